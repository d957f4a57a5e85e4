"""Files of DeepLabCut and SLEAP, which the package movement reads."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import graphtrack as gt
from graphtrack.errors import InputError
from graphtrack.io.format import recognised
from graphtrack.io.formats.movement import DEEPLABCUT, SLEAP, software_of
from graphtrack.io.source import Source

h5py = pytest.importorskip("h5py", reason="the extra movement has it")

FRAMES = 12
POINTS = ("nose", "left_ear", "right_ear", "left_hip", "right_hip")


def places(person: int) -> np.ndarray:
    """(frames, keypoints, 2) pixels of a person who walks to the right and looks there."""
    at = np.array([[8.0, 0.0], [0.0, -6.0], [0.0, 6.0], [-2.0, -9.0], [-2.0, 9.0]])
    walk = np.column_stack([20.0 + 5.0 * np.arange(FRAMES), np.full(FRAMES, 50.0 + 100.0 * person)])
    return walk[:, None, :] + at


def deeplabcut(path: Path) -> Path:
    """Two people in the layout of DeepLabCut's multi-animal CSV."""
    header: list[list[str]] = [["scorer"], ["individuals"], ["bodyparts"], ["coords"]]
    for person in ("anna", "ben"):
        for point in POINTS:
            for name in ("x", "y", "likelihood"):
                for row, cell in zip(header, ("made", person, point, name), strict=True):
                    row.append(cell)
    rows = [",".join(row) for row in header]
    for k in range(FRAMES):
        cells = [f"{value:.1f}" for person in (0, 1) for x, y in places(person)[k] for value in (x, y, 0.9)]
        rows.append(",".join([str(k), *cells]))
    path.write_text("\n".join(rows) + "\n")
    return path


def sleap(path: Path) -> Path:
    """The same people in the layout of SLEAP's analysis files."""
    tracks = np.stack([places(person) for person in (0, 1)])  # tracks, frames, nodes, 2
    with h5py.File(path, "w") as file:
        file["tracks"] = tracks.transpose(0, 3, 2, 1)
        file["node_names"] = [name.encode() for name in POINTS]
        file["track_names"] = [b"anna", b"ben"]
        file["point_scores"] = np.full((2, len(POINTS), FRAMES), 0.9)
        file["track_occupancy"] = np.ones((FRAMES, 2))
    return path


WRITERS = {DEEPLABCUT: (deeplabcut, "poses.csv"), SLEAP: (sleap, "poses.h5")}


@pytest.mark.parametrize("software", WRITERS)
def test_files_are_recognised_by_their_content(software: str, tmp_path: Path) -> None:
    write, name = WRITERS[software]
    source = Source.open(write(tmp_path / name))
    assert recognised(source.head, source.path) == "movement" and software_of(source) == software


@pytest.mark.parametrize("software", WRITERS)
def test_poses_are_tracks(software: str, tmp_path: Path) -> None:
    pytest.importorskip("movement", reason="the extra poses has it")
    write, name = WRITERS[software]
    tracks = gt.read(write(tmp_path / name), fps=10.0, metres_per_pixel=0.02)
    assert [track.label for track in tracks] == ["anna", "ben"]
    assert (tracks.summary.rows_read, tracks.summary.rows_used) == (2 * FRAMES, 2 * FRAMES)
    for person, track in enumerate(tracks):
        hips = places(person)[:, 3:].mean(axis=1)
        np.testing.assert_allclose(track.position, 0.02 * hips * [1.0, -1.0], atol=1e-5)
        np.testing.assert_allclose(track.t, np.arange(FRAMES) / 10.0)
        assert track.head is not None
        np.testing.assert_allclose(track.head, 0.0, atol=1e-5)


@pytest.mark.parametrize("software", WRITERS)
def test_without_the_package_the_way_is_named(
    software: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "movement", None)
    monkeypatch.setitem(sys.modules, "movement.io", None)
    write, name = WRITERS[software]
    with pytest.raises(InputError) as told:
        gt.read(write(tmp_path / name), fps=10.0, metres_per_pixel=0.02)
    for words in (software, "graphtrack[poses]", "movement.io.load_dataset", name):
        assert words in str(told.value)


@pytest.mark.parametrize(
    ("options", "said"), [({"fps": 10.0}, "--units m"), ({"metres_per_pixel": 1}, "--fps")]
)
def test_what_such_files_do_not_say_is_asked_for(options: dict[str, Any], said: str, tmp_path: Path) -> None:
    pytest.importorskip("movement", reason="the extra poses has it")
    with pytest.raises(InputError, match=said):
        gt.read(sleap(tmp_path / "poses.h5"), **options)


def test_a_damaged_file_is_told(tmp_path: Path) -> None:
    pytest.importorskip("movement", reason="the extra poses has it")
    path = tmp_path / "poses.csv"
    path.write_text("scorer,made,made,made\nbodyparts,nose,nose,nose\n0,1.0,2.0,0.9\n")
    with pytest.raises(InputError, match="a file of DeepLabCut that movement cannot read"):
        gt.read(path, fps=10.0, metres_per_pixel=0.02)
