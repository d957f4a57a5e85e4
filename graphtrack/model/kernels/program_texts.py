"""What every frame program says: its head, and how its functions open."""

from __future__ import annotations

HEADER = '''"""The frame program of {title}.

Written by `graphtrack.model.kernels.generator`; not to be edited.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from graphtrack.geometry.angles import FloatArray
from graphtrack.model.kernels.compiled import allocating, compiled
from graphtrack.model.kernels.layout import {layout}
from graphtrack.model.kernels.problem import Problem
{imports}

'''

OPEN_OWN = '''
@compiled
def add_own(
    problem: Problem,
    track: int,
    k: int,
    start: FloatArray,
    states: FloatArray,
    exact: bool,
    turns: FloatArray,
    gradient: FloatArray,
    hessian: FloatArray,
) -> float:
    """Add the terms of frame k of a track alone, whose ``turns`` are noted; returns their cost."""
    place = problem.offsets[track] + k
    frame, state = problem.records[place], states[k]
    cost = 0.0'''

OPEN_LINKS = '''
@compiled
def add_links(
    problem: Problem,
    track: int,
    k: int,
    states: FloatArray,
    exact: bool,
    turns: FloatArray,
    gradient_before: FloatArray,
    gradient: FloatArray,
    hessian_before: FloatArray,
    hessian: FloatArray,
    transition: FloatArray,
) -> float:
    """Add the terms between frame k of a track and the one before; returns their cost."""
    place = problem.offsets[track] + k
    frame, before, state = problem.records[place], states[k - 1], states[k]
    cost = 0.0'''

NOTE_TURNS = '''
@compiled
def note_turns(k: int, states: FloatArray, turns: FloatArray) -> None:
    """Cosines and sines of body and head in frame k; ``turns`` is (n, 4)."""
    turns[k, 0], turns[k, 1] = math.cos(states[k, BODY]), math.sin(states[k, BODY])
    turns[k, 2], turns[k, 3] = math.cos(states[k, HEAD]), math.sin(states[k, HEAD])
'''

OPEN_FRAME = '''
@compiled
def add_frame(
    problem: Problem,
    track: int,
    k: int,
    start: FloatArray,
    states: FloatArray,
    exact: bool,
    turns: FloatArray,
    gradient_before: FloatArray,
    gradient: FloatArray,
    hessian_before: FloatArray,
    hessian: FloatArray,
    transition: FloatArray,
) -> float:
    """Add all terms that arrive with frame k of a track; returns their cost.

    ``turns`` (n, 4) must have been noted of the frame before, and are of frame k.
    """
    place = problem.offsets[track] + k
    frame, before, state = problem.records[place], states[k - 1], states[k]
    body_cos, body_sin = math.cos(state[BODY]), math.sin(state[BODY])
    head_cos, head_sin = math.cos(state[HEAD]), math.sin(state[HEAD])
    turns[k, 0], turns[k, 1], turns[k, 2], turns[k, 3] = body_cos, body_sin, head_cos, head_sin
    cost = 0.0'''

OPEN_CUT = '''
@compiled
def cut(frame: Any) -> None:
    """Take a frame's links to the one before out of its record."""'''

OPEN_OVER = '''
@allocating
def add_over(
    problem: Problem,
    track: int,
    states: FloatArray,
    cos: FloatArray,
    sin: FloatArray,
    node: np.ndarray,
    body: FloatArray,
    head: FloatArray,
) -> None:
    """Add what frames cost at each direction of a grid, to the rows of their groups.

    ``node`` (n,) is each frame's group; ``body`` and ``head`` are (groups, directions).
    """'''

OVER_FRAMES = """\
    for k in range(len(states)):
        place, state, g = problem.offsets[track] + k, states[k], node[k]
        frame = problem.records[place]"""

OPEN_QUARTERS = '''
@allocating
def set_quarters(problem: Problem, track: int, states: FloatArray, quarters: FloatArray) -> None:
    """What each frame costs with body or head as they are, and one, two and three quarters on.

    A row of ``quarters`` (n, 12) becomes the four costs of the body, those of the head, and the cosines and
    sines of body and head as they are.
    """
    body, head = np.empty(4), np.empty(4)'''

QUARTERS_FRAMES = """\
    for k in range(len(states)):
        place, state = problem.offsets[track] + k, states[k]
        frame = problem.records[place]
        body_cos, body_sin = math.cos(state[BODY]), math.sin(state[BODY])
        head_cos, head_sin = math.cos(state[HEAD]), math.sin(state[HEAD])
        body[:] = 0.0
        head[:] = 0.0"""

QUARTERS = """\
        turns[0, 0], turns[0, 1], turns[0, 2], turns[0, 3] = body_cos, -body_sin, -body_cos, body_sin
        turns[1, 0], turns[1, 1], turns[1, 2], turns[1, 3] = body_sin, body_cos, -body_sin, -body_cos
        turns[2, 0], turns[2, 1], turns[2, 2], turns[2, 3] = head_cos, -head_sin, -head_cos, head_sin
        turns[3, 0], turns[3, 1], turns[3, 2], turns[3, 3] = head_sin, head_cos, -head_sin, -head_cos"""

END_QUARTERS = """\
        for q in range(4):
            quarters[k, q], quarters[k, 4 + q] = body[q], head[q]
        quarters[k, 8], quarters[k, 9] = body_cos, body_sin
        quarters[k, 10], quarters[k, 11] = head_cos, head_sin
"""
