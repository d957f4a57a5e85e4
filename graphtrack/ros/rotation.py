"""Orientations and spreads of ROS's poses, and what a ground plane keeps of them.

Quaternions are x, y, z, w; covariances are those of ROS's poses: row by row 6×6 of x, y, z (metres) and of
the rotations about the axes (radians).
"""

from __future__ import annotations

import numpy as np

from graphtrack.bounds import LARGEST_CONCENTRATION
from graphtrack.geometry.angles import FloatArray

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
    with np.errstate(all="ignore"):
        x, y, z, w = (quaternion / np.linalg.norm(quaternion, axis=1, keepdims=True)).T
        if axis == "x":
            along, across = 1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z)
        else:
            along, across = 2.0 * (x * z + w * y), 2.0 * (y * z - w * x)
        # A comparison with NaN is false.
        return np.where(np.hypot(along, across) > _STEEP, np.arctan2(across, along), np.nan)


def quaternion_of(yaw: FloatArray) -> FloatArray:
    """Quaternions (n, 4) of rotations about the vertical by (n,) radians; no rotation for NaN."""
    half = np.nan_to_num(np.asarray(yaw, dtype=float)) / 2.0
    none = np.zeros_like(half)
    return np.stack([none, none, np.sin(half), np.cos(half)], axis=-1)


def multiplied(first: FloatArray, second: FloatArray) -> FloatArray:
    """The quaternions (n, 4) of turning by the second, then by the first."""
    from scipy.spatial.transform import Rotation

    known = (np.linalg.norm(second, axis=1) > 0.0) & np.isfinite(second).all(axis=1)
    found = np.zeros_like(second)
    if known.any():
        found[known] = (Rotation.from_quat(first[known]) * Rotation.from_quat(second[known])).as_quat()
    return found


def spread_of(covariance: FloatArray, turn: FloatArray | None = None) -> tuple[FloatArray, FloatArray]:
    """What covariances of poses say of the ground plane.

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
