"""The volume of the posterior about an optimum, compiled."""

from __future__ import annotations

import math

from graphtrack.geometry.angles import FloatArray
from graphtrack.inference.chain.elimination import Workspace
from graphtrack.inference.chain.newton import factorise
from graphtrack.model.kernels.compiled import allocating
from graphtrack.model.kernels.layout import N
from graphtrack.model.kernels.problem import Problem


@allocating
def log_determinants(
    problem: Problem, begin: int, end: int, states: FloatArray, workspace: Workspace, found: FloatArray
) -> None:
    """log det of the Hessians of tracks ``begin`` to ``end`` at their states, from the Cholesky factors.

    The Hessian is exact where that is positive definite, else that of Gauss–Newton.
    """
    for track in range(begin, end):
        a, b = problem.offsets[track], problem.offsets[track + 1]
        here, n = states[a:b], b - a
        factorise(problem, track, n, here, workspace)
        total = 0.0
        for k in range(b - a):
            for i in range(N):
                total -= 2.0 * math.log(workspace.inverse[k, i, i])
        found[track] = total
