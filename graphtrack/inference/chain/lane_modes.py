"""`modes.renew_tracks` of several tracks side by side: the same recursions over modes and offsets."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from graphtrack.geometry.angles import FloatArray
from graphtrack.inference.chain.lane_mode_memory import (
    AHEAD_BODY,
    AHEAD_VX,
    AHEAD_VY,
    BODY_INFORMATION,
    BODY_KAPPA,
    DT,
    FIELDS,
    HEAD_INFORMATION,
    HEAD_KAPPA,
    OF_BODY,
    OF_HEAD,
    OWN_BODY,
    OWN_VX,
    OWN_VY,
    SEEN,
    TURN,
    WEIGHT,
    ModeMemory,
    gather_modes,
)
from graphtrack.inference.chain.modes import is_seen
from graphtrack.model.kernels.branches import any_of, choose
from graphtrack.model.kernels.compiled import apart, compiled, inner
from graphtrack.model.kernels.elementary import exp, log
from graphtrack.model.kernels.lanes import LANES, load, store
from graphtrack.model.kernels.problem import Problem
from graphtrack.model.kernels.vector_math import cos_sin, direction_of
from graphtrack.model.terms.body_follows_motion import squared_excess
from graphtrack.model.terms.gait import BINS, MOST_DRIFT, NEAR, ROW, Gait, Modes
from graphtrack.model.terms.intentional_motion import steer


@inner
def judge(given: FloatArray, at: int, row: Any, modes: Modes, weight: Any, cos: Any, sin: Any) -> None:
    """`gait.add_seen` of all lanes: of what stands at ``at``, as seen from a direction, to the row there."""
    mean_cos, mean_sin, kappa, uniform = (
        load(given, at),
        load(given, at + 1),
        load(given, at + 2),
        load(given, at + 3),
    )
    known = weight * kappa > 0.0
    if not any_of(known):
        return
    weight = choose(known, weight, 0.0)
    along = choose(known, mean_cos * cos + mean_sin * sin, 0.0)
    across = choose(known, mean_sin * cos - mean_cos * sin, 0.0)
    rows, first = row
    softened, share = uniform > 0.0, 1.0 / (1.0 + uniform)
    soft = any_of(softened)
    cosines, sines = modes.cos, modes.sin
    for j in range(ROW):
        says = kappa * (cosines[j] * along + sines[j] * across - 1.0)
        if soft:
            says = choose(softened, log((exp(says) + uniform) * share) - 2.0 * kappa, says)
        store(rows, first + j, load(rows, first + j) + weight * says)


@inner
def drift_lanes(row: FloatArray, passes: int, side: Any, left: Any, memory: FloatArray) -> None:
    """`gait.drift` of the first `BINS` of (ROW, LANES); ``left``: passes that each lane has."""
    last = BINS - 1
    for turn in range(passes):
        share = choose(left > float(turn), side, 0.0)
        for j in range(BINS):
            store(memory, j, load(row, j))
        for j in range(1, last):
            own = load(memory, j)
            store(row, j, own + share * (load(memory, j - 1) + load(memory, j + 1) - 2.0 * own))
        own = load(memory, 0)
        store(row, 0, own + share * (load(memory, last) + load(memory, 1) - 2.0 * own))
        own = load(memory, last)
        store(row, last, own + share * (load(memory, last - 1) + load(memory, 0) - 2.0 * own))


@compiled
def passes_of(drift: float, dt: FloatArray, found: FloatArray) -> int:
    """How many passes the lanes' drifts take, and how far each goes, (2, LANES); returns the most."""
    most = 0
    for lane in range(LANES):
        share = drift * dt[lane] / (TURN / BINS) ** 2
        passes = int(min(math.ceil(2.0 * share), MOST_DRIFT)) if share > 0.0 else 0
        found[0, lane] = passes
        found[1, lane] = min(0.5 * share / passes, 1.0 / 3.0) if passes > 0 else 0.0
        most = max(most, passes)
    return most


@inner
def infer_lanes(n: int, modes: Modes, memory: ModeMemory) -> None:
    """`gait.infer_modes` of all lanes from their rows; the smoothed probabilities are put into the memory."""
    row, probability, now, before = memory.row, memory.probability, memory.now, memory.before
    anywhere, near, found = modes.anywhere, modes.share, memory.found
    one = load(memory.given, DT) * 0.0 + 1.0
    for j in range(BINS):
        store(now, j, one * (1.0 - modes.aligned) * anywhere[j])
    for j in range(NEAR):
        store(now, BINS + j, one * modes.aligned * near[j])
    for k in range(n):
        if k > 0:
            dt = load(memory.given, k * FIELDS + DT)
            passes = passes_of(modes.drift, memory.given[k, DT], found)
            drift_lanes(now, passes, load(found, 1), load(found, 0), before)
            # The probabilities sum to 1; what changes is drawn anew from the long run.
            kept = exp(-modes.switching * dt)
            anew = (1.0 - kept) * (1.0 - modes.aligned)
            for j in range(BINS):
                store(now, j, kept * load(now, j) + anew * anywhere[j])
            anew = (1.0 - kept) * modes.aligned
            for j in range(NEAR):
                store(now, BINS + j, kept * load(now, BINS + j) + anew * near[j])
        greatest, total = load(row, k * ROW), 0.0 * one
        for j in range(1, ROW):
            other = load(row, k * ROW + j)
            greatest = choose(other > greatest, other, greatest)
        for j in range(ROW):
            says = exp(load(row, k * ROW + j) - greatest)
            store(row, k * ROW + j, says)
            says *= load(now, j)
            store(now, j, says)
            total += says
        share = 1.0 / total
        for j in range(ROW):
            says = share * load(now, j)
            store(now, j, says)
            store(probability, k * ROW + j, says)
    for j in range(ROW):
        store(now, j, one)
    for k in range(n - 1, -1, -1):
        total = 0.0 * one
        for j in range(ROW):
            says = load(probability, k * ROW + j) * load(now, j)
            store(probability, k * ROW + j, says)
            total += says
        share = 1.0 / total
        for j in range(ROW):
            store(probability, k * ROW + j, share * load(probability, k * ROW + j))
        if k == 0:
            break
        # now: how likely all that follows is, from each mode and offset of the frame before.
        free = aligned = 0.0 * one
        for j in range(BINS):
            says = load(now, j) * load(row, k * ROW + j)
            store(now, j, says)
            free += says * anywhere[j]
        for j in range(NEAR):
            says = load(now, BINS + j) * load(row, k * ROW + BINS + j)
            store(now, BINS + j, says)
            aligned += says * near[j]
        kept = exp(-modes.switching * load(memory.given, k * FIELDS + DT))
        anew = (1.0 - kept) * ((1.0 - modes.aligned) * free + modes.aligned * aligned)
        total = 0.0 * one
        for j in range(ROW):
            says = kept * load(now, j) + anew
            store(now, j, says)
            total += says
        passes = passes_of(modes.drift, memory.given[k, DT], found)
        drift_lanes(now, passes, load(found, 1), load(found, 0), before)
        share, inside = 1.0 / total, load(memory.given, k * FIELDS + DT) > 0.0
        for j in range(ROW):
            store(now, j, choose(inside, share * load(now, j), 1.0))


@inner
def couple_lanes(k: int, modes: Modes, kappa: Any, lead_cos: Any, lead_sin: Any, memory: ModeMemory) -> Any:
    """`modes.couple` of all lanes: κ, cosine and sine of the offset, its pull, and those of the mean."""
    free_cos = free_sin = near_cos = near_sin = free = near = 0.0 * kappa
    first, cosines, sines = k * ROW, modes.cos, modes.sin
    for j in range(BINS):
        weight = load(memory.probability, first + j)
        free_cos += weight * cosines[j]
        free_sin += weight * sines[j]
    for j in range(BINS, ROW):
        weight = load(memory.probability, first + j)
        near_cos += weight * cosines[j]
        near_sin += weight * sines[j]
    cos = modes.free_strength * free_cos + modes.strength * near_cos
    sin = modes.free_strength * free_sin + modes.strength * near_sin
    size = math.sqrt(cos * cos + sin * sin)
    some = size > 0.0
    cos, sin = choose(some, cos / size, 1.0), choose(some, sin / size, 0.0)
    for j in range(BINS):
        pull = sines[j] * cos - cosines[j] * sin
        free += load(memory.probability, first + j) * pull * pull
    for j in range(BINS, ROW):
        pull = sines[j] * cos - cosines[j] * sin
        near += load(memory.probability, first + j) * pull * pull
    strength, free_strength = modes.strength, modes.free_strength
    pull = math.sqrt(free_strength * free_strength * free + strength * strength * near)
    given = choose(some, kappa * size, 0.0)
    turned_cos = choose(some, cos * lead_cos - sin * lead_sin, 1.0)
    turned_sin = choose(some, sin * lead_cos + cos * lead_sin, 0.0)
    spread = choose(some, kappa * pull, 0.0)
    return given, turned_cos, turned_sin, spread, free_cos + near_cos, free_sin + near_sin


@compiled
def loosened_lanes(kappa: Any, excess: Any, missing: Any, weight: Any, diffusion: float) -> Any:
    """`modes.loosened` of all lanes."""
    loose = kappa / (1.0 + kappa * excess / weight * diffusion * missing)
    return choose(missing > 0.0, loose, kappa)


@compiled
def put_body(problem: Problem, k: int, memory: ModeMemory, modes: FloatArray, spread: FloatArray) -> None:
    """What was found of the first coupling into the records and the answer."""
    for lane in range(LANES):
        track = memory.tracks[lane]
        if track < 0 or k >= problem.offsets[track + 1] - problem.offsets[track]:
            continue
        place, found = problem.offsets[track] + k, memory.found
        frame = problem.records[place]
        frame.motion_body_kappa = found[0, lane]
        frame.motion_body_cos, frame.motion_body_sin = found[1, lane], found[2, lane]
        spread[place, 0] = found[3, lane]
        aligned = 0.0
        for j in range(BINS, ROW):
            aligned += memory.probability[k, j, lane]
        modes[place, 0] = aligned
        modes[place, 1] = math.atan2(memory.held[k, 1, lane], memory.held[k, 0, lane])


@compiled
def put_head(
    problem: Problem, k: int, rate: float, ahead: FloatArray, memory: ModeMemory, spread: FloatArray
) -> None:
    """What was found of the second coupling, and how far the head steers the step after frame k."""
    for lane in range(LANES):
        track = memory.tracks[lane]
        if track < 0 or k >= problem.offsets[track + 1] - problem.offsets[track]:
            continue
        place, found = problem.offsets[track] + k, memory.found
        frame = problem.records[place]
        frame.head_body_kappa = found[0, lane]
        frame.head_body_cos, frame.head_body_sin = found[1, lane], found[2, lane]
        spread[place, 1] = found[3, lane]
        if k < problem.offsets[track + 1] - problem.offsets[track] - 1:
            after = problem.records[place + 1]
            share = rate if is_seen(after) else 1.0
            steer(after, after.steer_rate * share * max(ahead[0, lane], 0.0))


@compiled
def renew_group(
    problem: Problem, n: int, gait: Gait, memory: ModeMemory, modes: FloatArray, spread: FloatArray
) -> None:
    """`modes.renew_couplings` of a group that has been gathered, in which no class likelihoods are known."""
    given, row, found, shared = memory.given, memory.row, memory.found, problem.shared[0]
    threshold, diffusion = shared.speed_threshold, shared.body_diffusion
    ahead = np.empty((1, LANES))
    for k in range(n):
        at = k * FIELDS
        zero = 0.0 * load(given, at + DT)
        for j in range(ROW):
            store(row, k * ROW + j, zero)
        vx, vy = load(given, at + OWN_VX), load(given, at + OWN_VY)
        coupling = load(given, at + BODY_KAPPA) * squared_excess(vx, vy, threshold)
        active = (coupling > 0.0) & (load(given, at + SEEN) > 0.0)
        if not any_of(active):
            continue
        # As in `modes.judge_body`.
        cos, sin = direction_of(load(given, at + AHEAD_VX), load(given, at + AHEAD_VY))
        head, loose = load(given, at + HEAD_INFORMATION), coupling * load(given, at + HEAD_KAPPA)
        apart = coupling + load(given, at + HEAD_KAPPA)
        share = choose(active, coupling / (coupling + load(given, at + BODY_INFORMATION)), 0.0)
        head_share = choose(active, gait.head_evidence * loose / (loose + head * apart + 1e-300), 0.0)
        judge(given, at + OF_BODY, (row, k * ROW), gait.body, share, cos, sin)
        judge(given, at + OF_HEAD, (row, k * ROW), gait.body, head_share, cos, sin)
    infer_lanes(n, gait.body, memory)
    left = 0.0 * load(given, DT)
    for k in range(n - 1, -1, -1):
        at = k * FIELDS
        vx, vy = load(given, at + OWN_VX), load(given, at + OWN_VY)
        own_cos, own_sin = direction_of(vx, vy)
        cos, sin = direction_of(load(given, at + AHEAD_VX), load(given, at + AHEAD_VY))
        lead_cos, lead_sin = cos * own_cos + sin * own_sin, sin * own_cos - cos * own_sin
        kappa, offset_cos, offset_sin, pull, mean_cos, mean_sin = couple_lanes(
            k, gait.body, load(given, at + BODY_KAPPA), lead_cos, lead_sin, memory
        )
        beyond, weight = squared_excess(vx, vy, threshold), load(given, at + WEIGHT)
        loose = loosened_lanes(kappa, beyond, gait.body.lead - left, weight, diffusion)
        store(memory.held, 2 * k, mean_cos)
        store(memory.held, 2 * k + 1, mean_sin)
        store(found, 0, loose)
        store(found, 1, offset_cos)
        store(found, 2, offset_sin)
        store(found, 3, choose(kappa > 0.0, pull * loose / kappa, 0.0))
        put_body(problem, k, memory, modes, spread)
        left += load(given, at + DT)
    for k in range(n):
        at = k * FIELDS
        zero = 0.0 * load(given, at + DT)
        for j in range(ROW):
            store(row, k * ROW + j, zero)
        coupling = load(given, at + HEAD_KAPPA)
        # As in `modes.judge_head`.
        moves = squared_excess(load(given, at + OWN_VX), load(given, at + OWN_VY), threshold) > 0.0
        known = (moves & (load(given, at + SEEN) > 0.0)) | (load(given, at + BODY_INFORMATION) > 0.0)
        active = (coupling > 0.0) & known
        if not any_of(active):
            continue
        cos, sin = cos_sin(load(given, at + AHEAD_BODY))
        share = choose(active, coupling / (coupling + load(given, at + HEAD_INFORMATION)), 0.0)
        judge(given, at + OF_HEAD, (row, k * ROW), gait.head, share, cos, sin)
    infer_lanes(n, gait.head, memory)
    left = 0.0 * load(given, DT)
    common = math.sqrt(gait.head_common)
    for k in range(n - 1, -1, -1):
        at = k * FIELDS
        lead_cos, lead_sin = cos_sin(load(given, at + AHEAD_BODY) - load(given, at + OWN_BODY))
        kappa, offset_cos, offset_sin, pull, mean_cos, mean_sin = couple_lanes(
            k, gait.head, load(given, at + HEAD_KAPPA), lead_cos, lead_sin, memory
        )
        weight = load(given, at + WEIGHT)
        loose = loosened_lanes(kappa, 1.0, gait.head.lead - left, weight, diffusion)
        store(found, 0, loose)
        store(found, 1, offset_cos)
        store(found, 2, offset_sin)
        store(found, 3, choose(kappa > 0.0, common * pull * loose / kappa, 0.0))
        # The head steers as far as it is expected to point where the motion goes.
        store(ahead, 0, load(memory.held, 2 * k) * mean_cos - load(memory.held, 2 * k + 1) * mean_sin)
        put_head(problem, k, gait.head_rate_seen, ahead, memory, spread)
        left += load(given, at + DT)


@apart
def renew_lanes(
    problem: Problem,
    order: NDArray[np.int64],
    states: FloatArray,
    gait: Gait,
    memory: ModeMemory,
    modes: FloatArray,
    spread: FloatArray,
) -> None:
    """`modes.renew_tracks` of tracks in an ``order`` in which neighbours are about as long."""
    for begin in range(0, len(order), LANES):
        for lane in range(LANES):
            memory.tracks[lane] = order[begin + lane] if begin + lane < len(order) else -1
        n = gather_modes(problem, states, gait, memory)
        renew_group(problem, n, gait, memory, modes, spread)
