"""A scripted scene: six people who do what makes tracking hard, with truth and noisy observations."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray, unit, wrap
from graphtrack.simulation.degrade import OBSERVED, add_noise, withhold
from graphtrack.tracks import Track, TrackSet

SHORTEST = 12.0
"""Seconds that the script needs."""

_GRID = 0.01
_BODY_LAG, _HEAD_LEAD, _HEAD_LAG = 0.25, 0.55, 0.15
"""Seconds: the shoulders follow the course late; the head looks ahead and follows its aim quickly."""


@dataclass(frozen=True)
class _Part:
    """Script of one person: speed in m/s, course and gaze (head against course) in radians, of time in s.

    ``anchor`` is where the person is at ``anchor_time``.
    """

    label: str
    speed: Callable[[FloatArray], FloatArray]
    course: Callable[[FloatArray], FloatArray]
    gaze: Callable[[FloatArray], FloatArray]
    anchor: tuple[float, float]
    anchor_time: float
    hidden: tuple[float, float] | None = None


def scenario(
    rng: np.random.Generator,
    *,
    fps: float = 10.0,
    seconds: float = 30.0,
    occlusion: float = 2.0,
    position_std: float = 0.1,
    body_kappa: float = 1.2,
    head_kappa: float = 2.3,
) -> TrackSet:
    """Six people: two cross, one stops and starts again, one turns, one looks aside, one is hidden.

    Speeds and courses are smooth and integrated to paths. The shoulders follow the course with a lag, the
    head leads a turn. Paths sway a little, and differently for every ``rng``. Raise InputError for a number
    outside its range.

    Parameters
    ----------
    rng : source of the sway and of the noise
    fps : frames a second
    seconds : length of the scene, at least `SHORTEST`
    occlusion : seconds for which nothing is seen of the last person, in a turn; at most 5
    position_std : metres, 1-σ of each axis
    body_kappa, head_kappa : concentration of the observed angles; mean errors of 52° and 35° at the
        defaults, somewhat more than the 41.7° and 30.3° of Chen et al.'s observations (its Table 2)

    Returns
    -------
    TrackSet
        Observations, the truth, and labels that say what each person does.
    """
    if not (np.isfinite(fps) and fps > 0.0):
        raise InputError(f"fps = {fps!r}", "a positive number of frames a second")
    if not (np.isfinite(seconds) and seconds >= SHORTEST):
        raise InputError(f"seconds = {seconds!r}", f"at least {SHORTEST:g}")
    if not 0.0 <= occlusion <= 5.0:
        raise InputError(f"occlusion = {occlusion!r}", "seconds from 0 to 5")
    parts = _script(seconds, occlusion)
    paths = TrackSet(tuple(_walk(i, part, fps, seconds, rng) for i, part in enumerate(parts, start=1)))
    noisy = add_noise(paths, position_std=position_std, body_kappa=body_kappa, head_kappa=head_kappa, rng=rng)
    return noisy.with_tracks(
        track
        if part.hidden is None
        else withhold(track, (track.t >= part.hidden[0]) & (track.t < part.hidden[1]), OBSERVED)
        for track, part in zip(noisy, parts, strict=True)
    )


def _script(seconds: float, occlusion: float) -> list[_Part]:
    middle = 0.5 * seconds
    stop, start = 0.33 * seconds, 0.6 * seconds
    aside = (0.25 * seconds, 0.65 * seconds)
    hidden = (middle - 0.5 * occlusion, middle + 0.5 * occlusion)
    return [
        _Part("crosses from the left", _steady(1.3), _bending(10, 1.0, middle), _still, (0.0, 0.0), middle),
        _Part(
            "crosses from the right", _steady(1.2), _bending(165, -1.2, middle), _still, (0.3, 0.6), middle
        ),
        _Part(
            "stops, looks around and walks on",
            lambda t: 1.2 * (1.0 - _ramp(t, stop, 1.5) + _ramp(t, start, 1.5)),
            # The way on is another: the person turns where they stand.
            lambda t: np.radians(80.0) - np.radians(50.0) * _ramp(t, start - 1.5, 2.5),
            lambda t: np.radians(55.0) * (_pulse(t, stop + 1.0, 2.0, 1.0) - _pulse(t, stop + 3.5, 2.0, 1.0)),
            (-6.0, -2.0),
            stop,
        ),
        _Part(
            "turns sharply",
            lambda t: 1.35 - 0.5 * _pulse(t, middle - 1.0, 2.0, 1.0),
            lambda t: np.radians(200.0) - np.radians(110.0) * _ramp(t, middle - 0.9, 1.8),
            _still,
            (-3.0, -6.0),
            middle,
        ),
        _Part(
            "walks while looking aside",
            _steady(1.1),
            _bending(-80, 1.5, middle),
            lambda t: np.radians(70.0) * (_pulse(t, aside[0], 4.0, 0.8) - _pulse(t, aside[1], 3.0, 0.8)),
            (7.0, 0.0),
            middle,
        ),
        _Part(
            f"is hidden for {occlusion:g} s while turning" if occlusion else "turns",
            _steady(1.25),
            lambda t: np.radians(-20.0) + np.radians(75.0) * _ramp(t, middle - 1.25, 2.5),
            _still,
            (2.0, 6.0),
            middle,
            hidden if occlusion else None,
        ),
    ]


def _walk(track_id: int, part: _Part, fps: float, seconds: float, rng: np.random.Generator) -> Track:
    grid = np.arange(0.0, seconds + _GRID, _GRID)
    course = part.course(grid) + _sway(grid, rng, np.radians(2.5))
    speed = part.speed(grid) * (1.0 + _sway(grid, rng, 0.04))
    step = speed[:, None] * unit(course)
    path = np.vstack([np.zeros(2), np.cumsum(0.5 * _GRID * (step[1:] + step[:-1]), axis=0)])
    # The head aims where the course will lead in a moment.
    ahead = part.course(grid + _HEAD_LEAD) + part.gaze(grid)
    frame = np.arange(round(seconds * fps))
    t = frame / fps

    def at(values: FloatArray, time: FloatArray) -> FloatArray:
        return np.stack([np.interp(time, grid, column) for column in values.T], axis=-1)

    anchor = np.asarray(part.anchor) - at(path, np.array([part.anchor_time]))
    return Track(
        track_id,
        frame,
        t,
        at(path, t) + anchor,
        body=wrap(np.interp(t, grid, _follow(course, _BODY_LAG))),
        head=wrap(np.interp(t, grid, _follow(ahead + _sway(grid, rng, np.radians(4.0)), _HEAD_LAG))),
        label=part.label,
    )


def _follow(aim: FloatArray, lag: float) -> FloatArray:
    """Follow unwrapped angles on the grid with two first-order lags of half of ``lag`` seconds each."""
    keep = float(np.exp(-2.0 * _GRID / lag))
    for _ in range(2):
        followed = np.empty_like(aim)
        value = float(aim[0])
        for k, target in enumerate(aim.tolist()):
            value = keep * value + (1.0 - keep) * target
            followed[k] = value
        aim = followed
    return aim


def _sway(t: FloatArray, rng: np.random.Generator, size: float) -> FloatArray:
    periods, phases = rng.uniform(5.0, 12.0, 2), rng.uniform(0.0, 2.0 * np.pi, 2)
    waves = np.sin(2.0 * np.pi * t[:, None] / periods + phases)
    return 0.5 * size * waves.sum(axis=1)


def _ramp(t: FloatArray, begin: float, length: float) -> FloatArray:
    """From 0 to 1 within ``length`` seconds, with smooth ends."""
    share = np.clip((t - begin) / length, 0.0, 1.0)
    return share**2 * (3.0 - 2.0 * share)


def _pulse(t: FloatArray, begin: float, length: float, rise: float) -> FloatArray:
    """Up within ``rise`` seconds and down again ``length`` seconds after ``begin``."""
    return _ramp(t, begin, rise) - _ramp(t, begin + length - rise, rise)


def _steady(speed: float) -> Callable[[FloatArray], FloatArray]:
    return lambda t: np.full_like(t, speed)


def _bending(degrees: float, degrees_a_second: float, middle: float) -> Callable[[FloatArray], FloatArray]:
    return lambda t: np.radians(degrees + degrees_a_second * (t - middle))


def _still(t: FloatArray) -> FloatArray:
    return np.zeros_like(t)
