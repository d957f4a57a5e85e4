"""Calibrated covariances of estimates, for frames one by one or whole tracks."""

from __future__ import annotations

import numpy as np

from graphtrack.inference.chain.covariance import calibrate_tracks, calibration_of
from graphtrack.model import Parameters


def seconds_to_ends(t: np.ndarray) -> np.ndarray:
    """Seconds (n,) from the frames of a track at the times (n,) to its nearer end."""
    return np.asarray(np.minimum(t - t[0], t[-1] - t))


def calibrated(
    covariance: np.ndarray, velocity: np.ndarray, parameters: Parameters, ends: np.ndarray | float = 0.0
) -> np.ndarray:
    """Covariances (..., 6, 6), the inverse curvature, as estimates report them; ``velocity`` is (..., 2).

    ``ends`` (...): seconds to the nearer end of the track.
    """
    # Each is the middle one of three frames.
    blocks = np.array(covariance, float).reshape(-1, 6, 6).repeat(3, axis=0)
    states, offsets = np.zeros((len(blocks), 6)), np.arange(0, len(blocks) + 1, 3)
    states[:, 2:4] = np.reshape(velocity, (-1, 2)).repeat(3, axis=0)
    t = np.broadcast_to(np.asarray(ends, float), len(blocks) // 3)[:, None] * [-1.0, 0.0, 1.0]
    calibrate_tracks(blocks, states, offsets, t.ravel(), calibration_of(parameters))
    return blocks[1::3].reshape(covariance.shape)
