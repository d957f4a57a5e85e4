"""The frame program of the presets' terms.

Written by `graphtrack.model.kernels.generator`; not to be edited.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from graphtrack.geometry.angles import FloatArray
from graphtrack.model.kernels.compiled import allocating, compiled
from graphtrack.model.kernels.layout import BODY, HEAD, N
from graphtrack.model.kernels.problem import Problem
from graphtrack.model.terms.anchor import add_anchor
from graphtrack.model.terms.body_follows_motion import (
    add_body_follows_motion,
    add_motion_over,
    add_motion_quarters,
)
from graphtrack.model.terms.faces_group import add_faces_group
from graphtrack.model.terms.head_follows_body import add_head_follows_body
from graphtrack.model.terms.holds_still import add_holds
from graphtrack.model.terms.intentional_motion import add_steered_motion
from graphtrack.model.terms.motion import add_first_velocity, add_motion
from graphtrack.model.terms.place import add_place
from graphtrack.model.terms.pose import add_angle, add_angle_over, add_angle_quarters
from graphtrack.model.terms.pose_classes import (
    add_class_quarters,
    add_classes,
    add_classes_over,
    class_densities,
)
from graphtrack.model.terms.position import add_pixel, add_position
from graphtrack.model.terms.turning import add_turn

FRAME = np.dtype(
    [
        ("dt", float),  # seconds since the person's frame before; 0 at the first
        ("motion_information", float),  # 1/q in s³/m²; 0 at the first frame
        ("velocity_information", float),  # of the prior on the velocity, where it stands
        ("x", float),  # observed position in the world, metres
        ("y", float),
        ("position_information", float),  # 1/σ²; 0: no position was observed
        ("u", float),  # observed pixel without the lens
        ("v", float),
        ("pixel_information", float),  # 1/σ² in pixels⁻²; 0: judged in metres, if at all
        ("body_turn_kappa", float),  # of rotational diffusion since the frame before; 0 at the first
        ("head_turn_kappa", float),  # of rotational diffusion since the frame before; 0 at the first
        ("seen_body_cos", float),  # direction, concentration and ε/2π of an observed body angle
        ("seen_body_sin", float),
        ("body_kappa", float),
        ("body_uniform", float),  # the outliers' density over that at the peak of the von Mises
        ("body_class_kappa", float),  # concentration of the classes; 0: no class likelihoods
        ("body_doubt", float),  # probability that they say nothing, by the modes of the couplings
        ("seen_head_cos", float),  # direction, concentration and ε/2π of an observed head angle
        ("seen_head_sin", float),
        ("head_kappa", float),
        ("head_uniform", float),  # the outliers' density over that at the peak of the von Mises
        ("head_class_kappa", float),  # concentration of the classes; 0: no class likelihoods
        ("head_doubt", float),  # probability that they say nothing, by the modes of the couplings
        ("motion_body_kappa", float),  # κ₁ with the frame's weight
        ("motion_body_cos", float),  # of the angle from motion to body at which their coupling rests
        ("motion_body_sin", float),
        ("head_body_kappa", float),  # κ₂ with the frame's weight
        ("head_body_cos", float),  # of the angle from body to head at which their coupling rests
        ("head_body_sin", float),
        ("steer_gain", float),  # share of the velocity that turns to the head; 0: white-noise acceleration
        ("steer_reach", float),  # seconds that the old velocity carries on
        ("steer_place", float),  # information on the position, on both, and on the velocity
        ("steer_cross", float),
        ("steer_spread", float),
        ("steer_rate", float),  # λ in 1/s, where modes choose how much of it holds
        ("body_aligned_kappa", float),  # κ₁ and κ₂ with the weight, where modes choose how much of them holds
        ("head_aligned_kappa", float),
        ("coupling_weight", float),  # that weight
        ("body_information", float),  # Fisher information of what was seen of the body, and of the head
        ("head_information", float),
        ("place_weight", float),  # |strength| with the frame's weight
        ("group_weight", float),  # of the direction of the o-space
        ("group_cos", float),  # of that direction
        ("group_sin", float),
        ("group_hold", float),  # probability of the conversation; 0 at the first frame
        ("group_drift", float),  # radians up to which a turn is a drift
        ("body_anchor", float),  # concentration that holds a first orientation to its initial value
        ("head_anchor", float),
    ]
)
"""One frame. What a gate stands for is 0 where there is nothing to say."""

SHARED = np.dtype(
    [
        ("robust", float),  # 0 none, 1 Huber, 2 Cauchy
        ("robust_threshold", float),  # standard deviations
        ("to_image", float, (3, 3)),  # from metres about the world's origin to ideal pixels
        ("speed_threshold", float),  # τ in m/s
        ("body_diffusion", float),  # rad²/s
        ("place_x", float),  # the place in the world, metres
        ("place_y", float),
        ("place_radius", float),  # metres
        ("place_sign", float),  # 1: people are drawn to it, −1: kept from it
        ("group_body_kappa", float),  # concentration of bodies about the direction
        ("group_head_kappa", float),  # of heads
        ("group_outliers", float),  # share of members who face elsewhere
        ("group_body_hold", float),  # cost of a radian's turn
        ("group_head_hold", float),
    ]
)
"""What all frames of a job share."""

LINKS = ("motion_information", "body_turn_kappa", "head_turn_kappa", "steer_gain", "group_hold")
"""Gates of what links a frame to the one before."""

SWITCHED = ("motion_body_kappa", "head_body_kappa", "steer_gain")
"""Gates of what the modes of the couplings switch."""


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
    cost = 0.0
    shared = problem.shared[0]
    if frame.velocity_information > 0.0:
        cost += add_first_velocity(state, frame.velocity_information, gradient, hessian)
    if frame.position_information > 0.0 and not frame.pixel_information > 0.0:
        cost += add_position(
            state,
            problem.origin[track, 0],
            problem.origin[track, 1],
            frame.x,
            frame.y,
            frame.position_information,
            shared.robust,
            shared.robust_threshold,
            exact,
            gradient,
            hessian,
        )
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
    if frame.body_kappa > 0.0:
        cost += add_angle(
            turns[k, 0],
            turns[k, 1],
            BODY,
            frame.seen_body_cos,
            frame.seen_body_sin,
            frame.body_kappa,
            frame.body_uniform,
            exact,
            gradient,
            hessian,
        )
    if frame.body_class_kappa > 0.0:
        cost += add_classes(
            turns[k, 0],
            turns[k, 1],
            BODY,
            problem.body_heights[place],
            problem.body_directions,
            frame.body_class_kappa,
            frame.body_doubt,
            exact,
            gradient,
            hessian,
        )
    if frame.head_kappa > 0.0:
        cost += add_angle(
            turns[k, 2],
            turns[k, 3],
            HEAD,
            frame.seen_head_cos,
            frame.seen_head_sin,
            frame.head_kappa,
            frame.head_uniform,
            exact,
            gradient,
            hessian,
        )
    if frame.head_class_kappa > 0.0:
        cost += add_classes(
            turns[k, 2],
            turns[k, 3],
            HEAD,
            problem.head_heights[place],
            problem.head_directions,
            frame.head_class_kappa,
            frame.head_doubt,
            exact,
            gradient,
            hessian,
        )
    if frame.motion_body_kappa > 0.0:
        cost += add_body_follows_motion(
            state,
            turns[k, 0],
            turns[k, 1],
            frame.motion_body_kappa,
            frame.motion_body_cos,
            frame.motion_body_sin,
            shared.speed_threshold,
            exact,
            gradient,
            hessian,
        )
    if frame.head_body_kappa > 0.0:
        cost += add_head_follows_body(
            turns[k, 0],
            turns[k, 1],
            turns[k, 2],
            turns[k, 3],
            frame.head_body_kappa,
            frame.head_body_cos,
            frame.head_body_sin,
            exact,
            gradient,
            hessian,
        )
    if frame.place_weight > 0.0:
        cost += add_place(
            state,
            problem.origin[track, 0],
            problem.origin[track, 1],
            frame.place_weight,
            shared.place_x,
            shared.place_y,
            shared.place_radius,
            shared.place_sign,
            exact,
            gradient,
            hessian,
        )
    if frame.group_weight > 0.0:
        cost += add_faces_group(
            BODY,
            turns[k, 0],
            turns[k, 1],
            frame.group_weight,
            frame.group_cos,
            frame.group_sin,
            shared.group_body_kappa,
            shared.group_outliers,
            exact,
            gradient,
            hessian,
        )
    if frame.group_weight > 0.0:
        cost += add_faces_group(
            HEAD,
            turns[k, 2],
            turns[k, 3],
            frame.group_weight,
            frame.group_cos,
            frame.group_sin,
            shared.group_head_kappa,
            shared.group_outliers,
            exact,
            gradient,
            hessian,
        )
    if frame.body_anchor > 0.0:
        cost += add_anchor(turns[k, 0], turns[k, 1], BODY, start, frame.body_anchor, exact, gradient, hessian)
    if frame.head_anchor > 0.0:
        cost += add_anchor(turns[k, 2], turns[k, 3], HEAD, start, frame.head_anchor, exact, gradient, hessian)
    return cost


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
    cost = 0.0
    shared = problem.shared[0]
    if frame.motion_information > 0.0 and not frame.steer_gain > 0.0:
        cost += add_motion(
            before,
            state,
            frame.dt,
            frame.motion_information,
            gradient_before,
            gradient,
            hessian_before,
            hessian,
            transition,
        )
    if frame.body_turn_kappa > 0.0:
        cost += add_turn(
            turns[k - 1, 0],
            turns[k - 1, 1],
            turns[k, 0],
            turns[k, 1],
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
        cost += add_turn(
            turns[k - 1, 2],
            turns[k - 1, 3],
            turns[k, 2],
            turns[k, 3],
            HEAD,
            frame.head_turn_kappa,
            exact,
            gradient_before,
            gradient,
            hessian_before,
            hessian,
            transition,
        )
    if frame.steer_gain > 0.0:
        cost += add_steered_motion(
            before,
            state,
            turns[k - 1, 2],
            turns[k - 1, 3],
            frame.dt,
            frame.steer_gain,
            frame.steer_reach,
            frame.steer_place,
            frame.steer_cross,
            frame.steer_spread,
            exact,
            gradient_before,
            gradient,
            hessian_before,
            hessian,
            transition,
        )
    if frame.group_hold > 0.0:
        cost += add_holds(
            turns[k - 1, 0],
            turns[k - 1, 1],
            turns[k, 0],
            turns[k, 1],
            BODY,
            frame.group_hold,
            frame.group_drift,
            shared.group_body_hold,
            exact,
            gradient_before,
            gradient,
            hessian_before,
            hessian,
            transition,
        )
    if frame.group_hold > 0.0:
        cost += add_holds(
            turns[k - 1, 2],
            turns[k - 1, 3],
            turns[k, 2],
            turns[k, 3],
            HEAD,
            frame.group_hold,
            frame.group_drift,
            shared.group_head_hold,
            exact,
            gradient_before,
            gradient,
            hessian_before,
            hessian,
            transition,
        )
    return cost


@compiled
def note_turns(k: int, states: FloatArray, turns: FloatArray) -> None:
    """Cosines and sines of body and head in frame k; ``turns`` is (n, 4)."""
    turns[k, 0], turns[k, 1] = math.cos(states[k, BODY]), math.sin(states[k, BODY])
    turns[k, 2], turns[k, 3] = math.cos(states[k, HEAD]), math.sin(states[k, HEAD])


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
    cost = 0.0
    shared = problem.shared[0]
    if frame.motion_information > 0.0 and not frame.steer_gain > 0.0:
        cost += add_motion(
            before,
            state,
            frame.dt,
            frame.motion_information,
            gradient_before,
            gradient,
            hessian_before,
            hessian,
            transition,
        )
    if frame.body_turn_kappa > 0.0:
        cost += add_turn(
            turns[k - 1, 0],
            turns[k - 1, 1],
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
        cost += add_turn(
            turns[k - 1, 2],
            turns[k - 1, 3],
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
    if frame.steer_gain > 0.0:
        cost += add_steered_motion(
            before,
            state,
            turns[k - 1, 2],
            turns[k - 1, 3],
            frame.dt,
            frame.steer_gain,
            frame.steer_reach,
            frame.steer_place,
            frame.steer_cross,
            frame.steer_spread,
            exact,
            gradient_before,
            gradient,
            hessian_before,
            hessian,
            transition,
        )
    if frame.group_hold > 0.0:
        cost += add_holds(
            turns[k - 1, 0],
            turns[k - 1, 1],
            body_cos,
            body_sin,
            BODY,
            frame.group_hold,
            frame.group_drift,
            shared.group_body_hold,
            exact,
            gradient_before,
            gradient,
            hessian_before,
            hessian,
            transition,
        )
    if frame.group_hold > 0.0:
        cost += add_holds(
            turns[k - 1, 2],
            turns[k - 1, 3],
            head_cos,
            head_sin,
            HEAD,
            frame.group_hold,
            frame.group_drift,
            shared.group_head_hold,
            exact,
            gradient_before,
            gradient,
            hessian_before,
            hessian,
            transition,
        )
    if frame.velocity_information > 0.0:
        cost += add_first_velocity(state, frame.velocity_information, gradient, hessian)
    if frame.position_information > 0.0 and not frame.pixel_information > 0.0:
        cost += add_position(
            state,
            problem.origin[track, 0],
            problem.origin[track, 1],
            frame.x,
            frame.y,
            frame.position_information,
            shared.robust,
            shared.robust_threshold,
            exact,
            gradient,
            hessian,
        )
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
    if frame.body_kappa > 0.0:
        cost += add_angle(
            body_cos,
            body_sin,
            BODY,
            frame.seen_body_cos,
            frame.seen_body_sin,
            frame.body_kappa,
            frame.body_uniform,
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
            frame.body_doubt,
            exact,
            gradient,
            hessian,
        )
    if frame.head_kappa > 0.0:
        cost += add_angle(
            head_cos,
            head_sin,
            HEAD,
            frame.seen_head_cos,
            frame.seen_head_sin,
            frame.head_kappa,
            frame.head_uniform,
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
            frame.head_doubt,
            exact,
            gradient,
            hessian,
        )
    if frame.motion_body_kappa > 0.0:
        cost += add_body_follows_motion(
            state,
            body_cos,
            body_sin,
            frame.motion_body_kappa,
            frame.motion_body_cos,
            frame.motion_body_sin,
            shared.speed_threshold,
            exact,
            gradient,
            hessian,
        )
    if frame.head_body_kappa > 0.0:
        cost += add_head_follows_body(
            body_cos,
            body_sin,
            head_cos,
            head_sin,
            frame.head_body_kappa,
            frame.head_body_cos,
            frame.head_body_sin,
            exact,
            gradient,
            hessian,
        )
    if frame.place_weight > 0.0:
        cost += add_place(
            state,
            problem.origin[track, 0],
            problem.origin[track, 1],
            frame.place_weight,
            shared.place_x,
            shared.place_y,
            shared.place_radius,
            shared.place_sign,
            exact,
            gradient,
            hessian,
        )
    if frame.group_weight > 0.0:
        cost += add_faces_group(
            BODY,
            body_cos,
            body_sin,
            frame.group_weight,
            frame.group_cos,
            frame.group_sin,
            shared.group_body_kappa,
            shared.group_outliers,
            exact,
            gradient,
            hessian,
        )
    if frame.group_weight > 0.0:
        cost += add_faces_group(
            HEAD,
            head_cos,
            head_sin,
            frame.group_weight,
            frame.group_cos,
            frame.group_sin,
            shared.group_head_kappa,
            shared.group_outliers,
            exact,
            gradient,
            hessian,
        )
    if frame.body_anchor > 0.0:
        cost += add_anchor(body_cos, body_sin, BODY, start, frame.body_anchor, exact, gradient, hessian)
    if frame.head_anchor > 0.0:
        cost += add_anchor(head_cos, head_sin, HEAD, start, frame.head_anchor, exact, gradient, hessian)
    return cost


@compiled
def cut(frame: Any) -> None:
    """Take a frame's links to the one before out of its record."""
    frame.motion_information = 0.0
    frame.body_turn_kappa = 0.0
    frame.head_turn_kappa = 0.0
    frame.steer_gain = 0.0
    frame.group_hold = 0.0


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
    """
    shared = problem.shared[0]
    exact = False
    gradient = np.zeros(N)
    hessian = np.zeros((N, N))
    of_body_class_kappa = class_densities(cos, sin, problem.body_directions)
    of_head_class_kappa = class_densities(cos, sin, problem.head_directions)
    for k in range(len(states)):
        place, state, g = problem.offsets[track] + k, states[k], node[k]
        frame = problem.records[place]
        if frame.body_kappa > 0.0:
            add_angle_over(
                frame.seen_body_cos,
                frame.seen_body_sin,
                frame.body_kappa,
                frame.body_uniform,
                cos,
                sin,
                body[g],
            )
        if frame.body_class_kappa > 0.0:
            add_classes_over(
                problem.body_heights[place],
                of_body_class_kappa,
                frame.body_class_kappa,
                frame.body_doubt,
                body[g],
            )
        if frame.head_kappa > 0.0:
            add_angle_over(
                frame.seen_head_cos,
                frame.seen_head_sin,
                frame.head_kappa,
                frame.head_uniform,
                cos,
                sin,
                head[g],
            )
        if frame.head_class_kappa > 0.0:
            add_classes_over(
                problem.head_heights[place],
                of_head_class_kappa,
                frame.head_class_kappa,
                frame.head_doubt,
                head[g],
            )
        if frame.motion_body_kappa > 0.0:
            add_motion_over(state, frame.motion_body_kappa, shared.speed_threshold, cos, sin, body[g])
        if frame.group_weight > 0.0:
            for i in range(len(cos)):
                body[g, i] += add_faces_group(
                    BODY,
                    cos[i],
                    sin[i],
                    frame.group_weight,
                    frame.group_cos,
                    frame.group_sin,
                    shared.group_body_kappa,
                    shared.group_outliers,
                    exact,
                    gradient,
                    hessian,
                )
        if frame.group_weight > 0.0:
            for i in range(len(cos)):
                head[g, i] += add_faces_group(
                    HEAD,
                    cos[i],
                    sin[i],
                    frame.group_weight,
                    frame.group_cos,
                    frame.group_sin,
                    shared.group_head_kappa,
                    shared.group_outliers,
                    exact,
                    gradient,
                    hessian,
                )


@allocating
def set_quarters(problem: Problem, track: int, states: FloatArray, quarters: FloatArray) -> None:
    """What each frame costs with body or head as they are, and one, two and three quarters on.

    A row of ``quarters`` (n, 12) becomes the four costs of the body, those of the head, and the cosines and
    sines of body and head as they are.
    """
    body, head = np.empty(4), np.empty(4)
    shared = problem.shared[0]
    exact = False
    gradient = np.zeros(N)
    hessian = np.zeros((N, N))
    turns = np.empty((4, 4))
    for k in range(len(states)):
        place, state = problem.offsets[track] + k, states[k]
        frame = problem.records[place]
        body_cos, body_sin = math.cos(state[BODY]), math.sin(state[BODY])
        head_cos, head_sin = math.cos(state[HEAD]), math.sin(state[HEAD])
        body[:] = 0.0
        head[:] = 0.0
        turns[0, 0], turns[0, 1], turns[0, 2], turns[0, 3] = body_cos, -body_sin, -body_cos, body_sin
        turns[1, 0], turns[1, 1], turns[1, 2], turns[1, 3] = body_sin, body_cos, -body_sin, -body_cos
        turns[2, 0], turns[2, 1], turns[2, 2], turns[2, 3] = head_cos, -head_sin, -head_cos, head_sin
        turns[3, 0], turns[3, 1], turns[3, 2], turns[3, 3] = head_sin, head_cos, -head_sin, -head_cos
        if frame.body_kappa > 0.0:
            add_angle_quarters(
                frame.seen_body_cos,
                frame.seen_body_sin,
                frame.body_kappa,
                frame.body_uniform,
                body_cos,
                body_sin,
                body,
            )
        if frame.body_class_kappa > 0.0:
            add_class_quarters(
                body_cos,
                body_sin,
                problem.body_heights[place],
                problem.body_directions,
                frame.body_class_kappa,
                frame.body_doubt,
                body,
            )
        if frame.head_kappa > 0.0:
            add_angle_quarters(
                frame.seen_head_cos,
                frame.seen_head_sin,
                frame.head_kappa,
                frame.head_uniform,
                head_cos,
                head_sin,
                head,
            )
        if frame.head_class_kappa > 0.0:
            add_class_quarters(
                head_cos,
                head_sin,
                problem.head_heights[place],
                problem.head_directions,
                frame.head_class_kappa,
                frame.head_doubt,
                head,
            )
        if frame.motion_body_kappa > 0.0:
            add_motion_quarters(
                state, frame.motion_body_kappa, shared.speed_threshold, body_cos, body_sin, body
            )
        if frame.group_weight > 0.0:
            for i in range(4):
                body[i] += add_faces_group(
                    BODY,
                    turns[0, i],
                    turns[1, i],
                    frame.group_weight,
                    frame.group_cos,
                    frame.group_sin,
                    shared.group_body_kappa,
                    shared.group_outliers,
                    exact,
                    gradient,
                    hessian,
                )
        if frame.group_weight > 0.0:
            for i in range(4):
                head[i] += add_faces_group(
                    HEAD,
                    turns[2, i],
                    turns[3, i],
                    frame.group_weight,
                    frame.group_cos,
                    frame.group_sin,
                    shared.group_head_kappa,
                    shared.group_outliers,
                    exact,
                    gradient,
                    hessian,
                )
        for q in range(4):
            quarters[k, q], quarters[k, 4 + q] = body[q], head[q]
        quarters[k, 8], quarters[k, 9] = body_cos, body_sin
        quarters[k, 10], quarters[k, 11] = head_cos, head_sin
