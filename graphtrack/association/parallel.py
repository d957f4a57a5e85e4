"""Tracks of one person, by one sensor or several, or parts of them, joined as a whole.

Moving one detection after the other from one such track to the other gains nothing until the last: no move of
a single frame joins them.
"""

from __future__ import annotations

import math

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
from graphtrack.geometry.angles import BoolArray, FloatArray
from graphtrack.kernels.compilation import allocating
from graphtrack.packages import ndimage, spatial

_NEAR = 3.0
"""Standard deviations of the difference of two detections, within which most of two tracks are."""

_SAME_WAY = 1.6
"""The same for the running median of detections of a part of a track; of one person it is about 0.8."""

_MEDIAN_OF = 9  # detections of the running median
_SHORTEST = 4  # detections of a part of a track

_CLASHES = 0.1
"""Share of the scans of a part, at most, in which both tracks have a detection."""

_REACH, _SECONDS = 1.0, 0.3
"""Metres and seconds between two detections of tracks that are compared."""


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
    """Join tracks, or parts, that are more probably of one person than of two; return the number of joints.

    A part of one track is put into the other, which keeps its own detection in scans in which both have one.
    What is before the part and behind it is one track, or two, whichever is more probable. The tracks are to
    be filtered again.
    """
    tracks = {k: order for k, order in enumerate(tracks_of(chains)) if len(order) > 1}
    value = {k: _worth(chains, order, scene) for k, order in tracks.items()}
    joints, free = 0, len(chains.rows)
    for pair in _neighbours(chains, tracks):
        if not tracks.keys() >= pair:
            continue
        shorter, longer = sorted(pair, key=lambda k: (len(tracks[k]), k))
        for giver, taker in ((shorter, longer), (longer, shorter)):
            before = value[giver] + value[taker]
            found = _with_part(chains, tracks[giver], tracks[taker], before, scene)
            if found is None:
                continue
            for order in (tracks.pop(giver), tracks[taker]):
                chains.following[order], chains.preceding[order] = -1, -1
            for order in found:
                chains.following[order[:-1]], chains.preceding[order[1:]] = order[1:], order[:-1]
            numbers = [taker, *range(free, free + len(found) - 1)]
            tracks |= zip(numbers, found, strict=True)
            value |= {k: _worth(chains, tracks[k], scene) for k in numbers}
            joints, free = joints + 1, free + len(found) - 1
            break
    return joints


def _with_part(
    chains: Chains, own: IntArray, other: IntArray, before: float, scene: SceneRow
) -> list[IntArray] | None:
    """Return a track with a part of another one, and what is left of that; None if they are worth no more.

    ``before``: the worth of both as they are
    """
    for part in _parts(chains, own, other):
        kept = own[part][~np.isin(chains.frame[own[part]], chains.frame[other])]
        merged = np.sort(np.concatenate([other, kept]))
        rest, worth = _rest(chains, own[: part.start], own[part.stop :], scene)
        if _worth(chains, merged, scene) + worth > before:
            return [merged, *rest]
    return None


def _worth(chains: Chains, order: IntArray, scene: SceneRow) -> float:
    """Return the evidence of a track over that of false detections; 0 if those are more probable."""
    return max(evidence_of(chains, order, scene), 0.0) if len(order) else 0.0


def _rest(
    chains: Chains, before: IntArray, behind: IntArray, scene: SceneRow
) -> tuple[list[IntArray], float]:
    """Return the more probable tracks of the detections before and behind a part, and their worth."""
    apart = _worth(chains, before, scene) + _worth(chains, behind, scene)
    found = [order for order in (before, behind) if len(order)]
    if len(found) == 2 and float(chains.t[behind[0]] - chains.t[before[-1]]) <= scene.longest_gap:
        linked = np.concatenate(found)
        if (together := _worth(chains, linked, scene)) > apart:
            return [linked], together
    return found, apart


def _neighbours(chains: Chains, tracks: dict[int, IntArray]) -> list[set[int]]:
    """Return pairs of tracks that have detections near each other, those with the most of them first."""
    owner = np.full(len(chains.rows), -1)
    for k, order in tracks.items():
        owner[order] = k
    some = np.flatnonzero(owner >= 0)
    if not len(some):
        return []
    points = np.column_stack([chains.position[some] / _REACH, chains.t[some] / _SECONDS])
    pairs = owner[some][spatial.cKDTree(points).query_pairs(1.0, output_type="ndarray").reshape(-1, 2)]
    pairs = np.sort(pairs[pairs[:, 0] != pairs[:, 1]], axis=1)
    found, counts = np.unique(pairs, axis=0, return_counts=True)
    return [set(pair) for pair in found[np.argsort(-counts, kind="stable")].tolist()]


def _parts(chains: Chains, own: IntArray, other: IntArray) -> list[slice]:
    """Return the parts of a track that may be of the person of another track, all of it first."""
    t = chains.t
    during = (t[own] >= t[other[0]]) & (t[own] <= t[other[-1]])
    away = np.full(len(own), np.inf)
    reach = np.sqrt(chains.variance[own] + float(np.median(chains.variance[other])))
    away[during] = _distance(t[own[during]], chains.position[own[during]], t[other], chains.position[other])
    away /= reach
    found = []
    if during.any() and np.median(away[during]) < _NEAR and len(own) <= len(other):
        found.append(slice(0, len(own)))
    smooth = ndimage.median_filter(away, min(_MEDIAN_OF, len(own)), mode="nearest")
    found += [part for part in _runs(smooth < _SAME_WAY) if part.stop - part.start >= _SHORTEST]
    clash = np.isin(chains.frame[own], chains.frame[other])
    return [part for part in found if clash[part].mean() <= _CLASHES]


def _runs(mask: BoolArray) -> list[slice]:
    """Return the longest slices in which a mask (n,) is True."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]]).astype(int)))
    return [slice(int(a), int(b)) for a, b in edges.reshape(-1, 2)]


def _distance(at: FloatArray, position: FloatArray, t: FloatArray, way: FloatArray) -> FloatArray:
    """Return the RMS of x and y of the way from positions (n, 2) at some times to a path between its rows."""
    places = np.column_stack([np.interp(at, t, axis) for axis in way.T])
    return np.asarray(np.hypot(*(position - places).T) / math.sqrt(2.0))
