"""Errors of sensors as arrays, as they are learned."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np

from graphtrack.geometry.angles import FloatArray, wrapped
from graphtrack.tracks.sensors import Sensor

ERRORS = ("shift_x", "shift_y", "rotation", "angle_bias", "clock_offset")
"""Errors of a sensor, in the order of arrays: metres, metres, radians, radians, seconds."""

X, Y, ROTATION, BIAS, CLOCK = range(len(ERRORS))

PRIOR_STD = (1.0, 1.0, math.radians(10.0), math.radians(30.0), 0.5)
"""1-σ of the errors before anything is observed, in the units of `ERRORS`."""


def errors_of(sensor: Sensor) -> FloatArray:
    """Return the errors (5,) of a sensor, NaN where they are unknown."""
    shift = (None, None) if sensor.shift is None else sensor.shift
    values = (*shift, sensor.rotation, sensor.angle_bias, sensor.clock_offset)
    return np.array([math.nan if one is None else one for one in values])


def with_errors(sensor: Sensor, errors: FloatArray, std: FloatArray | None = None) -> Sensor:
    """Return a description with errors (5,), and with their 1-σ (5,) where these are not NaN."""
    x, y, rotation, bias, clock = errors.tolist()
    found = replace(
        sensor, shift=(x, y), rotation=wrapped(rotation), angle_bias=wrapped(bias), clock_offset=clock
    )
    if std is None:
        return found
    given = dict(zip(ERRORS, std.tolist(), strict=True))
    of_shift = given["shift_x"], given["shift_y"]
    names = ("rotation", "angle_bias", "clock_offset")
    known = {f"{name}_std": given[name] for name in names if not math.isnan(given[name])}
    return replace(found, shift_std=None if math.isnan(sum(of_shift)) else of_shift, **known)


def shown_values(sensor: Sensor) -> dict[str, tuple[float | None, float | None]]:
    """Return the name with unit of each quantity that is learned → its value and its 1-σ; None: unknown."""

    def degrees(*angles: float | None) -> Any:
        return tuple(None if one is None else math.degrees(one) for one in angles)

    def milliseconds(*times: float | None) -> Any:
        return tuple(None if one is None else 1e3 * one for one in times)

    shift, spread = (one or (None, None) for one in (sensor.shift, sensor.shift_std))
    return {
        "shift x (m)": (shift[0], spread[0]),
        "shift y (m)": (shift[1], spread[1]),
        "rotation (°)": degrees(sensor.rotation, sensor.rotation_std),
        "angles (°)": degrees(sensor.angle_bias, sensor.angle_bias_std),
        "clock (ms)": milliseconds(sensor.clock_offset, sensor.clock_offset_std),
        "noise (×)": (sensor.position_scale, None),
        "detected": (sensor.detection_probability, None),
        "false (1/m²)": (sensor.false_density, None),
    }
