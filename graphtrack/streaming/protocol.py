"""Conversion of a stream's rows to observations and of estimates to answers, with its names and units."""

from __future__ import annotations

import json
import math
from codecs import BOM_UTF8
from collections import deque
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from itertools import chain
from typing import Any, TypeGuard

import numpy as np

from graphtrack.errors import InputError
from graphtrack.geometry.angles import wrapped
from graphtrack.geometry.camera import GroundCamera
from graphtrack.geometry.conventions import UNPLACED, AngleConvention, converted
from graphtrack.inference.online import Estimate
from graphtrack.io.column_names import with_synonyms
from graphtrack.io.formats.ndjson import Pairs, identity, parse_line
from graphtrack.io.options import ReadOptions
from graphtrack.model import Observation
from graphtrack.model.observation import Covariance
from graphtrack.streaming.clock import StreamClock
from graphtrack.streaming.described import DescribedSensors
from graphtrack.streaming.moving import MOST_POSES, POSE, POSE_KEYS, Group, MovingSensors, Waiting
from graphtrack.tracks.cells import Layout, box_of
from graphtrack.tracks.schema import BOX_KEYS, CLASS, NAMES, box_form, in_order, is_column, numeric, unknown
from graphtrack.tracks.table import ANGLES, IN_DEGREES
from graphtrack.tracks.time import DAY, NANOSECONDS_IN, NotIso, TimeScale, from_text, is_iso
from graphtrack.tracks.track import BODY_CLASSES, HEAD_CLASSES, STATE
from graphtrack.tracks.validation import APPEARANCE, INPUT, LARGEST_DEGREES, LARGEST_SECONDS

LONGEST_LINE = 1 << 20
"""Largest number of bytes in a line."""

_CLASSES = {"body": BODY_CLASSES, "head": HEAD_CLASSES}
_ANSWER = tuple(f"{name}_deg" if name in _CLASSES else name for name in STATE)
_NUMBERS = (*_ANSWER, *(f"{name}_std_deg" if name in _CLASSES else f"{name}_std" for name in STATE))
_PLACES = {"position": ("x", "y"), "pixel": ("u", "v")}
_LIKELIHOODS = {
    f"{name}_likelihood": tuple(f"{name}_p{k}" for k in range(count)) for name, count in _CLASSES.items()
}
_NAMED = 100
"""Number of unknown keys that are reported."""


class UnknownKeys:
    """Reports ignored keys, once each.

    Parameters
    ----------
    note : receives the messages
    known : keys that are read in addition to those of the native table
    unused : keys of the native table that are not used
    """

    def __init__(
        self, note: Callable[[str], None], known: Collection[str] = (), unused: Collection[str] = ()
    ) -> None:
        self._note, self._known = note, known
        self._unknown: set[str] = set()
        self._unused = frozenset(unused)

    def check_used(self, names: Collection[str]) -> None:
        """Report keys of a row that are read and not used, once each."""
        if self._unused and not self._unused.isdisjoint(names):
            found = self._unused.intersection(names)
            found -= {"u", "v"} if "x" in names else set()  # the pixel of that position
            for name in sorted(found):
                self._note(f"key {name!r} is not used")
            self._unused -= found

    def __call__(self, pairs: Pairs) -> None:
        """Report unknown keys of a line."""
        for name in _unknown(tuple([name for name, _ in pairs])):
            if name not in self._unknown and name not in self._known and len(self._unknown) < _NAMED:
                self._unknown.add(name)
                more = "; further keys will not be reported" if len(self._unknown) == _NAMED else ""
                self._note(f"ignored key {name[:100]!r}{more}")


class Answering:
    """Base of classes that answer rows, and whose members' states are saved one by one.

    Parameters
    ----------
    fps : frames a second, for rows without a time
    note : called with a sentence on each unknown key, and on times that jump
    known, unused : as in `UnknownKeys`
    moving : poses of moving sensors; None: with the default lag
    described : descriptions of sensors; None: without

    Attributes
    ----------
    members : key → member, such as the smoother of a person
    rows, line : rows answered, and the line of the last of them, from 1
    """

    def __init__(
        self,
        fps: float | None,
        note: Callable[[str], None],
        known: Collection[str] = (),
        unused: Collection[str] = (),
        moving: MovingSensors | None = None,
        described: DescribedSensors | None = None,
    ) -> None:
        self.fps, self._note, self._unknown_keys = fps, note, UnknownKeys(note, known, unused)
        self._of_poses = UnknownKeys(note, POSE_KEYS, set(NAMES) - POSE_KEYS)
        self._moving = MovingSensors() if moving is None else moving
        self._described = DescribedSensors() if described is None else described
        self._has_noted_jump = False
        self.members: dict[Any, Any] = {}
        self.rows = self.line = 0

    @property
    def count(self) -> int:
        """Number of tracked people."""
        raise NotImplementedError

    def answers_together(self, lines: Sequence[tuple[int, bytes]]) -> list[list[dict[str, Any]]]:
        """Return the answers to each of some lines, the same as one by one."""
        raise NotImplementedError

    def finish(self) -> list[dict[str, Any]]:
        """Return the answers at the end of input."""
        raise NotImplementedError

    def shared_state(self) -> dict[str, Any]:
        """Return the part of the state that belongs to no member, as JSON-able data."""
        found: dict[str, Any] = {"moving": self._moving.state()} if self._moving.is_used else {}
        return found | ({"ordered": self._described.state()} if self._described.puts_in_order else {})

    def restore_shared(self, state: Mapping[str, Any]) -> None:
        """Take over a `shared_state`."""
        if "moving" in state:
            self._moving.restore(state["moving"])
        if self._described.puts_in_order:
            self._described.restore(state["ordered"])

    def ready(self, number: int, line: bytes, answers: list[dict[str, Any]]) -> list[tuple[int, bytes]]:
        """Return the lines to answer once a line came: itself, unless it waits, and what waited.

        A row waits for a pose, or for earlier rows of sensors with other clocks or delays. A pose is taken,
        and answered if it is invalid.
        """
        moving, described = self._moving, self._described
        if not (moving.is_used or described.puts_in_order) and b'"pose"' not in line:
            return [(number, line)]
        try:
            pairs = parse_line(text_of(line))
        except InputError:  # reported with the answer to the line
            return [*moving.due(), (number, line)]
        given = dict(pairs)
        try:
            if POSE in given:
                self._of_poses(pairs)
                self._of_poses.check_used(given)
                new, jump = moving.add(pairs)
                if new is not None and self.rows > 1:
                    sensor = f" of the sensor {new!r}" if new else ""
                    self._note(
                        f"poses{sensor} begin in line {number}: earlier rows are taken as in the world"
                    )
                if jump is not None:
                    self._note(f"poses: {jump}")
                return list(moving.due())
            t, sensor = given.get("t", given.get("end")), given.get("sensor") or ""
            if t is None and self.fps is not None and _is_number(given.get("frame")):
                t = given["frame"] / self.fps
            if _is_number(t) and abs(t) <= LARGEST_SECONDS and isinstance(sensor, str):
                is_end = "end" in given
                one = Waiting(number, line, self.group_of(given), None if is_end else sensor, t)
                of_clock = None if is_end and given.get("sensor") is None else sensor
                ready = described.in_order(one, of_clock) if described.puts_in_order else [one]
                return self._without_held(ready, answers)
        except InputError as error:
            answers.append(error_row(pairs, number, error))
            return list(moving.due())
        return [*moving.due(), (number, line)]

    def _without_held(self, waiting: list[Waiting], answers: list[dict[str, Any]]) -> list[tuple[int, bytes]]:
        """Return the lines that do not wait for a pose, and those that need not wait any more."""
        found: list[tuple[int, bytes]] = []
        for one in waiting:
            try:
                is_held = self._moving.hold(one)
            except InputError as error:
                answers.append(error_row(parse_line(text_of(one.line)), one.number, error))
                is_held = True
            found += self._moving.due()
            found += [] if is_held else [(one.number, one.line)]
        return found

    def at_the_end(self) -> Iterator[tuple[int, bytes]]:
        """Remove and yield the lines that wait: the input has ended."""
        yield from self._moving.due(all=True)
        yield from ((one.number, one.line) for one in self._described.rest())

    def observed(self, cells: dict[str, Any]) -> Observation:
        """Return a row as an observation in the world, without the known errors of its sensor.

        Raises
        ------
        InputError
            Without a time, or as `MovingSensors.in_world`.
        """
        return self._moving.in_world(self._described.corrected(observation_of(cells, self.fps)))

    def group_of(self, given: Mapping[str, Any]) -> Group:
        """Return the stream whose lines stay in order, of a line's content; None: any order."""
        return None

    def note_unconfirmed(self, t: float, clock: StreamClock) -> None:
        """Note the first row whose time (seconds) is implausible."""
        if not self._has_noted_jump:
            self._has_noted_jump = True
            assert clock.now is not None
            after, hint = f"more than {clock.limit:g} s after", "; --forget-after allows longer steps"
            place, hint = (after, hint) if t > clock.now else (f"more than {clock.back:g} s before", "")
            self._note(
                f"a row with t = {t:.15g} s, {place} {clock.now:.15g} s, is unconfirmed until the next row "
                f"agrees{hint}"
            )

    def answers(self, number: int, line: bytes) -> list[dict[str, Any]]:
        """Return the answers to a line of input."""
        return self.answers_together([(number, line)])[0]

    def pairs_of(self, line: bytes) -> Pairs:
        """Return the keys and values of a line, and report unknown keys."""
        pairs = parse_line(text_of(line))
        self._unknown_keys(pairs)
        return pairs


@lru_cache(64)
def _unknown(names: tuple[str, ...]) -> list[str]:
    return unknown(names)


def error_row(pairs: Pairs, number: int, error: InputError) -> dict[str, Any]:
    """Return the answer to an invalid line."""
    return {**identity(pairs), "line": number, "error": str(error.at(line=number))}


def observation_of(cells: dict[str, Any], fps: float | None) -> Observation:
    """Return a row as an observation; angles in radians.

    Raises
    ------
    InputError
        Without a time.
    """
    t = cells.get("t")
    if t is None:
        if fps is None:
            raise InputError("no t", "seconds, or a frame rate (--fps)", column="t")
        t = cells["frame"] / fps
    get = cells.get
    body, head = get("body_deg"), get("head_deg")
    return Observation(
        t,
        cells["frame"],
        _pair(cells, "x", "y"),
        get("pos_std") or _of_axes(cells),
        _pair(cells, "u", "v"),
        None if body is None else _angle(body),
        get("body_kappa"),
        None if head is None else _angle(head),
        get("head_kappa"),
        _classes(cells, "body"),
        _classes(cells, "head"),
        get("score"),
        _covariance(cells, "x", "y", "xy"),
        _pair(cells, "observed_vx", "observed_vy"),
        _covariance(cells, "vx", "vy", "vxy"),
        None if "body_axis_deg" not in cells else _angle(cells["body_axis_deg"]),
        get("body_axis_kappa"),
        get("sensor", ""),
        _inputs(cells),
    )


def _covariance(cells: dict[str, Any], first: str, second: str, both: str) -> Covariance | None:
    """Return the covariance of observed columns of deviations and a correlation; None without them."""
    a, b = cells.get(f"observed_{first}_std"), cells.get(f"observed_{second}_std")
    if a is None or b is None:
        return None
    mixed = cells.get(f"observed_{both}_corr", 0.0) * a * b
    return ((a * a, mixed), (mixed, b * b))


def _of_axes(cells: dict[str, Any]) -> float | None:
    """Return the root mean square of x_std and y_std, as `given.position_noise`; None without them."""
    if "x_std" not in cells or "y_std" not in cells:
        return None
    return math.hypot(cells["x_std"], cells["y_std"]) / math.sqrt(2.0)


def _classes(cells: dict[str, Any], name: str) -> tuple[float, ...] | None:
    if f"{name}_p0" not in cells:
        return None
    return tuple([cells[f"{name}_p{k}"] for k in range(_CLASSES[name])])


@lru_cache(64)
def _of_inputs(names: tuple[str, ...]) -> list[str]:
    """Return the input keys of a row; cached, since most rows of a stream have the same keys."""
    return [name for name in names if name.startswith((INPUT, APPEARANCE))]


def _inputs(cells: dict[str, Any]) -> dict[str, float | tuple[float, ...]]:
    given = _of_inputs(tuple(cells))
    if not given:
        return {}
    numbers: dict[str, float] = {}
    arrays: dict[str, tuple[float, ...]] = {}
    for name in in_order(given):
        column = numeric(name)
        assert column is not None
        key = column.field.removeprefix(INPUT)
        if column.index:
            arrays[key] = (*arrays.get(key, ()), cells[name])
        else:
            numbers[key] = cells[name]
        if key in numbers and key in arrays:
            raise InputError(f"a key {name.removesuffix('_0')} next to {name}", "one of the two", column=name)
    return {**numbers, **arrays}


def _angle(degrees: float) -> float:
    angle = math.radians(degrees)
    return angle if -math.pi < angle <= math.pi else wrapped(angle)


def _pair(cells: dict[str, Any], first: str, second: str) -> tuple[float, float] | None:
    return (cells[first], cells[second]) if first in cells else None


def text_of(line: bytes) -> str:
    """Return a line as text; InputError if it is too long or not text."""
    if len(line) > LONGEST_LINE:
        raise InputError(f"more than {LONGEST_LINE} bytes", "a shorter line")
    try:
        return line.decode("utf-8-sig" if line.startswith(BOM_UTF8) else "utf-8")
    except UnicodeDecodeError as error:
        raise InputError(f"the byte 0x{line[error.start]:02x}", "UTF-8 text") from error


def estimate_row(track_id: int, estimate: Estimate) -> dict[str, Any]:
    """Return an estimate with the columns of the native table; null for unknown values."""
    # This runs for every row: plain numbers are quicker than arrays of two.
    variance = estimate.covariance.diagonal().tolist()
    std = [math.sqrt(one) if one >= 0.0 else math.nan for one in variance]
    position, velocity = estimate.position.tolist(), estimate.velocity.tolist()
    row: dict[str, Any] = {"track_id": track_id, "frame": estimate.frame, "t": estimate.t}
    if estimate.sensor:
        row["sensor"] = estimate.sensor
    values = (*position, *velocity, math.degrees(estimate.body), math.degrees(estimate.head))
    spread = (*std[:4], math.degrees(std[4]), math.degrees(std[5]))
    for name, value in zip(_NUMBERS, values + spread, strict=True):
        row[name] = value if math.isfinite(value) else None
    speed = math.hypot(*velocity)
    row["speed"] = speed if math.isfinite(speed) else None
    row["status"] = estimate.status
    if estimate.reason:
        row["reason"] = estimate.reason
    return row


_TIMES = ("t", "end")
_DIGITS = 3
"""Decimals of times in answers, in units other than nanoseconds."""

ORIGIN = "time_origin"
"""Key of the origin among the settings of a state."""

DATES = "dates"
"""Key of the origin there, as text in the form of the stream's times, where these are text."""

_MICROSECONDS = 6
"""Decimals of the seconds of dates, where the first has none."""

BOX = "box"
"""Key there of the columns of boxes, where rows have them in place of positions."""

KNOWN = "known_names"
"""Key there of the flag that columns were read by well-known names."""

Lines = Iterator[tuple[int, bytes]]
"""Lines with their numbers, from 1."""


Refuse = Callable[[int, bytes], None]
"""Callback that answers an unreadable line, given its number, before the kind of rows is known."""


def with_first_row(lines: Lines, refuse: Refuse) -> tuple[Lines, dict[str, Any] | None]:
    """Return the lines from the first that can be read, and its cells; None if there is none.

    Earlier lines are refused at once: their sender may wait for an answer. Poses say nothing of the rows: the
    newest are kept, and earlier ones go to ``refuse`` too.
    """
    poses = deque[tuple[int, bytes]]()
    for number, line in lines:
        try:
            given = dict(parse_line(text_of(line)))
        except InputError:
            refuse(number, line)
            continue
        if POSE not in given:
            return chain(poses, [(number, line)], lines), given
        poses.append((number, line))
        if len(poses) > MOST_POSES:
            refuse(*poses.popleft())
    return iter(poses), None


@dataclass(frozen=True)
class StreamNames:
    """Names of a stream's columns, and the unit or form of its times.

    Attributes
    ----------
    columns : name in the native table → name in the stream
    unit : nanoseconds of the unit of time; those of a second leave times unchanged
    origin : nanoseconds at t = 0; see `beginning`
    dates : the form of times that are text in ISO 8601; None: times are numbers
    are_known : whether the columns were read by well-known names, without options
    radians : columns of the native table that are radians in the stream
    angles : convention of the stream's angles; None: native
    camera : of the stream, for angles that are directions in its image
    box : columns of the native table of the boxes whose foot points are the pixels; empty: no boxes
    """

    columns: Mapping[str, str] = field(default_factory=dict)
    unit: int = NANOSECONDS_IN["s"]
    origin: int = 0
    dates: TimeScale | None = None
    are_known: bool = False
    radians: frozenset[str] = frozenset()
    angles: AngleConvention | None = None
    camera: GroundCamera | None = None
    box: tuple[str, ...] = ()

    @classmethod
    def of(cls, layout: Layout) -> StreamNames:
        """Return the names that a table's layout gives.

        Raises
        ------
        InputError
            For layouts that a stream does not support: geographic degrees, columns for each person, and text
            for times.
        """
        given = {key: name for key, name in layout.columns.items() if key != CLASS}
        if "score" not in given and "confidence" in given:
            given["score"] = given.pop("confidence")
        for key, name in given.items():
            if not (is_column(key) or key in (*ANGLES, *BOX_KEYS)) or name in layout.wild.values():
                raise InputError(f"columns {key}={name} with -", "names of the native table's columns")
        unit = layout.time_unit or "s"
        if unit not in NANOSECONDS_IN:
            raise InputError(f"--time-unit {unit} with -", f"one of {', '.join(NANOSECONDS_IN)}")
        if layout.units is not None or layout.crs is not None:
            raise InputError("--units or --crs with -", "rows in metres")
        columns = {ANGLES.get(key, key): name for key, name in given.items()}
        radians = frozenset(native for key, native in ANGLES.items() if key in layout.columns)
        return cls(columns, NANOSECONDS_IN[unit], radians=radians)

    def with_angles(self, angles: AngleConvention | None, camera: GroundCamera | None) -> StreamNames:
        """Return a copy for angles of a convention, and the camera of its directions."""
        return self if angles is None else replace(self, angles=angles, camera=camera)

    def beginning(
        self, lines: Lines, refuse: Refuse, note: Callable[[str], None]
    ) -> tuple[Lines, StreamNames]:
        """Return the lines, and the names and the origin implied by the first readable line.

        Columns of well-known names (`column_names.SYNONYMS`) are read as in a file, unless options name the
        columns, and reported to ``note``. The seconds of a stream with another unit count from the midnight
        (UTC) before it, which is subtracted while times are whole numbers: a double that counts from 1970
        has no digits left below a microsecond. So do those of dates and times as text (ISO 8601).

        Raises
        ------
        InputError
            If two columns have well-known names of one meaning, or a position is not in metres.
        """
        lines, given = with_first_row(lines, refuse)
        if given is None:
            return lines, self
        names = self._with_synonyms(list(given), note)._with_boxes(list(given))
        text = next(
            (given[name] for name in map(names._name, _TIMES) if isinstance(given.get(name), str)), ""
        )
        if is_iso(text):
            dates = from_text([text], None)[1]
            return lines, replace(names, dates=replace(dates, digits=dates.digits or _MICROSECONDS))
        if names._leaves_times:
            return lines, names
        time = next((given[name] for name in map(names._name, _TIMES) if _is_number(given.get(name))), 0)
        since = time * names.unit
        return lines, names.counting_from(int(since) // DAY * DAY if 0 < since < 2**63 else 0)

    def _with_synonyms(self, given: list[str], note: Callable[[str], None]) -> StreamNames:
        if self.columns:
            return self
        unit = None if self._leaves_times else next(u for u, n in NANOSECONDS_IN.items() if n == self.unit)
        found, notes = with_synonyms(given, ReadOptions(time_unit=unit))
        for text in notes:
            note(text)
        layout = found.layout() if found.columns else None
        if layout is None:
            return self
        if layout.units is not None:
            raise InputError(f"column {layout.columns['x']} with -", "a column of positions in metres")
        return replace(self.of(layout), are_known=True).with_angles(self.angles, self.camera)

    def _with_boxes(self, given: list[str]) -> StreamNames:
        """Return a copy for rows with boxes in place of positions."""
        if {self._name("x"), self._name("u")} & set(given):
            return self
        return replace(self, box=box_form([key for key in BOX_KEYS if self._name(key) in given]))

    def going_on(self, saved: Mapping[str, Any]) -> StreamNames:
        """Return the names of a resumed stream, given the settings of its state."""
        names, columns, per_second = self, saved.get("columns"), saved.get("per_second")
        if saved.get(KNOWN) is True and not self.columns and isinstance(columns, dict):
            unit = next((n for n in NANOSECONDS_IN.values() if 1e9 / n == per_second), self.unit)
            known = {str(key): str(name) for key, name in columns.items()}
            names = replace(self, columns=known, unit=unit, are_known=True)
        if isinstance(box := saved.get(BOX), list):
            names = replace(names, box=tuple(box))
        if isinstance(dates := saved.get(DATES), str) and is_iso(dates):
            scale = from_text([dates], None)[1]
            return replace(names, dates=scale)
        origin = saved.get(ORIGIN)
        return names.counting_from(origin if isinstance(origin, int) else 0)

    def counting_from(self, origin: int) -> StreamNames:
        """Return a copy for a stream whose seconds count from an origin in nanoseconds."""
        return replace(self, origin=origin)

    @property
    def are_native(self) -> bool:
        """Return True if all names and units are those of the native table."""
        plain = not self.columns and not self.box and self.dates is None
        return plain and self._leaves_times and self.angles is None

    @property
    def _leaves_times(self) -> bool:
        return self.unit == NANOSECONDS_IN["s"]

    def _name(self, key: str) -> str:
        return self.columns.get(key, key)

    def settings(self) -> dict[str, Any]:
        """Return the settings that the answers depend on, for a state."""
        found: dict[str, Any] = {"columns": dict(self.columns), "per_second": 1e9 / self.unit}
        found |= {ORIGIN: self.origin} if self.origin else {}
        found |= {"radians": sorted(self.radians)} if self.radians else {}
        found |= {BOX: list(self.box)} if self.box else {}
        found |= {} if self.dates is None else {DATES: self.dates.restored(np.zeros(1))[0]}
        return found | ({KNOWN: True} if self.are_known else {})

    def native_lines(self, lines: Lines, note: Callable[[str], None] | None = None) -> Lines:
        """Yield lines in native names and units, with their numbers; ``note`` receives unused angles."""
        return lines if self.are_native else self._converted_lines(lines, note or (lambda text: None))

    def _converted_lines(self, lines: Lines, note: Callable[[str], None]) -> Lines:
        reported: set[str] = set()
        for number, line in lines:
            unused: set[str] = set()
            yield number, self.native(line, unused)
            for key in sorted(unused - reported):
                note(f"key {self._name(key)!r} is not used in rows without a position: {UNPLACED}")
                reported.add(key)

    def native(self, line: bytes, unused: set[str] | None = None) -> bytes:
        """Return a line in native names and units; an unreadable line is unchanged and refused later.

        Keys of angles that cannot be converted are null, and added to ``unused``.
        """
        try:
            pairs = parse_line(text_of(line))
        except InputError:
            return line
        meaning = {name: key for key, name in self.columns.items()}
        found: list[tuple[str, Any]] = []
        for name, value in pairs:
            key = meaning.get(name, name)
            if name not in meaning and name in self.columns:  # another column has that meaning
                continue
            found.append((key, self._seconds(value) if key in _TIMES else value))
        if self.box:
            found = self._with_foot_point(found)
        if self.angles is not None or self.radians:
            headings = self._angles(dict(found))
            found = [(key, headings.get(key, value)) for key, value in found]
            if unused is not None:
                unused |= {key for key, value in headings.items() if value is None}
        # A repeated key is kept, since it is an error.
        body = ", ".join(f"{json.dumps(key)}: {json.dumps(value)}" for key, value in found)
        return f"{{{body}}}\n".encode()

    def _with_foot_point(self, pairs: list[tuple[str, Any]]) -> list[tuple[str, Any]]:
        """Replace the box of a row by the pixel of its foot point."""
        given = {key: value for key, value in pairs if key in self.box and _is_number(value)}
        if len(given) < len(self.box):
            return pairs
        left, top, width, height = box_of(self.box, given)
        foot: list[tuple[str, Any]] = [("u", left + width / 2.0), ("v", top + height)]
        return [pair for pair in pairs if pair[0] not in self.box] + foot

    def _seconds(self, value: Any) -> Any:
        if self.dates is not None:
            try:
                return from_text([value], self.dates)[0].item() if isinstance(value, str) else value
            except NotIso:  # an invalid time, refused later
                return value
        if self._leaves_times or not _is_number(value):
            return value
        try:
            if isinstance(value, int):
                return (value * self.unit - self.origin) / 10**9
            # The difference of two doubles of one size is exact, unlike a product.
            return (value - self.origin // self.unit) / (1e9 / self.unit)
        except OverflowError:  # an invalid time, refused later
            return value

    def restored(self, answer: Mapping[str, Any]) -> dict[str, Any]:
        """Return an answer under the stream's names, in its unit and its convention of angles."""
        if self.angles is not None or self.radians:
            answer = {**answer, **self._angles(answer, back=True)}
        return {self._name(key): self._value(key, value) for key, value in answer.items()}

    def _angles(self, row: Mapping[str, Any], back: bool = False) -> dict[str, float | None]:
        """Return angles and class likelihoods of a row as native ones, or ``back`` as those of the stream.

        None is an angle that the camera cannot map without a position; what is no number is left to others.
        """
        in_radians = IN_DEGREES if self.angles is not None and self.angles.unit == "rad" else self.radians
        given = {
            key: value
            for key in IN_DEGREES
            if _is_number(value := row.get(key)) and abs(value) <= LARGEST_DEGREES
        }
        if not back:
            given |= {key: math.degrees(given[key]) for key in in_radians if key in given}
        if self.angles is not None:
            given |= self._converted(row, given, back)
        if back:
            given |= {key: math.radians(given[key]) for key in in_radians if key in given}
        return {key: None if value != value else value for key, value in given.items()}

    def _converted(self, row: Mapping[str, Any], angles: Mapping[str, float], back: bool) -> dict[str, float]:
        """Return angles in degrees, and class likelihoods of a row, by the convention; NaN where unknown."""
        channels = {key.removesuffix("_deg"): np.radians([angle]) for key, angle in angles.items()}
        for name, keys in (*_PLACES.items(), *_LIKELIHOODS.items()):
            numbers = [value for key in keys if _is_number(value := row.get(key))]
            if len(numbers) == len(keys) and (name in _PLACES or sum(numbers) > 0.0):
                channels[name] = np.array([numbers], float)
        assert self.angles is not None
        found: dict[str, float] = {}
        with np.errstate(all="ignore"):  # numbers out of range are refused later
            for name, values in converted(channels, self.angles, self.camera, back=back).items():
                if name in _LIKELIHOODS:
                    found |= zip(_LIKELIHOODS[name], values[0].tolist(), strict=True)
                else:
                    found[f"{name}_deg"] = math.degrees(values.item())
        return found

    def _value(self, key: str, value: Any) -> Any:
        if isinstance(value, list):  # revisions and forecasts are rows themselves
            return [self.restored(one) if isinstance(one, Mapping) else one for one in value]
        return self._time(value) if key in _TIMES else value

    def _time(self, value: Any) -> Any:
        if self.dates is not None and _is_number(value):
            return self.dates.restored(np.array([value]))[0]
        if self._leaves_times or not _is_number(value):
            return value
        count = round(value * (1e9 / self.unit), 0 if self.unit == 1 else _DIGITS)
        units = self.origin // self.unit
        return int(count) + units if float(count).is_integer() else count + units


def _is_number(value: Any) -> TypeGuard[float]:
    return isinstance(value, int | float) and not isinstance(value, bool)
