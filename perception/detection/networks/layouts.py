"""How YOLO networks write down what they found.

====================  ===================  =============================================================
layout                output               a row
====================  ===================  =============================================================
``anchors``           (1, 3·cells, 5 + c)  middle, width, height, objectness, c classes (YOLOv5, v7)
``cells``             (1, 4 + c, cells)    middle, width, height, c classes (v8 to v12; v10 and v26 without
                                           their end-to-end heads); a column is one find
``selected``          (1, n, 6)            corners, score, class (v10 and v26 with them)
``unselected``        (1, cells, 4 + c)    corners, c classes: the last two, cut before the selection
====================  ===================  =============================================================

With keypoints each row goes on with x, y and visibility of each. Places are pixels of the input. Cells are
those of strides 8, 16 and 32 (and 64, or 4).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray
from perception.pose.keypoints.skeleton import BY_NUMBER, KNOWN, in_coco_order

Kind = Literal["anchors", "cells", "selected", "unselected"]

_STRIDES = ((8, 16, 32), (8, 16, 32, 64), (4, 8, 16, 32))
_EXPECTED = "YOLO's (1, 3·cells, 5 + classes), (1, 4 + classes, cells) or (1, n, 6)"
_POSE = {"anchors": 52, "cells": 52, "unselected": 52, "selected": 51}
_EXPECTED_POSE = "YOLO-pose's (1, 56, cells) or (1, n, 57)"


@dataclass(frozen=True)
class Layout:
    """What the numbers of an output are.

    Attributes
    ----------
    kind : as in the table
    classes : how many; None: the output does not say
    points : keypoints of each person, 0: none
    columns : numbers of each keypoint: 2 (no visibility) or 3
    """

    kind: Kind
    classes: int | None
    points: int = 0
    columns: int = 3

    def rows(self, output: NDArray[np.float32]) -> FloatArray:
        """A row (n, k) for each find."""
        values = np.asarray(output[0], float)
        return values.T if self.kind == "cells" else values

    @property
    def suppressed(self) -> bool:
        """Whether nobody is found twice."""
        return self.kind in ("selected", "unselected")

    def decoded(
        self, output: NDArray[np.float32], person: int, least: float
    ) -> tuple[FloatArray, FloatArray, FloatArray | None]:
        """Corners (n, 4), scores (n,) from the least on, and keypoints (n, 17, 3) of people."""
        rows = self.rows(output)
        start, scores = 6, rows[:, 4]
        if self.kind == "selected":
            is_person = np.round(rows[:, 5]) == person
        else:
            first = 5 if self.kind == "anchors" else 4
            assert self.classes is not None
            start = first + self.classes
            of_class = rows[:, first:start]
            is_person = of_class.argmax(axis=1) == person
            scores = of_class[:, person] * (scores if self.kind == "anchors" else 1.0)
        kept = is_person & (scores >= least) & np.isfinite(rows).all(axis=1)
        rows, scores = rows[kept], np.clip(scores[kept], 0.0, 1.0)
        corners = rows[:, :4]
        if self.kind in ("anchors", "cells"):
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
    cut: bool = False,
    names: int | None = None,
    keypoints: tuple[int, int] | None = None,
    pose: bool = False,
) -> Layout:
    """The layout of an output.

    Parameters
    ----------
    shape : of the output
    size : columns and rows of the input
    path : of the file, for messages
    cut : whether the network ends before its selection
    names : how many classes the file names; None: it does not
    keypoints : how many the file says there are, and numbers of each; None: it does not
    pose : whether keypoints are wanted

    Raises
    ------
    InputError
        If it is none of the table, or has another number of classes or keypoints.
    """
    found = f"an output of shape {shape} for an input of {size[0]} × {size[1]}"
    expected = _EXPECTED_POSE if pose else _EXPECTED
    cells = {sum(-(-size[0] // s) * -(-size[1] // s) for s in strides) for strides in _STRIDES}
    if len(shape) != 3 or shape[0] != 1:
        raise InputError(found, expected, path=path)
    _, rows, columns = shape
    kind: Kind
    if cut and rows in cells:
        kind, numbers, before = "unselected", columns, 4
    elif rows in {3 * count for count in cells}:
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
        keypoints = _told_keypoints(numbers - before - (0 if kind == "selected" else names or 1), found, path)
    points, each = keypoints or (0, 3)
    if points and points not in BY_NUMBER and pose:
        raise InputError(f"a network of {points} keypoints", KNOWN, path=path)
    rest = numbers - before - points * each
    if kind == "selected":
        if rest:
            raise InputError(found, expected, path=path)
        return Layout(kind, names, points, each)
    if rest < 1 or (names is not None and rest != names):
        told = f", and {names} classes by name" if names is not None else ""
        raise InputError(found + told, f"{before} + classes{' + keypoints' if points else ''}", path=path)
    return Layout(kind, rest, points, each)


def _told_keypoints(numbers: int, found: str, path: str) -> tuple[int, int]:
    """How many keypoints so many numbers are."""
    if numbers <= 0:
        raise InputError(f"{found}, without keypoints", _EXPECTED_POSE, path=path)
    if numbers % 3 or numbers // 3 not in BY_NUMBER:
        count = (
            f"{numbers // 3} keypoints" if numbers % 3 == 0 else f"{numbers} numbers besides box and class"
        )
        raise InputError(f"{found}: {count}", KNOWN, path=path)
    return numbers // 3, 3
