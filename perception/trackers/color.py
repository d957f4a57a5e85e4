"""Colour tracker: a particle filter on histograms of hue, saturation and value, then head pose.

Pérez, Hue, Vermaak & Gangnet 2002. The weighted histograms are those of the Sigma-Pi tracker's cue.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import ClassVar

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

from graphtrack.baselines.particle_kernels import generator, normalise
from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray
from perception.images.pixels import Image, enlarged, grey
from perception.pose.classes import PoseClasses
from perception.pose.features import SIDE
from perception.trackers.head_exemplars import HeadExemplars
from perception.trackers.tracker import (
    PATCH_MARGIN,
    Box,
    BoxDynamics,
    BoxEstimate,
    Cloud,
    Proposal,
    boxes_of,
    check_frame,
    cut,
    equalised,
    first_state,
    predict,
    resampled,
)

Bins = tuple[int, int, int]
"""Numbers of bins of hue, saturation and value."""

BINS: Bins = (12, 5, 8)
"""Number of joint bins of a pixel's colour."""
COUNT = BINS[0] * BINS[1] * BINS[2]
_SMOOTHING = 0.5
"""1-σ in bins, of the smoothing over neighbouring colours."""


_BOX_BINS: Bins = (10, 10, 10)
"""Bins of the histograms of boxes: hue and saturation, and value for pixels without hue (Pérez et al.)."""
_LEAST_SATURATION, _LEAST_VALUE = 0.1, 0.2
"""0…1; pixels below either have no hue and are binned by value."""
_SAMPLES = 24
"""Sampled pixels along each side of a box."""


def hue_bins(image: Image) -> NDArray[np.int32]:
    """Return the bin (h, w) of every pixel in the histograms of boxes."""
    hues, saturations, _ = _BOX_BINS
    hsv = _channels(image)
    hue, saturation, value = _levels(hsv, _BOX_BINS, (saturations, 1, 1))
    pale = (hsv[1] < 255 * _LEAST_SATURATION) | (hsv[2] < 255 * _LEAST_VALUE)
    return np.where(pale, hues * saturations + value, hue + saturation)


def box_colours(pixels: NDArray[np.integer], boxes: FloatArray) -> FloatArray:
    """Return histograms (n, bins) of boxes (n, 4), of sum 1, from the `hue_bins` (h, w) of an image."""
    height, width = pixels.shape
    share = (np.arange(_SAMPLES) + 0.5) / _SAMPLES
    columns = np.clip((boxes[:, :1] + boxes[:, 2:3] * share).astype(np.int64), 0, width - 1)
    rows = np.clip((boxes[:, 1:2] + boxes[:, 3:] * share).astype(np.int64), 0, height - 1)
    patches = pixels[rows[:, :, None], columns[:, None, :]].reshape(len(boxes), -1)
    hues, saturations, values = _BOX_BINS
    count = hues * saturations + values
    place = patches + count * np.arange(len(boxes))[:, None]
    total = np.bincount(place.ravel(), minlength=count * len(boxes)).reshape(len(boxes), count)
    return np.asarray(total / patches.shape[1], float)


def bhattacharyya(histogram: FloatArray, model: FloatArray) -> FloatArray:
    """Return Bhattacharyya coefficients (n,) of histograms (n, bins) and one (bins,): 1 if equal."""
    return np.asarray(np.sqrt(histogram * model).sum(axis=1), float)


def pixel_bins(image: Image) -> NDArray[np.int32]:
    """Return the bin (h, w), of `COUNT`, of each pixel of an image (h, w, 3)."""
    _, saturations, values = BINS
    hue, saturation, value = _levels(_channels(image), BINS, (saturations * values, values, 1))
    return np.asarray(hue + saturation + value, np.int32)


def weighed_histogram(pixels: NDArray[np.int32], weights: NDArray[np.float32] | None = None) -> FloatArray:
    """Return the share (COUNT,) of each bin among weighted pixels, smoothed over neighbours.

    All arrays have the same shape. Zero if all weights are zero.
    """
    flat = None if weights is None else weights.ravel()
    counts = np.bincount(pixels.ravel(), flat, minlength=COUNT).astype(float).reshape(BINS)
    for axis, mode in enumerate(("wrap", "nearest", "nearest")):
        counts = gaussian_filter1d(counts, _SMOOTHING, axis=axis, mode=mode, truncate=2.0)
    total = counts.sum()
    return np.asarray(counts.ravel() / total if total > 0.0 else counts.ravel())


def target_share(target: FloatArray, background: FloatArray, odds: float) -> FloatArray:
    """Return the probability (COUNT,) that a pixel of each colour is the target's, from both histograms.

    The ratio histogram of Swain & Ballard (1991) in its Bayesian form.

    Parameters
    ----------
    odds : prior odds of the background against the target
    """
    return np.asarray(target / np.maximum(target + odds * background, 1e-9))


def _channels(image: Image) -> tuple[NDArray[np.uint8], ...]:
    """Return hue (0…179), saturation and value (0…255), (h, w) each."""
    return tuple(
        np.asarray(channel, np.uint8) for channel in cv2.split(cv2.cvtColor(image, cv2.COLOR_BGR2HSV))
    )


def _levels(hsv: tuple[NDArray[np.uint8], ...], bins: Bins, strides: Bins) -> list[NDArray[np.int32]]:
    """Return the bin of each channel times its stride, (h, w) each, by an eight-bit lookup table."""
    return [table[channel] for table, channel in zip(_tables(bins, strides), hsv, strict=True)]


@lru_cache(maxsize=8)
def _tables(bins: Bins, strides: Bins) -> list[NDArray[np.int32]]:
    level, (hues, saturations, values) = np.arange(256), bins
    in_bins = (np.minimum(level * hues // 180, hues - 1), level * saturations // 256, level * values // 256)
    return [(found * stride).astype(np.int32) for found, stride in zip(in_bins, strides, strict=True)]


_SHARPNESS = 20.0
"""λ of the likelihood exp(−λ·D²), D² = 1 − Bhattacharyya coefficient."""
_LEAST_SIMILARITY = 0.6
"""Bhattacharyya coefficient of the estimate below which the target is not found."""


@dataclass(frozen=True)
class ColourParameters:
    """Parameters of the colour tracker.

    Attributes
    ----------
    particles : number of particles
    dynamics : of the box
    resample_below : relative effective sample size below which particles are resampled (systematic)
    rate : share of the reference histogram that a frame replaces while the target is found; 0: the first
        box's histogram stays, as in Pérez et al. and in Ba & Odobez's baseline. `MixedStateTracker` updates
        its histogram in the same way.
    """

    particles: int = 200
    dynamics: BoxDynamics = field(default_factory=BoxDynamics)
    resample_below: float = 0.5
    rate: float = 0.0

    def __post_init__(self) -> None:
        if self.particles < 2:
            raise InputError(f"{self.particles} particles", "at least 2")
        if not 0.0 <= self.rate <= 1.0:
            raise InputError(f"rate = {self.rate}", "a share from 0 to 1")

    @classmethod
    def of_the_paper(cls, particles: int = 200) -> ColourParameters:
        """Ba & Odobez's baseline, Pérez et al. 2002: the histogram of the first box stays."""
        return cls(particles, rate=0.0)


class ColourTracker:
    """Track the colours of the first box.

    Parameters
    ----------
    exemplars : if given, the pan is estimated in the tracked box ("track, then estimate pose")
    particles : overrides the number in the parameters
    """

    name: ClassVar[str] = "color"

    def __init__(
        self,
        parameters: ColourParameters = ColourParameters(),
        *,
        exemplars: HeadExemplars | None = None,
        particles: int | None = None,
        seed: int | np.random.Generator = 0,
    ) -> None:
        self.parameters = parameters if particles is None else replace(parameters, particles=particles)
        self.exemplars = exemplars
        self.pan_classes: PoseClasses | None = None if exemplars is None else exemplars.classes.pans
        self._rng = generator(seed)
        self._shape: tuple[int, int] = (0, 0)

    def start(self, image: Image, box: Box | None) -> BoxEstimate:
        """Start with the target's box; see `Tracker.start`."""
        p = self.parameters
        first = first_state(image, box)
        self._shape = image.shape[0], image.shape[1]
        self._model = box_colours(hue_bins(image), boxes_of(first[None]))[0]
        self._reference = first[2:]
        self._cloud = Cloud.about(first, p.particles, self._rng)
        return self._look(image)

    def step(self, image: Image, proposal: Proposal | None = None) -> BoxEstimate:
        """Process the next frame; see `Tracker.step`."""
        check_frame(image, self._shape)
        p = self.parameters
        cloud, _ = resampled(self._cloud, p.resample_below, self._rng)
        self._cloud = predict(cloud, self._reference, p.dynamics, self._rng, proposal, self._shape)
        return self._look(image)

    def _look(self, image: Image) -> BoxEstimate:
        p = self.parameters
        pixels = hue_bins(image)
        similarity = bhattacharyya(box_colours(pixels, self._cloud.boxes), self._model)
        with np.errstate(divide="ignore"):
            log_weights = np.log(self._cloud.weights) - _SHARPNESS * (1.0 - similarity)
        normalise(log_weights, weights := np.empty_like(log_weights))
        self._cloud = replace(self._cloud, weights=weights)
        box, spread = self._cloud.mean()
        here = box_colours(pixels, np.array([box]))
        at_mean = float(bhattacharyya(here, self._model)[0])
        found = at_mean > _LEAST_SIMILARITY
        if found:
            self._model = (1.0 - p.rate) * self._model + p.rate * here[0]
        pan, tilt = self._pose(image, box)
        return BoxEstimate(
            box=box,
            spread=spread,
            confidence=at_mean,
            found=found,
            particles=self._cloud.boxes,
            weights=weights,
            pan=pan,
            pan_likelihood=pan,
            tilt=tilt,
            cues={"colour": at_mean},
        )

    def _pose(self, image: Image, box: Box) -> tuple[FloatArray | None, float | None]:
        """Return the distribution (n_pan,) of the pan and the expected tilt in a box of a single frame (Ba &
        Odobez 2003, §4.2)."""
        if self.exemplars is None:
            return None, None
        patch = equalised(cut(grey(image), enlarged(np.array([box]), PATCH_MARGIN), SIDE))
        poses = self.exemplars.pose_log_likelihood(self.exemplars.log_ratio(self.exemplars.features(patch)))
        of_classes = np.exp(poses[0] - poses[0].max())
        of_classes /= of_classes.sum()
        pans = of_classes.reshape(self.exemplars.classes.n_tilt, -1).sum(axis=0)
        return np.asarray(pans, float), self.exemplars.mean_tilt(of_classes)
