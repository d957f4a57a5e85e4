"""Values of saved states: checked types, arrays as text, and the error for a damaged state."""

from __future__ import annotations

import base64
from typing import Any

import numpy as np

from graphtrack.errors import GraphtrackError, InputError
from graphtrack.geometry.angles import FloatArray

DAMAGES = (KeyError, TypeError, ValueError, IndexError, AttributeError, GraphtrackError)
"""What going on from a damaged state raises."""


def damaged(error: Exception) -> InputError:
    """What is said of a state that raised one of `DAMAGES`."""
    return InputError(f"a damaged state ({error!r})", "what a smoother saved")


def number(value: Any) -> float:
    """Return a finite or infinite number of a state as a float; TypeError if it is none."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise TypeError(f"{value!r} in place of a number")
    return float(value)


def whole(value: Any) -> int:
    """Return a whole number of a state; TypeError if it is none."""
    if type(value) is not int:
        raise TypeError(f"{value!r} in place of a whole number")
    return value


def boolean(value: Any) -> bool:
    """Return a truth value of a state; TypeError if it is none."""
    if type(value) is not bool:
        raise TypeError(f"{value!r} in place of true or false")
    return value


def to_text(values: FloatArray) -> str:
    """An array of numbers as Base64 of their bytes; its shape is not in it."""
    return base64.b64encode(values.astype("<f8").tobytes()).decode()


def from_text(text: str) -> FloatArray:
    """The inverse of `to_text`, flat."""
    return np.frombuffer(base64.b64decode(text, validate=True), dtype="<f8").astype(float)
