"""Many crops in one picture, to look at."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from perception.images.pixels import Image

_TITLE_HEIGHT = 18


def contact_sheet(
    images: Sequence[Image], columns: int, *, cell: tuple[int, int] = (64, 64), titles: Sequence[str] = ()
) -> Image:
    """Crops row by row, enlarged without smoothing so that every pixel shows.

    Parameters
    ----------
    images : arrays (h, w, 3) uint8
    columns : crops in a row
    cell : width and height of a cell in pixels; crops keep their proportions
    titles : of the columns
    """
    width, height = cell
    rows = -(-len(images) // columns)
    sheet = np.zeros((_TITLE_HEIGHT + rows * height, columns * width, 3), np.uint8)
    for k, image in enumerate(images):
        factor = min(width / image.shape[1], height / image.shape[0])
        shown = cv2.resize(image, None, fx=factor, fy=factor, interpolation=cv2.INTER_NEAREST)[
            :height, :width
        ]
        top, left = _TITLE_HEIGHT + k // columns * height, k % columns * width
        sheet[top : top + shown.shape[0], left : left + shown.shape[1]] = shown
    for k, title in enumerate(titles):
        cv2.putText(sheet, title, (k * width + 4, 13), cv2.FONT_HERSHEY_SIMPLEX, 0.42, (255, 255, 255), 1)
    return sheet
