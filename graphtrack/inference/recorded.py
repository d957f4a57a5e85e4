"""Recorded tracks online: at each frame what was known then."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import partial
from operator import itemgetter
from pathlib import Path
from typing import TYPE_CHECKING, Any, overload

import numpy as np

from graphtrack.association.reading import tracks_of
from graphtrack.geometry.camera import GroundCamera
from graphtrack.inference.conversations import Conversations
from graphtrack.inference.online import OnlineSmoother
from graphtrack.inference.online_engines import OnlineEngine
from graphtrack.inference.social import lacks_groups
from graphtrack.inference.state import Estimate
from graphtrack.model import Model
from graphtrack.model.observation import observations
from graphtrack.tracks import Track, TrackSet

if TYPE_CHECKING:
    from graphtrack.io.given import Given, Scene

Progress = Callable[[int], None]
Options = dict[str, Any]
"""Of an `OnlineSmoother`."""


@overload
def track_online(
    tracks: Track,
    model: Model | str | Path | None = None,
    *,
    engine: OnlineEngine = "auto",
    lag: float | None = 2.0,
    camera: GroundCamera | None = None,
    progress: Progress = ...,
    **reading: Any,
) -> Track: ...


@overload
def track_online(
    tracks: Scene,
    model: Model | str | Path | None = None,
    *,
    engine: OnlineEngine = "auto",
    lag: float | None = 2.0,
    camera: GroundCamera | None = None,
    progress: Progress = ...,
    **reading: Any,
) -> TrackSet: ...


def track_online(
    tracks: Given,
    model: Model | str | Path | None = None,
    *,
    engine: OnlineEngine = "auto",
    lag: float | None = 2.0,
    camera: GroundCamera | None = None,
    progress: Progress = lambda frames: None,
    **reading: Any,
) -> TrackSet | Track:
    """The online estimates of recorded tracks: at each frame, from what came before. NaN while waiting.

    With the model "social" the tracks of a scene are tracked in step, and their groups are found on the way,
    where no track has the input ``group``.

    Parameters
    ----------
    tracks : a `Track`, of which a `Track` comes out, or what `solve` takes, of which a `TrackSet` does
    model, engine, lag : as in `OnlineSmoother`
    camera : camera of the scene; by default that of the `TrackSet`
    progress : called with the numbers of person-frames that are done
    **reading : options of `read`, where ``tracks`` is a path or a table, such as ``fps``

    Raises
    ------
    InputError
        For a file of detections without identities too: who is who is found out from past and future by
        `associate`, and from the past alone by `OnlineTracker`.
    """
    if not isinstance(tracks, Track) or reading:
        scene, chosen = tracks_of(tracks, **{"associate": "never", **reading}), Model.named(model)
        camera = scene.camera if camera is None else camera
        options: Options = {"engine": engine, "lag": lag, "camera": camera}
        if chosen.has_groups and lacks_groups(scene):
            return _in_step(scene, chosen, options, progress)
        return scene.map(lambda one: _by_itself(one, chosen, options, progress))
    return _by_itself(tracks, Model.named(model), {"engine": engine, "lag": lag, "camera": camera}, progress)


def _by_itself(track: Track, model: Model, options: Options, progress: Progress) -> Track:
    smoother = OnlineSmoother(model, **options)
    found = [smoother.update(observation) for observation in observations(track)]
    progress(len(track))
    return as_track(track, found, model)


def _in_step(scene: TrackSet, model: Model, options: Options, progress: Progress) -> TrackSet:
    """Everybody frame by frame, each told of the conversations of the frames before."""
    conversations = Conversations(model)
    people = [OnlineSmoother(model, **options) for _ in scene]
    found: list[list[Estimate]] = [[] for _ in scene]
    seen = [((one.t, place), one) for place, track in enumerate(scene) for one in observations(track)]
    for (_, place), observation in sorted(seen, key=itemgetter(0)):
        track_id = scene.tracks[place].track_id
        estimate = people[place].update(conversations.observed(track_id, observation))
        conversations.estimated(track_id, estimate)
        found[place].append(estimate)
        progress(1)
    return scene.with_tracks(map(partial(as_track, model=model), scene, found))


def as_track(track: Track, estimates: Iterable[Estimate], model: Model) -> Track:
    """A track of online estimates, one for each frame of the recorded one."""
    found = list(estimates)
    return track.with_estimates(
        position=np.array([e.position for e in found]),
        velocity=np.array([e.velocity for e in found]),
        body=np.array([e.body for e in found]) if model.has_body else None,
        head=np.array([e.head for e in found]) if model.has_head else None,
        covariance=np.array([e.covariance for e in found]),
        aligned_p=np.array([e.aligned_p for e in found]) if model.has_modes else None,
        gait_offset=np.array([e.gait_offset for e in found]) if model.has_modes else None,
        glance_p=np.array([e.glance_p for e in found]) if model.has_modes else None,
    )
