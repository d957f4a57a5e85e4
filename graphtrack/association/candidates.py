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
    State,
    evidence_after,
    evidence_as_new,
    extend_track,
    head_worth,
    is_new,
    is_within,
    log_between,
    log_end,
    log_gap,
    reach,
    spread_after,
    start_track,
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


FRAME_GROUP = np.dtype(
    [
        ("earliest", float),  # seconds
        ("latest", float),
        ("greatest_variance", float),  # m²
        ("least_variance", float),
        ("x", float),  # corner of the grid, metres
        ("y", float),
        ("size", float),  # of a cell, metres
        ("cells_x", np.int64),  # cells along each axis; 0: no detections
        ("cells_y", np.int64),
        ("first_cell", np.int64),
        ("first_frame", np.int64),
    ]
)
"""Detections of consecutive frames, and the grid that they lie in."""


class Grid(NamedTuple):
    """Detections by groups of frames, and in each group by cell."""

    detections: IntArray  # (columns,)
    groups: NDArray[np.void]  # of FRAME_GROUP
    start: IntArray  # (cells + 1,) of each cell in ``order``
    order: IntArray  # (n,) columns


@allocating
def grid_of(chains: Chains, detections: IntArray, columns: IntArray) -> Grid:
    """Return the grid of some columns (n,) of detections that are in the order of time."""
    n, count, base = len(columns), 0, chains.rows[detections[0]].frame
    group = np.empty(n, np.int64)
    for i in range(n):
        offset, g = chains.rows[detections[columns[i]]].frame - base, 0
        while offset > 0:
            offset, g = offset >> 1, g + 1
        group[i] = g
        count = max(count, g + 1)
    groups, high, sizes = np.zeros(count, FRAME_GROUP), np.full((count, 2), -np.inf), np.zeros(count)
    for g in range(count):
        one = groups[g]
        one.earliest = one.least_variance = one.x = one.y = np.inf
        one.latest = one.greatest_variance = -np.inf
    for i in range(n):
        row, g = chains.rows[detections[columns[i]]], group[i]
        one = groups[g]
        one.earliest, one.latest = min(one.earliest, row.t), max(one.latest, row.t)
        one.greatest_variance = max(one.greatest_variance, row.variance)
        one.least_variance = min(one.least_variance, row.variance)
        one.x, one.y = min(one.x, row.x), min(one.y, row.y)
        high[g, 0], high[g, 1] = max(high[g, 0], row.x), max(high[g, 1], row.y)
        sizes[g] += 1
    cells = 0
    for g in range(count):
        one = groups[g]
        one.first_cell, one.first_frame = cells, base + (1 << g) // 2
        if sizes[g]:
            width, height = high[g, 0] - one.x, high[g, 1] - one.y
            # Two detections a cell, and never many more cells than detections.
            size = max(math.sqrt(2.0 * width * height / sizes[g]), max(width, height) / sizes[g])
            one.size = max(size, _SMALLEST_CELL)
            one.cells_x, one.cells_y = int(width / one.size) + 1, int(height / one.size) + 1
            cells += one.cells_x * one.cells_y
    cell, start = np.empty(n, np.int64), np.zeros(cells + 1, np.int64)
    for i in range(n):
        row, one = chains.rows[detections[columns[i]]], groups[group[i]]
        across = int((row.x - one.x) / one.size)
        cell[i] = one.first_cell + across * one.cells_y + int((row.y - one.y) / one.size)
        start[cell[i] + 1] += 1
    start = np.cumsum(start)
    order, filled = np.empty(n, np.int64), start[:-1].copy()
    for i in range(n):
        order[filled[cell[i]]] = columns[i]
        filled[cell[i]] += 1
    return Grid(detections, groups, start, order)


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
    state: State,
    t: float,
    frame: int,
    grid: Grid,
    bounds: FloatArray,
    scene: SceneRow,
    found: IntArray,
) -> int:
    """Put into ``found`` the columns of a grid's detections within reach; return their number.

    Parameters
    ----------
    state, t, frame : of a person, at a time (s) and in a frame
    bounds : (groups,) greatest gain of links to each group over the gain needed, without position and gap
    """
    count, longest = 0, scene.longest_gap + TIME_TOLERANCE
    for g in range(len(grid.groups)):
        group = grid.groups[g]
        soon, latest = max(group.earliest - t, 0.0), min(group.latest - t, longest)
        if not group.cells_x or latest <= 0.0 or soon > longest:
            continue
        narrow = not is_new(state) and state.pv >= 0.0  # so that the variance grows with time
        least = spread_after(soon, state, group.least_variance, scene) if narrow else group.least_variance
        # Of several sensors some may not see the person.
        gone = log_gap(group.first_frame - frame - 1, scene) if not chains.scans.shape[1] else 0.0
        bound = bounds[g] + gone - math.log(2.0 * math.pi * least)
        if bound <= 0.0:
            continue
        # The variance is a convex function of time.
        widest = group.greatest_variance
        far = max(reach(state, soon, widest, scene), reach(state, latest, widest, scene))
        if not is_new(state):
            far *= min(math.sqrt(2.0 * bound) / GATE, 1.0)
        more_x, more_y = state.vx * (latest - soon), state.vy * (latest - soon)
        x, y = state.x + state.vx * soon, state.y + state.vy * soon
        low_x, high_x = x + min(more_x, 0.0) - far, x + max(more_x, 0.0) + far
        low_y, high_y = y + min(more_y, 0.0) - far, y + max(more_y, 0.0) + far
        first_x, end_x = cells_along(low_x, high_x, group.x, group.size, group.cells_x)
        first_y, end_y = cells_along(low_y, high_y, group.y, group.size, group.cells_y)
        if first_y >= end_y:
            continue
        for across in range(first_x, end_x):
            column = group.first_cell + across * group.cells_y
            for j in grid.order[grid.start[column + first_y] : grid.start[column + end_y]]:
                other = chains.rows[grid.detections[j]]
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
def most_dense(earlier: Row, before: State, later: Row, scene: SceneRow) -> float:
    """Bound of the log density of the position of a detection after an earlier one; see `kalman_step`."""
    dt = later.t - earlier.t
    off_x, off_y = later.x - before.x - dt * before.vx, later.y - before.y - dt * before.vy
    if is_new(before):
        total = 1e-300
        for component in scene.velocities:
            spread = compiled_spread(before.pp, 0.0, component.variance, dt, scene.density)[0]
            spread += later.variance
            ahead_x, ahead_y = off_x - dt * component.vx, off_y - dt * component.vy
            square = 0.5 * (ahead_x * ahead_x + ahead_y * ahead_y)
            total += component.weight * math.exp(-square / spread) / spread
        return math.log(total / (2.0 * math.pi))
    spread = spread_after(dt, before, later.variance, scene)
    wide = spread + (scene.jump_variance if scene.jump_probability > 0.0 else 0.0)
    square = 0.5 * (off_x * off_x + off_y * off_y)
    return -math.log(2.0 * math.pi * spread) - square / wide


@compiled
def log_skipped(chains: Chains, k: int, m: int, skipped: FloatArray, scene: SceneRow) -> float:
    """`log_between`, of one sensor read from ``skipped``: `log_gap` of gaps of 0, 1 … frames."""
    if chains.scans.shape[1]:
        return log_between(chains, k, m, scene)
    gap = chains.rows[m].frame - chains.rows[k].frame - 1
    return skipped[gap] if gap < len(skipped) else log_gap(gap, scene)


@allocating
def gaps_missed(scene: SceneRow) -> FloatArray:
    """Return `log_gap` for gaps of 0, 1 … frames up to the longest."""
    frames = int(min(scene.longest_gap / scene.frame_seconds, 200.0)) + 1
    skipped = np.empty(frames)
    for k in range(frames):
        skipped[k] = log_gap(k, scene)
    return skipped


@compiled
def worth_of_state(tail: Row, state: State, scene: SceneRow) -> float:
    """Bound of a tail state's contribution to the log likelihood of a new person's detections."""
    determinant = max(state.pp * state.vv - state.pv * state.pv, 1e-12)
    speed = state.vx * state.vx + state.vy * state.vy
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
def most_offered_each(chains: Chains, grid: Grid, least: FloatArray, scene: SceneRow) -> FloatArray:
    """Return the greatest `most_offered` over the least gain (``least``) in each group of a grid."""
    most, offered = most_shown(scene), np.full(len(grid.groups), -np.inf)
    for g in range(len(grid.groups)):
        one = grid.groups[g]
        for j in grid.order[
            grid.start[one.first_cell] : grid.start[one.first_cell + one.cells_x * one.cells_y]
        ]:
            worth = most_offered(chains.rows[grid.detections[j]], 0.0, most, scene)
            offered[g] = max(offered[g], worth - least[j])
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
    state, near = np.empty(1, STATE), np.empty(len(columns), np.int64)
    value, most, skipped = np.full(len(columns), np.nan), most_shown(scene), gaps_missed(scene)
    every, new = grids_of(chains, columns, fresh[1])
    offered_every = most_offered_each(chains, every, least, scene)
    offered_new = most_offered_each(chains, new, least, scene)
    for i in rows:
        k = heads[i]
        earlier, before = chains.rows[k], chains.state[k]
        more = head_worth(chains, k, scene)
        grid, offered = (every, offered_every) if fresh[0][i] else (new, offered_new)
        bounds = offered + more
        count = near_detections(chains, before, earlier.t, earlier.frame, grid, bounds, scene, near)
        for j in near[:count]:
            m = columns[j]
            if math.isnan(value[j]):
                value[j] = evidence_as_new(chains, m, scene, state[0])
            later = chains.rows[m]
            bound = more + most_offered(later, value[j], most, scene)
            bound += log_skipped(chains, k, m, skipped, scene)
            if bound - math.log(2.0 * math.pi * later.variance) <= least[j]:
                continue
            if bound + most_dense(earlier, before, later, scene) <= least[j]:
                continue
            gain = more + extend_track(chains, before, k, m, scene, state[0])
            bound = gain - scene.log_birth - later.birth - later.gain + min(0.0, value[j]) + most
            if later.following >= 0 and bound + worth_of_state(later, state[0], scene) <= least[j]:
                continue
            gain += evidence_after(chains, state[0], m, scene) - max(0.0, value[j])
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
    state, here, back = np.empty(1, STATE), np.empty(1, STATE), np.zeros(1, STATE)
    alone, near = np.empty(len(columns)), np.empty(len(columns), np.int64)
    most, skipped = most_shown(scene), gaps_missed(scene)
    now, frame = chains.rows[columns[0]].t, chains.rows[columns[0]].frame
    every, new_columns = grids_of(chains, columns, fresh[1])
    last, new, bounds = -np.inf, -np.inf, np.empty(1)
    for j in range(len(columns)):
        d = columns[j]
        value, left = start_track(chains.rows[d], scene, state[0]), log_end(chains, d, scene)
        alone[j] = max(0.0, value + left)
        last = max(last, chains.rows[d].gain + left - alone[j] - least[j])
        new = max(new, value - alone[j] - least[j])
    for i in rows:
        k, m = heads[i], tails[i]
        grid = every if fresh[0][i] else new_columns
        if k >= 0:
            without, one = state_after(chains, k, scene, state[0]), chains.rows[k]
            bounds[0] = np.inf if m >= 0 else head_worth(chains, k, scene) + most + last
            count = near_detections(chains, chains.state[k], one.t, one.frame, grid, bounds, scene, near)
        else:
            # As far from the tail as a new person may have walked.
            without, later = evidence_as_new(chains, m, scene, state[0]), chains.rows[m]
            dt = later.t - now
            bounds[0] = new + most_offered(later, without, most, scene)
            if not chains.scans.shape[1]:
                bounds[0] += log_gap(later.frame - frame - 1, scene)
            back[0].x, back[0].y = later.x, later.y
            back[0].pp = compiled_spread(later.variance, 0.0, scene.speed_variance, dt, scene.density)[0]
            count = near_detections(
                chains, back[0], math.nextafter(now, -math.inf), frame - 1, grid, bounds, scene, near
            )
        for j in near[:count]:
            d = columns[j]
            if k < 0:
                gain = start_track(chains.rows[d], scene, here[0])
                bound = gain - alone[j] + most_offered(chains.rows[m], without, most, scene)
                bound += most_dense(chains.rows[d], here[0], chains.rows[m], scene)
                if bound > least[j]:
                    bound += log_skipped(chains, d, m, skipped, scene)
            else:
                bound = np.inf
                if m < 0:
                    bound = head_worth(chains, k, scene) + most
                    bound += chains.rows[d].gain + log_end(chains, d, scene) - alone[j]
                    bound += most_dense(chains.rows[k], chains.state[k], chains.rows[d], scene)
                    if bound > least[j]:
                        bound += log_skipped(chains, k, d, skipped, scene)
                if bound > least[j]:
                    gain = chains.rows[k].total + extend_track(chains, chains.state[k], k, d, scene, here[0])
            if bound <= least[j]:
                continue
            if m >= 0:
                if not is_within(here[0], chains.rows[m].t - now, chains.rows[m], scene):
                    continue
                gain += extend_track(chains, here[0], d, m, scene, state[0]) + evidence_after(
                    chains, state[0], m, scene
                )
            else:
                gain += log_end(chains, d, scene)
            gain -= max(0.0, without) + alone[j]
            if gain > least[j]:
                edges = with_edge(edges, n, i, j, gain)
                n += 1
    return edges[0][:n].copy(), edges[1][:n].copy(), edges[2][:n].copy()
