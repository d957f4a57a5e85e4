"""Modes of the couplings in the sliding window of the online chain engine."""

from __future__ import annotations

import numpy as np

from graphtrack.geometry.angles import FloatArray
from graphtrack.inference.chain.modes import is_classified, renew_couplings
from graphtrack.model.kernels.problem import Problem
from graphtrack.model.terms.gait import ROW, Gait


class WindowModes:
    """What the modes need beside the window: their probabilities in the frame that left it last.

    Parameters
    ----------
    gait : parameters of the modes

    Attributes
    ----------
    before : (2, ROW) probabilities of both couplings' modes in the frame before the window, given the past
    classified : whether class likelihoods of the head have been seen
    spread : (n, 2) what the modes of the couplings leave open in the frames of the window
    newest : probability that the body is aligned in the newest frame, and its offset from the motion, radians
    """

    def __init__(self, gait: Gait) -> None:
        self._gait = gait
        self._filtered = np.zeros((2, 0, ROW))
        self.before: FloatArray = np.zeros((2, ROW))
        self.classified = False
        self.spread: FloatArray = np.zeros((0, 2))
        self.newest = (float("nan"), float("nan"))

    def renew(self, problem: Problem, states: FloatArray) -> None:
        """Set the couplings of the frames ``problem.offsets`` by the modes that the states imply."""
        begin, end = problem.offsets
        self.classified = self.classified or is_classified(problem, 0)
        self._filtered, modes = np.empty((2, end - begin, ROW)), np.empty((end - begin, 2))
        self.spread = np.empty((end - begin, 2))
        renew_couplings(
            problem,
            0,
            states[begin:end],
            self._gait,
            self.classified,
            self.before,
            self._filtered,
            modes,
            self.spread,
        )
        self.newest = (float(modes[-1, 0]), float(modes[-1, 1]))

    def let_go(self) -> None:
        """The oldest frame leaves the window."""
        self.before, self._filtered = self._filtered[:, 0].copy(), self._filtered[:, 1:]
