"""What `lane_modes` reads of tracks side by side, and memory for it."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from graphtrack.geometry.angles import FloatArray
from graphtrack.inference.chain.modes import is_seen
from graphtrack.model.kernels.compiled import compiled, inner
from graphtrack.model.kernels.lanes import LANES
from graphtrack.model.kernels.layout import BODY, VX, VY
from graphtrack.model.kernels.problem import Problem
from graphtrack.model.terms.gait import BINS, ROW, Gait

DT, SEEN, WEIGHT, BODY_KAPPA, HEAD_KAPPA, BODY_INFORMATION, HEAD_INFORMATION = range(7)
OF_BODY, OF_HEAD = 7, 11  # cosine, sine, concentration and outliers of what was seen
OWN_VX, OWN_VY, OWN_BODY, AHEAD_VX, AHEAD_VY, AHEAD_BODY = range(15, 21)
FIELDS = 21
TURN = 2.0 * math.pi


class ModeMemory(NamedTuple):
    """A group of tracks of up to n frames; lanes come last."""

    tracks: NDArray[np.int64]  # (LANES,) which; −1: none
    given: FloatArray  # (n, FIELDS, LANES)
    row: FloatArray  # (n, ROW, LANES)
    probability: FloatArray  # (n, ROW, LANES)
    now: FloatArray  # (ROW, LANES)
    before: FloatArray  # (BINS, LANES)
    held: FloatArray  # (n, 2, LANES) cosine and sine of the offset from motion to body
    found: FloatArray  # (6, LANES)


def mode_memory(n: int) -> ModeMemory:
    """Memory for tracks of up to n frames."""
    return ModeMemory(
        np.empty(LANES, np.int64),
        np.empty((n, FIELDS, LANES)),
        np.empty((n, ROW, LANES)),
        np.empty((n, ROW, LANES)),
        np.empty((ROW, LANES)),
        np.empty((BINS, LANES)),
        np.empty((n, 2, LANES)),
        np.empty((6, LANES)),
    )


@compiled
def look_ahead(given: FloatArray, lane: int, n: int, lead: float, of_motion: bool) -> None:
    """`modes.leading_angles` of a lane, of motion as a vector."""
    at, since = 0, lead
    for k in range(n):
        if k > 0:
            since += given[k, DT, lane]
        while at < n - 1 and since >= given[at + 1, DT, lane]:
            since -= given[at + 1, DT, lane]
            at += 1
        while at > 0 and since < 0.0:
            since += given[at, DT, lane]
            at -= 1
        share = 0.0
        if at < n - 1:
            share = min(max(since / given[at + 1, DT, lane], 0.0), 1.0)
        after = min(at + 1, n - 1)
        if of_motion:
            for i in range(2):
                own, other = given[at, OWN_VX + i, lane], given[after, OWN_VX + i, lane]
                given[k, AHEAD_VX + i, lane] = (1.0 - share) * own + share * other
        else:
            # Neighbours may be written in different turns.
            turn = given[after, OWN_BODY, lane] - given[at, OWN_BODY, lane]
            turn -= TURN * math.floor(turn / TURN + 0.5)
            given[k, AHEAD_BODY, lane] = given[at, OWN_BODY, lane] + share * turn


@inner
def gather_modes(problem: Problem, states: FloatArray, gait: Gait, memory: ModeMemory) -> int:
    """Put what the recursions read of a group's frames side by side; returns its length."""
    given, longest = memory.given, 0
    for track in memory.tracks:
        if track >= 0:
            longest = max(longest, problem.offsets[track + 1] - problem.offsets[track])
    given[:longest] = 0.0
    for lane in range(LANES):
        track = memory.tracks[lane]
        if track < 0:
            continue
        a, n = problem.offsets[track], problem.offsets[track + 1] - problem.offsets[track]
        for k in range(n):
            frame, row = problem.records[a + k], given[k]
            row[DT, lane] = frame.dt
            row[SEEN, lane] = 1.0 if is_seen(frame) else 0.0
            row[WEIGHT, lane] = frame.coupling_weight
            row[BODY_KAPPA, lane], row[HEAD_KAPPA, lane] = (
                frame.body_aligned_kappa,
                frame.head_aligned_kappa,
            )
            row[BODY_INFORMATION, lane] = frame.body_information
            row[HEAD_INFORMATION, lane] = frame.head_information
            row[OF_BODY, lane], row[OF_BODY + 1, lane] = frame.seen_body_cos, frame.seen_body_sin
            row[OF_BODY + 2, lane], row[OF_BODY + 3, lane] = frame.body_kappa, frame.body_uniform
            row[OF_HEAD, lane], row[OF_HEAD + 1, lane] = frame.seen_head_cos, frame.seen_head_sin
            row[OF_HEAD + 2, lane], row[OF_HEAD + 3, lane] = frame.head_kappa, frame.head_uniform
            row[OWN_VX, lane], row[OWN_VY, lane], row[OWN_BODY, lane] = (
                states[a + k, VX],
                states[a + k, VY],
                states[a + k, BODY],
            )
        look_ahead(given, lane, n, gait.body.lead, True)
        look_ahead(given, lane, n, gait.head.lead, False)
    return longest
