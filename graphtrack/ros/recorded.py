"""The rows of a recording: whom its messages tell of, on the ground of one frame of reference."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from graphtrack.errors import InputError
from graphtrack.io.layout import Layout
from graphtrack.io.tables.cells import Cells
from graphtrack.io.tables.rows import rows_of_cells
from graphtrack.ros.bag import Bag, open_bag
from graphtrack.ros.choice import chosen_topics, is_of_one
from graphtrack.ros.definitions import DETECTIONS, IDS, TRANSFORMS
from graphtrack.ros.ground import Ground, Seen
from graphtrack.ros.humans import Humans
from graphtrack.ros.messages import Frame, frame_of
from graphtrack.ros.transforms import Transforms
from graphtrack.table.as_read import AsRead
from graphtrack.table.moments import TimeScale
from graphtrack.table.rows import Rows

if TYPE_CHECKING:
    from graphtrack.io.options import ReadOptions

_AT_A_TIME = 2048
"""Messages that are brought to the ground together."""

_BACK, _AHEAD = 10**9, 86_400 * 10**9
"""Nanoseconds by which stamps may go back, as messages overtake each other, and go ahead from the last."""

_LAYOUT = Layout(
    {"track_id": "name", "t": "stamp", "body_rad": "body_rad", "head_rad": "head_rad"}, time_unit="ns"
)
_STATIC = "tf_static"

_AGAIN = "told again with the same stamp"
_NO_TRANSFORM = "at a time without tf"
_OTHER_CLASS = "of another class"


@dataclass(eq=False)
class _Columns:
    """Content of the messages read so far, on the ground."""

    parts: list[dict[str, NDArray[Any]]] = field(default_factory=list)
    refused: Counter[str] = field(default_factory=Counter)
    kinds: Counter[str] = field(default_factory=Counter)
    turned: bool = False
    """Return whether any orientation is another than that of the frame of reference."""


def rows_of_bag(path: Path, options: ReadOptions) -> Rows:
    """Read whom a recording tells of.

    Parameters
    ----------
    options : of them ``topic``, ``fixed_frame``, ``classes`` and ``beside`` count
    """
    with open_bag(path) as bag:
        topics = chosen_topics(bag.topics, options.topic, path)
        kind = bag.topics[topics[0]]
        try:
            ground = _ground(bag, kind, topics, options.fixed_frame)
            columns = _columns(bag, kind, topics, ground, options.classes)
        except InputError as error:
            raise _placed(error, path) from error
        notes = [f"topic {', '.join(topics)} ({kind})", *ground.notes]
        if len(columns.kinds) > 1 and not _is_given(options.classes):
            notes.append(f"all classes were read: {', '.join(sorted(columns.kinds))}; --class picks")
        return _rows(path, columns, notes, options.beside, ground.fixed or "")


def _placed(error: InputError, path: Path) -> InputError:
    if error.path is not None:
        return error
    return InputError(error.found, error.expected, path=path, line=error.line, column=error.column)


def _is_given(classes: tuple[str, ...]) -> bool:
    """Return whether classes were asked for, rather than left at what KITTI calls people."""
    return classes != ("Pedestrian",)


def _frames(bag: Bag, kind: str, topics: list[str]) -> Iterator[tuple[Frame, int]]:
    """The messages that tell of people, and their numbers; times are those of one clock."""
    of_one = is_of_one(kind)
    before: dict[str, int] = {}
    unstamped = _is_unstamped(bag, kind, topics)
    for (topic, logged, _, number), frame in bag.decoded(kind, topics, partial(frame_of, kind=kind)):
        if unstamped:
            frame = frame._replace(stamp=logged)
        _check_clock(before.get(topic), frame.stamp, number, topic)
        if of_one:
            frame = frame._replace(people=[frame.people[0]._replace(name=topic)])
        elif before.get(topic) == frame.stamp and not any(one.name for one in frame.people):
            frame = frame._replace(people=[one._replace(kind=_AGAIN) for one in frame.people])
        before[topic] = max(frame.stamp, before.get(topic, frame.stamp))
        yield frame, number


def _is_unstamped(bag: Bag, kind: str, topics: list[str]) -> bool:
    """Return whether nobody stamped the messages: a simulation's first may be stamped 0, not the second."""
    with open_bag(bag.path) as other:
        frames = other.decoded(kind, topics[:1], partial(frame_of, kind=kind))
        first = [frame.stamp for _, frame in islice(frames, 2)]
    return bool(first) and not any(first)


def _check_clock(before: int | None, stamp: int, number: int, topic: str) -> None:
    if before is None or -_BACK <= stamp - before <= _AHEAD:
        return
    found = f"a clock that jumps by {(stamp - before) / 1e9:+.6g} s"
    expected = "stamps that go on; cut the recording where its clock was set (ros2 bag convert)"
    raise InputError(found, expected, line=number, column=topic)


def _ground(bag: Bag, kind: str, topics: list[str], fixed: str | None) -> Ground:
    """The conversion to the ground; tf is read where it may be needed."""
    humans = Humans.of(bag, topics[0]) if kind == IDS else None
    fixed = None if fixed is None else fixed.lstrip("/")
    transforms = Transforms()
    if fixed is not None or humans is not None:
        of_tf = [name for name, type_ in bag.topics.items() if type_ == TRANSFORMS]
        for one, told in bag.decoded(TRANSFORMS, of_tf, lambda message: message.transforms):
            transforms.add(told, static=one.topic.endswith(_STATIC))
    has_transforms = TRANSFORMS in bag.topics.values()
    return Ground(fixed, transforms, humans, has_transforms)


def _columns(bag: Bag, kind: str, topics: list[str], ground: Ground, classes: tuple[str, ...]) -> _Columns:
    columns = _Columns()
    frames = _frames(bag, kind, topics)
    while some := list(islice(frames, _AT_A_TIME)):
        seen = Seen.of(some)
        if not len(seen):
            continue
        keep = np.ones(len(seen), dtype=bool)
        for row, said in enumerate(seen.kinds):
            if said == _AGAIN:
                keep[row] = False
                columns.refused[_AGAIN] += 1
            elif kind == DETECTIONS and _is_given(classes) and said not in classes:
                keep[row] = False
                columns.refused[_OTHER_CLASS] += 1
            elif said:
                columns.kinds[said] += 1
        columns.turned |= kind == IDS or seen.is_turned()
        found, known = ground.placed(seen)
        columns.refused[_NO_TRANSFORM] += int((keep & ~known).sum())
        keep &= known
        columns.parts.append({name: values[keep] for name, values in found.items()})
    return columns


def _rows(path: Path, columns: _Columns, notes: list[str], beside: AsRead | None, frame: str) -> Rows:
    refused = +columns.refused
    joined: dict[str, NDArray[Any]] = {}
    if columns.parts:
        joined = {name: np.concatenate([one[name] for one in columns.parts]) for name in columns.parts[0]}
    columns.parts.clear()
    if not len(joined.get("stamp", ())):
        reasons = "; ".join(f"{count} {reason}" for reason, count in refused.items())
        found = f"nobody in the messages ({reasons})" if reasons else "nobody in any message"
        raise InputError(found, "people", path=path)
    if (joined["name"] != "").any():
        first = _first_of_each(joined)
        refused[_AGAIN] += int(len(first) - first.sum())
        joined = {name: values[first] for name, values in joined.items()}
    else:
        del joined["name"]
    if not columns.turned and np.isfinite(joined["body_rad"]).any():
        joined["body_rad"][:] = np.nan
        notes.append("orientations are all those of the frame of reference, and were taken for unsaid")
    number = joined.pop("number")
    said = {name: values for name, values in joined.items() if not _is_void(values)}
    layout = replace(_LAYOUT, columns={k: v for k, v in _LAYOUT.columns.items() if v in said})
    cells = Cells(path, "bag", said, lambda row: int(number[row]), {})
    rows = rows_of_cells(cells, layout, beside=beside)
    told = rows.as_read
    assert told is not None and told.time is not None
    # As a table, seconds of the same clock, which read back as they stand.
    as_read = AsRead({}, TimeScale("number", origin=told.time.origin), names=told.names, frame=frame)
    notes = [*notes, *(note for note in rows.notes if note not in notes)]
    return replace(rows, refused=dict(+refused), notes=tuple(notes), as_read=as_read)


def _is_void(values: NDArray[Any]) -> bool:
    return values.dtype.kind == "f" and bool(np.isnan(values).all())


def _first_of_each(joined: dict[str, NDArray[Any]]) -> NDArray[np.bool_]:
    """The rows in which somebody is told of for the first time at a stamp."""
    _, who = np.unique(joined["name"].astype(str), return_inverse=True)
    order = np.lexsort((np.arange(len(who)), joined["stamp"], who))
    again = (np.diff(who[order]) == 0) & (np.diff(joined["stamp"][order]) == 0)
    first = np.ones(len(who), dtype=bool)
    first[order[1:][again]] = joined["name"][order[1:][again]] == ""
    return first
