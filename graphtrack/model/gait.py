"""Modes of the couplings: where they do not hold, a drifting offset takes their place, or nothing."""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

import gtsam
import numpy as np
from scipy import special

from graphtrack.geometry.angles import FloatArray
from graphtrack.geometry.camera import GroundCamera
from graphtrack.model.coupling import coupling_weights
from graphtrack.model.kernels.gait import BINS, NEAR, Gait, Modes
from graphtrack.model.kernels.packing import PackedTracks
from graphtrack.model.parameters import GaitParameters
from graphtrack.model.pose import class_centres, class_kappa
from graphtrack.model.steps import States, Step
from graphtrack.model.term import Term, Variable
from graphtrack.tracks import Track

_GRID = 2.0 * np.pi * np.arange(72) / 72


def gait_of(parameters: GaitParameters) -> Gait:
    """The parameters as the kernels take them."""
    return Gait(
        _modes(parameters, "body"),
        _modes(parameters, "head"),
        parameters.head_evidence,
        parameters.head_rate_seen,
    )


def _modes(parameters: GaitParameters, side: str) -> Modes:
    names = ("aligned", "switching", "drift", "strength", "free_strength", "lead", "spread", "offset_kappa")
    values = {name: float(getattr(parameters, f"{side}_{name}")) for name in names}
    steps = np.linspace(-2.0, 2.0, NEAR)
    offsets = np.append(2.0 * np.pi * np.arange(BINS) / BINS, steps * values.pop("spread"))
    anywhere = np.exp(values.pop("offset_kappa") * (np.cos(offsets[:BINS]) - 1.0))
    share = np.exp(-0.5 * steps**2)
    return Modes(
        **values,
        cos=np.cos(offsets),
        sin=np.sin(offsets),
        anywhere=anywhere / anywhere.sum(),
        share=share / share.sum(),
    )


def angle_information(kappa: FloatArray) -> FloatArray:
    """Fisher information κ·I₁(κ)/I₀(κ) of an angle seen with concentration κ."""
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
        records["coupling_weight"] = coupling_weights(coupling, packed.dt)
        records["body_aligned_kappa"] = records["motion_body_kappa"]
        records["head_aligned_kappa"] = records["head_body_kappa"]
        for name, heights in (("body", packed.body_heights), ("head", packed.head_heights)):
            records[f"{name}_information"] = angle_information(records[f"{name}_kappa"])
            if len(heights):
                records[f"{name}_information"] += class_information(heights)
