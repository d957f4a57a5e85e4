"""Real recordings: known counts, and properties of walking people."""

from pathlib import Path

import numpy as np
import pytest

from graphtrack import io
from graphtrack.geometry.angles import difference, direction
from graphtrack.geometry.camera import GroundCamera
from graphtrack.io.formats.caviar import LOBBY_HEIGHT, _Reader, lobby_camera
from graphtrack.io.source import Source
from graphtrack.tracks.track import TrackSet


def speeds(tracks: TrackSet, seconds: float) -> np.ndarray:
    """Speeds (m/s) over a span of about ``seconds``, of everyone."""
    found = []
    for track in tracks:
        k = max(1, round(seconds / float(np.median(np.diff(track.t))))) if len(track) > 1 else 1
        moved = np.linalg.norm(track.position[k:] - track.position[:-k], axis=1)
        found.append(moved / (track.t[k:] - track.t[:-k]))
    return np.concatenate(found)


def heading_errors(tracks: TrackSet, channel: str, seconds: float, slowest: float) -> np.ndarray:
    """Orientation minus direction of motion (radians) where people move faster than ``slowest`` m/s."""
    found = []
    for track in tracks:
        angle = getattr(track, channel)
        k = max(1, round(seconds / float(np.median(np.diff(track.t)))))
        if angle is None or len(track) <= 2 * k:
            continue
        velocity = (track.position[2 * k :] - track.position[: -2 * k]) / (
            track.t[2 * k :] - track.t[: -2 * k]
        )[:, None]
        error = difference(angle[k:-k], direction(velocity))
        found.append(error[(np.linalg.norm(velocity, axis=1) > slowest) & np.isfinite(error)])
    return np.concatenate(found)


@pytest.mark.parametrize(
    ("name", "rows", "used", "people"),
    [
        ("mocap/tracks_30hz.csv.gz", 68066, 68066, 374),
        ("salsa/features.txt", 645 * 18, 645 * 18, 18),
        ("kitti/label_02/0012.txt", 354, 64, 1),
        ("eth/seq_hotel/obsmat.txt", 6544, 6544, 390),
        ("ucy/zara01/annotation.vsp", 1520, 1520, 148),
        ("towncentre/boxes.csv", 71460, 71460, 230),
        ("tud/TUD-Stadtmitte/gt.txt", 1156, 1156, 10),
        ("tud/TUD-Campus/gt.txt", 359, 359, 8),
        ("tud/TUD-Stadtmitte/test.txt", 749, 749, 12),
        ("caviar/xml/mws1gt.xml", 1788, 1788, 9),
        ("caviar/xml/wk2gt.xml", 2914, 2914, 6),
        ("caviar/corridor/fols1gt.xml", 438, 438, 3),
    ],
)
def test_counts(name: str, rows: int, used: int, people: int, data_dir: Path) -> None:
    tracks = io.read_identified(data_dir / name)
    assert tracks.summary.rows_read == rows and tracks.summary.rows_used == used == tracks.n_frames
    assert len(tracks) == people and not any("faster than" in note for note in tracks.summary.notes)


@pytest.mark.parametrize(
    ("name", "slowest", "fastest"),
    [
        ("mocap/tracks_30hz.csv.gz", 0.9, 1.3),
        ("kitti/label_02/0012.txt", 1.0, 1.6),
        ("eth/seq_hotel/obsmat.txt", 1.0, 1.6),
        ("ucy/zara01/annotation.vsp", 1.0, 1.4),
        ("towncentre/boxes.csv", 1.4, 1.5),
        ("tud/TUD-Stadtmitte/gt.txt", 1.0, 1.4),
        ("caviar/xml/mws1gt.xml", 1.0, 1.7),
        ("caviar/xml/fra2gt.xml", 1.0, 1.7),
        ("salsa/features.txt", -0.1, 0.1),  # they stand
    ],
)
def test_people_walk_at_a_walking_pace(name: str, slowest: float, fastest: float, data_dir: Path) -> None:
    seconds = 3.0 if "salsa" in name else 1.0
    assert slowest < np.nanmedian(speeds(io.read_identified(data_dir / name), seconds)) < fastest


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "seconds", "slowest", "degrees"),
    [
        ("kitti/label_02/0012.txt", 0.3, 0.5, 10.0),
        ("mocap/tracks_30hz.csv.gz", 0.3, 0.5, 10.0),
        ("caviar/xml/mws1gt.xml", 0.25, 0.8, 18.0),
        ("caviar/xml/fra2gt.xml", 0.25, 0.8, 18.0),
    ],
)
def test_people_face_where_they_walk(
    name: str, seconds: float, slowest: float, degrees: float, data_dir: Path
) -> None:
    tracks = io.read_identified(data_dir / name)
    error = heading_errors(tracks.select("*_walk_*") if "mocap" in name else tracks, "body", seconds, slowest)
    assert len(error) > 40 and np.rad2deg(np.median(np.abs(error))) < degrees


def test_the_corridor_through_its_point_pairs(data_dir: Path) -> None:
    folder = data_dir / "caviar/corridor"
    pairs = np.loadtxt(folder / "homography_points.txt", delimiter=None)[4:8]
    camera, _ = GroundCamera.from_point_pairs(pairs[:, :2], 0.01 * pairs[:, 2:])
    tracks = io.read_identified(folder / "fols1gt.xml", camera=camera)
    moving = speeds(tracks, 1.0)
    assert 0.7 < np.median(moving[moving > 0.3]) < 1.6
    corners = tracks.camera.image_to_ground([[60.0, 153.0], [367.0, 200.0]])
    np.testing.assert_allclose(corners, [[0.0, 0.0], [3.82, 8.78]], atol=1e-6)


def test_heads_are_seen_above_the_feet_by_the_camera_of_the_lobby(data_dir: Path) -> None:
    camera = lobby_camera()
    observations = _Reader(Source.open(data_dir / "caviar/xml/mws1gt.xml")).observations()
    both = [o for o in observations if np.isfinite([*o.foot, *o.head]).all()]
    foot, head = np.array([o.foot for o in both]), np.array([o.head for o in both])
    # A head at 1.6 m occludes the ground behind it, by the ratio of heights above ground and head.
    predicted = camera.ground_to_image(camera.image_to_ground(foot) * LOBBY_HEIGHT / (LOBBY_HEIGHT - 1.6))
    miss = np.linalg.norm(predicted - head, axis=1)
    assert len(both) > 1400
    assert np.median(miss) < 3.5 < np.median(np.linalg.norm(foot - head, axis=1)) / 5


def test_zara_is_mirrored_and_its_control_points_lie_on_the_published_walks(data_dir: Path) -> None:
    zara = io.read_identified(data_dir / "ucy/zara01/annotation.vsp")
    assert any("right-handed" in note for note in zara.summary.notes)
    # OpenTraj's table of the same walks keeps the mirrored ground: the same x, the opposite y.
    for walk in io.read_identified(data_dir / "ucy/zara01/obsmat.txt"):
        spline = zara.by_id(walk.track_id - 1)
        x, y = (np.interp(walk.frame, spline.frame, axis) for axis in spline.position.T)
        assert np.median(np.hypot(x - walk.position[:, 0], y + walk.position[:, 1])) < 0.25
