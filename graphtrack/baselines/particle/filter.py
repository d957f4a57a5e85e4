"""The joint particle filter of Chen, Heili & Odobez (2011, §3), and its backward-simulation smoother.

A bootstrap filter on the same `Model` object that the factor graph uses: the state is p, v, θ, α; its
dynamics are the proposal. The angles are drawn from the *normalised* product of the von Mises of their
dynamics and of their coupling (Chen et al. 2011, eq. 8 and 10), where the graph holds the product without
that normalisation. Chen et al.'s baseline, κ₂ = 0, is the preset ``joint-body``.

With the preset ``full`` each particle has the modes of its two couplings, too: drawn at the beginning from
their long run and at each step from their Markov chain, as `graphtrack.inference.chain.coupling_modes` has
it. They say at which offset, and how firmly, the coupling holds, and how far the head steers. There are no
frames after the newest, so the leads loosen the couplings, as they do in the newest frame of the chain.
"""

from __future__ import annotations

import itertools
import warnings
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from graphtrack.baselines.particle.backward import backward
from graphtrack.baselines.particle.data import Job, PoseModel, prepare
from graphtrack.baselines.particle.kernels import FIRST, POSITION, RECOVERED, run, summarise
from graphtrack.baselines.particle.recovery import draw_states, recover
from graphtrack.errors import NO_POSITION, InputError, InputWarning, SolveError
from graphtrack.geometry.angles import FloatArray
from graphtrack.geometry.camera import GroundCamera
from graphtrack.model import Model
from graphtrack.particles import generator
from graphtrack.readiness import TRACK, Rehearsal, make_ready
from graphtrack.tracks import Track


@dataclass(frozen=True)
class ParticleOptions:
    """How the particle filter samples and judges.

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
    """What the particles say of a track; NaN before its first position.

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


@dataclass(eq=False)
class _FilterOutput:
    """A filter's output as it is written, with its particles if they are kept."""

    job: Job
    start: int
    mean: FloatArray
    covariance: FloatArray
    log_evidence: FloatArray
    effective_sample_size: FloatArray
    mode_means: FloatArray
    history: FloatArray
    history_log_weights: FloatArray
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

    Where all weights vanish, because an observation is out of reach of every particle, what was observed
    (the position, and the velocity with it, the body or the head) is drawn anew about the observation, the
    rest stays, and an `InputWarning` says so.

    Raises
    ------
    SolveError
        If no position was observed.
    InputError
        If the model has a term that the filter does not know, or the camera is missing that ``image_pose``
        needs.
    """
    model, options = Model.named(model), ParticleOptions() if options is None else options
    make_ready("the particle filter", _REHEARSAL)
    found = _filter(track, model, camera, options, generator(seed), keep=False)
    return _estimate(track, model, found, found.mean, found.covariance, found.mode_means)


def particle_smoother(
    track: Track,
    model: Model | str | Path = "joint",
    *,
    camera: GroundCamera | None = None,
    options: ParticleOptions | None = None,
    seed: int | np.random.Generator = 0,
) -> ParticleEstimate:
    """Offline estimates by forward filtering and backward simulation (Godsill, Doucet & West 2004).

    Mean and covariance are those of ``options.paths`` paths. The finer the frames, the fewer particles lie
    within reach of a path's next state: at 30 Hz raise ``particles``. Before the first position the estimates
    are NaN. Errors are those of `particle_filter`; a model with modes is an `InputError`, too.
    """
    model, options = Model.named(model), ParticleOptions() if options is None else options
    if model.has_modes:
        raise InputError("modes of the couplings, which the particle smoother does not know", "joint")
    make_ready("the particle smoother", _REHEARSAL)
    rng = generator(seed)
    found = _filter(track, model, camera, options, rng, keep=True)
    return _estimate(track, model, found, *_backwards(found, options.paths, rng))


def _rehearse() -> None:
    """Call everything that is compiled, for somebody made up."""
    options, rng = ParticleOptions(particles=2), generator(0)
    found = _filter(TRACK, Model("joint"), None, options, rng, keep=True)
    _backwards(found, 1, rng)


_REHEARSAL = Rehearsal("particles", _rehearse, 10.0)


def _backwards(found: _FilterOutput, count: int, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    """Means (n, 6) and covariances (n, 6, 6) of paths that are drawn backwards."""
    n = len(found.mean)
    paths = np.empty((n, count, 6))
    # A step into a frame of recovery has no likely origin; there each part is smoothed by itself.
    edges = [found.start, *found.recovered, n]
    for first, last in itertools.pairwise(edges):
        backward(
            rng, first, found.history[:last], found.history_log_weights[:last], found.job.motion, paths[:last]
        )
    mean, covariance = np.full((n, 6), np.nan), np.full((n, 6, 6), np.nan)
    even = np.full(count, 1.0 / count)
    for k in range(found.start, n):
        summarise(paths[k], even, found.job.motion, mean[k], covariance[k])
    return mean, covariance


def _filter(
    track: Track,
    model: Model,
    camera: GroundCamera | None,
    options: ParticleOptions,
    rng: np.random.Generator,
    *,
    keep: bool,
) -> _FilterOutput:
    job = prepare(track, model, camera, options.pose, options.image_pose)
    seen = np.flatnonzero(job.position.kind)
    if not len(seen):
        raise SolveError(track.track_id, NO_POSITION)
    n, count, start = len(track), options.particles, int(seen[0])
    found = _FilterOutput(
        job,
        start,
        np.full((n, 6), np.nan),
        np.full((n, 6, 6), np.nan),
        np.full(n, np.nan),
        np.full(n, np.nan),
        np.full((n, 2), np.nan),
        np.full((n if keep else 0, count, 6), np.nan),
        np.full((n if keep else 0, count), np.nan),
        [],
    )
    particles, held = np.zeros((2, count, 6)), np.zeros((2, count, 2), dtype=np.int64)
    speed = model.parameters.motion.initial_speed_std
    particles[0, :, :4] = draw_states(job, start, count, speed, rng)
    log_weights = np.full(count, -np.log(count))
    k, mode, used = start, FIRST, POSITION
    while True:
        k, half = run(
            rng,
            k,
            mode,
            used,
            particles,
            held,
            log_weights,
            job.motion,
            job.modes,
            job.position,
            job.body,
            job.head,
            job.camera,
            options.resample_below,
            found.mean,
            found.covariance,
            found.log_evidence,
            found.effective_sample_size,
            found.mode_means,
            found.history,
            found.history_log_weights,
        )
        if k == n:
            break
        particles[0], held[0] = particles[half], held[half]
        used = recover(job, k, particles[0], speed, rng)
        log_weights[:] = -np.log(count)
        found.recovered.append(k)
        mode = RECOVERED
    if found.recovered:
        rows = ", ".join(str(int(track.frame[k])) for k in found.recovered[:5])
        more = "" if len(found.recovered) <= 5 else f" and {len(found.recovered) - 5} more"
        warnings.warn(
            f"track {track.track_id}: no particle was near the observation at frame {rows}{more}; "
            "the particle filter began again there",
            InputWarning,
            stacklevel=3,
        )
    return found


def _estimate(
    track: Track,
    model: Model,
    found: _FilterOutput,
    mean: FloatArray,
    covariance: FloatArray,
    modes: FloatArray | None = None,
) -> ParticleEstimate:
    modes = modes if model.has_modes else None
    estimate = track.with_estimates(
        position=mean[:, :2],
        velocity=mean[:, 2:4],
        body=mean[:, 4] if model.has_body else None,
        head=mean[:, 5] if model.has_head else None,
        covariance=covariance,
        aligned_p=None if modes is None else modes[:, 0],
        gait_offset=None if modes is None else modes[:, 1],
    )
    return ParticleEstimate(estimate, found.log_evidence, found.effective_sample_size, tuple(found.recovered))
