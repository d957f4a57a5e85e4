"""The noise that tracks declare, and notes on columns that are not used."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Collection, Iterable
from dataclasses import replace
from typing import Any

import numpy as np

from graphtrack.errors import InputWarning
from graphtrack.geometry.angles import FloatArray
from graphtrack.tracks.display import listed
from graphtrack.tracks.schema import COLUMNS, Column
from graphtrack.tracks.track import Track, channel_of

_OBSERVED = (
    *("position", "position_std", "position_covariance", "pixel", "score"),
    *("observed_velocity", "observed_velocity_covariance", "body_axis", "body_axis_kappa"),
    *("body", "body_kappa", "body_likelihood", "head", "head_kappa", "head_likelihood"),
)
"""Fields that no engine sets alone, and that are no truth."""

AXES = "x_std and y_std are used as the noise of the positions, by their root mean square"


def position_noise(position_std: FloatArray | None, covariance: FloatArray | None) -> FloatArray | None:
    """Return 1-σ (n,) of positions: as declared, else the root mean square of x_std and y_std; None: neither.

    ``covariance`` is (n, 6, 6), as in `Track`.
    """
    if covariance is None:
        return position_std
    of_axes = np.sqrt(0.5 * (covariance[:, 0, 0] + covariance[:, 1, 1]))
    return of_axes if position_std is None else np.where(np.isnan(position_std), of_axes, position_std)


def with_position_noise(track: Track) -> Track:
    """Return a track whose positions have the noise of `position_noise`."""
    noise = position_noise(track.position_std, track.covariance)
    same = noise is track.position_std or noise is None or np.isnan(noise).all()
    return track if same else replace(track, position_std=noise)


def unused_note(tracks: Iterable[Track], unused: Callable[[Column], bool], user: str) -> list[str]:
    """Return a note that names the columns which are ``unused`` and in which tracks have values; or none."""
    tracks = list(tracks)
    names = [column.name for column in COLUMNS if unused(column) and _is_given(tracks, column)]
    return [f"not used by {user}: {listed(names, len(names))}"] if names else []


def _is_given(tracks: Iterable[Track], column: Column) -> bool:
    place: tuple[Any, ...] = (..., *column.index)
    given = (channel_of(track, column.field) for track in tracks)
    return any(values is not None and bool(np.isfinite(values[place]).any()) for values in given)


def warn_unused(tracks: Iterable[Track], used: Collection[str], user: str) -> None:
    """Warn of observations in tracks that are not among the columns ``used``."""
    for line in unused_note(tracks, lambda c: c.name not in used and c.field in _OBSERVED, user):
        warnings.warn(line, InputWarning, stacklevel=3)
