"""A member of a conversation seldom turns: an ℓ₁-like cost of turns."""

from __future__ import annotations

import math
from typing import ClassVar

import numpy as np

from graphtrack.geometry.angles import FloatArray
from graphtrack.geometry.camera import GroundCamera
from graphtrack.kernels.compilation import compiled
from graphtrack.kernels.lanes import choose
from graphtrack.kernels.layout import Field, Kernel
from graphtrack.model.observation import States
from graphtrack.model.packing import PackedTracks
from graphtrack.model.term import Term, Variable
from graphtrack.model.terms.faces_group import GROUP
from graphtrack.tracks.track import Track

SLOW = 0.05  # rad/s up to which a turn is a drift, of quadratic cost
LEAST_TURN, GREATEST_TURN = 0.01, 0.05
"""Least radians of a drift from a frame to the next, at any frame rate."""


@compiled
def add_persistence(
    cos_before: float,
    sin_before: float,
    cos: float,
    sin: float,
    place: int,
    group_hold: float,
    group_drift: float,
    hold: float,
    exact: bool,
    gradient_before: FloatArray,
    gradient: FloatArray,
    hessian_before: FloatArray,
    hessian: FloatArray,
    transition: FloatArray,
) -> float:
    """w·λ·(√(δ² + 2·(1 − cos Δ)) − δ) between an angle and its previous value: about λ·|Δ|."""
    close = cos_before * cos + sin_before * sin
    across = sin * cos_before - cos * sin_before
    size = math.sqrt(group_drift * group_drift + 2.0 * choose(close < 1.0, 1.0 - close, 0.0))
    weight = group_hold * hold / size
    pull = weight * across
    slope = across / size
    curvature = weight * (close - slope * slope) if exact else weight
    gradient[place] += pull
    gradient_before[place] -= pull
    hessian[place, place] += curvature
    hessian_before[place, place] += curvature
    transition[place, place] -= curvature
    return group_hold * hold * (size - group_drift)


def _persistence(name: Variable) -> Kernel:
    names = {"place": name.upper(), "hold": f"group_{name}_hold"}
    for part in ("cos", "sin"):
        names |= {part: f"{name}_{part}", f"{part}_before": f"{name}_{part}_before"}
    return Kernel(add_persistence, gate="group_hold", variables=(name,), before=(name,), names=names)


class OrientationPersistence(Term):
    """p·λ·(√(δ² + 2·(1 − cos Δ)) − δ) of the turns of body and head from frame to frame: about λ·|Δ|.

    So people in conversation keep their orientation, then turn at once, at any frame rate. p is the
    probability of a conversation. Without the input `GROUP` there is no cost.
    """

    uses: ClassVar[frozenset[Variable]] = frozenset({"body", "head"})
    reads = ("social.body_hold", "social.head_hold")
    fields = (
        Field("group_hold", "probability of the conversation; 0 at the first frame"),
        Field("group_drift", "radians up to which a turn is a drift"),
    )
    shared = (Field("group_body_hold", "cost of a radian's turn"), Field("group_head_hold", ""))
    kernels = (_persistence("body"), _persistence("head"))

    def cost(self, states: States, track: Track, camera: GroundCamera | None = None) -> float:
        """Σ over turns, of body and head."""
        social, total = self.parameters.social, 0.0
        weight, drift = _probability(track.input(GROUP, 3))[1:], _drift(track.dt)[1:]
        for angle, hold in ((states.body, social.body_hold), (states.head, social.head_hold)):
            chord = 2.0 * np.sin(0.5 * np.diff(angle))
            total += float(np.sum(weight * hold * (np.hypot(drift, chord) - drift)))
        return total

    def pack(self, packed: PackedTracks) -> None:
        """Weights and drifts of the frames, and the parameters."""
        social, records, shared = self.parameters.social, packed.records, packed.shared
        weight = _probability(packed.input(GROUP, 3))
        records["group_hold"] = np.where(packed.dt > 0.0, weight, 0.0)
        records["group_drift"] = _drift(packed.dt)
        shared["group_body_hold"], shared["group_head_hold"] = social.body_hold, social.head_hold


def _probability(group: FloatArray) -> FloatArray:
    """(n,) probability of a conversation; 0 where unknown."""
    return np.where(np.isfinite(group[:, 2]), group[:, 2], 0.0)


def _drift(dt: FloatArray) -> FloatArray:
    """Radians up to which the turn of a frame is a drift."""
    return np.clip(SLOW * dt, LEAST_TURN, GREATEST_TURN)
