"""What stands for tracks wherever tracks are asked for."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from graphtrack.errors import InputError
from graphtrack.io.options import Associate
from graphtrack.io.reading import are_paths, is_table, read
from graphtrack.scene import GivenScene
from graphtrack.tracks import Track, TrackSet

if TYPE_CHECKING:
    import pandas as pd

    Scene: TypeAlias = (
        TrackSet | Sequence[Track] | str | Path | Sequence[str | Path] | pd.DataFrame | Mapping[str, Any]
    )
    Given: TypeAlias = Track | Scene


def tracks_of(
    given: Given, associate: Associate = "auto", scene: GivenScene = None, **reading: Any
) -> TrackSet:
    """Tracks, a track, several of them, the path of a file or of several, or a table, as a set of tracks.

    Parameters
    ----------
    associate, scene : what to do with a file's rows without identities, as in `ReadOptions`
    **reading : other options of `read`, for paths and tables

    Raises
    ------
    InputError
        For anything else, and for a file or table that cannot be read.
    """
    if reading and not (isinstance(given, str | Path) or is_table(given) or are_paths(given)):
        names = ", ".join(reading)
        raise InputError(
            f"{names} with a {type(given).__name__}", "options of reading with a path or a table"
        )
    if isinstance(given, TrackSet):
        return given
    if isinstance(given, Track):
        return TrackSet((given,))
    if isinstance(given, str | Path):
        return read(given, associate=associate, scene=scene, **reading)
    if is_table(given):
        return read(given, **reading) if reading else TrackSet.from_table(given)
    if isinstance(given, list | tuple) and given:
        if all(isinstance(one, Track) for one in given):
            return TrackSet(tuple(given))
        if are_paths(given):
            return read(given, associate=associate, scene=scene, **reading)
    raise InputError(_described(given), f"a TrackSet, a Track, a table or the path of a file{_hint(given)}")


def _described(given: object) -> str:
    shape = _shape(given)
    return f"a {type(given).__name__}" + (f" of shape {shape}" if shape else "")


def _hint(given: object) -> str:
    """How an array of positions becomes a track."""
    shape = _shape(given)
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
