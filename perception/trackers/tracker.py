"""Interface of trackers on pixels, and their parts: states of boxes, dynamics and patches.

Boxes move by a second-order autoregression (Ba & Odobez 2003, §3.3), mixed with an external proposal.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import ClassVar, Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from graphtrack.baselines.particle_kernels import effective_sample_size, resample
from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray
from perception.images.pixels import Image, box_text, checked_box
from perception.pose.classes import PoseClasses

Box = tuple[float, float, float, float]
"""Left, top, width, height in pixels."""


@dataclass(frozen=True, eq=False)
class Proposal:
    """External prediction of the target in the next frame: a normal density of its box's centre.

    Attributes
    ----------
    centre : (2,) pixels
    covariance : (2, 2) pixels²
    """

    centre: FloatArray
    covariance: FloatArray


@dataclass(frozen=True, eq=False)
class BoxEstimate:
    """A tracker's estimate in one frame.

    Attributes
    ----------
    box : left, top, width, height in pixels
    spread : (2,) 1-σ of the particles' centres, right and down (pixels)
    confidence : 0…1, comparable within one tracker
    found : whether the tracker detects the target in the frame
    particles : (n, 4) boxes
    weights : (n,) of the particles; they sum to 1
    pan : (n_pan,) distribution of the head's pan over the tracker's classes, image frame; it sums to 1
    pan_likelihood : (n_pan,) likelihood of the pan in this frame alone, up to a factor
    cues : strength of each cue, by name
    tilt : expected tilt of the head, radians above the horizontal
    """

    box: Box
    spread: FloatArray
    confidence: float
    found: bool
    particles: FloatArray
    weights: FloatArray
    pan: FloatArray | None = None
    pan_likelihood: FloatArray | None = None
    cues: Mapping[str, float] = field(default_factory=dict)
    tilt: float | None = None

    @property
    def centre(self) -> FloatArray:
        """Middle (2,) of the box, pixels."""
        left, top, width, height = self.box
        return np.array([left + width / 2.0, top + height / 2.0])


class Tracker(Protocol):
    """Tracker of one target in consecutive frames of one size.

    ``pan_classes`` are the classes of `BoxEstimate.pan`; None for trackers without pan.
    """

    name: ClassVar[str]
    pan_classes: PoseClasses | None

    def start(self, image: Image, box: Box | None) -> BoxEstimate:
        """Start with the target's box in the first frame; without a box the tracker searches for a target.

        Raises
        ------
        InputError
            If the box cannot be used, or there is none and the tracker finds no target.
        """
        ...

    def step(self, image: Image, proposal: Proposal | None = None) -> BoxEstimate:
        """Process the next frame (h, w, 3) uint8.

        Raises
        ------
        InputError
            If the frame's size is not that of the first.
        """
        ...


START_STD = 0.04
"""1-σ of the initial boxes about the given box, as a share of its size."""


@dataclass(frozen=True, eq=False)
class Cloud:
    """Weighted boxes, n in number, and their positions in the previous frame.

    Attributes
    ----------
    now, before : (n, 4) centre right and down (pixels), logarithms of width and height (pixels)
    weights : (n,), they sum to 1
    """

    now: FloatArray
    before: FloatArray
    weights: FloatArray

    @classmethod
    def about(cls, first: FloatArray, count: int, rng: np.random.Generator) -> Cloud:
        """Equal particles about a state (4,), at rest."""
        noise = START_STD * rng.standard_normal((count, 4))
        noise[:, :2] *= np.exp(first[2:])
        now = first + noise
        return cls(now, now.copy(), np.full(count, 1.0 / count))

    def chosen(self, ancestors: NDArray[np.int64]) -> Cloud:
        """Equal weights for the particles (n,) that were drawn."""
        n = len(ancestors)
        return Cloud(self.now[ancestors], self.before[ancestors], np.full(n, 1.0 / n))

    @property
    def boxes(self) -> FloatArray:
        """Left, top, width and height (n, 4)."""
        return boxes_of(self.now)

    def mean(self) -> tuple[Box, FloatArray]:
        """The mean box and the 1-σ (2,) of the centres (pixels)."""
        mean = self.weights @ self.now
        spread = np.sqrt(self.weights @ (self.now[:, :2] - mean[:2]) ** 2)
        left, top, width, height = (float(value) for value in boxes_of(mean[None])[0])
        return (left, top, width, height), spread


def boxes_of(states: FloatArray) -> FloatArray:
    """Boxes (n, 4) of states (n, 4): centre and logarithms of the size."""
    size = np.exp(states[:, 2:])
    return np.hstack([states[:, :2] - size / 2.0, size])


def states_of(boxes: FloatArray) -> FloatArray:
    """States (n, 4) of boxes (n, 4); the inverse of `boxes_of`."""
    return np.hstack([boxes[:, :2] + boxes[:, 2:] / 2.0, np.log(boxes[:, 2:])])


def check_frame(image: Image, shape: tuple[int, int] | None) -> None:
    """Refuse a frame that is no colour image, or differs in size (height, width) from the first frame.

    Raises
    ------
    InputError
        With both sizes.
    """
    if image.ndim != 3 or image.shape[2] != 3 or image.dtype != np.uint8:
        raise InputError(f"an array {image.shape} of {image.dtype}", "a frame (h, w, 3) of uint8")
    if shape is not None and image.shape[:2] != shape:
        found, first = f"{image.shape[1]} × {image.shape[0]}", f"{shape[1]} × {shape[0]}"
        raise InputError(f"a frame of {found} pixels", f"{first}, as the first frame")


def first_state(image: Image, box: Box | None) -> FloatArray:
    """Return the initial state (4,) of a tracker's box in a frame.

    Raises
    ------
    InputError
        If there is no box, it is refused by `check_box`, or the frame by `check_frame`.
    """
    if box is None:
        raise InputError("no target in the first frame", "the target's box")
    check_frame(image, None)
    return states_of(check_box(box, image)[None])[0]


def check_box(box: Box, image: Image) -> FloatArray:
    """Return the checked box (4,) of a target in the first frame.

    Raises
    ------
    InputError
        If it is no `checked_box`, smaller than 2 pixels, or its middle is outside the image.
    """
    try:
        left, top, width, height = values = checked_box(box, image.shape)
        h, w = image.shape[:2]
        if min(width, height) < 2.0:
            raise InputError(box_text(values), "a width and height of at least 2 pixels")
        if not (0.0 <= left + width / 2.0 <= w and 0.0 <= top + height / 2.0 <= h):
            expected = f"one with its middle inside the image of {w} × {h} pixels"
            raise InputError(box_text(values), expected)
    except InputError as error:
        raise InputError(f"no target in the first frame: {error.found}", error.expected) from error
    return values


@dataclass(frozen=True)
class BoxDynamics:
    """Dynamics per frame of the centre, in units of the box's size, and of the logarithm of the size.

    Attributes
    ----------
    persistence : coefficient of the centre's last step, 0 (random walk) … 1 (constant velocity)
    centre_std : 1-σ of the noise of the centre, as a share of the box's width and height
    size_std : 1-σ of the noise of the logarithm of the size
    reversion : rate per frame of the reversion to the first size
    guided_share : share of the particles whose centre is drawn from a `Proposal`, if there is one
    """

    persistence: float = 0.8
    centre_std: float = 0.08
    size_persistence: float = 0.3
    size_std: float = 0.02
    reversion: float = 0.01
    guided_share: float = 0.8


def resampled(cloud: Cloud, below: float, rng: np.random.Generator) -> tuple[Cloud, NDArray[np.int64]]:
    """Resample a cloud; return it and the ancestors (n,) of its particles.

    It is resampled only if its effective sample size is less than a share ``below`` of its particles.
    """
    n = len(cloud.weights)
    if effective_sample_size(cloud.weights) >= below * n:
        return cloud, np.arange(n)
    ancestors = resample(cloud.weights, rng)
    return cloud.chosen(ancestors), ancestors


def predict(
    cloud: Cloud,
    reference: FloatArray,
    dynamics: BoxDynamics,
    rng: np.random.Generator,
    proposal: Proposal | None = None,
    shape: tuple[int, ...] | None = None,
) -> Cloud:
    """Draw the next states of all particles.

    x_t = x_{t−1} + a·(x_{t−1} − x_{t−2}) + noise for the centre; the size also goes back to its reference.
    With a proposal the dynamics are a mixture: the centres of ``guided_share`` of the particles come from it,
    with velocity 0, so that particles of a lost target do not continue at its last velocity.

    Parameters
    ----------
    reference : (2,) logarithms of the first width and height (pixels)
    shape : of an image (h, w) that the centres are kept within
    """
    now, step = cloud.now, cloud.now - cloud.before
    noise = rng.standard_normal(now.shape)
    size = np.exp(now[:, 2:])
    after = np.empty_like(now)
    after[:, :2] = now[:, :2] + dynamics.persistence * step[:, :2] + dynamics.centre_std * size * noise[:, :2]
    after[:, 2:] = (
        now[:, 2:]
        + dynamics.size_persistence * step[:, 2:]
        + dynamics.reversion * (reference - now[:, 2:])
        + dynamics.size_std * noise[:, 2:]
    )
    before = now.copy()
    if proposal is not None:
        guided = rng.random(len(now)) < dynamics.guided_share
        drawn = rng.multivariate_normal(proposal.centre, proposal.covariance, len(now))
        after[guided, :2] = drawn[guided]
        before[guided] = after[guided]
    if shape is not None:
        np.clip(after[:, :2], 0.0, shape[::-1], out=after[:, :2])
    return Cloud(after, before, cloud.weights)


PATCH_MARGIN = 1.06
"""Size of a head's patch relative to its box, as that of the crops which classifiers are trained with."""


def cut(grey: NDArray[np.uint8], boxes: FloatArray, side: int) -> NDArray[np.uint8]:
    """Cut patches (n, side, side) of boxes (n, 4) in a grey image (h, w), by linear interpolation.

    The image's border is replicated.
    """
    share = ((np.arange(side) + 0.5) / side).astype(np.float32)
    left, top, width, height = np.asarray(boxes, np.float32).T[:, :, None]
    x, y = left + width * share - np.float32(0.5), top + height * share - np.float32(0.5)
    shape = (len(boxes), side, side)
    # A patch is a row of the maps: OpenCV takes no more than 2¹⁵ rows.
    columns = np.ascontiguousarray(np.broadcast_to(x[:, None, :], shape)).reshape(len(boxes), -1)
    rows = np.ascontiguousarray(np.broadcast_to(y[:, :, None], shape)).reshape(len(boxes), -1)
    patches = cv2.remap(grey, columns, rows, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(patches, np.uint8).reshape(shape)


def equalised(patches: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Equalise the histogram of each patch (n, h, w)."""
    return np.array([cv2.equalizeHist(patch) for patch in patches], np.uint8).reshape(patches.shape)
