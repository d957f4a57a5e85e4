"""The most probable explanation of a whole recording, by assigning anew at every cut and in every frame.

At each time all tracks are cut: what came before (heads) and what comes after (tails) are matched anew, a
link being worth the evidence of the joined track over that of both alone. In each frame its detections are
matched anew to the tracks that span it, everything else staying. Each is the best of its block, so that the
evidence only rises; a few sweeps over the recording suffice.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from graphtrack.association import duplicates, learning
from graphtrack.association.detections import Detections
from graphtrack.association.kernels import (
    Chains,
    IntArray,
    Scene,
    ending,
    gains_of_detections,
    gains_of_links,
    refresh,
)
from graphtrack.association.scene import SceneParameters
from graphtrack.geometry.angles import FloatArray

SWEEPS = 6
"""Over the recording at most, for one set of parameters."""

ROUNDS = 3
"""Times that the scene's parameters are learned from the tracks, which are found anew with them."""


@dataclass(frozen=True, eq=False)
class Association:
    """Who is who.

    Attributes
    ----------
    identity : (n,) of each detection, from 0 in the order of first appearance; −1: false
    probability : (n,) that the detection is of the same person as the one before it in its track; 1 at first
    scene : the parameters that it was found with
    evidence : log of how much more probable than that all detections are false
    """

    identity: NDArray[np.int64]
    probability: FloatArray
    scene: SceneParameters
    evidence: float


def associate_detections(
    detections: Detections,
    scene: SceneParameters | None = None,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> Association:
    """Find the people of a recording.

    Parameters
    ----------
    detections : of the whole recording
    scene : its parameters; None: they are learned from the detections
    progress : called with sweeps done and sweeps in all
    """
    search = _Search(detections, learning.first_guess(detections) if scene is None else scene)
    for k in range(ROUNDS):
        if k:
            search.adopt(search.learned() if scene is None else scene)
        for sweep in range(SWEEPS):
            progress(k * SWEEPS + sweep, ROUNDS * SWEEPS)
            if not search.sweep():
                break
    progress(ROUNDS * SWEEPS, ROUNDS * SWEEPS)
    identity = search.identities()
    return Association(identity, search.probabilities(), search.scene, search.evidence())


class _Search:
    """The chains of detections, and the moves that change them."""

    def __init__(self, detections: Detections, scene: SceneParameters) -> None:
        n = len(detections)
        self.detections = detections
        std = detections.channels.get("position_std")
        self._std = np.full(n, np.nan) if std is None else std
        nobody = np.full(n, -1)
        self.chains = Chains(
            detections.t,
            detections.frame - detections.frame[0],
            np.ascontiguousarray(detections.position),
            np.empty(n),
            np.empty(n),
            nobody.copy(),
            nobody.copy(),
            np.zeros((n, 7)),
            np.zeros(n),
            np.zeros(n),
        )
        _, self._first = np.unique(self.chains.frame, return_index=True)
        self._end = np.append(self._first[1:], n)
        self._probability, self._duplicates = np.ones(n), np.zeros(n)
        self._packed = Scene(*scene.packed(detections.frame_seconds))
        self.adopt(scene)

    def adopt(self, scene: SceneParameters) -> None:
        """Go on with other parameters, and with who is near whom as it is known by now."""
        self.scene = scene
        identity = self.identities()
        if (identity >= 0).any():
            detections = self.detections
            self._duplicates = duplicates.density(detections.frame, detections.position, identity, scene)
        self._packed = Scene(*scene.packed(self.detections.frame_seconds))
        self.chains.variance[:] = np.where(np.isnan(self._std), scene.position_std, self._std) ** 2
        false = scene.clutter_density + self._duplicates
        self.chains.gain[:] = np.log(scene.detection_probability) - np.log(false)
        refresh(self.chains, 0, len(self.chains.t), self._packed)

    def learned(self) -> SceneParameters:
        """The parameters that the tracks of now speak for."""
        identity, seen = self.identities(), self.detections
        rate, spread = duplicates.learned(seen.frame, seen.position, identity, self.scene)
        scene = replace(self.scene, duplicate_rate=rate, duplicate_spread=spread)
        return learning.learned(self.chains, identity, scene, self._std)

    def sweep(self) -> int:
        """Every move once, from the first frame to the last; the number of links that changed."""
        changed = 0
        for first, end in zip(self._first.tolist(), self._end.tolist(), strict=True):
            changed += self._cut(first)
            changed += self._frame(first, end)
            refresh(self.chains, first, end, self._packed)
        return changed

    def _window(self, first: int) -> tuple[int, int]:
        t, gap = self.chains.t, self._packed.longest_gap
        return int(np.searchsorted(t, t[first] - gap)), int(np.searchsorted(t, t[first] + gap, "right"))

    def _ends(self, first: int) -> tuple[IntArray, IntArray]:
        """Heads and tails of the tracks that are cut before detection ``first``."""
        begin, end = self._window(first)
        following, preceding = self.chains.following[begin:first], self.chains.preceding[first:end]
        heads = begin + np.flatnonzero((following < 0) | (following >= first))
        return heads, first + np.flatnonzero(preceding < first)

    def _cut(self, first: int) -> int:
        chains = self.chains
        heads, tails = self._ends(first)
        if not len(heads) or not len(tails):
            return 0
        gains = gains_of_links(chains, heads, tails, self._packed)
        links = {(int(heads[i]), int(tails[j])) for i, j in match(gains)}
        inside = {*tails.tolist()}
        before = {(k, m) for k in heads.tolist() if (m := int(chains.following[k])) in inside}
        if links != before:
            for k, m in before:
                chains.following[k] = chains.preceding[m] = -1
            for k, m in links:
                self._link(k, m)
        self._note(gains, heads, tails)
        return len(links ^ before)

    def _frame(self, first: int, end: int) -> int:
        """Match the detections of a frame anew to the tracks that span it."""
        chains = self.chains
        before = self._links_of(first, end)
        heads, tails = self._spanning(first, end)
        if not len(heads):
            return 0
        for k in range(first, end):
            chains.following[k] = chains.preceding[k] = -1
        for k, m in zip(heads.tolist(), tails.tolist(), strict=True):
            if k >= 0:
                chains.following[k] = m
            if m >= 0:
                chains.preceding[m] = k
        found = np.arange(first, end)
        for i, j in match(gains_of_detections(chains, heads, tails, found, self._packed)):
            k, m, d = int(heads[i]), int(tails[i]), int(found[j])
            if k >= 0:
                self._link(k, d)
            if m >= 0:
                self._link(d, m)
        return len(before ^ self._links_of(first, end))

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

    def _links_of(self, first: int, end: int) -> set[tuple[int, int]]:
        chains = self.chains
        own = range(first, end)
        back = {(int(chains.preceding[k]), k) for k in own if chains.preceding[k] >= 0}
        return back | {(k, int(chains.following[k])) for k in own if chains.following[k] >= 0}

    def _link(self, k: int, m: int) -> None:
        self.chains.following[k], self.chains.preceding[m] = m, k

    def _note(self, gains: FloatArray, heads: IntArray, tails: IntArray) -> None:
        """How probable each link is among those that either end could have had, or none."""
        place = {m: j for j, m in enumerate(tails.tolist())}
        for i, k in enumerate(heads.tolist()):
            j = place.get(int(self.chains.following[k]))
            if j is not None:
                rivals = np.concatenate([gains[i], np.delete(gains[:, j], i), [0.0]])
                rivals = rivals[rivals > gains[i, j] - 50.0] - gains[i, j]
                self._probability[tails[j]] = 1.0 / np.exp(np.minimum(rivals, 50.0)).sum()

    # -- what came out ---------------------------------------------------------------------------------------

    def identities(self) -> NDArray[np.int64]:
        """(n,) number of each detection's track; −1: it is more probably of false ones."""
        preceding, following = self.chains.preceding, self.chains.following
        root = np.arange(len(preceding))
        for k in range(len(root)):
            if preceding[k] >= 0:
                root[k] = root[preceding[k]]
        value = np.full(len(root), -np.inf)
        for k in np.flatnonzero(following < 0).tolist():
            value[root[k]] = self.chains.total[k] + ending(self.chains, k, self._packed)
        alive = value[root] > 0.0
        numbers = np.full(len(root), -1)
        roots = np.unique(root[alive])
        numbers[alive] = np.searchsorted(roots, root[alive])
        return numbers

    def probabilities(self) -> FloatArray:
        """(n,) as in `Association`."""
        return np.where(self.chains.preceding < 0, 1.0, self._probability)

    def evidence(self) -> float:
        """The sum over the tracks that are kept."""
        ends = np.flatnonzero(self.chains.following < 0).tolist()
        values = [self.chains.total[k] + ending(self.chains, k, self._packed) for k in ends]
        return float(sum(value for value in values if value > 0.0))


def match(gains: FloatArray) -> list[tuple[int, int]]:
    """The pairs whose gains are greatest in sum, each row and column once; none whose gain is not above 0."""
    good = gains > 0.0
    rows, columns = np.flatnonzero(good.any(axis=1)), np.flatnonzero(good.any(axis=0))
    if not len(rows):
        return []
    inner = good[np.ix_(rows, columns)]
    if len(rows) == len(columns) == inner.sum():
        i, j = np.nonzero(inner)
    else:
        i, j = linear_sum_assignment(np.maximum(gains[np.ix_(rows, columns)], 0.0), maximize=True)
        kept = inner[i, j]
        i, j = i[kept], j[kept]
    return list(zip(rows[i].tolist(), columns[j].tolist(), strict=True))
