"""What the compiled chain engine gives."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from graphtrack.geometry.angles import FloatArray


class Result(NamedTuple):
    """What comes out: ``states`` also holds where to start."""

    states: FloatArray  # (N, 6); angles are not wrapped
    covariance: FloatArray  # (N, 6, 6)
    first_cost: FloatArray  # (m,)
    cost: FloatArray  # (m,)
    iterations: NDArray[np.int64]  # (m,)
    status: NDArray[np.int64]  # (m,) see CONVERGED
    modes: (
        FloatArray  # (N, 3) probability of an aligned body, its offset from the motion, and that of a glance
    )


CONVERGED, NOT_CONVERGED, NOT_FINITE = 0, 1, 2
"""How a descent ended."""
