"""Finding the top of a log density in a few parameters, and how sharp it is."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy import optimize

from graphtrack.geometry.angles import FloatArray

Blocks = Callable[[FloatArray], FloatArray]
"""x (p,) → a log density for each block of independent data; their sum is climbed."""

REACH = float(np.log(100.0))
"""Largest distance of a parameter from its start, on its scale."""

PRIOR_STD = 3.0
"""Of a parameter about its start, on its scale: a factor of 20 either way is not held against it."""

ROUGH, FINE = 0.02, 1e-4
"""Least gain of an iteration, in the logarithm of the density."""

_DIFFERENCE = 1e-3


def penalty(x: FloatArray, start: FloatArray) -> float:
    """The broad prior that keeps what the data do not determine where it starts."""
    return 0.5 * float(np.sum((x - start) ** 2)) / PRIOR_STD**2


def climb(
    values: Blocks, start: FloatArray, prior: FloatArray, hessian: FloatArray | None = None
) -> FloatArray:
    """The place (p,) of the maximum, from ``start``; the prior's mean is ``prior``.

    Without the ``hessian`` (p, p) of the costs near the start it is a rough one: it ends where an iteration
    gains less than `ROUGH`, and takes one-sided slopes, which move the maximum by half a step. With it the
    climb is in directions in which the costs are about as curved, and ends where it gains less than `FINE`.
    """
    rough = hessian is None
    axes = np.eye(len(start)) if hessian is None else np.linalg.inv(np.linalg.cholesky(hessian)).T

    def cost(x: FloatArray) -> float:
        return penalty(x, prior) - float(values(x).sum())

    def cost_and_slope(y: FloatArray) -> tuple[float, FloatArray]:
        x, steps = start + axes @ y, _DIFFERENCE * np.eye(len(y))
        x = np.clip(x, prior - REACH, prior + REACH)
        here = cost(x)
        if rough:
            slope = np.array([cost(x + d) - here for d in steps]) / _DIFFERENCE
        else:
            slope = np.array([cost(x + d) - cost(x - d) for d in steps]) / (2.0 * _DIFFERENCE)
        return here, axes.T @ slope

    limits = zip(prior - REACH - start, prior + REACH - start, strict=True)
    found = optimize.minimize(
        cost_and_slope,
        np.zeros(len(start)),
        jac=True,
        method="L-BFGS-B",
        bounds=list(limits) if rough else None,
        options={"ftol": (ROUGH if rough else FINE) / max(1.0, abs(cost(start))), "maxiter": 50},
    )
    return np.clip(start + axes @ found.x, prior - REACH, prior + REACH)


@dataclass(frozen=True, eq=False)
class Curvature:
    """Curvature of a log density, for each block of independent data and with the prior.

    Attributes
    ----------
    total : (p, p) minus the Hessian of the sum with the prior
    slopes : (blocks, p) of each block
    blocks : (blocks, p, p) minus the Hessian of each block
    """

    total: FloatArray
    slopes: FloatArray
    blocks: FloatArray


def curvature(values: Blocks, x: FloatArray, prior: FloatArray) -> Curvature:
    """The curvature at ``x`` (p,), by differences.

    Steps are about half a standard deviation long: rounding and the higher derivatives both are small there.
    """
    p, here = len(x), values(x)
    steps = np.full(p, 0.02)
    for _ in range(2):
        units = np.diag(steps)
        ahead = np.array([values(x + unit) for unit in units])
        behind = np.array([values(x - unit) for unit in units])
        bends = (2.0 * here - ahead - behind) / steps[:, None] ** 2
        used = steps
        # The prior is a parabola: it bends by that much everywhere.
        diagonal = bends.sum(axis=1) + PRIOR_STD**-2
        steps = np.clip(0.5 / np.sqrt(np.maximum(diagonal, PRIOR_STD**-2)), 2e-3, 0.3)
    blocks = np.zeros((len(here), p, p))
    blocks[:, range(p), range(p)] = bends.T
    units = np.diag(used)
    for i in range(p):
        for j in range(i):
            corner = values(x + units[i] + units[j])
            mixed = (ahead[i] + ahead[j] - here - corner) / (used[i] * used[j])
            blocks[:, i, j] = blocks[:, j, i] = mixed
    slopes = ((ahead - behind) / (2.0 * used[:, None])).T
    return Curvature(blocks.sum(axis=0) + PRIOR_STD**-2 * np.eye(p), slopes, blocks)


def uncertainty(found: Curvature) -> FloatArray:
    """Covariance (p, p) of the maximum: by the jackknife, with no variance below the curvature's.

    The jackknife goes by how far the maximum moves, by one Newton step, without each of the blocks. To first
    order that is the sandwich estimate. Of few blocks it may be small by chance.
    """
    count, centred = len(found.slopes), found.slopes - found.slopes.mean(axis=0)
    moves = np.array(
        [
            np.linalg.solve(definite(found.total - own), slope)
            for own, slope in zip(found.blocks, centred, strict=True)
        ]
    )
    moves -= moves.mean(axis=0)
    covariance = moves.T @ moves * (count - 1.0) / count
    least = np.diag(np.linalg.inv(definite(found.total)))
    # Correlations are the jackknife's.
    wider = np.sqrt(np.maximum(1.0, least / np.maximum(np.diag(covariance), 1e-300)))
    return np.asarray(wider[:, None] * covariance * wider)


def definite(hessian: FloatArray) -> FloatArray:
    """The Hessian (p, p) with no less curvature in any direction than the prior alone has.

    At the edge of what is allowed the curvature can be anything; there, the prior is all there is.
    """
    sizes, axes = np.linalg.eigh(hessian)
    return np.asarray((axes * np.maximum(sizes, PRIOR_STD**-2)) @ axes.T)
