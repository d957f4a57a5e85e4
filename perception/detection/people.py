"""People in single frames: OpenCV's HOG + SVM detector at all scales."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.special import expit

from graphtrack.geometry.angles import FloatArray
from perception.detection.blocks import CELL, FOOT, TALL, WindowFilter, foot_boxes, gradient_blocks, resized
from perception.detection.boxes import Detections
from perception.images.pixels import Image, non_maximum_suppression

_ROWS = 720
_OVERLAP = 0.4
"""Intersection over union above which the weaker of two boxes is dropped."""
_STEP = 1.08
"""Ratio of neighbouring scales."""
_MARGIN = 16
"""Pixels by which a window may reach beyond the image."""
_SLOPE = 2.0
"""Log odds of a score of one; those of zero are even."""


class PeopleDetector:
    """OpenCV's default people detector at all scales; its weights come with the library.

    An image of fewer than 720 rows is enlarged to that, by a factor of 8 at most.

    Parameters
    ----------
    threshold : least score of the SVM
    """

    def __init__(self, threshold: float = 0.3) -> None:
        self.threshold = threshold
        self._filter = WindowFilter.of_opencv()

    def detect(self, image: Image) -> Detections:
        """Return people with the probabilities of them, best first."""
        found, heights, scores = [np.empty((0, 2))], [np.empty(0)], [np.empty(0)]
        for scale in self._scales(image):
            feet, values = self._at(image, scale)
            kept = values > self.threshold
            found.append(feet[kept])
            heights.append(np.full(int(kept.sum()), TALL / scale))
            scores.append(values[kept].astype(float))
        boxes, score = foot_boxes(np.vstack(found), np.concatenate(heights)), np.concatenate(scores)
        best = non_maximum_suppression(boxes, score, _OVERLAP)
        return Detections(boxes[best], np.asarray(expit(_SLOPE * score[best]), float))

    def _scales(self, image: Image) -> list[float]:
        """Factors of the image, from the largest to the last at which a window fits in it."""
        rows, columns = image.shape[:2]
        largest = float(np.clip(_ROWS / rows, 1.0, 8.0))
        least = max(128 / rows, 64 / columns)
        if largest < least:
            return []
        count = int(np.log(largest / least) / np.log(_STEP))
        return [largest / _STEP**k for k in range(count + 1)]

    def _at(self, image: Image, scale: float) -> tuple[FloatArray, NDArray[np.float32]]:
        """Feet (n, 2) and scores (n,) of all windows of the image at a scale."""
        size = max(64, round(image.shape[1] * scale)), max(128, round(image.shape[0] * scale))
        large = cv2.copyMakeBorder(
            resized(image, size), _MARGIN, _MARGIN, _MARGIN, _MARGIN, cv2.BORDER_REPLICATE
        )
        scores = self._filter.scores(gradient_blocks(np.asarray(large, np.uint8)))
        rows, columns = np.indices(scores.shape)
        feet = np.stack([columns * CELL + FOOT[0], rows * CELL + FOOT[1]], axis=-1) - _MARGIN
        return feet.reshape(-1, 2) / scale, scores.ravel()
