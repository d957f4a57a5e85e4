"""The Sigma-Pi tracker: its cues and equations written out, synthetic videos, and recordings."""

import warnings
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from command import run

from graphtrack.errors import InputError
from graphtrack.experiments.harness import Settings, Table
from perception.experiments.head_trackers import heads_of, slower
from perception.experiments.sigma_pi_runs import (
    LEAST_LOST,
    METHODS,
    OURS,
    PersonJob,
    Tally,
    pooled_success,
    recordings,
)
from perception.experiments.yan_sigma_pi import (
    PAPER,
    difference_table,
    frames_of,
    jobs_of,
    loss_table,
    tables_of,
)
from perception.images.pixels import Image
from perception.trackers import color, sigma_pi_cues
from perception.trackers.sigma_pi import SigmaPiTracker
from perception.trackers.sigma_pi_cues import (
    ColourCue,
    MotionCue,
    ShapeCue,
    ViewCue,
    descriptors,
    integral,
    sums,
)
from perception.trackers.sigma_pi_network import (
    CUES,
    TERM_NAMES,
    SigmaPiParameters,
    adapted,
    output,
    products,
)
from perception.trackers.sigma_pi_redetection import Redetection
from perception.trackers.tracker import Box, BoxDynamics, BoxEstimate, Cloud, Proposal, predict, states_of

SIZE = (200, 150)
TARGET = (32, 36)
RATE = 12.5


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


@pytest.mark.slow
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


def test_a_step_without_a_start_and_bad_parameters_are_refused() -> None:
    with pytest.raises(InputError, match="start"):
        SigmaPiTracker(seed=0).step(ROOM)
    for wrong, said in (({"particles": 0}, "particles"), ({"cues": ("smell",)}, "smell")):
        with pytest.raises(InputError, match=said):
            SigmaPiParameters(**wrong)


def test_missing_and_mismatch_are_counted_as_in_the_papers_table() -> None:
    tally, label = Tally(RATE), (10.0, 10.0, 20.0, 20.0)
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
    assert tally.success == 5 / 8
    assert pooled_success([tally, Tally(RATE, frames=8)]) == 100.0 * 13 / 16


def test_a_run_without_a_success_to_the_end_has_lost_the_person_for_good() -> None:
    label, estimate = (10.0, 10.0, 20.0, 20.0), SigmaPiTracker(seed=0).start(ROOM, None)
    inside = replace(estimate, found=True, box=(15.0, 15.0, 4.0, 4.0))
    astray, gone = replace(inside, box=(40.0, 15.0, 4.0, 4.0)), replace(inside, found=False)
    frames = 25
    tally = Tally(frames / LEAST_LOST)
    for one in (*[astray] * frames, inside, *[gone, astray] * frames):
        tally.add(one, label)
    tally.add(gone, None)  # the person left: not a failure
    assert tally.lost_frames == tally.longest == 2 * frames
    tally.add(inside, label)
    assert tally.lost_frames == 0 and tally.longest == 2 * frames
    for _ in range(frames - 1):
        tally.add(gone, label)
    assert tally.lost_frames == 0
    tally.add(gone, label)
    assert tally.lost_frames == frames


def test_the_papers_total_is_over_frames_and_one_rate_differs_from_its_counts() -> None:
    assert sum(frames for frames, *_ in PAPER.values()) == 9155
    assert pooled_success([Tally(RATE, frames, *failures) for frames, *failures, _ in PAPER.values()]) == (
        pytest.approx(90.28, abs=0.005)
    )
    differing = [
        kind
        for kind, (frames, missing, mismatch, rate) in PAPER.items()
        if abs(100.0 * (1.0 - (missing + mismatch) / frames) - rate) > 0.011
    ]
    assert differing == ["person moving and sitting 2"]


def test_rendered_sequences_are_as_long_as_the_papers() -> None:
    drawn, real = jobs_of(Settings())
    assert {job.name: job.frames for job in drawn}.items() >= {k: v[0] for k, v in PAPER.items()}.items()
    assert not real and frames_of("person moving 2", quick=True) == 120


def test_tables_of_runs_weigh_frames_and_show_every_method() -> None:
    jobs = [PersonJob(kind, (0, 0, k), None) for kind in PAPER for k in range(2)]
    good, bad = Tally(RATE, 300, 0, 30, 0, 5), Tally(RATE, 100, 60, 0, 60, 60)
    results = [{name: good if name == OURS or k % 2 else bad for name in METHODS} for k in range(len(jobs))]
    tables = {
        one.title: one.records() for one in tables_of(Settings(), jobs, results) if isinstance(one, Table)
    }
    losses = next(rows for title, rows in tables.items() if title.startswith("Lost for good"))
    assert {row["method"] for row in losses} == set(METHODS)
    for row in losses:
        lost = row["method"] != OURS
        assert row["runs lost (%)"] == 50.0 * lost
        assert row["longest loss, greatest (frames)"] == (60 if lost else 5)
        assert row["frames lost (%)"] == pytest.approx(60.0 / 4.0 * lost)
        assert row["success (%)"] == pytest.approx(100.0 * (1.0 - (90.0 / 400.0 if lost else 0.1)))
    total = next(rows for title, rows in tables.items() if title.startswith("Paper / ours"))[-1]
    assert total["paper: success"] == pytest.approx(90.28, abs=0.005) and total["ours: missing"] == 0.0
    assert [total[f"ours: {name}"] for name in METHODS] == pytest.approx(
        [90.0 if name == OURS else 77.5 for name in METHODS]
    )
    kind = {"person moving 1": results[:2]}
    for row in difference_table(kind, np.random.default_rng(0)).records():
        assert row["ours better (sequences)"] == 1 and row["worse (sequences)"] == 0
    assert loss_table(kind, "one").records()[1]["success in the other runs (%)"] == 90.0


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


def test_sums_over_windows_are_direct_sums() -> None:
    rng = np.random.default_rng(0)
    saliency = rng.random((40, 60)).astype(np.float32)
    windows = np.column_stack([rng.integers(-20, 70, (200, 2)), rng.integers(1, 50, (200, 2))]).astype(float)
    found = sums(integral(saliency), windows)
    for (left, top, width, height), value in zip(windows.astype(int), found, strict=True):
        rows = slice(max(top, 0), max(top + height, 0))
        columns = slice(max(left, 0), max(left + width, 0))
        assert value == pytest.approx(saliency[rows, columns].sum(dtype=float), abs=1e-4)


def test_every_pixel_is_in_the_bin_of_its_hue_saturation_and_value() -> None:
    image = np.random.default_rng(0).integers(0, 256, (20, 30, 3), dtype=np.uint8)
    hsv = cv2.cvtColor(image, cv2.COLOR_BGR2HSV).astype(float)
    hues, saturations, values = color.BINS
    expected = np.floor(hsv[..., 0] / 180 * hues) * saturations * values
    expected += np.floor(hsv[..., 1] / 256 * saturations) * values + np.floor(hsv[..., 2] / 256 * values)
    np.testing.assert_array_equal(color.pixel_bins(image), expected)


def test_back_projection_finds_the_colour_of_the_target() -> None:
    image = np.full((60, 80, 3), (120, 130, 125), np.uint8)
    image[20:40, 30:50] = (40, 40, 200)
    inside = np.zeros((60, 80), np.float32)
    inside[20:40, 30:50] = 1.0
    numbers = color.pixel_bins(image)
    target, background = (
        color.weighed_histogram(numbers, inside),
        color.weighed_histogram(numbers, 1.0 - inside),
    )
    assert target.sum() == pytest.approx(1.0) and background.sum() == pytest.approx(1.0)
    share = color.target_share(target, background, 3.0)[numbers]
    assert share[inside > 0.0].min() > 0.95 and share[inside == 0.0].max() < 0.05
    assert color.weighed_histogram(numbers, 0.0 * inside).sum() == 0.0


def test_features_match_themselves_after_a_shift_of_the_image() -> None:
    picture = cv2.GaussianBlur(np.random.default_rng(0).normal(128, 90, (120, 160)), (0, 0), 2.0)
    grey = np.clip(128 + 6 * (picture - 128), 0, 255).astype(np.uint8)
    sift = cv2.SIFT_create()  # type: ignore[attr-defined]
    still, moved = (
        sigma_pi_cues.detect(sift, grey[:100, :140]),
        sigma_pi_cues.detect(sift, grey[8:108, 12:152]),
    )
    assert len(still.points) > 20
    np.testing.assert_allclose(np.linalg.norm(still.descriptors, axis=1), 1.0, atol=1e-5)
    match = (moved.descriptors @ still.descriptors.T).argmax(axis=1)
    shift = still.points[match] - moved.points
    assert np.mean(np.abs(shift - [12, 8]).max(axis=1) < 1.5) > 0.6
    assert np.mean(sigma_pi_cues.similarity(moved.descriptors, still.descriptors) >= 0.9) > 0.6
    assert len(sigma_pi_cues.detect(sift, np.zeros((50, 50), np.uint8)).points) == 0


LOBBY_SIZE = (160, 120)


def texture(width: int, height: int, level: float, grain: float, seed: int) -> np.ndarray:
    noise = cv2.GaussianBlur(np.random.default_rng(seed).normal(0, 1, (height, width)), (0, 0), grain)
    return np.clip(level + 20.0 * noise / noise.std(), 0, 255)


LOBBY, STANDS, WALKS = (
    texture(*LOBBY_SIZE, 120, 6, 0),
    texture(24, 16, 100, 1.5, 1),
    texture(24, 16, 150, 1.5, 2),
)
BOX: Box = (40.0, 60.0, 24.0, 16.0)


def lobby(k: int, seed: int = 0) -> np.ndarray:
    """A person who stands from the first frame on, and a person of the same colours who passes closely."""
    grey = LOBBY.copy()
    grey[60:76, 40:64] = STANDS
    left = 4 * k - 30
    lo, hi = max(left, 0), min(left + 24, LOBBY_SIZE[0])
    if hi > lo:
        grey[78:94, lo:hi] = WALKS[:, lo - left : hi - left]
    grey = grey + np.random.default_rng([seed, k]).normal(0, 2, grey.shape)
    return np.repeat(np.clip(grey, 0, 255).astype(np.uint8)[..., None], 3, axis=2)


def on(box: Box, label: Box = BOX) -> bool:
    x, y = box[0] + box[2] / 2.0, box[1] + box[3] / 2.0
    return bool(label[0] <= x <= label[0] + label[2] and label[1] <= y <= label[1] + label[3])


@pytest.mark.slow
def test_who_stands_from_the_first_frame_on_is_held_though_somebody_passes() -> None:
    held = []
    for seed in range(3):
        tracker = SigmaPiTracker(seed=seed)
        tracker.start(lobby(0), BOX)
        found = [tracker.step(lobby(k, seed)) for k in range(1, 60)]
        held += [one.found and on(one.box) for one in found]
    assert np.mean(held) > 0.98


def test_views_are_liker_the_person_than_what_is_beside_and_blank_walls() -> None:
    image = lobby(0)
    cue = ViewCue.of(image, np.array(BOX))
    assert cue is not None
    cue.look(lobby(1))
    left, top, width, height = BOX
    aside = np.array(
        [(left + dx * width, top + dy * height, width, height) for dx, dy in ((0.5, 0), (0, 0.5))]
    )
    activity = cue.activity(np.vstack([[BOX], aside]))
    assert activity[0] > 0.9 > 0.1 > activity[1:].max()
    cue.look(np.full((*LOBBY_SIZE[::-1], 3), 120, np.uint8))
    assert cue.gain(np.array([BOX]))[0] < 0.1


def test_the_first_view_is_never_forgotten_and_known_ones_are_not_added() -> None:
    cue = ViewCue(lobby(0), np.array(BOX))
    cue.look(lobby(1))
    for _ in range(5):
        cue.adapt(np.array(BOX))
    assert not cue._later
    for k in range(15):
        cue.look(np.repeat(texture(*LOBBY_SIZE, 120, 2, 10 + k).astype(np.uint8)[..., None], 3, axis=2))
        cue.adapt(np.array(BOX))
    assert len(cue._later) == 10
    cue.look(lobby(1))
    assert cue.gain(np.array([BOX]))[0] > 0.8


def test_boxes_that_are_too_small_or_blank_have_no_view() -> None:
    assert ViewCue.of(lobby(0), np.array([40.0, 60.0, 24.0, 8.0])) is None
    assert ViewCue.of(np.full((120, 160, 3), 90, np.uint8), np.array(BOX)) is None
    lengths = np.linalg.norm(descriptors(lobby(0)[..., 0], np.array([BOX, (0.0, 0.0, 30.0, 30.0)])), axis=1)
    assert (lengths <= 1.0 + 1e-6).all() and lengths[0] > 0.8


@pytest.mark.parametrize("box", [None, BOX])
def test_views_change_nothing_for_people_whom_nobody_shows(box: Box | None) -> None:
    ends = []
    for views in (True, False):
        tracker = SigmaPiTracker(SigmaPiParameters(views=views), seed=0)
        tracker.start(lobby(0), box)
        ends.append([tracker.step(lobby(k)).box for k in range(1, 10)][-1])
    assert (ends[0] == ends[1]) == (box is None)


def test_in_too_small_a_box_motion_keeps_its_reliability() -> None:
    tracker = SigmaPiTracker(seed=0)
    tracker.start(lobby(0), (40.0, 60.0, 10.0, 8.0))
    found = [tracker.step(lobby(k)) for k in range(1, 12)]
    assert {one.cues["reliability motion"] for one in found} == {1.0}
    assert len({one.cues["reliability colour"] for one in found}) > 1


# -- re-detection after a loss ------------------------------------------------------------------------------


def with_decoy(k: int) -> Image:
    """A person who walks; from frame 20 on, a decoy of their shape and another colour stands in their way."""
    decoy = np.ascontiguousarray(PERSON[..., ::-1])
    room = shown(path(19), 1000, person=decoy) if k >= 20 else ROOM
    return shown((path(k)[0] + 40.0 * (k >= 20), 110.0 if k >= 20 else path(k)[1]), k, room)


@pytest.mark.slow
def test_a_target_that_leaves_its_window_to_a_decoy_is_found_by_its_colours_where_pixels_change() -> None:
    ends = {}
    for redetect in (True, False):
        tracker = SigmaPiTracker(SigmaPiParameters(redetect=redetect), seed=1)
        found = follow(tracker, [with_decoy(k) for k in range(45)], box_at(path(0)))
        assert is_on(found[19], path(19))
        ends[redetect] = [is_on(one, (path(k)[0] + 40.0, 110.0)) for k, one in enumerate(found)][-10:]
    assert all(ends[True]) and not any(ends[False])


@pytest.mark.slow
def test_a_target_at_rest_is_not_left_for_a_person_of_other_colours() -> None:
    other = np.ascontiguousarray(PERSON[..., ::-1])
    images = []
    for k in range(100):
        at_rest = shown(path(min(k, 30)), 1000 + k)
        images.append(shown((2.0 * k - 40.0, 120.0), k, at_rest, other) if 40 <= k < 110 else at_rest)
    found = follow(SigmaPiTracker(seed=1), images, box_at(path(0)))
    assert all(is_on(one, path(30)) for one in found[30:])


def test_only_regions_whose_pixels_change_are_offered() -> None:
    """What is put down differs from the background for long, but does not change."""
    cue = MotionCue(ROOM, None)
    for k in range(12):
        put_down = shown((40.0, 40.0), 1000 + k) if k >= 2 else ROOM
        cue.look(shown((80.0 + 4.0 * k, 110.0), k, put_down))
    boxes, pixels = cue.regions()
    large = boxes[pixels > 200]
    assert cue.saliency[40, 40] == 1.0 and len(large) == 1
    np.testing.assert_allclose(large[0], box_at((124.0, 110.0)), atol=4.0)
    assert cue.changes_in(large[0]) and not cue.changes_in(np.array(box_at((40.0, 40.0))))


def test_a_region_is_accepted_when_it_was_more_similar_in_five_consecutive_frames() -> None:
    target, window = np.array(box_at((60.0, 60.0))), np.array(box_at((140.0, 100.0)))
    colour, image = ColourCue(ROOM), shown((60.0, 60.0), 0)
    colour.look(image)
    search = Redetection()
    assert search.search(window, target[None], colour, 0.1) is None
    search.learn(colour.histogram(target))
    nothing = np.zeros((0, 4))
    for pause in (nothing, window[None]):
        answers = [search.search(window, target[None], colour, 0.1) for _ in range(4)]
        answers.append(search.search(window, pause, colour, 0.1))
        assert all(answer is None for answer in answers)
    answers = [search.search(window, target[None], colour, 0.1) for _ in range(5)]
    assert answers[:4] == [None] * 4
    np.testing.assert_array_equal(answers[4], target)
    assert all(search.search(target, target[None], colour, 0.1) is None for _ in range(6))


def test_a_histogram_of_a_window_is_that_of_the_whole_image_by_the_kernel() -> None:
    colour = ColourCue(ROOM)
    colour.look(shown((60.0, 60.0), 0))
    for box in (box_at((60.0, 60.0)), box_at((3.0, 148.0)), (190.4, 20.3, 30.0, 12.7)):
        whole = color.weighed_histogram(
            color.pixel_bins(shown((60.0, 60.0), 0)), sigma_pi_cues.kernel(ROOM.shape, np.array(box))
        )
        np.testing.assert_allclose(colour.histogram(np.array(box)), whole, atol=1e-6)
    assert colour.histogram(np.array([300.0, 20.0, 30.0, 12.0])).sum() == 0.0


def test_a_lost_target_of_too_small_a_box_is_sought_near_its_last_place() -> None:
    black = np.zeros((150, 200, 3), np.uint8)
    lost = follow(SigmaPiTracker(seed=0), [black] * 30, (40.0, 30.0, 10.0, 8.0))[-10:]
    assert not any(one.found for one in lost)
    centres = np.concatenate([one.particles[:, :2] + one.particles[:, 2:] / 2.0 for one in lost])
    assert (np.abs(centres - [45.0, 34.0]) < 6.0 * np.array([10.0, 8.0])).all()


def test_folders_without_recordings_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="Town Centre"):
        heads_of(tmp_path, 1)
    assert run("evaluate", "heads", "--data", str(tmp_path)).returncode == 2


def test_slower_motion_is_that_of_many_steps() -> None:
    dynamics = BoxDynamics(size_std=0.0, size_persistence=0.0, reversion=0.0)
    n = 20_000
    start = np.tile([0.0, 0.0, 0.0, 0.0], (n, 1))
    cloud = Cloud(start, start, np.full(n, 1.0 / n))
    rng = np.random.default_rng(0)
    for _ in range(10):
        cloud = predict(cloud, np.zeros(2), dynamics, rng)
    once = predict(Cloud(start, start, np.full(n, 1.0 / n)), np.zeros(2), slower(dynamics, 10), rng)
    assert once.now[:, 0].std() == pytest.approx(cloud.now[:, 0].std(), rel=0.05)
