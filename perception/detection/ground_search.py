"""Candidates of people in a camera with a known ground plane, restricted to a person's height."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray
from graphtrack.geometry.camera import GroundCamera
from graphtrack.io.cameras import PERSON_HEIGHT
from perception.detection.background import Background
from perception.detection.hog import (
    CELL,
    FOOT,
    ORIENTATIONS,
    TALL,
    WINDOW,
    Grid,
    WindowFilter,
    gradient_blocks,
    mean_blocks,
    resized,
    window_at,
)
from perception.images.pixels import Image, suppressed

LEAN = 0.5
"""Largest lateral shift of the head, in heights, of a person treated as upright in the image."""


@dataclass(frozen=True, eq=False)
class PersonSizes:
    """Head positions and image heights of people standing on the ground.

    Attributes
    ----------
    camera : over the ground
    lift : (3,) change of the homogeneous ideal pixel of a ground point per metre of height
    height : of a person, in metres
    """

    camera: GroundCamera
    lift: FloatArray
    height: float = PERSON_HEIGHT

    @classmethod
    def of(cls, camera: GroundCamera, size: tuple[int, int], height: float = PERSON_HEIGHT) -> PersonSizes:
        """Return the sizes for a camera with images of ``size`` columns and rows.

        Without a camera matrix, pixels are assumed to be square, the principal point in the middle of the
        image, and the focal length follows from the ground plane (Zhang 2000, eq. 3–4).
        """
        to_image = np.asarray(np.linalg.inv(camera.homography), float)
        matrix = camera.intrinsics
        if matrix is None:
            matrix = _square_matrix(to_image, size)
        first, second, translation = (np.linalg.inv(matrix) @ to_image).T
        scale = float(np.sqrt(np.linalg.norm(first) * np.linalg.norm(second)))
        up = np.cross(first, second) / scale
        if up @ translation > 0.0:  # the camera is above the ground
            up = -up
        return cls(camera, matrix @ up, height)

    def heads(self, foot: ArrayLike) -> FloatArray:
        """Return raw pixels (n, 2) of heads for feet at (n, 2); NaN beyond the horizon."""
        ground = self.camera.image_to_ground(foot)
        flat = np.column_stack([ground, np.ones(len(ground))])
        with np.errstate(invalid="ignore", divide="ignore"):
            head = flat @ np.linalg.inv(self.camera.homography).T + self.height * self.lift
            ideal = np.where(head[:, 2:] > 0.0, head[:, :2] / head[:, 2:], np.nan)
        return self.camera.distort(ideal)

    def heights(self, foot: ArrayLike) -> FloatArray:
        """Return pixels (n,) from head to foot; NaN if a person is not upright in the image."""
        foot = np.asarray(foot, float)
        up = foot - self.heads(foot)
        with np.errstate(invalid="ignore"):
            upright = (up[:, 1] > 0.0) & (np.abs(up[:, 0]) <= LEAN * up[:, 1])
        return np.where(upright, up[:, 1], np.nan)


def _square_matrix(to_image: FloatArray, size: tuple[int, int]) -> FloatArray:
    """Return the camera matrix (3, 3) that makes the ground's axes orthogonal and equally long."""
    middle = np.array([size[0], size[1]], float) / 2.0
    centred = to_image.copy()
    centred[:2] -= middle[:, None] * to_image[2]
    (x1, y1, w1), (x2, y2, w2) = centred[:, 0], centred[:, 1]
    left = np.array([x1 * x2 + y1 * y2, x1**2 + y1**2 - x2**2 - y2**2])
    right = -np.array([w1 * w2, w1**2 - w2**2])
    share = float(left @ right) / max(float(left @ left), 1e-300)  # 1 / focal²
    widest = float(max(size))
    # The focal length is not observable from straight above, or with rounding.
    focal = np.clip(1.0 / np.sqrt(share), 0.3 * widest, 10.0 * widest) if share > 0.0 else 1.2 * widest
    return np.array([[focal, 0.0, middle[0]], [0.0, focal, middle[1]], [0.0, 0.0, 1.0]])


_STEP = 1.12  # ratio of the heights of neighbouring bands
_LEAST, _MOST = 28.0, 1200.0  # range of people's heights, pixels
_LATTICE = 16


@dataclass(frozen=True, eq=False)
class SearchBand:
    """Part of the image, enlarged or reduced, and its windows with possible people of one height.

    Attributes
    ----------
    scale : pixels of the band over those of the image
    left, top : pixel of the image at which the band begins
    size : columns and rows of the band
    windows, foot : (n, 2) rows and columns of the windows, and image pixels of their feet
    """

    scale: float
    left: int
    top: int
    size: tuple[int, int]
    windows: NDArray[np.int64]
    foot: FloatArray

    def cut(self, image: Image) -> Image:
        """Return the band of an image; the border is replicated."""
        columns, rows = (round(length / self.scale) for length in self.size)
        h, w = image.shape[:2]
        first, last = max(self.top, 0), min(self.top + rows, h)
        start, end = max(self.left, 0), min(self.left + columns, w)
        part = image[first:last, start:end]
        beyond = first - self.top, self.top + rows - last, start - self.left, self.left + columns - end
        if any(beyond):
            part = cv2.copyMakeBorder(part, *beyond, cv2.BORDER_REPLICATE)
        return resized(np.asarray(part, np.uint8), self.size)

    def blocks(self, image: Image, foreground: NDArray[np.float32] | None) -> Grid:
        """Return blocks (rows, columns, 37): gradients, and the share of the foreground.

        Parameters
        ----------
        foreground : (h, w) from 0 to 1, at the image's size or a smaller one; None: not known, and 0
        """
        gradients = gradient_blocks(self.cut(image))
        if foreground is None:
            shares = np.zeros((*gradients.shape[:2], 1), np.float32)
        else:
            shares = mean_blocks(self._of_smaller(foreground, foreground.shape[1] / image.shape[1]))
        return np.concatenate([gradients, shares], axis=2)

    def _of_smaller(self, values: NDArray[np.float32], factor: float) -> NDArray[np.float32]:
        """Return the band of values (h, w) that were reduced by a factor."""
        scale = self.scale / factor
        move = np.array([[scale, 0.0, -self.left * self.scale], [0.0, scale, -self.top * self.scale]])
        if self.scale < 0.7 * factor:
            width = max(1, round(0.7 * factor / self.scale))
            values = cv2.blur(values, (width, width))
        return np.asarray(
            cv2.warpAffine(values, move, self.size, flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE),
            np.float32,
        )


def bands_of(sizes: PersonSizes, size: tuple[int, int], tolerance: float = 0.1) -> list[SearchBand]:
    """Return the bands of images of ``size`` columns and rows that hold people, by height.

    ``tolerance`` is that of the log of people's height.
    """
    u, v = np.meshgrid(np.arange(0, size[0], _LATTICE), np.arange(0, size[1], _LATTICE))
    lattice = np.column_stack([u.ravel(), v.ravel()]).astype(float)
    height = sizes.heights(lattice)
    usable = np.isfinite(height) & (height >= _LEAST) & (height <= min(_MOST, 2.0 * size[1]))
    lattice, height = lattice[usable], height[usable]
    if not len(height):
        return []
    count = max(1, int(np.ceil(np.log(height.max() / height.min()) / np.log(_STEP))))
    found = []
    for tall in np.geomspace(height.min(), height.max(), count + 1) if count > 1 else height[:1]:
        near = lattice[np.abs(np.log(height / tall)) <= tolerance + 0.02]
        if len(near):
            found.append(_band(sizes, size, near, float(tall), tolerance))
    return [band for band in found if len(band.windows)]


def _band(
    sizes: PersonSizes, size: tuple[int, int], near: FloatArray, tall: float, tolerance: float
) -> SearchBand:
    scale = TALL / tall
    low, high = near.min(axis=0), near.max(axis=0) + _LATTICE
    left, top = (int(np.floor(low[k] - FOOT[k] / scale)) for k in range(2))
    extent = (high - np.array([left, top])) * scale + np.array([32.0, 128.0 - FOOT[1]])
    band_size = int(np.ceil(extent[0])), int(np.ceil(extent[1]))
    across, down = (length // CELL - blocks for length, blocks in zip(band_size, WINDOW, strict=True))
    u = left + (CELL * np.arange(across) + FOOT[0]) / scale
    v = top + (CELL * np.arange(down) + FOOT[1]) / scale
    feet = np.stack(np.meshgrid(u, v), axis=-1)
    inside = (feet >= 0.0).all(axis=-1) & (feet <= np.array(size)).all(axis=-1)
    with np.errstate(invalid="ignore"):
        off = np.log(tall / sizes.heights(feet.reshape(-1, 2))).reshape(feet.shape[:2])
        rows, columns = np.nonzero(inside & (np.abs(off) <= tolerance))
    windows = np.column_stack([rows, columns]).astype(np.int64)
    return SearchBand(scale, left, top, band_size, windows, feet[rows, columns])


FEATURES = WINDOW[0] * WINDOW[1] * (ORIENTATIONS + 1)
"""Number of features of a candidate's window."""
_MOST_FOREGROUND = 0.5  # share of the frame; above it the camera moved or the light changed


APART = 0.4, 0.6
"""Metres to the side and upwards within which detections are merged."""
_CLOSE = 0.15, 0.25  # the same, of candidates
_MOST_CANDIDATES = 120  # of a frame
_INSIDE, _OUTSIDE = 4.0, 2.0  # weights of foreground in a person and around, in scores of the SVM
_PERSON = 1.7  # metres of a person's height


@dataclass(frozen=True, eq=False)
class Candidates:
    """Candidates of people in a frame.

    Attributes
    ----------
    foot : (n, 2) pixels of the feet
    height : (n,) pixels
    score : (n,)
    features : (n, `FEATURES`) blocks of the windows
    """

    foot: FloatArray
    height: FloatArray
    score: FloatArray
    features: NDArray[np.float16]

    def __len__(self) -> int:
        return len(self.score)

    def scored(self, score: FloatArray) -> Candidates:
        """Return the candidates with other scores (n,)."""
        return replace(self, score=score)


class GroundSearch:
    """Search for windows with the height of a person.

    Parameters
    ----------
    camera : over the ground
    size : columns and rows of the images

    Raises
    ------
    InputError
        If no person would be upright in the image, or at least 28 pixels high.
    """

    def __init__(self, camera: GroundCamera, size: tuple[int, int]) -> None:
        self.size = size
        self._bands = bands = bands_of(PersonSizes.of(camera, size), size)
        if not bands:
            raise InputError(
                f"images of {size[0]} × {size[1]} pixels in which people are not upright or too small",
                "a calibration of this view, or --boxes",
            )
        self._first = first_filter()
        self._band = np.repeat(np.arange(len(bands)), [len(band.windows) for band in bands])
        self._window = np.vstack([band.windows for band in bands])
        self._foot = np.vstack([band.foot for band in bands])
        self._height = TALL / np.array([band.scale for band in bands])[self._band]

    def candidates(self, image: Image, background: Background | None) -> Candidates:
        """Return the best candidates of a frame, best first; without a background from gradients only.

        Raises
        ------
        InputError
            If the frame has another size.
        """
        size = (image.shape[1], image.shape[0])
        if size != self.size:
            raise InputError(
                f"a frame of {size[0]} × {size[1]} pixels", f"{self.size[0]} × {self.size[1]} as the first"
            )
        foreground = None if background is None else background.foreground(image)
        if foreground is not None and float(foreground.mean()) > _MOST_FOREGROUND:
            foreground = None
        grids = [band.blocks(image, foreground) for band in self._bands]
        score = np.concatenate(
            [
                self._first.scores(grid)[band.windows[:, 0], band.windows[:, 1]]
                for grid, band in zip(grids, self._bands, strict=True)
            ]
        ).astype(float)
        best = np.argsort(-score, kind="stable")[: 40 * _MOST_CANDIDATES]
        foot, height = self._foot[best], self._height[best]
        kept = best[strongest(foot, height, score[best], _CLOSE, _MOST_CANDIDATES)]
        features = [window_at(grids[self._band[k]], *self._window[k].tolist()) for k in kept.tolist()]
        return Candidates(
            self._foot[kept],
            self._height[kept],
            score[kept],
            np.array(features, np.float16).reshape(-1, FEATURES),
        )


def first_filter() -> WindowFilter:
    """Return OpenCV's people detector plus the foreground in the middle of the window against its border."""
    svm = WindowFilter.of_opencv()
    across, down = WINDOW
    inside, outside = np.zeros((2, down, across, 1), np.float32)
    inside[2:-2, 2:-2] = 1.0
    outside[[0, -1]], outside[:, [0, -1]] = 1.0, 1.0
    share = _INSIDE * inside / inside.sum() - _OUTSIDE * outside / outside.sum()
    return WindowFilter(np.concatenate([svm.weight, share], axis=2), svm.bias)


def strongest(
    foot: FloatArray,
    height: FloatArray,
    score: FloatArray,
    apart: tuple[float, float],
    most: int | None = None,
) -> NDArray[np.int64]:
    """Apply non-maximum suppression to n candidates; return the strongest, best first.

    Parameters
    ----------
    foot, height, score : (n, 2), (n,) pixels and (n,)
    apart : metres to the side and upwards, half axes of an ellipse in the upright plane at the person
    most : largest number of results; None: all
    """

    def near(k: int, left: NDArray[np.int64]) -> NDArray[np.bool_]:
        away = (foot[left] - foot[k]) * (_PERSON / height[k]) / np.array(apart)
        return np.asarray(np.einsum("nk,nk->n", away, away) < 1.0)

    return np.array(suppressed(score, near, most), np.int64)


def joined(candidates: Candidates, apart: tuple[float, float] = APART) -> Candidates:
    """Return the strongest candidates, scored by probabilities, each at the mean of its neighbourhood.

    The mean is weighted by the probabilities, which interpolates between grid positions.
    """
    kept = strongest(candidates.foot, candidates.height, candidates.score, apart)
    foot, height = np.empty((len(kept), 2)), np.empty(len(kept))
    for i, k in enumerate(kept.tolist()):
        scale = 2.0 * _PERSON / candidates.height[k] / np.array(apart)
        away = (candidates.foot - candidates.foot[k]) * scale
        weight = np.where(np.einsum("nk,nk->n", away, away) < 1.0, candidates.score, 0.0)
        weight[k] += 1e-9
        foot[i] = weight @ candidates.foot / weight.sum()
        height[i] = np.exp(weight @ np.log(candidates.height) / weight.sum())
    return Candidates(foot, height, candidates.score[kept], candidates.features[kept])
