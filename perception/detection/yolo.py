"""YOLO networks in ONNX files.

====================  ===================  =============================================================
layout                output               a row
====================  ===================  =============================================================
``anchors``           (1, 3·cells, 5 + c)  middle, width, height, objectness, c classes (YOLOv5, v7)
``cells``             (1, 4 + c, cells)    middle, width, height, c classes (v8 to v12; v10 and v26 without
                                           their end-to-end heads); a column is one detection
``selected``          (1, n, 6)            corners, score, class (v10 and v26 with them)
====================  ===================  =============================================================

With keypoints each row continues with x, y and visibility of each. Positions are pixels of the input. Cells
have strides 8, 16 and 32 (and 64, or 4).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray
from perception.detection.boxes import FrameDetections
from perception.detection.onnx_network import OnnxNetwork, ScoreCheck, literal
from perception.images.pixels import Image, non_maximum_suppression
from perception.pose.keypoints import BY_NUMBER, KNOWN, in_coco_order

_GREY = (114, 114, 114)


def letterboxed(image: Image, size: tuple[int, int]) -> tuple[NDArray[np.float32], float, FloatArray]:
    """Place an image in the middle of a network's input of columns and rows, with its aspect ratio kept.

    Returns
    -------
    The input (1, 3, rows, columns), red, green, blue from 0 to 1; its pixels per pixel of the image; and the
    margin (2,) in columns to the left and rows above. Right and below may have one more.
    """
    (columns, rows), (h, w) = size, image.shape[:2]
    scale = min(columns / w, rows / h)
    width, height = min(max(1, round(w * scale)), columns), min(max(1, round(h * scale)), rows)
    left, top = (columns - width) // 2, (rows - height) // 2
    right, bottom = columns - width - left, rows - height - top
    small = cv2.resize(image, (width, height), interpolation=cv2.INTER_LINEAR)
    padded = cv2.copyMakeBorder(small, top, bottom, left, right, cv2.BORDER_CONSTANT, value=_GREY)
    values = np.asarray(cv2.dnn.blobFromImage(padded, 1.0 / 255.0, swapRB=True), np.float32)
    return values, scale, np.array([left, top], float)


Kind = Literal["anchors", "cells", "selected"]

_STRIDES = ((8, 16, 32), (8, 16, 32, 64), (4, 8, 16, 32))
_EXPECTED = "YOLO's (1, 3·cells, 5 + classes), (1, 4 + classes, cells) or (1, n, 6)"
_POSE = {"anchors": 52, "cells": 52, "selected": 51}
_EXPECTED_POSE = "YOLO-pose's (1, 56, cells) or (1, n, 57)"


@dataclass(frozen=True)
class OutputLayout:
    """Layout of an output.

    Attributes
    ----------
    kind : as in the table
    classes : number of classes; None: not part of the output
    points : keypoints of each person, 0: none
    columns : numbers of each keypoint: 2 (no visibility) or 3
    """

    kind: Kind
    classes: int | None
    points: int = 0
    columns: int = 3

    @property
    def _first(self) -> int:
        """Return the first column of the classes."""
        return 5 if self.kind == "anchors" else 4

    def _rows(self, output: NDArray[np.float32]) -> FloatArray:
        values = np.asarray(output[0], float)
        return values.T if self.kind == "cells" else values

    def scores(self, output: NDArray[np.float32]) -> FloatArray:
        """Return the scores (n, classes) of all detections; (n, 1) of those of ``selected``."""
        rows = self._rows(output)
        if self.kind == "selected":
            return rows[:, 4:5]
        assert self.classes is not None
        of_class = rows[:, self._first : self._first + self.classes]
        return of_class * rows[:, 4:5] if self.kind == "anchors" else of_class

    def decoded(
        self, output: NDArray[np.float32], person: int, least: float
    ) -> tuple[FloatArray, FloatArray, FloatArray | None]:
        """Corners (n, 4), scores (n,) from the least on, and keypoints (n, 17, 3) of people."""
        rows, of_class = self._rows(output), self.scores(output)
        if self.kind == "selected":
            start, scores = 6, of_class[:, 0]
            is_person = np.round(rows[:, 5]) == person
        else:
            start, scores = self._first + of_class.shape[1], of_class[:, person]
            is_person = of_class.argmax(axis=1) == person
        kept = is_person & (scores >= least) & np.isfinite(rows).all(axis=1)
        rows, scores = rows[kept], np.clip(scores[kept], 0.0, 1.0)
        corners = rows[:, :4]
        if self.kind != "selected":
            corners = np.hstack([rows[:, :2] - rows[:, 2:4] / 2.0, rows[:, :2] + rows[:, 2:4] / 2.0])
        return corners, scores, self._points(rows[:, start:]) if self.points else None

    def _points(self, values: FloatArray) -> FloatArray:
        values = values[:, : self.points * self.columns].reshape(len(values), self.points, self.columns)
        if self.columns == 2:
            values = np.concatenate([values, np.ones((*values.shape[:2], 1))], axis=2)
        return in_coco_order(values, BY_NUMBER[self.points])


def layout_of(
    shape: tuple[int, ...],
    size: tuple[int, int],
    *,
    path: str,
    names: int | None = None,
    keypoints: tuple[int, int] | None = None,
    pose: bool = False,
) -> OutputLayout:
    """The layout of an output.

    Parameters
    ----------
    shape : of the output
    size : columns and rows of the input
    path : of the file, for messages
    names : number of named classes in the file; None: no names
    keypoints : number of keypoints in the file's metadata, and numbers of each; None: not given
    pose : whether keypoints are wanted

    Raises
    ------
    InputError
        If it is not in the table, or has another number of classes or keypoints.
    """
    found = f"an output of shape {shape} for an input of {size[0]} × {size[1]}"
    expected = _EXPECTED_POSE if pose else _EXPECTED
    cells = {sum(-(-size[0] // s) * -(-size[1] // s) for s in strides) for strides in _STRIDES}
    if len(shape) != 3 or shape[0] != 1:
        raise InputError(found, expected, path=path)
    _, rows, columns = shape
    kind: Kind
    if rows in {3 * count for count in cells}:
        kind, numbers, before = "anchors", columns, 5
    elif columns in cells:
        kind, numbers, before = "cells", rows, 4
    elif columns >= 6 and rows not in cells and rows > 0:
        kind, numbers, before = "selected", columns, 6
    else:
        raise InputError(found, expected, path=path)
    if keypoints is None and names is None and numbers - before == _POSE[kind]:
        keypoints = (17, 3)  # YOLO-pose as it is, of one class
    if pose and keypoints is None:
        classes = 0 if kind == "selected" else names or 1
        keypoints = _counted_keypoints(numbers - before - classes, found, path)
    points, each = keypoints or (0, 3)
    if points and points not in BY_NUMBER and pose:
        raise InputError(f"a network of {points} keypoints", KNOWN, path=path)
    rest = numbers - before - points * each
    if kind == "selected":
        if rest:
            raise InputError(found, expected, path=path)
        return OutputLayout(kind, names, points, each)
    if rest < 1 or (names is not None and rest != names):
        suffix = f", and {names} classes by name" if names is not None else ""
        raise InputError(found + suffix, f"{before} + classes{' + keypoints' if points else ''}", path=path)
    return OutputLayout(kind, rest, points, each)


def _counted_keypoints(numbers: int, found: str, path: str) -> tuple[int, int]:
    """Number of keypoints and of numbers of each."""
    if numbers <= 0:
        raise InputError(f"{found}, without keypoints", _EXPECTED_POSE, path=path)
    if numbers % 3 or numbers // 3 not in BY_NUMBER:
        count = f"{numbers // 3} keypoints" if numbers % 3 == 0 else f"{numbers} numbers after box and class"
        raise InputError(f"{found}: {count}", KNOWN, path=path)
    return numbers // 3, 3


_MOST = 1000  # detections, best first, that enter non-maximum suppression
_OVERLAP = 0.6  # intersection over union above which the weaker of two boxes is dropped


class YoloNetwork:
    """YOLO network that detects people.

    Parameters
    ----------
    path : the ONNX file, or the opened one
    pose : whether keypoints are wanted
    size : columns and rows of the input, if the file leaves them open
    person : name or number of the class; None: "person", or the first
    least : least score of reported people

    Raises
    ------
    InputError
        If ONNX Runtime is missing or cannot run the file, or the layout of its output is unknown.
    """

    def __init__(
        self,
        path: str | Path | OnnxNetwork,
        *,
        pose: bool = False,
        size: tuple[int, int] | None = None,
        person: str | None = None,
        least: float = 0.25,
    ) -> None:
        self._network = path if isinstance(path, OnnxNetwork) else OnnxNetwork(path)
        self.path, self.least = self._network.path, least
        self.checked = ScoreCheck(self.path)
        notes = self._network.notes
        names, task = _names(notes), notes.get("task")
        wanted = ("pose",) if pose else ("detect", "pose")
        if task is not None and task not in wanted:
            raise InputError(f"a network for the task {task!r}", " or ".join(wanted), path=self.path)
        self.size = self._network.input_size(size)
        self.person = _person(names, person, self.path)
        blank = np.full((self.size[1], self.size[0], 3), 114, np.uint8)
        outputs = self._network.run(letterboxed(blank, self.size)[0])
        # The first output of three dimensions: YOLOv5 also returns its cells, and others return masks.
        self._output = next((k for k, values in enumerate(outputs) if values.ndim == 3), 0)
        self.layout: OutputLayout = layout_of(
            outputs[self._output].shape,
            self.size,
            path=self.path,
            names=None if names is None else len(names),
            keypoints=_keypoints(notes),
            pose=pose,
        )
        if self.layout.classes is not None and self.person >= self.layout.classes:
            found = f"class {self.person} of {self.layout.classes}"
            raise InputError(found, "--person-class with an existing class", path=self.path)

    def detect(self, image: Image) -> FrameDetections:
        """Return the people of an image (h, w, 3) uint8, best first."""
        values, scale, margin = letterboxed(image, self.size)
        output = self._network.run(values)[self._output]
        self.checked.add("scores", self.layout.scores(output))
        corners, scores, points = self.layout.decoded(output, self.person, self.least)
        if points is not None:
            self.checked.add("visibilities of keypoints", points[..., 2])
        order = np.argsort(-scores, kind="stable")[:_MOST]
        ends = np.clip((corners[order].reshape(-1, 2, 2) - margin) / scale, 0.0, image.shape[1::-1])
        boxes = np.hstack([ends[:, 0], ends[:, 1] - ends[:, 0]])
        good = (boxes[:, 2:] >= 1.0).all(axis=1)
        order, boxes = order[good], boxes[good]
        if self.layout.kind != "selected" and len(boxes):
            kept = non_maximum_suppression(boxes, scores[order], _OVERLAP)
            order, boxes = order[kept], boxes[kept]
        if points is not None:
            points = points[order]
            image_points = np.where(points[..., 2:] > 0.0, (points[..., :2] - margin) / scale, 0.0)
            points = np.concatenate([image_points, points[..., 2:]], axis=2)
        return FrameDetections(boxes, scores[order], points)


def _names(notes: Mapping[str, str]) -> dict[int, str] | None:
    """Return the names of the classes by number."""
    noted = literal(notes.get("names"))
    if isinstance(noted, (list, tuple)):
        noted = dict(enumerate(noted))
    if not isinstance(noted, dict) or not all(isinstance(key, int) for key in noted):
        return None
    return {key: str(name) for key, name in noted.items()}


def _keypoints(notes: Mapping[str, str]) -> tuple[int, int] | None:
    """Return the number of keypoints and of numbers of each, if the file has them."""
    noted = literal(notes.get("kpt_shape"))
    if isinstance(noted, (list, tuple)) and len(noted) == 2 and noted[1] in (2, 3):
        return int(noted[0]), int(noted[1])
    return None


def _person(names: dict[int, str] | None, asked: str | None, path: str) -> int:
    """Return the number of the class of people."""
    known = {} if names is None else {name.lower(): number for number, name in names.items()}
    if asked is not None:
        if asked.isdecimal():
            return int(asked)
        if asked.lower() in known:
            return known[asked.lower()]
        named = ", ".join(list(known)[:5]) or "no names"
        raise InputError(f"--person-class {asked}", f"a number, or a name of the file ({named})", path=path)
    if names is None or len(names) == 1 or all(name.isdecimal() for name in known):
        return 0  # numbers as names carry no information
    if "person" not in known:
        named = ", ".join(list(known)[:5])
        raise InputError(f"classes without a person ({named} …)", "--person-class", path=path)
    return known["person"]
