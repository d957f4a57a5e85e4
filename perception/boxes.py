"""Boxes of people in MOT text: frame, id, left, top, width, height, confidence."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from graphtrack.errors import InputError
from graphtrack.io import atomic_path, schema
from graphtrack.io.numbers import read_numbers
from graphtrack.io.source import Source

_NAMES = ("frame", "id", "left", "top", "width", "height", "confidence", "x", "y", "z")


@dataclass(frozen=True)
class PersonBox:
    """A person in one frame.

    Attributes
    ----------
    frame, track_id : whole numbers; −1 is no identity
    box : left, top, width, height in pixels
    confidence : of the detector
    """

    frame: int
    track_id: int
    box: tuple[float, float, float, float]
    confidence: float = 1.0


def read_boxes(path: str | Path) -> list[PersonBox]:
    """Boxes of a MOT file, in its order; rows with confidence 0 are marked to be ignored and left out.

    Raises
    ------
    InputError
        With line and column of the first cell that cannot be used, such as a box of zero size.
    """
    table = read_numbers(Source.open(path), delimiter=",", widths=(7, 8, 9, 10), names=_NAMES)
    frames, identities = table.integers(0), table.integers(1, schema.LARGEST_ID)
    found = []
    for row, values in enumerate(table.values):
        for column in (4, 5):
            if not values[column] > 0.0:
                raise table.fail(row, column, "a size above 0")
        if values[6] != 0.0:
            left, top, width, height = (float(value) for value in values[2:6])
            found.append(
                PersonBox(
                    int(frames[row]), int(identities[row]), (left, top, width, height), float(values[6])
                )
            )
    if not found:
        raise InputError("no boxes", "at least one", path=path)
    return found


def write_boxes(boxes: Iterable[PersonBox], path: str | Path) -> None:
    """Write MOT text that `read_boxes` and any MOT tool read.

    Raises
    ------
    InputError
        If the place cannot be written to.
    """
    with atomic_path(path) as temporary, temporary.open("w", encoding="ascii", newline="\n") as stream:
        for item in boxes:
            cells = ",".join(f"{value:.2f}" for value in (*item.box, item.confidence))
            stream.write(f"{item.frame},{item.track_id},{cells},-1,-1,-1\n")


def foot_point(box: tuple[float, float, float, float]) -> np.ndarray:
    """The middle (2,) of a box's lower edge, in pixels."""
    left, top, width, height = box
    return np.array([left + width / 2.0, top + height])
