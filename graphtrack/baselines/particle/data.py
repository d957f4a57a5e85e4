"""What the particle filter's kernels know of a model and a track: arrays with one row a frame."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from graphtrack.baselines.kalman import position_std
from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray, class_centres, class_kappa
from graphtrack.geometry.camera import GroundCamera
from graphtrack.inference.chain.mode_tables import ALWAYS, ModeTable, mode_table, transition
from graphtrack.later import special
from graphtrack.model import Model
from graphtrack.model.terms.body_follows_motion import BodyFollowsMotion
from graphtrack.model.terms.gait import GaitOffsets, gait_of
from graphtrack.model.terms.head_follows_body import HeadFollowsBody
from graphtrack.model.terms.intentional_motion import (
    HEAD_RATE,
    IntentionalMotion,
    head_rates,
    steered_step,
)
from graphtrack.model.terms.motion import Motion
from graphtrack.model.terms.pose import BodyLikelihood, HeadLikelihood
from graphtrack.model.terms.position import PositionLikelihood
from graphtrack.model.terms.turning import BodyDynamics, HeadDynamics
from graphtrack.tracks import Track

PoseModel = Literal["smooth", "closest"]

KNOWN = (
    Motion,
    IntentionalMotion,
    PositionLikelihood,
    BodyDynamics,
    HeadDynamics,
    BodyLikelihood,
    HeadLikelihood,
    BodyFollowsMotion,
    HeadFollowsBody,
    GaitOffsets,
)
"""The terms that the particle filter interprets."""

SHARES = 33
"""Shares of the steering, from 0 to 1, that a step may have where couplings have modes."""

ROBUST = {"none": 0, "huber": 1, "cauchy": 2}


class PackedMotion(NamedTuple):
    """Dynamics, a row for each frame k: of the step from k − 1 to k.

    ``root`` (n, s, 3) is the Cholesky factor [[a, 0], [b, c]] of the noise of position and velocity on each
    axis. Of the velocity ``keep`` (n, s) remains, and it carries the position on for ``reach`` (n, s)
    seconds; for the rest of the step the head steers. Where it does not, they are 1 and the whole step.
    Without modes s is 1, else `SHARES`: the head steers by a share of its rate, from 0 to all of it.
    """

    dt: FloatArray
    keep: FloatArray
    reach: FloatArray
    root: FloatArray
    body_turn_kappa: FloatArray
    head_turn_kappa: FloatArray
    motion_body_kappa: FloatArray
    head_body_kappa: FloatArray
    speed_threshold: float
    has_body: bool
    has_head: bool


class PackedModes(NamedTuple):
    """The m modes and offsets of body and head, as a table of arrays (2, m). Without modes m is 1.

    ``transitions`` (2, q, m, m) has the cumulative probabilities of where each leads to in a step, that to
    frame k the one of the place ``step`` (n,); ``initial`` is cumulative, too. ``seen_share`` is that of the
    steering where a position is seen. The leads (2,) in seconds loosen the couplings as the chain loosens
    those of its newest frame: ``weight`` (n,) and ``diffusion`` as in `coupling_modes.loosened`.
    """

    initial: FloatArray
    transitions: FloatArray
    step: NDArray[np.int64]
    table: ModeTable
    lead: FloatArray
    seen_share: float
    weight: FloatArray
    diffusion: float


class PackedPosition(NamedTuple):
    """Observed positions; ``kind`` is 0 nothing, 1 metres, 2 ideal pixels."""

    kind: NDArray[np.int64]
    value: FloatArray
    std: FloatArray
    robust: int
    threshold: float


class PackedPose(NamedTuple):
    """An observed orientation: a mixture of ``components`` von Mises, or a score for the closest class."""

    components: NDArray[np.int64]
    closest: NDArray[np.bool_]
    log_height: FloatArray
    cos_mean: FloatArray
    sin_mean: FloatArray
    kappa: FloatArray
    log_uniform: FloatArray


class PackedCamera(NamedTuple):
    """The camera, if there is one; ``judge_pose``: orientations were observed in the image frame."""

    to_image: FloatArray
    to_ground: FloatArray
    centre: FloatArray
    has_centre: bool
    sign: float
    judge_pose: bool


@dataclass(frozen=True, eq=False)
class Job:
    """All that a run over one track needs."""

    motion: PackedMotion
    modes: PackedModes
    position: PackedPosition
    body: PackedPose
    head: PackedPose
    camera: PackedCamera


def prepare(
    track: Track, model: Model, camera: GroundCamera | None, pose: PoseModel, image_pose: bool
) -> Job:
    """The arrays of a track under a model.

    Raises
    ------
    InputError
        If the model has a term that the particle filter does not know, or poses are to be judged in the image
        without a camera.
    """
    for term in model.terms:
        if type(term) not in KNOWN:
            raise InputError(
                f"the term {type(term).__name__}, which the particle filter does not know",
                "for it, a model of position, separate, joint-body, joint, intentional, joint-intentional or "
                "full",
            )
    if image_pose and camera is None:
        raise InputError("poses in the image frame without a camera", "a camera of the scene")
    return Job(
        _motion(track, model),
        _modes(track, model),
        _position(track, model, camera),
        _pose(track, model, "body", pose),
        _pose(track, model, "head", pose),
        _camera(camera, image_pose),
    )


def _motion(track: Track, model: Model) -> PackedMotion:
    kinds = {type(term) for term in model.terms}
    parameters = model.parameters
    dt = track.dt
    q = parameters.motion.acceleration_density
    rate = parameters.motion.head_rate if IntentionalMotion in kinds else 0.0
    shares = np.linspace(0.0, 1.0, SHARES) if model.has_modes else np.ones(1)
    moments = steered_step(dt[:, None], shares * head_rates(track.input(HEAD_RATE), rate)[:, None])
    with np.errstate(divide="ignore", invalid="ignore"):
        place = np.sqrt(q * moments.place)
        cross = q * moments.cross / place
        spread = np.sqrt(q * moments.spread - cross**2)
        body_turn = 1.0 / (parameters.orientation.body_diffusion * dt)
        head_turn = 1.0 / (parameters.orientation.head_diffusion * dt)
    coupling = parameters.coupling
    weight = coupling.weights(dt)
    return PackedMotion(
        dt,
        moments.keep,
        moments.reach,
        np.stack([place, cross, spread], axis=2),
        body_turn,
        head_turn,
        weight * (coupling.motion_body_kappa if BodyFollowsMotion in kinds else 0.0),
        weight * (coupling.head_body_kappa if HeadFollowsBody in kinds else 0.0),
        coupling.speed_threshold,
        model.has_body,
        model.has_head,
    )


def _modes(track: Track, model: Model) -> PackedModes:
    parameters = model.parameters
    weight = parameters.coupling.weights(track.dt)
    diffusion = parameters.orientation.body_diffusion
    if not model.has_modes:
        tables, lead, seen_share = (ALWAYS, ALWAYS), np.zeros(2), 1.0
        transitions, step = np.ones((2, 1, 1, 1)), np.zeros(len(track), dtype=np.int64)
    else:
        gait = gait_of(parameters.gait)
        both = gait.body, gait.head if track.head_likelihood is None else gait.classified_head
        tables = mode_table(both[0]), mode_table(both[1])
        lead, seen_share = np.array([modes.lead for modes in both]), gait.head_rate_seen
        # To the millisecond: rounding of times would make each step one of its own.
        times, step = np.unique(np.round(track.dt, 3), return_inverse=True)
        transitions = np.array([[transition(modes, dt) for dt in times.tolist()] for modes in both])
    table = ModeTable(*(np.stack(pair) for pair in zip(*tables, strict=True)))
    return PackedModes(
        table.initial.cumsum(axis=1),
        transitions.cumsum(axis=3),
        step.astype(np.int64),
        table,
        lead,
        seen_share,
        weight,
        diffusion,
    )


def _position(track: Track, model: Model, camera: GroundCamera | None) -> PackedPosition:
    likelihood = model.parameters.likelihood
    value, std = track.position.copy(), position_std(track, model.parameters)
    kind = np.array(np.isfinite(value).all(axis=1), dtype=np.int64)
    if likelihood.image_frame and track.pixel is not None and camera is not None:
        ideal = camera.undistort(track.pixel)
        seen = np.isfinite(ideal).all(axis=1)
        kind[seen], value[seen], std[seen] = 2, ideal[seen], likelihood.pixel_std
    return PackedPosition(kind, value, std, ROBUST[likelihood.robust], likelihood.robust_threshold)


def _pose(track: Track, model: Model, name: Literal["body", "head"], pose: PoseModel) -> PackedPose:
    likelihood, n = model.parameters.likelihood, len(track)
    classes = getattr(track, f"{name}_likelihood")
    size = 1 if classes is None else classes.shape[1]
    found = PackedPose(
        np.zeros(n, dtype=np.int64),
        np.zeros(n, dtype=bool),
        np.full((n, size), -np.inf),
        np.ones((n, size)),
        np.zeros((n, size)),
        np.zeros(n),
        np.full(n, -np.inf),
    )
    angle, kappa = getattr(track, name), getattr(track, f"{name}_kappa")
    if angle is not None:
        own = likelihood.kappas(name, kappa, n)
        seen = np.isfinite(angle) & (own > 0.0)
        _fill(
            found,
            seen,
            np.ones((seen.sum(), 1)),
            angle[seen, None],
            own[seen],
            likelihood.outlier_probability,
        )
    if classes is not None:
        usable = np.isfinite(classes).all(axis=1)
        usable[usable] = classes[usable].sum(axis=1) > 0.0
        scores = classes[usable] / classes[usable].sum(axis=1, keepdims=True)
        centres = np.broadcast_to(class_centres(size), scores.shape)
        concentration = np.full(len(scores), class_kappa(size))
        _fill(found, usable, scores, centres, concentration, likelihood.class_outlier_probability)
        if pose == "closest":
            uniform = likelihood.class_outlier_probability
            found.closest[usable] = True
            with np.errstate(divide="ignore"):
                found.log_height[usable] = np.log((uniform + (1.0 - uniform) * size * scores) / (2.0 * np.pi))
    return found


def _fill(
    pose: PackedPose,
    rows: NDArray[np.bool_],
    weights: FloatArray,
    means: FloatArray,
    kappa: FloatArray,
    uniform: float,
) -> None:
    """The mixture ε/2π + (1 − ε)·Σ w_k·VM(θ; μ_k, κ) of an orientation seen (docs/model.md, Outliers); see
    `mixture_log_density`."""
    size = weights.shape[1]
    peak = 1.0 / (2.0 * np.pi * special.i0e(kappa))
    pose.components[rows], pose.kappa[rows] = size, kappa
    columns = np.ix_(np.flatnonzero(rows), np.arange(size))
    with np.errstate(divide="ignore"):
        pose.log_height[columns] = np.log((1.0 - uniform) * weights * peak[:, None])
        pose.log_uniform[rows] = np.log(uniform / (2.0 * np.pi))
    pose.cos_mean[columns], pose.sin_mean[columns] = np.cos(means), np.sin(means)


def _camera(camera: GroundCamera | None, image_pose: bool) -> PackedCamera:
    if camera is None:
        return PackedCamera(np.eye(3), np.eye(3), np.zeros(2), False, 1.0, False)
    centre = camera.optical_centre_on_ground
    # Arrays that may be written to: those of the camera may not, and would have everything compiled again.
    return PackedCamera(
        np.array(np.linalg.inv(camera.homography), order="C"),
        np.array(camera.homography, order="C"),
        np.zeros(2) if centre is None else np.array(centre, dtype=float),
        centre is not None,
        -1.0 if camera.is_mirrored else 1.0,
        image_pose,
    )
