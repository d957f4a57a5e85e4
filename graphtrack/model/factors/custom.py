"""Custom GTSAM factors through one checked wrapper.

GTSAM takes what a callback returns on trust: a Jacobian of a wrong shape, or one left unassigned, ends the
process. Here every answer is checked on its way, and a wrong shape is a Python error.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache
from typing import Any

import numpy as np

from graphtrack.errors import GraphtrackError
from graphtrack.geometry.angles import FloatArray
from graphtrack.later import gtsam

Residual = Callable[["gtsam.Values"], FloatArray]
Linearised = Callable[["gtsam.Values"], tuple[FloatArray, Sequence[FloatArray]]]

_DIMENSION = {"x": 2, "v": 2, "b": 1, "h": 1}


class FactorShapeError(GraphtrackError):
    """A custom factor that returned arrays of a wrong shape."""


def custom_factor(
    keys: Sequence[int],
    rows: int,
    residual: Residual,
    linearised: Linearised | None = None,
    noise: gtsam.noiseModel.Base | None = None,
) -> gtsam.CustomFactor:
    """A factor ½‖r(values)‖² from a function that returns the whitened residual.

    Parameters
    ----------
    keys : GTSAM keys of the variables: positions, velocities, body and head orientations of some steps
    rows : number of residual rows m
    residual : values → (m,)
    linearised : values → residual (m,) and one Jacobian (m, d) for each key, d = 2 for positions and
        velocities, 1 for orientations. Without it the Jacobians are central differences.
    noise : noise model of m rows, for robust factors; None: the residual is whitened already

    Raises
    ------
    FactorShapeError
        When the factor is used, if a function returns something else; the message names the key.
    """
    keys = list(keys)
    shapes = [(rows, variable_dimension(key)) for key in keys]

    def callback(this: gtsam.CustomFactor, values: gtsam.Values, jacobians: Any) -> FloatArray:
        del this  # a traceback would keep it, and its repr after the factor is gone ends the process
        if jacobians is None:
            value = residual(values)
        elif linearised is None:
            value = residual(values)
            if value.shape != (rows,):
                raise FactorShapeError(f"found a residual of shape {value.shape}, expected ({rows},)")
            for i, jacobian in enumerate(numerical_jacobians(residual, values, keys)):
                jacobians[i] = jacobian
        else:
            value, given = linearised(values)
            if len(given) != len(keys):
                raise FactorShapeError(
                    f"found {len(given)} Jacobians, expected {len(keys)}, one for each key"
                )
            for i, shape in enumerate(shapes):
                if given[i].shape != shape:
                    name = gtsam.DefaultKeyFormatter(keys[i])
                    raise FactorShapeError(f"found a Jacobian {given[i].shape} by {name}, expected {shape}")
                jacobians[i] = given[i]
        if value.shape != (rows,):
            raise FactorShapeError(f"found a residual of shape {value.shape}, expected ({rows},)")
        return value

    return gtsam.CustomFactor(unit_noise(rows) if noise is None else noise, keys, callback)


@cache
def unit_noise(rows: int) -> gtsam.noiseModel.Base:
    """The noise model of residuals that are whitened already."""
    return gtsam.noiseModel.Unit.Create(rows)


def variable_dimension(key: int) -> int:
    """Degrees of freedom of the variable behind a key: 2 for X and V, 1 for B and H."""
    letter = chr(gtsam.Symbol(key).chr())
    if letter not in _DIMENSION:
        name = gtsam.DefaultKeyFormatter(key)
        raise FactorShapeError(f"found the key {name}, expected one of x, v, b, h")
    return _DIMENSION[letter]


def numerical_jacobians(
    residual: Residual, values: gtsam.Values, keys: Sequence[int], step: float = 1e-6
) -> list[FloatArray]:
    """Central differences of a residual through ``retract``: one (m, d) array for each key."""
    result = []
    for key in keys:
        dimension = variable_dimension(key)
        columns = []
        for axis in range(dimension):
            sides = []
            for sign in (1.0, -1.0):
                delta = gtsam.VectorValues()
                delta.insert(key, sign * step * np.eye(dimension)[axis])
                sides.append(np.asarray(residual(values.retract(delta))))
            columns.append((sides[0] - sides[1]) / (2.0 * step))
        result.append(np.stack(columns, axis=1))
    return result
