"""`gait.infer_modes` of tracks side by side: the recursions over modes and offsets, each in one pass a frame.

Probabilities are not normalised where they are kept; what reads them divides by their sum.
"""

from __future__ import annotations

import math
from typing import Any

from graphtrack.geometry.angles import FloatArray
from graphtrack.inference.chain.lane_mode_memory import DT, TURN, ModeMemory
from graphtrack.model.kernels.branches import any_of, choose
from graphtrack.model.kernels.compiled import compiled
from graphtrack.model.kernels.elementary import exp
from graphtrack.model.kernels.lanes import load, store
from graphtrack.model.kernels.vector_math import exp2
from graphtrack.model.terms.gait import BINS, MOST_DRIFT, ROW, Modes

LAST = BINS - 1


@compiled
def drift_of(drift: float, dt: Any) -> tuple[Any, Any]:
    """How many passes `gait.drift` has in ``dt`` seconds, and how far each goes."""
    share = dt * (drift / (TURN / BINS) ** 2)
    passes = choose(share > 0.0, -math.floor(-2.0 * share), 0.0)
    passes = choose(passes < float(MOST_DRIFT), passes, float(MOST_DRIFT))
    side = choose(passes > 0.0, 0.5 * share / passes, 0.0)
    return passes, choose(side < 1.0 / 3.0, side, 1.0 / 3.0)


@compiled
def drift_further(rows: FloatArray, at: int, passes: Any, side: Any) -> None:
    """All passes of a drift but one, of the free offsets from a place in the rows on."""
    turn = 1.0
    while any_of(passes > turn):
        share = choose(passes > turn, side, 0.0)
        first = own = load(rows, at)
        behind = load(rows, at + LAST)
        for j in range(LAST):
            beyond = load(rows, at + j + 1)
            store(rows, at + j, own + share * (behind + beyond - 2.0 * own))
            behind, own = own, beyond
        store(rows, at + LAST, own + share * (behind + first - 2.0 * own))
        turn += 1.0


@compiled
def filter_lanes(n: int, modes: Modes, frames: FloatArray, memory: ModeMemory) -> None:
    """Forward: each frame's probabilities given those before; log likelihoods become likelihoods."""
    row, filtered, fields = memory.row, memory.filtered, frames.shape[1]
    anywhere, near, spare = modes.anywhere, modes.share, len(memory.filtered) - 1
    share = load(frames, DT) * 0.0 + 1.0
    for k in range(n):
        at = k * ROW
        greatest, total = load(row, at), 0.0 * share
        for j in range(1, ROW):
            other = load(row, at + j)
            greatest = choose(other > greatest, other, greatest)
        if k == 0:
            for j in range(BINS):
                says = exp2(load(row, j) - greatest)
                store(row, j, says)
                now = says * ((1.0 - modes.aligned) * anywhere[j])
                store(filtered, j, now)
                total += now
            for j in range(BINS, ROW):
                says = exp2(load(row, j) - greatest)
                store(row, j, says)
                now = says * (modes.aligned * near[j - BINS])
                store(filtered, j, now)
                total += now
            share = 1.0 / total
            continue
        dt = load(frames, k * fields + DT)
        passes, side = drift_of(modes.drift, dt)
        found = at - ROW
        if any_of(passes > 1.0):
            found = spare * ROW
            for j in range(BINS):
                store(filtered, found + j, load(filtered, at - ROW + j))
            drift_further(filtered, found, passes, side)
        # Of what sums to 1, what changes is drawn anew from the long run.
        kept = exp(-modes.switching * dt)
        free, aligned = (1.0 - kept) * (1.0 - modes.aligned), (1.0 - kept) * modes.aligned
        kept *= share
        own, behind = load(filtered, found), load(filtered, found + LAST)
        for j in range(BINS):
            beyond = load(filtered, found + (j + 1 if j < LAST else 0))
            moved = own + side * (behind + beyond - 2.0 * own)
            says = exp2(load(row, at + j) - greatest)
            store(row, at + j, says)
            now = says * (kept * moved + free * anywhere[j])
            store(filtered, at + j, now)
            total += now
            behind, own = own, beyond
        for j in range(BINS, ROW):
            says = exp2(load(row, at + j) - greatest)
            store(row, at + j, says)
            now = says * (kept * load(filtered, at - ROW + j) + aligned * near[j - BINS])
            store(filtered, at + j, now)
            total += now
        share = 1.0 / total


@compiled
def begin_back(frames: FloatArray, memory: ModeMemory) -> None:
    """Nothing follows the last frame."""
    zero = load(frames, DT) * 0.0
    for j in range(2 * ROW):
        store(memory.after, j, zero)
    store(memory.step, 0, zero)
    store(memory.step, 1, zero + 1.0)
    store(memory.step, 2, zero)


@compiled
def smooth_lanes(k: int, modes: Modes, frames: FloatArray, memory: ModeMemory) -> tuple[Any, ...]:
    """One frame backward; its probabilities are left in the memory.

    Returns the sums of those of free and of aligned offsets, of their cosines, and of their sines.
    """
    row, filtered, after, weights = memory.row, memory.filtered, memory.after, memory.weight
    anywhere, near, cosines, sines = modes.anywhere, modes.share, modes.cos, modes.sin
    scale, anew, side = load(memory.step, 0), load(memory.step, 1), load(memory.step, 2)
    at, target = k * ROW, (k & 1) * ROW
    source = ROW - target
    free = free_cos = free_sin = aligned = near_cos = near_sin = follows = follows_near = 0.0 * scale
    own, behind = load(after, source), load(after, source + LAST)
    for j in range(BINS):
        beyond = load(after, source + (j + 1 if j < LAST else 0))
        says = scale * (own + side * (behind + beyond - 2.0 * own)) + anew
        weight = says * load(filtered, at + j)
        store(weights, j, weight)
        free += weight
        free_cos += weight * cosines[j]
        free_sin += weight * sines[j]
        says *= load(row, at + j)
        store(after, target + j, says)
        follows += says * anywhere[j]
        behind, own = own, beyond
    for j in range(BINS, ROW):
        says = scale * load(after, source + j) + anew
        weight = says * load(filtered, at + j)
        store(weights, j, weight)
        aligned += weight
        near_cos += weight * cosines[j]
        near_sin += weight * sines[j]
        says *= load(row, at + j)
        store(after, target + j, says)
        follows_near += says * near[j - BINS]
    # Of the frame before: what follows it, as if this frame's were drawn anew, is taken as 1.
    dt = load(frames, k * frames.shape[1] + DT)
    inside, kept = dt > 0.0, exp(-modes.switching * dt)
    passes, side = drift_of(modes.drift, dt)
    mixed = (1.0 - modes.aligned) * follows + modes.aligned * follows_near
    store(memory.step, 0, choose(inside, kept / mixed, 0.0))
    store(memory.step, 1, choose(inside, 1.0 - kept, 1.0))
    store(memory.step, 2, side)
    drift_further(after, target, passes, side)
    return free, free_cos, free_sin, aligned, near_cos, near_sin
