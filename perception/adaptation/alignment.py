"""Where the head is in boxes that are off: all people of a recording aligned to common templates.

A template is of the gradients of head and shoulders, as seen in one quarter of the directions of walking,
whitened by what is beside heads (Hariharan, Malik & Ramanan 2012): its score is the log density ratio of a
head here and a head elsewhere, for Gaussians of one covariance. People's heads are placed by templates of
other people only, so that no one confirms their own mistakes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve

from graphtrack.geometry.angles import FloatArray
from perception.adaptation.patches import in_patch, of_patch
from perception.images.pixels import Image, grey
from perception.pose.features.hog import BINS
from perception.pose.heads import HeadCandidates

_STEP = 2
"""Pixels of a patch from one place to the next."""
_APART = 2
"""Steps between a template's cells."""
_CELLS = 14
_ABOVE, _BESIDE = 10, 14
"""Steps from a template's first cell to the middle of the head, down and across."""
_ACROSS, _DOWN = 11, 10
"""Steps that a head is looked for from where it usually is."""
_USUAL = np.array([0.0, 0.085])
"""The middle of the head, in heights of the box from the middle of its top."""
_MARGIN = 6
"""Squares about the part that is looked at, for filters."""
_BLUR, _BLUR_AROUND = 1.0, 5.0
"""1-σ in squares."""
_SQUARES = (2 * _DOWN + 1 + _APART * _CELLS, 2 * _ACROSS + 1 + _APART * _CELLS)
"""Rows and columns that templates see from all of the places."""
_SHRINKAGE = 0.05
_QUARTERS = 4
_SHARED = 30.0
"""Samples that the mean of all quarters counts as in that of each."""
_BESIDE_EACH = 5
"""Places beside each head, for the covariance."""
_NOT_NEAR = 4.0
"""Steps from the head from which on a place is beside it."""

HEAD_WIDTH, HEAD_HEIGHT = 0.13, 0.16
"""Of the head, in heights of the box."""

_X, _Y = (
    part.ravel() for part in np.meshgrid(np.arange(-_ACROSS, _ACROSS + 1), np.arange(-_DOWN, _DOWN + 1))
)
_PLACES = _USUAL + _STEP / 160.0 * np.column_stack([_X, _Y])
"""(n, 2) where a head is looked for."""


def within_reach(head: FloatArray) -> NDArray[np.bool_]:
    """Whether heads (n, 2), in heights of the box, are among the places where they are looked for."""
    low, high = _PLACES.min(axis=0), _PLACES.max(axis=0)
    return np.asarray(((head >= low) & (head <= high)).all(axis=1), np.bool_)


def orientations(patch: Image) -> NDArray[np.float32]:
    """Gradients (rows, columns, 9) about head and shoulders, in squares of `_STEP` pixels of a patch.

    They are those of square roots, shared among two orientations each, blurred, and relative to those
    around.
    """
    middle = np.rint(in_patch(_USUAL) / _STEP).astype(int)
    first = middle[::-1] - np.array([_ABOVE + _DOWN, _BESIDE + _ACROSS])
    small = (patch.shape[1] // _STEP, patch.shape[0] // _STEP)
    values = np.sqrt(cv2.resize(grey(patch), small, interpolation=cv2.INTER_AREA).astype(np.float32))
    rows, columns = (
        np.clip(np.arange(start - _MARGIN, start + squares + _MARGIN), 0, size - 1)
        for start, squares, size in zip(first.tolist(), _SQUARES, values.shape, strict=True)
    )
    values = values[rows[:, None], columns]
    across = cv2.Sobel(values, cv2.CV_32F, 1, 0, ksize=1)
    down = cv2.Sobel(values, cv2.CV_32F, 0, 1, ksize=1)
    strength, angle = (np.asarray(part) for part in cv2.cartToPolar(across, down))
    place = np.mod(angle, np.pi) * (BINS / np.pi) + (BINS - 0.5)
    lower = place.astype(np.int32)
    share = place - lower
    layers = np.zeros((*values.shape, BINS), np.float32)
    square = np.arange(values.size).reshape(values.shape) * BINS
    layers.flat[square + lower % BINS] = strength * (1.0 - share)
    layers.flat[square + (lower + 1) % BINS] = strength * share
    layers = np.asarray(cv2.GaussianBlur(layers, (0, 0), _BLUR))
    around = cv2.GaussianBlur(np.sqrt(np.einsum("yxb,yxb->yx", layers, layers)), (0, 0), _BLUR_AROUND)
    layers /= np.asarray(around)[..., None] + 0.15
    return np.ascontiguousarray(layers[_MARGIN:-_MARGIN, _MARGIN:-_MARGIN])


def _windows(layers: NDArray[np.float32], places: NDArray[np.int64]) -> NDArray[np.float32]:
    """What a template sees at some of the places (n,), (n, 9 · cells²): row by row, its cells' bins."""
    row, column = places // (2 * _ACROSS + 1), places % (2 * _ACROSS + 1)
    cells = _APART * np.arange(_CELLS)
    found = layers[(row[:, None] + cells)[:, :, None], (column[:, None] + cells)[:, None, :]]
    return np.ascontiguousarray(found).reshape(len(places), -1)


def _mirrored(windows: NDArray[np.float32]) -> NDArray[np.float32]:
    """What a template would see in mirror images (n, d)."""
    cells = windows.reshape(-1, _CELLS, _CELLS, BINS)[:, :, ::-1, ::-1]
    return np.ascontiguousarray(cells).reshape(len(windows), -1)


def _correlated(layers: NDArray[np.float32], weight: NDArray[np.float32]) -> NDArray[np.float32]:
    """Templates (k, d) on what they see at each place, (n, k)."""
    down, across = 2 * _DOWN + 1, 2 * _ACROSS + 1
    columns = np.arange(across)[:, None] + _APART * np.arange(_CELLS)
    rows = layers[: down + _APART * (_CELLS - 1), columns].reshape(-1, _CELLS * BINS)
    by_row = weight.reshape(len(weight), _CELLS, _CELLS * BINS)
    found = np.zeros((down * across, len(weight)), np.float32)
    # Row by row of the templates: products as small as these are not worth a second thread.
    for i in range(_CELLS):
        found += rows[_APART * i * across :][: len(found)] @ by_row[:, i].T
    return found


def _quarter(angle: FloatArray) -> NDArray[np.int64]:
    return np.asarray(np.rint(angle / (2.0 * np.pi / _QUARTERS)).astype(int) % _QUARTERS, np.int64)


@dataclass(frozen=True, eq=False)
class HeadTemplates:
    """Templates of head and shoulders, and where heads are in the boxes of a recording.

    Attributes
    ----------
    weight : (k, d) of each template
    bias : (k,)
    place : (2, 2) mean and 1-σ of the head's middle, in heights of the box from the middle of its top
    """

    weight: NDArray[np.float32]
    bias: FloatArray
    place: FloatArray

    def scores(self, patch: Image) -> FloatArray:
        """Log ratios (n,) of a head at each place where one is looked for, by the likeliest template."""
        found = _correlated(orientations(patch), self.weight) + self.bias
        away = (_PLACES - self.place[0]) / self.place[1]
        return np.asarray(found.max(axis=1) - 0.5 * np.square(away).sum(axis=1), float)

    def candidates(self, patch: Image, most: int = 3) -> HeadCandidates:
        """Heads in a patch, best first, in heights of the box from the middle of its top."""
        scores = self.scores(patch)
        left = np.argsort(-scores, kind="stable")
        kept: list[int] = []
        while len(left) and len(kept) < most:
            best = int(left[0])
            kept.append(best)
            left = left[np.maximum(np.abs(_X[left] - _X[best]), np.abs(_Y[left] - _Y[best])) > 2]
        size = np.array([HEAD_WIDTH, HEAD_HEIGHT])
        boxes = np.hstack([_PLACES[kept] - size / 2.0, np.broadcast_to(size, (len(kept), 2))])
        return HeadCandidates(boxes, scores[kept])


@dataclass(frozen=True, eq=False)
class HeadSamples:
    """What templates are learned from: n heads and their mirror images, and what is beside all of them.

    Attributes
    ----------
    place : (n, 2) middles of heads, in heights of the box from the middle of its top
    quarter : (2, n) of the directions, of the heads and of their mirror images
    seen : (2, n, d) what a template sees of them
    mean : (d,) beside heads
    factor : of the covariance beside heads, as from `scipy.linalg.cho_factor`
    """

    place: FloatArray
    quarter: NDArray[np.int64]
    seen: NDArray[np.float32]
    mean: NDArray[np.float32]
    factor: tuple[NDArray[Any], bool]

    @classmethod
    def of(
        cls, patches: Sequence[Image], place: FloatArray, angle: FloatArray, rng: np.random.Generator
    ) -> HeadSamples:
        """Samples of people whose heads are known, or thought to be.

        Parameters
        ----------
        patches : n of them
        place : (n, 2) as above
        angle : (n,) radians, where they go, in the image frame
        """
        nearest = np.argmin(np.square(place[:, None, :] - _PLACES).sum(axis=2), axis=1)
        seen, beside = [], []
        for patch, best in zip(patches, nearest.tolist(), strict=True):
            far = np.flatnonzero(np.hypot(_X - _X[best], _Y - _Y[best]) > _NOT_NEAR)
            places = np.array([best, *rng.choice(far, _BESIDE_EACH, replace=False)])
            windows = _windows(orientations(patch), places)
            seen.append(windows[0])
            beside.append(windows[1:])
        heads, others = np.array(seen), np.concatenate(beside)
        others = np.vstack([others, _mirrored(others)])
        mean = others.mean(axis=0)
        covariance = (others - mean).T @ (others - mean) / len(others)
        size = len(covariance)
        covariance[np.diag_indices(size)] += _SHRINKAGE * np.trace(covariance) / size + 1e-6
        quarter = np.stack([_quarter(angle), _quarter(-angle)])
        both = np.stack([heads, _mirrored(heads)])
        return cls(place, quarter, both, mean, cho_factor(covariance.astype(float), lower=True))

    def templates(self, used: NDArray[np.bool_]) -> HeadTemplates:
        """Templates of the heads (n,) that are used."""
        heads, quarter = self.seen[:, used].reshape(-1, len(self.mean)), self.quarter[:, used].ravel()
        shared = heads.mean(axis=0)
        means = []
        for k in range(_QUARTERS):
            own = heads[quarter == k]
            means.append((own.sum(axis=0) + _SHARED * shared) / (len(own) + _SHARED) - self.mean)
        apart = np.array(means, float)
        weight = cho_solve(self.factor, apart.T).T
        bias = -0.5 * np.einsum("kd,kd->k", weight, apart) - weight @ self.mean
        return HeadTemplates(weight.astype(np.float32), bias, _usual_place(self.place[used]))


def _usual_place(head: FloatArray) -> FloatArray:
    """Mean and spread (2, 2) of most heads (n, 2)."""
    middle = np.median(head, axis=0)
    spread = 1.48 * np.median(np.abs(head - middle), axis=0)
    return np.stack([middle, np.clip(spread, 0.03, 0.06)])


def head_of_crop(box: FloatArray, scale: float) -> FloatArray:
    """The middle (2,) of a head's box (4,) in pixels of an upright cut of a patch, which `crop_of` made."""
    left, top, width, height = box / scale
    return of_patch(np.array([left + width / 2.0 + _CROP[0], top + height / 2.0 + _CROP[1]]))


_CROP = (35, 19, 90, 176)
"""Left, top, width and height of a patch's part in which the package's localiser looks for heads."""


def crop_of(patch: Image) -> Image:
    """The part of a patch that is a person's box with a margin."""
    left, top, width, height = _CROP
    return np.ascontiguousarray(patch[top : top + height, left : left + width])
