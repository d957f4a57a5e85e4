"""What the compiled windows of many people are given, and what they tell."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from graphtrack.geometry.angles import FloatArray
from graphtrack.inference.chain.calibration import Calibration, calibration_of
from graphtrack.model import Model
from graphtrack.model.kernels.layout import N

SLOT, ADDS, SOLVES, WARM, SEARCHES, LEAVE = range(6)
"""Columns of what is to be done with each window, as whole numbers: its slot; whether the frame after its
newest is added, and how it begins; whether it is solved, or only its couplings are set; whether the
factorisation of the last solution is there; whether other basins are searched; and how many frames then leave
it."""
NOTHING, AS_SET, PREDICTED = range(3)
"""What is added: nothing; a frame whose state stands in its row; or one that goes on from the last."""


class Rules(NamedTuple):
    """What is the same for all windows of a smoother's kind."""

    has_body: bool
    has_head: bool
    max_iterations: int
    tolerance: float
    calibration: Calibration


@lru_cache(64)
def rules_of(model: Model, tolerance: float, max_iterations: int) -> Rules:
    """The same for the same, so that windows that have it can be taken together."""
    calibration = calibration_of(model.parameters)
    return Rules(model.has_body, model.has_head, max_iterations, tolerance, calibration)


class Advanced(NamedTuple):
    """What is found: of P windows."""

    fine: NDArray[np.bool_]  # (P,) whether all went well; else the window is as it was
    state: FloatArray  # (P, 6) of the newest frame, in the world
    covariance: FloatArray  # (P, 6, 6) calibrated
    spread: FloatArray  # (P, 6, 6) what the modes of the couplings leave open, as part of it
    modes: FloatArray  # (P, 2) probability of an aligned body and its offset
    coupled: np.ndarray  # (n,) the records of a single window with their couplings; or none: nobody asks


def room_for(n: int, records: np.ndarray) -> Advanced:
    """For what will be found of n windows; ``records`` as in `Advanced`."""
    return Advanced(
        np.zeros(n, bool),
        np.empty((n, N)),
        np.empty((n, N, N)),
        np.zeros((n, N, N)),
        np.full((n, 2), math.nan),
        records,
    )


class Windows(NamedTuple):
    """The windows of S people, each of up to n frames; what each is, see `Problem` and `Workspace`."""

    records: np.ndarray  # (S, n)
    shared: np.ndarray  # (S, 1)
    body_heights: FloatArray  # (S, n, classes + 1)
    head_heights: FloatArray
    body_directions: FloatArray  # (classes, 2)
    head_directions: FloatArray
    origin: FloatArray  # (S, 1, 2)
    offsets: NDArray[np.int64]  # (S, 2) the rows of the window
    prior: FloatArray  # (S, 8, 6)
    states: FloatArray  # (S, n, 6)
    inverse: FloatArray  # (S, n, 6, 6)
    link: FloatArray  # (S, n, 6, 6)
    trigonometry: FloatArray  # (S, n, 4)
    message: FloatArray  # (S, n, 7, 6)
    factored: FloatArray  # (S, n, 6)
    modes_before: FloatArray  # (S, 2, ROW) both couplings' modes in the frame before the window
    classified: NDArray[np.bool_]  # (S, 1) whether class likelihoods of the head have been seen
