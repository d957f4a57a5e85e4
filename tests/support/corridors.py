"""People who walk round the corner of a corridor."""

import numpy as np
import shapely

import graphtrack as gt
from graphtrack.geometry.walkable import WalkableArea

CORRIDOR = shapely.union_all([shapely.box(0, 0, 20, 2), shapely.box(18, 0, 20, 12)])
NOISE = 0.3  # 1-σ of the positions, m on each axis


def corridor_walkers(
    count: int, rng: np.random.Generator, noise: float = NOISE, *, aside: float | None = None, apart: int = 0
) -> gt.TrackSet:
    """People at 5 Hz, ``aside`` of a wall (m, else at random), each ``apart`` frames after the one before."""
    found = []
    for k in range(count):
        wall = rng.uniform(0.12, 1.88) if aside is None else aside
        corners = np.array([[0.3, wall], [20.0 - wall, wall], [20.0 - wall, 11.7]])
        along = np.r_[0.0, np.cumsum(np.linalg.norm(np.diff(corners, axis=0), axis=1))]
        at = np.arange(0.0, along[-1], 0.26)
        path = np.column_stack([np.interp(at, along, corners[:, axis]) for axis in range(2)])
        frame = apart * k + np.arange(len(at))
        observed = path + rng.normal(0.0, noise, path.shape)
        std = np.full(len(at), noise)
        found.append(gt.Track(k, frame, 0.2 * frame, observed, position_std=std, true_position=path))
    return gt.TrackSet(tuple(found))


def share_outside(position: np.ndarray) -> float:
    """Return the share of positions (n, 2) outside the corridor."""
    return 1.0 - float(WalkableArea(CORRIDOR).contains(position).mean())
