"""Stated uncertainty of whole tracks: `stating` of `LANES` frames at a time."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from graphtrack.geometry.angles import FloatArray
from graphtrack.inference.chain.linear import Linear, solve_linear_track
from graphtrack.inference.chain.result import Result
from graphtrack.inference.chain.stating import Added, Stating, across, added, state
from graphtrack.model.kernels.compiled import allocating, compiled
from graphtrack.model.kernels.lanes import LANES, load, store
from graphtrack.model.kernels.layout import BODY, HEAD
from graphtrack.model.kernels.vector_math import of_lanes  # noqa: F401  (math.exp of lanes)


@allocating
def state_tracks(
    covariance: FloatArray, states: FloatArray, offsets: NDArray[np.int64], t: FloatArray, stating: Stating
) -> None:
    """Covariances (n, 6, 6) of all frames of tracks from ``offsets`` (m + 1,) on, at the times ``t`` (n,)."""
    known = np.empty((8, LANES))
    for track in range(len(offsets) - 1):
        state_track(covariance, states, offsets[track], offsets[track + 1] - 1, t, stating, known)


@allocating
def solve_and_state(linear: Linear, longest: int, t: FloatArray, stating: Stating, result: Result) -> None:
    """`solve_linear_tracks` and `state_tracks` in one pass, while a track's covariances are at hand."""
    known, spread, memory = np.empty((8, LANES)), np.empty((longest, 3)), np.empty((longest, 7))
    offsets = linear.offsets
    for track in range(len(offsets) - 1):
        solve_linear_track(linear, track, spread, memory, result)
        first, last = offsets[track], offsets[track + 1] - 1
        state_track(result.covariance, result.states, first, last, t, stating, known)


@compiled
def state_track(
    covariance: FloatArray,
    states: FloatArray,
    first: int,
    last: int,
    t: FloatArray,
    stating: Stating,
    known: FloatArray,
) -> None:
    """Covariances of the frames ``first`` to ``last`` of one track; ``known`` (8, LANES) is memory."""
    for begin in range(first, last + 1, LANES):
        for lane in range(LANES):
            k = min(begin + lane, last)
            known[0, lane] = 0.5 * (covariance[k, 2, 2] + covariance[k, 3, 3])
            known[1, lane] = 0.5 * (covariance[k, 0, 2] + covariance[k, 1, 3])
            known[2, lane] = across(covariance, states, k, BODY)
            known[3, lane] = covariance[k, BODY, BODY]
            known[4, lane] = covariance[k, HEAD, BODY]
            known[5, lane] = across(covariance, states, k, HEAD)
            known[6, lane] = covariance[k, HEAD, HEAD]
            known[7, lane] = min(t[k] - t[first], t[last] - t[k])
        more = added(
            load(known, 0),
            load(known, 1),
            load(known, 2),
            load(known, 3),
            load(known, 4),
            load(known, 5),
            load(known, 6),
            load(known, 7),
            stating,
        )
        store(known, 0, more.position)
        store(known, 1, more.both)
        store(known, 2, more.velocity)
        store(known, 3, more.body)
        store(known, 4, more.head)
        for lane in range(min(LANES, last + 1 - begin)):
            told = Added(known[0, lane], known[1, lane], known[2, lane], known[3, lane], known[4, lane])
            state(covariance, begin + lane, told, stating)
