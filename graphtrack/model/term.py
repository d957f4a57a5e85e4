"""What a term of the model is."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import ClassVar, Literal

import gtsam

from graphtrack.geometry.camera import GroundCamera
from graphtrack.model.kernels.packing import PackedTracks
from graphtrack.model.parameters import Parameters
from graphtrack.model.steps import States, Step
from graphtrack.tracks import Track

Variable = Literal["body", "head"]


class Term(ABC):
    """One term of the model: its density and its factors, side by side.

    A subclass is a whole new term; see the README for one in full.

    Attributes
    ----------
    parameters : all parameters of the model
    uses : the orientations that the term acts on; a model estimates those that some term acts on
    only_compiled : whether the term says what factors cannot, so that GTSAM does not solve its models
    linear : whether the linear solution (`linear_kernels`) knows all that the term packs; see `is_linear`
    """

    uses: ClassVar[frozenset[Variable]] = frozenset()
    only_compiled: ClassVar[bool] = False
    linear: ClassVar[bool] = False

    def __init__(self, parameters: Parameters) -> None:
        self.parameters = parameters

    @abstractmethod
    def factors(self, step: Step) -> Sequence[gtsam.NonlinearFactor]:
        """The factors that arrive with a step: on its variables and those of ``step.previous``."""

    @abstractmethod
    def cost(self, states: States, track: Track, camera: GroundCamera | None = None) -> float:
        """Negative log density of a whole track, the sum of its factors' errors; vectorised over frames."""

    def pack(self, packed: PackedTracks) -> None:
        """Fill in what the term's compiled kernel reads, where it has one; see `is_compiled`."""
        raise NotImplementedError(f"{type(self).__name__} has no compiled kernel")

    def log_normaliser(self, track: Track, camera: GroundCamera | None = None) -> float:
        """log ∫ exp(−cost) over what the term is a density of: what `cost` leaves out, for whole tracks.

        It depends on the parameters and on what the track has, not on the states. Parameters can be learned
        without a truth from terms that state it.
        """
        raise NotImplementedError(f"{type(self).__name__} states no normaliser")

    @property
    def is_normalised(self) -> bool:
        """Whether the class itself, not a parent, states its `log_normaliser`."""
        return "log_normaliser" in vars(type(self))

    @property
    def is_compiled(self) -> bool:
        """Whether the chain solver knows the term: the class itself, not a parent, states its `pack`."""
        return "pack" in vars(type(self))

    @property
    def is_linear(self) -> bool:
        """Whether the linear solution knows the term: the class itself, not a parent, says ``linear``."""
        return bool(vars(type(self)).get("linear", False))
