"""Pose classes, and the conversion of class likelihoods from the image to the world frame."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import logsumexp

from graphtrack.geometry.angles import FloatArray, difference, direction, likelihood_at, unit, wrap
from graphtrack.geometry.camera import GroundCamera

TILT_EDGE = float(np.pi / 6.0)
"""Radians: bound of the tilt classes up and down (Chen et al. 2011, §2.3)."""


@dataclass(frozen=True)
class PoseClasses:
    """Pan classes times tilt classes; class index = tilt index · number of pans + pan index.

    Attributes
    ----------
    first, step : radians, centre of the first pan class and distance to the next
    n_pan : number of pan classes
    n_tilt : 1 (tilt is ignored) or 3 (down, middle, up)
    """

    first: float
    step: float
    n_pan: int
    n_tilt: int = 1

    @classmethod
    def circle(cls, n_pan: int, n_tilt: int = 1) -> PoseClasses:
        """Class k is centred on 360·k/n degrees, as in the table of observations."""
        return cls(0.0, 2.0 * np.pi / n_pan, n_pan, n_tilt)

    @classmethod
    def half_circle(cls) -> PoseClasses:
        """−90° to 90° in steps of 22.5° (Ba & Odobez 2003, §2.1)."""
        return cls(-np.pi / 2.0, np.pi / 8.0, 9)

    def __len__(self) -> int:
        return self.n_pan * self.n_tilt

    @property
    def all_around(self) -> bool:
        """Return True if the pans cover the whole circle."""
        return bool(np.isclose(self.n_pan * self.step, 2.0 * np.pi))

    @property
    def pans(self) -> PoseClasses:
        """Return the classes without tilts."""
        return PoseClasses(self.first, self.step, self.n_pan)

    @cached_property
    def pan(self) -> FloatArray:
        """Centres (n_pan,) of the pan classes, radians in (−π, π]."""
        return wrap(self.first + self.step * np.arange(self.n_pan))

    def index(self, pan: ArrayLike, tilt: ArrayLike = 0.0) -> NDArray[np.int64]:
        """The class (n,) of poses (n,) in radians; pans beyond the last class count to the nearest."""
        away = np.abs(difference(np.atleast_1d(np.asarray(pan, float))[:, None], self.pan))
        nearest = np.argmin(away, axis=1)
        if self.n_tilt == 1:
            return nearest
        level = 1 + (np.asarray(tilt) > TILT_EDGE).astype(int) - (np.asarray(tilt) < -TILT_EDGE)
        return np.asarray(level * self.n_pan + nearest, np.int64)

    def reflected(self, labels: NDArray[np.int64]) -> NDArray[np.int64]:
        """The classes (n,) of the mirror images of classes (n,): pans change their sign."""
        mirror = self.pans.index(-self.pan)
        level, pan = np.divmod(labels, self.n_pan)
        return np.asarray(level * self.n_pan + mirror[pan], np.int64)

    def pan_log_likelihood(self, log_likelihood: ArrayLike) -> FloatArray:
        """Sum the tilt classes out: (..., n_classes) → (..., n_pan)."""
        values = np.asarray(log_likelihood, float)
        levels = values.reshape(*values.shape[:-1], self.n_tilt, self.n_pan)
        return np.asarray(logsumexp(levels, axis=-2), float)

    def most_likely_pan(self, log_likelihood: ArrayLike) -> FloatArray:
        """Centre of the pan class with the highest likelihood, (...,) radians."""
        return self.pan[np.argmax(self.pan_log_likelihood(log_likelihood), axis=-1)]

    def mean_pan(self, log_likelihood: ArrayLike) -> FloatArray:
        """Circular mean (...,) in radians of the pan classes, weighted by their likelihoods."""
        pans = self.pan_log_likelihood(log_likelihood)
        weights = np.exp(pans - pans.max(axis=-1, keepdims=True))
        return self.mean_of(weights)

    def mean_of(self, distribution: FloatArray) -> FloatArray:
        """Circular mean (...,) in radians of distributions (..., n_pan) over the pan classes."""
        return direction(distribution @ unit(self.pan))


def world_likelihood(
    log_likelihood: ArrayLike,
    classes: PoseClasses,
    wanted: PoseClasses,
    camera: GroundCamera,
    position: FloatArray,
) -> FloatArray:
    """Convert class likelihoods (n, n_pan) in the image to (n, n_wanted) in the world, for people at (n, 2).

    Each world class is turned by the ray to the person (Chen et al. 2011, §3), and the image likelihood is
    interpolated linearly at that angle. Rows sum to 1.
    """
    n = len(position)
    at = np.stack([camera.image_angle(np.full(n, pan), position) for pan in wanted.pan], axis=1)
    return likelihood_at(np.exp(np.asarray(log_likelihood, float)), at, classes.first)


def image_likelihood(log_likelihood: ArrayLike, classes: PoseClasses, wanted: PoseClasses) -> FloatArray:
    """Resample likelihoods (n, n_pan) of image classes to (n, n_wanted) other image classes.

    Interpolation between the centres is linear. Rows sum to 1.
    """
    at = np.broadcast_to(wanted.pan, (len(np.asarray(log_likelihood)), wanted.n_pan))
    return likelihood_at(np.exp(np.asarray(log_likelihood, float)), at, classes.first)
