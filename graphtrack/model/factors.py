"""GTSAM factors: native von Mises, and those derived from kernels.

From a kernel's
cost c, gradient g and Gauss–Newton block H, a pivoted Cholesky factorisation makes rows with JᵀJ = H and
Jᵀr = g; one more row, without Jacobian, carries the cost c beyond ½‖r‖².
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cache, lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

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


@cache
def unit_noise(rows: int) -> gtsam.noiseModel.Base:
    """The noise model of whitened residuals."""
    return gtsam.noiseModel.Unit.Create(rows)


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
    return [_Call(kernel, packed) for kernel in kernels if kernel.acts(packed.records[:1])[0]]


def _factor(call: _Call, live: Sequence[tuple[str, float]], step: Step) -> gtsam.NonlinearFactor:
    keys = [
        getattr(step.previous if earlier else step, f"{name}_key") for name, _, _, earlier in call.variables
    ]
    evaluation = _Evaluation(call, live, keys)
    blocks = [evaluation.jacobian[:, part] for part in call.parts]

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
