"""A camera from points on the ground: the calibration of their file, and the page to click them on."""

import json
import re
import shutil
import subprocess
from pathlib import Path

import cv2
import numpy as np
import pytest
from command import ran, run

from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray
from graphtrack.geometry.camera import GroundCamera, fit_homography
from graphtrack.io.cameras import camera_of_point_pairs, read_calibration
from perception.ground.fitting import PinholeView
from perception.ground.point_pairs import view_of_point_pairs

SIZE = (1280, 720)
VIEW = PinholeView(900.0, np.deg2rad(25.0), np.deg2rad(1.5), 4.2)
GROUND = np.array([[-3.0, 6.0], [3.0, 6.0], [4.0, 14.0], [-4.0, 14.0], [0.0, 9.0], [2.0, 11.0]])
AWAY = np.array([120.0, -40.0])
"""Origin of the coordinates, far from the camera."""


def pairs(rng: np.random.Generator | None = None, n: int = 6) -> FloatArray:
    camera = VIEW.camera(SIZE)
    pixel = np.array([camera.ground_to_image(point) for point in GROUND[:n]])
    if rng is not None:
        pixel += rng.normal(0.0, 0.3, pixel.shape)
    return np.column_stack([pixel, GROUND[:n] + AWAY])


def saved(path: Path, numbers: FloatArray) -> Path:
    np.savetxt(path, numbers, header="u v X Y")
    return path


@pytest.mark.parametrize("n", [4, 6])
def test_exact_points_give_the_camera_back(n: int, tmp_path: Path) -> None:
    found = view_of_point_pairs(saved(tmp_path / "pairs.txt", pairs(n=n)), SIZE)
    assert found.intrinsics[0, 0] == pytest.approx(900.0, rel=2e-3)
    assert found.height == pytest.approx(4.2, rel=2e-3) and found.error < 0.05
    found.write(tmp_path / "camera.ci")
    camera = read_calibration(tmp_path / "camera.ci")
    for u, v, x, y in pairs():
        np.testing.assert_allclose(camera.image_to_ground([u, v]), [x, y], atol=0.02)
    assert f"{found.height:.2f} m above" in found.described()[0]


def test_points_with_errors_of_pixels_agree_within_their_noise(tmp_path: Path) -> None:
    numbers = pairs(np.random.default_rng(1))
    found = view_of_point_pairs(saved(tmp_path / "pairs.txt", numbers), SIZE)
    assert 0.0 < found.error < 1.0 and found.height == pytest.approx(4.2, rel=0.1)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda given: given[:3], "found 3"),
        (lambda given: given * [1.0, 1.0, 1.0, -1.0], "left-handed"),
        (lambda given: np.add(given, [2000.0, 0.0, 0.0, 0.0]), "pixels of the image, 1280×720"),
    ],
)
def test_points_of_no_camera_are_one_error(change, message: str, tmp_path: Path) -> None:
    path = saved(tmp_path / "pairs.txt", change(pairs()))
    with pytest.raises(InputError, match=message):
        view_of_point_pairs(path, SIZE)


@pytest.fixture
def video(cwd: Path) -> Path:
    folder = cwd / "a `frame` ${1}"
    folder.mkdir()
    image = np.full((*SIZE[::-1], 3), 90, np.uint8)
    for k in range(2):
        cv2.imwrite(str(folder / f"{k}.png"), image + 40 * k)
    return folder


def test_the_command_calibrates_by_points_and_writes_the_page(video: Path) -> None:
    saved(Path("pairs.txt"), pairs())
    done = ran("calibrate", str(video), "--point-pairs", "pairs.txt", "-o", "camera.ci", program="perception")
    assert "6 point pairs" in done.stderr and read_calibration("camera.ci").intrinsics is not None
    ran("calibrate", str(video), "-o", "pairs.html", "--frame", "1", program="perception")
    page = Path("pairs.html").read_text(encoding="utf-8")
    assert "data:image/jpeg;base64," in page and "http" not in page.replace("http://www.w3.org/2000/svg", "")
    assert 'viewBox="0 0 1280 720"' in page and "frame 1" in page


@pytest.mark.parametrize(
    "options",
    [
        ("-o", "camera.ci"),
        ("-o", "page.html", "--point-pairs", "pairs.txt"),
        ("-o", "camera.ci", "--point-pairs", "pairs.txt", "--frame", "1"),
        ("-o", "page.html", "--frame", "9"),
    ],
)
def test_options_that_exclude_each_other_write_nothing(options: tuple[str, ...], video: Path) -> None:
    saved(Path("pairs.txt"), pairs())
    done = run("calibrate", str(video), *options, program="perception")
    assert done.returncode == 2 and not Path(options[1]).exists()


def test_the_page_fits_as_python_does(video: Path) -> None:
    """Its script is one that runs, whatever the name of the video is, and its errors are those of the DLT."""
    node = shutil.which("node")
    if node is None:
        pytest.skip("needs node")
    ran("calibrate", str(video), "-o", "pairs.html", program="perception")
    script = re.search(r"<script>(.*)</script>", Path("pairs.html").read_text(encoding="utf-8"), re.DOTALL)
    assert script is not None
    (fit,) = re.findall(r"// <fit>(.*)// </fit>", script[1], re.DOTALL)
    numbers = pairs(np.random.default_rng(2))
    code = f"{fit}\nconsole.log(JSON.stringify([errorsOf({numbers.tolist()}), errorsOf([[1, 2, 3, 4]])]));"
    found = subprocess.run([node], input=code, capture_output=True, text=True, check=True)
    errors, none = json.loads(found.stdout)
    expected = fit_homography(numbers[:, :2], numbers[:, 2:])
    assert none is None and max(errors) == pytest.approx(expected.max_error, rel=0.5)
    Path("page.js").write_text(script[1], encoding="utf-8")
    assert subprocess.run([node, "--check", "page.js"], check=False).returncode == 0


def test_the_one_pair_that_the_others_contradict_is_named(tmp_path: Path) -> None:
    numbers = [[0.01, 0.001, -4.0], [0.0005, -0.02, 9.0], [1e-5, -0.0012, 1.0]]
    camera = GroundCamera.from_homography(numbers, visible=np.array([[320.0, 400.0]]))
    pixel = np.array([[u, v] for u in (100.0, 320.0, 540.0) for v in (300.0, 400.0, 500.0)])
    ground = camera.image_to_ground(pixel) + np.random.default_rng(0).normal(0.0, 0.02, (9, 2))
    place = tmp_path / "pairs.txt"

    def notes() -> str:
        np.savetxt(place, np.hstack([pixel, ground]), fmt="%.4f")
        return " ".join(camera_of_point_pairs(place)[1])

    assert "from where the others place it" not in notes()
    ground[4] += 3.0
    assert f"the pair 320 400 {ground[4, 0]:g}" in notes() and "from where the others place it" in notes()
