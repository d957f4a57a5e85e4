"""Trackers of many people behind one protocol: who is who, from detections alone."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Protocol

import numpy as np

from graphtrack.association.detections import Detections
from graphtrack.association.recorded import track_rows
from graphtrack.association.rows import associated
from graphtrack.baselines.hungarian import HungarianParameters, track_detections
from graphtrack.errors import InputError
from graphtrack.evaluation.tracking.peers import TUNED, PeerName, PeerParameters, load, track_boxes
from graphtrack.inference.solution import Solution
from graphtrack.model import Model
from graphtrack.smoothing.recording import solve
from graphtrack.smoothing.tracker import OnlineTracker
from graphtrack.table.rows import Rows
from graphtrack.tracks import TrackSet

TRACKERS = ("associate", "online", "hungarian")
"""Those that need no other package."""


class TrackingMethod(Protocol):
    """What finds out who is who.

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
        """Whether what it says of a frame depends on what came before alone."""

    @property
    def information(self) -> str:
        """What it does, in words."""

    def track(self, detections: Detections) -> TrackSet:
        """The people, from detections of a whole recording, which an online method reads frame by frame."""


@dataclass(frozen=True)
class Associated:
    """`associate`, then the smoother, as `graphtrack smooth` has them one after the other."""

    model: Model

    name = "associate"
    online = False
    information = "past and future; smoothed, gaps filled"

    def track(self, detections: Detections) -> TrackSet:
        """All people at once, each from first to last."""
        try:
            found = associated(_rows(detections), self.model.scene)
        except InputError:  # of detections, which have places and times: nobody is there
            return TrackSet(())
        return smoothed(found, self.model)


@dataclass(frozen=True)
class Online:
    """`OnlineTracker`, as `graphtrack track` has it: what it said at once."""

    model: Model

    name = "online"
    online = True
    information = "past only; predicted while probably there"

    def track(self, detections: Detections) -> TrackSet:
        """Frame by frame."""
        try:
            return track_rows(_rows(detections), OnlineTracker(self.model))
        except InputError:  # nobody was said to be there
            return TrackSet(())


@dataclass(frozen=True)
class Hungarian:
    """Our plain Kalman filter and Hungarian method."""

    parameters: HungarianParameters = field(default_factory=HungarianParameters)

    name = "hungarian"
    online = True

    @property
    def information(self) -> str:
        """What it reports of those who are not seen."""
        return f"past only; predicted for up to {self.parameters.coasting:g} s"

    def track(self, detections: Detections) -> TrackSet:
        """Frame by frame."""
        return track_detections(detections, self.parameters)


@dataclass(frozen=True)
class Peer:
    """A tracker of the package ``trackers``; see `graphtrack.evaluation.tracking.peers`."""

    name: PeerName
    parameters: PeerParameters

    online = True
    information = "past only; boxes, where they were detected"

    def track(self, detections: Detections) -> TrackSet:
        """Frame by frame.

        Raises
        ------
        InputError
            If the package is not installed.
        """
        make, boxes_of = load(self.name)
        return track_boxes(detections, self.parameters, make, boxes_of)


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
        "associate": Associated,
        "online": Online,
        "hungarian": lambda model: Hungarian(),
        "bytetrack": lambda model: Peer("bytetrack", TUNED["bytetrack"]),
        "ocsort": lambda model: Peer("ocsort", TUNED["ocsort"]),
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
