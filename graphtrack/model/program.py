"""The frame program of the presets' terms, with its kernels.

Written by `graphtrack.model.generator`; not to be edited.
"""
# fmt: off
# ruff: noqa
# mypy: ignore-errors

from __future__ import annotations

import math
from typing import Any

from graphtrack.kernels.compilation import compiled
from graphtrack.kernels.layout import BODY, HEAD, LINKS, OWN, Chain, Sums


@compiled
def add_white_noise_acceleration(before: Any, dt: Any, exact: Any, number_motion_information: Any, state: Any, sums: Any) -> float:
    x = state[0]
    y = state[1]
    vx = state[2]
    vy = state[3]
    x_before = before[0]
    y_before = before[1]
    vx_before = before[2]
    vy_before = before[3]
    gradient = sums.gradient
    gradient_before = sums.gradient_before
    hessian = sums.hessian
    hessian_before = sums.hessian_before
    transition = sums.transition
    step_0 = math.sqrt(number_motion_information)
    step_1 = step_0/math.sqrt(dt)
    step_2 = (1/2)*dt
    step_3 = math.sqrt(3)
    step_4 = 2*step_0*step_3/math.sqrt(dt)**(3)
    step_5 = -step_1
    step_6 = -step_1*step_3
    step_7 = -step_4
    r0 = step_1*(vx - vx_before)
    r1 = step_4*(-step_2*(vx + vx_before) + x - x_before)
    r2 = step_1*(vy - vy_before)
    r3 = step_4*(-step_2*(vy + vy_before) + y - y_before)
    j0_2 = step_1
    j0_6 = step_5
    j1_0 = step_4
    j1_2 = step_6
    j1_4 = step_7
    j1_6 = step_6
    j2_3 = step_1
    j2_7 = step_5
    j3_1 = step_4
    j3_3 = step_6
    j3_5 = step_7
    j3_7 = step_6
    cost = (1/2)*r0**2 + (1/2)*r1**2 + (1/2)*r2**2 + (1/2)*r3**2
    gradient[0] += j1_0*r1
    hessian[0, 0] += j1_0**2
    gradient[1] += j3_1*r3
    hessian[1, 1] += j3_1**2
    gradient[2] += j0_2*r0 + j1_2*r1
    hessian[2, 0] += j1_0*j1_2
    hessian[2, 2] += j0_2**2 + j1_2**2
    gradient[3] += j2_3*r2 + j3_3*r3
    hessian[3, 1] += j3_1*j3_3
    hessian[3, 3] += j2_3**2 + j3_3**2
    gradient_before[0] += j1_4*r1
    transition[0, 0] += j1_0*j1_4
    transition[0, 2] += j1_2*j1_4
    hessian_before[0, 0] += j1_4**2
    gradient_before[1] += j3_5*r3
    transition[1, 1] += j3_1*j3_5
    transition[1, 3] += j3_3*j3_5
    hessian_before[1, 1] += j3_5**2
    gradient_before[2] += j0_6*r0 + j1_6*r1
    transition[2, 0] += j1_0*j1_6
    transition[2, 2] += j0_2*j0_6 + j1_2*j1_6
    hessian_before[2, 0] += j1_4*j1_6
    hessian_before[2, 2] += j0_6**2 + j1_6**2
    gradient_before[3] += j2_7*r2 + j3_7*r3
    transition[3, 1] += j3_1*j3_7
    transition[3, 3] += j2_3*j2_7 + j3_3*j3_7
    hessian_before[3, 1] += j3_5*j3_7
    hessian_before[3, 3] += j2_7**2 + j3_7**2
    return cost


@compiled
def add_first_velocity(exact: Any, number_velocity_information: Any, state: Any, sums: Any) -> float:
    vx = state[2]
    vy = state[3]
    gradient = sums.gradient
    hessian = sums.hessian
    step_0 = math.sqrt(number_velocity_information)
    r0 = step_0*vx
    r1 = step_0*vy
    j0_0 = step_0
    j1_1 = step_0
    cost = (1/2)*r0**2 + (1/2)*r1**2
    gradient[2] += j0_0*r0
    hessian[2, 2] += j0_0**2
    gradient[3] += j1_1*r1
    hessian[3, 3] += j1_1**2
    return cost


@compiled
def add_observed_position(exact: Any, number_information: Any, number_robust: Any, number_robust_threshold: Any, number_x: Any, number_y: Any, origin_x: Any, origin_y: Any, state: Any, sums: Any) -> float:
    x = state[0]
    y = state[1]
    number_x = number_x - origin_x
    number_y = number_y - origin_y
    gradient = sums.gradient
    hessian = sums.hessian
    step_0 = math.sqrt(number_information)
    r0 = step_0*(-number_x + x)
    r1 = step_0*(-number_y + y)
    j0_0 = step_0
    j1_1 = step_0
    half = (1/2)*r0**2 + (1/2)*r1**2
    weight = ((1/(2*half/number_robust_threshold**2 + 1)) if (number_robust > 1.5) else ((((1/2)*math.sqrt(2)*number_robust_threshold/math.sqrt(half)) if (half > (1/2)*number_robust_threshold**2) else (1))) if (number_robust > 0.5) else (1))
    bend = ((-2/(number_robust_threshold**2*(2*half/number_robust_threshold**2 + 1)**2)) if (number_robust > 1.5) else (((-1/4*math.sqrt(2)*number_robust_threshold/math.sqrt(half)**(3)) if (half > (1/2)*number_robust_threshold**2) else (0))) if (number_robust > 0.5) else (0))
    pull0 = j0_0*r0
    pull1 = j1_1*r1
    cost = (((1/2)*number_robust_threshold**2*math.log(2*half/number_robust_threshold**2 + 1)) if (number_robust > 1.5) else (((math.sqrt(2)*math.sqrt(half)*number_robust_threshold - 1/2*number_robust_threshold**2) if (half > (1/2)*number_robust_threshold**2) else (half))) if (number_robust > 0.5) else (half))
    gradient[0] += pull0*weight
    hessian[0, 0] += j0_0**2*weight
    gradient[1] += pull1*weight
    hessian[1, 1] += j1_1**2*weight
    if exact:
        hessian[0, 0] += bend*pull0**2
        hessian[1, 0] += bend*pull0*pull1
        hessian[1, 1] += bend*pull1**2
    return cost


@compiled
def add_observed_pixel(exact: Any, number_information: Any, number_robust: Any, number_robust_threshold: Any, number_to_image: Any, number_u: Any, number_v: Any, origin_x: Any, origin_y: Any, state: Any, sums: Any) -> float:
    x = state[0] + origin_x
    y = state[1] + origin_y
    gradient = sums.gradient
    hessian = sums.hessian
    step_0 = math.sqrt(number_information)
    step_1 = number_to_image[0, 0]*x + number_to_image[0, 1]*y + number_to_image[0, 2]
    step_2 = number_to_image[2, 0]*x + number_to_image[2, 1]*y + number_to_image[2, 2]
    step_3 = 1/step_2
    step_4 = number_to_image[1, 0]*x + number_to_image[1, 1]*y + number_to_image[1, 2]
    step_5 = step_2**(-2)
    step_6 = step_1*step_5
    step_7 = step_4*step_5
    step_8 = step_1*step_3
    step_9 = number_to_image[2, 0]*step_8
    step_10 = step_0*step_5
    step_11 = 2*step_10
    step_12 = number_to_image[2, 0]*step_11
    step_13 = step_3*step_4
    step_14 = number_to_image[2, 0]*step_13
    step_15 = 2*number_to_image[2, 1]
    step_16 = number_to_image[2, 1]*step_11
    r0 = step_0*(-number_u + step_1*step_3)
    r1 = step_0*(-number_v + step_3*step_4)
    j0_0 = step_0*(number_to_image[0, 0]*step_3 - number_to_image[2, 0]*step_6)
    j0_1 = step_0*(number_to_image[0, 1]*step_3 - number_to_image[2, 1]*step_6)
    j1_0 = step_0*(number_to_image[1, 0]*step_3 - number_to_image[2, 0]*step_7)
    j1_1 = step_0*(number_to_image[1, 1]*step_3 - number_to_image[2, 1]*step_7)
    half = (1/2)*r0**2 + (1/2)*r1**2
    weight = ((1/(2*half/number_robust_threshold**2 + 1)) if (number_robust > 1.5) else ((((1/2)*math.sqrt(2)*number_robust_threshold/math.sqrt(half)) if (half > (1/2)*number_robust_threshold**2) else (1))) if (number_robust > 0.5) else (1))
    bend = ((-2/(number_robust_threshold**2*(2*half/number_robust_threshold**2 + 1)**2)) if (number_robust > 1.5) else (((-1/4*math.sqrt(2)*number_robust_threshold/math.sqrt(half)**(3)) if (half > (1/2)*number_robust_threshold**2) else (0))) if (number_robust > 0.5) else (0))
    pull0 = j0_0*r0 + j1_0*r1
    pull1 = j0_1*r0 + j1_1*r1
    c0_0_0 = -step_12*(number_to_image[0, 0] - step_9)
    c1_0_0 = -step_12*(number_to_image[1, 0] - step_14)
    c0_1_0 = -step_10*(number_to_image[0, 0]*number_to_image[2, 1] + number_to_image[0, 1]*number_to_image[2, 0] - step_15*step_9)
    c1_1_0 = -step_10*(number_to_image[1, 0]*number_to_image[2, 1] + number_to_image[1, 1]*number_to_image[2, 0] - step_14*step_15)
    c0_1_1 = -step_16*(number_to_image[0, 1] - number_to_image[2, 1]*step_8)
    c1_1_1 = -step_16*(number_to_image[1, 1] - number_to_image[2, 1]*step_13)
    cost = (((1/2)*number_robust_threshold**2*math.log(2*half/number_robust_threshold**2 + 1)) if (number_robust > 1.5) else (((math.sqrt(2)*math.sqrt(half)*number_robust_threshold - 1/2*number_robust_threshold**2) if (half > (1/2)*number_robust_threshold**2) else (half))) if (number_robust > 0.5) else (half))
    gradient[0] += pull0*weight
    hessian[0, 0] += weight*(j0_0**2 + j1_0**2)
    gradient[1] += pull1*weight
    hessian[1, 0] += weight*(j0_0*j0_1 + j1_0*j1_1)
    hessian[1, 1] += weight*(j0_1**2 + j1_1**2)
    if exact:
        hessian[0, 0] += bend*pull0**2 + c0_0_0*r0*weight + c1_0_0*r1*weight
        hessian[1, 0] += bend*pull0*pull1 + c0_1_0*r0*weight + c1_1_0*r1*weight
        hessian[1, 1] += bend*pull1**2 + c0_1_1*r0*weight + c1_1_1*r1*weight
    return cost


@compiled
def add_observed_ellipse(exact: Any, number_robust: Any, number_robust_threshold: Any, number_root_xx: Any, number_root_xy: Any, number_root_yy: Any, number_x: Any, number_y: Any, origin_x: Any, origin_y: Any, state: Any, sums: Any) -> float:
    x = state[0]
    y = state[1]
    number_x = number_x - origin_x
    number_y = number_y - origin_y
    gradient = sums.gradient
    hessian = sums.hessian
    step_0 = -number_y + y
    r0 = number_root_xx*(-number_x + x) + number_root_xy*step_0
    r1 = number_root_yy*step_0
    j0_0 = number_root_xx
    j0_1 = number_root_xy
    j1_1 = number_root_yy
    half = (1/2)*r0**2 + (1/2)*r1**2
    weight = ((1/(2*half/number_robust_threshold**2 + 1)) if (number_robust > 1.5) else ((((1/2)*math.sqrt(2)*number_robust_threshold/math.sqrt(half)) if (half > (1/2)*number_robust_threshold**2) else (1))) if (number_robust > 0.5) else (1))
    bend = ((-2/(number_robust_threshold**2*(2*half/number_robust_threshold**2 + 1)**2)) if (number_robust > 1.5) else (((-1/4*math.sqrt(2)*number_robust_threshold/math.sqrt(half)**(3)) if (half > (1/2)*number_robust_threshold**2) else (0))) if (number_robust > 0.5) else (0))
    pull0 = j0_0*r0
    pull1 = j0_1*r0 + j1_1*r1
    cost = (((1/2)*number_robust_threshold**2*math.log(2*half/number_robust_threshold**2 + 1)) if (number_robust > 1.5) else (((math.sqrt(2)*math.sqrt(half)*number_robust_threshold - 1/2*number_robust_threshold**2) if (half > (1/2)*number_robust_threshold**2) else (half))) if (number_robust > 0.5) else (half))
    gradient[0] += pull0*weight
    hessian[0, 0] += j0_0**2*weight
    gradient[1] += pull1*weight
    hessian[1, 0] += j0_0*j0_1*weight
    hessian[1, 1] += weight*(j0_1**2 + j1_1**2)
    if exact:
        hessian[0, 0] += bend*pull0**2
        hessian[1, 0] += bend*pull0*pull1
        hessian[1, 1] += bend*pull1**2
    return cost


@compiled
def add_observed_velocity(exact: Any, number_root_xx: Any, number_root_xy: Any, number_root_yy: Any, number_vx: Any, number_vy: Any, state: Any, sums: Any) -> float:
    vx = state[2]
    vy = state[3]
    gradient = sums.gradient
    hessian = sums.hessian
    step_0 = -number_vy + vy
    r0 = number_root_xx*(-number_vx + vx) + number_root_xy*step_0
    r1 = number_root_yy*step_0
    j0_0 = number_root_xx
    j0_1 = number_root_xy
    j1_1 = number_root_yy
    cost = (1/2)*r0**2 + (1/2)*r1**2
    gradient[2] += j0_0*r0
    hessian[2, 2] += j0_0**2
    gradient[3] += j0_1*r0 + j1_1*r1
    hessian[3, 2] += j0_0*j0_1
    hessian[3, 3] += j0_1**2 + j1_1**2
    return cost


@compiled
def add_turning(angle_cos: Any, angle_cos_before: Any, angle_sin: Any, angle_sin_before: Any, exact: Any, number_kappa: Any, place: Any, sums: Any) -> float:
    gradient = sums.gradient
    gradient_before = sums.gradient_before
    hessian = sums.hessian
    hessian_before = sums.hessian_before
    transition = sums.transition
    step_0 = angle_cos*angle_cos_before + angle_sin*angle_sin_before
    step_1 = step_0 - 1
    step_2 = angle_cos*angle_sin_before - angle_cos_before*angle_sin
    step_3 = number_kappa*step_1
    cost = -number_kappa*step_1
    gradient[place] += -number_kappa*step_2
    hessian[place, place] += number_kappa
    gradient_before[place] += number_kappa*step_2
    transition[place, place] += -number_kappa*step_0
    hessian_before[place, place] += number_kappa
    if exact:
        hessian[place, place] += step_3
        hessian_before[place, place] += step_3
    return cost


@compiled
def add_observed_angle(angle_cos: Any, angle_sin: Any, exact: Any, number_cos: Any, number_kappa: Any, number_sin: Any, place: Any, sums: Any) -> float:
    gradient = sums.gradient
    hessian = sums.hessian
    step_0 = angle_cos*number_cos + angle_sin*number_sin - 1
    cost = -number_kappa*step_0
    gradient[place] += number_kappa*(-angle_cos*number_sin + angle_sin*number_cos)
    hessian[place, place] += number_kappa
    if exact:
        hessian[place, place] += number_kappa*step_0
    return cost


@compiled
def cost_observed_angle(angle_cos: Any, angle_sin: Any, number_cos: Any, number_kappa: Any, number_sin: Any) -> float:
    step_0 = (1/2)*number_kappa
    cost = step_0*(angle_cos - number_cos)**2 + step_0*(angle_sin - number_sin)**2
    return cost


@compiled
def add_doubtful_angle(angle_cos: Any, angle_sin: Any, exact: Any, number_cos: Any, number_kappa: Any, number_sin: Any, number_uniform: Any, place: Any, sums: Any) -> float:
    gradient = sums.gradient
    hessian = sums.hessian
    step_0 = math.sqrt(number_kappa)
    step_1 = -angle_sin*step_0
    step_2 = angle_cos*step_0
    r0 = step_0*(angle_cos - number_cos)
    r1 = step_0*(angle_sin - number_sin)
    j0_0 = step_1
    j1_0 = step_2
    half = (1/2)*r0**2 + (1/2)*r1**2
    weight = math.exp(-half)/(number_uniform + math.exp(-half))
    bend = (-1 + math.exp(-half)/(number_uniform + math.exp(-half)))*math.exp(-half)/(number_uniform + math.exp(-half))
    pull0 = j0_0*r0 + j1_0*r1
    c0_0_0 = -step_2
    c1_0_0 = step_1
    cost = -math.log((number_uniform + math.exp(-half))/(number_uniform + 1)) + math.log(2)
    gradient[place] += pull0*weight
    hessian[place, place] += weight*(j0_0**2 + j1_0**2)
    if exact:
        hessian[place, place] += bend*pull0**2 + c0_0_0*r0*weight + c1_0_0*r1*weight
    return cost


@compiled
def cost_doubtful_angle(angle_cos: Any, angle_sin: Any, number_cos: Any, number_kappa: Any, number_sin: Any, number_uniform: Any) -> float:
    step_0 = (1/2)*number_kappa
    cost = -math.log((number_uniform + math.exp(-step_0*(angle_cos - number_cos)**2 - step_0*(angle_sin - number_sin)**2))/(number_uniform + 1)) + math.log(2)
    return cost


@compiled
def add_observed_classes_8(angle_cos: Any, angle_sin: Any, exact: Any, number_heights: Any, number_kappa: Any, place: Any, sums: Any) -> float:
    gradient = sums.gradient
    hessian = sums.hessian
    step_0 = number_heights[0]*math.exp(number_kappa*(angle_cos - 1))
    step_1 = number_heights[2]*math.exp(number_kappa*(angle_sin - 1))
    step_2 = angle_cos + 1
    step_3 = number_heights[4]*math.exp(-number_kappa*step_2)
    step_4 = angle_sin + 1
    step_5 = number_heights[6]*math.exp(-number_kappa*step_4)
    step_6 = (1/2)*math.sqrt(2)
    step_7 = angle_cos*step_6
    step_8 = angle_sin*step_6
    step_9 = step_7 + step_8
    step_10 = number_heights[1]*math.exp(number_kappa*(step_9 - 1))
    step_11 = step_7 - step_8
    step_12 = step_11 + 1
    step_13 = number_heights[3]*math.exp(-number_kappa*step_12)
    step_14 = step_9 + 1
    step_15 = number_heights[5]*math.exp(-number_kappa*step_14)
    step_16 = -step_7 + step_8 + 1
    step_17 = number_heights[7]*math.exp(-number_kappa*step_16)
    step_18 = number_heights[8] + step_0 + step_1 + step_10 + step_13 + step_15 + step_17 + step_3 + step_5
    step_19 = angle_cos*number_kappa
    step_20 = angle_sin*number_kappa
    step_21 = number_kappa*step_10
    step_22 = number_heights[4]*math.exp(-number_kappa*step_2)
    step_23 = number_heights[6]*math.exp(-number_kappa*step_4)
    step_24 = angle_cos**2*number_kappa
    step_25 = angle_sin**2*number_kappa
    step_26 = angle_cos + angle_sin
    step_27 = step_10*step_6
    step_28 = number_heights[5]*math.exp(-number_kappa*step_14)
    step_29 = (1/2)*number_kappa
    step_30 = step_26**2*step_29
    step_31 = number_heights[3]*math.exp(-number_kappa*step_12)
    step_32 = number_heights[7]*math.exp(-number_kappa*step_16)
    step_33 = -angle_cos + angle_sin
    step_34 = step_33**2
    step_35 = step_33*step_6
    step_36 = step_17*step_6
    step_37 = step_13*step_6
    step_38 = -step_15*step_6 + step_27
    inner = step_18
    slope = -number_kappa*step_11*step_15 + number_kappa*step_13*step_9 - number_kappa*step_17*step_9 - step_0*step_20 + step_1*step_19 + step_11*step_21 - step_19*step_5 + step_20*step_3
    bend = number_kappa*(-angle_cos*step_0 + angle_cos*step_22 - angle_sin*step_1 + angle_sin*step_23 + step_0*step_25 + step_1*step_24 + (1/2)*step_21*step_34 + step_22*step_25 + step_23*step_24 - step_26*step_27 + step_26*step_28*step_6 + step_28*step_29*step_34 + step_30*step_31 + step_30*step_32 - step_31*step_35 + step_32*step_35)
    cost = 2*number_kappa - math.log(inner)
    curve = -bend/inner + slope**2/inner**2
    least = step_29*math.sqrt((step_0 - step_3 + step_36 - step_37 + step_38)**2 + (step_1 - step_36 + step_37 + step_38 - step_5)**2)/step_18
    gradient[place] += -slope/inner
    hessian[place, place] += curve + max(0, -curve + least)
    if exact:
        hessian[place, place] += -max(0, -curve + least)
    return cost


@compiled
def cost_observed_classes_8(angle_cos: Any, angle_sin: Any, number_heights: Any, number_kappa: Any) -> float:
    step_0 = (1/2)*math.sqrt(2)
    step_1 = angle_cos*step_0
    step_2 = angle_sin*step_0
    step_3 = step_1 + step_2
    cost = 2*number_kappa - math.log(number_heights[0]*math.exp(number_kappa*(angle_cos - 1)) + number_heights[1]*math.exp(number_kappa*(step_3 - 1)) + number_heights[2]*math.exp(number_kappa*(angle_sin - 1)) + number_heights[3]*math.exp(number_kappa*(-step_1 + step_2 - 1)) + number_heights[4]*math.exp(number_kappa*(-angle_cos - 1)) + number_heights[5]*math.exp(number_kappa*(-step_3 - 1)) + number_heights[6]*math.exp(number_kappa*(-angle_sin - 1)) + number_heights[7]*math.exp(number_kappa*(step_1 - step_2 - 1)) + number_heights[8])
    return cost


@compiled
def add_observed_axis(angle_cos: Any, angle_sin: Any, exact: Any, number_cos: Any, number_kappa: Any, number_sin: Any, place: Any, sums: Any) -> float:
    gradient = sums.gradient
    hessian = sums.hessian
    step_0 = angle_cos*angle_sin
    step_1 = angle_cos**2
    step_2 = 2*number_cos*step_1 - number_cos + 2*number_sin*step_0 - 1
    cost = -1/4*number_kappa*step_2
    gradient[place] += number_kappa*(number_cos*step_0 - number_sin*step_1 + (1/2)*number_sin)
    hessian[place, place] += number_kappa
    if exact:
        hessian[place, place] += number_kappa*step_2
    return cost


@compiled
def cost_observed_axis(angle_cos: Any, angle_sin: Any, number_cos: Any, number_kappa: Any, number_sin: Any) -> float:
    step_0 = (1/8)*number_kappa
    cost = step_0*(2*angle_cos*angle_sin - number_sin)**2 + step_0*(angle_cos**2 - angle_sin**2 - number_cos)**2
    return cost


@compiled
def add_observed_classes_12(angle_cos: Any, angle_sin: Any, exact: Any, number_heights: Any, number_kappa: Any, place: Any, sums: Any) -> float:
    gradient = sums.gradient
    hessian = sums.hessian
    step_0 = number_heights[0]*math.exp(number_kappa*(angle_cos - 1))
    step_1 = math.exp(number_kappa*(angle_sin - 1))
    step_2 = number_heights[3]*step_1
    step_3 = angle_cos + 1
    step_4 = number_heights[6]*math.exp(-number_kappa*step_3)
    step_5 = angle_sin + 1
    step_6 = number_heights[9]*math.exp(-number_kappa*step_5)
    step_7 = (1/2)*angle_cos
    step_8 = math.sqrt(3)
    step_9 = (1/2)*angle_sin
    step_10 = step_8*step_9
    step_11 = step_10 - step_7 + 1
    step_12 = number_heights[10]*math.exp(-number_kappa*step_11)
    step_13 = step_7*step_8
    step_14 = -step_13 + step_9 + 1
    step_15 = number_heights[11]*math.exp(-number_kappa*step_14)
    step_16 = step_13 + step_9
    step_17 = math.exp(number_kappa*(step_16 - 1))
    step_18 = number_heights[1]*step_17
    step_19 = step_10 + step_7
    step_20 = math.exp(number_kappa*(step_19 - 1))
    step_21 = number_heights[2]*step_20
    step_22 = -step_10 + step_7
    step_23 = step_22 + 1
    step_24 = math.exp(-number_kappa*step_23)
    step_25 = number_heights[4]*step_24
    step_26 = step_13 - step_9
    step_27 = step_26 + 1
    step_28 = math.exp(-number_kappa*step_27)
    step_29 = number_heights[5]*step_28
    step_30 = step_16 + 1
    step_31 = number_heights[7]*math.exp(-number_kappa*step_30)
    step_32 = step_19 + 1
    step_33 = number_heights[8]*math.exp(-number_kappa*step_32)
    step_34 = number_heights[12] + step_0 + step_12 + step_15 + step_18 + step_2 + step_21 + step_25 + step_29 + step_31 + step_33 + step_4 + step_6
    step_35 = angle_cos*number_kappa
    step_36 = angle_sin*number_kappa
    step_37 = number_kappa*step_18
    step_38 = number_kappa*step_21
    step_39 = number_heights[6]*math.exp(-number_kappa*step_3)
    step_40 = number_heights[9]*math.exp(-number_kappa*step_5)
    step_41 = angle_cos**2*number_kappa
    step_42 = angle_sin**2*number_kappa
    step_43 = angle_cos*step_8
    step_44 = angle_sin + step_43
    step_45 = (1/2)*step_18
    step_46 = angle_cos + angle_sin*step_8
    step_47 = (1/2)*step_21
    step_48 = number_heights[7]*math.exp(-number_kappa*step_30)
    step_49 = number_heights[8]*math.exp(-number_kappa*step_32)
    step_50 = angle_sin - step_43
    step_51 = (1/2)*step_50
    step_52 = number_heights[11]*math.exp(-number_kappa*step_14)
    step_53 = number_heights[5]*math.exp(-number_kappa*step_27)
    step_54 = -angle_cos + angle_sin*step_8
    step_55 = (1/2)*step_54
    step_56 = number_heights[10]*math.exp(-number_kappa*step_11)
    step_57 = number_heights[4]*math.exp(-number_kappa*step_23)
    step_58 = (1/4)*number_kappa
    step_59 = step_44**2*step_58
    step_60 = step_46**2*step_58
    step_61 = step_50**2
    step_62 = step_54**2
    step_63 = (1/2)*step_12
    step_64 = (1/2)*step_33
    step_65 = (1/2)*step_15
    step_66 = (1/2)*step_31
    inner = step_34
    slope = -number_kappa*step_12*step_16 - number_kappa*step_15*step_19 + number_kappa*step_16*step_25 + number_kappa*step_19*step_29 - number_kappa*step_22*step_31 - number_kappa*step_26*step_33 - step_0*step_36 + step_2*step_35 + step_22*step_37 + step_26*step_38 - step_35*step_6 + step_36*step_4
    bend = number_kappa*(-angle_cos*step_0 + angle_cos*step_39 - angle_sin*step_2 + angle_sin*step_40 + step_0*step_42 + step_2*step_41 + (1/4)*step_37*step_62 + (1/4)*step_38*step_61 + step_39*step_42 + step_40*step_41 - step_44*step_45 + (1/2)*step_44*step_48 - step_46*step_47 + (1/2)*step_46*step_49 + step_48*step_58*step_62 + step_49*step_58*step_61 + step_51*step_52 - step_51*step_53 + step_52*step_60 + step_53*step_60 + step_55*step_56 - step_55*step_57 + step_56*step_59 + step_57*step_59)
    cost = 2*number_kappa - math.log(inner)
    curve = -bend/inner + slope**2/inner**2
    least = (1/2)*number_kappa*math.sqrt((step_0 - 1/2*step_25 - 1/2*step_29*step_8 - step_4 + step_45*step_8 + step_47 + step_63 - step_64 + step_65*step_8 - step_66*step_8)**2 + ((1/2)*number_heights[1]*step_17 + (1/2)*number_heights[2]*step_20*step_8 + number_heights[3]*step_1 + (1/2)*number_heights[4]*step_24*step_8 + (1/2)*number_heights[5]*step_28 - step_6 - step_63*step_8 - step_64*step_8 - step_65 - step_66)**2)/step_34
    gradient[place] += -slope/inner
    hessian[place, place] += curve + max(0, -curve + least)
    if exact:
        hessian[place, place] += -max(0, -curve + least)
    return cost


@compiled
def cost_observed_classes_12(angle_cos: Any, angle_sin: Any, number_heights: Any, number_kappa: Any) -> float:
    step_0 = (1/2)*angle_cos
    step_1 = math.sqrt(3)
    step_2 = (1/2)*angle_sin
    step_3 = step_1*step_2
    step_4 = step_3 + 1
    step_5 = step_0*step_1
    step_6 = step_2 + 1
    cost = 2*number_kappa - math.log(number_heights[0]*math.exp(number_kappa*(angle_cos - 1)) + number_heights[10]*math.exp(number_kappa*(step_0 - step_4)) + number_heights[11]*math.exp(number_kappa*(step_5 - step_6)) + number_heights[12] + number_heights[1]*math.exp(number_kappa*(step_2 + step_5 - 1)) + number_heights[2]*math.exp(number_kappa*(step_0 + step_3 - 1)) + number_heights[3]*math.exp(number_kappa*(angle_sin - 1)) + number_heights[4]*math.exp(number_kappa*(-step_0 + step_3 - 1)) + number_heights[5]*math.exp(number_kappa*(step_2 - step_5 - 1)) + number_heights[6]*math.exp(number_kappa*(-angle_cos - 1)) + number_heights[7]*math.exp(number_kappa*(-step_5 - step_6)) + number_heights[8]*math.exp(number_kappa*(-step_0 - step_4)) + number_heights[9]*math.exp(number_kappa*(-angle_sin - 1)))
    return cost


@compiled
def add_body_follows_motion(body_cos: Any, body_sin: Any, exact: Any, number_kappa: Any, number_speed_threshold: Any, state: Any, sums: Any) -> float:
    vx = state[2]
    vy = state[3]
    if not ((-number_speed_threshold + math.sqrt(vx**2 + vy**2) > 0) and (math.sqrt(vx**2 + vy**2) > 0)):
        return 0.0
    gradient = sums.gradient
    hessian = sums.hessian
    step_0 = vx**2
    step_1 = vy**2
    step_2 = step_0 + step_1
    step_3 = math.sqrt(step_2)
    step_4 = 1/step_3
    step_5 = step_4*vx
    step_6 = body_cos - step_5
    step_7 = math.sqrt(number_kappa)
    step_8 = number_speed_threshold - step_3
    step_9 = -step_7*step_8
    step_10 = step_4*vy
    step_11 = body_sin - step_10
    step_12 = step_6*step_7
    step_13 = -step_4
    step_14 = math.sqrt(step_2)**(-3)
    step_15 = step_14*vx
    step_16 = step_15*step_9*vy
    step_17 = step_11*step_7
    step_18 = 1/step_2
    step_19 = step_0*step_18
    step_20 = step_19 - 1
    step_21 = 2*step_18
    step_22 = -step_6
    step_23 = step_22*step_4
    step_24 = step_14*step_8
    step_25 = step_24*vx
    step_26 = step_2**(-2)
    step_27 = step_0*step_26
    step_28 = -step_11
    step_29 = step_28*step_4
    step_30 = step_24*(3*step_19 - 1)
    step_31 = step_1*step_26
    step_32 = step_1*step_18
    step_33 = step_32 - 1
    step_34 = step_5*step_7
    step_35 = step_10*step_7
    step_36 = step_7*step_8
    r0 = step_6*step_9
    r1 = step_11*step_9
    j0_0 = step_12*step_5 + step_9*(step_0*step_14 + step_13)
    j0_1 = step_10*step_12 + step_16
    j0_2 = -body_sin*step_9
    j1_0 = step_16 + step_17*step_5
    j1_1 = step_10*step_17 + step_9*(step_1*step_14 + step_13)
    j1_2 = body_cos*step_9
    c0_0_0 = step_20*step_7*(step_21*vx + step_23 + 3*step_25)
    c1_0_0 = step_7*(step_20*step_29 + 2*step_27*vy + step_30*vy)
    c0_1_0 = step_7*vy*(step_15*step_22 + step_18*step_20 + step_27 + step_30)
    c1_1_0 = step_7*vx*(3*step_1*step_8/math.sqrt(step_2)**(5) + step_14*step_28*vy + step_18*step_33 - step_24 + step_31)
    c0_1_1 = step_7*(step_23*step_33 + step_25*(3*step_32 - 1) + 2*step_31*vx)
    c1_1_1 = step_33*step_7*(step_21*vy + 3*step_24*vy + step_29)
    c0_2_0 = -body_sin*step_34
    c1_2_0 = body_cos*step_34
    c0_2_1 = -body_sin*step_35
    c1_2_1 = body_cos*step_35
    c0_2_2 = body_cos*step_36
    c1_2_2 = body_sin*step_36
    cost = (1/2)*r0**2 + (1/2)*r1**2
    gradient[2] += j0_0*r0 + j1_0*r1
    hessian[2, 2] += j0_0**2 + j1_0**2
    gradient[3] += j0_1*r0 + j1_1*r1
    hessian[3, 2] += j0_0*j0_1 + j1_0*j1_1
    hessian[3, 3] += j0_1**2 + j1_1**2
    gradient[4] += j0_2*r0 + j1_2*r1
    hessian[4, 2] += j0_0*j0_2 + j1_0*j1_2
    hessian[4, 3] += j0_1*j0_2 + j1_1*j1_2
    hessian[4, 4] += j0_2**2 + j1_2**2
    if exact:
        hessian[2, 2] += c0_0_0*r0 + c1_0_0*r1
        hessian[3, 2] += c0_1_0*r0 + c1_1_0*r1
        hessian[3, 3] += c0_1_1*r0 + c1_1_1*r1
        hessian[4, 2] += c0_2_0*r0 + c1_2_0*r1
        hessian[4, 3] += c0_2_1*r0 + c1_2_1*r1
        hessian[4, 4] += c0_2_2*r0 + c1_2_2*r1
    return cost


@compiled
def cost_body_follows_motion(body_cos: Any, body_sin: Any, number_kappa: Any, number_speed_threshold: Any, state: Any) -> float:
    vx = state[2]
    vy = state[3]
    if not ((-number_speed_threshold + math.sqrt(vx**2 + vy**2) > 0) and (math.sqrt(vx**2 + vy**2) > 0)):
        return 0.0
    step_0 = math.sqrt(vx**2 + vy**2)
    step_1 = 1/step_0
    step_2 = (1/2)*number_kappa*(-number_speed_threshold + step_0)**2
    cost = step_2*(body_cos - step_1*vx)**2 + step_2*(body_sin - step_1*vy)**2
    return cost


@compiled
def add_head_follows_body(body_cos: Any, body_sin: Any, exact: Any, head_cos: Any, head_sin: Any, number_head_body_kappa: Any, sums: Any) -> float:
    gradient = sums.gradient
    hessian = sums.hessian
    step_0 = body_cos*head_cos + body_sin*head_sin
    step_1 = step_0 - 1
    step_2 = body_cos*head_sin - body_sin*head_cos
    step_3 = number_head_body_kappa*step_1
    cost = -number_head_body_kappa*step_1
    gradient[4] += -number_head_body_kappa*step_2
    hessian[4, 4] += number_head_body_kappa
    gradient[5] += number_head_body_kappa*step_2
    hessian[5, 4] += -number_head_body_kappa*step_0
    hessian[5, 5] += number_head_body_kappa
    if exact:
        hessian[4, 4] += step_3
        hessian[5, 5] += step_3
    return cost


@compiled
def add_steered_motion(before: Any, dt: Any, exact: Any, head_cos_before: Any, head_sin_before: Any, number_gain: Any, number_lag: Any, number_off: Any, number_reach: Any, number_turn: Any, state: Any, sums: Any) -> float:
    x = state[0]
    y = state[1]
    vx = state[2]
    vy = state[3]
    x_before = before[0]
    y_before = before[1]
    vx_before = before[2]
    vy_before = before[3]
    gradient = sums.gradient
    gradient_before = sums.gradient_before
    hessian = sums.hessian
    hessian_before = sums.hessian_before
    transition = sums.transition
    step_0 = dt - number_reach
    step_1 = vx_before**2
    step_2 = vy_before**2
    step_3 = step_1 + step_2
    step_4 = step_3 + 0.0001
    step_5 = math.sqrt(step_4)
    step_6 = step_5 + 0.01
    step_7 = 1/step_6
    step_8 = step_3*step_7
    step_9 = head_cos_before*step_8
    step_10 = step_0*step_9
    step_11 = number_gain - 1
    step_12 = -step_11
    step_13 = number_gain*step_9
    step_14 = -step_12*vx_before - step_13 + vx
    step_15 = head_sin_before*step_8
    step_16 = step_0*step_15
    step_17 = number_gain*step_15
    step_18 = -step_12*vy_before - step_17 + vy
    step_19 = -number_lag*number_off
    step_20 = -number_off
    step_21 = head_cos_before*vx_before
    step_22 = 2*step_7
    step_23 = step_0*step_22
    step_24 = 1/step_5
    step_25 = step_6**(-2)
    step_26 = number_gain*step_22
    step_27 = step_25*step_3
    step_28 = step_24*step_27
    step_29 = number_gain*step_21*step_28 + step_11 - step_21*step_26
    step_30 = head_cos_before*vy_before
    step_31 = number_gain*step_28*step_30 - step_26*step_30
    step_32 = number_gain*number_lag
    step_33 = number_turn*step_17
    step_34 = head_sin_before*vx_before
    step_35 = number_gain*step_28*step_34 - step_26*step_34
    step_36 = head_sin_before*vy_before
    step_37 = number_gain*step_28*step_36 + step_11 - step_26*step_36
    step_38 = number_turn*step_13
    step_39 = 4*step_24
    step_40 = step_1*step_7
    step_41 = math.sqrt(step_4)**(-3)
    step_42 = step_3*step_41
    step_43 = 1/step_4
    step_44 = 2*step_43
    step_45 = step_27*step_44
    step_46 = step_1*step_45
    step_47 = step_24*step_8
    step_48 = 2 - step_47
    step_49 = -step_39*step_40 + step_40*step_42 + step_46 + step_48
    step_50 = step_0*step_39
    step_51 = step_0*step_42
    step_52 = -2*dt + 2*number_reach + step_0*step_47
    step_53 = number_off*step_7
    step_54 = step_53*(-step_0*step_46 + step_32*step_49 + step_40*step_50 - step_40*step_51 + step_52)
    step_55 = number_gain*number_turn
    step_56 = step_55*step_7
    step_57 = step_49*step_56
    step_58 = step_25*vy_before
    step_59 = step_21*step_58
    step_60 = -step_39 + step_42 + step_44*step_8
    step_61 = number_off*(step_0*step_3*step_41 + 2*step_0*step_3*step_43*step_7 - step_32*step_60 - step_50)
    step_62 = step_55*step_60
    step_63 = step_34*step_58
    step_64 = step_2*step_7
    step_65 = step_2*step_45
    step_66 = -step_39*step_64 + step_42*step_64 + step_48 + step_65
    step_67 = step_53*(-step_0*step_65 + step_32*step_66 + step_50*step_64 - step_51*step_64 + step_52)
    step_68 = step_56*step_66
    step_69 = step_53*(number_gain*number_lag*step_24*step_3*step_7 - 2*step_32 - step_52)
    step_70 = step_47 - 2
    step_71 = -step_56*step_70
    step_72 = step_56*step_70
    step_73 = number_off*(-dt + number_reach + step_32)
    r0 = number_off*(-number_lag*step_14 - number_reach*vx_before - step_10 + x - x_before)
    r1 = number_turn*step_14
    r2 = number_off*(-number_lag*step_18 - number_reach*vy_before - step_16 + y - y_before)
    r3 = number_turn*step_18
    j0_0 = number_off
    j0_2 = step_19
    j0_4 = step_20
    j0_6 = number_off*(head_cos_before*step_0*step_24*step_25*step_3*vx_before - number_lag*step_29 - number_reach - step_21*step_23)
    j0_7 = number_off*(head_cos_before*step_0*step_24*step_25*step_3*vy_before - number_lag*step_31 - step_23*step_30)
    j0_8 = number_off*(-step_15*step_32 + step_16)
    j1_2 = number_turn
    j1_6 = number_turn*step_29
    j1_7 = number_turn*step_31
    j1_8 = step_33
    j2_1 = number_off
    j2_3 = step_19
    j2_5 = step_20
    j2_6 = number_off*(head_sin_before*step_0*step_24*step_25*step_3*vx_before - number_lag*step_35 - step_23*step_34)
    j2_7 = number_off*(head_sin_before*step_0*step_24*step_25*step_3*vy_before - number_lag*step_37 - number_reach - step_23*step_36)
    j2_8 = number_off*(-step_10 + step_32*step_9)
    j3_3 = number_turn
    j3_6 = number_turn*step_35
    j3_7 = number_turn*step_37
    j3_8 = -step_38
    c0_6_6 = head_cos_before*step_54
    c1_6_6 = -head_cos_before*step_57
    c2_6_6 = head_sin_before*step_54
    c3_6_6 = -head_sin_before*step_57
    c0_7_6 = -step_59*step_61
    c1_7_6 = -step_59*step_62
    c2_7_6 = -step_61*step_63
    c3_7_6 = -step_62*step_63
    c0_7_7 = head_cos_before*step_67
    c1_7_7 = -head_cos_before*step_68
    c2_7_7 = head_sin_before*step_67
    c3_7_7 = -head_sin_before*step_68
    c0_8_6 = step_34*step_69
    c1_8_6 = step_34*step_71
    c2_8_6 = -step_21*step_69
    c3_8_6 = step_21*step_72
    c0_8_7 = step_36*step_69
    c1_8_7 = step_36*step_71
    c2_8_7 = -step_30*step_69
    c3_8_7 = step_30*step_72
    c0_8_8 = -step_73*step_9
    c1_8_8 = step_38
    c2_8_8 = -step_15*step_73
    c3_8_8 = step_33
    cost = (1/2)*r0**2 + (1/2)*r1**2 + (1/2)*r2**2 + (1/2)*r3**2
    gradient[0] += j0_0*r0
    hessian[0, 0] += j0_0**2
    gradient[1] += j2_1*r2
    hessian[1, 1] += j2_1**2
    gradient[2] += j0_2*r0 + j1_2*r1
    hessian[2, 0] += j0_0*j0_2
    hessian[2, 2] += j0_2**2 + j1_2**2
    gradient[3] += j2_3*r2 + j3_3*r3
    hessian[3, 1] += j2_1*j2_3
    hessian[3, 3] += j2_3**2 + j3_3**2
    gradient_before[0] += j0_4*r0
    transition[0, 0] += j0_0*j0_4
    transition[0, 2] += j0_2*j0_4
    hessian_before[0, 0] += j0_4**2
    gradient_before[1] += j2_5*r2
    transition[1, 1] += j2_1*j2_5
    transition[1, 3] += j2_3*j2_5
    hessian_before[1, 1] += j2_5**2
    gradient_before[2] += j0_6*r0 + j1_6*r1 + j2_6*r2 + j3_6*r3
    transition[2, 0] += j0_0*j0_6
    transition[2, 1] += j2_1*j2_6
    transition[2, 2] += j0_2*j0_6 + j1_2*j1_6
    transition[2, 3] += j2_3*j2_6 + j3_3*j3_6
    hessian_before[2, 0] += j0_4*j0_6
    hessian_before[2, 1] += j2_5*j2_6
    hessian_before[2, 2] += j0_6**2 + j1_6**2 + j2_6**2 + j3_6**2
    gradient_before[3] += j0_7*r0 + j1_7*r1 + j2_7*r2 + j3_7*r3
    transition[3, 0] += j0_0*j0_7
    transition[3, 1] += j2_1*j2_7
    transition[3, 2] += j0_2*j0_7 + j1_2*j1_7
    transition[3, 3] += j2_3*j2_7 + j3_3*j3_7
    hessian_before[3, 0] += j0_4*j0_7
    hessian_before[3, 1] += j2_5*j2_7
    hessian_before[3, 2] += j0_6*j0_7 + j1_6*j1_7 + j2_6*j2_7 + j3_6*j3_7
    hessian_before[3, 3] += j0_7**2 + j1_7**2 + j2_7**2 + j3_7**2
    gradient_before[5] += j0_8*r0 + j1_8*r1 + j2_8*r2 + j3_8*r3
    transition[5, 0] += j0_0*j0_8
    transition[5, 1] += j2_1*j2_8
    transition[5, 2] += j0_2*j0_8 + j1_2*j1_8
    transition[5, 3] += j2_3*j2_8 + j3_3*j3_8
    hessian_before[5, 0] += j0_4*j0_8
    hessian_before[5, 1] += j2_5*j2_8
    hessian_before[5, 2] += j0_6*j0_8 + j1_6*j1_8 + j2_6*j2_8 + j3_6*j3_8
    hessian_before[5, 3] += j0_7*j0_8 + j1_7*j1_8 + j2_7*j2_8 + j3_7*j3_8
    hessian_before[5, 5] += j0_8**2 + j1_8**2 + j2_8**2 + j3_8**2
    if exact:
        hessian_before[2, 2] += c0_6_6*r0 + c1_6_6*r1 + c2_6_6*r2 + c3_6_6*r3
        hessian_before[3, 2] += c0_7_6*r0 + c1_7_6*r1 + c2_7_6*r2 + c3_7_6*r3
        hessian_before[3, 3] += c0_7_7*r0 + c1_7_7*r1 + c2_7_7*r2 + c3_7_7*r3
        hessian_before[5, 2] += c0_8_6*r0 + c1_8_6*r1 + c2_8_6*r2 + c3_8_6*r3
        hessian_before[5, 3] += c0_8_7*r0 + c1_8_7*r1 + c2_8_7*r2 + c3_8_7*r3
        hessian_before[5, 5] += c0_8_8*r0 + c1_8_8*r1 + c2_8_8*r2 + c3_8_8*r3
    return cost


@compiled
def add_faces_group(angle_cos: Any, angle_sin: Any, exact: Any, number_cos: Any, number_kappa: Any, number_outliers: Any, number_sin: Any, number_weight: Any, place: Any, sums: Any) -> float:
    gradient = sums.gradient
    hessian = sums.hessian
    step_0 = math.sqrt(number_kappa)
    step_1 = -angle_sin*step_0
    step_2 = angle_cos*step_0
    r0 = step_0*(angle_cos - number_cos)
    r1 = step_0*(angle_sin - number_sin)
    j0_0 = step_1
    j1_0 = step_2
    half = (1/2)*r0**2 + (1/2)*r1**2
    weight = number_weight*(1 - number_outliers)*math.exp(-half)/(number_outliers + (1 - number_outliers)*math.exp(-half))
    bend = number_weight*(number_outliers - 1)*((number_outliers - 1)*math.exp(-half)/(number_outliers - (number_outliers - 1)*math.exp(-half)) + 1)*math.exp(-half)/(number_outliers - (number_outliers - 1)*math.exp(-half))
    pull0 = j0_0*r0 + j1_0*r1
    c0_0_0 = -step_2
    c1_0_0 = step_1
    cost = -number_weight*math.log(number_outliers + (1 - number_outliers)*math.exp(-half))
    gradient[place] += pull0*weight
    hessian[place, place] += weight*(j0_0**2 + j1_0**2)
    if exact:
        hessian[place, place] += bend*pull0**2 + c0_0_0*r0*weight + c1_0_0*r1*weight
    return cost


@compiled
def cost_faces_group(angle_cos: Any, angle_sin: Any, number_cos: Any, number_kappa: Any, number_outliers: Any, number_sin: Any, number_weight: Any) -> float:
    step_0 = (1/2)*number_kappa
    cost = -number_weight*math.log(number_outliers + (1 - number_outliers)*math.exp(-step_0*(angle_cos - number_cos)**2 - step_0*(angle_sin - number_sin)**2))
    return cost


@compiled
def add_persistence(angle_cos: Any, angle_cos_before: Any, angle_sin: Any, angle_sin_before: Any, exact: Any, number_drift: Any, number_hold: Any, number_probability: Any, place: Any, sums: Any) -> float:
    gradient = sums.gradient
    gradient_before = sums.gradient_before
    hessian = sums.hessian
    hessian_before = sums.hessian_before
    transition = sums.transition
    step_0 = -angle_cos_before
    step_1 = -angle_sin
    r0 = angle_cos + step_0
    r1 = angle_sin - angle_sin_before
    j0_0 = step_1
    j0_1 = angle_sin_before
    j1_0 = angle_cos
    j1_1 = step_0
    half = (1/2)*r0**2 + (1/2)*r1**2
    weight = number_hold*number_probability/math.sqrt(2*half + number_drift**2)
    bend = -number_hold*number_probability/math.sqrt(2*half + number_drift**2)**(3)
    pull0 = j0_0*r0 + j1_0*r1
    pull1 = j0_1*r0 + j1_1*r1
    c0_0_0 = -angle_cos
    c1_0_0 = step_1
    c0_1_1 = angle_cos_before
    c1_1_1 = angle_sin_before
    cost = number_hold*number_probability*(-number_drift + math.sqrt(2*half + number_drift**2))
    gradient[place] += pull0*weight
    hessian[place, place] += weight*(j0_0**2 + j1_0**2)
    gradient_before[place] += pull1*weight
    transition[place, place] += weight*(j0_0*j0_1 + j1_0*j1_1)
    hessian_before[place, place] += weight*(j0_1**2 + j1_1**2)
    if exact:
        hessian[place, place] += bend*pull0**2 + c0_0_0*r0*weight + c1_0_0*r1*weight
        transition[place, place] += bend*pull0*pull1
        hessian_before[place, place] += bend*pull1**2 + c0_1_1*r0*weight + c1_1_1*r1*weight
    return cost


@compiled
def add_anchor(angle_cos: Any, angle_sin: Any, exact: Any, number_kappa: Any, number_start: Any, place: Any, sums: Any) -> float:
    gradient = sums.gradient
    hessian = sums.hessian
    step_0 = math.cos(number_start)
    step_1 = angle_cos*step_0
    step_2 = math.sin(number_start)
    step_3 = angle_sin*step_2
    cost = number_kappa*((1/2)*step_0**2 - step_1 + (1/2)*step_2**2 - step_3 + 1/2)
    gradient[place] += number_kappa*(-angle_cos*step_2 + angle_sin*step_0)
    hessian[place, place] += number_kappa
    if exact:
        hessian[place, place] += number_kappa*(step_1 + step_3 - 1)
    return cost


@compiled
def add_wall(exact: Any, number_offset: Any, number_weight: Any, number_x: Any, number_y: Any, origin_x: Any, origin_y: Any, state: Any, sums: Any) -> float:
    x = state[0] + origin_x
    y = state[1] + origin_y
    if not ((number_offset - number_x*x - number_y*y > 0)):
        return 0.0
    gradient = sums.gradient
    hessian = sums.hessian
    step_0 = math.sqrt(number_weight)
    r0 = step_0*(number_offset - number_x*x - number_y*y)
    j0_0 = -number_x*step_0
    j0_1 = -number_y*step_0
    cost = (1/2)*r0**2
    gradient[0] += j0_0*r0
    hessian[0, 0] += j0_0**2
    gradient[1] += j0_1*r0
    hessian[1, 0] += j0_0*j0_1
    hessian[1, 1] += j0_1**2
    return cost


@compiled
def add_frame(
    chain: Chain, k: int, states: Any, start: Any, exact: bool, part: int, turns: Any, sums: Sums
) -> float:
    """Add the terms of frame k of a track; returns their cost.

    ``part``: terms between the frame and the previous one, of the frame alone, or both. ``turns`` (n, 4),
    cosine and sine of body and head, are read for the previous frame, and set for frame k.
    """
    problem = chain.problem
    row = problem.offsets[chain.track] + k
    frame, shared, state, cost = problem.records[row], problem.shared[0], states[k], 0.0
    # Sums: kernels are compiled again for each constant argument.
    at_body, at_head = BODY + 0, HEAD + 0
    body_cos, body_sin = math.cos(state[BODY]), math.sin(state[BODY])
    head_cos, head_sin = math.cos(state[HEAD]), math.sin(state[HEAD])
    turns[k, 0], turns[k, 1], turns[k, 2], turns[k, 3] = body_cos, body_sin, head_cos, head_sin
    if part != OWN and k > 0:
        before = states[k - 1]
        body_cos_before, body_sin_before = turns[k - 1, 0], turns[k - 1, 1]
        head_cos_before, head_sin_before = turns[k - 1, 2], turns[k - 1, 3]
        if frame.motion_information > 0.0 and not frame.steer_gain > 0.0:
            cost += add_white_noise_acceleration(before, frame.dt, exact, frame.motion_information, state,
                sums)
        if frame.body_turn_kappa > 0.0:
            cost += add_turning(body_cos, body_cos_before, body_sin, body_sin_before, exact,
                frame.body_turn_kappa, at_body, sums)
        if frame.head_turn_kappa > 0.0:
            cost += add_turning(head_cos, head_cos_before, head_sin, head_sin_before, exact,
                frame.head_turn_kappa, at_head, sums)
        if frame.steer_gain > 0.0:
            cost += add_steered_motion(before, frame.dt, exact, head_cos_before, head_sin_before,
                frame.steer_gain, frame.steer_lag, frame.steer_off, frame.steer_reach, frame.steer_turn,
                state, sums)
        if frame.group_hold > 0.0:
            cost += add_persistence(body_cos, body_cos_before, body_sin, body_sin_before, exact,
                frame.group_drift, shared.group_body_hold, frame.group_hold, at_body, sums)
        if frame.group_hold > 0.0:
            cost += add_persistence(head_cos, head_cos_before, head_sin, head_sin_before, exact,
                frame.group_drift, shared.group_head_hold, frame.group_hold, at_head, sums)
    if part != LINKS:
        if frame.velocity_information > 0.0:
            cost += add_first_velocity(exact, frame.velocity_information, state, sums)
        if frame.position_information > 0.0 and not frame.position_replaced > 0.0:
            cost += add_observed_position(exact, frame.position_information, shared.robust,
                shared.robust_threshold, frame.x, frame.y, problem.origin[chain.track, 0],
                problem.origin[chain.track, 1], state, sums)
        if frame.pixel_information > 0.0:
            cost += add_observed_pixel(exact, frame.pixel_information, shared.robust, shared.robust_threshold,
                shared.to_image, frame.u, frame.v, problem.origin[chain.track, 0], problem.origin[chain.track,
                1], state, sums)
        if frame.ellipse_xx > 0.0:
            cost += add_observed_ellipse(exact, shared.robust, shared.robust_threshold, frame.ellipse_xx,
                frame.ellipse_xy, frame.ellipse_yy, frame.x, frame.y, problem.origin[chain.track, 0],
                problem.origin[chain.track, 1], state, sums)
        if frame.velocity_xx > 0.0:
            cost += add_observed_velocity(exact, frame.velocity_xx, frame.velocity_xy, frame.velocity_yy,
                frame.observed_vx, frame.observed_vy, state, sums)
        if frame.body_kappa > 0.0 and not frame.body_uniform > 0.0:
            cost += add_observed_angle(body_cos, body_sin, exact, frame.observed_body_cos, frame.body_kappa,
                frame.observed_body_sin, at_body, sums)
        if frame.body_uniform > 0.0:
            cost += add_doubtful_angle(body_cos, body_sin, exact, frame.observed_body_cos, frame.body_kappa,
                frame.observed_body_sin, frame.body_uniform, at_body, sums)
        if frame.body_class_kappa > 0.0:
            cost += add_observed_classes_8(body_cos, body_sin, exact, problem.body_heights[row],
                frame.body_class_kappa, at_body, sums)
        if frame.body_axis_kappa > 0.0:
            cost += add_observed_axis(body_cos, body_sin, exact, frame.body_axis_cos, frame.body_axis_kappa,
                frame.body_axis_sin, at_body, sums)
        if frame.head_kappa > 0.0 and not frame.head_uniform > 0.0:
            cost += add_observed_angle(head_cos, head_sin, exact, frame.observed_head_cos, frame.head_kappa,
                frame.observed_head_sin, at_head, sums)
        if frame.head_uniform > 0.0:
            cost += add_doubtful_angle(head_cos, head_sin, exact, frame.observed_head_cos, frame.head_kappa,
                frame.observed_head_sin, frame.head_uniform, at_head, sums)
        if frame.head_class_kappa > 0.0:
            cost += add_observed_classes_12(head_cos, head_sin, exact, problem.head_heights[row],
                frame.head_class_kappa, at_head, sums)
        if frame.motion_body_kappa > 0.0:
            cost += add_body_follows_motion(body_cos, body_sin, exact, frame.motion_body_kappa,
                shared.speed_threshold, state, sums)
        if frame.head_body_kappa > 0.0:
            cost += add_head_follows_body(body_cos, body_sin, exact, head_cos, head_sin,
                frame.head_body_kappa, sums)
        if frame.group_weight > 0.0:
            cost += add_faces_group(body_cos, body_sin, exact, frame.group_cos, shared.group_body_kappa,
                shared.group_outliers, frame.group_sin, frame.group_weight, at_body, sums)
        if frame.group_weight > 0.0:
            cost += add_faces_group(head_cos, head_sin, exact, frame.group_cos, shared.group_head_kappa,
                shared.group_outliers, frame.group_sin, frame.group_weight, at_head, sums)
        if frame.body_anchor > 0.0:
            cost += add_anchor(body_cos, body_sin, exact, frame.body_anchor, start[BODY], at_body, sums)
        if frame.head_anchor > 0.0:
            cost += add_anchor(head_cos, head_sin, exact, frame.head_anchor, start[HEAD], at_head, sums)
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
def orientation_costs(
    chain: Chain, k: int, state: Any, body_cos: float, body_sin: float, head_cos: float, head_sin: float
) -> tuple[float, float]:
    """Costs of frame k that depend on body alone, and on head alone, at some directions."""
    problem = chain.problem
    row = problem.offsets[chain.track] + k
    frame, shared, body, head = problem.records[row], problem.shared[0], 0.0, 0.0
    if frame.body_kappa > 0.0 and not frame.body_uniform > 0.0:
        body += cost_observed_angle(body_cos, body_sin, frame.observed_body_cos, frame.body_kappa,
            frame.observed_body_sin)
    if frame.body_uniform > 0.0:
        body += cost_doubtful_angle(body_cos, body_sin, frame.observed_body_cos, frame.body_kappa,
            frame.observed_body_sin, frame.body_uniform)
    if frame.body_class_kappa > 0.0:
        body += cost_observed_classes_8(body_cos, body_sin, problem.body_heights[row], frame.body_class_kappa)
    if frame.body_axis_kappa > 0.0:
        body += cost_observed_axis(body_cos, body_sin, frame.body_axis_cos, frame.body_axis_kappa,
            frame.body_axis_sin)
    if frame.head_kappa > 0.0 and not frame.head_uniform > 0.0:
        head += cost_observed_angle(head_cos, head_sin, frame.observed_head_cos, frame.head_kappa,
            frame.observed_head_sin)
    if frame.head_uniform > 0.0:
        head += cost_doubtful_angle(head_cos, head_sin, frame.observed_head_cos, frame.head_kappa,
            frame.observed_head_sin, frame.head_uniform)
    if frame.head_class_kappa > 0.0:
        head += cost_observed_classes_12(head_cos, head_sin, problem.head_heights[row],
            frame.head_class_kappa)
    if frame.motion_body_kappa > 0.0:
        body += cost_body_follows_motion(body_cos, body_sin, frame.motion_body_kappa, shared.speed_threshold,
            state)
    if frame.group_weight > 0.0:
        body += cost_faces_group(body_cos, body_sin, frame.group_cos, shared.group_body_kappa,
            shared.group_outliers, frame.group_sin, frame.group_weight)
    if frame.group_weight > 0.0:
        head += cost_faces_group(head_cos, head_sin, frame.group_cos, shared.group_head_kappa,
            shared.group_outliers, frame.group_sin, frame.group_weight)
    return body, head

FUNCTIONS = {
    "white_noise_acceleration": ("graphtrack.model.terms.motion", "white_noise_acceleration"),
    "first_velocity": ("graphtrack.model.terms.motion", "first_velocity"),
    "observed_position": ("graphtrack.model.terms.position", "observed_position"),
    "observed_pixel": ("graphtrack.model.terms.position", "observed_pixel"),
    "observed_ellipse": ("graphtrack.model.terms.position", "observed_ellipse"),
    "observed_velocity": ("graphtrack.model.terms.position", "observed_velocity"),
    "turning": ("graphtrack.model.terms.orientation", "turning"),
    "observed_angle": ("graphtrack.model.terms.orientation", "observed_angle"),
    "doubtful_angle": ("graphtrack.model.terms.orientation", "doubtful_angle"),
    "observed_classes_8": ("graphtrack.model.terms.orientation", "observed_classes_8"),
    "observed_axis": ("graphtrack.model.terms.orientation", "observed_axis"),
    "observed_classes_12": ("graphtrack.model.terms.orientation", "observed_classes_12"),
    "body_follows_motion": ("graphtrack.model.terms.couplings", "body_follows_motion"),
    "head_follows_body": ("graphtrack.model.terms.couplings", "head_follows_body"),
    "steered_motion": ("graphtrack.model.terms.motion", "steered_motion"),
    "faces_group": ("graphtrack.model.terms.conversation", "faces_group"),
    "persistence": ("graphtrack.model.terms.conversation", "persistence"),
    "anchor": ("graphtrack.model.terms.orientation", "anchor"),
    "wall": ("graphtrack.model.terms.walls", "wall"),
}
"""What kernels are derived from: name of a function → module, qualified name."""
