"""Walkable areas: polygons with holes on the ground, and the walls near a position."""

from __future__ import annotations

from functools import cached_property
from hashlib import sha256
from itertools import accumulate
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray

if TYPE_CHECKING:
    import shapely

AreaLike: TypeAlias = "WalkableArea | str | Path | Any"
"""A walkable area, the path of its file, or an object of Shapely or PedPy that holds one."""

REACH = 2.0
"""Metres within which a wall is taken into account."""
MARGIN = 0.05
"""Metres that estimates and forecasts keep from walls."""
WALLS = 2
"""Most walls of a position that are taken into account: a corner has two."""

_PARALLEL = 0.95  # Cosine between normals above which a second wall is redundant
_ON_WALL = 1e-9  # metres
_FARTHEST = 1e8  # metres, the limit of positions


class WalkableArea:
    """Area in which people walk.

    Parameters
    ----------
    geometry : Shapely polygon or polygons, in metres of the world

    Raises
    ------
    InputError
        For a geometry that is not a polygon, is not valid, has no area or lies farther than 1e8 m from the
        origin, where no position may lie either.
    """

    def __init__(self, geometry: shapely.Geometry) -> None:
        import shapely

        if geometry.geom_type not in ("Polygon", "MultiPolygon") or geometry.is_empty:
            raise InputError(f"a geometry of type {geometry.geom_type}", "a polygon or several, not empty")
        if not geometry.is_valid:
            raise InputError(
                f"polygons that are not valid: {shapely.is_valid_reason(geometry)}", "valid polygons"
            )
        farthest = float(np.abs(geometry.bounds).max())
        if farthest > _FARTHEST:
            raise InputError(f"a coordinate of {farthest:.3g} m", f"coordinates within ±{_FARTHEST:g} m")
        shapely.prepare(geometry)
        self.geometry = geometry
        rings = [
            ring
            for polygon in getattr(geometry, "geoms", [geometry])
            for ring in (lambda one: [one.exterior, *one.interiors])(shapely.geometry.polygon.orient(polygon))
        ]
        # Of an oriented polygon the area lies to the left of each ring.
        self._ends = np.concatenate([_segments(np.asarray(ring.coords)[:, :2]) for ring in rings])
        self._tree = shapely.STRtree(shapely.linestrings(self._ends))

    def __reduce__(self) -> tuple[Any, ...]:
        return WalkableArea, (self.geometry,)

    @classmethod
    def of(cls, area: AreaLike) -> WalkableArea:
        """Return an area from a path, a polygon or an area.

        Raises
        ------
        InputError
            For a file that cannot be read, or another object.
        """
        from graphtrack.packages import package

        shapely = package("shapely", "geo")
        if isinstance(area, cls):
            return area
        if isinstance(area, str | Path):
            path = Path(area)
            geometry = _read(path, shapely)
            try:
                return cls(geometry)
            except InputError as error:
                raise error.at(path) from error
        geometry = getattr(area, "polygon", area)  # PedPy's WalkableArea
        if not isinstance(geometry, shapely.Geometry):
            raise InputError(
                f"a walkable area of type {type(area).__name__}", "a path, or a polygon of Shapely"
            )
        return cls(geometry)

    def digest(self) -> str:
        """Return text that is the same for equal polygons and differs for others."""
        import shapely

        return sha256(shapely.to_wkb(shapely.normalize(self.geometry))).hexdigest()[:16]

    def contains(self, position: FloatArray) -> NDArray[np.bool_]:
        """Return a mask (n,), True for positions (n, 2) in the area or on its border; False where NaN."""
        import shapely

        position = np.asarray(position, dtype=float)
        known = np.isfinite(position).all(axis=1)
        found = np.zeros(len(position), dtype=bool)
        found[known] = shapely.intersects_xy(self.geometry, *position[known].T)
        return found

    def walls(self, position: FloatArray) -> FloatArray:
        """Return the half planes that hold the area near positions.

        Parameters
        ----------
        position : (n, 2) metres; NaN where unknown

        Returns
        -------
        (n, 6)
            For each of `WALLS` walls the inward unit normal and the offset c: inside, normal·position ≥ c.
            Zeros where no wall is within `REACH`.
        """
        position = np.asarray(position, dtype=float)
        walls = np.zeros((len(position), WALLS, 3))
        row, segment = self._near(position)
        if not len(row):
            return walls.reshape(-1, 3 * WALLS)
        start, end = self._ends[segment, 0], self._ends[segment, 1]
        along = end - start
        length = np.maximum(np.linalg.norm(along, axis=1), 1e-300)
        share = np.clip(np.sum((position[row] - start) * along, axis=1) / length**2, 0.0, 1.0)
        nearest = start + share[:, None] * along
        away = position[row] - nearest
        distance = np.linalg.norm(away, axis=1)
        inward = np.column_stack([-along[:, 1], along[:, 0]]) / length[:, None]
        is_inside = self.contains(position)[row]
        outward = np.where(is_inside, 1.0, -1.0)[:, None] * away / np.maximum(distance, 1e-300)[:, None]
        normal = np.where(distance[:, None] > _ON_WALL, outward, inward)
        order = np.lexsort((distance, row))
        row, normal, nearest, is_inside = row[order], normal[order], nearest[order], is_inside[order]
        offset = np.sum(normal * nearest, axis=1)
        first = np.flatnonzero(np.diff(row, prepend=-1))
        walls[row[first], 0] = np.column_stack([normal[first], offset[first]])
        # A position outside is attracted by the nearest wall only; second walls are for positions inside.
        facing = np.sum(normal * walls[row, 0, :2], axis=1)
        other = np.flatnonzero(is_inside & (facing < _PARALLEL))
        second = other[np.flatnonzero(np.diff(row[other], prepend=-1))]
        walls[row[second], 1] = np.column_stack([normal[second], offset[second]])
        return walls.reshape(-1, 3 * WALLS)

    @cached_property
    def _inner(self) -> shapely.Geometry:
        """The area at least `MARGIN` from its walls; all of one that is narrower throughout."""
        inner = self.geometry.buffer(-MARGIN)
        return self.geometry if inner.is_empty else inner

    def confined(self, path: FloatArray, start: FloatArray) -> FloatArray:
        """Return a path (k, 2) from ``start`` (2,) that follows the walls where it would cross them.

        A point beyond a wall is replaced by the nearest point of the area, `MARGIN` from its walls,
        or by the previous point where the straight way there crosses a wall, too. A start outside, such as a
        noisy observation, is replaced by the nearest point in the same way.
        """
        import shapely

        found, here = np.array(path, dtype=float), np.asarray(start, dtype=float)
        if not self.contains(here[None])[0]:
            here = self._nearest(here)
        for k, point in enumerate(found):
            if np.isfinite(point).all() and not self.geometry.covers(shapely.LineString([here, point])):
                nearest = self._nearest(point)
                is_free = self.geometry.covers(shapely.LineString([here, nearest]))
                found[k] = nearest if is_free else here
            here = found[k]
        return found

    def _nearest(self, point: FloatArray) -> FloatArray:
        """Return the nearest point (2,) of the inner area."""
        import shapely

        return np.array(shapely.shortest_line(self._inner, shapely.Point(point)).coords[0])

    def _near(self, position: FloatArray) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Pairs of a position and a segment within `REACH`, or the nearest segment of one outside."""
        import shapely

        known = np.flatnonzero(np.isfinite(position).all(axis=1))
        points = shapely.points(position[known])
        near = self._tree.query(points, predicate="dwithin", distance=REACH)
        outside = np.flatnonzero(~self.contains(position[known]))
        far = self._tree.query_nearest(points[outside], all_matches=False)
        row = np.concatenate([near[0], outside[far[0]]])
        pairs = np.unique(np.column_stack([row, np.concatenate([near[1], far[1]])]), axis=0)
        return known[pairs[:, 0]], pairs[:, 1]


def _segments(ring: FloatArray) -> FloatArray:
    """Segments (n, 2, 2) of a closed ring (n + 1, 2), without segments of zero length."""
    ends = np.stack([ring[:-1], ring[1:]], axis=1)
    return ends[np.any(ends[:, 0] != ends[:, 1], axis=1)]


def _read(path: Path, shapely: Any) -> shapely.Geometry:
    """Read the polygons of a GeoJSON or WKT file."""
    try:
        with path.open("rb") as stream:
            data = stream.read(_MOST_BYTES + 1)  # a device may be endless
        text = data[:_MOST_BYTES].decode()
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(
            getattr(error, "strerror", None) or "a file that is not text", "a walkable area", path=path
        ) from error
    if len(data) > _MOST_BYTES:
        found, most = f"more than {_MOST_BYTES // 2**20} MiB", "a file of polygons in metres"
        raise InputError(found, most, path=path)
    is_json = text.lstrip().startswith("{")
    expected = "GeoJSON or well-known text with polygons in metres"
    if _levels(text) > _MOST_LEVELS:  # GEOS has no limit but the stack, and ends the process
        raise InputError("brackets within brackets without end", expected, path=path)
    try:
        with np.errstate(over="ignore", invalid="ignore"):  # `WalkableArea` refuses such coordinates
            geometry = shapely.from_geojson(text) if is_json else shapely.from_wkt(text)
            polygons = [
                one
                for part in shapely.get_parts(geometry)
                for one in shapely.get_parts(part)
                if one.geom_type == "Polygon"
            ]
            area = shapely.union_all(polygons)
    # Curves are no geometries of Shapely.
    except (shapely.errors.ShapelyError, NotImplementedError, TypeError, ValueError) as error:
        found = next(iter(str(error).splitlines()), "") or "no geometry"
        raise InputError(found, expected, path=path) from error
    if not polygons:
        raise InputError("no polygon", "at least one polygon in which people walk", path=path)
    return area


_MOST_LEVELS = 50
_MOST_BYTES = 2**28


def _levels(text: str) -> int:
    """Return the largest number of brackets that are open at once."""
    opened = (1 if bracket in "([{" else -1 for bracket in text if bracket in "([{}])")
    return max(accumulate(opened), default=0)
