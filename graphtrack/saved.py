"""Serialisation of states: arrays and records as JSON-able data, restored to the last bit."""

from __future__ import annotations

import base64
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from graphtrack.errors import GraphtrackError, InputError
from graphtrack.geometry.angles import FloatArray

DAMAGES = (KeyError, TypeError, ValueError, IndexError, AttributeError, GraphtrackError)
"""Exceptions that a damaged state raises."""


def damaged(
    error: Exception, expected: str = "what a smoother saved", path: str | Path | None = None
) -> InputError:
    """Return the error for a state that raised an exception, such as one of `DAMAGES`."""
    return InputError(f"a damaged state ({error!r})", expected, path=path)


def real(value: Any) -> float:
    """Return a finite number of a saved state; TypeError for other values."""
    if type(value) not in (int, float) or not math.isfinite(value):
        raise TypeError(f"{str(value)[:40]!r} in place of a finite number")
    return float(value)


def integer(value: Any) -> int:
    """Return a whole number of a saved state; TypeError for other values."""
    if type(value) is not int:
        raise TypeError(f"{str(value)[:40]!r} in place of a whole number")
    return value


def count(value: Any) -> int:
    """Return a whole number from 0 on of a saved state; TypeError or ValueError for other values."""
    if integer(value) < 0:
        raise ValueError(f"{value} in place of a count")
    return int(value)


def check_numbers(value: Any) -> None:
    """Raise TypeError for a boolean among saved numbers, at any depth."""
    if isinstance(value, list | tuple | dict):
        for one in value.values() if isinstance(value, dict) else value:
            check_numbers(one)
    elif isinstance(value, bool):
        raise TypeError(f"{value} in place of a number")


def to_text(values: FloatArray) -> str:
    """Return an array of numbers as Base64 of their bytes, without its shape."""
    return base64.b64encode(values.astype("<f8").tobytes()).decode()


def from_text(text: str) -> FloatArray:
    """Invert `to_text`; the array is flat."""
    return np.frombuffer(base64.b64decode(text, validate=True), dtype="<f8").astype(float)


def packed(values: NDArray[Any]) -> list[Any]:
    """Return an array as JSON-able data: its shape, its kind and its numbers."""
    kind = values.dtype.kind
    numbers = np.ascontiguousarray(values, complex).view(float) if kind == "c" else values
    return [list(values.shape), kind, to_text(numbers)]


def unpacked(saved: list[Any]) -> NDArray[Any]:
    """Invert `packed`."""
    shape, kind, text = saved
    if kind not in ("f", "i", "b", "c"):
        raise TypeError(f"{str(kind)[:40]!r} in place of a kind of numbers")
    numbers: NDArray[Any] = from_text(text)
    if kind == "c":
        return numbers.view(complex).reshape(shape)
    # Whole numbers up to this size are exact doubles.
    return numbers.reshape(shape).astype(np.int64 if kind == "i" else float)


def pack_tree(values: Mapping[str, Any]) -> dict[str, Any]:
    """Return nested dictionaries of arrays, without lists, as JSON-able data."""
    found = {}
    for name, value in values.items():
        if isinstance(value, np.ndarray):
            value = packed(value)
        found[name] = pack_tree(value) if isinstance(value, Mapping) else value
    return found


def unpack_tree(saved: Mapping[str, Any]) -> dict[str, Any]:
    """Invert `pack_tree`."""
    found = {}
    for name, value in saved.items():
        if isinstance(value, list):
            value = unpacked(value)
        found[name] = unpack_tree(value) if isinstance(value, Mapping) else value
    return found


def pack_records(records: NDArray[np.void]) -> dict[str, list[Any]]:
    """Return records as JSON-able data, field by field."""
    return {name: packed(np.ascontiguousarray(records[name])) for name in records.dtype.names or ()}


def unpack_records(saved: Mapping[str, list[Any]], kind: np.dtype[np.void]) -> NDArray[np.void]:
    """Invert `pack_records`."""
    fields = {name: unpacked(values) for name, values in saved.items()}
    records = np.zeros(len(next(iter(fields.values()))), kind)
    for name, values in fields.items():
        records[name] = values
    return records
