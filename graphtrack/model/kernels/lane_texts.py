"""What every frame program for tracks side by side says: its head, and how its functions open."""

from __future__ import annotations

LANE_HEADER = '''"""The frame program of {title}, for several tracks side by side.

Written by `graphtrack.model.kernels.generator`; not to be edited.
"""

from __future__ import annotations

from typing import Any

from graphtrack.geometry.angles import FloatArray
from graphtrack.model.kernels.compiled import compiled
from graphtrack.model.kernels.lanes import {lanes}
{layout}from graphtrack.model.kernels.problem import Problem
from graphtrack.model.kernels.vector_math import cos_sin
{imports}

'''

OPEN_LANES = '''
@compiled
def add_lanes(
    problem: Problem,
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
    """Add the terms that arrive with frame k of all lanes; returns their cost, and whether others are left.

    Parameters
    ----------
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
    body_cos, body_sin = cos_sin(state[4])
    head_cos, head_sin = cos_sin(state[5])
    body_cos_before, body_sin_before = load(turns, 4 * there), load(turns, 4 * there + 1)
    head_cos_before, head_sin_before = load(turns, 4 * there + 2), load(turns, 4 * there + 3)
    store(turns, 4 * here, body_cos)
    store(turns, 4 * here + 1, body_sin)
    store(turns, 4 * here + 2, head_cos)
    store(turns, 4 * here + 3, head_sin)
    cost = 0.0 * state[0]'''

OPEN_OTHERS = '''
@compiled
def add_others(
    problem: Problem,
    track: int,
    k: int,
    start: FloatArray,
    states: FloatArray,
    exact: bool,
    turns: FloatArray,
    gradients: FloatArray,
    hessians: FloatArray,
) -> float:
    """Add the terms of frame k of one track whose kernels are not for lanes; returns their cost.

    ``states`` (2, 6), ``turns`` (2, 4) and ``gradients`` (2, 6) are of the frame before and of frame k, and
    ``hessians`` (3, 6, 6) besides of both.
    """
    place = problem.offsets[track] + k
    frame = problem.records[place]'''
