"""Boxes of people: MOT text (frame, id, left, top, width, height, confidence), and CAVIAR's XML."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from graphtrack.errors import InputError
from graphtrack.io import atomic_path, schema
from graphtrack.io.caviar import looks_like
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
    """Boxes of a MOT file or of CAVIAR's ground truth, in their order.

    In MOT text, rows with confidence 0 are marked to be ignored and left out; so are CAVIAR's empty boxes.

    Raises
    ------
    InputError
        With line and column of the first cell that cannot be used, such as a box of zero size.
    """
    source = Source.open(path)
    found = _of_caviar(source) if looks_like(source.head, source.path) else _of_mot(source)
    if not found:
        raise InputError("no boxes", "at least one", path=path)
    return found


def _of_caviar(source: Source) -> list[PersonBox]:
    from xml.etree.ElementTree import ParseError

    from defusedxml import DefusedXmlException
    from defusedxml.ElementTree import fromstring

    found = []
    try:
        for frame in fromstring(source.data, forbid_dtd=True).iter("frame"):
            for item in frame.findall("objectlist/object"):
                cells = item.find("box")
                if cells is None:
                    raise ValueError("an object without a box")
                x, y, width, height = (float(cells.attrib[name]) for name in ("xc", "yc", "w", "h"))
                if min(width, height) > 0.0:
                    box = (x - width / 2.0, y - height / 2.0, width, height)
                    found.append(PersonBox(int(frame.attrib["number"]), int(item.attrib["id"]), box))
    except (ParseError, DefusedXmlException, ValueError, KeyError) as error:
        raise InputError(f"unusable XML ({error})", "CAVIAR ground truth", path=source.path) from error
    return found


def _of_mot(source: Source) -> list[PersonBox]:
    table = read_numbers(source, delimiter=",", widths=(7, 8, 9, 10), names=_NAMES)
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
