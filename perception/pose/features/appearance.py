"""What somebody looks like: colours and texture by parts of the body, in a few numbers.

Histograms of parts of the body, weighed towards its axis, are those of SDALF (Farenzena, Bazzani, Perina,
Murino & Cristani, Person re-identification by symmetry-driven accumulation of local features, CVPR 2010),
here joint ones of CIE L*a*b*, with orientations of gradients beside them (Dalal & Triggs, CVPR 2005). Their
square roots are compared, so that Euclidean distances are Hellinger's; a projection makes them short.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from graphtrack.geometry.angles import FloatArray
from perception.images.pixels import Image
from perception.pose.features.hog import BINS, cell_histograms

HEIGHT, WIDTH = 64, 24
"""Pixels to which a person's picture is brought."""
PARTS = ((0, 11), (11, 22), (22, 33), (33, 57))
"""Rows of the head, the chest, the waist, the legs. Below are the ground and the shadow."""
LEVELS = (6, 5, 5)
"""Bins of L*, a* and b*."""
_TEXTURED = ((1, 4), (4, 7))
"""Eighths of the height whose gradients count: trunk and legs."""
_CHROMA = 15.0
"""The outermost bins of a* and b* are centred on ± this; streets and clothes have little colour."""
_AXIS = 0.18
"""1-σ of the weight of columns, in widths: the border is background."""

_COLOURS = len(PARTS) * int(np.prod(LEVELS))
LENGTH = _COLOURS + len(_TEXTURED) * BINS
"""Numbers of a description before it is projected."""

Looks = NDArray[np.uint8]
"""(n, `LENGTH`) square roots of histograms, in 255ths: they are kept of all detections of a recording."""


def light_of(image: Image) -> FloatArray:
    """The median L*, a* and b* (3,) of a frame (h, w, 3): exposure, and the colour of the light."""
    few = np.ascontiguousarray(image[::8, ::8])
    return np.asarray(np.median(_lab(few).reshape(-1, 3), axis=0), float)


def describe(pictures: Sequence[Image], light: FloatArray) -> Looks:
    """Descriptions (n, `LENGTH`) of the pictures (h, w, 3) of people, each cut out of one frame.

    Parameters
    ----------
    light : (3,) of that frame, as `light_of` has it; colours are relative to it
    """
    n = len(pictures)
    if not n:
        return np.empty((0, LENGTH), np.uint8)
    small = [cv2.resize(picture, (WIDTH, HEIGHT), interpolation=cv2.INTER_AREA) for picture in pictures]
    lab = _lab(np.concatenate(small)).reshape(n, HEIGHT, WIDTH, 3)
    brightness = np.clip(lab[..., 0] * 2.55, 0.0, 255.0).astype(np.uint8)
    found = np.concatenate([_colours(lab - light.astype(np.float32)), _textures(brightness)], axis=1)
    return np.rint(255.0 * np.sqrt(found)).astype(np.uint8)


def _lab(image: Image) -> NDArray[np.float32]:
    """L* (0 … 100), a* and b* (h, w, 3)."""
    return np.asarray(cv2.cvtColor(image.astype(np.float32) / 255.0, cv2.COLOR_BGR2LAB), np.float32)


def _colours(lab: NDArray[np.float32]) -> FloatArray:
    """Joint histograms (n, parts · bins) of colours (n, h, w, 3) about the light, of sum 1 each.

    A pixel votes for the eight nearest bins, by linear interpolation.
    """
    n = len(lab)
    steps = np.array(LEVELS) - 1
    place = (lab + np.array([50.0, _CHROMA, _CHROMA])) / (100.0, 2.0 * _CHROMA, 2.0 * _CHROMA) * steps
    place = np.clip(place, 0.0, steps)
    lower = np.minimum(place.astype(np.int64), steps - 1)
    share = place - lower
    columns = np.exp(-0.5 * (((np.arange(WIDTH) + 0.5) / WIDTH - 0.5) / _AXIS) ** 2)
    size, strides = int(np.prod(LEVELS)), np.array([LEVELS[1] * LEVELS[2], LEVELS[2], 1])
    first = lower @ strides
    result = np.empty((n, len(PARTS), size))
    for part, (top, bottom) in enumerate(PARTS):
        rows = slice(top, bottom)
        bins = first[:, rows] + (size * np.arange(n))[:, None, None]
        weight = np.broadcast_to(columns / columns.sum() / (bottom - top), bins.shape)
        total = np.zeros(n * size)
        for corner in np.ndindex(2, 2, 2):
            of_corner = np.where(np.array(corner, bool), share[:, rows], 1.0 - share[:, rows]).prod(axis=-1)
            step = int(np.dot(corner, strides))
            total += np.bincount((bins + step).ravel(), (weight * of_corner).ravel(), n * size)
        result[:, part] = total.reshape(n, size)
    return np.minimum(result.reshape(n, -1), 1.0)


def _textures(brightness: NDArray[np.uint8]) -> FloatArray:
    """Shares (n, parts · 9) of the orientations of gradients of (n, h, w); small where all is even."""
    cells = cell_histograms(brightness, 8, 2).sum(axis=2)
    parts = np.stack([cells[:, top:bottom].sum(axis=1) for top, bottom in _TEXTURED], axis=1)
    return np.asarray((parts / (parts.sum(axis=2, keepdims=True) + 100.0)).reshape(len(parts), -1), float)


@dataclass(frozen=True, eq=False)
class Projection:
    """From descriptions to the numbers that a table has.

    Attributes
    ----------
    mean : (`LENGTH`,)
    basis : (`LENGTH`, size) orthonormal columns
    """

    mean: FloatArray
    basis: FloatArray

    def __call__(self, looks: Looks) -> FloatArray:
        """Numbers (n, size) to four decimals, of descriptions (n, `LENGTH`); most are within ±1."""
        return np.asarray(np.round((looks / 255.0 - self.mean) @ self.basis, 4), float)

    @classmethod
    def fitted(cls, looks: Looks, size: int = 32) -> Projection:
        """The principal components of a recording; of less than 2 · ``size`` people, `fixed`."""
        if len(looks) < 2 * size:
            return cls.fixed()
        some = looks[:: -(-len(looks) // 8192)] / 255.0
        mean = some.mean(axis=0)
        _, vectors = np.linalg.eigh((some - mean).T @ (some - mean))
        return cls(mean, np.asarray(vectors[:, : -size - 1 : -1], float))

    @classmethod
    def fixed(cls, size: int = 64) -> Projection:
        """A random projection, the same always: it keeps distances nearly (Johnson & Lindenstrauss 1984).

        For streams, of which nothing is known beforehand.
        """
        columns = np.random.default_rng(0).normal(size=(LENGTH, size))
        return cls(np.zeros(LENGTH), np.asarray(np.linalg.qr(columns)[0], float))
