"""Trackers of many people behind one protocol: who is who, from detections alone."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import Protocol

import numpy as np

from graphtrack.association.recorded import track_rows
from graphtrack.association.rows import associated
from graphtrack.baselines.hungarian import HungarianParameters, track_detections
from graphtrack.errors import InputError
from graphtrack.evaluation.tracking.peers import TUNED, PeerName, load, track_boxes
from graphtrack.inference.solution import Solution
from graphtrack.model import Model
from graphtrack.smoothing.recording import solve
from graphtrack.smoothing.tracker import OnlineTracker
from graphtrack.table.detections import Detections
from graphtrack.table.rows import Rows
from graphtrack.tracks import TrackSet

TRACKERS = ("associate", "online", "hungarian")
"""Those that need no other package."""


class TrackingMethod(Protocol):
    """A tracker of many people.

    Attributes
    ----------
    name : short and unique
    online : whether it says of a frame who is who before it sees the next one, and never changes that
    information : what it does, in words
    """

    @property
    def name(self) -> str:
        """Short and unique."""

    @property
    def online(self) -> bool:
        """True if the output of a frame depends on the past alone."""

    @property
    def information(self) -> str:
        """A description in words."""

    def track(self, detections: Detections) -> TrackSet:
        """The people, from detections of a whole recording, which an online method reads frame by frame."""


@dataclass(frozen=True)
class FunctionTracker:
    """A tracker made of a function of detections."""

    name: str
    online: bool
    information: str
    function: Callable[[Detections], TrackSet]

    def track(self, detections: Detections) -> TrackSet:
        """The function's tracks."""
        return self.function(detections)


def _associate(model: Model) -> FunctionTracker:
    """`associate`, then the smoother, as `graphtrack smooth` has them one after the other."""

    def track(detections: Detections) -> TrackSet:
        try:
            found = associated(_rows(detections), model.scene)
        except InputError:  # of detections, which have places and times: nobody is there
            return TrackSet(())
        return smoothed(found, model)

    return FunctionTracker("associate", False, "past and future; smoothed, gaps filled", track)


def _online(model: Model) -> FunctionTracker:
    """`OnlineTracker`, as `graphtrack track` has it: its first answers."""

    def track(detections: Detections) -> TrackSet:
        try:
            return track_rows(_rows(detections), OnlineTracker(model))
        except InputError:  # nobody was reported
            return TrackSet(())

    return FunctionTracker("online", True, "past only; predicted while probably there", track)


def _hungarian(model: Model) -> FunctionTracker:
    """Our plain Kalman filter and Hungarian method."""
    parameters = HungarianParameters()
    information = f"past only; predicted for up to {parameters.coasting:g} s"
    track = partial(track_detections, parameters=parameters)
    return FunctionTracker("hungarian", True, information, track)


def _peer(name: PeerName) -> FunctionTracker:
    """A tracker of the package ``trackers``; an `InputError` when it runs where that is not installed."""

    def track(detections: Detections) -> TrackSet:
        return track_boxes(detections, TUNED[name], *load(name))

    return FunctionTracker(name, True, "past only; boxes, where they were detected", track)


def _rows(detections: Detections) -> Rows:
    """Detections as a reader makes them."""
    seen = {"t": detections.t, "position": detections.position}
    channels = {name: values for name, values in detections.channels.items() if name != "box"}
    nobody = np.full(len(detections), -1)
    return Rows(
        Path("detections"),
        "memory",
        nobody,
        detections.frame,
        channels | seen,
        line_of=lambda row: row + 1,
        has_identity=False,
    )


def smoothed(tracks: TrackSet, model: Model) -> TrackSet:
    """Tracks smoothed, their gaps filled; one that cannot be smoothed stays as it is."""
    found = solve(tracks, model)
    return tracks.with_tracks(
        one.track if isinstance(one, Solution) else track for one, track in zip(found, tracks, strict=True)
    )


registry: Mapping[str, Callable[[Model], TrackingMethod]] = MappingProxyType(
    {
        "associate": _associate,
        "online": _online,
        "hungarian": _hungarian,
        "bytetrack": lambda model: _peer("bytetrack"),
        "ocsort": lambda model: _peer("ocsort"),
    }
)
"""Name → factory of the method, for the model that smooths. Another method is another line here."""


def make_tracker(method: TrackingMethod | str, model: Model) -> TrackingMethod:
    """A method from its name in `registry`; a method is returned as it is.

    Raises
    ------
    InputError
        For an unknown name.
    """
    if not isinstance(method, str):
        return method
    if method not in registry:
        raise InputError(f"method {method!r}", f"with --truth one of {', '.join(registry)}")
    return registry[method](model)
