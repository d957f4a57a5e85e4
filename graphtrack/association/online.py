"""Online data association with a revision window.

The moves of `offline` are made in the newest frames alone. Older decisions are final; the last detection of
each track is kept, for it may be detected again, and the newest detections, from which the scene's parameters
are learned.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from itertools import pairwise
from statistics import fmean, median
from typing import Any, ClassVar

import numpy as np

from graphtrack.association.appearance import AppearanceEvidence, widened
from graphtrack.association.likelihood import (
    ANY_VELOCITY,
    Chains,
    IntArray,
    count_up,
    misses_of,
    scene_of,
    unlinked,
)
from graphtrack.association.moves import Moves
from graphtrack.association.offline import LearnedScene, learn_from_detections, make_association_ready
from graphtrack.association.rates import SensorRates
from graphtrack.association.scene import (
    AHEAD,
    GroundRates,
    Pairs,
    duplicate_density_of,
    duplicate_pairs,
    first_guess,
    first_velocities,
)
from graphtrack.association.sensors import (
    BETWEEN_SCANS,
    Views,
    describes_view,
    with_longest_gap,
    with_views,
    with_zeros,
)
from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray
from graphtrack.saved import OtherSettings, Saved
from graphtrack.tracks.detections import APPEARANCE, Detections
from graphtrack.tracks.scene import GivenScene, Known, SceneParameters, known_values
from graphtrack.tracks.sensors import NO_SENSORS, Sensor, Sensors, digest_of
from graphtrack.tracks.time import TIME_TOLERANCE
from graphtrack.tracks.validation import LARGEST_SECONDS, bounds_of, is_number

NOBODY = -1


@dataclass
class Notes:
    """Attributes of n detections alongside their chains."""

    std: FloatArray  # declared noise, metres, or NaN
    place: IntArray  # index in its update
    reported: IntArray  # track id that was last reported
    number: IntArray  # track id of the track that begins with it, 0 before it has an id
    before: IntArray  # detections of its track that were dropped
    clutter: FloatArray  # density of false detections there, over its mean
    score: FloatArray  # detection score, or NaN
    descriptor: FloatArray  # (n, d), NaN where missing; d is 0 until the first descriptor

    @classmethod
    def of(cls, std: FloatArray, clutter: FloatArray, score: FloatArray, descriptor: FloatArray) -> Notes:
        """Attributes of the detections of a new frame."""
        n = len(std)
        nobody = np.full(n, NOBODY)
        return cls(
            std, np.arange(n), nobody, nobody.copy(), np.zeros(n, np.int64), clutter, score, descriptor
        )

    def extended(self, new: Notes) -> Notes:
        """These attributes with those of further detections."""
        both = zip(vars(self).values(), vars(new).values(), strict=True)
        return Notes(*(np.concatenate(pair) for pair in both))

    def of_some(self, some: IntArray) -> Notes:
        """The attributes of some detections."""
        return Notes(*(values[some] for values in vars(self).values()))


FIRST_LEARNED = 10, 5.0  # frames and person-seconds after which the scene's parameters are first learned
RELEARNED = 300.0  # seconds after which they are learned again at the latest
REMEMBERED = 2000
"""Detections that parameters are learned from, if these are at least as many frames as are needed first."""

_ROUNDING = 1e-3  # relative: rounded times change no frame in which parameters are learned

GUESS_SECONDS = 10.0  # weight of the prior of turning: at first all people may walk straight

_TURNS = {"acceleration_density": 1, "body_turn": 2, "head_turn": 2}
"""Parameters of turning, and the exponent that makes a variance of each."""

_OF_CHAINS = ("t", "frame", "position", "facing", "sensor", "scans")
_REMEMBERED = (*_OF_CHAINS, "std", "score", "descriptor")


class History(Saved):
    """The newest final detections, from which parameters are learned.

    What is learned does not depend on decisions that were made before: people are found in these detections
    once more, with what comes after them.
    """

    _saved: ClassVar = {
        **dict.fromkeys(_REMEMBERED, np.ndarray),
        "watched": float,
        "people": float,
        "due": float,
        "frames": int,
        "learnings": int,
    }

    def __init__(self) -> None:
        self.t, self.std, self.score = np.zeros(0), np.zeros(0), np.zeros(0)
        self.position, self.facing, self.descriptor = np.zeros((0, 2)), np.zeros((0, 2)), np.zeros((0, 0))
        self.frame, self.sensor = np.zeros(0, np.int64), np.zeros(0, np.int64)
        self.scans = np.zeros((0, 0))
        self.frames, self.people, self.watched = 0, 0.0, 0.0  # frames, person-seconds and seconds so far
        self.due, self.learnings = 0.0, 0

    def add(self, chains: Chains, notes: Notes, first: int, end: int, step_seconds: float) -> None:
        """Store the detections ``first`` up to ``end``, and drop the oldest beyond the limit."""
        new = {name: getattr(chains, name) for name in _OF_CHAINS}
        new |= {name: getattr(notes, name) for name in ("std", "score", "descriptor")}
        self.descriptor = widened(self.descriptor, notes.descriptor.shape[1])
        self.scans = with_first_sensor(self.scans, self.frame, chains.scans.shape[1])
        frames, few = np.unique(chains.frame[first:end]), FIRST_LEARNED[0] * max(chains.scans.shape[1], 1)
        newest = np.unique(np.concatenate([self.frame, frames]))[-few:]
        frame = np.concatenate([self.frame, chains.frame[first:end]])
        oldest = min(max(len(frame) - REMEMBERED, 0), int(np.searchsorted(frame, newest[0])))
        # No frame is remembered in part.
        oldest = int(np.searchsorted(frame, frame[oldest]))
        for name, values in new.items():
            setattr(self, name, np.concatenate([getattr(self, name), values[first:end]])[oldest:])
        self.frames += len(frames)
        self.people += (end - first) * step_seconds
        self.watched += len(frames) * step_seconds

    def is_due(self) -> bool:
        """Return True if parameters are to be learned: each time that twice as much has been watched."""
        frames, people = FIRST_LEARNED
        more = 1.0 + _ROUNDING
        enough = self.frames >= frames * max(self.scans.shape[1], 1)
        return enough and self.people * more >= people and self.watched * more >= self.due

    def learned(self, known: Known, described: tuple[Sensor, ...] = ()) -> LearnedScene:
        """Learn the unknown parameters, the maps of rates, and the ratios of appearance and scores.

        ``described``: descriptions of the sensors so far, or none
        """
        self.learnings += 1
        self.due = min(2.0 * self.watched, self.watched + RELEARNED)
        channels = {"position_std": self.std, "score": self.score, "body": self.facing[:, 0]}
        channels |= {"head": self.facing[:, 1], APPEARANCE: self.descriptor}
        of_sensors: dict[str, Any] = {"sensor": self.sensor, "scans": self.scans}
        if self.scans.shape[1]:
            of_sensors["sensors"] = described
        detections = Detections(self.frame, self.t, self.position, channels, **of_sensors)
        if self.scans.shape[1]:
            views = Views.of(self.position, self.sensor, self.scans.shape[1], described)
            detections = with_views(detections, views)
        found = learn_from_detections(detections, known)
        return replace(found, scene=self._with_guess(found.scene, known))

    def _with_guess(self, scene: SceneParameters, known: Known) -> SceneParameters:
        """Weight the parameters of turning between prior and estimate by time."""
        share, guess = GUESS_SECONDS / (GUESS_SECONDS + self.watched), SceneParameters()
        mean = {}
        for name, power in _TURNS.items():
            first, found = getattr(guess, name) ** power, getattr(scene, name) ** power
            mean[name] = (share * first + (1.0 - share) * found) ** (1.0 / power)
        return replace(scene, **mean | dict(known))


def with_first_sensor(scans: FloatArray, frame: IntArray, count: int) -> FloatArray:
    """Return scans (n, s) of detections with the columns of new sensors.

    The frames (n,) of a sensor alone, of which there are no scans, are its scans.
    """
    if count and not scans.shape[1]:
        scans = frame[:, None].astype(float)
    return with_zeros(scans, count)


REPORTED_FROM = 0.45
"""Least probability of existence, and of presence where hidden, of a reported person: half the greatest
F-measure maximises it (Lipton et al. 2014, ECML PKDD), and IDF1 of synthetic crowds is 0.9."""

_LEAST_VALUE = float(np.log(REPORTED_FROM / (1.0 - REPORTED_FROM)))  # the same as a track's value

REVISED_FRAMES = 8
"""Frames of the revision window: enough detections to decide their identities."""

AGES = {0.09: tuple(range(REVISED_FRAMES - 1, -1, -1)), 0.0: (7, 3, 1, 0)}
"""Least seconds between frames → ages of the frames that are decided again; fewer at high frame rates. The
limit is at no usual rate, so that rounded times do not change sides."""


@dataclass(frozen=True)
class Revision:
    """A detection that changes its track; −1: no track."""

    t: float  # seconds
    frame: int  # the number of its update
    detection: int  # its index in the update
    before: int  # track id
    after: int  # track id


@dataclass(frozen=True, eq=False)
class Decision:
    """Assignment of a frame's n detections."""

    identity: IntArray  # (n,) track ids, from 1; −1: no track so far
    # (n,) that each is of the same person as the track's detection before; 1 for a first one
    probability: FloatArray
    revised: tuple[Revision, ...]  # changes of earlier assignments


class OnlineAssociation(Moves, Saved):
    """Online data association, frame by frame.

    Parameters
    ----------
    scene : known parameters of birth, death and detection; the others are learned online
    lag : seconds within which decisions may be revised
    described : name of a sensor → its description: field of view and rates of detection
    """

    _saved: ClassVar = {
        "known": dict[str, Any],
        "lag": float,
        "scene": SceneParameters,
        "_velocities": np.ndarray,
        "chains": Chains,
        "link_p": np.ndarray,
        "_notes": Notes,
        "_first": list[int],
        "_history": Saved,
        "_ground_rates": GroundRates | None,
        "_appearance": AppearanceEvidence,
        "_next": int,
        "updates": int,
        "_last": float,
        "_intervals": list[float],
        "sensors": list[str],
        "_last_of": list[float],
        "_scans": list[int],
        "_views": Views,
        "_rates": SensorRates,
        "_recent": list[int],
    }

    def __init__(self, scene: GivenScene = None, lag: float = 2.0, described: Sensors = NO_SENSORS) -> None:
        if not lag > 0.0:
            raise InputError(f"lag = {lag}", "a positive number of seconds")
        make_association_ready()
        self.known, self.lag, self._described = known_values(scene), lag, described
        self.scene = SceneParameters(**self.known)
        empty, none = np.zeros(0), np.zeros(0, np.int64)
        nowhere = np.zeros((0, 2))
        super().__init__(unlinked(empty, none, nowhere, nowhere.copy()), scene_of(self.scene, 1.0))
        self._velocities = ANY_VELOCITY
        self._notes = Notes.of(empty, empty, empty, np.zeros((0, 0)))
        self._first: list[int] = []  # first detection of each frame that can be revised, oldest first
        self._history = History()
        self._ground_rates: GroundRates | None = None
        self._appearance = AppearanceEvidence()
        self._next, self.updates, self._last = 1, 0, -np.inf
        self._intervals: list[float] = []
        # Names of the sensors, the time of the last scan of each, and its number of scans.
        self.sensors: list[str] = []
        self._last_of: list[float] = []
        self._scans: list[int] = []
        self._views, self._rates = Views.none(), SensorRates.even(0)
        self._recent: list[int] = []  # sensors of the newest scans, if there are several
        self._pairs: Pairs  # of the frames that can be revised
        # The same by the number of the update, from its first detection on, and the spread that they are for.
        self._pairs_of: dict[int, Pairs] = {}
        self._pairs_spread = np.nan

    @property
    def learned(self) -> int:
        """Number of times that parameters were learned."""
        return self._history.learnings

    @property
    def descriptor_size(self) -> int:
        """Size of appearance descriptors; 0: no descriptor so far."""
        return int(self._notes.descriptor.shape[1])

    @property
    def step_seconds(self) -> float:
        """Median seconds between recent frames, of several sensors the mean between their scans."""
        if not self._intervals:
            return 1.0
        return fmean(self._intervals) if len(self.sensors) > 1 else median(self._intervals)

    def state(self) -> dict[str, Any]:
        """Return the state to continue from, as JSON-able data; see `from_state`."""
        digest = digest_of(self._described)
        return super().state() | ({"described": digest} if digest else {})

    def restore(self, state: Mapping[str, Any]) -> None:
        """Take over a `state`; OtherSettings if its known parameters, lag or descriptions are others."""
        of_sensors = "descriptions of sensors"
        own = {**self.known, "lag": self.lag, of_sensors: digest_of(self._described) or None}
        super().restore(state)
        saved = {**self.known, "lag": self.lag, of_sensors: state.get("described")}
        for name in {**saved, **own}:
            if saved.get(name) != own.get(name):
                found, expected = (f"{name} = {one.get(name)}" for one in (saved, own))
                raise OtherSettings(f"a state with {found}", f"one with {expected}")
        self._pack()

    @property
    def _descriptions(self) -> tuple[Sensor, ...]:
        """Descriptions of the sensors so far; () if there are none at all."""
        unknown = Sensor()
        return tuple(self._described.get(one, unknown) for one in self.sensors) if self._described else ()

    def _widen_views(self, position: FloatArray, sensor: IntArray) -> None:
        """Extend the fields of view that are not described to places (n, 2), each of one sensor (n,)."""
        if self._described:
            learned = np.array([not describes_view(one) for one in self._descriptions])
            position, sensor = position[learned[sensor]], sensor[learned[sensor]]
        self._views = self._views.reaching(position, sensor)

    @property
    def first_open(self) -> int:
        """The number of the oldest update whose detections can still be revised."""
        return int(self.chains.frame[self._first[0]]) if self._first else self.updates - 1

    def open_detections(self, tracks: Collection[int]) -> dict[int, list[tuple[int, int]]]:
        """Track id → its detections that can still be revised, oldest first: (update, index in it)."""
        found: dict[int, list[tuple[int, int]]] = {}
        reported = self._notes.reported
        first = self._first[0] if self._first else len(reported)
        for k in (first + np.flatnonzero(np.isin(reported[first:], list(tracks)))).tolist():
            key = int(self.chains.frame[k]), int(self._notes.place[k])
            found.setdefault(int(reported[k]), []).append(key)
        return found

    def hidden(self) -> list[int]:
        """Track ids without a detection in the newest frame whose people probably are still there."""
        chains, now = self.chains, self.updates - 1
        root, value = self.roots()
        number = self._notes.number[root]
        believed = (number != NOBODY) & (value[root] > _LEAST_VALUE)
        last = np.flatnonzero((chains.following < 0) & (chains.frame < now) & believed)
        return sorted(number[last[self._still_there(last, now) > REPORTED_FROM]].tolist())

    def _still_there(self, last: IntArray, now: int) -> FloatArray:
        """Return the probability (n,) that the people last detected at these have not left by a frame."""
        chains, frames = self.chains, now - self.chains.frame[last]
        longest = int(frames.max(initial=0))
        often = self._often_missed(last, longest)
        since = np.arange(longest)[:, None]
        seconds = self.step_seconds * np.minimum(since, frames - 1) + AHEAD
        goal = chains.position[last] + seconds[:, :, None] * chains.velocity[last]
        rate = np.ones(seconds.shape)
        if self._ground_rates is not None:
            rate = self._ground_rates.leaving_for(goal.reshape(-1, 2)).reshape(rate.shape)
        leaves = np.where(since < frames, np.minimum(np.exp(self.packed.log_death) * rate, 1.0), 0.0)
        stays = np.cumprod(np.vstack([np.ones(len(last)), 1.0 - leaves]), axis=0)
        left = (stays[:-1] * leaves * often[:longest]).sum(axis=0)
        there = stays[-1] * often[frames, np.arange(len(last))]
        found: FloatArray = there / (there + left)
        return found

    def _often_missed(self, last: IntArray, longest: int) -> FloatArray:
        """Return the probability (longest + 1, n) of no detection in so many frames after ``last``."""
        frames = np.arange(longest + 1.0)[:, None] * np.ones(len(last))
        missed = frames
        if len(self.sensors) > 1 and longest:
            chains, ahead = self.chains, self.step_seconds * frames[1:, :, None]
            places = chains.position[last] + ahead * chains.velocity[last]
            views = self._views.at(places.reshape(-1, 2)).reshape(longest, len(last), -1)
            # The sensor of the scan that is k after that of each detection.
            scan = chains.frame[last] + np.arange(1, longest + 1)[:, None]
            newest = np.array(self._recent)
            place = len(newest) - (self.updates - scan)
            sensor = newest[np.clip(place, 0, len(newest) - 1)]
            each = np.take_along_axis(views * self._rates.weights, sensor[:, :, None], axis=2)[:, :, 0]
            missed = np.vstack([np.zeros(len(last)), np.cumsum(each, axis=0)])
        return np.exp(misses_of(missed, frames, self.packed))

    def number_from(self, first: int) -> None:
        """Number new tracks from a track id on."""
        self._next = first

    @property
    def next_number(self) -> int:
        """Track id of the next new track."""
        return self._next

    def remembered(self) -> set[int]:
        """The track ids that may be detected again."""
        return set(self._notes.reported.tolist())

    def update(
        self,
        t: float,
        position: FloatArray,
        std: FloatArray | None = None,
        facing: FloatArray | None = None,
        score: FloatArray | None = None,
        descriptor: FloatArray | None = None,
        sensor: str = "",
    ) -> Decision:
        """Associate a frame's detections, with several sensors a scan of one.

        Raise InputError if time does not increase, a position is not finite or descriptors have another size
        than before. The state is then unchanged.

        Parameters
        ----------
        t : seconds, after those of the previous update
        position : (n, 2) metres; n may be 0
        std : (n,) metres, NaN where unknown
        facing : (n, 2) radians, body and head as they were observed; NaN: not observed
        score : (n,) detection scores, in the detector's units; NaN: no score
        descriptor : (n, d) appearance descriptors, NaN where missing; d is the same in all frames
        sensor : name of the sensor
        """
        position = np.asarray(position, float).reshape(-1, 2)
        self.check_time(t, sensor)
        if not np.isfinite(position).all():
            raise InputError("a detection without a position", "both of its coordinates")
        n = len(position)
        nothing = np.full(n, np.nan)
        shown = np.full((n, self.descriptor_size), np.nan) if descriptor is None else descriptor
        shown = np.asarray(shown, float)
        if shown.ndim != 2 or shown.shape[1] != (self.descriptor_size or shown.shape[1]):
            raise InputError(f"descriptors of shape {shown.shape}", f"(n, {self.descriptor_size or 'd'})")
        one, t = self._scan(t, sensor)
        if self.updates:
            self._intervals = [*self._intervals[-24 * len(self.sensors) :], t - self._last]
        self._last = t
        self._forget(t)
        std = nothing if std is None else np.asarray(std, float)
        angles = np.full((n, 2), np.nan) if facing is None else np.asarray(facing, float)
        scores = nothing if score is None else np.asarray(score, float)
        first = self._append(t, position, angles, Notes.of(std, np.ones(n), scores, shown), one)
        self.updates += 1
        self._scans[one] += 1
        self._learn()
        self._prepare()
        if n:
            self.move(first, first + n)
            self._weigh_duplicates()
        ends = [*self._first[1:], len(self.chains.t)]
        count = len(self.sensors)
        ages = next(some for least, some in AGES.items() if self.step_seconds * count >= least)
        for age in (age * count for age in ages):
            if age < len(self._first):
                begin, end = self._first[-1 - age], ends[-1 - age]
                if self.move(begin, end):
                    self.filter_from(end)
        return self._decide(first)

    def check_time(self, t: float, sensor: str = "") -> None:
        """Raise InputError unless a frame at a time (seconds), of a sensor, is valid."""
        if not (is_number(t) and abs(t) <= LARGEST_SECONDS):
            raise InputError(f"t = {t!r}", f"a time in seconds, {bounds_of('t').expected}")
        last = max(self._last_of, default=-np.inf)
        own = self._last_of[self.sensors.index(sensor)] if sensor in self.sensors else -np.inf
        if not t > own + TIME_TOLERANCE:
            raise InputError(f"t = {t:.15g}", f"a time in seconds after {own:.15g}")
        if t < last - TIME_TOLERANCE:
            expected = (
                f"a time in seconds from {last:.15g} on, as of other sensors: scans in the order of time, as "
                "graphtrack.streaming.reordering.ReorderBuffer puts them"
            )
            raise InputError(f"t = {t:.15g}", expected)

    # -- one step ------------------------------------------------------------------------------------------

    def _scan(self, t: float, sensor: str) -> tuple[int, float]:
        """Return the number of a scan's sensor, and its time, after those of the scans before."""
        if sensor not in self.sensors:
            self.sensors.append(sensor)
            self._last_of.append(t)
            self._scans.append(0)
            self._views = self._views.with_sensor(self._described.get(sensor, Sensor()))
            # Before all rates are learned, some that are described compare with nothing.
            known = self._descriptions if self.learned else ()
            self._rates = self._rates.extended(len(self.sensors), known)
            if len(self.sensors) == 2:
                self._widen_views(self.chains.position, self.chains.sensor)
                self._recent = [0] * len(self._intervals)
            count = len(self.sensors) if len(self.sensors) > 1 else 0
            scans = with_first_sensor(self.chains.scans, self.chains.frame, count)
            self.chains = self.chains._replace(scans=scans, views=np.zeros(scans.shape))
            self._pack()
        one = self.sensors.index(sensor)
        self._last_of[one] = t
        if len(self.sensors) > 1:
            longest = self.scene.longest_gap / max(self.step_seconds, 1e-3)
            self._recent = [*self._recent[-int(longest) - 1 :], one]
            t = max(t, self._last + BETWEEN_SCANS)
        return one, t

    def _append(self, t: float, position: FloatArray, facing: FloatArray, notes: Notes, sensor: int) -> int:
        """Append a frame's detections; return the index of the first."""
        chains, n, first = self.chains, len(position), len(self.chains.t)
        new = unlinked(np.full(n, t), np.full(n, self.updates), position, facing)
        new.rows["sensor"] = sensor
        if chains.scans.shape[1]:
            scans = np.tile(np.array(self._scans, float), (n, 1))
            new = new._replace(scans=scans, views=np.zeros(scans.shape))
        new = self._appearance.in_chains(new, notes.descriptor)
        if self._ground_rates is not None:
            births, deaths, notes.clutter = self._ground_rates.at(position)
            new.rows["birth"], new.rows["death"] = np.log(births), np.log(deaths)
        self.chains = Chains(*(np.concatenate(both) for both in zip(chains, new, strict=True)))
        self.link_p = np.concatenate([self.link_p, np.ones(n)])
        self._notes.descriptor = widened(self._notes.descriptor, notes.descriptor.shape[1])
        self._notes = self._notes.extended(notes)
        if n:
            self._first.append(first)
        return first

    def _forget(self, t: float) -> None:
        """Finalise frames that leave the revision window; keep detections that may be continued."""
        chains = self.chains
        oldest = t - self.lag - TIME_TOLERANCE
        most = REVISED_FRAMES * len(self.sensors)
        kept = [k for k in self._first if chains.t[k] >= oldest][-(most - 1) :]
        # A new person is decided by two frames together, so the last is open however far it is.
        kept = kept or self._first[-1:]
        settled = kept[0] if kept else len(chains.t)
        open_before = self._first[0] if self._first else len(chains.t)
        if settled == open_before:
            return
        root, value = self.roots()
        number, times = self._notes.number[root], self._times()
        self._history.add(chains, self._notes, open_before, settled, self.step_seconds)
        following = chains.following[:settled]
        # A track of too low a value is not continued after a gap.
        lost = (following < 0) & (value[root[:settled]] > 0.0)
        earliest = t - self.scene.longest_gap - TIME_TOLERANCE
        heads = (lost & (chains.t[:settled] >= earliest)) | (following >= settled)
        remain = np.concatenate([np.flatnonzero(heads), np.arange(settled, len(chains.t))])
        # A track's number and length pass to the detections that remain of it.
        self._notes.number[:settled] = number[:settled]
        self._notes.before[:settled] = times[:settled] - 1
        self._notes = self._notes.of_some(remain)
        place = np.full(len(chains.t) + 1, -1)
        place[remain] = np.arange(len(remain))
        self.chains = Chains(*(values[remain] for values in chains))
        self.chains.following[:] = place[self.chains.following]
        self.chains.preceding[:] = place[self.chains.preceding]
        self.link_p = self.link_p[remain]
        self._first = [int(place[k]) for k in kept]

    def _prepare(self) -> None:
        """Recompute variances and gains in the revision window, and filter its tracks again."""
        self.scene = with_longest_gap(self.scene, self._views, self.known)
        self._pack()
        chains = self.chains
        if not self._first:
            return
        if chains.scans.shape[1]:
            chains.views[:] = self._views.at(chains.position)
            chains.views[np.arange(len(chains.t)), chains.sensor] = 1.0
        first = self._first[0]
        self._pairs = self._duplicate_pairs(first)
        std = self._notes.std[first:]
        chains.variance[first:] = np.where(np.isnan(std), self.scene.position_std, std) ** 2
        self._weigh_duplicates()

    def _duplicate_pairs(self, first: int) -> Pairs:
        """Return `duplicate_pairs` of the detections from ``first`` on; only new frames are searched."""
        chains, known, spread = self.chains, self._pairs_of, self.scene.duplicate_spread
        known = known if spread == self._pairs_spread else {}
        self._pairs_spread, self._pairs_of, found = spread, {}, []
        for begin, end in pairwise([*self._first, len(chains.t)]):
            rows, number = chains.rows[begin:end], int(chains.frame[begin])
            if number not in known:
                position = np.column_stack([rows["x"], rows["y"]])
                known[number] = duplicate_pairs(rows["frame"], position, self.scene)
            one, other, square = self._pairs_of[number] = known[number]
            found.append((one + (begin - first), other + (begin - first), square))
        one, other, square = (np.concatenate(parts) for parts in zip(*found, strict=True))
        return one, other, square

    def _pack(self) -> None:
        packed = scene_of(self.scene, self.step_seconds, self._velocities)
        packed = packed._replace(views=self._views.heights, weights=self._rates.weights)
        self.packed = self._appearance.in_scene(packed)

    def _weigh_duplicates(self) -> None:
        """Set the gains of detections: lower near a person who is detected already."""
        chains, notes, first = self.chains, self._notes, self._first[0]
        root, value = self.roots()
        track = np.where(value[root] > 0.0, root, NOBODY)
        times = np.zeros(len(root), np.int64)
        np.maximum.at(times, root, self._times())
        near = duplicate_density_of(self._pairs, track[first:], self.scene, times)
        false = self.scene.clutter_density * notes.clutter[first:] + near
        chains.gain[first:] = np.log(self.scene.detection_probability) - np.log(false)
        chains.gain[first:] += self._rates.gains[chains.sensor[first:]]
        chains.gain[first:] += self._appearance.gain(notes.descriptor[first:], notes.score[first:])
        self.filter_from(first)

    def _times(self) -> IntArray:
        """(n,) length of each detection's track up to it."""
        times = self._notes.before + 1
        count_up(self.chains, times)
        return times

    def _decide(self, first: int) -> Decision:
        root, value = self.roots()
        for k in np.unique(root[first:]).tolist():
            if value[k] > _LEAST_VALUE and self._notes.number[k] == NOBODY:
                self._notes.number[k], self._next = self._next, self._next + 1
        owner = np.where(value[root] > _LEAST_VALUE, self._notes.number[root], NOBODY)
        changed = np.flatnonzero(owner[:first] != self._notes.reported[:first])
        changed = changed[changed >= (self._first[0] if self._first else 0)]
        chains = self.chains
        columns = chains.t, chains.frame, self._notes.place, self._notes.reported, owner
        rows = zip(*(values[changed].tolist() for values in columns), strict=True)
        revised = tuple(Revision(*row) for row in rows)
        self._notes.reported = owner
        if len(self.sensors) > 1:
            known = np.flatnonzero(owner[first:] > 0) + first
            self._widen_views(chains.position[known], chains.sensor[known])
        sure = np.where(chains.preceding < 0, 1.0, self.link_p)
        return Decision(owner[first:], sure[first:], revised)

    # -- parameters ----------------------------------------------------------------------------------------

    def _learn(self) -> None:
        """Learn from final detections; before that, guess from their number. Known values are kept."""
        chains, history = self.chains, self._history
        if not len(chains.t):
            return
        if history.is_due():
            found = history.learned(self.known, self._descriptions)
            self.scene, self._velocities = found.scene, found.velocities
            self._ground_rates, self._appearance = found.rates, found.appearance
            self._rates = found.sensor_rates.extended(len(self.sensors))
            self.chains = self._appearance.in_chains(chains, self._notes.descriptor)
        elif not history.learnings:
            of_sensors: dict[str, Any] = {"sensor": chains.sensor, "scans": chains.scans}
            detections = Detections(chains.frame, chains.t, chains.position, **of_sensors).of_main_sensor
            self.scene = replace(first_guess(detections), **self.known)
            self._velocities = first_velocities(detections, self.scene, self.known)
