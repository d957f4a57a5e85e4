"""Speeds that no pedestrian has, which tell of wrong units, frame rates or scales."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from graphtrack.geometry.angles import FloatArray

FASTEST = 12.0
"""Metres a second: nobody runs faster."""

_SPAN = 1.0
"""Seconds over which speeds are taken: from frame to frame they are mostly noise."""

_SHARE = 0.1
"""Share of the positions from which fast tracks are told of: a few odd ones have other causes than units."""


@dataclass(frozen=True)
class Speeds:
    """Speeds of tracks.

    Attributes
    ----------
    n_tracks, n_positions : of all tracks with a speed
    fast : median speed (m/s) of each track that is faster than `FASTEST`
    n_fast : positions of those
    """

    n_tracks: int = 0
    n_positions: int = 0
    fast: tuple[float, ...] = ()
    n_fast: int = 0

    @classmethod
    def of(cls, tracks: Iterable[tuple[FloatArray, FloatArray]]) -> Speeds:
        """The speeds of tracks by their times (n,) and positions (n, 2)."""
        found = [(speed, n) for speed, n in (median_speed(*one) for one in tracks) if n]
        fast = [(speed, n) for speed, n in found if speed > FASTEST]
        return cls(
            len(found),
            sum(n for _, n in found),
            tuple(speed for speed, _ in fast),
            sum(n for _, n in fast),
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
        """Note on speeds that no people have; None where there are none."""
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
    """Median speed (m/s) over spans of about a second, and the number of positions; 0, 0 of less than two."""
    seen = np.isfinite(position).all(axis=1)
    position, t = position[seen], t[seen]
    if len(t) < 2:
        return 0.0, 0
    apart = max(1, round(min(_SPAN / _median(t[1:] - t[:-1]), len(t) - 1.0)))
    moved = np.hypot(*(position[apart:] - position[:-apart]).T)
    with np.errstate(over="ignore"):
        return _median(moved / (t[apart:] - t[:-apart])), len(t)


def _median(values: FloatArray) -> float:
    """The upper median; for thousands of short tracks ``np.median`` takes as long as to read them."""
    return float(np.partition(values, len(values) // 2)[len(values) // 2])
