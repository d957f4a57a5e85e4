"""Places as gaze targets: discs and polygons on the ground, and the file that lists them."""

from __future__ import annotations

import csv
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray, difference, direction
from graphtrack.interaction.gaze_model import half_angle
from graphtrack.io.source import Source
from graphtrack.io.text import expected_number, parse_number
from graphtrack.tracks.validation import LARGEST_METRES


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
    reader = csv.DictReader(source.lines, skipinitialspace=True)
    header = [name.strip() for name in reader.fieldnames or []]
    reader.fieldnames = header
    if "name" not in header or not ({"x", "y", "radius"} <= set(header) or "polygon" in header):
        expected = "name and x, y, radius, or name and polygon"
        raise InputError(f"the columns {', '.join(header)[:80]}", expected, path=source.path)
    places: list[Place] = []
    for row in reader:
        line = reader.line_num
        name = (row.get("name") or "").strip()
        if not name or name in [place.name for place in places]:
            found = f"the name {name!r} again" if name else "no name"
            raise InputError(found, "a name for each place", path=source.path, line=line, column="name")
        cells = {key: (row.get(key) or "").strip() for key in ("x", "y", "radius", "polygon")}
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
