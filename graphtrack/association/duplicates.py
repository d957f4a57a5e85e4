"""Several detections of one person in a frame: the others are not people of their own."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from graphtrack.geometry.angles import FloatArray
from graphtrack.scene import NOTHING, Known, SceneParameters

_DUPLICATE_REACH = 3.0
"""Spreads within which a detection may be a duplicate."""


Pairs: TypeAlias = tuple[NDArray[np.int64], NDArray[np.int64], FloatArray]
"""Two detections each, and their squared distances (m²)."""


def duplicate_density(
    frame: NDArray[np.int64],
    position: FloatArray,
    identity: NDArray[np.int64],
    scene: SceneParameters,
) -> FloatArray:
    """Return the expected density of duplicates of other people at each detection, (n,) 1/m².

    A person counts for those who were detected less often: of two who walk in each other's place the one with
    more detections is the person.

    Parameters
    ----------
    frame, position : (n,) and (n, 2) of the detections
    identity : (n,) as they are thought to be; −1: false
    """
    times = np.bincount(identity[identity >= 0], minlength=1)
    return duplicate_density_of(duplicate_pairs(frame, position, scene), identity, scene, times)


def duplicate_pairs(frame: NDArray[np.int64], position: FloatArray, scene: SceneParameters) -> Pairs:
    """Those of which one can be a duplicate of the other, as `pairs_within` has them."""
    return pairs_within(frame, position, _DUPLICATE_REACH * scene.duplicate_spread)


def duplicate_density_of(
    pairs: Pairs, identity: NDArray[np.int64], scene: SceneParameters, times: NDArray[np.int64]
) -> FloatArray:
    """`duplicate_density` where the pairs are known.

    Parameters
    ----------
    identity : (n,) as they are thought to be; −1: false
    times : identity → how often it was detected
    """
    first, second, square = pairs
    strength = np.where(identity >= 0, times[np.maximum(identity, 0)], 0)
    counts = (identity[second] >= 0) & (identity[first] != identity[second])
    counts &= (strength[second] > strength[first]) | (
        (strength[second] == strength[first]) & (identity[second] < identity[first])
    )
    first, square = first[counts], square[counts]
    variance = scene.duplicate_spread**2
    each = scene.duplicate_rate * np.exp(-0.5 * square / variance) / (2.0 * np.pi * variance)
    return np.bincount(first, each, minlength=len(identity)).astype(float)


def pairs_within(frame: NDArray[np.int64], position: FloatArray, reach: float) -> Pairs:
    """Pairs (both ways) of detections of one frame within reach (m), and their squared distances (m²)."""
    # Frames far apart on a third axis: one tree for all.
    apart = np.column_stack([position, frame * (10.0 * reach)])
    pairs = cKDTree(apart).query_pairs(reach, output_type="ndarray").reshape(-1, 2)
    first = np.concatenate([pairs[:, 0], pairs[:, 1]]).astype(np.int64)
    second = np.concatenate([pairs[:, 1], pairs[:, 0]]).astype(np.int64)
    return first, second, np.sum((position[first] - position[second]) ** 2, axis=1)


def learn_duplicates(
    frame: NDArray[np.int64],
    position: FloatArray,
    identity: NDArray[np.int64],
    scene: SceneParameters,
    known: Known = NOTHING,
) -> SceneParameters:
    """The scene with rate and spread of duplicates from the false detections around people.

    Those of the two that are known are kept.
    """
    first, second, square = pairs_within(frame, position, 2.0)
    counts = (identity[first] < 0) & (identity[second] >= 0)
    first, square = first[counts], square[counts]
    people = float((identity >= 0).sum())
    free = [name for name in ("duplicate_rate", "duplicate_spread") if name not in known]
    rate, variance = scene.duplicate_rate, scene.duplicate_spread**2
    for _ in range(20 if free else 0):
        each = rate * np.exp(-0.5 * square / variance) / (2.0 * np.pi * variance)
        around = np.bincount(first, each, minlength=len(frame))
        share = each / (around[first] + scene.clutter_density)
        total = float(share.sum())
        if "duplicate_rate" in free:
            rate = (total + 0.02) / (people + 1.0)
        if "duplicate_spread" in free:
            variance = float(np.clip((0.5 * (share * square).sum() + 0.25) / (total + 1.0), 0.01, 1.0))
    found: dict[str, Any] = {
        "duplicate_rate": float(np.clip(rate, 0.0, 10.0)),
        "duplicate_spread": float(np.sqrt(variance)),
    }
    return replace(scene, **{name: found[name] for name in free})
