"""Simulated pedestrians not sampled from the model: crowds that cross an area, and strollers.

Speeds and courses of strollers are piecewise smooth functions of time, the body follows the course with a
lag, the head turns ahead of it, and a glance adds an angle of its own. Walking paces follow Daamen &
Hoogendoorn (2007) and hip drift follows Murray et al. (1964); glances and stops are choices.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.signal import lfilter

from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray, direction, unit, wrap
from graphtrack.simulation.degrade import add_noise
from graphtrack.tracks.track import Track, TrackSet
from graphtrack.tracks.validation import check_numbers, check_within, number

_GRID = 0.1  # step of the walks in seconds

_SHORTEST = 4.0  # metres between the ends of a walk


@dataclass(frozen=True)
class CrossedArea:
    """Area that people cross.

    Attributes
    ----------
    width, depth : size of the area, m
    arrivals : arrival rate of people or pairs, 1/s
    pairs : share of pairs among arrivals
    apart : distance within a pair, m
    speed, speed_std : preferred walking speed, m/s, mean and standard deviation
    velocity_std : standard deviation of the velocity about it, m/s on each axis
    velocity_seconds : correlation time of the velocity, s
    stops : share of people who stop on their way
    stop_seconds : mean duration of a stop, s
    """

    width: float = 16.0
    depth: float = 14.0
    arrivals: float = 0.5
    pairs: float = 0.35
    apart: float = 0.8
    speed: float = 1.3
    speed_std: float = 0.25
    velocity_std: float = 0.15
    velocity_seconds: float = 1.5
    stops: float = 0.15
    stop_seconds: float = 5.0

    def __post_init__(self) -> None:
        if not min(self.width, self.depth) >= 2.0 * _SHORTEST:
            raise InputError(
                f"a place of {self.width:g} m by {self.depth:g} m", f"{2.0 * _SHORTEST:g} m at least"
            )


def crowd(
    rng: np.random.Generator, *, place: CrossedArea = CrossedArea(), seconds: float = 120.0, fps: float = 2.5
) -> TrackSet:
    """Simulate people who walk from one edge of an area to another, without noise.

    The velocity is an Ornstein–Uhlenbeck process about the velocity towards the goal. Pairs walk side by side
    with independent deviations. Raise InputError for a scene without people.

    ``seconds``, ``fps``: length of the scene, and frames a second
    """
    tracks: list[Track] = []
    count = rng.poisson(place.arrivals * seconds)
    for start in np.sort(rng.uniform(-10.0, seconds, count)).tolist():
        walk = _walk(rng, place)
        walks = [walk]
        if rng.random() < place.pairs:
            walks.append(_companion(rng, walk, place))
        for path in walks:
            track = _visible_track(path, start, len(tracks), seconds, fps)
            if track is not None:
                tracks.append(track)
    if not tracks:
        raise InputError("a scene without people", "more seconds or arrivals")
    return TrackSet(tuple(tracks))


def crossing(
    rng: np.random.Generator, *, people: int, seconds: float, fps: float, side: float = 20.0
) -> TrackSet:
    """Simulate people who cross a square about the origin, with bodies and heads, and their truth.

    The paths are those of `crowd`. Bodies follow the course with a lag and keep it while a person stands;
    heads turn ahead of it, and glance to the side. Raise InputError for a scene without people.

    Parameters
    ----------
    people : mean number of people
    seconds, fps : length of the scene, and frames a second
    side : of the square, m
    """
    check_within(1e-3, 1e6, seconds=seconds, fps=fps)
    place = CrossedArea(width=side, depth=side)
    place = replace(place, arrivals=people / (seconds * (1.0 + place.pairs)))
    return crowd(rng, place=place, seconds=seconds, fps=fps).map(lambda track: _oriented(track, fps, rng))


def _oriented(track: Track, fps: float, rng: np.random.Generator) -> Track:
    """Return an exact track with body, head and its truth."""
    habits, n = StrollerParameters(), len(track)
    position = track.position
    velocity = np.gradient(position, track.t, axis=0) if n > 1 else np.zeros((1, 2))
    moves = np.flatnonzero(np.hypot(*velocity.T) > _STANDING)
    # Of a person at rest the last course, before any motion the first one.
    last = moves[np.maximum(np.searchsorted(moves, np.arange(n), side="right") - 1, 0)] if len(moves) else 0
    course = np.unwrap(direction(velocity)[last] + np.zeros(n))
    body = _lagged(course, habits.body_lag, 1.0 / fps)
    ahead = np.interp(track.t + habits.head_lead, track.t, course)
    head = wrap(_lagged(ahead, 0.1, 1.0 / fps) + _glances(track.t, habits, rng))
    body = wrap(body)
    return replace(track, body=body, head=head, true_position=position, true_body=body, true_head=head)


_STANDING = 0.3  # m/s below which the direction of motion is that of noise


def _edge(rng: np.random.Generator, place: CrossedArea, side: int) -> FloatArray:
    half = 0.5 * np.array([place.width, place.depth])
    point = rng.uniform(-half, half)
    axis, sign = side % 2, 1.0 if side < 2 else -1.0
    point[axis] = sign * half[axis]
    return point


def _walk(rng: np.random.Generator, place: CrossedArea) -> FloatArray:
    """Return positions (n, 2) every `_GRID` seconds from one edge to another."""
    first, second = rng.permutation(4)[:2].tolist()
    position = goal = _edge(rng, place, first)
    while np.linalg.norm(goal - position) < _SHORTEST:
        goal = _edge(rng, place, second)
    liked = float(np.clip(rng.normal(place.speed, place.speed_std), 0.5, 2.2))
    halt = rng.uniform(0.2, 0.8) if rng.random() < place.stops else np.inf
    halted, length = float(rng.exponential(place.stop_seconds)), np.linalg.norm(goal - position)
    velocity, path = liked * (goal - position) / length, [position]
    keep = np.exp(-_GRID / place.velocity_seconds)
    noise = place.velocity_std * np.sqrt(1.0 - keep**2)
    while (left := float(np.linalg.norm(goal - position))) > 0.3 and len(path) < 1200:
        stands = left < (1.0 - halt) * length and halted > 0.0
        halted -= _GRID * stands
        wanted = 0.0 if stands else liked / left * (goal - position)
        velocity = (
            wanted + keep * (velocity - wanted) + noise * rng.standard_normal(2) * (0.2 if stands else 1.0)
        )
        position = position + _GRID * velocity
        path.append(position)
    return np.array(path)


def _companion(rng: np.random.Generator, walk: FloatArray, place: CrossedArea) -> FloatArray:
    along = walk[-1] - walk[0]
    aside = np.array([-along[1], along[0]]) / np.linalg.norm(along)
    keep = np.exp(-_GRID / 3.0)
    velocity_std = np.zeros((len(walk), 2))
    for k in range(1, len(walk)):
        velocity_std[k] = keep * velocity_std[k - 1] + 0.15 * np.sqrt(1.0 - keep**2) * rng.standard_normal(2)
    return walk + place.apart * aside + velocity_std


def _visible_track(path: FloatArray, start: float, identity: int, seconds: float, fps: float) -> Track | None:
    own = start + _GRID * np.arange(len(path))
    frame = np.arange(round(seconds * fps))
    frame = frame[(frame / fps >= own[0]) & (frame / fps <= own[-1])]
    if not len(frame):
        return None
    position = np.column_stack([np.interp(frame / fps, own, column) for column in path.T])
    return Track(identity, frame, frame / fps, position)


_STROLLER_GRID = 0.02  # seconds between samples of a path before it is observed

_FARTHEST = np.radians(120.0)  # of a turn on the spot; beyond it both directions are equally likely


@dataclass(frozen=True)
class StrollerParameters:
    """Habits of simulated pedestrians.

    Attributes
    ----------
    speed, speed_std : m/s, mean and 1-σ between people
    fastest_turn : rad/s of the course, at most
    turns_per_minute, stops_per_minute, glances_per_minute : mean number
    stop_low, stop_high : duration of a stop in seconds, uniform
    glance_low, glance_high : duration of a glance in seconds, uniform
    glance_std : radians, 1-σ of the angle of a glance, at most 90°
    head_lead : seconds by which the head turns ahead of the course
    body_lag : seconds by which the body turns after it
    sidesteps_per_minute : mean number of stretches that are walked sideways or backwards
    """

    speed: float = number(1.3, 0.1, 3.0, "m/s")
    speed_std: float = number(0.2, 0.0, 1.0, "m/s")
    fastest_turn: float = number(1.8, 0.0, 10.0, "rad/s")
    turns_per_minute: float = number(10.0, 0.0, 60.0)
    stops_per_minute: float = number(4.5, 0.0, 60.0)
    stop_low: float = number(2.0, 0.0, 60.0, "s")
    stop_high: float = number(6.0, 0.0, 60.0, "s")
    glances_per_minute: float = number(4.0, 0.0, 60.0)
    glance_low: float = number(1.0, 0.1, 60.0, "s")
    glance_high: float = number(3.0, 0.1, 60.0, "s")
    glance_std: float = number(float(np.radians(45.0)), 0.0, np.pi, "rad")
    head_lead: float = number(0.25, 0.0, 2.0, "s")
    body_lag: float = number(0.15, 0.0, 2.0, "s")
    sidesteps_per_minute: float = number(0.0, 0.0, 60.0)

    def __post_init__(self) -> None:
        check_numbers(self)


def strollers(
    rng: np.random.Generator,
    parameters: StrollerParameters | None = None,
    *,
    people: int = 16,
    seconds: float = 30.0,
    fps: float = 10.0,
    position_std: float = 0.15,
    body_std: float | None = float(np.radians(40.0)),
    head_std: float | None = float(np.radians(30.0)),
    turned: float = 0.05,
    declared: bool = True,
) -> TrackSet:
    """Simulate pedestrians with their truth, observed with noise.

    Raise InputError for a number outside its range.

    Parameters
    ----------
    rng : generator of people and noise
    people, seconds, fps : number of tracks, their length and frames a second
    position_std : metres, 1-σ of each axis
    body_std, head_std : radians, 1-σ of the observed angles (κ = 1/σ²); None: not observed
    turned : share of observed angles that are turned by 180°
    declared : True if the tracks declare the noise of their angles; else the model's defaults apply
    """
    if people < 1 or not (np.isfinite(seconds * fps) and seconds > 0.0 and fps > 0.0):
        raise InputError(f"{people} people, {seconds!r} s at {fps!r} Hz", "positive numbers")
    check_within(0.0, 1.0, turned=turned)
    habits = StrollerParameters() if parameters is None else parameters
    truth = TrackSet(tuple(_stroll(k + 1, habits, seconds, fps, rng) for k in range(people)))
    body_kappa, head_kappa = (None if std is None else 1.0 / std**2 for std in (body_std, head_std))
    noisy = add_noise(truth, position_std=position_std, body_kappa=body_kappa, head_kappa=head_kappa, rng=rng)

    def observed(track: Track) -> Track:
        changed: dict[str, Any] = {}
        for name, std in (("body", body_std), ("head", head_std)):
            over = np.pi * (rng.random(len(track)) < turned)
            changed[name] = None if std is None else wrap(getattr(track, name) + over)
            if std is None or not declared:
                changed[f"{name}_kappa"] = None
        return replace(track, **changed)

    return noisy.map(observed)


def standers(
    rng: np.random.Generator,
    habits: StrollerParameters | None = None,
    *,
    people: int = 16,
    seconds: float = 20.0,
    fps: float = 10.0,
) -> TrackSet:
    """Simulate people who stand and turn on the spot, as in CHIL (Chen et al. 2011, §4.3): the truth alone.

    The body turns ``turns_per_minute`` times by 30° to 150°, the head ahead of it, with glances; the place
    drifts by 3 cm. Of the habits, those of speed and stops have no part.
    """
    habits = habits or StrollerParameters()
    t = np.arange(0.0, seconds, _STROLLER_GRID)
    frame = np.arange(round(seconds * fps))
    tracks = []
    for k in range(people):
        course = np.full_like(t, rng.uniform(-np.pi, np.pi))
        for begin in _times(t, habits.turns_per_minute, rng):
            turn = rng.choice([-1.0, 1.0]) * rng.uniform(np.radians(30.0), np.radians(150.0))
            course += turn * _ramp(t, begin, abs(turn) / (rng.uniform(0.4, 1.0) * habits.fastest_turn))
        body = _lagged(course, habits.body_lag) + np.radians(4.0) * _smooth_noise(t, 2.0, rng)
        ahead = _lagged(np.interp(t + habits.head_lead, t, course), 0.1)
        head = ahead + _glances(t, habits, rng) + np.radians(3.0) * _smooth_noise(t, 1.0, rng)
        place = rng.uniform(-3.0, 3.0, 2)
        drift = np.stack([0.03 * _smooth_noise(t, 2.0, rng) for _ in range(2)])
        x, y, at_body, at_head = (np.interp(frame / fps, t, one) for one in (*drift, body, head))
        position = place + np.column_stack([x, y])
        tracks.append(Track(k, frame, frame / fps, position, body=wrap(at_body), head=wrap(at_head)))
    return TrackSet(tuple(tracks))


def full_turns_too_many(estimate: Track, truth: Track) -> tuple[int, int]:
    """Count stops over which the estimated body turns by 180° more than the true body, and all stops.

    From a second before a stop to one after, unwrapped from frame to frame; none without a body or its truth.
    """
    if estimate.body is None or truth.true_body is None:
        return 0, 0
    found, true, t, wrong = np.unwrap(estimate.body), np.unwrap(truth.true_body), truth.t, 0
    stops = standing(truth)
    for begin, end in stops:
        first, last = np.searchsorted(t, [t[begin] - 1.0, t[end - 1] + 1.0])
        last = min(last, len(t) - 1)
        wrong += abs(found[last] - found[first]) - abs(true[last] - true[first]) > np.pi
    return int(wrong), len(stops)


def standing(track: Track, least: float = 1.5, slowest: float = 0.05) -> list[tuple[int, int]]:
    """Return intervals of frames, first and one past the last, in which the true position is at rest.

    Parameters
    ----------
    least : shortest interval in seconds
    slowest : speed of a standing person, at most, m/s
    """
    if track.true_position is None or len(track) < 2:
        return []
    speed = np.linalg.norm(np.gradient(track.true_position, track.t, axis=0), axis=1)
    edges = np.flatnonzero(np.diff(np.concatenate([[0], (speed < slowest).astype(int), [0]])))
    return [
        (begin, end)
        for begin, end in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True)
        if track.t[end - 1] - track.t[begin] >= least
    ]


def _stroll(
    track_id: int, habits: StrollerParameters, seconds: float, fps: float, rng: np.random.Generator
) -> Track:
    """Return one person's truth, sampled at the frames."""
    # Discard a burn-in, so that tracks begin within an activity.
    before = 5.0
    t = np.arange(0.0, seconds + 2.0 * before, _STROLLER_GRID)
    own = max(habits.speed + habits.speed_std * float(rng.standard_normal()), 0.2)
    moving = np.ones_like(t)
    course = np.full_like(t, rng.uniform(-np.pi, np.pi))
    walks_from = 0.0
    for begin in _times(t, habits.stops_per_minute, rng):
        length = rng.uniform(habits.stop_low, habits.stop_high)
        if begin < walks_from:
            continue
        walks_from = begin + length + 2.0
        moving = np.minimum(moving, 1.0 - _ramp(t, begin - 0.7, 0.7) + _ramp(t, begin + length, 0.7))
        # The new direction is reached by a turn on the spot before the first step.
        onward = np.clip(rng.normal(0.0, np.radians(50.0)), -_FARTHEST, _FARTHEST)
        course += onward * _ramp(t, begin + length - 1.2, 1.2)
    for begin in _times(t, habits.turns_per_minute, rng):
        rate, length = rng.uniform(0.4, 1.0) * habits.fastest_turn, rng.uniform(0.5, 2.0)
        way = rng.choice([-1.0, 1.0])
        if moving[(t > begin - 1.0) & (t < begin + length + 1.0)].all():
            course += way * rate * length * _ramp(t, begin, length)
    aside = np.zeros_like(t)
    for begin in _times(t, habits.sidesteps_per_minute, rng):
        angle = rng.choice([-90.0, 90.0, 180.0]) * np.pi / 180.0
        length = rng.uniform(3.0, 8.0)
        aside += angle * (_ramp(t, begin, 0.8) - _ramp(t, begin + length, 0.8))
    glance = _glances(t, habits, rng)
    phase, pace = rng.uniform(0.0, 2.0 * np.pi), rng.uniform(0.85, 1.05)
    step = moving * np.sin(2.0 * np.pi * pace * t + phase)
    wander = np.radians(4.0) * _smooth_noise(t, 2.0, rng)
    velocity = (own * moving * (1.0 + 0.05 * _smooth_noise(t, 3.0, rng)))[:, None] * unit(course + wander)
    path = np.cumsum(velocity * _STROLLER_GRID, axis=0) + 0.02 * step[:, None] * unit(course + 0.5 * np.pi)
    body = _lagged(course + wander, habits.body_lag) - aside + np.radians(4.0) * step
    ahead = np.interp(t + habits.head_lead, t, course)
    head = _lagged(ahead, 0.1) - aside + glance + np.radians(3.0) * _smooth_noise(t, 1.0, rng)
    frame = np.arange(round(seconds * fps))
    at = before + frame / fps
    body, head = np.interp(at, t, body), np.interp(at, t, head)
    position = np.stack([np.interp(at, t, column) for column in path.T], axis=1)
    return Track(
        track_id, frame, frame / fps, position - position.mean(axis=0), body=wrap(body), head=wrap(head)
    )


def _glances(t: FloatArray, habits: StrollerParameters, rng: np.random.Generator) -> FloatArray:
    """Return the angles (n,) of glances to the side at the times ``t``."""
    glance = np.zeros_like(t)
    for begin in _times(t, habits.glances_per_minute, rng):
        length = rng.uniform(habits.glance_low, habits.glance_high)
        angle = np.clip(habits.glance_std * rng.standard_normal(), -0.5 * np.pi, 0.5 * np.pi)
        glance += angle * (_ramp(t, begin, 0.3) - _ramp(t, begin + length - 0.3, 0.3))
    return glance


def _times(t: FloatArray, per_minute: float, rng: np.random.Generator) -> list[float]:
    """Return event times of a Poisson process over the times ``t``."""
    seconds = float(t[-1] - t[0])
    found: list[float] = np.sort(rng.uniform(t[0], t[-1], rng.poisson(per_minute * seconds / 60.0))).tolist()
    return found


def _ramp(t: FloatArray, begin: float, length: float) -> FloatArray:
    """Return a half-cosine ramp from 0 to 1 within ``length`` seconds."""
    return 0.5 - 0.5 * np.cos(np.pi * np.clip((t - begin) / length, 0.0, 1.0))


def _lagged(angle: FloatArray, lag: float, step: float = _STROLLER_GRID) -> FloatArray:
    """Filter unwrapped angles, one every ``step`` seconds, with a first-order lag in seconds."""
    if lag == 0.0:
        return angle
    keep = float(np.exp(-step / lag))
    followed: FloatArray = angle[0] + lfilter([1.0 - keep], [1.0, -keep], angle - angle[0])
    return followed


def _smooth_noise(t: FloatArray, seconds: float, rng: np.random.Generator) -> FloatArray:
    """Return a stationary Gaussian process of variance 1 with correlation time ``seconds``."""
    keep = float(np.exp(-_STROLLER_GRID / seconds))
    white = np.sqrt(1.0 - keep**2) * rng.standard_normal(len(t))
    white[0] = rng.standard_normal()
    course: FloatArray = lfilter([1.0], [1.0, -keep], white)
    return course
