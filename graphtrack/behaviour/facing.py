"""Expected body orientation from where the others stand: an o-space is empty, with companions about it."""

from __future__ import annotations

import math

import numpy as np

from graphtrack.behaviour.parameters import RINGS, GroupParameters
from graphtrack.behaviour.people import IntArray
from graphtrack.geometry.angles import FloatArray, unit
from graphtrack.model.kernels.compiled import allocating

DIRECTIONS: FloatArray = 2.0 * np.pi * np.arange(36) / 36
"""Radians, of the bodies that are compared."""
_WIDTH = 0.2
"""Metres, 1-σ of a ring."""
_FARTHEST = 2.5
"""Metres from an o-space beyond which somebody tells nothing of it."""


@allocating
def _add_scores(
    position: FloatArray,
    space: FloatArray,
    rings: FloatArray,
    weights: FloatArray,
    left: IntArray,
    right: IntArray,
    together: FloatArray,
    found: FloatArray,
) -> None:
    weight = np.empty(len(rings))
    for k in range(len(left)):
        weight[:] = together[k] * weights[0] + (1.0 - together[k]) * weights[1]
        x, y = position[right[k], 0] - position[left[k], 0], position[right[k], 1] - position[left[k], 1]
        for d in range(len(space)):
            for side in range(2):
                sign = 1.0 - 2.0 * side
                far = math.hypot(sign * x - space[d, 0], sign * y - space[d, 1])
                if far > _FARTHEST:
                    continue
                total = 0.0
                for r in range(len(rings)):
                    total += weight[r] * math.exp(-0.5 * ((far - rings[r]) / _WIDTH) ** 2)
                found[right[k] if side else left[k], d] += total


def facing_scores(
    position: FloatArray,
    left: IntArray,
    right: IntArray,
    together: FloatArray,
    weights: FloatArray,
    stride: float,
) -> FloatArray:
    """Log odds (n, directions) of each person's body pointing there, of where the others are.

    Parameters
    ----------
    position : (n, 2) metres
    left, right : (k,) rows of the two of a pair of people near each other in one frame
    together : (k,) probability that they are in one conversation
    weights : (2, rings) of companions and of others
    stride : metres to the o-space ahead of a body
    """
    found = np.zeros((len(position), len(DIRECTIONS)))
    space, rings = stride * unit(DIRECTIONS), np.array(RINGS)
    _add_scores(position, space, rings, weights, left, right, together, found)
    return found


def facing(
    position: FloatArray, left: IntArray, right: IntArray, odds: FloatArray, parameters: GroupParameters
) -> FloatArray:
    """(n, 2) expected unit vectors of bodies by where the others stand; 0 where nobody is near.

    The parameters are as those of `facing_scores`, but for the log odds of pairs.
    """
    weights = np.stack([parameters.companions.of_rings, parameters.others.of_rings])
    together = 0.5 * (1.0 + np.tanh(0.5 * odds))
    score = facing_scores(position, left, right, together, weights, parameters.stride)
    found: FloatArray = np.zeros((len(position), 2))
    met = score.any(axis=1)
    found[met] = probabilities(score[met]) @ unit(DIRECTIONS)
    return found


def probabilities(score: FloatArray) -> FloatArray:
    """(n, k) of log odds (n, k)."""
    likelihood = np.exp(score - score.max(axis=1, keepdims=True))
    return np.asarray(likelihood / likelihood.sum(axis=1, keepdims=True))
