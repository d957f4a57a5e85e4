"""What the compiled chain engine is given and gives: arrays of some tracks end to end."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from graphtrack.geometry.angles import FloatArray

N = 6
"""Degrees of freedom of a frame."""


class Problem(NamedTuple):
    """Some tracks end to end, as the kernels see them: N frames, m tracks."""

    records: np.ndarray  # (N,) of FRAME
    shared: np.ndarray  # (1,) of SHARED
    body_heights: FloatArray  # (N, classes + 1), or no rows without class likelihoods
    head_heights: FloatArray
    body_directions: FloatArray  # (classes, 2) cosines and sines of the centres
    head_directions: FloatArray
    origin: FloatArray  # (m, 2) metres, what a track's positions are counted from
    offsets: NDArray[np.int64]  # (m + 1,)
    prior: FloatArray  # (8, 6) on the first frame: rows Λ, then η and the point d = 0; no rows: there is none


class Result(NamedTuple):
    """What comes out: ``states`` also holds where to start."""

    states: FloatArray  # (N, 6); angles are not wrapped
    covariance: FloatArray  # (N, 6, 6)
    first_cost: FloatArray  # (m,)
    cost: FloatArray  # (m,)
    iterations: NDArray[np.int64]  # (m,)
    status: NDArray[np.int64]  # (m,) see CONVERGED
    modes: FloatArray  # (N, 2) probability of an aligned body, and its offset from the motion in radians
