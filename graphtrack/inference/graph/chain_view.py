"""Compiled kernels applied to GTSAM's states: other basins, and coupling modes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from graphtrack.geometry.angles import FloatArray
from graphtrack.inference.chain.basin_search import admit_rejected, find_other_basin, unwind
from graphtrack.inference.chain.covariance import spread_track
from graphtrack.inference.chain.newton import Workspace, leave_saddle, workspace
from graphtrack.inference.chain.window import FrameRows, gait_of_model
from graphtrack.inference.state import MarginalPrior
from graphtrack.kernels.layout import Chain, N
from graphtrack.model import Model, Step
from graphtrack.model.coupling_modes import (
    add_glance_variance,
    classified_in,
    mode_memory,
    renew_couplings,
    report_modes,
)
from graphtrack.model.factors import couplings_of
from graphtrack.model.generator import program_of
from graphtrack.model.terms.couplings import ROW


class ChainView:
    """Steps of a track packed for the kernels. User-defined terms without a kernel are ignored.

    Parameters
    ----------
    model : with its compiled terms
    couplings : index of a step → values that its factors read; None for a model without modes

    Attributes
    ----------
    modes : (n, 3) as in `chain.newton.Result`; NaN until `renew`
    before : (2, ROW) probabilities of both couplings' modes in the previous frame
    """

    def __init__(self, model: Model, couplings: dict[int, Sequence[float]] | None = None) -> None:
        self._model, self._program, self._frames = model, program_of(model), FrameRows(model)
        self.couplings = {} if couplings is None else couplings
        self.before = np.zeros((2, ROW))
        self._steps: Sequence[Step] = ()
        self._filtered = np.empty((2, 0, ROW))

    def follow(
        self, steps: Sequence[Step], states: FloatArray, prior: MarginalPrior | None, complete: bool = False
    ) -> None:
        """Take steps with states (n, 6), and the data of the first; ``complete``: all of a track."""
        n, known = len(steps), [step.index for step in self._steps]
        gone = known.index(steps[0].index) if steps[0].index in known else len(known)
        if 0 < gone <= len(self._filtered[0]):
            self.before = self._filtered[:, gone - 1].copy()
        origin = states[0, :2].copy()
        self._frames.make(n, origin, np.zeros((N + 2, N)) if prior is None else prior.rows(origin))
        for row, step in enumerate(steps):
            self._frames.put(row, step)
        for name in self._program.links:
            # They are part of the prior, or link to steps outside the window.
            self._frames.rows[0, self._frames.place[name]] = 0.0
        self._steps, self._complete = steps, complete
        self._problem = self._frames.problem
        self._chain = Chain(self._problem, 0, n, float(n))
        self.modes, self._spread, self._held = np.full((n, 3), np.nan), np.zeros((n, 2)), np.zeros((n, 4))
        self._filtered = np.empty((2, 0, ROW))

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

    def renew(self, states: FloatArray) -> None:
        """Set the couplings by the modes given the states (n, 6)."""
        gait = gait_of_model(self._model)
        here, n = self._here(states), len(states)
        memory = mode_memory(n)
        memory.before[:] = self.before
        _, classified = classified_in(self._problem, 0)
        renew_couplings(self._chain, here, gait, classified, True, memory)
        report_modes(n, 0, memory.held, self.modes)
        filtered = np.stack([memory.filtered_body, memory.filtered_head])
        self._spread, self._held = memory.spread, memory.held
        self._filtered = filtered / filtered.sum(axis=2, keepdims=True)
        self._note()

    def widen(self, states: FloatArray, covariance: FloatArray) -> None:
        """Add the uncertainty of the modes to covariances (n, 6, 6) at states (n, 6), in place."""
        memory = workspace(len(states))
        here = self._here(states)
        spread_track(self._chain, here, self._spread, memory, covariance)
        add_glance_variance(len(here), self._held, gait_of_model(self._model), covariance)

    def _note(self) -> None:
        rows = couplings_of(self._problem.records[: len(self._steps)])
        # Links of the first step to the previous one are cut here, and may not be in the graph.
        first = 0 if self._complete else 1
        for step, row in zip(self._steps[first:], rows[first:], strict=True):
            self.couplings[step.index] = row
        self.couplings.setdefault(self._steps[0].index, rows[0])

    def decouple(self) -> None:
        """Switch off the couplings, and the steering by the head."""
        for gate in self._program.switched:
            self._problem.records[gate] = 0.0
        self._note()

    def _here(self, states: FloatArray) -> FloatArray:
        """The states for the kernels: relative to the track's origin, and 0 outside the model."""
        here = np.nan_to_num(states)
        here[:, :2] -= self._problem.origin[0]
        return here
