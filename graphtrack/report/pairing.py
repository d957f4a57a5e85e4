"""An estimated track beside the observations it came from, frame by frame."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from graphtrack.geometry.angles import FloatArray
from graphtrack.tracks import Track, TrackSet


@dataclass(frozen=True, eq=False)
class Pair:
    """One person's estimate with, where there are any, the observations.

    Attributes
    ----------
    estimate : Track
    observation : Track or None
    seen : (n,) bool
        Whether the position was observed at each frame of the estimate; without observations what the
        estimate says of it itself, None if nothing.
    seen_position : (n, 2) metres, the observed position at the frames of the estimate; NaN where not observed
    seen_body, seen_head : (n,) radians, the observed angles (`observed_angle`) there; NaN where not observed
    true_position, true_body, true_head : (n, 2), (n,), (n,)
        The truth at the frames of the estimate, from either track; NaN where it is not known.
    """

    estimate: Track
    observation: Track | None
    seen: NDArray[np.bool_] | None
    seen_position: FloatArray
    seen_body: FloatArray
    seen_head: FloatArray
    true_position: FloatArray
    true_body: FloatArray
    true_head: FloatArray

    @property
    def label(self) -> str:
        """The person's label, of either track; empty where there is none."""
        return self.estimate.label or (self.observation.label if self.observation is not None else "")

    @property
    def name(self) -> str:
        """The name to display: the id, and the label if there is one."""
        return f"person {self.estimate.track_id}" + (f" ({self.label})" if self.label else "")

    def true_angle(self, name: str) -> FloatArray:
        """The true ``body`` or ``head`` (radians, (n,))."""
        return self.true_body if name == "body" else self.true_head


def pair_track(estimate: Track, observation: Track | None = None) -> Pair:
    """Align the observations and the truth of one person with the frames of the estimate."""
    n = len(estimate)
    seen_position = np.full((n, 2), np.nan)
    seen: NDArray[np.bool_] | None = None
    if observation is None and estimate.observed is not None:
        seen = np.asarray(estimate.observed != 0.0)
    if observation is not None:
        seen_position = _at_frames(observation.position, observation, estimate)
        seen = finite_rows(seen_position)
        if observation.pixel is not None:
            # A foot point in the image is an observation too, though it has no place on the ground plane yet.
            seen |= finite_rows(_at_frames(observation.pixel, observation, estimate))

    def truth(name: str, shape: tuple[int, ...]) -> FloatArray:
        own = getattr(estimate, name)
        if own is not None:
            return np.asarray(own)
        other = None if observation is None else getattr(observation, name)
        if observation is None or other is None:
            return np.full(shape, np.nan)
        return _at_frames(other, observation, estimate)

    def seen_angle(name: str) -> FloatArray:
        observed = None if observation is None else observed_angle(observation, name)
        if observation is None or observed is None:
            return np.full(n, np.nan)
        return _at_frames(observed, observation, estimate)

    return Pair(
        estimate=estimate,
        observation=observation,
        seen=seen,
        seen_position=seen_position,
        seen_body=seen_angle("body"),
        seen_head=seen_angle("head"),
        true_position=truth("true_position", (n, 2)),
        true_body=truth("true_body", (n,)),
        true_head=truth("true_head", (n,)),
    )


def pair_tracks(estimates: TrackSet, observations: TrackSet | None = None) -> tuple[Pair, ...]:
    """Pair every estimate with the observations of the same ``track_id``, in the order of the estimates."""
    by_id = {} if observations is None else {track.track_id: track for track in observations}
    return tuple(pair_track(estimate, by_id.get(estimate.track_id)) for estimate in estimates)


def observed_angle(track: Track, name: str) -> FloatArray | None:
    """The observed ``body`` or ``head`` (radians, (n,)); None when the track has no such channel.

    Where only class likelihoods were observed, the centre of the likeliest class stands for the angle.
    """
    angle = getattr(track, name)
    likelihood = getattr(track, f"{name}_likelihood")
    if likelihood is None:
        return None if angle is None else np.asarray(angle)
    scored = finite_rows(likelihood)
    best = np.full(len(track), np.nan)
    best[scored] = np.argmax(likelihood[scored], axis=1) * (2.0 * np.pi / likelihood.shape[1])
    best = np.where(best > np.pi, best - 2.0 * np.pi, best)
    return best if angle is None else np.where(np.isfinite(angle), angle, best)


def has_angle(pair: Pair, name: str) -> bool:
    """True if ``body`` or ``head`` is known anywhere, as an estimate or as an observation."""
    values = [getattr(pair.estimate, name)]
    if pair.observation is not None:
        values.append(observed_angle(pair.observation, name))
    return any(value is not None and np.isfinite(value).any() for value in values)


def finite_rows(values: FloatArray) -> NDArray[np.bool_]:
    """Which rows of (n, k) values are finite throughout."""
    return np.asarray(np.isfinite(values).all(axis=1), dtype=bool)


def _at_frames(values: FloatArray, source: Track, target: Track) -> FloatArray:
    """``values`` of ``source`` at the frames of ``target``; NaN at frames that ``source`` does not have."""
    out = np.full((len(target), *values.shape[1:]), np.nan)
    _, there, here = np.intersect1d(source.frame, target.frame, assume_unique=True, return_indices=True)
    out[here] = values[there]
    return out
