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
    """One term of the model: its density, and its kernels and factors.

    A subclass is a whole new term; see the README for an example. It defines `cost`, and then either
    `kernels` with their data (`fields`, `shared`, `pack`), for all engines, or `factors`, for those of GTSAM
    alone; both where GTSAM has a native factor.

    Attributes
    ----------
    parameters : all parameters of the model
    uses : the orientations that the term acts on; a model estimates these
    fields, shared : fields of each frame, and fields shared by all frames; `pack` fills them in
    kernels : the compiled functions of the term
    reads : the parameters that it reads, as ``group.key``; None: undeclared, so that none is learned
    repeats : True if frames with equal observations and time steps have equal packings except for `live`;
        packings are then cached online
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
        """Negative log density of a whole track, vectorised over frames: the sum of the kernels' costs."""

    def factors(self, step: Step) -> Sequence[gtsam.NonlinearFactor]:
        """The factors of a step: on its variables and those of ``step.previous``.

        By default they are derived from the kernels.
        """
        return derived_factors(self, step)

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

    def log_normaliser(self, track: Track, camera: GroundCamera | None = None) -> float:
        """log ∫ exp(−cost) over the term's variable: the normaliser that `cost` leaves out, for whole tracks.

        It depends on the parameters and on the track's observations, not on the states. Parameters can be
        learned without a truth from terms that define it.
        """
        raise NotImplementedError(f"{type(self).__name__} has no normaliser")

    @cached_property
    def packer(self) -> FramePacker:
        """Packer of single frames: for this term alone, unless a model has a joint packer for its terms."""
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
