"""Detections chained to tracks, and a scene's parameters, as compiled functions read them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from graphtrack.geometry.angles import FloatArray

IntArray = NDArray[np.int64]

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
    birth: FloatArray  # (n,) log of how many times the mean rate people come into view there
    death: FloatArray  # (n,) the same of those who leave
    facing: FloatArray  # (n, 2) radians, observed body and head; NaN: not observed
    looks: FloatArray  # (n, d) whitened descriptors, NaN where one is missing; (n, 0) where there are none
    given: IntArray  # (n,) identities that somebody gave them and that mostly are right; −1: none
    following: IntArray  # (n,) the next detection of the same person, or −1
    preceding: IntArray  # (n,) the one before, or −1
    state: FloatArray  # (n, STATE) filtered there, see `STATE`
    evidence: FloatArray  # (n,) of the detection given those before
    total: FloatArray  # (n,) of the track up to there
    rest: FloatArray  # (n,) of the track from there on, to its end: as it was when a sweep began


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
        zeros.copy(),
        zeros.copy(),
        facing,
        np.empty((n, 0)),
        nobody.copy(),
        nobody,
        nobody.copy(),
        np.zeros((n, STATE)),
        zeros,
        zeros.copy(),
        zeros.copy(),
    )


def link_by(chains: Chains, identity: IntArray) -> None:
    """Chain the detections of each identity in the order of time; of two in a frame only one; −1: none."""
    order = np.lexsort((np.arange(len(identity)), identity))
    before, after = order[:-1], order[1:]
    same = (identity[before] == identity[after]) & (identity[after] >= 0)
    same &= chains.frame[after] > chains.frame[before]
    chains.following[before[same]] = after[same]
    chains.preceding[after[same]] = before[same]
