"""Orientations and spreads of ROS's poses, and what a ground plane keeps of them.

Quaternions are x, y, z, w; covariances are those of ROS's poses: row by row 6×6 of x, y, z (metres) and of
the rotations about the axes (radians).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from graphtrack.bounds import LARGEST_CONCENTRATION
from graphtrack.geometry.angles import FloatArray

_AXES = {"x": [1.0, 0.0, 0.0], "z": [0.0, 0.0, 1.0]}

_STEEP = 0.1
"""Of an axis: the part along the ground (sine of its angle to the vertical) below which it has no heading."""


def yaw_of(quaternion: FloatArray, axis: str = "x") -> FloatArray:
    """Headings (n,) of an axis of rotated frames, in radians counter-clockwise from x.

    Parameters
    ----------
    quaternion : (n, 4); of any length, for those who publish them often do not care
    axis : "x" as for bodies and faces, "z" as for gazes and cameras

    Returns
    -------
    (n,) NaN where the quaternion is 0 or not finite, or the axis stands upright
    """
    quaternion = np.asarray(quaternion, dtype=float).reshape(-1, 4)
    known = _is_rotation(quaternion)
    turned = np.full((len(quaternion), 3), np.nan)
    if known.any():
        turned[known] = Rotation.from_quat(quaternion[known]).apply(_AXES[axis])
    # A comparison with NaN is false.
    level = np.hypot(turned[:, 0], turned[:, 1]) > _STEEP
    return np.where(level, np.arctan2(turned[:, 1], turned[:, 0]), np.nan)


def _is_rotation(quaternion: FloatArray) -> NDArray[np.bool_]:
    with np.errstate(invalid="ignore"):
        length = np.linalg.norm(quaternion, axis=1)
    return np.asarray((length > 0.0) & np.isfinite(length))


def quaternion_of(yaw: FloatArray) -> FloatArray:
    """Quaternions (n, 4) of rotations about the vertical by (n,) radians; no rotation for NaN."""
    half = np.nan_to_num(np.asarray(yaw, dtype=float)) / 2.0
    none = np.zeros_like(half)
    return np.stack([none, none, np.sin(half), np.cos(half)], axis=-1)


def multiplied(first: FloatArray, second: FloatArray) -> FloatArray:
    """The quaternions (n, 4) of turning by the second, then by the first."""
    known = _is_rotation(second)
    found = np.zeros_like(second)
    if known.any():
        found[known] = (Rotation.from_quat(first[known]) * Rotation.from_quat(second[known])).as_quat()
    return found


def spread_of(covariance: FloatArray, turn: FloatArray | None = None) -> tuple[FloatArray, FloatArray]:
    """Position and yaw spread on the ground plane by covariances of poses.

    Parameters
    ----------
    covariance : (n, 36)
    turn : (n, 3, 3) rotations into the frame whose plane is meant

    Returns
    -------
    position_std : (n,) metres of each axis, as if both were alike: the root of the mean of both variances
    yaw_variance : (n,) rad²

    NaN where they are not positive: ROS says by zeros, or by −1, that they are unknown.
    """
    covariance = np.asarray(covariance, dtype=float).reshape(-1, 6, 6)
    places, turns = covariance[:, :3, :3], covariance[:, 3:, 3:]
    if turn is not None:
        places, turns = (turn @ one @ turn.transpose(0, 2, 1) for one in (places, turns))
    variance = (places[:, 0, 0] + places[:, 1, 1]) / 2.0
    both = (covariance[:, 0, 0] > 0.0) & (covariance[:, 1, 1] > 0.0)
    with np.errstate(invalid="ignore"):
        std = np.where(both & (variance > 0.0), np.sqrt(variance), np.nan)
        return std, np.where((covariance[:, 5, 5] > 0.0) & (turns[:, 2, 2] > 0.0), turns[:, 2, 2], np.nan)


def kappa_of(variance: FloatArray) -> FloatArray:
    """von Mises concentrations (n,) of variances in rad², NaN where unknown."""
    with np.errstate(divide="ignore"):
        return np.minimum(1.0 / np.asarray(variance, dtype=float), LARGEST_CONCENTRATION)


def variance_of(kappa: FloatArray) -> FloatArray:
    """Variances (n,), rad², of von Mises concentrations; NaN where unknown or where nothing is said (0)."""
    kappa = np.asarray(kappa, dtype=float)
    with np.errstate(divide="ignore"):
        return np.where(kappa > 0.0, 1.0 / kappa, np.nan)
