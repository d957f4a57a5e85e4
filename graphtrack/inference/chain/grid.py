"""Orientations of a whole track on a grid, by dynamic programming: where a descent can start anew.

Newton's method ends in the basin it began in. Where observations contradict each other (a classifier that
takes front for back) another course of the orientations may cost less. Two steps look for it, with the motion
fixed: `greatest_gain` tells at little cost whether there can be one, `best_course` finds it.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from graphtrack.geometry.angles import FloatArray
from graphtrack.inference.chain.problem import Problem
from graphtrack.model.kernels.compiled import compiled
from graphtrack.model.kernels.frames import BODY, HEAD, VX, VY
from graphtrack.model.kernels.pose import angle_cost

Single = NDArray[np.float32]


@compiled
def motion_pull(problem: Problem, place: int, state: FloatArray) -> tuple[float, float, float]:
    """Cosine and sine of a frame's direction of motion, and the concentration of the body about it."""
    kappa, threshold = problem.records[place].motion_body_kappa, problem.shared[0].speed_threshold
    speed = math.hypot(state[VX], state[VY])
    if kappa == 0.0 or speed <= threshold or speed < 1e-12:
        return 1.0, 0.0, 0.0
    return state[VX] / speed, state[VY] / speed, kappa * (speed - threshold) ** 2


@compiled
def add_quarters(
    cos: float, sin: float, mean_cos: float, mean_sin: float, kappa: float, uniform: float, cost: FloatArray
) -> None:
    """Add what an observed angle costs at a direction and one, two and three quarters on; ``cost`` (4,)."""
    if kappa > 0.0:
        close = cos * mean_cos + sin * mean_sin
        across = sin * mean_cos - cos * mean_sin
        cost[0] += angle_cost(close, kappa, uniform)
        cost[1] += angle_cost(-across, kappa, uniform)
        cost[2] += angle_cost(-close, kappa, uniform)
        cost[3] += angle_cost(across, kappa, uniform)


@compiled
def add_class_quarters(
    cos: float, sin: float, heights: FloatArray, directions: FloatArray, kappa: float, cost: FloatArray
) -> None:
    """The same of class likelihoods. A quarter on, a class is where another was: its density is known."""
    n = len(directions)
    quarter = n // 4
    here = onward = opposite = back = heights[n]
    for c in range(n):
        value = math.exp(kappa * (cos * directions[c, 0] + sin * directions[c, 1] - 1.0))
        here += heights[c] * value
        onward += heights[(c + quarter) % n] * value
        opposite += heights[(c + 2 * quarter) % n] * value
        back += heights[(c + 3 * quarter) % n] * value
    cost[0] -= math.log(here)
    cost[1] -= math.log(onward)
    cost[2] -= math.log(opposite)
    cost[3] -= math.log(back)


@compiled
def greatest_gain(problem: Problem, track: int, states: FloatArray) -> float:
    """The most that a stretch of frames gains by turning body, head or both by one, two or three quarters.

    Turning there and back is free, so that this is more than any such course can gain.
    """
    body, head, gain = np.empty(4), np.empty(4), np.zeros((3, 4))
    greatest, offset = 0.0, problem.offsets[track]
    for k in range(len(states)):
        place, state = offset + k, states[k]
        frame = problem.records[place]
        body_cos, body_sin = math.cos(state[BODY]), math.sin(state[BODY])
        head_cos, head_sin = math.cos(state[HEAD]), math.sin(state[HEAD])
        body[:] = 0.0
        head[:] = 0.0
        cos, sin, kappa = motion_pull(problem, place, state)
        add_quarters(body_cos, body_sin, cos, sin, kappa, 0.0, body)
        cos, sin, kappa = frame.body_cos, frame.body_sin, frame.body_kappa
        add_quarters(body_cos, body_sin, cos, sin, kappa, frame.body_uniform, body)
        cos, sin, kappa = frame.head_cos, frame.head_sin, frame.head_kappa
        add_quarters(head_cos, head_sin, cos, sin, kappa, frame.head_uniform, head)
        if frame.body_class_kappa > 0.0:
            heights, directions = problem.body_heights[place], problem.body_directions
            add_class_quarters(body_cos, body_sin, heights, directions, frame.body_class_kappa, body)
        if frame.head_class_kappa > 0.0:
            heights, directions = problem.head_heights[place], problem.head_directions
            add_class_quarters(head_cos, head_sin, heights, directions, frame.head_class_kappa, head)
        # The cosine of head minus body once the head, or the body, has turned by a quarter more.
        close = body_cos * head_cos + body_sin * head_sin
        across = head_sin * body_cos - head_cos * body_sin
        kappa, turned, turning = frame.head_body_kappa, close, across
        for q in range(1, 4):
            turned, turning = -turning, turned
            unturned = turned if q == 2 else -turned
            by_body, by_head = body[0] - body[q], head[0] - head[q]
            gain[0, q] = max(0.0, gain[0, q] + by_body + kappa * (unturned - close))
            gain[1, q] = max(0.0, gain[1, q] + by_head + kappa * (turned - close))
            gain[2, q] = max(0.0, gain[2, q] + by_body + by_head)
            for way in range(3):
                greatest = max(greatest, gain[way, q])
    return greatest


@compiled
def nodes_of(problem: Problem, track: int, n: int, spread: float, node: np.ndarray) -> int:
    """Group frames of a track until body and head diffuse by the variance ``spread``; returns the number.

    ``node`` (n,) gets the group of each frame. A grid cannot follow turns of less than its spacing: without
    groups it would overrate the cost of turning wherever frames are dense.
    """
    count, body, head = 0, 0.0, 0.0
    for k in range(n):
        frame = problem.records[problem.offsets[track] + k]
        if k > 0:
            body += 1.0 / frame.body_turn_kappa if frame.body_turn_kappa > 0.0 else spread
            head += 1.0 / frame.head_turn_kappa if frame.head_turn_kappa > 0.0 else spread
            if min(body, head) >= spread:
                count, body, head = count + 1, 0.0, 0.0
        node[k] = count
    return count + 1


@compiled
def add_angles(
    mean_cos: float,
    mean_sin: float,
    kappa: float,
    uniform: float,
    cos: FloatArray,
    sin: FloatArray,
    cost: FloatArray,
) -> None:
    """Add what an observed angle costs at each direction of the grid."""
    if kappa > 0.0:
        for b in range(len(cos)):
            cost[b] += angle_cost(cos[b] * mean_cos + sin[b] * mean_sin, kappa, uniform)


@compiled
def add_densities(heights: FloatArray, densities: FloatArray, cost: FloatArray) -> None:
    """Add what class likelihoods cost at each direction; ``densities`` (bins, n) of the classes there."""
    n = densities.shape[1]
    for b in range(len(cost)):
        density = heights[n]
        for c in range(n):
            density += heights[c] * densities[b, c]
        cost[b] -= math.log(density)


@compiled
def densities_on(cos: FloatArray, sin: FloatArray, directions: FloatArray, kappa: FloatArray) -> FloatArray:
    """Densities (bins, n) of the classes over those at their centres, at each direction of the grid.

    ``kappa`` is that of each frame: all the same, or 0.
    """
    sharpness = kappa.max()
    found = np.empty((len(cos), len(directions)))
    for b in range(len(cos)):
        for c in range(len(directions)):
            found[b, c] = math.exp(sharpness * (cos[b] * directions[c, 0] + sin[b] * directions[c, 1] - 1.0))
    return found


@compiled
def hops(variance: float, cos: FloatArray, cost: Single) -> None:
    """Cost of each turn from one group to the next, which diffusion by ``variance`` allows; 0: free."""
    kappa = 1.0 / variance if variance > 0.0 else 0.0
    for shift in range(len(cos)):
        cost[shift] = kappa * (1.0 - cos[shift])


@compiled
def turn(before: Single, body_hop: Single, head_hop: Single, now: Single) -> None:
    """Least cost of arriving at each pair of directions: ``now`` from ``before``, both (bins, bins).

    Turns of body and head are independent, so it is a minimum over those of the one, then of the other.
    """
    bins = len(before)
    between, doubled = np.empty_like(before), np.empty(2 * bins, before.dtype)
    for b in range(bins):
        row = between[b]
        row[:] = before[b]
        for shift in range(1, bins):
            other, hop = before[(b + shift) % bins], body_hop[shift]
            for h in range(bins):
                candidate = other[h] + hop
                row[h] = candidate if candidate < row[h] else row[h]
    for b in range(bins):
        row = now[b]
        row[:] = between[b]
        doubled[:bins] = row
        doubled[bins:] = row
        for shift in range(1, bins):
            other, hop = doubled[shift : shift + bins], head_hop[shift]
            for h in range(bins):
                candidate = other[h] + hop
                row[h] = candidate if candidate < row[h] else row[h]


@compiled
def best_course(
    problem: Problem, track: int, states: FloatArray, bins: int, spread: float, course: FloatArray
) -> None:
    """The course (n, 2) of body and head on a grid of ``bins`` × ``bins`` directions that costs least.

    The motion is that of ``states``. Frames are grouped as `nodes_of` says; 0: each for itself. Viterbi's
    algorithm.
    """
    n, a = len(states), problem.offsets[track]
    records = problem.records[a : a + n]
    node = np.empty(n, np.int64)
    count = nodes_of(problem, track, n, spread, node)
    angles = 2.0 * np.pi * np.arange(bins) / bins
    cos, sin = np.cos(angles), np.sin(angles)
    body_densities = densities_on(cos, sin, problem.body_directions, records["body_class_kappa"])
    head_densities = densities_on(cos, sin, problem.head_directions, records["head_class_kappa"])
    body, head, kappa = np.zeros((count, bins)), np.zeros((count, bins)), np.zeros(count)
    body_turn, head_turn = np.zeros(count), np.zeros(count)
    for k in range(n):
        frame, g = records[k], node[k]
        kappa[g] += frame.head_body_kappa
        motion_cos, motion_sin, pull = motion_pull(problem, a + k, states[k])
        add_angles(motion_cos, motion_sin, pull, 0.0, cos, sin, body[g])
        add_angles(frame.body_cos, frame.body_sin, frame.body_kappa, frame.body_uniform, cos, sin, body[g])
        add_angles(frame.head_cos, frame.head_sin, frame.head_kappa, frame.head_uniform, cos, sin, head[g])
        if frame.body_class_kappa > 0.0:
            add_densities(problem.body_heights[a + k], body_densities, body[g])
        if frame.head_class_kappa > 0.0:
            add_densities(problem.head_heights[a + k], head_densities, head[g])
        if frame.body_turn_kappa > 0.0:
            body_turn[g] += 1.0 / frame.body_turn_kappa
        if frame.head_turn_kappa > 0.0:
            head_turn[g] += 1.0 / frame.head_turn_kappa
    # value[g, b, h]: what the cheapest course costs that is at (b, h) in group g, beyond the cheapest of all.
    value = np.empty((count, bins, bins), np.float32)
    body_hop, head_hop = np.empty(bins, np.float32), np.empty(bins, np.float32)
    for g in range(count):
        now = value[g]
        if g == 0:
            now[:] = 0.0
        else:
            hops(body_turn[g], cos, body_hop)
            hops(head_turn[g], cos, head_hop)
            turn(value[g - 1], body_hop, head_hop, now)
        for b in range(bins):
            for h in range(bins):
                now[b, h] += body[g, b] + head[g, h] + kappa[g] * (1.0 - cos[(h - b) % bins])
        now -= now.min()
    # Back along the course: which turn led here is found again, which is less work than to note them all.
    at = int(np.argmin(value[count - 1]))
    b, h = at // bins, at % bins
    k = n - 1
    for g in range(count - 1, -1, -1):
        while k >= 0 and node[k] == g:
            course[k, 0], course[k, 1] = angles[b], angles[h]
            k -= 1
        if g > 0:
            hops(body_turn[g], cos, body_hop)
            hops(head_turn[g], cos, head_hop)
            least, to_b, to_h = math.inf, b, h
            for i in range(bins):
                for j in range(bins):
                    total = value[g - 1, i, j] + body_hop[(b - i) % bins] + head_hop[(h - j) % bins]
                    if total < least:
                        least, to_b, to_h = total, i, j
            b, h = to_b, to_h
