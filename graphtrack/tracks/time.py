"""Times: equality of seconds, their forms in tables (counts, ISO 8601 text, dates), and places on the earth.

Seconds of dates and of epochs count from the midnight (UTC) before the first, since a double that counts from
1970 has no digits left below a microsecond. Places need the package pyproj (extra ``geo``).
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray
from graphtrack.packages import package

TIME_TOLERANCE = 1e-5
"""Seconds by which equal times, and equal durations, may differ: doubles that count from 1970 are 2.4e-7 s
apart, and files round times to microseconds. Frames are further apart. Comparisons of times allow for it, so
that no result depends on where time begins."""


def distinct_times(t: FloatArray) -> tuple[FloatArray, NDArray[np.int64]]:
    """Return the distinct times (k,), ascending, and the index among them of each time (n,).

    Times within `TIME_TOLERANCE` of the one before are one time, of which the earliest is returned.
    """
    order = np.argsort(t, kind="stable")
    begins = np.diff(t[order], prepend=-np.inf) > TIME_TOLERANCE
    place = np.empty(len(t), np.int64)
    place[order] = np.cumsum(begins) - 1
    return t[order][begins], place


NANOSECONDS_IN = {"s": 10**9, "ms": 10**6, "us": 10**3, "ns": 1}
"""Unit of time → nanoseconds."""

UNIT_OF = {count: unit for unit, count in NANOSECONDS_IN.items()}
"""Nanoseconds → unit of time."""

DAY = 86_400 * 10**9
"""Nanoseconds."""
EPOCH = 1e8
"""Seconds above which a number counts from 1970: no recording takes three years."""

_ISO = re.compile(
    r"(\d{4}-\d{2}-\d{2})([T ])(\d{2}:\d{2}(?::\d{2})?)(?:[.,](\d{1,9}))?\s*(Z|[+-]\d{2}(?::?\d{2})?)?",
    re.ASCII,
)
_YEARS = range(1700, 2200)  # years within 64-bit nanoseconds from 1970


@dataclass(frozen=True)
class TimeScale:
    """Representation of times in a file.

    Attributes
    ----------
    kind : "number": counts of a unit; "text": ISO 8601; "date": values of a type for dates
    unit : nanoseconds of a count, or of the unit of a date's type
    integer : whether the counts are whole numbers, and are written as such
    origin : nanoseconds since 1970, or since the beginning of the file, at t = 0
    between, digits, zone : of text: separator of day and time, digits after the second, and suffix ("", "Z",
        or such as "+01:00"); of dates the name of the zone, "" where they have none
    """

    kind: Literal["number", "text", "date"]
    unit: int = 10**9
    integer: bool = False
    origin: int = 0
    between: str = "T"
    digits: int = 0
    zone: str = ""

    def restored(self, t: FloatArray) -> Any:
        """Return times (n,), given in seconds, in the representation of the file."""
        if self.kind == "number" and not self.integer:
            return (self.origin / 1e9 + t) * (1e9 / self.unit)
        since = self.origin + np.rint(t * 1e9).astype(np.int64)
        if self.kind == "text":
            return self._as_text(since)
        counts = (since + self.unit // 2) // self.unit
        if self.kind == "number":
            return counts
        dates = counts.astype(f"M8[{UNIT_OF[self.unit]}]")
        if not self.zone:
            return dates
        import pandas as pd

        return pd.DatetimeIndex(dates).tz_localize("UTC").tz_convert(self.zone)

    def _as_text(self, since: NDArray[np.int64]) -> NDArray[Any]:
        digit = 10 ** (9 - self.digits)
        since = (since + digit // 2) // digit * digit + _offset(self.zone)
        texts = np.datetime_as_string(since.astype("M8[ns]"))
        end = len("2000-01-01T00:00:00") + (self.digits + 1 if self.digits else 0)
        return np.array([text[:end].replace("T", self.between) + self.zone for text in texts], dtype=object)


def from_nanoseconds(since: NDArray[np.int64], reference: TimeScale | None) -> tuple[FloatArray, int]:
    """Return seconds (n,) of nanoseconds, and their origin in nanoseconds."""
    origin = reference.origin if reference is not None else int(since.min()) // DAY * DAY if len(since) else 0
    return (since - origin) / 1e9, origin


def from_numbers(
    values: NDArray[Any], unit: str, reference: TimeScale | None = None
) -> tuple[FloatArray, TimeScale]:
    """Return seconds (n,) of counts of a unit; those of an epoch from the midnight before the first.

    Parameters
    ----------
    values : (n,) int64 or float, NaN where there is none
    unit : one of `NANOSECONDS_IN`
    reference : time scale of a table with the same origin
    """
    each = NANOSECONDS_IN[unit]
    integer = values.dtype.kind in "iu"
    known = values if integer else values[np.isfinite(values)]
    epoch = bool(len(known)) and float(np.median(known)) * (each / 1e9) >= EPOCH
    if not epoch:
        # Filling a gap may need times between whole seconds.
        scale = TimeScale("number", each, integer and unit != "s")
        return (values.astype(float) if unit == "s" else values / (10**9 / each)), scale
    if integer:
        seconds, origin = from_nanoseconds(values.astype(np.int64) * each, reference)
    else:
        origin = (
            reference.origin if reference is not None else int(known.min() * (each / 1e9)) // 86_400 * DAY
        )
        # The difference of two doubles of one size is exact, unlike a product.
        seconds = (values - origin / each) * (each / 1e9)
    return seconds, TimeScale("number", each, integer, origin)


def from_dates(values: NDArray[Any], zone: str, reference: TimeScale | None) -> tuple[FloatArray, TimeScale]:
    """Return seconds (n,) of ``datetime64`` in UTC; NaN where one is missing."""
    unit = np.datetime_data(values.dtype)[0]
    empty = np.isnat(values)
    since = values.astype("M8[ns]").astype(np.int64)
    seconds, origin = from_nanoseconds(since[~empty], reference)
    found = np.full(len(values), np.nan)
    found[~empty] = seconds
    return found, TimeScale("date", NANOSECONDS_IN.get(unit, 1), origin=origin, zone=zone)


def date_texts(values: Any) -> NDArray[Any]:
    """Return dates as ISO 8601 text, for files without a type for them."""
    if isinstance(values, np.ndarray):
        return np.datetime_as_string(values).astype(object)
    return np.array([one.isoformat() for one in values], dtype=object)


def is_iso(text: str) -> bool:
    """Return whether a text is a date and a time of ISO 8601."""
    return _ISO.fullmatch(text.strip()) is not None


class NotIso(ValueError):
    """Error with the row (from 0) of a text that is not a time, and the expectation."""

    def __init__(self, row: int, expected: str) -> None:
        self.row, self.expected = row, expected
        super().__init__(row, expected)


def from_text(texts: list[str], reference: TimeScale | None) -> tuple[FloatArray, TimeScale]:
    """Return seconds (n,) of ISO 8601 texts, such as 2026-11-23T10:00:00.04+01:00; NaN for an empty text.

    Times without a zone are read as UTC.

    Raises
    ------
    NotIso
        For the first text that is not a time, or that differs from the first in having a zone.
    """
    since, known, digits = np.zeros(len(texts), np.int64), np.zeros(len(texts), bool), 0
    between, zone = "T", None
    days: list[str] = []
    parts: list[int] = []
    for row, text in enumerate(texts):
        if not text.strip():
            continue
        match = _ISO.fullmatch(text.strip())
        if match is None or int(match[1][:4]) not in _YEARS:
            raise NotIso(row, "a date and time as in 2026-11-23T10:00:00.04 (ISO 8601)")
        if zone is None:
            between, zone = match[2], match[5] or ""
        if bool(match[5]) != bool(zone):
            raise NotIso(row, f"a time {'with' if zone else 'without'} a zone, as the first one is")
        fraction = match[4] or ""
        digits = max(digits, len(fraction))
        days.append(f"{match[1]}T{match[3]}")
        parts.append(int(fraction.ljust(9, "0")) - _offset(match[5] or ""))
        known[row] = True
    try:
        integer = np.array(days, dtype="M8[ns]").astype(np.int64)
    except ValueError:
        row = int(np.flatnonzero(known)[next(i for i, day in enumerate(days) if not _is_day(day))])
        raise NotIso(row, "a date and time that exists") from None
    since[known] = integer + np.array(parts, dtype=np.int64)
    seconds, origin = from_nanoseconds(since[known], reference)
    found = np.full(len(texts), np.nan)
    found[known] = seconds
    return found, TimeScale("text", origin=origin, between=between, digits=digits, zone=zone or "")


def _is_day(text: str) -> bool:
    try:
        np.datetime64(text)
    except ValueError:
        return False
    return True


def _offset(zone: str) -> int:
    """Return the offset of a zone from UTC in nanoseconds."""
    if zone in ("", "Z"):
        return 0
    digits = zone[1:].replace(":", "").ljust(4, "0")
    return (-1 if zone[0] == "-" else 1) * (int(digits[:2]) * 60 + int(digits[2:])) * 60 * 10**9


def check_time_unit(unit: str) -> None:
    """Raise InputError for an unknown unit of time."""
    if unit != "iso" and unit not in NANOSECONDS_IN:
        raise InputError(f"time_unit = {unit!r}", f"one of {', '.join(NANOSECONDS_IN)}, iso")


WGS84 = "EPSG:4326"
_DIGITS = 2
"""Decimals of a plane's origin in degrees: files of one site share an origin."""


def check_crs(crs: str) -> None:
    """Raise InputError unless the text is a coordinate reference system of positions on the ground."""
    pyproj = package("pyproj", "geo")
    try:
        known = pyproj.CRS.from_user_input(crs)
    except pyproj.exceptions.CRSError as error:
        expected = "a coordinate reference system, such as EPSG:4326 or EPSG:25832"
        raise InputError(f"--crs {crs!r}", expected) from error
    if not (known.is_geographic or known.is_projected):
        kind = known.type_name
        raise InputError(f"--crs {crs!r}, a {kind}", "one of positions on the ground, such as EPSG:4326")


@dataclass(frozen=True)
class Plane:
    """Local tangent plane: x to the east, y to the north, metres (transverse Mercator).

    The projection preserves angles and, within 30 km of the origin, lengths to 1 in 10⁵.

    Attributes
    ----------
    crs : coordinate reference system of a file
    latitude, longitude : degrees, of the origin
    """

    crs: str
    latitude: float
    longitude: float

    @classmethod
    def around(cls, crs: str, first: FloatArray, second: FloatArray) -> Plane:
        """Return the plane centred on points (n,): easting or longitude, northing or latitude; NaN: none."""
        check_crs(crs)
        longitude, latitude = _transformer(crs, WGS84)(first, second)
        known = np.isfinite(longitude) & np.isfinite(latitude)
        if not known.any():
            raise InputError(f"no place within --crs {crs}", "coordinates of that system")
        return cls(crs, *(round(float(np.median(of[known])), _DIGITS) for of in (latitude, longitude)))

    def metres(self, first: FloatArray, second: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return x and y (n,) of points; NaN for missing points, infinite outside the crs."""
        return _transformer(self.crs, self.local)(first, second)

    def back(self, x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return easting and northing, or longitude and latitude, (n,) of points on the plane."""
        return _transformer(self.local, self.crs)(x, y)

    @property
    def local(self) -> str:
        """Coordinate reference system of the plane."""
        return (
            f"+proj=tmerc +lat_0={self.latitude} +lon_0={self.longitude} +k=1 +x_0=0 +y_0=0 +datum=WGS84 "
            "+units=m +no_defs"
        )


@lru_cache(16)
def _transformer(from_crs: str, to_crs: str) -> Any:
    transform = package("pyproj", "geo").Transformer.from_crs(from_crs, to_crs, always_xy=True).transform

    def converted(first: FloatArray, second: FloatArray) -> tuple[FloatArray, FloatArray]:
        first, second = np.array(first, dtype=float), np.array(second, dtype=float)
        empty = np.isnan(first) | np.isnan(second)
        found = transform(np.where(empty, 0.0, first), np.where(empty, 0.0, second))
        one, other = (np.where(empty, math.nan, values) for values in found)
        return one, other

    return converted
