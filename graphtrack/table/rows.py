"""Rows of observations: what a reader makes of its file, and what is checked before they are tracks."""

from __future__ import annotations

import warnings
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from graphtrack.bounds import bounds_of, out_of_bounds
from graphtrack.errors import InputError, InputWarning
from graphtrack.geometry.angles import FloatArray
from graphtrack.geometry.camera import GroundCamera
from graphtrack.table.as_read import AsRead


@dataclass(frozen=True, eq=False)
class Rows:
    """The rows of one file, n of them, still in its order.

    Attributes
    ----------
    path, format : where they come from
    track_id, frame : (n,) int64
    channels : `Track` attribute → (n, ...) in the units of `Track`; ``t`` and ``position`` must be among them
        when they become tracks. A track's input is the channel ``input_<name>``
    line_of : row number → line in the file
    labels : track id → label
    camera : the camera that made the positions, if any
    refused : reason → number of rows left out so far
    notes : what was assumed or repaired, one sentence each
    has_identity : False: the file does not say of whom a row is, and ``track_id`` is −1 throughout
    as_read : names and units of a table that has others than the native one
    """

    path: Path
    format: str
    track_id: NDArray[np.int64]
    frame: NDArray[np.int64]
    channels: Mapping[str, FloatArray]
    line_of: Callable[[int], int]
    labels: Mapping[int, str] = field(default_factory=dict)
    camera: GroundCamera | None = None
    refused: Mapping[str, int] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    has_identity: bool = True
    as_read: AsRead | None = None

    def __len__(self) -> int:
        return len(self.track_id)

    @property
    def n_read(self) -> int:
        """Rows of the file, those that were refused among them."""
        return len(self) + sum(self.refused.values())

    def with_channels(self, **channels: FloatArray) -> Rows:
        """The same rows with channels added or replaced."""
        return replace(self, channels={**self.channels, **channels})

    def without(self, *names: str) -> Rows:
        """The same rows without these channels."""
        return replace(self, channels={k: v for k, v in self.channels.items() if k not in names})

    def with_camera(self, camera: GroundCamera | None) -> Rows:
        """The same rows seen by that camera."""
        return replace(self, camera=camera)

    def with_notes(self, *notes: str) -> Rows:
        """The same rows with more notes."""
        return replace(self, notes=(*self.notes, *notes))

    def keep(self, mask: NDArray[np.bool_], reason: str) -> Rows:
        """The rows where the mask holds; the others are counted as refused for the reason."""
        count = int(len(self) - mask.sum())
        if not count:
            return self
        refused = dict(Counter(self.refused) + Counter({reason: count}))
        return replace(self.taken(np.flatnonzero(mask)), refused=refused)

    def taken(self, places: NDArray[np.int64]) -> Rows:
        """The rows at some places, in that order."""
        line_of = self.line_of
        return replace(
            self,
            track_id=self.track_id[places],
            frame=self.frame[places],
            channels={name: value[places] for name, value in self.channels.items()},
            line_of=lambda i: line_of(int(places[i])),
        )

    def with_times(self, fps: float) -> Rows:
        """Times from the frame numbers at ``fps`` frames a second."""
        return self.with_channels(t=self.frame / fps)


def in_order(rows: Rows) -> Rows:
    """The rows by track and, of each track, by frame.

    Warns
    -----
    InputWarning
        If frames had to be sorted; the notes say so too.
    """
    check_rows(rows)
    unsorted_tracks = _unsorted(rows)
    if unsorted_tracks:
        note = f"the frames of {unsorted_tracks} of the tracks were out of order and have been sorted"
        rows = rows.with_notes(note)
        warnings.warn(f"{rows.path}: {note}", InputWarning, stacklevel=2)
    order = np.lexsort((rows.frame, rows.track_id))
    rows = rows.taken(order)
    late = (np.diff(rows.track_id) == 0) & (np.diff(rows.channels["t"]) <= 0.0)
    if late.any():
        # The first of them in the file.
        i = min((np.flatnonzero(late) + 1).tolist(), key=lambda i: order[i])
        raise InputError(
            f"t = {rows.channels['t'][i]:g} in frame {rows.frame[i]} of track {rows.track_id[i]}",
            "a time after that of the frame before",
            path=rows.path,
            line=rows.line_of(i),
            column="t",
        )
    for name, values in rows.channels.items():
        place = bounds_of(name).first_outside(values)
        if place is not None:
            i = place[0]
            at = {"path": rows.path, "line": rows.line_of(i)}
            raise out_of_bounds(name, values[place], int(rows.frame[i]), int(rows.track_id[i]), **at)
    return rows


def no_camera(rows: Rows) -> InputError:
    """The error for rows that have only pixels, where nothing brings them to the ground."""
    expected = "x, y, or a homography or point pairs as well"
    return InputError("pixels u, v and no camera", expected, path=rows.path)


def check_identities(rows: Rows) -> None:
    """Raise InputError for rows that do not say of whom they are."""
    if not rows.has_identity:
        raise InputError(
            "rows without identities",
            "a track_id for each (--columns id=…); smooth --associate and gt.associate find it out",
            path=rows.path,
            line=rows.line_of(0) if len(rows) else None,
        )


def check_rows(rows: Rows) -> None:
    """Refuse a file of which no row is left, some have no identity, or two are of one track in one frame."""
    if not len(rows):
        reasons = "; ".join(f"{count} {reason}" for reason, count in rows.refused.items())
        found = f"no usable row ({reasons} refused)" if reasons else "no rows"
        raise InputError(found, "at least one row", path=rows.path)
    nobody = np.flatnonzero(rows.track_id == -1)
    if 0 < len(nobody) < len(rows):
        raise InputError(
            f"a row without an identity (−1), which {len(rows) - len(nobody)} others have",
            "one for each row, or none; with --associate always they are forgotten, with repair kept",
            path=rows.path,
            line=rows.line_of(int(nobody[0])),
        )
    order = np.lexsort((rows.frame, rows.track_id))
    twice = (np.diff(rows.track_id[order]) == 0) & (np.diff(rows.frame[order]) == 0)
    if twice.any():
        later = order[np.flatnonzero(twice) + 1]
        i = int(later.min())
        raise InputError(
            f"track {rows.track_id[i]} again in frame {rows.frame[i]}",
            "each track once a frame",
            path=rows.path,
            line=rows.line_of(i),
        )


def _unsorted(rows: Rows) -> int:
    """Number of tracks with a frame that comes after a later one in the file."""
    order = np.argsort(rows.track_id, kind="stable")
    track_id, frame = rows.track_id[order], rows.frame[order]
    back = (np.diff(track_id) == 0) & (np.diff(frame) < 0)
    return len(np.unique(track_id[1:][back]))
