"""Newton's method on tracks whose Hessian is block-tridiagonal.

A forward sweep adds the terms up frame by frame and eliminates each frame by block Cholesky, as a Kalman
filter in information form; a backward sweep gives the Newton step, or the covariances as the
Rauch–Tung–Striebel smoother does.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from graphtrack.geometry.angles import FloatArray
from graphtrack.kernels.arithmetic import note_turns
from graphtrack.kernels.compilation import allocating, compiled, inner, merged
from graphtrack.kernels.layout import BODY, BOTH, Chain, N, Sums
from graphtrack.model.generator import add_frame


class Workspace(NamedTuple):
    """Memory of a factorisation and a descent, for tracks of up to n frames."""

    inverse: FloatArray  # (n, 6, 6) inverse Cholesky factors
    link: FloatArray  # (n, 6, 6) coupling of each frame to the next, in the whitened state
    solution: FloatArray  # (n, 6)
    step: FloatArray  # (n, 6)
    candidate: FloatArray  # (n, 6)
    trigonometry: FloatArray  # (n, 4) cosine and sine of body and head
    gradient: FloatArray  # (2, 6) of even and odd frames
    hessian: FloatArray  # (2, 6, 6)
    transition: FloatArray  # (6, 6) see `Sums`
    start: FloatArray  # (1, 6) initial state of the first frame
    message: FloatArray  # (n, 7, 6) Hessian and gradient, earlier frames eliminated; or (0, 7, 6)
    factored: FloatArray  # (n, 6) the states at which each frame was factored; or (0, 6)
    again: FloatArray  # (n, 6) states in another basin
    rival: FloatArray  # (n, 6) the states of the best basin that lost a comparison


@allocating
def workspace(n: int) -> Workspace:
    """Memory for tracks of up to n frames, in which no factorisation is kept."""
    return Workspace(
        np.empty((n, N, N)),
        np.empty((n, N, N)),
        np.empty((n, N)),
        np.empty((n, N)),
        np.empty((n, N)),
        np.empty((n, 4)),
        np.empty((2, N)),
        np.empty((2, N, N)),
        np.empty((N, N)),
        np.empty((1, N)),
        np.empty((0, N + 1, N)),
        np.empty((0, N)),
        np.empty((n, N)),
        np.empty((n, N)),
    )


@merged
def sums_of(k: int, workspace: Workspace) -> Sums:
    """The sums of frame k and the previous one."""
    before, here = 1 - (k & 1), k & 1
    gradient, hessian = workspace.gradient, workspace.hessian
    return Sums(gradient[before], gradient[here], hessian[before], hessian[here], workspace.transition)


_SMALLEST_PIVOT = 1e-13  # relative to the diagonal


@compiled
def invert_cholesky(matrix: FloatArray, inverse: FloatArray) -> bool:
    """Write the lower inverse Cholesky factor of a symmetric matrix; True if it is positive definite."""
    # Unrolled, so that it stays in registers: loops of variable length take twice as long.
    pivot = matrix[0, 0]
    sound0 = pivot > _SMALLEST_PIVOT * abs(matrix[0, 0])
    m00 = 1.0 / math.sqrt(pivot)
    l10 = (matrix[1, 0]) * m00
    l20 = (matrix[2, 0]) * m00
    l30 = (matrix[3, 0]) * m00
    l40 = (matrix[4, 0]) * m00
    l50 = (matrix[5, 0]) * m00
    pivot = matrix[1, 1] - l10 * l10
    sound1 = pivot > _SMALLEST_PIVOT * abs(matrix[1, 1])
    m11 = 1.0 / math.sqrt(pivot)
    l21 = (matrix[2, 1] - l20 * l10) * m11
    l31 = (matrix[3, 1] - l30 * l10) * m11
    l41 = (matrix[4, 1] - l40 * l10) * m11
    l51 = (matrix[5, 1] - l50 * l10) * m11
    pivot = matrix[2, 2] - l20 * l20 - l21 * l21
    sound2 = pivot > _SMALLEST_PIVOT * abs(matrix[2, 2])
    m22 = 1.0 / math.sqrt(pivot)
    l32 = (matrix[3, 2] - l30 * l20 - l31 * l21) * m22
    l42 = (matrix[4, 2] - l40 * l20 - l41 * l21) * m22
    l52 = (matrix[5, 2] - l50 * l20 - l51 * l21) * m22
    pivot = matrix[3, 3] - l30 * l30 - l31 * l31 - l32 * l32
    sound3 = pivot > _SMALLEST_PIVOT * abs(matrix[3, 3])
    m33 = 1.0 / math.sqrt(pivot)
    l43 = (matrix[4, 3] - l40 * l30 - l41 * l31 - l42 * l32) * m33
    l53 = (matrix[5, 3] - l50 * l30 - l51 * l31 - l52 * l32) * m33
    pivot = matrix[4, 4] - l40 * l40 - l41 * l41 - l42 * l42 - l43 * l43
    sound4 = pivot > _SMALLEST_PIVOT * abs(matrix[4, 4])
    m44 = 1.0 / math.sqrt(pivot)
    l54 = (matrix[5, 4] - l50 * l40 - l51 * l41 - l52 * l42 - l53 * l43) * m44
    pivot = matrix[5, 5] - l50 * l50 - l51 * l51 - l52 * l52 - l53 * l53 - l54 * l54
    sound5 = pivot > _SMALLEST_PIVOT * abs(matrix[5, 5])
    m55 = 1.0 / math.sqrt(pivot)
    inverse[0, 0] = m00
    inverse[1, 1] = m11
    inverse[2, 2] = m22
    inverse[3, 3] = m33
    inverse[4, 4] = m44
    inverse[5, 5] = m55
    inverse[1, 0] = m10 = -m11 * (l10 * m00)
    inverse[2, 0] = m20 = -m22 * (l20 * m00 + l21 * m10)
    inverse[3, 0] = m30 = -m33 * (l30 * m00 + l31 * m10 + l32 * m20)
    inverse[4, 0] = m40 = -m44 * (l40 * m00 + l41 * m10 + l42 * m20 + l43 * m30)
    inverse[5, 0] = -m55 * (l50 * m00 + l51 * m10 + l52 * m20 + l53 * m30 + l54 * m40)
    inverse[2, 1] = m21 = -m22 * (l21 * m11)
    inverse[3, 1] = m31 = -m33 * (l31 * m11 + l32 * m21)
    inverse[4, 1] = m41 = -m44 * (l41 * m11 + l42 * m21 + l43 * m31)
    inverse[5, 1] = -m55 * (l51 * m11 + l52 * m21 + l53 * m31 + l54 * m41)
    inverse[3, 2] = m32 = -m33 * (l32 * m22)
    inverse[4, 2] = m42 = -m44 * (l42 * m22 + l43 * m32)
    inverse[5, 2] = -m55 * (l52 * m22 + l53 * m32 + l54 * m42)
    inverse[4, 3] = m43 = -m44 * (l43 * m33)
    inverse[5, 3] = -m55 * (l53 * m33 + l54 * m43)
    inverse[5, 4] = -m55 * (l54 * m44)
    return sound0 and sound1 and sound2 and sound3 and sound4 and sound5


@compiled
def eliminate(sums: Sums, inverse: FloatArray, link: FloatArray, solution: FloatArray) -> bool:
    """Eliminate the previous frame: add its Schur complement; keep the data of the backward sweep."""
    # Three arrays and not the whole workspace, with which a descent takes a sixth longer.
    right, right_next, hessian_next = sums.gradient_before, sums.gradient, sums.hessian
    transition, definite = sums.transition, invert_cholesky(sums.hessian_before, inverse)
    # Six parallel sums are vectorised; an inner loop is not, and takes three times as long.
    for i in range(N):
        a = b = c = d = e = f = total = 0.0
        for j in range(i + 1):
            weight, row = inverse[i, j], transition[j]
            total += weight * right[j]
            a += weight * row[0]
            b += weight * row[1]
            c += weight * row[2]
            d += weight * row[3]
            e += weight * row[4]
            f += weight * row[5]
        solution[i] = total
        row = link[i]
        row[0], row[1], row[2], row[3], row[4], row[5] = a, b, c, d, e, f
    for i in range(N):
        a = b = c = d = e = f = total = 0.0
        for j in range(N):
            row = link[j]
            weight = row[i]
            total += weight * solution[j]
            a += weight * row[0]
            b += weight * row[1]
            c += weight * row[2]
            d += weight * row[3]
            e += weight * row[4]
            f += weight * row[5]
        right_next[i] -= total
        row = hessian_next[i]
        row[0] -= a
        row[1] -= b
        row[2] -= c
        row[3] -= d
        row[4] -= e
        row[5] -= f
    return definite


@compiled
def whiten(inverse: FloatArray, right: FloatArray, solution: FloatArray) -> None:
    """Multiply a right-hand side (6,) with the inverse of a Cholesky factor."""
    for i in range(N):
        total = 0.0
        for j in range(i + 1):
            total += inverse[i, j] * right[j]
        solution[i] = total


@compiled
def clear(gradient: FloatArray, hessian: FloatArray, transition: FloatArray) -> None:
    """Set to 0; assigning to slices would take longer than the terms themselves."""
    for i in range(N):
        gradient[i] = 0.0
        for j in range(N):
            hessian[i, j] = 0.0
            transition[i, j] = 0.0


@compiled
def assign(target: FloatArray, source: FloatArray) -> None:
    """Copy a matrix. Assigning to a slice does the same, but takes most of a second to compile."""
    for k in range(len(target)):
        for i in range(target.shape[1]):
            target[k, i] = source[k, i]


@inner
def copy_rows(first: int, last: int, source: FloatArray, target: FloatArray) -> None:
    """Copy the frames from ``first`` to before ``last``, (n, 6)."""
    for k in range(first, last):
        for i in range(N):
            target[k, i] = source[k, i]


@inner
def first_open(chain: Chain) -> int:
    """The first frame that may move: the last kept frame, or the first of all."""
    return max(chain.kept - 1, 0)


@inner
def sweep_back(chain: Chain, workspace: Workspace) -> float:
    """The Newton step (n, 6) of the frames not kept; returns the predicted decrease."""
    solution, decrement = workspace.solution, 0.0
    for k in range(chain.n - 1, first_open(chain) - 1, -1):
        for i in range(N):
            decrement += 0.5 * solution[k, i] * solution[k, i]
        take_step(k, k < chain.n - 1, workspace)
    return decrement


@compiled
def take_step(k: int, linked: bool, workspace: Workspace) -> None:
    """A frame's step from its part of the solution and the next frame's step, if ``linked``."""
    inverse, link, solution, step = workspace.inverse, workspace.link, workspace.solution, workspace.step
    if linked:
        for i in range(N):
            total = solution[k, i]
            for j in range(N):
                total += link[k, i, j] * step[k + 1, j]
            solution[k, i] = total
    for i in range(N):
        total = 0.0
        for j in range(i, N):
            total += inverse[k, j, i] * solution[k, j]
        step[k, i] = -total


@inner
def marginals(n: int, workspace: Workspace, covariance: FloatArray) -> None:
    """Covariances (n, 6, 6) of every frame's state from a factorisation."""
    inverse, link = workspace.inverse, workspace.link
    full, product = workspace.hessian[0], workspace.hessian[1]
    for k in range(n - 1, -1, -1):
        after = covariance[min(k + 1, n - 1)]
        marginal(inverse[k], link[k], k < n - 1, after, full, product, covariance[k])


@compiled
def marginal(
    inverse: FloatArray,
    link: FloatArray,
    linked: bool,
    after: FloatArray,
    full: FloatArray,
    product: FloatArray,
    covariance: FloatArray,
) -> None:
    """Covariance of a frame's state from that of the frame ``after`` it, if ``linked``."""
    # P = L⁻ᵀ·(I + W·P'·Wᵀ)·L⁻¹, with P' of the frame after: G = L⁻ᵀ·W, then G·P'·Gᵀ + L⁻ᵀ·L⁻¹.
    if linked:
        for i in range(N):
            a = b = c = d = e = f = 0.0
            for m in range(i, N):
                weight, row = inverse[m, i], link[m]
                a += weight * row[0]
                b += weight * row[1]
                c += weight * row[2]
                d += weight * row[3]
                e += weight * row[4]
                f += weight * row[5]
            row = full[i]
            row[0], row[1], row[2], row[3], row[4], row[5] = a, b, c, d, e, f
        for i in range(N):
            a = b = c = d = e = f = 0.0
            for m in range(N):
                weight, row = full[i, m], after[m]
                a += weight * row[0]
                b += weight * row[1]
                c += weight * row[2]
                d += weight * row[3]
                e += weight * row[4]
                f += weight * row[5]
            row = product[i]
            row[0], row[1], row[2], row[3], row[4], row[5] = a, b, c, d, e, f
    for i in range(N):
        for j in range(i + 1):
            total = 0.0
            for m in range(i, N):
                total += inverse[m, i] * inverse[m, j]
            if linked:
                row, other = product[i], full[j]
                total += (
                    row[0] * other[0]
                    + row[1] * other[1]
                    + row[2] * other[2]
                    + row[3] * other[3]
                    + row[4] * other[4]
                    + row[5] * other[5]
                )
            covariance[i, j] = total
            covariance[j, i] = total


class Result(NamedTuple):
    """Result; ``states`` holds the initial states beforehand."""

    states: FloatArray  # (N, 6); angles are not wrapped
    covariance: FloatArray  # (N, 6, 6)
    first_cost: FloatArray  # (m,)
    cost: FloatArray  # (m,)
    iterations: NDArray[np.int64]  # (m,)
    status: NDArray[np.int64]  # (m,) see CONVERGED
    apart: FloatArray  # (N, 2) spread of body and head to another basin, radians


CONVERGED, NOT_CONVERGED, NOT_FINITE = 0, 1, 2  # Status of a descent


class Descent(NamedTuple):
    """Outcome of `minimise`."""

    first_cost: float
    cost: float
    steps: int
    status: int  # see CONVERGED
    exact: bool  # True if the factorisation is that of the exact curvature at the end


@inner
def as_variable(flag: bool) -> bool:
    """The flag, as a variable: functions are compiled again for each constant."""
    negated = not flag
    return not negated


@inner
def add_prior(prior: FloatArray, state: FloatArray, sums: Sums) -> float:
    """½·dᵀ·Λ·d − ηᵀ·d, where d is the deviation from the prior's point."""
    cost = 0.0
    for i in range(N):
        slope = 0.0
        for j in range(N):
            slope += prior[i, j] * (state[j] - prior[N + 1, j])
            sums.hessian[i, j] += prior[i, j]
        cost += (0.5 * slope - prior[N, i]) * (state[i] - prior[N + 1, i])
        sums.gradient[i] += slope - prior[N, i]
    return cost


@inner
def add_message(k: int, states: FloatArray, workspace: Workspace) -> float:
    """Add the cost of a frame and all earlier ones, relative to their factorisation, with derivatives."""
    message, cost = workspace.message[k], 0.0
    gradient, hessian = workspace.gradient[k & 1], workspace.hessian[k & 1]
    for i in range(N):
        slope = message[N, i]
        gradient[i] = slope
        for j in range(N):
            hessian[i, j] = message[i, j]
            bend = message[max(i, j), min(i, j)] * (states[k, j] - workspace.factored[k, j])
            gradient[i] += bend
            slope += 0.5 * bend
        cost += slope * (states[k, i] - workspace.factored[k, i])
    note_turns(k, states, workspace.trigonometry)
    return cost


@inner
def sweep_forward(chain: Chain, states: FloatArray, exact: bool, workspace: Workspace) -> tuple[float, bool]:
    """Factor the Hessian at the states; returns their cost and True if it is positive definite."""
    problem, n, first, keeps = chain.problem, chain.n, chain.kept, len(workspace.message) > 0
    inverse, link, solution = workspace.inverse, workspace.link, workspace.solution
    turns, start, part = workspace.trigonometry, workspace.start[0], BOTH + 0
    gradient, hessian, transition = workspace.gradient, workspace.hessian, workspace.transition
    cost, definite = 0.0, True
    for k in range(2):
        clear(gradient[k], hessian[k], transition)
    if first > 0:
        cost += add_message(first - 1, states, workspace)
    for k in range(first, n):
        sums = sums_of(k, workspace)
        cost += add_frame(chain, k, states, start, exact, part, turns, sums)
        if k == 0 and len(problem.prior) > 0:
            cost += add_prior(problem.prior, states[0], sums)
        if k > 0 and definite:
            definite = eliminate(sums, inverse[k - 1], link[k - 1], solution[k - 1])
        clear(sums.gradient_before, sums.hessian_before, transition)
        if keeps and definite:
            for i in range(N):
                for j in range(N):
                    workspace.message[k, i, j] = sums.hessian[i, j]
                workspace.message[k, N, i] = sums.gradient[i]
                workspace.factored[k, i] = states[k, i]
    last = (n - 1) & 1
    if definite:
        definite = invert_cholesky(hessian[last], inverse[n - 1])
        whiten(inverse[n - 1], gradient[last], solution[n - 1])
    return cost, definite


_SMALLEST_SCALE = 1e-9

_NUDGE = 0.1
"""Radians by which orientations leave a stationary point that is no minimum, such as a body that was never
observed and points exactly backwards: its gradient is zero, and only the curvature tells."""


@inner
def go(first: int, n: int, states: FloatArray, scale: float, step: FloatArray, to: FloatArray) -> None:
    """Apply the fraction ``scale`` of the steps."""
    for k in range(first, n):
        for i in range(N):
            to[k, i] = states[k, i] + scale * step[k, i]


@inner
def nudge(first: int, n: int, states: FloatArray, to: FloatArray) -> None:
    """Copy states from the frame ``first`` on, with orientations turned by `_NUDGE`."""
    for k in range(first, n):
        for i in range(N):
            to[k, i] = states[k, i] + (_NUDGE if i >= BODY else 0.0)


@inner
def minimise(
    chain: Chain, states: FloatArray, max_iterations: int, tolerance: float, workspace: Workspace
) -> Descent:
    """Newton's method with step halving from ``states`` (n, 6), in place.

    Kept frames do not move, except the last. A saddle is left once.
    """
    step, candidate, n = workspace.step, workspace.candidate, chain.n
    first, full = first_open(chain), as_variable(True)
    copy_rows(0, 1, states, workspace.start)
    first_cost, definite = sweep_forward(chain, states, full, workspace)
    cost, exact, left_saddle, steps = first_cost, definite, False, 0
    status = NOT_CONVERGED if math.isfinite(cost) else NOT_FINITE
    for iteration in range(max_iterations + 1 if math.isfinite(cost) else 0):
        steps, exact, sound = iteration, definite, definite
        if not definite:
            _, sound = sweep_forward(chain, states, not full, workspace)
        decrement = sweep_back(chain, workspace) if sound else math.nan
        if not math.isfinite(decrement):
            status = NOT_FINITE
            break
        if decrement <= tolerance * (1.0 + abs(cost)):
            if not (definite or left_saddle) and iteration < max_iterations:
                nudge(first, n, states, states)
                cost, definite = sweep_forward(chain, states, full, workspace)
                left_saddle = True
                continue
            go(first, n, states, 1.0, step, states)
            status = CONVERGED
            break
        if iteration == max_iterations:
            break
        scale = 1.0
        while True:
            go(first, n, states, scale, step, candidate)
            found, definite = sweep_forward(chain, candidate, full, workspace)
            if found <= cost or scale <= _SMALLEST_SCALE:
                break
            scale *= 0.5
        exact = definite
        if not found <= cost:
            # The predicted decrease is less than the rounding of the cost.
            status = CONVERGED if definite else NOT_CONVERGED
            break
        cost = found
        copy_rows(first, n, candidate, states)
    return Descent(first_cost, cost, steps, status, exact)


@allocating
def leave_saddle(chain: Chain, states: FloatArray, workspace: Workspace) -> bool:
    """Put into ``workspace.again`` turned orientations of one track; False where the states are a minimum."""
    copy_rows(0, 1, states, workspace.start)
    _, definite = sweep_forward(chain, states, as_variable(True), workspace)
    if definite:
        return False
    nudge(0, chain.n, states, workspace.again)
    return True


@merged
def cost_of(chain: Chain, states: FloatArray, workspace: Workspace) -> float:
    """The cost of candidate initial states."""
    copy_rows(0, 1, states, workspace.start)
    return sweep_forward(chain, states, as_variable(True), workspace)[0]
