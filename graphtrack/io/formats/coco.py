"""COCO's boxes as JSON: results of detectors (``image_id``, ``bbox``, ``score``), and annotations."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import PurePosixPath
from typing import Any

import numpy as np
import orjson
from numpy.typing import NDArray

from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray
from graphtrack.io.cameras import placed_boxes, with_scores
from graphtrack.io.format import Format
from graphtrack.io.options import ReadOptions
from graphtrack.io.source import Source
from graphtrack.tracks.table import Rows
from graphtrack.tracks.validation import LARGEST_FRAME, LARGEST_ID, LARGEST_PIXELS, is_number

PERSON = 1
"""COCO's category of people."""

_PEOPLE = ("person", "pedestrian")  # names of that category in files with names
_ENTRY = "an object with image_id and bbox"
_KEYS = re.compile(rb'"image_id"')
_NUMBER_AT_THE_END = re.compile(r"(\d{1,15})$", re.ASCII)


def read(source: Source, options: ReadOptions) -> Rows:
    """Read boxes and project the middles of their lower edges to the ground; see `read_boxes`."""
    if options.fps is None:
        raise InputError("no frame rate", "frames a second (--fps)", path=source.path)
    rows = placed_boxes(read_boxes(source, options), options).with_times(options.fps)
    return with_scores(rows).without("box", "confidence")


def read_boxes(source: Source, options: ReadOptions = ReadOptions()) -> Rows:
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
    kind = _categories(entries, document, options)
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
        raise InputError(f"no JSON ({error.msg})", _ENTRY, path=source.path, line=error.lineno) from error
    document: Mapping[str, Any] = data if isinstance(data, dict) else {}
    entries = document.get("annotations") if document else data
    if not isinstance(entries, list) or not entries:
        raise InputError(
            "no list of boxes", "a list with entries, or annotations in a dataset", path=source.path
        )
    for k, one in enumerate(entries):
        if not isinstance(one, dict) or "image_id" not in one:
            raise _fail(source, k, f"entry {k + 1} without image_id", _ENTRY)
    return entries, document


def _fail(source: Source, k: int, found: str, expected: str, column: str | None = None) -> InputError:
    return InputError(found, expected, path=source.path, line=_line_of(source, k), column=column)


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
    images = document.get("images")
    if not isinstance(images, list) or not all(isinstance(one, dict) for one in images):
        return {}
    stems = {one.get("id"): PurePosixPath(str(one.get("file_name", ""))).stem for one in images}
    found = {key: match for key, stem in stems.items() if (match := _NUMBER_AT_THE_END.search(stem))}
    numbers = {key: int(match[1]) for key, match in found.items()}
    return numbers if len(set(numbers.values())) == len(images) else {}


def _frames(
    source: Source, entries: Sequence[Mapping[str, Any]], document: Mapping[str, Any]
) -> NDArray[np.int64]:
    names = _names(document)
    frames = []
    for k, one in enumerate(entries):
        image = one["image_id"]
        number: object = names.get(image, image) if isinstance(image, int | str) else image
        if isinstance(number, str) and (match := _NUMBER_AT_THE_END.search(PurePosixPath(number).stem)):
            number = int(match[1])
        if not _is_integer(number, -LARGEST_FRAME, LARGEST_FRAME):
            expected = f"a whole number within ±{LARGEST_FRAME}, or a name that ends in one"
            raise _fail(source, k, repr(image)[:40], expected, "image_id")
        frames.append(number)
    return np.array(frames, dtype=np.int64)


def _categories(
    entries: Sequence[Mapping[str, Any]], document: Mapping[str, Any], options: ReadOptions
) -> NDArray[Any]:
    """Return each entry's reason of refusal (n,): the name of its category, or "crowd"; "" for people."""
    wanted = {*_PEOPLE, *(name.lower() for name in options.classes)}
    named = document.get("categories")
    named = named if isinstance(named, list) else []
    names = {one.get("id"): str(one.get("name")) for one in named if isinstance(one, dict)}
    found = []
    for one in entries:
        category = one.get("category_id", PERSON)
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
    read=read,
    read_boxes=read_boxes,
)
