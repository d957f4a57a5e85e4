"""The frames of a recording, from those in which anybody was seen."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray


def usual_step(frames: NDArray[np.int64]) -> int:
    """The most frequent difference between frames (n,) that follow each other; 1 if there is but one."""
    steps, counts = np.unique(np.diff(frames), return_counts=True)
    return int(steps[counts.argmax()]) if len(steps) else 1


def with_those_between(frames: NDArray[np.int64], step: int | None = None) -> NDArray[np.int64]:
    """The frames (n,), increasing, and those between them in which nobody was seen, a step apart.

    Parameters
    ----------
    step : from a frame to the next one; None: the usual one
    """
    step = usual_step(frames) if step is None else step
    between = [np.arange(a, b, step) for a, b in pairwise(frames.tolist())]
    return np.unique(np.concatenate([frames, *between]))
