"""Recordings as factor graphs of GTSAM, and values of GTSAM as tracks."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from graphtrack.association.associate import tracks_of as tracks_given
from graphtrack.constants.personal import parameters_of
from graphtrack.inference.engines import PersonalConstants
from graphtrack.inference.graph.recording import recording_graph, recording_tracks
from graphtrack.model import Model
from graphtrack.packages import gtsam
from graphtrack.tracks.given import with_position_noise
from graphtrack.tracks.sensors import Sensors
from graphtrack.tracks.track import TrackSet

if TYPE_CHECKING:
    from graphtrack.io.read_write import Given


def graph_of(
    tracks: Given,
    model: Model | str | Path | None = None,
    *,
    constants: Mapping[int, PersonalConstants] | None = None,
    sensors: Sensors | None = None,
) -> tuple[gtsam.NonlinearFactorGraph, gtsam.Values]:
    """Return the factors of a recording, and the values from which the engines start.

    The error of the graph is the cost that every offline engine minimises, and `gtsam.Marginals` of it are
    the covariances that they report. A person's variables have the keys of `key_of`. Motion, turning,
    observed positions and angles, and the coupling of the head to the body are GTSAM's own factors; others
    are `gtsam.CustomFactor`. GTSAM 4.3 serialises neither these nor its own of motion and of rotations: save
    the tracks and the model instead.

    Parameters
    ----------
    tracks : observations, as in `solve`; groups are not searched for, but read from the input ``group``
    model : as in `solve`; by default "joint"
    constants : by track id, those of people in place of the model's, such as `Solution.constants`. Of several
        couplings the most probable one is taken
    sensors : descriptions for which the tracks' rows were corrected (`read` with ``sensors``). Errors that
        are unknown or have a 1-σ are variables: of the k-th sensor ``gtsam.symbol("s", k)``, a vector of
        these in the order of `ERRORS` (metres, radians, seconds)

    Raises
    ------
    InputError
        For ids below 0 or beyond 2²⁴ − 1, or that two tracks share.
    SolveError
        For a track without a position.

    Examples
    --------
    >>> import gtsam, graphtrack as gt, numpy as np
    >>> tracks = gt.simulate("joint", n_tracks=2, rng=np.random.default_rng(0))
    >>> graph, values = gt.graph_of(tracks)
    >>> found = gtsam.LevenbergMarquardtOptimizer(graph, values).optimize()
    >>> gt.tracks_of(found, tracks, marginals=gtsam.Marginals(graph, found))
    TrackSet(2 tracks, 400 person-frames, 0.0–19.9 s, body, head; estimates; truth)
    """
    given, models = _given(tracks, model, constants)
    return recording_graph(given, models, sensors)


def tracks_of(
    values: gtsam.Values,
    tracks: Given,
    model: Model | str | Path | None = None,
    *,
    constants: Mapping[int, PersonalConstants] | None = None,
    marginals: gtsam.Marginals | None = None,
) -> TrackSet:
    """Return tracks of the estimates among values with the keys of `graph_of`, the inverse of it.

    Parameters
    ----------
    values : with the variables of all tracks, and any others
    tracks, model, constants : as for `graph_of`
    marginals : of the graph; without them covariances are NaN

    Raises
    ------
    SolveError
        For a track whose variables are not among the values.
    """
    given, models = _given(tracks, model, constants)
    return recording_tracks(values, given, models, marginals)


def _given(
    tracks: Given, model: Model | str | Path | None, constants: Mapping[int, PersonalConstants] | None
) -> tuple[TrackSet, list[Model]]:
    chosen = Model.named(model)
    given = tracks_given(tracks, scene=chosen.scene).map(with_position_noise)
    own = {} if constants is None else constants
    models = [
        chosen.with_parameters(chosen.parameters.with_values(parameters_of(own[track.track_id], chosen)))
        if track.track_id in own
        else chosen
        for track in given
    ]
    return given, models
