"""What is checked of the arrays that a `Track` is given: channels and inputs."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from graphtrack.bounds import INPUT, bounds_of, out_of_bounds, real_numbers
from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray
from graphtrack.table import schema

if TYPE_CHECKING:
    from graphtrack.tracks import Track


def checked_channel(name: str, given: Any, shape: tuple[int, ...], track: Track) -> FloatArray:
    """A copy of what is given for a channel of a track, as an array of that shape.

    Raises
    ------
    InputError
        If it is none, or a number is out of its bounds.
    """
    try:
        value = real_numbers(given)
    except (TypeError, ValueError) as error:
        found = f"{name} of track {track.track_id} that is no array of numbers ({error})"
        raise InputError(found, f"shape {shape}") from error
    if value.shape != shape:
        what = ": x and y in metres" if name == "position" else ""
        raise InputError(f"{name} of shape {value.shape} in track {track.track_id}", f"shape {shape}{what}")
    place = bounds_of(name).first_outside(value)
    if place is not None:
        raise out_of_bounds(name, value[place], track.frame[place[0]], track.track_id)
    return value


def checked_inputs(track: Track) -> dict[str, FloatArray]:
    """Copies, not to be written to, of the inputs that a track is given.

    Raises
    ------
    InputError
        For a name or an array that is none of an input.
    """
    n, found = len(track.frame), {}
    for name, given in track.inputs.items():
        if not isinstance(name, str) or not schema.is_input_name(name):
            raise InputError(f"an input {name!r} of track {track.track_id}", schema.INPUT_NAME)
        value = checked_channel(f"{INPUT}{name}", given, (n, *_size(given)), track)
        missing = np.isnan(value).reshape(n, -1)
        partial = missing.any(axis=1) & ~missing.all(axis=1)
        if not value.size or partial.any():
            place = f"in frame {track.frame[partial.argmax()]}" if value.size else "without a number"
            expected = "rows that are all finite or all NaN, of one number at least"
            raise InputError(f"input {name!r} of track {track.track_id} {place}", expected)
        value.setflags(write=False)
        found[name] = value
    return found


def _size(given: Any) -> tuple[int, ...]:
    """How many numbers a frame has of an array, () for one; of what is no array, one."""
    try:
        return np.shape(given)[1:2]
    except ValueError:  # rows of different lengths
        return ()


def input_of_size(track: Track, name: str, size: tuple[int, ...]) -> FloatArray:
    """An input (n, *size) of a track, NaN where it has none of that name.

    Raises
    ------
    InputError
        If it has another size.
    """
    value = track.inputs.get(name)
    if value is None:
        return np.full((len(track), *size), np.nan)
    if value.shape[1:] != size:
        found = f"input {name!r} of {_numbers(value.shape[1:])} a frame in track {track.track_id}"
        raise InputError(found, _numbers(size))
    return value


def _numbers(size: tuple[int, ...]) -> str:
    return f"{size[0]} numbers" if size else "one number"
