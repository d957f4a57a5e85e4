"""How often a detection is right: judged by tracks that have not seen its frame."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment
from scipy.special import expit, logit

from graphtrack.geometry.angles import FloatArray
from graphtrack.smoothing import smooth
from graphtrack.tracks import TrackSet

_PARTS = 3
"""Every third frame is left out at a time."""
_LEAST_SEEN = 3
"""Detections in other frames, for a track to say where somebody is."""
_ORDER = 1e-3
"""Slope beyond the ends: what is likelier stays likelier."""


@dataclass(frozen=True, eq=False)
class Certainty:
    """How often it is a person at some log odds that a model says: isotonic, and linear in between.

    Attributes
    ----------
    said, found : (k,) log odds, increasing
    """

    said: FloatArray
    found: FloatArray

    @classmethod
    def fitted(cls, said: FloatArray, truth: NDArray[np.bool_]) -> Self:
        """Of log odds (n,) and whether it was a person (n,): blocks of equal frequency, by their means."""
        from sklearn.isotonic import IsotonicRegression

        least = 1.0 / (len(truth) + 2)
        model = IsotonicRegression(y_min=least, y_max=1.0 - least)
        frequency, block = np.unique(model.fit_transform(said, truth.astype(float)), return_inverse=True)
        means = np.bincount(block, said) / np.bincount(block)
        return cls(means, np.asarray(logit(frequency), float))

    def of(self, log_odds: FloatArray) -> FloatArray:
        """Probabilities (n,) of log odds (n,), in the same order."""
        beyond = log_odds - np.clip(log_odds, self.said[0], self.said[-1])
        return np.asarray(expit(np.interp(log_odds, self.said, self.found) + _ORDER * beyond), float)

    def to_record(self) -> dict[str, Any]:
        """As JSON knows it."""
        return {"said": self.said.tolist(), "found": self.found.tolist()}

    @classmethod
    def from_record(cls, values: dict[str, Any]) -> Self:
        """The inverse of `to_record`; ``ValueError``, ``TypeError`` or ``KeyError`` for anything else."""
        said, found = (np.array(values[name], float) for name in ("said", "found"))
        if said.ndim != 1 or not len(said) or said.shape != found.shape:
            raise ValueError("log odds of other shapes")
        return cls(said, found)


def judged_by_other_frames(
    frame: NDArray[np.int64],
    place: FloatArray,
    tracks: TrackSet,
    *,
    radius: float,
    least_boxes: int,
    least_way: float,
) -> FloatArray:
    """Whether detections are of people (n,): 1, 0, or NaN where that is not known.

    A track is smoothed without the frame, so that it does not follow the detection that it judges: a
    detection that lies off is none of a person.

    Parameters
    ----------
    frame, place : (n,), (n, 2) metres, of each detection
    tracks : of detections
    radius : metres, within which a detection is of a track
    least_boxes, least_way : detections, and metres from its first to its last place, of a track that is
        surely a person's
    """
    known = _places(tracks, least_boxes, least_way)
    right = np.full(len(frame), np.nan)
    for number in np.unique(frame).tolist():
        rows = np.flatnonzero(frame == number)
        there = known.get(number, [])
        at = np.array([where for where, _ in there]).reshape(-1, 2)
        sure = np.array([certain for _, certain in there], bool)
        away = np.linalg.norm(place[rows][:, None] - at, axis=2)
        near = away < radius
        # Nobody's: where no track is, and what is too many about those that are sure.
        right[rows[~near[:, ~sure].any(axis=1)]] = 0.0
        one, track = linear_sum_assignment(np.minimum(away, 2.0 * radius))
        good = near[one, track]
        right[rows[one[good]]] = np.where(sure[track[good]], 1.0, np.nan)
    return right


_Places = dict[int, list[tuple[FloatArray, bool]]]
"""By frame: where each track is, and whether it is surely a person's and seen before and after."""


def _places(tracks: TrackSet, least_boxes: int, least_way: float) -> _Places:
    frames = np.unique(np.concatenate([track.frame for track in tracks]))
    found: _Places = {}
    for part in range(_PARTS):
        left_out = frames[part::_PARTS]
        rest, seen = _without(tracks, left_out)
        for track in smooth(tracks.with_tracks(rest), "position") if rest else ():
            boxes, first, last = seen[track.track_id]
            way = float(np.linalg.norm(track.position[-1] - track.position[0]))
            person = boxes >= least_boxes and way >= least_way
            for k in np.flatnonzero(np.isin(track.frame, left_out)).tolist():
                number = int(track.frame[k])
                between = first < number < last
                found.setdefault(number, []).append((track.position[k], person and between))
    return found


def _without(
    tracks: TrackSet, left_out: Sequence[int] | NDArray[np.int64]
) -> tuple[list[Any], dict[int, tuple[int, int, int]]]:
    """Tracks that have not seen some frames; how often each was seen in all, and first and last in others."""
    rest, seen = [], {}
    for track in tracks:
        detected = np.isfinite(track.position).all(axis=1)
        other = detected & ~np.isin(track.frame, left_out)
        if int(other.sum()) < _LEAST_SEEN:
            continue
        rest.append(replace(track, position=np.where(other[:, None], track.position, np.nan)))
        at = track.frame[other]
        seen[track.track_id] = int(detected.sum()), int(at[0]), int(at[-1])
    return rest, seen
