"""People found by a YOLO network in an ONNX file, run by OpenCV; the weights are the user's."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray
from perception.detection.networks.found import FoundPeople
from perception.detection.networks.layouts import Layout, layout_of
from perception.detection.networks.letterbox import Letterbox
from perception.detection.networks.onnx_file import OnnxFile, Shape
from perception.images.pixels import Image, non_maximum_suppression

_MOST = 1000
"""Finds, best first, among which those of the same person are looked for."""
_SMALLEST, _LARGEST = 32, 8192


@dataclass(frozen=True)
class NetworkParameters:
    """What the user may say of a network.

    Attributes
    ----------
    size : columns and rows of the input, where the file leaves them open
    person : name or number of the class; None: "person", or the first
    least : score of those who are told of
    overlap : intersection over union above which the weaker of two boxes is dropped
    """

    size: tuple[int, int] | None = None
    person: str | None = None
    least: float = 0.25
    overlap: float = 0.6


class YoloNetwork:
    """A network that finds people.

    Parameters
    ----------
    path : the ONNX file
    pose : whether keypoints are wanted
    parameters : what the file does not say

    Raises
    ------
    InputError
        If it is no such file, OpenCV cannot run it, or its output is of no known layout.
    """

    def __init__(
        self, path: str | Path, *, pose: bool = False, parameters: NetworkParameters = NetworkParameters()
    ) -> None:
        self.parameters, self.path = parameters, str(path)
        file = OnnxFile.read(path)
        names, keypoints = _names(file), _keypoints(file)
        self._check_task(file, pose)
        self.size = _input_size(file, parameters.size)
        self.person = _person(names, parameters.person, self.path)
        self._net, cut = _loaded(file, self.size)
        blank = np.full((self.size[1], self.size[0], 3), 114, np.uint8)
        self._output, shape = self._chosen_output(self._run(Letterbox(self.size, self.size).applied(blank)))
        count = None if names is None else len(names)
        self.layout: Layout = layout_of(
            shape, self.size, path=self.path, cut=cut, names=count, keypoints=keypoints, pose=pose
        )
        if self.layout.classes is not None and self.person >= self.layout.classes:
            found = f"class {self.person} of {self.layout.classes}"
            raise InputError(found, "--person-class with a class that there is", path=self.path)

    def _check_task(self, file: OnnxFile, pose: bool) -> None:
        task = file.notes.get("task")
        wanted = ("pose",) if pose else ("detect", "pose")
        if task is not None and task not in wanted:
            raise InputError(f"a network for the task {task!r}", " or ".join(wanted), path=self.path)

    def _run(self, values: NDArray[np.float32]) -> dict[str, NDArray[np.float32]]:
        names = self._net.getUnconnectedOutLayersNames()
        try:
            with _quiet():
                self._net.setInput(values)
                return dict(zip(names, self._net.forward(names), strict=True))
        except cv2.error as error:
            raise _not_run(error, self.path) from error

    def _chosen_output(self, outputs: dict[str, NDArray[np.float32]]) -> tuple[str, tuple[int, ...]]:
        """The first output of three dimensions: besides, YOLOv5 tells of its cells, and others of masks."""
        flat = [name for name, values in outputs.items() if values.ndim == 3]
        name = flat[0] if flat else next(iter(outputs))
        return name, outputs[name].shape

    def found(self, image: Image) -> FoundPeople:
        """The people of an image (h, w, 3) uint8."""
        p = self.parameters
        box = Letterbox((image.shape[1], image.shape[0]), self.size)
        output = self._run(box.applied(image))[self._output]
        corners, scores, points = self.layout.decoded(output, self.person, p.least)
        order = np.argsort(-scores, kind="stable")[:_MOST]
        ends = np.clip(box.back(corners[order].reshape(-1, 2, 2)), 0.0, box.image)
        boxes = np.hstack([ends[:, 0], ends[:, 1] - ends[:, 0]])
        good = (boxes[:, 2:] >= 1.0).all(axis=1)
        order, boxes = order[good], boxes[good]
        if not self.layout.suppressed and len(boxes):
            kept = non_maximum_suppression(boxes, scores[order], p.overlap)
            order, boxes = order[kept], boxes[kept]
        if points is not None:
            points = points[order]
            places = np.where(points[..., 2:] > 0.0, box.back(points[..., :2]), 0.0)
            points = np.concatenate([places, points[..., 2:]], axis=2)
        return FoundPeople(boxes, scores[order], points)

    def detect(self, image: Image) -> tuple[FloatArray, FloatArray]:
        """Boxes (n, 4), left, top, width, height in pixels, and scores (n,), best first."""
        found = self.found(image)
        return found.boxes, found.scores


def _loaded(file: OnnxFile, size: tuple[int, int]) -> tuple[Any, bool]:
    """OpenCV's network, and whether it was cut before its selection."""
    is_open = any(side is None for shape in file.inputs.values() for side in shape)
    data = file.of_size(*size) if is_open else file.data
    try:
        with _quiet():
            return cv2.dnn.readNetFromONNX(np.frombuffer(data, np.uint8)), False
    except cv2.error as error:
        shorter = file.before_selection(*size)
        if shorter is None:
            raise _not_run(error, file.path) from error
    try:
        with _quiet():
            return cv2.dnn.readNetFromONNX(np.frombuffer(shorter, np.uint8)), True
    except cv2.error as error:
        raise _not_run(error, file.path) from error


def _not_run(error: cv2.error, path: str) -> InputError:
    reason = " ".join(str(error.err or error).split())[:160]
    return InputError(
        f"a network that OpenCV {cv2.__version__} cannot run ({reason})",
        "plain layers, exported for one image of a fixed size",
        path=path,
    )


@contextmanager
def _quiet() -> Iterator[None]:
    """OpenCV writes its errors down besides raising them."""
    logging = cv2.utils.logging
    level = logging.getLogLevel()
    logging.setLogLevel(logging.LOG_LEVEL_SILENT)
    try:
        yield
    finally:
        logging.setLogLevel(level)


def _input_size(file: OnnxFile, asked: tuple[int, int] | None) -> tuple[int, int]:
    """Columns and rows of the input."""
    if len(file.inputs) != 1:
        raise InputError(f"a network of {len(file.inputs)} inputs", "one input, an image", path=file.path)
    (shape,) = file.inputs.values()
    if len(shape) != 4 or shape[1] not in (3, None) or shape[0] not in (1, None):
        expected = "(1, 3, rows, columns), an image in colour"
        raise InputError(f"an input of shape {_as_text(shape)}", expected, path=file.path)
    rows, columns = shape[2:]
    fixed = None if rows is None or columns is None else (columns, rows)
    if fixed and asked and fixed != asked:
        raise InputError(
            f"an input of {fixed[0]} × {fixed[1]}", f"--input-size {asked[0]}x{asked[1]}", path=file.path
        )
    noted = _literal(file.notes.get("imgsz"))
    if fixed is None and asked is None and isinstance(noted, (list, tuple)) and len(noted) == 2:
        asked = (int(noted[1]), int(noted[0]))
    size = fixed or asked
    if size is None:
        found = f"an input of any size, {_as_text(shape)}"
        raise InputError(found, "--input-size, such as 640 or 1280x736", path=file.path)
    if not all(_SMALLEST <= side <= _LARGEST for side in size):
        raise InputError(
            f"an input of {size[0]} × {size[1]}", f"{_SMALLEST} to {_LARGEST} pixels", path=file.path
        )
    return size


def _as_text(shape: Shape) -> str:
    return f"({', '.join('any' if size is None else str(size) for size in shape)})"


def _literal(text: str | None) -> object:
    """What a note says; None if it cannot be read."""
    try:
        return None if text is None else ast.literal_eval(text)
    except (ValueError, SyntaxError, MemoryError, RecursionError):
        return None


def _names(file: OnnxFile) -> dict[int, str] | None:
    """Names of the classes by number."""
    noted = _literal(file.notes.get("names"))
    if isinstance(noted, (list, tuple)):
        noted = dict(enumerate(noted))
    if not isinstance(noted, dict) or not all(isinstance(key, int) for key in noted):
        return None
    return {key: str(name) for key, name in noted.items()}


def _keypoints(file: OnnxFile) -> tuple[int, int] | None:
    """How many keypoints there are and how many numbers each has, where the file says so."""
    noted = _literal(file.notes.get("kpt_shape"))
    if isinstance(noted, (list, tuple)) and len(noted) == 2 and noted[1] in (2, 3):
        return int(noted[0]), int(noted[1])
    return None


def _person(names: dict[int, str] | None, asked: str | None, path: str) -> int:
    """The number of the class of people."""
    known = {} if names is None else {name.lower(): number for number, name in names.items()}
    if asked is not None:
        if asked.isdecimal():
            return int(asked)
        if asked.lower() in known:
            return known[asked.lower()]
        named = ", ".join(list(known)[:5]) or "no names"
        raise InputError(f"--person-class {asked}", f"a number, or a name of the file ({named})", path=path)
    if names is None or len(names) == 1 or all(name.isdecimal() for name in known):
        return 0  # who names classes by number has not named them
    if "person" not in known:
        named = ", ".join(list(known)[:5])
        raise InputError(f"classes without a person ({named} …)", "--person-class", path=path)
    return known["person"]
