"""People of one frame, as online smoothers and trackers tell of them."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from graphtrack.behaviour.people import IntArray, People, expected_unit
from graphtrack.errors import InputError
from graphtrack.inference.state import Estimate
from graphtrack.tracks import STATE

if TYPE_CHECKING:
    from graphtrack.association.tracker import PersonEstimate

Told = Mapping[int, Estimate] | Iterable["PersonEstimate"]
"""Estimates by track id, or those of a tracker, which know whose they are."""

_BODY, _HEAD = STATE.index("body"), STATE.index("head")


def people_told(t: float, told: Told) -> People:
    """The people of a frame, by identity; those who still wait for a position are left out.

    Raises
    ------
    InputError
        For a time that is no number, and for somebody who is told of twice.
    """
    if not math.isfinite(t):
        raise InputError(f"t = {t:g}", "a time in seconds")
    if isinstance(told, Mapping):
        pairs: list[tuple[int, Any]] = list(told.items())
    else:
        pairs = [(one.track_id, one) for one in told]
    pairs = sorted((pair for pair in pairs if pair[1].status != "waiting"), key=lambda pair: pair[0])
    ids: IntArray = np.array([one for one, _ in pairs], dtype=np.int64)
    if len(ids) and (ids[1:] == ids[:-1]).any():
        raise InputError(f"track {ids[1:][ids[1:] == ids[:-1]][0]} twice", "each person once in a frame")
    found = [one for _, one in pairs]
    count = len(found)
    angle = np.array([(one.body, one.head) for one in found], float).reshape(-1, 2)
    variance = [(one.covariance[_BODY, _BODY], one.covariance[_HEAD, _HEAD]) for one in found]
    body, head = (
        expected_unit(angle[:, k], np.array(variance, float).reshape(-1, 2)[:, k]) for k in (0, 1)
    )
    frame = max((one.frame for one in found), default=0)
    return People(
        ids,
        np.full(min(count, 1), frame, dtype=np.int64),
        np.full(min(count, 1), float(t)),
        np.array([0, count] if count else [0], dtype=np.int64),
        np.arange(count),
        np.array([one.position for one in found], float).reshape(-1, 2),
        np.nan_to_num(np.array([one.velocity for one in found], float).reshape(-1, 2)),
        body,
        head,
    )
