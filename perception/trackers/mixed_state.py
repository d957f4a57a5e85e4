"""Mixed-state particle filter: head box and exemplar label in one state (Ba & Odobez 2003, §3)."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import ClassVar, Literal

import numpy as np
from scipy.special import logsumexp

from graphtrack.baselines.particle_kernels import generator
from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray
from perception.images.pixels import Image, enlarged, grey
from perception.pose.classes import PoseClasses
from perception.pose.features import SIDE
from perception.trackers.color import bhattacharyya, box_colours, hue_bins
from perception.trackers.head_exemplars import HeadExemplars, load_head_exemplars
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

Labels = Literal["sampled", "summed"]
Likelihood = Literal["ratio", "density"]


_SHARPNESS, _TYPICAL = 20.0, 0.8
"""Log ratio per unit of the Bhattacharyya coefficient; the neutral coefficient: rendered heads have at least
0.88 in 95 % of the frames, other boxes at most 0.83 in 95 %."""
TRANSITIONS = float(np.radians(12.0)), 0.05, 0.9
"""1-σ of the pan in radians a frame, share of each neighbouring tilt class relative to staying, and
probability of the same exemplar while the pose stays; see `HeadExemplars.transitions`."""
_VANISH, _APPEAR = 0.02, 0.05
"""Probabilities per frame that a visible head becomes hidden, and that a hidden head becomes visible."""
MEMORY = 0.05
"""Share of the reference histogram that a frame replaces while the head is visible."""


@dataclass(frozen=True)
class MixedStateParameters:
    """Parameters of the mixed-state tracker.

    Attributes
    ----------
    particles : number of particles
    labels : "sampled": one label per particle, as in the paper; "summed": each particle has the
        distribution of its labels given its path, so that only boxes are sampled (Rao–Blackwell)
    likelihood : "ratio": p(z|X)/p(z|no head) with one weight per filter, and the head may be hidden;
        "density": p_T(z|k) of eq. 5 as published, with the head always visible
    colour : whether the head's colours distinguish it from other heads and occluders, by a term
        ``_SHARPNESS``·(similarity − ``_TYPICAL``) of the log ratio; the paper uses exemplars only
    dynamics : of the box
    pan_limit : radians; poses that face away from the camera by more are excluded. The exemplars confuse
        faces with backs of heads; Ba & Odobez (2003) have −90° to 90° only.
    resample_below : relative effective sample size below which particles are resampled (systematic)
    plain_exemplars : whether exemplars have the published form (`HeadExemplars.plain`)
    """

    particles: int = 200
    labels: Labels = "summed"
    likelihood: Likelihood = "ratio"
    colour: bool = True
    dynamics: BoxDynamics = field(default_factory=BoxDynamics)
    pan_limit: float = float(np.pi)
    resample_below: float = 0.5
    plain_exemplars: bool = False

    def __post_init__(self) -> None:
        if self.particles < 2:
            raise InputError(f"{self.particles} particles", "at least 2")
        if self.likelihood not in ("ratio", "density"):
            raise InputError(f"likelihood {self.likelihood!r}", "'ratio' or 'density'")
        if self.labels not in ("sampled", "summed"):
            raise InputError(f"labels {self.labels!r}", "'sampled' or 'summed'")
        if not 0.0 <= self.pan_limit <= np.pi + 1e-9:
            raise InputError(f"pan_limit = {self.pan_limit} radians", "an angle from 0 to π")

    @classmethod
    def of_the_paper(cls, particles: int = 200) -> MixedStateParameters:
        """Return the parameters of Ba & Odobez 2003 as published.

        Likelihoods of eq. 5, sampled labels, resampling in every step (§3.1), pans from −90° to 90°
        (§2.1); no colours; exemplars with the deviations of their own clusters (§2.1) and transitions by
        common people alone (§3.3). The head is never hidden. The paper gives the form of the boxes' dynamics
        but no numbers; these are our own.
        """
        return cls(
            particles,
            likelihood="density",
            labels="sampled",
            colour=False,
            pan_limit=float(np.pi / 2.0),
            resample_below=1.0,
            plain_exemplars=True,
        )


class HeadAppearance:
    """Likelihood ratios of a head in boxes: its exemplars and, if wanted, its colours so far.

    Parameters
    ----------
    exemplars : with the poses that are possible
    has_colours : whether the head's colours count
    """

    def __init__(self, exemplars: HeadExemplars, *, has_colours: bool) -> None:
        self.exemplars, self._has_colours = exemplars, has_colours
        self._colours: FloatArray | None = None

    def start(self, image: Image, first: FloatArray) -> None:
        """Start with the box of a state (4,) in an image."""
        self._colours = box_colours(hue_bins(image), boxes_of(first[None]))[0] if self._has_colours else None

    def look(self, image: Image) -> None:
        """Look at an image."""
        self._grey = grey(image)
        self._pixels = None if self._colours is None else hue_bins(image)

    def features(self, boxes: FloatArray) -> FloatArray:
        """Return the responses (n, 764) in boxes (n, 4)."""
        patches = cut(self._grey, enlarged(boxes, PATCH_MARGIN), SIDE)
        return self.exemplars.features(equalised(patches))

    def by_colour(self, boxes: FloatArray) -> FloatArray:
        """Return the colour terms (n,) of the log ratio in boxes (n, 4)."""
        if self._colours is None or self._pixels is None:
            return np.zeros(len(boxes))
        similarity = bhattacharyya(box_colours(self._pixels, boxes), self._colours)
        return _SHARPNESS * (similarity - _TYPICAL)

    def remember(self, box: Box, visibility: float) -> dict[str, float]:
        """Update the colours by those of a box; return the cue "colour", their similarity, if they count."""
        if self._colours is None or self._pixels is None:
            return {}
        here = box_colours(self._pixels, np.array([box]))[0]
        similarity = float(bhattacharyya(here[None], self._colours)[0])
        rate = MEMORY * visibility
        self._colours = (1.0 - rate) * self._colours + rate * here
        return {"colour": similarity}


class MixedStateTracker:
    """Track a head, its pan and its tilt.

    The weight of a particle is 1 − P + P·p(z|X)/p(z|no head), P being the probability that the head is
    visible: a hidden Markov chain of two states, driven by the particles' mean ratio. While P is small the
    weights stay as they are and the particles spread; the weights cannot all vanish. With
    ``likelihood="density"`` the weight is p_T(z|k) (eq. 6), and the confidence is the similarity of the
    patches to the exemplars (`HeadExemplars.fit`).

    Parameters
    ----------
    exemplars : the appearance model; by default the package's, see ``plain_exemplars``
    particles : overrides the number in the parameters
    """

    name: ClassVar[str] = "mixed-state"

    def __init__(
        self,
        parameters: MixedStateParameters = MixedStateParameters(),
        *,
        exemplars: HeadExemplars | None = None,
        particles: int | None = None,
        seed: int | np.random.Generator = 0,
    ) -> None:
        self.parameters = parameters if particles is None else replace(parameters, particles=particles)
        plain = self.parameters.plain_exemplars
        loaded = load_head_exemplars(plain=plain) if exemplars is None else exemplars
        self.exemplars = loaded.within(self.parameters.pan_limit)
        classes = self.exemplars.classes
        self.pan_classes: PoseClasses | None = classes.pans
        self._rng = generator(seed)
        self._transitions = self.exemplars.transitions(*TRANSITIONS)
        self._reach = np.cumsum(self._transitions, axis=1)
        self._shape: tuple[int, int] = (0, 0)
        self._visibility = 1.0
        self._appearance = HeadAppearance(self.exemplars, has_colours=self.parameters.colour)

    def start(self, image: Image, box: Box | None) -> BoxEstimate:
        """Start with the head's box; see `Tracker.start`."""
        first = first_state(image, box)
        self._shape = image.shape[0], image.shape[1]
        n = self.parameters.particles
        self._reference = first[2:]
        self._cloud = Cloud.about(first, n, self._rng)
        self._label = self._rng.choice(self.exemplars.labels, n, p=self.exemplars.prior())
        self._belief = np.tile(self.exemplars.prior(), (n, 1))
        # A given box holds a head, whatever its likelihood.
        self._visibility = 1.0
        self._appearance.start(image, first)
        return self._look(image, 1.0)

    def step(self, image: Image, proposal: Proposal | None = None) -> BoxEstimate:
        """Process the next frame; see `Tracker.step`."""
        check_frame(image, self._shape)
        p = self.parameters
        cloud, ancestors = resampled(self._cloud, p.resample_below, self._rng)
        self._label, self._belief = self._label[ancestors], self._belief[ancestors]
        self._cloud = predict(cloud, self._reference, p.dynamics, self._rng, proposal, self._shape)
        if p.labels == "sampled":
            drawn = self._rng.random((p.particles, 1))
            last = self.exemplars.labels - 1
            self._label = np.minimum((self._reach[self._label] < drawn).sum(axis=1), last)
        else:
            self._belief = self._belief @ self._transitions
        return self._look(image, still_visible(self._visibility))

    def _look(self, image: Image, visible: float) -> BoxEstimate:
        """Weight the particles by the frame; ``visible`` is the prior probability."""
        before = self._cloud.weights
        self._appearance.look(image)
        features = self._appearance.features(self._cloud.boxes)
        of_colour = self._appearance.by_colour(self._cloud.boxes)
        if self.parameters.likelihood == "ratio":
            by_label = self.exemplars.log_ratio(features)
            by_shape = self._over_labels(by_label)
            weights, self._visibility = perhaps_hidden(before, np.exp(by_shape + of_colour), visible)
            odds = float(before @ np.exp(by_shape))
            like, confidence = odds / (1.0 + odds), self._visibility
        else:
            by_label = self.exemplars.log_density(features)
            weights = _normalised(before, self._over_labels(by_label) + of_colour)
            fit = (self._labels() * self.exemplars.fit(by_label)).sum(axis=1)
            like = confidence = float(weights @ fit)
        self._cloud = replace(self._cloud, weights=weights)
        box, spread = self._cloud.mean()
        cues = {"exemplars": like} | self._appearance.remember(box, self._visibility)
        of_labels = weights @ self._labels()
        return BoxEstimate(
            box=box,
            spread=spread,
            confidence=confidence,
            found=self._visibility > 0.5,
            particles=self._cloud.boxes,
            weights=weights,
            pan=self._by_pan(of_labels),
            pan_likelihood=self._pan_likelihood(by_label, weights),
            tilt=self.exemplars.mean_tilt(of_labels),
            cues=cues,
        )

    def _over_labels(self, by_label: FloatArray) -> FloatArray:
        """Return log likelihoods (n,) of the particles from values (n, labels), and update the beliefs."""
        if self.parameters.labels == "sampled":
            return np.asarray(by_label[np.arange(len(by_label)), self._label])
        with np.errstate(divide="ignore"):
            joint = by_label + np.log(self._belief)
        total = np.asarray(logsumexp(joint, axis=1), float)
        self._belief = np.exp(joint - total[:, None])
        return total

    def _labels(self) -> FloatArray:
        """Return the distribution (n, labels) of each particle's label."""
        if self.parameters.labels == "summed":
            return self._belief
        return np.eye(self.exemplars.labels)[self._label]

    def _by_pan(self, of_labels: FloatArray) -> FloatArray:
        """Sum labels (labels,) for each pan (eq. 10)."""
        classes = self.exemplars.classes
        return np.asarray(of_labels.reshape(classes.n_tilt, classes.n_pan, -1).sum(axis=(0, 2)), float)

    def _pan_likelihood(self, ratio: FloatArray, weights: FloatArray) -> FloatArray:
        """Return p(z|pan) (n_pan,), over boxes and tilts, from the current frame only."""
        over_boxes = over(self.exemplars.pose_log_likelihood(ratio), weights)
        pans = self.exemplars.classes.pan_log_likelihood(over_boxes)
        return np.exp(pans - logsumexp(pans))


def over(log_likelihood: FloatArray, weights: FloatArray) -> FloatArray:
    """Return the logarithm (k,) of the weighted sum over boxes, from log likelihoods (n, k)."""
    with np.errstate(divide="ignore"):
        return np.asarray(logsumexp(log_likelihood + np.log(weights)[:, None], axis=0))


def still_visible(visibility: float) -> float:
    """Return the probability that the head is visible in the next frame."""
    return visibility * (1.0 - _VANISH) + (1.0 - visibility) * _APPEAR


def perhaps_hidden(before: FloatArray, likelihood: FloatArray, visible: float) -> tuple[FloatArray, float]:
    """Return weights (n,) from likelihood ratios (n,) of a head that may be hidden, and P(visible)."""
    evidence = float(before @ likelihood)
    weights = before * (1.0 - visible + visible * likelihood)
    visible_share = visible * evidence / (1.0 - visible + visible * evidence)
    return np.asarray(weights / weights.sum()), visible_share


def _normalised(before: FloatArray, log_likelihood: FloatArray) -> FloatArray:
    """Return the weights (n,) of eq. 6, by ratios, since likelihoods of 764 responses underflow."""
    weights = before * np.exp(log_likelihood - log_likelihood.max())
    return np.asarray(weights / weights.sum())
