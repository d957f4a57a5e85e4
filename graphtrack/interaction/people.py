"""People of a scene, frame by frame, and the places on the ground that they may look at."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, TypeAlias

import numpy as np
from numpy.typing import NDArray

from graphtrack.errors import InputError
from graphtrack.geometry.angles import (
    BoolArray,
    FloatArray,
    difference,
    direction,
    mean_resultant_length,
    unit,
)
from graphtrack.interaction.gaze_model import half_angle
from graphtrack.io.source import Source
from graphtrack.io.text import csv_records, expected_number, parse_number
from graphtrack.tracks.time import TIME_TOLERANCE
from graphtrack.tracks.track import STATE, Track
from graphtrack.tracks.validation import LARGEST_METRES

if TYPE_CHECKING:
    from graphtrack.association.tracker import PersonEstimate
    from graphtrack.inference.state import Estimate


IntArray = NDArray[np.int64]

_SLOPE_SECONDS = 0.5
"""Half width in seconds of the differences for missing velocities, if frames are closer."""


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

    def __len__(self) -> int:
        return len(self.person)

    @property
    def frame_of(self) -> IntArray:
        """(n,) index in ``frame`` of each row."""
        return np.repeat(np.arange(len(self.frame)), np.diff(self.first))

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
                *(values[here] for values in (self.position, self.velocity, self.body, self.head)),
            )


_ANGLES = [f"{name}_{part}" for name in ("body", "head") for part in ("deg", "kappa", "std_deg")]

USED = ("t", "x", "y", "vx", "vy", *_ANGLES)
"""Columns of people that groups are found from."""


def people_of(tracks: Iterable[Track], *, online: bool = False) -> People:
    """Return the people of a scene with known positions.

    Estimates are weighted by their covariance, observed angles by their concentration; angles with neither
    are exact. With ``online``, missing velocities are computed from the past.
    """
    chosen = sorted(tracks, key=lambda track: track.track_id)
    parts = [_rows(track, online) for track in chosen]
    ids = np.array([track.track_id for track in chosen], dtype=np.int64)
    person = np.repeat(np.arange(len(chosen)), [len(part[0]) for part in parts])
    joined = [np.concatenate(columns) for columns in zip(*parts, strict=True)] if parts else _nobody()
    order = np.lexsort((person, joined[0]))
    frames, t, position, velocity, body, head = (column[order] for column in joined)
    frame, first = np.unique(frames, return_index=True)
    return People(
        ids, frame, t[first], np.append(first, len(frames)), person[order], position, velocity, body, head
    )


def _nobody() -> list[np.ndarray]:
    return [np.empty(0, dtype=np.int64), np.empty(0), *(np.empty((0, 2)) for _ in range(4))]


def _rows(track: Track, online: bool) -> tuple[np.ndarray, ...]:
    known: BoolArray = np.asarray(np.isfinite(track.position).all(axis=1))
    velocity = _velocity(track, known, online) if track.velocity is None else track.velocity[known]
    return (
        track.frame[known],
        track.t[known],
        track.position[known],
        np.nan_to_num(velocity),
        expected_direction(track, "body")[known],
        expected_direction(track, "head")[known],
    )


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
    """Return the slope of known positions, over `_SLOPE_SECONDS` or a frame to either side."""
    t, position = track.t[known], track.position[known]
    count = len(t)
    if count < 2:
        return np.zeros((count, 2))
    each, reach = np.arange(count), _SLOPE_SECONDS + TIME_TOLERANCE
    before = np.minimum(np.searchsorted(t, t - reach), np.maximum(each - 1, 0))
    after = np.maximum(np.searchsorted(t, t + reach, side="right") - 1, np.minimum(each + 1, count - 1))
    if online:
        past: FloatArray = (position - position[before]) / np.where(each > 0, t - t[before], 1.0)[:, None]
        return past
    slope: FloatArray = (position[after] - position[before]) / (t[after] - t[before])[:, None]
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
    )


@dataclass(frozen=True, eq=False)
class Place:
    """Disc about a point, or polygon."""

    name: str  # display name, unique
    outline: FloatArray  # (k, 2) metres, the corners; one point for a disc
    radius: float = 0.0  # metres; 0 for a polygon

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
            return bearing, half_angle(self.radius, far), far
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


def read_places(path: str | Path) -> list[Place]:
    """Read places: CSV with ``name`` and either ``x, y, radius`` or ``polygon`` (``x y x y x y …``), metres.

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
            if len(numbers) < 6 or len(numbers) % 2:
                found, expected = f"{len(numbers)} numbers", "x y of three corners or more"
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
