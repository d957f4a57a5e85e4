"""One step of everybody's chain of looks, compiled."""

from __future__ import annotations

import math

import numpy as np

from graphtrack.behaviour.looking import (
    LOOK_STD,
    REACH,
    SWITCHING,
    IntArray,
    carry,
    densities,
    go_on,
    noise_of,
    prior_of_looks,
    see,
)
from graphtrack.geometry.angles import FloatArray
from graphtrack.model.kernels.compiled import allocating, compiled


@compiled
def _near(position: FloatArray, i: int, j: int) -> bool:
    x, y = position[j, 0] - position[i, 0], position[j, 1] - position[i, 1]
    return i != j and x * x + y * y < REACH * REACH


@allocating
def looks_of_frame(
    t: float,
    ids: IntArray,
    position: FloatArray,
    angle: FloatArray,
    kappa: FloatArray,
    seen: np.ndarray,
    group: IntArray,
    place_bearing: FloatArray,
    place_half: FloatArray,
    place_far: FloatArray,
    was: IntArray,
    t_before: FloatArray,
    head_before: FloatArray,
    first_before: IntArray,
    target_before: IntArray,
    bearing_before: FloatArray,
    person_before: FloatArray,
    place_bearing_before: FloatArray,
    place_before: FloatArray,
    parameters: FloatArray,
) -> tuple[FloatArray, IntArray, IntArray, FloatArray, FloatArray, FloatArray]:
    """A step of everybody's chain: head, first, target, bearing, person and place, as in `_Known`.

    Parameters
    ----------
    ids, position, angle, kappa, seen, group : (n,) who, where, and how heads point, if they were seen
    place_bearing, place_half, place_far : (n, places) how places are seen
    was : (n,) place of each among those known before, −1: unknown; what follows is theirs
    """
    n, places = place_bearing.shape
    first, head = np.zeros(n + 1, dtype=np.int64), np.empty((n, 2))
    for i in range(n):
        near = 0
        for j in range(n):
            near += _near(position, i, j)
        first[i + 1] = first[i] + near
    target = np.empty(first[-1], dtype=np.int64)
    all_bearing, person = np.empty(first[-1]), np.empty(first[-1])
    place = np.empty((n, places + 1))
    others, fellow, weight = np.empty((n, 2)), np.empty(n, dtype=np.bool_), np.ones(1)
    room = np.empty((9, n + places + 1))
    for i in range(n):
        at, people = first[i], first[i + 1] - first[i]
        count = people + places
        bearing, half, far = room[0, :count], room[1, :count], room[2, :count]
        prior, anew, held = room[3, : count + 1], room[4, : count + 1], room[5, : count + 1]
        then, then_bearing, found = room[6, : count + 1], room[7, :count], room[8, : count + 1]
        k = 0
        for j in range(n):
            if _near(position, i, j):
                target[at + k], others[k] = ids[j], position[j]
                fellow[k] = group[i] >= 0 and group[i] == group[j]
                k += 1
        see(position[i], others[:people], bearing[:people], half[:people], far[:people])
        bearing[people:], half[people:], far[people:] = place_bearing[i], place_half[i], place_far[i]
        prior_of_looks(bearing, half, far, fellow[:people], people, parameters, prior)
        weight[0] = 1.0 if seen[i] else math.nan
        one = slice(i, i + 1)
        densities(bearing, half, weight, angle[one], kappa[one], parameters[LOOK_STD], anew)
        head[i, 0], head[i, 1] = angle[i], noise_of(kappa[i]) if seen[i] else math.inf
        p = was[i]
        gap, stay, before = math.inf, 0.0, head[i]
        then[:], then_bearing[:] = 0.0, math.nan
        if p >= 0:
            gap, before = t - t_before[p], head_before[p]
            stay = math.exp(-parameters[SWITCHING] * gap)
            b, end = first_before[p], first_before[p + 1]
            for k in range(people):
                while b < end and target_before[b] < target[at + k]:
                    b += 1
                if b < end and target_before[b] == target[at + k]:
                    then[k], then_bearing[k] = person_before[b], bearing_before[b]
            then[people:], then_bearing[people:] = place_before[p], place_bearing_before[p]
        carry(gap, head[i], before, bearing, then_bearing, parameters, anew, held)
        go_on(prior, anew, held, stay, then, found)
        person[at : at + people], all_bearing[at : at + people] = found[:people], bearing[:people]
        place[i] = found[people:]
    return head, first, target, all_bearing, person, place
