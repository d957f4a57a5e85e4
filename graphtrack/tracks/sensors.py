"""Sensors described: errors, noise and field of view, and the correction of rows by what is known of them."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from hashlib import sha256
from types import MappingProxyType
from typing import Any, Literal, Self, TypeAlias

import numpy as np

from graphtrack.errors import InputError
from graphtrack.geometry.angles import BoolArray, FloatArray, direction, rotated, rotated_classes, unit, wrap
from graphtrack.tracks.table import Rows
from graphtrack.tracks.validation import LARGEST_CONCENTRATION, LARGEST_METRES, Bounds, is_number

_ARC = 49
"""Points of an arc of a field of view."""

MOST_CORNERS = 1000
"""Corners of a field of view, at most."""

_STD = (1e-4, 100.0)  # metres


@dataclass(frozen=True)
class _Key:
    """Values of a field, in the unit of the file: degrees where the field has radians."""

    kind: Literal["number", "pair", "polygon", "flag", "text"]
    low: float = -LARGEST_METRES
    high: float = LARGEST_METRES
    degrees: bool = False


def _key(
    kind: Literal["number", "pair", "polygon", "flag", "text"] = "number",
    low: float = -LARGEST_METRES,
    high: float = LARGEST_METRES,
    *,
    degrees: bool = False,
    default: Any = None,
) -> Any:
    """Return a field of a description; see `_Key`."""
    return field(default=default, metadata={"key": _Key(kind, low, high, degrees)})


class _Described:
    """Base of dataclasses whose fields are made by `_key`; a file has ``<name>_deg`` for angles."""

    def __post_init__(self) -> None:
        for one in fields(self):  # type: ignore[arg-type]
            value = getattr(self, one.name)
            if "key" in one.metadata and value is not None:
                object.__setattr__(self, one.name, _checked(one.name, value, one.metadata["key"]))

    @classmethod
    def from_table(cls, place: str, table: Any) -> Self:
        """Return a description of a file's table; InputError for an unknown key or a wrong value.

        ``place``: the name of the table, for messages
        """
        if not isinstance(table, Mapping):
            raise InputError(f"{place} = {table!r}"[:80], f"a table [{place}]")
        known = {_name_in_file(one): one for one in fields(cls)}  # type: ignore[arg-type]
        values: dict[str, Any] = {}
        for name, value in table.items():
            if name not in known:
                raise InputError(f"key {place}.{name}"[:120], f"one of {', '.join(known)}")
            key = known[name].metadata.get("key")
            here = f"{place}.{name}"
            if key is None:
                values[name] = SimulatedSensor.from_table(here, value)
            else:
                values[known[name].name] = _converted(_checked(here, value, key, in_file=True), key)
        try:
            return cls(**values)
        except InputError as error:
            raise InputError(f"[{place}] {error.found}", error.expected) from error

    def to_table(self) -> dict[str, Any]:
        """Return the table of a file; what is unknown is left out."""
        found: dict[str, Any] = {}
        for one in fields(self):  # type: ignore[arg-type]
            value, key = getattr(self, one.name), one.metadata.get("key")
            if value == one.default:
                continue
            found[_name_in_file(one)] = value.to_table() if key is None else _written(value, key)
        return found


def _name_in_file(one: Any) -> str:
    key = one.metadata.get("key")
    return f"{one.name}_deg" if key is not None and key.degrees else str(one.name)


def _converted(value: Any, key: _Key) -> Any:
    """Return a value of a file in radians, if it has degrees."""
    if not key.degrees:
        return value
    return tuple(map(math.radians, value)) if isinstance(value, tuple) else math.radians(value)


def _written(value: Any, key: _Key) -> Any:
    if isinstance(value, tuple):
        return [_written(one, key) for one in value]
    return _degrees(value) if key.degrees else value


def _degrees(angle: float) -> float:
    """Return an angle in degrees with the fewest digits that read back to it."""
    exact = math.degrees(angle)
    for digits in range(1, 17):
        if math.radians(short := float(f"{exact:.{digits}g}")) == angle:
            return short
    return exact


def _checked(name: str, value: Any, key: _Key, *, in_file: bool = False) -> Any:
    """Return a value as a float, a boolean, text or tuples of floats; InputError if the key has no such."""
    if key.kind == "flag":
        if not isinstance(value, bool):
            raise InputError(f"{name} = {value!r}"[:80], "true or false")
        return value
    if key.kind == "text":
        if not isinstance(value, str) or not value:
            raise InputError(f"{name} = {value!r}"[:80], "text")
        return value
    scale = math.radians(1.0) if key.degrees and not in_file else 1.0
    bounds = Bounds(scale * key.low, scale * key.high)
    if key.kind == "number":
        return _number(name, value, bounds)
    if key.kind == "pair":
        return _pair(name, value, bounds)
    if not _is_list(value) or not 3 <= len(value) <= MOST_CORNERS:
        raise InputError(f"{name} = {value!r}"[:80], f"a list of 3 to {MOST_CORNERS} corners [x, y]")
    ring = tuple(_pair(f"{name}[{k}]", one, bounds) for k, one in enumerate(value))
    return _simple(name, ring[:-1] if ring[0] == ring[-1] and len(ring) > 3 else ring)


def _is_list(value: Any) -> bool:
    return isinstance(value, Sequence | np.ndarray) and not isinstance(value, str | bytes)


def _number(name: str, value: Any, bounds: Bounds) -> float:
    if not is_number(value) or not bounds.low <= value <= bounds.high:
        raise InputError(f"{name} = {value!r}"[:80], bounds.expected)
    return float(value)


def _pair(name: str, value: Any, bounds: Bounds) -> tuple[float, float]:
    if not _is_list(value) or len(value) != 2:
        raise InputError(f"{name} = {value!r}"[:80], "a list of two numbers")
    first, second = (_number(f"{name}[{k}]", one, bounds) for k, one in enumerate(value))
    return first, second


def _simple(name: str, ring: tuple[tuple[float, float], ...]) -> tuple[tuple[float, float], ...]:
    """Return the corners of a polygon; InputError if it has no area, or edges meet outside of a corner."""
    a = np.array(ring)
    b, c = np.roll(a, -1, axis=0), np.roll(a, -2, axis=0)
    expected = "corners in order around an area, each once"
    if (a == b).all(axis=1).any():
        raise InputError(f"{name} with a corner twice", expected)
    back = (_cross(b - a, c - b) == 0.0) & (np.sum((b - a) * (c - b), axis=1) < 0.0)
    first, second = np.triu_indices(len(a), 2)
    apart = (first > 0) | (second < len(a) - 1)  # the first edge and the last one share a corner
    i, j = first[apart], second[apart]
    low, high = np.minimum(a, b), np.maximum(a, b)
    near = ((low[i] <= high[j]) & (low[j] <= high[i])).all(axis=1)
    i, j = i[near], j[near]
    sides = [np.sign(_cross(b[p] - a[p], one[q] - a[p])) for p, q in ((i, j), (j, i)) for one in (a, b)]
    crossing = (sides[0] * sides[1] <= 0.0) & (sides[2] * sides[3] <= 0.0)
    if back.any() or crossing.any() or _cross(a - a[0], b - a[0]).sum() == 0.0:
        raise InputError(f"{name} that intersects itself, or has no area", expected)
    return ring


def _cross(a: FloatArray, b: FloatArray) -> FloatArray:
    return np.asarray(a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0])


@dataclass(frozen=True)
class SimulatedSensor(_Described):
    """Keys of a sensor that only ``graphtrack simulate --sensors`` reads: table ``simulation`` of a sensor.

    Attributes
    ----------
    hz : scans a second
    phase : s, time of the first scan after the beginning
    ray_std, across_std : m, 1-σ of positions along and across the ray from ``at``, in place of
        ``position_std``
    declares : rows have their noise: ``pos_std``, or for an ellipse the covariance, and concentrations
    body_kappa, head_kappa : von Mises concentration of observed angles; None: not observed
    occlusion_radius : m, a person hides who is farther away and whose ray from ``at`` passes so close;
        0: nobody hides anybody
    lost_after : s without a detection after which the sensor's own tracker begins another identity
    switch_probability : probability that the own identities of two people are swapped when they meet
    meeting_distance : m, distance of people who meet
    way : "circle": a moving sensor drives in a circle
    centre, radius, turn_rate : m, m and rad/s of the circle; with a radius of 0 it turns on the spot
    path : file with the way of a moving sensor in the world: t, x, y, yaw_deg and perhaps sensor
    pose_hz : observed poses a second; None: ``hz``
    pose_std : m, 1-σ of each axis of observed poses
    pose_yaw_std : rad, 1-σ of their yaw
    """

    hz: float = _key("number", 1e-3, 1e4, default=10.0)
    phase: float = _key("number", 0.0, 1e6, default=0.0)
    ray_std: float | None = _key("number", *_STD)
    across_std: float | None = _key("number", *_STD)
    declares: bool = _key("flag", default=True)
    body_kappa: float | None = _key("number", 0.0, LARGEST_CONCENTRATION)
    head_kappa: float | None = _key("number", 0.0, LARGEST_CONCENTRATION)
    occlusion_radius: float = _key("number", 0.0, 10.0, default=0.3)
    lost_after: float = _key("number", 0.0, 1e6, default=1.0)
    switch_probability: float = _key("number", 0.0, 1.0, default=0.0)
    meeting_distance: float = _key("number", 0.0, 100.0, default=0.5)
    way: Literal["circle"] | None = _key("text")
    centre: tuple[float, float] = _key("pair", default=(0.0, 0.0))
    radius: float = _key("number", 0.0, 1e6, default=0.0)
    turn_rate: float = _key("number", -3600.0, 3600.0, degrees=True, default=0.0)
    path: str | None = _key("text")
    pose_hz: float | None = _key("number", 1e-3, 1e4)
    pose_std: float = _key("number", 0.0, 100.0, default=0.0)
    pose_yaw_std: float = _key("number", 0.0, 180.0, degrees=True, default=0.0)

    def __post_init__(self) -> None:
        super().__post_init__()
        if (self.ray_std is None) != (self.across_std is None):
            raise InputError("one of ray_std and across_std", "both or none")
        if self.way not in (None, "circle"):
            raise InputError(f"way = {self.way!r}"[:80], "circle")
        if self.way is not None and self.path is not None:
            raise InputError("way and path", "one of them")

    @property
    def has_way(self) -> bool:
        """Return whether the way of a moving sensor is known."""
        return self.way is not None or self.path is not None


@dataclass(frozen=True)
class Sensor(_Described):
    """Description of a sensor; None is unknown.

    The errors are those of its rows: a row is pivot + R(rotation)·(true − pivot) + shift. A sensor that moves
    has rows, errors and field of view in its own frame.

    Attributes
    ----------
    position_std : m, 1-σ of each axis of positions that declare none
    position_scale : their 1-σ as a multiple of what they declare
    shift : m, x and y
    rotation, pivot : rad about a point in metres
    angle_bias : rad by which angles of bodies and heads are larger, in addition to the rotation
    clock_offset : s by which times are later than the true ones
    detection_probability : of a person in view, in a scan
    false_density : false detections a scan and m²
    field_of_view : polygon of (x, y) in metres; None with neither range nor sector: it sees everywhere
    range, sector, at, heading : m, (from, to) in rad, (x, y) in metres and rad: it sees people within a
        distance of ``at``, in directions from ``heading`` + from counter-clockwise to ``heading`` + to
    moves : whether the sensor's frame moves; where it is comes from elsewhere
    shift_std, rotation_std, angle_bias_std, clock_offset_std : 1-σ of learned errors; of x and y in metres,
        rad, rad and s
    simulation : keys that only simulation reads
    """

    position_std: float | None = _key("number", *_STD)
    position_scale: float | None = _key("number", 1e-3, 1e3)
    shift: tuple[float, float] | None = _key("pair")
    rotation: float | None = _key("number", -180.0, 180.0, degrees=True)
    pivot: tuple[float, float] = _key("pair", default=(0.0, 0.0))
    angle_bias: float | None = _key("number", -180.0, 180.0, degrees=True)
    clock_offset: float | None = _key("number", -1e9, 1e9)
    detection_probability: float | None = _key("number", 0.0, 1.0)
    false_density: float | None = _key("number", 0.0, 100.0)
    field_of_view: tuple[tuple[float, float], ...] | None = _key("polygon")
    range: float | None = _key("number", 1e-3, 1e6)
    sector: tuple[float, float] | None = _key("pair", -360.0, 360.0, degrees=True)
    at: tuple[float, float] | None = _key("pair")
    heading: float | None = _key("number", -360.0, 360.0, degrees=True)
    moves: bool = _key("flag", default=False)
    shift_std: tuple[float, float] | None = _key("pair", 0.0)
    rotation_std: float | None = _key("number", 0.0, 180.0, degrees=True)
    angle_bias_std: float | None = _key("number", 0.0, 180.0, degrees=True)
    clock_offset_std: float | None = _key("number", 0.0, 1e9)
    simulation: SimulatedSensor | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.simulation is not None and not isinstance(self.simulation, SimulatedSensor):
            raise InputError(f"simulation = {self.simulation!r}"[:80], "a SimulatedSensor")
        if self.simulation is not None and self.simulation.has_way and not self.moves:
            raise InputError("way or path of a sensor that does not move", "moves = true")
        has_sector = self.range is not None or self.sector is not None
        if has_sector and self.field_of_view is not None:
            raise InputError("field_of_view with range or sector", "a polygon, or range and sector")
        if has_sector and self.eye is None:
            raise InputError("range or sector without at", "at = [x, y], the point that they are seen from")
        if self.heading is not None and self.sector is None:
            raise InputError("heading without sector", "sector_deg = [from, to] about it")
        if self.sector is not None and not 0.0 < self.sector[1] - self.sector[0] <= math.tau * (1 + 1e-12):
            found = f"sector_deg = [{', '.join(f'{math.degrees(one):g}' for one in self.sector)}]"
            raise InputError(found, "[from, to], counter-clockwise, 360 degrees at most")

    @property
    def eye(self) -> tuple[float, float] | None:
        """Return the point (x, y) that it sees from; of one that moves by default its frame's origin."""
        return (0.0, 0.0) if self.at is None and self.moves else self.at


Sensors: TypeAlias = Mapping[str, Sensor]
"""Name of a sensor → its description."""

NO_SENSORS: Sensors = MappingProxyType({})


def digest_of(sensors: Sensors) -> str:
    """Return text that is the same for equal descriptions, without keys for simulation alone; "" for none."""
    tables = {name: replace(one, simulation=None).to_table() for name, one in sensors.items()}
    return sha256(json.dumps(tables, sort_keys=True).encode()).hexdigest()[:16] if tables else ""


def sees(sensor: Sensor, points: FloatArray, pose: FloatArray | None = None) -> BoolArray:
    """Return a mask (n,) of the points in a field of view; False where NaN.

    Parameters
    ----------
    points : (n, 2) metres, in the frame of the field of view or, with a pose, in the world
    pose : (3,) or for each point (n, 3), x and y in metres and yaw in rad of the sensor's frame
    """
    points = np.asarray(points, dtype=float)
    if pose is not None:
        points = into_frame(points, np.asarray(pose, dtype=float))
    found = np.asarray(np.isfinite(points).all(axis=1))
    if sensor.field_of_view is not None:
        found[found] = _inside(np.array(sensor.field_of_view), points[found])
    if sensor.eye is not None:
        away = points - np.array(sensor.eye)
        if sensor.range is not None:
            found &= np.hypot(away[:, 0], away[:, 1]) <= sensor.range
        if sensor.sector is not None:
            begin, end = sensor.sector
            bearing = direction(away) - (sensor.heading or 0.0) - begin
            found &= np.mod(bearing, math.tau) <= end - begin
    return found


def outline_of(sensor: Sensor, observed: FloatArray) -> FloatArray | None:
    """Return the outline (k, 2) of a described field of view; None if it is not described.

    A sector without a range reaches as far as the positions (n, 2) that were observed.
    """
    if sensor.field_of_view is not None:
        return np.array(sensor.field_of_view)
    if sensor.eye is None or (sensor.range is None and sensor.sector is None):
        return None
    eye = np.array(sensor.eye)
    reach = sensor.range
    if reach is None:
        reach = float(np.linalg.norm(observed - eye, axis=1).max(initial=1.0))
    begin, end = (0.0, math.tau) if sensor.sector is None else sensor.sector
    arc = eye + reach * unit(np.linspace(begin, end, _ARC) + (sensor.heading or 0.0))
    return arc if sensor.sector is None else np.vstack([eye, arc])


def into_frame(points: FloatArray, pose: FloatArray) -> FloatArray:
    """Return points (..., 2) of the world in the frames of poses (..., 3): x, y, yaw."""
    return rotated(points - pose[..., :2], -pose[..., 2])


def _inside(ring: FloatArray, points: FloatArray) -> BoolArray:
    """Return whether points (n, 2) lie in a polygon (k, 2): the parity of its edges to their right."""
    x, y = points.T
    found = np.zeros(len(points), bool)
    for (ax, ay), (bx, by) in zip(ring, np.roll(ring, -1, axis=0), strict=True):
        if ay == by:
            continue
        between = (ay <= y) != (by <= y)
        found ^= between & (x < ax + (y - ay) * ((bx - ax) / (by - ay)))
    return found


def corrected(rows: Rows, sensors: Sensors) -> Rows:
    """Return rows without the known errors of their sensors, in the same order.

    Positions, velocities, their covariances, angles, class likelihoods and times are corrected; noise is
    declared as ``position_scale`` and ``position_std`` say. The truth and inputs are unchanged. Pixels of
    positions that were moved are left out, since they would contradict them.
    """
    return _changed(rows, sensors, distort=False)


def distorted(rows: Rows, sensors: Sensors) -> Rows:
    """Return rows with the errors of their sensors, the inverse of `corrected`.

    Two things have no inverse: ``position_std``, which is declared where nothing was, and class likelihoods
    that were interpolated.
    """
    return _changed(rows, sensors, distort=True)


MOVED_PIXELS = "pixels of rows whose positions were corrected for their sensor are not used"


def _changed(rows: Rows, sensors: Sensors, *, distort: bool) -> Rows:
    names = np.full(len(rows), "") if rows.sensor is None else rows.sensor
    channels, notes = dict(rows.channels), rows.notes
    for name, sensor in sensors.items():
        here = np.flatnonzero(names == name)
        if not len(here):
            continue
        own = {channel: values[here] for channel, values in rows.channels.items()}
        for channel, values in changed_channels(own, sensor, distort=distort).items():
            before = channels.get(channel)
            after = np.full((len(rows), *values.shape[1:]), np.nan) if before is None else before.copy()
            after[here] = values
            channels[channel] = after
            if channel == "pixel" and MOVED_PIXELS not in notes:
                notes = (*notes, MOVED_PIXELS)
    return replace(rows, channels=channels, notes=notes)


def changed_channels(
    own: Mapping[str, FloatArray], sensor: Sensor, *, distort: bool = False
) -> dict[str, FloatArray]:
    """Return the channels of a sensor's rows that change when its errors are removed, or added.

    Parameters
    ----------
    own : channels (n, …) of the rows, with their times ``t``
    sensor : description of the sensor
    distort : the errors are added
    """
    sign = 1.0 if distort else -1.0
    rotation = sign * (sensor.rotation or 0.0)
    turn = rotation + sign * (sensor.angle_bias or 0.0)
    shift = np.array(sensor.shift or (0.0, 0.0))
    found: dict[str, FloatArray] = {}

    def change(names: Sequence[str], function: Callable[[FloatArray], FloatArray]) -> None:
        found.update({name: function(found.get(name, own[name])) for name in names if name in own})

    if rotation or shift.any():
        pivot = np.array(sensor.pivot)
        before, after = (pivot, pivot + shift) if distort else (pivot + shift, pivot)
        change(["position"], lambda values: after + rotated(values - before, rotation))
        change(["pixel"], lambda values: np.full_like(values, np.nan))
    if rotation:
        change(["observed_velocity", "velocity"], lambda values: rotated(values, rotation))
        covariances = ["position_covariance", "observed_velocity_covariance"]
        change(covariances, lambda values: _turned_covariance(values, rotation))
        change(["covariance"], lambda values: _turned_deviations(values, rotation))
    if turn:
        change(["body", "head", "body_axis"], lambda values: wrap(values + turn))
        change(["body_likelihood", "head_likelihood"], lambda values: rotated_classes(values, turn))
    if sensor.clock_offset:
        offset = sign * sensor.clock_offset
        change(["t"], lambda values: values + offset)
    if sensor.position_scale is not None:
        scale = sensor.position_scale**-sign
        of_state = np.array([scale, scale, 1.0, 1.0, 1.0, 1.0])
        change(["position_std"], lambda values: scale * values)
        change(["position_covariance"], lambda values: scale**2 * values)
        change(["covariance"], lambda values: np.outer(of_state, of_state) * values)
    if sensor.position_std is not None and "position" in own and not distort:
        missing = np.full(len(own["position"]), np.nan)
        declared = [own[name].reshape(len(missing), -1)[:, 0] for name in _DECLARED if name in own]
        undeclared = np.isnan([missing, *declared]).all(axis=0)
        given = found.get("position_std", own.get("position_std", missing))
        found["position_std"] = np.where(undeclared, sensor.position_std, given)
    return found


_DECLARED = ("position_std", "position_covariance", "covariance")
"""Channels whose first number is missing where they declare no noise of a position."""


def _turned_covariance(covariance: FloatArray, angle: float) -> FloatArray:
    """Return covariances (n, 2, 2) of turned vectors."""
    matrix = rotated(np.eye(2), -angle)  # its rows are the turned axes' coordinates
    found = np.einsum("ij,njk,lk->nil", matrix, covariance, matrix)
    return np.asarray(0.5 * (found + np.swapaxes(found, 1, 2)))


def _turned_deviations(covariance: FloatArray, angle: float) -> FloatArray:
    """Return covariances (n, 6, 6) of which tables have the deviations alone, of turned positions and motion.

    Their correlations are unknown, and taken for 0.
    """
    found = covariance.copy()
    cos, sin = math.cos(angle) ** 2, math.sin(angle) ** 2
    for i, j in ((0, 1), (2, 3)):
        found[:, i, i] = cos * covariance[:, i, i] + sin * covariance[:, j, j]
        found[:, j, j] = sin * covariance[:, i, i] + cos * covariance[:, j, j]
    return found
