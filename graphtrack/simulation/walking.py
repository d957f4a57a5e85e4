"""Velocities of people whose body and head are coupled to the motion."""

from __future__ import annotations

import numpy as np

from graphtrack.geometry.angles import FloatArray, direction, unit
from graphtrack.later import special
from graphtrack.model import CouplingParameters, Parameters
from graphtrack.model.terms.intentional_motion import smooth_speed
from graphtrack.simulation.motion import first_velocity, next_velocity
from graphtrack.simulation.orientations import Modes

_CANDIDATES = 32


def sample_coupled_velocity(
    t: FloatArray,
    modes: Modes,
    parameters: Parameters,
    rng: np.random.Generator,
    *,
    pace: float | None,
    rate: FloatArray,
    head_coupled: bool = True,
) -> FloatArray:
    """Velocities (n_tracks, n, 2) in m/s that the couplings have held to the body, and the head has steered.

    A velocity is chosen among candidates of the motion terms by how well a body can follow it from where it
    was. What is to come says of a body that is off the motion as much as it does in the long run: a von Mises
    whose concentration the pulls and the diffusion balance. Body and head on the way are let go again, for
    `sample_orientations` draws them given all velocities. Couplings do not slow people down here, as their
    density would: only in its direction is the motion theirs.

    ``rate``: λ in 1/s (n_tracks, n − 1) with which the head steers each step
    """
    motion, turning, coupling = parameters.motion, parameters.orientation, parameters.coupling
    n_tracks, n = modes.body.offset.shape
    start = first_velocity(n_tracks, motion, rng, pace)
    velocity = np.empty((n_tracks, n, 2))
    velocity[:, 0] = start.velocity
    body = direction(start.velocity) + modes.body.offset[:, 0]
    head = body + modes.head.offset[:, 0]
    of_head = coupling.head_body_kappa if head_coupled else 0.0
    rows = np.arange(n_tracks)
    for k, dt in enumerate(np.diff(t).tolist(), start=1):
        before = velocity[:, k - 1]
        aim = (smooth_speed(before)[:, None] * unit(head))[:, None]
        before = np.broadcast_to(before[:, None], (n_tracks, _CANDIDATES, 2))
        found = next_velocity(before, aim, rate[:, k - 1, None], dt, start.pace, motion, rng)
        weight = float(coupling.weights(dt))
        body_kappa, head_kappa = 1.0 / (turning.body_diffusion * dt), 1.0 / (turning.head_diffusion * dt)
        head_pull = _held(weight * of_head * modes.head.strength[:, k], turning.head_diffusion * dt)
        # The head that was, and how it turns, say where the body is.
        said = np.divide(1.0, 1.0 / np.maximum(head_pull, 1e-12) + 1.0 / head_kappa)
        past = body_kappa * np.exp(1j * body) + said * np.exp(1j * (head - modes.head.offset[:, k]))
        speed = np.linalg.norm(found, axis=-1)
        pull = _body_pull(speed, weight, modes.body.strength[:, k, None], coupling)
        relative = turning.body_diffusion + motion.acceleration_density / np.maximum(speed, 0.1) ** 2
        pull = _held(pull, relative * dt)
        course = direction(found) + modes.body.offset[:, k, None]
        resultant = past[:, None] + pull * np.exp(1j * course)
        size, known = np.abs(resultant), np.abs(past)[:, None]
        # Against a body that agrees with the motion: how fast people go is no matter of the coupling.
        fit = np.log(special.i0e(size)) + size - np.log(special.i0e(known + pull)) - known - pull
        best = np.cumsum(np.exp(fit - fit.max(axis=1, keepdims=True)), axis=1)
        one = (best < rng.random((n_tracks, 1)) * best[:, -1:]).sum(axis=1)
        velocity[:, k] = found[rows, one]
        chosen = resultant[rows, one]
        body = rng.vonmises(np.angle(chosen), np.abs(chosen))
        chosen = head_kappa * np.exp(1j * head) + head_pull * np.exp(1j * (body + modes.head.offset[:, k]))
        head = rng.vonmises(np.angle(chosen), np.abs(chosen))
    return velocity


def _body_pull(
    speed: FloatArray, weight: float, strength: FloatArray, coupling: CouplingParameters
) -> FloatArray:
    excess = np.maximum(speed - coupling.speed_threshold, 0.0)
    return weight * coupling.motion_body_kappa * strength * excess**2


def _held(pull: FloatArray, turned: FloatArray | float) -> FloatArray:
    """Concentration of this frame's pull and of all to come, where a frame turns by the variance ``turned``.

    It is the fixed point P of P = pull + 1/(1/P + turned).
    """
    return 0.5 * pull + np.sqrt(0.25 * pull**2 + pull / turned)
