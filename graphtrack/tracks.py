"""`Track` and `TrackSet`: the one structure that flows through everything.

Observations and estimates share it. A track read from a file holds observations; a track that comes out of
a smoother holds estimates in the same fields, with ``velocity`` and ``covariance`` set.
"""

from __future__ import annotations

import fnmatch
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, fields, replace
from itertools import pairwise
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, overload

import numpy as np
from numpy.typing import NDArray

from graphtrack.bounds import (
    APPEARANCE,
    BODY_CLASSES,
    HEAD_CLASSES,
    INPUT,
    LARGEST_FRAME,
    LARGEST_ID,
    SHAPES,
    STATE,
    TEXT,
    is_text,
)
from graphtrack.channels import checked_channel, checked_inputs, input_of_size
from graphtrack.display import html_of_track, html_of_tracks, line_of_track, line_of_tracks, listed
from graphtrack.errors import InputError, UnknownTrackError
from graphtrack.geometry.angles import FloatArray
from graphtrack.table.as_read import AsRead, restored
from graphtrack.table.columns import rows_of_table, to_columns
from graphtrack.table.rows import Rows, check_identities, in_order
from graphtrack.table.speeds import with_speeds_checked
from graphtrack.table.summary import ReadSummary

if TYPE_CHECKING:
    import pandas as pd

    from graphtrack.geometry.camera import GroundCamera

__all__ = ["BODY_CLASSES", "HEAD_CLASSES", "STATE", "ReadSummary", "Track", "TrackSet"]

_ABSENT = dict.fromkeys(SHAPES)
_KEPT = {"t", "identity_p", "observed", "true_position", "true_body", "true_head"}
"""What estimates leave of a track that was observed."""
_NOT_KEPT = dict.fromkeys(SHAPES.keys() - _KEPT)


@dataclass(frozen=True, eq=False)
class Track:
    """One person over n frames. NaN is a missing value; ``None`` a channel that is absent altogether.

    Attributes
    ----------
    track_id : within ±`LARGEST_ID`
    frame : (n,) int64, strictly increasing
    t : (n,) seconds, strictly increasing
    position : (n, 2) metres on the ground plane
    position_std : (n,) metres, the 1-σ of each axis of ``position``; NaN: the model's default
    pixel : (n, 2) foot point (u, v) in the image, y down
    body, head : (n,) radians, orientation in the world
    body_kappa, head_kappa : (n,) von Mises concentration of ``body`` and ``head``; NaN: the model's default
    body_likelihood : (n, 8), head_likelihood : (n, 12)
        Class likelihoods; class k is centred on 360·k/n degrees. A row is all finite or all NaN.
    score : (n,) how sure the detector was, from 0 on; what it means is the detector's own
    identity_p : (n,) probability that this is whom the track had before, where identities were associated;
        NaN: not observed
    observed : (n,) 1 where the frame was observed, 0 where association left a gap
    velocity : (n, 2) metres a second (estimates)
    covariance : (n, 6, 6) in the order of `STATE` (estimates); NaN where a quantity was not estimated
    aligned_p : (n,) probability that the body faces where the motion goes (estimates)
    gait_offset : (n,) radians from the direction of motion to the body, as expected (estimates)
    glance_p : (n,) probability that the head glances aside (estimates)
    true_position, true_body, true_head : the truth, where it is known
    label : a name for people to read, such as the clip
    inputs : name → (n,) or (n, k) what else is known in each frame and a term of the model reads, such as a
        group's centre or a distance; a row is all finite or all NaN. Estimates keep them, but for
        ``appearance`` (n, k), what a detection looks like, with which identities are associated.
    """

    track_id: int
    frame: NDArray[np.int64]
    t: FloatArray
    position: FloatArray
    position_std: FloatArray | None = None
    pixel: FloatArray | None = None
    body: FloatArray | None = None
    body_kappa: FloatArray | None = None
    head: FloatArray | None = None
    head_kappa: FloatArray | None = None
    body_likelihood: FloatArray | None = None
    head_likelihood: FloatArray | None = None
    score: FloatArray | None = None
    identity_p: FloatArray | None = None
    observed: FloatArray | None = None
    velocity: FloatArray | None = None
    covariance: FloatArray | None = None
    aligned_p: FloatArray | None = None
    gait_offset: FloatArray | None = None
    glance_p: FloatArray | None = None
    true_position: FloatArray | None = None
    true_body: FloatArray | None = None
    true_head: FloatArray | None = None
    label: str = ""
    inputs: Mapping[str, FloatArray] = field(default_factory=dict)

    def __post_init__(self) -> None:
        is_whole = isinstance(self.track_id, int | np.integer) and not isinstance(self.track_id, bool)
        if not is_whole or abs(int(self.track_id)) > LARGEST_ID:
            raise InputError(f"track_id {self.track_id!r}", f"a whole number within ±{LARGEST_ID}")
        if not is_text(self.label):
            raise InputError(f"label {self.label!r} of track {self.track_id}", TEXT)
        frame = np.asarray(self.frame)
        if frame.ndim != 1 or frame.size == 0 or not np.issubdtype(frame.dtype, np.integer):
            raise InputError(
                f"frames of shape {frame.shape} and type {frame.dtype}",
                f"a non-empty one-dimensional integer array for track {self.track_id}",
            )
        if np.abs(frame).max() > LARGEST_FRAME:
            raise InputError(
                f"frame {frame[np.abs(frame).argmax()]} of track {self.track_id}",
                f"whole numbers within ±{LARGEST_FRAME}",
            )
        self._set("frame", frame.astype(np.int64))
        for name, tail in SHAPES.items():
            value = getattr(self, name)
            if value is None:
                continue
            self._set(name, checked_channel(name, value, (len(frame), *tail), self))
        object.__setattr__(self, "inputs", checked_inputs(self))
        if np.any(np.diff(self.frame) <= 0):
            raise InputError(
                "frames that do not increase", f"each frame once, in order, in track {self.track_id}"
            )
        if not np.all(np.isfinite(self.t)) or np.any(np.diff(self.t) <= 0):
            raise InputError("times that do not increase", f"strictly increasing t in track {self.track_id}")

    @classmethod
    def _trusted(
        cls,
        track_id: int,
        frame: NDArray[np.int64],
        channels: Mapping[str, FloatArray | None],
        label: str = "",
        inputs: Mapping[str, FloatArray] = MappingProxyType({}),
    ) -> Track:
        """A track of arrays that are as the attributes say; they become read-only.

        They are neither checked nor copied: for thousands of tracks that would take as long as to read them,
        and longer than to smooth them. For readers, who have checked a file as a whole, and for engines.
        """
        track = object.__new__(cls)
        vars(track).update(track_id=track_id, frame=frame, label=label, inputs=dict(inputs), **_ABSENT)
        vars(track).update(channels)
        for value in (frame, *channels.values(), *inputs.values()):
            if value is not None:
                value.setflags(write=False)
        return track

    def __repr__(self) -> str:
        return line_of_track(self)

    def _repr_html_(self) -> str:
        return html_of_track(self)

    def _set(self, name: str, value: NDArray[Any]) -> None:
        value.setflags(write=False)
        object.__setattr__(self, name, value)

    def __len__(self) -> int:
        return len(self.frame)

    @property
    def dt(self) -> FloatArray:
        """(n,) seconds since the frame before; 0 at the first."""
        return np.diff(self.t, prepend=self.t[:1])

    def __getitem__(self, index: slice | NDArray[Any]) -> Track:
        """The same person over some of the frames."""
        parts: dict[str, Any] = {
            f.name: getattr(self, f.name)[index]
            for f in fields(self)
            if isinstance(getattr(self, f.name), np.ndarray)
        }
        parts["inputs"] = {name: value[index] for name, value in self.inputs.items()}
        return replace(self, **parts)

    def input(self, name: str, *size: int) -> FloatArray:
        """One of the `inputs`, (n,) or (n, size), for a term that needs it so; NaN where the track lacks it.

        Raises
        ------
        InputError
            If the track has it in another size.
        """
        return input_of_size(self, name, size)

    def with_estimates(
        self,
        *,
        position: FloatArray,
        velocity: FloatArray,
        covariance: FloatArray,
        body: FloatArray | None = None,
        head: FloatArray | None = None,
        aligned_p: FloatArray | None = None,
        gait_offset: FloatArray | None = None,
        glance_p: FloatArray | None = None,
    ) -> Track:
        """The track with estimates in place of its observations; truth, label and inputs stay.

        What somebody looked like does not: it is of no use once identities are known.

        The arrays must be as the attributes say: they are neither checked nor copied.
        """
        estimates = {
            "position": position,
            "velocity": velocity,
            "body": body,
            "head": head,
            "covariance": covariance,
            "aligned_p": aligned_p,
            "gait_offset": gait_offset,
            "glance_p": glance_p,
        }
        for value in estimates.values():
            if value is not None:
                value.setflags(write=False)
        track = object.__new__(Track)
        attributes = vars(track)
        attributes.update(vars(self))
        attributes.update(_NOT_KEPT)
        attributes.update(estimates)
        attributes["inputs"] = {name: own for name, own in self.inputs.items() if name != APPEARANCE}
        return track

    def std(self, name: str) -> FloatArray | None:
        """1-σ of one quantity of `STATE` (metres, m/s or radians), (n,), or None without a covariance.

        Raises
        ------
        InputError
            For a name that is none of a quantity.
        """
        if name not in STATE:
            raise InputError(f"quantity {name!r}", f"one of {', '.join(STATE)}")
        if self.covariance is None:
            return None
        i = STATE.index(name)
        return np.sqrt(self.covariance[:, i, i])

    @property
    def has_truth(self) -> bool:
        """Whether the true positions are known."""
        return self.true_position is not None and bool(np.isfinite(self.true_position).any())


@dataclass(frozen=True, eq=False)
class TrackSet:
    """People of one scene: tracks with distinct ids, the camera if it is known, and the reading's summary.

    Of a table with other names and units than the native one ``as_read`` keeps them for what is written.
    """

    tracks: tuple[Track, ...]
    camera: GroundCamera | None = None
    summary: ReadSummary = field(default_factory=ReadSummary)
    as_read: AsRead | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "tracks", tuple(self.tracks))
        for one in self.tracks:
            if not isinstance(one, Track):
                raise InputError(f"a {type(one).__name__} among tracks", "a Track")
        ids = [track.track_id for track in self.tracks]
        if len(set(ids)) != len(ids):
            twice = next(i for i in ids if ids.count(i) > 1)
            raise InputError(f"track {twice} twice", "each track_id once")
        sizes: dict[str, tuple[int, ...]] = {}
        for track in self.tracks:
            for name, values in track.inputs.items():
                track.input(name, *sizes.setdefault(name, values.shape[1:]))

    def __repr__(self) -> str:
        return line_of_tracks(self)

    def _repr_html_(self) -> str:
        return html_of_tracks(self)

    def __iter__(self) -> Iterator[Track]:
        return iter(self.tracks)

    def __len__(self) -> int:
        return len(self.tracks)

    @overload
    def __getitem__(self, key: int) -> Track: ...
    @overload
    def __getitem__(self, key: slice) -> TrackSet: ...
    def __getitem__(self, key: int | slice) -> Track | TrackSet:
        """The track of an id; a slice stands for places: ``tracks[:2]`` are the first two, a set."""
        if isinstance(key, slice):
            return self.with_tracks(self.tracks[key])
        for track in self.tracks:
            if track.track_id == key:
                return track
        known = listed(track.track_id for track in self.tracks)
        raise UnknownTrackError(f"no track {key!r}", f"one of the ids {known}" if known else "a track")

    @property
    def n_frames(self) -> int:
        """Person-frames: the sum of the tracks' lengths."""
        return sum(len(track) for track in self.tracks)

    def with_tracks(self, tracks: Iterable[Track]) -> TrackSet:
        """The same scene with other tracks."""
        return replace(self, tracks=tuple(tracks))

    def map(self, function: Callable[[Track], Track]) -> TrackSet:
        """Apply a function to every track."""
        return self.with_tracks(function(track) for track in self.tracks)

    def select(self, *patterns: str) -> TrackSet:
        """The tracks whose label or id matches one of the shell patterns (``*walk*``, ``17``)."""
        return self.with_tracks(
            track
            for track in self.tracks
            if any(fnmatch.fnmatchcase(track.label, p) or str(track.track_id) == p for p in patterns)
        )

    def to_table(self, *, as_read: bool = False) -> pd.DataFrame:
        """One row per person and frame, with the columns of the native format (degrees in ``*_deg``).

        Parameters
        ----------
        as_read : columns have the names and units of the table that was read, where it had others
        """
        import pandas as pd

        return pd.DataFrame(restored(to_columns(self), self.as_read if as_read else None))

    @classmethod
    def from_table(cls, table: pd.DataFrame | Mapping[str, Any], *, fps: float | None = None) -> TrackSet:
        """Tracks from a table with the columns of the native format; a missing cell is a missing observation.

        Parameters
        ----------
        table : a DataFrame, or name → column. Dates and times in ``t`` become seconds since 1970, UTC; the
            summary's notes say so.
        fps : frames a second, for a table without ``t``

        Raises
        ------
        InputError
            Naming the row (from 1) and column that cannot be used.
        """
        rows = rows_of_table(table, fps)
        check_identities(rows)
        return with_speeds_checked(cls.from_rows(rows), Path("table"))

    @classmethod
    def from_rows(cls, rows: Rows) -> TrackSet:
        """Tracks from the rows that a reader made of its file.

        Raises
        ------
        InputError, and a warning
            As `in_order`.
        """
        rows = in_order(rows)
        ids = rows.track_id
        edges = np.flatnonzero(np.diff(ids, prepend=ids[0] - 1, append=ids[-1] + 1)).tolist()
        # A channel that is missing throughout a track is absent: engines ask for None, not for all-NaN.
        known = {
            name: np.logical_or.reduceat(~np.isnan(values).reshape(len(rows), -1).all(axis=1), edges[:-1])
            for name, values in rows.channels.items()
            if name != "position"
        }
        tracks = []
        for k, (start, stop) in enumerate(pairwise(edges)):
            channels = {
                name: values[start:stop]
                for name, values in rows.channels.items()
                if name == "position" or known[name][k]
            }
            identity = int(ids[start])
            label = rows.labels.get(identity, "")
            given = [name for name in channels if name.startswith(INPUT)]
            inputs = {name.removeprefix(INPUT): channels.pop(name) for name in given}
            tracks.append(Track._trusted(identity, rows.frame[start:stop], channels, label, inputs))
        summary = ReadSummary(rows.format, rows.n_read, dict(rows.refused), rows.notes)
        return cls(tuple(tracks), rows.camera, summary, rows.as_read)
