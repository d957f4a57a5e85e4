"""Files of keypoints: COCO, OpenPose, MMPose and MediaPipe.

MediaPipe writes no files: its landmarks are read as programs dump them, a JSON list with an entry per frame
(empty or null: nobody). An entry is a person's 33 landmarks, a list of people, or an object with
``pose_landmarks`` and perhaps ``pose_world_landmarks`` of either, and perhaps ``frame``. A landmark is an
object with x, y, z and visibility, or a list of these.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import chain
from pathlib import Path
from typing import Any, NamedTuple

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
from perception.detection.boxes import FrameDetections, PersonBox, points_of
from perception.pose.keypoints import BY_NUMBER, KNOWN, N_POINTS, coco_indices, in_coco_order

_EXPECTED = (
    "keypoints of COCO (a list with image_id, keypoints), OpenPose (people), MMPose (instances) or MediaPipe "
    "(a list of frames with 33 landmarks a person)"
)
_LARGEST = 1e6  # largest coordinate of a point, pixels


class _Person(NamedTuple):
    """Frame, COCO's points (17, 3), box (4,) or NaN, score in 0…1, and the points in space or NaN."""

    frame: int
    points: FloatArray
    box: FloatArray
    score: float
    joints: FloatArray = np.full((N_POINTS, 3), np.nan)


_FrameOf = Callable[[str], int | None]


def read_keypoints(
    path: str | Path,
    frame_of: _FrameOf = lambda name: None,
    *,
    size: Callable[[], tuple[int, int]] | None = None,
    first: int = 0,
) -> dict[int, FrameDetections]:
    """Read the people of a JSON file, or of a folder with one file per frame, by frame.

    Frame numbers are ``image_id``, ``frame_id``, ``frame`` or those in the names of images and files.

    Parameters
    ----------
    frame_of : returns the frame of an image by its file name without suffix; None: no such image
    size : returns columns and rows of the frames, of which MediaPipe's landmarks are fractions
    first : number of the frame with which a list of frames begins

    Raises
    ------
    InputError
        With file and entry of the first unusable person, such as points of another convention.
    """
    path = Path(path)
    if not path.is_dir():
        return _by_frame(path, _of_file(path, frame_of, size, first))
    files = sorted(file for file in path.iterdir() if file.suffix.lower() == ".json")
    if not files:
        raise InputError("a folder without JSON files", "0001_keypoints.json, …", path=path)
    found = chain.from_iterable(_of_frame_file(file, frame_of, size) for file in files)
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
            **({} if item.joints is None else {"keypoints_3d": np.array(item.joints).ravel().tolist()}),
        }
        for item in people
        if item.keypoints is not None
    ]
    with atomic_path(path) as temporary:
        temporary.write_text(json.dumps(entries), encoding="ascii")


def keypoints_by_box(people: Sequence[PersonBox], path: str | Path) -> list[PersonBox]:
    """Return boxes with the keypoints that `write_keypoints` wrote for the same boxes.

    Raises
    ------
    InputError
        As `read_keypoints` does.
    """

    def key(frame: int, box: ArrayLike) -> tuple[float, ...]:
        return frame, *np.round(np.asarray(box, float), 2).tolist()

    known = {
        key(frame, box): found.pose(k)
        for frame, found in read_keypoints(path).items()
        for k, box in enumerate(found.boxes)
    }
    found = [known.get(key(item.frame, item.box), (None, None)) for item in people]
    return [
        replace(item, keypoints=points, joints=joints)
        for item, (points, joints) in zip(people, found, strict=True)
    ]


def _by_frame(path: Path, people: Iterable[_Person]) -> dict[int, FrameDetections]:
    groups: dict[int, list[_Person]] = {}
    for person in people:
        groups.setdefault(person.frame, []).append(person)
    if not groups:
        raise InputError("no people", "at least one person's keypoints", path=path)
    found = {
        frame: FrameDetections(*(np.array(values) for values in (boxes, scores, points, joints)))
        for frame, group in sorted(groups.items())
        for _, points, boxes, scores, joints in [zip(*group, strict=True)]
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


_Size = Callable[[], tuple[int, int]] | None


def _of_file(path: Path, frame_of: _FrameOf, size: _Size, first: int) -> Iterator[_Person]:
    data = _loaded(path)
    if _is_mediapipe(data):
        return _of_mediapipe(path, data, size, range(first, first + len(data)))
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


def _of_frame_file(path: Path, frame_of: _FrameOf, size: _Size) -> Iterator[_Person]:
    """Return the people of a file of one frame."""
    data, number = _loaded(path), _number_of(path, path.stem, frame_of)
    if _is_mediapipe([data]):
        return _of_mediapipe(path, [data], size, range(number, number + 1))
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
        yield _Person(frame, points, np.full(4, np.nan), min(score, 1.0))


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
        person = _Person(frame, points, _box(item.get("bbox"), path, k), _score(item, path, k))
        if "keypoints_3d" in item:
            joints = _array(item["keypoints_3d"], path, f"entry {k}, keypoints_3d")
            if joints.size != 3 * N_POINTS:
                raise InputError(f"entry {k}: keypoints_3d of {joints.size} numbers", "51", path=path)
            person = person._replace(joints=joints.reshape(N_POINTS, 3))
        yield person


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
        yield _Person(frame, _points(values.ravel(), path, place, names), corners, score)


_IMAGE, _WORLD = ("pose_landmarks", "landmarks", "landmark"), ("pose_world_landmarks", "world_landmarks")
_LANDMARKS = 33


def _is_landmark(value: object) -> bool:
    """Return True for an object with x and y, or a list of three numbers or more."""
    if isinstance(value, dict):
        return "x" in value and "y" in value
    return isinstance(value, list) and len(value) >= 3 and all(isinstance(one, int | float) for one in value)


def _poses(entry: object, keys: Sequence[str]) -> list[list[Any]] | None:
    """Return the landmarks of each person of a frame's entry; None: it has none of the form."""
    if entry is None:
        return []
    if isinstance(entry, dict):
        inner = next((entry[key] for key in keys if key in entry), entry)
        return None if inner is entry else _poses(inner, _IMAGE)  # protocol buffers have a list within
    if not isinstance(entry, list):
        return None
    if entry and _is_landmark(entry[0]):
        return [entry]
    people = [_poses(person, keys) for person in entry]
    return None if any(one is None for one in people) else [one for some in people for one in some or ()]


def _is_mediapipe(data: object) -> bool:
    """Return True for a list of frames some of which have landmarks."""
    return isinstance(data, list) and any(_poses(entry, _IMAGE) for entry in data)


def _of_mediapipe(
    path: Path, entries: Sequence[Any], size: _Size, frames: Sequence[int]
) -> Iterator[_Person]:
    if size is None:
        raise InputError(
            "landmarks in fractions of the image", "a recording, whose images have a size", path=path
        )
    scale = np.array([*size(), 1.0])
    for number, entry in zip(frames, entries, strict=True):
        place = f"frame {number}"
        poses = _poses(entry, _IMAGE)
        if poses is None:
            raise InputError(f"{place} without landmarks", "33 landmarks of each person, or null", path=path)
        if isinstance(entry, dict) and "frame" in entry:
            number = _frame(entry["frame"], path, place)
        spaces = _poses(entry, _WORLD) if isinstance(entry, dict) else None
        if spaces and len(spaces) != len(poses):
            raise InputError(
                f"{place}: world landmarks of {len(spaces)} of {len(poses)} people", "all", path=path
            )
        for k, pose in enumerate(poses):
            values = _landmarks(pose, path, f"{place}, person {k}")
            if np.median(np.abs(values[:, :2])) > _FARTHEST:
                raise InputError(
                    f"{place}, person {k}: landmarks in pixels", "fractions of the image", path=path
                )
            # Without landmarks in metres, depths are in widths of the image.
            space = _landmarks(spaces[k], path, place)[:, :3] if spaces else values[:, :3] * scale[[0, 1, 0]]
            points = values[:, [0, 1, 3]] * scale
            order = list(BY_NUMBER[_LANDMARKS])
            score = float(np.clip(np.nanmean(values[:, 3]), 0.0, 1.0))
            yield _Person(number, in_coco_order(points, order), np.full(4, np.nan), score, space[order])


_FARTHEST = 3.0  # widths of the image from its corner to the median landmark of a person in part in the image


def _landmarks(pose: Sequence[Any], path: Path, place: str) -> FloatArray:
    """Parse landmarks (33, 4): x, y, z and visibility; NaN: no z, 1: no visibility."""
    if len(pose) != _LANDMARKS:
        raise InputError(f"{place}: {len(pose)} landmarks", f"{_LANDMARKS} landmarks of a person", path=path)
    nothing = (np.nan, np.nan, np.nan, 1.0)
    rows = [
        [one.get(name, value) for name, value in zip(("x", "y", "z", "visibility"), nothing, strict=True)]
        if isinstance(one, dict)
        else [*one[:4], *nothing[len(one) :]]
        for one in pose
        if isinstance(one, dict | list)
    ]
    values = _array(rows, path, place)
    if values.shape != (_LANDMARKS, 4):
        raise InputError(f"{place}: something else", "x, y, z and visibility of each landmark", path=path)
    return values


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
