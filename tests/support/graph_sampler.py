"""People drawn from the graph's own density, motion included, where `simulate` keeps to a walking pace.

The couplings reweigh the motion there, so that no recursion forward in time samples it. A particle filter
whose observations are the couplings does, with backward simulation: each track is one draw, exact as the
number of particles grows.
"""

from dataclasses import dataclass

import numpy as np
from scipy import special
from von_mises import von_mises_product

from graphtrack.geometry.angles import FloatArray, direction, wrap
from graphtrack.model import CouplingParameters, Parameters
from graphtrack.tracks.track import Track, TrackSet


@dataclass(frozen=True, eq=False)
class Cloud:
    """Weighted particles of one frame: velocity (p, 2), body and head (p,), logarithms of their weights."""

    velocity: FloatArray
    angles: FloatArray  # (2, p)
    log_weight: FloatArray


def turn(
    before: FloatArray, dynamics: float, towards: FloatArray, pull: FloatArray, rng: np.random.Generator
) -> tuple[FloatArray, FloatArray]:
    """Angles from the normalised product of turning and coupling, and the logarithms of its normaliser."""
    mean, kappa = von_mises_product(before, dynamics, towards, pull)
    log_mass = np.log(special.i0e(kappa) / special.i0e(dynamics)) + kappa - dynamics - pull
    return wrap(rng.vonmises(mean, kappa)), log_mass


def filtered(
    t: FloatArray, parameters: Parameters, particles: int, rng: np.random.Generator
) -> tuple[list[Cloud], float]:
    """The clouds of all frames, and the logarithm of the couplings' mean under the uncoupled model."""
    motion, turning, coupling = parameters.motion, parameters.orientation, parameters.coupling
    clouds: list[Cloud] = []
    log_mean = 0.0
    for dt in [None, *np.diff(t).tolist()]:
        if dt is None:
            velocity = motion.initial_speed_std * rng.standard_normal((particles, 2))
            angles, kappas = np.zeros((2, particles)), (0.0, 0.0)
        else:
            weight = np.exp(clouds[-1].log_weight)
            chosen = np.searchsorted(np.cumsum(weight), (np.arange(particles) + rng.random()) / particles)
            chosen = np.minimum(chosen, particles - 1)
            noise = np.sqrt(motion.acceleration_density * dt) * rng.standard_normal((particles, 2))
            velocity, angles = clouds[-1].velocity[chosen] + noise, clouds[-1].angles[:, chosen]
            kappas = 1.0 / (turning.body_diffusion * dt), 1.0 / (turning.head_diffusion * dt)
        share = coupling.weights(dt)
        excess = np.maximum(np.linalg.norm(velocity, axis=1) - coupling.speed_threshold, 0.0)
        body, first = turn(
            angles[0], kappas[0], direction(velocity), share * coupling.motion_body_kappa * excess**2, rng
        )
        pull = np.full(particles, share * coupling.head_body_kappa)
        head, second = turn(angles[1], kappas[1], body, pull, rng)
        log_weight = first + second
        total = float(special.logsumexp(log_weight))
        log_mean += total - np.log(particles)
        clouds.append(Cloud(velocity, np.array([body, head]), log_weight - total))
    return clouds, log_mean


def draw(
    t: FloatArray, parameters: Parameters, particles: int, rng: np.random.Generator
) -> tuple[FloatArray, FloatArray]:
    """Velocities (n, 2) and angles (2, n) of one person."""
    clouds, _ = filtered(t, parameters, particles, rng)
    dt, n = np.diff(t), len(t)
    velocity, angles = np.empty((n, 2)), np.empty((2, n))
    for k in range(n - 1, -1, -1):
        cloud = clouds[k]
        log_weight = cloud.log_weight
        if k < n - 1:
            variance = parameters.motion.acceleration_density * dt[k]
            log_weight = log_weight - 0.5 * np.sum((velocity[k + 1] - cloud.velocity) ** 2, axis=1) / variance
            for i, name in enumerate(("body", "head")):
                kappa = 1.0 / (getattr(parameters.orientation, f"{name}_diffusion") * dt[k])
                log_weight = log_weight + kappa * np.cos(angles[i, k + 1] - cloud.angles[i])
        weight = np.exp(log_weight - log_weight.max())
        chosen = rng.choice(len(weight), p=weight / weight.sum())
        velocity[k], angles[:, k] = cloud.velocity[chosen], cloud.angles[:, chosen]
    return velocity, angles


def sample_graph(
    parameters: Parameters,
    *,
    n_tracks: int,
    n_steps: int,
    fps: float = 10.0,
    rng: np.random.Generator,
    particles: int = 1000,
) -> TrackSet:
    """People of `joint` with their truth, observed by the parameters, without declared noise."""
    t, likelihood, tracks = np.arange(n_steps) / fps, parameters.likelihood, []
    for i in range(n_tracks):
        velocity, (body, head) = draw(t, parameters, particles, rng)
        # Between its ends a step of white-noise acceleration is off the mean velocity by q·Δt³/12.
        bend = np.sqrt(parameters.motion.acceleration_density * fps**-3 / 12.0)
        moved = 0.5 * (velocity[1:] + velocity[:-1]) / fps + bend * rng.standard_normal((n_steps - 1, 2))
        position = np.vstack([np.zeros(2), np.cumsum(moved, axis=0)])
        tracks.append(
            Track(
                i,
                np.arange(n_steps),
                t,
                position + likelihood.position_std * rng.standard_normal(position.shape),
                body=wrap(body + rng.vonmises(0.0, likelihood.body_kappa, n_steps)),
                head=wrap(head + rng.vonmises(0.0, likelihood.head_kappa, n_steps)),
                true_position=position,
                true_body=body,
                true_head=head,
            )
        )
    return TrackSet(tuple(tracks))


COUPLED = CouplingParameters(12.0, 0.2, 4.0, 0.3)
