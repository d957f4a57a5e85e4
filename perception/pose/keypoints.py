"""Keypoints in COCO's order: other conventions, files of other tools, and body and head orientation."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from types import MappingProxyType
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray
from scipy.special import log_softmax

from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray
from graphtrack.io.source import Source
from graphtrack.tracks.schema import LARGEST_FRAME
from graphtrack.tracks.track import BODY_CLASSES, HEAD_CLASSES
from perception.pose.classes import PoseClasses
from perception.pose.classifier import fit_temperature_and_share, with_neighbours
from perception.storage import ModelCard, Stored

NAMES = (
    "nose",
    "left_eye",
    "right_eye",
    "left_ear",
    "right_ear",
    "left_shoulder",
    "right_shoulder",
    "left_elbow",
    "right_elbow",
    "left_wrist",
    "right_wrist",
    "left_hip",
    "right_hip",
    "left_knee",
    "right_knee",
    "left_ankle",
    "right_ankle",
)
"""Left and right are the person's own."""

N_POINTS = len(NAMES)
FACE = (0, 1, 2, 3, 4)
"""Nose, eyes and ears."""
SHOULDERS, HIPS, ANKLES = (5, 6), (11, 12), (15, 16)
USED = (*FACE, *SHOULDERS, *HIPS)
"""Points that determine body and head orientation."""

_OPENPOSE = (0, 15, 14, 17, 16, 5, 2, 6, 3, 7, 4, 11, 8, 12, 9, 13, 10)
_BODY_25 = (0, 16, 15, 18, 17, 5, 2, 6, 3, 7, 4, 12, 9, 13, 10, 14, 11)
_FIRST = tuple(range(N_POINTS))
BY_NUMBER: Mapping[int, tuple[int, ...]] = MappingProxyType(
    {17: _FIRST, 18: _OPENPOSE, 25: _BODY_25, 26: _FIRST, 133: _FIRST, 136: _FIRST}
)
"""Indices of COCO's points in COCO, OpenPose's COCO and BODY_25, Halpe and COCO-WholeBody."""
KNOWN = "17 points (COCO), 18 or 25 (OpenPose), 26 or 136 (Halpe) or 133 (COCO-WholeBody)"

Points = tuple[tuple[float, float, float], ...]
"""Columns, rows and confidences of one person's 17 points; confidence 0: missing."""


def coco_indices(names: Sequence[str]) -> tuple[int, ...] | None:
    """Return indices of COCO's points among named points; None if any but a limb's is missing."""
    plain = [name.lower().replace(" ", "_").replace("-", "_") for name in names]
    indices = tuple(plain.index(name) if name in plain else -1 for name in NAMES)
    return None if any(indices[k] < 0 for k in USED) else indices


def in_coco_order(points: FloatArray, indices: Sequence[int], *, clipped: bool = True) -> FloatArray:
    """Convert points (..., k, 3) of another convention to COCO's (..., 17, 3); missing points are 0.

    Points without a position have confidence 0; confidences are clipped to 0…1 unless disabled.
    """
    chosen = np.where((np.array(indices) >= 0)[:, None], points[..., list(indices), :], 0.0)
    there = np.isfinite(chosen).all(axis=-1) & (chosen[..., 2] > 0.0)
    found = np.where(there[..., None], chosen, 0.0)
    if clipped:
        found[..., 2] = np.clip(found[..., 2], 0.0, 1.0)
    return np.asarray(found, float)


def as_points(values: FloatArray) -> Points:
    """Return one person's points (17, 3) as plain numbers, rounded to 0.01 pixels."""
    return tuple((round(x, 2), round(y, 2), round(c, 4)) for x, y, c in np.asarray(values, float).tolist())


def mirrored(points: FloatArray, order: NDArray[np.int64] | None = None) -> FloatArray:
    """Return points (..., k, 3) of the mirror image: columns negated, left and right exchanged.

    Parameters
    ----------
    order : (k,) indices of the points; all 17 by default
    """
    names = NAMES if order is None else tuple(NAMES[k] for k in order.tolist())
    swap = {"left": "right", "right": "left"}
    other = [names.index("_".join(swap.get(part, part) for part in name.split("_"))) for name in names]
    return np.asarray(points[..., other, :] * np.array([-1.0, 1.0, 1.0]), float)


BODY, HEAD = PoseClasses.circle(BODY_CLASSES), PoseClasses.circle(HEAD_CLASSES)
FLOOR = 0.05
"""Uniform share of the likelihood, for network errors that the simulation lacks."""

_FACE = 5
_SURE = 0.95
_UNSEEN = 0.05  # largest confidence of a missing point
_ORDER = np.array(USED)


def features(points: FloatArray) -> NDArray[np.float32]:
    """Features (n, 48) of the points (n, 9, 3) of `USED`.

    Positions relative to the mean and the spread of all points, and of the face's points relative to the
    face's, weighted by confidence; confidences; the spreads in pixels and their ratio.
    """
    points = np.asarray(points, float)
    confidence = np.where(points[..., 2] > _UNSEEN, np.minimum(points[..., 2], _SURE), 0.0)
    document, spread = _relative(points, confidence)
    face, of_face = _relative(points[:, :_FACE], confidence[:, :_FACE])
    n = len(points)
    ratio = np.where((spread > 0.0) & (of_face > 0.0), of_face / np.maximum(spread, 1e-6), 0.0)
    found = [
        (document * confidence[..., None]).reshape(n, -1),
        (face * confidence[:, :_FACE, None]).reshape(n, -1),
        confidence,
        (confidence > 0.0).astype(float),
        np.stack([np.log(np.maximum(spread, 1.0)) / 3.0, 3.0 * ratio], axis=1),
    ]
    return np.concatenate(found, axis=1).astype(np.float32)


def _relative(points: FloatArray, weight: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return positions (n, k, 2) about their weighted mean, in spreads, and the spreads (n,) in pixels."""
    total = np.maximum(weight.sum(axis=1), 1e-9)[:, None]
    middle = (points[..., :2] * weight[..., None]).sum(axis=1) / total
    away = points[..., :2] - middle[:, None]
    spread = np.sqrt(((away**2).sum(axis=2) * weight).sum(axis=1) / total[:, 0])
    # Coincident points, or a single one, have no spread.
    scale = np.maximum(spread, 0.3)
    return np.clip(away / scale[:, None, None], -4.0, 4.0), spread


@dataclass(frozen=True, eq=False)
class Layers:
    """Network with rectified units between the layers.

    Attributes
    ----------
    weights : of each layer (inputs, units)
    biases : of each (units,)
    temperature, share : as in `fit_temperature_and_share`
    """

    weights: tuple[NDArray[np.float32], ...]
    biases: tuple[NDArray[np.float32], ...]
    temperature: float = 1.0
    share: float = 0.0

    def scores(self, points: FloatArray) -> FloatArray:
        """Return log likelihoods (n, classes) before calibration, equivariant to mirroring."""
        classes = len(self.biases[-1])
        of_mirror = (-np.arange(classes)) % classes
        straight, turned = (
            log_softmax(self._forward(features(some)), axis=1) for some in (points, mirrored(points, _ORDER))
        )
        return np.asarray(0.5 * (straight + turned[:, of_mirror]), float)

    def _forward(self, values: NDArray[np.float32]) -> FloatArray:
        last = len(self.weights) - 1
        for k, (weight, bias) in enumerate(zip(self.weights, self.biases, strict=True)):
            values = values @ weight + bias
            if k < last:
                values = np.maximum(values, 0.0)
        return np.asarray(values, float)

    def calibrated(self, points: FloatArray, labels: NDArray[np.int64]) -> Layers:
        """Return the network with temperature and share fitted to labels (n,) of other people."""
        return Layers(self.weights, self.biases, *fit_temperature_and_share(self.scores(points), labels))

    def log_likelihoods(self, points: FloatArray) -> FloatArray:
        """Return calibrated log likelihoods (n, classes); uniform without any point."""
        scores = self.scores(points)
        p = with_neighbours(np.exp(log_softmax(scores / self.temperature, axis=1)), self.share)
        p = (1.0 - FLOOR) * p + FLOOR / p.shape[1]
        detected = np.any(points[..., 2] > _UNSEEN, axis=1)
        p = np.where(detected[:, None], p / p.sum(axis=1, keepdims=True), 1.0 / p.shape[1])
        return np.asarray(np.log(p), float)


@dataclass(eq=False)
class KeypointPose(Stored):
    """Model of likelihoods of body (8 classes) and head (12) directions, image frame.

    A small network on shoulders, hips, nose, eyes and ears, trained on skeletons in front of random cameras
    (`perception.synthetic.skeletons`); see docs/perception.md.
    """

    kind: ClassVar[str] = "keypoints"

    body: Layers
    head: Layers
    card: ModelCard

    def log_likelihoods(self, points: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Log likelihoods of body (n, 8) and head (n, 12) for COCO's points (n, 17, 3)."""
        used = np.asarray(points, float).reshape(-1, 17, 3)[:, _ORDER]
        return self.body.log_likelihoods(used), self.head.log_likelihoods(used)

    def parameters(self) -> dict[str, Any]:
        """Calibrations."""
        parts = (("body", self.body), ("head", self.head))
        return {name: {"temperature": part.temperature, "share": part.share} for name, part in parts}

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Weights."""
        found: dict[str, NDArray[Any]] = {}
        for name, part in (("body", self.body), ("head", self.head)):
            for k, (weight, bias) in enumerate(zip(part.weights, part.biases, strict=True)):
                found |= {f"{name}_weight_{k}": weight, f"{name}_bias_{k}": bias}
        return found

    @classmethod
    def restored(cls, card: ModelCard, arrays: dict[str, NDArray[Any]]) -> Self:
        """Load the model of a file."""
        return cls(_layers("body", card, arrays), _layers("head", card, arrays), card)


def _layers(name: str, card: ModelCard, arrays: dict[str, NDArray[Any]]) -> Layers:
    count = sum(key.startswith(f"{name}_weight_") for key in arrays)
    weights, biases = (
        tuple(arrays[f"{name}_{part}_{k}"] for k in range(max(count, 1))) for part in ("weight", "bias")
    )
    given = card.parameters[name]
    return Layers(weights, biases, float(given["temperature"]), float(given["share"]))


_EXPECTED = "keypoints of COCO (a list with image_id, keypoints), OpenPose (people) or MMPose (instances)"
_LARGEST = 1e6  # largest coordinate of a point, pixels


@dataclass(frozen=True, eq=False)
class PersonPoints:
    """One person in one frame.

    Attributes
    ----------
    frame : number
    points : (17, 3) COCO's points
    box : (4,) left, top, width, height in pixels; NaN: not given
    score : from 0 to 1
    """

    frame: int
    points: FloatArray
    box: FloatArray
    score: float


def read_keypoints(
    path: str | Path, frame_of: Callable[[str], int | None] = lambda name: None
) -> list[PersonPoints]:
    """Read the people of a JSON file, or of a folder with one file per frame.

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
        return _checked(path, _of_file(path, frame_of))
    files = sorted(file for file in path.iterdir() if file.suffix.lower() == ".json")
    if not files:
        raise InputError("a folder without JSON files", "0001_keypoints.json, …", path=path)
    found = chain.from_iterable(_of_frame_file(file, frame_of) for file in files)
    return _checked(path, found)


def _checked(path: Path, people: Iterable[PersonPoints]) -> list[PersonPoints]:
    found = sorted(people, key=lambda person: person.frame)
    if not found:
        raise InputError("no people", "at least one person's keypoints", path=path)
    # Annotations have visibilities 0, 1 (hidden) and 2 (visible) instead of confidences.
    every = np.array([person.points[:, 2] for person in found])
    document = 2.0 if np.isin(every, (0.0, 1.0, 2.0)).all() and (every == 2.0).any() else 1.0
    for person in found:
        person.points[:, 2] = np.clip(person.points[:, 2] / document, 0.0, 1.0)
    return found


def _loaded(path: Path) -> Any:
    source = Source.open(path)
    try:
        return json.loads(source.data)
    except (ValueError, RecursionError) as error:
        raise InputError("something else, or a truncated file", "JSON", path=path) from error


def _of_file(path: Path, frame_of: Callable[[str], int | None]) -> Iterator[PersonPoints]:
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


def _of_frame_file(path: Path, frame_of: Callable[[str], int | None]) -> Iterator[PersonPoints]:
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


def _number_of(path: Path, name: str, frame_of: Callable[[str], int | None]) -> int:
    """Return the frame of an image or file with this name without suffix."""
    stem = re.sub(r"_keypoints$", "", name)
    known = frame_of(stem)
    if known is not None:
        return known
    digits = re.search(r"(\d+)$", stem)
    if digits is None:
        found = f"a name without a frame's number, {name!r}"
        raise InputError(found, "names that end in numbers, or are those of the images", path=path)
    return _frame(int(digits[1]), path, name)


def _frame(value: object, path: Path, place: str) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value <= LARGEST_FRAME:
        raise InputError(f"frame {value!r} ({place})", f"a whole number up to {LARGEST_FRAME}", path=path)
    return value


def _of_openpose(path: Path, data: Mapping[str, Any], frame: int) -> Iterator[PersonPoints]:
    for k, person in enumerate(_entries(data["people"], path, "people")):
        values = person.get("pose_keypoints_2d")
        points = _points(values, path, f"person {k}, pose_keypoints_2d", None)
        confident = points[points[:, 2] > 0.0, 2]
        score = float(confident.mean()) if len(confident) else 0.0
        yield PersonPoints(frame, points, np.full(4, np.nan), min(score, 1.0))


def _of_coco(
    path: Path, entries: object, document: Mapping[str, Any], frame_of: Callable[[str], int | None]
) -> Iterator[PersonPoints]:
    images = {
        item.get("id"): str(item.get("file_name", item.get("id")))
        for item in _entries(document.get("images", []), path, "images")
    }
    names = next(
        (item["keypoints"] for item in _entries(document.get("categories", []), path, "categories")
         if item.get("keypoints")), None
    )  # fmt: skip
    for k, item in enumerate(_entries(entries, path, "entries")):
        if "keypoints" not in item:
            raise InputError(f"entry {k} without keypoints", _EXPECTED, path=path)
        image = item.get("image_id")
        name = images.get(image, image if isinstance(image, str) else None)
        frame = (
            _frame(image, path, f"entry {k}") if name is None else _number_of(path, Path(name).stem, frame_of)
        )
        points = _points(item["keypoints"], path, f"entry {k}", names)
        yield PersonPoints(frame, points, _box(item.get("bbox"), path, k), _score(item, path, k))


def _of_mmpose(path: Path, frames: object, notes: object, *, from_one: bool) -> Iterator[PersonPoints]:
    """Parse frames with instances; MMPose's scripts count from 1, its inferencer from 0."""
    entries = _entries(frames, path, "frames")
    numbers = [_frame(item.get("frame_id"), path, f"entry {k}") for k, item in enumerate(entries)]
    names = None
    if isinstance(notes, dict) and isinstance(notes.get("keypoint_id2name"), dict):
        named = notes["keypoint_id2name"]
        names = [str(named[key]) for key in sorted(named, key=int)]
    start = 1 if from_one and min(numbers, default=0) == 1 else 0
    for number, item in zip(numbers, entries, strict=True):
        yield from _of_instances(path, item.get("instances"), number - start, names)


def _of_instances(
    path: Path, entries: object, frame: int, names: Sequence[str] | None
) -> Iterator[PersonPoints]:
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
        yield PersonPoints(frame, _points(values.ravel(), path, place, names), corners, score)


def _entries(values: object, path: Path, name: str) -> list[dict[str, Any]]:
    if not isinstance(values, list) or not all(isinstance(item, dict) for item in values):
        raise InputError(f"{name} that are no list of objects", _EXPECTED, path=path)
    return values


def _array(values: object, path: Path, place: str) -> FloatArray:
    try:
        return np.array(values, float)
    except (ValueError, TypeError) as error:
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
