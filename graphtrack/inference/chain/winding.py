"""Winding: somebody who stands turns by less than half a turn, unless it costs less to turn by more.

While somebody stands, the direction of their path means nothing and may go all around. A body that followed
it has turned by 360° too much, and no descent can take that back: each frame by itself is where it should be.
`unwind` proposes the other way round.
"""

from __future__ import annotations

import math
from typing import Any

from graphtrack.geometry.angles import FloatArray
from graphtrack.inference.chain.elimination import Workspace, copy_rows
from graphtrack.model.kernels.compiled import compiled
from graphtrack.model.kernels.lanes import lane_count, lane_of, masked, only_lane
from graphtrack.model.kernels.layout import BODY, HEAD, VX, VY
from graphtrack.model.kernels.problem import Problem

SLOW = 0.3
"""m/s below which somebody may stand: half of the slowest walk."""

BRIEF = 0.5
"""Seconds for which the estimated speed of somebody who stands may be above that."""

_TURN = 2.0 * math.pi


@compiled
def unwind(problem: Problem, track: int, n: int, states: FloatArray, workspace: Workspace) -> Any:
    """Put into ``workspace.again`` the states with each slow turn of more than 180° the other way round.

    Returns a condition that holds where there is one; else the states are not copied.

    Parameters
    ----------
    problem, track : as the kernels see them: whole, or lanes
    n, states : (n, 6)
    """
    length, again = workspace.length[0], workspace.again
    found, copied = length < 0.0, False
    for lane in range(lane_count(length)):
        for place in (BODY, HEAD):
            frames, begin, slow, since, turned = int(lane_of(length, lane)), -1, 0, 0.0, 0.0
            at_slow = 0.0
            for k in range(frames):
                vx, vy, step = lane_of(states[k, VX], lane), lane_of(states[k, VY], lane), 0.0
                if k > 0:
                    since += lane_of(problem.records[problem.offsets[track] + k].dt, lane)
                    step = lane_of(states[k, place], lane) - lane_of(states[k - 1, place], lane)
                    step -= _TURN * math.floor(step / _TURN + 0.5)
                    turned += step
                if vx * vx + vy * vy < SLOW * SLOW:
                    if begin < 0:
                        begin, turned = max(k - 1, 0), step
                    slow, since, at_slow = k, 0.0, turned
                if begin < 0 or (since <= BRIEF and k < frames - 1):
                    continue
                # The stretch is over: it lasted up to the frame after the last slow one.
                if abs(at_slow) > math.pi:
                    if not copied:
                        copy_rows(0, n, states, again)
                        copied = True
                    this = only_lane(found, lane)
                    found |= this
                    first = lane_of(states[begin, place], lane)
                    shorter = at_slow - _TURN * math.floor(at_slow / _TURN + 0.5)
                    angles = masked(again, this)
                    for m in range(begin + 1, slow):
                        angles[m, place] = first + shorter * ((m - begin) / (slow - begin))
                begin = -1
    return found
