"""Rows of estimates and truth are paired by their times, whatever the rates and the frame numbers."""

import numpy as np
import pytest
from command import ran
from hypothesis import given
from hypothesis import strategies as st

import graphtrack as gt

RATES = st.sampled_from([1.0, 2.5, 10.0, 25.0, 100.0])


def people(hz, noise=0.0, offset=0.0, jitter=0.0, seed=0):
    """Three people who walk apart, each with times of their own."""
    rng = np.random.default_rng(seed)
    tracks = []
    for k in range(3):
        t = np.arange(0.0, 20.0, 1.0 / hz) + offset * k
        t = t + rng.uniform(-jitter, jitter, len(t))
        position = np.column_stack([1.2 * t, np.full(len(t), 2.0 * k)])
        position = position + rng.normal(0.0, noise, position.shape)
        tracks.append(gt.Track(k + 1, frame=np.arange(len(t)), t=t, position=position))
    return gt.TrackSet(tuple(tracks))


@given(RATES, RATES, st.integers(0, 99))
def test_rates_change_no_identity(hz, of_truth, seed):
    found = gt.score(people(hz, 0.03, seed=seed), people(of_truth), metres=0.5).together
    assert found.idf1 > 0.97 and found.switches == 0
    if min(hz, of_truth) < max(hz, of_truth):
        assert abs(found.frames - 20.0 * min(hz, of_truth)) <= 1


@given(st.floats(0.0, 0.03), st.floats(0.0, 0.004))
def test_each_sensor_may_have_a_clock_of_its_own(offset, jitter):
    found = gt.score(people(10, 0.03, offset, jitter), people(10, 0.0, offset, jitter), metres=0.5).together
    assert found.idf1 > 0.98 and found.switches == 0


def test_frames_without_estimates_are_missed():
    estimates = people(10, 0.03)
    part = gt.TrackSet(tuple(one[(one.t < 5.0) | (one.t > 15.0)] for one in estimates))
    found = gt.score(part, people(100), metres=0.5).together
    assert found.recall == pytest.approx(0.5, abs=0.02) and found.precision == 1.0


def test_the_command_says_that_it_compares_by_time(cwd):
    gt.write(people(10, 0.03), "found.csv")
    gt.write(people(100), "truth.csv")
    done = ran("score", "found.csv", "--truth", "truth.csv", program="graphtrack")
    assert "compared by time" in done.stderr and "10 Hz and 100 Hz" in done.stderr
