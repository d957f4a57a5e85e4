"""Initial states: the linear solution for positions, a circular running mean for angles.

Motion and positions in metres are solved exactly in one pass. Both axes share one covariance, so a frame is a
2 × 2 block (position, velocity) with two right-hand sides.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from graphtrack.geometry.angles import FloatArray, vectors_of
from graphtrack.geometry.camera import GroundCamera
from graphtrack.inference.chain.basin_search import SLOW, admit_rejected
from graphtrack.inference.chain.newton import CONVERGED, NOT_FINITE, Result
from graphtrack.kernels.compilation import allocating, compiled, inner
from graphtrack.kernels.layout import (
    BODY,
    HEAD,
    VX,
    VY,
    N,
    Problem,
    X,
    Y,
)
from graphtrack.model import Model, States
from graphtrack.model.generator import program_of
from graphtrack.model.observation import require_position
from graphtrack.model.packing import PackedTracks, number_rows, place_in_row
from graphtrack.model.term import filled, types_of
from graphtrack.tracks.time import TIME_TOLERANCE
from graphtrack.tracks.track import Track


class RecordEntries(NamedTuple):
    """Columns of the model's linear part in a record."""

    dt: int
    motion_information: int
    velocity_information: int
    x: int
    y: int
    position_information: int


class Linear(NamedTuple):
    """The linear part of some tracks end to end, without other fields: N frames, m tracks."""

    rows: FloatArray  # (N, fields) the records
    entries: RecordEntries
    origin: FloatArray  # (m, 2) metres, origin of a track's positions
    offsets: NDArray[np.int64]  # (m + 1,)


def linear_part(packed: PackedTracks) -> Linear:
    """Return the linear part of packed tracks."""
    entries = RecordEntries(*(place_in_row(name, packed.records.dtype) for name in RecordEntries._fields))
    return Linear(number_rows(packed.records), entries, packed.origin, packed.offsets)


@allocating
def solve_linear_tracks(linear: Linear, longest: int, result: Result) -> None:
    """Solve tracks with linear terms only; states in the world, orientations NaN."""
    spread, memory = np.empty((longest, 3)), np.empty((longest, 7))
    for track in range(len(linear.offsets) - 1):
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
    """Posterior of positions and velocities of one track; returns its cost.

    Fills in four columns of ``states`` (n, 6), and ``spread`` (n, 3): variance of the position, covariance,
    and variance of the velocity on each axis. ``memory`` is (n, 7). NaN where no position determines the
    track.
    """
    at, origin = linear.entries, linear.origin[track]
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
            # The previous frame, complete with this transition, is eliminated.
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


OPPOSITE = math.cos(math.pi - 1e-5)
"""Cosine below which two angles are opposite: more than rounding, less than noise."""

_ASIDE = math.radians(30.0)
"""Offset of opposite fallback angles of two consecutive frames towards each other."""


class ObservedAngles(NamedTuple):
    """Observations from which initial orientations are computed."""

    t: FloatArray  # (N,) seconds since the first frame of the track
    body: FloatArray  # (N, 2) vectors along the observed body, or NaN; no rows: no body
    head: FloatArray  # (N, 2) the same for the head
    moving: float  # m/s above which the direction of travel replaces a missing angle
    window: float  # seconds to either side over which vectors are averaged


@inner
def running_mean(t: FloatArray, vectors: FloatArray, window: float, angle: FloatArray) -> None:
    """Mean direction of the vectors (n, 2) observed within ``window`` seconds; NaN without any."""
    n = len(t)
    low = high = count = 0
    x = y = 0.0
    for k in range(n):
        while high < n and t[high] - t[k] <= window + TIME_TOLERANCE:
            if math.isfinite(vectors[high, 0]):
                x += vectors[high, 0]
                y += vectors[high, 1]
                count += 1
            high += 1
        while t[k] - t[low] > window + TIME_TOLERANCE:
            if math.isfinite(vectors[low, 0]):
                x -= vectors[low, 0]
                y -= vectors[low, 1]
                count -= 1
            low += 1
        if count > 0 and x * x + y * y > 1e-18:
            angle[k] = math.atan2(y, x)
        else:
            angle[k] = math.nan


@inner
def headings(states: FloatArray, threshold: float, angle: FloatArray) -> int:
    """Direction of travel where the speed is above the threshold, else NaN; returns their number."""
    count = 0
    for k in range(len(states)):
        vx, vy = states[k, VX], states[k, VY]
        moving = vx * vx + vy * vy > threshold * threshold
        angle[k] = math.atan2(vy, vx) if moving else math.nan
        count += 1 if moving else 0
    return count


@compiled
def fill(t: FloatArray, angle: FloatArray, fallback: FloatArray) -> None:
    """Replace NaN angles by the fallback, else by the nearest angle in time of either, else by 0.

    Between two fallbacks that are opposite, angles turn evenly and counter-clockwise.
    """
    n = len(t)
    last, guessed = -1, False
    for k in range(n):
        guess = not math.isfinite(angle[k])
        if guess:
            angle[k] = fallback[k]
        if math.isfinite(angle[k]):
            opposite = guess and guessed and math.cos(angle[k] - angle[last]) < OPPOSITE
            if opposite and last == k - 1:
                angle[last], angle[k] = angle[last] + _ASIDE, angle[last] + math.pi - _ASIDE
            for gap in range(last + 1, k):
                if opposite:
                    angle[gap] = angle[last] + math.pi * (t[gap] - t[last]) / (t[k] - t[last])
                    continue
                earlier = last >= 0 and t[gap] - t[last] <= t[k] - t[gap] + TIME_TOLERANCE
                angle[gap] = angle[last] if earlier else angle[k]
            last, guessed = k, guess
    for gap in range(last + 1, n):
        angle[gap] = angle[last] if last >= 0 else 0.0


@allocating
def initialise(
    problem: Problem, linear: Linear, angles_observed: ObservedAngles, angles: FloatArray, states: FloatArray
) -> None:
    """Fill in the states (N, 6) of all tracks; ``angles`` (3, n) is memory, for the longest track."""
    longest = angles.shape[1]
    spread, memory = np.empty((longest, 3)), np.empty((longest, 7))
    for track in range(len(linear.offsets) - 1):
        a, b = linear.offsets[track], linear.offsets[track + 1]
        n, t, here = b - a, angles_observed.t[a:b], states[a:b]
        solve_linear(linear, track, here, spread, memory)
        heading = angles[0, :n]
        # The path of a standing person may point in any direction.
        if headings(here, max(angles_observed.moving, SLOW), heading) == 0:
            headings(here, angles_observed.moving, heading)
        for place, vectors, row in ((BODY, angles_observed.body, 1), (HEAD, angles_observed.head, 2)):
            angle = angles[row, :n]
            if len(vectors) == 0:
                here[:, place] = 0.0
                continue
            running_mean(t, vectors[a:b], angles_observed.window, angle)
            fill(t, angle, angles[1, :n] if place == HEAD and len(angles_observed.body) > 0 else heading)
            for k in range(n):
                here[k, place] = angle[k]
        admit_rejected(problem, track, here)


WINDOW = 0.5  # Seconds to either side over which observed angles are averaged for the initial values

NO_PRIOR = np.zeros((0, 6))

CREEPING = 0.1
"""Least m/s at which a direction of travel replaces an orientation, whatever the threshold."""


def pack(
    tracks: Sequence[Track],
    model: Model,
    camera: GroundCamera | None = None,
    personal: Mapping[str, FloatArray] | None = None,
) -> PackedTracks:
    """Tracks end to end, with the records that the model's compiled terms fill in.

    ``personal``: as in `PackedTracks`, in place of the model's parameters
    """
    packed = PackedTracks.of(tracks, camera, program_of(model).types, personal)
    return filled(packed, model.compiled_terms)


def pack_to_solve(
    tracks: Sequence[Track],
    model: Model,
    camera: GroundCamera | None = None,
    personal: Mapping[str, FloatArray] | None = None,
) -> PackedTracks:
    """The same; for a linear model, with a fourth of the memory."""
    terms = model.terms  # without the anchors of first orientations
    if camera is None and not (model.has_body or model.has_head):
        packed = filled(PackedTracks.of(tracks, camera, types_of(terms), personal), terms)
        if model.is_linear(packed):
            return packed
    return pack(tracks, model, camera, personal)


def problem_of(packed: PackedTracks) -> Problem:
    """Return the arrays that the kernels read."""
    return Problem(
        packed.records,
        packed.shared,
        packed.body_heights,
        packed.head_heights,
        packed.origin,
        packed.offsets,
        NO_PRIOR,
    )


def observed_angles(packed: PackedTracks, model: Model) -> ObservedAngles:
    """Return the observations from which initial orientations are computed."""
    body, head = (
        vectors_of(packed.directions(name), packed.channel(f"{name}_likelihood"), len(packed.t))
        if has
        else np.zeros((0, 2))
        for name, has in (("body", model.has_body), ("head", model.has_head))
    )
    return ObservedAngles(
        packed.t, body, head, max(model.parameters.coupling.speed_threshold, CREEPING), WINDOW
    )


def initial_states(track: Track, model: Model) -> States:
    """Return initial states; NaN where there is no orientation. SolveError without positions."""
    packed = pack([track], Model(model.preset, model.parameters))
    require_position(track)
    states = np.zeros((len(track), 6))
    memory = np.empty((3, len(track)))
    initialise(problem_of(packed), linear_part(packed), observed_angles(packed, model), memory, states)
    none = np.full(len(track), np.nan)
    return States(
        states[:, :2] + packed.origin[0],
        states[:, 2:4],
        states[:, 4] if model.has_body else none,
        states[:, 5] if model.has_head else none,
    )


def empty_result(packed: PackedTracks) -> Result:
    """Room for the solution of packed tracks."""
    n, m = len(packed.records), len(packed.tracks)
    steps, status = np.zeros((2, m), np.int64)
    states, covariance = np.zeros((n, 6)), np.empty((n, 6, 6))
    return Result(states, covariance, np.zeros(m), np.zeros(m), steps, status, np.zeros((n, 2)))
