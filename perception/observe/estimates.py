"""Estimates of the people in boxes: identities, then position, motion, body and head."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from graphtrack.association.tracks import associate
from graphtrack.errors import InputError
from graphtrack.evaluation.methods import make_method, own_model
from graphtrack.geometry.camera import GroundCamera
from graphtrack.inference.offline import engine_of
from graphtrack.inference.solution import Solution
from graphtrack.model import Model
from graphtrack.smoothing.recording import solve_tracks
from graphtrack.tracks import Track, TrackSet
from perception.detection.boxes import PersonBox

METHODS = ("smoother", "ffbs", "particle", "chain", "isam2", "fixed-lag")
"""The graph's smoother; Chen et al.'s joint particle filter, smoothed (``ffbs``) or online (``particle``);
the graph online."""
FILTERS = ("ffbs", "particle")
"""What a camera teaches itself of the graph's share of outliers is none of theirs: they forget as they go."""

BOX = "box"
"""The input of a track that says which box each row was seen in; NaN in rows of nothing."""


def numbered(tracks: TrackSet, boxes: Sequence[PersonBox]) -> TrackSet:
    """Add the number of each row's box, as an input, to tracks of boxes with identities."""
    number = {(item.track_id, item.frame): k for k, item in enumerate(boxes)}

    def with_boxes(track: Track) -> Track:
        of_rows = [number[track.track_id, frame] for frame in track.frame.tolist()]
        return replace(track, inputs={**track.inputs, BOX: np.array(of_rows, float)})

    return tracks.map(with_boxes)


def associated(
    columns: Mapping[str, NDArray[Any]], number: NDArray[np.int64], boxes: Sequence[PersonBox]
) -> TrackSet:
    """Associate detections to tracks; each row has the number of its box as an input.

    Parameters
    ----------
    columns : as `perception.observe.detections.to_detections` makes them
    number : (n,) of each row's box
    boxes : that were looked at

    Raises
    ------
    InputError
        If no track is left.
    """
    of_box = {item.track_id: k for k, item in enumerate(boxes)}
    found = associate({**columns, f"input_{BOX}": np.array([of_box[k] for k in number.tolist()], float)})
    if not len(found):
        raise InputError("detections that are all taken for false", "people who are seen for a while")
    return found


def estimated(
    tracks: TrackSet,
    camera: GroundCamera,
    method: str,
    advance: Callable[[int], None],
    adapted: Callable[[Model], Model] = lambda model: model,
) -> tuple[TrackSet, list[str]]:
    """Where everybody is, how they move and point, and what is to be said of it.

    Parameters
    ----------
    tracks : of observations
    camera : over the ground
    method : one of `METHODS`
    advance : is told of person-frames that are done
    adapted : makes of a model that of the camera, as `CameraModels.graph`

    Raises
    ------
    InputError
        If nobody's track can be estimated.
    """
    chosen = make_method(method, adapted(own_model(method)))
    placed = replace(tracks, camera=camera)
    said: list[str] = []
    if method == "smoother":
        model = adapted(Model.named(None))
        found = solve_tracks(placed, model, engine_of(model), progress=advance)
        good = [result.track for result in found if isinstance(result, Solution)]
        bad = [one for one in found if not isinstance(one, Solution)]
        said += [f"track {one.track_id} is left out: {one.reason}" for one in bad]
    else:
        good = []
        for track in placed:
            good.append(chosen.estimate(track, camera))
            advance(len(track))
    if not good:
        raise InputError("no track that can be estimated", "people who are seen for a while")
    return placed.with_tracks(good), [f"estimates by `{method}`: {chosen.information}", *said]
