"""Body and head sampled from the graph's own density given the motion: couplings, modes and steering."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from graphtrack.geometry.angles import FloatArray, wrap
from graphtrack.model import GaitParameters, Model
from graphtrack.model.terms.body_follows_motion import BodyFollowsMotion
from graphtrack.model.terms.gait import BINS, gait_of
from graphtrack.model.terms.head_follows_body import HeadFollowsBody
from graphtrack.model.terms.intentional_motion import smooth_speed, steered_step
from graphtrack.simulation.courses import sample_course

_SWEEPS = 2
"""Gibbs sampling begins where it nearly ends: head and body hold each other loosely beside the rest."""


@dataclass(frozen=True, eq=False)
class ModeCourse:
    """Modes of one coupling, frame by frame.

    Attributes
    ----------
    aligned : (n_tracks, n) whether the coupling rests near 0
    glancing : (n_tracks, n) whether it rests at the angle of a glance
    offset : (n_tracks, n) radians at which it rests
    strength : (n_tracks, n) multiple of its κ
    lead : seconds by which it looks ahead
    """

    aligned: np.ndarray
    glancing: np.ndarray
    offset: FloatArray
    strength: FloatArray
    lead: float


class Modes(NamedTuple):
    """The modes of both couplings."""

    body: ModeCourse
    head: ModeCourse

    @property
    def ahead(self) -> FloatArray:
        """Cosine (n_tracks, n) of heads to the motion, from 0 to 1: so far they steer it.

        A glance does not.
        """
        along = np.maximum(np.cos(self.body.offset + self.head.offset), 0.0)
        return np.where(self.head.glancing, 0.0, along)


def without_modes(n_tracks: int, n: int) -> Modes:
    """Couplings as Chen et al. (2011) have them: at rest at 0, without a lead."""
    always = np.ones((n_tracks, n), bool)
    course = ModeCourse(always, ~always, np.zeros((n_tracks, n)), np.ones((n_tracks, n)), 0.0)
    return Modes(course, course)


def sample_modes(t: FloatArray, n_tracks: int, gait: GaitParameters, rng: np.random.Generator) -> Modes:
    """Modes and offsets of both couplings at the times ``t`` (n,) seconds.

    They begin as in the long run. At the rate ``switching`` both are drawn anew; the offset of the free mode
    drifts, that of the aligned one stays. Heads glance aside for a while, and after that both are drawn anew.
    """
    return Modes(*(_modes_of(side, t, n_tracks, gait, rng) for side in ("body", "head")))


def _modes_of(
    side: str, t: FloatArray, n_tracks: int, parameters: GaitParameters, rng: np.random.Generator
) -> ModeCourse:
    names = ("aligned", "switching", "spread", "drift", "strength", "free_strength", "lead", "offset_kappa")
    modes = getattr(gait_of(parameters), side)
    around, nobody = 2.0 * np.pi * np.arange(BINS) / BINS, np.zeros(n_tracks, bool)
    gait = {name: float(getattr(parameters, f"{side}_{name}")) for name in names}
    n = len(t)
    aligned, glancing = np.empty((n_tracks, n), bool), np.empty((n_tracks, n), bool)
    offset = np.empty((n_tracks, n))
    for k, dt in enumerate([np.inf, *np.diff(t).tolist()]):
        near = rng.random(n_tracks) < gait["aligned"]
        anew = np.where(
            near,
            gait["spread"] * rng.standard_normal(n_tracks),
            rng.vonmises(0.0, gait["offset_kappa"], n_tracks),
        )
        glance = rng.choice(around, n_tracks, p=modes.glance)
        # Two states that change at random, each at its rate; the long run to begin with.
        before = glancing[:, k - 1] if k > 0 else nobody
        changed = rng.random(n_tracks) < -np.expm1(-modes.glance_change * dt)
        drawn = rng.random(n_tracks) < modes.glance_share
        begins, ends = changed & drawn & ~before, changed & ~drawn & before
        glancing[:, k] = (before & ~ends) | begins
        if k == 0:
            aligned[:, k], offset[:, k] = near & ~begins, np.where(begins, glance, anew)
            continue
        drifted = offset[:, k - 1] + np.sqrt(gait["drift"] * dt) * rng.standard_normal(n_tracks)
        kept = np.where(aligned[:, k - 1] | before, offset[:, k - 1], drifted)
        changes = ~before & (rng.random(n_tracks) < -np.expm1(-gait["switching"] * dt)) | ends
        aligned[:, k] = np.where(changes, near, aligned[:, k - 1]) & ~begins
        offset[:, k] = np.where(begins, glance, np.where(changes, anew, kept))
    strength = np.where(aligned, gait["strength"], gait["free_strength"])
    strength = np.where(glancing, modes.glance_strength, strength)
    return ModeCourse(aligned, glancing, wrap(offset), strength, gait["lead"])


def sample_orientations(
    t: FloatArray,
    velocity: FloatArray,
    model: Model,
    rng: np.random.Generator,
    *,
    modes: Modes | None = None,
    rate: FloatArray | float = 0.0,
) -> tuple[FloatArray, FloatArray]:
    """Body and head (n_tracks, n) in radians, given the velocities (n_tracks, n, 2) in m/s.

    The body is drawn from the density of its turns and of its coupling to the motion, over the whole chain;
    then the head, from that of its turns, of its coupling to the body, and of the motion that it steers; then
    both once more, the body given the head as well.

    Parameters
    ----------
    model : whose terms say what is coupled, and whether the couplings have modes
    modes : of both couplings; None: without
    rate : λ in 1/s with which the head steers the motion, of all steps or of each, (n_tracks, n − 1)
    """
    parameters, (n_tracks, n) = model.parameters, velocity.shape[:2]
    turning, coupling = parameters.orientation, parameters.coupling
    body_modes, head_modes = without_modes(n_tracks, n) if modes is None else modes
    weights = coupling.weights(np.concatenate([[0.0], np.diff(t)]))
    of_motion, of_body = np.zeros((n_tracks, n), complex), np.zeros((n_tracks, n))
    if model.has_term(BodyFollowsMotion):
        course = np.angle(_leading(t, velocity[..., 0] + 1j * velocity[..., 1], body_modes.lead))
        excess = np.maximum(np.linalg.norm(velocity, axis=-1) - coupling.speed_threshold, 0.0) ** 2
        kappa = coupling.motion_body_kappa * body_modes.strength * excess
        kappa = weights * _loosened(t, kappa, body_modes.lead, turning.body_diffusion)
        of_motion = kappa * np.exp(1j * (course + body_modes.offset))
    if model.has_term(HeadFollowsBody):
        kappa = coupling.head_body_kappa * head_modes.strength
        of_body = weights * _loosened(t, kappa, head_modes.lead, turning.body_diffusion)
    steering = np.zeros((n_tracks, n), complex)
    rate = np.broadcast_to(rate, (n_tracks, n - 1))
    steering[:, :-1] = _steering(t, velocity, rate, parameters.motion.acceleration_density)

    of_head = np.zeros((n_tracks, n), complex)
    for _ in range(_SWEEPS if of_body.any() else 1):
        body = sample_course(t, turning.body_diffusion, of_motion + of_head, rng)
        target = _leading(t, np.unwrap(body, axis=1), head_modes.lead) + head_modes.offset
        head = sample_course(t, turning.head_diffusion, of_body * np.exp(1j * target) + steering, rng)
        of_head = _led(t, of_body * np.exp(1j * (head - head_modes.offset)), head_modes.lead)
    return body, head


def _leading(t: FloatArray, values: np.ndarray, lead: float) -> np.ndarray:
    """Values (n_tracks, n) ``lead`` seconds after each frame, straight on between frames; the last beyond."""
    if lead == 0.0:
        return values
    return np.stack([np.interp(t + lead, t, own) for own in values])


def _led(t: FloatArray, pull: np.ndarray, lead: float) -> np.ndarray:
    """Pulls (n_tracks, n) on what stands ``lead`` seconds after each frame, as pulls on the frames there."""
    place = np.interp(t + lead, t, np.arange(len(t)))
    at = place.astype(np.int64)
    share, found = place - at, np.zeros_like(pull.T)
    np.add.at(found, at, ((1.0 - share) * pull).T)
    np.add.at(found, np.minimum(at + 1, len(t) - 1), (share * pull).T)
    return found.T


def _loosened(t: FloatArray, kappa: FloatArray, lead: float, diffusion: float) -> FloatArray:
    """Concentrations (n_tracks, n) where the lead reaches past the end: so far the one may have turned."""
    missing = np.maximum(lead - (t[-1] - t), 0.0)
    return kappa / (1.0 + kappa * diffusion * missing)


def _steering(t: FloatArray, velocity: FloatArray, rate: FloatArray, density: float) -> np.ndarray:
    """Return the pulls of velocities on the heads that steered them, (n_tracks, n − 1)."""
    before = velocity[:, :-1]
    step = steered_step(np.broadcast_to(np.diff(t), rate.shape), rate)
    gain = 1.0 - step.keep
    turn = velocity[:, 1:] - step.keep[..., None] * before
    strength = gain * smooth_speed(before) / (density * step.spread)
    return strength * (turn[..., 0] + 1j * turn[..., 1])
