"""Places on the earth as metres on a local ground, and back (the package pyproj, extra ``geo``)."""

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
"""Of the degrees of a plane's origin: files of one place have one origin, whatever is seen in each."""


def check_crs(crs: str) -> None:
    """Raise InputError for what is no coordinate reference system of places on the ground."""
    pyproj = package("pyproj", "geo")
    try:
        known = pyproj.CRS.from_user_input(crs)
    except pyproj.exceptions.CRSError as error:
        expected = "a coordinate reference system, such as EPSG:4326 or EPSG:25832"
        raise InputError(f"--crs {crs!r}", expected) from error
    if not (known.is_geographic or known.is_projected):
        kind = known.type_name
        raise InputError(f"--crs {crs!r}, a {kind}", "one of places on the ground, such as EPSG:4326")


@dataclass(frozen=True)
class Plane:
    """A local ground that touches the earth: x to the east, y to the north, metres (transverse Mercator).

    Angles are true, and within 30 km of the origin so are lengths, to 1 in 10⁵.

    Attributes
    ----------
    crs : of the places in a file
    latitude, longitude : degrees, of the origin
    """

    crs: str
    latitude: float
    longitude: float

    @classmethod
    def around(cls, crs: str, first: FloatArray, second: FloatArray) -> Plane:
        """The plane amid places (n,) given by easting or longitude and northing or latitude; NaN is none."""
        check_crs(crs)
        longitude, latitude = _transformer(crs, WGS84)(first, second)
        known = np.isfinite(longitude) & np.isfinite(latitude)
        if not known.any():
            raise InputError(f"no place within --crs {crs}", "coordinates of that system")
        return cls(crs, *(round(float(np.median(of[known])), _DIGITS) for of in (latitude, longitude)))

    def metres(self, first: FloatArray, second: FloatArray) -> tuple[FloatArray, FloatArray]:
        """x and y (n,) of places; NaN where there is none, infinite where the crs has none."""
        return _transformer(self.crs, self.local)(first, second)

    def back(self, x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Easting and northing, or longitude and latitude, (n,) of places on the plane."""
        return _transformer(self.local, self.crs)(x, y)

    @property
    def local(self) -> str:
        """The plane's own coordinate reference system."""
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
