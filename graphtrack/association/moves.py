"""Moves that match cut tracks, or the detections of a frame, again; each maximises its block of the evidence.

A repeated move computes only the candidates of tracks that have changed since.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from graphtrack.association.candidates import Flags, gains_of_detections, gains_of_links
from graphtrack.association.likelihood import (
    Chains,
    IntArray,
    SceneRow,
    change_after,
    refresh,
    remember_rest,
    roots,
)
from graphtrack.association.matching import Edges, match
from graphtrack.geometry.angles import FloatArray
from graphtrack.kernels.compilation import allocating, compiled, processors
from graphtrack.tracks.time import TIME_TOLERANCE

WORTHLESS = -10.0
"""Gain below that of the best for the same detection below which a candidate's probability is taken as 0."""


@allocating
def raise_least(edges: Edges, complete: Flags, worthless: float, least: FloatArray) -> None:
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


@allocating
def probabilities_of_links(edges: Edges, partner: IntArray, tails: IntArray, probability: FloatArray) -> None:
    """Set the probability of each row's link to its column among all candidates of both, or no link.

    Parameters
    ----------
    edges : as of `gains_of_links`
    partner : (heads,) the column of each head's tail; −1: it has none
    tails : (columns,) detections
    probability : (n,) of all detections, set at tails that are linked
    """
    rows, columns, gains = edges
    of_row, of_column = np.full(len(partner), np.nan), np.full(len(tails), np.nan)
    total = np.zeros(len(partner))
    linked = np.full(len(tails), -1)
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
            probability[tails[partner[i]]] = 1.0 / total[i]


@compiled
def window(chains: Chains, first: int, scene: SceneRow) -> tuple[int, int]:
    """First detection within the longest gap of a detection, and the first detection behind those."""
    now = chains.rows[first].t
    begin, behind = 0, first
    while begin < behind:
        middle = (begin + behind) // 2
        if chains.rows[middle].t < now - scene.longest_gap - TIME_TOLERANCE:
            begin = middle + 1
        else:
            behind = middle
    end, behind = first, len(chains.rows)
    while end < behind:
        middle = (end + behind) // 2
        if chains.rows[middle].t <= now + scene.longest_gap + TIME_TOLERANCE:
            end = middle + 1
        else:
            behind = middle
    return begin, end


@allocating
def ends_at(chains: Chains, first: int, scene: SceneRow) -> tuple[IntArray, IntArray]:
    """Return heads and tails within the longest gap of the tracks that are cut before ``first``."""
    begin, end = window(chains, first, scene)
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


class CutTracks(NamedTuple):
    """Tracks that are cut: the last detection before the cut, the first after it, and a lasting name."""

    heads: IntArray  # (n,) −1: none
    tails: IntArray  # (n,) −1: none
    keys: IntArray  # (n,) the head, or the tail behind all detections


@allocating
def spanning(chains: Chains, first: int, end: int, scene: SceneRow) -> CutTracks:
    """Return the tracks around the frame from ``first`` to ``end``."""
    begin, last = window(chains, first, scene)
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
    return CutTracks(heads, tails, np.where(heads >= 0, heads, tails + len(chains.rows)))


@compiled
def link(
    chains: Chains, heads: IntArray, tails: IntArray, partner: IntArray, scene: SceneRow, move: int
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
    scene: SceneRow,
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
def changed_since(chains: Chains, heads: IntArray, tails: IntArray, since: int) -> Flags:
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
    stale_rows: Flags,
    stale_columns: Flags,
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


@dataclass(frozen=True, eq=False)
class _Visit:
    """Candidates of a cut or of a frame, by the keys of tracks and by detections, after a move.

    ``keys`` and ``columns`` are all tracks and detections, also those without a candidate.
    """

    move: int
    edges: Edges
    keys: IntArray
    columns: IntArray


_NO_EDGES: Edges = np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros(0)
_RECENT = 2  # frames before the current frame: candidates of their heads are computed first
_ROWS_OF_A_THREAD = 128
"""Tracks whose candidates are computed by one thread at least: fewer take less time than the threads."""

Gains = Callable[..., Edges]


class Moves:
    """Chains of detections in the order of time, and the moves that change them.

    Attributes
    ----------
    chains : the tracks
    packed : the scene's parameters
    link_p : (n,) probability of the link to the previous detection, among the alternatives of both
    remembers : keep candidates, so that a repeated move computes only those that changed
    worthless : gain, below that of the best, at which a candidate's probability is taken as 0
    """

    def __init__(self, chains: Chains, packed: SceneRow, remembers: bool = False) -> None:
        self.chains, self.packed, self.remembers = chains, packed, remembers
        self.link_p, self.worthless = np.ones(len(chains.t)), WORTHLESS
        self._move = 1
        self._visits: dict[tuple[Gains, int], _Visit] = {}
        self._last_cut: _Visit | None = None
        self._place = np.full(2 * len(chains.t), -1)
        self._threads = ThreadPoolExecutor(processors()) if processors() > 1 else None

    def move(self, first: int, end: int) -> bool:
        """Make both moves at the frame of the detections ``first`` up to ``end``; True if a link changed."""
        cut = self._cut(first)
        changed = self._frame(first, end) or cut
        refresh(self.chains, first, end, self.packed, self._move)
        return changed

    def filter_from(self, first: int) -> None:
        """Filter all detections from ``first`` on along their chains."""
        self._visits.clear()
        self._last_cut = None
        refresh(self.chains, first, len(self.chains.t), self.packed, self._move)
        remember_rest(self.chains, self.packed, self._move)

    def _cut(self, first: int) -> bool:
        """Match the tracks before a frame to those from it on; return True if a link changed."""
        heads, tails = ends_at(self.chains, first, self.packed)
        edges = self._links(heads, tails, first)
        if edges is None:
            return False
        partner = match(edges, (len(heads), len(tails)))
        probabilities_of_links(edges, partner, tails, self.link_p)
        return link(self.chains, heads, tails, partner, self.packed, self._move)

    def _links(self, heads: IntArray, tails: IntArray, first: int) -> Edges | None:
        """Candidates of heads for tails across a cut; None: nothing changed since the last time."""
        if not len(heads) or not len(tails):
            return None
        chains, own = self.chains, self._visits.get((gains_of_links, first))
        # A link gains the same at every cut between its detections.
        visit = own or self._last_cut
        since = -1 if visit is None else visit.move
        none = np.full(max(len(heads), len(tails)), -1)
        fresh = (
            changed_since(chains, heads, none[: len(heads)], since),
            changed_since(chains, none[: len(tails)], tails, since),
        )
        if own is not None and not (fresh[0].any() or fresh[1].any()):
            return None
        if own is None and visit is not None:
            fresh[0][np.isin(heads, visit.keys, invert=True)] = True
            fresh[1][np.isin(tails, visit.columns, invert=True)] = True
        recent = (chains.following[heads] >= 0) | self._is_recent(heads, first)
        tracks = CutTracks(heads, none, heads)
        edges = self._candidates(gains_of_links, visit, tracks, tails, fresh, recent)
        if self.remembers:
            self._last_cut = self._remember(gains_of_links, first, edges, heads, tails)
        return edges

    def _frame(self, first: int, end: int) -> bool:
        """Match the detections of a frame again to the tracks that span it; return whether a link changed."""
        chains, visit = self.chains, self._visits.get((gains_of_detections, first))
        since = -1 if visit is None else visit.move
        tracks = spanning(chains, first, end, self.packed)
        heads, tails, _ = tracks
        fresh = changed_since(chains, heads, tails, since), np.full(end - first, since < 0)
        if not len(heads) or not (fresh[0].any() or fresh[1].any()):
            return False
        before = np.column_stack([chains.following[first:end], chains.preceding[first:end]])
        bridge(chains, heads, tails, first, end)
        recent = (heads >= 0) & ((tails >= 0) | self._is_recent(heads, first))
        detections = np.arange(first, end)
        edges = self._candidates(gains_of_detections, visit, tracks, detections, fresh, recent)
        if self.remembers:
            self._remember(gains_of_detections, first, edges, tracks.keys, detections)
        partner = match(edges, (len(heads), len(detections)))
        return insert(chains, heads, tails, partner, first, before, self.packed, self._move)

    def _remember(self, gains: Gains, first: int, edges: Edges, keys: IntArray, columns: IntArray) -> _Visit:
        """Keep the candidates of a cut or of a frame, by their indices in ``keys`` and ``columns``."""
        i, j, gain = edges
        visit = _Visit(self._move, (keys[i], columns[j], gain), keys, columns)
        self._visits[gains, first] = visit
        return visit

    def _is_recent(self, heads: IntArray, first: int) -> Flags:
        return np.asarray(self.chains.frame[heads] >= self.chains.frame[first] - _RECENT)

    def _candidates(
        self,
        gains: Gains,
        visit: _Visit | None,
        tracks: CutTracks,
        columns: IntArray,
        fresh: tuple[Flags, Flags],
        recent: Flags,
    ) -> Edges:
        """Candidates of tracks (rows) for detections (columns).

        Parameters
        ----------
        gains : `gains_of_links` or `gains_of_detections`
        visit : earlier candidates; None: there are none
        tracks : of the rows
        fresh : (rows,) and (columns,) that have changed since the visit
        recent : (rows,) whose candidates are computed first: candidates that they outbid are skipped
        """
        self._move += self.remembers
        edges = _NO_EDGES
        if visit is not None:
            edges = carried(visit.edges, tracks.keys, columns, *fresh, self._place)
        least = np.full(len(columns), self.worthless)
        has_new = bool(fresh[1].any())
        for group in (recent, ~recent):
            rows = np.flatnonzero(group if has_new else group & fresh[0])
            if len(rows):
                found = self._in_threads(gains, tracks, columns, fresh, rows, least)
                edges = joined([edges, *found])
            if group is recent:
                raise_least(edges, recent, self.worthless, least)
        return edges

    def _in_threads(
        self,
        gains: Gains,
        tracks: CutTracks,
        columns: IntArray,
        fresh: tuple[Flags, Flags],
        rows: IntArray,
        least: FloatArray,
    ) -> list[Edges]:
        """Candidates of some rows, in their order whatever the number of threads."""

        def some(rows: IntArray) -> Edges:
            return gains(self.chains, tracks.heads, tracks.tails, columns, fresh, rows, least, self.packed)

        parts = min(processors(), len(rows) // _ROWS_OF_A_THREAD)
        if self._threads is None or parts < 2:
            return [some(rows)]
        own, *further = np.array_split(rows, parts)
        calls = [self._threads.submit(some, part) for part in further]
        return [some(own), *(call.result() for call in calls)]

    def roots(self) -> tuple[IntArray, FloatArray]:
        """Return the first detection of each detection's track (n,), and at first detections its value.

        The value is the log evidence ratio over false detections; −inf elsewhere.
        """
        root, value = np.empty(len(self.chains.t), np.int64), np.empty(len(self.chains.t))
        roots(self.chains, self.packed, root, value)
        return root, value


def joined(pieces: Sequence[Edges]) -> Edges:
    """Return all candidates of several arrays of them."""
    rows, columns, gains = (np.concatenate(parts) for parts in zip(*pieces, strict=True))
    return rows, columns, gains
