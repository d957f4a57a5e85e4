"""What the online engines take for an observation."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from graphtrack.bounds import FIELDS, LARGEST_SECONDS
from graphtrack.errors import InputError
from graphtrack.model import Observation
from graphtrack.model.observation import CHANNELS
from graphtrack.tracks import BODY_CLASSES, HEAD_CLASSES

_SIZES = {"position": 2, "pixel": 2, "body_likelihood": BODY_CLASSES, "head_likelihood": HEAD_CLASSES}
_CHECKS = tuple((name, FIELDS[name].low, FIELDS[name].high, _SIZES.get(name, 0)) for name in CHANNELS)


def checked(observation: Observation) -> Observation:
    """The observation, with tuples where it had lists or arrays, if an engine can use it.

    Raises
    ------
    InputError
        Naming the channel: a value that is no number within the bounds of `graphtrack.bounds`, or several
        where there should be one or another number of them.
    """
    try:
        if _wrong(observation) is None:
            return observation
    except (TypeError, ValueError):  # no numbers at all
        pass
    return _mended(observation)


def _wrong(observation: Observation) -> str | None:
    """The first channel that cannot be used as it is; this is asked of every observation."""
    if not -LARGEST_SECONDS <= observation.t <= LARGEST_SECONDS:
        return "t"
    for name, low, high, size in _CHECKS:
        value = getattr(observation, name)
        if value is None:
            continue
        if size:
            if type(value) is not tuple or len(value) != size:
                return name
            for number in value:
                if not low <= number <= high:
                    return name
        elif not low <= value <= high:
            return name
    return None


def _mended(observation: Observation) -> Observation:
    changed: dict[str, Any] = {}
    for name in ("t", *CHANNELS):
        value, bounds, size = getattr(observation, name), FIELDS[name], _SIZES.get(name, 0)
        if value is None and name != "t":
            continue
        try:
            numbers = np.asarray(value, dtype=float)
        except (TypeError, ValueError):
            numbers = np.full(1, np.nan)
        right = numbers.shape == ((size,) if size else ())
        if not right or np.isnan(numbers).any() or bounds.first_outside(numbers) is not None:
            expected = f"{size} numbers, each {bounds.expected}" if size else bounds.expected
            missing = "" if name == "t" else ", or None where nothing was observed"
            raise InputError(f"{name} = {' '.join(repr(value).split())[:60]}", expected + missing)
        changed[name] = tuple(numbers.tolist()) if size else float(numbers)
    return replace(observation, **changed)
