"""Frames and times of a dataset."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from graphtrack.bounds import LARGEST_FRAME
from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray
from graphtrack.io.movement.layout import TIME
from graphtrack.io.options import ReadOptions
from graphtrack.io.tables.rows import numbered_times
from graphtrack.table.moments import TimeScale, from_dates


def frames_and_times(
    dataset: Any, options: ReadOptions, path: Path
) -> tuple[NDArray[np.int64], FloatArray, TimeScale | None, list[str]]:
    """Frames (n,) and seconds (n,) of the steps of a dataset, what dates they are, and notes.

    Times are those of the coordinate ``time``: dates, seconds, or, where the attribute ``time_unit`` says so
    or they are whole numbers without a frame rate, frames. Then the rate is ``fps`` of the options, or the
    dataset's attribute of that name.
    """
    n = dataset.sizes[TIME]
    values = dataset[TIME].to_numpy() if TIME in dataset.coords else np.arange(n)
    rate = options.fps if options.fps is not None else _rate(dataset)
    said = dataset.attrs.get("time_unit")
    time: TimeScale | None = None
    notes: list[str] = []
    if values.dtype.kind == "M":
        beside = None if options.beside is None else options.beside.time
        values, time = from_dates(values, "", beside)
    elif values.dtype.kind == "m":
        values = values.astype("m8[ns]").astype(np.int64) / 1e9
    elif values.dtype.kind not in "iuf":
        raise InputError(f"times of type {values.dtype}", "seconds, or frames and --fps", path=path)
    elif said == "frames" or (said is None and (values.dtype.kind in "iu") and "frame" not in dataset.coords):
        if rate is None:
            raise InputError("times in frames, and no frame rate", "frames a second (--fps)", path=path)
        frame = _whole(values, path)
        return frame, frame / rate, None, notes
    t = np.asarray(values, dtype=float)
    if not np.isfinite(t).all():
        raise InputError("a time that is missing", "a time for each step", path=path)
    if "frame" in dataset.coords and dataset["frame"].dims == (TIME,):
        frame = _whole(dataset["frame"].to_numpy(), path)
    elif rate is not None and np.abs(t * rate - np.rint(t * rate)).max(initial=0.0) < 0.25:
        frame = _whole(np.rint(t * rate), path)
    else:
        known, place = np.unique(t, return_inverse=True)
        numbers, how = numbered_times(known)
        frame = numbers[place].astype(np.int64)
        notes.append(f"no frames: {how}")
    if options.fps is not None:
        notes.append("the frame rate was not used: the file has times")
    return frame, t, time, notes


def _rate(dataset: Any) -> float | None:
    given = dataset.attrs.get("fps")
    try:
        rate = float(given)
    except (TypeError, ValueError):
        return None
    return rate if np.isfinite(rate) and 0.0 < rate <= 1e6 else None


def _whole(values: NDArray[Any], path: Path) -> NDArray[np.int64]:
    numbers = np.asarray(values, dtype=float)
    bad = ~(np.abs(numbers) <= LARGEST_FRAME) | (numbers != np.rint(numbers))
    if bad.any():
        expected = f"a whole number within ±{LARGEST_FRAME}"
        raise InputError(f"the frame {numbers[bad][0]:g}", expected, path=path)
    return numbers.astype(np.int64)
