"""Compiled twin of `graphtrack.model.motion`."""

from __future__ import annotations

from graphtrack.angles import FloatArray
from graphtrack.model.kernels.compiled import compiled
from graphtrack.model.kernels.frames import VX, X


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
