"""What the compiled chain engine is given: arrays of some tracks end to end."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from graphtrack.geometry.angles import FloatArray


class Problem(NamedTuple):
    """Some tracks end to end, as the kernels see them: N frames, m tracks."""

    records: np.ndarray  # (N,) of the program's FRAME
    shared: np.ndarray  # (1,) of its SHARED
    body_heights: FloatArray  # (N, classes + 1), or no rows without class likelihoods
    head_heights: FloatArray
    body_directions: FloatArray  # (classes, 2) cosines and sines of the centres
    head_directions: FloatArray
    origin: FloatArray  # (m, 2) metres, what a track's positions are counted from
    offsets: NDArray[np.int64]  # (m + 1,)
    prior: FloatArray  # (8, 6) on the first frame: rows Λ, then η and the point d = 0; no rows: there is none
