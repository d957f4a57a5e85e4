"""`perception observe`: its output, skipped rows, messages and drawings, and resuming."""

from io import StringIO
from pathlib import Path

import cv2
import numpy as np
import pandas as pd
import pytest
from command import ran, run

import graphtrack as gt
from graphtrack.errors import InputError
from perception.detection.boxes import PersonBox, read_boxes, write_boxes
from perception.images.frames import FrameSource
from perception.observation.pipeline import PersonObservation, by_frame, observe_frame
from perception.observation.tables import to_tracks
from perception.pose.classes import PoseClasses
from perception.pose.head_detection import HeadCandidates
from perception.synthetic import Camera, Person, Scene, render_frame
from perception.synthetic.cameras import ImageSensor
from perception.synthetic.people import Posture, random_appearance
from perception.synthetic.raycast import Light, TiledFloor

STREET = Camera((0.0, -9.0, 3.0), np.pi / 2, -0.2, 500.0, (320, 240))
EIGHT = PoseClasses.circle(8)


@pytest.fixture(scope="module")
def clip(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with 6 frames of a person who walks, MOT boxes and the homography."""
    folder = tmp_path_factory.mktemp("clip")
    (folder / "frames").mkdir()
    rng = np.random.default_rng(0)
    look = random_appearance(rng)
    light = Light((0.3, -0.5, 0.8), (0.5, 0.5, 0.5), (0.5, 0.5, 0.5))
    scene = Scene(STREET, light, TiledFloor((0.6, 0.6, 0.6)))
    boxes = []
    for k in range(6):
        posture = Posture((-1.0 + 0.25 * k, 0.0), 0.0, 0.0, phase=0.9 * k, stride=0.8)
        frame = render_frame(scene, [Person(look, posture)], ImageSensor(noise=1.0), rng)
        cv2.imwrite(str(folder / "frames" / f"{k:04d}.png"), frame.image)
        boxes.append(PersonBox(k, 7, frame.labels[0].body_box))
    write_boxes(boxes, folder / "boxes.txt")
    np.savetxt(folder / "homography.txt", STREET.ground_camera().homography)
    return folder


def frames_looked_at(monkeypatch: pytest.MonkeyPatch, error: type[BaseException] | None) -> list[int]:
    """The frames that models look at from here on; the fourth raises an error."""
    looked: list[int] = []

    def look(image: np.ndarray, frame: int, *rest: object) -> list[PersonObservation]:
        looked.append(frame)
        if error is not None and len(looked) == 4:
            raise error
        return observe_frame(image, frame, *rest)

    monkeypatch.setattr("perception.observation.pipeline.observe_frame", look)
    return looked


def test_observe_writes_what_smooth_reads(clip: Path, tmp_path: Path) -> None:
    out = tmp_path / "observations.csv"
    options = ["--boxes", clip / "boxes.txt", "--homography", clip / "homography.txt", "--fps", 5]
    done = ran("observe", clip / "frames", *options, "-o", out)
    assert "6 person-frames in 1 track" in done.stderr
    assert not list(tmp_path.glob("*.journal"))
    track = gt.read(out).by_id(7)
    np.testing.assert_allclose(np.diff(track.t), 0.2)
    # The box's lower edge is the toe, not the middle of the person.
    np.testing.assert_allclose(track.position[:, 0], -1.0 + 0.25 * np.arange(6), atol=0.25)
    np.testing.assert_allclose(track.body_likelihood.sum(axis=1), 1.0, atol=1e-3)
    np.testing.assert_allclose(track.head_likelihood.sum(axis=1), 1.0, atol=1e-3)
    body = EIGHT.mean_pan(np.log(track.body_likelihood + 1e-9))
    assert np.abs(body).mean() < np.deg2rad(60.0)  # they walk to the right; by chance: 90°


def test_frames_and_boxes_that_cannot_be_used_are_told_of(clip: Path, tmp_path: Path) -> None:
    folder = tmp_path / "frames"
    folder.mkdir()
    for path in (clip / "frames").iterdir():
        (folder / path.name).write_bytes(path.read_bytes() if path.stem != "0003" else b"broken")
    more = """\
2,9,5000,0,30,80,1,-1,-1,-1
77,9,0,0,30,80,1,-1,-1,-1
2,9,10,10,30,80,0,-1,-1,-1
3,8,-60000,-60000,120000,120000,1,-1,-1,-1
"""
    (tmp_path / "boxes.txt").write_text((clip / "boxes.txt").read_text() + more)
    done = ran("observe", folder, "--boxes", tmp_path / "boxes.txt", "-o", tmp_path / "out.csv")
    for text in (
        "0003.png cannot be decoded",
        "inside the image",
        "1 boxes of missing frames, such as 77: frames 0 to 5 came",
        "no camera",
        "1 marked to be ignored",
    ):
        assert text in done.stderr
    assert sorted(pd.read_csv(tmp_path / "out.csv")["frame"]) == [0, 1, 2, 4, 5]


def nobodys(clip: Path, folder: Path) -> Path:
    """The clip's boxes as a detector gives them: in any order, without identities, with log odds."""
    boxes = read_boxes(next(clip.glob("boxes.txt")))[::-1]
    path = folder / "det.txt"
    cells = ((item.frame, -1, *item.box, 2.0 - k) for k, item in enumerate(boxes))
    path.write_text("".join(",".join(map(str, row)) + "\n" for row in cells))
    return path


@pytest.mark.slow
def test_detections_stand_alone_and_are_associated(long_clip: Path, tmp_path: Path) -> None:
    """Rows are those of people with identities, but for heads, which no other frame chooses."""
    known = rows_of(
        long_clip, long_clip / "images", tmp_path / "known.csv", "--boxes", long_clip / "boxes.txt"
    )
    det = nobodys(long_clip, tmp_path)
    found = rows_of(long_clip, long_clip / "images", tmp_path / "found.csv", "--boxes", det)
    assert set(found["track_id"]) == {-1} and found["score"].between(0.0, 1.0).all()
    assert not {"score", "appearance_0"} & set(known.columns)
    together = known.merge(found, on=["frame", "u", "v"])
    assert len(together) == len(found) == len(known)
    for name in ("x", "body_p3"):
        np.testing.assert_allclose(together[f"{name}_x"], together[f"{name}_y"], rtol=1e-9)
    for suffix in (".parquet", ".ndjson"):
        other = tmp_path / f"found{suffix}"
        assert run("observe", long_clip / "images", "--boxes", det, "--fps", 5, "-o", other).returncode == 0
        people = gt.read(other)  # associated
        assert all(track.score is not None and "appearance" in track.inputs for track in people)
        with pytest.raises(InputError, match="without identities"):
            gt.read(other, associate="never")


@pytest.mark.slow
def test_a_detection_depends_on_no_other_when_causal(long_clip: Path, tmp_path: Path) -> None:
    det, lines = nobodys(long_clip, tmp_path), (tmp_path / "det.txt").read_text().splitlines()
    whole = rows_of(long_clip, long_clip / "images", tmp_path / "a.csv", "--boxes", det, "--causal")
    streamed = rows_of(long_clip, long_clip / "images", Path("-"), "--boxes", det)
    assert "appearance_63" in whole.columns and set(streamed["track_id"]) == {-1}
    order = ["frame", "u", "v"]
    whole, streamed = (table.sort_values(order, ignore_index=True) for table in (whole, streamed))
    pd.testing.assert_frame_equal(streamed[whole.columns], whole, rtol=1e-4, atol=1e-3, check_dtype=False)
    det.write_text("\n".join(lines[::3]) + "\n")
    some = rows_of(long_clip, long_clip / "images", tmp_path / "b.csv", "--boxes", det, "--causal")
    again = whole.merge(some[order], on=order)[some.columns]
    some = some.sort_values(order, ignore_index=True)
    assert len(again) == len(some) > 3
    # Of fewer people no score may be negative, and less is hidden.
    kept = [name for name in some.columns if name != "score" and not name.endswith("_hidden")]
    pd.testing.assert_frame_equal(again[kept], some[kept], rtol=1e-9, atol=1e-4)


@pytest.mark.parametrize("asked", [True, False])
def test_looks_are_written_when_asked_for(clip: Path, tmp_path: Path, asked: bool) -> None:
    boxes = clip / "boxes.txt" if asked else nobodys(clip, tmp_path)
    option = "--appearance" if asked else "--no-appearance"
    ran("observe", clip / "frames", "--boxes", boxes, "--fps", 5, option, "-o", tmp_path / "o.csv")
    columns = set(pd.read_csv(tmp_path / "o.csv").columns)
    assert ("appearance_0" in columns) == asked == ("score" not in columns)


def test_feet_beyond_the_horizon_are_told_of(clip: Path, tmp_path: Path) -> None:
    beyond = "3,8,-60000,-60000,120000,120000,1,-1,-1,-1\n4,6,10,-70,30,80,1,-1,-1,-1\n"
    (tmp_path / "boxes.txt").write_text((clip / "boxes.txt").read_text() + beyond)
    options = ["--boxes", tmp_path / "boxes.txt", "--homography", clip / "homography.txt"]
    done = run("observe", clip / "frames", *options, "-o", tmp_path / "out.csv")
    assert done.returncode == 0 and "6 person-frames in 1 track" in done.stderr
    assert "frame 3, track 8: found a box" in done.stderr and "refused 1: at or beyond" in done.stderr


@pytest.mark.parametrize("where", ["observing", "writing"])
def test_an_error_leaves_nothing_that_the_next_run_trips_over(
    clip: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, where: str
) -> None:
    arguments = "observe", clip / "frames", "--boxes", clip / "boxes.txt", "-o", tmp_path / "o.csv"
    looked = frames_looked_at(monkeypatch, MemoryError if where == "observing" else None)

    def full(*rest: object, **options: object) -> None:
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patch:
        if where == "writing":
            patch.setattr("graphtrack.io.read_write.write", full)
        assert run(*arguments).returncode == 2
    journal = tmp_path / "o.csv.journal"
    with journal.open("a") as stream:
        stream.write('{"frame": 77, "known": {"people": [{"frame": 77}], "refused": []}}\n')
    ran(*arguments)
    assert looked == ([0, 1, 2, 3, 3, 4, 5] if where == "observing" else [0, 1, 2, 3, 4, 5])
    assert [path.name for path in tmp_path.iterdir()] == ["o.csv"]


# -- drawn -------------------------------------------------------------------------------------------------


def drawn(folder: Path) -> dict[int, np.ndarray]:
    return {int(path.stem): cv2.imread(str(path)) for path in folder.iterdir()}


def test_a_run_that_was_broken_off_is_drawn_whole(
    clip: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    frames_looked_at(monkeypatch, KeyboardInterrupt)
    outside = "0,9,5000,0,30,80,1,-1,-1,-1\n"
    (tmp_path / "boxes.txt").write_text(outside + (clip / "boxes.txt").read_text())
    options = ["--boxes", tmp_path / "boxes.txt", "--homography", clip / "homography.txt"]
    arguments = "observe", clip / "frames", *options, "-o", tmp_path / "o.csv", "--render", tmp_path / "shown"
    assert run(*arguments).returncode == 130 and not (tmp_path / "shown").exists()
    done = run(*arguments)
    assert done.returncode == 0 and "going on after 3 frames" in done.stderr, done.stderr
    assert "frame 0, track 9: found a box" in done.stderr  # which the first run could not report
    whole = drawn(tmp_path / "shown")
    assert sorted(whole) == list(range(6))
    plain = FrameSource.open(clip / "frames")
    for frame, item in zip(plain, read_boxes(clip / "boxes.txt"), strict=True):
        changed = (cv2.resize(frame.image, None, fx=2, fy=2) != whole[frame.number]).any(axis=2)
        left, top, width, _ = (round(2 * value) for value in item.box)
        assert changed[top, left : left + width].mean() > 0.9  # small images are drawn twice as large
    out = tmp_path / "again.mp4"
    done = run("observe", clip / "frames", *options, "-o", tmp_path / "again.csv", "--render", out)
    assert done.returncode == 0 and f"and {out}" in done.stderr
    assert FrameSource.open(out).count == 6


@pytest.fixture(scope="module")
def long_clip(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A rendered street of 8 frames, whose people have several candidates of the head."""
    folder = tmp_path_factory.mktemp("street") / "clip"
    ran("simulate", "-o", folder, "--frames", 8, "--seed", 12, "--images")
    return folder


def rows_of(clip: Path, frames: Path, out: Path, *options: object) -> pd.DataFrame:
    given = ["--homography", clip / "homography.txt", "--fps", 5]
    done = ran("observe", frames, *given, *options, "-o", out)
    table = pd.read_json(StringIO(done.stdout), lines=True) if str(out) == "-" else pd.read_csv(out)
    return table.sort_values(["track_id", "frame", "u", "v"], ignore_index=True)


def cut(clip: Path, folder: Path, count: int) -> Path:
    """The first frames alone."""
    folder.mkdir()
    for path in sorted((clip / "images").glob("*.png"))[:count]:
        (folder / path.name).write_bytes(path.read_bytes())
    return folder


@pytest.mark.parametrize(
    ("boxes_given", "count"), [(True, 3), (True, 5), pytest.param(False, 5, marks=pytest.mark.slow)]
)
def test_causal_rows_do_not_change_when_later_frames_are_cut_off(
    long_clip: Path, tmp_path: Path, boxes_given: bool, count: int
) -> None:
    options = ["--causal", *(["--boxes", long_clip / "boxes.txt"] if boxes_given else [])]
    whole = rows_of(long_clip, long_clip / "images", tmp_path / "whole.csv", *options)
    first = rows_of(long_clip, cut(long_clip, tmp_path / "cut", count), tmp_path / "cut.csv", *options)
    assert len(first) > 3 and first["frame"].max() < count <= whole["frame"].max()
    expected = whole[whole["frame"] < count].reset_index(drop=True)
    # To rounding: sums over fewer rows are added up in another order.
    pd.testing.assert_frame_equal(first, expected, rtol=1e-12, atol=1e-12)


def test_the_scale_without_a_camera_is_that_of_the_first_frame_when_causal(tmp_path: Path) -> None:
    flat = np.log(np.full(8, 1.0 / 8.0))
    heads = HeadCandidates(np.array([[5.0, 2.0, 10.0, 14.0]]), np.array([0.4]))
    near = [
        PersonObservation(
            k, 1, (10.0, 10.0, 30.0, 80.0 + 40.0 * k), flat, heads, np.log(np.full((1, 12), 1 / 12))
        )
        for k in range(3)
    ]
    classes = PoseClasses.circle(12)
    alone, after = (
        to_tracks(by_frame(near[:n]), classes, None, 5.0, causal=True).tracks.by_id(1) for n in (1, 3)
    )
    np.testing.assert_array_equal(alone.position[0], after.position[0])
    whole = to_tracks(by_frame(near), classes, None, 5.0).tracks.by_id(1)
    assert not np.allclose(whole.position[0], after.position[0])


@pytest.mark.parametrize("boxes_given", [True, pytest.param(False, marks=pytest.mark.slow)])
def test_streamed_rows_are_those_of_a_causal_file(long_clip: Path, tmp_path: Path, boxes_given: bool) -> None:
    options = ["--boxes", long_clip / "boxes.txt"] if boxes_given else []
    streamed = rows_of(long_clip, long_clip / "images", Path("-"), *options)
    written = rows_of(long_clip, long_clip / "images", tmp_path / "o.csv", "--causal", *options)
    pd.testing.assert_frame_equal(streamed[written.columns], written, rtol=1e-4, atol=1e-3, check_dtype=False)


@pytest.mark.parametrize(
    ("options", "output", "told"),
    [
        (["--boxes", "boxes.txt", "--write-boxes", "again.txt"], "o.csv", "--write-boxes with --boxes"),
        (["--homography", "h.txt", "--calibration", "h.txt"], "o.csv", "--homography and --calibration"),
        (["--boxes", "det.txt"], "o.txt", "detections without identities"),
        (["--boxes-first-frame", "1"], "o.csv", "--boxes-first-frame without --boxes"),
        (["--models", "h.txt", "--body-pose-model", "h.txt"], "o.csv", "one of them"),
        (["--render", "seen.mp4"], "-", "--render with -o -"),
        (["--write-boxes", "b.txt"], "-", "--write-boxes with -o -"),
    ],
)
def test_options_that_exclude_each_other_are_one_line(
    clip: Path, tmp_path: Path, options: list[str], output: str, told: str
) -> None:
    known = {"boxes.txt": clip / "boxes.txt", "h.txt": clip / "homography.txt", "det.txt": None}
    given = [known[name] or nobodys(clip, tmp_path) if name in known else name for name in options]
    given = [tmp_path / name if name in ("again.txt", "seen.mp4", "b.txt") else name for name in given]
    out = output if output == "-" else tmp_path / output
    done = run("observe", clip / "frames", *given, "-o", out)
    assert done.returncode == 2 and told in done.stderr and not done.stdout
    assert {path.name for path in tmp_path.iterdir()} <= {"det.txt"}
