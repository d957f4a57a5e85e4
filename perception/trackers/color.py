"""A particle filter on colour histograms (Pérez, Hue, Vermaak & Gangnet 2002), and then the head's pose."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import ClassVar

import numpy as np

from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray
from graphtrack.particles import generator, normalise
from perception.images.pixels import Image, enlarged, grey
from perception.pose.classes import PoseClasses
from perception.pose.features.gabor import SIDE
from perception.trackers.colours import BoxColours, bhattacharyya
from perception.trackers.dynamics import BoxDynamics, predict, resampled
from perception.trackers.mixed_state.exemplars import HeadExemplars
from perception.trackers.patches import PATCH_MARGIN, cut, equalised
from perception.trackers.tracker import Box, BoxEstimate, Cloud, Proposal, boxes_of, check_frame, first_state


@dataclass(frozen=True)
class ColourParameters:
    """How the colour tracker moves, looks and remembers.

    Attributes
    ----------
    particles : number of particles
    sharpness : λ of the likelihood exp(−λ·D²), D² = 1 − Bhattacharyya coefficient
    colours : how they are counted
    dynamics : of the box
    start_std : 1-σ of the first boxes about the given one, as a share of its size
    least_similarity : Bhattacharyya coefficient of the estimate below which the target is not found
    resample_below : share of the particles; resampling is systematic, below this effective sample size
    rate : share of the remembered histogram that a frame replaces while the target is found; 0: the first
        box's stays, as in Pérez et al. and so in Ba & Odobez's baseline. `MixedStateTracker` has the same
        memory.
    """

    particles: int = 200
    sharpness: float = 20.0
    colours: BoxColours = field(default_factory=BoxColours)
    dynamics: BoxDynamics = field(default_factory=BoxDynamics)
    start_std: float = 0.04
    least_similarity: float = 0.6
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
        self.pan_classes: PoseClasses | None = None if exemplars is None else exemplars.classes.pans
        self._rng = generator(seed)
        self._shape: tuple[int, int] = (0, 0)

    def start(self, image: Image, box: Box | None) -> BoxEstimate:
        """Begin with the target's box; see `Tracker.start`."""
        p = self.parameters
        first = first_state(image, box)
        self._shape = image.shape[0], image.shape[1]
        self._model = p.colours.of_boxes(p.colours.of_pixels(image), boxes_of(first[None]))[0]
        self._reference = first[2:]
        self._cloud = Cloud.about(first, p.particles, p.start_std, self._rng)
        return self._look(image)

    def step(self, image: Image, proposal: Proposal | None = None) -> BoxEstimate:
        """Go on to the next frame; see `Tracker.step`."""
        check_frame(image, self._shape)
        p = self.parameters
        cloud, _ = resampled(self._cloud, p.resample_below, self._rng)
        self._cloud = predict(cloud, self._reference, p.dynamics, self._rng, proposal, self._shape)
        return self._look(image)

    def _look(self, image: Image) -> BoxEstimate:
        p = self.parameters
        pixels = p.colours.of_pixels(image)
        similarity = bhattacharyya(p.colours.of_boxes(pixels, self._cloud.boxes), self._model)
        with np.errstate(divide="ignore"):
            log_weights = np.log(self._cloud.weights) - p.sharpness * (1.0 - similarity)
        normalise(log_weights, weights := np.empty_like(log_weights))
        self._cloud = replace(self._cloud, weights=weights)
        box, spread = self._cloud.mean()
        here = p.colours.of_boxes(pixels, np.array([box]))
        at_mean = float(bhattacharyya(here, self._model)[0])
        found = at_mean > p.least_similarity
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
        """Distribution (n_pan,) of the pan and expected tilt, by this box of this frame alone (Ba & Odobez
        2003, §4.2)."""
        if self.exemplars is None:
            return None, None
        patch = equalised(cut(grey(image), enlarged(np.array([box]), PATCH_MARGIN), SIDE))
        poses = self.exemplars.pose_log_likelihood(self.exemplars.log_ratio(self.exemplars.features(patch)))
        of_classes = np.exp(poses[0] - poses[0].max())
        of_classes /= of_classes.sum()
        pans = of_classes.reshape(self.exemplars.classes.n_tilt, -1).sum(axis=0)
        return np.asarray(pans, float), self.exemplars.mean_tilt(of_classes)
