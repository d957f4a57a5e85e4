"""Detections: observations in each frame, without identities."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray
from graphtrack.tracks.sensors import Sensor

APPEARANCE = "input_appearance"
"""The channel of appearance descriptors, (n, d)."""


@dataclass(frozen=True, eq=False)
class Detections:
    """n detections of one scene, in the order of their times; in any order within a frame.

    Attributes
    ----------
    frame : (n,) int64, equal for detections at one time
    t : (n,) seconds
    position : (n, 2) metres on the ground plane
    channels : further observed attributes of a `Track`, by name, (n, …); and ``box`` (n, 4), left, top, width
        and height in pixels, for trackers of boxes
    row : (n,) index of each in the input
    sensor : (n,) number of its sensor
    scans : (n, s) scans of each of several sensors before its own; a frame is then a scan of one of them.
        (n, 0): one sensor
    views : (n, s) probability that its place is in the field of view of each
    sensors : descriptions of the s sensors; (): none
    """

    frame: NDArray[np.int64]
    t: FloatArray
    position: FloatArray
    channels: Mapping[str, FloatArray] = field(default_factory=dict)
    row: NDArray[np.int64] = field(default_factory=lambda: np.zeros(0, np.int64))
    sensor: NDArray[np.int64] = field(default_factory=lambda: np.zeros(0, np.int64))
    scans: FloatArray = field(default_factory=lambda: np.zeros((0, 0)))
    views: FloatArray = field(default_factory=lambda: np.zeros((0, 0)))
    sensors: tuple[Sensor, ...] = ()

    def __post_init__(self) -> None:
        n = len(self.t)
        if not n:
            raise InputError("no detections", "at least one")
        if not np.isfinite(self.position).all() or not np.isfinite(self.t).all():
            raise InputError("a detection without a position or a time", "both, for each")
        order = np.lexsort((np.arange(n), self.t))
        row = self.row if len(self.row) == n else np.arange(n)
        known = {"frame": self.frame, "t": self.t, "position": self.position, "row": row}
        known["sensor"] = self.sensor if len(self.sensor) == n else np.zeros(n, np.int64)
        known |= {"scans": self.scans if len(self.scans) == n else np.zeros((n, 0))}
        known |= {"views": self.views if len(self.views) == n else np.ones(known["scans"].shape)}
        for name, values in known.items():
            object.__setattr__(self, name, np.asarray(values)[order])
        object.__setattr__(self, "channels", {name: v[order] for name, v in self.channels.items()})

    def __len__(self) -> int:
        return len(self.t)

    def taken(self, rows: NDArray[np.int64]) -> Detections:
        """Return the detections at some indices."""
        channels = {name: values[rows] for name, values in self.channels.items()}
        frame, t, position = self.frame[rows], self.t[rows], self.position[rows]
        of_sensors = self.sensor[rows], self.scans[rows], self.views[rows], self.sensors
        return Detections(frame, t, position, channels, self.row[rows], *of_sensors)

    @property
    def of_main_sensor(self) -> Detections:
        """Return the detections of the sensor that has most, with its own frames; all of one sensor alone."""
        if not self.scans.shape[1]:
            return self
        main = int(np.bincount(self.sensor).argmax())
        own = np.flatnonzero(self.sensor == main)
        alone = self.taken(own)
        return replace(
            alone,
            frame=alone.scans[:, main].astype(np.int64),
            sensor=np.zeros(len(own), np.int64),
            scans=np.zeros((len(own), 0)),
            views=np.zeros((len(own), 0)),
            sensors=(),
        )

    @property
    def step(self) -> NDArray[np.int64]:
        """Return (n,) the number of each detection's frame, in steps of the recording from the first."""
        apart = 1 if self.scans.shape[1] else frames_between(self.frame)
        return (self.frame - self.frame[0]) // apart

    @property
    def step_seconds(self) -> float:
        """Return the usual interval between frames, seconds."""
        steps, first = np.unique(self.step, return_index=True)
        if len(steps) < 2:
            return 1.0
        if self.scans.shape[1]:
            return float((self.t[-1] - self.t[0]) / (steps[-1] - steps[0]))
        return float(np.median(np.diff(self.t[first]) / np.maximum(np.diff(steps), 1)))


_MOST, _MOST_TIMES = 1_000_000, 100  # frames, or times as many as there are with detections


def with_those_between(frames: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the increasing frames (n,), with frames between them that have no detections.

    Raise InputError if these are so many that the numbers cannot count time.
    """
    step = frames_between(frames)
    count = int(frames[-1] - frames[0]) // step if len(frames) else 0
    if count > max(_MOST, _MOST_TIMES * len(frames)):
        found = f"{len(frames)} frames from {frames[0]} to {frames[-1]}, {step} apart"
        raise InputError(found, f"at most {_MOST_TIMES} times as many, or frame numbers that count time")
    between = [np.arange(a, b, step) for a, b in pairwise(frames.tolist())]
    return np.unique(np.concatenate([frames, *between]))


def frames_between(frame: NDArray[np.int64]) -> int:
    """Return the most frequent step between neighbouring frame numbers, such as 10."""
    apart, counts = np.unique(np.diff(np.unique(frame)), return_counts=True)
    return int(apart[counts.argmax()]) if len(apart) else 1
