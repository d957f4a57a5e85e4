"""Compiled twins of `graphtrack.model.motion` and `graphtrack.model.intentional`."""

from __future__ import annotations

import math
from typing import Any

from graphtrack.geometry.angles import FloatArray
from graphtrack.model.kernels.compiled import compiled
from graphtrack.model.kernels.frames import HEAD, VX, VY, X, Y

SMALL_TURN = 1e-3
"""λΔt below which the closed forms of a steered step cancel; there, their series."""

STANDSTILL = 0.01
"""m/s: the speed that the head steers has no kink at 0; it is rounded off over about so much."""


@compiled
def add_motion(
    before: FloatArray,
    state: FloatArray,
    dt: float,
    information: float,
    gradient_before: FloatArray,
    gradient: FloatArray,
    hessian_before: FloatArray,
    hessian: FloatArray,
    transition: FloatArray,
) -> float:
    """White-noise acceleration between two frames; ``transition[i, j]`` is ∂²/∂before_i ∂state_j."""
    half = 0.5 * dt
    turn = information / dt
    bend = 12.0 * information / (dt * dt * dt)
    cost = 0.0
    for axis in range(2):
        p, v = X + axis, VX + axis
        dv = state[v] - before[v]
        off = state[p] - before[p] - half * (state[v] + before[v])
        cost += 0.5 * (turn * dv * dv + bend * off * off)
        gradient[p] += bend * off
        gradient_before[p] -= bend * off
        gradient[v] += turn * dv - half * bend * off
        gradient_before[v] -= turn * dv + half * bend * off
        hessian[p, p] += bend
        hessian[v, p] -= half * bend
        hessian[v, v] += turn + half * half * bend
        hessian_before[p, p] += bend
        hessian_before[v, p] += half * bend
        hessian_before[v, v] += turn + half * half * bend
        transition[p, p] -= bend
        transition[p, v] += half * bend
        transition[v, p] -= half * bend
        transition[v, v] += half * half * bend - turn
    return cost


@compiled
def steer(frame: Any, rate: float) -> None:
    """Set the ``rate`` λ in 1/s at which a step is steered; see `intentional.steered_step`."""
    dt, x = frame.dt, rate * frame.dt
    if not (x > 0.0 and frame.motion_information > 0.0):
        frame.steer_gain = 0.0
        return
    once, twice = math.expm1(-x), math.expm1(-2.0 * x)
    if x < SMALL_TURN:
        reach = dt * (1.0 - x / 2.0 + x * x / 6.0)
        place = dt * dt * dt / 3.0 * (1.0 - 0.75 * x + 0.35 * x * x)
        cross = dt * dt / 2.0 * (1.0 - x + 7.0 * x * x / 12.0)
        spread = dt * (1.0 - x + 2.0 * x * x / 3.0)
    else:
        reach = -once / rate
        place = (dt + 2.0 * once / rate - twice / (2.0 * rate)) / (rate * rate)
        cross = once * once / (2.0 * rate * rate)
        spread = -twice / (2.0 * rate)
    scale = frame.motion_information / (place * spread - cross * cross)
    frame.steer_gain, frame.steer_reach = -once, reach
    frame.steer_place, frame.steer_cross, frame.steer_spread = spread * scale, -cross * scale, place * scale


@compiled
def add_steered_motion(
    frame: Any,
    before: FloatArray,
    state: FloatArray,
    head_cos: float,
    head_sin: float,
    exact: bool,
    gradient_before: FloatArray,
    gradient: FloatArray,
    hessian_before: FloatArray,
    hessian: FloatArray,
    transition: FloatArray,
) -> float:
    """A step whose velocity turns to where the head pointed; ``head_cos`` and ``head_sin`` are those before.

    With the residuals e of position and velocity and their information, the pull on the aim s·u(α) is
    −(far·Λe_p + gain·Λe_v); its second derivatives by v and α are what ``exact`` adds to Gauss–Newton.
    """
    gain, reach = frame.steer_gain, frame.steer_reach
    keep, far = 1.0 - gain, frame.dt - reach
    place, cross, spread = frame.steer_place, frame.steer_cross, frame.steer_spread
    vx, vy = before[VX], before[VY]
    square = vx * vx + vy * vy
    root = math.sqrt(square + STANDSTILL * STANDSTILL)
    speed = square / (root + STANDSTILL)
    nx, ny = vx / root, vy / root
    aim_x, aim_y = speed * head_cos, speed * head_sin
    off_x = state[X] - before[X] - reach * vx - far * aim_x
    off_y = state[Y] - before[Y] - reach * vy - far * aim_y
    turn_x = state[VX] - keep * vx - gain * aim_x
    turn_y = state[VY] - keep * vy - gain * aim_y
    place_x, place_y = place * off_x + cross * turn_x, place * off_y + cross * turn_y
    spread_x, spread_y = cross * off_x + spread * turn_x, cross * off_y + spread * turn_y
    gradient[X] += place_x
    gradient[Y] += place_y
    gradient[VX] += spread_x
    gradient[VY] += spread_y
    gradient_before[X] -= place_x
    gradient_before[Y] -= place_y
    pull_x, pull_y = far * place_x + gain * spread_x, far * place_y + gain * spread_y
    along = head_cos * pull_x + head_sin * pull_y
    across = head_cos * pull_y - head_sin * pull_x
    gradient_before[VX] -= reach * place_x + keep * spread_x + along * nx
    gradient_before[VY] -= reach * place_y + keep * spread_y + along * ny
    gradient_before[HEAD] -= speed * across
    # Per axis, what the information says of the own velocity (own), of the aim (aimed) and of both.
    to_place, to_spread = reach * place + keep * cross, reach * cross + keep * spread
    own = reach * to_place + keep * to_spread
    both = far * to_place + gain * to_spread
    aim_place, aim_spread = far * place + gain * cross, far * cross + gain * spread
    aimed = far * aim_place + gain * aim_spread
    for axis in range(2):
        p, v = X + axis, VX + axis
        hessian[p, p] += place
        hessian[v, p] += cross
        hessian[v, v] += spread
        hessian_before[p, p] += place
        u = head_cos if axis == 0 else head_sin
        w = -head_sin if axis == 0 else head_cos
        transition[p, p] -= place
        transition[p, v] -= cross
        transition[v, p] -= to_place
        transition[v, v] -= to_spread
        transition[VX, p] -= nx * u * aim_place
        transition[VX, v] -= nx * u * aim_spread
        transition[VY, p] -= ny * u * aim_place
        transition[VY, v] -= ny * u * aim_spread
        transition[HEAD, p] -= speed * w * aim_place
        transition[HEAD, v] -= speed * w * aim_spread
        hessian_before[v, p] += to_place
        hessian_before[VX, p] += nx * u * aim_place
        hessian_before[VY, p] += ny * u * aim_place
        hessian_before[HEAD, p] += speed * w * aim_place
    # MᵀΛM with M = reach·I + far·u·nᵀ for the position, keep·I + gain·u·nᵀ for the velocity.
    hessian_before[VX, VX] += own + 2.0 * both * head_cos * nx + aimed * nx * nx
    hessian_before[VY, VX] += both * (head_cos * ny + head_sin * nx) + aimed * nx * ny
    hessian_before[VY, VY] += own + 2.0 * both * head_sin * ny + aimed * ny * ny
    hessian_before[HEAD, VX] -= speed * both * head_sin
    hessian_before[HEAD, VY] += speed * both * head_cos
    hessian_before[HEAD, HEAD] += speed * speed * aimed
    if exact:
        bend = along / root
        hessian_before[VX, VX] -= bend * (1.0 - nx * nx)
        hessian_before[VY, VX] += bend * nx * ny
        hessian_before[VY, VY] -= bend * (1.0 - ny * ny)
        hessian_before[HEAD, VX] -= across * nx
        hessian_before[HEAD, VY] -= across * ny
        hessian_before[HEAD, HEAD] += speed * along
    return 0.5 * (off_x * place_x + off_y * place_y + turn_x * spread_x + turn_y * spread_y)


@compiled
def add_first_velocity(
    state: FloatArray, information: float, gradient: FloatArray, hessian: FloatArray
) -> float:
    """The broad prior on a first velocity."""
    cost = 0.0
    for v in range(VX, VX + 2):
        cost += 0.5 * information * state[v] * state[v]
        gradient[v] += information * state[v]
        hessian[v, v] += information
    return cost
