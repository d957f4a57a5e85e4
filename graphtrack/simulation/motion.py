"""Velocities and positions sampled from the motion terms, at a walking pace if wanted."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from graphtrack.geometry.angles import FloatArray, unit
from graphtrack.model import MotionParameters, Parameters
from graphtrack.model.terms.intentional_motion import smooth_speed, steered_step

SCENE_SIZE = 20.0
"""Metres: tracks begin anywhere in a square of this side around the origin."""

PACE_SPREAD = 0.23
"""1-σ of the logarithm of people's own paces: 0.3 m/s at 1.3 m/s."""

PACE_RATE = 0.7
"""1/s at which a speed returns to the person's own pace: slowly against what a few frames tell."""

_SUBSTEP = 0.05


def sample_motion(
    t: FloatArray,
    n_tracks: int,
    parameters: Parameters,
    rng: np.random.Generator,
    *,
    pace: float | None = None,
) -> tuple[FloatArray, FloatArray]:
    """Positions and velocities (n_tracks, n, 2) of white-noise acceleration at the times ``t`` (n,) seconds.

    Without a ``pace`` in m/s exact: each step has the covariance Q(Δt) of the model's term `Motion`,
    whatever Δt.
    """
    velocity = sample_velocity(t, n_tracks, parameters.motion, rng, pace=pace)
    return sample_positions(t, velocity, parameters.motion, rng), velocity


def sample_velocity(
    t: FloatArray,
    n_tracks: int,
    motion: MotionParameters,
    rng: np.random.Generator,
    *,
    pace: float | None = None,
    head: FloatArray | None = None,
) -> FloatArray:
    """Velocities (n_tracks, n, 2) in m/s at the times ``t`` (n,) seconds.

    Parameters
    ----------
    pace : m/s, the median over people of the speed that each returns to at `PACE_RATE`; None: speeds wander
        as white-noise acceleration has it, ever further from the first ones
    head : (n_tracks, n) radians of heads that steer the motion; None: nothing steers it
    """
    start = first_velocity(n_tracks, motion, rng, pace)
    velocity = np.empty((n_tracks, len(t), 2))
    velocity[:, 0] = start.velocity
    for k, dt in enumerate(np.diff(t).tolist(), start=1):
        before = velocity[:, k - 1]
        aim = np.zeros_like(before) if head is None else smooth_speed(before)[:, None] * unit(head[:, k - 1])
        rate = 0.0 if head is None else motion.head_rate
        velocity[:, k] = next_velocity(before, aim, rate, dt, start.pace, motion, rng)
    return velocity


class Start(NamedTuple):
    """First velocities (n_tracks, 2), and people's own paces (n_tracks,); None: they have none."""

    velocity: FloatArray
    pace: FloatArray | None


def first_velocity(
    n_tracks: int, motion: MotionParameters, rng: np.random.Generator, pace: float | None
) -> Start:
    """Sample first velocities: by the model's prior or, with a median ``pace`` in m/s, as people go on."""
    if pace is None:
        return Start(motion.initial_speed_std * rng.standard_normal((n_tracks, 2)), None)
    own = pace * np.exp(PACE_SPREAD * rng.standard_normal(n_tracks))
    wander = math.sqrt(motion.acceleration_density / (2.0 * PACE_RATE))
    speed = own + wander * rng.standard_normal(n_tracks)
    return Start(speed[:, None] * unit(rng.uniform(-np.pi, np.pi, n_tracks)), own)


def next_velocity(
    before: FloatArray,
    aim: FloatArray,
    rate: FloatArray | float,
    dt: float,
    pace: FloatArray | None,
    motion: MotionParameters,
    rng: np.random.Generator,
) -> FloatArray:
    """Velocities (n_tracks, …, 2) ``dt`` seconds on, which turn to the ``aim`` at the ``rate`` λ in 1/s."""
    now = before
    parts = 1 if pace is None else math.ceil(dt / _SUBSTEP)
    step = steered_step(dt / parts, rate)
    keep, size = step.keep[..., None], np.sqrt(motion.acceleration_density * step.spread)[..., None]
    for _ in range(parts):
        now = keep * now + (1.0 - keep) * aim + size * rng.standard_normal(now.shape)
        if pace is not None:
            now = _paced(now, pace, dt / parts, motion.acceleration_density)
    return now


def _paced(velocity: FloatArray, own: FloatArray, dt: float, density: float) -> FloatArray:
    """Velocities (m, …, 2) whose speeds have returned towards the people's own for ``dt`` seconds."""
    speed = np.linalg.norm(velocity, axis=-1)
    own = own.reshape(-1, *(1,) * (speed.ndim - 1))
    # Noise across the motion makes the speed grow by q/2s a second.
    rest = np.maximum(own - density / (2.0 * PACE_RATE * own), 0.0)
    wanted = rest + (speed - rest) * math.exp(-PACE_RATE * dt)
    return velocity * (wanted / np.maximum(speed, 1e-9))[..., None]


def sample_positions(
    t: FloatArray,
    velocity: FloatArray,
    motion: MotionParameters,
    rng: np.random.Generator,
    *,
    head: FloatArray | None = None,
    rate: FloatArray | float = 0.0,
) -> FloatArray:
    """Positions (n_tracks, n, 2) in metres given the velocities (n_tracks, n, 2): of a step, what Q leaves.

    Parameters
    ----------
    head : (n_tracks, n) radians of heads that steer the motion
    rate : λ in 1/s, of all steps or of each, (n_tracks, n − 1)
    """
    n_tracks, n, _ = velocity.shape
    position = np.empty((n_tracks, n, 2))
    position[:, 0] = rng.uniform(-0.5 * SCENE_SIZE, 0.5 * SCENE_SIZE, (n_tracks, 2))
    before, dt = velocity[:, :-1], np.broadcast_to(np.diff(t), (n_tracks, n - 1))
    step = steered_step(dt, rate)
    keep, reach, place, cross, spread = (moment[..., None] for moment in step)
    aim = np.zeros_like(before)
    if head is not None:
        aim = smooth_speed(before)[..., None] * unit(head[:, :-1])
    turn = velocity[:, 1:] - keep * before - (1.0 - keep) * aim
    left = motion.acceleration_density * np.maximum(place - cross**2 / spread, 0.0)
    moved = reach * before + (dt[..., None] - reach) * aim + cross / spread * turn
    moved += np.sqrt(left) * rng.standard_normal(moved.shape)
    position[:, 1:] = position[:, :1] + np.cumsum(moved, axis=1)
    return position
