"""A term of the model, and packing by terms: of all frames of some tracks, or one at a time."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import cached_property, lru_cache
from typing import Any, ClassVar, Literal

import numpy as np

from graphtrack.geometry.camera import GroundCamera
from graphtrack.kernels.layout import DT, Field, record_type
from graphtrack.model.factors import kernel_factors
from graphtrack.model.kernel import Kernel
from graphtrack.model.observation import CHANNELS, Observation, States, Step
from graphtrack.model.packing import PackedTracks, RecordTypes
from graphtrack.model.parameters import Parameters
from graphtrack.packages import gtsam
from graphtrack.tracks.track import Track

Variable = Literal["body", "head"]


class Term:
    """One term of the model: its density, and its kernels and factors.

    A subclass is a whole new term; docs/how-to/own-term.md has an example. It defines `cost`, and then either
    `kernels` with their data (`fields`, `shared`, `pack`), for all engines, or `factors`, for those of GTSAM
    alone; both where GTSAM has a native factor.

    Attributes
    ----------
    parameters : all parameters of the model
    uses : the orientations that the term acts on; a model estimates these
    fields, shared : fields of each frame, and fields shared by all frames; `pack` fills them in
    kernels : the compiled functions of the term
    reads : the parameters that it reads, as ``group.key``; None: undeclared, so that none is learned
    scaled : fields that are proportional to a power of a parameter: field, ``group.key``, power
    repeats : True if frames with equal observations and time steps have equal packings except for `live`;
        packings are then cached online
    """

    uses: ClassVar[frozenset[Variable]] = frozenset()
    fields: ClassVar[tuple[Field, ...]] = ()
    shared: ClassVar[tuple[Field, ...]] = ()
    kernels: ClassVar[tuple[Kernel, ...]] = ()
    reads: ClassVar[tuple[str, ...] | None] = None
    scaled: ClassVar[tuple[tuple[str, str, float], ...]] = ()
    repeats: ClassVar[bool] = False

    def __init__(self, parameters: Parameters) -> None:
        self.parameters = parameters

    @property
    def label(self) -> str:
        """The name in messages."""
        return type(self).__name__

    @property
    def documented(self) -> object:
        """The class or function whose docstring describes the term."""
        return type(self)

    def cost(self, states: States, track: Track, camera: GroundCamera | None = None) -> float:
        """Negative log density of a whole track, by NumPy from the kernels' cost functions."""
        packed = filled(PackedTracks.of([track], camera, types_of([self])), [self])
        rows = np.column_stack([states.position, states.velocity, states.body, states.head])
        return sum(kernel.total(packed, rows) for kernel in self.kernels)

    def factors(self, step: Step) -> Sequence[gtsam.NonlinearFactor]:
        """The factors of a step: on its variables and those of ``step.previous``.

        By default they are derived from the kernels.
        """
        return self.derived_factors(step)

    def derived_factors(self, step: Step) -> Sequence[gtsam.NonlinearFactor]:
        """One factor for each live kernel."""
        packed = self.packer(step.observation, step.dt, step.starts, step.camera)
        return kernel_factors(self.kernels, packed, self.packer.live(step.observation), step)

    def pack(self, packed: PackedTracks) -> None:
        """Fill in the records' `fields`, and `shared`. Records are zero before."""
        raise NotImplementedError(f"{type(self).__name__} has no compiled kernel")

    def live(self, observation: Observation) -> Iterable[tuple[str, float]]:
        """Fields of a frame, with their values, that vary with the observed position and angles.

        All others may depend on the set of observed channels, but not on their values.
        """
        return ()

    def is_linear(self, packed: PackedTracks) -> bool:
        """Return True if the linear solution covers everything that the term packed."""
        return False

    @cached_property
    def packer(self) -> FramePacker:
        """Packer of single frames: for this term alone, unless a model has a joint packer for its terms."""
        return FramePacker((self,), types_of((self,)))

    def states(self, name: str) -> bool:
        """Return True if the class itself defines ``name``: a parent's definition may not hold for it."""
        return name in vars(type(self))

    @property
    def is_compiled(self) -> bool:
        """Return True if the chain engine can solve the term: it defines its kernels."""
        return self.states("kernels")


def types_of(terms: Sequence[Term]) -> RecordTypes:
    """Types with the fields of some terms only."""
    frame = record_type((DT, *(field for term in terms for field in term.fields)))
    return RecordTypes(frame, record_type(field for term in terms for field in term.shared))


def filled(packed: PackedTracks, terms: Iterable[Term]) -> PackedTracks:
    """Packed tracks, once some terms have filled in their records."""
    for term in terms:
        term.pack(packed)
    return packed


_KINDS = 1024  # Size of the cache of packed frames, some kilobytes each; the oldest is dropped


class FramePacker:
    """Frames packed one at a time, with a cache by kind.

    The kind is the set of observed channels, their declared noise in one number, and the time since the
    previous frame. A frame with inputs, pixels or class likelihoods is a kind of its own: those of a window
    are read again at each step.
    """

    def __init__(self, terms: Sequence[Term], types: RecordTypes) -> None:
        self._terms, self.types = terms, types
        self._repeats = all(term.states("repeats") and term.repeats for term in terms)
        # Most terms have no live fields; calling them all takes longer than writing the live fields.
        self._live = [term.live for term in terms if term.live.__qualname__ != "Term.live"]
        self._known: dict[tuple[object, ...], PackedTracks] = {}

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
        kind: tuple[object, ...]
        if not (simple and self._repeats) or observation.inputs:
            kind = (seconds, starts, observation, camera)
        else:
            kind = (
                seconds,
                starts,
                observation.position_std,
                observation.body_kappa,
                observation.head_kappa,
                observation.body_axis_kappa,
                observation.position is None,
                observation.position_covariance is None,
                observation.observed_velocity is None,
                observation.body is None,
                observation.body_axis is None,
                observation.head is None,
            )
        known = self._known.get(kind)
        if known is None:
            if len(self._known) == _KINDS:
                del self._known[next(iter(self._known))]
            known = self._known[kind] = self._packed(observation, seconds, starts, camera)
        return known

    def live(self, observation: Observation) -> list[tuple[str, float]]:
        """Fields, with their values, that differ between frames of a kind."""
        return [field for live in self._live for field in live(observation)]

    def _packed(
        self, observation: Observation, dt: float, starts: bool, camera: GroundCamera | None
    ) -> PackedTracks:
        packed = PackedTracks.within(one_row(observation), camera, dt, starts, self.types)
        return filled(packed, self._terms)


@lru_cache(4)
def one_row(observation: Observation) -> Track:
    """An observation as a track: once for all terms that are packed separately."""
    given = {name: getattr(observation, name) for name in CHANNELS}
    position = given.pop("position") or (np.nan, np.nan)
    channels: dict[str, Any] = {name: np.array([value]) for name, value in given.items() if value is not None}
    inputs = {name: np.array([value]) for name, value in observation.inputs.items()}
    return Track(0, np.array([0]), np.array([observation.t]), np.array([position]), inputs=inputs, **channels)
