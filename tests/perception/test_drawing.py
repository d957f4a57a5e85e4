"""Drawn estimates and drawn people: positions in the image, colours, and files."""

from dataclasses import replace
from itertools import combinations
from pathlib import Path

import cv2
import numpy as np
import pytest
from blob_tracker import SIZE, BlobTracker, blob_image

from graphtrack.errors import InputError
from graphtrack.geometry.angles import difference, direction
from graphtrack.geometry.camera import GroundCamera
from perception.drawing.overlays import LIGHT, Likelihoods, person_colour
from perception.drawing.people import DrawnPerson, draw, draw_people
from perception.images.encoding import check_render, pictures
from perception.pose.classes import PoseClasses
from perception.synthetic import Camera
from perception.trackers.tracker import BoxEstimate

CENTRE = (80.0, 60.0)


GREY = np.full((SIZE[1], SIZE[0], 3), 100, np.uint8)


@pytest.fixture
def estimate() -> BoxEstimate:
    return BlobTracker().start(blob_image(CENTRE), (72.0, 50.0, 16.0, 20.0))


def changed(estimate: BoxEstimate, other: BoxEstimate, pans: bool = False) -> np.ndarray:
    """Rows and columns (n, 2) in which two pictures differ, in pixels of the image before it was enlarged."""
    classes = BlobTracker().pan_classes if pans else None
    first, second = (draw(GREY, 1, item, classes) for item in (estimate, other))
    factor = first.shape[0] // SIZE[1]
    found = np.argwhere((first != second).any(axis=2)[:, : factor * SIZE[0]])
    return np.asarray(found / factor)


def test_particles_are_drawn_where_they_are(estimate: BoxEstimate) -> None:
    particle = np.array([[20.0, 90.0, 10.0, 10.0]])
    alone = replace(estimate, particles=particle, weights=np.ones(1))
    elsewhere = replace(alone, particles=particle + np.array([[100.0, 0.0, 0.0, 0.0]]))
    rows, columns = changed(alone, elsewhere).T
    assert np.abs(rows - 95.0).max() < 2.0
    near = np.minimum(np.abs(columns - 25.0), np.abs(columns - 125.0))
    assert near.max() < 2.0 and columns.min() < 30.0 and columns.max() > 120.0


@pytest.mark.parametrize(("pan_class", "along"), [(0, (0, 1)), (3, (1, 0)), (6, (0, -1)), (9, (-1, 0))])
def test_the_arrow_points_down_to_the_camera_and_right_at_a_quarter(
    estimate: BoxEstimate, pan_class: int, along: tuple[int, int]
) -> None:
    pan = np.full(12, 1e-6)
    pan[pan_class] = 1.0
    turned = replace(estimate, pan=pan / pan.sum())
    opposite = replace(turned, pan=np.roll(turned.pan, 6))
    # Both arrows begin in the middle; pixels on the tested side must belong to this one.
    plain, arrow = draw(GREY, 1, turned), draw(GREY, 1, turned, BlobTracker().pan_classes)
    factor = plain.shape[0] // SIZE[1]
    rows, columns = np.argwhere((plain != arrow).any(axis=2)[:, : factor * SIZE[0]]).T / factor
    away = np.array([columns.mean() - CENTRE[0], rows.mean() - CENTRE[1]])
    assert away @ along > 5.0 and abs(away @ along[::-1]) < 2.0
    assert len(changed(turned, opposite, pans=True))


def test_not_found_is_shown(estimate: BoxEstimate) -> None:
    rows, columns = changed(estimate, replace(estimate, found=False)).T
    assert ((rows < 12.0) & (columns < 60.0)).any()


def test_pictures_of_a_video_have_one_size_whatever_is_drawn(estimate: BoxEstimate) -> None:
    image = blob_image(CENTRE)
    bare = replace(estimate, pan=None, cues={}, found=False, box=(-50.0, -9.0, 900.0, 3.0))
    many = replace(estimate, cues={f"cue {k}": k / 30.0 for k in range(30)})
    shapes = {
        draw(image, k, item, BlobTracker().pan_classes).shape for k, item in enumerate((estimate, bare, many))
    }
    assert len(shapes) == 1


@pytest.mark.parametrize("name", ["film.mp4", "film.avi", "film.webm"])
def test_a_video_has_the_frames_that_were_shown(tmp_path: Path, estimate: BoxEstimate, name: str) -> None:
    with pictures(tmp_path / name, 10.0) as write:
        for k in range(7):
            write(k, draw(blob_image(CENTRE), k, estimate))
    video = cv2.VideoCapture(str(tmp_path / name))
    images = []
    while (read := video.read())[0]:
        images.append(read[1])
    assert len(images) == 7 and video.get(cv2.CAP_PROP_FPS) == pytest.approx(10.0)
    expected = draw(blob_image(CENTRE), 0, estimate)
    assert images[0].shape == expected.shape
    assert np.abs(images[0].astype(float) - expected).mean() < 8.0


@pytest.mark.parametrize(("suffix", "codes"), [(".mp4", ("avc1", "h264")), (".webm", ("VP80",))])
def test_browsers_play_the_codec(tmp_path: Path, suffix: str, codes: tuple[str, ...]) -> None:
    with pictures(tmp_path / f"film{suffix}", 12.5) as write:
        for k in range(4):
            write(k, np.full((75, 101, 3), 60 * k, np.uint8))  # H.264 needs even sizes
    video = cv2.VideoCapture(str(tmp_path / f"film{suffix}"))
    code = int(video.get(cv2.CAP_PROP_FOURCC)).to_bytes(4, "little").decode()
    assert code in codes
    levels = []
    while (read := video.read())[0]:
        levels.append(read[1].mean())
    assert levels == pytest.approx([0, 60, 120, 180], abs=4)


def test_a_folder_has_an_image_for_each_frame_by_its_number(tmp_path: Path, estimate: BoxEstimate) -> None:
    with pictures(tmp_path / "shown", 25.0) as write:
        for k in (3, 12):
            write(k, draw(blob_image(CENTRE), k, estimate))
    assert sorted(path.name for path in (tmp_path / "shown").iterdir()) == ["000003.png", "000012.png"]
    picture = cv2.imread(str(tmp_path / "shown" / "000012.png"))
    np.testing.assert_array_equal(picture, draw(blob_image(CENTRE), 12, estimate))


@pytest.mark.parametrize("name", ["film.mp4", "shown"])
def test_nothing_is_left_of_a_rendering_that_failed(tmp_path: Path, name: str) -> None:
    with pytest.raises(InputError, match="lost"), pictures(tmp_path / name, 25.0) as write:
        write(0, blob_image(CENTRE))
        raise InputError("lost", "found")
    assert not list(tmp_path.iterdir())


def test_a_picture_of_another_size_is_refused_where_opencv_would_leave_it_out(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="frame 1 of 80 × 120"), pictures(tmp_path / "a.mp4", 5.0) as write:
        write(0, blob_image(CENTRE))
        write(1, blob_image(CENTRE)[:, :80])
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", ["film.mp4", "film.avi", "film.webm", "shown"])
def test_a_video_for_which_there_is_no_room_is_an_error(tmp_path: Path, name: str) -> None:
    resource = pytest.importorskip("resource")
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    images = np.random.default_rng(3).integers(0, 256, (20, 96, 128, 3), np.uint8)
    resource.setrlimit(resource.RLIMIT_FSIZE, (10_000, limits[1]))
    try:
        with pytest.raises(InputError, match="cannot be written"), pictures(tmp_path / name, 5.0) as write:
            for k, image in enumerate(images):
                write(k, image)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert not list(tmp_path.iterdir())


def test_places_that_cannot_be_are_refused(tmp_path: Path) -> None:
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "a.txt").write_text("")
    for path in (tmp_path / "film.mov", tmp_path / "no" / "film.mp4", tmp_path / "full"):
        with pytest.raises(InputError):
            check_render(path)


CAMERAS = {
    "street": Camera((0.0, -9.0, 4.0), np.pi / 2, -0.4, 900.0, (640, 480)).ground_camera(),
    "from above": GroundCamera.from_scale(0.01),
    "mirrored": GroundCamera(np.diag([0.01, 0.01, 1.0])),
}
CANVAS = np.full((480, 640, 3), 100, np.uint8)
FOOT, HEAD = np.array([460.0, 330.0]), np.array([180.0, 180.0])
every_camera = pytest.mark.parametrize("camera", CAMERAS.values(), ids=CAMERAS)


def person(camera: GroundCamera, body: int | None, head: int | None, track_id: int = 3) -> DrawnPerson:
    """A person who certainly faces one direction, or any; the box is far from the feet, for the test."""
    shares = [
        Likelihoods(np.full(n, 1.0 / n) if k is None else np.eye(n)[k], PoseClasses.circle(n))
        for k, n in ((body, 8), (head, 12))
    ]
    box, head_box = np.array([10.0, 400.0, 30.0, 60.0]), np.array([*(HEAD - 3.0), 6.0, 6.0])
    return DrawnPerson(track_id, box, camera.image_to_ground(FOOT), *shares, head_box)


def near(picture: np.ndarray, middle: np.ndarray, colour: tuple[int, int, int]) -> np.ndarray:
    """Pixels (n, 2), relative to a middle, that are drawn in a colour within 130 pixels of it."""
    left, top = (middle - 130.0).astype(int)
    part = picture[top : top + 261, left : left + 261].astype(float) - 100.0
    toward = np.array(colour) - 100.0
    found = np.argwhere(part @ toward > 0.4 * toward @ toward)[:, ::-1] - 130.0
    return found[np.linalg.norm(found, axis=1) > 15.0]


@every_camera
@pytest.mark.parametrize("k", [0, 1, 3, 6])
def test_a_body_points_along_the_ground_at_the_feet(camera: GroundCamera, k: int) -> None:
    found = near(draw_people(CANVAS, "", [person(camera, k, None)], camera), FOOT, person_colour(3))
    away = camera.image_to_ground(FOOT + found + 0.5) - camera.image_to_ground(FOOT)
    assert np.abs(difference(direction(away), np.pi / 4 * k)).max() < np.deg2rad(22.5 + 8.0)
    assert 0.75 < np.linalg.norm(away, axis=1).max() < 0.95


@every_camera
@pytest.mark.parametrize("k", [0, 2, 7])
def test_a_head_points_as_it_would_on_the_ground_below(camera: GroundCamera, k: int) -> None:
    found = near(draw_people(CANVAS, "", [person(camera, None, k)], camera), HEAD, LIGHT)
    away = camera.image_to_ground(FOOT + found + 0.5) - camera.image_to_ground(FOOT)
    assert np.abs(difference(direction(away), np.pi / 6 * k)).max() < np.deg2rad(15.0 + 12.0)
    assert 0.5 < np.linalg.norm(away, axis=1).max() < 0.7


def test_boxes_are_where_they_are_in_colours_that_hold() -> None:
    camera = CAMERAS["from above"]
    alone = draw_people(CANVAS, "", [person(camera, 0, 0, 7)], camera)
    together = draw_people(CANVAS, "", [person(camera, 0, 0, 1), person(camera, 0, 0, 7)], camera)
    for picture in (alone, together):
        for row, column in ((430, 10), (460, 15), (430, 40)):
            np.testing.assert_allclose(picture[row, column], person_colour(7), atol=20)
    colours = np.array([person_colour(k) for k in range(12)], float)
    assert min(np.abs(a - b).max() for a, b in combinations(colours, 2)) > 30.0


def test_small_images_are_drawn_larger_and_others_as_they_are() -> None:
    camera = CAMERAS["from above"]
    assert draw_people(CANVAS[:120, :160], "", [person(camera, 0, 0)], camera).shape == (480, 640, 3)
    assert draw_people(CANVAS, "", [], camera).shape == CANVAS.shape
    assert (CANVAS == 100).all()


def test_what_is_out_of_sight_is_no_error() -> None:
    street = CAMERAS["street"]
    behind = replace(
        person(street, 0, 0),
        box=np.array([-900.0, -1e5, 30.0, 60.0]),
        head_box=np.array([0.0, -1e6, 9.0, 9.0]),
        position=np.array([0.0, -9.4]),
    )
    assert draw_people(CANVAS, "", [behind], street).shape == CANVAS.shape
