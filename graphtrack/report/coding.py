"""Series as the page holds them: rounded, and as differences, which pack well."""

from __future__ import annotations

from typing import Final

import numpy as np

from graphtrack.geometry.angles import FloatArray

TIME_STEP: Final = 1e-3
"""Seconds a unit of a coded time."""

LENGTH_STEP: Final = 1e-3
"""Metres (or metres a second) a unit of a coded length (or velocity)."""

ANGLE_STEP: Final = float(np.radians(0.1))
"""Radians a unit of a coded angle."""

SURE_STEP: Final = 1e-2
"""Probability a unit of a coded one."""

COARSE_STEP: Final = 1e-2
"""Metres a unit of a coded length that nobody knows to a millimetre: of forecasts, and of groups."""

Codes = list[int | None]


def delta_code(values: FloatArray, step: float) -> Codes | None:
    """Integers in units of ``step``: the first value, then differences; None where a value is not finite."""
    known = np.isfinite(values)
    if not known.any():
        return None
    codes = np.full(len(values), None, dtype=object)
    codes[known] = np.diff(np.round(values[known] / step).astype(np.int64), prepend=0)
    found: Codes = codes.tolist()
    return found
