"""Compiled steps of particle filters: log-weights, resampling, seeding, moves, and backward simulation.

A particle is x, y, vx, vy (metres, m/s), body and head (radians).
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from graphtrack.baselines.particle_model import (
    PackedCamera,
    PackedMotion,
    PackedPose,
    PackedPosition,
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

POSITION, BODY, HEAD = 1, 2, 4  # Observations that were used up when particles were drawn from them

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
        vx, vy = after[2], after[3]
        pull = motion_pull(vx, vy, k, motion)
        kappa = 0.0 if first else motion.body_turn_kappa[k]
        if pull > 0.0:
            speed = math.sqrt(vx * vx + vy * vy)
            east = kappa * math.cos(before[4]) + pull * vx / speed
            north = kappa * math.sin(before[4]) + pull * vy / speed
            after[4] = sample_von_mises(rng, math.atan2(north, east), math.sqrt(east * east + north * north))
        else:
            after[4] = sample_von_mises(rng, before[4], kappa)
    if motion.has_head:
        pull = motion.head_body_kappa[k]
        kappa = 0.0 if first else motion.head_turn_kappa[k]
        if pull > 0.0:
            east = kappa * math.cos(before[5]) + pull * math.cos(after[4])
            north = kappa * math.sin(before[5]) + pull * math.sin(after[4])
            after[5] = sample_von_mises(rng, math.atan2(north, east), math.sqrt(east * east + north * north))
        else:
            after[5] = sample_von_mises(rng, before[5], kappa)


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
        x, y, vx, vy = before[source, 0], before[source, 1], before[source, 2], before[source, 3]
        after[i, 0], after[i, 1] = x + reach * vx, y + reach * vy
        after[i, 2], after[i, 3] = keep * vx, keep * vy
        if gain > 0.0:
            # The speed as `IntentionalMotion` has it.
            square = vx * vx + vy * vy
            speed = square / (math.sqrt(square + STANDSTILL * STANDSTILL) + STANDSTILL)
            head = before[source, 5]
            aim_x, aim_y = speed * math.cos(head), speed * math.sin(head)
            after[i, 0] += far * aim_x
            after[i, 1] += far * aim_y
            after[i, 2] += gain * aim_x
            after[i, 3] += gain * aim_y


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
            after[i, axis] += a * first
            after[i, 2 + axis] += b * first + c * rng.standard_normal()


@compiled
def summarise_motion(
    particles: FloatArray, weights: FloatArray, mean: FloatArray, covariance: FloatArray
) -> None:
    """Weighted mean and covariance of the first four numbers, in one pass about the heaviest particle."""
    heaviest = np.argmax(weights)
    x0, y0 = particles[heaviest, 0], particles[heaviest, 1]
    u0, v0 = particles[heaviest, 2], particles[heaviest, 3]
    x1 = y1 = u1 = v1 = xx = xy = xu = xv = yy = yu = yv = uu = uv = vv = 0.0
    for i in range(len(weights)):
        w = weights[i]
        x, y = particles[i, 0] - x0, particles[i, 1] - y0
        u, v = particles[i, 2] - u0, particles[i, 3] - v0
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
    mean[0], mean[1], mean[2], mean[3] = x0 + x1, y0 + y1, u0 + u1, v0 + v1
    covariance[0, 0], covariance[1, 1] = xx - x1 * x1, yy - y1 * y1
    covariance[2, 2], covariance[3, 3] = uu - u1 * u1, vv - v1 * v1
    covariance[0, 1] = covariance[1, 0] = xy - x1 * y1
    covariance[0, 2] = covariance[2, 0] = xu - x1 * u1
    covariance[0, 3] = covariance[3, 0] = xv - x1 * v1
    covariance[1, 2] = covariance[2, 1] = yu - y1 * u1
    covariance[1, 3] = covariance[3, 1] = yv - y1 * v1
    covariance[2, 3] = covariance[3, 2] = uv - u1 * v1


@allocating
def summarise_angle(
    particles: FloatArray, weights: FloatArray, place: int, mean: FloatArray, covariance: FloatArray
) -> None:
    """Circular mean of one angle, its variance, and its covariances with what stands before it."""
    n = len(weights)
    east = north = 0.0
    for i in range(n):
        east += weights[i] * math.cos(particles[i, place])
        north += weights[i] * math.sin(particles[i, place])
    mean[place] = math.atan2(north, east)
    sums = np.zeros(6)
    for i in range(n):
        deviation = wrapped(particles[i, place] - mean[place])
        scaled = weights[i] * deviation
        for j in range(4):
            sums[j] += scaled * (particles[i, j] - mean[j])
        if place == 5:
            sums[4] += scaled * wrapped(particles[i, 4] - mean[4])
        sums[place] += scaled * deviation
    for j in range(place + 1):
        covariance[place, j] = covariance[j, place] = sums[j]


@compiled
def summarise(
    particles: FloatArray, weights: FloatArray, motion: PackedMotion, mean: FloatArray, covariance: FloatArray
) -> None:
    """Write the weighted mean (6,), circular for angles, and covariance (6, 6) of the particles."""
    summarise_motion(particles, weights, mean, covariance)
    if motion.has_body:
        summarise_angle(particles, weights, 4, mean, covariance)
    if motion.has_head:
        summarise_angle(particles, weights, 5, mean, covariance)
        if not motion.has_body:
            covariance[4, 5] = covariance[5, 4] = math.nan


@allocating
def run(
    rng: np.random.Generator,
    start: int,
    mode: int,
    used: int,
    particles: FloatArray,
    log_weights: FloatArray,
    motion: PackedMotion,
    position: PackedPosition,
    body: PackedPose,
    head: PackedPose,
    camera: PackedCamera,
    resample_below: float,
    mean: FloatArray,
    covariance: FloatArray,
    log_evidence: FloatArray,
    sample_size: FloatArray,
    history: FloatArray,
    history_log_weights: FloatArray,
) -> tuple[int, int]:
    """Filter from frame ``start`` to the end, or to the frame at which all weights vanish.

    Parameters
    ----------
    mode : how the first frame begins: `PROPAGATE`, `FIRST` or `RECOVERED`
    used : observations of the first frame that do not count: the sum of `POSITION`, `BODY` and `HEAD`
    particles : (2, n, 6): those of the frame before, or of this one, in the first half; both are written
    log_weights : (n,) normalised; written
    resample_below : share of n below which the effective sample size calls for resampling
    mean, covariance, log_evidence, sample_size : (frames, …), written
    history, history_log_weights : (frames, n, 6) and (frames, n) to keep the particles, or of length 0

    Returns
    -------
    frame, half : the frame at which all weights vanished, or the number of frames; the half of ``particles``
        that holds the last ones
    """
    n, frames = particles.shape[1], len(motion.dt)
    weights, log_likelihood, ancestors = np.empty(n), np.empty(n), np.arange(n)
    normalise(log_weights, weights)
    has_angles = motion.has_body or motion.has_head
    half = 0
    for k in range(start, frames):
        fresh, done = (mode, used) if k == start else (PROPAGATE, 0)
        if fresh == PROPAGATE:
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
        elif fresh == FIRST:
            for i in range(n):
                draw_angles(rng, k, True, particles[half, i], particles[half, i], motion)
        now = particles[half]
        log_likelihood[:] = 0.0
        if not done & POSITION:
            add_position_log_density(now, k, position, camera, log_likelihood)
        if motion.has_body and not done & BODY:
            add_pose_log_density(now, 4, k, body, camera, log_likelihood)
        if motion.has_head and not done & HEAD:
            add_pose_log_density(now, 5, k, head, camera, log_likelihood)
        best = log_likelihood.max()
        for i in range(n):
            log_weights[i] += log_likelihood[i]
        log_sum = normalise(log_weights, weights)
        if fresh != RECOVERED:
            log_evidence[k] = log_sum
        if fresh == PROPAGATE and best < VANISHED:
            return k, half
        summarise(now, weights, motion, mean[k], covariance[k])
        sample_size[k] = effective_sample_size(weights)
        if len(history):
            history[k] = now
            history_log_weights[k] = log_weights
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
                    first = (ahead[axis] - carried[i, axis]) / a
                    second = (ahead[2 + axis] - carried[i, 2 + axis] - b * first) / c
                    score -= 0.5 * (first * first + second * second)
                motions[i] = score
                if score > motions[leader]:
                    leader = i
            pull = motion_pull(ahead[2], ahead[3], k + 1, motion)
            course = math.atan2(ahead[3], ahead[2])
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
                    score += _product_log_density(ahead[4], now[i, 4], kappa, course, pull)
                if motion.has_head:
                    kappa, follow = motion.head_turn_kappa[k + 1], motion.head_body_kappa[k + 1]
                    score += _product_log_density(ahead[5], now[i, 5], kappa, ahead[4], follow)
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
