"""Motion: what differs from a background that follows the image slowly (003 §3)."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from perception.images.pixels import Image


def smoothed(image: Image) -> NDArray[np.float32]:
    """An image (h, w, 3) without most of its noise, as float."""
    return np.asarray(cv2.blur(image, (3, 3)), np.float32)


def running_average(
    background: NDArray[np.float32], image: NDArray[np.float32], rate: float
) -> NDArray[np.float32]:
    """The background (h, w, 3) after one more frame (h, w, 3): B + rate · (I − B)."""
    return np.asarray(cv2.addWeighted(background, 1.0 - rate, image, rate, 0.0), np.float32)


def foreground(
    background: NDArray[np.float32], image: NDArray[np.float32], threshold: float
) -> NDArray[np.float32]:
    """1 where any channel differs from the background by more than ``threshold`` grey levels (h, w)."""
    difference = cv2.absdiff(image, background)
    blue, green, red = cv2.split(difference)
    return np.asarray(cv2.max(cv2.max(blue, green), red) > threshold, np.float32)
