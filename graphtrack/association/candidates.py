"""Candidates within reach and their gains in evidence, compiled.

Candidates are found on grids: a cell for each place, and groups of frames whose lengths double with the time
from the frame that is decided. Bounds leave out candidates whose gain cannot matter.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from graphtrack.association.likelihood import (
    GATE,
    STATE,
    Chains,
    IntArray,
    Row,
    SceneRow,
    begin,
    born,
    ending,
    follow,
    head_worth,
    is_new,
    is_within,
    missed,
    reach,
    run_on,
    spread_after,
    state_after,
)
from graphtrack.association.matching import Edges
from graphtrack.constant_velocity import compiled_spread
from graphtrack.geometry.angles import FloatArray
from graphtrack.kernels.compilation import allocating, compiled
from graphtrack.tracks.time import TIME_TOLERANCE

Flags = NDArray[np.bool_]

_WORTH_OF_VELOCITY = 12.0
"""Greatest log likelihood that a track's following detections gain by a known position and velocity."""

_WORTH_OF_PRIOR = 5.0
"""Bound of the log of a Gaussian's density over that of the prior of velocities, beyond its ends."""

_SMALLEST_CELL = 0.5  # metres


class Grid(NamedTuple):
    """Detections by groups of frames, and in each group by cell."""

    # (groups, 7) earliest and latest time (s), greatest and least variance (m²), corner, size of a cell (m)
    spans: FloatArray
    # (groups, 4) cells along x and y, number of the first cell, and first frame
    shape: IntArray
    start: IntArray  # (cells + 1,) of each cell in ``order``
    order: IntArray  # (n,) columns


@allocating
def grid_of(chains: Chains, detections: IntArray, columns: IntArray) -> Grid:
    """Return the grid of some columns (n,) of detections that are in the order of time."""
    n, groups, base = len(columns), 0, chains.rows[detections[0]].frame
    group = np.empty(n, np.int64)
    for i in range(n):
        offset, g = chains.rows[detections[columns[i]]].frame - base, 0
        while offset > 0:
            offset, g = offset >> 1, g + 1
        group[i] = g
        groups = max(groups, g + 1)
    spans, shape = np.empty((groups, 7)), np.zeros((groups, 4), np.int64)
    high, count = np.full((groups, 2), -np.inf), np.zeros(groups, np.int64)
    spans[:, 1:3] = -np.inf
    spans[:, 0], spans[:, 3:6] = np.inf, np.inf
    for i in range(n):
        one, g = chains.rows[detections[columns[i]]], group[i]
        spans[g, 0], spans[g, 1] = min(spans[g, 0], one.t), max(spans[g, 1], one.t)
        spans[g, 2], spans[g, 3] = max(spans[g, 2], one.variance), min(spans[g, 3], one.variance)
        spans[g, 4], spans[g, 5] = min(spans[g, 4], one.x), min(spans[g, 5], one.y)
        high[g, 0], high[g, 1] = max(high[g, 0], one.x), max(high[g, 1], one.y)
        count[g] += 1
    cells = 0
    for g in range(groups):
        shape[g, 2], shape[g, 3] = cells, base + (1 << g) // 2
        if count[g]:
            width, height = high[g, 0] - spans[g, 4], high[g, 1] - spans[g, 5]
            # Two detections a cell, and never many more cells than detections.
            size = max(math.sqrt(2.0 * width * height / count[g]), max(width, height) / count[g])
            spans[g, 6] = max(size, _SMALLEST_CELL)
            shape[g, 0], shape[g, 1] = int(width / spans[g, 6]) + 1, int(height / spans[g, 6]) + 1
            cells += shape[g, 0] * shape[g, 1]
    cell, start = np.empty(n, np.int64), np.zeros(cells + 1, np.int64)
    for i in range(n):
        one, g = chains.rows[detections[columns[i]]], group[i]
        across = int((one.x - spans[g, 4]) / spans[g, 6])
        cell[i] = shape[g, 2] + across * shape[g, 1] + int((one.y - spans[g, 5]) / spans[g, 6])
        start[cell[i] + 1] += 1
    start = np.cumsum(start)
    order, filled = np.empty(n, np.int64), start[:-1].copy()
    for i in range(n):
        order[filled[cell[i]]] = columns[i]
        filled[cell[i]] += 1
    return Grid(spans, shape, start, order)


@allocating
def grids_of(chains: Chains, detections: IntArray, fresh: Flags) -> tuple[Grid, Grid]:
    """Return the grids of all columns, and of those that are ``fresh``."""
    every = grid_of(chains, detections, np.arange(len(detections)))
    return every, every if fresh.all() else grid_of(chains, detections, np.flatnonzero(fresh))


@compiled
def cells_along(low: float, high: float, corner: float, size: float, cells: int) -> tuple[int, int]:
    """First cell along an axis from ``low`` to ``high``, and the first cell behind them."""
    first = max(math.floor((low - corner) / size), 0.0)
    end = min(math.floor((high - corner) / size) + 1.0, float(cells))
    return int(min(first, float(cells))), int(max(end, 0.0))


@compiled
def near_detections(
    chains: Chains,
    state: FloatArray,
    t: float,
    frame: int,
    detections: IntArray,
    grid: Grid,
    bounds: FloatArray,
    scene: SceneRow,
    found: IntArray,
) -> int:
    """Put into ``found`` the columns of detections within reach; return their number.

    Parameters
    ----------
    state, t, frame : of a person, at a time (s) and in a frame
    detections, grid : the columns, and the grid of some of them
    bounds : (groups,) greatest gain of links to each group over the gain needed, without position and gap
    """
    count, longest = 0, scene.longest_gap + TIME_TOLERANCE
    for g in range(len(grid.shape)):
        spans, shape = grid.spans[g], grid.shape[g]
        soon, latest = max(spans[0] - t, 0.0), min(spans[1] - t, longest)
        if not shape[0] or latest <= 0.0 or soon > longest:
            continue
        narrow = not is_new(state) and state[5] >= 0.0  # so that the variance grows with time
        least = spread_after(soon, state, spans[3], scene) if narrow else spans[3]
        bound = bounds[g] + missed(shape[3] - frame - 1, scene) - math.log(2.0 * math.pi * least)
        if bound <= 0.0:
            continue
        # The variance is a convex function of time.
        far = max(reach(state, soon, spans[2], scene), reach(state, latest, spans[2], scene))
        if not is_new(state):
            far *= min(math.sqrt(2.0 * bound) / GATE, 1.0)
        more_x, more_y = state[2] * (latest - soon), state[3] * (latest - soon)
        x, y = state[0] + state[2] * soon, state[1] + state[3] * soon
        low_x, high_x = x + min(more_x, 0.0) - far, x + max(more_x, 0.0) + far
        low_y, high_y = y + min(more_y, 0.0) - far, y + max(more_y, 0.0) + far
        first_x, end_x = cells_along(low_x, high_x, spans[4], spans[6], shape[0])
        first_y, end_y = cells_along(low_y, high_y, spans[5], spans[6], shape[1])
        if first_y >= end_y:
            continue
        for across in range(first_x, end_x):
            column = shape[2] + across * shape[1]
            for j in grid.order[grid.start[column + first_y] : grid.start[column + end_y]]:
                other = chains.rows[detections[j]]
                dt = other.t - t
                if 0.0 < dt <= longest and is_within(state, dt, other, scene):
                    found[count] = j
                    count += 1
    return count


@compiled
def most_shown(scene: SceneRow) -> float:
    """Greatest log likelihood ratio of appearance, angles and a given identity that a link can have."""
    most = scene.trust
    if scene.appearance_outliers < 1.0:
        most -= math.log(scene.appearance_outliers)
    if scene.body_outliers < 1.0:
        most += max(0.5 * math.log(2.0 * math.pi / scene.body_variance), 0.0) + 1.0
    if scene.head_outliers < 1.0:
        most += max(0.5 * math.log(2.0 * math.pi / scene.head_variance), 0.0) + 1.0
    return most


@compiled
def most_dense(earlier: Row, before: FloatArray, later: Row, skipped: FloatArray, scene: SceneRow) -> float:
    """Bound of the log density of a later detection's position and of its gap; see `move`.

    ``skipped``: `missed`, of gaps of 0, 1 … frames
    """
    dt = later.t - earlier.t
    off_x, off_y = later.x - before[0] - dt * before[2], later.y - before[1] - dt * before[3]
    gap = later.frame - earlier.frame - 1
    gone = skipped[gap] if gap < len(skipped) else missed(gap, scene)
    if is_new(before):
        total = 1e-300
        for component in scene.velocities:
            spread = compiled_spread(before[4], 0.0, component[3], dt, scene.density)[0] + later.variance
            ahead_x, ahead_y = off_x - dt * component[1], off_y - dt * component[2]
            square = 0.5 * (ahead_x * ahead_x + ahead_y * ahead_y)
            total += component[0] * math.exp(-square / spread) / spread
        return math.log(total / (2.0 * math.pi)) + gone
    spread = spread_after(dt, before, later.variance, scene)
    wide = spread + (scene.jump_variance if scene.jump_probability > 0.0 else 0.0)
    square = 0.5 * (off_x * off_x + off_y * off_y)
    return -math.log(2.0 * math.pi * spread) - square / wide + gone


@allocating
def gaps_missed(scene: SceneRow) -> FloatArray:
    """Return `missed` for gaps of 0, 1 … frames up to the longest."""
    frames = int(min(scene.longest_gap / scene.frame_seconds, 200.0)) + 1
    skipped = np.empty(frames)
    for k in range(frames):
        skipped[k] = missed(k, scene)
    return skipped


@compiled
def worth_of_state(tail: Row, state: FloatArray, scene: SceneRow) -> float:
    """Bound of a tail state's contribution to the log likelihood of a new person's detections."""
    determinant = max(state[4] * state[6] - state[5] * state[5], 1e-12)
    speed = state[2] * state[2] + state[3] * state[3]
    gained = math.log(tail.variance * scene.speed_variance / determinant)
    return max(gained, 0.0) + speed / scene.speed_variance + _WORTH_OF_PRIOR


@compiled
def most_offered(tail: Row, value: float, most: float, scene: SceneRow) -> float:
    """Bound of the gain of a link to a tail of that value as a new person, without `most_dense`.

    The following detections have at least the likelihood that they have for a new person, plus the bound.
    """
    following = _WORTH_OF_VELOCITY + most if tail.following >= 0 else 0.0
    return min(0.0, value) - scene.log_birth - tail.birth + following + most


@allocating
def most_offered_each(
    chains: Chains, tails: IntArray, grid: Grid, least: FloatArray, scene: SceneRow
) -> FloatArray:
    """Return the greatest `most_offered` over the least gain (``least``) in each group of a grid."""
    most, offered = most_shown(scene), np.full(len(grid.shape), -np.inf)
    for g in range(len(grid.shape)):
        first = grid.shape[g, 2]
        for j in grid.order[grid.start[first] : grid.start[first + grid.shape[g, 0] * grid.shape[g, 1]]]:
            offered[g] = max(offered[g], most_offered(chains.rows[tails[j]], 0.0, most, scene) - least[j])
    return offered


@allocating
def with_edge(edges: Edges, n: int, row: int, column: int, gain: float) -> Edges:
    """Return edges with one put in place ``n``, in arrays of twice the room where they are full."""
    if n == len(edges[0]):
        room = 2 * n
        new = np.empty(room, np.int64), np.empty(room, np.int64), np.empty(room)
        new[0][:n], new[1][:n], new[2][:n] = edges
        edges = new
    edges[0][n], edges[1][n], edges[2][n] = row, column, gain
    return edges


@allocating
def gains_of_links(
    chains: Chains,
    heads: IntArray,
    tails: IntArray,
    columns: IntArray,
    fresh: tuple[Flags, Flags],
    rows: IntArray,
    least: FloatArray,
    scene: SceneRow,
) -> Edges:
    """Return the gain in evidence of each link of a track's head to a tail over none.

    Parameters
    ----------
    heads, columns : detections; the columns are the tails
    tails : not used, as of `gains_of_detections`
    fresh : rows (heads,) that are compared with all columns, and columns that all rows are compared with
    rows : heads to do
    least : (columns,) gains that matter
    """
    edges, n = (np.empty(64, np.int64), np.empty(64, np.int64), np.empty(64)), 0
    state, near = np.empty(STATE), np.empty(len(columns), np.int64)
    value, most, skipped = np.full(len(columns), np.nan), most_shown(scene), gaps_missed(scene)
    every, new = grids_of(chains, columns, fresh[1])
    offered_every = most_offered_each(chains, columns, every, least, scene)
    offered_new = most_offered_each(chains, columns, new, least, scene)
    for i in rows:
        k = heads[i]
        earlier, before = chains.rows[k], chains.state[k]
        more = head_worth(chains, k, scene)
        grid, offered = (every, offered_every) if fresh[0][i] else (new, offered_new)
        bounds = offered + more
        count = near_detections(chains, before, earlier.t, earlier.frame, columns, grid, bounds, scene, near)
        for j in near[:count]:
            m = columns[j]
            if math.isnan(value[j]):
                value[j] = born(chains, m, scene, state)
            later = chains.rows[m]
            bound = more + most_offered(later, value[j], most, scene)
            if bound + most_dense(earlier, before, later, skipped, scene) <= least[j]:
                continue
            gain = more + follow(chains, before, k, m, scene, state)
            bound = gain - scene.log_birth - later.birth - later.gain + min(0.0, value[j]) + most
            if later.following >= 0 and bound + worth_of_state(later, state, scene) <= least[j]:
                continue
            gain += run_on(chains, state, m, scene) - max(0.0, value[j])
            if gain > least[j]:
                edges = with_edge(edges, n, i, j, gain)
                n += 1
    return edges[0][:n].copy(), edges[1][:n].copy(), edges[2][:n].copy()


@allocating
def gains_of_detections(
    chains: Chains,
    heads: IntArray,
    tails: IntArray,
    columns: IntArray,
    fresh: tuple[Flags, Flags],
    rows: IntArray,
    least: FloatArray,
    scene: SceneRow,
) -> Edges:
    """Return the gain in evidence of each detection of a frame in a track that spans it, over none.

    Parameters
    ----------
    heads, tails : (tracks,) the last detection before the frame and the first after it, linked; −1: none
    columns : the frame's detections
    fresh, rows, least : as of `gains_of_links`
    """
    edges, n = (np.empty(64, np.int64), np.empty(64, np.int64), np.empty(64)), 0
    state, here, back = np.empty(STATE), np.empty(STATE), np.zeros(STATE)
    alone, near = np.empty(len(columns)), np.empty(len(columns), np.int64)
    most, skipped = most_shown(scene), gaps_missed(scene)
    now, frame = chains.rows[columns[0]].t, chains.rows[columns[0]].frame
    every, new_columns = grids_of(chains, columns, fresh[1])
    last, new, bounds = -np.inf, -np.inf, np.empty(1)
    for j in range(len(columns)):
        d = columns[j]
        value, left = begin(chains.rows[d], scene, state), ending(chains, d, scene)
        alone[j] = max(0.0, value + left)
        last = max(last, chains.rows[d].gain + left - alone[j] - least[j])
        new = max(new, value - alone[j] - least[j])
    for i in rows:
        k, m = heads[i], tails[i]
        grid = every if fresh[0][i] else new_columns
        if k >= 0:
            without, one = state_after(chains, k, scene, state), chains.rows[k]
            bounds[0] = np.inf if m >= 0 else head_worth(chains, k, scene) + most + last
            count = near_detections(
                chains, chains.state[k], one.t, one.frame, columns, grid, bounds, scene, near
            )
        else:
            # As far from the tail as a new person may have walked.
            without, later = born(chains, m, scene, state), chains.rows[m]
            dt = later.t - now
            bounds[0] = new + most_offered(later, without, most, scene)
            bounds[0] += missed(later.frame - frame - 1, scene)
            back[0], back[1] = later.x, later.y
            back[4] = compiled_spread(later.variance, 0.0, scene.speed_variance, dt, scene.density)[0]
            count = near_detections(
                chains, back, math.nextafter(now, -math.inf), frame - 1, columns, grid, bounds, scene, near
            )
        for j in near[:count]:
            d = columns[j]
            if k < 0:
                gain = begin(chains.rows[d], scene, here)
                bound = gain - alone[j] + most_offered(chains.rows[m], without, most, scene)
                bound += most_dense(chains.rows[d], here, chains.rows[m], skipped, scene)
            else:
                bound = np.inf
                if m < 0:
                    bound = head_worth(chains, k, scene) + most
                    bound += chains.rows[d].gain + ending(chains, d, scene) - alone[j]
                    bound += most_dense(chains.rows[k], chains.state[k], chains.rows[d], skipped, scene)
                if bound > least[j]:
                    gain = chains.rows[k].total + follow(chains, chains.state[k], k, d, scene, here)
            if bound <= least[j]:
                continue
            if m >= 0:
                if not is_within(here, chains.rows[m].t - now, chains.rows[m], scene):
                    continue
                gain += follow(chains, here, d, m, scene, state) + run_on(chains, state, m, scene)
            else:
                gain += ending(chains, d, scene)
            gain -= max(0.0, without) + alone[j]
            if gain > least[j]:
                edges = with_edge(edges, n, i, j, gain)
                n += 1
    return edges[0][:n].copy(), edges[1][:n].copy(), edges[2][:n].copy()
