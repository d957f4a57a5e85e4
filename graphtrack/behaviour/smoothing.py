"""Evidence of pairs of people in one group: from each frame, averaged over time."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from graphtrack.behaviour.people import IntArray
from graphtrack.geometry.angles import FloatArray
from graphtrack.model.kernels.compiled import allocating, compiled

_BEGINNING = 0.5
"""Seconds that the first frame counts for where nobody knows when the next one will come."""
FORGOTTEN = 5.0
"""Times of averaging after which, where the past alone counts, two who meet again meet for the first time."""


def averaged(
    pair: IntArray, t: FloatArray, values: FloatArray, seconds: float
) -> tuple[FloatArray, FloatArray]:
    """Averages (n, k) with weights exp(−|Δt|/seconds) within each pair, and the sum of the weights, (n,) s.

    Each frame counts for the time about it, so that the frame rate is without effect, but no frame for more
    than `seconds`. Without averaging (0 s) the values stay, and the sums are 0.

    Parameters
    ----------
    pair : (n,) which pair a value is of
    t : (n,) seconds
    values : (n, k)
    """
    if seconds <= 0.0 or not len(pair):
        return values, np.zeros(len(pair))
    order: NDArray[np.int64] = np.lexsort((t, pair))
    found, weight = np.empty_like(values), np.empty(len(pair))
    found[order], weight[order] = _averaged(pair[order], t[order], values[order], seconds)
    return found, weight


@allocating
def _averaged(
    pair: IntArray, t: FloatArray, values: FloatArray, seconds: float
) -> tuple[FloatArray, FloatArray]:
    n, size = values.shape
    about, found, whole = np.empty(n), np.empty((n, size)), np.empty(n)
    for k in range(n):
        low = t[k] - t[k - 1] if k > 0 and pair[k - 1] == pair[k] else math.inf
        high = t[k + 1] - t[k] if k + 1 < n and pair[k + 1] == pair[k] else math.inf
        if low == math.inf or high == math.inf:
            about[k] = min(low, high, seconds)
        else:
            about[k] = 0.5 * (min(low, seconds) + min(high, seconds))
        fade = math.exp(-low / seconds)
        whole[k] = about[k]
        found[k] = about[k] * values[k]
        if fade > 0.0:
            whole[k] += fade * whole[k - 1]
            found[k] += fade * found[k - 1]
    after, total = np.zeros(size), 0.0
    for k in range(n - 1, -1, -1):
        if k + 1 < n and pair[k + 1] == pair[k]:
            fade = math.exp(-(t[k + 1] - t[k]) / seconds)
            after[:] = fade * (after + about[k + 1] * values[k + 1])
            total = fade * (total + about[k + 1])
        else:
            after[:] = 0.0
            total = 0.0
        whole[k] += total
        found[k] = (found[k] + after) / whole[k]
    return found, whole


@compiled
def since(gap: float, seconds: float) -> tuple[float, float]:
    """Return the seconds a frame counts for where the past alone does, and the share of the past that stays.

    ``gap``: seconds from the frame before; infinite for the first
    """
    if gap > FORGOTTEN * seconds:
        return min(_BEGINNING, seconds), 0.0
    return min(gap, seconds), math.exp(-gap / seconds)


@allocating
def merged(
    known: IntArray,
    last: FloatArray,
    sums: FloatArray,
    pairs: IntArray,
    values: FloatArray,
    of: IntArray,
    seconds: FloatArray,
    t: float,
) -> tuple[IntArray, FloatArray, FloatArray, FloatArray]:
    """Take in a frame's pairs: all that are still known, when last seen, their sums; the averages of these.

    Parameters
    ----------
    known, pairs : (k, 2), (n, 2) ids, both ascending by the second, then by the first
    last : (k,) seconds
    sums : (k, 9) of the values of each pair, times the seconds that they count for, and of the seconds
    values : (n, 6)
    of : (6,) which of the times of averaging each value has
    seconds : (3,)
    """
    size, count = values.shape[1], len(pairs)
    room = len(known) + count
    all_pairs, all_last = np.empty((room, 2), dtype=np.int64), np.empty(room)
    all_sums, means = np.empty((room, sums.shape[1])), np.empty((count, size))
    at, k, n = 0, 0, 0
    while k < len(known) or n < count:
        before = n == count or (
            k < len(known)
            and (known[k, 1] < pairs[n, 1] or (known[k, 1] == pairs[n, 1] and known[k, 0] < pairs[n, 0]))
        )
        if before:
            if t - last[k] <= FORGOTTEN * seconds.max():
                all_pairs[at], all_last[at], all_sums[at] = known[k], last[k], sums[k]
                at += 1
            k += 1
            continue
        met = k < len(known) and known[k, 0] == pairs[n, 0] and known[k, 1] == pairs[n, 1]
        gap = t - last[k] if met else math.inf
        all_pairs[at], all_last[at] = pairs[n], t
        for part in range(len(seconds)):
            about, fade = since(gap, seconds[part])
            weight = about
            if fade > 0.0:
                weight += fade * sums[k, size + part]
            all_sums[at, size + part] = weight
            for j in range(size):
                if of[j] != part:
                    continue
                total = about * values[n, j]
                if fade > 0.0:
                    total += fade * sums[k, j]
                all_sums[at, j] = total
                means[n, j] = total / weight if seconds[part] > 0.0 else values[n, j]
        at += 1
        k += met
        n += 1
    return all_pairs[:at].copy(), all_last[:at].copy(), all_sums[:at].copy(), means
