"""A particle filter on colour histograms (Pérez, Hue, Vermaak & Gangnet 2002), and then the head's pose."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import ClassVar

import cv2
import numpy as np
from numpy.typing import NDArray

from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray
from graphtrack.particles import effective_sample_size, generator, normalise, resample
from perception.images.pixels import Image, enlarged
from perception.pose.classes import PoseClasses
from perception.pose.features.gabor import SIDE, gabor_features
from perception.trackers.dynamics import BoxDynamics, predict
from perception.trackers.mixed_state.exemplars import HeadExemplars
from perception.trackers.patches import PATCH_MARGIN, cut, equalised
from perception.trackers.tracker import Box, BoxEstimate, Cloud, Proposal, check_box, check_frame, states_of


@dataclass(frozen=True)
class ColourParameters:
    """How the colour tracker moves and looks; the numbers of the histogram are those of Pérez et al.

    Attributes
    ----------
    particles : number of particles
    bins : of hue, of saturation and of value
    least_saturation, least_value : 0…1; pixels below either have no hue and are counted by their value
    sharpness : λ of the likelihood exp(−λ·D²), D² = 1 − Bhattacharyya coefficient
    samples : pixels looked at along each side of a box
    dynamics : of the box
    start_std : 1-σ of the first boxes about the given one, as a share of its size
    least_similarity : Bhattacharyya coefficient of the estimate below which the target is not found
    resample_below : share of the particles; resampling is systematic, below this effective sample size
    """

    particles: int = 200
    bins: tuple[int, int, int] = (10, 10, 10)
    least_saturation: float = 0.1
    least_value: float = 0.2
    sharpness: float = 20.0
    samples: int = 24
    dynamics: BoxDynamics = field(default_factory=BoxDynamics)
    start_std: float = 0.04
    least_similarity: float = 0.6
    resample_below: float = 0.5

    def __post_init__(self) -> None:
        if self.particles < 2:
            raise InputError(f"{self.particles} particles", "at least 2")


class ColourTracker:
    """Follow what has the colours of the first box.

    Parameters
    ----------
    exemplars : with them, the pan is estimated in the box that was tracked ("track, then estimate pose")
    particles : in place of the parameters' number
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
        self.pan_classes: PoseClasses | None = None
        if exemplars is not None:
            self.pan_classes = exemplars.classes.pans
        self._rng = generator(seed)
        self._shape: tuple[int, int] = (0, 0)

    def start(self, image: Image, box: Box | None) -> BoxEstimate:
        """Begin with the target's box.

        Raises
        ------
        InputError
            If there is no box, or it cannot be used.
        """
        if box is None:
            raise InputError("no target in the first frame", "the target's box")
        check_frame(image, None)
        p = self.parameters
        given = np.array([check_box(box, image)])
        self._shape = image.shape[0], image.shape[1]
        self._model = histograms(colour_bins(image, p), given, p)[0]
        first = states_of(given)[0]
        self._reference = first[2:]
        self._cloud = Cloud.about(first, p.particles, p.start_std, self._rng)
        return self._look(image)

    def step(self, image: Image, proposal: Proposal | None = None) -> BoxEstimate:
        """Go on to the next frame.

        Raises
        ------
        InputError
            If the frame's size is not that of the first.
        """
        check_frame(image, self._shape)
        p = self.parameters
        if effective_sample_size(self._cloud.weights) < p.resample_below * p.particles:
            self._cloud = self._cloud.chosen(resample(self._cloud.weights, self._rng))
        self._cloud = predict(self._cloud, self._reference, p.dynamics, self._rng, proposal)
        np.clip(self._cloud.now[:, :2], 0.0, self._shape[::-1], out=self._cloud.now[:, :2])
        return self._look(image)

    def _look(self, image: Image) -> BoxEstimate:
        p = self.parameters
        bins = colour_bins(image, p)
        similarity = bhattacharyya(histograms(bins, self._cloud.boxes, p), self._model)
        with np.errstate(divide="ignore"):
            log_weights = np.log(self._cloud.weights) - p.sharpness * (1.0 - similarity)
        weights = np.empty_like(log_weights)
        normalise(log_weights, weights)
        self._cloud = replace(self._cloud, weights=weights)
        box, spread = self._cloud.mean()
        at_mean = float(bhattacharyya(histograms(bins, np.array([box]), p), self._model)[0])
        pan = self._pan(image, box)
        return BoxEstimate(
            box=box,
            spread=spread,
            confidence=at_mean,
            found=at_mean > p.least_similarity,
            particles=self._cloud.boxes,
            weights=weights,
            pan=pan,
            pan_likelihood=pan,
            cues={"colour": at_mean},
        )

    def _pan(self, image: Image, box: Box) -> FloatArray | None:
        """Distribution (n_pan,) of the pan, by this box of this frame alone (004 §4.2)."""
        if self.exemplars is None:
            return None
        grey = np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), np.uint8)
        patch = equalised(cut(grey, enlarged(np.array([box]), PATCH_MARGIN), SIDE))
        poses = self.exemplars.pose_log_likelihood(self.exemplars.log_ratio(gabor_features(patch)))
        pans = np.exp(self.exemplars.classes.pan_log_likelihood(poses[0]))
        return np.asarray(pans / pans.sum(), float)


def colour_bins(image: Image, parameters: ColourParameters) -> NDArray[np.int64]:
    """The histogram's bin (h, w) of every pixel: hue and saturation, or value where there is no hue."""
    hue_bins, saturation_bins, value_bins = parameters.bins
    hsv = cv2.cvtColor(image, cv2.COLOR_BGR2HSV)
    hue, saturation, value = (hsv[..., k].astype(np.int64) for k in range(3))
    coloured = hue * hue_bins // 180 * saturation_bins + saturation * saturation_bins // 256
    pale = (saturation < 255 * parameters.least_saturation) | (value < 255 * parameters.least_value)
    grey = hue_bins * saturation_bins + value * value_bins // 256
    return np.where(pale, grey, coloured)


def histograms(bins: NDArray[np.int64], boxes: FloatArray, parameters: ColourParameters) -> FloatArray:
    """Normalised histograms (n, bins) of boxes (n, 4), from pixels on a grid in each."""
    height, width = bins.shape
    share = (np.arange(parameters.samples) + 0.5) / parameters.samples
    columns = np.clip((boxes[:, :1] + boxes[:, 2:3] * share).astype(np.int64), 0, width - 1)
    rows = np.clip((boxes[:, 1:2] + boxes[:, 3:] * share).astype(np.int64), 0, height - 1)
    seen = bins[rows[:, :, None], columns[:, None, :]].reshape(len(boxes), -1)
    hue_bins, saturation_bins, value_bins = parameters.bins
    count = hue_bins * saturation_bins + value_bins
    place = seen + count * np.arange(len(boxes))[:, None]
    total = np.bincount(place.ravel(), minlength=count * len(boxes)).reshape(len(boxes), count)
    return np.asarray(total / seen.shape[1], float)


def bhattacharyya(histogram: FloatArray, model: FloatArray) -> FloatArray:
    """Σ √(p·q) (n,) of histograms (n, bins) and one (bins,): 1 where they are equal, 0 without overlap."""
    return np.asarray(np.sqrt(histogram * model).sum(axis=1), float)
