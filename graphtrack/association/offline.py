"""Offline data association: block-wise maximisation of the evidence of a whole recording.

At each time all tracks are cut: heads (what came before) and tails (what comes after) are matched again, a
link being worth the evidence of the joined track over that of both alone. In each frame the detections are
matched again to the tracks that span it. Each match maximises its block, so that the evidence never
decreases; a few sweeps suffice.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from graphtrack.association.appearance import (
    AppearanceEvidence,
    Colours,
    ScoreRatio,
    constancy,
    evidence_of_tracks,
    learn_appearance,
)
from graphtrack.association.likelihood import (
    chains_of,
    count_up,
    learn_orientation,
    link_by,
    log_gap,
    remember_rest,
    scene_of,
)
from graphtrack.association.moves import WORTHLESS, Moves
from graphtrack.association.parallel import join_parallel
from graphtrack.association.rates import SensorRates
from graphtrack.association.scene import (
    GroundRates,
    duplicate_density,
    first_guess,
    first_velocities,
    learn_duplicates,
    learn_ground_rates,
    learn_scene,
    own_rates,
)
from graphtrack.association.sensors import Views, with_longest_gap
from graphtrack.geometry.angles import FloatArray
from graphtrack.kernels.compilation import Rehearsal, make_ready
from graphtrack.tracks.detections import APPEARANCE, Detections
from graphtrack.tracks.scene import GivenScene, Known, SceneParameters, known_values

SWEEPS = 6  # most sweeps over the recording for one set of parameters
ROUNDS = 4  # alternations of finding tracks and learning the scene's parameters from them
TRUST = 4.0  # log odds that a tracker's next detection is of the same person: a switch in one of fifty
LEARNING_ROUNDS = 2  # the same, where parameters alone are asked for
_JOINED_FRAMES = 16
"""Frames that the first sweep looks ahead: nothing is linked yet, and every detection is a candidate."""

_FIRST_GAP, _FIRST_FRAMES = 2.0, 4
"""Seconds of the longest gap in the first round, whose parameters are a guess; at least so many frames."""


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
    make_association_ready()
    search = _Search(detections, known_values(scene), start)
    search.run(rounds, progress)
    return search.found(search.identities())


@dataclass(frozen=True, eq=False)
class LearnedScene:
    """Parameters of a scene, learned from some of its detections."""

    scene: SceneParameters
    velocities: NDArray[np.void]  # see `velocities_of`
    rates: GroundRates
    sensor_rates: SensorRates
    appearance: AppearanceEvidence


def learn_from_detections(detections: Detections, known: Known) -> LearnedScene:
    """Learn the unknown parameters of a scene from some of its detections, by finding the people in them."""
    search = _Search(detections, known)
    search.run(LEARNING_ROUNDS)
    scene, identity = search.learned(), search.identities()
    appearance = search.appearance_of(identity)
    search.adopt(scene)
    rates = learn_ground_rates(search.chains, identity)
    return LearnedScene(scene, search.velocities, rates, search.sensor_rates, appearance)


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
    make_association_ready()
    search = _Search(detections, known_values(scene))
    search.begin_with(given)
    for _ in range(ROUNDS):
        search.adopt(search.learned())
        search.settle()
        search.join_doubles()
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
        alone = detections.of_main_sensor
        scene = replace(first_guess(alone) if start is None else start, **known)
        count, described = detections.scans.shape[1], detections.sensors
        self._views = Views.of(detections.position, detections.sensor, count, described)
        self.sensor_rates = SensorRates.even(max(count, 1))
        scene = with_longest_gap(scene, self._views, known)
        self.velocities = first_velocities(alone, scene, known)
        channels = detections.channels
        self._std = channels.get("position_std", np.full(n, np.nan))
        chains = chains_of(detections)
        packed = scene_of(scene, detections.step_seconds)
        super().__init__(chains, packed._replace(weights=self.sensor_rates.weights), remembers=True)
        _, self._first = np.unique(chains.frame, return_index=True)
        self._end = np.append(self._first[1:], n)
        self._duplicates, self._score = np.zeros(n), channels.get("score", np.full(n, np.nan))
        self._descriptors = channels.get(APPEARANCE, np.empty((n, 0)))
        self._appearance = AppearanceEvidence()
        self._trust = 0.0
        self.adopt(scene)

    def run(self, rounds: int, progress: Callable[[int, int], None] = lambda done, total: None) -> None:
        """Alternate between finding tracks and learning the scene's parameters from them."""
        for k in range(rounds):
            if k:
                self.adopt(self.learned())
            elif rounds > 1:
                self.look_near()
            self.worthless = 0.0
            self.join_generously()
            # Link probabilities are those of the last round.
            self.worthless = WORTHLESS if k == rounds - 1 else 0.0
            self.settle(progress, k * SWEEPS, rounds * SWEEPS)
            self.join_doubles()
        progress(rounds * SWEEPS, rounds * SWEEPS)

    def appearance_of(self, identity: NDArray[np.int64]) -> AppearanceEvidence:
        """The ratios of appearance and scores that the tracks show."""
        found = evidence_of_tracks(self.chains, identity, self._like_first(), self._score)
        return replace(found, colours=self._appearance.colours)

    def _like_first(self) -> FloatArray:
        """The descriptors (n, d) as the first sensor would have them."""
        colours = self._appearance.colours
        if colours is None:
            return self._descriptors
        return colours.removed(self._descriptors, self.detections.sensor)

    def begin_with(self, given: NDArray[np.int64]) -> None:
        """Start from the tracks of given identities (n,), from 0, and trust them; −1: none.

        Of several sensors each has tracks of its own, and those of one person alternate: the search starts
        from the places alone.
        """
        if self.detections.scans.shape[1]:
            self.run(ROUNDS)
        else:
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
        packed = scene_of(scene, self.detections.step_seconds, self.velocities)
        packed = packed._replace(
            trust=self._trust, views=self._views.heights, weights=self.sensor_rates.weights
        )
        self.packed = self._appearance.in_scene(packed)
        self.chains = self._appearance.in_chains(self.chains, self._descriptors)
        self.chains.variance[:] = np.where(np.isnan(self._std), scene.position_std, self._std) ** 2
        births, deaths, clutter = own_rates(self.chains, identity)
        self.chains.rows["birth"], self.chains.rows["death"] = np.log(births), np.log(deaths)
        false = scene.clutter_density * clutter + self._duplicates
        self.chains.gain[:] = np.log(scene.detection_probability) - np.log(false)
        self.chains.gain[:] += self.sensor_rates.gains[self.detections.sensor]
        model, each = self._appearance.model, 0.0
        if model is not None:
            each = constancy(self.chains, identity, model, self._like_first())
        scores = ScoreRatio.learned(self._score, identity) if (identity >= 0).any() else ScoreRatio()
        self._appearance = AppearanceEvidence(model, each, scores, self._appearance.colours)
        self.chains.gain[:] += self._appearance.gain(self._descriptors, self._score)
        self.filter_from(0)

    def learned(self) -> SceneParameters:
        """Learn the parameters from the current tracks."""
        identity, detections = self.identities(), self.detections
        scene = learn_duplicates(detections.step, detections.position, identity, self.scene, self._known)
        if self._descriptors.shape[1]:
            colours = Colours.learned(self._descriptors, detections.sensor, identity)
            self._appearance = AppearanceEvidence(colours=colours)
            model = learn_appearance(self.chains, identity, self._like_first())
            self._appearance = replace(self._appearance, model=model)
        known = self._known
        if detections.scans.shape[1]:
            rates = SensorRates.learned(self.chains, identity, self._views, detections.sensors)
            self.sensor_rates = rates
            # From gaps, chance and occlusion can hardly be told apart: most gaps are of one scan.
            known = {"detection_probability": float(rates.detection.mean()), **known}
        seconds = self.packed.frame_seconds
        scene = learn_orientation(self.chains, scene, seconds, self._known, self.velocities)
        return learn_scene(self.chains, identity, scene, self._std, seconds, known, self.velocities)

    def look_near(self) -> None:
        """Look no further than a few seconds, until parameters are learned that tell what may be far."""
        self.packed = self.packed._replace(longest_gap=self._first_gap())

    def _first_gap(self) -> float:
        """Return the longest gap in seconds while it is not known what may be far."""
        longest = max(_FIRST_GAP, _FIRST_FRAMES * self.packed.frame_seconds)
        return min(self.packed.longest_gap, longest)

    def join_generously(self) -> None:
        """Sweep once with free births and deaths.

        Two detections alone are seldom worth a birth and a death, so that no track would reach a third;
        tracks that are not worth both are split again by the sweeps that follow.
        """
        packed = self.packed
        gap = min(self._first_gap(), _JOINED_FRAMES * packed.frame_seconds)
        self.packed = packed._replace(
            log_birth=np.log(self.scene.clutter_density), log_death=0.0, longest_gap=gap
        )
        self.filter_from(0)
        self.remembers = False
        self.sweep()
        self.packed, self.remembers = packed, True
        self.filter_from(0)

    def join_doubles(self) -> None:
        """Join tracks, or their parts, that are of one person, and settle again."""
        if join_parallel(self.chains, self.packed):
            self.filter_from(0)
            self.settle()

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


def make_association_ready() -> None:
    """Compile or load the functions that associate detections; the log reports a long wait."""
    make_ready("data association", REHEARSAL)


def _rehearse() -> None:
    """Associate detections of two people who cross, and call what the online association alone calls."""
    frame = np.repeat(np.arange(12), 3)
    position = np.column_stack([0.1 * frame, (frame - 5.5) * np.tile([0.1, -0.1, 0.0], 12)])
    position += np.random.default_rng(0).normal(0.0, np.tile([0.05, 0.05, 0.5], 12)[:, None], position.shape)
    detections = Detections(frame, np.asarray(0.1 * frame, float), position)
    associate_detections(detections)
    count_up(chains_of(detections), np.zeros(len(frame), np.int64))
    log_gap(1, scene_of(SceneParameters(), 0.1))


REHEARSAL = Rehearsal("association", _rehearse, 20.0)
