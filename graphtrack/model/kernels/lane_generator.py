"""Writes the frame program for several tracks side by side: the terms whose kernels take `lanes`.

``python -m graphtrack.model.kernels.lane_generator`` writes `lane_program` anew; a test compares.
"""

from __future__ import annotations

import math
from pathlib import Path

from graphtrack.model.kernels.generator import TURNS, Program, unturned, write, written_call
from graphtrack.model.kernels.kernel import Kernel

HEADER = '''"""The frame program of {title}, for several tracks side by side.

Written by `graphtrack.model.kernels.lane_generator`; not to be edited.
"""

from __future__ import annotations

from typing import Any

from graphtrack.geometry.angles import FloatArray
from graphtrack.model.kernels.branches import any_of, choose
from graphtrack.model.kernels.compiled import compiled
from graphtrack.model.kernels.lanes import load, masked, matrix_of, negate, row_of, store
from graphtrack.model.kernels.layout import BODY, HEAD
from graphtrack.model.kernels.vector_math import cos_sin
{imports}

'''

OPEN_LANES = '''
@compiled
def add_lanes(
    shared: Any,
    frames: FloatArray,
    origin: FloatArray,
    starts: FloatArray,
    k: int,
    states: FloatArray,
    exact: bool,
    turns: FloatArray,
    gradients: FloatArray,
    hessians: FloatArray,
) -> Any:
    """Add the terms that arrive with frame k of all lanes; returns their cost.

    Parameters
    ----------
    shared : the record of what all frames share
    frames : (n, fields of a record, LANES)
    origin, starts : (2, LANES) metres; (1, 6, LANES)
    states : (n, 6, LANES)
    turns : (2, 4, LANES) noted of the frame before in one half, and now of frame k in the other
    gradients, hessians : (2, 6, LANES) and (3, 6, 6, LANES); the frame's where k is odd second, and last
        the transition
    """
    here, at = k & 1, k * frames.shape[1]
    there = 1 - here
    state, before, start = row_of(states, k), row_of(states, k - 1), row_of(starts, 0)
    body_cos, body_sin = cos_sin(state[BODY])
    head_cos, head_sin = cos_sin(state[HEAD])
    body_cos_before, body_sin_before = load(turns, 4 * there), load(turns, 4 * there + 1)
    head_cos_before, head_sin_before = load(turns, 4 * there + 2), load(turns, 4 * there + 3)
    store(turns, 4 * here, body_cos)
    store(turns, 4 * here + 1, body_sin)
    store(turns, 4 * here + 2, head_cos)
    store(turns, 4 * here + 3, head_sin)
    cost = 0.0 * state[0]'''

OPEN_LANE_QUARTERS = '''

@compiled
def set_lane_quarters(
    shared: Any, frames: FloatArray, k: int, states: FloatArray, turns: FloatArray, quarters: FloatArray
) -> None:
    """What frame k of all lanes costs with body or head as they are, and one, two and three quarters on.

    As `program.set_quarters`: in the first numbers of the two rows of ``quarters`` (2, 6, LANES). Cosine and
    sine of body and head as they are come into the first half of ``turns`` (2, 4, LANES).
    """
    at, state = k * frames.shape[1], row_of(states, k)
    body, head = row_of(quarters, 0), row_of(quarters, 1)
    body_cos, body_sin = cos_sin(state[BODY])
    head_cos, head_sin = cos_sin(state[HEAD])
    store(turns, 0, body_cos)
    store(turns, 1, body_sin)
    store(turns, 2, head_cos)
    store(turns, 3, head_sin)
    zero = 0.0 * body_cos
    for i in range(4):
        body[i], head[i] = zero, zero'''


class LaneProgram(Program):
    """The program of the terms of the presets that can be solved side by side; see `Kernel.lanes`."""

    def _source(self, title: str) -> str:
        known = {f.name: self._field(f.name) for f in self.fields} | {
            "origin_x": "load(origin, 0)",
            "origin_y": "load(origin, 1)",
            "gradient_before": "masked(row_of(gradients, there), gate)",
            "gradient": "masked(row_of(gradients, here), gate)",
            "hessian_before": "masked(matrix_of(hessians, there), gate)",
            "hessian": "masked(matrix_of(hessians, here), gate)",
            "transition": "masked(matrix_of(hessians, 2), gate)",
        }
        local = ("state", "before", "start", "exact", *TURNS, *(f"{name}_before" for name in TURNS))
        lines = []
        # Links first, as in `program.add_frame`.
        for kernel in sorted((k for k in self.kernels if k.lanes), key=lambda k: not k.before):
            given = self._all_given(kernel.arguments, local, known)
            lines += [f"    gate = {self._lane_gate(kernel)}", "    if any_of(gate):"]
            lines += [written_call(8, "found = ", self._name(kernel.function), given)]
            lines += ["        cost += choose(gate, found, 0.0)"]
        lines += ["    return cost", OPEN_LANE_QUARTERS]
        local = ("state", *TURNS)
        for name, kernel in self._searched():
            if kernel.lanes:
                if kernel.search is None or kernel.search.add_quarters is None:
                    raise ValueError(f"found lanes of {kernel.gate} without a search by quarters")
                function = kernel.search.add_quarters
                here = {"cos": f"{name}_cos", "sin": f"{name}_sin", "cost": f"masked({name}, gate)"}
                names = unturned(function, kernel)
                given = self._all_given(names, local, known | here)
                lines += [f"    gate = {self._lane_gate(kernel)}", "    if any_of(gate):"]
                lines += [written_call(8, "", self._name(function), given)]
        head = HEADER.format(title=title, imports=self._import_lines())
        return head + "\n".join([OPEN_LANES, *lines, ""])

    def _field(self, name: str) -> str:
        """A number of a frame's record, of all lanes."""
        place = 0
        for field in self.fields:
            if field.name == name:
                break
            place += math.prod(field.shape)
        return f"load(frames, at + {place})"

    def _lane_gate(self, kernel: Kernel) -> str:
        gate = f"{self._field(kernel.gate)} > 0.0"
        if kernel.unless in [f.name for f in self.fields]:
            return f"({gate}) & negate({self._field(kernel.unless)} > 0.0)"
        return gate


if __name__ == "__main__":
    write(LaneProgram, Path(__file__).with_name("lane_program.py"))
