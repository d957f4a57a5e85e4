"""Scripted scenes with their truth: six people who are hard to track, and a party with conversations."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray, unit, wrap
from graphtrack.simulation.degrade import OBSERVED, add_noise, withhold
from graphtrack.tracks.track import Track, TrackSet
from graphtrack.tracks.validation import LARGEST_SECONDS, check_frame_rate, check_within

SHORTEST = 12.0
"""Shortest scene in seconds."""

_GRID = 0.01
_BODY_LAG, _HEAD_LEAD, _HEAD_LAG = 0.25, 0.55, 0.15
"""Lags in seconds: the shoulders lag behind the course; the head leads it and follows its aim quickly."""


@dataclass(frozen=True)
class _Part:
    """Script of one person: speed in m/s, course and gaze (head against course) in radians, of time in s."""

    label: str
    speed: Callable[[FloatArray], FloatArray]
    course: Callable[[FloatArray], FloatArray]
    gaze: Callable[[FloatArray], FloatArray]
    anchor: tuple[float, float]  # where the person is at ``anchor_time``
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
    head leads a turn. Paths have a small random sway. Raise InputError for a number
    outside its range.

    Parameters
    ----------
    rng : generator of the sway and the noise
    fps : frames a second
    seconds : length of the scene, at least `SHORTEST`
    occlusion : seconds without observations of the last person, in a turn; at most 5
    position_std : metres, 1-σ of each axis
    body_kappa, head_kappa : concentration of the observed angles; mean errors of 52° and 35° at the
        defaults, somewhat more than the 41.7° and 30.3° of Chen et al.'s observations (its Table 2)

    Returns
    -------
    TrackSet
        Observations, the truth, and labels that describe each person's motion.
    """
    check_frame_rate(fps)
    check_within(SHORTEST, LARGEST_SECONDS, seconds=seconds)
    check_within(0.0, 5.0, occlusion=occlusion)
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
            # The new direction is reached by a turn on the spot.
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
    course = part.course(grid) + _wander(grid, rng, np.radians(2.5))
    speed = part.speed(grid) * (1.0 + _wander(grid, rng, 0.04))
    step = speed[:, None] * unit(course)
    path = np.vstack([np.zeros(2), np.cumsum(0.5 * _GRID * (step[1:] + step[:-1]), axis=0)])
    # The head aims in the direction of the upcoming course.
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
        head=wrap(np.interp(t, grid, _follow(ahead + _wander(grid, rng, np.radians(4.0)), _HEAD_LAG))),
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


def _wander(t: FloatArray, rng: np.random.Generator, size: float) -> FloatArray:
    periods, phases = rng.uniform(5.0, 12.0, 2), rng.uniform(0.0, 2.0 * np.pi, 2)
    waves = np.sin(2.0 * np.pi * t[:, None] / periods + phases)
    return 0.5 * size * waves.sum(axis=1)


def _ramp(t: FloatArray, begin: float, length: float) -> FloatArray:
    """Return a ramp from 0 to 1 within ``length`` seconds, with smooth ends."""
    share = np.clip((t - begin) / length, 0.0, 1.0)
    return share**2 * (3.0 - 2.0 * share)


def _pulse(t: FloatArray, begin: float, length: float, rise: float) -> FloatArray:
    """Return a pulse that rises within ``rise`` seconds, and falls ``length`` seconds after ``begin``."""
    return _ramp(t, begin, rise) - _ramp(t, begin + length - rise, rise)


def _steady(speed: float) -> Callable[[FloatArray], FloatArray]:
    return lambda t: np.full_like(t, speed)


def _bending(degrees: float, degrees_a_second: float, middle: float) -> Callable[[FloatArray], FloatArray]:
    return lambda t: np.radians(degrees + degrees_a_second * (t - middle))


def _still(t: FloatArray) -> FloatArray:
    return np.zeros_like(t)


IntArray = np.ndarray

NOTHING = -1
"""Gaze target: nobody."""

_STAY, _LOOK = 40.0, 2.5  # mean duration of group membership and of gaze at a target, seconds
_PACE = 1.1
_BODY_STD, _LOOK_STD, _DRIFT = 0.3, 0.25, 0.4
"""1-σ in radians of bodies about their o-space and heads about their aim; correlation time in seconds."""
_ALONE, _AWAY, _ELSEWHERE = 0.1, 0.3, 0.1
"""Share of people alone, of gaze at nobody, and of gaze at people outside the group."""
_SHOULDERS = 0.25
_APART = 3.0  # metres between the centres of conversations


@dataclass(frozen=True, eq=False)
class Party:
    """People without noise, with their groups and gaze targets."""

    tracks: TrackSet  # with their truth
    group: IntArray  # (people, n) number of the conversation; −1: alone, or walking to another
    look: IntArray  # (people, n) id of the gaze target; `NOTHING`

    def group_columns(self) -> dict[str, IntArray]:
        """``frame, t, track_id, group``, a row for each person and frame."""
        return self._columns("group", self.group)

    def look_columns(self) -> dict[str, IntArray]:
        """``frame, t, track_id, target``, likewise."""
        return self._columns("target", self.look)

    def _columns(self, name: str, values: IntArray) -> dict[str, IntArray]:
        frame, t = (np.concatenate([getattr(track, key) for track in self.tracks]) for key in ("frame", "t"))
        person = np.repeat([track.track_id for track in self.tracks], self.group.shape[1])
        return {"frame": frame, "t": t, "track_id": person, name: values.ravel()}


def party(rng: np.random.Generator, *, people: int = 12, steps: int = 200, fps: float = 2.0) -> Party:
    """Sample a party.

    Conversations are on a grid `_APART` metres wide; a person who leaves one walks to another. Members stand
    around the o-space and approximately face it; each looks at a fellow member, or away. Others face where
    they walk, and at rest where they faced before. Raise InputError for fewer than one person or two steps.
    """
    if people < 1 or steps < 2:
        raise InputError(f"{people} people, {steps} steps", "a person and two steps at least")
    dt, n_circles = 1.0 / fps, max(1, -(-people // 4))
    side = int(np.ceil(np.sqrt(n_circles)))
    centres = _APART * np.array([[k % side, k // side] for k in range(n_circles)], dtype=float)
    alone = centres.mean(axis=0) + _APART * (0.6 * side + 0.5) * unit(
        np.linspace(0.0, 2.0 * np.pi, people + 1)[:-1]
    )
    member = np.where(rng.random(people) < _ALONE, -1, np.arange(people) % n_circles)
    seat = _seats(member, n_circles, rng)
    position = _goals(member, seat, centres, alone)
    paths, groups = np.empty((people, steps, 2)), np.empty((people, steps), dtype=np.int64)
    gaze, bodies, heads = np.empty_like(groups), np.empty((people, steps)), np.empty((people, steps))
    look = np.full(people, NOTHING)
    stray = np.stack([_BODY_STD * rng.standard_normal(people), _LOOK_STD * rng.standard_normal(people)])
    away = rng.uniform(-np.pi, np.pi, people)
    course, keep = away.copy(), np.exp(-dt / _DRIFT)
    for k in range(steps):
        leaving = np.flatnonzero(rng.random(people) < 1.0 - np.exp(-dt / _STAY))
        for one in leaving.tolist():
            member[one] = -1 if rng.random() < _ALONE else rng.integers(n_circles)
            seat = _seats(member, n_circles, rng, seat)
        goal = _goals(member, seat, centres, alone)
        way = goal - position
        far = np.linalg.norm(way, axis=1)
        walking = far > 0.5
        speed = np.where(walking, _PACE, 0.3)
        position = position + way * np.minimum(1.0, speed * dt / np.maximum(far, 1e-9))[:, None]
        there = ~walking & (member >= 0)
        groups[:, k] = np.where(there, member, -1)
        for group in range(n_circles):
            if np.count_nonzero(groups[:, k] == group) == 1:
                groups[groups[:, k] == group, k] = -1
        stray = keep * stray + np.sqrt(1.0 - keep**2) * rng.standard_normal((2, people)) * [
            [_BODY_STD],
            [_LOOK_STD],
        ]
        ended = rng.random(people) < 1.0 - np.exp(-dt / _LOOK)
        for one in range(people):
            fellows = np.flatnonzero((groups[:, k] == groups[one, k]) & (np.arange(people) != one))
            if k == 0 or ended[one]:
                free = people < 2 or rng.random() < _AWAY
                away[one] = rng.uniform(-np.pi, np.pi)
                alone_now = groups[one, k] < 0 or rng.random() < _ELSEWHERE
                look[one] = NOTHING if free else _drawn(one, position, fellows, alone_now, rng)
            inward = centres[groups[one, k]] - position[one] if groups[one, k] >= 0 else way[one]
            if groups[one, k] >= 0 or far[one] > 1e-9:
                course[one] = np.arctan2(inward[1], inward[0])
            bodies[one, k] = wrap(course[one] + stray[0, one])
            at = position[look[one]] - position[one] if look[one] != NOTHING else None
            aim = away[one] if at is None else np.arctan2(at[1], at[0])
            heads[one, k] = wrap(aim + stray[1, one])
        paths[:, k], gaze[:, k] = position, look
    frame = np.arange(steps, dtype=np.int64)
    t = np.asarray(dt * frame, dtype=float)
    tracks = tuple(
        Track(
            one,
            frame,
            t,
            paths[one],
            body=bodies[one],
            head=heads[one],
            true_position=paths[one],
            true_body=bodies[one],
            true_head=heads[one],
        )
        for one in range(people)
    )
    return Party(TrackSet(tracks), groups, gaze)


def _drawn(one: int, position: FloatArray, fellows: IntArray, anybody: bool, rng: np.random.Generator) -> int:
    """Draw the next gaze target: a fellow member, or a visible person with a preference for near ones."""
    if not anybody:
        return int(rng.choice(fellows))
    away = position - position[one]
    far = np.linalg.norm(away, axis=1)
    bearing = np.arctan2(away[:, 1], away[:, 0])
    turn = np.abs(wrap(bearing[:, None] - bearing))
    hides = (turn < np.arctan2(_SHOULDERS, far)) & (far < far[:, None]) & (far > 0.0)
    weight = np.where(hides.any(axis=1), 0.0, 1.0 / (1.0 + (far / 4.0) ** 2))
    weight[one] = 0.0
    return int(rng.choice(len(position), p=weight / weight.sum()))


def _seats(
    member: IntArray, n_circles: int, rng: np.random.Generator, before: FloatArray | None = None
) -> FloatArray:
    """Return the seat of each member in its circle, (people, 2): radius and angle."""
    seat = np.zeros((len(member), 2)) if before is None else before.copy()
    for group in range(n_circles):
        inside = np.flatnonzero(member == group)
        turn = rng.uniform(0.0, 2.0 * np.pi) if before is None else seat[inside, 1].min(initial=7.0)
        order = inside if before is None else inside[np.argsort(seat[inside, 1])]
        seat[order, 0] = 0.35 + 0.1 * len(inside)
        seat[order, 1] = turn + 2.0 * np.pi * np.arange(len(inside)) / max(len(inside), 1)
    return seat


def _goals(member: IntArray, seat: FloatArray, centres: FloatArray, alone: FloatArray) -> FloatArray:
    inside = centres[np.maximum(member, 0)] + seat[:, :1] * unit(seat[:, 1])
    return np.where(member[:, None] >= 0, inside, alone)
