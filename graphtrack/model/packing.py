"""From tracks to the arrays that the kernels read: the frames of some tracks end to end."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from graphtrack.geometry.angles import FloatArray, unit
from graphtrack.geometry.camera import GroundCamera
from graphtrack.tracks.track import BODY_CLASSES, HEAD_CLASSES, Track


@dataclass(eq=False)
class PackedTracks:
    """The observations of some tracks end to end, and the records that terms fill in.

    Attributes
    ----------
    tracks : the tracks
    camera : camera of the scene, for the pixel likelihood
    offsets : (m + 1,) index of each track's first frame, and the end
    records : (N,) one record for each frame
    shared : (1,) fields shared by all frames
    body_heights, head_heights : (N, classes + 1) class likelihoods and, last, the outliers' part
    personal : parameters of the model by name, as ``group.key``, with a value (m,) for each track
    """

    tracks: Sequence[Track]
    camera: GroundCamera | None
    offsets: NDArray[np.int64]
    records: NDArray[np.void]
    shared: NDArray[np.void]
    body_heights: FloatArray = field(default_factory=lambda: np.zeros((0, BODY_CLASSES + 1)))
    head_heights: FloatArray = field(default_factory=lambda: np.zeros((0, HEAD_CLASSES + 1)))
    personal: Mapping[str, FloatArray] = field(default_factory=dict)
    _directions: dict[str, FloatArray | None] = field(default_factory=dict, repr=False)

    @classmethod
    def of(
        cls,
        tracks: Sequence[Track],
        camera: GroundCamera | None,
        types: RecordTypes,
        personal: Mapping[str, FloatArray] | None = None,
    ) -> PackedTracks:
        """Tracks end to end, with records that are zero but for their ``dt``."""
        offsets = np.concatenate([[0], np.cumsum([len(track) for track in tracks])])
        packed = cls(tracks, camera, offsets, np.zeros(offsets[-1], types.frame), np.zeros(1, types.shared))
        packed.records["dt"] = packed.dt
        packed.personal = {} if personal is None else personal
        return packed

    @classmethod
    def within(
        cls, track: Track, camera: GroundCamera | None, dt: float, starts: bool, types: RecordTypes
    ) -> PackedTracks:
        """A frame within a track, ``dt`` seconds after the previous one; 0: no previous frame."""
        packed = cls.of([track], camera, types)
        packed.records["dt"] = packed.dt = np.array([dt])
        packed.is_first = packed.dt == 0.0
        packed.first_position = packed.first_position if starts else packed.first_position[:0]
        return packed

    def channel(self, name: str) -> FloatArray | None:
        """One channel (N, …) of all tracks, NaN for tracks without it; None if no track has it."""
        values = [getattr(track, name) for track in self.tracks]
        known = next((value for value in values if value is not None), None)
        if known is None or len(values) == 1:
            return known
        parts = [
            np.full((len(track), *known.shape[1:]), np.nan) if value is None else value
            for track, value in zip(self.tracks, values, strict=True)
        ]
        return np.concatenate(parts)

    def parameter(self, name: str, value: float) -> FloatArray | float:
        """A parameter of each frame (N,), where tracks have their own, else the model's ``value``."""
        own = self.personal.get(name)
        return value if own is None else np.repeat(own, np.diff(self.offsets))

    def directions(self, name: str) -> FloatArray | None:
        """Unit vectors (N, 2) along the observed directions of body or head, NaN where unobserved; cached."""
        if name not in self._directions:
            angle = self.channel(name)
            self._directions[name] = None if angle is None else unit(angle)
        return self._directions[name]

    def input(self, name: str, *size: int) -> FloatArray:
        """One of the tracks' inputs, (N,) or (N, size), NaN where absent; InputError for another size."""
        return np.concatenate([track.input(name, *size) for track in self.tracks])

    @cached_property
    def numbers(self) -> FloatArray:
        """The records as rows of numbers, one after another."""
        return self.records.view(float)

    @cached_property
    def t(self) -> FloatArray:
        """(N,) seconds since the first frame of the same track, the only times that the solvers read."""
        return np.concatenate([track.t - track.t[:1] for track in self.tracks])

    @cached_property
    def is_first(self) -> NDArray[np.bool_]:
        """(N,) True at the first frame of a track."""
        first = np.zeros(self.offsets[-1], bool)
        first[self.offsets[:-1]] = True
        return first

    @cached_property
    def dt(self) -> FloatArray:
        """(N,) seconds since the previous frame of the same track; 0 at its first."""
        dt = np.diff(self.t, prepend=self.t[:1])
        dt[self.is_first] = 0.0
        return dt

    @cached_property
    def position(self) -> FloatArray:
        """(N, 2) observed positions in metres."""
        return np.concatenate([track.position for track in self.tracks])

    @cached_property
    def has_position(self) -> NDArray[np.bool_]:
        """(N,) True where a position was observed."""
        x, y = np.isfinite(self.position).T  # `all` over two columns takes several times as long
        return np.asarray(x & y)

    @cached_property
    def first_position(self) -> NDArray[np.int64]:
        """(m,) index of each track's first frame with a position; its first frame if it has no position."""
        begins = self.offsets[:-1]
        if self.has_position[begins].all():
            return begins
        observation = np.where(self.has_position, np.arange(len(self.has_position)), self.offsets[-1])
        first = np.minimum.reduceat(observation, begins)
        return np.where(first < self.offsets[1:], first, begins)

    @cached_property
    def origin(self) -> FloatArray:
        """(m, 2) metres: the first position of each track, the origin of its states; 0 if it has none."""
        return np.nan_to_num(self.position[self.first_position])


class RecordTypes(NamedTuple):
    """Types of the records of frames, and of the fields shared by all frames."""

    frame: np.dtype
    shared: np.dtype


def number_rows(records: np.ndarray) -> np.ndarray:
    """The same records (n,) as rows (n, numbers) of floats, in the same memory."""
    return records.view(float).reshape(len(records), -1)


def place_in_row(field: str, record: np.dtype) -> int:
    """Return the place of a number in such a row."""
    assert record.fields is not None
    return int(record.fields[field][1]) // 8


def of_alike(function: Callable[[FloatArray], FloatArray], numbers: FloatArray) -> FloatArray:
    """A function of numbers (n,), evaluated once where all are equal."""
    alike = len(numbers) > 0 and bool(np.all(numbers == numbers[0]))
    return np.broadcast_to(function(numbers[:1]), numbers.shape) if alike else function(numbers)
