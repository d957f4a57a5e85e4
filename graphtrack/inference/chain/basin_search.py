"""Basin search: orientations on a grid by dynamic programming, as another start of Newton's method.

With the motion fixed, `greatest_gain` bounds the possible gain and `best_course` finds it, from the costs of
single orientations, of turns, and of the head's deviation from the body. `unwind` proposes turns of less than
180° where the body of a standing person followed the path all around.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from graphtrack.geometry.angles import FloatArray
from graphtrack.inference.chain.newton import Workspace, copy_rows
from graphtrack.kernels.arithmetic import TURN, note_turns, wrapped
from graphtrack.kernels.compilation import allocating, compiled, inner, inner_allocating
from graphtrack.kernels.layout import BODY, HEAD, VX, VY, Chain, N, Problem
from graphtrack.model.generator import orientation_costs
from graphtrack.model.terms.orientation import angle_cost
from graphtrack.tracks.time import TIME_TOLERANCE

Single = NDArray[np.float32]

SURE = 4.0  # Greatest concentration that the past of a window has in the search for another basin

WORTHWHILE = 4.0
"""Least `greatest_gain` for which a grid is searched: turning there and back costs more than that."""

COARSE, FINE = (12, 0.2), (24, 0.05)
"""Directions of the grids, and rad² of diffusion of frames that are grouped. The coarse grid decides if the
fine one, which takes ten times as long, is needed."""

AT_START, AT_END = math.cos(math.radians(90.0)), math.cos(math.radians(60.0))
"""Cosines of the turns within which a course on a grid leads to the same basin as the states: at the start of
a descent, and at its end."""


@allocating
def greatest_gain(chain: Chain, states: FloatArray, workspace: Workspace) -> float:
    """Upper bound of the gain of a stretch of frames by quarter turns of body, head or both."""
    turns, greatest = workspace.trigonometry, 0.0
    gain, costs = np.zeros((3, 4)), np.empty((2, 4))
    for k in range(chain.n):
        note_turns(k, states, turns)
        body_cos, body_sin, head_cos, head_sin = turns[k, 0], turns[k, 1], turns[k, 2], turns[k, 3]
        # The cosine of head minus body after a quarter turn of the head, or of the body.
        close = body_cos * head_cos + body_sin * head_sin
        across = head_sin * body_cos - head_cos * body_sin
        kappa = chain.problem.records[chain.problem.offsets[chain.track] + k].head_body_kappa
        turned, turning = close, across
        for q in range(4):
            costs[0, q], costs[1, q] = orientation_costs(
                chain, k, states[k], body_cos, body_sin, head_cos, head_sin
            )
            body_cos, body_sin, head_cos, head_sin = -body_sin, body_cos, -head_sin, head_cos
        for q in range(1, 4):
            turned, turning = -turning, turned
            unturned = turned if q == 2 else -turned
            by_body, by_head = costs[0, 0] - costs[0, q], costs[1, 0] - costs[1, q]
            gain[0, q] += by_body + kappa * (unturned - close)
            gain[1, q] += by_head + kappa * (turned - close)
            gain[2, q] += by_body + by_head
            for way in range(3):
                gain[way, q] = max(gain[way, q], 0.0)
                greatest = max(greatest, gain[way, q])
    return greatest


@inner
def nodes_of(problem: Problem, track: int, n: int, spread: float, node: np.ndarray) -> int:
    """Group frames until body and head diffuse by the variance ``spread``; returns the number of groups."""
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


@inner
def hops(variance: float, cos: FloatArray, cost: Single) -> None:
    """Cost of each turn from one group to the next, which diffusion by ``variance`` allows; 0: free."""
    kappa = 1.0 / variance if variance > 0.0 else 0.0
    for shift in range(len(cos)):
        cost[shift] = kappa * (1.0 - cos[shift])


@inner_allocating
def turn(before: Single, body_hop: Single, head_hop: Single, now: Single) -> None:
    """Least cost of arriving at each pair of directions: ``now`` from ``before``, both (bins, bins)."""
    bins = len(before)
    between, doubled = np.empty_like(before), np.empty(2 * bins, before.dtype)
    for b in range(bins):
        row = between[b]
        for h in range(bins):
            row[h] = before[b, h]
        for shift in range(1, bins):
            other, hop = before[(b + shift) % bins], body_hop[shift]
            for h in range(bins):
                candidate = other[h] + hop
                row[h] = candidate if candidate < row[h] else row[h]
    for b in range(bins):
        row = now[b]
        for h in range(bins):
            row[h] = doubled[h] = doubled[bins + h] = between[b, h]
        for shift in range(1, bins):
            other, hop = doubled[shift : shift + bins], head_hop[shift]
            for h in range(bins):
                candidate = other[h] + hop
                row[h] = candidate if candidate < row[h] else row[h]


@inner_allocating
def add_past(prior: FloatArray, state: FloatArray, angles: FloatArray, cost: Single) -> None:
    """Add the prior of body and head in a first frame, (bins, bins), at most `SURE`."""
    slope = -prior[N, BODY:]
    for i in range(2):
        for j in range(BODY):
            slope[i] += prior[BODY + i, j] * (state[j] - prior[N + 1, j])
    both = prior[BODY, HEAD]
    determinant = prior[BODY, BODY] * prior[HEAD, HEAD] - both * both
    if not determinant > 0.0:
        return
    body = prior[N + 1, BODY] + (both * slope[1] - prior[HEAD, HEAD] * slope[0]) / determinant
    head = prior[N + 1, HEAD] + (both * slope[0] - prior[BODY, BODY] * slope[1]) / determinant
    of_body = min(max(prior[BODY, BODY] + both, 0.0), SURE)
    of_head = min(max(prior[HEAD, HEAD] + both, 0.0), SURE)
    of_both = min(max(-both, 0.0), SURE)
    for b in range(len(angles)):
        for h in range(len(angles)):
            turn, turn_head = angles[b] - body, angles[h] - head
            cost[b, h] += of_body * (1.0 - math.cos(turn)) + of_head * (1.0 - math.cos(turn_head))
            cost[b, h] += of_both * (1.0 - math.cos(turn_head - turn))


@inner
def least_of(cost: Single) -> tuple[int, int]:
    """The first index (b, h) of the minimum of a matrix."""
    b = h = 0
    for i in range(len(cost)):
        for j in range(len(cost)):
            if cost[i, j] < cost[b, h]:
                b, h = i, j
    return b, h


@allocating
def add_grid_costs(
    chain: Chain,
    states: FloatArray,
    cos: FloatArray,
    sin: FloatArray,
    node: np.ndarray,
    body: FloatArray,
    head: FloatArray,
) -> None:
    """Add costs of frames at each direction of a grid to the rows (groups, bins) of their ``node``."""
    for k in range(len(states)):
        for i in range(len(cos)):
            of_body, of_head = orientation_costs(chain, k, states[k], cos[i], sin[i], cos[i], sin[i])
            body[node[k], i] += of_body
            head[node[k], i] += of_head


@inner_allocating
def best_course(chain: Chain, states: FloatArray, bins: int, spread: float, course: FloatArray) -> None:
    """The cheapest course (n, 2) of body and head on a grid, given the motion, by the Viterbi algorithm."""
    problem, track, n = chain.problem, chain.track, chain.n
    a = problem.offsets[track]
    records = problem.records[a : a + n]
    node = np.empty(n, np.int64)
    count = nodes_of(problem, track, n, spread, node)
    angles, cos, sin = np.empty(bins), np.empty(bins), np.empty(bins)
    for i in range(bins):
        angles[i] = 2.0 * math.pi * i / bins
        cos[i], sin[i] = math.cos(angles[i]), math.sin(angles[i])
    body, head, kappa = np.zeros((count, bins)), np.zeros((count, bins)), np.zeros(count)
    body_turn, head_turn = np.zeros(count), np.zeros(count)
    add_grid_costs(chain, states, cos, sin, node, body, head)
    for k in range(n):
        frame, g = records[k], node[k]
        kappa[g] += frame.head_body_kappa
        if frame.body_turn_kappa > 0.0:
            body_turn[g] += 1.0 / frame.body_turn_kappa
        if frame.head_turn_kappa > 0.0:
            head_turn[g] += 1.0 / frame.head_turn_kappa
    # value[g, b, h]: cost of the cheapest course through (b, h) in group g, relative to the cheapest of all.
    value = np.empty((count, bins, bins), np.float32)
    body_hop, head_hop = np.empty(bins, np.float32), np.empty(bins, np.float32)
    for g in range(count):
        now = value[g]
        if g == 0:
            now[:] = 0.0
            if len(problem.prior) > 0:
                add_past(problem.prior, states[0], angles, now)
        else:
            hops(body_turn[g], cos, body_hop)
            hops(head_turn[g], cos, head_hop)
            turn(value[g - 1], body_hop, head_hop, now)
        for b in range(bins):
            for h in range(bins):
                now[b, h] += body[g, b] + head[g, h] + kappa[g] * (1.0 - cos[(h - b) % bins])
        b, h = least_of(now)
        least = now[b, h]
        for i in range(bins):
            for j in range(bins):
                now[i, j] -= least
    # Back along the course: the turns are recomputed, which is less work than storing them.
    b, h = least_of(value[count - 1])
    k = n - 1
    for g in range(count - 1, -1, -1):
        while k >= 0 and node[k] == g:
            course[k, 0], course[k, 1] = angles[b], angles[h]
            k -= 1
        if g > 0:
            hops(body_turn[g], cos, body_hop)
            hops(head_turn[g], cos, head_hop)
            cheapest, to_b, to_h = math.inf, b, h
            for i in range(bins):
                for j in range(bins):
                    total = value[g - 1, i, j] + body_hop[(b - i) % bins] + head_hop[(h - j) % bins]
                    if total < cheapest:
                        cheapest, to_b, to_h = total, i, j
            b, h = to_b, to_h


@inner
def lies_elsewhere(states: FloatArray, course: FloatArray, near: float) -> bool:
    """Return True if a course (n, 2) turns from the states' orientations by more than ``near``, a cosine."""
    for k in range(len(states)):
        if math.cos(course[k, 0] - states[k, BODY]) < near:
            return True
        if math.cos(course[k, 1] - states[k, HEAD]) < near:
            return True
    return False


@allocating
def find_other_basin(chain: Chain, states: FloatArray, near: float, workspace: Workspace) -> bool:
    """Put into ``workspace.again`` the states (n, 6) with the orientations of the best course on the grid.

    Returns False where that is the basin of the states: within the turn whose cosine is ``near``.
    """
    if not greatest_gain(chain, states, workspace) > WORTHWHILE:
        return False
    n, again, course = chain.n, workspace.again, np.empty((chain.n, 2))
    for bins, spread in (COARSE, FINE):
        best_course(chain, states, bins, spread, course)
        if not lies_elsewhere(states, course, near):
            return False
    copy_rows(0, n, states, again)
    for k in range(n):  # assigning to a slice takes a second to compile
        again[k, BODY], again[k, HEAD] = course[k, 0], course[k, 1]
    # The grid is coarser than accurate observations.
    admit_rejected(chain.problem, chain.track, again[:n])
    return True


_REJECTED = 8.0
"""κ·(1 − cos Δ) from which an observed angle counts as rejected: four standard deviations."""


@inner
def observed_angle(frame: Any, place: int) -> tuple[float, float, float, float]:
    """Return an observed angle, its concentration, the outliers' share, and the turn's concentration."""
    if place == BODY:
        angle = math.atan2(frame.observed_body_sin, frame.observed_body_cos)
        return angle, frame.body_kappa, frame.body_uniform, frame.body_turn_kappa
    angle = math.atan2(frame.observed_head_sin, frame.observed_head_cos)
    return angle, frame.head_kappa, frame.head_uniform, frame.head_turn_kappa


@inner
def is_rejected(frame: Any, place: int, angle: float) -> bool:
    """Return True if an observed angle is far from an estimate, and may be an outlier."""
    at, kappa, uniform, _ = observed_angle(frame, place)
    return uniform > 0.0 and kappa * (1.0 - math.cos(angle - at)) > _REJECTED


@allocating
def admit_rejected(problem: Problem, track: int, states: FloatArray) -> bool:
    """Move estimates (n, 6) to rejected observations of angles on the cheapest course; True if one moves.

    Where outliers have a probability, the cost of an accurate observation is flat a few of its standard
    deviations away, and no descent arrives there. The course goes through the estimate or the observation of
    each frame (Viterbi algorithm); turns and observations count.
    """
    n, moved, offset = len(states), False, problem.offsets[track]
    value, back = np.zeros(2), np.zeros((n, 2), np.int64)
    for place in (BODY, HEAD):
        rejected = False
        for k in range(n):
            rejected |= is_rejected(problem.records[offset + k], place, states[k, place])
        if not rejected:
            continue
        before, value[0], value[1] = (states[0, place], states[0, place]), 0.0, math.inf
        for k in range(n):
            angle, kappa, uniform, turning = observed_angle(problem.records[offset + k], place)
            here = states[k, place]
            there = angle if is_rejected(problem.records[offset + k], place, here) else here
            stay, go = math.inf, math.inf
            for way in range(2):
                to_here = value[way] + turning * (1.0 - math.cos(here - before[way]))
                to_there = value[way] + turning * (1.0 - math.cos(there - before[way]))
                if to_here < stay:
                    stay, back[k, 0] = to_here, way
                if to_there < go:
                    go, back[k, 1] = to_there, way
            value[0] = stay + angle_cost(math.cos(angle - here), kappa, uniform)
            value[1] = go + angle_cost(math.cos(angle - there), kappa, uniform)
            before = here, there
        way = 1 if value[1] < value[0] else 0
        for k in range(n - 1, -1, -1):
            if way == 1 and is_rejected(problem.records[offset + k], place, states[k, place]):
                turn = observed_angle(problem.records[offset + k], place)[0] - states[k, place]
                states[k, place] += wrapped(turn)
                moved = True
            way = back[k, way]
    return moved


SLOW = 0.3  # m/s below which a person may stand: half of the slowest walk

BRIEF = 0.5  # Seconds for which the estimated speed of a standing person may exceed `SLOW`

_GOES_ON = 0.1  # Of the mean turn in a slow stretch, above which the frames around it turn on


@inner
def turn_to(chain: Chain, k: int, states: FloatArray, place: int) -> tuple[float, float]:
    """The turn of an orientation from frame k − 1 to frame k, and the variance of diffusion."""
    frame = chain.problem.records[chain.problem.offsets[chain.track] + k]
    kappa = frame.body_turn_kappa if place == BODY else frame.head_turn_kappa
    turn = states[k, place] - states[k - 1, place]
    return wrapped(turn), 1.0 / kappa if kappa > 0.0 else TURN


@compiled
def unwind(chain: Chain, states: FloatArray, dearer: float, workspace: Workspace) -> bool:
    """Put into ``workspace.again`` states with slow turns of over 180° reversed; True if there are any.

    ``dearer``: if positive, each turn is followed to its ends, at any speed, and smaller turns are reversed
    too, where that increases the cost of diffusion by at most ``dearer``.
    """
    frames, again = chain.n, workspace.again
    records, offset = chain.problem.records, chain.problem.offsets[chain.track]
    found = False
    for place in (BODY, HEAD):
        begin, slow, since, turned, at_slow = -1, 0, 0.0, 0.0, 0.0
        for k in range(frames):
            vx, vy, step = states[k, VX], states[k, VY], 0.0
            if k > 0:
                since += records[offset + k].dt
                step = turn_to(chain, k, states, place)[0]
                turned += step
            if vx * vx + vy * vy < SLOW * SLOW:
                if begin < 0:
                    begin, turned = max(k - 1, 0), step
                slow, since, at_slow = k, 0.0, turned
            if begin < 0 or (since <= BRIEF + TIME_TOLERANCE and k < frames - 1):
                continue
            # The stretch is over: it lasted up to the frame after the last slow one.
            variance = 0.0
            if dearer > 0.0 and slow > begin:
                least = _GOES_ON * at_slow / (slow - begin)
                for m in range(begin + 1, slow + 1):
                    variance += turn_to(chain, m, states, place)[1]
                while begin > 0:
                    step, diffuses = turn_to(chain, begin, states, place)
                    if not step * least > least * least:
                        break
                    begin, at_slow, variance = begin - 1, at_slow + step, variance + diffuses
                while slow < frames - 1:
                    step, diffuses = turn_to(chain, slow + 1, states, place)
                    if not step * least > least * least:
                        break
                    slow, at_slow, variance = slow + 1, at_slow + step, variance + diffuses
            # A turn costs half of its square over the variance.
            if TURN * (math.pi - abs(at_slow)) < dearer * variance:
                if not found:
                    copy_rows(0, frames, states, again)
                    found = True
                first = states[begin, place]
                other = wrapped(at_slow)
                if other == at_slow:
                    other -= math.copysign(TURN, at_slow)
                for m in range(begin + 1, slow):
                    again[m, place] = first + other * ((m - begin) / (slow - begin))
            begin = -1
    return found
