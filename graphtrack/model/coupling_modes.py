"""Coupling modes given the states: the mode of each coupling, and the resulting coupling.

The hidden Markov chains of `graphtrack.model.terms.couplings`, by the forward–backward recursion; the
couplings of the next descent are the expectation over modes and offsets. One source, also for lanes.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from graphtrack.geometry.angles import FloatArray
from graphtrack.kernels.arithmetic import cos_sin, direction_of, exp, floor_of, log
from graphtrack.kernels.compilation import allocating, compiled, inner, merged
from graphtrack.kernels.lanes import any_of, choose, lane_count, lane_of, masked, only_lane, sized
from graphtrack.kernels.layout import BODY, HEAD, VX, VY, Chain, Problem
from graphtrack.model.terms.couplings import BASE, BINS, MOST_DRIFT, ROW, Gait, Modes, squared_excess
from graphtrack.model.terms.motion import steer

BODY_MODE, HEAD_MODE = 0, 1  # Places of the two couplings in arrays of both

AHEAD_VX, AHEAD_VY, AHEAD_BODY = range(3)

GLANCE = 3  # Place of the probability of a glance in `ModeMemory.held`

_TURN = 2.0 * math.pi
_LAST = BINS - 1


class ModeMemory(NamedTuple):
    """Memory for the recursions over the modes of tracks of up to n frames: of one track, or of lanes."""

    dt: FloatArray  # (n,) seconds since the previous frame; 0 at a first frame
    ahead: FloatArray  # (n, 3) velocity and body orientation a lead later
    likelihood: FloatArray  # (n, ROW) of the observations at each of `BASE` offsets; their logarithm at first
    filtered_body: FloatArray  # (n, ROW) probabilities given the past, not normalised
    filtered_head: FloatArray  # (n, ROW)
    spare: FloatArray  # (1, ROW)
    after: FloatArray  # (2, ROW) likelihood of all following observations, for two frames
    weight: FloatArray  # (1, ROW) probabilities given all frames, not normalised
    before: FloatArray  # (2, ROW) filtered probabilities of both couplings in the frame before the first
    held: FloatArray  # (n, 4) offset from motion to body, cosine and sine; probabilities: aligned, a glance
    spread: FloatArray  # (n, 2) standard deviation of the pull of each coupling


sized(ModeMemory, ROW, ahead=3, held=4, spread=2)


@allocating
def mode_memory(n: int) -> ModeMemory:
    """Memory for tracks of up to n frames."""
    return ModeMemory(
        np.empty(n),
        np.empty((n, 3)),
        np.empty((n, ROW)),
        np.empty((n, ROW)),
        np.empty((n, ROW)),
        np.empty((1, ROW)),
        np.empty((2, ROW)),
        np.empty((1, ROW)),
        np.zeros((2, ROW)),
        np.empty((n, 4)),
        np.empty((n, 2)),
    )


# -- the states a lead later ---------------------------------------------------------------------------------


@compiled
def look_ahead(
    n: int, length: Any, states: FloatArray, lead: float, of_motion: bool, dt: FloatArray, ahead: FloatArray
) -> None:
    """Put velocity or body ``lead`` seconds after each frame into ``ahead`` (n, 3); the last beyond."""
    for k in range(n):
        if of_motion:
            ahead[k, AHEAD_VX] = ahead[k, AHEAD_VY] = 0.0 * length
        else:
            ahead[k, AHEAD_BODY] = 0.0 * length
    for lane in range(lane_count(length)):
        # ``since``: seconds from frame ``at`` to the moment looked for.
        frames, at, since = int(lane_of(length, lane)), 0, lead
        found = masked(ahead, only_lane(length > 0.0, lane))
        for k in range(frames):
            if k > 0:
                since += lane_of(dt[k], lane)
            while at < frames - 1 and since >= lane_of(dt[at + 1], lane):
                since -= lane_of(dt[at + 1], lane)
                at += 1
            while at > 0 and since < 0.0:
                since += lane_of(dt[at], lane)
                at -= 1
            share = 0.0
            if at < frames - 1:
                share = min(max(since / lane_of(dt[at + 1], lane), 0.0), 1.0)
            after = min(at + 1, frames - 1)
            if of_motion:
                vx, other_vx = lane_of(states[at, VX], lane), lane_of(states[after, VX], lane)
                vy, other_vy = lane_of(states[at, VY], lane), lane_of(states[after, VY], lane)
                found[k, AHEAD_VX] = (1.0 - share) * vx + share * other_vx
                found[k, AHEAD_VY] = (1.0 - share) * vy + share * other_vy
            else:
                # Neighbours may be written in different turns.
                body = lane_of(states[at, BODY], lane)
                turn = lane_of(states[after, BODY], lane) - body
                turn -= _TURN * floor_of(turn / _TURN + 0.5)
                found[k, AHEAD_BODY] = body + share * turn


# -- evidence ------------------------------------------------------------------------------------------------


@inner
def is_observed(frame: Any) -> Any:
    """Return True if a position was observed in a frame."""
    return (frame.position_information > 0.0) | (frame.pixel_information > 0.0)


class Base(NamedTuple):
    """Direction about which offsets are judged, and the weight of the observations there."""

    cos: Any
    sin: Any
    weight: Any


@inner
def add_angle_evidence(
    row: FloatArray, modes: Modes, base: Any, cos: Any, sin: Any, kappa: Any, uniform: Any
) -> None:
    """Add the log likelihood (BASE,) of an observed angle at each offset; see `orientation.add_angle`."""
    known = base.weight * kappa > 0.0
    if not any_of(known):
        return
    weight, kappa = choose(known, base.weight, 0.0), choose(known, kappa, 0.0)
    along = choose(known, kappa * (cos * base.cos + sin * base.sin), 0.0)
    across = choose(known, kappa * (sin * base.cos - cos * base.sin), 0.0)
    softened, cosines, sines = uniform > 0.0, modes.cos, modes.sin
    # Two loops: a condition within a loop prevents vectorisation.
    if not any_of(softened):
        for j in range(BASE):
            row[j] += weight * (cosines[j] * along + sines[j] * across - kappa)
        return
    for j in range(BASE):
        close = cosines[j] * along + sines[j] * across - kappa
        row[j] += weight * choose(softened, log(exp(close) + uniform), close)


@inner
def add_class_evidence(
    row: FloatArray, modes: Modes, base: Any, heights: FloatArray, directions: FloatArray, kappa: Any
) -> None:
    """The same for class likelihoods; ``heights`` and ``directions`` as in `orientation.add_classes`."""
    if not any_of(base.weight * kappa > 0.0):
        return
    n_classes = len(heights) - 1
    for j in range(BASE):
        along = base.cos * modes.cos[j] - base.sin * modes.sin[j]
        across = base.sin * modes.cos[j] + base.cos * modes.sin[j]
        density = 0.0 * along + heights[n_classes]
        for c in range(n_classes):
            close = along * directions[c, 0] + across * directions[c, 1]
            density += heights[c] * exp(kappa * (close - 1.0))
        row[j] += base.weight * log(density)


@inner
def add_body_evidence(problem: Problem, place: int, modes: Modes, base: Any, row: FloatArray) -> None:
    """Add the observations of the body, an angle and classes, of the frame whose record is at ``place``."""
    frame = problem.records[place]
    cos, sin = frame.observed_body_cos, frame.observed_body_sin
    add_angle_evidence(row, modes, base, cos, sin, frame.body_kappa, frame.body_uniform)
    if any_of(frame.body_class_kappa > 0.0):
        heights, directions = problem.body_heights[place], problem.body_directions
        add_class_evidence(row, modes, base, heights, directions, frame.body_class_kappa)


@inner
def add_head_evidence(problem: Problem, place: int, modes: Modes, base: Any, row: FloatArray) -> None:
    """Add the observations of the head in the same way."""
    frame = problem.records[place]
    cos, sin = frame.observed_head_cos, frame.observed_head_sin
    add_angle_evidence(row, modes, base, cos, sin, frame.head_kappa, frame.head_uniform)
    if any_of(frame.head_class_kappa > 0.0):
        heights, directions = problem.head_heights[place], problem.head_directions
        add_class_evidence(row, modes, base, heights, directions, frame.head_class_kappa)


@merged
def judge_body(chain: Chain, states: FloatArray, gait: Gait, memory: ModeMemory) -> None:
    """Log likelihoods (n, BASE) of the observations of body and head at each offset from the motion."""
    problem, offset = chain.problem, chain.problem.offsets[chain.track]
    threshold = problem.shared[0].speed_threshold
    for k in range(chain.n):
        frame, row = problem.records[offset + k], memory.likelihood[k]
        nothing = 0.0 * frame.dt
        for j in range(BASE):
            row[j] = nothing
        # Concentration of an aligned body about the motion in this frame; κ₁ contains the weight w here.
        coupling = frame.body_aligned_kappa * squared_excess(states[k, VX], states[k, VY], threshold)
        active = (coupling > 0.0) & is_observed(frame)
        if not any_of(active):
            continue
        cos, sin = direction_of(memory.ahead[k, AHEAD_VX], memory.ahead[k, AHEAD_VY])
        # Deviations persist, so consecutive frames repeat the same information: it is reduced by the factor
        # that the coupling transmits.
        share = choose(active, coupling / (coupling + frame.body_information), 0.0)
        head, spread = frame.head_information, frame.head_aligned_kappa
        loose = coupling * spread
        head_share = gait.head_evidence * loose / (loose + head * (coupling + spread) + 1e-300)
        head_share = choose(active, head_share, 0.0)
        add_body_evidence(problem, offset + k, gait.body, Base(cos, sin, share), row)
        add_head_evidence(problem, offset + k, gait.body, Base(cos, sin, head_share), row)


@merged
def judge_head(chain: Chain, states: FloatArray, modes: Modes, memory: ModeMemory) -> None:
    """Log likelihoods (n, BASE) of the observations of the head at each offset from the body."""
    problem, offset = chain.problem, chain.problem.offsets[chain.track]
    threshold = problem.shared[0].speed_threshold
    for k in range(chain.n):
        frame, row = problem.records[offset + k], memory.likelihood[k]
        nothing = 0.0 * frame.dt
        for j in range(BASE):
            row[j] = nothing
        coupling = frame.head_aligned_kappa
        # Without motion and body, as of standing people, the head would be compared with itself.
        motion = frame.body_aligned_kappa * squared_excess(states[k, VX], states[k, VY], threshold)
        known = frame.body_information + choose(is_observed(frame), motion, 0.0)
        active = (coupling > 0.0) & (known > 0.0)
        if not any_of(active):
            continue
        cos, sin = cos_sin(memory.ahead[k, AHEAD_BODY])
        tight = modes.strength * coupling
        share = tight / (tight + frame.head_information) * known / (known + coupling)
        share = choose(active, share, 0.0)
        add_head_evidence(problem, offset + k, modes, Base(cos, sin, share), row)


@compiled
def classified_in(problem: Problem, track: int) -> tuple[bool, bool]:
    """Return whether class likelihoods of the body, and of the head, exist in any frame of a track."""
    body = head = False
    for k in range(problem.offsets[track], problem.offsets[track + 1]):
        body = body or problem.records[k].body_class_kappa > 0.0
        head = head or problem.records[k].head_class_kappa > 0.0
    return body, head


# -- the recursions ------------------------------------------------------------------------------------------


@inner
def drift_of(drift: float, dt: Any) -> tuple[Any, Any]:
    """Number of diffusion passes for ``dt`` seconds, and the share that moves to either side in each."""
    share = dt * (drift / (_TURN / BINS) ** 2)
    # After `MOST_DRIFT` passes the density is nearly uniform.
    passes = choose(share > 0.0, -floor_of(-2.0 * share), 0.0)
    passes = choose(passes < float(MOST_DRIFT), passes, float(MOST_DRIFT))
    side = choose(passes > 0.0, 0.5 * share / choose(passes > 0.0, passes, 1.0), 0.0)
    return passes, choose(side < 1.0 / 3.0, side, 1.0 / 3.0)


@inner
def drift_further(row: FloatArray, passes: Any, side: Any) -> None:
    """All passes of a drift but the last, in place; the recursions make the last."""
    turn = 1.0
    while any_of(passes > turn):
        share = choose(passes > turn, side, 0.0)
        first = own = row[0]
        behind = row[_LAST]
        for j in range(_LAST):
            beyond = row[j + 1]
            row[j] = own + share * (behind + beyond - 2.0 * own)
            behind, own = own, beyond
        row[_LAST] = own + share * (behind + first - 2.0 * own)
        turn += 1.0


class Changes(NamedTuple):
    """Probabilities of mode changes within a step; a changed mode is redrawn from the stationary density."""

    begins: Any  # no glance before, a glance after
    ends: Any  # a glance before, none after
    kept: Any  # mode and offset, of no glance
    kept_glance: Any


@inner
def changes_in(modes: Modes, dt: Any) -> Any:
    """Return the changes within ``dt`` seconds, as `Changes`."""
    rate, share = modes.glance_change, modes.glance_share
    changed = 1.0 - exp(-rate * dt)
    kept = exp(-(share * rate + modes.switching) * dt)
    return Changes(share * changed, (1.0 - share) * changed, kept, exp(-(1.0 - share) * rate * dt))


@compiled
def filter_modes(n: int, modes: Modes, before: FloatArray, filtered: FloatArray, memory: ModeMemory) -> None:
    """The forward recursion, not normalised; ``before`` (ROW,) counts if the first frame has a dt."""
    likelihood, spare, anywhere, near = memory.likelihood, memory.spare[0], modes.anywhere, modes.share
    glances = modes.glance_share > 0.0
    share = 0.0 * memory.dt[0] + 1.0
    # The probability of no glance in the previous frame.
    base = share
    if any_of(memory.dt[0] > 0.0):
        base = 0.0 * share
        for j in range(BASE):
            base += before[j]
    for k in range(n):
        row, now, dt = likelihood[k], filtered[k], memory.dt[k]
        greatest = row[0]
        for j in range(1, BASE):
            greatest = choose(row[j] > greatest, row[j], greatest)
        for j in range(BASE):
            row[j] = exp(row[j] - greatest)
        base_total = glance_total = 0.0 * share
        previous = filtered[k - 1] if k > 0 else before
        passes, side = drift_of(modes.drift, dt)
        source = previous
        if any_of(passes > 1.0):
            for j in range(BINS):
                spare[j] = previous[j]
            drift_further(spare, passes, side)
            source = spare
        # At a first frame all modes are drawn from the stationary density.
        changes, inside = changes_in(modes, dt), dt > 0.0
        again = (1.0 - changes.begins - changes.kept) * base + changes.ends * (1.0 - base)
        again = choose(inside, again, 1.0 - modes.glance_share)
        free, aligned = again * (1.0 - modes.aligned), again * modes.aligned
        kept = choose(inside, changes.kept * share, 0.0)
        own, behind = source[0], source[_LAST]
        for j in range(BINS):
            beyond = source[j + 1 if j < _LAST else 0]
            found = row[j] * (kept * (own + side * (behind + beyond - 2.0 * own)) + free * anywhere[j])
            now[j] = found
            base_total += found
            behind, own = own, beyond
        for j in range(BINS, BASE):
            found = row[j] * (kept * previous[j] + aligned * near[j - BINS])
            now[j] = found
            base_total += found
        if glances:
            kept = choose(inside, changes.kept_glance * share, 0.0)
            again = changes.begins * base + (1.0 - changes.ends - changes.kept_glance) * (1.0 - base)
            again = choose(inside, again, modes.glance_share)
            for j in range(BINS):
                found = row[j] * (kept * previous[BASE + j] + again * modes.glance[j])
                now[BASE + j] = found
                glance_total += found
        else:
            for j in range(BASE, ROW):
                now[j] = glance_total
        share = 1.0 / (base_total + glance_total)
        base = base_total * share


class Smoothed(NamedTuple):
    """Probabilities and resultants of one frame's modes given all frames, by kind."""

    own: Any
    own_cos: Any
    own_sin: Any
    mistaken: Any
    near: Any
    near_cos: Any
    near_sin: Any
    glance: Any
    glance_cos: Any
    glance_sin: Any


class Following(NamedTuple):
    """Backward transition of probabilities to a frame: scale, share drawn again, and drift."""

    scale: Any
    again: Any
    glance_scale: Any
    glance_again: Any
    side: Any


@compiled
def smooth_modes(
    k: int, modes: Modes, filtered: FloatArray, following: Any, memory: ModeMemory
) -> tuple[Any, Any]:
    """One frame of the backward recursion, as `Smoothed` and `Following`."""
    row, now, weights = memory.likelihood[k], filtered[k], memory.weight[0]
    source, target = memory.after[1 - (k & 1)], memory.after[k & 1]
    scale, again, side = following.scale, following.again, following.side
    own = own_cos = own_sin = every = near = near_cos = near_sin = follows = follows_near = 0.0 * scale
    glance = glance_cos = glance_sin = follows_glance = own
    here, behind = source[0], source[_LAST]
    for j in range(BINS):
        beyond = source[j + 1 if j < _LAST else 0]
        ahead = scale * (here + side * (behind + beyond - 2.0 * here)) + again
        weight = ahead * now[j]
        weights[j] = weight
        owned = weight * modes.own[j]
        every += weight
        own += owned
        own_cos += owned * modes.cos[j]
        own_sin += owned * modes.sin[j]
        ahead *= row[j]
        target[j] = ahead
        follows += ahead * modes.anywhere[j]
        behind, here = here, beyond
    for j in range(BINS, BASE):
        ahead = scale * source[j] + again
        weight = ahead * now[j]
        weights[j] = weight
        near += weight
        near_cos += weight * modes.cos[j]
        near_sin += weight * modes.sin[j]
        ahead *= row[j]
        target[j] = ahead
        follows_near += ahead * modes.share[j - BINS]
    if modes.glance_share > 0.0:
        scale, again = following.glance_scale, following.glance_again
        for j in range(BINS):
            ahead = scale * source[BASE + j] + again
            weight = ahead * now[BASE + j]
            weights[BASE + j] = weight
            glance += weight
            glance_cos += weight * modes.cos[j]
            glance_sin += weight * modes.sin[j]
            ahead *= row[j]
            target[BASE + j] = ahead
            follows_glance += ahead * modes.glance[j]
    else:
        for j in range(BASE, ROW):
            weights[j] = target[j] = glance
    share = 1.0 / (every + near + glance)
    found = Smoothed(
        share * own,
        share * own_cos,
        share * own_sin,
        share * (every - own),
        share * near,
        share * near_cos,
        share * near_sin,
        share * glance,
        share * glance_cos,
        share * glance_sin,
    )
    # In the previous frame, the likelihood of later observations after a redrawn mode is scaled to 1.
    dt = memory.dt[k]
    inside, changes = dt > 0.0, changes_in(modes, dt)
    passes, side = drift_of(modes.drift, dt)
    mixed = (1.0 - modes.aligned) * follows + modes.aligned * follows_near
    drift_further(target, passes, side)
    begun = follows_glance / mixed
    again = 1.0 - changes.begins - changes.kept + changes.begins * begun
    glance_again = changes.ends + (1.0 - changes.ends - changes.kept_glance) * begun
    return found, Following(
        choose(inside, changes.kept / mixed, 0.0),
        choose(inside, again, 1.0),
        choose(inside, changes.kept_glance / mixed, 0.0),
        choose(inside, glance_again, 1.0),
        side,
    )


@compiled
def expected(found: Any, strength: float, free_strength: float, glance_strength: float) -> tuple[Any, Any]:
    """Resultant of the couplings over all modes and offsets: cosine and sine times the concentration."""
    cos = free_strength * found.own_cos + strength * (found.mistaken + found.near_cos)
    sin = free_strength * found.own_sin + strength * found.near_sin
    return cos + glance_strength * found.glance_cos, sin + glance_strength * found.glance_sin


@inner
def deviation(found: Any, modes: Modes, cos: Any, sin: Any, weights: FloatArray) -> Any:
    """Standard deviation of the pulls of all modes and offsets on a direction, given by cosine and sine."""
    free = near = glance = total = 0.0 * cos
    for j in range(BINS):
        pull = modes.sin[j] * cos - modes.cos[j] * sin
        free += weights[j] * modes.own[j] * pull * pull
        glance += weights[BASE + j] * pull * pull
        total += weights[j] + weights[BASE + j]
    for j in range(BINS, BASE):
        pull = modes.sin[j] * cos - modes.cos[j] * sin
        near += weights[j] * pull * pull
        total += weights[j]
    square = modes.free_strength * modes.free_strength * free + modes.strength * modes.strength * near
    square = (square + modes.glance_strength * modes.glance_strength * glance) / total
    mistaken = modes.strength * sin
    return math.sqrt(square + found.mistaken * mistaken * mistaken)


# -- the couplings -------------------------------------------------------------------------------------------


class Coupling(NamedTuple):
    """One coupling in a frame."""

    kappa: Any
    cos: Any  # of the offset
    sin: Any
    spread: Any  # standard deviation of the pull by modes and offsets


class Lead(NamedTuple):
    """Change of the direction that a coupling follows within its lead."""

    cos: Any  # of the turn
    sin: Any
    excess: Any  # as in `loosened`
    missing: Any  # seconds of the lead after the last frame


@inner
def loosened(kappa: Any, excess: Any, missing: Any, weight: Any, diffusion: float) -> Any:
    """Factor of a coupling's κ where the lead is unknown for ``missing`` seconds and turns are possible."""
    unknown = (missing > 0.0) & (kappa > 0.0)
    return choose(unknown, 1.0 / (1.0 + kappa * excess / weight * diffusion * missing), 1.0)


@inner
def couple(
    found: Any,
    modes: Modes,
    kappa: Any,
    lead: Any,
    frame: Any,
    diffusion: float,
    weights: Any,
    has_spread: bool,
) -> Any:
    """The expected coupling over the modes, turned by the lead while that lasts, as `Coupling`.

    ``kappa`` is the concentration when aligned. Without ``has_spread`` the spread is 0.
    """
    cos, sin = expected(found, modes.strength, modes.free_strength, modes.glance_strength)
    size = math.sqrt(cos * cos + sin * sin)
    some = size > 0.0
    cos, sin = choose(some, cos / size, 1.0), choose(some, sin / size, 0.0)
    given, spread = choose(some, kappa * size, 0.0), 0.0 * kappa
    remains = loosened(given, lead.excess, lead.missing, frame.coupling_weight, diffusion)
    if has_spread:
        spread = choose(some, kappa * remains * deviation(found, modes, cos, sin, weights), 0.0)
    return Coupling(
        given * remains,
        choose(some, cos * lead.cos - sin * lead.sin, 1.0),
        choose(some, sin * lead.cos + cos * lead.sin, 0.0),
        spread,
    )


@merged
def renew_body(chain: Chain, states: FloatArray, gait: Gait, has_spread: bool, memory: ModeMemory) -> None:
    """Set the coupling of body and motion in all frames."""
    problem, n, modes, filtered = chain.problem, chain.n, gait.body, memory.filtered_body
    shared, offset = problem.shared[0], problem.offsets[chain.track]
    look_ahead(n, chain.length, states, modes.lead, True, memory.dt, memory.ahead)
    judge_body(chain, states, gait, memory)
    filter_modes(n, modes, memory.before[BODY_MODE], filtered, memory)
    left = 0.0 * chain.length
    following = begin_back(left, memory)
    for k in range(n - 1, -1, -1):
        frame, vx, vy = problem.records[offset + k], states[k, VX], states[k, VY]
        found, following = smooth_modes(k, modes, filtered, following, memory)
        own_cos, own_sin = direction_of(vx, vy)
        cos, sin = direction_of(memory.ahead[k, AHEAD_VX], memory.ahead[k, AHEAD_VY])
        excess, missing = squared_excess(vx, vy, shared.speed_threshold), modes.lead - left
        lead = Lead(cos * own_cos + sin * own_sin, sin * own_cos - cos * own_sin, excess, missing)
        kappa, weights = frame.body_aligned_kappa, memory.weight[0]
        coupling = couple(found, modes, kappa, lead, frame, shared.body_diffusion, weights, has_spread)
        frame.motion_body_kappa, frame.motion_body_cos = coupling.kappa, coupling.cos
        frame.motion_body_sin = coupling.sin
        memory.held[k, 0], memory.held[k, 1] = expected(found, 1.0, 1.0, 0.0)
        memory.held[k, 2], memory.spread[k, BODY_MODE] = found.near, coupling.spread
        left += frame.dt


@merged
def renew_head(
    chain: Chain, states: FloatArray, gait: Gait, classified: bool, has_spread: bool, memory: ModeMemory
) -> None:
    """Set the coupling of head and body in all frames, and the head's steering of the following steps."""
    problem, n, filtered = chain.problem, chain.n, memory.filtered_head
    shared, offset = problem.shared[0], problem.offsets[chain.track]
    modes = gait.classified_head if classified else gait.head
    look_ahead(n, chain.length, states, modes.lead, False, memory.dt, memory.ahead)
    judge_head(chain, states, modes, memory)
    filter_modes(n, modes, memory.before[HEAD_MODE], filtered, memory)
    left, common = 0.0 * chain.length, math.sqrt(gait.head_common)
    following = begin_back(left, memory)
    for k in range(n - 1, -1, -1):
        frame = problem.records[offset + k]
        found, following = smooth_modes(k, modes, filtered, following, memory)
        lead_cos, lead_sin = cos_sin(memory.ahead[k, AHEAD_BODY] - states[k, BODY])
        lead = Lead(lead_cos, lead_sin, 1.0 + 0.0 * left, modes.lead - left)
        kappa, weights = frame.head_aligned_kappa, memory.weight[0]
        coupling = couple(found, modes, kappa, lead, frame, shared.body_diffusion, weights, has_spread)
        frame.head_body_kappa, frame.head_body_cos = coupling.kappa, coupling.cos
        frame.head_body_sin, frame.head_doubt = coupling.sin, found.mistaken
        memory.held[k, GLANCE] = found.glance
        memory.spread[k, HEAD_MODE] = common * coupling.spread
        left += frame.dt
        if k < n - 1:
            # The head steers by the probability that it points along the motion; a glance does not steer.
            after = problem.records[offset + k + 1]
            cos, sin = expected(found, 1.0, 1.0, 0.0)
            forth = memory.held[k, 0] * cos - memory.held[k, 1] * sin
            share = choose(is_observed(after), gait.head_rate_observed, 1.0) * choose(forth > 0.0, forth, 0.0)
            steer(after, after.steer_rate * share)


@inner
def begin_back(zero: Any, memory: ModeMemory) -> Any:
    """The likelihood after the last frame: uniform; as `Following`."""
    for j in range(ROW):
        memory.after[0, j] = memory.after[1, j] = zero
    return Following(zero, zero + 1.0, zero, zero + 1.0, zero)


@compiled
def renew_couplings(
    chain: Chain, states: FloatArray, gait: Gait, classified: bool, has_spread: bool, memory: ModeMemory
) -> None:
    """Set the couplings of a track's frames, and the steering between them, by the modes given the states.

    Parameters
    ----------
    states : (n, 6)
    classified : the head is observed by a classifier, whose errors may persist
    has_spread : compute ``memory.spread``
    memory : ``before`` is read where the first frame has a dt; ``held`` and ``spread`` are results
    """
    offset = chain.problem.offsets[chain.track]
    for k in range(chain.n):
        memory.dt[k] = chain.problem.records[offset + k].dt
    renew_body(chain, states, gait, has_spread, memory)
    renew_head(chain, states, gait, classified, has_spread, memory)


@inner
def glance_variance(glance: Any, gait: Gait) -> Any:
    """Variance added to a head with a probability of a glance above the stationary one."""
    more = (glance - gait.head.glance_share) / (1.0 - gait.head.glance_share)
    less = 1.0 - choose(more > 0.0, more, 0.0)
    return gait.glance_variance * (1.0 - less * less)


@compiled
def add_glance_variance(n: int, held: FloatArray, gait: Gait, covariance: FloatArray) -> None:
    """Add the glance variance to covariances (n, 6, 6), in place; ``held`` (n, 4) is that of `ModeMemory`."""
    for k in range(n):
        covariance[k, HEAD, HEAD] += glance_variance(held[k, GLANCE], gait)


@compiled
def report_modes(n: int, lane: int, held: FloatArray, modes: FloatArray) -> None:
    """Write modes (n, 3): probability of an aligned body, its offset (radians), and of a glance."""
    for k in range(n):
        modes[k, 0] = lane_of(held[k, 2], lane)
        modes[k, 1] = math.atan2(lane_of(held[k, 1], lane), lane_of(held[k, 0], lane))
        modes[k, 2] = lane_of(held[k, GLANCE], lane)


@compiled
def normalise(filtered: FloatArray, probabilities: FloatArray) -> None:
    """Filtered probabilities (ROW,) of a frame that sum to 1."""
    total = 0.0
    for j in range(ROW):
        total += filtered[j]
    for j in range(ROW):
        probabilities[j] = filtered[j] / total
