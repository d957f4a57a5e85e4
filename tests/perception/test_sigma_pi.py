"""The Sigma-Pi tracker on small synthetic videos, and its equations written out."""

from __future__ import annotations

import warnings
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from graphtrack.errors import InputError
from perception.experiments.sigma_pi_runs import Tally, recordings
from perception.images.pixels import Image
from perception.synthetic.ceiling import KINDS, ceiling_sequence
from perception.trackers.sigma_pi import SigmaPiTracker
from perception.trackers.sigma_pi_cues import ShapeCue
from perception.trackers.sigma_pi_network import (
    CUES,
    TERM_NAMES,
    SigmaPiParameters,
    adapted,
    output,
    products,
)
from perception.trackers.tracker import Box, BoxDynamics, BoxEstimate, Proposal, states_of

SIZE = (200, 150)
TARGET = (32, 36)


def picture(width: int, height: int, colour: tuple[int, int, int], grain: float, seed: int) -> Image:
    """A texture about a colour; ``grain`` is its size in pixels."""
    noise = cv2.GaussianBlur(np.random.default_rng(seed).normal(0, 1, (height, width)), (0, 0), grain)
    return np.clip(np.array(colour) + 25.0 * (noise / noise.std())[..., None], 0, 255).astype(np.uint8)


ROOM = picture(*SIZE, (130, 120, 120), 8.0, 0)
PERSON = picture(*TARGET, (60, 60, 170), 1.5, 1)


def shown(place: tuple[float, float] | None, seed: int, room: Image = ROOM, person: Image = PERSON) -> Image:
    """The room with the person's middle at a place, with noise."""
    image = room.copy()
    if place is not None:
        left, top = round(place[0] - TARGET[0] / 2), round(place[1] - TARGET[1] / 2)
        image[top : top + TARGET[1], left : left + TARGET[0]] = person
    return np.clip(image + np.random.default_rng(seed).normal(0, 2, image.shape), 0, 255).astype(np.uint8)


def box_at(place: tuple[float, float]) -> Box:
    return (place[0] - TARGET[0] / 2, place[1] - TARGET[1] / 2, *map(float, TARGET))


def path(k: int) -> tuple[float, float]:
    return (30.0 + 2.0 * k, 60.0 + 20.0 * np.sin(k / 12.0))


def follow(tracker: SigmaPiTracker, images: Iterable[Image], box: Box | None) -> list[BoxEstimate]:
    images = iter(images)
    return [tracker.start(next(images), box), *(tracker.step(image) for image in images)]


def is_on(estimate: BoxEstimate, place: tuple[float, float]) -> bool:
    return bool(estimate.found and (np.abs(estimate.centre - place) < np.array(TARGET) / 2).all())


def test_weights_are_the_sum_of_linear_quadratic_and_cubic_terms() -> None:
    rng = np.random.default_rng(0)
    activities, alpha = rng.random((40, 3)), rng.random(7)
    for (m, c, s), weight in zip(activities, output(activities, alpha), strict=True):
        linear = alpha[0] * m + alpha[1] * c + alpha[2] * s
        quadratic = alpha[3] * m * c + alpha[4] * m * s + alpha[5] * c * s
        assert weight == pytest.approx(linear + quadratic + alpha[6] * m * c * s)
    assert TERM_NAMES[3:] == ("motion·colour", "motion·shape", "colour·shape", "motion·colour·shape")


def test_reliabilities_follow_equations_5_and_6() -> None:
    rng = np.random.default_rng(0)
    alpha, activities = rng.random(7), rng.random(3)
    terms = products(activities)
    for c, value in enumerate(adapted(alpha, activities, 0.1, 0.02)):
        f = sum(terms[i] * terms[c] for i in range(7) if i != c)
        assert value == pytest.approx(0.9 * alpha[c] + 0.1 * f + 0.02)


def test_who_moves_is_followed_from_a_box_and_found_without() -> None:
    for box, first in ((box_at(path(0)), 0), (None, 15)):
        images = [shown(path(k) if k >= first else None, k) for k in range(45)]
        estimates = follow(SigmaPiTracker(seed=1), images, box)
        assert all(is_on(estimate, path(k)) for k, estimate in enumerate(estimates) if k >= first + 10)
        assert box is not None or not any(estimate.found for estimate in estimates[:first])


@pytest.mark.slow
def test_what_rests_is_absorbed_by_the_motion_cue_and_held_by_the_others() -> None:
    images = [shown(path(min(k, 30)), k) for k in range(160)]
    estimates = follow(SigmaPiTracker(seed=1), images, box_at(path(0)))
    assert estimates[28].cues["motion"] > 0.5 > 0.05 > estimates[-1].cues["motion"]
    assert all(is_on(estimate, path(30)) for estimate in estimates[30:])
    motion_alone = SigmaPiTracker(SigmaPiParameters(cues=("motion",)), seed=1)
    assert not follow(motion_alone, images, box_at(path(0)))[-1].found


@pytest.mark.slow
def test_whoever_leaves_is_lost_and_found_again_by_what_was_learned() -> None:
    """Motion is switched off: only memories that nothing else was written into can find the person."""
    parameters = SigmaPiParameters(cues=("colour", "shape"))
    images = [shown(path(k) if k < 30 or k >= 90 else None, k) for k in range(90)]
    images += [shown((150.0, 100.0), k) for k in range(90, 130)]
    estimates = follow(SigmaPiTracker(parameters, seed=1), images, box_at(path(0)))
    assert all(estimate.found for estimate in estimates[:30])
    assert not any(estimate.found for estimate in estimates[36:90])
    assert all(is_on(estimate, (150.0, 100.0)) for estimate in estimates[-15:])


def test_features_of_furniture_lower_the_shape_cue() -> None:
    window = np.array([box_at((60.0, 60.0))])
    cue = ShapeCue()
    cue.look(shown((60.0, 60.0), 0))
    cue.adapt(window[0])
    cue.look(shown((60.0, 60.0), 1))
    before = cue.activity(window)[0]
    cue.give([shown((60.0, 60.0), 2)])
    cue.look(shown((60.0, 60.0), 1))
    assert before > 0.5 > 0.1 > cue.activity(window)[0]


def test_estimates_are_whole_and_in_the_pixels_of_large_frames() -> None:
    factor = 4
    images = [cv2.resize(shown(path(k), k), None, fx=factor, fy=factor) for k in range(25)]
    left, top, width, height = (factor * value for value in box_at(path(0)))
    estimates = follow(SigmaPiTracker(seed=1), images, (left, top, width, height))
    for k, estimate in enumerate(estimates):
        assert is_on(replace(estimate, box=tuple(value / factor for value in estimate.box)), path(k))
        assert estimate.particles.shape == (50, 4) and estimate.weights.sum() == pytest.approx(1.0)
        assert set(estimate.cues) == {*CUES, *(f"reliability {name}" for name in TERM_NAMES)}
        assert all(0.0 <= estimate.cues[name] <= 1.0 for name in CUES)
        assert 0.0 <= estimate.confidence <= 1.0 and estimate.pan is None


def test_cues_that_are_not_used_have_no_part() -> None:
    images = [shown(path(k), k) for k in range(20)]
    found = follow(SigmaPiTracker(SigmaPiParameters(cues=("motion",)), seed=1), images, None)[-1]
    assert found.cues["colour"] == found.cues["shape"] == 0.0
    assert [name for name in TERM_NAMES if found.cues[f"reliability {name}"] != 0.0] == ["motion"]


def test_a_proposal_draws_particles_to_its_place() -> None:
    dynamics = BoxDynamics(0.6, 0.12, guided_share=0.5)
    tracker = SigmaPiTracker(SigmaPiParameters(dynamics=dynamics), seed=1)
    follow(tracker, [shown(path(k), k) for k in range(10)], box_at(path(0)))
    place = np.array([160.0, 120.0])
    guided = tracker.step(shown(None, 10), Proposal(place, 4.0 * np.eye(2)))
    centres = guided.particles[:, :2] + guided.particles[:, 2:] / 2.0
    assert np.mean(np.abs(centres - place).max(axis=1) < 8.0) > 0.3


def test_a_black_video_has_nobody_in_it() -> None:
    black = np.zeros((150, 200, 3), np.uint8)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        estimates = follow(SigmaPiTracker(seed=0), [black] * 10, None)
        late = follow(SigmaPiTracker(seed=0), [black] * 10, (10.0, 10.0, 30.0, 30.0))
    assert not any(estimate.found for estimate in estimates) and not late[-1].found
    assert np.isfinite(estimates[-1].box).all() and estimates[-1].weights.sum() == pytest.approx(1.0)


def test_frames_of_another_size_and_steps_without_a_start_are_refused() -> None:
    tracker = SigmaPiTracker(seed=0)
    with pytest.raises(InputError, match="start"):
        tracker.step(ROOM)
    tracker.start(ROOM, None)
    with pytest.raises(InputError, match="200 × 150"):
        tracker.step(ROOM[:100])
    with pytest.raises(InputError, match="particles"):
        SigmaPiParameters(particles=0)
    with pytest.raises(InputError, match="smell"):
        SigmaPiParameters(cues=("smell",))


def test_somebody_who_comes_into_a_rendered_room_is_found() -> None:
    sequence = ceiling_sequence(
        KINDS["person moving 1"], np.random.default_rng(0), frames=50, empty=8, oversampling=1
    )
    tracker = SigmaPiTracker(seed=0)
    good = []
    for k, frame in enumerate(sequence):
        estimate = tracker.step(frame.image) if k else tracker.start(frame.image, None)
        box = None if frame.target is None else frame.target.body_box
        if box is None:
            assert not estimate.found
        else:
            left, top, width, height = box
            x, y = estimate.centre
            good.append(estimate.found and left < x < left + width and top < y < top + height)
    assert np.mean(good[15:]) > 0.9


def test_missing_and_mismatch_are_counted_as_in_the_papers_table() -> None:
    tally, label = Tally(), (10.0, 10.0, 20.0, 20.0)
    estimate = SigmaPiTracker(seed=0).start(ROOM, None)
    inside = replace(estimate, found=True, box=(15.0, 15.0, 4.0, 4.0))
    outside = replace(estimate, found=True, box=(26.0, 15.0, 10.0, 4.0))
    lost = replace(inside, found=False)
    for one, times in ((inside, 5), (outside, 2), (lost, 1)):
        for _ in range(times):
            tally.add(one, label)
    tally.add(inside, None)
    tally.add(lost, None)
    tally.add(outside, label, counts=False)
    assert (tally.frames, tally.missing, tally.mismatch, tally.empty, tally.alarms) == (8, 1, 2, 2, 1)
    assert tally.success == 5 / 8 and len(tally.estimates) == 11


def test_people_of_a_recording_are_cut_where_frames_are_left_out(tmp_path: Path) -> None:
    numbers = [*range(3, 9), *range(12, 16)]
    (tmp_path / "frames" / "walk").mkdir(parents=True)
    for number in numbers:
        cv2.imwrite(str(tmp_path / "frames" / "walk" / f"{number:04d}.jpg"), np.full((20, 30, 3), number))
    (tmp_path / "xml").mkdir()
    box = '<box xc="10" yc="10" w="6" h="4"/>'
    frames = "".join(
        f'<frame number="{k}"><objectlist><object id="7">{box}</object></objectlist></frame>'
        for k in range(20)
    )
    (tmp_path / "xml" / "walk.xml").write_text(f"<dataset>{frames}</dataset>")
    found = recordings(tmp_path, ["walk", "missing"], 4)
    assert [one.numbers for one in found] == [tuple(range(3, 9)), tuple(range(12, 16))]
    assert [int(image.mean()) for image in found[1].images()] == list(range(12, 16))
    assert found[0].labels[3] == (7.0, 8.0, 6.0, 4.0)
    assert len(recordings(tmp_path, ["walk"], 5)) == 1


# -- as the paper has it ------------------------------------------------------------------------------------


def test_the_papers_form_averages_all_particles_and_keeps_the_reliability_of_motion() -> None:
    tracks = {}
    for name, parameters in (("ours", SigmaPiParameters()), ("paper", SigmaPiParameters.of_the_paper())):
        tracker = SigmaPiTracker(parameters, seed=0)
        found = follow(tracker, [shown(path(k), k) for k in range(25)], box_at(path(0)))
        tracks[name] = np.array([[one.cues[f"reliability {term}"] for term in TERM_NAMES] for one in found])
        off = [
            np.abs(states_of(np.array([one.box]))[0] - one.weights @ states_of(one.particles)).max()
            for one in found[1:]
        ]
        assert (max(off) < 1e-9) == (name == "paper")
    assert (tracks["paper"][:, 0] == 1.0).all()
    assert np.ptp(tracks["ours"][:, 0]) > 0.05
    assert (np.ptp(tracks["paper"][:, 1:], axis=0) > 0.05).all()
    assert not SigmaPiParameters.of_the_paper().views
    with pytest.raises(InputError, match="smell"):
        SigmaPiParameters(fixed=("smell",))


def test_the_papers_weights_are_equation_4_where_the_last_frame_left_the_particles() -> None:
    parameters = replace(SigmaPiParameters.of_the_paper(), cues=("motion", "colour"))
    tracker = SigmaPiTracker(parameters, seed=0)
    first, *images = [shown(path(k), k) for k in range(12)]
    tracker.start(first, box_at(path(0)))
    for image in images:
        before, reliabilities = tracker._cloud.boxes, tracker.reliabilities
        estimate = tracker.step(image)
        weights = output(tracker._activities(before), reliabilities)
        np.testing.assert_allclose(estimate.weights, weights / weights.sum(), atol=1e-12)
        assert not np.allclose(estimate.particles, before)


@pytest.mark.parametrize(("printed", "share"), [(True, 0.05), (False, 0.5)])
def test_the_printed_form_assigns_5_per_cent_to_random_places_also_when_nobody_is_found(
    printed: bool, share: float
) -> None:
    parameters = SigmaPiParameters.of_the_paper() if printed else SigmaPiParameters()
    tracker = SigmaPiTracker(replace(parameters, particles=400), seed=0)
    black = np.zeros((150, 200, 3), np.uint8)
    tracker.start(black)
    moved = []
    for _ in range(20):
        tracker.step(black)
        # A particle that was assigned to a place has no step behind it in its place.
        moved.append((tracker._cloud.now[:, :2] == tracker._cloud.before[:, :2]).all(axis=1).mean())
    assert np.mean(moved) == pytest.approx(share, abs=0.02)
