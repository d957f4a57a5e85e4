"""Labels of a user's own images: a CSV with a row for each file."""

from __future__ import annotations

import csv
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray
from graphtrack.io.numbers import parse_number
from perception.images.pixels import Image, as_uint8


@dataclass(frozen=True, eq=False)
class LabelledImages:
    """n images with numbers of each: ``values`` (n, k) in the order of the columns that were asked for."""

    images: list[Image]
    values: FloatArray


def read_labelled(folder: str | Path, labels: str | Path, columns: tuple[str, ...]) -> LabelledImages:
    """Read the images that a CSV names in its column ``image``, with other columns as numbers.

    Parameters
    ----------
    folder : where the images are
    labels : the CSV, with a heading
    columns : that it must have besides ``image``

    Raises
    ------
    InputError
        With the line of the first row that cannot be used.
    """
    images, values = [], []
    with Path(labels).open(encoding="utf-8-sig", newline="") as stream:
        reader = csv.DictReader(stream)
        missing = [name for name in ("image", *columns) if name not in (reader.fieldnames or [])]
        if missing:
            raise InputError("no such column", f"a column {missing[0]}", path=labels, column=missing[0])
        for row in reader:
            numbers = [parse_number(row[name] or "") for name in columns]
            for name, number in zip(columns, numbers, strict=True):
                if number is None:
                    line = reader.line_num
                    raise InputError(repr(row[name]), "a number", path=labels, line=line, column=name)
            image = cv2.imread(str(Path(folder) / row["image"]), cv2.IMREAD_UNCHANGED)
            if image is None:
                raise InputError(
                    f"image {row['image']!r}, which cannot be read",
                    f"an image in {folder}",
                    path=labels,
                    line=reader.line_num,
                )
            images.append(as_uint8(np.asarray(image)))
            values.append(numbers)
    if not images:
        raise InputError("no rows", "at least one image", path=labels)
    return LabelledImages(images, np.array(values, float))
