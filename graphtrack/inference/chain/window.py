"""The fixed-lag smoother on the compiled chain: as `FixedLag` with GTSAM, in a fraction of the time."""

from __future__ import annotations

import math
import threading
import weakref
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import lru_cache
from typing import Any

import numpy as np

from graphtrack.geometry.angles import FloatArray
from graphtrack.inference.chain.window_kernels import (
    AS_SET,
    NOTHING,
    PREDICTED,
    TASK,
    Advanced,
    WindowRules,
    Windows,
    advance,
    window_problem,
)
from graphtrack.inference.state import (
    FAILURES,
    NOT_DETERMINED,
    Angles,
    MarginalPrior,
    Newest,
    Window,
    leaving,
)
from graphtrack.kernels.compilation import processors
from graphtrack.kernels.layout import N, Problem
from graphtrack.model import Model, Observation, Step
from graphtrack.model.generator import FrameProgram, program_of
from graphtrack.model.observation import OWN
from graphtrack.model.packing import PackedTracks, number_rows, place_in_row
from graphtrack.model.term import FramePacker

_FACTORISATION = ("inverse", "link", "trigonometry", "message", "factored")
"""Arrays of the last solution that the next observation reads; a row for each frame."""
_OF_FRAMES = ("body_heights", "head_heights", "states", *_FACTORISATION)
_OF_WINDOW = ("shared", "origin", "prior")
"""The arrays of a slot that move with a window: those with a row for each frame, its records left out, and
others."""

SLOTS = 128  # Windows per block
_LEAST_FRAMES = 64


class Slot:
    """The arrays of one window of a block, by their names in `Windows`."""

    def __init__(self, windows: Windows, number: int) -> None:
        self.windows, self.number = windows, number

    def __getattr__(self, name: str) -> Any:
        return getattr(self.windows, name)[self.number]


class Pool:
    """Blocks for the windows of a program, as many as are needed."""

    def __init__(self, program: FrameProgram) -> None:
        self._program, self._mutex = program, threading.RLock()
        self.blocks: dict[int, tuple[Windows, list[int]]] = {}  # with the indices of their free slots

    def slot(self, size: int) -> Slot:
        """A slot with room for a number of frames, freed as garbage. Arrays are not cleared."""
        with self._mutex:
            for windows, free in self.blocks.values():
                if free and windows.states.shape[1] == size:
                    break
            else:
                windows, free = Windows.empty(self._program, size, SLOTS), list(range(SLOTS - 1, -1, -1))
                self.blocks[id(windows)] = windows, free
            slot = Slot(windows, free.pop())
        weakref.finalize(slot, self._take_back, id(windows), slot.number).atexit = False
        return slot

    def _take_back(self, block: int, number: int) -> None:
        with self._mutex:
            free = self.blocks[block][1]
            free.append(number)
            if len(free) == SLOTS:
                del self.blocks[block]


@lru_cache(16)
def pool_of(program: FrameProgram) -> Pool:
    """One for all windows of a process."""
    return Pool(program)


class FrameRows:
    """The frames of one person in the arrays of a problem.

    Attributes
    ----------
    problem : the arrays, once they are made
    rows : its records as rows of numbers: writing to their fields is slow
    place : field of a record → its index in such a row
    """

    problem: Problem
    rows: FloatArray

    def __init__(self, model: Model) -> None:
        self._program, self._packer = program_of(model), packer_of(model)
        record = self._program.types.frame
        self.place = {name: place_in_row(name, record) for name in record.names or ()}
        # Place of a field, place of its parameter in `OwnParameters`, the model's value, and the power.
        self._scaled = [
            (self.place[name], OWN.index(parameter), model.parameters.value(parameter), power)
            for term in model.terms
            for name, parameter, power in term.scaled
        ]

    def make(self, n: int, origin: FloatArray, prior: FloatArray) -> None:
        """Make arrays for n frames; the other arguments are those of `Problem`, without the first axis."""
        problem = window_problem(Windows.empty(self._program, n, 1), 0)
        problem.origin[0], problem.offsets[1], problem.prior[:] = origin, n, prior
        self.take(problem)

    def take(self, problem: Problem) -> None:
        """Use existing arrays."""
        self.problem = problem
        self.rows = number_rows(problem.records)
        problem.shared[:] = self._packer(Observation(0.0, position=(0.0, 0.0)), None, True, None).shared

    def put(self, row: int, step: Step) -> PackedTracks:
        """Write a step into a row; return the packed frame."""
        observation, record, problem = step.observation, self.rows[row], self.problem
        packed = self._packer(observation, step.dt, step.starts, step.camera)
        record[:] = packed.numbers
        if step.camera is not None:
            problem.shared[:] = packed.shared  # the camera is part of it
        record[self.place["dt"]] = 0.0 if step.dt is None else step.dt
        for name, value in self._packer.live(observation):
            record[self.place[name]] = value
        if step.own is not None:
            for place, which, value, power in self._scaled:
                record[place] *= (step.own[which] / value) ** power
        if step.is_ambiguous:
            body, head = packed.body_heights, packed.head_heights
            problem.body_heights[row : row + len(body)] = body
            problem.head_heights[row : row + len(head)] = head
        return packed


@lru_cache(16)
def packer_of(model: Model) -> FramePacker:
    """One object for all people tracked with a model, so that packed frames are shared."""
    return FramePacker(model.compiled_terms, program_of(model).types)


class ChainWindow:
    """A fixed-lag smoother of one person by compiled Newton steps.

    The frames of the window are rows of arrays that kernels read in place, alongside other windows. Frames
    that leave the window are marginalised with their exact curvature. A method that raises changes nothing.

    Parameters
    ----------
    model : a chain (see `chain.batch.is_chain`)
    lag : length of the window in seconds, back from its newest step
    tolerance : of the predicted decrease of the cost by the next Newton step, relative to 1 + the cost
    max_iterations : most Newton steps for an observation
    """

    def __init__(self, model: Model, lag: float, tolerance: float, max_iterations: int) -> None:
        self._model, self._lag = model, lag
        self._program = program_of(model)
        self._rules = _rules_of(model, tolerance, max_iterations)
        self._frames = FrameRows(model)
        self._anchor: Angles | None = None
        self._steps: list[Step] = []
        self._has_prior = False
        # True if an observation can have several modes: then other basins are searched.
        self._ambiguous = model.parameters.likelihood.has_outliers
        self._warm = False
        self._take_slot(_LEAST_FRAMES)

    @property
    def steps(self) -> Sequence[Step]:
        """The steps of the window, oldest first."""
        return self._steps

    def states(self, last: int | None = None) -> FloatArray:
        """States (n, 6) of the window's steps, or of its last ones; NaN for variables outside the model."""
        begin, end = self._offsets.tolist()
        states = self._states[begin if last is None else end - last : end].copy()
        states[:, :2] += self._origin
        outside = [False] * 4 + [not self._model.has_body, not self._model.has_head]
        states[:, outside] = math.nan
        return states

    def extend(self, step: Step, state: Sequence[float]) -> Newest:
        """Add a step whose variables start at ``state``; return its estimate."""
        begins = not self._steps
        if begins:
            self._origin[:] = state[:2]
        self._put_next(step)
        self._set(self._offsets[1], state)
        newest = self._solved(AS_SET, step)
        if begins:
            self._anchor = (state[4], state[5])
        return newest

    def rework(self, window: Window) -> Newest:
        """Replace the window by a changed one; return the estimate of its newest step."""
        before = self.window()
        try:
            self.restore(window)
            return self._solved(NOTHING, self._steps[-1])
        except BaseException:
            self.restore(before)
            raise

    def restore(self, window: Window) -> None:
        """Replace the window without solving it."""
        self._take(window, window.states[0, :2].copy() if window.steps else np.zeros(2))

    def arrays(self) -> dict[str, FloatArray]:
        """The arrays that reproduce the next estimates exactly, in addition to the window; see `resume`."""
        open_frames = slice(*self._offsets.tolist())
        kept = {"origin": self._origin, "states": self._states[open_frames], "prior": self._prior}
        if self._warm:
            kept |= {name: getattr(self._slot, name)[open_frames] for name in _FACTORISATION}
        found = {name: values.copy() for name, values in kept.items()}
        if self._warm:
            # The newest frame has no link yet: an earlier window may have left one there.
            found["link"][-1:] = 0.0
        return found

    def resume(self, window: Window, arrays: Mapping[str, FloatArray]) -> None:
        """Continue from `window` and `arrays`; KeyError or ValueError if these do not fit."""
        n = len(window.steps)
        self._take(window, arrays["origin"])
        self._states[:n] = arrays["states"].reshape(n, N)
        self._prior[:] = arrays["prior"].reshape(N + 2, N)
        self._warm = "message" in arrays
        if self._warm:
            for name in _FACTORISATION:
                rows = getattr(self._slot, name)
                rows[:n] = arrays[name].reshape(n, *rows.shape[1:])

    def _take(self, window: Window, origin: FloatArray) -> None:
        prior = np.zeros((N + 2, N)) if window.prior is None else window.prior.rows(origin)
        n, size = len(window.steps), _size_for(len(window.steps))
        if size == len(self._states):
            self._clear()
        else:
            self._take_slot(size)
        self._origin[:], self._prior[:] = origin, prior
        self._has_prior, self._anchor = window.prior is not None, window.anchor
        for k, step in enumerate(window.steps):
            self._put(k, step, k > 0)
        self._offsets[1], self._steps = n, [step.alone() for step in window.steps]
        states = self._states[:n]
        states[:] = np.nan_to_num(window.states)
        states[:, :2] -= origin
        # Angles are unwrapped to follow the prior and the previous step.
        point = self._prior[N + 1 :, 4:] if self._has_prior else states[:1, 4:]
        turns = np.round(np.diff(states[:, 4:], axis=0, prepend=point) / (2.0 * np.pi))
        states[:, 4:] -= 2.0 * np.pi * np.cumsum(turns, axis=0)

    def window(self) -> Window:
        """The window from which another smoother can resume."""
        steps = tuple(self._steps)
        prior = None
        if steps and self._has_prior:
            there = self._prior.copy()
            there[N + 1, :2] += self._origin
            prior = MarginalPrior(there[:N], there[N], there[N + 1])
        return Window(steps, self.states(), prior, self._anchor)

    # -- arrays --------------------------------------------------------------------------------------------

    def _take_slot(self, size: int) -> None:
        """Take a cleared slot with room for a number of frames."""
        self._slot = pool_of(self._program).slot(size)
        self._states, self._offsets = self._slot.states, self._slot.offsets
        self._prior, self._origin = self._slot.prior, self._slot.origin[0]
        self._clear()
        # Records as rows of numbers: as records they would be copied field by field.
        self._of_frames = [self._frames.rows, *(getattr(self._slot, name) for name in _OF_FRAMES)]

    def _clear(self) -> None:
        slot = self._slot
        self._frames.take(window_problem(slot.windows, slot.number))
        slot.offsets[:], slot.prior[:], slot.origin[:] = 0, 0.0, 0.0
        self._warm = False

    def _make_room(self) -> None:
        """Move the window to the front of its arrays, or into larger arrays."""
        begin, end = self._offsets.tolist()
        old, rows, n, warm = self._slot, self._of_frames, end - begin, self._warm
        size = _size_for(n)
        if size > len(self._states):
            self._take_slot(size)
            for name in _OF_WINDOW:
                getattr(self._slot, name)[:] = getattr(old, name)
        for new, previous in zip(self._of_frames, rows, strict=True):
            new[:n] = previous[begin:end]
        self._warm = warm
        self._offsets[:] = 0, n

    def _set(self, row: int, state: Sequence[float]) -> None:
        self._states[row] = np.nan_to_num(state)
        self._states[row, :2] -= self._origin

    def _put_next(self, step: Step) -> None:
        """Write a step into the row after the newest."""
        if self._offsets[1] == len(self._states):
            self._make_room()
        self._put(self._offsets.item(1), step, bool(self._steps))

    def _put(self, row: int, step: Step, linked: bool) -> None:
        """Write a step into a row of the arrays; ``linked`` if it has a previous step in the window."""
        packed = self._frames.put(row, step)
        if not linked:
            for name in self._program.links:
                self._frames.rows[row, self._frames.place[name]] = 0.0
        if step.is_ambiguous:
            self._ambiguous |= bool(len(packed.body_heights) + len(packed.head_heights))

    def _solved(self, adds: int, step: Step) -> Newest:
        """Solve the window, with a further step or unchanged; return the newest estimate."""
        (found,) = _taken([self], adds, [step], *_advanced([self], adds, [step]))
        if isinstance(found, Exception):
            raise found
        return found


def extend_together(
    windows: Sequence[ChainWindow], steps: Sequence[Step], threads: ThreadPoolExecutor | None = None
) -> list[Newest | Exception]:
    """Add a step, not the first, to each of some windows, in ``threads``; return the states or the errors."""
    found: list[Newest | Exception | None] = [None] * len(windows)
    groups: dict[tuple[int, int, int], list[int]] = {}
    parts = 1 if threads is None else processors()
    for k, (window, step) in enumerate(zip(windows, steps, strict=True)):
        try:
            window._put_next(step)
        except FAILURES as error:
            found[k] = error
        else:
            groups.setdefault((id(window._slot.windows), id(window._rules), k % parts), []).append(k)
    jobs = [([windows[k] for k in group], PREDICTED, [steps[k] for k in group]) for group in groups.values()]
    calls = [threads.submit(_advanced, *job) if threads and n % parts else None for n, job in enumerate(jobs)]
    for group, job, call in zip(groups.values(), jobs, calls, strict=True):
        for k, newest in zip(group, _taken(*job, *(call.result() if call else _advanced(*job))), strict=True):
            found[k] = newest
    return found  # type: ignore[return-value]  # all are filled


def _taken(
    windows: Sequence[ChainWindow], adds: int, steps: Sequence[Step], advanced: Advanced, leave: list[int]
) -> list[Newest | Exception]:
    """Take the results of `_advanced` for some windows; return the newest states or the errors."""
    found: list[Newest | Exception] = []
    fine = advanced.fine.tolist()
    for k, (window, step) in enumerate(zip(windows, steps, strict=True)):
        window._warm = fine[k]
        if not fine[k]:
            found.append(ArithmeticError(NOT_DETERMINED))
            continue
        if adds:
            window._steps.append(step.alone())
        if leave[k]:
            del window._steps[: leave[k]]
            window._has_prior = True
        found.append((advanced.state[k], advanced.covariance[k]))
    return found


def _advanced(windows: Sequence[ChainWindow], adds: int, steps: Sequence[Step]) -> tuple[Advanced, list[int]]:
    """The compiled call; its results, and the number of steps that leave each window."""
    first, n = windows[0], len(windows)
    leave = [leaving(one._steps, one._lag, step) for one, step in zip(windows, steps, strict=True)]
    tasks = [
        (one._slot.number, adds, one._warm, one._ambiguous, gone)
        for one, gone in zip(windows, leave, strict=True)
    ]
    found = Advanced(np.zeros(n, bool), np.empty((n, N)), np.empty((n, N, N)))
    advance(first._slot.windows, np.array(tasks, TASK), first._rules, found)
    return found, leave


def _size_for(frames: int) -> int:
    """Rows for a window of a number of frames, so that it is rarely moved to their front."""
    size = _LEAST_FRAMES
    while 8 * frames > 7 * size:
        size *= 2
    return size


@lru_cache(64)
def _rules_of(model: Model, tolerance: float, max_iterations: int) -> WindowRules:
    """The same object for equal parameters, so that windows that share it can be solved together."""
    return WindowRules(model.has_body, model.has_head, max_iterations, tolerance)
