"""What a fixed lag remembers of states it has let go: a Gaussian on the oldest step of its window."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import combinations
from typing import NamedTuple

import numpy as np

from graphtrack.geometry.angles import FloatArray
from graphtrack.later import gtsam
from graphtrack.model import Model, Step
from graphtrack.model.factors.custom import variable_dimension
from graphtrack.model.kernels.layout import BODY, HEAD, PLACES, N


@dataclass(frozen=True, eq=False)
class MarginalPrior:
    """½·dᵀ·Λ·d − ηᵀ·d + ½·c, where d is the deviation from a linearisation point.

    Attributes
    ----------
    keys : GTSAM keys of the variables, in order
    point : their values at the linearisation point: 2 numbers for X and V, an angle (radians) for B and H
    information, linear, constant : Λ, η and c

    Raises
    ------
    ValueError
        If the shapes do not fit the keys.
    """

    keys: tuple[int, ...]
    point: tuple[tuple[float, ...], ...]
    information: FloatArray
    linear: FloatArray
    constant: float

    def __post_init__(self) -> None:
        sizes = [variable_dimension(key) for key in self.keys]
        n = sum(sizes)
        if [len(point) for point in self.point] != sizes:
            raise ValueError("the linearisation point does not fit the keys")
        if self.information.shape != (n, n) or self.linear.shape != (n,):
            raise ValueError(f"Λ {self.information.shape} and η {self.linear.shape} for {n} dimensions")

    def values(self) -> gtsam.Values:
        """The linearisation point."""
        values = gtsam.Values()
        for key, point in zip(self.keys, self.point, strict=True):
            values.insert(key, np.array(point) if len(point) == 2 else gtsam.Rot2(point[0]))
        return values

    def firm(self, kappa: float) -> MarginalPrior:
        """The same, but that it holds each orientation by no less than a concentration."""
        information, place = self.information.copy(), 0
        for point in self.point:
            if len(point) == 1:
                information[place, place] = max(information[place, place], kappa)
            place += len(point)
        return replace(self, information=information)

    def turned(self, turns: Mapping[int, float], near: float) -> MarginalPrior:
        """The same in another basin: key of an orientation → radians to there.

        ``near`` is the cosine of the turn up to which an orientation is in the same basin. What the Gaussian
        says holds about its own basin; that it is as sure of the other one is the best guess.
        """
        point = tuple(
            (there[0] + turns[key],) if len(there) == 1 and math.cos(turns[key]) < near else there
            for key, there in zip(self.keys, self.point, strict=True)
        )
        return replace(self, point=point)

    def factor(self) -> gtsam.LinearContainerFactor:
        """The factor. A linearisation point belongs to it: without one its error would be 0 everywhere."""
        sizes = [variable_dimension(key) for key in self.keys]
        ends = np.cumsum(sizes)
        place = [slice(end - size, end) for end, size in zip(ends, sizes, strict=True)]
        parts = gtsam.GaussianFactorGraph()
        for i, key in enumerate(self.keys):
            constant = self.constant if i == 0 else 0.0
            block = self.information[place[i], place[i]]
            parts.push_back(gtsam.HessianFactor(key, block, self.linear[place[i]], constant))
        # GTSAM's Python offers Hessian factors of up to three variables; sums of pairs make larger ones.
        for i, j in combinations(range(len(self.keys)), 2):
            parts.push_back(
                gtsam.HessianFactor(
                    self.keys[i],
                    self.keys[j],
                    np.zeros((sizes[i], sizes[i])),
                    self.information[place[i], place[j]],
                    np.zeros(sizes[i]),
                    np.zeros((sizes[j], sizes[j])),
                    np.zeros(sizes[j]),
                    0.0,
                )
            )
        return gtsam.LinearContainerFactor(gtsam.HessianFactor(parts), self.values())


def marginal_prior(factor: gtsam.HessianFactor, linearization: gtsam.Values) -> MarginalPrior:
    """The prior that a marginal is, which was made at a linearisation point."""
    keys = tuple(factor.keys())
    point = tuple(
        tuple(linearization.atVector(key).tolist())
        if variable_dimension(key) == 2
        else (linearization.atRot2(key).theta(),)
        for key in keys
    )
    # A copy: what GTSAM returns is a view of the factor's own memory, which goes with the factor.
    linear = np.array(factor.linearTerm()).ravel()
    return MarginalPrior(keys, point, factor.information(), linear, float(factor.constantTerm()))


class StatePrior(NamedTuple):
    """The same on a state of six: Λ (6, 6), η (6,) and the point; zero for what the model does not have."""

    information: FloatArray
    linear: FloatArray
    point: FloatArray


def variable_keys(step: Step, model: Model) -> list[int]:
    """GTSAM keys of the variables of a step, in the order of the state."""
    return [key for key, _ in variables(step, model)]


def on_state(prior: MarginalPrior, step: Step, model: Model) -> StatePrior:
    """A prior on the variables of a step, on its state."""
    parts = dict(variables(step, model))
    rows = np.concatenate([np.arange(N)[parts[key]] for key in prior.keys])
    found = StatePrior(np.zeros((N, N)), np.zeros(N), np.zeros(N))
    found.information[np.ix_(rows, rows)] = prior.information
    found.linear[rows] = prior.linear
    found.point[rows] = np.concatenate([np.array(point) for point in prior.point])
    return found


def on_variables(prior: StatePrior, step: Step, model: Model) -> MarginalPrior:
    """The inverse of `on_state`."""
    places = variables(step, model)
    rows = np.concatenate([np.arange(N)[part] for _, part in places])
    return MarginalPrior(
        tuple(key for key, _ in places),
        tuple(tuple(prior.point[part].tolist()) for _, part in places),
        prior.information[np.ix_(rows, rows)],
        prior.linear[rows],
        0.0,
    )


def variables(step: Step, model: Model) -> list[tuple[int, slice]]:
    """GTSAM keys of a step's variables, and their places in the state."""
    found = [(step.position_key, PLACES["position"]), (step.velocity_key, PLACES["velocity"])]
    if model.has_body:
        found.append((step.body_key, slice(BODY, BODY + 1)))
    if model.has_head:
        found.append((step.head_key, slice(HEAD, HEAD + 1)))
    return found
