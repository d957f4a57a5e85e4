"""Compiled kernels applied to GTSAM's states, to find other basins."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from graphtrack.geometry.angles import FloatArray
from graphtrack.inference.chain.basin_search import admit_rejected, find_other_basin, unwind
from graphtrack.inference.chain.newton import Workspace, leave_saddle, workspace
from graphtrack.inference.chain.window import FrameRows
from graphtrack.inference.state import MarginalPrior
from graphtrack.kernels.layout import Chain, N
from graphtrack.model import Model, Step
from graphtrack.model.generator import program_of


class ChainView:
    """Steps of a track packed for the kernels. User-defined terms without a kernel are ignored.

    Parameters
    ----------
    model : with its compiled terms
    """

    def __init__(self, model: Model) -> None:
        self._model, self._program, self._frames = model, program_of(model), FrameRows(model)

    def follow(self, steps: Sequence[Step], states: FloatArray, prior: MarginalPrior | None) -> None:
        """Take steps with states (n, 6), and the prior of the first."""
        n = len(steps)
        origin = states[0, :2].copy()
        self._frames.make(n, origin, np.zeros((N + 2, N)) if prior is None else prior.rows(origin))
        for row, step in enumerate(steps):
            self._frames.put(row, step)
        for name in self._program.links:
            # They are part of the prior, or link to steps outside the window.
            self._frames.rows[0, self._frames.place[name]] = 0.0
        self._problem = self._frames.problem
        self._chain = Chain(self._problem, 0, n, 0)

    def other(self, states: FloatArray, near: float) -> FloatArray | None:
        """States (n, 6) in a better basin of the grid, with the same motion; None without one."""
        if not (self._model.has_body or self._model.has_head):
            return None
        here = self._here(states)
        memory = workspace(len(here))
        memory.again[:] = here
        if admit_rejected(self._problem, 0, memory.again):
            return self._there(memory)
        found = find_other_basin(self._chain, here, near, memory)
        return self._there(memory) if found else self.unwound(states)

    def unwound(self, states: FloatArray) -> FloatArray | None:
        """States (n, 6) with slow turns of more than 180° reversed; None without any."""
        here = self._here(states)
        memory = workspace(len(here))
        return self._there(memory) if unwind(self._chain, here, 0.0, memory) else None

    def off_saddle(self, states: FloatArray) -> FloatArray | None:
        """States (n, 6) with turned orientations, from which a saddle is left; None at a minimum.

        Gauss–Newton curvature, as GTSAM has it, is positive at a saddle too.
        """
        here = self._here(states)
        memory = workspace(len(here))
        return self._there(memory) if leave_saddle(self._chain, here, memory) else None

    def _there(self, memory: Workspace) -> FloatArray:
        """The alternative states in the memory, in the world's frame."""
        again = memory.again
        again[:, :2] += self._problem.origin[0]
        return again

    def _here(self, states: FloatArray) -> FloatArray:
        """The states for the kernels: relative to the track's origin, and 0 outside the model."""
        here = np.nan_to_num(states)
        here[:, :2] -= self._problem.origin[0]
        return here
