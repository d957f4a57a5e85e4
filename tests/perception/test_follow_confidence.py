"""The confidence of a followed target, its loss, and starts on no person, on rendered people."""

import csv
from dataclasses import replace
from functools import cache
from pathlib import Path

import cv2
import numpy as np
import pytest
from command import Done, run

from perception.detection.boxes import FrameDetections
from perception.experiments import following
from perception.experiments.following import Samples, TargetSequence, samples_of, street_targets, tables_of
from perception.following import watch
from perception.following.confidence import _RANGES, _SIGNS, KINDS, START_LEAST, load_confidence, tempered
from perception.following.watch import LOST_AFTER, LossDetector
from perception.trackers.registry import TRACKERS
from perception.trackers.tracker import BoxEstimate

GONE = 22
"""Frame in which the people of a third of the streets disappear."""


BACKGROUND, ALWAYS, ABSENT = 3000, 3001, 3005
"""Streets that nothing was fitted to: with a start on the background, and with people who disappear."""

street = cache(street_targets)


@pytest.fixture(scope="module")
def runs() -> list[Samples]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(following, "TRACKERS", ("sigma-pi", "cue-graph", "color"))
        seeds = (BACKGROUND, ALWAYS, ABSENT, 3007)
        return [run for seed in seeds for one in street(seed) for run in samples_of(one)]


def follow(target: TargetSequence, folder: Path, *arguments: object) -> tuple[Done, list[dict[str, str]]]:
    """Write the images, follow with the colour tracker, and read the table."""
    images, output = folder / "images", folder / "boxes.csv"
    if not images.is_dir():
        images.mkdir()
        for k, image in enumerate(target.images):
            assert cv2.imwrite(str(images / f"{k:03d}.png"), image)
    if "--init" not in arguments:
        box = target.body[0] if target.start is None else target.start[0]
        arguments = ("--init", ",".join(f"{value:.1f}" for value in box), *arguments)
    done = run(
        "follow", images, "--tracker", "color", "--fps", target.fps, "-o", output, "--seed", 1, *arguments
    )
    return done, list(csv.DictReader(output.open())) if output.exists() else []


def test_the_confidence_is_monotone_in_every_feature() -> None:
    model, rng = load_confidence(), np.random.default_rng(0)
    low, high = _RANGES.T
    features = rng.uniform(low, high, (200, len(low)))
    for tracker in TRACKERS:
        best = model.start_probability(tracker, features)
        for person in (True, False):
            before = model.probability(tracker, features, features[0], best, person=person)
            assert ((before > 0.0) & (before < 1.0)).all()
            for k, sign in enumerate(_SIGNS):
                more = features.copy()
                more[:, k] += sign * rng.uniform(0.0, 1.0, len(features))
                better = np.maximum(best, model.start_probability(tracker, more))
                assert (better == model.start_probability(tracker, more)).all()
                assert (model.probability(tracker, more, features[0], better, person=person) >= before).all()
    assert set(TRACKERS) == {name for names in KINDS.values() for name in names}


@pytest.mark.slow
def test_the_confidence_is_reliable_on_fresh_people(runs: list[Samples]) -> None:
    model = load_confidence()
    people = [run for run in runs if not run.on_background]
    said = np.concatenate([model.run(run.tracker, run.features) for run in people])
    on = np.concatenate([run.on for run in people])
    assert 0.2 < on.mean() < 0.95
    assert said[on > 0].mean() > said[on == 0].mean() + 0.3
    assert abs(said.mean() - on.mean()) < 0.15
    for low in (0.0, 0.5, 0.8):
        some = (said >= low) & (said < low + 0.5)
        assert some.sum() > 20
        assert on[some].mean() > said[some].mean() - 0.15


@pytest.mark.slow
def test_starts_on_people_and_on_the_background_differ(runs: list[Samples]) -> None:
    model = load_confidence()
    said = np.array([model.start_probability(run.tracker, run.features[0]) for run in runs])
    background = np.array([run.on_background for run in runs])
    assert said[~background].min() >= START_LEAST
    assert said[~background].mean() > said[background].mean() + 0.4
    assert np.mean(said[background] < START_LEAST) >= 0.5


@pytest.mark.slow
def test_tables_have_the_frames_of_all_runs(runs: list[Samples]) -> None:
    curve, summary, *_ = (table.records() for table in tables_of(load_confidence(), runs))
    assert sum(row["frames"] for row in curve) == sum(row["frames"] or 0 for row in summary)
    assert sum(row["starts"] for row in summary) == len(runs)


def test_a_person_who_disappears_is_lost_and_one_who_stays_is_not(tmp_path: Path) -> None:
    target = street(ABSENT)[0]
    done, rows = follow(target, tmp_path)
    assert done.returncode == 0, done.stderr
    states = [row["state"] for row in rows]
    # Pixels are compared with those a second ago, and features are averaged over 0.3 s.
    late = GONE + round((LOST_AFTER + 1.0) * target.fps)
    assert set(states[: GONE - 5]) == {"followed"} and set(states[late:]) == {"lost"}
    assert all((row["x"] == "") == (row["state"] == "lost") for row in rows)
    count = states.count("lost")
    assert f"lost in {count} of them ({count / target.fps:.1f} s)" in done.stderr + done.stdout
    assert f"lost in frames {states.index('lost')} to the end" in done.stderr


@pytest.mark.slow
def test_a_start_on_the_background_is_refused_unless_anything_is_followed(tmp_path: Path) -> None:
    target = next(one for one in street(BACKGROUND, frames=25) if one.start is not None)
    done, rows = follow(target, tmp_path)
    assert done.returncode == 2 and not rows and done.stderr.count("error:") == 1
    assert "--init" in done.stderr and "--start" in done.stderr and "--no-check" in done.stderr
    done, rows = follow(target, tmp_path, "--no-check")
    assert done.returncode == 0 and len(rows) == len(target.images), done.stderr


@pytest.mark.slow
def test_a_later_start(tmp_path: Path) -> None:
    target = street(ABSENT)[0]
    box = ",".join(f"{value:.1f}" for value in target.body[10])
    done, rows = follow(target, tmp_path, "--init", box, "--start", 10 / target.fps)
    assert done.returncode == 0, done.stderr
    assert [int(row["frame"]) for row in rows] == list(range(10, len(target.images)))
    done, _ = follow(target, tmp_path, "--init", box, "--start", 1000)
    assert done.returncode == 2 and "no frame" in done.stderr


def test_states_change_from_the_first_frame_of_what_lasts() -> None:
    loss = LossDetector()
    said = [0.0] * 2 + [0.9] * 10 + [0.1] * 4 + [0.9] * 3 + [0.1] * 8 + [0.9] * 4 + [0.1] + [0.9] * 8
    for k, confidence in enumerate(said):
        loss.update(k / 10.0, confidence, found=k >= 2)
    states = loss.states
    assert states[:2] == ["waiting"] * 2 and set(states[2:19]) == {"followed"}
    assert set(states[19:32]) == {"lost"} and set(states[32:]) == {"followed"} and not loss.lost
    for k in range(10):
        loss.update(10.0 + k, 0.1)
    loss.reinitialise()
    assert loss.states[-2:] == ["lost", "restarted"] and not loss.lost


def test_pans_are_as_sure_as_the_confidence() -> None:
    pan = np.random.default_rng(0).dirichlet(np.full(16, 0.1), 50)
    for confidence in (0.0, 0.5, 1.0):
        found = tempered(pan, np.array([0.5, 0.1]), confidence)
        np.testing.assert_allclose(found.sum(axis=1), 1.0)
        assert found.min() >= (1.0 - 0.9 * confidence) / 16 - 1e-12
        assert (confidence == 0.0) == np.allclose(found, 1.0 / 16)


RED, BLUE = (20, 20, 200), (200, 40, 20)


def painted(*people: tuple[tuple[int, int, int, int], tuple[int, int, int]]) -> np.ndarray:
    """Boxes of one colour each before grey noise."""
    image = np.random.default_rng(0).integers(90, 110, (300, 400, 3)).astype(np.uint8)
    for (left, top, width, height), colour in people:
        image[top : top + height, left : left + width] = colour
    return image


@pytest.mark.parametrize(
    ("others", "person", "expected"),
    [
        ([((150, 100, 40, 100), RED), ((90, 100, 40, 100), RED)], True, 1),
        ([((90, 100, 40, 100), BLUE), ((150, 100, 40, 100), RED)], True, 1),
        ([((90, 100, 40, 100), BLUE)], True, None),
        ([((90, 100, 60, 180), RED)], True, None),
        ([((340, 100, 40, 100), RED)], True, None),
        ([((90, 100, 40, 100), RED)], False, None),
    ],
)
def test_a_lost_target_is_taken_up_again_on_the_nearest_plausible_person(
    others: list, person: bool, expected: int | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Detector:
        def detect(self, image: np.ndarray) -> FrameDetections:
            return FrameDetections(np.array([box for box, _ in others], float), np.ones(len(others)))

    monkeypatch.setattr(watch, "PeopleDetector", Detector)
    followed = watch.TargetWatch("color", lambda number: number / 10.0, lambda number: None, person=person)
    box = (60.0, 100.0, 40.0, 100.0)
    particles = np.tile(box, (4, 1))
    estimate = BoxEstimate(box, np.ones(2), 0.99, True, particles, np.full(4, 0.25))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(watch, "START_LEAST", 0.0)
        followed.start(0, painted(((60, 100, 40, 100), RED)), estimate)
    for number in range(1, 8):
        followed.loss.update(number / 10.0, 0.0)
    assert followed.loss.lost
    found = followed.plausible_person(8, painted(*others))
    assert found == (None if expected is None else tuple(map(float, others[expected][0])))
    if found is not None:
        assert followed.plausible_person(9, painted(*others)) is None  # a second has not passed
        followed.reinitialise(9, painted(*others), replace(estimate, box=found))
        assert followed.loss.states[-1] == "restarted" and not followed.loss.lost
