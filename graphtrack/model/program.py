"""The frame program of the presets' terms.

Written by `graphtrack.model.generator`; not to be edited.
"""
# fmt: off

from __future__ import annotations

import math
from typing import Any

import graphtrack.model.terms.conversation as conversation_kernels
import graphtrack.model.terms.couplings as couplings_kernels
import graphtrack.model.terms.motion as motion_kernels
import graphtrack.model.terms.orientation as orientation_kernels
import graphtrack.model.terms.position as position_kernels
from graphtrack.kernels.compilation import compiled
from graphtrack.kernels.lanes import any_of, choose, masked, negate
from graphtrack.kernels.layout import BODY, HEAD, Problem, Sums


@compiled
def add_frame(
    problem: Problem, track: int, k: int, start: Any, states: Any, exact: bool, links: bool, own: bool,
    turns: Any, sums_before: Sums, sums: Sums, transition: Any,
) -> Any:
    """Add the terms of frame k of a track; returns their cost.

    ``links``: terms between the frame and the previous one; ``own``: terms of the frame alone. ``turns``
    (n, 4) are read for the previous frame, and set for frame k.
    """
    place = problem.offsets[track] + k
    frame, state, shared = problem.records[place], states[k], problem.shared[0]
    # Sums: kernels are compiled again for each constant argument.
    at_body, at_head = BODY + 0, HEAD + 0
    body_cos, body_sin = math.cos(state[BODY]), math.sin(state[BODY])
    head_cos, head_sin = math.cos(state[HEAD]), math.sin(state[HEAD])
    turns[k, 0], turns[k, 1], turns[k, 2], turns[k, 3] = body_cos, body_sin, head_cos, head_sin
    cost = 0.0 * body_cos
    if links and k > 0:
        before = states[k - 1]
        body_cos_before, body_sin_before = turns[k - 1, 0], turns[k - 1, 1]
        head_cos_before, head_sin_before = turns[k - 1, 2], turns[k - 1, 3]
        gate = (frame.motion_information > 0.0) & negate(frame.steer_gain > 0.0)
        if any_of(gate):
            cost += choose(gate, motion_kernels.add_motion(before, state, frame.dt, frame.motion_information,
                masked(sums_before.gradient, gate), masked(sums.gradient, gate), masked(sums_before.hessian,
                gate), masked(sums.hessian, gate), masked(transition, gate)), 0.0)
        gate = frame.body_turn_kappa > 0.0
        if any_of(gate):
            cost += choose(gate, orientation_kernels.add_turn(body_cos_before, body_sin_before, body_cos,
                body_sin, at_body, frame.body_turn_kappa, exact, masked(sums_before.gradient, gate),
                masked(sums.gradient, gate), masked(sums_before.hessian, gate), masked(sums.hessian, gate),
                masked(transition, gate)), 0.0)
        gate = frame.head_turn_kappa > 0.0
        if any_of(gate):
            cost += choose(gate, orientation_kernels.add_turn(head_cos_before, head_sin_before, head_cos,
                head_sin, at_head, frame.head_turn_kappa, exact, masked(sums_before.gradient, gate),
                masked(sums.gradient, gate), masked(sums_before.hessian, gate), masked(sums.hessian, gate),
                masked(transition, gate)), 0.0)
        gate = frame.steer_gain > 0.0
        if any_of(gate):
            cost += choose(gate, motion_kernels.add_steered_motion(before, state, head_cos_before,
                head_sin_before, frame.dt, frame.steer_gain, frame.steer_reach, frame.steer_place,
                frame.steer_cross, frame.steer_spread, exact, masked(sums_before.gradient, gate),
                masked(sums.gradient, gate), masked(sums_before.hessian, gate), masked(sums.hessian, gate),
                masked(transition, gate)), 0.0)
        gate = frame.group_hold > 0.0
        if any_of(gate):
            cost += choose(gate, conversation_kernels.add_persistence(body_cos_before, body_sin_before,
                body_cos, body_sin, at_body, frame.group_hold, frame.group_drift, shared.group_body_hold,
                exact, masked(sums_before.gradient, gate), masked(sums.gradient, gate),
                masked(sums_before.hessian, gate), masked(sums.hessian, gate), masked(transition, gate)), 0.0)
        gate = frame.group_hold > 0.0
        if any_of(gate):
            cost += choose(gate, conversation_kernels.add_persistence(head_cos_before, head_sin_before,
                head_cos, head_sin, at_head, frame.group_hold, frame.group_drift, shared.group_head_hold,
                exact, masked(sums_before.gradient, gate), masked(sums.gradient, gate),
                masked(sums_before.hessian, gate), masked(sums.hessian, gate), masked(transition, gate)), 0.0)
    if own:
        gate = frame.velocity_information > 0.0
        if any_of(gate):
            cost += choose(gate, motion_kernels.add_first_velocity(state, frame.velocity_information,
                masked(sums.gradient, gate), masked(sums.hessian, gate)), 0.0)
        gate = (frame.position_information > 0.0) & negate(frame.pixel_information > 0.0)
        if any_of(gate):
            cost += choose(gate, position_kernels.add_position(state, problem.origin[track, 0],
                problem.origin[track, 1], frame.x, frame.y, frame.position_information, shared.robust,
                shared.robust_threshold, exact, masked(sums.gradient, gate), masked(sums.hessian, gate)), 0.0)
        gate = frame.pixel_information > 0.0
        if any_of(gate):
            cost += choose(gate, position_kernels.add_pixel(state, problem.origin[track, 0],
                problem.origin[track, 1], frame.u, frame.v, frame.pixel_information, shared.to_image,
                shared.robust, shared.robust_threshold, exact, masked(sums.gradient, gate),
                masked(sums.hessian, gate)), 0.0)
        gate = frame.body_kappa > 0.0
        if any_of(gate):
            cost += choose(gate, orientation_kernels.add_angle(body_cos, body_sin, at_body,
                frame.observed_body_cos, frame.observed_body_sin, frame.body_kappa, frame.body_uniform, exact,
                masked(sums.gradient, gate), masked(sums.hessian, gate)), 0.0)
        gate = frame.body_class_kappa > 0.0
        if any_of(gate):
            cost += choose(gate, orientation_kernels.add_classes(body_cos, body_sin, at_body,
                problem.body_heights[place], problem.body_directions, frame.body_class_kappa, exact,
                masked(sums.gradient, gate), masked(sums.hessian, gate)), 0.0)
        gate = frame.head_kappa > 0.0
        if any_of(gate):
            cost += choose(gate, orientation_kernels.add_angle(head_cos, head_sin, at_head,
                frame.observed_head_cos, frame.observed_head_sin, frame.head_kappa, frame.head_uniform, exact,
                masked(sums.gradient, gate), masked(sums.hessian, gate)), 0.0)
        gate = frame.head_class_kappa > 0.0
        if any_of(gate):
            cost += choose(gate, orientation_kernels.add_classes(head_cos, head_sin, at_head,
                problem.head_heights[place], problem.head_directions, frame.head_class_kappa, exact,
                masked(sums.gradient, gate), masked(sums.hessian, gate)), 0.0)
        gate = frame.motion_body_kappa > 0.0
        if any_of(gate):
            cost += choose(gate, couplings_kernels.add_body_follows_motion(state, body_cos, body_sin,
                frame.motion_body_kappa, shared.speed_threshold, exact, masked(sums.gradient, gate),
                masked(sums.hessian, gate)), 0.0)
        gate = frame.head_body_kappa > 0.0
        if any_of(gate):
            cost += choose(gate, couplings_kernels.add_head_follows_body(body_cos, body_sin, head_cos,
                head_sin, frame.head_body_kappa, exact, masked(sums.gradient, gate), masked(sums.hessian,
                gate)), 0.0)
        gate = frame.group_weight > 0.0
        if any_of(gate):
            cost += choose(gate, conversation_kernels.add_faces_group(at_body, body_cos, body_sin,
                frame.group_weight, frame.group_cos, frame.group_sin, shared.group_body_kappa,
                shared.group_outliers, exact, masked(sums.gradient, gate), masked(sums.hessian, gate)), 0.0)
        gate = frame.group_weight > 0.0
        if any_of(gate):
            cost += choose(gate, conversation_kernels.add_faces_group(at_head, head_cos, head_sin,
                frame.group_weight, frame.group_cos, frame.group_sin, shared.group_head_kappa,
                shared.group_outliers, exact, masked(sums.gradient, gate), masked(sums.hessian, gate)), 0.0)
        gate = frame.body_anchor > 0.0
        if any_of(gate):
            cost += choose(gate, orientation_kernels.add_anchor(body_cos, body_sin, at_body, start,
                frame.body_anchor, exact, masked(sums.gradient, gate), masked(sums.hessian, gate)), 0.0)
        gate = frame.head_anchor > 0.0
        if any_of(gate):
            cost += choose(gate, orientation_kernels.add_anchor(head_cos, head_sin, at_head, start,
                frame.head_anchor, exact, masked(sums.gradient, gate), masked(sums.hessian, gate)), 0.0)
    return cost


@compiled
def cut(frame: Any) -> None:
    """Remove a frame's links to the previous one from its record."""
    frame.motion_information = 0.0
    frame.body_turn_kappa = 0.0
    frame.head_turn_kappa = 0.0
    frame.steer_gain = 0.0
    frame.group_hold = 0.0


@compiled
def set_quarter_turns(
    problem: Problem, track: int, k: int, state: Any, turns: Any, exact: bool, sums: Sums, body: Any,
    head: Any,
) -> None:
    """Costs of frame k with body or head at the directions ``turns``, and at their quarter turns.

    ``turns`` (4,) are cosine and sine of the body's direction and the head's; ``body`` and ``head`` (4,) are
    filled in. ``sums`` is memory.
    """
    place = problem.offsets[track] + k
    frame, shared = problem.records[place], problem.shared[0]
    at_body, at_head = BODY + 0, HEAD + 0
    body_cos, body_sin, head_cos, head_sin = turns[0], turns[1], turns[2], turns[3]
    for q in range(4):
        body[q] = head[q] = 0.0 * body_cos
    gate = frame.body_kappa > 0.0
    if any_of(gate):
        orientation_kernels.add_angle_quarter_turns(frame.observed_body_cos, frame.observed_body_sin,
            frame.body_kappa, frame.body_uniform, body_cos, body_sin, masked(body, gate))
    gate = frame.body_class_kappa > 0.0
    if any_of(gate):
        orientation_kernels.add_class_quarter_turns(body_cos, body_sin, problem.body_heights[place],
            problem.body_directions, frame.body_class_kappa, masked(body, gate))
    gate = frame.head_kappa > 0.0
    if any_of(gate):
        orientation_kernels.add_angle_quarter_turns(frame.observed_head_cos, frame.observed_head_sin,
            frame.head_kappa, frame.head_uniform, head_cos, head_sin, masked(head, gate))
    gate = frame.head_class_kappa > 0.0
    if any_of(gate):
        orientation_kernels.add_class_quarter_turns(head_cos, head_sin, problem.head_heights[place],
            problem.head_directions, frame.head_class_kappa, masked(head, gate))
    gate = frame.motion_body_kappa > 0.0
    if any_of(gate):
        couplings_kernels.add_motion_quarter_turns(state, frame.motion_body_kappa, shared.speed_threshold,
            body_cos, body_sin, masked(body, gate))
    gate = frame.group_weight > 0.0
    if any_of(gate):
        cos, sin = body_cos, body_sin
        for q in range(4):
            body[q] += choose(gate, conversation_kernels.add_faces_group(at_body, cos, sin,
                frame.group_weight, frame.group_cos, frame.group_sin, shared.group_body_kappa,
                shared.group_outliers, exact, masked(sums.gradient, gate), masked(sums.hessian, gate)), 0.0)
            cos, sin = -sin, cos
    gate = frame.group_weight > 0.0
    if any_of(gate):
        cos, sin = head_cos, head_sin
        for q in range(4):
            head[q] += choose(gate, conversation_kernels.add_faces_group(at_head, cos, sin,
                frame.group_weight, frame.group_cos, frame.group_sin, shared.group_head_kappa,
                shared.group_outliers, exact, masked(sums.gradient, gate), masked(sums.hessian, gate)), 0.0)
            cos, sin = -sin, cos
