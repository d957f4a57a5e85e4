"""A simulated party: people in conversations and alone, who look at each other, and who move on."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray, unit, wrap
from graphtrack.tracks import Track, TrackSet

IntArray = np.ndarray

NOTHING = -1
"""Of a look: at nobody."""

_STAY, _LOOK = 40.0, 2.5
"""Seconds that somebody stays with a group, and that a look lasts, on average."""
_PACE = 1.1
_BODY_STD, _LOOK_STD, _DRIFT = 0.3, 0.25, 0.4
"""Radians of bodies about their o-space and of heads about their aim, and seconds over which both drift."""
_ALONE, _AWAY, _ELSEWHERE = 0.1, 0.3, 0.1
"""Share of people alone, of looks at nobody, and of those at somebody that are at no fellow member."""
_SHOULDERS = 0.25
_APART = 3.0
"""Metres between the centres of conversations."""


@dataclass(frozen=True, eq=False)
class Party:
    """People without noise, and what they do.

    Attributes
    ----------
    tracks : with their truth
    group : (people, n) number of the conversation that each is in; −1: alone, or on the way
    look : (people, n) id of whom each looks at; `NOTHING`
    """

    tracks: TrackSet
    group: IntArray
    look: IntArray

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

    Conversations stand on a grid `_APART` metres wide; who leaves one walks to another. Members spread about
    the o-space, and face it more or less; each looks at a fellow member, or away. Raise InputError for fewer
    than one person or two steps.
    """
    if people < 1 or steps < 2:
        raise InputError(f"{people} people, {steps} steps", "a person and two steps at least")
    dt, places = 1.0 / fps, max(1, -(-people // 4))
    side = int(np.ceil(np.sqrt(places)))
    centres = _APART * np.array([[k % side, k // side] for k in range(places)], dtype=float)
    alone = centres.mean(axis=0) + _APART * (0.6 * side + 0.5) * unit(
        np.linspace(0.0, 2.0 * np.pi, people + 1)[:-1]
    )
    member = np.where(rng.random(people) < _ALONE, -1, np.arange(people) % places)
    seat = _seats(member, places, rng)
    position = _goals(member, seat, centres, alone)
    paths, groups = np.empty((people, steps, 2)), np.empty((people, steps), dtype=np.int64)
    looks, bodies, heads = np.empty_like(groups), np.empty((people, steps)), np.empty((people, steps))
    look = np.full(people, NOTHING)
    stray = np.stack([_BODY_STD * rng.standard_normal(people), _LOOK_STD * rng.standard_normal(people)])
    away = rng.uniform(-np.pi, np.pi, people)
    keep = np.exp(-dt / _DRIFT)
    for k in range(steps):
        leaving = np.flatnonzero(rng.random(people) < 1.0 - np.exp(-dt / _STAY))
        for one in leaving.tolist():
            member[one] = -1 if rng.random() < _ALONE else rng.integers(places)
            seat = _seats(member, places, rng, seat)
        goal = _goals(member, seat, centres, alone)
        way = goal - position
        far = np.linalg.norm(way, axis=1)
        walking = far > 0.5
        speed = np.where(walking, _PACE, 0.3)
        position = position + way * np.minimum(1.0, speed * dt / np.maximum(far, 1e-9))[:, None]
        there = ~walking & (member >= 0)
        groups[:, k] = np.where(there, member, -1)
        for group in range(places):
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
            course = np.arctan2(inward[1], inward[0])
            bodies[one, k] = wrap(course + stray[0, one])
            at = position[look[one]] - position[one] if look[one] != NOTHING else None
            aim = away[one] if at is None else np.arctan2(at[1], at[0])
            heads[one, k] = wrap(aim + stray[1, one])
        paths[:, k], looks[:, k] = position, look
    return _made(paths, bodies, heads, groups, looks, dt)


def _drawn(one: int, position: FloatArray, fellows: IntArray, anybody: bool, rng: np.random.Generator) -> int:
    """Draw whom somebody looks at next: a fellow member, or anybody in sight, the rather the nearer."""
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
    member: IntArray, places: int, rng: np.random.Generator, before: FloatArray | None = None
) -> FloatArray:
    """Return the seat of each member in its circle, (people, 2): radius and angle."""
    seat = np.zeros((len(member), 2)) if before is None else before.copy()
    for group in range(places):
        inside = np.flatnonzero(member == group)
        turn = rng.uniform(0.0, 2.0 * np.pi) if before is None else seat[inside, 1].min(initial=7.0)
        order = inside if before is None else inside[np.argsort(seat[inside, 1])]
        seat[order, 0] = 0.35 + 0.1 * len(inside)
        seat[order, 1] = turn + 2.0 * np.pi * np.arange(len(inside)) / max(len(inside), 1)
    return seat


def _goals(member: IntArray, seat: FloatArray, centres: FloatArray, alone: FloatArray) -> FloatArray:
    inside = centres[np.maximum(member, 0)] + seat[:, :1] * unit(seat[:, 1])
    return np.where(member[:, None] >= 0, inside, alone)


def _made(
    paths: FloatArray, bodies: FloatArray, heads: FloatArray, groups: IntArray, looks: IntArray, dt: float
) -> Party:
    frame = np.arange(paths.shape[1], dtype=np.int64)
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
        for one in range(len(paths))
    )
    return Party(TrackSet(tracks), groups, looks)
