"""Finding the top of a log density in a few parameters, and how sharp it is."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy import optimize

from graphtrack.angles import FloatArray

Blocks = Callable[[FloatArray], FloatArray]
"""x (p,) → a log density for each block of independent data; their sum is climbed."""

REACH = float(np.log(100.0))
"""How far a parameter may go from where it starts, on its scale."""

PRIOR_STD = 3.0
"""Of a parameter about its start, on its scale: a factor of 20 either way is not held against it."""

_DIFFERENCE = 1e-3


def penalty(x: FloatArray, start: FloatArray) -> float:
    """The broad prior that keeps what the data do not determine where it starts."""
    return 0.5 * float(np.sum((x - start) ** 2)) / PRIOR_STD**2


def climb(values: Blocks, start: FloatArray, prior: FloatArray) -> FloatArray:
    """The place (p,) of the maximum, from ``start``; the prior's mean is ``prior``."""

    def cost(x: FloatArray) -> float:
        return penalty(x, prior) - float(values(x).sum())

    def cost_and_slope(x: FloatArray) -> tuple[float, FloatArray]:
        here, steps = cost(x), _DIFFERENCE * np.eye(len(x))
        # Central: the maximum must not move by half a step.
        return here, np.array([cost(x + d) - cost(x - d) for d in steps]) / (2.0 * _DIFFERENCE)

    bounds = list(zip(prior - REACH, prior + REACH, strict=True))
    found = optimize.minimize(
        cost_and_slope,
        start,
        jac=True,
        method="L-BFGS-B",
        bounds=bounds,
        options={"ftol": 1e-9, "maxiter": 50},
    )
    return np.asarray(found.x)


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
