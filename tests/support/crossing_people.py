"""People who cross a place, as they are detected, and how well they are told apart."""

from __future__ import annotations

import numpy as np
from scipy.optimize import linear_sum_assignment

from graphtrack.association.detections import Detections


def street(
    rng: np.random.Generator,
    *,
    people: int = 12,
    frames: int = 60,
    noise: float = 0.1,
    miss: float = 0.0,
    false: float = 0.0,
    step: float = 0.4,
) -> tuple[Detections, np.ndarray]:
    """People who cross a place of 16 m × 16 m, and whose each detection is; −1: nobody's."""
    rows, owners = [], []
    for person in range(people):
        side = rng.integers(4)
        start, end = rng.uniform(-8.0, 8.0, 2), rng.uniform(-8.0, 8.0, 2)
        start[side % 2], end[side % 2] = (-8.0, 8.0) if side < 2 else (8.0, -8.0)
        duration = int(np.hypot(*(end - start)) / (rng.uniform(1.0, 1.6) * step))
        first = rng.integers(max(frames - duration, 1))
        for k in range(first, min(first + duration, frames)):
            if rng.random() >= miss:
                place = start + (end - start) * (k - first) / duration
                rows.append((k, *(place + rng.normal(0.0, noise, 2))))
                owners.append(person)
    for k in range(frames):
        for _ in range(rng.poisson(false)):
            rows.append((k, *rng.uniform(-8.0, 8.0, 2)))
            owners.append(-1)
    order = rng.permutation(len(rows))
    table, whose = np.array(rows)[order], np.array(owners)[order]
    frame = table[:, 0].astype(np.int64)
    detections = Detections(frame, frame * step, table[:, 1:])
    return detections, whose[detections.row]


def idf1(found: np.ndarray, whose: np.ndarray) -> float:
    """F1 of the detections under the best pairing of tracks with people."""
    both = (found >= 0) & (whose >= 0)
    counts = np.zeros((found.max() + 1, whose.max() + 1))
    np.add.at(counts, (found[both], whose[both]), 1)
    right = counts[linear_sum_assignment(-counts)].sum()
    return float(2.0 * right / ((found >= 0).sum() + (whose >= 0).sum()))
