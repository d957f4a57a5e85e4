"""The recordings as the experiments take them: some of the frames, some of the clips."""

from __future__ import annotations

import warnings
from functools import cache
from pathlib import Path

import numpy as np

from graphtrack.errors import InputWarning
from graphtrack.io import read
from graphtrack.tracks import Track, TrackSet

MOCAP = ("mocap", "tracks_30hz.csv.gz")
SALSA = ("salsa", "features.txt")
CAVIAR = ("caviar", "xml", "mws1gt.xml")

WALKING = "*_walk_*"
TURNING = "*_walk-turn-*"
ASKANCE = ("*_walk-left_*", "*_walk-right_*", "*_walk-back_*")
"""Patterns of the labels of mocap clips: walking ahead, turning, and side-stepping or walking backwards."""

EVERY = 3
"""Motion capture is thinned from 30 to 10 frames a second."""


@cache
def quietly(path: Path) -> TrackSet:
    """The tracks of a file, read once; what its reader has to say is left to ``graphtrack info``."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", InputWarning)
        return read(path)


def thinned(track: Track, every: int = EVERY) -> Track:
    """Every third frame, or every ``every``-th."""
    return track[np.arange(0, len(track), every)]


def evenly(tracks: TrackSet, count: int, least_seconds: float = 0.0) -> TrackSet:
    """At most ``count`` of the tracks that last long enough, evenly spread over the set."""
    long = [track for track in tracks if track.t[-1] - track.t[0] >= least_seconds]
    if len(long) > count:
        long = [long[i] for i in np.linspace(0, len(long) - 1, count).round().astype(int)]
    return tracks.with_tracks(long)
