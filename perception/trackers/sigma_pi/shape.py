"""Shape: local features of the target in the last frames, against those of the background (Yan et al. 2011,
§3)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from graphtrack.geometry.angles import FloatArray
from perception.images.pixels import Image

DIMENSION = 128


@dataclass(frozen=True, eq=False)
class Features:
    """n local features.

    Attributes
    ----------
    points : (n, 2) pixels
    descriptors : (n, 128) of length 1; the product of two is their similarity, 0…1
    """

    points: FloatArray
    descriptors: NDArray[np.float32]

    def chosen(self, which: NDArray[Any]) -> Features:
        """Some of them, by a mask (n,) or by numbers."""
        return Features(self.points[which], self.descriptors[which])


def none() -> NDArray[np.float32]:
    """No descriptors (0, 128)."""
    return np.zeros((0, DIMENSION), np.float32)


def detect(sift: Any, grey: Image, window: FloatArray | None = None) -> Features:
    """SIFT features of a grey image (h, w), as roots of shares (Arandjelović & Zisserman 2012).

    Parameters
    ----------
    window : (4,) left, top, width, height of the only part that is looked at; points are the image's
    """
    left = top = 0
    if window is not None:
        left, top = (max(int(value), 0) for value in window[:2])
        right, bottom = (max(int(value), 0) for value in window[:2] + window[2:])
        grey = grey[top:bottom, left:right]
    if not grey.size:
        return Features(np.zeros((0, 2)), none())
    keypoints, found = sift.detectAndCompute(grey, None)
    if not keypoints:
        return Features(np.zeros((0, 2)), none())
    share = found / np.maximum(found.sum(axis=1, keepdims=True), 1e-9)
    points = np.array([point.pt for point in keypoints]) + np.array([left, top])
    return Features(points, np.sqrt(share).astype(np.float32))


def similarity(descriptors: NDArray[np.float32], known: NDArray[np.float32]) -> FloatArray:
    """The greatest similarity (n,) of each descriptor (n, 128) to any known one (m, 128); 0 without any."""
    if not len(known) or not len(descriptors):
        return np.zeros(len(descriptors))
    return np.asarray((descriptors @ known.T).max(axis=1), float)


def matching_rate(earlier: NDArray[np.float32], later: NDArray[np.float32], matched: float) -> float:
    """Share of the earlier frame's features that have one at least as similar as ``matched`` in the later."""
    return float((similarity(earlier, later) >= matched).mean()) if len(earlier) else 0.0


def memory_similarity(
    descriptors: NDArray[np.float32], memory: Sequence[NDArray[np.float32]], weights: FloatArray
) -> FloatArray:
    """Similarity (n,) of descriptors to the frames of a memory: the greatest, each times the frame's weight.

    Parameters
    ----------
    memory : descriptors of each frame
    weights : of the frames, 0…1
    """
    found = np.zeros(len(descriptors))
    for frame, weight in zip(memory, weights, strict=True):
        found = np.maximum(found, weight * similarity(descriptors, frame))
    return found


def point_scores(target: FloatArray, background: FloatArray, matched: float, margin: float) -> FloatArray:
    """How much each feature speaks for the target (n,), −1…1, by its similarities (n,) to both.

    It is the lead of the target over the background in units of ``margin``, less a half, for features that
    are at least as similar as ``matched`` to either: what is alike to both speaks against the target. Others
    say nothing.
    """
    lead = np.clip((target - background) / margin - 0.5, -1.0, 1.0)
    return np.asarray(np.where(np.maximum(target, background) >= matched, lead, 0.0))


def inside(points: FloatArray, windows: FloatArray) -> NDArray[np.bool_]:
    """Whether each window (m, 4) holds each point (n, 2): (m, n)."""
    low = windows[:, None, :2]
    return np.asarray(((points >= low) & (points < low + windows[:, None, 2:])).all(axis=2))
