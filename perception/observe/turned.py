"""Class likelihoods of the image as those of the world, or of other classes."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from graphtrack.geometry.angles import FloatArray
from graphtrack.geometry.camera import GroundCamera
from perception.pose.classes import PoseClasses


def world_likelihood(
    log_likelihood: ArrayLike,
    classes: PoseClasses,
    wanted: PoseClasses,
    camera: GroundCamera,
    position: FloatArray,
) -> FloatArray:
    """Class likelihoods (n, n_wanted) in the world of those (n, n_pan) in the image, for people at (n, 2).

    The classes of the world are seen at other angles in the image, by the ray to each person (Chen et al.
    2011, §3); there the likelihood is interpolated linearly. Rows sum to 1.
    """
    p = np.exp(np.asarray(log_likelihood, float))
    at = np.stack([camera.image_angle(np.full(len(p), pan), position) for pan in wanted.pan], axis=1)
    found = interpolated(p, classes, at)
    return np.asarray(found / found.sum(axis=1, keepdims=True), float)


def image_likelihood(log_likelihood: ArrayLike, classes: PoseClasses, wanted: PoseClasses) -> FloatArray:
    """Likelihoods (n, n_wanted) of other classes of the image than those (n, n_pan) that are known.

    They are interpolated linearly between the centres. Rows sum to 1.
    """
    p = np.exp(np.asarray(log_likelihood, float))
    found = interpolated(p, classes, np.broadcast_to(wanted.pan, (len(p), wanted.n_pan)))
    return np.asarray(found / found.sum(axis=1, keepdims=True), float)


def interpolated(values: FloatArray, classes: PoseClasses, angle: FloatArray) -> FloatArray:
    """Values (n, n_pan) of classes all around, at angles (n, k) between their centres."""
    place = np.mod(angle - classes.first, 2.0 * np.pi) / classes.step
    lower: NDArray[np.int64] = np.floor(place).astype(np.int64)
    share = place - lower
    first = np.take_along_axis(values, lower % classes.n_pan, axis=1)
    second = np.take_along_axis(values, (lower + 1) % classes.n_pan, axis=1)
    return np.asarray((1.0 - share) * first + share * second, float)
