"""Modes of the couplings as a term: what `gait_modes` reads of the frames."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import TYPE_CHECKING, ClassVar

import gtsam
import numpy as np
from scipy import special

from graphtrack.geometry.angles import FloatArray, class_centres, class_kappa
from graphtrack.geometry.camera import GroundCamera
from graphtrack.model.kernels.layout import Field
from graphtrack.model.observation import States, Step
from graphtrack.model.parameters import GaitParameters
from graphtrack.model.term import Term, Variable
from graphtrack.tracks import Track

if TYPE_CHECKING:
    from graphtrack.model.kernels.packing import PackedTracks


_GRID = 2.0 * np.pi * np.arange(72) / 72


def angle_information(kappa: FloatArray) -> FloatArray:
    """Fisher information κ·I₁(κ)/I₀(κ) of an angle seen with concentration κ."""
    highest = np.max(kappa, initial=0.0)
    if np.all((kappa == highest) | (kappa == 0.0)):
        # As where no observation states its own: the Bessel functions take long.
        return np.where(kappa > 0.0, highest * special.i1e(highest) / special.i0e(highest), 0.0)
    return np.asarray(kappa * special.i1e(kappa) / special.i0e(kappa))


def class_information(heights: FloatArray) -> FloatArray:
    """Fisher information (n,) of class likelihoods (n, classes + 1), the last the outliers'; NaN is 0."""
    n_classes = heights.shape[1] - 1
    kappa, apart = class_kappa(n_classes), _GRID[:, None] - class_centres(n_classes)
    shapes = np.exp(kappa * (np.cos(apart) - 1.0))
    density = np.nan_to_num(heights[:, :-1]) @ shapes.T + np.nan_to_num(heights[:, -1:], nan=1.0)
    slope = np.nan_to_num(heights[:, :-1]) @ (-kappa * np.sin(apart) * shapes).T
    # The mean of (L'/L)² under L itself.
    return np.asarray((slope**2 / density).sum(axis=1) / density.sum(axis=1))


class GaitOffsets(Term):
    """Hidden modes of the two couplings, which stand before it in the list of terms.

    In each frame each coupling is *aligned* (at rest near 0, as 002 has it) or *free* (at rest at an offset
    that may be anything and drifts slowly); a hidden Markov chain says that this seldom changes. The
    couplings, and the head that steers the motion, count by the probabilities of the modes. The engine infers
    both in turn: given the states the modes, by the forward–backward recursion; given the modes the states.
    """

    uses: ClassVar[frozenset[Variable]] = frozenset({"body", "head"})
    only_compiled: ClassVar[bool] = True
    repeats = True
    reads = tuple(f"gait.{field.name}" for field in dataclasses.fields(GaitParameters))
    fields = (
        Field("body_aligned_kappa", "κ₁ and κ₂ with the weight, where modes choose how much of them holds"),
        Field("head_aligned_kappa", ""),
        Field("coupling_weight", "that weight"),
        Field("body_information", "Fisher information of what was seen of the body, and of the head"),
        Field("head_information", ""),
    )
    shared = (Field("body_diffusion", "rad²/s"),)
    kernels = ()  # it acts through those of the couplings

    def factors(self, step: Step) -> Sequence[gtsam.NonlinearFactor]:
        """None: the term acts through the couplings."""
        return []

    def cost(self, states: States, track: Track, camera: GroundCamera | None = None) -> float:
        """0: the modes weigh the couplings; they have no cost of their own."""
        return 0.0

    def pack(self, packed: PackedTracks) -> None:
        """The couplings when aligned, their weights, and how much each observation of body and head tells."""
        records, coupling = packed.records, self.parameters.coupling
        packed.shared["body_diffusion"] = self.parameters.orientation.body_diffusion
        records["coupling_weight"] = coupling.weights(packed.dt)
        records["body_aligned_kappa"] = records["motion_body_kappa"]
        records["head_aligned_kappa"] = records["head_body_kappa"]
        for name, heights in (("body", packed.body_heights), ("head", packed.head_heights)):
            records[f"{name}_information"] = angle_information(records[f"{name}_kappa"])
            if len(heights):
                records[f"{name}_information"] += class_information(heights)
