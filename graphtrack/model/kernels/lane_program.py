"""The frame program of the presets' terms, for several tracks side by side.

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
from graphtrack.model.terms.anchor import add_anchor
from graphtrack.model.terms.body_follows_motion import add_body_follows_motion, add_motion_quarters
from graphtrack.model.terms.head_follows_body import add_head_follows_body
from graphtrack.model.terms.intentional_motion import add_steered_motion
from graphtrack.model.terms.motion import add_first_velocity, add_motion
from graphtrack.model.terms.pose import add_angle, add_angle_quarters
from graphtrack.model.terms.position import add_pixel, add_position
from graphtrack.model.terms.turning import add_turn


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
    cost = 0.0 * state[0]
    gate = (load(frames, at + 1) > 0.0) & negate(load(frames, at + 29) > 0.0)
    if any_of(gate):
        found = add_motion(
            before,
            state,
            load(frames, at + 0),
            load(frames, at + 1),
            masked(row_of(gradients, there), gate),
            masked(row_of(gradients, here), gate),
            masked(matrix_of(hessians, there), gate),
            masked(matrix_of(hessians, here), gate),
            masked(matrix_of(hessians, 2), gate),
        )
        cost += choose(gate, found, 0.0)
    gate = load(frames, at + 9) > 0.0
    if any_of(gate):
        found = add_turn(
            body_cos_before,
            body_sin_before,
            body_cos,
            body_sin,
            BODY,
            load(frames, at + 9),
            exact,
            masked(row_of(gradients, there), gate),
            masked(row_of(gradients, here), gate),
            masked(matrix_of(hessians, there), gate),
            masked(matrix_of(hessians, here), gate),
            masked(matrix_of(hessians, 2), gate),
        )
        cost += choose(gate, found, 0.0)
    gate = load(frames, at + 10) > 0.0
    if any_of(gate):
        found = add_turn(
            head_cos_before,
            head_sin_before,
            head_cos,
            head_sin,
            HEAD,
            load(frames, at + 10),
            exact,
            masked(row_of(gradients, there), gate),
            masked(row_of(gradients, here), gate),
            masked(matrix_of(hessians, there), gate),
            masked(matrix_of(hessians, here), gate),
            masked(matrix_of(hessians, 2), gate),
        )
        cost += choose(gate, found, 0.0)
    gate = load(frames, at + 29) > 0.0
    if any_of(gate):
        found = add_steered_motion(
            before,
            state,
            head_cos_before,
            head_sin_before,
            load(frames, at + 0),
            load(frames, at + 29),
            load(frames, at + 30),
            load(frames, at + 31),
            load(frames, at + 32),
            load(frames, at + 33),
            exact,
            masked(row_of(gradients, there), gate),
            masked(row_of(gradients, here), gate),
            masked(matrix_of(hessians, there), gate),
            masked(matrix_of(hessians, here), gate),
            masked(matrix_of(hessians, 2), gate),
        )
        cost += choose(gate, found, 0.0)
    gate = load(frames, at + 2) > 0.0
    if any_of(gate):
        found = add_first_velocity(
            state,
            load(frames, at + 2),
            masked(row_of(gradients, here), gate),
            masked(matrix_of(hessians, here), gate),
        )
        cost += choose(gate, found, 0.0)
    gate = (load(frames, at + 5) > 0.0) & negate(load(frames, at + 8) > 0.0)
    if any_of(gate):
        found = add_position(
            state,
            load(origin, 0),
            load(origin, 1),
            load(frames, at + 3),
            load(frames, at + 4),
            load(frames, at + 5),
            shared.robust,
            shared.robust_threshold,
            exact,
            masked(row_of(gradients, here), gate),
            masked(matrix_of(hessians, here), gate),
        )
        cost += choose(gate, found, 0.0)
    gate = load(frames, at + 8) > 0.0
    if any_of(gate):
        found = add_pixel(
            state,
            load(origin, 0),
            load(origin, 1),
            load(frames, at + 6),
            load(frames, at + 7),
            load(frames, at + 8),
            shared.to_image,
            shared.robust,
            shared.robust_threshold,
            exact,
            masked(row_of(gradients, here), gate),
            masked(matrix_of(hessians, here), gate),
        )
        cost += choose(gate, found, 0.0)
    gate = load(frames, at + 13) > 0.0
    if any_of(gate):
        found = add_angle(
            body_cos,
            body_sin,
            BODY,
            load(frames, at + 11),
            load(frames, at + 12),
            load(frames, at + 13),
            load(frames, at + 14),
            exact,
            masked(row_of(gradients, here), gate),
            masked(matrix_of(hessians, here), gate),
        )
        cost += choose(gate, found, 0.0)
    gate = load(frames, at + 19) > 0.0
    if any_of(gate):
        found = add_angle(
            head_cos,
            head_sin,
            HEAD,
            load(frames, at + 17),
            load(frames, at + 18),
            load(frames, at + 19),
            load(frames, at + 20),
            exact,
            masked(row_of(gradients, here), gate),
            masked(matrix_of(hessians, here), gate),
        )
        cost += choose(gate, found, 0.0)
    gate = load(frames, at + 23) > 0.0
    if any_of(gate):
        found = add_body_follows_motion(
            state,
            body_cos,
            body_sin,
            load(frames, at + 23),
            load(frames, at + 24),
            load(frames, at + 25),
            shared.speed_threshold,
            exact,
            masked(row_of(gradients, here), gate),
            masked(matrix_of(hessians, here), gate),
        )
        cost += choose(gate, found, 0.0)
    gate = load(frames, at + 26) > 0.0
    if any_of(gate):
        found = add_head_follows_body(
            body_cos,
            body_sin,
            head_cos,
            head_sin,
            load(frames, at + 26),
            load(frames, at + 27),
            load(frames, at + 28),
            exact,
            masked(row_of(gradients, here), gate),
            masked(matrix_of(hessians, here), gate),
        )
        cost += choose(gate, found, 0.0)
    gate = load(frames, at + 46) > 0.0
    if any_of(gate):
        found = add_anchor(
            body_cos,
            body_sin,
            BODY,
            start,
            load(frames, at + 46),
            exact,
            masked(row_of(gradients, here), gate),
            masked(matrix_of(hessians, here), gate),
        )
        cost += choose(gate, found, 0.0)
    gate = load(frames, at + 47) > 0.0
    if any_of(gate):
        found = add_anchor(
            head_cos,
            head_sin,
            HEAD,
            start,
            load(frames, at + 47),
            exact,
            masked(row_of(gradients, here), gate),
            masked(matrix_of(hessians, here), gate),
        )
        cost += choose(gate, found, 0.0)
    return cost


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
        body[i], head[i] = zero, zero
    gate = load(frames, at + 13) > 0.0
    if any_of(gate):
        add_angle_quarters(
            load(frames, at + 11),
            load(frames, at + 12),
            load(frames, at + 13),
            load(frames, at + 14),
            body_cos,
            body_sin,
            masked(body, gate),
        )
    gate = load(frames, at + 19) > 0.0
    if any_of(gate):
        add_angle_quarters(
            load(frames, at + 17),
            load(frames, at + 18),
            load(frames, at + 19),
            load(frames, at + 20),
            head_cos,
            head_sin,
            masked(head, gate),
        )
    gate = load(frames, at + 23) > 0.0
    if any_of(gate):
        add_motion_quarters(
            state, load(frames, at + 23), shared.speed_threshold, body_cos, body_sin, masked(body, gate)
        )
