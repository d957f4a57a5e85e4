"""Features of a pair of people that tell conversations: positions, o-spaces, crowding and gaze, compiled."""

from __future__ import annotations

import math

import numpy as np

from graphtrack.behaviour.people import IntArray, People
from graphtrack.geometry.angles import FloatArray
from graphtrack.model.kernels.compiled import allocating, compiled

FEATURES = ("shared", "crowd", "far", "rank", "look")
"""The numbers, in order; `ConversationWeights` says what each is."""

REACH = 4.0
"""Metres: people further apart are in no group by themselves, only through others."""

_SHARED = 0.6
"""Metres over which two o-spaces count as one."""
_CROWD = 1.0
"""Metres over which somebody counts for the crowd about a place."""
_SOFT = 0.2
"""Metres of distance that make somebody clearly nearer than another."""
_LOOK = 0.5
"""Radians, 1-σ of where a head points about what is looked at."""
_NOTHING = 0.05
"""Weight of looks at nobody, where that of a look straight at somebody near is 1."""


@allocating
def _of_frame(
    position: FloatArray,
    body: FloatArray,
    head: FloatArray,
    stride: float,
    left: IntArray,
    right: IntArray,
    found: FloatArray,
    at: int,
    offset: int,
) -> int:
    """Write the pairs of one frame within reach from place ``at`` on; return the place after them."""
    people = len(position)
    apart, shared = np.zeros((people, people)), np.zeros((people, people))
    look, near = np.zeros((people, people)), np.zeros((people, people))
    space = position + stride * body
    crowd, seen = np.ones(people), np.full(people, _NOTHING)
    for i in range(people):
        shared[i, i] = 1.0
        for j in range(people):
            if j == i:
                continue
            x, y = position[j, 0] - position[i, 0], position[j, 1] - position[i, 1]
            square = x * x + y * y
            apart[i, j] = math.sqrt(square)
            if apart[i, j] > 3.0 * REACH:
                continue
            crowd[i] += math.exp(-0.5 * square / (_CROWD * _CROWD))
            near[i, j] = math.exp(-apart[i, j] / _SOFT)
            dx, dy = space[j, 0] - space[i, 0], space[j, 1] - space[i, 1]
            shared[i, j] = math.exp(-0.5 * (dx * dx + dy * dy) / (_SHARED * _SHARED))
            length = math.hypot(head[i, 0], head[i, 1])
            if length > 0.0:
                across, along = head[i, 0] * y - head[i, 1] * x, head[i, 0] * x + head[i, 1] * y
                angle = math.atan2(across, along)
                look[i, j] = length * math.exp(-0.5 * (angle / _LOOK) ** 2) / (1.0 + 0.5 * square)
                seen[i] += look[i, j]
    for i in range(people):
        for j in range(i):
            far = apart[i, j]
            if far > REACH:
                continue
            # Each k is nearer than the other one by a logistic function of distances, which is a ratio. The
            # other one counts for a half, which is taken off, and somebody is not near to themselves.
            both, before_one, before_other = 0.0, -0.5, -0.5
            here = near[i, j]
            for k in range(people):
                both += shared[i, k] * shared[j, k]
                before_one += near[i, k] / (near[i, k] + here)
                before_other += near[j, k] / (near[j, k] + here)
            ahead = math.hypot(space[i, 0] - position[j, 0], space[i, 1] - position[j, 1])
            other = math.hypot(space[j, 0] - position[i, 0], space[j, 1] - position[i, 1])
            found[at, 0] = math.log1p(both)
            found[at, 1] = math.log(crowd[i]) + math.log(crowd[j])
            found[at, 2] = max(ahead, other)
            found[at, 3] = math.log1p(before_one) + math.log1p(before_other)
            found[at, 4] = min(look[i, j] / seen[i], look[j, i] / seen[j])
            left[at], right[at] = offset + j, offset + i
            at += 1
    return at


@compiled
def _near_pairs(position: FloatArray, first: IntArray) -> int:
    count = 0
    for k in range(len(first) - 1):
        for i in range(first[k], first[k + 1]):
            for j in range(first[k], i):
                x, y = position[j, 0] - position[i, 0], position[j, 1] - position[i, 1]
                count += math.sqrt(x * x + y * y) <= REACH
    return count


@compiled
def of_frames(
    position: FloatArray,
    body: FloatArray,
    head: FloatArray,
    first: IntArray,
    stride: float,
    left: IntArray,
    right: IntArray,
    found: FloatArray,
) -> int:
    """Write the pairs of all frames, as `pair_features` gives them; how many there are."""
    at = 0
    for k in range(len(first) - 1):
        rows = slice(first[k], first[k + 1])
        at = _of_frame(position[rows], body[rows], head[rows], stride, left, right, found, at, first[k])
    return at


def pair_features(people: People, stride: float) -> tuple[IntArray, IntArray, FloatArray]:
    """The pairs within `REACH` in each frame, and their features.

    Directions count by their expected vectors, so that the o-space of somebody whose body is unknown is where
    they stand.

    ``stride``: metres from somebody to the o-space ahead of them

    Returns rows of the one and of the other person in ``people``, (n,) each, frame by frame; (n, 5) as
    `FEATURES`.
    """
    # A pair at the very edge may be counted and not found, as sums are reordered: there is room for more.
    count = _near_pairs(people.position, people.first) + len(people.frame)
    left, right = np.empty(count, dtype=np.int64), np.empty(count, dtype=np.int64)
    found = np.empty((count, len(FEATURES)))
    arrays = (people.position, people.body, people.head, people.first)
    end = of_frames(*arrays, stride, left, right, found)
    return left[:end], right[:end], found[:end]
