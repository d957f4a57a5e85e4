"""Detections chained to tracks, and a scene's parameters, as compiled functions read them."""

from __future__ import annotations

from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from graphtrack.geometry.angles import FloatArray

IntArray = NDArray[np.int64]

STATE = 11
"""Numbers in a filtered state: x, y, vx, vy, the covariance p, pv, v of each axis, and the directions of body
and head as vectors (x, y) whose length is their concentration; 0: not known."""
BODY, HEAD = 7, 9
"""Places of the last two."""


class Scene(NamedTuple):
    """`SceneParameters.packed`."""

    density: float
    speed_variance: float
    jump_probability: float
    jump_variance: float
    log_missed: float
    log_hidden: float
    hidden_seconds: float
    log_birth: float
    log_death: float
    longest_gap: float
    frame_seconds: float
    look_ahead: float
    body_variance: float
    body_turn: float  # variance a second
    body_outliers: float
    head_variance: float
    head_turn: float
    head_outliers: float
    heading_variance: float
    gaze_variance: float
    looks_offset: float = 0.0
    looks_slope: float = 0.0
    looks_outliers: float = 1.0
    trust: float = 0.0  # log odds that two detections of one given identity are one person's


DETECTION = np.dtype(
    [
        ("t", float),  # seconds
        ("frame", np.int64),  # in steps of the recording
        ("x", float),  # metres
        ("y", float),
        ("variance", float),  # m² of each axis
        ("gain", float),  # log of how much more likely as a person's than as a false one, position aside
        ("birth", float),  # log of how many times the mean rate people come into view there
        ("death", float),  # the same of those who leave
        ("body", float),  # radians, observed; NaN: not observed
        ("head", float),
        ("given", np.int64),  # identity that somebody gave it and that mostly is right; −1: none
        ("following", np.int64),  # the next detection of the same person, or −1
        ("preceding", np.int64),  # the one before, or −1
        ("evidence", float),  # of the detection given those before
        ("total", float),  # of the track up to there
        ("rest", float),  # of the track from there on, to its end: as it was when a sweep began
    ]
)
"""A detection as kernels read it: one record, since each array that they are handed costs some time."""


Row: TypeAlias = Any
"""One record of `DETECTION`, as kernels read it; type checkers know nothing of its fields."""


class Chains(NamedTuple):
    """n detections in the order of time, and the tracks that they are chained to.

    What is asked of all records at once is an attribute, (n,): ``chains.following``; it is a view of them.
    """

    rows: NDArray[np.void]  # (n,) of DETECTION
    state: FloatArray  # (n, STATE) filtered there, see `STATE`
    looks: FloatArray  # (n, d) whitened descriptors, NaN where one is missing; (n, 0) where there are none

    @property
    def t(self) -> FloatArray:
        """(n,) seconds."""
        return self.rows["t"]

    @property
    def frame(self) -> IntArray:
        """(n,) in steps of the recording."""
        return self.rows["frame"]

    @property
    def variance(self) -> FloatArray:
        """(n,) m² of each axis."""
        return self.rows["variance"]

    @property
    def gain(self) -> FloatArray:
        """(n,) see `DETECTION`."""
        return self.rows["gain"]

    @property
    def birth(self) -> FloatArray:
        """(n,) log of a rate."""
        return self.rows["birth"]

    @property
    def death(self) -> FloatArray:
        """(n,) log of a rate."""
        return self.rows["death"]

    @property
    def given(self) -> IntArray:
        """(n,) identities, or −1."""
        return self.rows["given"]

    @property
    def following(self) -> IntArray:
        """(n,) the next detection, or −1."""
        return self.rows["following"]

    @property
    def preceding(self) -> IntArray:
        """(n,) the one before, or −1."""
        return self.rows["preceding"]

    @property
    def position(self) -> FloatArray:
        """(n, 2) metres, a copy."""
        return np.column_stack([self.rows["x"], self.rows["y"]])

    @property
    def facing(self) -> FloatArray:
        """(n, 2) radians, observed body and head, a copy."""
        return np.column_stack([self.rows["body"], self.rows["head"]])


def unlinked(t: FloatArray, frame: IntArray, position: FloatArray, facing: FloatArray) -> Chains:
    """Detections that are nobody's yet; their variances, gains and looks are to be set.

    Parameters
    ----------
    t, frame, position : (n,) seconds, (n,) steps of the recording, (n, 2) metres
    facing : (n, 2) radians, observed body and head; NaN: not observed
    """
    rows = np.zeros(len(t), DETECTION)
    rows["t"], rows["frame"] = t, frame
    rows["x"], rows["y"] = position.T
    rows["body"], rows["head"] = facing.T
    for name in ("given", "following", "preceding"):
        rows[name] = -1
    return Chains(rows, np.zeros((len(t), STATE)), np.empty((len(t), 0)))


def link_by(chains: Chains, identity: IntArray) -> None:
    """Chain the detections of each identity in the order of time; of two in a frame only one; −1: none."""
    order = np.lexsort((np.arange(len(identity)), identity))
    before, after = order[:-1], order[1:]
    same = (identity[before] == identity[after]) & (identity[after] >= 0)
    same &= chains.frame[after] > chains.frame[before]
    chains.following[before[same]] = after[same]
    chains.preceding[after[same]] = before[same]
