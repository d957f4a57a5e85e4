"""The terms that arrive with a frame, added up: cost, gradient and Hessian."""

from __future__ import annotations

import math

from graphtrack.geometry.angles import FloatArray
from graphtrack.inference.chain.problem import N, Problem
from graphtrack.model.kernels.compiled import compiled
from graphtrack.model.kernels.coupling import add_body_follows_motion, add_head_follows_body
from graphtrack.model.kernels.frames import BODY, HEAD
from graphtrack.model.kernels.motion import add_first_velocity, add_motion, add_steered_motion
from graphtrack.model.kernels.orientation import add_turn
from graphtrack.model.kernels.pose import add_angle, add_classes
from graphtrack.model.kernels.position import add_pixel, add_position


@compiled
def add_frame(
    problem: Problem,
    track: int,
    k: int,
    start: FloatArray,
    states: FloatArray,
    exact: bool,
    trigonometry: FloatArray,
    gradient_before: FloatArray,
    gradient: FloatArray,
    hessian_before: FloatArray,
    hessian: FloatArray,
    transition: FloatArray,
) -> float:
    """Add all terms that arrive with frame k of a track; returns their cost."""
    place = problem.offsets[track] + k
    frame, state, shared = problem.records[place], states[k], problem.shared[0]
    body_cos, body_sin = math.cos(state[BODY]), math.sin(state[BODY])
    head_cos, head_sin = math.cos(state[HEAD]), math.sin(state[HEAD])
    now = trigonometry[k]
    now[0], now[1], now[2], now[3] = body_cos, body_sin, head_cos, head_sin
    cost = 0.0
    if frame.steer_gain > 0.0 and frame.motion_information > 0.0:
        then = trigonometry[k - 1]
        cost += add_steered_motion(
            frame,
            states[k - 1],
            state,
            then[2],
            then[3],
            exact,
            gradient_before,
            gradient,
            hessian_before,
            hessian,
            transition,
        )
    elif frame.motion_information > 0.0:
        cost += add_motion(
            states[k - 1],
            state,
            frame.dt,
            frame.motion_information,
            gradient_before,
            gradient,
            hessian_before,
            hessian,
            transition,
        )
    if frame.velocity_information > 0.0:
        cost += add_first_velocity(state, frame.velocity_information, gradient, hessian)
    if frame.pixel_information > 0.0:
        cost += add_pixel(
            state,
            problem.origin[track, 0],
            problem.origin[track, 1],
            frame.u,
            frame.v,
            frame.pixel_information,
            shared.to_image,
            shared.robust,
            shared.robust_threshold,
            exact,
            gradient,
            hessian,
        )
    elif frame.position_information > 0.0:
        cost += add_position(
            state,
            frame.x,
            frame.y,
            frame.position_information,
            shared.robust,
            shared.robust_threshold,
            exact,
            gradient,
            hessian,
        )
    if frame.body_turn_kappa > 0.0:
        then = trigonometry[k - 1]
        cost += add_turn(
            then[0],
            then[1],
            body_cos,
            body_sin,
            BODY,
            frame.body_turn_kappa,
            exact,
            gradient_before,
            gradient,
            hessian_before,
            hessian,
            transition,
        )
    if frame.head_turn_kappa > 0.0:
        then = trigonometry[k - 1]
        cost += add_turn(
            then[2],
            then[3],
            head_cos,
            head_sin,
            HEAD,
            frame.head_turn_kappa,
            exact,
            gradient_before,
            gradient,
            hessian_before,
            hessian,
            transition,
        )
    if frame.motion_body_kappa > 0.0:
        # A body turned back by the offset is what follows the motion; likewise below for the head.
        along, across = frame.motion_body_cos, frame.motion_body_sin
        cost += add_body_follows_motion(
            state,
            body_cos * along + body_sin * across,
            body_sin * along - body_cos * across,
            frame.motion_body_kappa,
            shared.speed_threshold,
            exact,
            gradient,
            hessian,
        )
    if frame.head_body_kappa > 0.0:
        along, across = frame.head_body_cos, frame.head_body_sin
        cost += add_head_follows_body(
            body_cos,
            body_sin,
            head_cos * along + head_sin * across,
            head_sin * along - head_cos * across,
            frame.head_body_kappa,
            exact,
            gradient,
            hessian,
        )
    if frame.body_kappa > 0.0:
        cost += add_angle(
            body_cos,
            body_sin,
            BODY,
            frame.body_cos,
            frame.body_sin,
            frame.body_kappa,
            frame.body_uniform,
            exact,
            gradient,
            hessian,
        )
    if frame.head_kappa > 0.0:
        cost += add_angle(
            head_cos,
            head_sin,
            HEAD,
            frame.head_cos,
            frame.head_sin,
            frame.head_kappa,
            frame.head_uniform,
            exact,
            gradient,
            hessian,
        )
    if frame.body_class_kappa > 0.0:
        cost += add_classes(
            body_cos,
            body_sin,
            BODY,
            problem.body_heights[place],
            problem.body_directions,
            frame.body_class_kappa,
            exact,
            gradient,
            hessian,
        )
    if frame.head_class_kappa > 0.0:
        cost += add_classes(
            head_cos,
            head_sin,
            HEAD,
            problem.head_heights[place],
            problem.head_directions,
            frame.head_class_kappa,
            exact,
            gradient,
            hessian,
        )
    if frame.body_anchor > 0.0:
        cos, sin = math.cos(start[BODY]), math.sin(start[BODY])
        cost += add_angle(
            body_cos, body_sin, BODY, cos, sin, frame.body_anchor, 0.0, exact, gradient, hessian
        )
    if frame.head_anchor > 0.0:
        cos, sin = math.cos(start[HEAD]), math.sin(start[HEAD])
        cost += add_angle(
            head_cos, head_sin, HEAD, cos, sin, frame.head_anchor, 0.0, exact, gradient, hessian
        )
    return cost


@compiled
def add_prior(prior: FloatArray, state: FloatArray, gradient: FloatArray, hessian: FloatArray) -> float:
    """½·dᵀ·Λ·d − ηᵀ·d, where d is the deviation from the prior's point."""
    cost = 0.0
    for i in range(N):
        slope = 0.0
        for j in range(N):
            slope += prior[i, j] * (state[j] - prior[N + 1, j])
            hessian[i, j] += prior[i, j]
        cost += (0.5 * slope - prior[N, i]) * (state[i] - prior[N + 1, i])
        gradient[i] += slope - prior[N, i]
    return cost
