"""A room under a fisheye camera: calibration, ground positions, and a robot in place of the person."""

from pathlib import Path

import cv2
import numpy as np
import pytest
from command import Done, ran, run

from graphtrack import io
from graphtrack.errors import InputError
from graphtrack.geometry.camera import GroundCamera
from graphtrack.io.cameras import read_calibration
from perception.detection.boxes import read_boxes
from perception.following.ground import BODY_MIDDLE, BoxCamera
from perception.following.run import box_cameras
from perception.synthetic.ceiling import ALL_KINDS, ceiling_sequence

pytestmark = pytest.mark.slow
"""A room is rendered for these; `test_ceiling` looks at one every time."""

CAMERA = ceiling_sequence(ALL_KINDS["robot moving"], np.random.default_rng(0), frames=30).scene.camera
GROUND = CAMERA.ground_camera()


@pytest.fixture(scope="module")
def rooms(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    made = {}
    for target in ("person", "robot"):
        made[target] = tmp_path_factory.mktemp("rooms") / target
        ran("simulate", "ceiling", "-o", made[target], "--target", target, "--frames", 70, "--seed", 3)
    return made


def follow(room: Path, output: Path, *arguments: object) -> Done:
    options = ["--tracker", "sigma-pi", "--calibration", room / "camera.ci", "-o", output]
    return run("follow", room / "video.mp4", *options, *arguments)


def away(boxes: BoxCamera, room: Path) -> np.ndarray:
    """Metres between the ground positions of a room's exact boxes and the truth."""
    (truth,) = io.read_identified(room / "truth.csv")
    at = dict(zip(truth.frame.tolist(), truth.position, strict=True))
    found = [(boxes.position(item.box), at[item.frame]) for item in read_boxes(room / "boxes.txt")]
    return np.array([np.linalg.norm(place - true) for place, true in found])


def test_a_room_comes_with_the_calibration_that_it_was_rendered_with(rooms: dict[str, Path]) -> None:
    camera = read_calibration(rooms["person"] / "camera.ci")
    assert camera.lens == "fisheye" and camera.height == pytest.approx(2.9)
    places = np.random.default_rng(0).uniform(-3.0, 3.0, (200, 2))
    rays = CAMERA.project(np.column_stack([places, np.zeros(200)]))
    np.testing.assert_allclose(camera.ground_to_image(places), rays, atol=1e-6)
    np.testing.assert_allclose(camera.image_to_ground(rays), places, atol=1e-5)


def test_the_middle_of_a_box_from_above_is_a_better_place_than_its_lower_edge(rooms: dict[str, Path]) -> None:
    by_middle = away(BoxCamera(GROUND, middle_at=BODY_MIDDLE), rooms["person"])
    by_foot = away(BoxCamera(GROUND), rooms["person"])
    assert by_middle.mean() < 0.2 and by_middle.max() < 0.5
    assert by_foot.mean() > 3.0 * by_middle.mean()
    assert away(BoxCamera(GROUND, middle_at=0.5), rooms["robot"]).mean() < 0.2


def test_what_the_middle_of_a_box_needs() -> None:
    with pytest.raises(InputError, match="a calibration"):
        BoxCamera(GroundCamera.from_scale(0.01), middle_at=1.0)
    with pytest.raises(InputError, match="below the camera"):
        BoxCamera(GROUND, middle_at=2.8)
    with pytest.raises(InputError, match="one of them"):
        box_cameras(GROUND, of_heads=False, foot_at=1.0, middle_at=1.0)
    with pytest.raises(InputError, match="--calibration"):
        box_cameras(None, of_heads=False, middle_at=1.0)
    first = (0.0, 0.0, 10.0, 20.0)
    assert box_cameras(GROUND, of_heads=False)(first).middle_at == BODY_MIDDLE
    assert box_cameras(GROUND, of_heads=False, foot_at=1.0)(first).middle_at is None


@pytest.mark.slow
def test_sigma_pi_gives_places_near_the_truth(rooms: dict[str, Path], tmp_path: Path) -> None:
    # A robot is found later: in the door it is hardly larger than the least window.
    for target, options, least in (("person", (), 25), ("robot", ("--middle-at", 0.5), 10)):
        done = follow(rooms[target], tmp_path / "o.csv", *options)
        assert done.returncode == 0 and "no camera" not in done.stderr, done.stderr
        (truth,), (track,) = (
            io.read_identified(rooms[target] / "truth.csv"),
            io.read_identified(tmp_path / "o.csv"),
        )
        at = dict(zip(truth.frame.tolist(), truth.position, strict=True))
        seen = [k for k, p in enumerate(track.position) if np.isfinite(p).all() and track.frame[k] in at]
        errors = [np.linalg.norm(track.position[k] - at[int(track.frame[k])]) for k in seen]
        assert len(seen) > least and np.median(errors) < 0.25, target


def test_a_background_is_read_before_the_work(rooms: dict[str, Path], tmp_path: Path) -> None:
    output, good, bad = tmp_path / "o.csv", tmp_path / "sofa.png", tmp_path / "bad.png"
    cv2.imwrite(str(good), np.random.default_rng(0).integers(0, 255, (60, 80, 3)).astype(np.uint8))
    bad.write_bytes(b"no image")
    (tmp_path / "empty").mkdir()
    for given, message in (
        (["--background", bad], "no image that can be decoded"),
        (["--background", good, "--background", tmp_path / "empty"], "a folder without images"),
        (["--background", tmp_path / "none"], "does not exist"),
        (["--background", good, "--tracker", "color", "--init", "1,1,9,9"], "sigma-pi, or none"),
    ):
        done = follow(rooms["robot"], output, *given)
        assert done.returncode == 2 and message in done.stderr, done.stderr
        assert not output.exists()
