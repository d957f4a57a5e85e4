"""Every method at its own best parameters before it is compared: a small search in the logarithms."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from scipy.optimize import minimize

from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray
from graphtrack.model import Parameters

REACH = 100.0


def fit(objective: Callable[..., float], start: Sequence[float], *, evaluations: int) -> tuple[float, ...]:
    """Positive parameters that make the objective small, by Nelder–Mead on their logarithms.

    The first simplex changes one parameter at a time by a factor of 3; none goes further than `REACH` times
    its start, for some errors hardly depend on a parameter that is very large.

    Parameters
    ----------
    objective : of as many numbers as ``start`` has; a value that is not finite counts as very bad, and so do
        parameters that it refuses with an `InputError`
    start : where to begin, > 0
    evaluations : of the objective, at most
    """
    origin = np.log(np.asarray(start, dtype=float))
    simplex = np.vstack([origin, origin + np.log(3.0) * np.eye(len(origin))])

    def cost(point: FloatArray) -> float:
        if np.abs(point - origin).max() > np.log(REACH):
            return 1e12
        try:
            value = float(objective(*np.exp(point).tolist()))
        except InputError:
            return 1e12
        return value if np.isfinite(value) else 1e12

    options = {"initial_simplex": simplex, "maxfev": evaluations, "xatol": 0.05, "fatol": 1e-6}
    found = minimize(cost, origin, method="Nelder-Mead", options=options)
    return tuple(np.exp(found.x).tolist())


def with_density(parameters: Parameters, acceleration_density: float) -> Parameters:
    """The parameters with another q in m²/s³."""
    return replace(parameters, motion=replace(parameters.motion, acceleration_density=acceleration_density))


def with_head_rate(parameters: Parameters, head_rate: float) -> Parameters:
    """The parameters with another λ in 1/s, at which the head draws the velocity."""
    return replace(parameters, motion=replace(parameters.motion, head_rate=head_rate))


def with_coupling(parameters: Parameters, factor: float) -> Parameters:
    """The parameters with couplings that many times as strong, and orientations that diffuse as much less.

    One number for how closely body and head follow the motion.
    """
    coupling, turning = parameters.coupling, parameters.orientation
    return replace(
        parameters,
        coupling=replace(
            coupling,
            motion_body_kappa=coupling.motion_body_kappa * factor,
            head_body_kappa=coupling.head_body_kappa * factor,
        ),
        orientation=replace(
            turning,
            body_diffusion=turning.body_diffusion / factor,
            head_diffusion=turning.head_diffusion / factor,
        ),
    )
