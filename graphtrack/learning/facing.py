"""Learning the parameters of groups and of attention from labels."""

from __future__ import annotations

import numpy as np

from graphtrack.behaviour.evidence import PairEvidence
from graphtrack.behaviour.facing import DIRECTIONS, facing_scores, probabilities
from graphtrack.behaviour.parameters import RINGS, FacingWeights, GroupParameters
from graphtrack.behaviour.people import People
from graphtrack.geometry.angles import BoolArray, FloatArray

_RIDGE = 20.0
_SPREAD = 1e-6


def fit_facing(
    people: People, evidence: list[PairEvidence], used: BoolArray, parameters: GroupParameters
) -> tuple[FacingWeights, FacingWeights]:
    """Learn the weights of companions and of others by the likelihood of bodies, with a ridge.

    Parameters
    ----------
    evidence : of the same people, of whom more or less was known: each counts
    used : (n,) rows to learn from, with a body
    parameters : of which the weights are not read
    """
    from scipy.optimize import minimize

    angle = np.arctan2(people.body[used, 1], people.body[used, 0])
    place = np.round(angle / (DIRECTIONS[1] - DIRECTIONS[0])).astype(np.int64) % len(DIRECTIONS)
    features = np.concatenate([_features(people, one, parameters.stride)[used] for one in evidence])
    chosen = (np.arange(len(features)), np.tile(place, len(evidence)))
    scale = features.std(axis=(0, 1)) + _SPREAD
    features = features / scale

    def cost(weights: FloatArray) -> tuple[float, FloatArray]:
        probability = probabilities(features @ weights)
        value = -np.log(probability[chosen] + 1e-300).sum() + 0.5 * _RIDGE * weights @ weights
        expected = np.einsum("nd,ndf->f", probability, features)
        return float(value), expected - features[chosen].sum(axis=0) + _RIDGE * weights

    found = minimize(cost, np.zeros(2 * len(RINGS)), jac=True, method="L-BFGS-B").x / scale
    values = [float(round(value, 3)) for value in np.clip(found, -50.0, 50.0).tolist()]
    return FacingWeights(*values[: len(RINGS)]), FacingWeights(*values[len(RINGS) :])


def _features(people: People, evidence: PairEvidence, stride: float) -> FloatArray:
    """(n, directions, 2·rings): how many companions, and others, are how far from the o-space there."""
    together = 0.5 * (1.0 + np.tanh(0.5 * evidence.odds))
    columns = []
    for place in range(2 * len(RINGS)):
        one = np.zeros(2 * len(RINGS))
        one[place] = 1.0
        weights = one.reshape(2, len(RINGS))
        columns.append(
            facing_scores(people.position, evidence.left, evidence.right, together, weights, stride)
        )
    return np.stack(columns, axis=2)
