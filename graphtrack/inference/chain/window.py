"""The fixed lag on the compiled chain: what `FixedLag` does with GTSAM, in a fraction of the time."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from graphtrack.geometry.angles import FloatArray
from graphtrack.inference.chain.elimination import workspace
from graphtrack.inference.chain.frame_rows import FrameRows
from graphtrack.inference.chain.programs import program_of
from graphtrack.inference.chain.window_modes import WindowModes
from graphtrack.inference.prior import MarginalPrior, StatePrior, on_state, on_variables
from graphtrack.inference.solution import stated_newest
from graphtrack.inference.state import Angles, Newest, Window
from graphtrack.model import Model, Step
from graphtrack.model.kernels.layout import BODY, HEAD, N
from graphtrack.model.terms.gait import gait_of

_FACTORISATION = ("inverse", "link", "trigonometry")
"""The rows of the workspace that the next observation reads; all others are written before they are read."""


class ChainWindow:
    """A fixed-lag smoother of one person by compiled Newton steps.

    The frames of the window stand one after another in arrays that the kernels read in place. What leaves the
    window is eliminated with its exact curvature, and what it says about the next frame stays as a Gaussian.
    Time and memory are bounded by the window. Whatever a method raises, it leaves the smoother as it was.

    Parameters
    ----------
    model : a chain (see `chain.engine.is_chain`)
    lag : seconds that the window reaches back from its newest step
    tolerance : the Newton steps of an observation end when the next one promises a smaller decrease of the
        cost, relative to 1 + the cost
    max_iterations : or after so many
    show_coupled : `coupled` is kept, which takes some time

    Attributes
    ----------
    coupled : the packed frames of the last solution, with what the modes of the couplings set; None without,
        or where it is not to be shown
    spread : (6, 6) what the modes of the couplings leave open in the newest frame; part of its covariance
    """

    def __init__(
        self, model: Model, lag: float, tolerance: float, max_iterations: int, *, show_coupled: bool = False
    ) -> None:
        self._model, self._lag = model, lag
        self._tolerance, self._max_iterations = tolerance, max_iterations
        self._program = program_of(model)
        self._frames = FrameRows(model)
        self._anchor: Angles | None = None
        self._steps: list[Step] = []
        self._has_prior = False
        self._show_coupled = show_coupled
        self.coupled: np.ndarray | None = None
        # Whether what was seen may speak for several directions: then other basins are searched.
        self._ambiguous = model.parameters.likelihood.outlier_probability > 0.0
        self._origin = np.zeros(2)
        self._covariance, self.spread = np.empty((N, N)), np.zeros((N, N))
        self._modes = WindowModes(gait_of(model.parameters.gait)) if model.has_modes else None
        self._allocate(64)

    @property
    def steps(self) -> Sequence[Step]:
        """The steps of the window, oldest first."""
        return self._steps

    def state(self, step: Step) -> tuple[float, ...]:
        """x, y, vx, vy, body, head of a step of the window; NaN for what the model does not have."""
        # The newest step is asked for at every observation.
        back = 1 if step is self._steps[-1] else len(self._steps) - self._index(step)
        return self._read(self._offsets[1] - back)

    @property
    def modes(self) -> tuple[float, float]:
        """Probability of an aligned body, and its offset from the motion, in the newest frame; or NaN."""
        return (float("nan"), float("nan")) if self._modes is None else self._modes.newest

    @property
    def modes_before(self) -> FloatArray | None:
        """Probabilities of both couplings' modes in the frame before the window; None without modes."""
        return None if self._modes is None else self._modes.before

    def extend(self, step: Step, state: Sequence[float]) -> Newest:
        """Add a step whose variables start at ``state``; what is known about it then."""
        if not self._steps:
            self._anchor = (state[4], state[5])
            self._origin[:] = state[:2]
        if self._offsets[1] == len(self._states):
            self._make_room()
        begin, end = self._offsets.tolist()
        before = self._states[begin:end].copy()
        self._put(end, step, state, bool(self._steps))
        self._offsets[1] = end + 1
        if not self._solve():
            self._offsets[1] = end
            self._states[begin:end] = before
            if not self._steps:
                self._anchor = None
            raise ArithmeticError("the estimate is not finite")
        self._steps.append(step.alone())
        newest = self._newest()
        self._slide()
        return newest

    def rework(self, window: Window) -> Newest:
        """Take over a window that was changed; what is known about its newest step then."""
        before = self.window()
        try:
            self.restore(window)
            if not self._solve():
                raise ArithmeticError("the estimate is not finite")
        except BaseException:
            self.restore(before)
            raise
        newest = self._newest()
        self._slide()
        return newest

    def restore(self, window: Window) -> None:
        """Take over a window as it stands."""
        origin = window.values[window.steps[0].index][:2] if window.steps else (0.0, 0.0)
        self._take(window, np.array(origin))

    def arrays(self) -> dict[str, FloatArray]:
        """What makes the next estimates the same to the last bit, beside the window; see `resume`."""
        open_frames = slice(*self._offsets.tolist())
        kept = {"origin": self._origin, "states": self._states[open_frames], "prior": self._prior}
        if self._warm:
            kept |= {name: getattr(self._memory, name)[open_frames] for name in _FACTORISATION}
            kept["newest"] = self._memory.newest
        if self._modes is not None and self._modes.classified:
            kept["classified"] = np.ones(1)
        return {name: values.copy() for name, values in kept.items()}

    def resume(self, window: Window, arrays: Mapping[str, FloatArray]) -> None:
        """Go on where `window` and `arrays` were taken, as if nothing had happened.

        Raises
        ------
        KeyError, ValueError
            If the arrays do not fit the window.
        """
        n = len(window.steps)
        self._take(window, arrays["origin"])
        self._states[:n] = arrays["states"].reshape(n, N)
        self._prior[:] = arrays["prior"].reshape(N + 2, N)
        self._warm = "newest" in arrays
        if self._modes is not None:
            self._modes.classified = "classified" in arrays
        if self._warm:
            self._memory.newest[:] = arrays["newest"].reshape(N, N)
            for name in _FACTORISATION:
                rows = getattr(self._memory, name)
                rows[:n] = arrays[name].reshape(n, *rows.shape[1:])

    def _take(self, window: Window, origin: FloatArray) -> None:
        prior = np.zeros((N + 2, N))
        if window.prior is not None:
            prior = self._from_prior(window.prior, window.steps[0], origin)
        self._allocate(max(64, 2 * len(window.steps)))
        self._origin[:] = origin
        self._prior[:] = prior
        self._has_prior, self._anchor = window.prior is not None, window.anchor
        if self._modes is not None and window.modes is not None:
            self._modes.before = np.array(window.modes)
        for k, step in enumerate(window.steps):
            self._put(k, step, window.values[step.index], k > 0)
        self._offsets[1] = len(window.steps)
        self._steps = [step.alone() for step in window.steps]
        for k in range(1, len(window.steps)):
            # Angles go on from the step before, whatever turn they were written in.
            turn = self._states[k, 4:] - self._states[k - 1, 4:]
            self._states[k, 4:] -= 2.0 * np.pi * np.round(turn / (2.0 * np.pi))
        if window.prior is not None and window.steps:
            turn = self._states[0, 4:] - self._prior[N + 1, 4:]
            self._states[: len(window.steps), 4:] -= 2.0 * np.pi * np.round(turn / (2.0 * np.pi))
        if window.steps:
            self._renew()

    def window(self) -> Window:
        """What another smoother needs to go on from here."""
        steps = tuple(self._steps)
        values = {step.index: self._read(self._offsets[0] + k) for k, step in enumerate(steps)}
        prior = self._to_prior(steps[0]) if steps and self._has_prior else None
        modes = None if self._modes is None else self._modes.before.copy()
        return Window(steps, values, prior, self._anchor, modes)

    # -- arrays --------------------------------------------------------------------------------------------

    def _allocate(self, n: int) -> None:
        self._states = np.zeros((n, N))
        self._offsets = np.zeros(2, np.int64)
        self._prior = np.zeros((N + 2, N))
        self._memory, self._warm = workspace(n), False
        self._frames.make(n, self._origin, self._offsets, self._prior)
        self._problem = self._frames.problem

    def _make_room(self) -> None:
        """Move the window to the front of the arrays, or into larger ones."""
        begin, end = self._offsets.tolist()
        n, warm, prior, shared = end - begin, self._warm, self._prior, self._problem.shared
        old, memory = self._rows_of_frames(), self._memory
        if 2 * n > len(self._states):
            self._allocate(2 * len(self._states))
            self._prior[:], self._problem.shared[:], self._memory.newest[:] = prior, shared, memory.newest
        for new, previous in zip(self._rows_of_frames(), old, strict=True):
            new[:n] = previous[begin:end].copy()
        self._warm = warm
        self._offsets[:] = 0, n

    def _rows_of_frames(self) -> list[np.ndarray]:
        """The arrays that have a row for each frame, and must move with it."""
        problem, factors = self._problem, [getattr(self._memory, name) for name in _FACTORISATION]
        return [self._states, problem.records, problem.body_heights, problem.head_heights, *factors]

    def _read(self, row: int) -> tuple[float, ...]:
        x, y, vx, vy, body, head = self._states[row].tolist()
        left, bottom = self._origin.tolist()
        body = body if self._model.has_body else math.nan
        return x + left, y + bottom, vx, vy, body, head if self._model.has_head else math.nan

    def _put(self, row: int, step: Step, state: Sequence[float], linked: bool) -> None:
        """Write a step into a row of the arrays; ``linked`` if there is one before it in the window."""
        packed = self._frames.put(row, step)
        if not linked:
            for name in self._program.links:
                self._frames.rows[row, self._frames.place[name]] = 0.0
        self._ambiguous = self._ambiguous or bool(len(packed.body_heights) + len(packed.head_heights))
        left, bottom = self._origin.tolist()
        x, y, vx, vy, body, head = state
        known = (body if math.isfinite(body) else 0.0, head if math.isfinite(head) else 0.0)
        self._states[row] = (x - left, y - bottom, vx, vy, *known)

    # -- solving -------------------------------------------------------------------------------------------

    def _solve(self) -> bool:
        self._renew()
        self._warm = self._program.solve_window(
            self._problem,
            self._states,
            self._warm,
            self._ambiguous,
            self._max_iterations,
            self._tolerance,
            self._memory,
            self._covariance,
        )
        if self._warm and self._modes is not None:
            self.spread[:] = 0.0
            self._program.spread_newest(
                self._problem, self._states, self._modes.spread, self._memory, self.spread
            )
        return self._warm

    def _renew(self) -> None:
        """Set the couplings by the modes that the states imply."""
        if self._modes is not None:
            self._modes.renew(self._problem, self._states)
        if self._modes is not None and self._show_coupled:
            # What slides out of the window is cut from it.
            self.coupled = self._problem.records[slice(*self._offsets.tolist())].copy()

    def _newest(self) -> Newest:
        covariance = self._covariance + self.spread
        for has, place in ((self._model.has_body, BODY), (self._model.has_head, HEAD)):
            if not has:
                covariance[place] = covariance[:, place] = np.nan
        return np.array(self._read(int(self._offsets[1]) - 1)), stated_newest(
            covariance, self._model.parameters
        )

    def _slide(self) -> None:
        horizon = self._steps[-1].observation.t - self._lag
        while self._steps[0].observation.t < horizon:
            self._program.let_go(self._problem, self._states, self._memory)
            if self._modes is not None:
                self._modes.let_go()
            self._has_prior = True
            del self._steps[0]

    # -- priors --------------------------------------------------------------------------------------------

    def _index(self, step: Step) -> int:
        return next(k for k, known in enumerate(self._steps) if known.index == step.index)

    def _to_prior(self, step: Step) -> MarginalPrior:
        point = self._prior[N + 1].copy()
        point[:2] += self._origin
        return on_variables(StatePrior(self._prior[:N], self._prior[N], point), step, self._model)

    def _from_prior(self, prior: MarginalPrior, step: Step, origin: FloatArray) -> FloatArray:
        information, linear, point = on_state(prior, step, self._model)
        point[:2] -= origin
        return np.vstack([information, linear, point])
