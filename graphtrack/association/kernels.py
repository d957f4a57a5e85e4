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
from graphtrack.model.kernels.compiled import compiled

IntArray = NDArray[np.int64]

NOTHING = -1e9
"""The gain of what cannot be."""
GATE = 6.0
"""Standard deviations beyond which a detection is nobody's."""


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


class Chains(NamedTuple):
    """n detections in the order of time, and the tracks that they are chained to."""

    t: FloatArray  # (n,) seconds
    frame: IntArray  # (n,) in steps of the recording
    position: FloatArray  # (n, 2) metres
    variance: FloatArray  # (n,) m² of each axis
    gain: FloatArray  # (n,) log of how much more likely as a person's than as a false one, position aside
    following: IntArray  # (n,) the next detection of the same person, or −1
    preceding: IntArray  # (n,) the one before, or −1
    state: FloatArray  # (n, 7) filtered there: x, y, vx, vy, and the covariance p, pv, v of each axis
    evidence: FloatArray  # (n,) of the detection given those before
    total: FloatArray  # (n,) of the track up to there


def unlinked(t: FloatArray, frame: IntArray, position: FloatArray) -> Chains:
    """Detections that are nobody's yet; their variances and gains are to be set."""
    n, nobody = len(t), np.full(len(t), -1)
    empty, zeros = np.empty(n), np.zeros(n)
    return Chains(
        t, frame, position, empty, empty.copy(), nobody, nobody.copy(), np.zeros((n, 7)), zeros, zeros.copy()
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
def begin(chains: Chains, k: int, scene: Scene, state: FloatArray) -> float:
    """The state of somebody first seen at detection k; its evidence."""
    state[0], state[1] = chains.position[k, 0], chains.position[k, 1]
    state[2] = state[3] = state[5] = 0.0
    state[4], state[6] = chains.variance[k], scene.speed_variance
    return scene.log_birth + chains.gain[k]


@compiled
def follow(chains: Chains, before: FloatArray, k: int, m: int, scene: Scene, state: FloatArray) -> float:
    """The state after detection m of somebody whose state was ``before`` at detection k; its evidence."""
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
    density = -math.log(2.0 * math.pi * spread) - 0.5 * (off_x * off_x + off_y * off_y) / spread
    return density + chains.gain[m] + missed(chains.frame[m] - chains.frame[k] - 1, scene)


@compiled
def is_near(chains: Chains, k: int, m: int, scene: Scene) -> bool:
    """Whether somebody filtered at detection k may be at detection m."""
    dt, state = chains.t[m] - chains.t[k], chains.state[k]
    if dt > scene.longest_gap or dt <= 0.0:
        return False
    spread = state[4] + 2.0 * dt * state[5] + dt * dt * state[6] + scene.density * dt**3 / 3.0
    off_x = chains.position[m, 0] - state[0] - dt * state[2]
    off_y = chains.position[m, 1] - state[1] - dt * state[3]
    return off_x * off_x + off_y * off_y < GATE * GATE * (spread + chains.variance[m])


@compiled
def run_on(chains: Chains, state: FloatArray, k: int, scene: Scene) -> float:
    """Evidence of what follows detection k in its chain, whose state there is given; it is changed.

    After ``look_ahead`` detections what is remembered is taken: nothing is left of where the track came from.
    """
    total, seen, here = 0.0, 0, np.empty(7)
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
    state = np.empty(7)
    value = begin(chains, k, scene, state)
    return max(0.0, value + run_on(chains, state, k, scene))


@compiled
def gains_of_links(chains: Chains, heads: IntArray, tails: IntArray, scene: Scene) -> FloatArray:
    """How much evidence (heads, tails) each link of a track's head to a tail brings over none."""
    gains, state = np.full((len(heads), len(tails)), NOTHING), np.empty(7)
    alone = np.empty(len(tails))
    for j in range(len(tails)):
        alone[j] = born(chains, tails[j], scene)
    for i in range(len(heads)):
        k = heads[i]
        ended = max(0.0, chains.total[k] + ending(chains, k, scene))
        for j in range(len(tails)):
            m = tails[j]
            if is_near(chains, k, m, scene):
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
    gains, state = np.full((len(heads), len(detections)), NOTHING), np.empty(7)
    for j in range(len(detections)):
        d = detections[j]
        alone = max(0.0, begin(chains, d, scene, state) + ending(chains, d, scene))
        for i in range(len(heads)):
            k, m = heads[i], tails[i]
            if k >= 0:
                if not is_near(chains, k, d, scene):
                    continue
                value = chains.total[k] + follow(chains, chains.state[k], k, d, scene, state)
                without = state_after(chains, k, scene)
            else:
                value = begin(chains, d, scene, state)
                without = born(chains, m, scene)
            if m >= 0:
                if chains.t[m] - chains.t[d] > scene.longest_gap:
                    continue
                here = state.copy()
                value += follow(chains, here, d, m, scene, state)
                value += run_on(chains, state, m, scene)
            else:
                value += ending(chains, d, scene)
            gains[i, j] = value - without - alone
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
        density = follow(chains, here, k, m, scene, chains.state[m])
        total += density - chains.gain[m] - missed(chains.frame[m] - chains.frame[k] - 1, scene)
        count += 1
    return total, count
