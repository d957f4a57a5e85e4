"""Copies of online smoothers and trackers: independent of the original, and equal to it from then on."""

from __future__ import annotations

import copy
import pickle

import numpy as np
import pytest

import graphtrack as gt

COPIES = {"deepcopy": copy.deepcopy, "pickle": lambda one: pickle.loads(pickle.dumps(one))}


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
