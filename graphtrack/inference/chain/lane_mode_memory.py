"""What `lane_modes` reads of tracks side by side, and memory for it."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from graphtrack.geometry.angles import FloatArray
from graphtrack.inference.chain.lane_newton import LaneMemory, place_of
from graphtrack.model.kernels.compiled import compiled
from graphtrack.model.kernels.lanes import LANES
from graphtrack.model.kernels.layout import BODY, VX, VY
from graphtrack.model.terms.gait import ROW

DT, POSITION_SEEN, PIXEL_SEEN = (
    place_of(name) for name in ("dt", "position_information", "pixel_information")
)
SEEN_BODY, SEEN_HEAD = place_of("seen_body_cos"), place_of("seen_head_cos")
"""Cosine, sine, concentration and outliers of what was seen, one after another."""

BODY_INFORMATION, HEAD_INFORMATION = place_of("body_information"), place_of("head_information")
BODY_KAPPA, HEAD_KAPPA = place_of("body_aligned_kappa"), place_of("head_aligned_kappa")
WEIGHT, MOTION, STEER_RATE = (
    place_of(name) for name in ("coupling_weight", "motion_information", "steer_rate")
)
TO_BODY, TO_HEAD = place_of("motion_body_kappa"), place_of("head_body_kappa")
"""Concentration, cosine and sine of the couplings, one after another."""

STEER = place_of("steer_gain")
"""Gain, reach, and the information on place, on both and on spread, one after another."""

AHEAD_VX, AHEAD_VY, AHEAD_BODY = range(3)
AHEAD = 3
TURN = 2.0 * math.pi


class ModeMemory(NamedTuple):
    """A group of tracks of up to n frames; lanes come last."""

    ahead: FloatArray  # (n, AHEAD, LANES) velocity and body, by the leads later
    row: FloatArray  # (n, ROW, LANES) log₂ likelihoods, then likelihoods
    filtered: FloatArray  # (n + 1, ROW, LANES) not normalised, and memory for one more
    after: FloatArray  # (2, ROW, LANES) what a frame and all that follow say, of two frames
    weight: FloatArray  # (ROW, LANES) smoothed, not normalised
    step: FloatArray  # (3, LANES) how probabilities pass from frame to frame
    held: FloatArray  # (n, 2, LANES) cosine and sine of the offset from motion to body
    spread: FloatArray  # (n, 2, LANES) of what the couplings pull with


def mode_memory(n: int) -> ModeMemory:
    """Memory for tracks of up to n frames."""
    return ModeMemory(
        np.empty((n, AHEAD, LANES)),
        np.empty((n, ROW, LANES)),
        np.empty((n + 1, ROW, LANES)),
        np.empty((2, ROW, LANES)),
        np.empty((ROW, LANES)),
        np.empty((3, LANES)),
        np.empty((n, 2, LANES)),
        np.empty((n, 2, LANES)),
    )


@compiled
def look_ahead(n: int, lead: float, of_motion: bool, memory: LaneMemory, found: FloatArray) -> None:
    """`modes.leading_angles` of all lanes, of motion as a vector; ``found`` is (n, AHEAD, LANES)."""
    frames, states = memory.frames, memory.states
    for lane in range(LANES):
        length = int(memory.lengths[0, lane])
        at, since = 0, lead
        for k in range(length):
            if k > 0:
                since += frames[k, DT, lane]
            while at < length - 1 and since >= frames[at + 1, DT, lane]:
                since -= frames[at + 1, DT, lane]
                at += 1
            while at > 0 and since < 0.0:
                since += frames[at, DT, lane]
                at -= 1
            share = 0.0
            if at < length - 1:
                share = min(max(since / frames[at + 1, DT, lane], 0.0), 1.0)
            after = min(at + 1, length - 1)
            if of_motion:
                found[k, AHEAD_VX, lane] = (1.0 - share) * states[at, VX, lane] + share * states[
                    after, VX, lane
                ]
                found[k, AHEAD_VY, lane] = (1.0 - share) * states[at, VY, lane] + share * states[
                    after, VY, lane
                ]
            else:
                # Neighbours may be written in different turns.
                turn = states[after, BODY, lane] - states[at, BODY, lane]
                turn -= TURN * math.floor(turn / TURN + 0.5)
                found[k, AHEAD_BODY, lane] = states[at, BODY, lane] + share * turn
        for k in range(length, n):
            if of_motion:
                found[k, AHEAD_VX, lane] = found[k, AHEAD_VY, lane] = 0.0
            else:
                found[k, AHEAD_BODY, lane] = 0.0
