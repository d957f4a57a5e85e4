"""Offline data association: block-wise maximisation of the evidence of a whole recording.

At each time all tracks are cut: heads (what came before) and tails (what comes after) are matched again, a
link being worth the evidence of the joined track over that of both alone. In each frame the detections are
matched again to the tracks that span it. Each match is the best of its block, so that the evidence only
rises; a few sweeps suffice.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from graphtrack.association.appearance import Looks, ScoreRatio, constancy, learn_appearance
from graphtrack.association.likelihood import (
    Chains,
    IntArray,
    Scene,
    chains_of,
    gains_of_detections,
    gains_of_links,
    learn_orientation,
    link_by,
    only_pairs,
    probabilities_of_links,
    refresh,
    remember_rest,
    roots,
)
from graphtrack.association.scene import (
    duplicate_density,
    first_guess,
    learn_duplicates,
    learn_scene,
    seen_from_within,
)
from graphtrack.geometry.angles import FloatArray
from graphtrack.packages import optimize
from graphtrack.tracks.detections import APPEARANCE, Detections
from graphtrack.tracks.scene import GivenScene, Known, SceneParameters, known_values


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
    row, column = optimize.linear_sum_assignment(inner, maximize=True)
    kept = inner[row, column] > 0.0
    return (
        np.concatenate([rows[:alone], i[row[kept]]]),
        np.concatenate([columns[:alone], j[column[kept]]]),
    )


SWEEPS = 6  # over the recording at most, for one set of parameters
ROUNDS = 4  # alternations of finding tracks and learning the scene's parameters from them
TRUST = 4.0  # log odds that a tracker's next detection is of the same person: it jumps at one in fifty
_JOINED_FRAMES = 16
"""Frames that the first sweep looks ahead: nothing is linked yet, and all that comes is a candidate."""


@dataclass(frozen=True, eq=False)
class Association:
    """Identities of a recording's detections."""

    identity: NDArray[np.int64]  # (n,) of each detection, from 0 in the order of first appearance; −1: false
    # (n,) that the detection is of the same person as the one before it in its track; 1 at first
    probability: FloatArray
    scene: SceneParameters  # the parameters that it was found with
    evidence: float  # log of how much more probable than that all detections are false


def associate_detections(
    detections: Detections,
    scene: GivenScene = None,
    progress: Callable[[int, int], None] = lambda done, total: None,
    *,
    start: SceneParameters | None = None,
    rounds: int = ROUNDS,
) -> Association:
    """Find the people of a recording.

    Parameters
    ----------
    scene : parameters that are known; the others are learned from the detections
    progress : called with sweeps done and sweeps in all
    start : parameters to begin with; None: a guess from how many detections there are
    rounds : times that people are found, with parameters learned from the time before
    """
    search = _Search(detections, known_values(scene), start)
    for k in range(rounds):
        if k:
            search.adopt(search.learned())
        search.join_generously()
        search.settle(progress, k * SWEEPS, rounds * SWEEPS)
    progress(rounds * SWEEPS, rounds * SWEEPS)
    return search.found(search.identities())


def repair_detections(
    detections: Detections, given: NDArray[np.int64], scene: GivenScene = None
) -> Association:
    """Keep a tracker's identities, but part those who were taken for one, and join who was taken for two.

    Parameters
    ----------
    given : (n,) identities from 0; −1: none
    scene : parameters that are known; the others are learned from the tracks

    Returns
    -------
    Association
        In which nothing is false: each detection keeps the identity that most of its track had, or gets a
        new one where another track has more of that.
    """
    search = _Search(detections, known_values(scene))
    search.begin_with(given)
    for _ in range(ROUNDS):
        search.adopt(search.learned())
        search.settle()
    root, _ = search.roots()
    return search.found(_renamed(root, given))


def _renamed(track: NDArray[np.int64], given: NDArray[np.int64]) -> NDArray[np.int64]:
    """Identities (n,) of tracks (n,): the given one that most of a track has, for who has most of it."""
    pairs, counts = np.unique(np.column_stack([track, given]), axis=0, return_counts=True)
    name: dict[int, int] = {}
    taken: set[int] = set()
    for place in np.argsort(-counts, kind="stable").tolist():
        one, identity = pairs[place].tolist()
        if identity >= 0 and one not in name and identity not in taken:
            name[one] = identity
            taken.add(identity)
    free = int(given.max()) + 1
    for one in np.unique(track).tolist():
        if one not in name:
            name[one], free = free, free + 1
    return np.array([name[one] for one in track.tolist()])


class _Search(Moves):
    """The explanation of a whole recording."""

    def __init__(self, detections: Detections, known: Known, start: SceneParameters | None = None) -> None:
        n = len(detections)
        self.detections, self._known = detections, known
        scene = replace(first_guess(detections) if start is None else start, **known)
        channels = detections.channels
        self._std = channels.get("position_std", np.full(n, np.nan))
        chains = chains_of(detections)
        super().__init__(chains, Scene(*scene.packed(detections.step_seconds)))
        _, self._first = np.unique(chains.frame, return_index=True)
        self._end = np.append(self._first[1:], n)
        self._duplicates, self._score = np.zeros(n), channels.get("score", np.full(n, np.nan))
        self._descriptors = channels.get(APPEARANCE, np.empty((n, 0)))
        self._looks = Looks()
        self._trust = 0.0
        self.adopt(scene)

    def begin_with(self, given: NDArray[np.int64]) -> None:
        """Start from the tracks of somebody's identities (n,), from 0, and trust them; −1: none."""
        link_by(self.chains, given)
        self.chains.rows["given"] = given
        self._trust = TRUST
        self.adopt(self.scene)

    def adopt(self, scene: SceneParameters) -> None:
        """Go on with other parameters, and with who is near whom as it is known by now."""
        self.scene = scene
        identity = self.identities()
        if (identity >= 0).any():
            detections = self.detections
            self._duplicates = duplicate_density(detections.step, detections.position, identity, scene)
        packed = Scene(*scene.packed(self.detections.step_seconds))
        self.packed = self._looks.in_scene(packed._replace(trust=self._trust))
        self.chains = self._looks.in_chains(self.chains, self._descriptors)
        self.chains.variance[:] = np.where(np.isnan(self._std), scene.position_std, self._std) ** 2
        births, deaths, clutter = seen_from_within(self.chains, identity)
        self.chains.rows["birth"], self.chains.rows["death"] = np.log(births), np.log(deaths)
        false = scene.clutter_density * clutter + self._duplicates
        self.chains.gain[:] = np.log(scene.detection_probability) - np.log(false)
        model, each = self._looks.model, 0.0
        if model is not None:
            each = constancy(self.chains, identity, model, self._descriptors)
        scores = ScoreRatio.learned(self._score, identity) if (identity >= 0).any() else ScoreRatio()
        self._looks = Looks(model, each, scores)
        self.chains.gain[:] += self._looks.gain(self._descriptors, self._score)
        self.filter_from(0)

    def learned(self) -> SceneParameters:
        """The parameters that the tracks of now speak for."""
        identity, seen = self.identities(), self.detections
        scene = learn_duplicates(seen.step, seen.position, identity, self.scene, self._known)
        if self._descriptors.shape[1]:
            self._looks = Looks(learn_appearance(self.chains, identity, self._descriptors))
        seconds = self.packed.frame_seconds
        scene = learn_orientation(self.chains, scene, seconds, self._known)
        return learn_scene(self.chains, identity, scene, self._std, seconds, self._known)

    def join_generously(self) -> None:
        """One sweep in which to come and to go costs nothing.

        Two detections alone are seldom worth a birth and a death, so that nobody would ever get a third; what
        is not worth them in the end is parted again by the sweeps that follow.
        """
        packed = self.packed
        gap = min(packed.longest_gap, _JOINED_FRAMES * packed.frame_seconds)
        self.packed = packed._replace(
            log_birth=np.log(self.scene.clutter_density), log_death=0.0, longest_gap=gap
        )
        self.filter_from(0)
        self.sweep()
        self.packed = packed
        self.filter_from(0)

    def settle(
        self, progress: Callable[[int, int], None] = lambda done, total: None, done: int = 0, total: int = 0
    ) -> None:
        """Sweep until nothing changes, or often enough; report the sweeps ``done`` before and since."""
        changed = None
        for sweep in range(SWEEPS):
            progress(done + sweep, total)
            changed = self.sweep(changed)
            if not len(changed):
                break

    def sweep(self, changed: FloatArray | None = None) -> FloatArray:
        """Every move once, from the first frame to the last; the times (s) of frames in which links changed.

        ``changed``: those of the sweep before, increasing: where nothing did, as far as a gap reaches,
        nothing will; None: all frames are looked at
        """
        remember_rest(self.chains, self.packed)
        frames = zip(self._first.tolist(), self._end.tolist(), strict=True)
        t, gap = self.chains.t, self.packed.longest_gap
        found: list[float] = []
        for first, end in frames:
            now = float(t[first])
            if changed is not None:
                near = np.searchsorted(changed, [now - gap, now + gap])
                if near[0] == near[1] and not (found and now - found[-1] <= gap):
                    continue
            if self.move(first, end):
                found.append(now)
        return np.array(found)

    # -- what came out ---------------------------------------------------------------------------------------

    def identities(self) -> NDArray[np.int64]:
        """(n,) number of each detection's track; −1: it is more probably of false ones."""
        root, value = self.roots()
        alive = value[root] > 0.0
        numbers = np.full(len(root), -1)
        roots = np.unique(root[alive])
        numbers[alive] = np.searchsorted(roots, root[alive])
        return numbers

    def found(self, identity: NDArray[np.int64]) -> Association:
        """The result, with the evidence of the tracks that are kept."""
        _, value = self.roots()
        probability = np.where(self.chains.preceding < 0, 1.0, self.link_p)
        return Association(identity, probability, self.scene, float(value[value > 0.0].sum()))
