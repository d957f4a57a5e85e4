"""`perception follow` with a tracker of red blobs: its messages, and its effect in the graph."""

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from blob_tracker import BLOB, SIZE, BlobTracker, blob_image
from command import Done, run

import graphtrack
from graphtrack.geometry.angles import difference
from graphtrack.geometry.camera import GroundCamera
from graphtrack.io.cameras import PERSON_HEIGHT
from perception.following.ground import BoxCamera
from perception.pose.classes import PoseClasses
from perception.synthetic import Camera
from perception.trackers.tracker import BoxEstimate

INIT = f"32,50,{BLOB[0]},{BLOB[1]}"
HIDDEN = range(20, 26)
COLUMNS = ["track_id", "frame", "t", "left", "top", "width", "height", "confidence"]
COLUMNS += ["u", "v", "x", "y", "pos_std"]
CAMERA = Camera((0.0, -6.0, 2.5), np.pi / 2, -0.3, 200.0, SIZE).ground_camera()
CEILING = Camera((0.0, 0.0, 2.9), np.pi / 2, -np.pi / 2, 118.0, (320, 240), "fisheye").ground_camera()


def centre(k: int) -> tuple[float, float]:
    return 40.0 + 2.0 * k, 60.0 + 0.5 * k


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Images numbered from 10; the blob is hidden in some, and one cannot be decoded."""
    path = tmp_path / "images"
    path.mkdir()
    for k in range(40):
        image = blob_image(None if k in HIDDEN else centre(k))
        assert cv2.imwrite(str(path / f"{k + 10:03d}.png"), image)
    (path / "015.png").write_bytes(b"no image")
    return path


@pytest.fixture(autouse=True)
def blobs(monkeypatch: pytest.MonkeyPatch) -> list[BlobTracker]:
    """Replace every tracker by the tracker of blobs; returns the trackers made."""
    made: list[BlobTracker] = []

    def make(
        name: str, particles: int | None = None, seed: int = 0, parameters: object = None, **options: object
    ) -> BlobTracker:
        made.append(BlobTracker(particles=particles or 30, seed=seed))
        return made[-1]

    monkeypatch.setattr("perception.trackers.registry.make_tracker", make)
    return made


def follow(folder: Path, *arguments: object) -> Done:
    given = [] if "--init" in arguments else ["--init", INIT]
    given += ["--no-check", "-o", folder.parent / "boxes.csv"]
    return run("follow", folder, "--tracker", "color", *given, *arguments)


def table(folder: Path) -> dict[str, np.ndarray]:
    lines = (folder.parent / "boxes.csv").read_text().splitlines()
    rows = [line.rpartition(",")[0].split(",") for line in lines[1:]]
    cells = [[float(cell) if cell else np.nan for cell in row] for row in rows]
    return dict(zip(lines[0].split(",")[:-1], np.array(cells).T, strict=True))


def test_the_table_has_boxes_foot_points_and_heads(folder: Path) -> None:
    done = follow(folder)
    assert done.returncode == 0, done.stderr
    columns = table(folder)
    assert list(columns) == [*COLUMNS, *(f"head_p{k}" for k in range(12))]
    frame = columns["frame"].astype(int)
    assert frame.tolist() == [k + 10 for k in range(40) if k != 5]
    np.testing.assert_allclose(columns["t"], frame / 25.0)
    seen = np.array([k - 10 not in HIDDEN for k in frame])
    true = np.array([centre(k - 10) for k in frame])
    middle = np.column_stack([columns["left"] + columns["width"] / 2, columns["top"] + columns["height"] / 2])
    assert np.abs(middle - true)[seen].max() <= 1.0
    np.testing.assert_allclose(columns["u"][seen], middle[seen, 0])
    np.testing.assert_allclose(columns["v"][seen], (columns["top"] + columns["height"])[seen])
    # Without a camera: the box is as high as a person, and y goes up.
    scale = PERSON_HEIGHT / BLOB[1]
    np.testing.assert_allclose(columns["x"][seen], scale * columns["u"][seen])
    np.testing.assert_allclose(columns["y"][seen], -scale * columns["v"][seen])
    # The cloud's 2 pixels, and a twentieth of the box's width as the floor.
    expected = scale * np.hypot(2.0, 0.05 * BLOB[0])
    np.testing.assert_allclose(np.median(columns["pos_std"][seen]), expected, rtol=0.1)
    for name in ("u", "v", "x", "y", "pos_std", "head_p0"):
        assert np.isnan(columns[name][~seen]).all() and np.isfinite(columns[name][seen]).all()
    assert np.isfinite(columns["left"]).all()
    assert "no camera" in done.stderr and "not found in 6 of 39" in done.stderr
    assert "015.png" in done.stderr


def test_the_tilt_is_written_in_degrees_where_the_target_is_found(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    step = BlobTracker.step

    def nodding(self: BlobTracker, image: np.ndarray, proposal: object = None) -> BoxEstimate:
        return replace(step(self, image, None), tilt=0.5)

    monkeypatch.setattr(BlobTracker, "step", nodding)
    follow(folder)
    tilt, seen = table(folder)["head_tilt_deg"], np.isfinite(table(folder)["x"])
    np.testing.assert_allclose(tilt[seen][1:], np.rad2deg(0.5))
    assert np.isnan(tilt[~seen]).all()
    assert graphtrack.read(folder.parent / "boxes.csv").summary.notes == ()


def test_graphtrack_takes_the_table_as_it_is(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    follow(folder)
    tracks = graphtrack.read(folder.parent / "boxes.csv")
    assert tracks.summary.notes == () and tracks.summary.rows_refused == 0
    smoothed = graphtrack.smooth(tracks, "joint").tracks[0]
    scale = PERSON_HEIGHT / BLOB[1]
    frame = tracks.tracks[0].frame - 10
    true = np.array([centre(k) for k in frame]) + np.array([0.0, BLOB[1] / 2.0])
    pixel = smoothed.position / [scale, -scale]
    # The graph bridges the frames in which nothing was found.
    hidden = np.isin(frame, list(HIDDEN))
    assert np.linalg.norm(pixel - true, axis=1)[hidden].max() < 1.5
    # The image's right is +x where y goes up: the tracker's pan is +π/2 in the image.
    assert smoothed.head is not None
    assert np.abs(difference(smoothed.head, 0.0)).max() < 0.3


def test_with_a_camera_feet_are_where_the_camera_says(folder: Path, tmp_path: Path) -> None:
    file = tmp_path / "h.txt"
    np.savetxt(file, CAMERA.homography)
    done = follow(folder, "--homography", file, "--foot-at", 2.0)
    assert done.returncode == 0 and "no camera" not in done.stderr
    columns = table(folder)
    seen = np.isfinite(columns["x"])
    np.testing.assert_allclose(columns["v"][seen], (columns["top"] + 2.0 * columns["height"])[seen])
    pixel = np.column_stack([columns["u"], columns["v"]])[seen]
    expected = GroundCamera.from_homography(CAMERA.homography).image_to_ground(pixel)
    np.testing.assert_allclose(np.column_stack([columns["x"], columns["y"]])[seen], expected)


def test_feet_beyond_the_horizon_are_no_observation(folder: Path, tmp_path: Path) -> None:
    file = tmp_path / "h.txt"
    np.savetxt(file, CAMERA.homography)
    done = follow(folder, "--homography", file, "--foot-at", -3.0)
    assert done.returncode == 0 and "horizon" in done.stderr
    columns = table(folder)
    assert 0 < np.isnan(columns["x"]).sum() - len(HIDDEN) < 39


def test_guided_the_tracker_hears_of_the_graph_as_long_as_nothing_is_seen(
    folder: Path, blobs: list[BlobTracker]
) -> None:
    assert follow(folder, "--guided").returncode == 0
    told = blobs[0].proposals
    assert told[0] is None and None not in told[1:]
    numbers = [k for k in range(40) if k != 5]
    away = [np.linalg.norm(p.centre - centre(k)) for k, p in zip(numbers[10:], told[10:], strict=True)]
    assert max(away) < 2.5
    size = {k: np.trace(p.covariance) for k, p in zip(numbers[1:], told[1:], strict=True)}
    growing = [size[k] for k in range(20, 27)]
    assert np.all(np.diff(growing) > 0.0) and size[39] < size[26]


def test_a_start_that_cannot_be_is_one_error(folder: Path) -> None:
    for init, message in (
        ("1,2,3", "LEFT,TOP,WIDTH,HEIGHT"),
        ("a,b,c,d", "LEFT,TOP,WIDTH,HEIGHT"),
        ("10,10,0,5", "above 0"),
        ("10,10,nan,5", "LEFT,TOP,WIDTH,HEIGHT"),
        ("900,10,20,20", "no target in the first frame"),
        ("-100,10,20,20", "no target in the first frame"),
        ("-1e6,-1e6,2e6,2.0001e6", "at most 3 times as large as the image of 160 × 120"),
    ):
        done = follow(folder, "--init", init)
        assert done.returncode == 2 and message in done.stderr and done.stderr.count("error:") == 1
        assert not (folder.parent / "boxes.csv").exists()


def broken(folder: Path, case: str) -> None:
    if case == "black":
        for path in folder.iterdir():
            cv2.imwrite(str(path), np.zeros((SIZE[1], SIZE[0], 3), np.uint8))
    elif case == "sizes":
        cv2.imwrite(str(folder / "030.png"), blob_image(centre(20), (200, 120)))
    elif case == "nothing":
        for path in folder.iterdir():
            cv2.imwrite(str(path), blob_image(None))
    elif case == "undecodable":
        for path in folder.iterdir():
            path.write_bytes(b"no image")


@pytest.mark.parametrize(
    ("case", "message"),
    [
        ("black", "a uniform colour"),
        ("sizes", "frame 30 of 200 × 120"),
        ("nothing", "no target in any of 40 frames"),
        ("undecodable", "no frame that can be decoded"),
    ],
)
def test_frames_that_cannot_be_followed_are_one_error(folder: Path, case: str, message: str) -> None:
    broken(folder, case)
    done = follow(folder, "--render", folder.parent / "shown.mp4")
    assert done.returncode == 2 and message in done.stderr and done.stderr.count("error:") == 1
    assert sorted(path.name for path in folder.parent.iterdir()) == ["images"]


def test_wrong_options_are_told_before_the_work(folder: Path, blobs: list[BlobTracker]) -> None:
    for arguments in (
        ("-o", "boxes.parquet"),
        ("-o", "no/such/folder/boxes.csv"),
        ("--render", "film.mov"),
        ("--render", "no/such/folder/film.mp4"),
        ("--foot-at", "99"),
        ("--middle-at", "1"),
        ("--background", folder),
    ):
        done = follow(folder, *arguments)
        assert done.returncode == 2 and done.stderr.count("error:") == 1, arguments
        assert not any(blob.proposals for blob in blobs)


@pytest.mark.slow
def test_without_a_box_only_some_trackers_begin(folder: Path) -> None:
    for name, message in (("color", "the first frame"), ("mixed-state", "no person in the first 2 seconds")):
        done = run("follow", folder, "--tracker", name, "-o", folder.parent / "boxes.csv")
        assert done.returncode == 2 and message in done.stderr and "--init" in done.stderr


# -- boxes on the ground -----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "boxes", [BoxCamera(CAMERA, 1.0, 1e-6), BoxCamera(CEILING, 1.0, 1e-6, middle_at=1.0)]
)
def test_the_clouds_spread_is_that_of_the_places_of_its_particles(boxes: BoxCamera) -> None:
    rng = np.random.default_rng(0)
    box = np.array([70.0, 80.0, 9.0, 20.0])
    particles = box + rng.normal(0.0, 0.3, (4000, 4))
    weights = rng.dirichlet(np.ones(4000))
    places = boxes.position(particles)
    away = places - weights @ places
    expected = np.sqrt((weights @ (away**2)).mean())
    assert boxes.position_std(box, particles, weights) == pytest.approx(expected, rel=0.02)
    # And back: the middle of the box, and the covariance in pixels.
    place = boxes.position(box)
    np.testing.assert_allclose(boxes.box_centre(place, 20.0), [74.5, 90.0], atol=1e-3)
    covariance = (weights[:, None] * away).T @ away
    feet = particles[:, :2] + particles[:, 2:] / 2.0 if boxes.middle_at else boxes.foot(particles)
    away = feet - weights @ feet
    found = boxes.pixel_covariance(place, covariance)
    np.testing.assert_allclose(found, (weights[:, None] * away).T @ away, rtol=0.05, atol=0.01)


def test_pans_of_half_the_circle_are_unlikely_in_the_other_half() -> None:
    classes = PoseClasses.half_circle()
    boxes = BoxCamera(GroundCamera.from_scale(0.01))
    pan = np.exp(-0.5 * ((classes.pan - np.pi / 4) / 0.4) ** 2)
    world = boxes.head_likelihood(pan[None], classes, np.zeros((1, 2)))[0]
    # From above, an image angle a is the world's a − π/2: heads to the camera look down the image.
    angles = np.deg2rad(30.0 * np.arange(12))
    front = np.abs(difference(angles, -np.pi / 2)) < np.pi / 2 + 0.1
    assert world[~front].max() < 0.01 * world.max()
    assert abs(float(difference(angles[np.argmax(world)], -np.pi / 4))) <= np.deg2rad(15.1)
    assert world.sum() == pytest.approx(1.0)
