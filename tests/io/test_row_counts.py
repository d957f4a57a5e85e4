"""Every way in counts each row that it is given as used or as refused."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pandas as pd
import pytest
from format_samples import SAMPLES, made_tracks, name_of, sample_of

import graphtrack as gt
from perception.detection import from_supervision, from_ultralytics

Read = tuple[gt.TrackSet, int, int]
"""The result, the rows that went in, and the number of them that no reader can use."""


@dataclass(frozen=True)
class WayIn:
    """A reader or an adapter, and its further requirements."""

    read: Callable[[Path], Read]
    needs: tuple[str, ...] = ()


FRAMES = 20


def mixed_boxes(frame: int) -> SimpleNamespace:
    """Eight boxes, three of them of people whom the tracker follows."""
    left = 10.0 + 2.0 * frame + 100.0 * np.arange(8)
    corners = np.stack([left, np.full(8, 10.0), left + 40.0, np.full(8, 110.0)], axis=1)
    corners[5, 2] = np.nan
    corners[6, 2] = np.inf
    corners[7, [0, 2]] = corners[7, [2, 0]]
    return SimpleNamespace(
        xyxy=corners,
        confidence=np.full(8, 0.9),
        class_id=np.array([0, 0, 0, 16, 0, 0, 0, 0]),
        tracker_id=np.array([4, 2, 9, 7, -1, 3, 5, 6]),
    )


def as_results(found: SimpleNamespace) -> SimpleNamespace:
    """The same as Ultralytics has it."""
    boxes = SimpleNamespace(xyxy=found.xyxy, conf=found.confidence, cls=found.class_id, id=found.tracker_id)
    return SimpleNamespace(boxes=boxes, names={0: "person", 16: "dog"}, keypoints=None)


def found_by_supervision(folder: Path) -> Read:
    found = [mixed_boxes(frame) for frame in range(FRAMES)]
    return gt.from_supervision(found, fps=10.0, metres_per_pixel=0.02), 8 * FRAMES, 5 * FRAMES


def detected_by_supervision(folder: Path) -> Read:
    found = [mixed_boxes(frame) for frame in range(FRAMES)]
    for one in found:
        one.tracker_id = None
    return gt.from_supervision(found, fps=10.0, metres_per_pixel=0.02), 8 * FRAMES, 4 * FRAMES


def found_by_ultralytics(folder: Path) -> Read:
    found = [as_results(mixed_boxes(frame)) for frame in range(FRAMES)]
    return gt.from_ultralytics(found, fps=10.0, metres_per_pixel=0.02), 8 * FRAMES, 5 * FRAMES


def dataset(folder: Path) -> Read:
    data = gt.to_movement(made_tracks())[["position"]]
    position = data["position"].to_numpy()
    n_cells = int(np.isfinite(position).all(axis=1).sum())
    position[-1, 0, 0, 0] = np.nan  # x without y
    data = data.assign(position=(data["position"].dims, position))
    return gt.from_movement(data, units="m"), n_cells, 1


def trajectory(folder: Path) -> Read:
    table = pd.DataFrame({"id": [1, 1, 2], "frame": [0, 1, 1], "x": [0.0, 0.1, 3.0], "y": [0.0, 0.0, 1.0]})
    return gt.from_pedpy(SimpleNamespace(data=table, frame_rate=25.0)), 3, 0


def native_table(folder: Path) -> Read:
    table = made_tracks().to_table()
    return gt.TrackSet.from_table(table), len(table), 0


def frame_of_polars(folder: Path) -> Read:
    table = gt.to_polars(made_tracks())
    return gt.read(table), len(table), 0


def foreign_table(folder: Path) -> Read:
    table = pd.DataFrame({"who": ["a", "b", "a"], "ms": [0, 0, 40], "px": [0, 99, 4], "py": [0, 9, 0]})
    columns = "id=who,t=ms,x=px,y=py"
    return gt.read(table, columns=columns, time_unit="ms", units="cm"), 3, 0


def detections_as_table(folder: Path) -> Read:
    """Rows with missing positions, and with repeated rows."""
    t = np.repeat(np.arange(FRAMES), 2)
    x = np.tile([0.0, 5.0], FRAMES) + 0.05 * t
    table = pd.DataFrame({"frame": t, "t": t / 10.0, "x": x, "y": np.zeros(len(t))})
    table.loc[[3, 8], ["x", "y"]] = np.nan
    table = pd.concat([table, table.iloc[[6]]])
    return gt.associate(table), len(table), 3


def beyond_the_horizon(folder: Path) -> Read:
    """Pixels, one of them above the horizon v = 100."""
    homography = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, 1.0, -100.0]])
    pixels = {"track_id": [1] * 5, "frame": range(5), "u": [1, 2, 3, 4, 5], "v": [200, 201, 202, 203, 50]}
    return gt.read(pixels, fps=10.0, homography=homography), 5, 1


def boxes_to_ignore(folder: Path) -> Read:
    """MOT ground truth with rows that are marked to be ignored, and of other classes."""
    rows = [f"{k + 1},1,{100 + k},50,40,100,1,1,1.0" for k in range(4)]
    rows += ["1,2,300,50,40,100,0,1,1.0", "1,3,400,50,40,100,1,3,1.0"]
    (folder / "gt.txt").write_text("\n".join(rows) + "\n")
    return gt.read(folder / "gt.txt", fps=10.0, metres_per_pixel=0.02), 6, 2


def several_files(folder: Path) -> Read:
    paths = [sample_of("csv").write(folder / "a"), sample_of("mocap").write(folder / "b")]
    return gt.read(paths), sample_of("csv").rows + sample_of("mocap").rows, 0


def of_sample(sample: Any) -> Callable[[Path], Read]:
    def read(folder: Path) -> Read:
        tracks = gt.read(sample.write(folder), **sample.options)
        return tracks, sample.rows, FRAMES_IGNORED.get(sample.format, 0)

    return read


FRAMES_IGNORED = {"kitti": 12}
"""Rows of samples that say of themselves that they are to be left out (KITTI's DontCare)."""

WAYS = {
    **{name_of(sample): WayIn(of_sample(sample)) for sample in SAMPLES},
    "supervision": WayIn(found_by_supervision),
    "supervision without ids": WayIn(detected_by_supervision),
    "ultralytics": WayIn(found_by_ultralytics),
    "dataset of movement": WayIn(dataset, ("xarray",)),
    "trajectory of PedPy": WayIn(trajectory),
    "native table in memory": WayIn(native_table),
    "frame of polars": WayIn(frame_of_polars, ("polars",)),
    "foreign table in memory": WayIn(foreign_table),
    "detections in memory": WayIn(detections_as_table),
    "pixels beyond the horizon": WayIn(beyond_the_horizon),
    "MOT ground truth": WayIn(boxes_to_ignore),
    "several files": WayIn(several_files),
}


@pytest.mark.parametrize("name", WAYS)
def test_rows_read_are_used_or_refused(name: str, tmp_path: Path) -> None:
    way = WAYS[name]
    for package in way.needs:
        pytest.importorskip(package)
    tracks, given, unusable = way.read(tmp_path)
    # Rows that association adds for frames without a detection were not read.
    used = sum(len(track) if track.observed is None else int(np.nansum(track.observed)) for track in tracks)
    assert tracks.summary.rows_read == given
    assert tracks.summary.rows_refused >= unusable
    assert used + tracks.summary.rows_refused == given
    assert used == tracks.summary.rows_used > 0


def test_reasons_for_which_boxes_are_refused_have_their_counts() -> None:
    summary = gt.from_supervision([mixed_boxes(k) for k in range(FRAMES)], fps=10.0).summary
    assert list(summary.refused.values()) == [FRAMES, 2 * FRAMES, FRAMES, FRAMES]
    told = " ".join(summary.refused)
    for word in ("another class", "not finite", "beyond the other", "not followed"):
        assert word in told
    nobody = mixed_boxes(0)
    nobody.class_id[:] = 2
    with pytest.raises(gt.InputError, match=r"no people in 1 frames \(8 of another class refused\)"):
        gt.from_supervision([nobody], fps=10.0)


@pytest.mark.parametrize("library", ["supervision", "ultralytics"])
def test_boxes_for_perception_are_used_or_refused(library: str) -> None:
    told: list[str] = []
    found = mixed_boxes(3)
    if library == "supervision":
        boxes = from_supervision(found, 3, refuse=told.append)
    else:
        boxes = from_ultralytics(as_results(found), 3, refuse=told.append)
    refused = sum(int(line.removeprefix("frame 3: ").split()[0]) for line in told)
    assert len(boxes) == 3 and len(boxes) + refused == len(found.xyxy)
