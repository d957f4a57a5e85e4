"""Correlation clustering: the partition of people with the most log odds inside its groups, compiled."""

from __future__ import annotations

import numpy as np

from graphtrack.behaviour.people import IntArray
from graphtrack.geometry.angles import FloatArray
from graphtrack.model.kernels.compiled import allocating, compiled


@allocating
def _climbed(weight: FloatArray, label: IntArray) -> None:
    """Better a partition by moving one person, joining two groups, until nothing helps."""
    people = len(weight)
    gain = np.empty(people)
    for _ in range(100):
        changed = False
        for i in range(people):
            gain[:] = 0.0
            size = np.zeros(people, dtype=np.int64)
            for j in range(people):
                size[label[j]] += 1
                if j != i:
                    gain[label[j]] += weight[i, j]
            best, most = -1, 0.0 if size[label[i]] > 1 else -1e-9
            now = gain[label[i]] if size[label[i]] > 1 else 0.0
            for g in range(people):
                if size[g] > 0 and g != label[i] and gain[g] > most:
                    best, most = g, gain[g]
            if most > now + 1e-9:
                if best < 0:
                    for g in range(people):
                        if size[g] == 0:
                            best = g
                            break
                label[i] = best
                changed = True
        if _joined(weight, label):
            changed = True
        if not changed:
            return


@allocating
def _joined(weight: FloatArray, label: IntArray) -> bool:
    """Join the two groups that gain most by it, again and again; whether there were any."""
    people = len(weight)
    between = np.zeros((people, people))
    for i in range(people):
        for j in range(i):
            if label[i] != label[j]:
                between[label[i], label[j]] += weight[i, j]
                between[label[j], label[i]] += weight[i, j]
    any_joined = False
    while True:
        best, a, b = 1e-9, -1, -1
        for g in range(people):
            for h in range(g):
                if between[g, h] > best:
                    best, a, b = between[g, h], h, g
        if a < 0:
            return any_joined
        any_joined = True
        for i in range(people):
            if label[i] == b:
                label[i] = a
        for g in range(people):
            if g != a and g != b:
                between[a, g] += between[b, g]
                between[g, a] += between[g, b]
        between[b, :] = 0.0
        between[:, b] = 0.0
        between[a, b] = between[b, a] = 0.0


@compiled
def _inside(weight: FloatArray, label: IntArray) -> float:
    """The sum of log odds inside groups."""
    total = 0.0
    for i in range(len(label)):
        for j in range(i):
            if label[i] == label[j]:
                total += weight[i, j]
    return total


@allocating
def _best(weight: FloatArray) -> IntArray:
    """The better of what is reached from everybody alone, and from all together."""
    alone = np.arange(len(weight))
    _joined(weight, alone)
    _climbed(weight, alone)
    together = np.zeros(len(weight), dtype=np.int64)
    _climbed(weight, together)
    if _inside(weight, together) > _inside(weight, alone) + 1e-9:
        return together
    return alone


@allocating
def _components(people: int, left: IntArray, right: IntArray, odds: FloatArray) -> IntArray:
    """The smallest member of each person's component, where positive log odds connect."""
    root = np.arange(people)
    for k in range(len(left)):
        if odds[k] > 0.0:
            a, b = left[k], right[k]
            while root[a] != a:
                a = root[a]
            while root[b] != b:
                b = root[b]
            root[max(a, b)] = min(a, b)
    for i in range(people):
        a = i
        while root[a] != a:
            a = root[a]
        root[i] = a
    return root


@allocating
def partition(people: int, left: IntArray, right: IntArray, odds: FloatArray, far: float) -> IntArray:
    """Groups of one frame's people: a label for each, the place of the group's first member.

    Parameters
    ----------
    left, right : (k,) places of the two of a pair
    odds : (k,) log odds that they are of one group
    far : log odds of pairs that are not among them
    """
    found = np.arange(people)
    root = _components(people, left, right, odds)
    place = np.full(people, -1)
    for first in range(people):
        if root[first] != first:
            continue
        members = np.flatnonzero(root == first)
        if len(members) < 2:
            continue
        place[members] = np.arange(len(members))
        weight = np.full((len(members), len(members)), far)
        for k in range(len(left)):
            if root[left[k]] == first and root[right[k]] == first:
                a, b = place[left[k]], place[right[k]]
                weight[a, b] = weight[b, a] = odds[k]
        label = _best(weight)
        for a in range(len(members)):
            for b in range(len(members)):
                if label[b] == label[a]:
                    found[members[a]] = members[b]
                    break
    return found


@allocating
def partitions(
    first: IntArray, start: IntArray, left: IntArray, right: IntArray, odds: FloatArray, far: float
) -> IntArray:
    """`partition` of every frame: for each row the row of the first member of its group.

    Parameters
    ----------
    first : (k + 1,) first row of each frame
    start : (k + 1,) first pair of each frame
    left, right : (n,) rows of the two of a pair
    """
    found = np.empty(first[-1], dtype=np.int64)
    for k in range(len(first) - 1):
        pairs = slice(start[k], start[k + 1])
        label = partition(
            first[k + 1] - first[k], left[pairs] - first[k], right[pairs] - first[k], odds[pairs], far
        )
        found[first[k] : first[k + 1]] = label + first[k]
    return found
