"""Detector formats: MOTChallenge text ``frame,id,left,top,width,height,confidence,x,y,z``, and COCO's JSON.

Frames of MOT text are numbered from 1, and programs such as TrackEval refuse a frame 0. A table whose frames
begin at 0 is therefore written with one added to each, and its last column, z, is ``-0`` in place of ``0``:
zero metres for every reader, and for this one the mark to restore the original frames. COCO's boxes are
results of detectors (``image_id``, ``bbox``, ``score``) or annotations.
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np
import orjson
from numpy.typing import NDArray

from graphtrack.errors import InputError, InputWarning
from graphtrack.geometry.angles import FloatArray
from graphtrack.io.cameras import boxes_on_ground, placed_boxes, with_scores
from graphtrack.io.format import Format, companion_paths
from graphtrack.io.options import ReadOptions
from graphtrack.io.source import Source
from graphtrack.io.text import Numbers, read_numbers, trailing_number
from graphtrack.tracks.table import Rows
from graphtrack.tracks.track import Track, TrackSet
from graphtrack.tracks.validation import (
    LARGEST_FRAME,
    LARGEST_ID,
    LARGEST_LIKELIHOOD,
    LARGEST_PIXELS,
    is_number,
)

DEFAULT_FPS = 25.0

IGNORED = "marked to be ignored"

_NAMES = ("frame", "id", "left", "top", "width", "height", "confidence", "x", "y", "z")

_CLASSES = (
    "Pedestrian",
    "PersonOnVehicle",
    "Car",
    "Bicycle",
    "Motorbike",
    "NonMotorisedVehicle",
    "StaticPerson",
    "Distractor",
    "Occluder",
    "OccluderOnGround",
    "OccluderFull",
    "Reflection",
    "Crowd",
)
"""The classes 1, 2, … of ground truth with nine columns (MOT16 and later)."""


FROM_ZERO = "-0"
"""Mark in the last column: the row's frame is one less in the original table."""

SHIFTED = "frames are those of the table from which it was written, numbered from 0 (-0 in the last column)"
"""Note on a file with that mark in all rows."""


def read(source: Source, options: ReadOptions) -> Rows:
    """Read boxes with ids, and positions where the file has them.

    Columns 8 and 9 are metres unless all are −1; a row of −1 among metres is a missing position. With
    nine columns they are class and visibility (ground truth of MOT16 and later). Without metres the foot
    point, the middle of the box's lower edge, is projected to the ground by the camera of the options or by
    a scale. A confidence of 0 marks a row to be ignored. The confidence of detections is the channel
    ``score``, see `with_scores`. Frames are those of the file or of the original table (see the module). The
    frame rate is ``fps``, or that of a ``seqinfo.ini`` nearby, or 25.
    """
    rows = read_boxes(source, options)
    fps, note = _frame_rate(source.path, options)
    rows = placed_boxes(rows, options).with_notes(*note).with_times(fps)
    return with_scores(rows).without("box", "confidence")


def read_boxes(source: Source, options: ReadOptions = ReadOptions()) -> Rows:
    """Return rows with ids, in the order of the file, without ignored rows and other classes.

    The channels are ``box`` (n, 4), left, top, width and height in pixels, NaN where the row has no box;
    ``confidence`` (n,), possibly negative; and ``position`` (n, 2) in metres, where the file has any.
    """
    table = read_numbers(source, delimiter=",", widths=(7, 8, 9, 10), names=_NAMES)
    identity = table.integers(1, LARGEST_ID)
    unknown = identity < 0
    nobodys = bool((identity == -1).all())
    if unknown.any() and not nobodys:
        raise table.fail(
            int(np.argmax(unknown)),
            1,
            f"an id from 0, or -1 in all rows: {unknown.sum()} of {len(unknown)} are detections without "
            "identity",
        )
    channels = {
        "box": _boxes_of(table),
        "confidence": table.bounded(6, -LARGEST_LIKELIHOOD, LARGEST_LIKELIHOOD),
    }
    world = _world(table)
    if world is not None:
        channels["position"] = world
    frame, from_zero = table.integers(0), _counted_from_zero(table)
    notes = (SHIFTED,) if from_zero.all() else ()
    rows = Rows(source.path, "mot", identity, frame - from_zero, channels, table.line_of, notes=notes)
    rows = replace(rows, has_identity=not nobodys)
    if table.values.shape[1] == 9:
        rows = _of_classes(rows, table, options)
    confidence = rows.channels["confidence"]
    if nobodys and (confidence < 0.0).any():  # 0 is a valid confidence there
        return rows
    return rows.keep(confidence != 0.0, IGNORED)


def _counted_from_zero(table: Numbers) -> NDArray[np.bool_]:
    """Return a mask (n,) of rows with the mark `FROM_ZERO`."""
    z = table.values[:, 9] if table.values.shape[1] == 10 else np.ones(len(table.values))
    return np.signbit(z) & (z == 0.0)


def _boxes_of(table: Numbers) -> FloatArray:
    """Return boxes (n, 4) in pixels; NaN in rows whose box is −1, −1, −1, −1: no box."""
    absent = np.all(table.values[:, 2:6] == -1.0, axis=1)
    for column in (4, 5):
        bad = (table.values[:, column] <= 0.0) & ~absent
        if bad.any():
            raise table.fail(int(np.argmax(bad)), column, "a size above 0, or -1,-1,-1,-1 for no box")
    sizes = [table.bounded(column, -1.0, LARGEST_PIXELS) for column in (4, 5)]
    box = np.column_stack([table.pixels(2), table.pixels(3), *sizes])
    return np.where(absent[:, None], np.nan, box)


def _world(table: Numbers) -> FloatArray | None:
    """Return positions (n, 2) in metres, if the file has any."""
    if table.values.shape[1] < 10:
        return None
    absent = np.all(table.values[:, 7:9] == -1.0, axis=1)
    if absent.all():
        return None
    return np.where(absent[:, None], np.nan, np.column_stack([table.metres(7), table.metres(8)]))


def _of_classes(rows: Rows, table: Numbers, options: ReadOptions) -> Rows:
    """Return the rows of the selected classes; other rows are refused and counted by class."""
    number = table.integers(7)
    if (number < 1).all():  # −1: a result without classes
        return rows
    rows = rows.with_channels(number=number.astype(float))
    for k in np.unique(number):
        name = _CLASSES[k - 1] if 1 <= k <= len(_CLASSES) else f"number {k}"
        if name not in options.classes:
            rows = rows.keep(rows.channels["number"] != k, f"of class {name}")
    return rows.without("number")


def _frame_rate(path: Path, options: ReadOptions) -> tuple[float, tuple[str, ...]]:
    if options.fps is not None:
        return options.fps, ()
    for info in companion_paths(path, "mot"):
        if info.is_file():
            text = Source.open(info).text
            rate, width, height = (_setting(text, name) for name in ("frameRate", "imWidth", "imHeight"))
            if rate is not None:
                size = f" and images of {width} × {height}" if width and height else ""
                return float(rate), (f"frame rate {rate} Hz{size} from seqinfo.ini",)
    return DEFAULT_FPS, (f"no frame rate is given: {DEFAULT_FPS:g} Hz assumed",)


def _setting(text: str, name: str) -> str | None:
    """Return a number above 0 of a ``seqinfo.ini``, as text."""
    match = re.search(rf"(?m)^{name}\s*=\s*(\d{{1,6}}(?:\.\d+)?)\s*$", text)
    return match[1] if match is not None and float(match[1]) > 0.0 else None


def write(tracks: TrackSet, path: Path) -> None:
    """Write rows with positions in metres in columns 8 and 9.

    With a camera boxes are those of `boxes_on_ground`.
    Without a camera, or behind it, the box is −1, −1, −1, −1. Ids are those of the tracks; frames too, unless
    they begin at 0 (see the module).

    Warns
    -----
    InputWarning
        If the frames begin at 0, and are written with one added.
    """
    _write_rows(tracks, path, [(track.position, _boxes(track, tracks)) for track in tracks])


def write_2d(tracks: TrackSet, path: Path) -> None:
    """Write boxes alone, with −1 in columns 8 and 9, of rows within the view of the camera; else as `write`.

    Raises
    ------
    InputError
        Without a camera.
    """
    if tracks.camera is None:
        raise InputError("tracks without a camera", "--homography, which makes boxes of them", path=path)
    boxes = [_boxes(track, tracks) for track in tracks]
    nowhere = [np.where(box[:, 2:3] > 0.0, [-1.0, -1.0], np.nan) for box in boxes]
    _write_rows(tracks, path, list(zip(nowhere, boxes, strict=True)))


def _write_rows(tracks: TrackSet, path: Path, values: Sequence[tuple[FloatArray, FloatArray]]) -> None:
    """Write columns 8 and 9 (n, 2) and boxes (n, 4) of each track; rows without the former are left out."""
    negative = next((track.track_id for track in tracks if track.track_id < 0), None)
    if negative is not None:
        raise InputError(f"track id {negative}", "ids from 0 in MOT text")
    first = min((int(track.frame[0]) for track in tracks), default=1)
    if first < 0:
        raise InputError(f"frame {first}", "frames from 0 in MOT text")
    if first == 0:
        note = "frames begin at 0, and at 1 in MOT text: each is written as one more"
        warnings.warn(note, InputWarning, stacklevel=3)
    lines = [
        line for track, one in zip(tracks, values, strict=True) for line in _lines(track, *one, first == 0)
    ]
    lines.sort(key=lambda line: line[:2])
    with path.open("w", encoding="ascii", newline="\n") as stream:
        stream.writelines(text + "\n" for _, _, text in lines)


def _lines(track: Track, place: FloatArray, boxes: FloatArray, from_zero: bool) -> list[tuple[int, int, str]]:
    result = []
    for frame, box, position in zip(track.frame.tolist(), boxes, place, strict=True):
        if np.isfinite(position).all():
            cells = [repr(float(value)) for value in (*np.round(box, 3), 1.0, *position)]
            cells = [str(frame + from_zero), str(track.track_id), *(one.removesuffix(".0") for one in cells)]
            result.append((frame, track.track_id, ",".join([*cells, FROM_ZERO if from_zero else "0"])))
    return result


def _boxes(track: Track, tracks: TrackSet) -> FloatArray:
    """Return boxes (n, 4) left, top, width, height."""
    if tracks.camera is None:
        return np.full((len(track), 4), -1.0)
    return np.nan_to_num(boxes_on_ground(track.position, tracks.camera), nan=-1.0)


MOT = Format(
    name="mot",
    description="MOTChallenge text: frame,id,left,top,width,height,confidence,x,y,z",
    suffixes=(".txt",),
    read=read,
    write=write,
    read_boxes=read_boxes,
)

MOT_2D = Format(
    name="mot2d",
    description="MOTChallenge text of boxes alone, for 2-D evaluation (TrackEval); needs a camera",
    suffixes=(".2d.txt",),
    read=read,
    write=write_2d,
    is_read=False,
)

PERSON = 1
"""COCO's category of people."""

_PEOPLE = ("person", "pedestrian")  # names of that category in files with names
_ENTRY = "an object with image_id and bbox"
_KEYS = re.compile(rb'"image_id"')


def read_coco(source: Source, options: ReadOptions) -> Rows:
    """Read boxes and project the middles of their lower edges to the ground; see `read_boxes`."""
    if options.fps is None:
        raise source.fail("no frame rate", "frames a second (--fps)")
    rows = placed_boxes(read_coco_boxes(source, options), options).with_times(options.fps)
    return with_scores(rows).without("box", "confidence")


def read_coco_boxes(source: Source, options: ReadOptions = ReadOptions()) -> Rows:
    """Return rows of people in the file's order, with the channels ``box`` (n, 4) and ``confidence`` (n,).

    A frame is the number at the end of the image's file name, where the file names its images, and else
    ``image_id``. Identities are ``track_id``, where all entries have one.
    Other categories (by name where the file has names, else all but 1), entries without a box, and crowds
    (``iscrowd``) are refused.
    """
    entries, document = _entries(source)
    frame = _frames(source, entries, document)
    ids = [one.get("track_id") for one in entries]
    identified = all(_is_integer(one, 0, LARGEST_ID) for one in ids)
    box, confidence = np.full((len(entries), 4), np.nan), np.full(len(entries), -1.0)
    for k, one in enumerate(entries):
        if one.get("bbox"):
            box[k] = _box(source, k, one["bbox"])
        if one.get("score") is not None:
            confidence[k] = _score(source, k, one["score"])
    rows = Rows(
        source.path,
        "coco",
        np.array(ids, dtype=np.int64) if identified else np.full(len(entries), -1),
        frame,
        {"box": box, "confidence": confidence},
        lambda row: _line_of(source, row),
        notes=("frames are those of the images' names",)
        if _names(document)
        else ("frames are the image ids",),
        has_identity=identified,
    )
    kind = _categories(source, entries, document, options)
    for name in dict.fromkeys(kind.tolist()):
        if name:
            kept = kind != name
            rows, kind = rows.keep(kept, f"of category {name}"), kind[kept]
    return rows.keep(~np.isnan(rows.channels["box"][:, 0]), "without a box")


def _entries(source: Source) -> tuple[list[dict[str, Any]], Mapping[str, Any]]:
    """Return the boxes, and the whole dataset if they belong to one."""
    try:
        data = orjson.loads(source.text)
    except orjson.JSONDecodeError as error:
        raise source.fail(f"no JSON ({error.msg})", _ENTRY, line=error.lineno) from error
    document: Mapping[str, Any] = data if isinstance(data, dict) else {}
    entries = document.get("annotations") if document else data
    if not isinstance(entries, list) or not entries:
        raise source.fail("no list of boxes", "a list with entries, or annotations in a dataset")
    for k, one in enumerate(entries):
        if not isinstance(one, dict) or "image_id" not in one:
            raise _fail(source, k, f"entry {k + 1} without image_id", _ENTRY)
    return entries, document


def _fail(source: Source, k: int, found: str, expected: str, column: str | None = None) -> InputError:
    return source.fail(found, expected, line=_line_of(source, k), column=column)


def _line_of(source: Source, k: int) -> int:
    """Return the line of an entry, counted only for a message."""
    first = re.search(rb'"annotations"\s*:', source.data)
    matches = list(_KEYS.finditer(source.data, 0 if first is None else first.end()))
    place = matches[min(k, len(matches) - 1)].start() if matches else 0
    return source.data.count(b"\n", 0, place) + 1


def _is_integer(value: object, lowest: int, highest: int) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and lowest <= value <= highest


def _names(document: Mapping[str, Any]) -> dict[Any, int]:
    """Return image id → number at the end of its file name; none if a number is missing or repeated."""
    images = list(_by_id(document, "images"))
    stems = {key: PurePosixPath(str(one.get("file_name", ""))).stem for key, one in images}
    found = {key: trailing_number(stem) for key, stem in stems.items()}
    numbers = {key: number for key, number in found.items() if number is not None}
    return numbers if len(set(numbers.values())) == len(images) else {}


def _by_id(document: Mapping[str, Any], name: str) -> Iterator[tuple[int | str, Mapping[str, Any]]]:
    """Yield the id, a number or text, and the content of each object in a list of the document."""
    listed = document.get(name)
    for one in listed if isinstance(listed, list) else ():
        if isinstance(one, dict) and isinstance(one.get("id"), int | str):
            yield one["id"], one


def _frames(
    source: Source, entries: Sequence[Mapping[str, Any]], document: Mapping[str, Any]
) -> NDArray[np.int64]:
    names = _names(document)
    frames = []
    for k, one in enumerate(entries):
        image = one["image_id"]
        number: object = names.get(image, image) if isinstance(image, int | str) else image
        if isinstance(number, str):
            number = trailing_number(PurePosixPath(number).stem)
        if not _is_integer(number, -LARGEST_FRAME, LARGEST_FRAME):
            expected = f"a whole number within ±{LARGEST_FRAME}, or a name that ends in one"
            raise _fail(source, k, repr(image)[:40], expected, "image_id")
        frames.append(number)
    return np.array(frames, dtype=np.int64)


def _categories(
    source: Source, entries: Sequence[Mapping[str, Any]], document: Mapping[str, Any], options: ReadOptions
) -> NDArray[Any]:
    """Return each entry's reason of refusal (n,): the name of its category, or "crowd"; "" for people."""
    wanted = {*_PEOPLE, *(name.lower() for name in options.classes)}
    names = {key: str(one.get("name")) for key, one in _by_id(document, "categories")}
    found = []
    for k, one in enumerate(entries):
        category = one.get("category_id", PERSON)
        if not isinstance(category, int | str):
            raise _fail(source, k, repr(category)[:40], "a number or text", "category_id")
        name = names.get(category, "person" if category == PERSON and not names else str(category))
        found.append("crowd" if one.get("iscrowd") == 1 else "" if name.lower() in wanted else name)
    return np.array(found, dtype=object)


def _box(source: Source, k: int, given: object) -> FloatArray:
    expected = f"left, top, width and height in pixels within ±{LARGEST_PIXELS:g}, sizes above 0"
    numbers = given if isinstance(given, list) and all(map(is_number, given)) else []
    box = np.array(numbers, dtype=float)
    if box.shape != (4,) or not (np.abs(box) <= LARGEST_PIXELS).all() or box[2] <= 0.0 or box[3] <= 0.0:
        raise _fail(source, k, repr(given)[:60], expected, "bbox")
    return box


def _score(source: Source, k: int, given: Any) -> float:
    if not is_number(given) or not 0.0 <= float(given) <= 1.0:
        raise _fail(source, k, repr(given)[:40], "a number from 0 to 1", "score")
    return float(given)


COCO = Format(
    name="coco",
    description="COCO's boxes as JSON: results of a detector, or annotations",
    suffixes=(),
    read=read_coco,
    read_boxes=read_coco_boxes,
)
