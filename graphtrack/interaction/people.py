"""People of a scene, frame by frame, and the places on the ground that they may look at."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar, TypeAlias

import numpy as np
from numpy.typing import NDArray

from graphtrack.constant_velocity import white_noise_acceleration
from graphtrack.errors import InputError
from graphtrack.geometry.angles import (
    BoolArray,
    FloatArray,
    difference,
    direction,
    mean_resultant_length,
    unit,
)
from graphtrack.interaction.gaze_model import half_angles
from graphtrack.io.source import Source
from graphtrack.io.text import csv_records, expected_number, parse_number
from graphtrack.saved import Saved
from graphtrack.tracks.time import TIME_TOLERANCE
from graphtrack.tracks.track import STATE, Track
from graphtrack.tracks.validation import LARGEST_METRES

if TYPE_CHECKING:
    from graphtrack.association.tracker import PersonEstimate
    from graphtrack.inference.state import Estimate


IntArray = NDArray[np.int64]

_SLOPE_SECONDS = 0.5
"""Half width in seconds of the differences for missing velocities, if frames are closer."""
HELD = 4.0
"""Seconds for which a person without an observation counts where predicted."""
_ACCELERATION = 0.5  # m²/s³, spectral density of the acceleration of a person without an observation


@dataclass(frozen=True, eq=False)
class People:
    """Person-frames with a position, sorted by frame and by identity within it.

    Body and head are expected unit vectors: shorter for uncertain directions; 0 if unknown.
    """

    ids: IntArray  # (p,) identities, ascending
    frame: IntArray  # (k,) frames with people, ascending
    t: FloatArray  # (k,) seconds
    first: IntArray  # (k + 1,) first row of each frame
    person: IntArray  # (n,) index in ``ids``
    position: FloatArray  # (n, 2) metres
    velocity: FloatArray  # (n, 2) m/s; 0 if unknown
    body: FloatArray  # (n, 2)
    head: FloatArray  # (n, 2)
    age: FloatArray  # (n,) seconds from the nearest observation, where predicted; 0 where observed

    def __len__(self) -> int:
        return len(self.person)

    @property
    def frame_of(self) -> IntArray:
        """(n,) index in ``frame`` of each row."""
        return np.repeat(np.arange(len(self.frame)), np.diff(self.first))

    @property
    def values(self) -> FloatArray:
        """(n, 8) position, velocity, body and head of each row."""
        return np.hstack([self.position, self.velocity, self.body, self.head])

    def frames(self) -> Iterator[People]:
        """Return the people of each frame separately."""
        for k, (begin, end) in enumerate(pairwise(self.first.tolist())):
            here, count = slice(begin, end), end - begin
            yield People(
                self.ids[self.person[here]],
                self.frame[k : k + 1],
                self.t[k : k + 1],
                np.array([0, count]),
                np.arange(count),
                *(values[here] for values in (self.position, self.velocity, self.body, self.head, self.age)),
            )


_ANGLES = [f"{name}_{part}" for name in ("body", "head") for part in ("deg", "kappa", "std_deg")]

USED = ("t", "x", "y", "vx", "vy", *_ANGLES)
"""Columns of people that groups are found from."""


def people_of(tracks: Iterable[Track], *, online: bool = False) -> People:
    """Return the people of a scene with known positions.

    Estimates are weighted by their covariance, observed angles by their concentration; angles with neither
    are exact. Rows without an angle take those of the neighbouring rows, less certain by the time between.
    With ``online``, missing velocities and angles are computed from the past. Raise InputError for rows of
    several sensors, whose people are at times of their own.
    """
    chosen = sorted(tracks, key=lambda track: track.track_id)
    parts = [known_rows(track, online) for track in chosen]
    ids = np.array([track.track_id for track in chosen], dtype=np.int64)
    person = np.repeat(np.arange(len(chosen)), [len(part[0]) for part in parts])
    joined = [np.concatenate(columns) for columns in zip(*parts, strict=True)] if parts else _nobody()
    order = np.lexsort((person, joined[0]))
    frames, t, position, velocity, body, head = (column[order] for column in joined)
    frame, first = np.unique(frames, return_index=True)
    bounds, age = np.append(first, len(frames)), np.zeros(len(frames))
    if any(track.sensor is not None for track in chosen):
        _check_common_times(person[order], frames, t)
    return People(ids, frame, t[first], bounds, person[order], position, velocity, body, head, age)


def _check_common_times(person: IntArray, frames: IntArray, t: FloatArray) -> None:
    """Raise InputError unless a frame of sorted rows (n,) is one time, with each person once."""
    same = np.diff(frames) == 0
    if (same & ((np.abs(np.diff(t)) > TIME_TOLERANCE) | (np.diff(person) == 0))).any():
        found = "rows of several sensors, each with frames of its own"
        raise InputError(found, "people at common times: estimates of graphtrack smooth --resample")


def _nobody() -> list[np.ndarray]:
    return [np.empty(0, dtype=np.int64), np.empty(0), *(np.empty((0, 2)) for _ in range(4))]


def known_rows(track: Track, online: bool) -> tuple[np.ndarray, ...]:
    """Return frame, time, position, velocity, body and head, as in `People`, where the position is known."""
    known: BoolArray = np.asarray(np.isfinite(track.position).all(axis=1))
    velocity = _velocity(track, known, online) if track.velocity is None else track.velocity[known]
    return (
        track.frame[known],
        track.t[known],
        track.position[known],
        np.nan_to_num(velocity),
        *(
            _without_gaps(track.t[known], expected_direction(track, name)[known], online)
            for name in ("body", "head")
        ),
    )


def _without_gaps(t: FloatArray, vector: FloatArray, online: bool) -> FloatArray:
    """Return unit vectors (n, 2) with those of the neighbouring rows where they are 0."""
    known = vector.any(axis=1)
    if known.all() or not known.any():
        return vector
    found, since, until = interpolated(t[known], vector[known], t, online=online)
    return found * presence(np.minimum(since, until))[:, None]


def is_held(age: FloatArray) -> BoolArray:
    """Return True where people are predicted from an observation of an age (n,), seconds."""
    return np.asarray(age < HELD - TIME_TOLERANCE)


def presence(age: FloatArray) -> FloatArray:
    """Return the share (n,), 1 to 0 at `HELD`, by which predictions from observations of an age (s) count."""
    return np.asarray(np.clip(1.0 - age / HELD, 0.0, 1.0))


def interpolated(
    known: FloatArray, values: FloatArray, t: FloatArray, *, online: bool
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return values (m, k) at times t (m,), and the seconds (m,) since the row before and until the next.

    Linear between two rows, else those of the only neighbour; infinite seconds without a row, and with
    ``online`` until the next.

    ``known``, ``values``: (n,) seconds, ascending, and (n, k) of the rows, at least one
    """
    last = len(known) - 1
    # Times of one frame may differ by rounding.
    after = np.minimum(np.searchsorted(known, t), last)
    for near in (known[np.maximum(after - 1, 0)], known[after]):
        t = np.where(np.abs(near - t) <= TIME_TOLERANCE, near, t)
    before, after = np.searchsorted(known, t, side="right") - 1, np.searchsorted(known, t)
    since = np.where(before >= 0, t - known[np.maximum(before, 0)], np.inf)
    until = np.where((after <= last) & (not online), known[np.minimum(after, last)] - t, np.inf)
    apart = np.where(np.isfinite(since), np.maximum(since + until, 1e-300), 1.0)
    share = np.where(np.isfinite(since), since / apart, 1.0)[:, None]
    found = (1.0 - share) * values[np.maximum(before, 0)] + share * values[np.minimum(after, last)]
    return found, since, until


def predicted(
    known: FloatArray, values: FloatArray, t: FloatArray, *, online: bool
) -> tuple[FloatArray, FloatArray]:
    """Return a person's values (m, k) at times t (m,), and the seconds (m,) from the nearest observation.

    Values are linear between two observations. Before the first and after the last one, a person moves at
    constant velocity, for `HELD`. Directions become shorter, to 0 at `HELD`.

    Parameters
    ----------
    known : (n,) seconds of the observations, ascending, at least one
    values : (n, k) position, velocity, then directions
    online : True to use only observations before each time; their seconds are infinite without one
    """
    found, since, until = interpolated(known, values, t, online=online)
    beyond = np.where(np.isinf(until), since, np.where(np.isinf(since), -until, 0.0))
    return _moved(found, beyond, np.minimum(since, until)), np.minimum(since, until)


def _moved(values: FloatArray, seconds: FloatArray, age: FloatArray) -> FloatArray:
    """Return values (m, k) as in `predicted` after seconds (m,) of constant velocity, at an age (m,)."""
    ahead = np.clip(seconds, -HELD, HELD)[:, None]
    moved = (values[:, :2] + ahead * values[:, 2:4], values[:, 2:4], presence(age)[:, None] * values[:, 4:])
    return np.hstack(moved)


def drift(age: FloatArray) -> FloatArray:
    """Return the variance (n,), m² on each axis, of a position predicted from an observation of an age (s).

    That of a constant-velocity model with white-noise acceleration; constant from `HELD` on.
    """
    return np.asarray(white_noise_acceleration(np.minimum(age, HELD), _ACCELERATION).noise[0])


def with_absent(people: People) -> People:
    """Add the people who are not observed in a frame, but before and after it, less than `HELD` from one."""
    values, frame_of = people.values, people.frame_of
    order = np.argsort(people.person, kind="stable")
    ends = np.searchsorted(people.person[order], np.arange(len(people.ids) + 1))
    parts = [(frame_of, people.person, values, np.zeros(len(people)))]
    for person, (begin, end) in enumerate(pairwise(ends.tolist())):
        rows = order[begin:end]
        if not len(rows):
            continue
        known = people.t[frame_of[rows]]
        first, stop = np.searchsorted(people.t, known[[0, -1]])
        frames = np.setdiff1d(np.arange(first, stop), frame_of[rows], assume_unique=True)
        found, age = predicted(known, values[rows], people.t[frames], online=False)
        near = is_held(age)
        count = np.count_nonzero(near)
        parts.append((frames[near], np.full(count, person), found[near], age[near]))
    all_frames, persons, all_values, ages = (np.concatenate(part) for part in zip(*parts, strict=True))
    order = np.lexsort((persons, all_frames))
    bounds = np.searchsorted(all_frames[order], np.arange(len(people.frame) + 1))
    columns = (*np.split(all_values[order], 4, axis=1), ages[order])
    return People(people.ids, people.frame, people.t, bounds, persons[order], *columns)


@dataclass(frozen=True, eq=False)
class _LastObserved:
    """Last observation of people."""

    track_id: IntArray  # (p,) ascending
    t: FloatArray  # (p,) seconds
    values: FloatArray  # (p, 8) as `People.values`


class Present(Saved):
    """People of frame after frame, with those who were observed less than `HELD` before."""

    _saved: ClassVar = {"_last": _LastObserved}

    def __init__(self) -> None:
        self._last = _LastObserved(np.empty(0, dtype=np.int64), np.empty(0), np.empty((0, 8)))

    def take(self, people: People) -> People:
        """Take the people of one frame, later than those before, or of none, and add the absent people."""
        if not len(people):
            return people
        t, known = float(people.t[0]), self._last
        here = people.ids[people.person]
        absent = is_held(t - known.t) & ~np.isin(known.track_id, here)
        track_id = np.concatenate([here, known.track_id[absent]])
        last = np.concatenate([np.full(len(here), t), known.t[absent]])
        values = np.vstack([people.values, known.values[absent]])
        order = np.argsort(track_id)
        track_id, last, values = track_id[order], last[order], values[order]
        self._last = _LastObserved(track_id, last, values)
        age, rows = t - last, np.arange(len(track_id))
        columns = (*np.split(_moved(values, age, age), 4, axis=1), age)
        return People(track_id, people.frame, people.t, np.array([0, len(rows)]), rows, *columns)


def expected_unit(angle: FloatArray, variance: FloatArray) -> FloatArray:
    """Return the (n, 2) mean unit vector of an angle, rad, with a variance, rad²; 0 if unknown."""
    vector: FloatArray = np.nan_to_num(np.exp(-0.5 * variance)[:, None] * unit(angle))
    return vector


def expected_direction(track: Track, name: str) -> FloatArray:
    """Return the (n, 2) mean unit vector of ``body`` or ``head``; 0 if the angle is unknown."""
    angle: FloatArray | None = getattr(track, name)
    if angle is None:
        return np.zeros((len(track), 2))
    length = np.ones(len(track))
    kappa: FloatArray | None = getattr(track, f"{name}_kappa")
    if kappa is not None:
        length = np.where(np.isnan(kappa), 1.0, mean_resultant_length(np.nan_to_num(kappa)))
    direction: FloatArray = np.nan_to_num(length[:, None] * unit(angle))
    if track.covariance is None:
        return direction
    place = STATE.index(name)
    variance = track.covariance[:, place, place]
    return np.where(np.isnan(variance)[:, None], direction, expected_unit(angle, variance))


def _velocity(track: Track, known: BoolArray, online: bool) -> FloatArray:
    """Return the slope of known positions, over `_SLOPE_SECONDS` or a frame to either side.

    Positions over a shorter time say less of a velocity than their noise does: there it is nearer to 0.
    """
    t, position = track.t[known], track.position[known]
    count = len(t)
    if count < 2:
        return np.zeros((count, 2))
    each, reach = np.arange(count), _SLOPE_SECONDS + TIME_TOLERANCE
    before = np.minimum(np.searchsorted(t, t - reach), np.maximum(each - 1, 0))
    after = np.maximum(np.searchsorted(t, t + reach, side="right") - 1, np.minimum(each + 1, count - 1))
    if online:
        after = each
    seconds = np.maximum(t[after] - t[before], _SLOPE_SECONDS)
    slope: FloatArray = (position[after] - position[before]) / seconds[:, None]
    return slope


PeopleEstimates: TypeAlias = "Mapping[int, Estimate] | Iterable[PersonEstimate]"
"""Estimates by track id, or a tracker's estimates, which have their identities."""

Numbers = tuple[float, ...]
"""x, y, vx, vy, body, head, and the variances of these two: metres, seconds and radians."""

_BODY, _HEAD = STATE.index("body"), STATE.index("head")


def numbers_of(estimate: Estimate) -> Numbers:
    """Return the numbers of an estimate that groups and attention read."""
    spread = estimate.covariance
    angles = (estimate.body, estimate.head, spread.item(_BODY, _BODY), spread.item(_HEAD, _HEAD))
    return (*estimate.position.tolist(), *estimate.velocity.tolist(), *angles)


def people_of_estimates(t: float, estimates: PeopleEstimates) -> People:
    """Return the people of a frame, by identity; people without a position yet are left out.

    Raise InputError for an invalid time, and for a person given twice.
    """
    if not math.isfinite(t):
        raise InputError(f"t = {t:g}", "a time in seconds")
    numbers: dict[int, Numbers] = {}
    frame = 0
    for one, estimate in (
        estimates.items() if isinstance(estimates, Mapping) else ((p.track_id, p) for p in estimates)
    ):
        if one in numbers:
            raise InputError(f"track {one} twice", "each person once in a frame")
        if estimate.status != "waiting":
            numbers[one], frame = numbers_of(estimate), estimate.frame
    return people_at(t, frame, numbers)


def people_at(t: float, frame: int, numbers: Mapping[int, Numbers]) -> People:
    """Return the people of a frame from their values by track id."""
    ids = sorted(numbers)
    count, table = len(ids), np.array([numbers[one] for one in ids], float).reshape(-1, 8)
    return People(
        np.array(ids, dtype=np.int64),
        np.full(min(count, 1), frame, dtype=np.int64),
        np.full(min(count, 1), float(t)),
        np.array([0, count] if count else [0], dtype=np.int64),
        np.arange(count),
        table[:, :2].copy(),
        np.nan_to_num(table[:, 2:4]),
        expected_unit(table[:, 4], table[:, 6]),
        expected_unit(table[:, 5], table[:, 7]),
        np.zeros(count),
    )


@dataclass(frozen=True, eq=False)
class Place:
    """Disc about a point, or polygon; of crowd measures also a line."""

    name: str  # display name, unique
    outline: FloatArray  # (k, 2) metres, the corners; one point for a disc, two for a line
    radius: float = 0.0  # metres; 0 for a polygon

    @property
    def is_line(self) -> bool:
        """True for a line."""
        return len(self.outline) == 2

    @property
    def centre(self) -> FloatArray:
        """(2,) metres: the point, or the mean of the corners."""
        mean: FloatArray = self.outline.mean(axis=0)
        return mean

    def viewed_from(self, position: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return bearing and half angular width, radians, and distance, metres, from (n, 2)."""
        away = self.centre - position
        far, bearing = np.linalg.norm(away, axis=1), direction(away)
        if self.radius > 0.0:
            return bearing, half_angles(self.radius, far), far
        corners = direction(self.outline - position[:, None])
        turned = difference(corners, bearing[:, None])
        low, high = turned.min(axis=1), turned.max(axis=1)
        half = np.where(_inside(position, self.outline), np.pi, 0.5 * (high - low))
        return bearing + 0.5 * (low + high), half, far


def _inside(position: FloatArray, outline: FloatArray) -> np.ndarray:
    """Return True for points (n, 2) inside a polygon, by ray casting."""
    x, y = position.T
    ax, ay = outline.T
    bx, by = np.roll(outline, -1, axis=0).T
    spans = (ay > y[:, None]) != (by > y[:, None])
    with np.errstate(divide="ignore", invalid="ignore"):
        at = ax + (y[:, None] - ay) * (bx - ax) / (by - ay)
    return np.count_nonzero(spans & (x[:, None] < at), axis=1) % 2 == 1


def read_places(path: str | Path, *, lines: bool = False) -> list[Place]:
    """Read places: CSV with ``name`` and either ``x, y, radius`` or ``polygon`` (``x y x y x y …``), metres.

    ``lines``: a polygon may have two points, which are a line.

    Raise InputError with line and column: a place without radius and polygon, or with both, a duplicate name,
    an invalid number.
    """
    source = Source.open(path)
    header, rows = csv_records(source)
    if "name" not in header or not ({"x", "y", "radius"} <= set(header) or "polygon" in header):
        expected = "name and x, y, radius, or name and polygon"
        raise InputError(f"the columns {', '.join(header)[:80]}", expected, path=source.path)
    places: list[Place] = []
    names: set[str] = set()
    for line, row in rows:
        name = row["name"]
        if not name or name in names:
            found = f"the name {name!r} again" if name else "no name"
            raise InputError(found, "a name for each place", path=source.path, line=line, column="name")
        names.add(name)
        cells = {key: row.get(key, "") for key in ("x", "y", "radius", "polygon")}
        if bool(cells["radius"]) == bool(cells["polygon"]):
            found = f"place {name!r} with {'both' if cells['radius'] else 'neither radius nor polygon'}"
            raise InputError(found, "a radius or a polygon", path=source.path, line=line)
        if cells["polygon"]:
            numbers = [_metres(source, line, "polygon", cell) for cell in cells["polygon"].split()]
            if len(numbers) < (4 if lines else 6) or len(numbers) % 2:
                corners = "two points (a line)" if lines else "three corners"
                found, expected = f"{len(numbers)} numbers", f"x y of {corners} or more"
                raise InputError(found, expected, path=source.path, line=line, column="polygon")
            places.append(Place(name, np.array(numbers).reshape(-1, 2)))
            continue
        x, y, radius = (_metres(source, line, key, cells[key]) for key in ("x", "y", "radius"))
        if radius <= 0.0:
            raise InputError(f"{radius:g}", "metres above 0", path=source.path, line=line, column="radius")
        places.append(Place(name, np.array([[x, y]]), radius))
    if not places:
        raise InputError("no rows", "at least one place", path=source.path)
    return places


def _metres(source: Source, line: int, column: str, cell: str) -> float:
    value = parse_number(cell)
    if value is None or abs(value) > LARGEST_METRES:
        raise InputError(repr(cell[:40]), expected_number(cell), path=source.path, line=line, column=column)
    return value
