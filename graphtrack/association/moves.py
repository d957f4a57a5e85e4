"""Moves that better an explanation: tracks are cut and joined anew, a frame's detections matched anew."""

from __future__ import annotations

import numpy as np
from scipy.optimize import linear_sum_assignment

from graphtrack.association.chains import Chains, IntArray, Scene
from graphtrack.association.kernels import (
    gains_of_detections,
    gains_of_links,
    only_pairs,
    probabilities_of_links,
    refresh,
    remember_rest,
    roots,
)
from graphtrack.geometry.angles import FloatArray


class Moves:
    """Chains of detections, in the order of time, and what changes them.

    Attributes
    ----------
    chains : the tracks
    packed : the scene's parameters
    link_p : (n,) how probable the link to the one before was, among those that either could have had
    """

    def __init__(self, chains: Chains, packed: Scene) -> None:
        self.chains, self.packed = chains, packed
        self.link_p = np.ones(len(chains.t))

    def move(self, first: int, end: int) -> bool:
        """Both moves at the frame of the detections ``first`` up to ``end``; whether a link changed."""
        cut = self._cut(first)
        changed = self._frame(first, end) or cut
        refresh(self.chains, first, end, self.packed)
        return changed

    def filter_from(self, first: int) -> None:
        """Filter all detections from ``first`` on along their chains."""
        refresh(self.chains, first, len(self.chains.t), self.packed)
        remember_rest(self.chains, self.packed)

    def _window(self, first: int) -> tuple[int, int]:
        t, gap = self.chains.t, self.packed.longest_gap
        return int(np.searchsorted(t, t[first] - gap)), int(np.searchsorted(t, t[first] + gap, "right"))

    def _ends(self, first: int) -> tuple[IntArray, IntArray]:
        """Heads and tails of the tracks that are cut before detection ``first``."""
        begin, end = self._window(first)
        following, preceding = self.chains.following[begin:first], self.chains.preceding[first:end]
        heads = begin + np.flatnonzero((following < 0) | (following >= first))
        return heads, first + np.flatnonzero(preceding < first)

    def _cut(self, first: int) -> bool:
        """Match what came before a frame to what comes from it on; whether a link changed."""
        chains = self.chains
        heads, tails = self._ends(first)
        if not len(heads) or not len(tails):
            return False
        gains = gains_of_links(chains, heads, tails, self.packed)
        before, after = chains.following[heads], np.full(len(heads), -1)
        i, j = match(gains)
        after[i] = tails[j]
        new = after != before
        if new.any():
            lost, found = before[new & (before >= 0)], new & (after >= 0)
            chains.preceding[lost] = -1
            chains.following[heads] = after
            chains.preceding[after[found]] = heads[found]
        self._note(gains, heads, tails)
        return bool(new.any())

    def _frame(self, first: int, end: int) -> bool:
        """Match the detections of a frame anew to the tracks that span it; whether a link changed."""
        heads, tails = self._spanning(first, end)
        if not len(heads):
            return False
        following, preceding = self.chains.following, self.chains.preceding
        before = following[first:end].copy(), preceding[first:end].copy()
        following[first:end] = preceding[first:end] = -1
        has_head, has_tail = heads >= 0, tails >= 0
        following[heads[has_head]], preceding[tails[has_tail]] = tails[has_head], heads[has_tail]
        detections = np.arange(first, end)
        i, j = match(gains_of_detections(self.chains, heads, tails, detections, self.packed))
        head, tail, own = heads[i], tails[i], detections[j]
        preceding[own], following[own] = head, tail
        has_head, has_tail = head >= 0, tail >= 0
        following[head[has_head]], preceding[tail[has_tail]] = own[has_head], own[has_tail]
        return bool((following[first:end] != before[0]).any() or (preceding[first:end] != before[1]).any())

    def _spanning(self, first: int, end: int) -> tuple[IntArray, IntArray]:
        """Head and tail of each track around a frame, without its detections; −1: none."""
        heads, _ = self._ends(first)
        _, last = self._window(first)
        following = self.chains.following
        tails = following[heads]
        inside = (tails >= 0) & (tails < end)
        tails = np.where(inside, following[np.where(inside, tails, 0)], tails)
        before = self.chains.preceding[end:last]
        starts = end + np.flatnonzero(before < 0)
        # Tracks that begin in the frame go on after it.
        own = np.arange(first, end)
        begun = following[own][(self.chains.preceding[own] < 0) & (following[own] >= 0)]
        only_tails = np.concatenate([starts, begun])
        return (
            np.concatenate([heads, np.full(len(only_tails), -1)]),
            np.concatenate([tails, only_tails]),
        )

    def _note(self, gains: FloatArray, heads: IntArray, tails: IntArray) -> None:
        """Keep the probability of each link among those that either end could have had, or none."""
        place = np.full(len(self.chains.t) + 1, -1)
        place[tails] = np.arange(len(tails))
        sure = self.link_p[tails]
        probabilities_of_links(gains, place[self.chains.following[heads]], sure)
        self.link_p[tails] = sure

    def roots(self) -> tuple[IntArray, FloatArray]:
        """(n,) where the track of each detection begins, and at each beginning what the track is worth.

        That is the log of how much more probable it is than false detections; −inf where none begins.
        """
        root, value = np.empty(len(self.chains.t), np.int64), np.empty(len(self.chains.t))
        roots(self.chains, self.packed, root, value)
        return root, value


def match(gains: FloatArray) -> tuple[IntArray, IntArray]:
    """Rows and columns of the pairs whose gains are greatest in sum, each once, and each above 0."""
    rows, columns = np.empty(gains.shape[0] + 1, np.int64), np.empty(gains.shape[1] + 1, np.int64)
    alone = only_pairs(gains, rows, columns)
    i, j = rows[alone:], columns[alone:]
    i, j = i[i >= 0], j[j >= 0]
    if not len(i):
        return rows[:alone], columns[:alone]
    inner = np.maximum(gains[i[:, None], j], 0.0)
    row, column = linear_sum_assignment(inner, maximize=True)
    kept = inner[row, column] > 0.0
    return (
        np.concatenate([rows[:alone], i[row[kept]]]),
        np.concatenate([columns[:alone], j[column[kept]]]),
    )
