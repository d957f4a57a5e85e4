"""Readers of each format on synthetic files whose answer is known, and scores of MOT text."""

import tempfile
from pathlib import Path

import numpy as np
import pytest
from format_samples import FRAMES, SAMPLES, Sample, name_of, sample_of
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.special import expit

import graphtrack as gt
from graphtrack import io
from graphtrack.errors import InputError
from graphtrack.geometry.angles import difference
from graphtrack.geometry.camera import GroundCamera
from graphtrack.io.cameras import read_calibration
from graphtrack.io.format import SIGNATURES
from graphtrack.io.options import ReadOptions
from graphtrack.io.read_write import rows_of_file
from graphtrack.io.registry import HOMES, all_formats
from graphtrack.io.source import HEAD_BYTES, mostly
from graphtrack.tracks.table import Rows


@pytest.mark.parametrize("sample", SAMPLES, ids=name_of)
def test_each_format_is_recognised_whatever_its_name(sample: Sample, tmp_path: Path) -> None:
    path = sample.write(tmp_path)
    renamed = path.rename(path.with_name(path.name.split(".")[0] + ".data"))
    options = dict(sample.options)
    if sample.format == "kitti":
        options |= {"oxts": tmp_path / "oxts/0001.txt", "ego_calibration": tmp_path / "calib/0001.txt"}
    assert io.read_identified(renamed, **options).summary.format == sample.format


@pytest.mark.parametrize(
    ("format", "fps"), [("mot", 25), ("ucy", 25), ("towncentre", 25), ("caviar", 25), ("kitti", 10)]
)
def test_frame_rates(format: str, fps: float, tmp_path: Path) -> None:
    path = sample_of(format).write(tmp_path)
    for tracks, rate in ((io.read_identified(path), fps), (io.read_identified(path, fps=5.0), 5.0)):
        for track in tracks:
            np.testing.assert_allclose(track.t, track.frame / rate)


def test_a_line_that_the_head_cuts_does_not_hide_the_format() -> None:
    for line in (5000, HEAD_BYTES - 2):
        text = "1" * line + "\n" + "x" * HEAD_BYTES
        assert mostly(text.encode()[:HEAD_BYTES], str.isdigit)
    assert not mostly(b"1\nx", str.isdigit) and not mostly(b"x" * HEAD_BYTES, str.isdigit)


def test_every_format_that_is_read_has_a_signature() -> None:
    assert {one.name for one in all_formats() if one.is_read} == {*SIGNATURES, "bag"}
    assert [one.name for one in all_formats()] == [*HOMES]


def test_frame_rates_of_eth_follow_the_step_of_its_frames_and_of_mot_seqinfo(tmp_path: Path) -> None:
    for track in io.read_identified(sample_of("eth").write(tmp_path)):
        np.testing.assert_allclose(np.diff(track.t), 0.4)
    path = sample_of("mot").write(tmp_path)
    (path.parent / "seqinfo.ini").write_text("[Sequence]\nname=made\nframeRate=14\n")
    np.testing.assert_allclose(
        io.read_identified(path).by_id(1).t * 14, io.read_identified(path).by_id(1).frame
    )


def test_mot_ignored_rows_and_classes_are_counted(tmp_path: Path) -> None:
    path = tmp_path / "gt.txt"
    path.write_text("1,1,10,20,30,40,1,1,0.9\n1,2,10,20,30,40,0,1,0.9\n1,3,10,20,30,40,1,3,1\n")
    tracks = io.read_identified(path)
    assert tracks.summary.refused == {"marked to be ignored": 1, "of class Car": 1}
    assert [track.track_id for track in io.read_identified(path, classes=("Pedestrian", "Car"))] == [1, 3]


def test_pixels_without_a_camera_are_scaled_by_the_median_person(tmp_path: Path) -> None:
    path = sample_of("mot").write(tmp_path)
    scaled = io.read_identified(path)
    assert any("NO CAMERA IS KNOWN" in note for note in scaled.summary.notes)
    np.testing.assert_allclose(scaled.by_id(1).position, scaled.by_id(1).pixel * [0.017, -0.017])
    forced = io.read_identified(path, metres_per_pixel=0.5)
    np.testing.assert_allclose(forced.by_id(1).position, forced.by_id(1).pixel * [0.5, -0.5])


def test_point_pairs_make_the_camera(tmp_path: Path) -> None:
    path = sample_of("mot").write(tmp_path)
    pairs = tmp_path / "pairs.txt"
    pairs.write_text("# u v X Y\n0 0 0 0\n100 0 2 0\n100 100 2 -2\n0 100 0 -2 # corner\n")
    tracks = io.read_identified(path, point_pairs=pairs)
    np.testing.assert_allclose(tracks.by_id(1).position, tracks.by_id(1).pixel * [0.02, -0.02], atol=1e-9)
    assert any("reprojection error" in note for note in tracks.summary.notes)


def test_ucy_is_turned_right_handed(tmp_path: Path) -> None:
    path = sample_of("ucy").write(tmp_path)
    tracks = io.read_identified(path)
    assert tracks.camera is not None and not tracks.camera.is_mirrored
    assert any("right-handed" in note for note in tracks.summary.notes)
    # (x, y) = (−50, 30) is (row, column) = (258, 310); the synthetic homography maps that to (7.2, 5.66).
    np.testing.assert_allclose(tracks.by_id(0).position[0], [7.2, -5.66])
    assert all(track.head is None for track in tracks)
    path.write_bytes(sample_of("ucy").content().replace(b" 25 90.0", b" 0 90.0", 1))
    assert io.read_identified(path).summary.refused == {"second control point of a spline in one frame": 1}


OBSTACLES = """\
2 - number of line obstacles
-379.000000 -300.000000 380.000000 -300.000000 1 - left(x,y) right(x,y), type
-359.000000 120.000000 -207.000000 120.000000 0 - left(x,y) right(x,y), type
1 - number of cylinder obstacles
136.000000 -270.000000 (center)
20.000000 2 0 (radius, type, id)
0 1615 (start and end time)
"""


def test_ucy_obstacles_after_the_splines_are_read_past(tmp_path: Path) -> None:
    path = sample_of("ucy").write(tmp_path)
    plain = io.read_identified(path)
    path.write_bytes(sample_of("ucy").content() + OBSTACLES.replace("\n", "\r\n").encode())
    tracks = io.read_identified(path)
    assert "obstacles not read" in tracks.summary.notes
    assert tracks.summary.rows_read == plain.summary.rows_read
    for one, other in zip(plain, tracks, strict=True):
        np.testing.assert_array_equal(one.position, other.position)
    path.write_bytes(sample_of("ucy").content() + b"7 - number of people\n")
    with pytest.raises(InputError) as caught:
        io.read_identified(path)
    assert caught.value.line == sample_of("ucy").content().count(b"\n") + 1


def test_town_centre_boxes_of_the_half_image_are_doubled(tmp_path: Path) -> None:
    path = sample_of("towncentre").write(tmp_path)
    found = io.read_identified(path)
    camera = read_calibration(path.with_name("calibration.ci"))
    forced = {s: io.read_identified(path, camera=camera.resized(1.0 / s)) for s in (1.0, 2.0)}
    assert any("doubled" in note for note in found.summary.notes)
    np.testing.assert_array_equal(found.by_id(1).position, forced[2.0].by_id(1).position)
    assert (
        np.abs(found.by_id(1).position - forced[1.0].by_id(1).position).max() > 0.5
        and found.camera is not None
    )
    np.testing.assert_allclose(
        found.camera.ground_to_image(found.by_id(1).position), found.by_id(1).pixel, atol=1e-6
    )


def test_caviar_feet_shoulders_and_gaze(tmp_path: Path) -> None:
    track = io.read_identified(sample_of("caviar").write(tmp_path), metres_per_pixel=0.01).by_id(0)
    np.testing.assert_allclose(track.pixel[0], [100.0, 139.5])
    # The left shoulder is left of the right one and 2 px higher: the person walks away from the viewer.
    np.testing.assert_allclose(np.rad2deg(track.body), 90.0 - np.rad2deg(np.arctan2(2, 12)), atol=1e-9)
    gaze = np.deg2rad([0.0, 30.0, np.nan, 90.0, 120.0, 150.0])
    np.testing.assert_allclose(track.head, gaze, atol=1e-9)
    mirror = GroundCamera(np.diag([0.01, 0.01, 1.0]))
    mirrored = io.read_identified(tmp_path / sample_of("caviar").name, camera=mirror).by_id(0)
    np.testing.assert_allclose(difference(mirrored.body, -track.body), 0.0, atol=1e-9)


def test_kitti_brings_a_standing_person_to_one_place_from_a_moving_camera(tmp_path: Path) -> None:
    """Labels made from a known place and heading by the inverse chain come back as that place and heading."""
    sample = sample_of("kitti")
    path = sample.write(tmp_path)
    place, heading = np.array([12.0, 5.0, -1.0]), 0.7
    to_camera = np.eye(4)
    for line in (tmp_path / "calib/0001.txt").read_text().splitlines()[1:]:
        values = np.array(line.split()[1:], dtype=float).reshape(3, -1)
        matrix = np.eye(4)
        matrix[:3, : values.shape[1]] = values
        to_camera = to_camera @ matrix
    rows, ego = [], []
    for f in range(FRAMES):
        yaw = 0.5 + 0.1 * f
        # East by 0.1 m a frame at the equator, where Mercator is true to scale.
        ego.append(f"0.0 {np.rad2deg(0.1 * f / 6378137.0)} 0.0 0.0 0.0 {yaw} " + "0 " * 24)
        turn = np.array([[np.cos(yaw), -np.sin(yaw), 0], [np.sin(yaw), np.cos(yaw), 0], [0, 0, 1]])
        in_imu = turn.T @ (place - [0.1 * f, 0.0, 0.0])
        x, y, z, _ = to_camera @ np.append(in_imu, 1.0)
        rotation = yaw - heading - np.pi / 2
        rows.append(f"{f} 4 Pedestrian 0 0 0 1 2 3 4 1.7 0.6 0.8 {x} {y} {z} {rotation}")
    path.write_text("\n".join(rows) + "\n")
    (tmp_path / "oxts/0001.txt").write_text("\n".join(ego) + "\n")
    track = io.read_identified(path).by_id(4)
    np.testing.assert_allclose(track.position, np.tile(place[:2], (FRAMES, 1)), atol=1e-6)
    np.testing.assert_allclose(difference(track.body, heading), 0.0, atol=1e-9)


def test_salsa_angles_are_wrapped_and_steps_numbered(tmp_path: Path) -> None:
    track = io.read_identified(sample_of("salsa").write(tmp_path)).by_id(2)
    np.testing.assert_array_equal(track.frame, np.arange(FRAMES))
    np.testing.assert_allclose(track.t, 3.0 * np.arange(FRAMES) + 0.2)
    np.testing.assert_allclose(track.body[0], -5.0 + 2 * np.pi)
    assert track.label == "ID_002"


def test_a_camera_of_the_caller_wins(tmp_path: Path) -> None:
    path = sample_of("towncentre").write(tmp_path)
    camera = GroundCamera.from_scale(0.25)
    tracks = io.read_identified(path, camera=camera)
    assert tracks.camera is camera
    np.testing.assert_allclose(tracks.by_id(1).position, tracks.by_id(1).pixel * [0.25, -0.25])


NEGATIVE = "some confidences are negative"


def rows_of(confidences: list[float], identity: int = -1) -> Rows:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "det.txt"
        path.write_text(
            "".join(f"{k},{identity},{k},10,20,50,{c!r}\n" for k, c in enumerate(confidences, start=1))
        )
        return rows_of_file(path, None, ReadOptions(metres_per_pixel=0.02))


@settings(max_examples=20)
@given(
    st.lists(st.floats(-50.0, 50.0), min_size=1, max_size=9).filter(lambda found: set(found) - {0.0, -1.0})
)
def test_scores_keep_the_order_and_are_never_negative(confidences: list[float]) -> None:
    rows = rows_of(confidences)
    if min(confidences) < 0.0:
        np.testing.assert_allclose(rows.channels["score"], expit(confidences), rtol=1e-12, atol=1e-16)
        assert any(note.startswith(NEGATIVE) for note in rows.notes)
    else:
        np.testing.assert_array_equal(rows.channels["score"], [c for c in confidences if c != 0.0])
        assert not any(note.startswith(NEGATIVE) for note in rows.notes)


@pytest.mark.parametrize(("confidences", "identity"), [([-1.0, -1.0], -1), ([0.3, -0.7], 4)])
def test_confidences_that_say_nothing_much_or_too_much(confidences: list[float], identity: int) -> None:
    assert "score" not in rows_of(confidences, identity).channels
    np.testing.assert_array_equal(rows_of([-1e9, 0.0, 1e9]).channels["score"], [0.0, 0.5, 1.0])  # log odds
    with pytest.raises(InputError, match="line 2, column confidence"):
        rows_of([1.0, 1e30])


def test_scores_come_with_the_tracks_that_are_associated(tmp_path: Path) -> None:
    path = tmp_path / "det.txt"
    path.write_text("".join(f"{k},-1,{2 * k},10,20,50,{0.5 + k / 100}\n" for k in range(1, 9)))
    (track,) = gt.read(path, metres_per_pixel=0.02)
    np.testing.assert_allclose(track.score, 0.5 + track.frame / 100)
