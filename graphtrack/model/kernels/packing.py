"""From tracks to the arrays that the kernels read: all frames of some tracks, one after another."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from graphtrack.geometry.angles import FloatArray
from graphtrack.geometry.camera import GroundCamera
from graphtrack.model.kernels.frames import FRAME, SHARED
from graphtrack.tracks import BODY_CLASSES, HEAD_CLASSES, Track


@dataclass(eq=False)
class PackedTracks:
    """The observations of some tracks end to end, and the records that terms fill in.

    Attributes
    ----------
    tracks : the tracks
    camera : camera of the scene, for the pixel likelihood
    offsets : (m + 1,) where each track begins, and the end
    records : (N,) of `FRAME`
    shared : (1,) of `SHARED`
    body_heights, head_heights : (N, classes + 1) class likelihoods and, last, the outliers' part
    """

    tracks: Sequence[Track]
    camera: GroundCamera | None
    offsets: NDArray[np.int64]
    records: NDArray[np.void]
    shared: NDArray[np.void]
    body_heights: FloatArray = field(default_factory=lambda: np.zeros((0, BODY_CLASSES + 1)))
    head_heights: FloatArray = field(default_factory=lambda: np.zeros((0, HEAD_CLASSES + 1)))

    @classmethod
    def of(cls, tracks: Sequence[Track], camera: GroundCamera | None = None) -> PackedTracks:
        """Tracks end to end, with times and origins filled in and no term yet."""
        offsets = np.concatenate([[0], np.cumsum([len(track) for track in tracks])])
        packed = cls(tracks, camera, offsets, np.zeros(offsets[-1], FRAME), np.zeros(1, SHARED))
        packed.records["dt"] = packed.dt
        return packed

    @classmethod
    def within(
        cls, tracks: Sequence[Track], camera: GroundCamera | None, dt: FloatArray, starts: bool
    ) -> PackedTracks:
        """Frames from the midst of a track, ``dt`` seconds after the ones before (0: there is none).

        The track ``starts`` where the prior on the first velocity stands.
        """
        packed = cls.of(tracks, camera)
        packed.records["dt"] = packed.dt = dt
        packed.is_first = dt == 0.0
        packed.first_seen = packed.first_seen if starts else packed.first_seen[:0]
        packed.origin = np.zeros((len(tracks), 2))
        return packed

    def channel(self, name: str) -> FloatArray | None:
        """One channel (N, …) of all tracks, NaN where a track does not have it; None where none has."""
        values = [getattr(track, name) for track in self.tracks]
        if len(values) == 1 or all(value is not None for value in values):
            return values[0] if len(values) == 1 else np.concatenate(values)
        shape = next((value.shape[1:] for value in values if value is not None), None)
        if shape is None:
            return None
        parts = [
            np.full((len(track), *shape), np.nan) if value is None else value
            for track, value in zip(self.tracks, values, strict=True)
        ]
        return np.concatenate(parts)

    @cached_property
    def t(self) -> FloatArray:
        """(N,) seconds."""
        return np.concatenate([track.t for track in self.tracks])

    @cached_property
    def is_first(self) -> NDArray[np.bool_]:
        """(N,) whether a frame begins a track."""
        first = np.zeros(self.offsets[-1], bool)
        first[self.offsets[:-1]] = True
        return first

    @cached_property
    def dt(self) -> FloatArray:
        """(N,) seconds since the frame before of the same track; 0 at its first."""
        dt = np.diff(self.t, prepend=self.t[:1])
        dt[self.is_first] = 0.0
        return dt

    @cached_property
    def position(self) -> FloatArray:
        """(N, 2) observed positions in metres."""
        return np.concatenate([track.position for track in self.tracks])

    @cached_property
    def has_position(self) -> NDArray[np.bool_]:
        """(N,) whether a position was observed."""
        return np.asarray(np.isfinite(self.position).all(axis=1))

    @cached_property
    def first_seen(self) -> NDArray[np.int64]:
        """(m,) index of each track's first frame with a position; its first frame where there is none."""
        seen = np.where(self.has_position, np.arange(len(self.has_position)), self.offsets[-1])
        first = np.minimum.reduceat(seen, self.offsets[:-1])
        return np.where(first < self.offsets[1:], first, self.offsets[:-1])

    @cached_property
    def origin(self) -> FloatArray:
        """(m, 2) metres: the first position of each track, 0 where there is none. States count from it."""
        return np.nan_to_num(self.position[self.first_seen])

    @cached_property
    def local_position(self) -> FloatArray:
        """(N, 2) observed positions from the track's origin."""
        return self.position - np.repeat(self.origin, np.diff(self.offsets), axis=0)

    @property
    def is_linear(self) -> bool:
        """Whether positions are judged in metres and without a robust loss."""
        return not self.shared["robust"][0] and not self.records["pixel_information"].any()
