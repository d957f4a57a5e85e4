"""People of one frame, as online smoothers and trackers tell of them."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from graphtrack.behaviour.people import People, expected_unit
from graphtrack.errors import InputError
from graphtrack.tracks import STATE

if TYPE_CHECKING:
    from graphtrack.association.tracker import PersonEstimate
    from graphtrack.inference.state import Estimate

Told: TypeAlias = "Mapping[int, Estimate] | Iterable[PersonEstimate]"
"""Estimates by track id, or those of a tracker, which know whose they are."""

Numbers = tuple[float, ...]
"""x, y, vx, vy, body, head, and the variances of these two: metres, seconds and radians."""

_BODY, _HEAD = STATE.index("body"), STATE.index("head")


def numbers_of(estimate: Estimate) -> Numbers:
    """What groups and attention take of an estimate."""
    spread = estimate.covariance
    angles = (estimate.body, estimate.head, spread.item(_BODY, _BODY), spread.item(_HEAD, _HEAD))
    return (*estimate.position.tolist(), *estimate.velocity.tolist(), *angles)


def people_told(t: float, told: Told) -> People:
    """The people of a frame, by identity; those who still wait for a position are left out.

    Raises
    ------
    InputError
        For a time that is no number, and for somebody who is told of twice.
    """
    if not math.isfinite(t):
        raise InputError(f"t = {t:g}", "a time in seconds")
    numbers: dict[int, Numbers] = {}
    frame = 0
    for one, estimate in told.items() if isinstance(told, Mapping) else ((p.track_id, p) for p in told):
        if one in numbers:
            raise InputError(f"track {one} twice", "each person once in a frame")
        if estimate.status != "waiting":
            numbers[one], frame = numbers_of(estimate), estimate.frame
    return people_at(t, frame, numbers)


def people_at(t: float, frame: int, numbers: Mapping[int, Numbers]) -> People:
    """The people of a frame from their numbers by track id."""
    ids = sorted(numbers)
    count, table = len(ids), np.array([numbers[one] for one in ids], float).reshape(-1, 8)
    return People(
        np.array(ids, dtype=np.int64),
        np.full(min(count, 1), frame, dtype=np.int64),
        np.full(min(count, 1), float(t)),
        np.array([0, count] if count else [0], dtype=np.int64),
        np.arange(count),
        table[:, :2].copy(),
        np.nan_to_num(table[:, 2:4]),
        expected_unit(table[:, 4], table[:, 6]),
        expected_unit(table[:, 5], table[:, 7]),
    )
