"""Class likelihoods whose errors persist: what they weigh does not depend on the frame rate."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from walks import walk

import graphtrack as gt
from graphtrack.geometry.angles import difference
from graphtrack.model.parameters import LikelihoodParameters, Parameters
from graphtrack.model.terms.classes import class_evidence, class_weights, seconds_since_classes
from graphtrack.tracks.track import Track


def evidence(classes: np.ndarray, seconds: float, time: float = 1.0) -> np.ndarray:
    """Those of a second row, so many seconds after a first one."""
    both, t = np.concatenate([classes, classes]), np.array([0.0, seconds])
    channel = np.full((2, 8), 1.0)
    inputs = {"body_persistence": np.full(2, time)}
    track = Track(1, np.arange(2), t, np.zeros((2, 2)), body_likelihood=channel, inputs=inputs)
    likelihood = LikelihoodParameters()
    weight = class_weights(track, "body", likelihood)
    found = class_evidence(both, np.full(2, np.nan), weight, 0.05, likelihood)[1:]
    return np.asarray(found / found.sum())


@given(st.lists(st.floats(0.01, 1.0), min_size=8, max_size=8), st.integers(1, 40))
def test_frames_within_the_correlation_time_count_together_as_one(shares: list[float], count: int) -> None:
    """So many frames, each that share of T after the one before, are one frame T after the one before."""
    classes = np.array([shares])
    apart = evidence(classes, 0.999_999)
    together = evidence(classes, 0.999_999 / count) ** count
    np.testing.assert_allclose(together / together.sum(), apart, rtol=1e-6)


def test_longer_apart_or_without_a_correlation_time_each_counts_in_full() -> None:
    classes = np.array([[0.7, 0.2, 0.1, 0.0]])
    for seconds, time in ((1.0, 1.0), (9.0, 1.0), (0.04, 0.0), (0.001, 1.0)):
        np.testing.assert_allclose(evidence(classes, seconds, time), classes)
    assert evidence(classes, 0.04).max() < 0.4


def test_a_negative_time_is_one_error() -> None:
    track = replace(walk(3, classes=True), inputs={"head_persistence": np.array([1.0, -1.0, 1.0])})
    with pytest.raises(gt.InputError, match=r"head_persistence' of -1 s"):
        gt.smooth(track, "joint", constants="default")


def test_scores_that_are_all_zero_and_missing_ones_stay() -> None:
    classes = np.array([[0.0] * 4, [np.nan] * 4, [1.0, 0.0, 0.0, 0.0]])
    found = class_evidence(classes, np.full(3, np.nan), np.full(3, 0.1), 0.0, LikelihoodParameters())
    assert not found[0].any() and np.isnan(found[1]).all() and (found[2] == [1.0, 0.0, 0.0, 0.0]).all()


def persistent(preset: str, **values: Any) -> gt.Model:
    return gt.Model(preset, Parameters(likelihood=LikelihoodParameters(class_correlation_time=1.0, **values)))


def with_empty_rows(track: Track, more: int) -> Track:
    """The track with rows without an observation between its own."""
    n = (len(track) - 1) * more + 1
    t = np.interp(np.arange(n) / more, np.arange(len(track)), track.t)
    rows = np.arange(0, n, more)

    def spread(values: Any) -> Any:
        if values is None:
            return None
        found = np.full((n, *values.shape[1:]), np.nan)
        found[rows] = values
        return found

    fields = ("position", "body", "head", "body_kappa", "head_kappa", "body_likelihood", "head_likelihood")
    channels = {name: spread(getattr(track, name)) for name in fields}
    return Track(track.track_id, np.arange(n), t, **channels)


def test_rows_without_an_observation_change_no_weight() -> None:
    track = walk(30, classes=True)
    dense = with_empty_rows(track, 4)
    for name in ("body", "head"):
        expected = seconds_since_classes(track, name)
        np.testing.assert_allclose(seconds_since_classes(dense, name)[::4], expected, atol=1e-9)
    slim, full = (gt.smooth(one, persistent("joint"), constants="default") for one in (track, dense))
    assert np.abs(difference(slim.body, full.body[::4])).max() < np.radians(6.0)


@pytest.mark.parametrize("engine", ["chain", "fixed-lag", "isam2"])
def test_online_answers_know_the_likelihoods_before(engine: Any) -> None:
    """The last online answer is the smoother's, also after a saved state."""
    track = replace(walk(25, classes=True), body_kappa=None, head_kappa=None)
    model = persistent("joint")
    offline = gt.smooth(track, model, constants="default")
    smoother = gt.OnlineSmoother(model, constants="default", engine=engine, lag=30.0)
    for k, one in enumerate(gt.observations(track)):
        if k == 12:
            smoother = gt.OnlineSmoother.from_state(
                smoother.state(), model, constants="default", engine=engine, lag=30.0
            )
        estimate = smoother.update(one)
    tolerance = 1e-3 if engine == "chain" else 0.1  # they end within a fraction of the deviation
    for name in ("body", "head"):
        assert abs(difference(getattr(estimate, name), getattr(offline, name)[-1])) < tolerance


def test_a_classifier_with_errors_that_persist_is_not_overconfident() -> None:
    """Autocorrelations whose integral is T = 1 s: intervals of people who stand hold, at 5 and at 25 Hz."""
    for hz in (5.0, 25.0):
        inside = []
        for seed in range(12):
            rng = np.random.default_rng(seed)
            t = np.arange(0.0, 8.0, 1.0 / hz)
            error = np.zeros(len(t))
            keep = np.exp(-2.0 / hz)
            for k in range(len(t)):
                fresh = rng.normal(0.0, np.radians(40.0))
                error[k] = fresh if k == 0 else keep * error[k - 1] + np.sqrt(1.0 - keep**2) * fresh
            centres = np.arange(8) * np.pi / 4.0
            classes = np.exp(2.05 * np.cos(centres - (0.3 + error)[:, None]))
            track = Track(1, np.arange(len(t)), t, np.zeros((len(t), 2)), body_likelihood=classes)
            found = gt.smooth(track, persistent("separate", class_outlier_probability=0.0))
            inside.append(np.abs(difference(found.body, 0.3)) < 1.96 * found.std("body"))
        assert np.mean(inside) > 0.85, hz
