"""Tracking online, from tracks or from detections without identities, and compilation ahead of it.

`track_online` takes recorded tracks, `OnlineTracker` frames of detections as they come.
"""

from __future__ import annotations

import math
import warnings
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from copy import copy
from functools import partial
from itertools import pairwise, takewhile
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypedDict, Unpack, overload

import numpy as np

from graphtrack.association.associate import tracks_of
from graphtrack.association.sensors import BETWEEN_SCANS
from graphtrack.association.tracker import DetectionTracker, PersonEstimate
from graphtrack.constants import filters
from graphtrack.constants.commons import commons_of
from graphtrack.constants.online import OnlineSmoother
from graphtrack.constants.personal import Constants, is_learned
from graphtrack.errors import InputError, InputWarning
from graphtrack.forecasting.forecaster import Forecast, Forecaster, times_ahead
from graphtrack.geometry.angles import FloatArray
from graphtrack.geometry.camera import GroundCamera
from graphtrack.geometry.walkable import AreaLike, WalkableArea
from graphtrack.inference.engines import (
    OnlineEngine,
    rehearsals,
)
from graphtrack.inference.state import Estimate, as_track
from graphtrack.interaction.coupled import CONVERSATIONS, Conversations
from graphtrack.io.options import ReadingBase
from graphtrack.io.sensors import SensorScene, SensorsLike
from graphtrack.kernels.compilation import Rehearsal, make_ready
from graphtrack.model import Model, Observation
from graphtrack.model.given import notes_on
from graphtrack.model.observation import observations
from graphtrack.model.terms.walls import StaysInside
from graphtrack.saved import integer
from graphtrack.smoothing import Progress, lacks_groups
from graphtrack.tracks.given import with_position_noise
from graphtrack.tracks.scene import GivenScene, known_values
from graphtrack.tracks.sensors import NO_SENSORS
from graphtrack.tracks.time import TIME_TOLERANCE
from graphtrack.tracks.track import Track, TrackSet

if TYPE_CHECKING:
    from graphtrack.io.read_write import Given, Scene


class OnlineOptions(TypedDict, total=False):
    """Keywords of an `OnlineSmoother`."""

    engine: OnlineEngine
    lag: float | None
    camera: GroundCamera | None
    walkable: AreaLike | None
    constants: Constants | None


class OnlineReading(ReadingBase, total=False):
    """Keywords of reading for `track_online`, whose camera is one of `OnlineOptions`."""

    fps: float | None
    format: str | None


class OnlineTracking(OnlineOptions, OnlineReading, total=False):
    """Keywords of `track_online`."""

    progress: Progress


@overload
def track_online(
    tracks: Track, model: Model | str | Path | None = None, **options: Unpack[OnlineTracking]
) -> Track: ...
@overload
def track_online(
    tracks: Scene, model: Model | str | Path | None = None, **options: Unpack[OnlineTracking]
) -> TrackSet: ...
def track_online(
    tracks: Given,
    model: Model | str | Path | None = None,
    *,
    engine: OnlineEngine = "auto",
    lag: float | None = 2.0,
    camera: GroundCamera | None = None,
    progress: Progress = lambda frames: None,
    walkable: AreaLike | None = None,
    constants: Constants | None = None,
    **reading: Unpack[OnlineReading],
) -> TrackSet | Track:
    """Return online estimates of recorded tracks: at each frame from data up to it, NaN before a position.

    Constants are learned from a person's earlier observations, and from those who left before.
    With the model "social" the tracks of a scene are tracked in step, and their groups are estimated, where
    no track has the input ``group``.

    Parameters
    ----------
    tracks : a `Track`, which returns a `Track`, or input of `solve`, which returns a `TrackSet`
    model, constants, engine, lag : as in `OnlineSmoother`
    camera : camera of the scene; by default that of the `TrackSet`
    progress : called with the numbers of person-frames that are done
    walkable : as in `OnlineSmoother`
    **reading : options of `read`, where ``tracks`` is a path or a table, such as ``fps``

    Raises
    ------
    InputError
        For a file of detections without identities too: identities are associated from past and future by
        `associate`, and from the past alone by `OnlineTracker`.
    """
    area = None if walkable is None else WalkableArea.of(walkable)
    options: OnlineOptions = {
        "engine": engine,
        "lag": lag,
        "camera": camera,
        "walkable": area,
        "constants": constants,
    }
    if not isinstance(tracks, Track) or reading:
        scene, chosen = tracks_of(tracks, identified=True, **reading), Model.named(model)
        options["camera"] = scene.camera if camera is None else camera
        scene = _noted(scene, chosen, options["camera"])
        return _side_by_side(scene, chosen, options, progress) if len(scene) else scene
    chosen = Model.named(model)
    return _side_by_side(_noted(TrackSet((tracks,)), chosen, camera), chosen, options, progress).tracks[0]


def _noted(tracks: TrackSet, model: Model, camera: GroundCamera | None) -> TrackSet:
    """Return tracks with the noise of their positions; warn of channels that the model does not use."""
    for line in notes_on(tracks.tracks, model, camera):
        warnings.warn(line, InputWarning, stacklevel=3)
    return tracks.map(with_position_noise)


def _side_by_side(scene: TrackSet, model: Model, options: OnlineOptions, progress: Progress) -> TrackSet:
    """Track all people in the order of time, each with what the others have in common so far.

    With a model that has groups, and tracks that do not, each has the conversations before as input.
    """
    constants = options.get("constants")
    commons = commons_of(constants, model)
    conversations = Conversations(model) if model.has_groups and lacks_groups(scene) else None
    tracks = scene.tracks
    given = [observations(track) for track in tracks]
    people: dict[int, OnlineSmoother] = {}
    found: list[list[Estimate]] = [[] for _ in tracks]
    answers: dict[int, Track] = {}
    for t, places in _in_time(tracks):
        if commons.is_due(t):
            commons.refresh(t, {place: one.learner for place, one in people.items()})
        for place in places:
            if place not in people:
                people[place] = OnlineSmoother(model, **options)
            commons.inform(people[place].learner)
        # Groups are estimated person by person.
        parts = [places] if conversations is None else [[place] for place in places]
        for part in parts:
            some = [people[place] for place in part]
            observed = [next(given[place]) for place in part]
            if conversations is not None:
                observed = [
                    conversations.observed(tracks[place].track_id, one)
                    for place, one in zip(part, observed, strict=True)
                ]
            usable = [one.usable(observation) for one, observation in zip(some, observed, strict=True)]
            for place, estimate in zip(part, OnlineSmoother.update_together(some, usable), strict=True):
                found[place].append(estimate)
                if conversations is not None:
                    conversations.estimated(tracks[place].track_id, estimate)
        for place in places:
            if len(found[place]) == len(tracks[place]):
                answers[place] = as_track(tracks[place], found[place], model)
                found[place] = []
                commons.leave(people.pop(place).learner)
        progress(len(places))
    return scene.with_tracks(answers[place] for place in range(len(tracks)))


def _in_time(tracks: Sequence[Track]) -> Iterator[tuple[float, list[int]]]:
    """Yield each time and the places of the tracks that have a row then, a row of each at a time."""
    times = np.concatenate([track.t for track in tracks])
    place = np.repeat(np.arange(len(tracks)), [len(track) for track in tracks])
    order = np.lexsort((place, times))
    times, place = times[order], place[order]
    begins = np.flatnonzero((np.diff(times, prepend=-np.inf) > 0.0) | (np.diff(place, prepend=-1) <= 0))
    for begin, end in pairwise((*begins.tolist(), len(times))):
        yield float(times[begin]), place[begin:end].tolist()


_SMOOTHING = ("smooth", "solve")
_TRACKING = ("OnlineSmoother", "track_online")
_DETECTIONS = ("OnlineTracker",)
_BEHAVIOUR = ("groups", "OnlineGroups", "attention", "OnlineAttention", "forecast", "Forecaster")
WARMED = (*_SMOOTHING, *_TRACKING, *_DETECTIONS, "associate", *_BEHAVIOUR)
"""Functions and classes that `warm_up` takes by name."""


def warm_up(
    model: Model | str | Path | None = None,
    engine: OnlineEngine | Literal["gtsam"] = "auto",
    functions: str | Sequence[str] | None = None,
    *,
    behaviour: bool = False,
    walkable: bool = False,
) -> None:
    """Compile, or load from disk, all that the first calls of functions and classes would wait for.

    Without it the first call waits: half a second for loading or, once on a machine, about
    half a minute for compiling. The log ("graphtrack") then has a warning before and after, which Python
    shows where logging is not set up.

    Parameters
    ----------
    model, engine : as in `solve` and `OnlineSmoother`
    functions : names of those to be called: ``smooth`` (also ``solve``), ``OnlineSmoother``
        (``track_online``), ``OnlineTracker``, ``associate``, ``groups`` (``OnlineGroups``), ``attention``
        (``OnlineAttention``), ``forecast`` (``Forecaster``); None: the first four
    behaviour : include groups, attention and forecasts
    walkable : include kernels of walls, for a walkable area

    Raises
    ------
    InputError
        For a name that is none of these.
    """
    from graphtrack.association import offline as association
    from graphtrack.forecasting import forecaster
    from graphtrack.interaction import attention, groups

    chosen = Model.named(model)
    named = [functions] if isinstance(functions, str) else functions
    wanted = {*_SMOOTHING, *_TRACKING, *_DETECTIONS, "associate"} if named is None else set(named)
    for one in sorted(wanted - set(WARMED)):
        raise InputError(f"the function {one!r}", f"one of {', '.join(WARMED)}")
    wanted |= set(_BEHAVIOUR) if behaviour else set()
    of_tracks = not wanted.isdisjoint((*_SMOOTHING, *_TRACKING, *_DETECTIONS))
    found: list[Rehearsal] = []
    for each in (chosen, chosen.with_terms(StaysInside)) if walkable else (chosen,):
        offline = not wanted.isdisjoint(_SMOOTHING)
        online = not wanted.isdisjoint((*_TRACKING, *_DETECTIONS))
        found += rehearsals(each, engine, offline=offline, online=online)
    if is_learned(None, chosen):
        found += [filters.REHEARSAL] * (not wanted.isdisjoint(_SMOOTHING))
        found += [filters.ONLINE_REHEARSAL] * (not wanted.isdisjoint((*_TRACKING, *_DETECTIONS)))
    if not wanted.isdisjoint((*_SMOOTHING, *_DETECTIONS, "associate")):
        found.append(association.REHEARSAL)
    if (chosen.has_groups and of_tracks) or not wanted.isdisjoint(_BEHAVIOUR[:4]):
        found.append(groups.REHEARSAL)
    if not wanted.isdisjoint(_BEHAVIOUR[2:4]):
        found.append(attention.REHEARSAL)
    if not wanted.isdisjoint((*_DETECTIONS, *_BEHAVIOUR[4:])):
        found.append(forecaster.REHEARSAL)
    make_ready(", ".join(one for one in WARMED if one in wanted), *found)


_UNASKED = 1500  # frames that are kept until the first forecast

_KNOWN_HEAD = 0.6
"""Standard deviation of a head's direction, rad, above which forecasts ignore it."""


class OnlineTracker(DetectionTracker):
    """Track all people of a scene online, from detections without identities.

    Identities are assigned at once; within a revision window later detections may revise them, and the
    estimates with them. New people are reported once they are more probable than false detections. With a
    model that has groups, these are estimated too. Copies, and what `pickle` restores, continue to the same
    bits; with isam2 within its tolerances.

    Parameters
    ----------
    model, engine, camera : as in `OnlineSmoother`
    lag : as in `OnlineSmoother`; decisions, too, may change within ``lag`` seconds
    scene : known parameters of birth, death, detection and clutter: `SceneParameters`, or some by name. The
        rest are those of the model, else learned from the detections
    walkable : as in `OnlineSmoother`; `forecast` predicts no path that leaves it
    constants : as in `OnlineSmoother`; the people of the scene so far are the prior of the next
    sensors : descriptions of sensors, by name or a file: a `SensorScene`. `update` removes their known errors
        from the observations, and their clock offset from the time: scans come in the order of true times,
        which the estimates have. Observations of sensors that move are taken as they are, in the world.
        Described fields of view and rates of detection are used for identities

    Attributes
    ----------
    revised : earlier results that the last update changed

    Examples
    --------
    >>> tracker = OnlineTracker("joint")
    >>> for k in range(4):
    ...     people = tracker.update(0.4 * k, [(0.5 * k, 0.0), (3.0 - 0.5 * k, 4.0)])
    >>> [(person.track_id, person.detection) for person in people]
    [(1, 0), (2, 1)]
    """

    def __init__(
        self,
        model: Model | str | Path | None = None,
        *,
        scene: GivenScene = None,
        engine: OnlineEngine = "auto",
        lag: float | None = 2.0,
        camera: GroundCamera | None = None,
        walkable: AreaLike | None = None,
        constants: Constants | None = None,
        sensors: SensorsLike | None = None,
    ) -> None:
        chosen = Model.named(model)
        area = None if walkable is None else WalkableArea.of(walkable)
        self._conversations = Conversations(chosen) if chosen.has_groups else None
        super().__init__(
            chosen,
            scene=scene,
            engine=engine,
            lag=lag,
            camera=camera,
            groups=self._conversations,
            walkable=area,
            constants=constants,
            sensors=NO_SENSORS if sensors is None else SensorScene.of(sensors),
        )
        self._scene = known_values(scene)
        self._forecaster: Forecaster | None = None
        self._frames: deque[tuple[Any, ...]] = deque(maxlen=_UNASKED)
        self._present: list[int] = []

    def __reduce__(self) -> tuple[Any, ...]:
        """Copy and pickle by `state`, with what it leaves out."""
        made = partial(OnlineTracker.from_state, **self._given)
        names = ("_frames", "_present", "revised", "newest", "corrects")
        left_out = {name: copy(getattr(self, name)) for name in names}
        return made, (self.state(),), left_out

    @property
    def _given(self) -> dict[str, Any]:
        own = {"model": self.model, "scene": self._scene, "sensors": dict(self._sensors)}
        return own | self._options

    def reset(self) -> None:
        """Begin again without the frames so far, as where a clock was set back; options are kept.

        New people get track ids that were not used.
        """
        first, corrects = self.next_number, self.corrects
        vars(self).update(vars(OnlineTracker(**self._given)))
        self.number_from(first)
        self.corrects = corrects

    def update(
        self,
        t: float,
        detections: Sequence[Observation] | FloatArray | Sequence[Sequence[float]],
        sensor: str | None = None,
    ) -> list[PersonEstimate]:
        """Add a frame's detections, as `DetectionTracker.update`; forecasts use them from then on.

        Of a person in scans of several sensors at one time, forecasts use the first position.
        """
        people = super().update(t, detections, sensor)
        t = self.t
        # Observed positions: a forecast estimates their noise itself.
        self._present = [one.track_id for one in people]
        latest, known = -math.inf, set[int]()
        if len(self.sensors) > 1:
            latest, known = self._observed_since(t - TIME_TOLERANCE)
        observed = [
            (one, self.newest[one.detection]) for one in people if one.observed and one.track_id not in known
        ]
        position = np.array([observation.position for _, observation in observed], float).reshape(-1, 2)
        std = np.array([observation.axis_std for _, observation in observed], float)  # None becomes NaN
        heads = [one.head if one.covariance[5, 5] < _KNOWN_HEAD**2 else math.nan for one, _ in observed]
        at = max(t, latest + BETWEEN_SCANS)  # forecasts take times that increase
        frame = at, [one.track_id for one, _ in observed], position, std, np.array(heads)
        if self._forecaster is None:
            self._frames.append(frame)
        else:
            self._forecaster.update(*frame)
        return people

    def _observed_since(self, t: float) -> tuple[float, set[int]]:
        """Return the time of the last frame for forecasts, and the people in those at a time or later."""
        if self._forecaster is not None:
            return self._forecaster.t, self._forecaster.observed_since(t)
        newest = list(takewhile(lambda frame: frame[0] >= t, reversed(self._frames)))
        latest = self._frames[-1][0] if self._frames else -math.inf
        return latest, {one for _, ids, *_ in newest for one in ids}

    @property
    def sensors(self) -> list[str]:
        """The names of the sensors so far; "" is one without a name."""
        return self._association.sensors

    def sensor_of(self, update: int) -> str:
        """Return the name of the sensor of an update with detections that can still be revised."""
        chains = self._association.chains
        place = int(np.searchsorted(chains.frame, update))
        return self.sensors[int(chains.sensor[place])]

    def forecast(
        self,
        horizon: float = 4.8,
        step: float = 0.4,
        *,
        samples: int = 0,
        random: np.random.Generator | None = None,
    ) -> Forecast:
        """Predict positions of all people in the last update with at least two observations.

        The first call processes the last 1,500 frames at most; from then on each update is added. From that
        call on `state` includes the forecasts' data.

        Parameters
        ----------
        horizon, step : every ``step`` seconds up to ``horizon``
        samples, random : as in `Forecaster.forecast`

        Raises
        ------
        InputError
            For invalid times, and before the first update.
        """
        ahead = times_ahead(horizon, step)
        if not self.updates:
            raise InputError("no frame", "an update before a forecast")
        if self._forecaster is None:
            self._forecaster = Forecaster(walkable=self._walkable)
            for frame in self._frames:
                self._forecaster.update(*frame)
            self._frames.clear()
        people = self._forecaster.known(self._present)
        return self._forecaster.forecast(ahead, people, samples=samples, random=random)

    def state(self) -> dict[str, Any]:
        """Return the complete state as JSON-able data; see `from_state`."""
        found = super().state()
        if self._conversations is not None:
            found[CONVERSATIONS] = self._conversations.state()
        if self._forecaster is not None:
            found |= {"forecaster": self._forecaster.state(), "present": self._present}
        return found

    def restore(self, state: Mapping[str, Any]) -> None:
        """Take over a `state`."""
        super().restore(state)
        if self._conversations is not None:
            self._conversations.restore(state[CONVERSATIONS])
        if "forecaster" in state:
            self._forecaster = Forecaster.from_state(state["forecaster"], walkable=self._walkable)
            self._present = list(map(integer, state["present"]))
