"""GTSAM factors derived from a term's kernels.

A factor of GTSAM is ½‖r‖² with a Jacobian J. From a kernel's cost c, gradient g and Gauss–Newton block H, a
pivoted Cholesky factorisation makes rows with JᵀJ = H and Jᵀr = g; one more row, without Jacobian, carries
what c is beyond ½‖r‖². So the factor has the kernel's cost and gradient exactly.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import gtsam
import numpy as np
from numpy.typing import NDArray

from graphtrack.geometry.angles import FloatArray, class_centres, unit
from graphtrack.model.factors.custom import custom_factor
from graphtrack.model.kernels.compiled import compiled
from graphtrack.model.kernels.kernel import Kernel
from graphtrack.model.kernels.layout import BODY, HEAD, PLACES, N
from graphtrack.model.kernels.packing import PackedTracks
from graphtrack.model.observation import Step
from graphtrack.tracks import BODY_CLASSES, HEAD_CLASSES

if TYPE_CHECKING:
    from graphtrack.model.term import Term

_SMALLEST_PIVOT = 1e-14
"""Of the greatest: what is smaller is rounding of a block that is not of full rank."""

_CONSTANTS: dict[str, Any] = {
    "BODY": BODY,
    "HEAD": HEAD,
    "exact": False,
    "origin_x": 0.0,
    "origin_y": 0.0,
    "body_directions": unit(class_centres(BODY_CLASSES)),
    "head_directions": unit(class_centres(HEAD_CLASSES)),
}


def derived_factors(term: Term, step: Step) -> Sequence[gtsam.NonlinearFactor]:
    """The factors of a term at a step, one for each kernel that is called there."""
    packed = term.packer(step.observation, step.dt, step.starts, step.camera)
    record, found = packed.records[0], []
    for kernel in term.kernels:
        elsewhere = kernel.unless in (record.dtype.names or ()) and record[kernel.unless] > 0.0
        if record[kernel.gate] > 0.0 and not elsewhere and not (kernel.before and step.previous is None):
            found.append(_factor(kernel, packed, term, step))
    return found


def _factor(kernel: Kernel, packed: PackedTracks, term: Term, step: Step) -> gtsam.NonlinearFactor:
    keys, columns = [], []
    for names, of, first in ((kernel.before, step.previous, 0), (kernel.variables, step, N)):
        for name in names:
            keys.append(getattr(of, f"{name}_key"))
            columns.append(np.arange(first, first + N)[PLACES[name]])
    evaluation = _Evaluation(kernel, packed, term, step, keys, np.concatenate(columns))
    ends = np.cumsum([len(part) for part in columns]).tolist()
    parts = [slice(end - len(part), end) for end, part in zip(ends, columns, strict=True)]

    def residual(values: gtsam.Values) -> FloatArray:
        return evaluation(values)[0]

    def linearised(values: gtsam.Values) -> tuple[FloatArray, Sequence[FloatArray]]:
        rows, jacobian = evaluation(values)
        return rows, [jacobian[:, part] for part in parts]

    return custom_factor(keys, ends[-1] + 1, residual, linearised)


class _Evaluation:
    """A kernel at one step, called with GTSAM's values."""

    def __init__(
        self,
        kernel: Kernel,
        packed: PackedTracks,
        term: Term,
        step: Step,
        keys: Sequence[int],
        columns: NDArray[np.int64],
    ) -> None:
        self._function, self._columns = kernel.function, columns
        # (which variable, its key, the state it stands in, whether of the frame before)
        names = [*((name, True) for name in kernel.before), *((name, False) for name in kernel.variables)]
        self._variables = [(name, key, earlier) for (name, earlier), key in zip(names, keys, strict=True)]
        self._states = np.zeros((2, N))
        self._sums = [np.zeros((2, N)), np.zeros((3, N, N))]
        gradients, hessians = self._sums
        given: dict[str, Any] = _CONSTANTS | {
            "before": self._states[0],
            "state": self._states[1],
            "gradient_before": gradients[0],
            "gradient": gradients[1],
            "hessian_before": hessians[0],
            "hessian": hessians[1],
            "transition": hessians[2],
        }
        for row in (packed.records[0], packed.shared[0]):
            for name in row.dtype.names or ():
                given[name] = float(row[name]) if np.ndim(row[name]) == 0 else np.array(row[name])
        given |= dict(term.packer.live(step.observation))
        for name in ("body_heights", "head_heights"):
            heights = getattr(packed, name)
            given[name] = heights[0] if len(heights) else None
        self._arguments = [given.get(name, 0.0) for name in kernel.arguments]
        self._trigonometry = [
            (
                kernel.arguments.index(f"{name}_cos{suffix}"),
                kernel.arguments.index(f"{name}_sin{suffix}"),
                key,
            )
            for name, key, earlier in self._variables
            if f"{name}_cos{(suffix := '_before' if earlier else '')}" in kernel.arguments
        ]

    def __call__(self, values: gtsam.Values) -> tuple[FloatArray, FloatArray]:
        """Residual (n + 1,) and Jacobian (n + 1, n) of the n degrees of freedom."""
        for name, key, earlier in self._variables:
            state = self._states[0 if earlier else 1]
            if name == "position":
                state[PLACES[name]] = values.atPoint2(key)
            elif name == "velocity":
                state[PLACES[name]] = values.atVector(key)
            else:
                state[PLACES[name]] = values.atRot2(key).theta()
        for cos, sin, key in self._trigonometry:
            rotation = values.atRot2(key)
            self._arguments[cos], self._arguments[sin] = rotation.c(), rotation.s()
        gradients, hessians = self._sums
        gradients[:], hessians[:] = 0.0, 0.0
        cost = self._function(*self._arguments)
        n = len(self._columns)
        residual, jacobian = np.zeros(n + 1), np.zeros((n + 1, n))
        factorise(cost, gradients, hessians, self._columns, residual, jacobian)
        return residual, jacobian


@compiled
def factorise(
    cost: float,
    gradients: FloatArray,
    hessians: FloatArray,
    columns: NDArray[np.int64],
    residual: FloatArray,
    jacobian: FloatArray,
) -> None:
    """Rows whose squares are a cost, with its gradient and its block of Gauss–Newton's kind.

    Parameters
    ----------
    cost : not negative
    gradients : (2, 6) of the frame before and of the frame
    hessians : (3, 6, 6) lower triangles of the frame before and of the frame, and the block between them
    columns : (n,) which of the 12 degrees of freedom there are
    residual, jacobian : (n + 1,) and (n + 1, n) of zeros, filled in
    """
    n = len(columns)
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
        # What rounding leaves there would be taken for a pivot.
        block[pivot, pivot] = 0.0
    residual[n] = math.sqrt(max(rest, 0.0))
