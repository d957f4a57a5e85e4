"""Distances and velocities of those who walk together, from labelled groups."""

from __future__ import annotations

from dataclasses import fields, replace
from typing import Any

import numpy as np

from graphtrack.behaviour.evidence import ALONG, abreast, walks
from graphtrack.behaviour.features import REACH, pair_features
from graphtrack.behaviour.parameters import GroupParameters
from graphtrack.behaviour.people import IntArray, People
from graphtrack.geometry.angles import BoolArray

_LEAST = 20
"""Pairs in frames, of those who walk together and of those who do not, below which nothing is learned."""


def fit_walking(people: People, label: IntArray, used: BoolArray, start: GroupParameters) -> GroupParameters:
    """Learn how far apart and how alike two walk who do so together, and others who walk near each other.

    Means and standard deviations of labelled pairs of walkers within reach; others are anywhere in it.

    Parameters
    ----------
    label : (n,) numbers that those of a group share within a frame, −1 for those alone
    used : (n,) rows that are labelled and learned from
    start : what is returned where there are too few such pairs
    """
    left, right, _ = pair_features(people, start.stride)
    walk = walks(people, start)
    use = used[left] & used[right] & (np.minimum(walk[left], walk[right]) > 0.5)
    left, right = left[use], right[use]
    together = (label[left] == label[right]) & (label[left] >= 0)
    if min(np.count_nonzero(together), np.count_nonzero(~together)) < _LEAST:
        return start
    far, square = abreast(people, left, right)
    learned = {
        "walking_distance": far[together].mean(),
        "walking_distance_std": far[together].std(),
        "walking_speed_std": np.sqrt(0.5 * square[together].mean()),
        "others_speed_std": np.sqrt(0.5 * square[~together].mean()),
        "others_density": 1.0 / (np.pi * REACH**2 * ALONG),
        "walking_share": together.mean(),
    }
    ranges = {one.name: one.metadata["range"] for one in fields(start) if one.name in learned}
    values: dict[str, Any] = {
        name: float(np.clip(np.round(value, 4), *ranges[name])) for name, value in learned.items()
    }
    return replace(start, **values)
