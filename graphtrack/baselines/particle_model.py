"""The model and a track, packed for the particle filter's kernels, and its compiled densities."""

from __future__ import annotations

import math
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from graphtrack.baselines.kalman import position_std
from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray, class_centres, class_kappa
from graphtrack.geometry.camera import GroundCamera
from graphtrack.kernels.compilation import compiled
from graphtrack.model import Model
from graphtrack.model.terms.classes import HIDDEN, class_evidence, class_weights
from graphtrack.model.terms.couplings import (
    BODY_FREE,
    HEAD_FREE,
    BodyFollowsMotion,
    HeadFollowsBody,
    held,
)
from graphtrack.model.terms.motion import HEAD_RATE, IntentionalMotion, Motion, head_rates, steered_step
from graphtrack.model.terms.orientation import (
    BodyDynamics,
    BodyLikelihood,
    HeadDynamics,
    HeadLikelihood,
)
from graphtrack.model.terms.position import PositionLikelihood
from graphtrack.packages import special
from graphtrack.tracks.track import Track

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
)
"""The terms that the particle filter interprets."""

ROBUST = {"none": 0, "huber": 1, "cauchy": 2}


class PackedMotion(NamedTuple):
    """Dynamics, a row for each frame k: of the step from k − 1 to k.

    ``root`` (n, 3) is the Cholesky factor [[a, 0], [b, c]] of the noise of position and velocity on each
    axis. Of the velocity ``keep`` (n,) remains, and it carries the position on for ``reach`` (n,) seconds;
    for the rest of the step the head steers. Where it does not, they are 1 and the whole step.
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


X, Y, VX, VY, BODY, HEAD = range(6)
"""Columns of particles: metres, m/s and radians."""


class Job(NamedTuple):
    """All that a run over one track needs."""

    motion: PackedMotion
    position: PackedPosition
    body: PackedPose
    head: PackedPose
    camera: PackedCamera


def prepare(
    track: Track, model: Model, camera: GroundCamera | None, pose: PoseModel, image_pose: bool
) -> Job:
    """The arrays of a track under a model; InputError for an unknown term, or without a camera."""
    for term in model.terms:
        if type(term) not in KNOWN:
            known = "position, separate, joint-body, joint, intentional or joint-intentional"
            raise InputError(
                f"the term {term.label}, which the particle filter does not know",
                f"for it, a model of {known}",
            )
    if image_pose and camera is None:
        raise InputError("poses in the image frame without a camera", "a camera of the scene")
    return Job(
        _motion(track, model),
        _position(track, model, camera),
        _pose(track, model, "body", pose),
        _pose(track, model, "head", pose),
        _camera(camera, image_pose),
    )


def _motion(track: Track, model: Model) -> PackedMotion:
    kinds = {type(term) for term in model.terms}
    parameters, coupling, dt = model.parameters, model.parameters.coupling, track.dt
    q = parameters.motion.acceleration_density
    rate = parameters.motion.head_rate if IntentionalMotion in kinds else 0.0
    moments = steered_step(dt, head_rates(track.input(HEAD_RATE), rate))
    with np.errstate(divide="ignore", invalid="ignore"):
        place = np.sqrt(q * moments.place)
        cross = q * moments.cross / place
        spread = np.sqrt(q * moments.spread - cross**2)
        body_turn = 1.0 / (parameters.orientation.body_diffusion * dt)
        head_turn = 1.0 / (parameters.orientation.head_diffusion * dt)
    weight = coupling.weights(dt)
    body_kappa = coupling.motion_body_kappa if BodyFollowsMotion in kinds else 0.0
    head_kappa = coupling.head_body_kappa if HeadFollowsBody in kinds else 0.0
    return PackedMotion(
        dt,
        moments.keep,
        moments.reach,
        np.stack([place, cross, spread], axis=1),
        body_turn,
        head_turn,
        weight * held(track.input(BODY_FREE)) * body_kappa,
        weight * held(track.input(HEAD_FREE)) * head_kappa,
        coupling.speed_threshold,
        model.has_body,
        model.has_head,
    )


def _position(track: Track, model: Model, camera: GroundCamera | None) -> PackedPosition:
    likelihood = model.parameters.likelihood
    value, std = track.position.copy(), position_std(track, model.parameters)
    kind = np.array(np.isfinite(value).all(axis=1), dtype=np.int64)
    if likelihood.image_frame and track.pixel is not None and camera is not None:
        ideal = camera.undistort(track.pixel)
        known = np.isfinite(ideal).all(axis=1)
        kind[known], value[known], std[known] = 2, ideal[known], likelihood.pixel_std
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
        known = np.isfinite(angle) & (own > 0.0)
        weights, outliers = np.ones((known.sum(), 1)), likelihood.outliers(name)
        _fill(found, known, weights, angle[known, None], own[known], outliers)
    if classes is not None:
        uniform = likelihood.outliers(name, by_class=True)
        weight = class_weights(track, name, likelihood)
        classes = class_evidence(classes, track.input(HIDDEN[name]), weight, uniform, likelihood)
        usable = np.asarray(np.isfinite(classes).all(axis=1))
        usable[usable] = classes[usable].sum(axis=1) > 0.0
        scores = classes[usable] / classes[usable].sum(axis=1, keepdims=True)
        centres = np.broadcast_to(class_centres(size), scores.shape)
        concentration = np.full(len(scores), class_kappa(size))
        _fill(found, usable, scores, centres, concentration, uniform)
        if pose == "closest":
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
    """The mixture ε/2π + (1 − ε)·Σ w_k·VM(θ; μ_k, κ) of an orientation seen (docs/model/pose.md)."""
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


@compiled
def wrapped(angle: float) -> float:
    """The angle in (−π, π]."""
    return math.pi - (math.pi - angle) % (2.0 * math.pi)


@compiled
def sample_von_mises(rng: np.random.Generator, mean: float, kappa: float) -> float:
    """One von Mises variate in (−π, π] (Best & Fisher 1979)."""
    if kappa < 1e-8:
        return math.pi * (2.0 * rng.random() - 1.0)
    if kappa > 1e6:
        return wrapped(mean + rng.standard_normal() / math.sqrt(kappa))
    if kappa < 1e-5:
        shape = 1.0 / kappa + kappa
    else:
        r = 1.0 + math.sqrt(1.0 + 4.0 * kappa * kappa)
        rho = (r - math.sqrt(2.0 * r)) / (2.0 * kappa)
        shape = (1.0 + rho * rho) / (2.0 * rho)
    while True:
        z = math.cos(math.pi * rng.random())
        w = (1.0 + shape * z) / (shape + z)
        y = kappa * (shape - w)
        v = rng.random()
        if y * (2.0 - y) >= v or math.log(y / v) + 1.0 - y >= 0.0:
            break
    deviation = math.acos(min(max(w, -1.0), 1.0))
    return wrapped(mean + (deviation if rng.random() < 0.5 else -deviation))


@compiled
def add_position_log_density(
    particles: FloatArray, k: int, position: PackedPosition, camera: PackedCamera, found: FloatArray
) -> None:
    """Add to ``found`` (n,) the log-likelihood of the position at frame k (Chen et al. 2011, eq. 12)."""
    kind = position.kind[k]
    if kind == 0:
        return
    x_observed, y_observed = position.value[k]
    scale = 1.0 / position.std[k]
    peak = math.log(scale * scale / (2.0 * math.pi))
    robust, threshold = position.robust, position.threshold
    h = camera.to_image
    for i in range(len(particles)):
        x, y = particles[i, X], particles[i, Y]
        if kind == 2:
            depth = h[2, 0] * x + h[2, 1] * y + h[2, 2]
            if depth <= 0.0:
                found[i] = -math.inf
                continue
            x, y = (
                (h[0, 0] * x + h[0, 1] * y + h[0, 2]) / depth,
                (h[1, 0] * x + h[1, 1] * y + h[1, 2]) / depth,
            )
        dx, dy = scale * (x - x_observed), scale * (y - y_observed)
        squared = dx * dx + dy * dy
        loss = 0.5 * squared
        if robust == 1 and squared > threshold * threshold:
            loss = threshold * (math.sqrt(squared) - 0.5 * threshold)
        elif robust == 2:
            loss = 0.5 * threshold * threshold * math.log(1.0 + squared / (threshold * threshold))
        found[i] += peak - loss


@compiled
def bearing(x: float, y: float, camera: PackedCamera) -> float:
    """World direction in which the camera looks at a ground point, as `GroundCamera.ray_bearing`."""
    if camera.has_centre:
        return math.atan2(y - camera.centre[1], x - camera.centre[0])
    g, h = camera.to_image, camera.to_ground
    depth = g[2, 0] * x + g[2, 1] * y + g[2, 2]
    u = (g[0, 0] * x + g[0, 1] * y + g[0, 2]) / depth
    v = (g[1, 0] * x + g[1, 1] * y + g[1, 2]) / depth
    top_x = h[0, 0] * u + h[0, 1] * v + h[0, 2]
    top_y = h[1, 0] * u + h[1, 1] * v + h[1, 2]
    below = h[2, 0] * u + h[2, 1] * v + h[2, 2]
    # Up the image column: the derivative by −v, times the positive below².
    return math.atan2(-(h[1, 1] * below - top_y * h[2, 1]), -(h[0, 1] * below - top_x * h[2, 1]))


@compiled
def add_pose_log_density(
    particles: FloatArray, column: int, k: int, pose: PackedPose, camera: PackedCamera, found: FloatArray
) -> None:
    """Add to ``found`` (n,) the log-likelihood of an orientation at frame k (Chen et al. 2011, eq. 13–14).

    ``column``: `BODY` or `HEAD`
    """
    count = pose.components[k]
    if count == 0:
        return
    for i in range(len(particles)):
        angle = particles[i, column]
        if camera.judge_pose:
            angle = camera.sign * (angle - bearing(particles[i, X], particles[i, Y], camera) - math.pi)
        if pose.closest[k]:
            nearest = math.floor(angle * count / (2.0 * math.pi) + 0.5) % count
            found[i] += pose.log_height[k, nearest]
        else:
            found[i] += mixture_log_density(
                math.cos(angle),
                math.sin(angle),
                pose.log_height[k, :count],
                pose.cos_mean[k],
                pose.sin_mean[k],
                pose.kappa[k],
                pose.log_uniform[k],
            )


@compiled
def mixture_log_density(
    cos: float,
    sin: float,
    log_height: FloatArray,
    cos_mean: FloatArray,
    sin_mean: FloatArray,
    kappa: float,
    log_uniform: float,
) -> float:
    """Log of a uniform density plus von Mises of given heights, without underflow far from sharp ones."""
    greatest = log_uniform
    for j in range(len(log_height)):
        value = log_height[j] + kappa * (cos * cos_mean[j] + sin * sin_mean[j] - 1.0)
        greatest = max(greatest, value)
    if len(log_height) == 1 and log_uniform == -math.inf:
        return greatest
    density = math.exp(log_uniform - greatest)
    for j in range(len(log_height)):
        value = log_height[j] + kappa * (cos * cos_mean[j] + sin * sin_mean[j] - 1.0)
        density += math.exp(value - greatest)
    return greatest + math.log(density)
