"""The joint particle filter of Chen, Heili & Odobez (2011, §3), and its backward-simulation smoother.

A bootstrap filter on the `Model` of the factor graph with the state p, v, θ, α. The angles are drawn from the
*normalised* product of the von Mises of their dynamics and of their coupling (eq. 8 and 10). Chen et al.'s
baseline, κ₂ = 0, is the preset ``joint-body``.
"""

from __future__ import annotations

import itertools
import warnings
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from graphtrack.baselines.particle_kernels import (
    FIRST,
    RECOVERED,
    VANISHED,
    FilterOutput,
    Start,
    Used,
    backward,
    generator,
    run,
    summarise,
)
from graphtrack.baselines.particle_model import (
    BODY,
    HEAD,
    VX,
    Job,
    PackedCamera,
    PackedPose,
    PoseModel,
    add_pose_log_density,
    add_position_log_density,
    bearing,
    prepare,
)
from graphtrack.errors import NO_POSITION, InputError, InputWarning, SolveError
from graphtrack.geometry.angles import FloatArray, wrap
from graphtrack.geometry.camera import GroundCamera, apply_homography
from graphtrack.kernels.compilation import TRACK, Rehearsal, make_ready
from graphtrack.model import Model
from graphtrack.tracks.track import Track


def draw_states(
    job: Job, k: int, count: int, initial_speed_std: float, rng: np.random.Generator
) -> FloatArray:
    """Positions about the one observed at frame k and velocities from their prior, (count, 4)."""
    position = job.position
    found = position.value[k] + position.std[k] * rng.standard_normal((count, 2))
    if position.kind[k] == 2:
        found = np.where(_visible(job, found)[:, None], found, position.value[k])
        found = apply_homography(job.camera.to_ground, found)
    return np.hstack([found, initial_speed_std * rng.standard_normal((count, 2))])


def recover(
    job: Job, k: int, particles: FloatArray, initial_speed_std: float, rng: np.random.Generator
) -> Used:
    """Redraw in ``particles`` (n, 6) states out of reach at frame k; return the used observations."""
    reach: dict[str, float] = {}
    found = np.zeros(len(particles))
    if job.position.kind[k]:
        add_position_log_density(particles, k, job.position, job.camera, found)
        reach["position"] = float(found.max())
    for part, column, pose, estimated in (
        ("body", BODY, job.body, job.motion.has_body),
        ("head", HEAD, job.head, job.motion.has_head),
    ):
        if estimated and pose.components[k]:
            found[:] = 0.0
            add_pose_log_density(particles, column, k, pose, job.camera, found)
            reach[part] = float(found.max())
    # If each is within reach of some particle, but no particle reaches all, redraw all.
    lost = [part for part, best in reach.items() if best < VANISHED / 3.0] or list(reach)
    if "position" in lost:
        particles[:, :BODY] = draw_states(job, k, len(particles), initial_speed_std, rng)
    if "body" in lost:
        particles[:, BODY] = draw_orientations(job.body, job.camera, k, particles[:, :VX], rng)
    if "head" in lost:
        particles[:, HEAD] = draw_orientations(job.head, job.camera, k, particles[:, :VX], rng)
    return Used(*(name in lost for name in Used._fields))


def draw_orientations(
    pose: PackedPose, camera: PackedCamera, k: int, position: FloatArray, rng: np.random.Generator
) -> FloatArray:
    """Sample orientations (n,) at positions (n, 2) from the observations at frame k."""
    size, n = int(pose.components[k]), len(position)
    heights = np.exp(pose.log_height[k, :size] - pose.log_height[k, :size].max())
    chosen = rng.choice(size, n, p=heights / heights.sum())
    if pose.closest[k]:
        off = rng.uniform(-np.pi / size, np.pi / size, n)
    else:
        off = rng.vonmises(0.0, pose.kappa[k], n)
    angle = np.arctan2(pose.sin_mean[k, chosen], pose.cos_mean[k, chosen]) + off
    if camera.judge_pose:
        towards = np.array([bearing(x, y, camera) for x, y in position.tolist()])
        angle = camera.sign * angle + towards + np.pi
    return wrap(angle)


def _visible(job: Job, pixel: FloatArray) -> NDArray[np.bool_]:
    """Which ideal pixels (m, 2) lie on the visible side of the horizon."""
    to_ground = job.camera.to_ground
    return np.asarray(pixel @ to_ground[2, :2] + to_ground[2, 2] > 0.0)


@dataclass(frozen=True)
class ParticleOptions:
    """Options of sampling and weighting.

    Attributes
    ----------
    particles : number of them
    resample_below : share of the particles; resampling is systematic, when the effective sample size is below
    pose : class likelihoods as the "smooth" mixture of the model, or the score of the "closest" class (Chen
        et al. 2011, eq. 13–14)
    image_pose : orientations were observed in the image frame of the camera, and are judged there at each
        particle's own position (Chen et al. 2011, §3)
    paths : paths that the smoother draws backwards
    """

    particles: int = 1000
    resample_below: float = 0.5
    pose: PoseModel = "smooth"
    image_pose: bool = False
    paths: int = 100

    def __post_init__(self) -> None:
        for name in ("particles", "paths"):
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, int) or value < 1:
                raise InputError(f"{name} = {value!r}", "an integer, at least 1")
        if not 0.0 <= self.resample_below <= 1.0:
            raise InputError(f"resample_below = {self.resample_below!r}", "a share in [0, 1]")
        if self.pose not in ("smooth", "closest"):
            raise InputError(f"pose = {self.pose!r}", "'smooth' or 'closest'")


@dataclass(frozen=True, eq=False)
class ParticleEstimate:
    """The particle estimate of a track; NaN before its first position.

    Attributes
    ----------
    track : means, circular for the angles, and covariances
    log_evidence : (n,) log p(z_k | z before k), given the first position; its sum is the log evidence. With
        a robust position likelihood it lacks that density's normalisation.
    effective_sample_size : (n,) after each frame's observations
    recovered : frames (row numbers) at which all weights vanished and the filter began again
    """

    track: Track
    log_evidence: FloatArray
    effective_sample_size: FloatArray
    recovered: tuple[int, ...]


@dataclass(frozen=True, eq=False)
class _Filtered:
    """A track's run of the filter, from its first position on."""

    job: Job
    start: int
    output: FilterOutput
    recovered: list[int]


def particle_filter(
    track: Track,
    model: Model | str | Path = "joint",
    *,
    camera: GroundCamera | None = None,
    options: ParticleOptions | None = None,
    seed: int | np.random.Generator = 0,
) -> ParticleEstimate:
    """Online estimates: each from what came before and the frame itself.

    If all weights vanish, the observed states are redrawn about the observation, with an `InputWarning`.

    Raises
    ------
    SolveError
        If no position was observed.
    InputError
        For a term that the filter does not know, or no camera with ``image_pose``.
    """
    model, options = Model.named(model), ParticleOptions() if options is None else options
    make_ready("the particle filter", _REHEARSAL)
    found = _filter(track, model, camera, options, generator(seed), keep=False)
    return _estimate(track, model, found, found.output.mean, found.output.covariance)


def particle_smoother(
    track: Track,
    model: Model | str | Path = "joint",
    *,
    camera: GroundCamera | None = None,
    options: ParticleOptions | None = None,
    seed: int | np.random.Generator = 0,
) -> ParticleEstimate:
    """Offline estimates by forward filtering and backward simulation (Godsill, Doucet & West 2004).

    The finer the frames, the more particles it takes. NaN before the first position. Errors are those of
    `particle_filter`.
    """
    model, options = Model.named(model), ParticleOptions() if options is None else options
    make_ready("the particle smoother", _REHEARSAL)
    rng = generator(seed)
    found = _filter(track, model, camera, options, rng, keep=True)
    return _estimate(track, model, found, *_backwards(found, options.paths, rng))


def _rehearse() -> None:
    """Call all compiled functions on a synthetic person."""
    options, rng = ParticleOptions(particles=2), generator(0)
    found = _filter(TRACK, Model("joint"), None, options, rng, keep=True)
    _backwards(found, 1, rng)


_REHEARSAL = Rehearsal("particles", _rehearse, 10.0)


def _backwards(found: _Filtered, count: int, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    """Means (n, 6) and covariances (n, 6, 6) of paths that are drawn backwards."""
    output, motion, n = found.output, found.job.motion, len(found.output.mean)
    paths = np.empty((n, count, 6))
    # A step into a frame of recovery has no likely origin; there each part is smoothed by itself.
    edges = [found.start, *found.recovered, n]
    for first, last in itertools.pairwise(edges):
        backward(rng, first, output.history[:last], output.history_log_weights[:last], motion, paths[:last])
    mean, covariance = np.full((n, 6), np.nan), np.full((n, 6, 6), np.nan)
    even = np.full(count, 1.0 / count)
    for k in range(found.start, n):
        summarise(paths[k], even, motion, mean[k], covariance[k])
    return mean, covariance


def _filter(
    track: Track,
    model: Model,
    camera: GroundCamera | None,
    options: ParticleOptions,
    rng: np.random.Generator,
    *,
    keep: bool,
) -> _Filtered:
    job = prepare(track, model, camera, options.pose, options.image_pose)
    observed = np.flatnonzero(job.position.kind)
    if not len(observed):
        raise SolveError(track.track_id, NO_POSITION)
    n, count, start = len(track), options.particles, int(observed[0])
    output = FilterOutput(
        np.full((n, 6), np.nan),
        np.full((n, 6, 6), np.nan),
        np.full(n, np.nan),
        np.full(n, np.nan),
        np.full((n if keep else 0, count, 6), np.nan),
        np.full((n if keep else 0, count), np.nan),
    )
    particles = np.zeros((2, count, 6))
    speed = model.parameters.motion.initial_speed_std
    particles[0, :, :BODY] = draw_states(job, start, count, speed, rng)
    log_weights = np.full(count, -np.log(count))
    recovered: list[int] = []
    begin = Start(start, FIRST, Used(position=True, body=False, head=False))
    while True:
        k, half = run(rng, begin, particles, log_weights, job, options.resample_below, output)
        if k == n:
            break
        particles[0] = particles[half]
        begin = Start(k, RECOVERED, recover(job, k, particles[0], speed, rng))
        log_weights[:] = -np.log(count)
        recovered.append(k)
    if recovered:
        rows = ", ".join(str(int(track.frame[k])) for k in recovered[:5])
        more = "" if len(recovered) <= 5 else f" and {len(recovered) - 5} more"
        warnings.warn(
            f"track {track.track_id}: no particle was near the observation at frame {rows}{more}; "
            "the particle filter began again there",
            InputWarning,
            stacklevel=3,
        )
    return _Filtered(job, start, output, recovered)


def _estimate(
    track: Track,
    model: Model,
    found: _Filtered,
    mean: FloatArray,
    covariance: FloatArray,
) -> ParticleEstimate:
    estimate = track.with_estimates(
        position=mean[:, :VX],
        velocity=mean[:, VX:BODY],
        body=mean[:, BODY] if model.has_body else None,
        head=mean[:, HEAD] if model.has_head else None,
        covariance=covariance,
    )
    output = found.output
    return ParticleEstimate(
        estimate, output.log_evidence, output.effective_sample_size, tuple(found.recovered)
    )
