"""GTSAM factors: native von Mises, custom ones through a checked wrapper, and those derived from kernels.

GTSAM does not check a callback's Jacobians; `custom_factor` makes wrong shapes Python errors. From a kernel's
cost c, gradient g and Gauss–Newton block H, a pivoted Cholesky factorisation makes rows with JᵀJ = H and
Jᵀr = g; one more row, without Jacobian, carries the cost c beyond ½‖r‖².
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import cache, lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from graphtrack.errors import GraphtrackError
from graphtrack.geometry.angles import FloatArray
from graphtrack.kernels.compilation import allocating
from graphtrack.kernels.layout import BODY, HEAD, STATE_SLICES, N, Sums
from graphtrack.model.kernel import Kernel
from graphtrack.model.observation import Step
from graphtrack.model.packing import PackedTracks
from graphtrack.packages import gtsam


def von_mises_noise(kappa: float) -> gtsam.noiseModel.Base:
    """Noise with which a Frobenius factor on Rot2 costs exactly κ·(1 − cos Δ)."""
    # ‖R(a) − R(b)‖² = 4(1 − cos Δ), and the factor costs half of it over σ²: hence σ² = 2/κ.
    return gtsam.noiseModel.Isotropic.Sigma(4, float(np.sqrt(2.0 / kappa)))


def von_mises_prior(key: int, mean: float, kappa: float) -> gtsam.NonlinearFactor:
    """A native factor that costs κ·(1 − cos(angle − mean)); κ > 0."""
    return gtsam.FrobeniusPriorRot2(key, gtsam.Rot2(mean).matrix(), von_mises_noise(kappa))


def von_mises_between(first: int, second: int, kappa: float) -> gtsam.NonlinearFactor:
    """A native factor that costs κ·(1 − cos(second − first)); κ > 0."""
    return gtsam.FrobeniusBetweenFactorRot2(first, second, gtsam.Rot2(), von_mises_noise(kappa))


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
        When the factor is used, if a function returns another shape; the message names the key.
    """
    keys = list(keys)
    shapes = [(rows, variable_dimension(key)) for key in keys]

    def callback(this: gtsam.CustomFactor, values: gtsam.Values, jacobians: Any) -> FloatArray:
        del this  # a traceback would keep it, and its repr after the factor is freed ends the process
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
    """The noise model of whitened residuals."""
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


_SMALLEST_PIVOT = 1e-14  # Relative to the greatestpivot; smaller pivots are rounding errors

_CONSTANTS: dict[str, Any] = {
    "at_body": BODY,
    "at_head": HEAD,
    "exact": False,
    "origin_x": 0.0,
    "origin_y": 0.0,
}


def kernel_factors(
    kernels: tuple[Kernel, ...],
    packed: PackedTracks,
    live: Sequence[tuple[str, float]],
    step: Step,
) -> Sequence[gtsam.NonlinearFactor]:
    """One factor for each kernel that is called at a step.

    ``packed``: frame of its kind; ``live``: values of the fields that differ between frames of a kind.
    """
    return [
        _factor(call, live, step)
        for call in _calls(kernels, packed)
        if not (call.kernel.before and step.previous is None)
    ]


class _Call:
    """A kernel with its arguments in all frames of equal packing."""

    def __init__(self, kernel: Kernel, packed: PackedTracks) -> None:
        self.kernel = kernel
        arguments = kernel.arguments(kernel.compiled)
        given: dict[str, Any] = dict(_CONSTANTS)
        for row in (packed.records[0], packed.shared[0]):
            for name in set(arguments).intersection(row.dtype.names or ()):
                given[name] = float(row[name]) if np.ndim(row[name]) == 0 else np.array(row[name])
        for name in ("body_heights", "head_heights"):
            heights = getattr(packed, name)
            given[name] = heights[0] if len(heights) else None
        self.arguments = [given.get(name, 0.0) for name in arguments]
        self.place = {name: i for i, name in enumerate(arguments)}
        # (variable, indices of its cosine and sine among the arguments, True for the previous frame)
        self.variables = [
            (name, self.place.get(f"{name}_cos{end}"), self.place.get(f"{name}_sin{end}"), earlier)
            for names, end, earlier in ((kernel.before, "_before", True), (kernel.variables, "", False))
            for name in names
        ]
        columns = [
            np.arange(N)[STATE_SLICES[name]] + (0 if earlier else N) for name, _, _, earlier in self.variables
        ]
        self.columns = np.concatenate(columns)
        ends = np.cumsum([len(part) for part in columns]).tolist()
        self.parts = [slice(end - len(part), end) for end, part in zip(ends, columns, strict=True)]


@lru_cache(maxsize=256)
def _calls(kernels: tuple[Kernel, ...], packed: PackedTracks) -> list[_Call]:
    record = packed.records[0]
    names = record.dtype.names or ()
    return [
        _Call(kernel, packed)
        for kernel in kernels
        if record[kernel.gate] > 0.0 and not (kernel.unless in names and record[kernel.unless] > 0.0)
    ]


def _factor(call: _Call, live: Sequence[tuple[str, float]], step: Step) -> gtsam.NonlinearFactor:
    keys = [
        getattr(step.previous if earlier else step, f"{name}_key") for name, _, _, earlier in call.variables
    ]
    evaluation = _Evaluation(call, live, keys)
    blocks = [evaluation.jacobian[:, part] for part in call.parts]

    # Without `custom_factor`, whose checks take as long as a kernel.
    def callback(this: gtsam.CustomFactor, values: gtsam.Values, jacobians: Any) -> FloatArray:
        del this  # a traceback would keep it, and its repr after the factor is freed ends the process
        evaluation(values)
        if jacobians is not None:
            for i, block in enumerate(blocks):
                jacobians[i] = block
        return evaluation.residual

    return gtsam.CustomFactor(unit_noise(len(evaluation.residual)), keys, callback)


class _Evaluation:
    """A kernel at one step, called with GTSAM's values; GTSAM copies ``residual`` and ``jacobian``."""

    def __init__(self, call: _Call, live: Sequence[tuple[str, float]], keys: Sequence[int]) -> None:
        self._function, self._columns = call.kernel.compiled, call.columns
        states, self._gradients, self._hessians = (np.zeros(s) for s in ((2, N), (2, N), (3, N, N)))
        (before, state), (hessian_before, hessian, transition) = states, self._hessians
        sums = Sums(self._gradients[0], self._gradients[1], hessian_before, hessian, transition)
        self._arguments = list(call.arguments)
        for name, value in (("before", before), ("state", state), ("sums", sums), *live):
            if name in call.place:
                self._arguments[call.place[name]] = value
        # Preallocated slices of the states: making a slice takes longer than writing to it.
        self._vectors: list[tuple[bool, int, FloatArray]] = []
        self._rotations: list[tuple[int, FloatArray, int | None, int | None]] = []
        for (name, cos, sin, earlier), key in zip(call.variables, keys, strict=True):
            part = states[0 if earlier else 1, STATE_SLICES[name]]
            if name in ("position", "velocity"):
                self._vectors.append((name == "position", key, part))
            else:
                self._rotations.append((key, part, cos, sin))
        n = len(call.columns)
        # By columns, as GTSAM's matrices are.
        self.residual, self.jacobian = np.zeros(n + 1), np.zeros((n + 1, n), order="F")

    def __call__(self, values: gtsam.Values) -> None:
        """Evaluate residual and Jacobian."""
        arguments = self._arguments
        for is_position, key, part in self._vectors:
            part[:] = values.atPoint2(key) if is_position else values.atVector(key)
        for key, part, cos, sin in self._rotations:
            rotation = values.atRot2(key)
            part[0] = rotation.theta()
            if cos is not None:
                arguments[cos] = rotation.c()
            if sin is not None:
                arguments[sin] = rotation.s()
        cost = self._function(*arguments)
        factorise(cost, self._gradients, self._hessians, self._columns, self.residual, self.jacobian)


@allocating
def factorise(
    cost: float,
    gradients: FloatArray,
    hessians: FloatArray,
    columns: NDArray[np.int64],
    residual: FloatArray,
    jacobian: FloatArray,
) -> None:
    """Rows of a least-squares form of a cost, with its gradient and its Gauss–Newton block.

    ``gradients`` (2, 6) and ``hessians`` (3, 6, 6; lower triangles of two frames, and the block between) are
    reset to zero; ``columns`` (n,) of the 12 degrees of freedom; ``residual``, ``jacobian`` (n + 1, …) are
    filled in.
    """
    n = len(columns)
    residual[:], jacobian[:] = 0.0, 0.0
    left, block = np.empty(n), np.empty((n, n))
    for i in range(n):
        a = columns[i]
        left[i] = gradients[a // N, a % N]
        for j in range(n):
            b = columns[j]
            if a < N <= b:
                block[i, j] = hessians[2, a, b - N]
            elif b < N <= a:
                block[i, j] = hessians[2, b, a - N]
            else:
                block[i, j] = hessians[a // N, max(a, b) % N, min(a, b) % N]
    gradients[:], hessians[:] = 0.0, 0.0
    greatest = 0.0
    for i in range(n):
        greatest = max(greatest, block[i, i])
    rest = 2.0 * cost
    for row in range(n):
        pivot = 0
        for i in range(n):
            if block[i, i] > block[pivot, pivot]:
                pivot = i
        if not block[pivot, pivot] > _SMALLEST_PIVOT * greatest:
            break
        root = math.sqrt(block[pivot, pivot])
        for i in range(n):
            jacobian[row, i] = block[pivot, i] / root
        residual[row] = left[pivot] / root
        rest -= residual[row] * residual[row]
        for i in range(n):
            left[i] -= jacobian[row, i] * residual[row]
            for j in range(n):
                block[i, j] -= jacobian[row, i] * jacobian[row, j]
        # Rounding errors there would be taken for a pivot.
        block[pivot, pivot] = 0.0
    residual[n] = math.sqrt(max(rest, 0.0))
