"""Copies of online smoothers and trackers: independent of the original, and equal to it from then on."""

from __future__ import annotations

import copy
import pickle
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import graphtrack as gt

COPIES = {
    "copy": copy.copy,
    "deepcopy": copy.deepcopy,
    "pickle": lambda one: pickle.loads(pickle.dumps(one)),
}

_near = st.floats(-3.0, 3.0)
_observed = st.builds(
    gt.Observation,
    t=st.just(0.0),
    position=st.none() | st.tuples(_near, _near),
    body=st.none() | _near,
    head=st.none() | _near,
)
_frames = st.lists(st.tuples(st.sampled_from([0.04, 0.2, 0.4, 1.5]), _observed), min_size=2, max_size=12)


@pytest.mark.parametrize("way", COPIES)
@pytest.mark.parametrize("engine", ["chain", "fixed-lag"])
def test_copies_of_a_smoother_go_their_own_way(way, engine):
    smoother = gt.OnlineSmoother("joint", engine=engine, lag=1.0)
    for k in range(15):
        smoother.update(gt.Observation(t=0.1 * k, position=(0.1 * k, 0.01 * k), head=0.1))
    before = smoother.state()
    copied = COPIES[way](smoother)
    copied.update(gt.Observation(t=1.5, position=(5.0, 5.0)))
    assert smoother.state() == before
    copied = COPIES[way](smoother)
    for one in (smoother, copied):
        last = one.update(gt.Observation(t=1.5, position=(1.5, 0.15)))
    assert np.array_equal(last.position, smoother.last.position)
    assert smoother.state() == copied.state()


@pytest.mark.parametrize("way", COPIES)
def test_copies_of_a_tracker_go_their_own_way(way):
    tracker = gt.OnlineTracker("joint", scene={"clutter_density": 1e-4}, lag=1.0)
    for k in range(15):
        tracker.update(0.1 * k, [(0.1 * k, 0.0), (3.0 - 0.1 * k, 2.0)])
    before = tracker.state()
    copied = COPIES[way](tracker)
    copied.update(1.5, [(5.0, 5.0)])
    assert tracker.state() == before
    copied = COPIES[way](tracker)
    assert np.array_equal(copied.forecast(1.0).position, tracker.forecast(1.0).position)
    for one in (tracker, copied):
        one.update(1.5, [(1.5, 0.0), (1.5, 2.0)])
    assert tracker.state() == copied.state()


@settings(max_examples=20, deadline=None)
@given(
    way=st.sampled_from([*COPIES]),
    frames=_frames,
    cut=st.integers(0, 11),
    model=st.sampled_from([None, "joint", "social"]),
)
def test_a_copied_smoother_continues_to_the_same_bits(way, frames, cut, model):
    smoother, t = gt.OnlineSmoother(model, lag=1.0), 0.0
    for dt, observation in frames[:cut]:
        t += dt
        smoother.update(replace(observation, t=t))
    copied = COPIES[way](smoother)
    for dt, observation in frames[cut:]:
        t += dt
        found, expected = (one.update(replace(observation, t=t)) for one in (copied, smoother))
        assert found.position.tobytes() == expected.position.tobytes()
        assert found.covariance.tobytes() == expected.covariance.tobytes()
        assert repr((found.body, found.head, found.status)) == repr(
            (expected.body, expected.head, expected.status)
        )


@settings(max_examples=4, deadline=None)
@given(
    way=st.sampled_from([*COPIES]),
    frames=st.lists(st.lists(st.tuples(_near, _near), max_size=3), min_size=2, max_size=10),
    cut=st.integers(0, 9),
    forecasts=st.booleans(),
    model=st.sampled_from([None, "social"]),
)
def test_a_copied_tracker_continues_to_the_same_bits(way, frames, cut, forecasts, model):
    def advance(tracker, k):
        people = tracker.update(0.4 * k, frames[k])
        ahead = tracker.forecast(0.8).position if forecasts and k % 2 else np.zeros(0)
        return ahead.tobytes(), [(one.track_id, one.position.tobytes()) for one in people]

    tracker = gt.OnlineTracker(model, lag=1.0)
    for k in range(min(cut, len(frames))):
        advance(tracker, k)
    copied = COPIES[way](tracker)
    for k in range(cut, len(frames)):
        assert advance(copied, k) == advance(tracker, k)
    assert copied.state() == tracker.state()
