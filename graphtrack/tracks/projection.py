"""Projection of geographic coordinates to metres on a local ground, and back (pyproj, extra ``geo``)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray
from graphtrack.packages import package

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
