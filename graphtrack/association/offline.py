"""Offline data association: block-wise maximisation of the evidence of a whole recording.

At each time all tracks are cut: heads (what came before) and tails (what comes after) are matched again, a
link being worth the evidence of the joined track over that of both alone. In each frame the detections are
matched again to the tracks that span it. Each match maximises its block, so that the evidence never
decreases; a few sweeps suffice.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from graphtrack.association.appearance import AppearanceEvidence, ScoreRatio, constancy, learn_appearance
from graphtrack.association.candidates import (
    WORTHLESS,
    Edges,
    bridge,
    carried,
    changed_since,
    ends_at,
    gains_of_detections,
    gains_of_links,
    grid_of,
    insert,
    link,
    match,
    probabilities_of_links,
    raise_least,
    spanning,
    window,
)
from graphtrack.association.likelihood import (
    Chains,
    IntArray,
    Scene,
    chains_of,
    learn_orientation,
    link_by,
    refresh,
    remember_rest,
    roots,
)
from graphtrack.association.scene import (
    duplicate_density,
    first_guess,
    learn_duplicates,
    learn_scene,
    own_rates,
)
from graphtrack.geometry.angles import FloatArray
from graphtrack.tracks.detections import APPEARANCE, Detections
from graphtrack.tracks.scene import GivenScene, Known, SceneParameters, known_values


@dataclass(frozen=True, eq=False)
class _Visit:
    """Candidates of a cut or of a frame, by the keys of tracks and by detections, after a move."""

    move: int
    edges: Edges


_RECENT = 2  # frames before the current frame: candidates of their heads are computed first


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

    def __init__(self, chains: Chains, packed: Scene, remembers: bool = False) -> None:
        self.chains, self.packed, self.remembers = chains, packed, remembers
        self.link_p, self.worthless = np.ones(len(chains.t)), WORTHLESS
        self._move = 1
        self._visits: dict[tuple[str, int], _Visit] = {}
        self._place = np.full(2 * len(chains.t), -1)

    def move(self, first: int, end: int) -> bool:
        """Make both moves at the frame of the detections ``first`` up to ``end``; True if a link changed."""
        begin, last = window(self.chains, first, self.packed)
        cut = self._cut(begin, first, last)
        changed = self._frame(begin, first, end, last) or cut
        refresh(self.chains, first, end, self.packed, self._move)
        return changed

    def filter_from(self, first: int) -> None:
        """Filter all detections from ``first`` on along their chains."""
        self._visits.clear()
        refresh(self.chains, first, len(self.chains.t), self.packed, self._move)
        remember_rest(self.chains, self.packed, self._move)

    def _cut(self, begin: int, first: int, last: int) -> bool:
        """Match the tracks before a frame to those from it on; return True if a link changed."""
        heads, tails = ends_at(self.chains, begin, first, last)
        if not len(heads) or not len(tails):
            return False
        edges = self._links(heads, tails, first)
        if edges is None:
            return False
        partner = match(edges, (len(heads), len(tails)))
        sure = self.link_p[tails]
        probabilities_of_links(edges, partner, sure)
        self.link_p[tails] = sure
        return link(self.chains, heads, tails, partner, self.packed, self._move)

    def _links(self, heads: IntArray, tails: IntArray, first: int) -> Edges | None:
        """Candidates of heads for tails across a cut; None: nothing changed since the last time."""
        chains, scene, base = self.chains, self.packed, int(self.chains.frame[first])

        def gains(rows: IntArray, columns: IntArray, least: FloatArray) -> Edges:
            some = tails[columns]
            return gains_of_links(chains, heads[rows], some, grid_of(chains, some, base), least, scene)

        place, none = ("cut", first), np.full(max(len(heads), len(tails)), -1)
        fresh = self._fresh(place, heads, none[: len(heads)]), self._fresh(place, none[: len(tails)], tails)
        if not fresh[0].any() and not fresh[1].any():
            return None
        recent = (chains.following[heads] >= 0) | (chains.frame[heads] >= base - _RECENT)
        return self._candidates(place, heads, tails, fresh, recent, gains)

    def _frame(self, begin: int, first: int, end: int, last: int) -> bool:
        """Match the detections of a frame again to the tracks that span it; return whether a link changed."""
        chains, scene, base = self.chains, self.packed, int(self.chains.frame[first])
        heads, tails, keys = spanning(chains, begin, first, end, last)
        if not len(heads):
            return False
        place, detections = ("frame", first), np.arange(first, end)
        fresh = self._fresh(place, heads, tails), np.full(len(detections), place not in self._visits)
        if not fresh[0].any() and not fresh[1].any():
            return False
        before = np.column_stack([chains.following[first:end], chains.preceding[first:end]])
        bridge(chains, heads, tails, first, end)

        def gains(rows: IntArray, columns: IntArray, least: FloatArray) -> Edges:
            some = detections[columns]
            grid = grid_of(chains, some, base)
            return gains_of_detections(chains, heads[rows], tails[rows], some, grid, least, scene)

        recent = (heads >= 0) & ((tails >= 0) | (chains.frame[heads] >= base - _RECENT))
        edges = self._candidates(place, keys, detections, fresh, recent, gains)
        partner = match(edges, (len(heads), len(detections)))
        return insert(chains, heads, tails, partner, first, before, scene, self._move)

    def _fresh(self, place: tuple[str, int], heads: IntArray, tails: IntArray) -> NDArray[np.bool_]:
        """Return whether tracks (heads, tails; −1: none) changed since a move was last made at a place."""
        visit = self._visits.get(place)
        return changed_since(self.chains, heads, tails, -1 if visit is None else visit.move)

    def _candidates(
        self,
        place: tuple[str, int],
        keys: IntArray,
        columns: IntArray,
        fresh: tuple[NDArray[np.bool_], NDArray[np.bool_]],
        recent: NDArray[np.bool_],
        gains: Callable[[IntArray, IntArray, FloatArray], Edges],
    ) -> Edges:
        """Candidates of tracks (rows) for detections (columns).

        Parameters
        ----------
        place : where the move is made
        keys : (rows,) names of tracks, see `spanning`
        fresh : (rows,) and (columns,) that have changed since the move was last made there
        recent : (rows,) whose candidates are computed first: candidates that they outbid are skipped
        gains : candidates of some rows for some columns, whose gains are above a least value
        """
        self._move += self.remembers
        pieces: list[Edges] = []
        if place in self._visits:
            pieces.append(carried(self._visits[place].edges, keys, columns, *fresh, self._place))
        rows_fresh, columns_fresh = fresh
        least, every, new = (
            np.full(len(columns), self.worthless),
            np.arange(len(columns)),
            np.flatnonzero(columns_fresh),
        )
        for group in (recent, ~recent):
            for rows, some in ((rows_fresh & group, every), (~rows_fresh & group, new)):
                which = np.flatnonzero(rows)
                if len(which) and len(some):
                    i, j, gain = gains(which, some, least[some])
                    pieces.append((which[i], some[j], gain))
            edges = joined(pieces)
            raise_least(edges, recent, self.worthless, least)
        if self.remembers:
            i, j, gain = edges
            self._visits[place] = _Visit(self._move, (keys[i], columns[j], gain))
        return edges

    def roots(self) -> tuple[IntArray, FloatArray]:
        """Return the first detection of each detection's track (n,), and at first detections its value.

        The value is the log evidence ratio over false detections; −inf elsewhere.
        """
        root, value = np.empty(len(self.chains.t), np.int64), np.empty(len(self.chains.t))
        roots(self.chains, self.packed, root, value)
        return root, value


def joined(pieces: Sequence[Edges]) -> Edges:
    """Return all candidates of several arrays of them."""
    if not pieces:
        return np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros(0)
    rows, columns, gains = (np.concatenate(parts) for parts in zip(*pieces, strict=True))
    return rows, columns, gains


SWEEPS = 6  # most sweeps over the recording for one set of parameters
ROUNDS = 4  # alternations of finding tracks and learning the scene's parameters from them
TRUST = 4.0  # log odds that a tracker's next detection is of the same person: a switch in one of fifty
_JOINED_FRAMES = 16
"""Frames that the first sweep looks ahead: nothing is linked yet, and every detection is a candidate."""


@dataclass(frozen=True, eq=False)
class Association:
    """Identities of a recording's detections."""

    identity: NDArray[np.int64]  # (n,) of each detection, from 0 in the order of first appearance; −1: false
    # (n,) that the detection is of the same person as the previous one in its track; 1 for the first
    probability: FloatArray
    scene: SceneParameters  # the parameters that it was found with
    evidence: float  # log evidence ratio over all detections being false


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
    scene : known parameters; the others are learned from the detections
    progress : called with sweeps done and sweeps in all
    start : initial parameters; None: a guess from the number of detections
    rounds : alternations of association and parameter learning
    """
    search = _Search(detections, known_values(scene), start)
    for k in range(rounds):
        if k:
            search.adopt(search.learned())
        search.worthless = 0.0
        search.join_generously()
        # Link probabilities are those of the last round.
        search.worthless = WORTHLESS if k == rounds - 1 else 0.0
        search.settle(progress, k * SWEEPS, rounds * SWEEPS)
    progress(rounds * SWEEPS, rounds * SWEEPS)
    return search.found(search.identities())


def repair_detections(
    detections: Detections, given: NDArray[np.int64], scene: GivenScene = None
) -> Association:
    """Correct a tracker's identities: split tracks at identity switches, and join fragments.

    Parameters
    ----------
    given : (n,) identities from 0; −1: none
    scene : known parameters; the others are learned from the tracks

    Returns
    -------
    Association
        No detection is false: each keeps the identity that most of its track had, or gets a new identity
        where another track has more of that.
    """
    search = _Search(detections, known_values(scene))
    search.begin_with(given)
    for _ in range(ROUNDS):
        search.adopt(search.learned())
        search.settle()
    root, _ = search.roots()
    return search.found(_renamed(root, given))


def _renamed(track: NDArray[np.int64], given: NDArray[np.int64]) -> NDArray[np.int64]:
    """Identities (n,) of tracks (n,): the given identity of most of a track, kept by its longest track."""
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
    """The association of a whole recording."""

    def __init__(self, detections: Detections, known: Known, start: SceneParameters | None = None) -> None:
        n = len(detections)
        self.detections, self._known = detections, known
        scene = replace(first_guess(detections) if start is None else start, **known)
        channels = detections.channels
        self._std = channels.get("position_std", np.full(n, np.nan))
        chains = chains_of(detections)
        super().__init__(chains, Scene(*scene.packed(detections.step_seconds)), remembers=True)
        _, self._first = np.unique(chains.frame, return_index=True)
        self._end = np.append(self._first[1:], n)
        self._duplicates, self._score = np.zeros(n), channels.get("score", np.full(n, np.nan))
        self._descriptors = channels.get(APPEARANCE, np.empty((n, 0)))
        self._appearance = AppearanceEvidence()
        self._trust = 0.0
        self.adopt(scene)

    def begin_with(self, given: NDArray[np.int64]) -> None:
        """Start from the tracks of given identities (n,), from 0, and trust them; −1: none."""
        link_by(self.chains, given)
        self.chains.rows["given"] = given
        self._trust = TRUST
        self.adopt(self.scene)

    def adopt(self, scene: SceneParameters) -> None:
        """Continue with other parameters, and recompute which detections are near people."""
        self.scene = scene
        identity = self.identities()
        if (identity >= 0).any():
            detections = self.detections
            self._duplicates = duplicate_density(detections.step, detections.position, identity, scene)
        packed = Scene(*scene.packed(self.detections.step_seconds))
        self.packed = self._appearance.in_scene(packed._replace(trust=self._trust))
        self.chains = self._appearance.in_chains(self.chains, self._descriptors)
        self.chains.variance[:] = np.where(np.isnan(self._std), scene.position_std, self._std) ** 2
        births, deaths, clutter = own_rates(self.chains, identity)
        self.chains.rows["birth"], self.chains.rows["death"] = np.log(births), np.log(deaths)
        false = scene.clutter_density * clutter + self._duplicates
        self.chains.gain[:] = np.log(scene.detection_probability) - np.log(false)
        model, each = self._appearance.model, 0.0
        if model is not None:
            each = constancy(self.chains, identity, model, self._descriptors)
        scores = ScoreRatio.learned(self._score, identity) if (identity >= 0).any() else ScoreRatio()
        self._appearance = AppearanceEvidence(model, each, scores)
        self.chains.gain[:] += self._appearance.gain(self._descriptors, self._score)
        self.filter_from(0)

    def learned(self) -> SceneParameters:
        """Learn the parameters from the current tracks."""
        identity, detections = self.identities(), self.detections
        scene = learn_duplicates(detections.step, detections.position, identity, self.scene, self._known)
        if self._descriptors.shape[1]:
            self._appearance = AppearanceEvidence(learn_appearance(self.chains, identity, self._descriptors))
        seconds = self.packed.frame_seconds
        scene = learn_orientation(self.chains, scene, seconds, self._known)
        return learn_scene(self.chains, identity, scene, self._std, seconds, self._known)

    def join_generously(self) -> None:
        """Sweep once with free births and deaths.

        Two detections alone are seldom worth a birth and a death, so that no track would reach a third;
        tracks that are not worth both are split again by the sweeps that follow.
        """
        packed = self.packed
        gap = min(packed.longest_gap, _JOINED_FRAMES * packed.frame_seconds)
        self.packed = packed._replace(
            log_birth=np.log(self.scene.clutter_density), log_death=0.0, longest_gap=gap
        )
        self.filter_from(0)
        self.remembers = False
        self.sweep()
        self.packed, self.remembers = packed, True
        self.filter_from(0)

    def settle(
        self, progress: Callable[[int, int], None] = lambda done, total: None, done: int = 0, total: int = 0
    ) -> None:
        """Sweep to convergence or `SWEEPS` times; report the sweeps ``done`` before and since."""
        for sweep in range(SWEEPS):
            progress(done + sweep, total)
            if not self.sweep():
                break

    def sweep(self) -> int:
        """Make every move once, from the first frame to the last; return the number of changed frames."""
        self._move += 1
        remember_rest(self.chains, self.packed, self._move)
        return sum(
            self.move(first, end) for first, end in zip(self._first.tolist(), self._end.tolist(), strict=True)
        )

    # -- what came out ---------------------------------------------------------------------------------------

    def identities(self) -> NDArray[np.int64]:
        """(n,) number of each detection's track; −1: the track is more probably false detections."""
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
