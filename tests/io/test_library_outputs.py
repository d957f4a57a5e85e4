"""Tracks from and to supervision, Ultralytics, polars and GeoPandas."""

import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pandas as pd
import pytest
from command import ran

import graphtrack as gt
from graphtrack.errors import InputError
from graphtrack.forecasting.recorded import read_forecasts
from graphtrack.geometry.camera import GroundCamera
from graphtrack.interaction.tables import read_group_table
from graphtrack.tracks.schema import BOX_COLUMNS

CAMERA = GroundCamera.from_calibration(
    # 4 m above the ground, looking along +y and 20° down.
    np.array([[1.0, 0.0, 0.0], [0.0, -np.sin(0.35), -np.cos(0.35)], [0.0, np.cos(0.35), -np.sin(0.35)]]),
    np.array([0.0, 4.0 * np.cos(0.35), 4.0 * np.sin(0.35)]),
    np.array([[400.0, 0.0, 320.0], [0.0, 400.0, 240.0], [0.0, 0.0, 1.0]]),
)
FRAMES = 12


@pytest.fixture
def sv() -> Any:
    return pytest.importorskip("supervision", reason="the extra supervision has it")


def people() -> gt.TrackSet:
    """Two people who walk past each other; the second comes in frame 2, and is not observed in frame 5."""
    tracks = []
    for track_id, first, y, speed in ((7, 0, 9.0, 0.25), (3, 2, 12.0, -0.25)):
        frame = np.arange(first, FRAMES)
        position = np.column_stack([speed * (frame - 6), np.full(len(frame), y)])
        position[(frame == 5) & (track_id == 3)] = np.nan
        score = np.full(len(frame), 0.75)
        label = "Anna" if track_id == 7 else "Ben"
        tracks.append(gt.Track(track_id, frame, frame / 10.0, position, score=score, label=label))
    return gt.TrackSet(tuple(tracks), CAMERA)


@pytest.mark.slow
def test_a_frame_has_its_people_with_boxes_on_their_positions(sv: Any) -> None:
    scene = people()
    found = gt.to_supervision(scene, 4)
    assert isinstance(found, sv.Detections)
    assert found.tracker_id.tolist() == [7, 3] and found.class_id.tolist() == [0, 0]
    assert found.confidence.tolist() == [0.75, 0.75]
    assert found.data["class_name"].tolist() == ["person"] * 2
    assert found.data["label"].tolist() == ["Anna", "Ben"]
    feet = np.column_stack([found.xyxy[:, [0, 2]].mean(axis=1), found.xyxy[:, 3]])
    np.testing.assert_allclose(CAMERA.image_to_ground(feet), [[-0.5, 9.0], [0.5, 12.0]], atol=1e-9)
    np.testing.assert_array_equal(found.data["x"], [-0.5, 0.5])
    # The farther person is smaller; both are about as tall as a pole of 1.7 m at their feet.
    height = found.xyxy[:, 3] - found.xyxy[:, 1]
    depth = np.array([[9.0], [12.0]]) * np.cos(0.35) + 4.0 * np.sin(0.35)
    np.testing.assert_allclose(height, 400.0 * 1.7 / depth[:, 0], rtol=0.02)
    assert gt.to_supervision(scene, 5).tracker_id.tolist() == [7]
    assert len(gt.to_supervision(scene, 99)) == 0
    everybody = gt.to_supervision(scene)
    assert list(everybody) == list(range(FRAMES))
    assert [len(one) for one in everybody.values()] == [1, 1, 2, 2, 2, 1, *[2] * 6]
    homography = gt.to_supervision(scene.tracks[0], 4, camera=CAMERA.homography)
    np.testing.assert_allclose(homography.xyxy[0, 3], found.xyxy[0, 3])


@pytest.mark.slow
def test_what_supervision_gave_goes_back_to_it_and_is_read_again(sv: Any) -> None:
    scene = people()
    again = gt.from_supervision(gt.to_supervision(scene), fps=10.0, camera=CAMERA)
    assert [track.track_id for track in again] == [3, 7]
    for track in again:
        before = scene.by_id(track.track_id)
        known = np.isfinite(before.position[:, 0])
        np.testing.assert_array_equal(track.frame, before.frame[known])
        np.testing.assert_allclose(track.position, before.position[known], atol=1e-9)
        np.testing.assert_allclose(track.t, before.t[known])
    smoothed = gt.smooth(again, "position")
    assert gt.to_supervision(smoothed, 5).tracker_id.tolist() == [7]


def test_boxes_that_are_known_are_taken(sv: Any, tmp_path: Path) -> None:
    scene = people()
    table = scene.to_table()
    known = table["frame"] < 6
    for k, name in enumerate(BOX_COLUMNS[:4]):
        table[name] = np.where(known, 10.0 * (k + 1) + table["track_id"], np.nan)
    table.to_csv(tmp_path / "boxes.csv", index=False)
    expected = [[17.0, 27.0, 54.0, 74.0], [13.0, 23.0, 46.0, 66.0]]
    for boxes in (table, tmp_path / "boxes.csv", {name: table[name] for name in table}):
        found = gt.to_supervision(scene, boxes=boxes)
        np.testing.assert_array_equal(found[4].xyxy, expected)
        np.testing.assert_array_equal(found[8].xyxy, gt.to_supervision(scene, 8).xyxy)  # by the camera
    # A table's own boxes need no camera; people without either are left out.
    found = gt.to_supervision(table)  # in the order of ids
    np.testing.assert_array_equal(found[4].xyxy, expected[::-1])
    assert list(found) == [0, 1, 2, 3, 4, 5]
    gt.write(scene, tmp_path / "boxes.txt", format="mot")
    np.testing.assert_allclose(
        gt.to_supervision(gt.TrackSet(scene.tracks), 4, boxes=tmp_path / "boxes.txt").xyxy,
        gt.to_supervision(scene, 4).xyxy,
        atol=2e-3,
    )


def test_what_is_missing_is_named(sv: Any) -> None:
    with pytest.raises(InputError, match="without a camera, expected camera=, or boxes="):
        gt.to_supervision(gt.TrackSet(people().tracks), 4)
    with pytest.raises(InputError, match="left"):
        gt.to_supervision(people(), boxes=people().to_table())


@pytest.mark.parametrize("library", ["supervision", "polars"])
def test_a_missing_library_is_named_with_its_extra(library: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, library, None)
    with pytest.raises(InputError, match=rf"no package {library}.*graphtrack\[{library}\]"):
        getattr(gt, f"to_{library}")(people())


def test_a_frame_of_polars_is_the_table_and_is_read_again() -> None:
    polars = pytest.importorskip("polars", reason="the extra polars has it")
    scene = people()
    frame = gt.to_polars(scene)
    assert isinstance(frame, polars.DataFrame)
    assert frame.columns == list(scene.to_table().columns)
    assert frame["track_id"].dtype == polars.Int64 and frame["label"].dtype == polars.String
    assert frame["x"].null_count() == 1 and not frame["x"].is_nan().any()
    again = gt.read(frame)
    for one, other in zip(sorted(scene, key=lambda track: track.track_id), again, strict=True):
        np.testing.assert_array_equal(one.position, other.position)
        np.testing.assert_array_equal(one.t, other.t)
        assert one.label == other.label


def test_a_frame_of_polars_has_the_names_that_were_read() -> None:
    polars = pytest.importorskip("polars", reason="the extra polars has it")
    given = polars.DataFrame(
        {"who": ["a", "b", "a"], "ms": [0, 0, 40], "px": [0.0, 99.0, 4.0], "py": [0.0, 9.0, 0.0]}
    )
    tracks = gt.read(given, columns="id=who,t=ms,x=px,y=py", time_unit="ms", units="cm")
    frame = gt.to_polars(tracks, as_read=True)
    assert frame.sort("ms", "who").select(given.columns).rows() == given.sort("ms", "who").rows()


COLUMNS = {"id": "agent", "t": "timestamp", "lat": "lat", "lon": "lon"}
SPEC = ",".join(f"{key}={name}" for key, name in COLUMNS.items())


def walks() -> pd.DataFrame:
    """Two people who go north; one lacks a position."""
    times = [f"2025-11-23T10:00:0{k}.5Z" for k in range(4)]
    steps = 48.137 + 1e-5 * np.arange(4)
    anna = pd.DataFrame({"agent": "anna", "timestamp": times, "lat": steps, "lon": 11.575})
    bob = anna.assign(agent="bob", lon=11.576)
    bob.loc[1, ["lat", "lon"]] = np.nan
    return pd.concat([anna, bob], ignore_index=True)


def test_points_keep_their_places_times_and_names_in_files(tmp_path: Path) -> None:
    geopandas = pytest.importorskip("geopandas")
    points = gt.to_geopandas(gt.read(walks(), columns=COLUMNS))
    points.to_file(tmp_path / "walks.gpkg")
    points.to_parquet(tmp_path / "walks.parquet")
    given = walks().dropna()
    read = geopandas.read_file(tmp_path / "walks.gpkg"), geopandas.read_parquet(tmp_path / "walks.parquet")
    for found in read:
        assert found.crs.to_epsg() == 4326
        np.testing.assert_allclose(found.geometry.x, given.lon, atol=1e-9)
        np.testing.assert_allclose(found.geometry.y, given.lat, atol=1e-9)
        assert list(found["agent"]) == list(given.agent)
        expected = pd.to_datetime(given.timestamp).dt.tz_localize(None).to_numpy()
        assert (found["time"].to_numpy() == expected.astype(found["time"].dtype.str)).all()


def test_the_command_line_writes_them_by_the_ending(tmp_path: Path) -> None:
    geopandas = pytest.importorskip("geopandas")
    walks().to_csv(tmp_path / "walks.csv", index=False)
    for ending in ("gpkg", "geoparquet"):
        more = ("--columns", SPEC, "--model", "position", "-o", tmp_path / f"smoothed.{ending}")
        ran("smooth", tmp_path / "walks.csv", *more, program="graphtrack")
    layer = geopandas.read_file(tmp_path / "smoothed.gpkg")
    table = geopandas.read_parquet(tmp_path / "smoothed.geoparquet")
    assert layer.crs.to_epsg() == table.crs.to_epsg() == 4326
    np.testing.assert_allclose(layer.geometry.x, table.geometry.x)
    # Both are tables too.
    again = gt.read(tmp_path / "smoothed.geoparquet", columns=COLUMNS)
    frame = gt.read(layer.drop(columns="geometry"), columns=COLUMNS)
    assert [track.label for track in again] == [track.label for track in frame] == ["anna", "bob"]
    with pytest.raises(gt.InputError, match=r"GeoPackage.*read_file"):
        gt.read(tmp_path / "smoothed.gpkg")
    with pytest.raises(gt.InputError, match="only written"):
        gt.read(tmp_path / "smoothed.gpkg", format="geopackage")


@pytest.mark.slow
def test_tables_of_groups_looks_and_forecasts_name_people(tmp_path: Path) -> None:
    walks().assign(body_deg=90.0, head_deg=90.0).to_csv(tmp_path / "walks.csv", index=False)
    for command in ("groups", "attention", "forecast"):
        out = tmp_path / f"{command}.csv"
        ran(command, tmp_path / "walks.csv", "--columns", SPEC, "-o", out, program="graphtrack")
        table = pd.read_csv(out)
        names = dict(zip(table["track_id"], table["label"], strict=True))
        assert names == {1: "anna", 2: "bob"}, command
    looks = pd.read_csv(tmp_path / "attention.csv")
    others = looks[looks["kind"] == "person"]
    assert list(others["target_label"]) == [{"1": "anna", "2": "bob"}[str(one)] for one in others["target"]]
    assert looks[looks["kind"] != "person"]["target_label"].isna().all()
    read_group_table(tmp_path / "groups.csv")
    read_forecasts(tmp_path / "forecast.csv")


def detections(frame: int, ids: bool = True, make: Any = SimpleNamespace) -> Any:
    """Two people who walk past each other, and a dog."""
    left = np.array([10.0 + 3.0 * frame, 200.0 - 3.0 * frame, 50.0])
    corners = np.stack([left, [10.0, 30.0, 40.0], left + 40.0, [110.0, 130.0, 60.0]], axis=1)
    return make(
        xyxy=corners,
        confidence=np.array([0.9, 0.8, 0.7]),
        class_id=np.array([0, 0, 16]),
        tracker_id=np.array([5, 2, 7]) if ids else None,
    )


def assert_walks(tracks: gt.TrackSet, frames: Any = range(FRAMES)) -> None:
    frame = np.array(list(frames))
    foot = np.stack([0.01 * (30.0 + 3.0 * frame), np.full(len(frame), -1.1)], axis=1)
    first = min(tracks, key=lambda track: float(track.position[0, 0]))
    np.testing.assert_allclose(first.position, foot)
    np.testing.assert_array_equal(first.frame, frame)
    np.testing.assert_allclose(first.t, frame / 4.0)


def test_ids_of_a_tracker_are_the_tracks() -> None:
    found = [detections(frame) for frame in range(FRAMES)]
    tracks = gt.from_supervision(found, fps=4.0, metres_per_pixel=0.01)
    assert [track.track_id for track in tracks] == [2, 5]
    assert_walks(tracks)
    some = {frame: detections(frame) for frame in (3, 6)}
    assert_walks(gt.from_supervision(some, fps=4.0, metres_per_pixel=0.01), some)
    everything = gt.from_supervision(found, fps=4.0, metres_per_pixel=0.01, person=None)
    assert [track.track_id for track in everything] == [2, 5, 7]

    def result(one: Any) -> SimpleNamespace:
        boxes = SimpleNamespace(xyxy=one.xyxy, conf=one.confidence, cls=one.class_id, id=one.tracker_id)
        return SimpleNamespace(boxes=boxes, names={0: "person", 16: "dog"}, keypoints=None)

    assert_walks(gt.from_ultralytics(map(result, found), fps=4.0, metres_per_pixel=0.01))


def test_detections_without_ids_are_associated() -> None:
    found = [detections(frame, ids=False) for frame in range(FRAMES)]
    tracks = gt.from_supervision(found, fps=4.0, metres_per_pixel=0.01)
    assert len(tracks) == 2
    assert_walks(tracks)
    with pytest.raises(InputError, match="without identities"):
        gt.from_supervision(found, fps=4.0, metres_per_pixel=0.01, associate="never")


def test_boxes_of_frames_without_ids_are_refused_where_others_have_some() -> None:
    found = [detections(frame, ids=frame not in (0, 7)) for frame in range(FRAMES)]
    tracks = gt.from_supervision(found, fps=4.0, metres_per_pixel=0.01)
    assert_walks(tracks, [frame for frame in range(FRAMES) if frame not in (0, 7)])
    assert tracks.summary.refused == {"of another class": FRAMES, "not followed by the tracker (id −1)": 4}


def test_what_the_package_trackers_gives_is_taken() -> None:
    supervision = pytest.importorskip("supervision", reason="the extra peers has it")
    trackers = pytest.importorskip("trackers", reason="see the extra peers")
    tracker = trackers.ByteTrackTracker(frame_rate=4.0)
    found = [tracker.update(detections(k, ids=False, make=supervision.Detections)) for k in range(FRAMES)]
    assert found[0].tracker_id is not None and (found[0].tracker_id == -1).all()  # no tracks yet
    tracks = gt.from_supervision(found, fps=4.0, metres_per_pixel=0.01)
    assert_walks(tracks, range(1, FRAMES))


@pytest.mark.parametrize(
    ("found", "told"),
    [
        (detections(0), "a list of them"),
        ([], "no people in 0 frames"),
        ([SimpleNamespace(boxes=None)], "without xyxy"),
    ],
)
def test_what_does_not_fit_together_is_refused(found: Any, told: str) -> None:
    with pytest.raises(InputError, match=told):
        gt.from_supervision(found, fps=4.0)
    with pytest.raises(InputError, match="fps"):
        gt.from_supervision([detections(0)], fps=0.0)
