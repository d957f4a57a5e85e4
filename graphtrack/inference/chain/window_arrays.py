"""Arrays of online windows, which the chain's kernels read in place.

The windows of many people are in common blocks, so that one compiled call takes an observation of each;
`FrameRows` writes steps into them one at a time.
"""

from __future__ import annotations

import threading
import weakref
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from graphtrack.geometry.angles import FloatArray, class_centres, unit
from graphtrack.inference.chain.newton import Workspace
from graphtrack.kernels.compilation import allocating
from graphtrack.kernels.layout import N, Problem, number_rows, place_in_row
from graphtrack.model import Model, Observation, Step
from graphtrack.model.generator import FrameProgram, program_of
from graphtrack.model.packing import FramePacker, PackedTracks
from graphtrack.model.terms.gait import ROW
from graphtrack.tracks.track import BODY_CLASSES, HEAD_CLASSES

SLOTS = 32  # Windows per block


class Windows(NamedTuple):
    """A block: the windows of S people, each of up to n frames. For the arrays see `Problem`, `Workspace`."""

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
    classified: NDArray[np.bool_]  # (S, 1) True once class likelihoods of the head were observed

    @classmethod
    def empty(cls, program: FrameProgram, size: int) -> Windows:
        """A block of windows of up to ``size`` frames."""
        frames = (SLOTS, size)
        return cls(
            np.zeros(frames, program.types.frame),
            np.zeros((SLOTS, 1), program.types.shared),
            np.zeros((*frames, BODY_CLASSES + 1)),
            np.zeros((*frames, HEAD_CLASSES + 1)),
            unit(class_centres(BODY_CLASSES)),
            unit(class_centres(HEAD_CLASSES)),
            np.zeros((SLOTS, 1, 2)),
            np.zeros((SLOTS, 2), np.int64),
            np.zeros((SLOTS, N + 2, N)),
            np.zeros((*frames, N)),
            np.zeros((*frames, N, N)),
            np.zeros((*frames, N, N)),
            np.zeros((*frames, 4)),
            np.zeros((*frames, N + 1, N)),
            np.zeros((*frames, N)),
            np.zeros((SLOTS, 2, ROW)),
            np.zeros((SLOTS, 1), bool),
        )


def window_problem(windows: Windows, slot: int) -> Problem:
    """View of one window for the kernels."""
    return Problem(
        windows.records[slot],
        windows.shared[slot],
        windows.body_heights[slot],
        windows.head_heights[slot],
        windows.body_directions,
        windows.head_directions,
        windows.origin[slot],
        windows.offsets[slot],
        windows.prior[slot],
    )


problem_in = allocating(window_problem)


@allocating
def memory_in(windows: Windows, slot: int, begin: int, memory: Workspace) -> Workspace:
    """The memory of one window from row ``begin`` on: its factorisation, and temporary memory."""
    return Workspace(
        windows.inverse[slot, begin:],
        windows.link[slot, begin:],
        memory.solution,
        memory.step,
        memory.candidate,
        windows.trigonometry[slot, begin:],
        memory.scratch,
        memory.start,
        memory.ended,
        memory.length,
        windows.message[slot, begin:],
        windows.factored[slot, begin:],
        memory.kept,
        memory.again,
        memory.before,
        memory.rival,
    )


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
                windows, free = Windows.empty(self._program, size), list(range(SLOTS - 1, -1, -1))
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
        self._type, self._packer = program_of(model).types.frame, packer_of(model)
        self.place = {name: place_in_row(name, self._type) for name in self._type.names or ()}

    def make(self, n: int, origin: FloatArray, offsets: np.ndarray, prior: FloatArray) -> None:
        """Make arrays for n frames; the other arguments are those of `Problem`."""
        self.take(
            Problem(
                np.zeros(n, self._type),
                np.zeros(1, self._packer.types.shared),
                np.zeros((n, BODY_CLASSES + 1)),
                np.zeros((n, HEAD_CLASSES + 1)),
                unit(class_centres(BODY_CLASSES)),
                unit(class_centres(HEAD_CLASSES)),
                origin[None],
                offsets,
                prior,
            )
        )

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
        if len(packed.body_heights):
            problem.body_heights[row] = packed.body_heights[0]
        if len(packed.head_heights):
            problem.head_heights[row] = packed.head_heights[0]
        return packed


@lru_cache(16)
def packer_of(model: Model) -> FramePacker:
    """One object for all people tracked with a model, so that packed frames are shared."""
    return FramePacker(model.compiled_terms, program_of(model).types)
