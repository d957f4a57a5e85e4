"""Pedestrians of another model than the estimator's: their motion has the requested statistics."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from graphtrack.errors import InputError
from graphtrack.geometry.angles import difference, direction, wrap
from graphtrack.simulation.crowd import (
    StrollerParameters,
    full_turns_too_many,
    standing,
    strollers,
)

PLAIN = StrollerParameters(stops_per_minute=0.0, glances_per_minute=0.0)


def test_heads_lead_the_course_and_bodies_follow_it() -> None:
    people = strollers(np.random.default_rng(1), replace(PLAIN, head_lead=0.4), people=20, fps=25.0)
    leads = np.arange(-20, 21)
    for angle, lead in (("true_body", -0.15), ("true_head", 0.3)):
        errors = np.zeros(len(leads))
        for track in people:
            course = direction(np.gradient(track.true_position, track.t, axis=0))
            values = getattr(track, angle)
            for i, shift in enumerate(leads):
                there = np.clip(np.arange(len(track)) + shift, 0, len(track) - 1)
                errors[i] += np.mean(np.abs(difference(values, course[there])))
        assert leads[errors.argmin()] / 25.0 == pytest.approx(lead, abs=0.09)


def test_stops_and_glances_have_their_lengths() -> None:
    habits = StrollerParameters(turns_per_minute=0.0, stop_low=3.0, stop_high=3.5, glances_per_minute=0.0)
    people = strollers(np.random.default_rng(2), habits, people=20, fps=25.0)
    lengths = [
        track.t[end - 1] - track.t[begin]
        for track in people
        for begin, end in standing(track, slowest=0.02)
        if begin > 0 and end < len(track)
    ]
    assert len(lengths) > 20 and min(lengths) > 2.7 and max(lengths) < 3.6
    aside = strollers(np.random.default_rng(3), replace(PLAIN, glances_per_minute=10.0), people=20)
    off = np.abs(np.concatenate([difference(t.true_head, t.true_body) for t in aside]))
    none = strollers(np.random.default_rng(3), PLAIN, people=20)
    off_none = np.abs(np.concatenate([difference(t.true_head, t.true_body) for t in none]))
    assert np.mean(off > np.radians(30.0)) > np.mean(off_none > np.radians(30.0)) + 0.08


def test_noise_is_as_declared() -> None:
    people = strollers(np.random.default_rng(4), PLAIN, people=10, turned=0.1, position_std=0.2)
    off = np.concatenate([difference(t.head, t.true_head) for t in people])
    turned = np.abs(off) > np.radians(120.0)
    assert turned.mean() == pytest.approx(0.1, abs=0.02)
    kappa = 1.0 / np.radians(30.0) ** 2
    assert all(np.allclose(t.head_kappa, kappa) for t in people)
    assert np.concatenate([t.position - t.true_position for t in people]).std() == pytest.approx(
        0.2, rel=0.05
    )
    (bare,) = strollers(np.random.default_rng(5), PLAIN, people=1, body_std=None, declared=False, seconds=5.0)
    assert bare.body is None and bare.head_kappa is None and bare.true_body is not None


def test_a_turn_too_many_is_counted() -> None:
    people = strollers(np.random.default_rng(6), people=10)
    track = next(t for t in people if any(b > 0 and e < len(t) for b, e in standing(t)))
    right = replace(track, body=track.true_body)
    assert full_turns_too_many(right, track) == (0, len(standing(track)))
    begin, end = next((b, e) for b, e in standing(track) if b > 0 and e < len(track))
    ramp = np.clip((np.arange(len(track)) - begin) / (end - begin), 0.0, 1.0)
    wound = replace(track, body=wrap(track.true_body + 2.0 * np.pi * ramp))
    assert full_turns_too_many(wound, track)[0] == 1
    assert full_turns_too_many(replace(track, body=None), track) == (0, 0)


@pytest.mark.parametrize("wrong", [{"people": 0}, {"fps": -1.0}, {"turned": 1.5}, {"seconds": np.nan}])
def test_numbers_out_of_range_are_refused(wrong: dict[str, float]) -> None:
    with pytest.raises(InputError):
        strollers(np.random.default_rng(0), **wrong)  # type: ignore[arg-type]
    with pytest.raises(InputError):
        StrollerParameters(speed=-1.0)
