"""A camera without a calibration: the view from boxes, its uncertainty, and insufficient boxes."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from command import ran
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from street_boxes import DETECTORS, Detector, fragmented, street

from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray
from graphtrack.io.cameras import read_calibration
from perception.detection.boxes import PersonBox, read_boxes, write_boxes
from perception.ground.calibration import FoundScale, FoundView, complete_boxes, found_view, people_of
from perception.ground.fitting import PRIOR_MEAN, PRIOR_STD, RADIUS, PinholeView, box_heights, ground_points
from perception.synthetic.cameras import Camera

SIZE = (1280, 720)
VIEW = PinholeView(1000.0, np.deg2rad(28.0), 0.0, 5.0, -0.1)
NAMES = ("focal", "tilt", "height")


def crowd(
    camera: Camera,
    rng: np.random.Generator,
    *,
    people: int = 40,
    noise: float = 0.03,
    false: float = 0.0,
    identified: bool = True,
    nearest: float = 0.0,
    farthest: float = 60.0,
) -> list[PersonBox]:
    """Boxes around cylinders that walk straight, of heights about 1.7 m, and boxes of nothing."""
    radius = 1.7 * float(np.clip(rng.normal(PRIOR_MEAN[RADIUS], PRIOR_STD[RADIUS]), 0.02, 0.25))
    around = 2.0 * np.pi * np.arange(24) / 24
    ring = np.column_stack([radius * np.cos(around), radius * np.sin(around), np.zeros(24)])
    ground, boxes, count = camera.ground_camera(), [], 0
    while count < people:
        start = ground.image_to_ground(rng.uniform((0.0, 0.0), SIZE))
        away = np.linalg.norm(start - camera.position[:2])
        if not nearest < away < farthest:  # nor beyond the horizon
            continue
        way, tall, there = rng.uniform(0.0, 2.0 * np.pi), rng.normal(1.7, 0.09), 0
        for k in range(8):
            at = start + 0.5 * k * np.array([np.cos(way), np.sin(way)])
            cylinder = np.concatenate([ring, ring + np.array([0.0, 0.0, tall])])
            pixel = camera.project(cylinder + np.append(at, 0.0))
            (left, top), (right, bottom) = pixel.min(axis=0), pixel.max(axis=0)
            height = (bottom - top) * np.exp(rng.normal(0.0, noise))
            if not (
                np.isfinite(pixel).all() and left > 0 and right < SIZE[0] and top > 0 and bottom < SIZE[1]
            ):
                continue
            item = (left, bottom - height, right - left, height)
            boxes.append(PersonBox(8 * (count // 5) + k, count, item, identified=identified))
            there += 1
        count += there > 0
    for k in range(round(false * len(boxes))):
        height = rng.uniform(0.05, 0.4) * SIZE[1]
        corner = rng.uniform((0.0, 0.0), (SIZE[0] - 0.4 * height, SIZE[1] - height))
        frame = int(rng.integers(8 * (people // 5 + 1)))
        boxes.append(PersonBox(frame, 1000 + k, (*corner, 0.4 * height, height), identified=identified))
    return boxes


def some_camera(rng: np.random.Generator) -> Camera:
    pitch = -np.deg2rad(rng.uniform(15.0, 35.0))
    return Camera((0.0, 0.0, rng.uniform(3.0, 8.0)), 1.0, pitch, SIZE[0] * rng.uniform(0.7, 1.3), SIZE)


def holds(found: FoundView, camera: Camera) -> list[bool]:
    """Return whether the intervals of focal length, tilt, roll and height contain the camera's."""
    true = {"focal": camera.focal, "tilt": -camera.pitch, "roll": 0.0, "height": camera.position[2]}
    return [low <= true[name] <= high for name, (low, high) in found.interval.items()]


def found_in(boxes: list[PersonBox], size: tuple[int, int] = SIZE, height: float = 1.7) -> FoundView:
    found = found_view(boxes, size, np.random.default_rng(0), height)
    assert isinstance(found, FoundView), found.described()
    return found


def test_a_view_is_the_synthetic_camera_that_looks_the_same_way() -> None:
    camera = Camera((0.0, 0.0, 5.0), np.pi / 2, -0.4, 900.0, SIZE)
    seen = PinholeView(900.0, 0.4, 0.0, 5.0).camera(SIZE)
    places = np.random.default_rng(0).uniform((-4.0, 6.0), (4.0, 20.0), (20, 2))
    np.testing.assert_allclose(seen.ground_to_image(places), camera.ground_camera().ground_to_image(places))


@pytest.mark.parametrize("k1", [-0.15, 0.0, 0.05])
def test_box_heights_are_those_of_projected_cylinders(k1: float) -> None:
    view = PinholeView(800.0, 0.5, 0.2, 6.0, k1, (12.0, -9.0))
    camera, wide = view.camera(SIZE), float(SIZE[0])
    vector = np.array(
        [np.log(800.0 / wide), 0.5, 0.2, np.log(6.0 / 1.7), k1, 12.0 / wide, -9.0 / wide, 0.11, 0.0]
    )
    feet = np.random.default_rng(0).uniform((-450.0, -60.0), (450.0, 300.0), (30, 2))
    corner = float(np.hypot(*SIZE)) / 2.0 / wide
    ground = camera.image_to_ground(feet + np.array(SIZE) / 2.0)
    away = ground / np.linalg.norm(ground, axis=1, keepdims=True)
    top = np.column_stack([ground + 2.0 * 0.11 * 1.7 * away, np.full(30, 1.7)])
    seen = top @ view.rotation.T + view.translation
    pixel = camera.distort(800.0 * seen[:, :2] / seen[:, 2:] + np.array(SIZE) / 2.0 + (12.0, -9.0))
    expected = feet[:, 1] + SIZE[1] / 2.0 - pixel[:, 1]
    np.testing.assert_allclose(wide * box_heights(vector, feet / wide, corner), expected, rtol=1e-4)
    in_camera = 1.7 * ground_points(vector, feet / wide, corner).T
    np.testing.assert_allclose((in_camera - view.translation) @ view.rotation[:, :2], ground, atol=1e-4)


@dataclass(frozen=True)
class Judged:
    """Of the view found for a street: which intervals hold, and their half widths over the truth."""

    detector: Detector
    hold: tuple[bool, ...]
    width: tuple[float, ...]
    is_scale: bool


def judged(seeds: range) -> list[Judged]:
    """Return what is found for streets; those for which only one scale is found have no intervals."""
    every = []
    for seed in seeds:
        one = street(seed)
        found = found_view(one.boxes, one.size, np.random.default_rng(0))
        if isinstance(found, FoundScale):
            assert "scale only" in found.described()
            every.append(Judged(one.detector, (), (), True))
            continue
        true = [abs(getattr(one.view, name)) for name in NAMES]
        ends = [found.interval[name] for name in NAMES]
        wide = any(
            high - low > 0.5 * abs(getattr(found.view, name))
            for name, (low, high) in zip(NAMES, ends, strict=True)
        )
        assert (
            wide == ("scale only" in found.described()) == any("scale only" in note for note in found.notes)
        )
        hold = tuple(low <= value <= high for value, (low, high) in zip(true, ends, strict=True))
        width = tuple(0.5 * (high - low) / value for value, (low, high) in zip(true, ends, strict=True))
        every.append(Judged(one.detector, hold, width, wide))
    return every


@pytest.mark.slow
def test_intervals_hold_in_simulated_streets() -> None:
    hold = np.array([one.hold for one in judged(range(200, 208)) if one.hold])
    assert len(hold) >= 5
    assert hold.mean() >= 0.85


@pytest.mark.slow
def test_intervals_hold_in_many_simulated_streets(figures: Callable[..., None]) -> None:
    streets = judged(range(300, 400))
    for detector in (*DETECTORS, "all"):
        mine = [one for one in streets if detector in (one.detector, "all")]
        known = [one for one in mine if one.hold]
        shares, widths = (
            np.mean([one.hold for one in known], axis=0),
            np.median([one.width for one in known], axis=0),
        )
        row: dict[str, object] = {"boxes": detector, "streets": len(mine), "with intervals": len(known)}
        for name, share, width in zip(NAMES, shares.tolist(), widths.tolist(), strict=True):
            row |= {f"{name} holds (%)": 100.0 * share, f"{name} ± (%)": 100.0 * width}
        row["scale only (%)"] = 100.0 * float(np.mean([one.is_scale for one in mine]))
        figures("Cameras from people", row)
    hold = np.array([one.hold for one in streets if one.hold])
    assert len(hold) >= 60
    assert (hold.mean(axis=0) >= 0.9).all(), hold.mean(axis=0)


@pytest.mark.slow
@pytest.mark.parametrize("detector", ["exact", "noisy"])
def test_fragments_do_not_narrow_the_intervals(detector: Detector) -> None:
    one = street(400, detector=detector, people=24, size=(1280, 720), view=VIEW)
    parts = fragmented(one.boxes, np.random.default_rng(0), longest=8)
    assert len({item.track_id for item in parts}) > 3 * one.people
    joined, cut = (found_in(boxes, one.size) for boxes in (one.boxes, parts))
    assert cut.people <= 1.3 * joined.people

    def width(found: FoundView) -> FloatArray:
        return np.array(
            [np.subtract(*found.interval[name][::-1]) / abs(getattr(found.view, name)) for name in NAMES]
        )

    assert (width(cut) > 0.8 * width(joined)).all()


@pytest.mark.slow
def test_boxes_given_twice_are_of_the_same_people() -> None:
    one = street(401, detector="exact", people=20, size=(1280, 720), view=VIEW)
    twice = [*one.boxes, *(replace(item, track_id=item.track_id + 500) for item in one.boxes)]
    assert found_in(twice, one.size).people == found_in(one.boxes, one.size).people


@pytest.mark.slow
def test_a_view_of_resized_images_is_resized() -> None:
    one = street(402, detector="exact", people=20, size=(1280, 720), view=VIEW)
    inside = [item for item in one.boxes if complete_boxes(np.array([item.box]) * 0.5, (640, 360))[0]]
    half = [replace(item, box=tuple(0.5 * side for side in item.box)) for item in inside]
    large, small = found_in(inside, (1280, 720)), found_in(half, (640, 360))
    assert small.view.focal == pytest.approx(0.5 * large.view.focal, rel=0.02)
    for name in ("tilt", "height"):
        assert getattr(small.view, name) == pytest.approx(getattr(large.view, name), rel=0.02)
        assert small.interval[name] == pytest.approx(large.interval[name], rel=0.05)


walks = st.tuples(
    st.floats(-0.2, 1.2),
    st.floats(-0.2, 1.2),
    st.floats(0.002, 0.9),
    st.floats(-0.05, 0.05),
    st.floats(-0.05, 0.05),
)


@settings(max_examples=12, deadline=None, suppress_health_check=list(HealthCheck))
@given(st.lists(walks, min_size=1, max_size=12), st.integers(1, 12), st.booleans())
def test_no_boxes_end_in_an_error(people: list[tuple[float, ...]], frames: int, identified: bool) -> None:
    boxes = []
    for name, (across, along, tall, aside, down) in enumerate(people):
        for k in range(frames):
            left, top = (across + k * aside) * 320.0, (along + k * down) * 240.0
            box = (left, top, 0.4 * tall * 240.0, tall * 240.0)
            boxes.append(PersonBox(k, name if identified else len(boxes) + 1, box, identified=identified))
    try:
        found = found_view(boxes, (320, 240), np.random.default_rng(0))
    except InputError as error:
        assert "outside the image" in str(error)
        return
    assert found.described()
    if isinstance(found, FoundView):
        ends = np.array([*found.interval.values()])
        assert np.isfinite(ends).all() and (ends[:, 0] <= ends[:, 1]).all()
    ground = found.camera.image_to_ground([[160.0, 235.0]])
    assert ground.shape == (1, 2)


@pytest.mark.slow
@pytest.mark.parametrize("identified", [True, False])
def test_false_detections_hardly_matter(identified: bool) -> None:
    rng = np.random.default_rng(1)
    camera = Camera((0.0, 0.0, 4.0), 1.0, -0.4, 1100.0, SIZE)
    found = found_in(crowd(camera, rng, people=60, false=0.3, identified=identified))
    assert all(holds(found, camera))


@pytest.mark.slow
def test_the_scale_is_that_of_people() -> None:
    camera = Camera((0.0, 0.0, 4.0), 1.0, -0.45, 1100.0, SIZE)
    boxes = crowd(camera, np.random.default_rng(3))
    small, large = (found_in(boxes, height=height) for height in (0.85, 1.7))
    assert large.view.height == pytest.approx(2.0 * small.view.height)
    assert large.view.focal == pytest.approx(small.view.focal)


@pytest.mark.slow
def test_turning_the_image_around_turns_the_roll_around() -> None:
    camera = Camera((0.0, 0.0, 4.0), 1.0, -0.45, 1100.0, SIZE)
    boxes = crowd(camera, np.random.default_rng(4))
    mirrored = [
        PersonBox(item.frame, item.track_id, (SIZE[0] - item.box[0] - item.box[2], *item.box[1:]))
        for item in boxes
    ]
    one, other = (found_in(those).view for those in (boxes, mirrored))
    assert (other.focal, other.tilt, other.roll, other.height) == pytest.approx(
        (one.focal, one.tilt, -one.roll, one.height), rel=0.02, abs=2e-3
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    ("camera", "options", "words"),
    [
        (Camera((0.0, 0.0, 4.0), 1.0, -0.4, 1100.0, SIZE), {"people": 4}, "of 4 people are too few"),
        (
            Camera((0.0, 0.0, 2.0), 1.0, -0.05, 1100.0, SIZE),
            {"nearest": 19.5, "farthest": 20.5, "noise": 0.01},
            "scale only",
        ),
        (Camera((0.0, 0.0, 8.0), 1.0, -1.5, 900.0, SIZE), {}, "scale only"),
        (Camera((0.0, 0.0, 1.7), 1.0, 0.0, 1100.0, SIZE), {"nearest": 12.0, "noise": 0.1}, "scale only"),
    ],
    ids=["few people", "all at one depth", "from above", "level and noisy"],
)
def test_views_that_do_not_tell_are_a_scale_only(
    camera: Camera, options: dict[str, float], words: str, tmp_path: Path
) -> None:
    boxes = crowd(camera, np.random.default_rng(0), **options)
    found = found_view(boxes, SIZE, np.random.default_rng(0))
    assert found.described().startswith("scale only") and words in found.described()
    found.write(tmp_path / "camera.ci")
    foot = [[640.0, 700.0], [640.0, 710.0]]
    written = read_calibration(tmp_path / "camera.ci")
    np.testing.assert_allclose(written.image_to_ground(foot), found.camera.image_to_ground(foot), rtol=1e-9)


def test_boxes_of_another_image_are_refused() -> None:
    boxes = [PersonBox(k, k, (3000.0 + k, 100.0, 40.0, 100.0 + k)) for k in range(50)]
    with pytest.raises(InputError, match="50 of 50 boxes outside the image of 1280 × 720"):
        found_view(boxes, SIZE, np.random.default_rng(0))


def test_detections_of_one_person_are_joined_from_frame_to_frame() -> None:
    walk = [PersonBox(k, 2 * k, (100.0 + 5 * k, 50.0, 40.0, 100.0), identified=False) for k in range(5)]
    other = [PersonBox(k, 2 * k + 1, (400.0, 50.0, 40.0, 100.0), identified=False) for k in range(3)]
    who = people_of([*walk, *other])
    assert len(set(who[:5])) == 1 and len(set(who[5:])) == 1 and who[0] != who[5]


def written(folder: Path, boxes: list[PersonBox]) -> tuple[Path, Path]:
    (folder / "frames").mkdir()
    cv2.imwrite(str(folder / "frames" / "0000.png"), np.zeros((SIZE[1], SIZE[0], 3), np.uint8))
    write_boxes(boxes, folder / "boxes.txt")
    return folder / "frames", folder / "boxes.txt"


@pytest.mark.slow
def test_the_command_writes_a_calibration_that_is_read(tmp_path: Path) -> None:
    camera = Camera((0.0, 0.0, 4.0), 1.0, -0.45, 1100.0, SIZE)
    frames, boxes = written(tmp_path, crowd(camera, np.random.default_rng(5)))
    done = ran("calibrate", frames, "--boxes", boxes, "-o", tmp_path / "camera.ci")
    assert "95 %" in done.stdout + done.stderr and "k1" in done.stdout + done.stderr
    found = read_calibration(tmp_path / "camera.ci")
    expected = found_in(read_boxes(boxes))
    np.testing.assert_allclose(found.homography, expected.camera.homography)
    np.testing.assert_allclose(found.distortion, expected.view.distortion)
    assert all(
        name in (tmp_path / "camera.ci").read_text() for name in ("FocalLengthStd", "FocalLengthLow95")
    )


@pytest.mark.slow
def test_town_centre_is_found_from_its_public_detections(data_dir: Path) -> None:
    town_centre = data_dir / "towncentre"
    boxes = read_boxes(town_centre / "frames_001_150" / "det.txt")
    found = found_in(boxes, (1920, 1080))
    assert found.interval["focal"][0] < 2696.36 < found.interval["focal"][1]
    low, high = np.degrees(found.interval["tilt"])
    assert low < 20.04 < high
    known = read_calibration(town_centre / "calibration.ci")
    feet = np.array([(b.box[0] + b.box[2] / 2, b.box[1] + b.box[3]) for b in boxes])
    first, second = np.random.default_rng(0).integers(len(feet), size=(2, 2000))

    def distance(camera: object) -> FloatArray:
        ground = camera.image_to_ground(feet)
        return np.linalg.norm(ground[first] - ground[second], axis=1)

    apart = distance(known) > 1.0
    ratio = distance(found.camera)[apart] / distance(known)[apart]
    assert np.median(np.abs(ratio - 1.0)) < 0.1
