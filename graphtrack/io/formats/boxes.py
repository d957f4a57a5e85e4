"""Boxes of detectors and trackers: COCO's JSON, JSON lists of boxes, YOLO's label folders, and SDD's text.

COCO's boxes are results of detectors (``image_id``, ``bbox``, ``score``) or annotations. All others are
tables, whose columns of boxes are read as those of any table.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np
import orjson
from numpy.typing import NDArray

from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray
from graphtrack.io.cameras import placed_boxes, with_scores
from graphtrack.io.format import Format, label_files
from graphtrack.io.formats.ndjson import CELL_BYTES
from graphtrack.io.libraries import of_classes
from graphtrack.io.options import ReadOptions
from graphtrack.io.source import Source
from graphtrack.io.text import trailing_number
from graphtrack.tracks.cells import Cells, Columns, Layout, numbers
from graphtrack.tracks.schema import CLASS
from graphtrack.tracks.table import Rows
from graphtrack.tracks.validation import LARGEST_FRAME, LARGEST_ID, LARGEST_PIXELS, is_number, parse_number

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


# -- JSON lists of boxes -------------------------------------------------------------------------------------


def read_json(source: Source, options: ReadOptions = ReadOptions()) -> Cells:
    """Read a JSON list of objects as a table, as supervision's JSONSink and Ultralytics' ``to_json`` write.

    A list of lists, or an object of lists, has the boxes of one frame in each: frames are numbered from 0, or
    are the keys, or the numbers at their ends. Objects within an object (``box``) become columns of it.
    """
    try:
        data = orjson.loads(source.text)
    except orjson.JSONDecodeError as error:
        raise source.fail(f"no JSON ({error.msg})", "a list of objects", line=error.lineno) from error
    entries = list(_records(source, data))
    if not entries:
        raise source.fail("no rows", "at least one object")
    keys = list(dict.fromkeys(key for entry in entries for key in entry))
    found = f"{len(entries)} rows with one of {len(keys)} keys"
    source.limit.check(CELL_BYTES * len(entries) * len(keys), found)
    columns = Columns(keys, lambda name: _objects([entry.get(name) for entry in entries]))
    return Cells(source.path, "json", columns, lambda row: row + 1)


def _records(source: Source, data: Any) -> Iterator[dict[str, Any]]:
    parts = enumerate(data) if isinstance(data, list) else data.items() if isinstance(data, dict) else ()
    for key, part in parts:
        if isinstance(part, dict) and isinstance(data, list):
            yield _flat(part)
            continue
        frame = key if isinstance(key, int) else trailing_number(PurePosixPath(key).stem)
        if not isinstance(part, list) or not all(isinstance(one, dict) for one in part) or frame is None:
            found = repr(part if frame is not None else key)[:40]
            raise source.fail(found, "a list of objects, or a list of them for each frame", line=1)
        for one in part:
            yield {"frame": frame} | _flat(one)


def _flat(given: Mapping[str, Any]) -> dict[str, Any]:
    """Return an object with the keys of objects in it; lists, such as keypoints and masks, are left out."""
    found: dict[str, Any] = {}
    for key, value in given.items():
        if isinstance(value, dict):
            inner = {name: one for name, one in value.items() if not isinstance(one, list | dict)}
            found |= {name: one for name, one in inner.items() if name not in given}
        elif isinstance(value, list):
            found |= (
                dict(zip(_CORNERS, value, strict=True)) if key in _CORNER_LISTS and len(value) == 4 else {}
            )
        else:
            found[key] = value
    return found


_CORNERS, _CORNER_LISTS = ("x1", "y1", "x2", "y2"), ("xyxy", "bbox_xyxy")


def _objects(values: Sequence[Any]) -> NDArray[Any]:
    found = np.empty(len(values), dtype=object)
    found[:] = values
    return found


JSON = Format(
    name="json",
    description="a JSON list of objects, such as of supervision's JSONSink or Ultralytics' to_json",
    suffixes=(),
    cells=read_json,
)

# -- YOLO's labels -------------------------------------------------------------------------------------------

_KEYPOINTS = 51  # numbers of 17 keypoints after a box
_COLUMNS = ("frame", "class", "center_x", "center_y", "width", "height", "confidence", "track_id")
_ROW = "class, x, y, width and height relative to the image, and perhaps a confidence and an id"


def read_labels(source: Source, options: ReadOptions = ReadOptions()) -> Cells:
    """Read a folder of YOLO's labels: one text a frame, whose number is at the end of its name.

    Rows are class, centre, width and height relative to the image, 17 keypoints in files of poses, a
    confidence (``save_conf``) and an id (of a tracker), which rows of frames without ids lack.
    """
    files = label_files(source.path)
    if not files:
        expected = "the folder with one text a frame (labels), or in Python gt.from_ultralytics(results)"
        raise source.fail("boxes without a frame, as one file has those of one image", expected)
    rows: list[list[float]] = []
    places: list[tuple[Path, int]] = []
    for path in files:
        frame = trailing_number(path.stem)
        assert frame is not None
        for number, line in enumerate(Source.open(path).lines, 1):
            if not line.strip():
                continue
            values = [parse_number(cell) for cell in line.split()]
            known = [value for value in values if value is not None]
            tail = known[5:] if len(known) < 5 + _KEYPOINTS else known[5 + _KEYPOINTS :]
            if len(known) < len(values) or len(known) < 5 or len(tail) > 2:
                raise InputError(repr(line.strip()[:60]), _ROW, path=path, line=number)
            rows.append([float(frame), *known[:5], *tail])
            places.append((path, number))
    if not rows:
        raise source.fail("label files without rows", "at least one box")
    table = np.full((len(rows), len(_COLUMNS)), np.nan)
    longest = max(map(len, rows))
    last = np.array([row[6] for row in rows if len(row) == 7])
    of_tracker = longest == 7 and bool((last == np.rint(last)).all()) and bool((last >= 1.0).all())
    for row, cells in zip(table, rows, strict=True):
        row[: len(cells)] = cells
        if of_tracker and len(cells) == 7:
            row[6], row[7] = np.nan, cells[6]
    columns = dict(zip(_COLUMNS, table.T, strict=True))
    columns = {name: values for name, values in columns.items() if not np.isnan(values).all()}
    return Cells(source.path, "yolo", columns, lambda row: places[row][1])


YOLO = Format(
    name="yolo",
    description="folder of YOLO's labels: a text a frame, boxes relative to the image, ids optional",
    suffixes=(),
    cells=read_labels,
    default_fps=25.0,
)

# -- Stanford Drone Dataset ----------------------------------------------------------------------------------

_SDD = ("track_id", "left", "top", "right", "bottom", "frame", "lost", "occluded", "generated", "class")


def read_sdd(source: Source, options: ReadOptions = ReadOptions()) -> Cells:
    """Read annotations of the Stanford Drone Dataset: ``id xmin ymin xmax ymax frame lost … "label"``.

    The view is from above: a person stands at the middle of the box. Rows marked as lost are left out.
    """
    rows = [(number, line.split()) for number, line in enumerate(source.lines, 1) if line.strip()]
    for number, cells in rows:
        if len(cells) != len(_SDD):
            raise source.fail(f"{len(cells)} columns", str(len(_SDD)), line=number)
    columns: dict[str, NDArray[Any]] = {
        name: np.array([cells[k].strip('"') for _, cells in rows], dtype=object)
        for k, name in enumerate(_SDD)
    }
    table = Cells(source.path, "sdd", columns, lambda row: rows[row][0])
    left, top, right, bottom = (numbers(table, name) for name in _SDD[1:5])
    lost = numbers(table, "lost")
    columns = {name: columns[name] for name in ("track_id", "frame", "class")}
    columns |= {"u": (left + right) / 2.0, "v": (top + bottom) / 2.0}
    table = Cells(source.path, "sdd", columns, table.line_of).keep(lost == 0.0, "marked as lost")
    people = of_classes(table, Layout({CLASS: CLASS}), options)
    return replace(people, columns={name: people.columns[name] for name in columns if name != CLASS})


SDD = Format(
    name="sdd",
    description='Stanford Drone Dataset: id xmin ymin xmax ymax frame lost occluded generated "label"',
    suffixes=(),
    cells=read_sdd,
    default_fps=30.0,
)
