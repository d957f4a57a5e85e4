"""Recorded tracks online: at each frame what was known then."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, overload

import numpy as np

from graphtrack.geometry.camera import GroundCamera
from graphtrack.inference.online import OnlineEngine, OnlineSmoother
from graphtrack.inference.state import Estimate
from graphtrack.io.given import tracks_of
from graphtrack.model import Model
from graphtrack.model.observation import observations
from graphtrack.tracks import Track, TrackSet

if TYPE_CHECKING:
    from graphtrack.io.given import Given, Scene


@overload
def track_online(
    tracks: Track,
    model: Model | str | Path | None = None,
    *,
    engine: OnlineEngine = "auto",
    lag: float | None = 2.0,
    camera: GroundCamera | None = None,
) -> Track: ...


@overload
def track_online(
    tracks: Scene,
    model: Model | str | Path | None = None,
    *,
    engine: OnlineEngine = "auto",
    lag: float | None = 2.0,
    camera: GroundCamera | None = None,
) -> TrackSet: ...


def track_online(
    tracks: Given,
    model: Model | str | Path | None = None,
    *,
    engine: OnlineEngine = "auto",
    lag: float | None = 2.0,
    camera: GroundCamera | None = None,
) -> TrackSet | Track:
    """The online estimates of recorded tracks: at each frame, from what came before. NaN while waiting.

    Parameters
    ----------
    tracks : a `Track`, of which a `Track` comes out, or what `solve` takes, of which a `TrackSet` does
    model, engine, lag : as in `OnlineSmoother`
    camera : camera of the scene; by default that of the `TrackSet`

    Raises
    ------
    InputError
        For a file of detections without identities too: who is who is found out from past and future by
        `associate`, and from the past alone by `OnlineTracker`.
    """
    if not isinstance(tracks, Track):
        scene, chosen = tracks_of(tracks, associate="never"), Model.named(model)
        camera = scene.camera if camera is None else camera
        return scene.map(lambda one: track_online(one, chosen, engine=engine, lag=lag, camera=camera))
    smoother = OnlineSmoother(model, engine=engine, lag=lag, camera=camera)
    return as_track(
        tracks, [smoother.update(observation) for observation in observations(tracks)], smoother.model
    )


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
    )
