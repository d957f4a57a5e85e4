"""A coupling's modes as tables: of each mode and offset what it does, and how one leads to another.

They are the recursions of `coupling_modes` on one mode and offset at a time, for methods that draw these.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from graphtrack.geometry.angles import FloatArray
from graphtrack.inference.chain.coupling_modes import (
    Following,
    ModeMemory,
    expected,
    filter_modes,
    mode_memory,
    smooth_modes,
)
from graphtrack.model.terms.gait import BASE, ROW, Modes


class ModeTable(NamedTuple):
    """The m modes and offsets of one coupling, (m,) each.

    Attributes
    ----------
    initial : probabilities where nothing was seen
    cos, sin : the coupling's resultant, as multiples of its concentration when aligned
    held_cos, held_sin : of the offset itself; 0 in a glance, which steers nobody
    aligned : 1 in the aligned mode, else 0
    doubt : probability that the offset is a classifier's, and what it says of the orientation nothing
    """

    initial: FloatArray
    cos: FloatArray
    sin: FloatArray
    held_cos: FloatArray
    held_sin: FloatArray
    aligned: FloatArray
    doubt: FloatArray


ALWAYS = ModeTable(*(np.array([value]) for value in (1.0, 1.0, 0.0, 1.0, 0.0, 1.0, 0.0)))
"""A coupling without modes: it always holds."""


def mode_table(modes: Modes) -> ModeTable:
    """The table of a coupling's modes."""
    # What glances would do where there are none: nothing.
    rows = np.tile([0.0, 0.0, 1.0, 0.0, 0.0, 0.0], (ROW, 1))
    for j, mass in enumerate(np.eye(ROW)[: ROW if modes.glance_share > 0.0 else BASE]):
        memory = _memory(0.0)
        memory.likelihood[:], memory.after[:] = 1.0, 0.0
        found, _ = smooth_modes(0, modes, mass[None], Following(0.0, 1.0, 0.0, 1.0, 0.0), memory)
        pull = expected(found, modes.strength, modes.free_strength, modes.glance_strength)
        offset = expected(found, 1.0, 1.0, 0.0)
        rows[j] = *pull, *offset, found.near, found.mistaken
    memory = _memory(0.0)
    filter_modes(1, modes, np.zeros(ROW), memory.filtered_body, memory)
    initial = memory.filtered_body[0]
    return ModeTable(initial / initial.sum(), *rows.T)


def transition(modes: Modes, dt: float) -> FloatArray:
    """Matrix P[i, j] from mode and offset i to j in ``dt`` seconds; 0 is drawn as at a beginning."""
    found = np.empty((ROW, ROW))
    for i, before in enumerate(np.eye(ROW)):
        memory = _memory(dt)
        filter_modes(1, modes, before, memory.filtered_body, memory)
        found[i] = memory.filtered_body[0] / memory.filtered_body[0].sum()
    return found


def _memory(dt: float) -> ModeMemory:
    """Memory for one frame in which nothing is seen."""
    memory = mode_memory(1)
    memory.dt[0], memory.likelihood[:] = dt, 0.0
    return memory
