"""Candidate links within reach, their gains, and the best match among them, compiled.

Candidates are found on grids: a cell for each place, and groups of frames whose lengths double with the time
from the frame that is decided. A candidate that another candidate outbids in any case is left out.
"""

from __future__ import annotations

import math
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from graphtrack.association.likelihood import (
    GATE,
    STATE,
    Chains,
    IntArray,
    Row,
    Scene,
    begin,
    born,
    change_after,
    ending,
    follow,
    head_worth,
    is_within,
    missed,
    reach,
    run_on,
    spread_after,
    state_after,
)
from graphtrack.geometry.angles import FloatArray
from graphtrack.kernels.compilation import allocating, compiled
from graphtrack.packages import csgraph, sparse

Edges: TypeAlias = tuple[IntArray, IntArray, FloatArray]
"""Rows (e,), columns (e,) and gains (e,) of candidates."""

WORTHLESS = -10.0
"""Gain below that of the best for the same detection below which a candidate's probability is taken as 0."""

_WORTH_OF_VELOCITY = 12.0
"""Greatest log likelihood that a track's following detections gain by a known position and velocity."""

_SMALLEST_CELL = 0.5  # metres


class Grid(NamedTuple):
    """Detections by groups of frames, and in each group by cell."""

    spans: (
        FloatArray  # (groups, 6) earliest and latest time (s), greatest variance (m²), corner, cell size (m)
    )
    shape: IntArray  # (groups, 3) cells along x and y, and the number of the first cell
    start: IntArray  # (cells + 1,) of each cell in ``order``
    order: IntArray  # (n,) places of the detections in the array that the grid was made of


@allocating
def grid_of(chains: Chains, detections: IntArray, base: int) -> Grid:
    """Return the grid of detections (n,) that are in the frame ``base`` or later."""
    n, groups = len(detections), 0
    group = np.empty(n, np.int64)
    for j in range(n):
        offset, g = chains.rows[detections[j]].frame - base, 0
        while offset > 0:
            offset, g = offset >> 1, g + 1
        group[j] = g
        groups = max(groups, g + 1)
    spans, shape = np.empty((groups, 7)), np.zeros((groups, 4), np.int64)
    high, count = np.full((groups, 2), -np.inf), np.zeros(groups, np.int64)
    spans[:, 0], spans[:, 1], spans[:, 2] = np.inf, -np.inf, 0.0
    spans[:, 3:5], spans[:, 6] = np.inf, np.inf
    for j in range(n):
        one, g = chains.rows[detections[j]], group[j]
        spans[g, 0], spans[g, 1] = min(spans[g, 0], one.t), max(spans[g, 1], one.t)
        spans[g, 2], spans[g, 6] = max(spans[g, 2], one.variance), min(spans[g, 6], one.variance)
        spans[g, 3], spans[g, 4] = min(spans[g, 3], one.x), min(spans[g, 4], one.y)
        high[g, 0], high[g, 1] = max(high[g, 0], one.x), max(high[g, 1], one.y)
        count[g] += 1
    cells = 0
    for g in range(groups):
        shape[g, 2], shape[g, 3] = cells, base + (1 << g) // 2
        if count[g]:
            width, height = high[g, 0] - spans[g, 3], high[g, 1] - spans[g, 4]
            # Two detections a cell, and never many more cells than detections.
            size = max(math.sqrt(2.0 * width * height / count[g]), max(width, height) / count[g])
            spans[g, 5] = max(size, _SMALLEST_CELL)
            shape[g, 0], shape[g, 1] = int(width / spans[g, 5]) + 1, int(height / spans[g, 5]) + 1
            cells += shape[g, 0] * shape[g, 1]
    cell, start = np.empty(n, np.int64), np.zeros(cells + 1, np.int64)
    for j in range(n):
        one, g = chains.rows[detections[j]], group[j]
        across = int((one.x - spans[g, 3]) / spans[g, 5])
        cell[j] = shape[g, 2] + across * shape[g, 1] + int((one.y - spans[g, 4]) / spans[g, 5])
        start[cell[j] + 1] += 1
    start = np.cumsum(start)
    order, filled = np.empty(n, np.int64), start[:-1].copy()
    for j in range(n):
        order[filled[cell[j]]] = j
        filled[cell[j]] += 1
    return Grid(spans, shape, start, order)


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
    partners: IntArray,
    grid: Grid,
    bounds: FloatArray,
    scene: Scene,
    found: IntArray,
) -> int:
    """Put into ``found`` the indices in ``partners`` of detections within reach; return their number.

    Parameters
    ----------
    state, t, frame : of a person, at a time (s) and in a frame
    partners, grid : detections, and their grid
    bounds : (groups,) greatest gain of links to each group over the gain needed, without position and gap
    """
    count = 0
    for g in range(len(grid.shape)):
        spans, shape = grid.spans[g], grid.shape[g]
        soon, latest = max(spans[0] - t, 0.0), min(spans[1] - t, scene.longest_gap)
        if not shape[0] or latest <= 0.0 or soon > scene.longest_gap:
            continue
        # The variance is a convex function of time.
        far = max(reach(state, soon, spans[2], scene), reach(state, latest, spans[2], scene))
        least = spread_after(soon, state, spans[6], scene) if state[5] >= 0.0 else spans[6]
        bound = bounds[g] + missed(shape[3] - frame - 1, scene) - math.log(2.0 * math.pi * least)
        if bound <= 0.0:
            continue
        far *= min(math.sqrt(2.0 * bound) / GATE, 1.0)
        ahead_x, ahead_y = state[2] * soon, state[3] * soon
        more_x, more_y = state[2] * (latest - soon), state[3] * (latest - soon)
        x, y = state[0] + ahead_x, state[1] + ahead_y
        low_x, high_x = x + min(more_x, 0.0) - far, x + max(more_x, 0.0) + far
        low_y, high_y = y + min(more_y, 0.0) - far, y + max(more_y, 0.0) + far
        first_x, end_x = cells_along(low_x, high_x, spans[3], spans[5], shape[0])
        first_y, end_y = cells_along(low_y, high_y, spans[4], spans[5], shape[1])
        if first_y >= end_y:
            continue
        for across in range(first_x, end_x):
            column = shape[2] + across * shape[1]
            for place in range(grid.start[column + first_y], grid.start[column + end_y]):
                j = grid.order[place]
                other = chains.rows[partners[j]]
                dt = other.t - t
                if dt <= 0.0 or dt > scene.longest_gap:
                    continue
                off_x = other.x - state[0] - dt * state[2]
                off_y = other.y - state[1] - dt * state[3]
                if is_within(off_x, off_y, dt, state, other.variance, scene):
                    found[count] = j
                    count += 1
    return count


@compiled
def most_shown(scene: Scene) -> float:
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
def most_dense(earlier: Row, before: FloatArray, later: Row, skipped: FloatArray, scene: Scene) -> float:
    """Bound of the log density of a later detection's position and of its gap; see `move`.

    ``skipped``: `missed`, of gaps of 0, 1 … frames
    """
    dt = later.t - earlier.t
    spread = spread_after(dt, before, later.variance, scene)
    wide = spread + (scene.jump_variance if scene.jump_probability > 0.0 else 0.0)
    off_x, off_y = later.x - before[0] - dt * before[2], later.y - before[1] - dt * before[3]
    square = 0.5 * (off_x * off_x + off_y * off_y)
    gap = later.frame - earlier.frame - 1
    density = -math.log(2.0 * math.pi * spread) - square / wide
    return density + (skipped[gap] if gap < len(skipped) else missed(gap, scene))


@allocating
def gaps_missed(scene: Scene) -> FloatArray:
    """Return `missed` for gaps of 0, 1 … frames up to the longest."""
    frames = int(min(scene.longest_gap / scene.frame_seconds, 200.0)) + 1
    skipped = np.empty(frames)
    for k in range(frames):
        skipped[k] = missed(k, scene)
    return skipped


@compiled
def worth_of_state(tail: Row, state: FloatArray, scene: Scene) -> float:
    """Bound of a tail state's contribution to the log likelihood of a new person's detections."""
    determinant = max(state[4] * state[6] - state[5] * state[5], 1e-12)
    speed = state[2] * state[2] + state[3] * state[3]
    gained = math.log(tail.variance * scene.speed_variance / determinant)
    return max(gained, 0.0) + speed / scene.speed_variance + 2.0


@compiled
def most_offered(tail: Row, value: float, most: float, scene: Scene) -> float:
    """Bound of the gain of a link to a tail of that value as a new person, without `most_dense`.

    The following detections have at least the likelihood that they have for a new person, plus the bound.
    """
    following = _WORTH_OF_VELOCITY + most if tail.following >= 0 else 0.0
    return min(0.0, value) - scene.log_birth - tail.birth + following + most


@allocating
def most_offered_each(
    chains: Chains, tails: IntArray, grid: Grid, least: FloatArray, scene: Scene
) -> FloatArray:
    """Return the greatest `most_offered` over the least gain (``least``) in each group of a grid."""
    most, offered = most_shown(scene), np.full(len(grid.shape), -np.inf)
    for g in range(len(grid.shape)):
        first = grid.shape[g, 2]
        for place in range(grid.start[first], grid.start[first + grid.shape[g, 0] * grid.shape[g, 1]]):
            j = grid.order[place]
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
    grid: Grid,
    least: FloatArray,
    scene: Scene,
) -> Edges:
    """Return the gain in evidence of each link of a track's head to a tail over none.

    Parameters
    ----------
    heads, tails, grid : detections, and the grid of the tails
    least : (tails,) gains that matter
    """
    edges, n = (np.empty(64, np.int64), np.empty(64, np.int64), np.empty(64)), 0
    state, near = np.empty(STATE), np.empty(len(tails), np.int64)
    value, most, skipped = np.full(len(tails), np.nan), most_shown(scene), gaps_missed(scene)
    offered = most_offered_each(chains, tails, grid, least, scene)
    for i in range(len(heads)):
        k = heads[i]
        earlier, before = chains.rows[k], chains.state[k]
        more = head_worth(chains, k, scene)
        bounds = offered + more
        count = near_detections(chains, before, earlier.t, earlier.frame, tails, grid, bounds, scene, near)
        for j in near[:count]:
            m = tails[j]
            if math.isnan(value[j]):
                value[j] = born(chains, m, scene)
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
    detections: IntArray,
    grid: Grid,
    least: FloatArray,
    scene: Scene,
) -> Edges:
    """Return the gain in evidence of each detection of a frame in a track that spans it, over none.

    Parameters
    ----------
    heads, tails : (tracks,) the last detection before the frame and the first after it, linked; −1: none
    detections, grid : of the frame
    least : (detections,) gains that matter
    """
    edges, n = (np.empty(64, np.int64), np.empty(64, np.int64), np.empty(64)), 0
    state, here, back = np.empty(STATE), np.empty(STATE), np.zeros(STATE)
    alone, near = np.empty(len(detections)), np.empty(len(detections), np.int64)
    most, skipped = most_shown(scene), gaps_missed(scene)
    now, frame = chains.rows[detections[0]].t, chains.rows[detections[0]].frame
    last, new, bounds = -np.inf, -np.inf, np.empty(1)
    for j in range(len(detections)):
        d = detections[j]
        value, left = begin(chains.rows[d], scene, state), ending(chains, d, scene)
        alone[j] = max(0.0, value + left)
        last = max(last, chains.rows[d].gain + left - alone[j] - least[j])
        new = max(new, value - alone[j] - least[j])
    for i in range(len(heads)):
        k, m = heads[i], tails[i]
        if k >= 0:
            without = state_after(chains, k, scene)
            bounds[0] = np.inf if m >= 0 else head_worth(chains, k, scene) + most + last
            one = chains.rows[k]
            count = near_detections(
                chains, chains.state[k], one.t, one.frame, detections, grid, bounds, scene, near
            )
        else:
            # As far from the tail as a new person may have walked.
            without, later = born(chains, m, scene), chains.rows[m]
            dt = later.t - now
            bounds[0] = new + most_offered(later, without, most, scene)
            bounds[0] += missed(later.frame - frame - 1, scene)
            back[0], back[1], back[4] = later.x, later.y, later.variance
            back[4] += dt * dt * scene.speed_variance + scene.density * dt**3 / 3.0
            count = near_detections(
                chains, back, math.nextafter(now, -math.inf), frame - 1, detections, grid, bounds, scene, near
            )
        for j in near[:count]:
            d = detections[j]
            if k < 0:
                gain = begin(chains.rows[d], scene, here)
                off_x, off_y = chains.rows[m].x - here[0], chains.rows[m].y - here[1]
                if not is_within(off_x, off_y, chains.rows[m].t - now, here, chains.rows[m].variance, scene):
                    continue
                bound = gain - alone[j] + most_offered(chains.rows[m], without, most, scene)
                if bound + most_dense(chains.rows[d], here, chains.rows[m], skipped, scene) <= least[j]:
                    continue
            else:
                if m < 0:
                    bound = head_worth(chains, k, scene) + most
                    bound += chains.rows[d].gain + ending(chains, d, scene) - alone[j]
                    bound += most_dense(chains.rows[k], chains.state[k], chains.rows[d], skipped, scene)
                    if bound <= least[j]:
                        continue
                gain = chains.rows[k].total + follow(chains, chains.state[k], k, d, scene, here)
            if m >= 0:
                dt = chains.rows[m].t - now
                off_x = chains.rows[m].x - here[0] - dt * here[2]
                off_y = chains.rows[m].y - here[1] - dt * here[3]
                if not is_within(off_x, off_y, dt, here, chains.rows[m].variance, scene):
                    continue
                gain += follow(chains, here, d, m, scene, state) + run_on(chains, state, m, scene)
            else:
                gain += ending(chains, d, scene)
            gain -= max(0.0, without) + alone[j]
            if gain > least[j]:
                edges = with_edge(edges, n, i, j, gain)
                n += 1
    return edges[0][:n].copy(), edges[1][:n].copy(), edges[2][:n].copy()


@allocating
def raise_least(edges: Edges, complete: NDArray[np.bool_], worthless: float, least: FloatArray) -> None:
    """Raise the gains (columns,) that matter, given all candidates of some rows (rows,).

    Where a row has a candidate for a column, and each other candidate of the row is worth less by some
    amount, no candidate of the column that is worth less than that amount is in the best match. It is left
    out if it is also worth less than the column's best candidate and ``worthless``.
    """
    rows, columns, gains = edges
    best, second = np.zeros(len(complete)), np.zeros(len(complete))
    for e in range(len(rows)):
        i = rows[e]
        second[i] = max(second[i], min(best[i], gains[e]))
        best[i] = max(best[i], gains[e])
    for e in range(len(rows)):
        i, j = rows[e], columns[e]
        if not complete[i]:
            continue
        other = second[i] if gains[e] == best[i] else best[i]
        least[j] = max(least[j], min(gains[e] - other, gains[e] + worthless))


@compiled
def keep_best(best: FloatArray, gain: float) -> None:
    """Keep the two greatest gains."""
    best[1] = max(best[1], min(best[0], gain))
    best[0] = max(best[0], gain)


@allocating
def certain_pairs(edges: Edges, partner: IntArray, columns_taken: int) -> IntArray:
    """Fill the column of each row (rows,) where it is certain, else −1; return the remaining candidates.

    A pair is certain if it is worth as much as the best others of its row and of its column together.
    """
    rows, columns, gains = edges
    partner[:] = -1
    taken = np.zeros(columns_taken, np.bool_)
    left, n = np.empty(len(rows), np.int64), 0
    for e in range(len(rows)):
        if gains[e] > 0.0:
            left[n] = e
            n += 1
    of_row, of_column = np.empty((len(partner), 2)), np.empty((columns_taken, 2))
    found = True
    while found and n:
        found = False
        for e in left[:n]:
            of_row[rows[e]], of_column[columns[e]] = 0.0, 0.0
        for e in left[:n]:
            keep_best(of_row[rows[e]], gains[e])
            keep_best(of_column[columns[e]], gains[e])
        for e in left[:n]:
            i, j, gain = rows[e], columns[e], gains[e]
            is_best = gain == of_row[i, 0] and gain == of_column[j, 0]
            is_certain = is_best and gain >= of_row[i, 1] + of_column[j, 1]
            if is_certain and partner[i] < 0 and not taken[j]:
                partner[i], taken[j], found = j, True, True
        kept = 0
        for e in left[:n]:
            if partner[rows[e]] < 0 and not taken[columns[e]]:
                left[kept] = e
                kept += 1
        n = kept
    return left[:n].copy()


@compiled
def root_of(parent: IntArray, node: int) -> int:
    """Return the root of a node's component, and shorten the way there."""
    while parent[node] != node:
        parent[node] = parent[parent[node]]
        node = parent[node]
    return node


@allocating
def easy_components(edges: Edges, left: IntArray, partner: IntArray, columns_taken: int) -> IntArray:
    """Fill the partners where each row of a connected component has its best column to itself.

    ``left``: places of the candidates that count; those of the other components are returned
    """
    rows, columns, gains = edges
    n = len(partner)
    parent, best, owner = np.arange(n + columns_taken), np.full(n, -1), np.full(columns_taken, -1)
    for e in left:
        i, j = rows[e], columns[e]
        parent[root_of(parent, i)] = root_of(parent, n + j)
        if best[i] < 0 or gains[e] > gains[best[i]]:
            best[i] = e
    hard = np.zeros(n + columns_taken, np.bool_)
    for i in range(n):
        if best[i] >= 0:
            j = columns[best[i]]
            if owner[j] >= 0:
                hard[root_of(parent, i)] = True
            owner[j] = i
    kept, count = np.empty(len(left), np.int64), 0
    for e in left:
        if hard[root_of(parent, rows[e])]:
            kept[count] = e
            count += 1
        else:
            partner[rows[e]] = columns[best[rows[e]]]
    return kept[:count].copy()


def match(edges: Edges, shape: tuple[int, int]) -> IntArray:
    """Return the column (rows,) of each row, or −1: the pairs whose gains are greatest in sum, each above 0.

    ``shape``: number of rows and columns
    """
    partner = np.empty(shape[0], np.int64)
    left = easy_components(edges, certain_pairs(edges, partner, shape[1]), partner, shape[1])
    if not len(left):
        return partner
    rows, columns, gains = (values[left] for values in edges)
    row, i = np.unique(rows, return_inverse=True)
    column, j = np.unique(columns, return_inverse=True)
    # A dummy column for each row, for no match.
    none, size = np.arange(len(row)), (len(row), len(column) + len(row))
    worth = np.concatenate([1.0 + gains, np.ones(len(row))])
    links = sparse.csr_array((worth, (np.append(i, none), np.append(j, len(column) + none))), shape=size)
    one, other = csgraph.min_weight_full_bipartite_matching(links, maximize=True)
    some = other < len(column)
    partner[row[one[some]]] = column[other[some]]
    return partner


@allocating
def probabilities_of_links(edges: Edges, partner: IntArray, probability: FloatArray) -> None:
    """Fill the probability of each row's link to its column among all candidates of both, or no link.

    Parameters
    ----------
    edges : as of `gains_of_links`
    partner : (heads,) the column of each head's tail; −1: it has none
    probability : (tails,) is set where there is a link
    """
    rows, columns, gains = edges
    of_row, of_column = np.full(len(partner), np.nan), np.full(len(probability), np.nan)
    total = np.zeros(len(partner))
    linked = np.full(len(probability), -1)
    for e in range(len(rows)):
        if partner[rows[e]] == columns[e]:
            of_row[rows[e]] = of_column[columns[e]] = gains[e]
            linked[columns[e]] = rows[e]
            total[rows[e]] = 1.0 + math.exp(min(-gains[e], 50.0))
    for e in range(len(rows)):
        i, j, gain = rows[e], columns[e], gains[e]
        if partner[i] == j:
            continue
        if partner[i] >= 0:
            total[i] += math.exp(min(gain - of_row[i], 50.0))
        if linked[j] >= 0:
            total[linked[j]] += math.exp(min(gain - of_column[j], 50.0))
    for i in range(len(partner)):
        if partner[i] >= 0:
            probability[partner[i]] = 1.0 / total[i]


@compiled
def window(chains: Chains, first: int, scene: Scene) -> tuple[int, int]:
    """First detection within the longest gap of a detection, and the first detection behind those."""
    now = chains.rows[first].t
    begin, behind = 0, first
    while begin < behind:
        middle = (begin + behind) // 2
        if chains.rows[middle].t < now - scene.longest_gap:
            begin = middle + 1
        else:
            behind = middle
    end, behind = first, len(chains.rows)
    while end < behind:
        middle = (end + behind) // 2
        if chains.rows[middle].t <= now + scene.longest_gap:
            end = middle + 1
        else:
            behind = middle
    return begin, end


@allocating
def ends_at(chains: Chains, begin: int, first: int, end: int) -> tuple[IntArray, IntArray]:
    """Return heads from ``begin`` on and tails up to ``end`` of the tracks that are cut before ``first``."""
    heads, tails, n, m = np.empty(first - begin, np.int64), np.empty(end - first, np.int64), 0, 0
    for k in range(begin, first):
        after = chains.rows[k].following
        if after < 0 or after >= first:
            heads[n] = k
            n += 1
    for k in range(first, end):
        if chains.rows[k].preceding < first:
            tails[m] = k
            m += 1
    return heads[:n].copy(), tails[:m].copy()


@allocating
def spanning(
    chains: Chains, begin: int, first: int, end: int, last: int
) -> tuple[IntArray, IntArray, IntArray]:
    """Return head and tail (−1: none) of each track around the frame from ``first`` to ``end``, and its key.

    The key is the head, or the tail behind all detections.
    """
    heads, tails, n = np.empty(last - begin, np.int64), np.empty(last - begin, np.int64), 0
    for k in range(begin, last):
        one = chains.rows[k]
        after = one.following
        if k < first and (after < 0 or after >= first):
            heads[n], tails[n] = k, chains.rows[after].following if first <= after < end else after
        elif first <= k < end and one.preceding < 0 and after >= 0:
            heads[n], tails[n] = -1, after
        elif k >= end and one.preceding < 0:
            heads[n], tails[n] = -1, k
        else:
            continue
        n += 1
    heads, tails = heads[:n].copy(), tails[:n].copy()
    return heads, tails, np.where(heads >= 0, heads, tails + len(chains.rows))


@compiled
def link(
    chains: Chains, heads: IntArray, tails: IntArray, partner: IntArray, scene: Scene, move: int
) -> bool:
    """Link heads to the tails at the places ``partner`` (heads,), −1: to none; return whether one changed."""
    changed = False
    for i in range(len(heads)):
        old, new = chains.rows[heads[i]].following, tails[partner[i]] if partner[i] >= 0 else -1
        if old != new:
            changed = True
            chains.rows[heads[i]].following = new
            change_after(chains, heads[i], scene, move)
            if old >= 0:
                chains.rows[old].preceding = -1
                chains.rows[old].changed_after = move
    for i in range(len(heads)):
        new = chains.rows[heads[i]].following
        if new >= 0 and chains.rows[new].preceding != heads[i]:
            chains.rows[new].preceding = heads[i]
            chains.rows[new].changed_after = move
    return changed


@compiled
def bridge(chains: Chains, heads: IntArray, tails: IntArray, first: int, end: int) -> None:
    """Take the detections from ``first`` to ``end`` out of the tracks around them."""
    for d in range(first, end):
        chains.rows[d].following = chains.rows[d].preceding = -1
    for i in range(len(heads)):
        if heads[i] >= 0:
            chains.rows[heads[i]].following = tails[i]
        if tails[i] >= 0:
            chains.rows[tails[i]].preceding = heads[i]


@compiled
def insert(
    chains: Chains,
    heads: IntArray,
    tails: IntArray,
    partner: IntArray,
    first: int,
    before: IntArray,
    scene: Scene,
    move: int,
) -> bool:
    """Put the detections from ``first`` on into the tracks at ``partner``; return whether a link changed.

    ``partner``: (tracks,) of `spanning`, the detection's place, −1: none
    ``before``: (detections, 2) the next detections and those before as they were
    """
    for i in range(len(heads)):
        if partner[i] >= 0:
            k, d, m = heads[i], first + partner[i], tails[i]
            chains.rows[d].preceding, chains.rows[d].following = k, m
            if k >= 0:
                chains.rows[k].following = d
            if m >= 0:
                chains.rows[m].preceding = d
    changed = False
    for place in range(len(before)):
        d = first + place
        one, after, head = chains.rows[d], before[place, 0], before[place, 1]
        if one.preceding != head:
            changed = True
            one.changed_after = move
            for k in (head, one.preceding):
                if k >= 0:
                    change_after(chains, k, scene, move)
        if one.following != after:
            changed = True
            change_after(chains, d, scene, move)
            for m in (after, one.following):
                if m >= 0:
                    chains.rows[m].changed_after = move
    return changed


@allocating
def changed_since(chains: Chains, heads: IntArray, tails: IntArray, since: int) -> NDArray[np.bool_]:
    """Return True where a head, its tail (−1: none) or a relevant link changed after move ``since``."""
    found = np.zeros(len(heads), np.bool_)
    for i in range(len(heads)):
        k, m = heads[i], tails[i]
        found[i] = (k >= 0 and chains.rows[k].changed_before > since) or (
            m >= 0 and chains.rows[m].changed_after > since
        )
    return found


@allocating
def carried(
    edges: Edges,
    keys: IntArray,
    columns: IntArray,
    stale_rows: NDArray[np.bool_],
    stale_columns: NDArray[np.bool_],
    place: IntArray,
) -> Edges:
    """Return the earlier candidates that are still valid, by their indices in ``keys`` and ``columns``.

    Columns become stale for which a stale row, or one with a candidate in a stale column, had a candidate:
    what that outbid may matter now. ``place``: −1 throughout, as long as there are keys
    """
    rows_before, columns_before, gains = edges
    rows, partners = np.empty(len(gains), np.int64), np.empty(len(gains), np.int64)
    for i in range(len(keys)):
        place[keys[i]] = i
    for e in range(len(gains)):
        rows[e] = place[rows_before[e]]
    for i in range(len(keys)):
        place[keys[i]] = -1
    for j in range(len(columns)):
        place[columns[j]] = j
    touched = np.zeros(len(keys), np.bool_)
    for e in range(len(gains)):
        partners[e] = place[columns_before[e]]
        if rows[e] >= 0 and (partners[e] < 0 or stale_columns[partners[e]]):
            touched[rows[e]] = True
    for e in range(len(gains)):
        if partners[e] >= 0 and (rows[e] < 0 or stale_rows[rows[e]] or touched[rows[e]]):
            stale_columns[partners[e]] = True
    for j in range(len(columns)):
        place[columns[j]] = -1
    n, kept = 0, gains.copy()
    for e in range(len(gains)):
        i, j = rows[e], partners[e]
        if i >= 0 and j >= 0 and not stale_rows[i] and not stale_columns[j]:
            rows[n], partners[n], kept[n] = i, j, gains[e]
            n += 1
    return rows[:n].copy(), partners[:n].copy(), kept[:n].copy()
