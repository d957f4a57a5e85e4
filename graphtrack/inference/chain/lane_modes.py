"""`modes.renew_couplings` of tracks side by side, whose records and states stand in a `LaneMemory`."""

from __future__ import annotations

import math
from typing import Any

from graphtrack.geometry.angles import FloatArray
from graphtrack.inference.chain.lane_mode_memory import (
    AHEAD,
    AHEAD_BODY,
    AHEAD_VX,
    AHEAD_VY,
    BODY_INFORMATION,
    BODY_KAPPA,
    DT,
    HEAD_INFORMATION,
    HEAD_KAPPA,
    MOTION,
    PIXEL_SEEN,
    POSITION_SEEN,
    SEEN_BODY,
    SEEN_HEAD,
    STEER,
    STEER_RATE,
    TO_BODY,
    TO_HEAD,
    WEIGHT,
    ModeMemory,
    look_ahead,
)
from graphtrack.inference.chain.lane_newton import LaneMemory
from graphtrack.inference.chain.lane_recursions import begin_back, filter_lanes, smooth_lanes
from graphtrack.inference.chain.result import Result
from graphtrack.model.kernels.branches import any_of, choose
from graphtrack.model.kernels.compiled import compiled
from graphtrack.model.kernels.elementary import LOG2E, log
from graphtrack.model.kernels.lane_singles import softness
from graphtrack.model.kernels.lanes import LANES, load, row_of, store
from graphtrack.model.kernels.layout import BODY, VX, VY
from graphtrack.model.kernels.problem import Problem
from graphtrack.model.kernels.vector_math import cos_sin, direction_of, expm1
from graphtrack.model.terms.body_follows_motion import squared_excess
from graphtrack.model.terms.gait import BINS, ROW, Gait, Modes
from graphtrack.model.terms.intentional_motion import SMALL_TURN


@compiled
def judge(
    frames: FloatArray, at: int, row: FloatArray, first: int, modes: Modes, weight: Any, cos: Any, sin: Any
) -> None:
    """`gait.add_seen` of all lanes: of what stands at ``at``, as seen from a direction, to a row.

    In bits, and but for a constant, which probabilities do not have. What is softened is known within 2·10⁻⁷,
    by which answers change by 10⁻⁸.
    """
    kappa = load(frames, at + 2)
    known = weight * kappa > 0.0
    if not any_of(known):
        return
    mean_cos, mean_sin, uniform = load(frames, at), load(frames, at + 1), load(frames, at + 3)
    # What was not seen stands there as NaN.
    weight, kappa = choose(known, weight, 0.0), choose(known, kappa * LOG2E, 0.0)
    along = choose(known, kappa * (mean_cos * cos + mean_sin * sin), 0.0)
    across = choose(known, kappa * (mean_sin * cos - mean_cos * sin), 0.0)
    softened, cosines, sines = uniform > 0.0, modes.cos, modes.sin
    if any_of(softened):
        # log₂(2ˢ + ε) = log₂ ε + log₂(1 + 2ˣ) with x = s − log₂ ε: x where that is positive, and the rest.
        beyond = kappa + choose(softened, LOG2E * log(choose(softened, uniform, 1.0)), 0.0)
        for j in range(0, ROW, 2):
            after = min(j + 1, ROW - 1)
            one = cosines[j] * along + sines[j] * across - beyond
            two = cosines[after] * along + sines[after] * across - beyond
            rest, other = softness(one, two)
            one = choose(softened, choose(one > 0.0, one, 0.0) + rest, one)
            two = choose(softened, choose(two > 0.0, two, 0.0) + other, two)
            store(row, first + j, load(row, first + j) + weight * one)
            if after > j:
                store(row, first + after, load(row, first + after) + weight * two)
        return
    for j in range(ROW):
        says = cosines[j] * along + sines[j] * across - kappa
        store(row, first + j, load(row, first + j) + weight * says)


@compiled
def judge_body(
    n: int, gait: Gait, threshold: float, frames: FloatArray, states: FloatArray, memory: ModeMemory
) -> None:
    """`modes.judge_body` of all lanes."""
    row, ahead = memory.row, memory.ahead
    for k in range(n):
        at, state = k * frames.shape[1], row_of(states, k)
        zero = 0.0 * load(frames, at + DT)
        for j in range(ROW):
            store(row, k * ROW + j, zero)
        spread, head = load(frames, at + HEAD_KAPPA), load(frames, at + HEAD_INFORMATION)
        coupling = load(frames, at + BODY_KAPPA) * squared_excess(state[VX], state[VY], threshold)
        seen = (load(frames, at + POSITION_SEEN) > 0.0) | (load(frames, at + PIXEL_SEEN) > 0.0)
        active = (coupling > 0.0) & seen
        if not any_of(active):
            continue
        cos, sin = direction_of(load(ahead, k * AHEAD + AHEAD_VX), load(ahead, k * AHEAD + AHEAD_VY))
        loose = coupling * spread
        share = choose(active, coupling / (coupling + load(frames, at + BODY_INFORMATION)), 0.0)
        head_share = gait.head_evidence * loose / (loose + head * (coupling + spread) + 1e-300)
        judge(frames, at + SEEN_BODY, row, k * ROW, gait.body, share, cos, sin)
        judge(frames, at + SEEN_HEAD, row, k * ROW, gait.body, choose(active, head_share, 0.0), cos, sin)


@compiled
def judge_head(
    n: int, gait: Gait, threshold: float, frames: FloatArray, states: FloatArray, memory: ModeMemory
) -> None:
    """`modes.judge_head` of all lanes."""
    row = memory.row
    for k in range(n):
        at, state = k * frames.shape[1], row_of(states, k)
        zero = 0.0 * load(frames, at + DT)
        for j in range(ROW):
            store(row, k * ROW + j, zero)
        coupling = load(frames, at + HEAD_KAPPA)
        seen = (load(frames, at + POSITION_SEEN) > 0.0) | (load(frames, at + PIXEL_SEEN) > 0.0)
        moves = seen & (squared_excess(state[VX], state[VY], threshold) > 0.0)
        active = (coupling > 0.0) & (moves | (load(frames, at + BODY_INFORMATION) > 0.0))
        if not any_of(active):
            continue
        cos, sin = cos_sin(load(memory.ahead, k * AHEAD + AHEAD_BODY))
        share = choose(active, coupling / (coupling + load(frames, at + HEAD_INFORMATION)), 0.0)
        judge(frames, at + SEEN_HEAD, row, k * ROW, gait.head, share, cos, sin)


@compiled
def pulls_apart(modes: Modes, share: Any, cos: Any, sin: Any, weights: FloatArray) -> Any:
    """`gait.deviation` of all lanes about a direction; ``share`` makes the weights sum to 1."""
    free = near = 0.0 * cos
    for j in range(BINS):
        pull = modes.sin[j] * cos - modes.cos[j] * sin
        free += load(weights, j) * pull * pull
    for j in range(BINS, ROW):
        pull = modes.sin[j] * cos - modes.cos[j] * sin
        near += load(weights, j) * pull * pull
    strength, free_strength = modes.strength, modes.free_strength
    return math.sqrt(share * (free_strength * free_strength * free + strength * strength * near))


@compiled
def couple(
    frames: FloatArray,
    at: int,
    modes: Modes,
    kappa: Any,
    lead: Any,
    excess: Any,
    missing: Any,
    weight: Any,
    diffusion: float,
    found: tuple[Any, ...],
    weights: FloatArray,
    last: bool,
) -> Any:
    """`modes.couple` and `modes.loosened` of all lanes into the records; returns what the pull is spread by.

    ``lead``: cosine and sine; ``found``: from `smooth_lanes`. The spread is found on the ``last`` pass alone.
    """
    free, free_cos, free_sin, aligned, near_cos, near_sin = found
    lead_cos, lead_sin = lead
    share = 1.0 / (free + aligned)
    cos = share * (modes.free_strength * free_cos + modes.strength * near_cos)
    sin = share * (modes.free_strength * free_sin + modes.strength * near_sin)
    size = math.sqrt(cos * cos + sin * sin)
    some = size > 0.0
    cos, sin = choose(some, cos / size, 1.0), choose(some, sin / size, 0.0)
    spread = 0.0 * kappa
    given = choose(some, kappa * size, 0.0)
    # So much the one may have turned while the lead is not known.
    loosened = choose(
        (missing > 0.0) & (given > 0.0), 1.0 / (1.0 + given * excess / weight * diffusion * missing), 1.0
    )
    if last:
        spread = choose(some, kappa * loosened * pulls_apart(modes, share, cos, sin, weights), 0.0)
    store(frames, at, given * loosened)
    store(frames, at + 1, choose(some, cos * lead_cos - sin * lead_sin, 1.0))
    store(frames, at + 2, choose(some, sin * lead_cos + cos * lead_sin, 0.0))
    return spread


@compiled
def steer_lanes(frames: FloatArray, at: int, rate: Any) -> None:
    """`intentional_motion.steer` of all lanes: of the record that begins at ``at``."""
    dt, information = load(frames, at + DT), load(frames, at + MOTION)
    x = rate * dt
    some = (x > 0.0) & (information > 0.0)
    small = x < SMALL_TURN
    rate, x, dt = choose(some, rate, 1.0), choose(some, x, 1.0), choose(some, dt, 1.0)
    once, twice = expm1(-x), expm1(-2.0 * x)
    reach = choose(small, dt * (1.0 - x / 2.0 + x * x / 6.0), -once / rate)
    place = (dt + 2.0 * once / rate - twice / (2.0 * rate)) / (rate * rate)
    place = choose(small, dt * dt * dt / 3.0 * (1.0 - 0.75 * x + 0.35 * x * x), place)
    cross = choose(small, dt * dt / 2.0 * (1.0 - x + 7.0 * x * x / 12.0), once * once / (2.0 * rate * rate))
    spread = choose(small, dt * (1.0 - x + 2.0 * x * x / 3.0), -twice / (2.0 * rate))
    scale = information / (place * spread - cross * cross)
    store(frames, at + STEER, choose(some, -once, 0.0))
    store(frames, at + STEER + 1, reach)
    store(frames, at + STEER + 2, spread * scale)
    store(frames, at + STEER + 3, -cross * scale)
    store(frames, at + STEER + 4, place * scale)


@compiled
def renew_body(
    n: int, gait: Gait, threshold: float, diffusion: float, last: bool, group: LaneMemory, memory: ModeMemory
) -> None:
    """The first coupling of a group's frames, and what is held of it for the second."""
    frames, states, fields = group.frames, group.states, group.frames.shape[1]
    look_ahead(n, gait.body.lead, True, group, memory.ahead)
    judge_body(n, gait, threshold, frames, states, memory)
    filter_lanes(n, gait.body, frames, memory)
    begin_back(frames, memory)
    left = 0.0 * load(frames, DT)
    for k in range(n - 1, -1, -1):
        at, state = k * fields, row_of(states, k)
        found = smooth_lanes(k, gait.body, frames, memory)
        own_cos, own_sin = direction_of(state[VX], state[VY])
        cos, sin = direction_of(
            load(memory.ahead, k * AHEAD + AHEAD_VX), load(memory.ahead, k * AHEAD + AHEAD_VY)
        )
        lead = cos * own_cos + sin * own_sin, sin * own_cos - cos * own_sin
        spread = couple(
            frames,
            at + TO_BODY,
            gait.body,
            load(frames, at + BODY_KAPPA),
            lead,
            squared_excess(state[VX], state[VY], threshold),
            gait.body.lead - left,
            load(frames, at + WEIGHT),
            diffusion,
            found,
            memory.weight,
            last,
        )
        free, free_cos, free_sin, aligned, near_cos, near_sin = found
        share = 1.0 / (free + aligned)
        store(memory.held, 2 * k, share * (free_cos + near_cos))
        store(memory.held, 2 * k + 1, share * (free_sin + near_sin))
        store(memory.spread, 2 * k, spread)
        # It has no other use: where the last pass finds the probability of an aligned body.
        store(memory.ahead, k * AHEAD + AHEAD_VX, share * aligned)
        left += load(frames, at + DT)


@compiled
def renew_head(
    n: int, gait: Gait, threshold: float, diffusion: float, last: bool, group: LaneMemory, memory: ModeMemory
) -> None:
    """The second coupling of a group's frames, and how far the head steers the steps after them."""
    frames, states, fields = group.frames, group.states, group.frames.shape[1]
    look_ahead(n, gait.head.lead, False, group, memory.ahead)
    judge_head(n, gait, threshold, frames, states, memory)
    filter_lanes(n, gait.head, frames, memory)
    begin_back(frames, memory)
    left, common = 0.0 * load(frames, DT), math.sqrt(gait.head_common)
    for k in range(n - 1, -1, -1):
        at, state = k * fields, row_of(states, k)
        found = smooth_lanes(k, gait.head, frames, memory)
        lead = cos_sin(load(memory.ahead, k * AHEAD + AHEAD_BODY) - state[BODY])
        spread = couple(
            frames,
            at + TO_HEAD,
            gait.head,
            load(frames, at + HEAD_KAPPA),
            lead,
            1.0 + 0.0 * left,
            gait.head.lead - left,
            load(frames, at + WEIGHT),
            diffusion,
            found,
            memory.weight,
            last,
        )
        store(memory.spread, 2 * k + 1, common * spread)
        left += load(frames, at + DT)
        if k < n - 1:
            # The head steers as far as it is expected to point where the motion goes.
            free, free_cos, free_sin, aligned, near_cos, near_sin = found
            cos, sin = load(memory.held, 2 * k), load(memory.held, 2 * k + 1)
            forth = (cos * (free_cos + near_cos) - sin * (free_sin + near_sin)) / (free + aligned)
            after = at + fields
            seen = (load(frames, after + POSITION_SEEN) > 0.0) | (load(frames, after + PIXEL_SEEN) > 0.0)
            share = choose(seen, gait.head_rate_seen, 1.0) * choose(forth > 0.0, forth, 0.0)
            steer_lanes(frames, after, load(frames, after + STEER_RATE) * share)


@compiled
def put_modes(problem: Problem, group: LaneMemory, memory: ModeMemory, modes: FloatArray) -> None:
    """What was found of the body's mode into the answer."""
    for lane in range(LANES):
        if group.tracks[lane] >= 0:
            begin = problem.offsets[group.tracks[lane]]
            for k in range(int(group.lengths[0, lane])):
                modes[begin + k, 0] = memory.ahead[k, AHEAD_VX, lane]
                modes[begin + k, 1] = math.atan2(memory.held[k, 1, lane], memory.held[k, 0, lane])


@compiled
def renew_lanes(
    problem: Problem, n: int, gait: Gait, last: bool, group: LaneMemory, memory: ModeMemory, result: Result
) -> None:
    """Set the couplings of a group of up to n frames, in which no class likelihoods are known.

    On the ``last`` pass also the spread of what they pull with, and what the answer says of modes.
    """
    shared = problem.shared[0]
    threshold, diffusion = shared.speed_threshold, shared.body_diffusion
    renew_body(n, gait, threshold, diffusion, last, group, memory)
    renew_head(n, gait, threshold, diffusion, last, group, memory)
    if last:
        put_modes(problem, group, memory, result.modes)
