"""The factor graph of a recording: the factors of all people, initial values, and back to tracks.

Every offline engine minimises the error of this graph, person by person.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from graphtrack.errors import InputError, SolveError
from graphtrack.geometry.camera import GroundCamera
from graphtrack.inference.engines import estimated_tracks
from graphtrack.inference.graph.batch import (
    beginning,
    joined,
    reported_covariances,
    start_of,
    window_graph,
)
from graphtrack.inference.graph.sensors import (
    OBSERVING,
    observation_factors,
    priors_of,
    sensor_variables,
)
from graphtrack.inference.state import states_of, values_of
from graphtrack.kernels.layout import N
from graphtrack.model import Model, Step
from graphtrack.model.observation import chain
from graphtrack.model.same_time import merged_rows, of_every_row
from graphtrack.packages import gtsam
from graphtrack.tracks.sensors import Sensors
from graphtrack.tracks.track import Track, TrackSet

_LETTERS = {"position": "x", "velocity": "v", "body": "b", "head": "h"}
_ROW_BITS, _PERSON_BITS = 32, 24
"""Bits of the index of a GTSAM symbol, which has 56."""


def key_of(variable: str, track_id: int, row: int) -> int:
    """Return the GTSAM key of a variable of a person: the symbol x, v, b or h with index id·2³² + row.

    Parameters
    ----------
    variable : "position" (Point2, metres), "velocity" (Vector, m/s), "body" or "head" (Rot2)
    track_id : from 0 to 2²⁴ − 1
    row : number of the row in the track, from 0; rows of one time count once, see `same_time`

    Raises
    ------
    InputError
        For another variable, or a number out of bounds.
    """
    if variable not in _LETTERS:
        raise InputError(f"variable {variable!r}", f"one of {', '.join(_LETTERS)}")
    if not 0 <= row < 1 << _ROW_BITS:
        raise InputError(f"row {row}", f"a number from 0 to {(1 << _ROW_BITS) - 1}")
    return int(gtsam.symbol(_LETTERS[variable], _first_index(track_id) + row))


def _first_index(track_id: int) -> int:
    if not 0 <= track_id < 1 << _PERSON_BITS:
        expected = f"ids from 0 to {(1 << _PERSON_BITS) - 1}, which keys can hold; renumber the tracks"
        raise InputError(f"track {track_id} for a factor graph", expected)
    return int(track_id) << _ROW_BITS


def _frames(
    track: Track, model: Model, camera: GroundCamera | None
) -> tuple[Track, np.ndarray | None, list[Step]]:
    """The track with one row a time, the row of each row of the given one, and the steps."""
    found = merged_rows(track, model.parameters.likelihood, camera)
    merged, rows = (track, None) if found is None else found
    return merged, rows, chain(merged, camera, _first_index(track.track_id))


def recording_graph(
    tracks: TrackSet, models: Sequence[Model], sensors: Sensors | None = None
) -> tuple[gtsam.NonlinearFactorGraph, gtsam.Values]:
    """The factors of tracks, each by its own model, and the values from which the engines start.

    ``sensors``: those whose learned errors are variables too, where rows are corrected for them

    Raises
    ------
    InputError
        For ids that keys cannot hold, or that occur twice, and with sensors for a row of another one.
    SolveError
        For a track without a position.
    """
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    variables = {} if sensors is None else sensor_variables(sensors)
    for one in variables.values():
        if len(one.free):
            values.insert(one.key, one.start[one.free])
    graph.push_back(joined(priors_of(variables)))
    for track, model in zip(tracks, models, strict=True):
        merged, rows, steps = _frames(track, model, tracks.camera)
        start = start_of(merged, steps, model)
        if values.exists(steps[0].position_key):
            raise InputError(f"two tracks {track.track_id}", "a different id for each person")
        if sensors is None:
            graph.push_back(window_graph(start, model))
        else:
            further = [term for term in model.terms if not isinstance(term, OBSERVING)]
            factors = [factor for step in steps for term in further for factor in term.factors(step)]
            step_of_row = steps if rows is None else [steps[k] for k in rows.tolist()]
            factors += [*beginning(start, model), *observation_factors(track, step_of_row, variables, model)]
            graph.push_back(joined(factors))
        values.insert(values_of(steps, start.states, model))
    return graph, values


def recording_tracks(
    values: gtsam.Values,
    tracks: TrackSet,
    models: Sequence[Model],
    marginals: gtsam.Marginals | None = None,
) -> TrackSet:
    """The inverse of `recording_graph`: tracks of estimates, with covariances if there are marginals.

    Raises
    ------
    SolveError
        For a track whose variables are not among the values.
    """
    found: list[Track] = []
    for track, model in zip(tracks, models, strict=True):
        merged, rows, steps = _frames(track, model, tracks.camera)
        if not all(values.exists(step.position_key) for step in steps):
            raise SolveError(track.track_id, "the values have no variables of it, or not of all rows")
        states, covariance = states_of(values, steps, model), np.full((len(steps), N, N), np.nan)
        if marginals is not None:
            covariance = reported_covariances(marginals, steps, model)
        (estimate,) = estimated_tracks([merged], np.array([0, len(steps)]), states, covariance)
        found.append(estimate if rows is None else of_every_row(estimate, track, rows))
    return tracks.with_tracks(found)
