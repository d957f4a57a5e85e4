"""Images brought to the size that a network takes, with grey around them, and places brought back."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from graphtrack.geometry.angles import FloatArray
from perception.images.pixels import Image

_GREY = (114, 114, 114)


@dataclass(frozen=True)
class Letterbox:
    """How an image lies in a network's input: enlarged evenly, in the middle.

    Attributes
    ----------
    image, size : columns and rows of the image and of the input
    """

    image: tuple[int, int]
    size: tuple[int, int]

    @property
    def scale(self) -> float:
        """Pixels of the input for one of the image."""
        return min(self.size[0] / self.image[0], self.size[1] / self.image[1])

    @property
    def shown(self) -> tuple[int, int]:
        """Columns and rows that the image takes in the input."""
        width, height = (max(1, round(side * self.scale)) for side in self.image)
        return min(width, self.size[0]), min(height, self.size[1])

    @property
    def margin(self) -> tuple[int, int]:
        """Columns to the left and rows above; to the right and below there may be one more."""
        return (self.size[0] - self.shown[0]) // 2, (self.size[1] - self.shown[1]) // 2

    def applied(self, image: Image) -> NDArray[np.float32]:
        """The network's input (1, 3, rows, columns): red, green, blue from 0 to 1."""
        (left, top), (width, height) = self.margin, self.shown
        right, bottom = self.size[0] - width - left, self.size[1] - height - top
        small = cv2.resize(image, (width, height), interpolation=cv2.INTER_LINEAR)
        whole = cv2.copyMakeBorder(small, top, bottom, left, right, cv2.BORDER_CONSTANT, value=_GREY)
        return np.asarray(cv2.dnn.blobFromImage(whole, 1.0 / 255.0, swapRB=True), np.float32)

    def back(self, places: FloatArray) -> FloatArray:
        """Places (..., 2) of the input, in pixels of the image."""
        return np.asarray((places - np.array(self.margin)) / self.scale, float)
