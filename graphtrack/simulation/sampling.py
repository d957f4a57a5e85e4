"""Tracks sampled from the model itself, with their truth, and glances outside the model."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from graphtrack.geometry.angles import FloatArray, wrap
from graphtrack.model import Model
from graphtrack.model.terms.couplings import BodyFollowsMotion, HeadFollowsBody
from graphtrack.model.terms.motion import IntentionalMotion
from graphtrack.simulation import WALKING_PACE
from graphtrack.simulation.motion import (
    sample_coupled_velocity,
    sample_course,
    sample_orientations,
    sample_positions,
    sample_velocity,
)
from graphtrack.tracks.track import Track, TrackSet
from graphtrack.tracks.validation import (
    LARGEST_CONCENTRATION,
    LARGEST_METRES,
    SMALLEST,
    check_count,
    check_frame_rate,
    check_within,
)

_AMPLITUDE = np.radians([30.0, 80.0])
_HOLD, _RISE = (0.5, 2.0), (0.3, 0.6)
"""Hold and ramp times of a glance in seconds; uniform, like the amplitude."""


def sample_glances(t: FloatArray, n_tracks: int, per_minute: float, rng: np.random.Generator) -> FloatArray:
    """Sample glance angles (n_tracks, n) of heads, radians, at the times ``t`` (n,) seconds.

    Glances are a Poisson process with this mean number a minute, to both sides equally. Ramps are half
    cosines.
    """
    aside = np.zeros((n_tracks, len(t)))
    longest = _HOLD[1] + 2.0 * _RISE[1]
    seconds = t[-1] - t[0] + longest
    for row in aside:
        for begin in rng.uniform(t[0] - longest, t[-1], rng.poisson(per_minute * seconds / 60.0)).tolist():
            rise, hold = rng.uniform(*_RISE), rng.uniform(*_HOLD)
            peak = rng.choice([-1.0, 1.0]) * rng.uniform(*_AMPLITUDE)
            since = t - begin
            share = np.minimum(since, 2.0 * rise + hold - since) / rise
            row += peak * 0.5 * (1.0 - np.cos(np.pi * np.clip(share, 0.0, 1.0)))
    return aside


def simulate(
    model: Model | str | Path = "joint",
    *,
    n_tracks: int = 10,
    n_steps: int = 200,
    fps: float = 10.0,
    rng: np.random.Generator | None = None,
    missing: float = 0.0,
    position_std: float | None = None,
    body_kappa: float | None = None,
    head_kappa: float | None = None,
    pace: float | None = WALKING_PACE,
    glances: float = 0.0,
) -> TrackSet:
    """Sample people from the model: states from its dynamics, observations from its likelihoods.

    The motion is sampled from its terms, body and head from the graph's own density given it, over whole
    tracks and so at every frame rate alike; for "social" without conversations. Differences from the model:
    people keep a pace, whereas the model's speeds diverge, and couplings do not slow people down, whereas
    their density favours standing. User-defined terms are not sampled.

    Parameters
    ----------
    model : a `Model`, the name of a preset or a model file; "position" has no orientations, "separate" has
        them without couplings, "intentional" has a head only
    n_tracks, n_steps : people, and frames of each
    fps : frames a second
    rng : random generator; None: a new one, seeded from entropy
    missing : probability, for each channel by itself, that a frame lacks its observation; the first frame
        is complete
    position_std : metres, 1-σ of each axis of the observed positions; None: the model's
    body_kappa, head_kappa : concentration of the observed angles; None: the model's
    pace : m/s, the median over people of the speed that each returns to; None: the model's own motion, whose
        speeds begin at ``initial_speed_std`` and diverge
    glances : mean number of glances a minute, of 30° to 80° for one or two seconds, which are outside the
        model

    Returns
    -------
    TrackSet
        Observations, with the states they came from in ``true_position``, ``true_body`` and ``true_head``.

    Raises
    ------
    InputError
        For a number outside its range.
    """
    model = Model.named(model)
    check_count("n_tracks", n_tracks)
    check_count("n_steps", n_steps)
    check_frame_rate(fps)
    check_within(0.0, float(np.nextafter(1.0, 0.0)), missing=missing)
    likelihood = model.parameters.likelihood
    position_std = likelihood.position_std if position_std is None else position_std
    body_kappa = likelihood.body_kappa if body_kappa is None else body_kappa
    head_kappa = likelihood.head_kappa if head_kappa is None else head_kappa
    kappas = {"body": body_kappa, "head": head_kappa}
    check_within(SMALLEST, LARGEST_METRES, position_std=position_std, pace=pace)
    check_within(0.0, LARGEST_CONCENTRATION, body_kappa=body_kappa, head_kappa=head_kappa, glances=glances)
    rng = np.random.default_rng() if rng is None else rng

    frame = np.arange(n_steps)
    t = frame / fps
    lost = _missing(rng, n_tracks, n_steps, missing)
    truth = sample_states(t, n_tracks, model, rng, pace=pace)
    position = truth.pop("position")
    del truth["velocity"]
    if glances > 0.0 and "head" in truth:
        truth["head"] = wrap(truth["head"] + sample_glances(t, n_tracks, glances, rng))
    noisy = position + position_std * rng.standard_normal(position.shape)
    noisy[lost] = np.nan
    observed = {}
    for name, angles in truth.items():
        observed[name] = wrap(angles + rng.vonmises(0.0, kappas[name], angles.shape))
        observed[name][_missing(rng, n_tracks, n_steps, missing)] = np.nan

    def orientations(i: int) -> dict[str, Any]:
        has_position = {name: angles[i] for name, angles in observed.items()}
        kappa = {f"{name}_kappa": np.full(n_steps, kappas[name]) for name in observed}
        return has_position | kappa | {f"true_{name}": angles[i] for name, angles in truth.items()}

    tracks = (
        Track(
            i,
            frame,
            t,
            noisy[i],
            position_std=np.full(n_steps, position_std),
            true_position=position[i],
            label=f"simulated {i}",
            **orientations(i),
        )
        for i in range(n_tracks)
    )
    return TrackSet(tuple(tracks))


def sample_states(
    t: FloatArray,
    n_tracks: int,
    model: Model,
    rng: np.random.Generator,
    *,
    pace: float | None = None,
) -> dict[str, FloatArray]:
    """Sample states of people at the times ``t`` (n,) seconds, by name.

    Returns
    -------
    dict
        ``position`` and ``velocity`` (n_tracks, n, 2), and ``body`` and ``head`` (n_tracks, n) if the model
        has them.
    """
    motion, steps = model.parameters.motion, (n_tracks, len(t) - 1)
    coupled, steered = model.has_term(BodyFollowsMotion), model.has_term(IntentionalMotion)
    states: dict[str, FloatArray] = {}
    rate = np.full(steps, motion.head_rate if steered else 0.0)
    if not model.has_body:
        head = None
        if model.has_head:
            # The head has only its diffusion; the motion follows it.
            free = np.zeros((n_tracks, len(t)), complex)
            head = states["head"] = sample_course(t, model.parameters.orientation.head_diffusion, free, rng)
        velocity = sample_velocity(t, n_tracks, motion, rng, pace=pace, head=head)
    elif not coupled:
        velocity = sample_velocity(t, n_tracks, motion, rng, pace=pace)
        states["body"], states["head"] = sample_orientations(t, velocity, model, rng)
    else:
        held = model.has_term(HeadFollowsBody)
        velocity = sample_coupled_velocity(t, model.parameters, rng, pace=pace, rate=rate, head_coupled=held)
        states["body"], states["head"] = sample_orientations(t, velocity, model, rng, rate=rate)
    position = sample_positions(t, velocity, motion, rng, head=states.get("head"), rate=rate)
    return {"position": position, "velocity": velocity, **states}


def _missing(rng: np.random.Generator, n_tracks: int, n_steps: int, probability: float) -> np.ndarray:
    lost = rng.random((n_tracks, n_steps)) < probability
    lost[:, 0] = False
    return lost
