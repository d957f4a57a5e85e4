"""Shapes and bounds of a track's arrays, checks of settings, and detection of implausible speeds."""

from __future__ import annotations

import math
import sys
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray

LARGEST_FRAME = 2**31 - 1
LARGEST_ID = 2**53 - 1
"""Largest magnitude up to which every whole number has a unique double."""
LARGEST_METRES = 1e8
"""Twice the earth's circumference, metres: a larger coordinate is a mistake."""
LARGEST_SECONDS = 1e11
LARGEST_PIXELS = 1e6
LARGEST_DEGREES = 1e6
LARGEST_CONCENTRATION = 1e9
LARGEST_LIKELIHOOD = 1e12

SMALLEST = math.ulp(0.0)
"""Smallest positive double."""


@dataclass(frozen=True)
class Bounds:
    """Closed interval from ``low`` to ``high``."""

    low: float
    high: float

    @property
    def expected(self) -> str:
        """Description of the allowed numbers."""
        if math.isclose(-self.low, self.high):
            return f"a number within ±{self.high:g}"
        return f"a number {'above 0' if self.low == SMALLEST else f'from {self.low:g}'} to {self.high:g}"

    def first_outside(self, values: NDArray[Any]) -> tuple[int, ...] | None:
        """Return the index of the first value out of bounds, or None; NaN, a missing value, is allowed."""
        # Two reductions without a copy: this is called for every channel of every track.
        if not values.size:
            return None
        low, high = np.fmin.reduce(values, axis=None), np.fmax.reduce(values, axis=None)
        if not (low < self.low or high > self.high):
            return None
        place = np.argmax((values < self.low) | (values > self.high))
        return tuple(int(i) for i in np.unravel_index(place, values.shape))


def within(largest: float) -> Bounds:
    """Bounds of numbers of either sign."""
    return Bounds(-largest, largest)


METRES, PIXELS = within(LARGEST_METRES), within(LARGEST_PIXELS)
RADIANS = within(math.radians(LARGEST_DEGREES))
CONCENTRATION, LIKELIHOOD = Bounds(0.0, LARGEST_CONCENTRATION), Bounds(0.0, LARGEST_LIKELIHOOD)
FINITE = within(sys.float_info.max)

FIELDS: Mapping[str, Bounds] = {
    "t": within(LARGEST_SECONDS),
    "position": METRES,
    "position_std": Bounds(SMALLEST, LARGEST_METRES),
    "position_covariance": within(LARGEST_METRES**2),
    "pixel": PIXELS,
    "observed_velocity": METRES,
    "observed_velocity_covariance": within(LARGEST_METRES**2),
    "body": RADIANS,
    "body_kappa": CONCENTRATION,
    "body_axis": RADIANS,
    "body_axis_kappa": CONCENTRATION,
    "head": RADIANS,
    "head_kappa": CONCENTRATION,
    "body_likelihood": LIKELIHOOD,
    "head_likelihood": LIKELIHOOD,
    "score": LIKELIHOOD,
    "velocity": METRES,
    "covariance": FINITE,
    "identity_p": Bounds(0.0, 1.0),
    "observed": Bounds(0.0, 1.0),
    "true_position": METRES,
    "true_body": RADIANS,
    "true_head": RADIANS,
}
"""Bounds of a `Track`'s attributes, in its units; attributes that only engines set must be finite."""

STATE = ("x", "y", "vx", "vy", "body", "head")
"""Order of the state in ``Track.covariance``."""

BODY_CLASSES, HEAD_CLASSES = 8, 12

SHAPES: Mapping[str, tuple[int, ...]] = dict.fromkeys(FIELDS, ()) | {
    "position": (2,),
    "position_covariance": (2, 2),
    "pixel": (2,),
    "observed_velocity": (2,),
    "observed_velocity_covariance": (2, 2),
    "body_likelihood": (BODY_CLASSES,),
    "head_likelihood": (HEAD_CLASSES,),
    "velocity": (2,),
    "covariance": (len(STATE), len(STATE)),
    "true_position": (2,),
}
"""Shape of each attribute of a `Track` in one frame."""


INPUT = "input_"
"""Prefix of channels and columns that are inputs of a track."""

APPEARANCE = "appearance"
"""Name of the input with the appearance descriptor, of any size; its columns have no prefix."""


def bounds_of(name: str) -> Bounds:
    """Return the bounds of a `Track`'s attribute or input, in its units."""
    return FINITE if name.startswith(INPUT) else FIELDS[name]


def out_of_bounds(name: str, value: float, frame: int, person: str, **place: Any) -> InputError:
    """Return the error for a value of an attribute in one frame; ``place`` is its position in a file."""
    found = f"{name} = {value:g} in frame {frame} of {person}"
    return InputError(found, f"{bounds_of(name).expected}, or NaN where it is missing", **place)


def check_positive(name: str, value: float | None, highest: float) -> None:
    """Raise InputError unless a setting is a number above 0, ``highest`` at most, or None."""
    if value is not None and not (is_number(value) and np.isfinite(value) and 0.0 < value <= highest):
        raise InputError(f"{name} = {value!r}", f"a positive number up to {highest:g}")


def check_integer(name: str, value: Any, lowest: int, highest: int) -> None:
    """Raise InputError unless a setting is a whole number from ``lowest`` to ``highest``."""
    is_integer = isinstance(value, int | np.integer) and not isinstance(value, bool)
    if not (is_integer and lowest <= value <= highest):
        raise InputError(f"{name} = {value!r}", f"a whole number from {lowest} to {highest}")


def check_within(low: float, high: float, **values: float | None) -> None:
    """Raise InputError for a setting that is neither a number from ``low`` to ``high`` nor None."""
    for name, value in values.items():
        if value is not None and not (is_number(value) and low <= value <= high):
            raise InputError(f"{name} = {value!r}", Bounds(low, high).expected)


def finite_rows(values: FloatArray) -> NDArray[np.bool_]:
    """Return (n,) True for rows of values (n, ...) that are entirely finite."""
    known = np.isfinite(values)
    return np.asarray(known if known.ndim == 1 else known.reshape(len(known), -1).all(axis=1), dtype=bool)


def is_number(value: object) -> bool:
    """Return whether a setting is a real number that a double can hold, and not text or a boolean."""
    if isinstance(value, bool) or not isinstance(value, int | float | np.integer | np.floating):
        return False
    try:
        float(value)
    except OverflowError:
        return False
    return True


def check_count(name: str, value: object) -> None:
    """Raise InputError unless a setting is a whole number, 1 at least."""
    if isinstance(value, bool) or not isinstance(value, int | np.integer) or value < 1:
        raise InputError(f"{name} = {value!r}", "a whole number, at least 1")


def real_numbers(given: Any) -> NDArray[np.float64]:
    """Return a copy as an array of doubles; masked values are NaN.

    NumPy would drop masks and imaginary parts, and convert dates and durations to counts of their unit.

    Raises
    ------
    TypeError, ValueError
        For values other than real numbers.
    """
    value = np.asarray(given)
    if np.iscomplexobj(value):
        raise TypeError("complex numbers; expected real numbers")
    if value.dtype.kind in "mM":
        raise TypeError("dates or durations; expected seconds, such as (t - t[0]) / np.timedelta64(1, 's')")
    try:
        numbers = np.array(value, dtype=float)
    except OverflowError as error:
        raise ValueError(str(error)) from None
    if isinstance(given, np.ma.MaskedArray):
        numbers[np.ma.getmaskarray(given)] = np.nan
    return numbers


SENSOR_NAME = "up to 100 characters of text on one line"
"""Names of sensors, as messages expect them."""


def is_sensor_name(value: object) -> bool:
    """Return whether a value may be the name of a sensor; "" is that of rows without one."""
    short = isinstance(value, str) and len(value) <= 100 and len(value.splitlines()) <= 1
    return short and is_text(value)


TEXT = "text in Unicode characters (no half of a surrogate pair)"
"""Labels and identities, as messages expect them."""


def is_text(value: object) -> bool:
    """Return whether a value is text that UTF-8 can encode, without half a surrogate pair."""
    if not isinstance(value, str):
        return False
    try:
        value.encode()
    except UnicodeEncodeError:
        return False
    return True


def parse_number(text: str) -> float | None:
    """Parse a finite decimal number, or return None; unlike ``float`` no ``nan``, ``inf`` or ``1_000``."""
    if "_" in text or not text.isascii():
        return None
    try:
        value = float(text)
    except ValueError:
        return None
    return value if math.isfinite(value) else None


def expected_number(text: str) -> str:
    """Return a description of the expected number where `parse_number` finds none."""
    decimal_comma = parse_number(text.replace(",", ".")) is not None
    return "a finite number with a decimal point" if decimal_comma else "a finite number"


def check_frame_rate(fps: float | None) -> None:
    """Raise InputError unless frames a second are a number above 0, or None."""
    check_positive("fps", fps, 1e6)


def number(default: float, low: float, high: float, unit: str = "") -> Any:
    """Return a field of a dataclass of parameters: a number from ``low`` to ``high``; see `check_numbers`."""
    return field(default=default, metadata={"range": (low, high), "unit": unit})


def check_numbers(parameters: Any) -> None:
    """Raise InputError unless the fields of a dataclass that `number` made are in their ranges."""
    for one in fields(parameters):
        if "range" not in one.metadata:
            continue
        value, (low, high) = getattr(parameters, one.name), one.metadata["range"]
        if isinstance(value, bool) or not isinstance(value, int | float) or not low <= value <= high:
            expected = f"a number in [{low:g}, {high:g}] {one.metadata['unit']}".rstrip()
            raise InputError(f"{one.name} = {value!r}", expected)


Parameters = TypeVar("Parameters")


def with_clipped(parameters: Parameters, values: Mapping[str, float]) -> Parameters:
    """Return a dataclass of parameters with some values, each clipped to the parameter's range."""
    ranges = {one.name: one.metadata["range"] for one in fields(parameters)}  # type: ignore[arg-type]
    clipped = {name: float(np.clip(value, *ranges[name])) for name, value in values.items()}
    return replace(parameters, **clipped)  # type: ignore[type-var]


def with_table(parameters: Parameters, table: str, values: Any) -> Parameters:
    """Return a dataclass of parameters updated by the values of a file's table."""
    if not isinstance(values, Mapping):
        raise InputError(f"{table} = {values!r}", f"a table [{table}]")
    names = [one.name for one in fields(parameters)]  # type: ignore[arg-type]
    for name in values:
        if name not in names:
            raise InputError(f"key {table}.{name}", f"one of {', '.join(names)}")
    try:
        return replace(parameters, **values)  # type: ignore[type-var]
    except InputError as error:
        raise InputError(f"{table}.{error.found}", error.expected) from error


FASTEST = 12.0
"""Metres a second, the speed above which units are suspected."""

_SPAN = 1.0  # seconds over which speeds are computed: between frames they are mostly noise

_SHARE = 0.1
"""Least share of positions in fast tracks for a note: a few have other causes than wrong units."""


@dataclass(frozen=True)
class Speeds:
    """Speeds of tracks.

    Attributes
    ----------
    n_tracks, n_positions : of all tracks with a speed
    fast : median speed (m/s) of each track that is faster than `FASTEST`
    n_fast : number of positions of those tracks
    """

    n_tracks: int = 0
    n_positions: int = 0
    fast: tuple[float, ...] = ()
    n_fast: int = 0

    @classmethod
    def of(cls, tracks: Iterable[tuple[FloatArray, FloatArray]]) -> Speeds:
        """Return the speeds of tracks from their times (n,) and positions (n, 2)."""
        found = [(speed, n) for speed, n in (median_speed(*one) for one in tracks) if n]
        fast = [(speed, n) for speed, n in found if speed > FASTEST]
        return cls(
            len(found), sum(n for _, n in found), tuple(speed for speed, _ in fast), sum(n for _, n in fast)
        )

    def __add__(self, other: Speeds) -> Speeds:
        return Speeds(
            self.n_tracks + other.n_tracks,
            self.n_positions + other.n_positions,
            self.fast + other.fast,
            self.n_fast + other.n_fast,
        )

    @property
    def note(self) -> str | None:
        """Return a note on implausible speeds; None where there are none."""
        if self.n_fast <= _SHARE * self.n_positions:
            return None
        usual, greatest = _median(np.array(self.fast)), max(self.fast)
        n = len(self.fast)
        return (
            f"{n} of {self.n_tracks} tracks move faster than {FASTEST:g} m/s (median {usual:.3g}, "
            f"greatest {greatest:.3g}): check the unit of the positions (metres, or units), "
            "the frame rate (fps), and for pixels the homography or metres_per_pixel"
        )


def median_speed(t: FloatArray, position: FloatArray) -> tuple[float, int]:
    """Return the median speed (m/s) over about 1 s, and the number of positions; 0, 0 for fewer than two."""
    later = np.diff(t, prepend=-np.inf) > 0.0  # rows of several sensors may have one time
    has_position = np.isfinite(position).all(axis=1) & later
    position, t = position[has_position], t[has_position]
    if len(t) < 2:
        return 0.0, 0
    apart = max(1, round(min(_SPAN / _median(t[1:] - t[:-1]), len(t) - 1.0)))
    moved = np.hypot(*(position[apart:] - position[:-apart]).T)
    with np.errstate(over="ignore"):
        return _median(moved / (t[apart:] - t[:-apart])), len(t)


def _median(values: FloatArray) -> float:
    """Return the upper median; for thousands of short tracks ``np.median`` takes as long as reading."""
    return float(np.partition(values, len(values) // 2)[len(values) // 2])
