"""What a fixed lag remembers of states it has let go: a Gaussian on the oldest step of its window."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import gtsam
import numpy as np

from graphtrack.geometry.angles import FloatArray
from graphtrack.model.factors.custom import variable_dimension


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


def marginal_prior(
    factor: gtsam.LinearContainerFactor | None, linearization: gtsam.Values | None
) -> MarginalPrior | None:
    """What a marginal says that was made at a linearisation point; None for None."""
    if factor is None or linearization is None:
        return None
    keys = tuple(factor.keys())
    point = tuple(
        tuple(linearization.atVector(key).tolist())
        if variable_dimension(key) == 2
        else (linearization.atRot2(key).theta(),)
        for key in keys
    )
    hessian = factor.toHessian()
    return MarginalPrior(
        keys, point, hessian.information(), np.ravel(hessian.linearTerm()), float(hessian.constantTerm())
    )
