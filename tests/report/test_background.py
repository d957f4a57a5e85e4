"""A photo or floor plan under the paths, in figures and in the page; figures as files."""

import base64
import io

import numpy as np
import pytest
from command import run
from made_up import observed, walker
from PIL import Image

import graphtrack as gt
from graphtrack.errors import InputError
from graphtrack.geometry.camera import GroundCamera
from graphtrack.report.background import Backdrop
from graphtrack.report.html import render_report
from graphtrack.report.page import tracking_report, write_report
from graphtrack.report.plots.scene import plot_tracks
from graphtrack.tracks.track import TrackSet

COMMAND = {"program": "graphtrack"}
SQUARE = np.array([[-1.0, -1.0], [1.0, 1.0]])


@pytest.fixture
def marked(tmp_path):
    """Return the path of a grey image of 200 × 100 pixels with a red mark at (u, v) = (150, 20)."""
    image = np.full((100, 200, 3), 128, np.uint8)
    image[17:24, 147:154] = (255, 0, 0)
    Image.fromarray(image).save(tmp_path / "plan.png")
    return tmp_path / "plan.png"


def red_place(ground):
    """Return the mean ground position of the red pixels."""
    red = (ground.pixels[..., 0] > 200) & (ground.pixels[..., 1] < 90) & (ground.pixels[..., 3] > 0)
    rows, columns = np.nonzero(red)
    left, right, bottom, top = ground.extent
    h, w = red.shape
    return left + (columns.mean() + 0.5) / w * (right - left), top - (rows.mean() + 0.5) / h * (top - bottom)


def test_a_plan_lies_where_its_scale_and_corner_say(marked):
    around = [np.array([[0.0, 0.0], [2.0, 1.0]])]
    ground = Backdrop.of_plan(marked, 0.01, (0.0, 0.0)).on_ground(around)
    assert red_place(ground) == pytest.approx((1.505, 0.795), abs=0.02)
    # Pixels that are read with the same scale lie at the same place.
    ground = Backdrop.of_plan(marked, 0.01).on_ground([p * [1.0, -1.0] for p in around])
    assert red_place(ground) == pytest.approx((1.505, -0.205), abs=0.02)


@pytest.mark.parametrize("tilt", [0.0, 0.002])
def test_a_photo_lies_where_its_camera_sees_the_ground(marked, tilt):
    camera = GroundCamera(np.array([[0.02, 0.003, -1.0], [-0.002, -0.03, 3.0], [0.0, tilt, 1.0]]))
    mark = camera.image_to_ground(np.array([150.0, 20.0]))
    corners = camera.image_to_ground(np.array([[0.0, 0.0], [199.0, 0.0], [199.0, 99.0], [0.0, 99.0]]))
    ground = Backdrop.read(marked, camera).on_ground([corners])
    assert red_place(ground) == pytest.approx(tuple(mark), abs=0.06)
    # Outside of the image there is nothing.
    assert (ground.pixels[..., 3] == 0).any() and (ground.pixels[..., 3] == 255).any()


@pytest.mark.slow
def test_the_page_and_the_picture_have_it(marked):
    track = walker(1, n=20, position=np.linspace([0.2, 0.2], [1.8, 0.8], 20))
    background = Backdrop.of_plan(marked, 0.01, (0.0, 0.0))
    report = tracking_report(TrackSet((track,)), background=background)
    kind, encoded = report.replay["background"]["image"].split(",")
    assert kind == "data:image/webp;base64"
    assert Image.open(io.BytesIO(base64.b64decode(encoded))).mode == "RGBA"
    page = render_report(report)
    assert 'data-layer="background"' in page and 'class="photo"' in page
    assert 'data-layer="background"' not in render_report(tracking_report(TrackSet((track,))))
    (axes,) = plot_tracks(TrackSet((track,)), background=background, title="A hall").axes
    (image,) = axes.get_images()
    plain = plot_tracks(TrackSet((track,))).axes[0]
    assert axes.get_xlim() == plain.get_xlim() and image.get_zorder() < 1
    assert axes.get_title(loc="left") == "A hall"


def test_what_cannot_be_a_background_is_refused(marked, tmp_path):
    plan = Backdrop.of_plan(marked, 0.01, (0.0, 0.0))
    for nowhere in ([SQUARE + 50.0], [np.full((3, 2), np.nan)], []):
        with pytest.raises(InputError, match="none of the paths"):
            plan.on_ground(nowhere)
    (tmp_path / "text.png").write_text("no image")
    for path, words in ((tmp_path / "text.png", "can be read"), (tmp_path / "none.png", "no such file")):
        with pytest.raises(InputError, match=words):
            Backdrop.of_plan(path, 0.01)


@pytest.mark.slow
def test_the_command_takes_a_plan_and_writes_figures(marked, tmp_path):
    track = walker(1, n=20, position=np.linspace([0.2, 0.2], [1.8, 0.8], 20), label="Anna $5$")
    gt.write(track, tmp_path / "one.csv")
    given = ["report", tmp_path / "one.csv", "-o", tmp_path / "r.html", "--background", marked]
    scale = ["--metres-per-pixel", "0.01"]
    done = run(*given, *scale, "--background-corner=0,0", "--figures", tmp_path / "figures", **COMMAND)
    assert done.returncode == 0 and "not used" not in done.stdout + done.stderr
    names = {path.name for path in (tmp_path / "figures").iterdir()}
    assert {"paths-from-above.svg", "paths-from-above.pdf", "person-anna-5.svg", "person-anna-5.pdf"} <= names
    (tmp_path / "r.html").unlink()
    for wrong, words in (
        ((), "without a camera or scale"),
        ((*scale, "--background-corner=left"), "x and y in metres"),
        ((*scale, "--background-corner=90,90"), "none of the paths"),
    ):
        done = run(*given, *wrong, **COMMAND)
        assert done.returncode == 2 and words in done.stderr and not (tmp_path / "r.html").exists()
    done = run(*given[:-2], "--background-corner=0,0", **COMMAND)
    assert done.returncode == 2 and "--background" in done.stderr


@pytest.mark.slow
def test_figures_have_text_as_text_and_are_the_same_each_time(tmp_path):
    track = walker(1, n=30)
    for name in ("a", "b"):
        write_report(tmp_path / "r.html", track, observed(track), figures=tmp_path / name)
    files = sorted(path.name for path in (tmp_path / "a").iterdir())
    assert files == sorted(path.name for path in (tmp_path / "b").iterdir())
    svg = (tmp_path / "a" / "paths-from-above.svg").read_text()
    assert ">x (m)</text>" in svg
    for name in files:
        assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes()
