"""The plain tracker equals its documented filter, and confirms and deletes tracks by its rules."""

import numpy as np
import pytest
from filterpy.kalman import KalmanFilter

from graphtrack import InputError
from graphtrack.baselines.hungarian import HungarianParameters, HungarianTracker, track_detections
from graphtrack.constant_velocity import process_noise, transition_matrix
from graphtrack.tracks.detections import Detections

OPEN = HungarianParameters(gate=100.0, speed_std=1.0, hits=1, frames=1, coasting=10.0)


GATED = HungarianParameters(0.1, 0.1, 0.5, gate=3.0, hits=1, frames=1)


def walk(n: int, start=(0.0, 0.0), velocity=(0.5, 0.1)) -> np.ndarray:
    return np.asarray(start) + np.outer(np.arange(n), velocity)


def detections_of(rows: list[tuple[int, np.ndarray]], step: float = 0.4) -> Detections:
    frame = np.array([k for k, _ in rows])
    return Detections(frame, step * frame, np.array([place for _, place in rows]))


def test_one_person_is_filtered_as_filterpy_does() -> None:
    rng = np.random.default_rng(0)
    t = np.cumsum(rng.uniform(0.2, 0.6, 30))
    std = rng.uniform(0.05, 0.3, 30)
    places = walk(30) + std[:, None] * rng.standard_normal((30, 2))
    tracker = HungarianTracker(OPEN)
    oracle = KalmanFilter(4, 2)
    oracle.H = np.eye(2, 4)
    oracle.x = np.array([*places[0], 0.0, 0.0])
    oracle.P = np.diag([std[0] ** 2, std[0] ** 2, 1.0, 1.0])
    for k in range(30):
        missed = k in (7, 8, 20)
        found = tracker.step(t[k], places[[k]][: 1 - missed], std[[k]][: 1 - missed])
        if k:
            dt = t[k] - t[k - 1]
            oracle.predict(F=transition_matrix(dt), Q=process_noise(dt, OPEN.acceleration_density))
            if not missed:
                oracle.update(places[k], R=std[k] ** 2 * np.eye(2))
        assert found.detected.tolist() == [not missed] and found.people.tolist() == [0]
        np.testing.assert_allclose(found.mean[0], oracle.x, rtol=1e-9)
        np.testing.assert_allclose(found.covariance[0], oracle.P, rtol=1e-8, atol=1e-12)


@pytest.mark.parametrize(
    ("hits", "frames", "seen", "confirmed"),
    [
        (1, 1, "1", 0),
        (2, 2, "11", 1),
        (2, 2, "101", None),
        (2, 3, "101", 2),
        (3, 5, "10101", 4),
        (3, 5, "100101", None),
        (3, 4, "1101", 3),
    ],
)
def test_people_are_believed_after_so_many_hits_of_so_many_frames(hits, frames, seen, confirmed) -> None:
    tracker = HungarianTracker(HungarianParameters(hits=hits, frames=frames))
    places = walk(len(seen))
    first = None
    for k, hit in enumerate(seen):
        found = tracker.step(0.4 * k, places[[k]] if hit == "1" else np.empty((0, 2)))
        if first is None and len(found.people):
            first = k
        assert (found.identity >= 0).all() == (first is not None or hit == "0")
    assert first == confirmed


@pytest.mark.parametrize(("gap", "same"), [(1, True), (5, True), (6, False)])
def test_who_is_not_seen_for_longer_than_the_gap_is_given_up(gap: int, same: bool) -> None:
    parameters = HungarianParameters(longest_gap=2.4, coasting=0.8, gate=10.0)
    places = walk(30)
    rows = [(k, places[k]) for k in range(30) if not 12 <= k < 12 + gap]
    found = track_detections(detections_of(rows), parameters)
    assert len(found) == (1 if same else 2)
    before = found.tracks[0]
    predicted = before.frame[before.observed == 0.0]
    np.testing.assert_array_equal(predicted, np.arange(12, 12 + min(gap, 2)))
    np.testing.assert_allclose(before.position[before.observed == 0.0], places[predicted], atol=0.1)


def test_what_is_said_of_a_frame_does_not_depend_on_what_comes_after() -> None:
    rng = np.random.default_rng(1)
    t = 0.4 * np.arange(40)
    frames = [rng.uniform(0.0, 6.0, (rng.integers(0, 7), 2)) for _ in t]
    whole, begun = HungarianTracker(), HungarianTracker()
    told = [whole.step(*one) for one in zip(t, frames, strict=True)]
    again = [begun.step(*one) for one in zip(t[:20], frames[:20], strict=True)]
    for one, other in zip(told[:20], again, strict=True):
        np.testing.assert_array_equal(one.identity, other.identity)
        np.testing.assert_array_equal(one.mean, other.mean)


def test_nobody_has_two_detections_in_a_frame_and_no_identity_comes_back() -> None:
    rng = np.random.default_rng(2)
    tracker, ended, alive = HungarianTracker(), set(), set()
    for k in range(200):
        found = tracker.step(0.4 * k, rng.uniform(0.0, 8.0, (rng.integers(0, 9), 2)))
        known = found.identity[found.identity >= 0].tolist()
        assert len(set(known)) == len(known) and set(known) <= set(found.people.tolist())
        assert np.array_equal(np.sort(known), np.sort(found.people[found.detected]))
        now = set(tracker._identity[tracker._identity >= 0].tolist())
        ended |= alive - now
        alive = now
        assert not ended & now


def test_the_order_of_detections_turning_and_moving_the_world_change_nobody() -> None:
    rng = np.random.default_rng(3)
    people = [walk(40, rng.uniform(-5.0, 5.0, 2), rng.uniform(-0.5, 0.5, 2)) for _ in range(8)]
    one, other = HungarianTracker(), HungarianTracker()
    turn = np.array([[0.6, -0.8], [0.8, 0.6]])
    pairs = {}
    for k in range(40):
        here = np.array([path[k] for path in people]) + 0.05 * rng.standard_normal((8, 2))
        order = rng.permutation(8)
        first = one.step(0.4 * k, here).identity
        second = other.step(0.4 * k, (here @ turn.T + [300.0, -70.0])[order]).identity
        for a, b in zip(first[order].tolist(), second.tolist(), strict=True):
            assert (a < 0) == (b < 0)
            assert pairs.setdefault(a, b) == b
    assert len(set(pairs.values())) == len(pairs)


def test_a_detection_beyond_the_gate_is_somebody_else() -> None:
    tracker = HungarianTracker(GATED)
    tracker.step(0.0, np.zeros((1, 2)))
    spread = np.sqrt(0.1**2 + 0.4**2 * 0.5**2 + 0.1 * 0.4**3 / 3.0 + 0.1**2)
    assert tracker.step(0.4, np.array([[3.01 * spread, 0.0]])).identity.tolist() == [1]
    tracker = HungarianTracker(GATED)
    tracker.step(0.0, np.zeros((1, 2)))
    assert tracker.step(0.4, np.array([[2.99 * spread, 0.0]])).identity.tolist() == [0]


def test_detections_by_frames_in_which_nobody_was_seen_have_times_of_their_own() -> None:
    places = walk(20)
    rows = [(10 * k, places[k]) for k in range(20) if k not in (7, 8)]
    found = track_detections(detections_of(rows, 0.04), HungarianParameters(coasting=2.0))
    (track,) = found
    np.testing.assert_array_equal(track.frame, 10 * np.arange(1, 20))
    np.testing.assert_allclose(track.t, 0.04 * track.frame)


def test_time_must_go_on() -> None:
    tracker = HungarianTracker()
    tracker.step(1.0, np.zeros((1, 2)))
    with pytest.raises(InputError, match="order of time"):
        tracker.step(1.0, np.zeros((1, 2)))
