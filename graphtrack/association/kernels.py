"""Evidence that detections are one person's, compiled: filters of white-noise acceleration along chains.

A track is a chain: each detection knows the one after it (−1: none). Its evidence is the log density of its
detections, of how it was missed between them, and of its birth, over that of false detections.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from graphtrack.geometry.angles import FloatArray
from graphtrack.model.kernels.bessel import log_i0e
from graphtrack.model.kernels.compiled import compiled

IntArray = NDArray[np.int64]

NOTHING = -1e9
"""The gain of what cannot be."""
GATE = 6.0
"""Standard deviations beyond which a detection is nobody's."""


STATE = 11
"""Numbers in a filtered state: x, y, vx, vy, the covariance p, pv, v of each axis, and the directions of body
and head as vectors (x, y) whose length is their concentration; 0: not known."""
BODY, HEAD = 7, 9
"""Where the last two begin."""


class Scene(NamedTuple):
    """`SceneParameters.packed`."""

    density: float
    speed_variance: float
    log_missed: float
    log_hidden: float
    hidden_seconds: float
    log_birth: float
    log_death: float
    longest_gap: float
    frame_seconds: float
    look_ahead: float
    body_variance: float
    body_turn: float  # variance a second
    body_outliers: float
    head_variance: float
    head_turn: float
    head_outliers: float
    heading_variance: float
    looks_offset: float = 0.0
    looks_slope: float = 0.0
    looks_outliers: float = 1.0
    trust: float = 0.0  # log odds that two detections of one given identity are one person's


class Chains(NamedTuple):
    """n detections in the order of time, and the tracks that they are chained to."""

    t: FloatArray  # (n,) seconds
    frame: IntArray  # (n,) in steps of the recording
    position: FloatArray  # (n, 2) metres
    variance: FloatArray  # (n,) m² of each axis
    gain: FloatArray  # (n,) log of how much more likely as a person's than as a false one, position aside
    facing: FloatArray  # (n, 2) radians, observed body and head; NaN: not observed
    looks: FloatArray  # (n, d) whitened descriptors, NaN where one is missing; (n, 0) where there are none
    given: IntArray  # (n,) identities that somebody gave them and that mostly are right; −1: none
    following: IntArray  # (n,) the next detection of the same person, or −1
    preceding: IntArray  # (n,) the one before, or −1
    state: FloatArray  # (n, STATE) filtered there, see `STATE`
    evidence: FloatArray  # (n,) of the detection given those before
    total: FloatArray  # (n,) of the track up to there


def unlinked(t: FloatArray, frame: IntArray, position: FloatArray, facing: FloatArray) -> Chains:
    """Detections that are nobody's yet; their variances, gains and looks are to be set."""
    n, nobody = len(t), np.full(len(t), -1)
    zeros = np.zeros(n)
    return Chains(
        t,
        frame,
        position,
        np.empty(n),
        np.empty(n),
        facing,
        np.empty((n, 0)),
        nobody.copy(),
        nobody,
        nobody.copy(),
        np.zeros((n, STATE)),
        zeros,
        zeros.copy(),
    )


@compiled
def missed(frames: int, scene: Scene) -> float:
    """Log probability of so many frames between two detections: chance misses, or one occlusion."""
    if frames <= 0:
        return 0.0
    chance = frames * scene.log_missed
    hidden = scene.log_hidden - frames * scene.frame_seconds / scene.hidden_seconds
    return np.logaddexp(chance, hidden)


@compiled
def move(chains: Chains, before: FloatArray, k: int, m: int, scene: Scene, state: FloatArray) -> float:
    """The state after detection m of somebody whose state was ``before`` at k; log density of its place."""
    dt, q = chains.t[m] - chains.t[k], scene.density
    p = before[4] + 2.0 * dt * before[5] + dt * dt * before[6] + q * dt**3 / 3.0
    pv = before[5] + dt * before[6] + 0.5 * q * dt * dt
    v = before[6] + q * dt
    x, y = before[0] + dt * before[2], before[1] + dt * before[3]
    spread = p + chains.variance[m]
    off_x, off_y = chains.position[m, 0] - x, chains.position[m, 1] - y
    gain, turn = p / spread, pv / spread
    state[0], state[1] = x + gain * off_x, y + gain * off_y
    state[2], state[3] = before[2] + turn * off_x, before[3] + turn * off_y
    state[4], state[5], state[6] = p * (1.0 - gain), pv * (1.0 - gain), v - turn * pv
    return -math.log(2.0 * math.pi * spread) - 0.5 * (off_x * off_x + off_y * off_y) / spread


@compiled
def looks_ratio(chains: Chains, k: int, m: int, scene: Scene) -> float:
    """Log likelihood ratio of how two detections look; see `AppearanceModel`."""
    if scene.looks_outliers >= 1.0:
        return 0.0
    square = 0.0
    for i in range(chains.looks.shape[1]):
        square += (chains.looks[k, i] - chains.looks[m, i]) ** 2
    if math.isnan(square):
        return 0.0
    score = scene.looks_offset - scene.looks_slope * math.log(max(square, 1e-12))
    odds = math.exp(min(max(score, -50.0), 50.0))
    sure, unsure = 1.0 - scene.looks_outliers, scene.looks_outliers
    return math.log((sure * odds + unsure) / (sure + unsure * odds))


@compiled
def see_angle(
    angle: float, prior_x: float, prior_y: float, noise: float, outliers: float, state: FloatArray, place: int
) -> float:
    """Take an observed angle into the direction at ``place`` of a state; its log ratio to one by chance.

    Parameters
    ----------
    angle : radians; NaN: not observed
    prior_x, prior_y : the direction that is expected, with its concentration
    noise : variance of the observation
    outliers : share of observations that have nothing to do with the direction; 1: none is looked at
    """
    if outliers >= 1.0 or math.isnan(angle):
        return 0.0
    kappa, share, ratio = math.hypot(prior_x, prior_y), 1.0 - outliers, 0.0
    if kappa > 1e-6:
        kappa = 1.0 / (1.0 / kappa + noise)
        deviation = angle - math.atan2(prior_y, prior_x)
        density = share * math.exp(kappa * (math.cos(deviation) - 1.0) - log_i0e(kappa))
        ratio = math.log(density + outliers)
        share = density / (density + outliers)
    state[place] += share * math.cos(angle) / noise
    state[place + 1] += share * math.sin(angle) / noise
    return ratio


@compiled
def see_facing(chains: Chains, before: FloatArray, k: int, m: int, scene: Scene, state: FloatArray) -> float:
    """Take body and head of detection m into the state; their log likelihood ratio.

    They turn little since detection k, where the state was ``before``, and the body faces where the person
    goes, who moves as the state says.
    """
    dt = chains.t[m] - chains.t[k]
    for place, turn in ((BODY, scene.body_turn), (HEAD, scene.head_turn)):
        x, y = before[place], before[place + 1]
        less = 1.0 / (1.0 + math.hypot(x, y) * turn * dt)
        state[place], state[place + 1] = less * x, less * y
    x, y = state[BODY], state[BODY + 1]
    square = state[2] * state[2] + state[3] * state[3]
    if square > 1e-4:
        # Who hardly moves goes nowhere in particular.
        length = 1.0 / ((scene.heading_variance + state[6] / square) * math.sqrt(square))
        x, y = x + length * state[2], y + length * state[3]
    ratio = see_angle(chains.facing[m, 0], x, y, scene.body_variance, scene.body_outliers, state, BODY)
    x, y = state[HEAD], state[HEAD + 1]
    return ratio + see_angle(chains.facing[m, 1], x, y, scene.head_variance, scene.head_outliers, state, HEAD)


@compiled
def begin(chains: Chains, k: int, scene: Scene, state: FloatArray) -> float:
    """The state of somebody first seen at detection k; its evidence."""
    state[0], state[1] = chains.position[k, 0], chains.position[k, 1]
    state[2] = state[3] = state[5] = 0.0
    state[4], state[6] = chains.variance[k], scene.speed_variance
    state[BODY:] = 0.0
    see_angle(chains.facing[k, 0], 0.0, 0.0, scene.body_variance, scene.body_outliers, state, BODY)
    see_angle(chains.facing[k, 1], 0.0, 0.0, scene.head_variance, scene.head_outliers, state, HEAD)
    return scene.log_birth + chains.gain[k]


@compiled
def follow(chains: Chains, before: FloatArray, k: int, m: int, scene: Scene, state: FloatArray) -> float:
    """The state after detection m of somebody whose state was ``before`` at detection k; its evidence."""
    density = move(chains, before, k, m, scene, state)
    skipped = missed(chains.frame[m] - chains.frame[k] - 1, scene)
    shown = see_facing(chains, before, k, m, scene, state) + looks_ratio(chains, k, m, scene)
    trusted = scene.trust if chains.given[k] >= 0 and chains.given[k] == chains.given[m] else 0.0
    return density + chains.gain[m] + skipped + shown + trusted


@compiled
def is_within(
    off_x: float, off_y: float, dt: float, p: float, pv: float, v: float, variance: float, density: float
) -> bool:
    """Whether a detection so far from where somebody would be by then can be theirs.

    Parameters
    ----------
    off_x, off_y : metres from the predicted place
    dt : seconds since p, pv and v were the person's covariance on each axis
    variance : of the detection, m²
    density : of white-noise acceleration
    """
    spread = p + 2.0 * dt * pv + dt * dt * v + density * dt**3 / 3.0 + variance
    return off_x * off_x + off_y * off_y < GATE * GATE * spread


@compiled
def near_ones(
    chains: Chains, state: FloatArray, t: float, others: IntArray, scene: Scene, found: IntArray
) -> int:
    """Put into ``found`` the places in ``others`` of detections that somebody may be at; how many they are.

    One call for many: what a problem's arrays cost when they are handed on is more than the question.
    """
    count = 0
    for j in range(len(others)):
        m = others[j]
        dt = chains.t[m] - t
        if dt <= 0.0 or dt > scene.longest_gap:
            continue
        off_x = chains.position[m, 0] - state[0] - dt * state[2]
        off_y = chains.position[m, 1] - state[1] - dt * state[3]
        if is_within(off_x, off_y, dt, state[4], state[5], state[6], chains.variance[m], scene.density):
            found[count] = j
            count += 1
    return count


@compiled
def run_on(chains: Chains, state: FloatArray, k: int, scene: Scene) -> float:
    """Evidence of what follows detection k in its chain, whose state there is given; it is changed.

    After ``look_ahead`` detections what is remembered is taken: nothing is left of where the track came from.
    """
    total, seen, here = 0.0, 0, np.empty(STATE)
    m = chains.following[k]
    while m >= 0 and seen < scene.look_ahead:
        here[:] = state
        total += follow(chains, here, k, m, scene, state)
        k, m, seen = m, chains.following[m], seen + 1
    while m >= 0:
        total += chains.evidence[m]
        k, m = m, chains.following[m]
    return total + ending(chains, k, scene)


@compiled
def ending(chains: Chains, k: int, scene: Scene) -> float:
    """Log probability that a track's last detection is k: it left, or is not seen until the very end."""
    left = chains.frame[-1] - chains.frame[k]
    if left <= 0:
        return 0.0
    return max(scene.log_death, missed(left, scene))


@compiled
def born(chains: Chains, k: int, scene: Scene) -> float:
    """Evidence of the track from detection k on, as of somebody new; 0 if false ones are more probable."""
    state = np.empty(STATE)
    value = begin(chains, k, scene, state)
    return max(0.0, value + run_on(chains, state, k, scene))


@compiled
def gains_of_links(chains: Chains, heads: IntArray, tails: IntArray, scene: Scene) -> FloatArray:
    """How much evidence (heads, tails) each link of a track's head to a tail brings over none."""
    gains, state = np.full((len(heads), len(tails)), NOTHING), np.empty(STATE)
    alone, near = np.empty(len(tails)), np.empty(len(tails), np.int64)
    for j in range(len(tails)):
        alone[j] = born(chains, tails[j], scene)
    for i in range(len(heads)):
        k = heads[i]
        count = near_ones(chains, chains.state[k], chains.t[k], tails, scene, near)
        if not count:
            continue
        ended = max(0.0, chains.total[k] + ending(chains, k, scene))
        for j in near[:count]:
            m = tails[j]
            linked = chains.total[k] + follow(chains, chains.state[k], k, m, scene, state)
            gains[i, j] = linked + run_on(chains, state, m, scene) - ended - alone[j]
    return gains


@compiled
def gains_of_detections(
    chains: Chains, heads: IntArray, tails: IntArray, detections: IntArray, scene: Scene
) -> FloatArray:
    """How much evidence (tracks, detections) it brings that a track has a detection of a frame it spans.

    Parameters
    ----------
    heads, tails : (tracks,) the last detection before the frame and the first after it, linked; −1: none
    detections : of the frame, linked to nothing
    """
    gains, state, here = np.full((len(heads), len(detections)), NOTHING), np.empty(STATE), np.empty(STATE)
    alone, near, next_one = np.empty(len(detections)), np.arange(len(detections)), np.empty(1, np.int64)
    is_next = np.empty(1, np.int64)
    for j in range(len(detections)):
        d = detections[j]
        alone[j] = max(0.0, begin(chains, d, scene, state) + ending(chains, d, scene))
    for i in range(len(heads)):
        k, m = heads[i], tails[i]
        without, is_known = 0.0, False
        count = len(detections)
        if k >= 0:
            count = near_ones(chains, chains.state[k], chains.t[k], detections, scene, near)
        else:
            near[:] = np.arange(count)
        next_one[0] = m
        for j in near[:count]:
            d = detections[j]
            if k >= 0:
                value = chains.total[k] + follow(chains, chains.state[k], k, d, scene, here)
            else:
                value = begin(chains, d, scene, here)
            if m >= 0:
                if not near_ones(chains, here, chains.t[d], next_one, scene, is_next):
                    continue
                value += follow(chains, here, d, m, scene, state)
                value += run_on(chains, state, m, scene)
            else:
                value += ending(chains, d, scene)
            if not is_known:
                without = state_after(chains, k, scene) if k >= 0 else born(chains, m, scene)
                is_known = True
            gains[i, j] = value - without - alone[j]
    return gains


@compiled
def state_after(chains: Chains, k: int, scene: Scene) -> float:
    """Evidence of the whole track that detection k is in, from there on as it is linked; at least 0."""
    state = chains.state[k].copy()
    return max(0.0, chains.total[k] + run_on(chains, state, k, scene))


@compiled
def refresh(chains: Chains, first: int, end: int, scene: Scene) -> None:
    """Filter the detections from ``first`` up to ``end`` along their chains."""
    for m in range(first, end):
        k = chains.preceding[m]
        if k < 0:
            chains.evidence[m] = begin(chains, m, scene, chains.state[m])
            chains.total[m] = chains.evidence[m]
        else:
            chains.evidence[m] = follow(chains, chains.state[k], k, m, scene, chains.state[m])
            chains.total[m] = chains.total[k] + chains.evidence[m]


@compiled
def innovations(chains: Chains, scene: Scene) -> tuple[float, int]:
    """Log density of all linked detections given those before, as positions alone say, and their number."""
    total, count = 0.0, 0
    for m in range(len(chains.t)):
        k = chains.preceding[m]
        if k < 0:
            begin(chains, m, scene, chains.state[m])
            continue
        here = chains.state[k].copy()
        total += move(chains, here, k, m, scene, chains.state[m])
        count += 1
    return total, count


@compiled
def probabilities_of_links(gains: FloatArray, tail_of: IntArray, probability: FloatArray) -> None:
    """How probable the link of each head to its tail is among all that either could have, or none.

    Parameters
    ----------
    gains : (heads, tails) as of `gains_of_links`
    tail_of : (heads,) the column of each head's tail; −1: it has none
    probability : (tails,) is set where there is a link
    """
    for i in range(len(tail_of)):
        j = tail_of[i]
        if j < 0:
            continue
        own = gains[i, j]
        total = 1.0 + math.exp(min(-own, 50.0))
        for other in range(gains.shape[1]):
            if other != j and gains[i, other] > own - 50.0:
                total += math.exp(min(gains[i, other] - own, 50.0))
        for other in range(gains.shape[0]):
            if other != i and gains[other, j] > own - 50.0:
                total += math.exp(min(gains[other, j] - own, 50.0))
        probability[j] = 1.0 / total


@compiled
def roots(chains: Chains, scene: Scene, root: IntArray, value: FloatArray) -> None:
    """Where the track of each detection begins (n,), and for each beginning what the track is worth."""
    for k in range(len(root)):
        before = chains.preceding[k]
        root[k] = k if before < 0 else root[before]
        value[k] = -math.inf
    for k in range(len(root)):
        if chains.following[k] < 0:
            value[root[k]] = chains.total[k] + ending(chains, k, scene)


@compiled
def facing_evidence(chains: Chains, scene: Scene) -> float:
    """Sum of the log likelihood ratios of all angles along the chains, which are filtered again."""
    total = 0.0
    for m in range(len(chains.t)):
        k = chains.preceding[m]
        if k < 0:
            begin(chains, m, scene, chains.state[m])
            continue
        here = chains.state[k].copy()
        move(chains, here, k, m, scene, chains.state[m])
        total += see_facing(chains, here, k, m, scene, chains.state[m])
    return total
