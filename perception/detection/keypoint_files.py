"""Files of keypoints: COCO, OpenPose and MMPose."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray
from graphtrack.io.atomic import atomic_path
from graphtrack.io.source import Source
from graphtrack.io.text import trailing_number
from graphtrack.tracks.display import shortened
from graphtrack.tracks.schema import LARGEST_FRAME
from graphtrack.tracks.validation import parse_number
from perception.detection.boxes import FrameDetections, PersonBox, as_points, points_of
from perception.pose.keypoints import BY_NUMBER, KNOWN, coco_indices, in_coco_order

_EXPECTED = "keypoints of COCO (a list with image_id, keypoints), OpenPose (people) or MMPose (instances)"
_LARGEST = 1e6  # largest coordinate of a point, pixels


_Person = tuple[int, FloatArray, FloatArray, float]
"""Frame, COCO's points (17, 3), box (4,) or NaN, and score in 0…1."""
_FrameOf = Callable[[str], int | None]


def read_keypoints(path: str | Path, frame_of: _FrameOf = lambda name: None) -> dict[int, FrameDetections]:
    """Read the people of a JSON file, or of a folder with one file per frame, by frame.

    Frame numbers are ``image_id``, ``frame_id`` or those in the names of images and files.

    Parameters
    ----------
    frame_of : returns the frame of an image by its file name without suffix; None: no such image

    Raises
    ------
    InputError
        With file and entry of the first unusable person, such as points of another convention.
    """
    path = Path(path)
    if not path.is_dir():
        return _by_frame(path, _of_file(path, frame_of))
    files = sorted(file for file in path.iterdir() if file.suffix.lower() == ".json")
    if not files:
        raise InputError("a folder without JSON files", "0001_keypoints.json, …", path=path)
    found = chain.from_iterable(_of_frame_file(file, frame_of) for file in files)
    return _by_frame(path, found)


def write_keypoints(people: Iterable[PersonBox], path: str | Path) -> None:
    """Write the boxes that have keypoints as COCO results, whose ``image_id`` is the frame's number.

    Raises
    ------
    InputError
        If the path cannot be written to.
    """
    entries = [
        {
            "image_id": item.frame,
            "category_id": 1,
            "keypoints": np.round(points_of(item), 3).ravel().tolist(),
            "bbox": [round(side, 2) for side in item.box],
            "score": round(item.confidence, 4),
        }
        for item in people
        if item.keypoints is not None
    ]
    with atomic_path(path) as temporary:
        temporary.write_text(json.dumps(entries), encoding="ascii")


def keypoints_by_box(people: Iterable[PersonBox], path: str | Path) -> list[PersonBox]:
    """Return boxes with the keypoints that `write_keypoints` wrote for the same boxes.

    Raises
    ------
    InputError
        As `read_keypoints` does.
    """

    def key(frame: int, box: ArrayLike) -> tuple[float, ...]:
        return frame, *np.round(np.asarray(box, float), 2).tolist()

    known = {
        key(frame, box): as_points(points)
        for frame, found in read_keypoints(path).items()
        if found.points is not None
        for box, points in zip(found.boxes, found.points, strict=True)
    }
    return [replace(item, keypoints=known.get(key(item.frame, item.box))) for item in people]


def _by_frame(path: Path, people: Iterable[_Person]) -> dict[int, FrameDetections]:
    groups: dict[int, list[_Person]] = {}
    for person in people:
        groups.setdefault(person[0], []).append(person)
    if not groups:
        raise InputError("no people", "at least one person's keypoints", path=path)
    found = {
        frame: FrameDetections(*(np.array(values) for values in (boxes, scores, points)))
        for frame, group in sorted(groups.items())
        for _, points, boxes, scores in [zip(*group, strict=True)]
    }
    # Annotations have visibilities 0, 1 (hidden) and 2 (visible) instead of confidences.
    confidences = [one.points[..., 2] for one in found.values() if one.points is not None]
    every = np.concatenate([one.ravel() for one in confidences])
    document = 2.0 if np.isin(every, (0.0, 1.0, 2.0)).all() and (every == 2.0).any() else 1.0
    for one in confidences:
        one[:] = np.clip(one / document, 0.0, 1.0)
    return found


def _loaded(path: Path) -> Any:
    source = Source.open(path)
    try:
        return json.loads(source.data)
    except (ValueError, RecursionError) as error:
        raise InputError("something else, or a truncated file", "JSON", path=path) from error


def _of_file(path: Path, frame_of: _FrameOf) -> Iterator[_Person]:
    data = _loaded(path)
    if isinstance(data, dict) and "people" in data:
        return _of_openpose(path, data, _number_of(path, path.stem, frame_of))
    if isinstance(data, dict) and "instance_info" in data:
        return _of_mmpose(path, data["instance_info"], data.get("meta_info"), from_one=True)
    if isinstance(data, dict) and "annotations" in data:
        return _of_coco(path, data["annotations"], data, frame_of)
    if isinstance(data, list) and data and all(isinstance(item, dict) for item in data):
        if "instances" in data[0]:
            return _of_mmpose(path, data, None, from_one=False)
        if "image_id" in data[0]:
            return _of_coco(path, data, {}, frame_of)
        if "keypoint_scores" in data[0]:
            return _of_instances(path, data, _number_of(path, path.stem, frame_of), None)
    raise InputError(_what(data), _EXPECTED, path=path)


def _of_frame_file(path: Path, frame_of: _FrameOf) -> Iterator[_Person]:
    """Return the people of a file of one frame."""
    data, number = _loaded(path), _number_of(path, path.stem, frame_of)
    if isinstance(data, dict) and "people" in data:
        return _of_openpose(path, data, number)
    if isinstance(data, list):
        return _of_instances(path, data, number, None)
    raise InputError(_what(data), "one frame's people, as OpenPose or MMPose have them", path=path)


def _what(data: Any) -> str:
    if isinstance(data, dict):
        return f"JSON with {', '.join(map(repr, list(data)[:4])) or 'nothing in it'}"
    if isinstance(data, list):
        if data and isinstance(data[0], dict):
            return f"a list of entries with {', '.join(map(repr, list(data[0])[:4])) or 'nothing in them'}"
        return "a list without entries" if not data else "a list of something else"
    return "a single value"


def _number_of(path: Path, name: str, frame_of: _FrameOf) -> int:
    """Return the frame of an image or file with this name without suffix."""
    stem = name.removesuffix("_keypoints")
    known = frame_of(stem)
    if known is not None:
        return known
    number = trailing_number(stem)
    if number is None:
        found = f"a name without a frame's number, {shortened(name)}"
        raise InputError(found, "names that end in numbers, or are those of the images", path=path)
    return _frame(number, path, shortened(name))


def _frame(value: object, path: Path, place: str) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value <= LARGEST_FRAME:
        raise InputError(f"frame {value!r} ({place})", f"a whole number up to {LARGEST_FRAME}", path=path)
    return value


def _of_openpose(path: Path, data: Mapping[str, Any], frame: int) -> Iterator[_Person]:
    for k, person in enumerate(_entries(data["people"], path, "people")):
        values = person.get("pose_keypoints_2d")
        points = _points(values, path, f"person {k}, pose_keypoints_2d", None)
        confident = points[points[:, 2] > 0.0, 2]
        score = float(confident.mean()) if len(confident) else 0.0
        yield (frame, points, np.full(4, np.nan), min(score, 1.0))


def _of_coco(
    path: Path, entries: object, document: Mapping[str, Any], frame_of: _FrameOf
) -> Iterator[_Person]:
    images = {
        item["id"]: str(item.get("file_name", item["id"]))
        for item in _entries(document.get("images", []), path, "images")
        if isinstance(item.get("id"), int | str)
    }
    categories = _entries(document.get("categories", []), path, "categories")
    names = next((item["keypoints"] for item in categories if item.get("keypoints")), None)
    if names is not None and not (isinstance(names, list) and all(isinstance(one, str) for one in names)):
        raise InputError(
            "names of keypoints that are no texts", "COCO's names (nose, left_eye, …)", path=path
        )
    for k, item in enumerate(_entries(entries, path, "entries")):
        if "keypoints" not in item:
            raise InputError(f"entry {k} without keypoints", _EXPECTED, path=path)
        image = item.get("image_id")
        known = images.get(image) if isinstance(image, int | str) else None
        name = image if known is None and isinstance(image, str) else known
        frame = (
            _frame(image, path, f"entry {k}") if name is None else _number_of(path, Path(name).stem, frame_of)
        )
        points = _points(item["keypoints"], path, f"entry {k}", names)
        yield (frame, points, _box(item.get("bbox"), path, k), _score(item, path, k))


def _of_mmpose(path: Path, frames: object, notes: object, *, from_one: bool) -> Iterator[_Person]:
    """Parse frames with instances; MMPose's scripts count from 1, its inferencer from 0."""
    entries = _entries(frames, path, "frames")
    numbers = [_frame(item.get("frame_id"), path, f"entry {k}") for k, item in enumerate(entries)]
    names = None
    if isinstance(notes, dict) and isinstance(notes.get("keypoint_id2name"), dict):
        named = notes["keypoint_id2name"]
        numbers_of = {key: parse_number(key) for key in named}
        names = [str(named[key]) for key in sorted(named, key=lambda key: numbers_of[key] or 0.0)]
    start = 1 if from_one and min(numbers, default=0) == 1 else 0
    for number, item in zip(numbers, entries, strict=True):
        yield from _of_instances(path, item.get("instances"), number - start, names)


def _of_instances(path: Path, entries: object, frame: int, names: Sequence[str] | None) -> Iterator[_Person]:
    for k, item in enumerate(_entries(entries, path, "instances")):
        place = f"frame {frame}, instance {k}"
        if "keypoints" not in item or "keypoint_scores" not in item:
            raise InputError(f"{place} without keypoints and keypoint_scores", _EXPECTED, path=path)
        indices, sure = (_array(item[key], path, place) for key in ("keypoints", "keypoint_scores"))
        if indices.ndim != 2 or indices.shape[1] < 2 or sure.shape != indices.shape[:1]:
            raise InputError(
                f"{place}: keypoints of shape {indices.shape}", "pairs and a score of each", path=path
            )
        values = np.column_stack([indices[:, :2], sure])
        box = item.get("bbox")
        if isinstance(box, list) and len(box) == 1:
            box = box[0]
        corners = _box(box, path, k)
        corners[2:] -= corners[:2]
        score = _score({"score": item.get("bbox_score")}, path, k)
        yield (frame, _points(values.ravel(), path, place, names), corners, score)


def _entries(values: object, path: Path, name: str) -> list[dict[str, Any]]:
    if not isinstance(values, list) or not all(isinstance(item, dict) for item in values):
        raise InputError(f"{name} that are no list of objects", _EXPECTED, path=path)
    return values


def _array(values: object, path: Path, place: str) -> FloatArray:
    try:
        return np.array(values, float)
    except (ValueError, TypeError, OverflowError) as error:
        raise InputError(f"{place}: something else", "numbers", path=path) from error


def _points(values: object, path: Path, place: str, names: Sequence[str] | None) -> FloatArray:
    """Parse COCO's points (17, 3) from a row of x, y, confidence."""
    row = _array(values, path, place)
    if row.ndim != 1 or len(row) % 3:
        raise InputError(f"{place}: {row.size} numbers", "x, y and confidence of each point", path=path)
    points = row.reshape(-1, 3)
    indices = None
    if names is not None:
        indices = coco_indices(names) if len(names) == len(points) else None
        if indices is None:
            found = f"{place}: {len(points)} points named {', '.join(map(str, names[:4]))}, …"
            raise InputError(found, "COCO's names (nose, left_eye, …)", path=path)
    elif len(points) not in BY_NUMBER:
        raise InputError(f"{place}: {len(points)} points", KNOWN, path=path)
    points = np.where(np.abs(points) < _LARGEST, points, np.nan)
    return in_coco_order(points, indices or BY_NUMBER[len(points)], clipped=False)


def _box(values: object, path: Path, k: int) -> FloatArray:
    if values is None:
        return np.full(4, np.nan)
    box: FloatArray = _array(values, path, f"entry {k}, bbox")
    if box.shape != (4,):
        raise InputError(f"entry {k}: a bbox of {box.size} numbers", "4 numbers", path=path)
    return np.where(bool((np.abs(box) < _LARGEST).all()), box, np.nan)


def _score(item: Mapping[str, Any], path: Path, k: int) -> float:
    value = item.get("score")
    if value is None:
        return 1.0
    score = _array(value, path, f"entry {k}, score").ravel()
    if len(score) != 1 or not np.isfinite(score[0]):
        raise InputError(f"entry {k}: score {value!r}", "a number", path=path)
    return float(np.clip(score[0], 0.0, 1.0))
