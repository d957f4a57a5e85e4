"""Detections with an identity: positions on the ground or boxes in the image."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from graphtrack.display import counted
from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray
from graphtrack.io.cameras import NO_CAMERA
from graphtrack.table.rows import Rows
from graphtrack.tracks import Track, TrackSet

IntArray = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Detections:
    """Rows with an identity, n of them, by frame and within a frame by identity.

    Attributes
    ----------
    track_id, frame : (n,)
    place : (n, 2) metres on the ground, or (n, 4) left, top, width and height of a box in pixels; all finite
    missing : rows that were left out, because they have no place
    """

    track_id: IntArray
    frame: IntArray
    place: FloatArray
    missing: int = 0

    def __len__(self) -> int:
        return len(self.track_id)


def known_detections(track_id: IntArray, frame: IntArray, place: FloatArray) -> Detections:
    """The rows whose place (n, k) is known, in the order of `Detections`."""
    order = np.lexsort((track_id, frame))
    order = order[np.isfinite(place[order]).all(axis=1)]
    return Detections(track_id[order], frame[order], place[order], len(frame) - len(order))


def true_detections(tracks: TrackSet) -> Detections:
    """Detections of the truth: the true positions where any are known, else the positions.

    Raises
    ------
    InputError
            If nobody is anywhere, or positions rest on a guess.
    """
    _require_ground(tracks, "the truth")
    known = any(track.has_truth for track in tracks)
    found = _detections(tracks, "true_position" if known else "position")
    if not len(found):
        raise InputError("no position in the truth", "where people are, in one frame at least")
    return found


def estimated_detections(tracks: TrackSet) -> Detections:
    """Detections of the estimates: their positions.

    Raises
    ------
    InputError
        If those rest on a guess.
    """
    _require_ground(tracks, "the estimates")
    return _detections(tracks, "position")


def boxes(rows: Rows) -> Detections:
    """The boxes of a file that has any.

    Raises
    ------
    InputError
        If no row has a box.
    """
    found = known_detections(rows.track_id, rows.frame, rows.channels["box"])
    if not len(found):
        raise InputError("no boxes", "a box in one row at least", path=rows.path)
    return found


def missing_in_words(truth: Detections, estimates: Detections) -> tuple[str, ...]:
    """Numbers of rows that were left out, in words."""
    both = (("truth", truth), ("estimates", estimates))
    return tuple(
        f"{counted(of.missing, 'row')} of the {name} without a place: left out"
        for name, of in both
        if of.missing
    )


def _require_ground(tracks: TrackSet, side: str) -> None:
    """Refuse positions by a scale that a reader took from the boxes: it is another one for every file."""
    if any(note.startswith(NO_CAMERA) for note in tracks.summary.notes):
        raise InputError(
            f"no camera for {side}, whose positions are pixels",
            "a calibration or a homography, or iou to compare boxes in the image",
        )


def _detections(tracks: TrackSet, channel: str) -> Detections:
    if not len(tracks):
        none = np.empty(0, dtype=np.int64)
        return Detections(none, none, np.empty((0, 2)))
    return known_detections(
        np.repeat([track.track_id for track in tracks], [len(track) for track in tracks]),
        np.concatenate([track.frame for track in tracks]),
        np.concatenate([_places(track, channel) for track in tracks]),
    )


def _places(track: Track, channel: str) -> FloatArray:
    values: FloatArray | None = getattr(track, channel)
    return np.full((len(track), 2), np.nan) if values is None else values
