"""What single frames of a chain say, linearised: Gaussians for an engine that eliminates them itself."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from graphtrack.geometry.angles import FloatArray
from graphtrack.inference.chain.newton import as_variable
from graphtrack.model.kernels.compiled import apart, compiled
from graphtrack.model.kernels.layout import N
from graphtrack.model.kernels.problem import Problem
from graphtrack.model.kernels.program import add_links, add_own, note_turns


@apart
def linearise(
    problem: Problem,
    frames: NDArray[np.int64],
    start: FloatArray,
    states: FloatArray,
    zeros: FloatArray,
    blocks: FloatArray,
    vectors: FloatArray,
) -> None:
    """Gauss–Newton's Gaussians ½·dᵀΛd − ηᵀd of some frames' terms, d being the state beyond its zero.

    Parameters
    ----------
    problem : of one track, without a prior
    frames : (m,) which
    start : (6,) what the first orientations are held to
    states : (n, 6) where they are linearised
    zeros : (n, 6) the states at which d = 0
    blocks : (m, 4, 6, 6) filled with Λ of the frame's own terms; of those that link it to the one before: of
        the frame before, between (a row for each coordinate of the one before), of the frame
    vectors : (m, 3, 6) filled with η of the own terms, of the frame before, and of the frame
    """
    blocks[:] = 0.0
    vectors[:] = 0.0
    gaussian_newton, turns, track = as_variable(False), np.empty((len(states), 4)), len(problem.offsets) - 2
    for i in range(len(frames)):
        k = frames[i]
        own, before, between, here = blocks[i, 0], blocks[i, 1], blocks[i, 2], blocks[i, 3]
        note_turns(k, states, turns)
        add_own(problem, track, k, start, states, gaussian_newton, turns, vectors[i, 0], own)
        complete(own)
        shift(own, states[k] - zeros[k], vectors[i, 0])
        if k == 0:
            continue
        note_turns(k - 1, states, turns)
        add_links(
            problem,
            track,
            k,
            states,
            gaussian_newton,
            turns,
            vectors[i, 1],
            vectors[i, 2],
            before,
            here,
            between,
        )
        complete(before)
        complete(here)
        behind, away = states[k - 1] - zeros[k - 1], states[k] - zeros[k]
        shift(before, behind, vectors[i, 1])
        shift(here, away, vectors[i, 2])
        for a in range(N):
            for b in range(N):
                vectors[i, 1, a] += between[a, b] * away[b]
                vectors[i, 2, b] += between[a, b] * behind[a]


@compiled
def complete(matrix: FloatArray) -> None:
    """Fill the upper triangle in from the lower one."""
    for a in range(N):
        for b in range(a):
            matrix[b, a] = matrix[a, b]


@compiled
def shift(information: FloatArray, away: FloatArray, vector: FloatArray) -> None:
    """Make a gradient at ``away`` the linear part η = Λ·away − gradient, in place."""
    for a in range(N):
        total = -vector[a]
        for b in range(N):
            total += information[a, b] * away[b]
        vector[a] = total
