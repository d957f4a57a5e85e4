"""What the online engines take for an observation."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from graphtrack.bounds import FIELDS, FINITE, LARGEST_SECONDS, Bounds, real_numbers
from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray
from graphtrack.model import Observation
from graphtrack.model.observation import CHANNELS
from graphtrack.table.schema import INPUT_NAME, is_input_name
from graphtrack.tracks import BODY_CLASSES, HEAD_CLASSES

_SIZES = {"position": 2, "pixel": 2, "body_likelihood": BODY_CLASSES, "head_likelihood": HEAD_CLASSES}
_CHECKS = tuple((name, FIELDS[name].low, FIELDS[name].high, _SIZES.get(name, 0)) for name in CHANNELS)


def checked(observation: Observation) -> Observation:
    """The observation, with tuples where it had lists or arrays, if an engine can use it.

    Raises
    ------
    InputError
        Naming the channel: a value that is no number within the bounds of `graphtrack.bounds`, or several
        where there should be one or another number of them; or an input that has no numbers.
    """
    if not isinstance(observation, Observation):
        found = "None" if observation is None else f"a {type(observation).__name__}"
        raise InputError(found, "an Observation; its channels are None where nothing was observed")
    if observation.inputs:
        observation = replace(observation, inputs=_checked_inputs(observation.inputs))
    try:
        if _wrong(observation) is None:
            return observation
    except (TypeError, ValueError):  # no numbers at all
        pass
    return _mended(observation)


def _checked_inputs(inputs: Mapping[str, Any]) -> dict[str, float | tuple[float, ...]]:
    found: dict[str, float | tuple[float, ...]] = {}
    for name, value in inputs.items():
        if not isinstance(name, str) or not is_input_name(name):
            raise InputError(f"an input {name!r}", INPUT_NAME)
        numbers = _numbers(value)
        if numbers is None or numbers.ndim > 1 or not numbers.size or _is_outside(numbers, FINITE):
            expected = "a finite number, or several; left out where nothing is known"
            raise InputError(f"input {name} = {_shown(value)}", expected)
        found[name] = tuple(numbers.tolist()) if numbers.ndim else float(numbers)
    return found


def _numbers(value: object) -> FloatArray | None:
    try:
        return real_numbers(value)
    except (TypeError, ValueError):
        return None


def _is_outside(numbers: FloatArray, bounds: Bounds) -> bool:
    return bool(np.isnan(numbers).any()) or bounds.first_outside(numbers) is not None


def _shown(value: object) -> str:
    return " ".join(repr(value).split())[:60]


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
        numbers = _numbers(value)
        if numbers is None or numbers.shape != ((size,) if size else ()) or _is_outside(numbers, bounds):
            expected = f"{size} numbers, each {bounds.expected}" if size else bounds.expected
            missing = "" if name == "t" else ", or None where nothing was observed"
            raise InputError(f"{name} = {_shown(value)}", expected + missing)
        changed[name] = tuple(numbers.tolist()) if size else float(numbers)
    return replace(observation, **changed)
