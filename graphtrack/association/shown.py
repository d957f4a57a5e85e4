"""Angles, scores and descriptors of observations as arrays; NaN where one has none."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from graphtrack.association.facing import observed_angles
from graphtrack.bounds import APPEARANCE
from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray
from graphtrack.model import Observation


def facing_of(seen: Sequence[Observation]) -> FloatArray:
    """Observed body and head, (n, 2) radians; NaN where there is none."""
    channels: dict[str, FloatArray] = {}
    for name in ("body", "head"):
        angles = [getattr(one, name) for one in seen]
        channels[name] = np.array([math.nan if angle is None else angle for angle in angles])
        classes = [getattr(one, f"{name}_likelihood") for one in seen]
        size = next((len(one) for one in classes if one is not None), 0)
        if size:
            none = (math.nan,) * size
            channels[f"{name}_likelihood"] = np.array([none if one is None else one for one in classes])
    return observed_angles(channels, len(seen))


def scores_of(seen: Sequence[Observation]) -> FloatArray:
    """Return the detector's scores, (n,)."""
    return np.array([math.nan if one.score is None else one.score for one in seen])


def descriptors_of(seen: Sequence[Observation], size: int = 0) -> FloatArray:
    """Return the descriptors of observations, (n, d): their input `APPEARANCE`.

    Raise InputError for a descriptor that has another size.

    Parameters
    ----------
    size : d as it was before; 0: that of the first one
    """
    given = [one.inputs.get(APPEARANCE) for one in seen]
    rows = [None if one is None else np.atleast_1d(np.asarray(one, float)) for one in given]
    size = size or next((len(row) for row in rows if row is not None), 0)
    found = np.full((len(rows), size), np.nan)
    for k, row in enumerate(rows):
        if row is not None:
            if row.shape != (size,):
                raise InputError(
                    f"a descriptor of {row.size} numbers", f"{size}, as before", column=f"{APPEARANCE}_0"
                )
            found[k] = row
    return found


def to_smooth(seen: Observation, noise: float) -> Observation:
    """An observation without what says whose it is alone; of that noise (m) where it does not say its own."""
    if seen.position_std is not None and seen.score is None and not seen.inputs:
        return seen
    inputs = {name: value for name, value in seen.inputs.items() if name != APPEARANCE}
    return replace(seen, score=None, inputs=inputs, position_std=seen.position_std or noise)
