"""The linear part of the model, solved exactly in one pass: motion and positions in metres.

Both axes share one covariance, so a frame is a 2 × 2 block (position, velocity) with two right-hand sides.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from graphtrack.geometry.angles import FloatArray
from graphtrack.inference.chain.result import CONVERGED, NOT_FINITE, Result
from graphtrack.model.kernels.compiled import allocating, inner
from graphtrack.model.kernels.layout import BODY, HEAD, VX, VY, N, X, Y, number_rows, place_in_row
from graphtrack.model.kernels.packing import PackedTracks


class Places(NamedTuple):
    """Where in a record the numbers stand that the linear part of the model has."""

    dt: int
    motion_information: int
    velocity_information: int
    x: int
    y: int
    position_information: int


class Linear(NamedTuple):
    """The linear part of some tracks end to end, whatever else is in the records: N frames, m tracks."""

    rows: FloatArray  # (N, fields) the records
    places: Places
    origin: FloatArray  # (m, 2) metres, what a track's positions are counted from
    offsets: NDArray[np.int64]  # (m + 1,)


def linear_part(packed: PackedTracks) -> Linear:
    """What the linear solution reads of packed tracks."""
    places = Places(*(place_in_row(name, packed.records.dtype) for name in Places._fields))
    return Linear(number_rows(packed.records), places, packed.origin, packed.offsets)


@allocating
def solve_linear_tracks(linear: Linear, longest: int, result: Result) -> None:
    """Solve tracks, none longer than ``longest``, of which the linear part is all that there is.

    States are in the world's frame; orientations are NaN.
    """
    spread, memory = np.empty((longest, 3)), np.empty((longest, 7))
    for track in range(len(linear.offsets) - 1):
        solve_linear_track(linear, track, spread, memory, result)


@inner
def solve_linear_track(
    linear: Linear, track: int, spread: FloatArray, memory: FloatArray, result: Result
) -> None:
    """One of them; ``spread`` and ``memory`` as in `solve_linear`, of any track."""
    a, b = linear.offsets[track], linear.offsets[track + 1]
    states, origin = result.states[a:b], linear.origin[track]
    cost = solve_linear(linear, track, states, spread, memory)
    result.first_cost[track] = result.cost[track] = cost
    result.status[track] = CONVERGED if math.isfinite(cost) else NOT_FINITE
    blank = 0.0 if math.isfinite(cost) else math.nan
    for k in range(b - a):
        state, covariance = states[k], result.covariance[a + k]
        state[X] += origin[X]
        state[Y] += origin[Y]
        state[BODY] = state[HEAD] = math.nan
        for i in range(N):
            for j in range(N):
                covariance[i, j] = math.nan if i >= BODY or j >= BODY else blank
        for axis in range(2):
            p, v = X + axis, VX + axis
            covariance[p, p] = spread[k, 0] + blank
            covariance[p, v] = covariance[v, p] = spread[k, 1] + blank
            covariance[v, v] = spread[k, 2] + blank


@inner
def solve_linear(
    linear: Linear, track: int, states: FloatArray, spread: FloatArray, memory: FloatArray
) -> float:
    """Posterior mean and covariance of positions and velocities of one track; returns the cost there.

    Fills in the first four columns of ``states`` (n, 6), and ``spread`` (n, 3): the variance of the position,
    the covariance of position and velocity, and the variance of the velocity, on each axis. ``memory`` is
    (n, 7). Positions are counted from the origin. NaN comes out where no position determines the track.
    """
    at, origin = linear.places, linear.origin[track]
    frames = linear.rows[linear.offsets[track] : linear.offsets[track + 1]]
    n = len(frames)
    pp = pv = vv = px = py = vx = vy = 0.0
    for k in range(n):
        frame = frames[k]
        information = frame[at.motion_information]
        if information > 0.0:
            half = 0.5 * frame[at.dt]
            bend = 12.0 * information / (frame[at.dt] * frame[at.dt] * frame[at.dt])
            turn = information / frame[at.dt]
            # The frame before, complete with this transition, is eliminated.
            hpp, hpv, hvv = pp + bend, pv + half * bend, vv + turn + half * half * bend
            determinant = hpp * hvv - hpv * hpv
            a, b, c = hvv / determinant, -hpv / determinant, hpp / determinant
            e_pp, e_pv, e_vp, e_vv = -bend, -half * bend, half * bend, half * half * bend - turn
            g_pp, g_pv = a * e_pp + b * e_pv, b * e_pp + c * e_pv
            g_vp, g_vv = a * e_vp + b * e_vv, b * e_vp + c * e_vv
            row = memory[k - 1]
            row[0], row[1], row[2] = a, b, c
            row[3], row[4], row[5], row[6] = g_pp, g_pv, g_vp, g_vv
            mx, ux = a * px + b * vx, b * px + c * vx
            my, uy = a * py + b * vy, b * py + c * vy
            before = states[k - 1]
            before[X], before[VX], before[Y], before[VY] = mx, ux, my, uy
            px, vx = -(e_pp * mx + e_pv * ux), -(e_vp * mx + e_vv * ux)
            py, vy = -(e_pp * my + e_pv * uy), -(e_vp * my + e_vv * uy)
            pp = bend - (e_pp * g_pp + e_pv * g_pv)
            pv = -half * bend - (e_pp * g_vp + e_pv * g_vv)
            vv = turn + half * half * bend - (e_vp * g_vp + e_vv * g_vv)
        vv += frame[at.velocity_information]
        weight = frame[at.position_information]
        pp += weight
        px += weight * (frame[at.x] - origin[X])
        py += weight * (frame[at.y] - origin[Y])
    determinant = pp * vv - pv * pv
    a, b, c = vv / determinant, -pv / determinant, pp / determinant
    state = states[n - 1]
    state[X], state[VX] = a * px + b * vx, b * px + c * vx
    state[Y], state[VY] = a * py + b * vy, b * py + c * vy
    spread[n - 1, 0], spread[n - 1, 1], spread[n - 1, 2] = a, b, c
    for k in range(n - 2, -1, -1):
        row, after, state = memory[k], states[k + 1], states[k]
        g_pp, g_pv, g_vp, g_vv = row[3], row[4], row[5], row[6]
        state[X] -= g_pp * after[X] + g_vp * after[VX]
        state[VX] -= g_pv * after[X] + g_vv * after[VX]
        state[Y] -= g_pp * after[Y] + g_vp * after[VY]
        state[VY] -= g_pv * after[Y] + g_vv * after[VY]
        q_pp = g_pp * a + g_vp * b
        q_pv = g_pp * b + g_vp * c
        q_vp = g_pv * a + g_vv * b
        q_vv = g_pv * b + g_vv * c
        a = row[0] + q_pp * g_pp + q_pv * g_vp
        c_new = row[2] + q_vp * g_pv + q_vv * g_vv
        b = row[1] + q_pp * g_pv + q_pv * g_vv
        c = c_new
        spread[k, 0], spread[k, 1], spread[k, 2] = a, b, c
    cost = 0.0
    for k in range(n):
        frame, state = frames[k], states[k]
        dx, dy = state[X] - (frame[at.x] - origin[X]), state[Y] - (frame[at.y] - origin[Y])
        cost += 0.5 * frame[at.position_information] * (dx * dx + dy * dy)
        cost += 0.5 * frame[at.velocity_information] * (state[VX] * state[VX] + state[VY] * state[VY])
        if frame[at.motion_information] > 0.0:
            then, half = states[k - 1], 0.5 * frame[at.dt]
            turn = frame[at.motion_information] / frame[at.dt]
            bend = 12.0 * frame[at.motion_information] / (frame[at.dt] * frame[at.dt] * frame[at.dt])
            dvx, dvy = state[VX] - then[VX], state[VY] - then[VY]
            ox = state[X] - then[X] - half * (state[VX] + then[VX])
            oy = state[Y] - then[Y] - half * (state[VY] + then[VY])
            cost += 0.5 * (turn * (dvx * dvx + dvy * dvy) + bend * (ox * ox + oy * oy))
    return cost if math.isfinite(cost) else math.nan
