"""Tracks from a file, a table or tracks."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from graphtrack.errors import InputError
from graphtrack.io.reading import are_paths, is_table, read
from graphtrack.tracks import Track, TrackSet

if TYPE_CHECKING:
    import pandas as pd

    Scene: TypeAlias = (
        TrackSet | Sequence[Track] | str | Path | Sequence[str | Path] | pd.DataFrame | Mapping[str, Any]
    )
    Given: TypeAlias = Track | Scene


def tracks_of(given: Given, read: Callable[..., TrackSet] = read, **reading: Any) -> TrackSet:
    """Tracks, a track, several of them, the path of a file or of several, or a table, as a set of tracks.

    Parameters
    ----------
    read : what reads files, and tables with options
    **reading : its options
    """
    if isinstance(given, str | Path) or (are_paths(given) and given):
        return read(given, **reading)
    if is_table(given):
        return read(given, **reading) if reading else TrackSet.from_table(given)
    if reading:
        found = f"{', '.join(reading)} with a {type(given).__name__}"
        raise InputError(found, "options of reading with a path or a table")
    if isinstance(given, TrackSet):
        return given
    if isinstance(given, Track):
        return TrackSet((given,))
    if isinstance(given, list | tuple) and given and all(isinstance(one, Track) for one in given):
        return TrackSet(tuple(given))
    shape = _shape(given)
    found = f"a {type(given).__name__}" + (f" of shape {shape}" if shape else "")
    raise InputError(found, f"a TrackSet, a Track, a table or the path of a file{_hint(shape)}")


def _hint(shape: tuple[int, ...]) -> str:
    """Advice to make a track of an array of positions."""
    if len(shape) != 2 or shape[1] != 2:
        return ""
    n = shape[0]
    return (
        "; positions have no times of their own: "
        f"Track(0, frame=np.arange({n}), t=np.arange({n}) / fps, position=positions)"
    )


def _shape(given: Any) -> tuple[int, ...]:
    try:
        return np.shape(given)
    except ValueError:  # rows of different lengths
        return ()
