"""Covariances of the states: the inverse of the exact Hessian, as `gtsam.Marginals` has it.

An angle's is that of a von Mises density: its mean square, for the concentration 1/P of the inverse curvature
P. It is P where that is small, and never more than that of the uniform density.
"""

from __future__ import annotations

import math

import numpy as np

from graphtrack.geometry.angles import UNIFORM_STD, FloatArray
from graphtrack.inference.chain.newton import Workspace, as_variable, marginals, sweep_forward
from graphtrack.kernels.compilation import compiled, inner
from graphtrack.kernels.lanes import any_of, masked, negate
from graphtrack.kernels.layout import BODY, HEAD, Chain, N


@inner
def find_covariances(chain: Chain, states: FloatArray, workspace: Workspace, covariance: FloatArray) -> None:
    """Covariances (n, 6, 6) at states, of the exact curvature if definite."""
    full = as_variable(True)
    _, exact = sweep_forward(chain, states, full, workspace)
    if any_of(exact):
        marginals(chain.n, workspace, covariance)
    if any_of(negate(exact)):
        # A saddle, or not converged: the positive semidefinite curvature.
        sweep_forward(chain, states, not full, workspace)
        marginals(chain.n, workspace, masked(covariance, negate(exact)))


SHRINK_WIDEST = 1e3  # Inverse curvature in rad² beyond which an angle is uniform


def _von_mises_shrink(variance: FloatArray) -> FloatArray:
    """Root mean square of von Mises densities of concentration 1/``variance``, over √``variance``."""
    # In units of the standard deviation, so that narrow ones are resolved too.
    reach = np.minimum(np.pi, 12.0 * np.sqrt(variance))
    angle = reach[:, None] * (np.arange(1000) + 0.5) / 1000.0
    density = np.exp((np.cos(angle) - 1.0) / variance[:, None])
    return np.asarray(np.sqrt((density * angle**2).sum(axis=1) / density.sum(axis=1) / variance))


_SHARES = np.linspace(0.0, SHRINK_WIDEST / (1.0 + SHRINK_WIDEST), 400)
"""P/(1 + P) of the table of the factor of √P."""
_SHRINK = np.append(1.0, _von_mises_shrink(_SHARES[1:] / (1.0 - _SHARES[1:])))
_LAST = len(_SHRINK) - 1
_PER_SHARE = 1.0 / float(_SHARES[1])


@inner
def shrink_of(variance: float) -> float:
    """The factor of the standard deviation of an angle's inverse curvature."""
    place = variance / (1.0 + variance) * _PER_SHARE
    # NaN stays NaN.
    found = _SHRINK[_LAST] + 0.0 * variance
    if place < _LAST:
        k = int(place)
        found = _SHRINK[k] + (place - k) * (_SHRINK[k + 1] - _SHRINK[k])
    return UNIFORM_STD / math.sqrt(variance) if found * found * variance > UNIFORM_STD**2 else found


@inner
def limited(variance: float) -> float:
    """Bound the variance of an angle by that of the uniform density; NaN stays NaN."""
    return UNIFORM_STD**2 if variance > UNIFORM_STD**2 else variance


@compiled
def as_von_mises(covariances: FloatArray) -> None:
    """Change covariances (n, 6, 6), the inverse curvature, to those of von Mises densities, in place."""
    for k in range(len(covariances)):
        covariance = covariances[k]
        if math.isnan(covariance[BODY, BODY]) and math.isnan(covariance[HEAD, HEAD]):
            continue
        body, head = shrink_of(covariance[BODY, BODY]), shrink_of(covariance[HEAD, HEAD])
        for i in range(BODY):
            covariance[BODY, i] *= body
            covariance[i, BODY] *= body
            covariance[HEAD, i] *= head
            covariance[i, HEAD] *= head
        covariance[BODY, HEAD] *= body * head
        covariance[HEAD, BODY] *= body * head
        covariance[BODY, BODY] = limited(covariance[BODY, BODY] * body * body)
        covariance[HEAD, HEAD] = limited(covariance[HEAD, HEAD] * head * head)


@inner
def hide(place: int, state: FloatArray, covariance: FloatArray) -> None:
    """Set variables outside the model to NaN."""
    state[place] = math.nan
    for i in range(N):
        covariance[i, place] = covariance[place, i] = math.nan


@compiled
def admit_rivals(covariances: FloatArray, apart: FloatArray) -> None:
    """Add to covariances (n, 6, 6), in place, the spread to another basin of similar likelihood.

    ``apart`` (n, 2): turns of body and head to it, times the root of its probability; their squares are the
    mean squares about the estimates.
    """
    for k in range(len(covariances)):
        if apart[k, 0] == 0.0 and apart[k, 1] == 0.0:
            continue
        covariance = covariances[k]
        for i in range(2):
            for j in range(2):
                covariance[BODY + i, BODY + j] += apart[k, i] * apart[k, j]
        for place in (BODY, HEAD):
            variance = covariance[place, place]
            if variance > UNIFORM_STD**2:
                for i in range(N):
                    covariance[place, i] *= UNIFORM_STD / math.sqrt(variance)
                    covariance[i, place] *= UNIFORM_STD / math.sqrt(variance)
