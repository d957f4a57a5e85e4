"""The protocol of a term of the model."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Sequence
from functools import cached_property
from typing import ClassVar, Literal

from graphtrack.geometry.camera import GroundCamera
from graphtrack.kernels.layout import Field, Kernel
from graphtrack.model.factors import derived_factors
from graphtrack.model.observation import Observation, States, Step
from graphtrack.model.packing import FramePacker, PackedTracks, RecordTypes
from graphtrack.model.parameters import Parameters
from graphtrack.packages import gtsam
from graphtrack.tracks.track import Track

Variable = Literal["body", "head"]


class Term(ABC):
    """One term of the model: its density, and how engines add it up, side by side.

    A subclass is a whole new term; see the README for one in full. It states `cost`, and then either
    `kernels` with what they are given (`fields`, `shared`, `pack`), for all engines, or `factors`, for those
    of GTSAM alone; both where GTSAM has a native factor.

    Attributes
    ----------
    parameters : all parameters of the model
    uses : the orientations that the term acts on; a model estimates those that some term acts on
    fields, shared : what the kernels are given of each frame, and of all alike; `pack` fills it in
    kernels : the compiled functions that add the term up
    reads : the parameters that it reads, as ``group.key``; None: it does not say, so that none is learned
    repeats : whether frames in which the same was seen, as long after the frame before, are packed alike but
        for what is `live`; then one of them is remembered online
    """

    uses: ClassVar[frozenset[Variable]] = frozenset()
    fields: ClassVar[tuple[Field, ...]] = ()
    shared: ClassVar[tuple[Field, ...]] = ()
    kernels: ClassVar[tuple[Kernel, ...]] = ()
    reads: ClassVar[tuple[str, ...] | None] = None
    repeats: ClassVar[bool] = False

    def __init__(self, parameters: Parameters) -> None:
        self.parameters = parameters

    @abstractmethod
    def cost(self, states: States, track: Track, camera: GroundCamera | None = None) -> float:
        """Negative log density of a whole track; vectorised over frames. The sum of the kernels' costs."""

    def factors(self, step: Step) -> Sequence[gtsam.NonlinearFactor]:
        """The factors that arrive with a step: on its variables and those of ``step.previous``.

        Unless a term has its own, they are derived from its kernels.
        """
        return derived_factors(self, step)

    def pack(self, packed: PackedTracks) -> None:
        """Fill in the records' `fields`, and what is `shared`. Records begin as zeros."""
        raise NotImplementedError(f"{type(self).__name__} has no compiled kernel")

    def live(self, seen: Observation) -> Iterable[tuple[str, float]]:
        """Fields of a frame, with their values, that vary with the position and the angles seen there.

        All others may depend on which of them were seen, but not on what they are.
        """
        return ()

    def is_linear(self, packed: PackedTracks) -> bool:
        """Return True if the linear solution covers all that the term packed."""
        return False

    def log_normaliser(self, track: Track, camera: GroundCamera | None = None) -> float:
        """log ∫ exp(−cost) over what the term is a density of: what `cost` leaves out, for whole tracks.

        It depends on the parameters and on what the track has, not on the states. Parameters can be learned
        without a truth from terms that state it.
        """
        raise NotImplementedError(f"{type(self).__name__} states no normaliser")

    @cached_property
    def packer(self) -> FramePacker:
        """Packs single frames: for this term alone, unless a model has one for all of its terms."""
        return FramePacker((self,), RecordTypes.of((self,)))

    def states(self, name: str) -> bool:
        """Return True if the class itself defines ``name``: a parent's definition may not hold for it."""
        return name in vars(type(self))

    @property
    def is_normalised(self) -> bool:
        """Return True if the term defines its `log_normaliser`."""
        return self.states("log_normaliser")

    @property
    def is_compiled(self) -> bool:
        """Return True if the chain engine can solve the term: it defines its kernels."""
        return self.states("kernels")
