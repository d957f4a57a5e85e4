"""Modes of the couplings: aligned, or free with a drifting offset.

A hidden Markov chain over modes and offsets, for each coupling. A frame's mode is *aligned* (the coupling
rests near 0), *free* (at an offset that drifts around the circle) or, of heads, a *glance* (at an offset
within the neck's reach, for a moment; then the mode is redrawn). A row of probabilities has `BINS`
offsets of the free mode on a grid, then `NEAR` small ones of the aligned mode, then the grid once more, for
glances.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from functools import cache
from typing import Any, ClassVar, NamedTuple

import numpy as np

from graphtrack.geometry.angles import FloatArray, class_centres, class_kappa
from graphtrack.geometry.camera import GroundCamera
from graphtrack.kernels.layout import Field
from graphtrack.model.observation import States, Step
from graphtrack.model.packing import PackedTracks, of_alike
from graphtrack.model.parameters import GaitParameters
from graphtrack.model.term import Term, Variable
from graphtrack.packages import gtsam, special
from graphtrack.tracks.track import Track

BINS, NEAR = 36, 7  # Offsets of the free mode, all around, and of the aligned mode, about 0

BASE = BINS + NEAR
ROW = BASE + BINS

MOST_DRIFT = 100

NECK_REACH = math.radians(95.0)  # Angle of the head against the body within which a glance stays


class Modes(NamedTuple):
    """Parameters of one coupling's modes; see `GaitParameters`."""

    aligned: float
    switching: float  # 1/s
    drift: float  # rad²/s
    strength: float
    free_strength: float
    lead: float  # seconds
    cos: FloatArray  # (ROW,) of the offsets
    sin: FloatArray
    anywhere: FloatArray  # (BINS,) of the free mode's offsets in it; they sum to 1
    share: FloatArray  # (NEAR,) of the aligned mode's offsets in it; they sum to 1
    own: FloatArray  # (BINS,) probability that such an offset is the person's, and not the classifier's
    glance_share: float  # of the time; 0: there are no glances
    glance_change: float  # 1/s, the sum of the rates at which glances begin and end
    glance_strength: float
    glance: FloatArray  # (BINS,) of the glances' offsets; they sum to 1


class Gait(NamedTuple):
    """Parameters of both couplings' modes."""

    body: Modes
    head: Modes
    classified_head: Modes
    head_evidence: float
    head_rate_observed: float
    head_common: float
    glance_variance: float  # rad²


_GRID = 2.0 * np.pi * np.arange(72) / 72


def gait_of(parameters: GaitParameters) -> Gait:
    """The parameters as the kernels take them."""
    head = _modes(parameters, "head")
    return Gait(
        _modes(parameters, "body"),
        head,
        _mistaken(head, parameters.head_class_bias, parameters.head_class_bias_kappa),
        parameters.head_evidence,
        parameters.head_rate_observed,
        parameters.head_common,
        parameters.glance_std**2,
    )


def _modes(parameters: GaitParameters, side: str) -> Modes:
    names = ("aligned", "switching", "drift", "strength", "free_strength", "lead", "spread", "offset_kappa")
    values: dict[str, Any] = {name: float(getattr(parameters, f"{side}_{name}")) for name in names}
    steps = np.linspace(-2.0, 2.0, NEAR)
    around = 2.0 * np.pi * np.arange(BINS) / BINS
    offsets = np.concatenate([around, steps * values.pop("spread"), around])
    anywhere = np.exp(values.pop("offset_kappa") * (np.cos(offsets[:BINS]) - 1.0))
    share = np.exp(-0.5 * steps**2)
    return Modes(
        **values,
        cos=np.cos(offsets),
        sin=np.sin(offsets),
        anywhere=anywhere / anywhere.sum(),
        share=share / share.sum(),
        own=np.ones(BINS),
        **_glances(parameters, side, np.cos(around)),
    )


def _glances(parameters: GaitParameters, side: str, cos: FloatArray) -> dict[str, Any]:
    """The parameters of glances, which only heads have."""
    share = parameters.glance_share if side == "head" else 0.0
    within = np.where(cos > math.cos(NECK_REACH), np.exp(parameters.glance_kappa * (cos - 1.0)), 0.0)
    return {
        "glance_share": share,
        "glance_change": 1.0 / (parameters.glance_time * (1.0 - share)),
        "glance_strength": parameters.glance_strength,
        "glance": within / within.sum(),
    }


def _mistaken(modes: Modes, bias: float, kappa: float) -> Modes:
    """The modes of an orientation that a classifier sees turned persistently with probability ``bias``."""
    own = (1.0 - bias) * (1.0 - modes.aligned) * modes.anywhere
    turned = np.exp(kappa * (modes.cos[:BINS] - 1.0))
    apparent = own + bias * turned / turned.sum()
    return modes._replace(
        aligned=(1.0 - bias) * modes.aligned,
        anywhere=apparent / apparent.sum(),
        own=np.divide(own, apparent, out=np.ones(BINS), where=apparent > 0.0),
    )


def angle_information(kappa: FloatArray) -> FloatArray:
    """Fisher information κ·I₁(κ)/I₀(κ) of an angle seen with concentration κ."""
    return np.asarray(kappa * special.i1e(kappa) / special.i0e(kappa))


def class_information(heights: FloatArray) -> FloatArray:
    """Fisher information (n,) of class likelihoods (n, classes + 1), the last the outliers'; NaN is 0."""
    shapes, slopes = _class_shapes(heights.shape[1] - 1)
    scores = np.nan_to_num(heights[:, :-1])
    density = scores @ shapes + np.nan_to_num(heights[:, -1:], nan=1.0)
    slope = scores @ slopes
    # The mean of (L'/L)² under L itself.
    return np.asarray((slope**2 / density).sum(axis=1) / density.sum(axis=1))


@cache
def _class_shapes(n_classes: int) -> tuple[FloatArray, FloatArray]:
    """Densities of each class on the grid, relative to their peak, and their slopes: (classes, grid)."""
    kappa, apart = class_kappa(n_classes), _GRID - class_centres(n_classes)[:, None]
    shapes = np.exp(kappa * (np.cos(apart) - 1.0))
    return shapes, -kappa * np.sin(apart) * shapes


class GaitOffsets(Term):
    """Hidden modes of the two couplings; the term precedes both in the list of terms.

    In each frame each coupling is *aligned* (about 0, as in Chen et al. (2011)) or *free* (about an offset
    that drifts); a hidden Markov chain makes changes rare. The engine infers modes and states in turn.
    """

    uses: ClassVar[frozenset[Variable]] = frozenset({"body", "head"})
    repeats = True
    reads = tuple(f"gait.{field.name}" for field in dataclasses.fields(GaitParameters))
    fields = (
        Field("body_aligned_kappa", "κ₁ and κ₂ with the weight, before scaling by the modes"),
        Field("head_aligned_kappa", ""),
        Field("coupling_weight", "that weight"),
        Field("body_information", "Fisher information of the observations of the body, and of the head"),
        Field("head_information", ""),
    )
    shared = (Field("body_diffusion", "rad²/s"),)
    kernels = ()  # it acts through those of the couplings

    def factors(self, step: Step) -> Sequence[gtsam.NonlinearFactor]:
        """No factors: the term acts through the couplings."""
        return []

    def cost(self, states: States, track: Track, camera: GroundCamera | None = None) -> float:
        """0: the modes weigh the couplings; they have no cost of their own."""
        return 0.0

    def pack(self, packed: PackedTracks) -> None:
        """The couplings when aligned, their weights, and the information of observations of body and head."""
        records, coupling = packed.records, self.parameters.coupling
        packed.shared["body_diffusion"] = self.parameters.orientation.body_diffusion
        records["coupling_weight"] = coupling.weights(packed.dt)
        records["body_aligned_kappa"] = records["motion_body_kappa"]
        records["head_aligned_kappa"] = records["head_body_kappa"]
        for name, heights in (("body", packed.body_heights), ("head", packed.head_heights)):
            records[f"{name}_information"] = of_alike(angle_information, records[f"{name}_kappa"])
            if len(heights):
                records[f"{name}_information"] += class_information(heights)
