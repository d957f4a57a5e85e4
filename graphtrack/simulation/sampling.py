"""Tracks sampled from the model itself, with their truth."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray, direction, unit, wrap
from graphtrack.model import Model, Parameters
from graphtrack.model.parameters import CouplingParameters, OrientationParameters
from graphtrack.model.terms.body_follows_motion import BodyFollowsMotion
from graphtrack.model.terms.intentional_motion import IntentionalMotion, smooth_speed, steered_step
from graphtrack.model.terms.motion import process_noise, transition_matrix
from graphtrack.model.terms.place import PlacePrior
from graphtrack.simulation.scenario import scenario
from graphtrack.tracks import Track, TrackSet

__all__ = ["sample_motion", "sample_orientations", "scenario", "simulate", "von_mises_product"]

SCENE_SIZE = 20.0
"""Metres: tracks begin anywhere in a square of this side around the origin."""

NO_COUPLING = CouplingParameters(motion_body_kappa=0.0, head_body_kappa=0.0)


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
) -> TrackSet:
    """Sample people from the model: states from its dynamics, observations from its likelihoods.

    Motion is white-noise acceleration, or steered by the head in the presets that have that, sampled exactly.
    An orientation is sampled from the *normalised*
    product of the von Mises of its dynamics and that of its coupling (002 eq. 8 and 10 as its particle
    filter samples them); the factor graph holds the product without the normalisation. Not sampled are the
    modes of "full", with which everybody faces where they go, and terms of your own.

    Parameters
    ----------
    model : a `Model`, the name of a preset or a model file; "position" has no orientations, "separate" has
        them without couplings, "intentional" has a head only
    n_tracks, n_steps : people, and frames of each
    fps : frames a second
    rng : source of all randomness; None: a new one, different every time
    missing : probability, for each channel by itself, that a frame lacks its observation; the first frame
        is complete
    position_std : metres, 1-σ of each axis of the observed positions; None: the model's
    body_kappa, head_kappa : concentration of the observed angles; None: the model's

    Returns
    -------
    TrackSet
        Observations, with the states they came from in ``true_position``, ``true_body`` and ``true_head``.

    Raises
    ------
    InputError
        For a number outside its range, and for a model with a place, which cannot be sampled.
    """
    model = Model.named(model)
    if any(isinstance(term, PlacePrior) for term in model.terms):
        raise InputError("the term PlacePrior, which cannot be sampled", "a model without a place")
    _check(n_tracks, n_steps, fps, missing)
    likelihood = model.parameters.likelihood
    position_std = likelihood.position_std if position_std is None else position_std
    kappas = {
        "body": likelihood.body_kappa if body_kappa is None else body_kappa,
        "head": likelihood.head_kappa if head_kappa is None else head_kappa,
    }
    if not (np.isfinite(position_std) and position_std > 0.0):
        raise InputError(f"position_std = {position_std!r}", "a positive number of metres")
    for name, kappa in kappas.items():
        if not (np.isfinite(kappa) and kappa >= 0.0):
            raise InputError(f"{name}_kappa = {kappa!r}", "a finite number, at least 0")
    rng = np.random.default_rng() if rng is None else rng

    frame = np.arange(n_steps)
    t = frame / fps
    coupled = any(isinstance(term, BodyFollowsMotion) for term in model.terms)
    truth = {}
    if any(isinstance(term, IntentionalMotion) for term in model.terms):
        position, truth["body"], truth["head"] = sample_intentional(
            t, n_tracks, model.parameters, rng, coupled=coupled
        )
    else:
        position, velocity = sample_motion(t, n_tracks, model.parameters, rng)
        if model.has_body or model.has_head:
            truth["body"], truth["head"] = sample_orientations(
                t, velocity, model.parameters, rng, coupled=coupled
            )
    if not model.has_body:
        truth.pop("body", None)
    noisy = position + position_std * rng.standard_normal(position.shape)
    noisy[_missing(rng, n_tracks, n_steps, missing)] = np.nan
    observed = {}
    for name, angles in truth.items():
        observed[name] = wrap(angles + rng.vonmises(0.0, kappas[name], angles.shape))
        observed[name][_missing(rng, n_tracks, n_steps, missing)] = np.nan

    def orientations(i: int) -> dict[str, Any]:
        seen = {name: angles[i] for name, angles in observed.items()}
        kappa = {f"{name}_kappa": np.full(n_steps, kappas[name]) for name in observed}
        return seen | kappa | {f"true_{name}": angles[i] for name, angles in truth.items()}

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


def sample_motion(
    t: FloatArray, n_tracks: int, parameters: Parameters, rng: np.random.Generator
) -> tuple[FloatArray, FloatArray]:
    """Positions and velocities (n_tracks, n, 2) of white-noise acceleration at the times ``t`` (n,) seconds.

    Exact: each step has the covariance Q(Δt) of MODEL term 1, whatever Δt.
    """
    motion = parameters.motion
    state = np.empty((n_tracks, len(t), 4))
    state[:, 0, :2] = rng.uniform(-0.5 * SCENE_SIZE, 0.5 * SCENE_SIZE, (n_tracks, 2))
    state[:, 0, 2:] = motion.initial_speed_std * rng.standard_normal((n_tracks, 2))
    for k, dt in enumerate(np.diff(t).tolist(), start=1):
        root = np.linalg.cholesky(process_noise(dt, motion.acceleration_density))
        noise = rng.standard_normal((n_tracks, 4)) @ root.T
        state[:, k] = state[:, k - 1] @ transition_matrix(dt).T + noise
    return state[..., :2], state[..., 2:]


def sample_intentional(
    t: FloatArray, n_tracks: int, parameters: Parameters, rng: np.random.Generator, *, coupled: bool = True
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Positions (n_tracks, n, 2), body and head (n_tracks, n) of people steered by the head (term 5)."""
    motion, n = parameters.motion, len(t)
    coupling = parameters.coupling if coupled else NO_COUPLING
    position, velocity = np.empty((2, n_tracks, n, 2))
    body, head = np.zeros((2, n_tracks, n))
    position[:, 0] = rng.uniform(-0.5 * SCENE_SIZE, 0.5 * SCENE_SIZE, (n_tracks, 2))
    velocity[:, 0] = motion.initial_speed_std * rng.standard_normal((n_tracks, 2))
    steps: list[float | None] = [None, *np.diff(t).tolist()]
    for k, dt in enumerate(steps):
        if dt is not None:
            keep, reach, place, cross, spread = steered_step(dt, motion.head_rate)
            aim = smooth_speed(velocity[:, k - 1])[:, None] * unit(head[:, k - 1])
            root = np.linalg.cholesky(
                motion.acceleration_density * np.array([[place, cross], [cross, spread]])
            )
            noise = np.einsum("ab,mbd->mad", root, rng.standard_normal((n_tracks, 2, 2)))
            position[:, k] = (
                position[:, k - 1] + reach * velocity[:, k - 1] + (dt - reach) * aim + noise[:, 0]
            )
            velocity[:, k] = keep * velocity[:, k - 1] + (1.0 - keep) * aim + noise[:, 1]
        before = max(k - 1, 0)
        body[:, k], head[:, k] = _turn(
            dt, velocity[:, k], body[:, before], head[:, before], parameters.orientation, coupling, rng
        )
    return position, body, head


def sample_orientations(
    t: FloatArray,
    velocity: FloatArray,
    parameters: Parameters,
    rng: np.random.Generator,
    *,
    coupled: bool = True,
) -> tuple[FloatArray, FloatArray]:
    """Body and head (n_tracks, n) in radians, given the velocities (n_tracks, n, 2) in m/s.

    Each is sampled from the normalised product of its dynamics and, if ``coupled``, its coupling; the first
    from the coupling alone (the uniform density without one).
    """
    coupling = parameters.coupling if coupled else NO_COUPLING
    # Zeros, not empty memory: the first frame reads its predecessor with weight 0, and 0·NaN is NaN.
    body, head = np.zeros(velocity.shape[:2]), np.zeros(velocity.shape[:2])
    steps: list[float | None] = [None, *np.diff(t).tolist()]
    for k, dt in enumerate(steps):
        before = max(k - 1, 0)
        body[:, k], head[:, k] = _turn(
            dt, velocity[:, k], body[:, before], head[:, before], parameters.orientation, coupling, rng
        )
    return body, head


def _turn(
    dt: float | None,
    velocity: FloatArray,
    body: FloatArray,
    head: FloatArray,
    turning: OrientationParameters,
    coupling: CouplingParameters,
    rng: np.random.Generator,
) -> tuple[FloatArray, FloatArray]:
    """Body and head (m,) ``dt`` seconds (None: the first) on; ``velocity`` (m, 2) is the new one."""
    weight = coupling.weights(dt)
    body_dynamics = 0.0 if dt is None else 1.0 / (turning.body_diffusion * dt)
    head_dynamics = 0.0 if dt is None else 1.0 / (turning.head_diffusion * dt)
    excess = np.maximum(np.linalg.norm(velocity, axis=-1) - coupling.speed_threshold, 0.0)
    pull = weight * coupling.motion_body_kappa * excess**2
    body = wrap(rng.vonmises(*von_mises_product(body, body_dynamics, direction(velocity), pull)))
    pull = np.full(len(body), weight * coupling.head_body_kappa)
    return body, wrap(rng.vonmises(*von_mises_product(head, head_dynamics, body, pull)))


def von_mises_product(
    mean_1: ArrayLike, kappa_1: ArrayLike, mean_2: ArrayLike, kappa_2: ArrayLike
) -> tuple[FloatArray, FloatArray]:
    """Mean (radians) and concentration of the normalised product of two von Mises densities.

    It is again a von Mises, with the resultant κ₁·u(μ₁) + κ₂·u(μ₂).
    """
    resultant = np.asarray(kappa_1) * np.exp(1j * np.asarray(mean_1))
    resultant = resultant + np.asarray(kappa_2) * np.exp(1j * np.asarray(mean_2))
    return np.angle(resultant), np.abs(resultant)


def _missing(rng: np.random.Generator, n_tracks: int, n_steps: int, probability: float) -> np.ndarray:
    lost = rng.random((n_tracks, n_steps)) < probability
    lost[:, 0] = False
    return lost


def _check(n_tracks: int, n_steps: int, fps: float, missing: float) -> None:
    for name, count in (("n_tracks", n_tracks), ("n_steps", n_steps)):
        if count < 1:
            raise InputError(f"{name} = {count!r}", "an integer, at least 1")
    if not (np.isfinite(fps) and fps > 0.0):
        raise InputError(f"fps = {fps!r}", "a positive number of frames a second")
    if not 0.0 <= missing < 1.0:
        raise InputError(f"missing = {missing!r}", "a probability in [0, 1)")
