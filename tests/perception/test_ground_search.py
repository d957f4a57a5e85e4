"""People found where they have a person's height; learning from a recording, and confidence."""

import re
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pandas as pd
import pytest
from command import ran, run
from scipy.special import expit
from street_files import write_street

import graphtrack as gt
from graphtrack.errors import InputError
from graphtrack.geometry.camera import GroundCamera
from graphtrack.io.cameras import write_calibration
from graphtrack.tracks.track import Track, TrackSet
from perception.detection import rescoring
from perception.detection.background import Background, Backgrounds, background_samples
from perception.detection.boxes import foot_point
from perception.detection.ground_search import (
    Candidates,
    GroundSearch,
    PersonSizes,
    bands_of,
    joined,
    strongest,
)
from perception.detection.hog import TALL
from perception.detection.rescoring import (
    Certainty,
    PersonProbability,
    adapt_to_recording,
    judged_by_other_frames,
    learning_frames,
)
from perception.images.frames import Frame
from perception.synthetic import Camera
from perception.synthetic.clips import CAMERA, FPS, SIZE, PastedStreet, pasted_street


@pytest.fixture
def little_teaches(monkeypatch: pytest.MonkeyPatch) -> None:
    """Few people who walk for a short time are enough."""
    monkeypatch.setattr(rescoring, "LEAST_BOXES", 4)
    monkeypatch.setattr(rescoring, "LEAST_PEOPLE", 4)


@pytest.fixture(scope="module")
def street() -> PastedStreet:
    """One person after the other, ten seconds apart, before a background that is not empty."""
    made = pasted_street(9, np.random.default_rng(0), offset=0.0, upright=True)
    rng = np.random.default_rng(1)
    behind = cv2.GaussianBlur(rng.integers(60, 160, (SIZE[1], SIZE[0], 3), np.uint8), (0, 0), 3.0)
    for frame in made.frames:
        assert frame.image is not None
        empty = (frame.image == 110).all(axis=2)
        frame.image[empty] = behind[empty]

    def later(frame: int) -> int:
        return frame + 25 * (frame // 7)

    frames = [Frame(later(frame.number), frame.image) for frame in made.frames]
    return replace(made, frames=frames, boxes=[replace(item, frame=later(item.frame)) for item in made.boxes])


@pytest.fixture(scope="module")
def backgrounds(street: PastedStreet) -> Backgrounds:
    numbers = [frame.number for frame in street.frames]
    return Backgrounds.of(street.frames, background_samples(numbers, FPS), numbers)


@pytest.fixture(scope="module")
def candidates(street: PastedStreet, backgrounds: Backgrounds) -> dict[int, Candidates]:
    search = GroundSearch(street.camera, SIZE)
    found = {}
    for frame in street.frames:
        assert frame.image is not None
        found[frame.number] = search.candidates(frame.image, backgrounds.at(frame.number))
    return found


# -- sizes and bands ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("roll", [0.0, 0.1])
def test_a_person_has_the_height_that_the_camera_shows(roll: float) -> None:
    intrinsics = np.array([[900.0, 0.0, 480.0], [0.0, 900.0, 270.0], [0.0, 0.0, 1.0]])
    tilt = 0.5
    down = np.array(
        [[1.0, 0.0, 0.0], [0.0, -np.sin(tilt), -np.cos(tilt)], [0.0, np.cos(tilt), -np.sin(tilt)]]
    )
    turn = np.array([[np.cos(roll), -np.sin(roll), 0.0], [np.sin(roll), np.cos(roll), 0.0], [0.0, 0.0, 1.0]])
    rotation = turn @ down
    translation = -rotation @ np.array([0.0, -14.0, 7.0])
    ground = np.array([[0.0, 0.0, 0.0], [2.0, 3.0, 0.0], [-3.0, -1.0, 0.0]])

    def image(points: np.ndarray) -> np.ndarray:
        seen = (points @ rotation.T + translation) @ intrinsics.T
        return seen[:, :2] / seen[:, 2:]

    feet, heads = image(ground), image(ground + np.array([0.0, 0.0, 1.7]))
    known = GroundCamera.from_calibration(rotation, translation, intrinsics)
    for camera in (known, GroundCamera(known.homography)):  # the focal length follows from the ground
        sizes = PersonSizes.of(camera, (960, 540))
        np.testing.assert_allclose(sizes.heads(feet), heads, atol=0.5)
        np.testing.assert_allclose(sizes.heights(feet), (feet - heads)[:, 1], atol=0.5)


def test_nobody_has_a_height_beyond_the_horizon_or_below_the_camera() -> None:
    sizes = PersonSizes.of(CAMERA.ground_camera(), SIZE)
    assert np.isnan(sizes.heights(np.array([[160.0, -400.0]]))).all()
    with pytest.raises(InputError, match="people are not upright or too small"):
        GroundSearch(GroundCamera.from_scale(10.0), SIZE)


def test_every_place_is_in_a_band_of_its_height_which_shows_what_is_there() -> None:
    sizes = PersonSizes.of(CAMERA.ground_camera(), SIZE)
    bands = bands_of(sizes, SIZE)
    feet = np.vstack([band.foot for band in bands])
    for place in ([160.0, 150.0], [60.0, 200.0], [250.0, 120.0]):
        assert np.abs(feet - place).max(axis=1).min() < 0.1 * sizes.heights(np.array([place]))[0]
    for band in bands:
        assert np.abs(np.log(TALL / band.scale / sizes.heights(band.foot))).max() <= 0.1 + 1e-9
    image = np.tile((np.arange(SIZE[0]) // 2).astype(np.uint8)[None, :, None], (SIZE[1], 1, 3))
    for band in bands:
        cut = band.cut(image)
        assert cut.shape[:2] == band.size[::-1]
        column = cut.shape[1] // 2
        assert abs(cut[5, column, 0] - 0.5 * (band.left + (column + 0.5) / band.scale - 0.5)) <= 2.0


# -- background --------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_the_background_is_what_stays_and_the_foreground_who_walks(
    street: PastedStreet, backgrounds: Backgrounds
) -> None:
    item, frame = street.boxes[30], street.frames[30]
    background = backgrounds.at(frame.number)
    assert background is not None and frame.image is not None
    shown = background.foreground(frame.image)
    left, top, width, height = (round(value) for value in item.box)
    inside = np.zeros(shown.shape, bool)
    inside[top : top + height, left : left + width] = True
    assert shown[inside].mean() > 0.3 and shown[~inside].mean() < 0.1
    # Lighter or darker as a whole is no foreground.
    lit = np.clip(frame.image * 1.15, 0, 255).astype(np.uint8)
    assert background.foreground(lit)[~inside].mean() < 0.1


def test_long_recordings_have_several_backgrounds_and_bounded_samples() -> None:
    numbers = list(range(0, 90_000))
    samples = background_samples(numbers, 25.0)
    assert len(samples) == 6 and all(len(part) <= 40 for part in samples)
    assert [part[0] // 15_000 for part in samples] == list(range(6))
    assert background_samples(numbers[:100], 25.0) == []


# -- candidates --------------------------------------------------------------------------------------------


def test_the_weaker_of_two_at_one_place_is_dropped() -> None:
    foot = np.array([[100.0, 100.0], [105.0, 100.0], [140.0, 100.0], [100.0, 130.0]])
    kept = strongest(foot, np.full(4, 85.0), np.array([1.0, 2.0, 0.5, 0.4]), (0.4, 0.5))
    assert kept.tolist() == [1, 2, 3]
    assert strongest(foot, np.full(4, 85.0), np.array([1.0, 2.0, 0.5, 0.4]), (0.4, 0.5), 2).tolist() == [1, 2]


@pytest.mark.slow
def test_moved_cameras_have_no_foreground(street: PastedStreet) -> None:
    """An image that is foreground all over is uninformative."""
    search, image = GroundSearch(street.camera, SIZE), street.frames[0].image
    assert image is not None
    other = Background(
        np.full((*image.shape[:2], 3), 255.0, np.float32), np.full(image.shape[:2], 4.0, np.float32)
    )
    rolled = np.roll(image, 160, axis=1)
    rolled[np.arange(SIZE[1]) % 4 != 0] = 0
    assert other.foreground(rolled).mean() > 0.5
    np.testing.assert_allclose(search.candidates(rolled, other).score, search.candidates(rolled, None).score)


# -- learning from a recording -----------------------------------------------------------------------------


def precision_and_recall(
    street: PastedStreet, candidates: dict[int, Candidates], probability: PersonProbability
) -> tuple[float, float]:
    right = found = 0
    for item in street.boxes:
        boxes = probability.detections(candidates[item.frame]).boxes
        place = street.camera.image_to_ground(
            np.array([foot_point(tuple(box)) for box in boxes]).reshape(-1, 2)
        )
        true = street.camera.image_to_ground(foot_point(item.box))
        right += bool((np.linalg.norm(place - true, axis=1) < 1.0).any())
        found += len(boxes)
    return right / max(found, 1), right / len(street.boxes)


@pytest.mark.slow
def test_people_are_found_and_what_is_taught_helps(
    street: PastedStreet, candidates: dict[int, Candidates], little_teaches: None
) -> None:
    of_package = PersonProbability.of_package(foreground=True)
    of_street = adapt_to_recording(candidates, street.camera, FPS, np.random.default_rng(0))
    assert of_street is not None and of_street.people >= 4
    before, after = (precision_and_recall(street, candidates, one) for one in (of_package, of_street))
    assert sum(after) >= sum(before) - 0.02
    assert min(after) > 0.7


@pytest.mark.slow
def test_what_was_taught_holds_for_other_people(
    street: PastedStreet, candidates: dict[int, Candidates], little_teaches: None
) -> None:
    first = set(list(candidates)[: len(candidates) // 2])
    half = {k: candidates[k] for k in first}
    of_half = adapt_to_recording(half, street.camera, FPS, np.random.default_rng(0))
    assert of_half is not None
    said, true = [], []
    for item in street.boxes[len(first) :]:
        one = candidates[item.frame]
        best = joined(one.scored(of_half.of(one)), (0.4, 0.6))
        away = street.camera.image_to_ground(best.foot) - street.camera.image_to_ground(foot_point(item.box))
        said.append(best.score)
        true.append(np.linalg.norm(away, axis=1) < 1.0)
    p, right = np.concatenate(said), np.concatenate(true)
    sure = p > 0.8
    assert right[sure].mean() > 0.7 and right[p < 0.2].mean() < 0.2


@pytest.mark.slow
def test_nothing_is_taught_where_nobody_walks(street: PastedStreet, backgrounds: Backgrounds) -> None:
    image = street.frames[3].image
    assert image is not None
    one = GroundSearch(street.camera, SIZE).candidates(image, backgrounds.at(street.frames[3].number))
    still = dict.fromkeys(range(20), one)
    assert adapt_to_recording(still, street.camera, FPS, np.random.default_rng(0)) is None
    assert adapt_to_recording({}, street.camera, FPS, np.random.default_rng(0)) is None
    none = Candidates(one.foot[:0], one.height[:0], one.score[:0], one.features[:0])
    assert adapt_to_recording({0: none}, street.camera, FPS, np.random.default_rng(0)) is None


def test_few_frames_of_a_long_recording_are_learned_from() -> None:
    short = learning_frames(list(range(100)), 2.5)
    assert short == list(range(100))
    long = learning_frames(list(range(90_000)), 25.0)
    assert len(long) == 150 and np.median(np.diff(long)) == 10
    assert [long[0] // 30_000, long[75] // 30_000, long[-1] // 30_000] == [0, 1, 2]


# -- the command -------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def written(street: PastedStreet, tmp_path_factory: pytest.TempPathFactory) -> list[object]:
    frames, _, _, *options = write_street(street, tmp_path_factory.mktemp("street"))
    return [frames, *options]


@pytest.mark.slow
def test_observe_writes_detections_and_smooth_finds_who_is_who(
    street: PastedStreet, written: list[object], tmp_path: Path
) -> None:
    out = tmp_path / "seen.csv"
    done = ran("observe", *written, "-o", out, "--write-boxes", tmp_path / "boxes.txt")
    assert "walking people" in done.stderr and "searched for people in 63 frames" in done.stderr
    table = pd.read_csv(out)
    assert set(table["track_id"]) == {-1} and table["score"].between(0.5, 1.0).all()
    assert not list(tmp_path.glob("seen.csv.*"))
    people = gt.read(out)
    assert 6 <= len(people) <= 14


@pytest.mark.slow
def test_a_run_goes_on_with_what_it_was_taught(
    written: list[object], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With learning from a part of the frames, the others are processed without learning again."""
    monkeypatch.setattr("perception.detection.rescoring._FRAMES", 45)
    monkeypatch.setattr("perception.detection.rescoring._RUNS", 1)
    assert run("observe", *written, "-o", tmp_path / "whole.csv").returncode == 0
    whole = GroundSearch.candidates
    count: list[int] = []

    def interrupted(self: GroundSearch, *rest: object) -> Candidates:
        count.append(1)
        if len(count) == 50:
            raise KeyboardInterrupt
        return whole(self, *rest)  # type: ignore[arg-type]

    monkeypatch.setattr(GroundSearch, "candidates", interrupted)
    assert run("observe", *written, "-o", tmp_path / "o.csv").returncode != 0
    done = ran("observe", *written, "-o", tmp_path / "o.csv")
    assert "going on after 49 frames" in done.stderr and "walking people" not in done.stderr
    assert len(count) == 50 + 63 - 49
    assert sorted(path.name for path in tmp_path.iterdir()) == ["o.csv", "whole.csv"]
    tables = [pd.read_csv(tmp_path / name) for name in ("o.csv", "whole.csv")]
    pd.testing.assert_frame_equal(*tables, rtol=1e-4, atol=1e-4)


@pytest.mark.slow
def test_adapt_finds_people_itself_and_leaves_no_journal(written: list[object], tmp_path: Path) -> None:
    done = ran("adapt", *written, "-o", tmp_path / "camera.npz")
    assert "searched for people in 63 frames" in done.stderr
    assert re.search(r"boxes of \d walking people in \d+ tracks", done.stdout + done.stderr)
    assert [path.name for path in tmp_path.iterdir()] == ["camera.npz"]


@pytest.mark.parametrize("command", ["adapt", "observe"])
def test_a_recording_without_people_is_one_line(command: str, written: list[object], tmp_path: Path) -> None:
    (tmp_path / "frames").mkdir()
    for k in range(3):
        cv2.imwrite(str(tmp_path / "frames" / f"{k}.png"), np.full((240, 320, 3), 90, np.uint8))
    out = tmp_path / ("camera.npz" if command == "adapt" else "seen.csv")
    done = run(command, tmp_path / "frames", *written[1:], "-o", out)
    assert done.returncode == 2 and done.stderr.count("error:") == 1 and "without people" in done.stderr
    assert [path.name for path in tmp_path.iterdir()] == ["frames"]


def test_a_calibration_of_another_image_size_is_one_line(written: list[object], tmp_path: Path) -> None:
    camera = Camera((0.0, -14.0, 6.0), np.pi / 2, -0.4, 990.0, (960, 720))
    write_calibration(tmp_path / "camera.ci", camera.rotation, camera.translation, camera.intrinsics)
    done = run("observe", written[0], "--calibration", tmp_path / "camera.ci", "-o", tmp_path / "o.csv")
    assert done.returncode == 2 and done.stderr.count("error:") == 1
    assert "frames of 320 × 240 pixels, expected those of the calibration" in done.stderr
    assert [path.name for path in tmp_path.iterdir()] == ["camera.ci"]


JUDGED = {"radius": 0.5, "least_boxes": 5, "least_way": 1.5}


def test_what_is_said_too_surely_is_said_as_often_as_it_is_so() -> None:
    rng = np.random.default_rng(0)
    true = rng.normal(0.0, 2.0, 4000)
    right = rng.random(4000) < expit(true)
    certainty = Certainty.fitted(3.0 * true + 1.0, right)
    fresh = rng.normal(0.0, 2.0, 4000)
    said = certainty.of(3.0 * fresh + 1.0)
    assert np.abs(said - expit(fresh)).mean() < 0.04
    assert np.abs(expit(3.0 * fresh + 1.0) - expit(fresh)).mean() > 0.1


def test_what_is_likelier_stays_likelier_and_beyond_the_ends_too() -> None:
    rng = np.random.default_rng(1)
    said = rng.normal(size=300)
    certainty = Certainty.fitted(said, rng.random(300) < 0.5)
    values = certainty.of(np.linspace(-30.0, 30.0, 500))
    assert (np.diff(values) > 0.0).all() and values[0] > 0.0 and values[-1] < 1.0


@pytest.mark.parametrize("all_of_them", [True, False])
def test_of_one_kind_nothing_is_certain(all_of_them: bool) -> None:
    certainty = Certainty.fitted(np.arange(8.0), np.full(8, all_of_them))
    assert certainty.of(np.array([3.0]))[0] == pytest.approx(0.9 if all_of_them else 0.1, abs=0.01)


def straight(track_id: int, frames: int, speed: float, y: float) -> Track:
    frame = np.arange(frames)
    t = 0.4 * frame
    return Track(track_id, frame, t, np.column_stack([speed * t, np.full(frames, y)]))


def test_a_detection_that_lies_off_is_wrong_though_its_track_has_it() -> None:
    walk = straight(1, 15, 1.3, 0.0)
    off = walk.position.copy()
    off[7] += [0.0, 0.9]
    tracks = TrackSet((Track(1, walk.frame, walk.t, off),))
    right = judged_by_other_frames(walk.frame, off, tracks, **JUDGED)
    assert right[7] == 0.0
    assert (right[2:7] == 1.0).all() and (right[8:13] == 1.0).all()


def test_who_stands_says_nothing_and_what_nobody_follows_is_nobody() -> None:
    walk, still = straight(1, 15, 1.3, 0.0), straight(2, 15, 0.0, 5.0)
    frame = np.array([7, 7, 7, 7])
    there = walk.position[7]
    place = np.array([there, [0.05, 5.0], [9.0, 9.0], there + np.array([0.3, 0.0])])
    right = judged_by_other_frames(frame, place, TrackSet((walk, still)), **JUDGED)
    np.testing.assert_array_equal(right, [1.0, np.nan, 0.0, 0.0])  # one of the walker's two is too many


def test_a_track_says_nothing_beyond_its_ends() -> None:
    walk = straight(1, 15, 1.3, 0.0)
    ends = judged_by_other_frames(walk.frame, walk.position, TrackSet((walk,)), **JUDGED)[[0, -1]]
    assert not (ends == 1.0).any()
