"""Which boxes tell about the ground: whole ones, grouped by people, no more than are needed."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from graphtrack.geometry.angles import FloatArray
from perception.detection.boxes import PersonBox
from perception.images.pixels import intersection_over_union

_OVERLAP = 0.3
_BORDER = 2.0


def whole(box: FloatArray, size: tuple[int, int]) -> NDArray[np.bool_]:
    """Which boxes (n, 4) do not touch the border of an image of that size (columns, rows): others are cut."""
    left, top, width, height = box.T
    columns, rows = size
    inside = (left > _BORDER) & (left + width < columns - _BORDER)
    return np.asarray(inside & (top > _BORDER) & (top + height < rows - _BORDER))


def people_of(boxes: Sequence[PersonBox]) -> NDArray[np.int64]:
    """(n,) who is in each box, from 0: by identities or, without, by overlap from a frame to the next.

    Someone who is lost and found again counts as two.
    """
    if boxes and boxes[0].identified:
        ids = np.array([item.track_id for item in boxes])
        return np.asarray(np.unique(ids, return_inverse=True)[1], np.int64)
    frame = np.array([item.frame for item in boxes], np.int64)
    box = np.array([item.box for item in boxes], float).reshape(-1, 4)
    who: NDArray[np.int64] = np.full(len(boxes), -1)
    order = np.argsort(frame, kind="stable")
    before: NDArray[np.int64] = np.zeros(0, np.int64)
    count = 0
    for now in np.split(order, np.flatnonzero(np.diff(frame[order])) + 1) if len(order) else ():
        if len(before):
            overlap = intersection_over_union(box[now][:, None], box[before])
            first, second = linear_sum_assignment(-overlap)
            near = overlap[first, second] > _OVERLAP
            who[now[first[near]]] = who[before[second[near]]]
        new = now[who[now] < 0]
        who[new] = count + np.arange(len(new))
        count += len(new)
        before = now
    return who


def thinned(who: NDArray[np.int64], most: int, rng: np.random.Generator) -> NDArray[np.int64]:
    """Places of at most ``most`` boxes, as many of each person as possible, in their order.

    Parameters
    ----------
    who : (n,) who is in each box
    """
    if len(who) <= most:
        return np.arange(len(who))
    order = rng.permutation(len(who))
    by_person = order[np.argsort(who[order], kind="stable")]
    start = np.flatnonzero(np.diff(who[by_person], prepend=-1))
    turn = np.arange(len(who)) - np.repeat(start, np.diff(np.append(start, len(who))))
    # Everybody's first box comes before anybody's second; within a turn the order is by chance.
    chosen = by_person[np.lexsort((rng.permutation(len(who)), turn))[:most]]
    return np.sort(chosen)
