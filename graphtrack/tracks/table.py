"""Rows of observations: checked columns of the native table, with the names and units of the file."""

from __future__ import annotations

import warnings
from collections import Counter
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from graphtrack.errors import InputError, InputWarning
from graphtrack.geometry.angles import FloatArray, wrap
from graphtrack.geometry.camera import GroundCamera
from graphtrack.geometry.conventions import UNPLACED, AngleConvention, converted
from graphtrack.tracks.display import listed
from graphtrack.tracks.schema import (
    INTEGERS,
    NEEDED,
    NO_CLASS,
    expected_group,
    expected_integer,
    in_order,
    numeric,
    together,
)
from graphtrack.tracks.time import Plane, TimeScale
from graphtrack.tracks.validation import (
    SENSOR_NAME,
    SHAPES,
    TEXT,
    bounds_of,
    is_sensor_name,
    is_text,
    out_of_bounds,
)

if TYPE_CHECKING:
    import pyarrow as pa


LENGTHS = (
    *("x", "y", "pos_std", "vx", "vy", "x_std", "y_std", "vx_std", "vy_std", "true_x", "true_y"),
    *("observed_x_std", "observed_y_std"),
    *("observed_vx", "observed_vy", "observed_vx_std", "observed_vy_std"),
    *("speed", "speed_std", "speed_low", "speed_high"),
)
"""Columns of the native table that are metres, or metres a second."""

DEGREES = ("lat", "lon")
"""Columns of geographic coordinates, which replace ``x`` and ``y``."""

TRUE_DEGREES = ("true_lat", "true_lon")

ANGLES = {"body_rad": "body_deg", "head_rad": "head_deg"}
"""Columns in radians → the columns of the native table that they replace."""

IN_DEGREES = ("body_deg", "head_deg", "body_axis_deg", "true_body_deg", "true_head_deg")
"""Columns of angles, in degrees unless the convention of a file has radians."""


@dataclass(frozen=True)
class AsRead:
    """Names and units of a table.

    Attributes
    ----------
    columns : name in the native table (or one of `DEGREES` and `ANGLES`) → name in the file
    time : its time scale; None: seconds, as in the native table
    metre : metres of its unit of length
    names : track id → identity, where identities are text
    plane : projection of geographic coordinates; None: positions on a local ground
    frame : the name of the frame of reference, of a ROS 2 recording
    angles : convention of its angles; None: that of the native table
    """

    columns: Mapping[str, str] = field(default_factory=dict)
    time: TimeScale | None = None
    metre: float = 1.0
    names: Mapping[int, str] = field(default_factory=dict)
    plane: Plane | None = None
    frame: str = ""
    angles: AngleConvention | None = None

    def without_identities(self) -> AsRead:
        """Return a copy for identities that differ from those of the file."""
        columns = {key: name for key, name in self.columns.items() if key != "track_id"}
        return replace(self, columns=columns, names={})


def restored(columns: Mapping[str, NDArray[Any]], as_read: AsRead | None) -> dict[str, Any]:
    """Return columns of the native table under the names and in the units of the table that was read.

    Further columns of the native table keep their name, unless it is a name of the other table.

    Parameters
    ----------
    columns : of the native table, with angles of the file's convention
    as_read : None: the columns are unchanged
    """
    if as_read is None:
        return dict(columns)
    found = _identities(columns, as_read)
    if as_read.time is not None and "t" in found:
        found["t"] = as_read.time.restored(columns["t"])
    _check_placement(found, as_read)
    if as_read.metre != 1.0:
        for name in LENGTHS:
            if name in found:
                found[name] = found[name] / as_read.metre
    for key, native in ANGLES.items():
        if key in as_read.columns and native in found:
            found = {key if n == native else n: np.deg2rad(v) if n == native else v for n, v in found.items()}
    if as_read.angles is not None and as_read.angles.unit == "rad":
        found |= {key: np.deg2rad(found[key]) for key in IN_DEGREES if key in found}
    taken = {as_read.columns[key] for key in found if key in as_read.columns}
    return {
        as_read.columns.get(key, key): values
        for key, values in found.items()
        if key in as_read.columns or key not in taken
    }


def with_names(columns: Mapping[str, NDArray[Any]], as_read: AsRead | None) -> dict[str, NDArray[Any]]:
    """Return columns with identities that were text in the file as ``label``, next to the ids.

    Text identities of targets that are people are ``target_label``.
    """
    if as_read is None or not as_read.names:
        return dict(columns)
    names = as_read.names
    found = {**columns, "label": np.array([names.get(k, "") for k in columns["track_id"].tolist()], object)}
    if "target" in columns:
        names_by_id = {str(k): name for k, name in names.items()}
        pairs = zip(columns["kind"].tolist(), columns["target"].tolist(), strict=True)
        of_target = [names_by_id.get(target, "") if kind == "person" else "" for kind, target in pairs]
        found["target_label"] = np.array(of_target, object)
    return found


def identity_names(ids: Collection[int], as_read: AsRead | None) -> dict[int, str]:
    """Return track id → identity of the file, unique; ids that the file does not have are ``track 7``."""
    names: Mapping[int, str] = {} if as_read is None else as_read.names
    taken = set(names.values())
    return {k: names.get(k) or (f"track {k}" if str(k) in taken else str(k)) for k in ids}


def _identities(columns: Mapping[str, NDArray[Any]], as_read: AsRead) -> dict[str, Any]:
    """Return the columns with text identities of the file; labels equal to them are left out."""
    found: dict[str, Any] = dict(columns)
    if not as_read.names or "track_id" not in found or "track_id" not in as_read.columns:
        return found
    ids = found["track_id"].tolist()
    of = identity_names({*ids}, as_read)
    names = [of[k] for k in ids]
    if "label" in found and "label" not in as_read.columns and found["label"].tolist() == names:
        del found["label"]
    found["track_id"] = np.array(names, dtype=object)
    return found


def _check_placement(found: dict[str, Any], as_read: AsRead) -> None:
    """Replace metres by geographic coordinates, or add these if they are degrees."""
    plane = as_read.plane
    if plane is None:
        return
    degrees = DEGREES[0] in as_read.columns
    for pair, angles in ((("x", "y"), DEGREES), (("true_x", "true_y"), TRUE_DEGREES)):
        if pair[0] not in found:
            continue
        first, second = plane.back(found[pair[0]], found[pair[1]])
        if degrees:
            found[angles[0]], found[angles[1]] = second, first
        else:
            found[pair[0]], found[pair[1]] = first, second


def merged(parts: list[tuple[AsRead | None, Mapping[int, int]]]) -> AsRead | None:
    """Merge names and units of several tables; the first table decides on what all have in common.

    Parameters
    ----------
    parts : those of each file, and its track ids → track ids of the merged set
    """
    first = parts[0][0]
    if first is None or not any(one is not None and one.names for one, _ in parts):
        return first
    names: dict[int, str] = {}
    taken: set[str] = set()
    for one, ids in parts:
        for old, new in ids.items():
            label = name = one.names.get(old, str(old)) if one is not None else str(old)
            again = 1
            while name in taken:
                again += 1
                name = f"{label} ({again})"
            taken.add(name)
            names[new] = name
    return replace(first, names=names)


@dataclass(frozen=True)
class ReadSummary:
    """Counts of the rows of an input. ``rows_read == rows_used + rows_refused``.

    Attributes
    ----------
    refused : reason → number of rows that were left out for it
    notes : what the reader assumed or repaired, one sentence each
    """

    format: str = "memory"
    rows_read: int = 0
    refused: Mapping[str, int] = field(default_factory=dict)
    notes: tuple[str, ...] = ()

    @property
    def rows_refused(self) -> int:
        """Number of rows that were left out, for any reason."""
        return sum(self.refused.values())

    @property
    def rows_used(self) -> int:
        """Number of rows in the tracks."""
        return self.rows_read - self.rows_refused

    def merged(self, other: ReadSummary) -> ReadSummary:
        """Return the summary of both inputs together."""
        refused = dict(self.refused)
        for reason, count in other.refused.items():
            refused[reason] = refused.get(reason, 0) + count
        formats = dict.fromkeys([*self.format.split(" + "), *other.format.split(" + ")])
        return ReadSummary(
            format=" + ".join(formats),
            rows_read=self.rows_read + other.rows_read,
            refused=refused,
            notes=self.notes + tuple(n for n in other.notes if n not in self.notes),
        )


@dataclass(frozen=True, eq=False)
class Rows:
    """The n rows of one file, in its order.

    Attributes
    ----------
    path, format : of the file
    track_id, frame : (n,) int64
    channels : `Track` attribute → (n, ...) in the units of `Track`; ``t`` and ``position`` must be among them
        when they become tracks. A track's input is the channel ``input_<name>``
    line_of : row number → line in the file
    labels : track id → label
    sensor : (n,) text, the name of each row's sensor, "" without one; None: the rows have none
    camera : the camera that made the positions, if any
    refused : reason → number of rows left out so far
    notes : what was assumed or repaired, one sentence each
    has_identity : False: the file has no identities, and ``track_id`` is −1 throughout
    as_read : names and units of the table, where they differ from the native ones
    """

    path: Path
    format: str
    track_id: NDArray[np.int64]
    frame: NDArray[np.int64]
    channels: Mapping[str, FloatArray]
    line_of: Callable[[int], int]
    labels: Mapping[int, str] = field(default_factory=dict)
    sensor: NDArray[np.str_] | None = None
    camera: GroundCamera | None = None
    refused: Mapping[str, int] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    has_identity: bool = True
    as_read: AsRead | None = None

    def __len__(self) -> int:
        return len(self.track_id)

    def person(self, row: int) -> str:
        """Return the person of a row as the file names it, for messages."""
        return name_of(int(self.track_id[row]), {} if self.as_read is None else self.as_read.names)

    @property
    def n_read(self) -> int:
        """Number of rows of the file, including refused rows."""
        return len(self) + sum(self.refused.values())

    def with_channels(self, **channels: FloatArray) -> Rows:
        """Return the rows with channels added or replaced."""
        return replace(self, channels={**self.channels, **channels})

    def without(self, *names: str) -> Rows:
        """Return the rows without these channels."""
        return replace(self, channels={k: v for k, v in self.channels.items() if k not in names})

    def with_camera(self, camera: GroundCamera | None) -> Rows:
        """Return the rows with that camera."""
        return replace(self, camera=camera)

    def with_notes(self, *notes: str) -> Rows:
        """Return the rows with more notes."""
        return replace(self, notes=(*self.notes, *notes))

    def keep(self, mask: NDArray[np.bool_], reason: str) -> Rows:
        """Return the rows where the mask holds; other rows are counted as refused for the reason."""
        count = int(len(self) - mask.sum())
        if not count:
            return self
        refused = dict(Counter(self.refused) + Counter({reason: count}))
        return replace(self.taken(np.flatnonzero(mask)), refused=refused)

    def taken(self, rows: NDArray[np.int64]) -> Rows:
        """Return the rows at some indices, in that order."""
        line_of = self.line_of
        return replace(
            self,
            track_id=self.track_id[rows],
            frame=self.frame[rows],
            channels={name: value[rows] for name, value in self.channels.items()},
            sensor=None if self.sensor is None else self.sensor[rows],
            line_of=lambda i: line_of(int(rows[i])),
        )

    def with_headings(self) -> Rows:
        """Return the rows with the angles of their file's convention as headings."""
        convention = None if self.as_read is None else self.as_read.angles
        if convention is None:
            return self
        found = converted(self.channels, convention, self.camera)
        lost = {
            name: int((np.isnan(angles) & np.isfinite(self.channels[name])).sum())
            for name, angles in found.items()
        }
        notes = [
            f"{count} angles ({name}) of rows without a position were not used: {UNPLACED}"
            for name, count in lost.items()
            if count
        ]
        return self.with_channels(**found).with_notes(f"angles were read {convention}", *notes)

    def with_times(self, fps: float) -> Rows:
        """Return the rows with times from the frame numbers at ``fps`` frames a second."""
        return self.with_channels(t=self.frame / fps)


def sorted_rows(rows: Rows) -> Rows:
    """Return the rows sorted by track and frame; of several sensors by track, time and sensor.

    Rows of a track, a sensor and a time that repeat are left out and counted.

    Warns
    -----
    InputWarning
        If frames had to be sorted; a note is added too.
    """
    if rows.sensor is not None:
        return _sorted_scans(rows)
    check_rows(rows)
    unsorted_tracks = _unsorted(rows)
    if unsorted_tracks:
        note = f"the frames of {unsorted_tracks} of the tracks were out of order and have been sorted"
        rows = rows.with_notes(note)
        warnings.warn(f"{rows.path}: {note}", InputWarning, stacklevel=2)
    order = np.lexsort((rows.frame, rows.track_id))
    rows = rows.taken(order)
    backwards = (np.diff(rows.track_id) == 0) & (np.diff(rows.channels["t"]) <= 0.0)
    if backwards.any():
        # The first of them in the file.
        i = min((np.flatnonzero(backwards) + 1).tolist(), key=lambda i: order[i])
        raise InputError(
            f"t = {rows.channels['t'][i]:g} in frame {rows.frame[i]} of {rows.person(i)}",
            "a time after that of the frame before",
            path=rows.path,
            line=rows.line_of(i),
            column="t",
        )
    _check_bounds(rows)
    return rows


def _sorted_scans(rows: Rows) -> Rows:
    """Return the rows of several sensors in order; frames count the scans of each sensor by itself."""
    assert rows.sensor is not None
    order = np.lexsort((rows.sensor, rows.channels["t"], rows.track_id))
    rows = rows.taken(order)
    t, sensor = rows.channels["t"], rows.sensor
    assert sensor is not None
    again = np.zeros(len(rows), bool)
    again[1:] = (np.diff(rows.track_id) == 0) & (np.diff(t) == 0.0) & (sensor[1:] == sensor[:-1])
    rows = rows.keep(~again | (rows.track_id == -1), REPEATED_BY_SENSOR)
    _check_some(rows)
    _check_bounds(rows)
    return rows


REPEATED_BY_SENSOR = "rows that repeat a track and a time of one sensor"


def _check_bounds(rows: Rows) -> None:
    for name, values in rows.channels.items():
        place = bounds_of(name).first_outside(values)
        if place is not None:
            i = place[0]
            at = {"path": rows.path, "line": rows.line_of(i)}
            raise out_of_bounds(name, values[place], int(rows.frame[i]), rows.person(i), **at)


NO_PIXEL_CAMERA = "pixels u, v and no camera"


def no_camera(rows: Rows) -> InputError:
    """Return the error for rows with pixels alone and no camera or scale."""
    expected = "x, y, or a homography, point pairs, a calibration or metres per pixel as well"
    return InputError(NO_PIXEL_CAMERA, expected, path=rows.path)


def check_identities(rows: Rows) -> None:
    """Raise InputError for rows without identities."""
    if not rows.has_identity:
        raise InputError(
            "rows without identities",
            "a track_id for each (--columns id=…); smooth --associate and gt.associate estimate it",
            path=rows.path,
            line=rows.line_of(0) if len(rows) else None,
        )


def check_rows(rows: Rows) -> None:
    """Refuse a file without usable rows, with missing identities, or with two rows of a track in a frame."""
    _check_some(rows)
    order = np.lexsort((rows.frame, rows.track_id))
    twice = (np.diff(rows.track_id[order]) == 0) & (np.diff(rows.frame[order]) == 0)
    if twice.any():
        later = order[np.flatnonzero(twice) + 1]
        i = int(later.min())
        raise InputError(
            f"{rows.person(i)} again in frame {rows.frame[i]}",
            "each track once a frame, or a column sensor with the names of several",
            path=rows.path,
            line=rows.line_of(i),
        )


def _check_some(rows: Rows) -> None:
    """Refuse a file without usable rows, or with missing identities."""
    if not len(rows):
        reasons = "; ".join(f"{count} {reason}" for reason, count in rows.refused.items())
        found = f"no usable row ({reasons} refused)" if reasons else "no rows"
        raise InputError(found, "at least one row", path=rows.path)
    nobody = np.flatnonzero(rows.track_id == -1)
    if 0 < len(nobody) < len(rows):
        raise InputError(
            f"a row without an identity (−1), which {len(rows) - len(nobody)} others have",
            "one for each row, or none; --associate always ignores them, --associate repair keeps them",
            path=rows.path,
            line=rows.line_of(int(nobody[0])),
        )


def _unsorted(rows: Rows) -> int:
    """Return the number of tracks whose frames are out of order in the file."""
    order = np.argsort(rows.track_id, kind="stable")
    track_id, frame = rows.track_id[order], rows.frame[order]
    back = (np.diff(track_id) == 0) & (np.diff(frame) < 0)
    return len(np.unique(track_id[1:][back]))


_LONGEST = 2**31 - 1  # bytes of all texts of a column: Arrow's offsets have 32 bits


def arrow_array(values: NDArray[Any]) -> pa.Array:
    """Return a column (n,) as an Arrow array; NaN and None are null."""
    import pyarrow as pa

    if values.dtype in (np.float64, np.int64):
        kind = pa.float64() if values.dtype == np.float64 else pa.int64()
        return _array(kind, ~np.isnan(values), [pa.py_buffer(np.ascontiguousarray(values))])
    if values.dtype == object and any(values) and all(isinstance(one, str | None) for one in values):
        texts = [(one or "").encode() for one in values]
        ends = np.cumsum([0, *map(len, texts)])
        if ends[-1] <= _LONGEST:
            there = np.array([one is not None for one in values])
            buffers = [pa.py_buffer(ends.astype(np.int32)), pa.py_buffer(b"".join(texts))]
            return _array(pa.string(), there, buffers)
    return pa.array(values, from_pandas=True)


def _array(kind: pa.DataType, there: NDArray[np.bool_], buffers: list[pa.Buffer]) -> pa.Array:
    """Return an Arrow array of buffers; elements not ``there`` are null."""
    import pyarrow as pa

    valid = None if there.all() else pa.py_buffer(np.packbits(there, bitorder="little"))
    return pa.Array.from_buffers(kind, len(there), [valid, *buffers])


def from_columns(
    columns: Mapping[str, NDArray[Any]],
    *,
    path: Path,
    format: str,
    fps: float | None,
    line_of: Callable[[int], int],
    fail: Callable[..., InputError],
    ignored: Sequence[str],
    notes: tuple[str, ...],
    names: Mapping[int, str] = MappingProxyType({}),
) -> Rows:
    """Return rows from the columns of the native table, checked cell by cell.

    Parameters
    ----------
    columns : name → (n,) numbers, NaN where a cell is empty; ``sensor`` and ``label`` hold text or None
    path, format, line_of : as in `Rows`
    fps : frames a second, for rows without times
    fail : makes the error for what is found and expected in a row and a column
    ignored : names of further columns of the file
    notes : assumptions so far
    names : track id → identity, where identities are text
    """
    identified = "track_id" in columns
    if not identified and "frame" in columns:
        columns = {**columns, "track_id": np.full(len(columns["frame"]), -1.0)}
    check_names(columns, fps, fail)
    if not len(columns["track_id"]):
        raise fail("a header and no rows", "at least one row")
    for name, highest in INTEGERS.items():
        check_integers(columns[name], name, highest, fail)
    for name, values in columns.items():
        if (column := numeric(name)) is not None:
            place = column.bounds.first_outside(values)
            if place is not None:
                raise fail(f"{values[place]:g}", column.bounds.expected, place[0], name)
    for group in together(tuple(columns)):
        _check_group({name: columns[name] for name in group}, fail)
    for name, needed in NEEDED.items():
        if name in columns:
            _check_group({one: columns[one] for one in needed}, fail, columns[name])
    if ignored:
        notes = (*notes, f"ignored columns {listed(ignored)}")
    track_id = columns["track_id"].astype(np.int64)
    rows = Rows(
        path,
        format,
        track_id,
        columns["frame"].astype(np.int64),
        _channels(columns),
        line_of,
        _labels(columns.get("label"), track_id, fail, names),
        _sensors(columns.get("sensor"), fail),
        notes=notes,
        has_identity=identified and bool((track_id != -1).any()),
    )
    return _with_times(rows, fps, fail)


def check_names(names: Collection[str], fps: float | None, fail: Callable[..., InputError]) -> None:
    """Raise ``fail(found, expected, column=…)`` if a required column of the native table is missing."""
    for name in INTEGERS:
        if name not in names:
            raise fail("no such column", f"a column {name}", column=name)
    for group in together(tuple(names)):
        missing = next((name for name in group if name not in names), None)
        if missing is not None:
            have = next(name for name in group if name in names)
            raise fail("no such column", f"a column {missing} next to {have}", column=missing)
        alone = group[0].removesuffix("_0")
        if alone != group[0] and alone in names:
            raise fail(f"a column {alone} next to {group[0]}", "one of the two", column=alone)
    if "x" not in names and "u" not in names:
        raise fail("no position", "columns x, y (metres) or u, v (pixels) with a homography")
    if "t" not in names and fps is None:
        raise fail("no such column", "a column t (seconds), or a frame rate (fps)", column="t")


def check_integers(values: NDArray[Any], name: str, highest: int, fail: Callable[..., InputError]) -> None:
    """Raise ``fail(found, expected, row, name)`` for the first value that is not whole within ±highest."""
    with np.errstate(invalid="ignore"):
        bad = ~(np.abs(values) <= highest) | (values != np.floor(values))
    if bad.any():
        row = int(np.argmax(bad))
        found = "an empty cell" if np.isnan(values[row]) else f"{values[row]:.17g}"
        raise fail(found, expected_integer(highest), row, name)


def _check_group(
    group: Mapping[str, FloatArray], fail: Callable[..., InputError], user: FloatArray | None = None
) -> None:
    """Refuse rows with some but not all cells of a group, and class likelihoods that are all zero.

    ``user`` (n,): of a further column, which says nothing without the group
    """
    empty = np.isnan(np.column_stack(list(group.values())))
    partial = empty.any(axis=1) & (~empty.all(axis=1) if user is None else ~np.isnan(user))
    if partial.any():
        row = int(np.argmax(partial))
        names = list(group)
        name = names[int(np.argmax(empty[row]))]
        raise fail("an empty cell", expected_group(names), row, name)
    first = next(iter(group))
    if first.endswith("_p0"):
        zero = np.sum(list(group.values()), axis=0) <= 0.0
        if zero.any():
            raise fail(*NO_CLASS, int(np.argmax(zero)), first)


def _channels(columns: Mapping[str, NDArray[Any]]) -> dict[str, FloatArray]:
    n = len(columns["track_id"])
    known = [column for name in in_order(columns) if (column := numeric(name)) is not None]
    sizes = {column.field: (column.index[0] + 1,) if column.index else () for column in known}
    channels: dict[str, FloatArray] = {}
    for column in known:
        if column.field not in channels:
            shape = SHAPES.get(column.field, sizes[column.field])
            channels[column.field] = np.full((n, *shape), np.nan)
        cells = np.asarray(columns[column.name], dtype=float)
        if column.degrees:
            cells = np.deg2rad(cells)
        if column.wrapped:
            # An angle in range is kept to the last bit, so that files round-trip.
            with np.errstate(invalid="ignore"):
                cells = np.where((cells > -np.pi) & (cells <= np.pi), cells, wrap(cells))
        if column.part == "deviation":
            cells = cells**2
        place: tuple[Any, ...] = (..., *column.index)
        channels[column.field][place] = cells
    for name in ("position_covariance", "observed_velocity_covariance"):
        if name in channels:
            _complete(channels[name])
    return channels


def _complete(covariance: FloatArray) -> None:
    """Replace the correlation at [0, 1] of some (n, 2, 2), NaN for none, by the covariance, in place."""
    deviation = np.sqrt(covariance[:, 0, 0] * covariance[:, 1, 1])
    both = np.nan_to_num(covariance[:, 0, 1]) * deviation
    covariance[:, 0, 1] = covariance[:, 1, 0] = both


def name_of(track_id: int, names: Mapping[int, str]) -> str:
    """Return a person's identity in a file, given track id → text: ``track 7``, or ``track anna``."""
    return f"track {names.get(track_id, track_id)}"


def _labels(
    labels: NDArray[Any] | None,
    track_id: NDArray[np.int64],
    fail: Callable[..., InputError],
    names: Mapping[int, str],
) -> dict[int, str]:
    """Return track id → label; empty cells are skipped."""
    if labels is None:
        return {}
    found: dict[int, str] = {}
    for row, (identity, label) in enumerate(zip(track_id.tolist(), labels.tolist(), strict=True)):
        if not isinstance(label, str) or not label:
            continue
        if not is_text(label):
            raise fail(repr(label), TEXT, row, "label")
        if found.setdefault(identity, label) != label:
            raise fail(
                f"{label!r} after {found[identity]!r}",
                f"one label for {name_of(identity, names)}",
                row,
                "label",
            )
    return found


def _sensors(names: NDArray[Any] | None, fail: Callable[..., InputError]) -> NDArray[np.str_] | None:
    """Return the names of the rows' sensors (n,); None if all are empty."""
    if names is None:
        return None
    given = [name if isinstance(name, str) else "" for name in names.tolist()]
    wrong = next((row for row, name in enumerate(given) if not is_sensor_name(name)), None)
    if wrong is not None:
        raise fail(repr(given[wrong][:40]), SENSOR_NAME, wrong, "sensor")
    return np.array(given, dtype=str) if any(given) else None


def _with_times(rows: Rows, fps: float | None, fail: Callable[..., InputError]) -> Rows:
    if "t" not in rows.channels:
        assert fps is not None  # otherwise `check_names` has raised
        return rows.with_times(fps)
    empty = np.isnan(rows.channels["t"])
    if empty.any():
        raise fail("an empty cell", "a time in every row", int(np.argmax(empty)), "t")
    if fps is not None:
        return rows.with_notes("the frame rate was not used: the file has times")
    return rows
