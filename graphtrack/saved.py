"""Values of saved states: numbers as text, and the error for damaged ones."""

from __future__ import annotations

import base64
import math
from typing import Any

import numpy as np

from graphtrack.errors import GraphtrackError, InputError
from graphtrack.geometry.angles import FloatArray

DAMAGES = (KeyError, TypeError, ValueError, IndexError, AttributeError, GraphtrackError)
"""Exceptions that a damaged state raises."""


def damaged(error: Exception) -> InputError:
    """The error for a state that raised one of `DAMAGES`."""
    return InputError(f"a damaged state ({error!r})", "what a smoother saved")


def real(value: Any) -> float:
    """A finite number of a saved state; TypeError if the value is something else."""
    if type(value) not in (int, float) or not math.isfinite(value):
        raise TypeError(f"{str(value)[:40]!r} in place of a finite number")
    return float(value)


def whole(value: Any) -> int:
    """A whole number of a saved state; TypeError if the value is something else."""
    if type(value) is not int:
        raise TypeError(f"{str(value)[:40]!r} in place of a whole number")
    return value


def to_text(values: FloatArray) -> str:
    """An array of numbers as Base64 of their bytes; its shape is not in it."""
    return base64.b64encode(values.astype("<f8").tobytes()).decode()


def from_text(text: str) -> FloatArray:
    """The inverse of `to_text`, flat."""
    return np.frombuffer(base64.b64decode(text, validate=True), dtype="<f8").astype(float)
