"""From tracks to the arrays that the kernels read: all frames of some tracks, or one at a time."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from graphtrack.geometry.angles import FloatArray, unit
from graphtrack.geometry.camera import GroundCamera
from graphtrack.kernels.layout import DT, Field, Kernel, record_type
from graphtrack.model.observation import CHANNELS, Observation
from graphtrack.tracks.track import BODY_CLASSES, HEAD_CLASSES, Track


class PackedTerm(Protocol):
    """The part of a `Term` that packing and evaluation of its kernels need."""

    @property
    def fields(self) -> tuple[Field, ...]:
        """Fields of each frame's record that `pack` fills in."""

    @property
    def shared(self) -> tuple[Field, ...]:
        """Fields that all frames share."""

    @property
    def kernels(self) -> tuple[Kernel, ...]:
        """Compiled functions that add the term up."""

    @property
    def repeats(self) -> bool:
        """Return True if frames with equal observations have equal packings except for `live`."""

    def __hash__(self) -> int: ...

    def pack(self, packed: PackedTracks) -> None:
        """Fill in the records' `fields`, and `shared`."""

    def live(self, observation: Observation) -> Iterable[tuple[str, float]]:
        """Fields of a frame, with their values, that vary with the observed position and angles."""

    def states(self, name: str) -> bool:
        """Return True if the class itself defines ``name``."""

    @property
    def packer(self) -> FramePacker:
        """Packer of single frames."""


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
    """

    tracks: Sequence[Track]
    camera: GroundCamera | None
    offsets: NDArray[np.int64]
    records: NDArray[np.void]
    shared: NDArray[np.void]
    body_heights: FloatArray = field(default_factory=lambda: np.zeros((0, BODY_CLASSES + 1)))
    head_heights: FloatArray = field(default_factory=lambda: np.zeros((0, HEAD_CLASSES + 1)))
    _directions: dict[str, FloatArray | None] = field(default_factory=dict, repr=False)

    @classmethod
    def of(
        cls,
        tracks: Sequence[Track],
        camera: GroundCamera | None,
        terms: Iterable[PackedTerm],
        types: RecordTypes,
    ) -> PackedTracks:
        """Tracks end to end, packed by some terms."""
        offsets = np.concatenate([[0], np.cumsum([len(track) for track in tracks])])
        packed = cls(tracks, camera, offsets, np.zeros(offsets[-1], types.frame), np.zeros(1, types.shared))
        return packed._filled(terms)

    @classmethod
    def within(
        cls,
        track: Track,
        camera: GroundCamera | None,
        dt: float,
        starts: bool,
        terms: Iterable[PackedTerm],
        types: RecordTypes,
    ) -> PackedTracks:
        """A frame within a track, ``dt`` seconds after the previous one; 0: no previous frame."""
        packed = cls([track], camera, np.array([0, 1]), np.zeros(1, types.frame), np.zeros(1, types.shared))
        packed.dt = np.array([dt])
        packed.is_first = packed.dt == 0.0
        packed.first_position = packed.first_position if starts else packed.first_position[:0]
        return packed._filled(terms)

    def _filled(self, terms: Iterable[PackedTerm]) -> PackedTracks:
        self.records["dt"] = self.dt
        for term in terms:
            term.pack(self)
        return self

    def channel(self, name: str) -> FloatArray | None:
        """One channel (N, …) of all tracks, NaN for tracks without it; None if no track has it."""
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

    @classmethod
    def of(cls, terms: Sequence[PackedTerm]) -> RecordTypes:
        """The types with the fields of some terms only."""
        frame = record_type((DT, *(field for term in terms for field in term.fields)))
        return cls(frame, record_type(field for term in terms for field in term.shared))


_KINDS = 256  # Size of the cache of packed frames


class FramePacker:
    """Frames packed one at a time, with a cache by kind.

    The kind is the set of observed channels, their declared noise, and the time since the previous frame. A
    frame with inputs, pixels or class likelihoods has no kind, and is kept until the next frame.
    """

    def __init__(self, terms: Sequence[PackedTerm], types: RecordTypes) -> None:
        self._terms, self.types = terms, types
        self._repeats = all(term.states("repeats") and term.repeats for term in terms)
        # Most terms have no live fields; calling them all takes longer than writing the live fields.
        self._live = [term.live for term in terms if term.live.__qualname__ != "Term.live"]
        self._known: dict[tuple[object, ...], PackedTracks] = {}
        self._latest: tuple[tuple[object, ...], Any] = (), None

    def __call__(
        self, observation: Observation, dt: float | None, starts: bool, camera: GroundCamera | None
    ) -> PackedTracks:
        """A packed frame of this kind; its `live` fields are arbitrary."""
        # Time steps differ by rounding; the record gets its own dt where it matters.
        seconds = 0.0 if dt is None else round(dt, 14)
        simple = (
            observation.pixel is None
            and observation.body_likelihood is None
            and observation.head_likelihood is None
        )
        if not (simple and self._repeats) or observation.inputs:
            kind, packed = self._latest
            if kind != (observation, seconds, starts, camera):
                packed = self._packed(observation, seconds, starts, camera)
                self._latest = (observation, seconds, starts, camera), packed
            return packed
        kind = (
            seconds,
            starts,
            observation.position_std,
            observation.body_kappa,
            observation.head_kappa,
            observation.position is None,
            observation.body is None,
            observation.head is None,
        )
        known = self._known.get(kind)
        if known is None:
            if len(self._known) == _KINDS:
                self._known.clear()
            known = self._known[kind] = self._packed(observation, seconds, starts, camera)
        return known

    def live(self, observation: Observation) -> list[tuple[str, float]]:
        """Fields, with their values, that differ between frames of a kind."""
        return [field for live in self._live for field in live(observation)]

    def _packed(
        self, observation: Observation, dt: float, starts: bool, camera: GroundCamera | None
    ) -> PackedTracks:
        return PackedTracks.within(_track_of(observation), camera, dt, starts, self._terms, self.types)


@lru_cache(4)
def _track_of(observation: Observation) -> Track:
    """An observation as a track: once for all terms that are packed separately."""
    given = {name: getattr(observation, name) for name in CHANNELS}
    position = given.pop("position") or (np.nan, np.nan)
    channels: dict[str, Any] = {name: np.array([value]) for name, value in given.items() if value is not None}
    inputs = {name: np.array([value]) for name, value in observation.inputs.items()}
    return Track(0, np.array([0]), np.array([observation.t]), np.array([position]), inputs=inputs, **channels)
