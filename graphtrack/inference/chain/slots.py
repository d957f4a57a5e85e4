"""Memory of many windows side by side, so that one compiled call takes what was seen of many people."""

from __future__ import annotations

import threading
import weakref
from functools import lru_cache
from typing import Any

import numpy as np

from graphtrack.geometry.angles import class_centres, unit
from graphtrack.inference.chain.windows import Windows
from graphtrack.model.kernels.frame_program import FrameProgram
from graphtrack.model.kernels.layout import N
from graphtrack.model.kernels.problem import Problem
from graphtrack.model.terms.gait import ROW
from graphtrack.tracks import BODY_CLASSES, HEAD_CLASSES

SLOTS = 32
"""Windows of a block."""


class Block:
    """The memory of some windows of one size.

    Attributes
    ----------
    windows : the arrays
    size : frames for which each has room
    free : slots that nobody has, the first last
    """

    def __init__(self, program: FrameProgram, size: int) -> None:
        frames = (SLOTS, size)
        self.size, self.free = size, list(range(SLOTS - 1, -1, -1))
        self.windows = Windows(
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


class Slot:
    """A place in a block, as long as somebody holds it.

    Parameters
    ----------
    block, number : which one
    blocks : gets it back
    """

    def __init__(self, block: Block, number: int, blocks: Blocks) -> None:
        self.block, self.number = block, number
        weakref.finalize(self, blocks.take_back, block, number).atexit = False

    def __getattr__(self, name: str) -> Any:
        """One of the arrays of `Windows`, of this window alone."""
        return getattr(self.block.windows, name)[self.number]

    @property
    def problem(self) -> Problem:
        """What the kernels are given of the window."""
        windows = self.block.windows
        return Problem(
            self.records,
            self.shared,
            self.body_heights,
            self.head_heights,
            windows.body_directions,
            windows.head_directions,
            self.origin,
            self.offsets,
            self.prior,
        )


class Blocks:
    """All blocks for the windows of a program; as many as are needed."""

    def __init__(self, program: FrameProgram) -> None:
        self._program, self._blocks, self._mutex = program, list[Block](), threading.RLock()

    def slot(self, size: int) -> Slot:
        """A free slot with room for so many frames. What was there before is there still."""
        with self._mutex:
            found = next((one for one in self._blocks if one.size == size and one.free), None)
            if found is None:
                found = Block(self._program, size)
                self._blocks.append(found)
            return Slot(found, found.free.pop(), self)

    def take_back(self, block: Block, number: int) -> None:
        """A slot is free again; a block in which nobody is left is let go of."""
        with self._mutex:
            block.free.append(number)
            if len(block.free) == SLOTS:
                self._blocks.remove(block)


@lru_cache(16)
def blocks_of(program: FrameProgram) -> Blocks:
    """One for all windows of a process: what their frames are called is the same."""
    return Blocks(program)
