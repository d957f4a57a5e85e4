"""Probability that detections are right, by tracks that were held out."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import expit

from graphtrack.tracks.track import Track, TrackSet
from perception.detection.rescoring import Certainty, judged_by_other_frames

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
