"""Features of heads, bodies and people.

Histograms of oriented gradients, and those of all rectangles on a 6 × 6 grid by integral histograms (Chen et
al. 2011, §2.2–2.3); a Gaussian and three rotation-invariant Gabor wavelets at the points of a disc (Ba &
Odobez 2003, §2.1); skin by colour histograms (Jones & Rehg 2002); Fisher projection and sparse combinations.
Appearance is described by parts of the body weighted towards its axis, as in SDALF (Farenzena et al., CVPR
2010), in CIE L*a*b* with gradients; with square roots, so that Euclidean distances are Hellinger distances.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import linalg, ndimage
from scipy.special import j0

from graphtrack.geometry.angles import FloatArray
from graphtrack.kernels.compilation import kept
from perception.images.pixels import Image

BINS = 9
"""Unsigned orientations: bin k is centred on 20°·k + 10°."""


def gradients(images: NDArray[np.uint8]) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Central differences along columns and along rows, (n, h, w) each, of grey images (n, h, w)."""
    values = np.asarray(images, np.float32)
    padded = np.pad(values, ((0, 0), (1, 1), (1, 1)), mode="edge")
    across = padded[:, 1:-1, 2:] - padded[:, 1:-1, :-2]
    down = padded[:, 2:, 1:-1] - padded[:, :-2, 1:-1]
    return across, down


def cell_histograms(
    images: NDArray[np.uint8], rows: int, columns: int, *, interpolated: bool = True
) -> FloatArray:
    """Histograms (n, rows, columns, 9) of unsigned gradient orientation, weighted by magnitude.

    Parameters
    ----------
    images : (n, h, w) grey, h and w divisible by ``rows`` and ``columns``
    interpolated : whether a pixel votes for the two nearest bins, by linear interpolation, or for its own
    """
    n, h, w = images.shape
    across, down = gradients(images)
    magnitude = np.hypot(across, down)
    place = np.mod(np.arctan2(down, across), np.pi) * (BINS / np.pi) - 0.5
    lower = np.floor(place)
    upper_share = place - lower
    if not interpolated:
        upper_share = (upper_share >= 0.5).astype(np.float32)
    first = np.mod(lower.astype(np.int64), BINS)
    row = np.arange(h) // (h // rows)
    column = np.arange(w) // (w // columns)
    cell = (row[:, None] * columns + column[None, :]) * BINS
    cell = cell + (np.arange(n) * rows * columns * BINS)[:, None, None]
    size = n * rows * columns * BINS
    votes = np.bincount((cell + first).ravel(), (magnitude * (1.0 - upper_share)).ravel(), size)
    votes += np.bincount((cell + np.mod(first + 1, BINS)).ravel(), (magnitude * upper_share).ravel(), size)
    return np.asarray(votes.reshape(n, rows, columns, BINS), float)


def multi_level_hog(
    images: NDArray[np.uint8], levels: Sequence[tuple[int, int]], *, interpolated: bool = True
) -> FloatArray:
    """Concatenated block descriptors (n, d) at several levels (Chen et al. 2011, §2.3).

    Parameters
    ----------
    images : (n, h, w) grey
    levels : rows and columns of non-overlapping blocks; the last is the finest, and a multiple of the others
    interpolated : see `cell_histograms`

    Notes
    -----
    A block has 2 × 2 cells; its 36 values are divided by their Euclidean norm. Two levels of 2 × 2 and 4 × 4
    blocks give 20 · 36 = 720 values.
    """
    rows, columns = (2 * count for count in levels[-1])
    finest = cell_histograms(images, rows, columns, interpolated=interpolated)
    n = len(images)
    parts = []
    for block_rows, block_columns in levels:
        r, c = 2 * block_rows, 2 * block_columns
        cells = finest.reshape(n, r, rows // r, c, columns // c, BINS).sum(axis=(2, 4))
        blocks = cells.reshape(n, block_rows, 2, block_columns, 2, BINS).transpose(0, 1, 3, 2, 4, 5)
        blocks = blocks.reshape(n, block_rows * block_columns, 4 * BINS)
        length = np.linalg.norm(blocks, axis=2, keepdims=True)
        parts.append((blocks / (length + 1e-6)).reshape(n, -1))
    return np.concatenate(parts, axis=1)


GRID = 6
_CROPPED = 60.0  # largest gradient, in grey levels across two pixels; the paper crops them too


@lru_cache(maxsize=1)
def block_corners() -> NDArray[np.int64]:
    """First and last-plus-one row and column (441, 4) of every block of the grid."""
    edges = [(a, b) for a in range(GRID) for b in range(a + 1, GRID + 1)]
    return np.array([(*rows, *columns) for rows in edges for columns in edges])


def integral_histogram(grey: NDArray[np.uint8]) -> NDArray[np.float32]:
    """Sums (h + 1, w + 1, 10) of gradient magnitude above and left of each corner.

    The first nine are by unsigned orientation, the last is their sum.
    """
    across, down = gradients(grey[None])
    return np.asarray(_integral(across[0], down[0]), np.float32)


def grid_lines(windows: FloatArray, shape: tuple[int, ...]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Rows and columns (n, 7) of the grid's lines in windows (n, 4): left, top, width, height.

    Parameters
    ----------
    shape : of the integral, in which they stay
    """
    share = np.arange(GRID + 1) / GRID
    rows = np.rint(windows[:, 1, None] + windows[:, 3, None] * share).astype(np.int64)
    columns = np.rint(windows[:, 0, None] + windows[:, 2, None] * share).astype(np.int64)
    return np.clip(rows, 0, shape[0] - 1), np.clip(columns, 0, shape[1] - 1)


def corner_sums(integral: NDArray[np.float32], windows: FloatArray) -> NDArray[np.float32]:
    """The integral (n, 7, 7, 9) at the corners of the grid in windows (n, 4): left, top, width, height."""
    rows, columns = grid_lines(windows, integral.shape)
    return integral[rows[:, :, None], columns[:, None, :], :BINS]


def block_histograms(corners: NDArray[np.float32], *, normalised: bool = True) -> NDArray[np.float32]:
    """Histograms (n, 441, 9) of all blocks from `corner_sums`, each divided by its sum if ``normalised``."""
    top, bottom, left, right = block_corners().T
    sums = (
        corners[:, bottom, right] - corners[:, top, right] - corners[:, bottom, left] + corners[:, top, left]
    )
    return np.asarray(sums / (sums.sum(axis=2, keepdims=True) + 1.0) if normalised else sums, np.float32)


@kept()
def _integral(across: Any, down: Any) -> Any:
    h, w = across.shape
    sums = np.zeros((h + 1, w + 1, BINS + 1), np.float32)
    row = np.zeros(BINS + 1, np.float32)
    for y in range(h):
        row[:] = 0.0
        for x in range(w):
            gx, gy = across[y, x], down[y, x]
            magnitude = min(np.sqrt(gx * gx + gy * gy), _CROPPED)
            if magnitude > 0.0:
                angle = np.arctan2(gy, gx)
                if angle < 0.0:
                    angle += np.pi
                row[min(int(angle * (BINS / np.pi)), BINS - 1) if angle < np.pi else 0] += magnitude
                row[BINS] += magnitude
            for b in range(BINS + 1):
                sums[y + 1, x + 1, b] = sums[y, x + 1, b] + row[b]
    return sums


SIDE = 64
CENTRE, RADIUS = 31.5, 31.5
"""Pixels from 0; the paper counts them from 1."""
SCALES = (1.0, 2.0, 4.0)
FREQUENCIES = (0.5, 0.25, 0.125)
_SPACING = 4
_GAUSSIAN_SIGMA = 2.0
_NOTHING = 1e-30  # smaller weights are 0: arithmetic on subnormal numbers is up to 20 times slower


def rotation_invariant_gabor(radius: FloatArray, sigma: float, frequency: float) -> FloatArray:
    """The wavelet exp(−r²/2σ²)·cos(2π·ω·x') integrated over its orientation, at radius r (pixels).

    The mean of cos(2π·ω·r·cos α) over α is the Bessel function J₀(2π·ω·r).
    """
    return np.exp(-(radius**2) / (2.0 * sigma**2)) * j0(2.0 * np.pi * frequency * radius)


@lru_cache(maxsize=1)
def grid() -> NDArray[np.int64]:
    """The 191 points (191, 2) of the grid, x and y in pixels from 0.

    The paper's pixels count from 1, its disc has centre (32.5, 32.5) and radius 31.5; every fourth pixel
    inside it gives exactly its 191 points.
    """
    x, y = np.meshgrid(np.arange(_SPACING - 1, SIDE, _SPACING), np.arange(_SPACING - 1, SIDE, _SPACING))
    points = np.column_stack([x.ravel(), y.ravel()])
    return points[np.hypot(*(points - CENTRE).T) <= RADIUS]


@lru_cache(maxsize=1)
def filter_bank() -> NDArray[np.float32]:
    """Return the four filters at the grid points as a matrix (4·191, 64·64), cut off at the border."""
    x, y = np.meshgrid(np.arange(SIDE), np.arange(SIDE))
    rows = []
    points = grid()
    radius = np.hypot(x.ravel() - points[:, :1], y.ravel() - points[:, 1:])
    rows.append(np.exp(-(radius**2) / (2.0 * _GAUSSIAN_SIGMA**2)))
    for sigma, frequency in zip(SCALES, FREQUENCIES, strict=True):
        rows.append(rotation_invariant_gabor(radius, sigma, frequency))
    bank = np.concatenate(rows)
    bank /= np.abs(bank).sum(axis=1, keepdims=True)
    bank[np.abs(bank) < _NOTHING] = 0.0
    return np.asarray(bank, np.float32)


def gabor_features(images: NDArray[np.uint8], *, subtract_mean: bool = True) -> FloatArray:
    """Features (n, 764) of equalised grey images (n, 64, 64), each filter normalised (Ba & Odobez 2003, eq.
    1).

    Parameters
    ----------
    subtract_mean : whether an image loses its mean first. Filters end at the border, where an image without
        its mean loses only detail. Ba & Odobez (2003) do not subtract it.
    """
    n = len(images)
    values = np.asarray(images, np.float32).reshape(n, -1)
    if subtract_mean:
        values = values - values.mean(axis=1, keepdims=True)
    responses = values @ filter_bank().T
    by_filter = responses.reshape(n, 1 + len(SCALES), -1).astype(float)
    centred = by_filter - by_filter.mean(axis=2, keepdims=True)
    spread = np.sqrt(np.mean(centred**2, axis=2, keepdims=True))
    return np.asarray((centred / np.maximum(spread, 1e-6)).reshape(n, -1), float)


SKIN_BINS = 16
RGB_BINS = 32
MASK_SIDE = 20


@dataclass(frozen=True, eq=False)
class SkinColours:
    """Skin probabilities by colour.

    Attributes
    ----------
    probability : of skin; (16, 16, 16) for bins of relative brightness, log red/green and log green/blue, or
        (32, 32, 32) for bins of blue, green and red, as Jones & Rehg (2002) have them
    threshold : least probability of a skin pixel
    """

    probability: FloatArray
    threshold: float = 0.5

    @classmethod
    def fit(
        cls, images: Sequence[Image], masks: Sequence[NDArray[np.bool_]], *, as_published: bool = False
    ) -> SkinColours:
        """Fit to images (h, w, 3) and masks (h, w) of their skin; both classes have equal weight.

        The counts are smoothed a little over neighbouring colours.

        Parameters
        ----------
        as_published : the detector of Jones & Rehg (2002), which Chen et al. (2011) use: counts of 32³ bins
            of blue, green and red, not smoothed. Unobserved colours are not skin.
        """
        bins = RGB_BINS if as_published else SKIN_BINS
        skin, other = np.zeros(bins**3), np.zeros(bins**3)
        for image, mask in zip(images, masks, strict=True):
            index = (_rgb_bins if as_published else _bins)(image).ravel()
            skin += np.bincount(index[mask.ravel()], minlength=bins**3)
            other += np.bincount(index[~mask.ravel()], minlength=bins**3)
        if as_published:
            skin, other = skin / max(skin.sum(), 1.0), other / max(other.sum(), 1.0)
            both = skin + other
            share = np.where(both > 0.0, skin / np.where(both > 0.0, both, 1.0), 0.0)
            return cls(share.reshape((bins,) * 3))
        shares = []
        for count in (skin, other):
            smooth = count.reshape((SKIN_BINS,) * 3)
            for axis in range(3):
                smooth = ndimage.convolve1d(smooth, (0.25, 0.5, 0.25), axis, mode="constant")
            shares.append(smooth / max(smooth.sum(), 1e-12) + 1e-6)
        return cls(shares[0] / (shares[0] + shares[1]))

    def mask(self, image: Image) -> NDArray[np.bool_]:
        """Mask (h, w) of an image's skin; empty for a grey one."""
        if image.ndim == 2:
            return np.zeros(image.shape, bool)
        index = _rgb_bins(image) if len(self.probability) == RGB_BINS else _bins(image)
        return self.probability.ravel()[index] >= self.threshold

    def features(self, images: Sequence[Image]) -> FloatArray:
        """Binary masks (n, 400) of 20 × 20 pixels."""
        found = np.empty((len(images), MASK_SIDE**2))
        for k, image in enumerate(images):
            mask = self.mask(image).astype(np.float32)
            small = cv2.resize(mask, (MASK_SIDE, MASK_SIDE), interpolation=cv2.INTER_LINEAR)
            found[k] = small.ravel() >= 0.5
        return found


def _rgb_bins(image: Image) -> NDArray[np.int64]:
    """Index (h, w) of each pixel's blue, green and red, in 32 bins each."""
    b, g, r = np.moveaxis(image.astype(np.int64) // (256 // RGB_BINS), -1, 0)
    return np.asarray((b * RGB_BINS + g) * RGB_BINS + r, np.int64)


def _bins(image: Image) -> NDArray[np.int64]:
    """Index (h, w) of brightness, relative to the image's bright pixels, and of two colour ratios."""
    light = image.astype(np.float32) + 1.0
    mean = light.mean(axis=-1)
    brightness = mean * (10.6 / max(float(np.quantile(mean, 0.9)), 1e-6))
    logs = np.log(light) * 8.0
    warm, green = logs[..., 2] - logs[..., 1] + 8.0, logs[..., 1] - logs[..., 0] + 8.0
    b, w, g = (np.clip(values, 0, SKIN_BINS - 1).astype(np.int64) for values in (brightness, warm, green))
    return np.asarray((b * SKIN_BINS + w) * SKIN_BINS + g, np.int64)


_SHRINKAGE = 0.1
_DIRECTIONS = 30


def fisher_projection(features: FloatArray, labels: NDArray[np.int64]) -> FloatArray:
    """Return Fisher's discriminant directions (d, k), with unit spread within the classes."""
    count = np.bincount(labels)
    used = np.flatnonzero(count)
    means = np.array([features[labels == k].mean(axis=0) for k in used])
    within = features - means[np.searchsorted(used, labels)]
    covariance = within.T @ within / len(features)
    size = len(covariance)
    covariance *= 1.0 - _SHRINKAGE
    covariance[np.diag_indices(size)] += _SHRINKAGE * np.trace(covariance) / size + 1e-9
    # One Cholesky factor and an SVD of a few columns: a general eigensolver takes twenty times as long.
    factor = linalg.cholesky(covariance, lower=True)
    spread = np.sqrt(count[used] / len(features)) * (means - features.mean(axis=0)).T
    white = linalg.solve_triangular(factor, spread, lower=True)
    left = np.linalg.svd(white, full_matrices=False)[0][:, : min(_DIRECTIONS, len(used) - 1)]
    return np.asarray(linalg.solve_triangular(factor.T, left), float)


def sparse_weights(
    samples: FloatArray, dictionary: FloatArray, penalty: float, *, iterations: int = 150
) -> FloatArray:
    """Weights w ≥ 0 (n, m) that minimise ½‖z − Dᵀw‖² + penalty·Σw for each sample z.

    Parameters
    ----------
    samples : (n, d)
    dictionary : (m, d), the atoms

    Notes
    -----
    FISTA (Beck & Teboulle 2009): each step is two matrix products for the whole batch, while coordinate
    descent processes one sample at a time (scikit-learn: 7 ms per sample with 800 atoms, this: below 1 ms).
    """
    step = 1.0 / np.linalg.norm(dictionary, 2) ** 2
    weights = np.zeros((len(samples), len(dictionary)))
    ahead, momentum = weights, 1.0
    for _ in range(iterations):
        residual = ahead @ dictionary - samples
        moved = np.maximum(ahead - step * (residual @ dictionary.T + penalty), 0.0)
        following = (1.0 + np.sqrt(1.0 + 4.0 * momentum**2)) / 2.0
        ahead = moved + (momentum - 1.0) / following * (moved - weights)
        weights, momentum = moved, following
    return weights


HEIGHT, WIDTH = 64, 24
"""Size in pixels to which a person's crop is resized."""
PARTS = ((0, 11), (11, 22), (22, 33), (33, 57))
"""Rows of head, chest, waist and legs; the rows below show ground and shadow."""
LEVELS = (6, 5, 5)
"""Bins of L*, a* and b*."""
_TEXTURED = ((1, 4), (4, 7))  # eighths of the height with gradients: trunk and legs
_CHROMA = 15.0  # centres of the outermost bins of a* and b*: clothes have little colour
_AXIS = 0.18  # 1-σ of the weight of columns, in widths: the border is background

_COLOURS = len(PARTS) * int(np.prod(LEVELS))
LENGTH = _COLOURS + len(_TEXTURED) * BINS
"""Length of a descriptor before projection."""

Descriptors = NDArray[np.uint8]
"""(n, `LENGTH`) square roots of histograms, in 255ths, to store all detections of a recording."""


def light_of(image: Image) -> FloatArray:
    """Return the median L*, a* and b* (3,) of a frame (h, w, 3): exposure and colour of the light."""
    few = np.ascontiguousarray(image[::8, ::8])
    return np.asarray(np.median(_lab(few).reshape(-1, 3), axis=0), float)


def describe(pictures: Sequence[Image], light: FloatArray) -> Descriptors:
    """Return appearance descriptors (n, `LENGTH`) of crops (h, w, 3) of people in one frame.

    Parameters
    ----------
    light : (3,) of that frame, from `light_of`; colours are relative to it
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
    """Joint histograms (n, parts · bins), interpolated, of colours (n, h, w, 3) about the light."""
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
    """Return shares (n, parts · 9) of gradient orientations of (n, h, w); small in uniform regions."""
    cells = cell_histograms(brightness, 8, 2).sum(axis=2)
    parts = np.stack([cells[:, top:bottom].sum(axis=1) for top, bottom in _TEXTURED], axis=1)
    return np.asarray((parts / (parts.sum(axis=2, keepdims=True) + 100.0)).reshape(len(parts), -1), float)


@dataclass(frozen=True, eq=False)
class Projection:
    """Projection of appearance descriptors to the columns of a table.

    Attributes
    ----------
    mean : (`LENGTH`,)
    basis : (`LENGTH`, size) orthonormal columns
    """

    mean: FloatArray
    basis: FloatArray

    def __call__(self, descriptors: Descriptors) -> FloatArray:
        """Project descriptors (n, `LENGTH`) to (n, size), with four decimals; most are within ±1."""
        return np.asarray(np.round((descriptors / 255.0 - self.mean) @ self.basis, 4), float)

    @classmethod
    def fitted(cls, descriptors: Descriptors, size: int = 32) -> Projection:
        """Fit the principal components of a recording; with less than 2 · ``size`` people, `fixed`."""
        if len(descriptors) < 2 * size:
            return cls.fixed()
        some = descriptors[:: -(-len(descriptors) // 8192)] / 255.0
        mean = some.mean(axis=0)
        _, vectors = np.linalg.eigh((some - mean).T @ (some - mean))
        return cls(mean, np.asarray(vectors[:, : -size - 1 : -1], float))

    @classmethod
    def fixed(cls, size: int = 64) -> Projection:
        """Return a constant random projection, which nearly keeps distances (Johnson & Lindenstrauss 1984).

        It serves streams, where nothing is known in advance.
        """
        columns = np.random.default_rng(0).normal(size=(LENGTH, size))
        return cls(np.zeros(LENGTH), np.asarray(np.linalg.qr(columns)[0], float))
