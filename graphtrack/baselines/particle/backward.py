"""Compiled backward simulation for the particle smoother."""

from __future__ import annotations

import math

import numpy as np

from graphtrack.baselines.particle.data import PackedMotion
from graphtrack.baselines.particle.kernels import carry, motion_pull
from graphtrack.geometry.angles import FloatArray
from graphtrack.model.kernels.bessel import log_i0e
from graphtrack.model.kernels.compiled import allocating, compiled
from graphtrack.particles import normalise


@allocating
def backward(
    rng: np.random.Generator,
    start: int,
    history: FloatArray,
    history_log_weights: FloatArray,
    motion: PackedMotion,
    paths: FloatArray,
) -> None:
    """Draw paths (frames, m, 6) backwards from the filter's particles (Godsill, Doucet & West 2004).

    At each frame a particle is drawn with its weight times the density of the step to the path's next state.
    The density of an angle is the normalised product, whose normalisation depends on where it comes from.
    """
    frames, n = history_log_weights.shape
    m = paths.shape[1]
    weights, scores, motions = np.empty(n), np.empty(n), np.empty(n)
    themselves, steering, carried = np.arange(n), np.zeros(n, np.int64), np.empty((n, 4))
    for p in range(m):
        paths[frames - 1, p] = history[
            frames - 1, _draw(rng, history_log_weights[frames - 1], scores, weights)
        ]
    for k in range(frames - 2, start - 1, -1):
        now = history[k]
        a, b, c = motion.root[k + 1, 0]
        carry(k + 1, motion, now, themselves, steering, carried)
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
