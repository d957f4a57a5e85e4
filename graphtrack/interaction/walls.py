"""People and walls offline: estimates that stay within a walkable area."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from graphtrack.geometry.angles import FloatArray
from graphtrack.geometry.walkable import WalkableArea
from graphtrack.inference.engines import Failure, Solution
from graphtrack.model.terms.walls import WALL_INPUT, barrier_depth
from graphtrack.tracks.track import Track, TrackSet

ROUNDS = 4
"""Most rounds in which walls are selected at the previous estimates."""

Solve = Callable[[TrackSet], list[Solution | Failure]]


def with_walls(track: Track, position: FloatArray, area: WalkableArea) -> Track:
    """Return a track with the input `WALL_INPUT` of walls near positions (n, 2), one a frame."""
    return replace(track, inputs={**track.inputs, WALL_INPUT: area.walls(position)})


def without_walls(track: Track) -> Track:
    """Return a track without the input `WALL_INPUT`."""
    return replace(track, inputs={name: one for name, one in track.inputs.items() if name != WALL_INPUT})


def solve_inside(
    tracks: TrackSet, solve: Solve, solve_with_walls: Solve, area: WalkableArea
) -> list[Solution | Failure]:
    """Solve tracks, and solve again tracks with estimates near a wall, with the walls near these estimates.

    An estimate at least `MARGIN` from all walls is unchanged by walls, as the barrier is 0 there. If other
    walls are near the new estimates, the tracks are solved again with these.

    Parameters
    ----------
    tracks : observations
    solve : solver without walls
    solve_with_walls : solver whose model has the term `StaysInside`
    area : the walkable area
    """
    found = solve(tracks)
    left = [
        k
        for k, one in enumerate(found)
        if isinstance(one, Solution) and _is_near(one.track.position, area).any()
    ]
    for _ in range(ROUNDS):
        if not left:
            break
        walled = [
            with_walls(tracks.tracks[k], one.track.position, area)
            for k in left
            if isinstance(one := found[k], Solution)
        ]
        for k, one in zip(left, solve_with_walls(tracks.with_tracks(walled)), strict=True):
            found[k] = replace(one, track=without_walls(one.track)) if isinstance(one, Solution) else one
        left = [
            k
            for k in left
            if isinstance(one := found[k], Solution) and not _is_inside(one.track.position, area).all()
        ]
    return found


def _is_inside(position: NDArray[np.float64], area: WalkableArea) -> NDArray[np.bool_]:
    return area.contains(position) | ~np.isfinite(position).all(axis=1)


def _is_near(position: NDArray[np.float64], area: WalkableArea) -> NDArray[np.bool_]:
    """Return (n,) True for positions outside, or within the barrier of a wall."""
    beyond = barrier_depth(area.walls(position), position) > 0.0
    return np.asarray(np.any(beyond, axis=1) | ~_is_inside(position, area))
