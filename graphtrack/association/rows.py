"""Rows without identities, as readers make them, become rows of tracks."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np

from graphtrack.association.offline import APPEARANCE, associate_detections, repair_detections
from graphtrack.errors import InputError
from graphtrack.gaps import with_rows
from graphtrack.geometry.angles import FloatArray
from graphtrack.scene import GivenScene, SceneParameters, known_values
from graphtrack.table.detections import Detections, frames_between
from graphtrack.table.rows import Rows
from graphtrack.tracks import Track, TrackSet

FALSE = "taken for false detections"
NOWHERE = "detections without a position"
REPEATED = "at the place of another of the same frame"

_ALONG = (
    "position_std",
    "score",
    "body",
    "head",
    "body_likelihood",
    "head_likelihood",
    APPEARANCE,
)
"""Channels that the evidence reads beside the position."""


def associated(rows: Rows, scene: GivenScene = None, *, repair: bool = False) -> TrackSet:
    """The tracks that rows of detections belong to, with a row for each frame from first to last.

    Parameters
    ----------
    scene : its parameters that are known; the others are learned
    repair : the rows are a tracker's, whose identities are kept but where the evidence is against them
    """
    known = known_values(scene)
    found = with_repaired_identities(rows, known) if repair else with_identities(rows, known)
    return with_every_frame(TrackSet.from_rows(found), SceneParameters(**known).longest_filled)


def with_identities(rows: Rows, scene: GivenScene = None) -> Rows:
    """The rows of detections with the identities that are most probable; false ones are left out.

    Parameters
    ----------
    rows : on the ground, with times; their own identities do not matter
    scene : its parameters that are known; the others are learned
    """
    rows, detections = detections_of(rows)
    found = associate_detections(detections, scene)
    identity, probability = np.empty(len(rows), np.int64), np.empty(len(rows))
    identity[detections.row], probability[detections.row] = found.identity, found.probability
    people, false = int(identity.max()) + 1, int((identity < 0).sum())
    as_read = None if rows.as_read is None else rows.as_read.without_identities()
    rows = replace(rows, track_id=identity + 1, has_identity=True, labels={}, as_read=as_read)
    # Nobody knows better how noisy they are than who saw them follow each other.
    std = rows.channels.get("position_std", np.full(len(rows), np.nan))
    std = np.where(np.isnan(std), found.scene.position_std, std)
    rows = rows.with_channels(identity_p=probability, observed=np.ones(len(rows)), position_std=std)
    note = f"associated {len(rows)} detections: {people} people; {false} {FALSE}"
    return rows.keep(identity >= 0, FALSE).with_notes(note)


def with_repaired_identities(rows: Rows, scene: GivenScene = None) -> Rows:
    """The rows of a tracker, parted where it jumped from one person to another, and joined where it lost one.

    Parameters
    ----------
    rows : on the ground, with times and identities; those with the identity −1 have none
    scene : its parameters that are known; the others are learned
    """
    # Who is joined of two tracks need not stand in the order of frames.
    rows, detections = detections_of(rows.taken(np.argsort(rows.frame, kind="stable")))
    known, place = np.unique(rows.track_id, return_inverse=True)
    given = np.where(rows.track_id == -1, -1, place)[detections.row]
    found = repair_detections(detections, given, scene)
    # New people get the numbers after the highest.
    names = np.concatenate([known, known.max() + 1 + np.arange(len(rows))])
    track_id, probability = np.empty(len(rows), np.int64), np.empty(len(rows))
    track_id[detections.row], probability[detections.row] = names[found.identity], found.probability
    moved = int((track_id != rows.track_id).sum())
    before, after = len(known[known != -1]), len(np.unique(track_id))
    labels = {one: rows.labels[one] for one in np.unique(track_id).tolist() if one in rows.labels}
    rows = replace(rows, track_id=track_id, has_identity=True, labels=labels)
    rows = rows.with_channels(identity_p=probability, observed=np.ones(len(rows)))
    return rows.with_notes(
        f"repaired {before} tracks: now {after}; {moved} of {len(rows)} rows changed hands"
    )


def usable(rows: Rows) -> Rows:
    """The rows that have a position; of those that say the same twice only the first.

    Raise InputError with the line, where times do not increase from frame to frame.
    """
    rows = rows.keep(np.asarray(np.isfinite(rows.channels["position"]).all(axis=1)), NOWHERE)
    if not len(rows):
        return rows
    _check_times(rows)
    said = np.column_stack([rows.frame, rows.channels["position"]])
    _, first = np.unique(said, axis=0, return_index=True)
    return rows.keep(np.isin(np.arange(len(rows)), first), REPEATED)


def _check_times(rows: Rows) -> None:
    t = rows.channels["t"]
    frame, first, place = np.unique(rows.frame, return_index=True, return_inverse=True)
    other = np.flatnonzero(t != t[first][place])
    if len(other):
        i = int(other[0])
        raise InputError(
            f"frame {rows.frame[i]} at t = {t[i]:g}",
            f"t = {t[first][place[i]]:g}, as in its other rows",
            path=rows.path,
            line=rows.line_of(i),
        )
    back = np.flatnonzero(np.diff(t[first]) <= 0.0)
    if len(back):
        i = int(first[back[0] + 1])
        raise InputError(
            f"frame {rows.frame[i]} at t = {t[i]:g}",
            f"a time after that of frame {frame[back[0]]}, {t[first[back[0]]]:g}",
            path=rows.path,
            line=rows.line_of(i),
        )


def detections_of(rows: Rows) -> tuple[Rows, Detections]:
    """The usable rows, and what the evidence reads of them."""
    rows = usable(rows)
    channels = {name: rows.channels[name] for name in _ALONG if name in rows.channels}
    return rows, Detections(rows.frame, rows.channels["t"], rows.channels["position"], channels)


def with_every_frame(tracks: TrackSet, longest_filled: float = SceneParameters.longest_filled) -> TrackSet:
    """Tracks with an empty row for each frame in which somebody was not seen, in gaps that are short.

    Parameters
    ----------
    longest_filled : seconds of a gap that is filled
    """
    frames, first = np.unique(np.concatenate([track.frame for track in tracks]), return_index=True)
    t = np.concatenate([track.t for track in tracks])[first]
    step = frames_between(frames)
    return tracks.map(lambda track: _filled(track, frames, t, step, longest_filled))


def _filled(track: Track, frames: np.ndarray, t: FloatArray, step: int, longest: float) -> Track:
    # Between two detections two steps apart somebody was hidden for one.
    short = np.diff(track.t) - np.diff(t).min() <= longest * (1.0 + 1e-9)
    gaps = [pair for pair, fill in zip(pairwise(track.frame.tolist()), short, strict=True) if fill]
    # Frames in which nobody at all was seen are none of the recording's: they lie a step apart.
    between = [np.arange(a, b, step) for a, b in gaps]
    inside = [frames[(frames > a) & (frames < b)] for a, b in gaps if b - a > step]
    frame = np.unique(np.concatenate([track.frame, *inside, *between]))
    times = np.interp(frame, frames, t)
    return with_rows(track, frame, times)
