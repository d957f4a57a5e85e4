"""Tracks as a dataset of movement."""

from __future__ import annotations

from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from graphtrack.bounds import INPUT, STATE
from graphtrack.io.movement.layout import FURTHER, HAS_ROW, INDIVIDUALS, KEYPOINTS, SPACE, TIME
from graphtrack.io.movement.rows import rows_of_dataset
from graphtrack.io.options import ReadOptions
from graphtrack.io.rates import steady_rate
from graphtrack.later import package
from graphtrack.tracks import TrackSet

EXTRA = "movement"
_COORDINATES = {"image": ["u", "v"], "state": list(STATE), "other_state": list(STATE)}
_STD = "std"


def from_movement(dataset: Any, **options: Any) -> TrackSet:
    """Tracks from a dataset of the package movement.

    A person's position is a pair of keypoints' middle (hips, or ankles where a camera sees them), body and
    head are where shoulders, ears and nose say that they point; see docs/formats.md.

    Parameters
    ----------
    dataset : xarray.Dataset of poses or boxes, or one of `to_movement`
    **options : fields of `ReadOptions`: ``units``, or a camera, where the positions do not say that they are
        lengths; ``fps``, where they are of frames; ``columns`` with x and y, where space has other axes

    Raises
    ------
    InputError
        For what is none, and for options that are missing.
    """
    rows = rows_of_dataset(dataset, ReadOptions(**options), Path("dataset"))
    return TrackSet.from_identified_rows(rows)


def to_movement(tracks: TrackSet) -> Any:
    """A dataset of the package movement: poses of one keypoint, metres and seconds.

    Each attribute of a `Track` is a data variable of its name: ``body`` and ``head`` in radians,
    ``covariance``, and so on. ``std`` (time, individuals, state) has its diagonal's roots. `from_movement`
    gives the same tracks back, to the last bit.

    Returns
    -------
    xarray.Dataset
        Which ``to_netcdf`` writes.

    Raises
    ------
    InputError
        If the package xarray is not there.
    """
    xarray = package("xarray", EXTRA)
    moments, places = _steps(tracks)
    grid = _Grid(tracks, places, len(moments))
    names = {} if tracks.as_read is None else tracks.as_read.names
    ids = [track.track_id for track in tracks]
    position = grid.filled("position", (2,))
    if not len(position):
        position = np.empty((len(moments), 0, 2))
    variables: dict[str, Any] = {
        "position": (
            (TIME, SPACE, KEYPOINTS, INDIVIDUALS),
            np.moveaxis(position, 2, 1)[:, :, None, :],
            {"space_unit": "m"},
        ),
    }
    score = grid.filled("score", ())
    variables["confidence"] = ((TIME, KEYPOINTS, INDIVIDUALS), score[:, None, :])
    for name, further in FURTHER.items():
        if name != "score" and any(getattr(track, name) is not None for track in tracks):
            shape = next(getattr(one, name).shape[1:] for one in tracks if getattr(one, name) is not None)
            variables[name] = ((TIME, INDIVIDUALS, *further), grid.filled(name, shape))
    if "covariance" in variables:
        variance = np.diagonal(variables["covariance"][1], axis1=2, axis2=3)
        variables[_STD] = ((TIME, INDIVIDUALS, "state"), np.sqrt(variance))
    for name in sorted({*chain.from_iterable(track.inputs for track in tracks)}):
        shape = next(track.inputs[name].shape[1:] for track in tracks if name in track.inputs)
        further = (f"{name}_number",) if shape else ()
        variables[f"{INPUT}{name}"] = ((TIME, INDIVIDUALS, *further), grid.filled(f"{INPUT}{name}", shape))
    known = np.isfinite(position).all(axis=2)
    if not np.array_equal(known, grid.there):
        variables[HAS_ROW] = ((TIME, INDIVIDUALS), grid.there)
    attributes: dict[str, Any] = {"ds_type": "poses", "source_software": "graphtrack", "time_unit": "seconds"}
    rate = steady_rate(tracks)
    if rate is not None:
        attributes["fps"] = rate
    further_dims = {one for dims, *_ in variables.values() for one in dims}
    coordinates: dict[str, Any] = {
        TIME: np.array([t for t, _ in moments]),
        SPACE: ["x", "y"],
        KEYPOINTS: ["centroid"],
        INDIVIDUALS: [names.get(k, str(k)) for k in ids],
        "frame": (TIME, np.array([frame for _, frame in moments], dtype=np.int64)),
        "track_id": (INDIVIDUALS, np.array(ids, dtype=np.int64)),
    }
    if any(track.label != names.get(track.track_id, "") for track in tracks):
        coordinates["label"] = (INDIVIDUALS, np.array([track.label for track in tracks], dtype=object))
    coordinates |= {name: values for name, values in _COORDINATES.items() if name in further_dims}
    return xarray.Dataset(variables, coordinates, attributes)


def _steps(tracks: TrackSet) -> tuple[list[tuple[float, int]], list[NDArray[np.int64]]]:
    """Times and frames of all rows, each pair once and in order, and the places of each track's rows."""
    moments = sorted(
        {pair for one in tracks for pair in zip(one.t.tolist(), one.frame.tolist(), strict=True)}
    )
    place = {pair: k for k, pair in enumerate(moments)}
    return moments, [
        np.array([place[pair] for pair in zip(one.t.tolist(), one.frame.tolist(), strict=True)])
        for one in tracks
    ]


class _Grid:
    """The rows of tracks on a grid of all steps and all people."""

    def __init__(self, tracks: TrackSet, places: list[NDArray[np.int64]], steps: int) -> None:
        self._tracks, self._places = tracks, places
        self.there = np.zeros((steps, len(tracks)), dtype=bool)
        for k, place in enumerate(places):
            self.there[place, k] = True

    def filled(self, name: str, shape: tuple[int, ...]) -> NDArray[np.float64]:
        """A channel (steps, people, *shape); NaN where there is no row, or it says nothing."""
        found = np.full((*self.there.shape, *shape), np.nan)
        for k, (track, place) in enumerate(zip(self._tracks, self._places, strict=True)):
            values = (
                track.inputs.get(name.removeprefix(INPUT)) if name.startswith(INPUT) else getattr(track, name)
            )
            if values is not None:
                found[place, k] = values
        return found
