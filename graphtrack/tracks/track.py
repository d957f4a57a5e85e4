"""`Track` and `TrackSet`: the data structure of observations and estimates.

A track read from a file holds observations; a track returned by a smoother holds estimates in the same
fields, with ``velocity`` and ``covariance`` set.
"""

from __future__ import annotations

import fnmatch
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from operator import index
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, overload

import numpy as np
from numpy.typing import NDArray

from graphtrack.errors import InputError, InputWarning, TrackIndexError, UnknownTrackError
from graphtrack.geometry.angles import FloatArray, direction, unit, vectors_of
from graphtrack.geometry.planar import half_width, heading_half_width, is_moving, speed_interval, speed_std
from graphtrack.tracks.cells import rows_of_table
from graphtrack.tracks.display import LONGEST, MOST, counted, html_table, listed, shortened
from graphtrack.tracks.schema import (
    COLUMNS,
    ENDS,
    INPUT_NAME,
    INTERVALS,
    LARGEST_CORRELATION,
    Column,
    input_columns,
    is_input_name,
    numeric,
)
from graphtrack.tracks.schema import in_order as columns_in_order
from graphtrack.tracks.table import (
    AsRead,
    ReadSummary,
    Rows,
    check_identities,
    identity_names,
    name_of,
    restored,
    sorted_rows,
)
from graphtrack.tracks.validation import (
    APPEARANCE,
    BODY_CLASSES,
    HEAD_CLASSES,
    INPUT,
    LARGEST_FRAME,
    LARGEST_ID,
    SENSOR_NAME,
    SHAPES,
    STATE,
    TEXT,
    Speeds,
    bounds_of,
    finite_rows,
    is_sensor_name,
    is_text,
    out_of_bounds,
    real_numbers,
)

if TYPE_CHECKING:
    import pandas as pd

    from graphtrack.geometry.camera import GroundCamera
from graphtrack.geometry.conventions import AngleConvention, converted

__all__ = ["BODY_CLASSES", "HEAD_CLASSES", "STATE", "ReadSummary", "Track", "TrackSet", "to_columns"]

_PLACE = "an index from 0 to one less than that (by_id takes an id)"

_ABSENT = dict.fromkeys(SHAPES)
_KEPT = {"t", "identity_p", "observed", "true_position", "true_body", "true_head"}
"""Channels that estimates do not replace."""
_NOT_KEPT = dict.fromkeys(SHAPES.keys() - _KEPT)


@dataclass(frozen=True, eq=False)
class Track:
    """One person over n frames. NaN is a missing value; ``None`` an absent channel.

    Attributes
    ----------
    track_id : within ±`LARGEST_ID`
    frame : (n,) int64, strictly increasing; of several sensors in any order, each may count its own
    t : (n,) seconds, strictly increasing; rows of several sensors may have the same time
    position : (n, 2) metres on the ground plane
    position_std : (n,) metres, the 1-σ of each axis of ``position``; NaN: the model's default
    position_covariance : (n, 2, 2) m², of ``position``, in place of ``position_std``
    pixel : (n, 2) foot point (u, v) in the image, y down
    observed_velocity, observed_velocity_covariance : (n, 2) m/s and (n, 2, 2) m²/s², such as of a radar; NaN:
        the model's default
    body, head : (n,) radians, orientation in the world
    body_axis : (n,) radians, orientation of the body up to a half turn, such as of a box or a shoulder line;
        ``body_axis_kappa`` (n,) the concentration about either end; NaN: the model's ``body_kappa``
    body_kappa, head_kappa : (n,) von Mises concentration of ``body`` and ``head``; NaN: the model's default
    body_likelihood : (n, 8), head_likelihood : (n, 12)
        Class likelihoods; class k is centred on 360·k/n degrees. A row is all finite or all NaN.
    score : (n,) the detector's confidence, from 0 on, in the detector's scale
    identity_p : (n,) probability that this is the same person as before in the track, where identities were
        associated; NaN: not observed
    observed : (n,) 1 where the frame was observed, 0 where association left a gap
    velocity : (n, 2) metres a second (estimates)
    covariance : (n, 6, 6) in the order of `STATE` (estimates); NaN where a quantity was not estimated, and
        where a correlation is unknown: tables have deviations alone
    true_position, true_body, true_head : the truth, where it is known
    sensor : (n,) text, the name of each row's sensor, "" without one
    label : a readable name, such as the clip
    inputs : name → (n,) or (n, k) further known values in each frame that a term of the model reads, such as
        a group's centre or a distance; a row is all finite or all NaN. Estimates keep them, except
        ``appearance`` (n, k), a detection's descriptor for data association.
    """

    track_id: int
    frame: NDArray[np.int64]
    t: FloatArray
    position: FloatArray
    position_std: FloatArray | None = None
    position_covariance: FloatArray | None = None
    pixel: FloatArray | None = None
    observed_velocity: FloatArray | None = None
    observed_velocity_covariance: FloatArray | None = None
    body: FloatArray | None = None
    body_kappa: FloatArray | None = None
    body_axis: FloatArray | None = None
    body_axis_kappa: FloatArray | None = None
    head: FloatArray | None = None
    head_kappa: FloatArray | None = None
    body_likelihood: FloatArray | None = None
    head_likelihood: FloatArray | None = None
    score: FloatArray | None = None
    identity_p: FloatArray | None = None
    observed: FloatArray | None = None
    velocity: FloatArray | None = None
    covariance: FloatArray | None = None
    true_position: FloatArray | None = None
    true_body: FloatArray | None = None
    true_head: FloatArray | None = None
    sensor: NDArray[np.str_] | None = None
    label: str = ""
    inputs: Mapping[str, FloatArray] = field(default_factory=dict)

    def __post_init__(self) -> None:
        is_integer = isinstance(self.track_id, int | np.integer) and not isinstance(self.track_id, bool)
        if not is_integer or abs(int(self.track_id)) > LARGEST_ID:
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
            self._set(name, self._checked(name, value, (len(frame), *tail)))
        object.__setattr__(self, "inputs", self._checked_inputs())
        for name in ("position_covariance", "observed_velocity_covariance"):
            self._check_definite(name)
        if self.sensor is not None:
            self._check_sensors()
            return
        if np.any(np.diff(self.frame) <= 0):
            raise InputError(
                "frames that do not increase", f"each frame once, in order, in track {self.track_id}"
            )
        if not np.all(np.isfinite(self.t)) or np.any(np.diff(self.t) <= 0):
            raise InputError("times that do not increase", f"strictly increasing t in track {self.track_id}")

    def _check_definite(self, name: str) -> None:
        """Check that the covariances (n, 2, 2) of a channel are positive definite, or NaN."""
        value = getattr(self, name)
        if value is None:
            return
        a, b = value[:, 0, 0], value[:, 1, 1]
        largest = LARGEST_CORRELATION * np.sqrt(np.maximum(a * b, 0.0)) * (1.0 + 1e-12)
        alike = np.isclose(value[:, 0, 1], value[:, 1, 0], rtol=1e-9, atol=0.0)
        fine = (a > 0.0) & (b > 0.0) & alike & (np.abs(value[:, 0, 1]) <= largest)
        if not np.all(fine | np.isnan(value).all(axis=(1, 2))):
            frame = self.frame[~fine & ~np.isnan(value).all(axis=(1, 2))][0]
            found = f"{name} in frame {frame} of track {self.track_id}"
            raise InputError(found, "a symmetric, positive definite matrix, or NaN")

    def _check_sensors(self) -> None:
        """Check names, and times that increase for each sensor."""
        names = np.array(self.sensor, dtype=str)
        wrong = next((name for name in np.unique(names).tolist() if not is_sensor_name(name)), None)
        if names.shape != self.frame.shape or wrong is not None:
            found = f"sensors of shape {names.shape}" if wrong is None else f"the sensor {wrong[:40]!r}"
            expected = f"shape {self.frame.shape}" if wrong is None else SENSOR_NAME
            raise InputError(f"{found} in track {self.track_id}", expected)
        self._set("sensor", names)
        again = (np.diff(self.t) == 0.0) & (names[1:] <= names[:-1])
        if not np.all(np.isfinite(self.t)) or np.any(np.diff(self.t) < 0.0) or again.any():
            expected = f"t in order, and each sensor once at a time, by name, in track {self.track_id}"
            raise InputError("times that do not increase", expected)

    @classmethod
    def _trusted(
        cls,
        track_id: int,
        frame: NDArray[np.int64],
        channels: Mapping[str, FloatArray | None],
        label: str = "",
        inputs: Mapping[str, FloatArray] = MappingProxyType({}),
        sensor: NDArray[np.str_] | None = None,
    ) -> Track:
        """Return a track of valid arrays, which become read-only."""
        # Neither checked nor copied: for thousands of tracks that would take longer than smoothing.
        track = object.__new__(cls)
        vars(track).update(
            track_id=track_id, frame=frame, label=label, inputs=dict(inputs), sensor=sensor, **_ABSENT
        )
        vars(track).update(channels)
        for value in (frame, *channels.values(), *inputs.values()):
            if value is not None:
                value.setflags(write=False)
        return track

    def _checked(self, name: str, given: Any, shape: tuple[int, ...]) -> FloatArray:
        """Return a copy of a channel's values, checked for shape and bounds."""
        try:
            value = real_numbers(given)
        except (TypeError, ValueError) as error:
            found = f"{name} of track {self.track_id} that is no array of numbers ({error})"
            raise InputError(found, f"shape {shape}") from error
        if value.shape != shape:
            what = ": x and y in metres" if name == "position" else ""
            raise InputError(
                f"{name} of shape {value.shape} in track {self.track_id}", f"shape {shape}{what}"
            )
        place = bounds_of(name).first_outside(value)
        if place is not None:
            raise out_of_bounds(name, value[place], self.frame[place[0]], f"track {self.track_id}")
        return value

    def _checked_inputs(self) -> dict[str, FloatArray]:
        """Return read-only copies of the inputs: rows are all finite or all NaN."""
        n, found = len(self.frame), {}
        for name, given in self.inputs.items():
            if not isinstance(name, str) or not is_input_name(name):
                raise InputError(f"an input {name!r} of track {self.track_id}", INPUT_NAME)
            try:
                size = np.shape(given)[1:2]
            except ValueError:  # rows of different lengths, which `_checked` refuses
                size = ()
            value = self._checked(f"{INPUT}{name}", given, (n, *size))
            missing = np.isnan(value).reshape(n, -1)
            partial = missing.any(axis=1) & ~missing.all(axis=1)
            if not value.size or partial.any():
                place = f"in frame {self.frame[partial.argmax()]}" if value.size else "without a number"
                expected = "rows that are all finite or all NaN, of one number at least"
                raise InputError(f"input {name!r} of track {self.track_id} {place}", expected)
            value.setflags(write=False)
            found[name] = value
        return found

    def __repr__(self) -> str:
        label = [shortened(self.label)] if self.label else []
        parts = [str(self.track_id), *label, counted(len(self), "frame"), _contents([self])]
        return f"Track({', '.join(parts)})"

    def _repr_html_(self) -> str:
        rows = []
        for name in ("position", "pixel", "body", "body_likelihood", "head", "head_likelihood", "velocity"):
            values = getattr(self, name)
            if values is not None:
                rows.append((name, _n_known(values)))
        return html_table(repr(self), ("channel", f"of {counted(len(self), 'frame')}"), rows)

    def _set(self, name: str, value: NDArray[Any]) -> None:
        value.setflags(write=False)
        object.__setattr__(self, name, value)

    def __len__(self) -> int:
        return len(self.frame)

    @property
    def dt(self) -> FloatArray:
        """Return (n,) seconds since the previous frame; 0 at the first."""
        return np.diff(self.t, prepend=self.t[:1])

    def __getitem__(self, index: slice | NDArray[Any]) -> Track:
        """Return the track at some of the frames; InputError for a single index."""
        if isinstance(index, int | np.integer):
            raise InputError(f"track[{index}]", f"frames, such as track[{index}:{int(index) + 1}]")
        parts: dict[str, Any] = {
            name: value[index] for name, value in vars(self).items() if isinstance(value, np.ndarray)
        }
        parts["inputs"] = {name: value[index] for name, value in self.inputs.items()}
        if isinstance(index, slice) and len(parts["t"]) and (index.step is None or index.step > 0):
            # The rows of a valid track, in order, are valid: checking them takes a millisecond.
            track = object.__new__(Track)
            vars(track).update({**vars(self), **parts})
            return track
        return replace(self, **parts)

    def input(self, name: str, *size: int) -> FloatArray:
        """Return one of the `inputs`, (n,) or (n, size), as a term requires; NaN where the track lacks it.

        Raises
        ------
        InputError
            If the track has it in another size.
        """
        value = self.inputs.get(name)
        if value is None:
            return np.full((len(self), *size), np.nan)
        if value.shape[1:] != size:
            has, wanted = (f"{one[0]} numbers" if one else "one number" for one in (value.shape[1:], size))
            raise InputError(f"input {name!r} of {has} a frame in track {self.track_id}", wanted)
        return value

    def with_estimates(
        self,
        *,
        position: FloatArray,
        velocity: FloatArray,
        covariance: FloatArray,
        body: FloatArray | None = None,
        head: FloatArray | None = None,
    ) -> Track:
        """Return the track with estimates in place of its observations; truth, label and inputs are kept.

        Appearance is dropped, since identities are known.

        The arrays must be valid: they are neither checked nor copied.
        """
        estimates = {
            "position": position,
            "velocity": velocity,
            "body": body,
            "head": head,
            "covariance": covariance,
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

    def std(self, name: str) -> FloatArray:
        """Return 1-σ of one quantity of `STATE` (metres, m/s or radians), (n,); NaN without a covariance.

        Raises
        ------
        InputError
            For an unknown quantity.
        """
        if name not in STATE:
            raise InputError(f"quantity {name!r}", f"one of {', '.join(STATE)}")
        if self.covariance is None:
            return np.full(len(self), np.nan)
        i = STATE.index(name)
        return np.sqrt(self.covariance[:, i, i])

    @property
    def speed(self) -> FloatArray:
        """Return the speed (n,) of the estimated velocity, m/s; NaN without one."""
        return np.full(len(self), np.nan) if self.velocity is None else np.hypot(*self.velocity.T)

    @property
    def heading(self) -> FloatArray:
        """Return the direction of travel (n,) of the estimated velocity, radians; NaN where there is none."""
        return np.full(len(self), np.nan) if self.velocity is None else direction(self.velocity)

    @property
    def speed_std(self) -> FloatArray:
        """Return half the width (n,) of the interval that contains the speed with 68.3 %, m/s."""
        if self.velocity is None:
            return np.full(len(self), np.nan)
        return speed_std(*self._motion(self.velocity))

    def interval(self, name: str, probability: float = 0.95) -> tuple[FloatArray, FloatArray]:
        """Return the ends (n,) of the interval that contains a quantity; NaN without a covariance.

        Parameters
        ----------
        name : one of `STATE`, ``speed`` or ``heading``. Ends of angles are on either side of the angle and
            may be beyond ±π
        probability : between 0 and 1

        Returns
        -------
        low, high : (n,) metres, m/s or radians

        Raises
        ------
        InputError
            For an unknown quantity, or another probability.
        """
        if not 0.0 < probability < 1.0:
            raise InputError(f"probability {probability!r}", "a number between 0 and 1")
        if name not in ("speed", "heading"):
            half: FloatArray = self.std(name) * half_width(probability)
            value = {"x": self.position[:, 0], "y": self.position[:, 1], "body": self.body, "head": self.head}
            if self.velocity is not None:
                value |= {"vx": self.velocity[:, 0], "vy": self.velocity[:, 1]}
            middle = value.get(name)
        elif self.velocity is None:
            middle = None
        elif name == "speed":
            return speed_interval(*self._motion(self.velocity), probability)
        else:
            middle, half = self.heading, heading_half_width(*self._motion(self.velocity), probability)
        if middle is None:
            return np.full(len(self), np.nan), np.full(len(self), np.nan)
        if name in ("heading", "body", "head"):
            half = np.minimum(half, np.pi)
        return middle - half, middle + half

    def _motion(self, velocity: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the velocity (n, 2) and its covariance (n, 2, 2)."""
        unknown = np.full((len(self), 2, 2), np.nan)
        return velocity, unknown if self.covariance is None else self.covariance[:, 2:4, 2:4]

    @property
    def axis_std(self) -> FloatArray | None:
        """Return the 1-σ (n,) of each axis of positions, metres: of an ellipse by the mean variance."""
        return of_axes(self.position_std, self.position_covariance)

    @property
    def has_truth(self) -> bool:
        """Return whether the true positions are known."""
        return self.true_position is not None and bool(np.isfinite(self.true_position).any())


@dataclass(frozen=True, eq=False)
class TrackSet:
    """Tracks of one scene with distinct ids, the camera if it is known, and the summary of reading.

    It is a sequence of tracks: ``tracks[0]`` is the first, ``tracks[:2]`` a set of the first two.
    ``tracks.by_id(7)`` is the track of an id, ``tracks.select("anna", "*walk*")`` those of labels or ids.

    ``as_read`` keeps the names and units of a table that differ from the native ones, for writing.
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
        parts = [counted(len(self), "track")]
        if len(self):
            parts += [counted(self.n_frames, "person-frame"), _contents(self.tracks)]
        return f"TrackSet({', '.join(parts)}{'; camera' if self.camera is not None else ''})"

    def _repr_html_(self) -> str:
        header = ("id", "label", "frames", "from (s)", "to (s)", "position", "body", "head")
        rows = (
            (
                track.track_id,
                track.label[:LONGEST],
                len(track),
                f"{track.t[0]:.1f}",
                f"{track.t[-1]:.1f}",
                _n_known(track.position),
                _n_known(track.body, track.body_likelihood),
                _n_known(track.head, track.head_likelihood),
            )
            for track in self.tracks[:MOST]
        )
        return html_table(repr(self), header, rows, max(0, len(self) - MOST))

    def __iter__(self) -> Iterator[Track]:
        return iter(self.tracks)

    def __len__(self) -> int:
        return len(self.tracks)

    @overload
    def __getitem__(self, place: int) -> Track: ...
    @overload
    def __getitem__(self, place: slice) -> TrackSet: ...
    def __getitem__(self, place: int | slice) -> Track | TrackSet:
        """Return the track at an index, or the set of a slice, as in a list; `by_id` takes an id.

        Raises
        ------
        IndexError
            For an index beyond the last track.
        InputError
            For an index that is not a whole number, such as a label: use `select`.
        """
        if isinstance(place, slice):
            return self.with_tracks(self.tracks[place])
        try:
            number = index(place)
        except TypeError:
            expected = "an index from 0 or a slice; by_id takes an id, select a label or a pattern"
            raise InputError(f"tracks[{place!r}]", expected) from None
        if not -len(self) <= number < len(self):
            raise TrackIndexError(f"tracks[{number}] of {counted(len(self), 'track')}", _PLACE)
        return self.tracks[number]

    def person(self, track_id: int) -> str:
        """Return a person as the file names it, for messages: ``track 7``, or ``track anna``."""
        return name_of(track_id, {} if self.as_read is None else self.as_read.names)

    def by_id(self, track_id: int | str) -> Track:
        """Return the track of an id, or of an identity among `ids`.

        Raises
        ------
        UnknownTrackError
            If no track has it; a `KeyError` too.
        """
        number = self.ids.get(track_id) if isinstance(track_id, str) else track_id
        for track in self.tracks:
            if track.track_id == number:
                return track
        known = listed(self.ids if isinstance(track_id, str) else [track.track_id for track in self.tracks])
        raise UnknownTrackError(f"no track {track_id!r}", f"one of the ids {known}" if known else "a track")

    @property
    def names(self) -> dict[int, str]:
        """Track id → unique name: the file's text identity, else the label if all differ, else the id."""
        labels = [track.label for track in self.tracks]
        if (self.as_read is None or not self.as_read.names) and all(labels) and len({*labels}) == len(labels):
            return {track.track_id: track.label for track in self.tracks}
        return identity_names([track.track_id for track in self.tracks], self.as_read)

    @property
    def ids(self) -> dict[str, int]:
        """Name of a person, as of `names`, → track id."""
        return {name: track_id for track_id, name in self.names.items()}

    @property
    def n_frames(self) -> int:
        """Number of person-frames: the sum of the tracks' lengths."""
        return sum(len(track) for track in self.tracks)

    def with_tracks(self, tracks: Iterable[Track]) -> TrackSet:
        """Return the scene with other tracks."""
        return replace(self, tracks=tuple(tracks))

    def map(self, function: Callable[[Track], Track]) -> TrackSet:
        """Apply a function to every track."""
        return self.with_tracks(function(track) for track in self.tracks)

    def select(self, *patterns: str) -> TrackSet:
        """Return the tracks whose label or id matches one of the shell patterns (``*walk*``, ``17``)."""
        return self.with_tracks(
            track
            for track in self.tracks
            if any(fnmatch.fnmatchcase(track.label, p) or str(track.track_id) == p for p in patterns)
        )

    def to_table(self, *, as_read: bool = False, intervals: float | None = None) -> pd.DataFrame:
        """Return a table with a row for each person and frame and the native columns (degrees in ``*_deg``).

        Parameters
        ----------
        as_read : use the names and units of the table that was read
        intervals : probability of the intervals of speed, heading, body and head, whose ends are in
            ``speed_low``, ``speed_high``, ``heading_deg_low`` and so on; None: without them
        """
        import pandas as pd

        return pd.DataFrame(columns_as_read(self, intervals) if as_read else to_columns(self, intervals))

    @classmethod
    def from_table(cls, table: pd.DataFrame | Mapping[str, Any], *, fps: float | None = None) -> TrackSet:
        """Return tracks from a table with native columns; a missing cell is a missing observation.

        Parameters
        ----------
        table : a DataFrame, or name → column. Dates and times in ``t`` become seconds from the midnight (UTC)
            before the first.
        fps : frames a second, for a table without ``t``

        Raises
        ------
        InputError
            With the row (from 1) and column of an invalid value.
        """
        return cls.from_identified_rows(rows_of_table(table, fps))

    @classmethod
    def from_identified_rows(cls, rows: Rows) -> TrackSet:
        """Return tracks from rows with identities, with a note and a warning for implausible speeds.

        Raises
        ------
        InputError
            If rows have no identities, and as `in_order`.
        """
        check_identities(rows)
        tracks = cls.from_rows(rows)
        note = tracks.speeds.note
        if note is None:
            return tracks
        warnings.warn(f"{rows.path}: {note}", InputWarning, stacklevel=2)
        return replace(tracks, summary=replace(tracks.summary, notes=(*tracks.summary.notes, note)))

    @property
    def speeds(self) -> Speeds:
        """Return the median speeds of the tracks."""
        return Speeds.of((track.t, track.position) for track in self)

    @classmethod
    def from_rows(cls, rows: Rows) -> TrackSet:
        """Return tracks from the rows of a reader."""
        rows = sorted_rows(rows)
        ids = rows.track_id
        edges = np.flatnonzero(np.diff(ids, prepend=ids[0] - 1, append=ids[-1] + 1)).tolist()
        # A channel that is missing throughout a track is absent: engines expect None, not all-NaN.
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
            sensor = None if rows.sensor is None else rows.sensor[start:stop]
            tracks.append(Track._trusted(identity, rows.frame[start:stop], channels, label, inputs, sensor))
        summary = ReadSummary(rows.format, rows.n_read, dict(rows.refused), rows.notes)
        return cls(tuple(tracks), rows.camera, summary, rows.as_read)


def of_axes(std: FloatArray | None, covariance: FloatArray | None) -> FloatArray | None:
    """Return the 1-σ (n,) of an axis with the mean variance of covariances (n, 2, 2), else ``std``."""
    if covariance is None:
        return std
    mean = np.sqrt(0.5 * np.trace(covariance, axis1=1, axis2=2))
    return mean if std is None else np.where(np.isnan(mean), std, mean)


def observed_angle(track: Track, name: str) -> FloatArray:
    """Observed angle (n,) of body or head in radians; NaN where unobserved."""
    angle = getattr(track, name)
    directions = None if angle is None else unit(angle)
    vectors = vectors_of(directions, getattr(track, f"{name}_likelihood"), len(track))
    return np.where(np.isfinite(vectors).all(axis=1), direction(vectors), np.nan)


def _contents(tracks: Sequence[Track]) -> str:
    """Return the time span and channels of tracks, such as ``0.0–19.9 s, body, head; truth``."""
    begin, end = min(track.t[0] for track in tracks), max(track.t[-1] for track in tracks)
    words = [f"{begin:.1f}–{end:.1f} s"]
    for name, fields_ in (
        ("pixels", ("pixel",)),
        ("body", ("body", "body_likelihood")),
        ("head", ("head", "head_likelihood")),
    ):
        if any(getattr(track, one) is not None for track in tracks for one in fields_):
            words.append(name)
    text = ", ".join(words)
    if any(track.covariance is not None for track in tracks):
        text += "; estimates"
    return text + ("; truth" if any(track.has_truth for track in tracks) else "")


def _n_known(*channels: np.ndarray | None) -> int:
    """Return the number of frames in which any of the channels is known."""
    given = [finite_rows(one) for one in channels if one is not None]
    return int(np.logical_or.reduce(given).sum()) if given else 0


def to_columns(tracks: TrackSet, intervals: float | None = None) -> dict[str, NDArray[Any]]:
    """Return the columns of all tracks, in the order of `schema.in_order`; missing numbers are NaN.

    The diagonal of a covariance is written, as standard deviations. With velocities there are speed and
    heading.

    Parameters
    ----------
    intervals : probability of the intervals to add; see `TrackSet.to_table`
    """
    columns: dict[str, NDArray[Any]] = {
        "track_id": np.repeat([track.track_id for track in tracks], [len(track) for track in tracks]).astype(
            np.int64
        ),
        "frame": _joined([track.frame for track in tracks], np.int64),
    }
    for column in (*COLUMNS, *_input_columns(tracks)):
        if any(channel_of(track, column.field) is not None for track in tracks):
            columns[column.name] = _joined([_cells(track, column) for track in tracks], np.float64)
    # Spreads that no engine estimated are NaN throughout: leave the column out.
    for column in COLUMNS:
        if column.part and column.name in columns and np.isnan(columns[column.name]).all():
            del columns[column.name]
    if any(track.velocity is not None for track in tracks):
        columns |= _derived_columns(tracks, intervals)
    if any(track.sensor is not None for track in tracks):
        names = [np.full(len(one), "") if one.sensor is None else one.sensor for one in tracks]
        columns["sensor"] = np.concatenate(names).astype(object)
    if any(track.label for track in tracks):
        labels = [track.label for track in tracks]
        columns["label"] = np.repeat(np.array(labels, dtype=object), [len(track) for track in tracks])
    return columns


def columns_as_read(tracks: TrackSet, intervals: float | None = None) -> dict[str, Any]:
    """Return the columns of all tracks under the names, in the units and the convention of their file.

    Parameters
    ----------
    intervals : probability of the intervals to add; see `TrackSet.to_table`
    """
    convention = None if tracks.as_read is None else tracks.as_read.angles
    if convention is None:
        return restored(to_columns(tracks, intervals), tracks.as_read)

    def in_file(track: Track) -> Track:
        turned = object.__new__(Track)  # angles of valid tracks are valid: checking takes a millisecond
        angles = converted(vars(track), convention, tracks.camera, back=True)
        vars(turned).update({**vars(track), **angles})
        return turned

    columns = to_columns(tracks.map(in_file), intervals)
    if "heading_deg" in columns:
        columns |= _headings_in_file(tracks, columns, convention)
    return restored(columns, tracks.as_read)


def _headings_in_file(
    tracks: TrackSet, columns: Mapping[str, NDArray[Any]], convention: AngleConvention
) -> dict[str, NDArray[Any]]:
    """Return the columns of the direction of motion, and of its interval, in a convention of angles."""
    given = [vars(track) | {"head": _heading_of_travel(track)} for track in tracks]
    turned = [converted(_placed(one), convention, tracks.camera, back=True)["head"] for one in given]
    found = {"heading_deg": np.rad2deg(_joined(turned, np.float64))}
    low, high = (f"heading_deg_{end}" for end in ENDS)
    if low in columns:
        half = 0.5 * (columns[high] - columns[low])
        found |= {low: found["heading_deg"] - half, high: found["heading_deg"] + half}
    return found


def _placed(channels: Mapping[str, Any]) -> dict[str, Any]:
    """Return the head of a track's channels, and where it is."""
    return {name: channels.get(name) for name in ("position", "pixel", "head")}


def _heading_of_travel(track: Track) -> FloatArray:
    """Return the heading (n,) of a person who moves, radians; NaN where the speed may be 0."""
    if track.velocity is None:
        return track.heading
    return np.where(is_moving(*track._motion(track.velocity)), track.heading, np.nan)


def _derived_columns(tracks: TrackSet, intervals: float | None) -> dict[str, NDArray[Any]]:
    """Return speed and heading, and with a probability the ends of intervals; no columns of NaN alone."""
    found = {
        "speed": _joined([one.speed for one in tracks], np.float64),
        "speed_std": _joined([one.speed_std for one in tracks], np.float64),
        "heading_deg": np.rad2deg(_joined([_heading_of_travel(one) for one in tracks], np.float64)),
    }
    if intervals is not None:
        for column, name in INTERVALS.items():
            ends = [one.interval(name, intervals) for one in tracks]
            for end, parts in zip(ENDS, zip(*ends, strict=True), strict=True):
                values = _joined(list(parts), np.float64)
                found[f"{column}_{end}"] = np.rad2deg(values) if column.endswith("_deg") else values
        for end in ENDS:
            found[f"heading_deg_{end}"][np.isnan(found["heading_deg"])] = np.nan
    return {name: column for name, column in found.items() if not np.isnan(column).all()}


def _joined(parts: list[NDArray[Any]], dtype: type) -> NDArray[Any]:
    return np.concatenate(parts).astype(dtype) if parts else np.empty(0, dtype)


def _input_columns(tracks: TrackSet) -> list[Column]:
    """Return the columns of the inputs of all tracks, by name; a set's tracks agree on their sizes."""
    sizes = {name: values.shape[1:] for track in tracks for name, values in track.inputs.items()}
    names = [column.name for name in sizes for column in input_columns(f"{INPUT}{name}", sizes[name])]
    return [column for name in columns_in_order(names) if (column := numeric(name)) is not None]


def channel_of(track: Track, field: str) -> FloatArray | None:
    """Return an attribute of a track, or one of its inputs (``input_<name>``); None if it is absent."""
    if field.startswith(INPUT):
        return track.inputs.get(field.removeprefix(INPUT))
    value: FloatArray | None = getattr(track, field)
    return value


def _cells(track: Track, column: Column) -> FloatArray:
    value = channel_of(track, column.field)
    return np.full(len(track), np.nan) if value is None else cells_of(value, column)


def cells_of(value: FloatArray, column: Column) -> FloatArray:
    """Return the cells (n,) of a column, of the channel that it belongs to."""
    place: tuple[Any, ...] = (..., *column.index)
    cells: FloatArray = value[place]
    if column.part == "deviation":
        cells = np.sqrt(cells)
    elif column.part == "correlation":
        cells = cells / np.sqrt(value[..., 0, 0] * value[..., 1, 1])
    return np.rad2deg(cells) if column.degrees else cells
