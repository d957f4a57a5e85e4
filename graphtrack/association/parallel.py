"""Tracks of one person by different sensors, joined as a whole.

Moving one detection after the other from one such track to the other gains nothing until the last: no move of
a single frame joins them.
"""

from __future__ import annotations

import math
from itertools import combinations

import numpy as np

from graphtrack.association.likelihood import (
    STATE,
    Chains,
    IntArray,
    SceneRow,
    extend_track,
    log_end,
    start_track,
)
from graphtrack.geometry.angles import FloatArray
from graphtrack.kernels.compilation import allocating

_NEAR = 3.0
"""Standard deviations of the difference of two detections, within which most of two tracks are."""

_CLASHES = 0.1
"""Share of the shorter track's scans, at most, in which both tracks have a detection."""


@allocating
def evidence_of(chains: Chains, order: IntArray, scene: SceneRow) -> float:
    """Return the evidence of the track of some detections (n,), in the order of time."""
    state = np.zeros(1, STATE)
    total = start_track(chains.rows[order[0]], scene, state[0])
    for i in range(1, len(order)):
        total += extend_track(chains, state[0], order[i - 1], order[i], scene, state[0])
    return total + log_end(chains, order[-1], scene)


def tracks_of(chains: Chains) -> list[IntArray]:
    """Return the detections of each track, in the order of time."""
    found = []
    for first in np.flatnonzero(chains.preceding < 0).tolist():
        order = [first]
        while (after := int(chains.following[order[-1]])) >= 0:
            order.append(after)
        found.append(np.array(order))
    return found


def join_parallel(chains: Chains, scene: SceneRow) -> int:
    """Join tracks that are more probably one person's than two people's; return the number of joints.

    Of scans in which both have a detection the longer track keeps its own. The tracks are to be filtered
    again.
    """
    tracks = {k: order for k, order in enumerate(tracks_of(chains)) if len(order) > 1}
    value = {k: evidence_of(chains, order, scene) for k, order in tracks.items()}
    joints = 0
    for first, second in _candidates(chains, tracks):
        if first not in tracks or second not in tracks:
            continue
        longer, shorter = sorted((first, second), key=lambda k: -len(tracks[k]))
        kept = tracks[shorter][~np.isin(chains.frame[tracks[shorter]], chains.frame[tracks[longer]])]
        merged = np.sort(np.concatenate([tracks[longer], kept]))
        gained = max(evidence_of(chains, merged, scene), 0.0)
        if gained <= max(value[longer], 0.0) + max(value[shorter], 0.0):
            continue
        for order in (tracks[longer], tracks[shorter]):
            chains.following[order], chains.preceding[order] = -1, -1
        chains.following[merged[:-1]], chains.preceding[merged[1:]] = merged[1:], merged[:-1]
        tracks[longer], value[longer] = merged, gained
        del tracks[shorter]
        joints += 1
    return joints


def _candidates(chains: Chains, tracks: dict[int, IntArray]) -> list[tuple[int, int]]:
    """Return pairs of tracks that are near while both last, the nearest first."""
    t, position = chains.t, chains.position
    begin = {k: t[order[0]] for k, order in tracks.items()}
    end = {k: t[order[-1]] for k, order in tracks.items()}
    found: list[tuple[float, int, int]] = []
    for first, second in combinations(tracks, 2):
        low, high = max(begin[first], begin[second]), min(end[first], end[second])
        if high <= low:
            continue
        shorter, longer = sorted((first, second), key=lambda k: len(tracks[k]))
        own, other = tracks[shorter], tracks[longer]
        some = own[(t[own] >= low) & (t[own] <= high)]
        if not len(some):
            continue
        if np.isin(chains.frame[own], chains.frame[other]).mean() > _CLASHES:
            continue
        away = _distance(t[some], position[some], t[other], position[other])
        reach = np.sqrt(chains.variance[some] + float(np.median(chains.variance[other])))
        apart = float(np.median(away / reach))
        if apart < _NEAR:
            found.append((apart, first, second))
    return [(first, second) for _, first, second in sorted(found)]


def _distance(at: FloatArray, position: FloatArray, t: FloatArray, way: FloatArray) -> FloatArray:
    """Return the RMS of x and y of the way from positions (n, 2) at some times to a path between its rows."""
    places = np.column_stack([np.interp(at, t, axis) for axis in way.T])
    return np.asarray(np.hypot(*(position - places).T) / math.sqrt(2.0))
