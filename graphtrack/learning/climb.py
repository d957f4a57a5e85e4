"""Finding the top of a log density in a few parameters, and how sharp it is."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy import optimize

from graphtrack.geometry.angles import FloatArray

Blocks = Callable[[FloatArray], FloatArray]
"""x (p,) → a log density for each block of independent data; their sum is climbed."""

REACH = float(np.log(100.0))
"""How far a parameter may go from where it starts, on its scale."""

PRIOR_STD = 3.0
"""Of a parameter about its start, on its scale: a factor of 20 either way is not held against it."""

ROUGH, FINE = 0.02, 1e-4
"""What an iteration gains at least, in the logarithm of the density."""

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


def curvature(values: Blocks, x: FloatArray, prior: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Minus the Hessian (p, p) of the sum with the prior, and the slopes (blocks, p) of each block.

    Steps are about half a standard deviation long: rounding and the higher derivatives both are small there.
    """
    p, here = len(x), values(x)
    middle, steps = penalty(x, prior) - here.sum(), np.full(p, 0.02)
    for _ in range(2):
        units = np.diag(steps)
        ahead = [values(x + unit) for unit in units]
        behind = [values(x - unit) for unit in units]
        up = np.array([penalty(x + u, prior) - v.sum() for u, v in zip(units, ahead, strict=True)])
        down = np.array([penalty(x - u, prior) - v.sum() for u, v in zip(units, behind, strict=True)])
        diagonal = (up + down - 2.0 * middle) / steps**2
        used = steps
        steps = np.clip(0.5 / np.sqrt(np.maximum(diagonal, PRIOR_STD**-2)), 2e-3, 0.3)
    hessian = np.diag(diagonal)
    units = np.diag(used)
    for i in range(p):
        for j in range(i):
            both = x + units[i] + units[j]
            corner = penalty(both, prior) - float(values(both).sum())
            mixed = (corner - up[i] - up[j] + middle) / (used[i] * used[j])
            hessian[i, j] = hessian[j, i] = mixed
    slopes = np.stack([(a - b) / (2.0 * h) for a, b, h in zip(ahead, behind, used, strict=True)], axis=1)
    return hessian, slopes


def definite(hessian: FloatArray) -> FloatArray:
    """The Hessian (p, p) with no less curvature in any direction than the prior alone has.

    At the edge of what is allowed the curvature can be anything; there, the prior is all there is.
    """
    sizes, axes = np.linalg.eigh(hessian)
    return np.asarray((axes * np.maximum(sizes, PRIOR_STD**-2)) @ axes.T)
