"""Sparse assignment: the match of rows and columns whose gains are greatest in sum, compiled."""

from __future__ import annotations

import math
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from graphtrack.geometry.angles import FloatArray
from graphtrack.kernels.compilation import allocating

IntArray = NDArray[np.int64]

Edges: TypeAlias = tuple[IntArray, IntArray, FloatArray]
"""Rows (e,), columns (e,) and gains (e,) of candidates."""


@allocating
def by_row(edges: Edges, n: int) -> tuple[IntArray, IntArray, FloatArray]:
    """Return the first candidate of each row (n + 1,), and columns and gains of those above 0, row by row."""
    rows, columns, gains = edges
    start = np.zeros(n + 1, np.int64)
    for e in range(len(rows)):
        if gains[e] > 0.0:
            start[rows[e] + 1] += 1
    start = np.cumsum(start)
    place, column, gain = start[:-1].copy(), np.empty(start[n], np.int64), np.empty(start[n])
    for e in range(len(rows)):
        if gains[e] > 0.0:
            k = place[rows[e]]
            column[k], gain[k], place[rows[e]] = columns[e], gains[e], k + 1
    return start, column, gain


@allocating
def match(edges: Edges, shape: tuple[int, int]) -> IntArray:
    """Return the column (rows,) of each row, or −1: the pairs whose gains are greatest in sum, each above 0.

    Rows are added one by one, each along the shortest augmenting path (Jonker and Volgenant 1987); a row may
    also lose its column. Columns have prices, and a row's profit is the gain less the price.

    ``shape``: number of rows and columns
    """
    n, m = shape
    start, column, gain = by_row(edges, n)
    partner, owner, own = np.full(n, -1), np.full(m, -1), np.zeros(n)
    price, distance, is_final = np.zeros(m), np.full(m, np.inf), np.zeros(m, np.bool_)
    via, gain_via, reached = np.empty(m, np.int64), np.empty(m), np.empty(m, np.int64)
    for root in range(n):
        profit = 0.0
        for k in range(start[root], start[root + 1]):
            profit = max(profit, gain[k] - price[column[k]])
        i, low, end, count = root, 0.0, math.inf, 0
        loser, last = root, -1
        while True:
            if low + profit < end:
                end, loser = low + profit, i
            for k in range(start[i], start[i + 1]):
                j = column[k]
                loss = low + profit - gain[k] + price[j]
                if not is_final[j] and loss < distance[j]:
                    if distance[j] == math.inf:
                        reached[count] = j
                        count += 1
                    distance[j], via[j], gain_via[j] = loss, i, gain[k]
            last, low = -1, end
            for j in reached[:count]:
                if not is_final[j] and distance[j] < low:
                    last, low = j, distance[j]
            if last < 0 or owner[last] < 0:
                break
            is_final[last], i = True, owner[last]
            profit = own[i] - price[last]
        for j in reached[:count]:
            if is_final[j]:
                price[j] += low - distance[j]
            distance[j], is_final[j] = math.inf, False
        if last < 0:
            last, partner[loser] = partner[loser], -1
        while last >= 0:
            i, taken = via[last], last
            last, partner[i], owner[taken], own[i] = partner[i], taken, i, gain_via[taken]
    return partner
