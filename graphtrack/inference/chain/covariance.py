"""Covariances of the states: the inverse of the Gauss–Newton curvature, as `gtsam.Marginals` has it.

The variance of an angle is never more than that of the uniform density.
"""

from __future__ import annotations

import math

from graphtrack.geometry.angles import UNIFORM_STD, FloatArray
from graphtrack.inference.chain.newton import Workspace, as_variable, marginals, sweep_forward
from graphtrack.kernels.compilation import compiled, inner
from graphtrack.kernels.layout import BODY, HEAD, Chain, N


@inner
def find_covariances(chain: Chain, states: FloatArray, workspace: Workspace, covariance: FloatArray) -> None:
    """Covariances (n, 6, 6) at states."""
    sweep_forward(chain, states, as_variable(False), workspace)
    marginals(chain.n, workspace, covariance)


@compiled
def limit_angles(covariances: FloatArray) -> None:
    """Reduce the angles' variances in covariances (n, 6, 6) to that of the uniform density, in place.

    Correlations stay as they are.
    """
    for k in range(len(covariances)):
        covariance = covariances[k]
        for place in (BODY, HEAD):
            variance = covariance[place, place]
            if variance > UNIFORM_STD**2:
                for i in range(N):
                    covariance[place, i] *= UNIFORM_STD / math.sqrt(variance)
                    covariance[i, place] *= UNIFORM_STD / math.sqrt(variance)


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
    limit_angles(covariances)
