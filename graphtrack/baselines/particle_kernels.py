"""Compiled steps of particle filters: log-weights, resampling, seeding, moves, and backward simulation."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from graphtrack.baselines.particle_model import (
    BODY,
    HEAD,
    VX,
    VY,
    Job,
    PackedMotion,
    X,
    Y,
    add_pose_log_density,
    add_position_log_density,
    sample_von_mises,
    wrapped,
)
from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray
from graphtrack.kernels.arithmetic import log_i0e
from graphtrack.kernels.compilation import allocating, compiled
from graphtrack.model.terms.motion import STANDSTILL


def generator(seed: int | np.random.Generator) -> np.random.Generator:
    """A generator from a seed ≥ 0, or the generator given; InputError for anything else."""
    if isinstance(seed, np.random.Generator):
        return seed
    if isinstance(seed, bool) or not isinstance(seed, int | np.integer) or seed < 0:
        raise InputError(f"seed = {seed!r}", "an integer, at least 0, or a numpy.random.Generator")
    return np.random.default_rng(seed)


def resample(weights: FloatArray, rng: np.random.Generator, count: int | None = None) -> NDArray[np.int64]:
    """Ancestors (count,) of new particles, in order, by systematic resampling of normalised weights (n,)."""
    ancestors = np.empty(len(weights) if count is None else count, np.int64)
    systematic_ancestors(weights, rng.random(), ancestors)
    return ancestors


@compiled
def normalise(log_weights: FloatArray, weights: FloatArray) -> float:
    """Normalise log-weights (n,) in place, write the weights (n,), and return the logarithm of their sum.

    If all vanish (the greatest is −∞ or NaN) they become equal and the sum's logarithm is −∞.
    """
    n = len(log_weights)
    greatest = -math.inf
    for i in range(n):
        if log_weights[i] > greatest:
            greatest = log_weights[i]
    if greatest == -math.inf:
        log_weights[:] = -math.log(n)
        weights[:] = 1.0 / n
        return -math.inf
    total = 0.0
    for i in range(n):
        weights[i] = math.exp(log_weights[i] - greatest)
        total += weights[i]
    log_sum = greatest + math.log(total)
    for i in range(n):
        weights[i] /= total
        log_weights[i] -= log_sum
    return log_sum


@compiled
def effective_sample_size(weights: FloatArray) -> float:
    """1/Σw² of normalised weights (n,): between 1 and n."""
    total = 0.0
    for i in range(len(weights)):
        total += weights[i] * weights[i]
    return 1.0 / total


@compiled
def systematic_ancestors(weights: FloatArray, offset: float, ancestors: NDArray[np.int64]) -> None:
    """Write each new particle's ancestor (m,), in order, by one comb of m teeth at ``offset`` in [0, 1)."""
    n, m = len(weights), len(ancestors)
    place, reached = 0, weights[0]
    for i in range(m):
        tooth = (i + offset) / m
        # The last particle with a weight takes what rounding leaves over.
        while reached <= tooth and place < n - 1:
            place += 1
            reached += weights[place]
        ancestors[i] = place
    while weights[place] == 0.0 and place > 0:
        place -= 1
    for i in range(m - 1, -1, -1):
        if ancestors[i] <= place:
            break
        ancestors[i] = place


PROPAGATE, FIRST, RECOVERED = 0, 1, 2
"""Start of a run: from the frame before; with positions and velocities drawn already, angles from their
couplings; with everything at hand already."""


class Used(NamedTuple):
    """Observations of a frame from which particles were drawn, so that they do not count again."""

    position: bool
    body: bool
    head: bool


class Start(NamedTuple):
    """Frame with which a run begins, and how: `PROPAGATE`, `FIRST` or `RECOVERED`."""

    frame: int
    mode: int
    used: Used


class FilterOutput(NamedTuple):
    """Results of a filter over n frames; NaN where it has not been."""

    mean: FloatArray  # (n, 6)
    covariance: FloatArray  # (n, 6, 6)
    log_evidence: FloatArray  # (n,)
    effective_sample_size: FloatArray  # (n,)
    history: FloatArray  # (n, particles, 6), or of length 0: particles are not kept
    history_log_weights: FloatArray  # (n, particles), likewise


VANISHED = -700.0
"""Below this log-likelihood, even of the best particle, weights are 0 in double precision: it is lost."""


@compiled
def motion_pull(vx: float, vy: float, k: int, motion: PackedMotion) -> float:
    """κ(v) of Chen et al. 2011, eq. 9 at frame k."""
    excess = max(math.sqrt(vx * vx + vy * vy) - motion.speed_threshold, 0.0)
    return motion.motion_body_kappa[k] * excess * excess


@compiled
def draw_angles(
    rng: np.random.Generator,
    k: int,
    first: bool,
    before: FloatArray,
    after: FloatArray,
    motion: PackedMotion,
) -> None:
    """Angles of a particle of known velocity, from the products of Chen et al. 2011, eq. 8 and 10."""
    if motion.has_body:
        vx, vy = after[VX], after[VY]
        pull = motion_pull(vx, vy, k, motion)
        kappa = 0.0 if first else motion.body_turn_kappa[k]
        if pull > 0.0:
            speed = math.sqrt(vx * vx + vy * vy)
            east = kappa * math.cos(before[BODY]) + pull * vx / speed
            north = kappa * math.sin(before[BODY]) + pull * vy / speed
            after[BODY] = sample_von_mises(
                rng, math.atan2(north, east), math.sqrt(east * east + north * north)
            )
        else:
            after[BODY] = sample_von_mises(rng, before[BODY], kappa)
    if motion.has_head:
        pull = motion.head_body_kappa[k]
        kappa = 0.0 if first else motion.head_turn_kappa[k]
        if pull > 0.0:
            east = kappa * math.cos(before[HEAD]) + pull * math.cos(after[BODY])
            north = kappa * math.sin(before[HEAD]) + pull * math.sin(after[BODY])
            after[HEAD] = sample_von_mises(
                rng, math.atan2(north, east), math.sqrt(east * east + north * north)
            )
        else:
            after[HEAD] = sample_von_mises(rng, before[HEAD], kappa)


@compiled
def carry(
    k: int,
    motion: PackedMotion,
    before: FloatArray,
    ancestors: NDArray[np.int64],
    after: FloatArray,
) -> None:
    """Mean positions and velocities (n, …) at frame k, straight on or steered by the head."""
    keep, reach = motion.keep[k], motion.reach[k]
    gain, far = 1.0 - keep, motion.dt[k] - reach
    for i in range(len(after)):
        source = ancestors[i]
        x, y, vx, vy = before[source, X], before[source, Y], before[source, VX], before[source, VY]
        after[i, X], after[i, Y] = x + reach * vx, y + reach * vy
        after[i, VX], after[i, VY] = keep * vx, keep * vy
        if gain > 0.0:
            # The speed as `IntentionalMotion` has it.
            square = vx * vx + vy * vy
            speed = square / (math.sqrt(square + STANDSTILL * STANDSTILL) + STANDSTILL)
            head = before[source, HEAD]
            aim_x, aim_y = speed * math.cos(head), speed * math.sin(head)
            after[i, X] += far * aim_x
            after[i, Y] += far * aim_y
            after[i, VX] += gain * aim_x
            after[i, VY] += gain * aim_y


@compiled
def draw_motion(
    rng: np.random.Generator,
    k: int,
    motion: PackedMotion,
    before: FloatArray,
    ancestors: NDArray[np.int64],
    after: FloatArray,
) -> None:
    """Positions and velocities (n, …) at frame k: where they are carried to, and the noise."""
    carry(k, motion, before, ancestors, after)
    a, b, c = motion.root[k]
    for i in range(len(after)):
        for axis in range(2):
            first = rng.standard_normal()
            after[i, X + axis] += a * first
            after[i, VX + axis] += b * first + c * rng.standard_normal()


@compiled
def summarise_motion(
    particles: FloatArray, weights: FloatArray, mean: FloatArray, covariance: FloatArray
) -> None:
    """Weighted mean and covariance of the first four numbers, in one pass about the heaviest particle."""
    heaviest = np.argmax(weights)
    x0, y0 = particles[heaviest, X], particles[heaviest, Y]
    u0, v0 = particles[heaviest, VX], particles[heaviest, VY]
    x1 = y1 = u1 = v1 = xx = xy = xu = xv = yy = yu = yv = uu = uv = vv = 0.0
    for i in range(len(weights)):
        w = weights[i]
        x, y = particles[i, X] - x0, particles[i, Y] - y0
        u, v = particles[i, VX] - u0, particles[i, VY] - v0
        wx, wy, wu, wv = w * x, w * y, w * u, w * v
        x1 += wx
        y1 += wy
        u1 += wu
        v1 += wv
        xx += wx * x
        xy += wx * y
        xu += wx * u
        xv += wx * v
        yy += wy * y
        yu += wy * u
        yv += wy * v
        uu += wu * u
        uv += wu * v
        vv += wv * v
    mean[X], mean[Y], mean[VX], mean[VY] = x0 + x1, y0 + y1, u0 + u1, v0 + v1
    covariance[X, X], covariance[Y, Y] = xx - x1 * x1, yy - y1 * y1
    covariance[VX, VX], covariance[VY, VY] = uu - u1 * u1, vv - v1 * v1
    covariance[X, Y] = covariance[Y, X] = xy - x1 * y1
    covariance[X, VX] = covariance[VX, X] = xu - x1 * u1
    covariance[X, VY] = covariance[VY, X] = xv - x1 * v1
    covariance[Y, VX] = covariance[VX, Y] = yu - y1 * u1
    covariance[Y, VY] = covariance[VY, Y] = yv - y1 * v1
    covariance[VX, VY] = covariance[VY, VX] = uv - u1 * v1


@allocating
def summarise_angle(
    particles: FloatArray, weights: FloatArray, column: int, mean: FloatArray, covariance: FloatArray
) -> None:
    """Circular mean of an angle, `BODY` or `HEAD`, its variance, and its covariances with earlier columns."""
    n = len(weights)
    east = north = 0.0
    for i in range(n):
        east += weights[i] * math.cos(particles[i, column])
        north += weights[i] * math.sin(particles[i, column])
    mean[column] = math.atan2(north, east)
    sums = np.zeros(6)
    for i in range(n):
        deviation = wrapped(particles[i, column] - mean[column])
        scaled = weights[i] * deviation
        for j in range(BODY):
            sums[j] += scaled * (particles[i, j] - mean[j])
        if column == HEAD:
            sums[BODY] += scaled * wrapped(particles[i, BODY] - mean[BODY])
        sums[column] += scaled * deviation
    for j in range(column + 1):
        covariance[column, j] = covariance[j, column] = sums[j]


@compiled
def summarise(
    particles: FloatArray, weights: FloatArray, motion: PackedMotion, mean: FloatArray, covariance: FloatArray
) -> None:
    """Write the weighted mean (6,), circular for angles, and covariance (6, 6) of the particles."""
    summarise_motion(particles, weights, mean, covariance)
    if motion.has_body:
        summarise_angle(particles, weights, BODY, mean, covariance)
    if motion.has_head:
        summarise_angle(particles, weights, HEAD, mean, covariance)
        if not motion.has_body:
            covariance[BODY, HEAD] = covariance[HEAD, BODY] = math.nan


@allocating
def run(
    rng: np.random.Generator,
    start: Start,
    particles: FloatArray,
    log_weights: FloatArray,
    job: Job,
    resample_below: float,
    output: FilterOutput,
) -> tuple[int, int]:
    """Filter from a frame to the end, or to the frame at which all weights vanish.

    Parameters
    ----------
    particles : (2, n, 6): those of the frame before, or of this one, in the first half; both are written
    log_weights : (n,) normalised; written
    resample_below : share of n below which the effective sample size calls for resampling

    Returns
    -------
    frame, half : the frame at which all weights vanished, or the number of frames; the half of ``particles``
        that holds the last ones
    """
    motion = job.motion
    n, frames = particles.shape[1], len(motion.dt)
    weights, log_likelihood, ancestors = np.empty(n), np.empty(n), np.arange(n)
    normalise(log_weights, weights)
    has_angles = motion.has_body or motion.has_head
    half = 0
    for k in range(start.frame, frames):
        is_start = k == start.frame
        mode = start.mode if is_start else PROPAGATE
        if mode == PROPAGATE:
            if effective_sample_size(weights) < resample_below * n:
                systematic_ancestors(weights, rng.random(), ancestors)
                log_weights[:] = -math.log(n)
            else:
                for i in range(n):
                    ancestors[i] = i
            before, after = particles[half], particles[1 - half]
            half = 1 - half
            draw_motion(rng, k, motion, before, ancestors, after)
            if has_angles:
                for i in range(n):
                    draw_angles(rng, k, False, before[ancestors[i]], after[i], motion)
        elif mode == FIRST:
            for i in range(n):
                draw_angles(rng, k, True, particles[half, i], particles[half, i], motion)
        now = particles[half]
        log_likelihood[:] = 0.0
        if not (is_start and start.used.position):
            add_position_log_density(now, k, job.position, job.camera, log_likelihood)
        if motion.has_body and not (is_start and start.used.body):
            add_pose_log_density(now, BODY, k, job.body, job.camera, log_likelihood)
        if motion.has_head and not (is_start and start.used.head):
            add_pose_log_density(now, HEAD, k, job.head, job.camera, log_likelihood)
        best = log_likelihood.max()
        for i in range(n):
            log_weights[i] += log_likelihood[i]
        log_sum = normalise(log_weights, weights)
        if mode != RECOVERED:
            output.log_evidence[k] = log_sum
        if mode == PROPAGATE and best < VANISHED:
            return k, half
        summarise(now, weights, motion, output.mean[k], output.covariance[k])
        output.effective_sample_size[k] = effective_sample_size(weights)
        if len(output.history):
            output.history[k] = now
            output.history_log_weights[k] = log_weights
    return frames, half


@allocating
def backward(
    rng: np.random.Generator,
    start: int,
    history: FloatArray,
    history_log_weights: FloatArray,
    motion: PackedMotion,
    paths: FloatArray,
) -> None:
    """Draw paths (frames, m, 6) backwards from the filter's particles (Godsill, Doucet & West 2004)."""
    frames, n = history_log_weights.shape
    m = paths.shape[1]
    weights, scores, motions = np.empty(n), np.empty(n), np.empty(n)
    themselves, carried = np.arange(n), np.empty((n, 4))
    for p in range(m):
        paths[frames - 1, p] = history[
            frames - 1, _draw(rng, history_log_weights[frames - 1], scores, weights)
        ]
    for k in range(frames - 2, start - 1, -1):
        now = history[k]
        a, b, c = motion.root[k + 1]
        carry(k + 1, motion, now, themselves, carried)
        for p in range(m):
            ahead = paths[k + 1, p]
            leader = 0
            for i in range(n):
                score = history_log_weights[k, i]
                for axis in range(2):
                    first = (ahead[X + axis] - carried[i, X + axis]) / a
                    second = (ahead[VX + axis] - carried[i, VX + axis] - b * first) / c
                    score -= 0.5 * (first * first + second * second)
                motions[i] = score
                if score > motions[leader]:
                    leader = i
            pull = motion_pull(ahead[VX], ahead[VY], k + 1, motion)
            course = math.atan2(ahead[VY], ahead[VX])
            # No product of von Mises exceeds the one in which both agree.
            most = 0.0
            if motion.has_body:
                most -= math.log(2.0 * math.pi) + log_i0e(motion.body_turn_kappa[k + 1] + pull)
            if motion.has_head:
                kappa = motion.head_turn_kappa[k + 1] + motion.head_body_kappa[k + 1]
                most -= math.log(2.0 * math.pi) + log_i0e(kappa)
            best = -math.inf
            for step in range(-1, n):
                i = leader if step < 0 else step
                score = motions[i]
                if score + most < best - 40.0:
                    scores[i] = -math.inf
                    continue
                if motion.has_body:
                    kappa = motion.body_turn_kappa[k + 1]
                    score += _product_log_density(ahead[BODY], now[i, BODY], kappa, course, pull)
                if motion.has_head:
                    kappa, follow = motion.head_turn_kappa[k + 1], motion.head_body_kappa[k + 1]
                    score += _product_log_density(ahead[HEAD], now[i, HEAD], kappa, ahead[BODY], follow)
                scores[i] = score
                best = max(best, score)
            paths[k, p] = now[_draw(rng, scores, motions, weights)]


@compiled
def _product_log_density(angle: float, before: float, kappa: float, toward: float, pull: float) -> float:
    """Log of the normalised product VM(angle; before, kappa)·VM(angle; toward, pull)."""
    if pull == 0.0:
        return kappa * (math.cos(angle - before) - 1.0) - math.log(2.0 * math.pi) - log_i0e(kappa)
    resultant = math.sqrt(kappa * kappa + pull * pull + 2.0 * kappa * pull * math.cos(before - toward))
    agreement = kappa * math.cos(angle - before) + pull * math.cos(angle - toward)
    return agreement - resultant - math.log(2.0 * math.pi) - log_i0e(resultant)


@allocating
def _draw(rng: np.random.Generator, log_weights: FloatArray, scratch: FloatArray, weights: FloatArray) -> int:
    """A number drawn with these log-weights."""
    scratch[:] = log_weights
    normalise(scratch, weights)
    target, reached = rng.random(), 0.0
    for i in range(len(weights)):
        reached += weights[i]
        if reached > target:
            return i
    return int(np.argmax(weights))
