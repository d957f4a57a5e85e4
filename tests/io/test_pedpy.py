"""PedPy's trajectories, its text files, and JuPedSim's databases, there and back."""

import gzip
import sqlite3
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pandas as pd
import pytest
from format_samples import made_tracks
from same_tracks import assert_same

import graphtrack as gt
from graphtrack.errors import InputError
from graphtrack.tracks.track import Track, TrackSet

SIMULATED = Path(__file__).parent / "made_elsewhere" / "jupedsim.sqlite.gz"
"""Written by JuPedSim 1.4: three agents in a room of 6 m × 4 m, 200 steps of 10 ms, each tenth."""


def seen() -> TrackSet:
    """Tracks as `made_tracks`, the frames with a position, with the columns of text and databases."""
    return TrackSet(tuple(track[np.isfinite(track.position).all(axis=1)] for track in made_tracks()))


def test_trajectories_come_back() -> None:
    pedpy = pytest.importorskip("pedpy", reason="the extra pedpy has it")
    trajectory = gt.to_pedpy(made_tracks())
    assert isinstance(trajectory, pedpy.TrajectoryData) and trajectory.frame_rate == 10.0
    assert_same(gt.from_pedpy(trajectory), seen(), in_degrees=True)
    data = pd.DataFrame(
        {"id": [1, 1, 4], "frame": [10, 11, 10], "x": [0.0, 1.0, 5.0], "y": 2.0, "point": None}
    )
    found = gt.from_pedpy(SimpleNamespace(data=data, frame_rate=5))
    np.testing.assert_array_equal(found.by_id(1).t, [2.0, 2.2])
    speed = pedpy.compute_individual_speed(traj_data=trajectory, frame_step=1)
    np.testing.assert_allclose(speed["speed"].median(), np.hypot(1.0, 3.0), rtol=0.01)


def walk(t: Any) -> TrackSet:
    t = np.asarray(t, dtype=float)
    return TrackSet((Track(0, np.arange(len(t)), t, np.column_stack([t, t])),))


def test_times_without_a_rate_are_refused(tmp_path: Path) -> None:
    pytest.importorskip("pedpy")
    for path in ("a.sqlite", "a.pedpy.txt"):
        with pytest.raises(InputError, match=r"without a steady frame rate.*\.nc"):
            gt.write(walk([0.0, 0.1, 0.7]), tmp_path / path)
        assert not (tmp_path / path).exists()
    with pytest.raises(InputError, match="steady"):
        gt.to_pedpy(walk([0.0]))
    assert gt.to_pedpy(walk([0.0]), frame_rate=4).frame_rate == 4
    with pytest.raises(InputError, match=r"pedpy\.TrajectoryData"):
        gt.from_pedpy(pd.DataFrame())


@pytest.mark.parametrize(
    ("header", "options", "rate", "metre"),
    [
        ("# framerate: 25\n# id frame x/m y/m z/m\n", {}, 25.0, 1.0),
        ("#framerate: 16.00 fps\n#ID\tFR\tX/cm\tY/cm\n", {}, 16.0, 0.01),
        ("# PeTrack project\n# framerate: 25 fps\n# <number> <frame> <x> <y> <z> [in m]\n", {}, 25.0, 1.0),
        ("#framerate 12.5\n", {"units": "cm"}, 12.5, 0.01),
        ("# nothing that helps\n", {"units": "m", "fps": 8.0}, 8.0, 1.0),
    ],
)
def test_text_files_of_all_headers(
    header: str, options: Any, rate: float, metre: float, tmp_path: Path
) -> None:
    path = tmp_path / "walk.txt"
    path.write_text(header + "1 0 10 20.5 170\n1 1 11 21 170\n2\t0\t-3\t4\t160\n")
    tracks = gt.read(path, **options)
    assert tracks.summary.format == "pedpy" and [track.track_id for track in tracks] == [1, 2]
    np.testing.assert_allclose(tracks.by_id(1).position, metre * np.array([[10, 20.5], [11, 21]]))
    np.testing.assert_allclose(tracks.by_id(1).t, [0.0, 1.0 / rate])
    pedpy = pytest.importorskip("pedpy", reason="the extra pedpy has it")
    given = {"default_frame_rate": options.get("fps"), "default_unit": None}
    if "units" in options:
        unit = {"m": "METER", "cm": "CENTIMETER"}[options["units"]]
        given["default_unit"] = getattr(pedpy.TrajectoryUnit, unit)
    loaded = pedpy.load_trajectory_from_txt(trajectory_file=path, **given)
    for one, other in zip(tracks, gt.from_pedpy(loaded), strict=True):
        np.testing.assert_allclose(one.position, other.position, rtol=1e-15)
        np.testing.assert_array_equal(one.t, other.t)


@pytest.mark.parametrize(
    ("text", "options", "told"),
    [
        ("# id frame x/m y/m\n1 0 1 2\n", {}, "no frame rate.*--fps"),
        ("# framerate: 0\n# x/m\n1 0 1 2\n", {}, "no frame rate"),
        ("# framerate: 5\n1 0 1 2\n", {}, "no unit of x and y.*--units"),
        ("# framerate: 5 x/m\n1 0 1 2\n", {"units": "cm"}, "--units cm, and m in the header"),
        ("# framerate: 5 x/m\n1 0 1 2\n", {"time_unit": "ms"}, "--time-unit for the format pedpy"),
        ("# framerate: 5 x/m\n1 0 1 2\n1 1 1 2\n1 2 x 2\n", {}, "line 4, column x: found 'x'"),
        ("# framerate: 5 x/m\n1 0 1 2\n1 0 1 2\n", {}, "line 3.*again in frame 0"),
    ],
)
def test_what_a_text_file_lacks_is_told(text: str, options: Any, told: str, tmp_path: Path) -> None:
    (tmp_path / "walk.txt").write_text(text)
    with pytest.raises(InputError, match=told):
        gt.read(tmp_path / "walk.txt", **options)


def test_written_text_is_pedpys(tmp_path: Path) -> None:
    path = tmp_path / "walk.pedpy.txt"
    gt.write(seen(), path)
    found = gt.read(path)
    for one, other in zip(found, seen(), strict=True):
        np.testing.assert_array_equal(one.position, other.position)
        np.testing.assert_array_equal(one.frame, other.frame)
    pedpy = pytest.importorskip("pedpy", reason="the extra pedpy has it")
    assert_same(gt.from_pedpy(pedpy.load_trajectory(trajectory_file=path)), found)


def test_databases_come_back(tmp_path: Path) -> None:
    path = tmp_path / "walk.sqlite"
    gt.write(made_tracks(), path)
    assert_same(gt.read(path), seen(), in_degrees=True)
    smoothed = gt.smooth(made_tracks(), model="position")
    gt.write(smoothed, path)
    assert_same(gt.read(path), smoothed, but=("covariance",), in_degrees=True)  # a table has its diagonal
    pedpy = pytest.importorskip("pedpy", reason="the extra pedpy has it")
    loaded = pedpy.load_trajectory_from_jupedsim_sqlite(trajectory_file=path)
    area = pedpy.load_walkable_area_from_jupedsim_sqlite(trajectory_file=path)
    assert loaded.frame_rate == 10.0 and loaded.data.point.apply(area.polygon.contains).all()
    np.testing.assert_array_equal(loaded.data[["x", "y"]], smoothed.to_table()[["x", "y"]])


def test_what_jupedsim_wrote_is_read() -> None:
    tracks = gt.read(SIMULATED)
    assert tracks.summary.format == "jupedsim" and len(tracks) == 3
    starts = {(1.0, 1.0), (1.5, 3.0), (3.0, 2.0)}
    assert {tuple(track.position[0].tolist()) for track in tracks} == starts
    for track in tracks:
        np.testing.assert_allclose(np.diff(track.t), 0.1)
        assert track.body is not None
        step = np.diff(track.position, axis=0)[2:]
        heading = np.arctan2(step[:, 1], step[:, 0])
        assert np.abs(np.angle(np.exp(1j * (track.body[3:] - heading)))).max() < 0.5


@pytest.mark.parametrize(
    ("statements", "told"),
    [
        ("create table walks(id, x)", "without a table trajectory_data.*walks"),
        ("create table gpkg_contents(a)", "GeoPackage"),
        ("create table trajectory_data(frame, id, pos_x)", "without pos_y"),
        ("create table trajectory_data(frame, id, pos_x, pos_y); insert into trajectory_data values(0,1,2,3)",
         "no fps.*--fps"),
        ("create table trajectory_data(frame, id, pos_x, pos_y); create table metadata(key, value);"
         "insert into metadata values('fps', '5'); insert into trajectory_data values(0, 1, 'x', 3)",
         "line 1, column pos_x: found 'x'"),
    ],
)  # fmt: skip
def test_other_databases_are_refused(statements: str, told: str, tmp_path: Path) -> None:
    path = tmp_path / "other.sqlite"
    with sqlite3.connect(path) as connection:
        connection.executescript(statements)
    with pytest.raises(InputError, match=told):
        gt.read(path)
    whole = gzip.decompress(SIMULATED.read_bytes())
    for data in (whole[:5000], whole[:4096] + bytes(len(whole) - 4096), whole[:16]):
        path.write_bytes(data)
        with pytest.raises(InputError):
            gt.read(path)
