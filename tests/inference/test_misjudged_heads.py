"""Heads that a classifier sees turned persistently, with a probability in the modes of `full`."""

from dataclasses import replace

import numpy as np
import pytest
from mode_recursions import both_ways
from scipy import special
from walks import errors, people

from graphtrack.geometry.angles import class_centres, class_kappa, difference, mean_absolute_error, unit
from graphtrack.inference.online import OnlineSolver
from graphtrack.model import GaitParameters, Model
from graphtrack.model.observation import observations
from graphtrack.model.terms.couplings import BASE, BINS, NEAR, ROW, gait_of
from graphtrack.model.terms.orientation import add_class_quarter_turns, add_classes
from graphtrack.simulation.degrade import add_class_likelihoods, confusion_matrix
from graphtrack.smoothing import smooth, track_online
from graphtrack.tracks.track import HEAD_CLASSES, Track, TrackSet


def classified(tracks: TrackSet, turned: int, seed: int) -> TrackSet:
    """Body and head as a classifier sees them, the head so many classes further round than it is."""
    bodies, heads = (confusion_matrix(n, flipped=0.1, at_random=0.4) for n in (8, HEAD_CLASSES))
    seen = add_class_likelihoods(tracks, body=bodies, head=heads, rng=np.random.default_rng(seed))
    return seen.map(
        lambda track: replace(track, head_likelihood=np.roll(track.head_likelihood, turned, axis=1))
    )


def with_bias(share: float) -> Model:
    full = Model("full")
    gait = replace(full.parameters.gait, head_class_bias=share)
    return full.with_parameters(replace(full.parameters, gait=gait))


def test_a_head_that_no_body_has_is_the_classifiers() -> None:
    seen = classified(people(0.0, 4, seed=31, seconds=4.0), turned=5, seed=32)
    models = with_bias(0.0), Model("full")
    sure, (body, head) = (errors(seen, smooth(seen, model)) for model in models)
    assert body < 12.0 and head < min(20.0, 0.7 * sure[1])


def test_a_head_that_looks_aside_is_believed_all_the_same() -> None:
    aside = np.radians(30.0)
    seen = classified(people(0.0, 4, seed=33, seconds=4.0, head=aside), turned=0, seed=34)
    found = list(smooth(seen, "full"))
    offsets = np.concatenate([difference(one.head, one.body) for one in found])
    assert np.mean(offsets) > 0.6 * aside and errors(seen, found)[1] < 12.0


def test_angles_have_no_such_doubts() -> None:
    tracks = people(0.0, 2, seed=35, seconds=3.0, head=np.radians(40.0))
    sure, default = with_bias(0.0), Model("full")
    for a, b in zip(smooth(tracks, sure), smooth(tracks, default), strict=True):
        np.testing.assert_array_equal(a.head, b.head)
        np.testing.assert_array_equal(a.covariance, b.covariance)
    np.testing.assert_array_equal(
        track_online(tracks.by_id(0), sure).head, track_online(tracks.by_id(0), default).head
    )


def swinging(seed: int) -> tuple[Track, np.ndarray]:
    """A person who walks along x and swings the head by 70 degrees, and the head as classified."""
    rng, n = np.random.default_rng(seed), 100
    t = np.arange(n) / 25.0
    head = np.radians(70.0) * np.sin(2.0 * np.pi * t / 4.0)
    seen = head + rng.vonmises(0.0, 8.0, n)
    likelihood = np.exp(4.0 * (np.cos(class_centres(HEAD_CLASSES) - seen[:, None]) - 1.0))
    position = np.column_stack([t, 0.0 * t]) + rng.normal(0.0, 0.02, (n, 2))
    likelihood /= likelihood.sum(axis=1, keepdims=True)
    given = {"position_std": np.full(n, 0.02), "head_likelihood": likelihood, "true_head": head}
    return Track(seed, np.arange(n), t, position, **given), seen


@pytest.mark.parametrize("preset", ["separate", "joint", "full"])
def test_smoothing_improves_a_head_that_swings_and_is_seen_without_bias(preset: str) -> None:
    """Against the observed angles themselves."""
    for seed in range(3):
        track, seen = swinging(seed)
        found = smooth(TrackSet((track,)), preset).tracks[0]
        assert mean_absolute_error(found.head, track.true_head) < mean_absolute_error(seen, track.true_head)


def test_the_classifiers_share_of_an_offset_is_bayes() -> None:
    """Against whose it is as a state of its own, for offsets that neither drift nor change."""
    share, kappa, rng = 0.3, 2.0, np.random.default_rng(36)
    still = GaitParameters(head_drift=0.0, head_switching=0.0, glance_share=0.0)
    both = gait_of(replace(still, head_class_bias=share, head_class_bias_kappa=kappa))
    row = rng.normal(0.0, 2.0, (5, BASE))
    _, smoothed = both_ways(np.r_[0.0, np.full(4, 0.1)], row, both.classified_head, np.zeros(ROW))

    evidence, circle = np.exp(row.sum(axis=0)), 2.0 * np.pi * np.arange(BINS) / BINS
    turned = np.exp(kappa * np.cos(circle)) / (BINS * special.i0(kappa))
    free = (1.0 - share) * (1.0 - both.head.aligned) * both.head.anywhere * evidence[:BINS]
    near = (1.0 - share) * both.head.aligned * both.head.share * evidence[BINS:]
    mistaken = share * turned * evidence[:BINS]
    total = free.sum() + near.sum() + mistaken.sum()
    own = both.classified_head.own
    for of_frame in smoothed:
        np.testing.assert_allclose(of_frame[:BINS] * own, free / total, atol=1e-9)
        np.testing.assert_allclose(of_frame[:BINS] * (1.0 - own), mistaken / total, atol=1e-9)
        np.testing.assert_allclose(of_frame[BINS:BASE], near / total, atol=1e-9)
    assert len(of_frame) == BINS + NEAR + BINS


def test_what_was_seen_by_a_classifier_stays_so_while_the_head_is_hidden() -> None:
    """Beyond the window, and in a saved state."""
    (seen,) = classified(people(0.0, 1, seed=37, seconds=5.0), turned=5, seed=38)
    hidden = np.arange(len(seen)) >= 60
    seen = replace(seen, head_likelihood=np.where(hidden[:, None], np.nan, seen.head_likelihood))
    rows = list(observations(seen))
    smoother = OnlineSolver("full", lag=1.0)
    for one in rows[:-1]:
        smoother.update(one)
    again = OnlineSolver.from_state(smoother.state(), "full", lag=1.0)
    expected, found = smoother.update(rows[-1]), again.update(rows[-1])
    assert abs(difference(expected.head, expected.body)) < np.radians(30.0)
    assert found.head == expected.head


@pytest.mark.parametrize("doubt", [0.0, 0.4, 1.0])
def test_doubted_classes_are_mixed_with_what_says_nothing(doubt: float) -> None:
    """Their lost weight is spread over the circle: by quadrature, with the gradient by differences."""
    n, rng = HEAD_CLASSES, np.random.default_rng(39)
    heights = rng.random(n + 1)
    heights /= heights.sum()
    kappa, directions = class_kappa(n), unit(class_centres(n))
    angles = np.linspace(-np.pi, np.pi, 720, endpoint=False)
    cos, sin = np.cos(angles), np.sin(angles)
    classes = (
        np.exp(kappa * (cos[:, None] * directions[:, 0] + sin[:, None] * directions[:, 1] - 1.0))
        @ heights[:n]
    )
    expected = -np.log(heights[n] + (1.0 - doubt) * classes + doubt * classes.mean())

    def cost(angle: float) -> tuple[float, float]:
        gradient, hessian = np.zeros(6), np.zeros((6, 6))
        given = (np.cos(angle), np.sin(angle), 5, heights, directions, kappa, doubt, True)
        return float(add_classes(*given, gradient, hessian)), float(gradient[5])

    found = np.array([cost(angle) for angle in angles.tolist()])
    np.testing.assert_allclose(found[:, 0] - 2.0 * kappa, expected, atol=1e-5)
    step = 1e-5
    slope = [(cost(a + step)[0] - cost(a - step)[0]) / (2.0 * step) for a in angles[::40].tolist()]
    np.testing.assert_allclose(found[::40, 1], slope, atol=1e-6)
    quarters = np.zeros(4)
    add_class_quarter_turns(cos[7], sin[7], heights, directions, kappa, doubt, quarters)
    np.testing.assert_allclose(quarters, expected[[7, 187, 367, 547]], atol=1e-5)
