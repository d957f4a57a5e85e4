"""Trajectories of PedPy, in memory and as the text files of the Pedestrian Dynamics Data Archive."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from graphtrack.bounds import check_frame_rate
from graphtrack.errors import InputError
from graphtrack.io.rates import rate_to_write, times_told
from graphtrack.later import package
from graphtrack.table.columns import frame_of, rows_of_table
from graphtrack.tracks import TrackSet, to_columns

EXTRA = "pedpy"
_IDENTITY, _POINT = "id", "point"


def from_pedpy(trajectory: Any) -> TrackSet:
    """Tracks from a ``pedpy.TrajectoryData``.

    Columns of the native table that its data have besides, as those of `to_pedpy` do, are read too.

    Raises
    ------
    InputError
        If it is none, or a value cannot be used.
    """
    data, rate = getattr(trajectory, "data", None), getattr(trajectory, "frame_rate", None)
    if data is None or rate is None:
        raise InputError(f"a {type(trajectory).__name__}", "a pedpy.TrajectoryData: data and frame_rate")
    check_frame_rate(float(rate))
    table = frame_of(data).drop(columns=_POINT, errors="ignore").rename(columns={_IDENTITY: "track_id"})
    rows = rows_of_table(table, None if "t" in table.columns else float(rate))
    return TrackSet.from_identified_rows(replace(rows, format="pedpy"))


def to_pedpy(tracks: TrackSet, *, frame_rate: float | None = None) -> Any:
    """A ``pedpy.TrajectoryData``: id, frame, x and y in metres, and beside them the native table's columns.

    Rows without a position are left out. Times that frames and rate do not say are kept as the column ``t``.

    Parameters
    ----------
    frame_rate : frames a second, for tracks of a single frame

    Raises
    ------
    InputError
        If the package pedpy is not there, or the times have no steady rate.
    """
    pedpy = package("pedpy", EXTRA)
    import pandas as pd

    columns, rate = trajectory_columns(tracks, frame_rate=frame_rate)
    return pedpy.TrajectoryData(data=pd.DataFrame(columns), frame_rate=rate)


def trajectory_columns(
    tracks: TrackSet, *, path: Path | None = None, frame_rate: float | None = None
) -> tuple[Mapping[str, NDArray[Any]], float]:
    """Columns id, frame, x, y and the native table's others, of rows with a position, and their rate."""
    rate = rate_to_write(tracks, path, frame_rate)
    columns = to_columns(tracks)
    known = np.isfinite(columns["x"]) & np.isfinite(columns["y"])
    columns = {name: values[known] for name, values in columns.items()}
    first = {_IDENTITY: columns.pop("track_id"), **{name: columns.pop(name) for name in ("frame", "x", "y")}}
    if times_told(first["frame"].astype(float), columns["t"], rate):
        del columns["t"]
    return {**first, **columns}, rate
