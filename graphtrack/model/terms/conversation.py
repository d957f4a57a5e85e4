"""Members of a conversation face its o-space, with weight and with outliers, and seldom turn."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, ClassVar

import numpy as np

from graphtrack.geometry.angles import FloatArray, unit
from graphtrack.kernels.layout import Field, Orientation
from graphtrack.model.costs import Cost, chord
from graphtrack.model.kernel import Kernel
from graphtrack.model.observation import Observation
from graphtrack.model.packing import PackedTracks
from graphtrack.model.term import Term, Variable
from graphtrack.packages import sympy

GROUP = "group"
"""The input: the direction of the o-space, x and y of a vector whose length is the weight of the frame, and
the probability that there is a conversation."""

Group = tuple[float, float, float]  # The value of `GROUP` in a frame


def with_group_at(observation: Observation, group: Group | None) -> Observation:
    """Return the observation with the input `GROUP`, unless it has it or ``group`` is None."""
    if group is None or GROUP in observation.inputs:
        return observation
    return replace(observation, inputs={**observation.inputs, GROUP: group})


def faces_group(now: Any, weight: Any, cos: Any, sin: Any, kappa: Any, outliers: Any) -> Cost:
    """Return −w·log(ε + (1 − ε)·e^−κ(1 − cos Δ)) of an angle."""

    def loss(cost: Any) -> Any:
        return -weight * sympy.log(outliers + (1 - outliers) * sympy.exp(-cost))

    return Cost(chord(kappa, now.angle, (cos, sin)), loss)


def _faces(name: Orientation) -> Kernel:
    names = {part: f"group_{part}" for part in ("weight", "cos", "sin", "outliers")}
    names["kappa"] = f"group_{name}_kappa"
    return Kernel(faces_group, "group_weight", (name,), angle=name, names=names)


class FacesGroup(Term):
    """−w·log(ε + (1 − ε)·e^−κ(1 − cos Δ)) of body and head, Δ from the direction of the o-space.

    The weight w is the length of the input's vector. Without the input `GROUP` there is none.
    """

    uses: ClassVar[frozenset[Variable]] = frozenset({"body", "head"})
    reads = ("social.body_kappa", "social.head_kappa", "social.outliers")
    fields = (
        Field("group_weight", "of the direction of the o-space"),
        Field("group_cos", "of that direction"),
        Field("group_sin", ""),
    )
    shared = (
        Field("group_body_kappa", "concentration of bodies about the direction"),
        Field("group_head_kappa", "of heads"),
        Field("group_outliers", "share of members who face elsewhere"),
    )
    kernels = (_faces("body"), _faces("head"))

    def pack(self, packed: PackedTracks) -> None:
        """Weights and directions of the frames, and the parameters."""
        social, records, shared = self.parameters.social, packed.records, packed.shared
        records["group_weight"], bearing = _weight_and_bearing(packed.input(GROUP, 3))
        records["group_cos"], records["group_sin"] = bearing.T
        shared["group_body_kappa"], shared["group_head_kappa"] = social.body_kappa, social.head_kappa
        shared["group_outliers"] = social.outliers


def _weight_and_bearing(group: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(n,) weight of the direction, 0 without one, and (n, 2) the direction."""
    known = np.asarray(np.isfinite(group).all(axis=1))
    x, y, _ = np.where(known[:, None], group, 0.0).T
    return np.hypot(x, y), unit(np.arctan2(y, x))


SLOW = 0.05  # rad/s up to which a turn is a drift, of quadratic cost
LEAST_TURN, GREATEST_TURN = 0.01, 0.05
"""Least radians of a drift from a frame to the next, at any frame rate."""


def persistence(before: Any, now: Any, probability: Any, drift: Any, hold: Any) -> Cost:
    """Return p·λ·(√(δ² + 2·(1 − cos Δ)) − δ) between an angle and its previous value: about p·λ·|Δ|."""

    def loss(cost: Any) -> Any:
        return probability * hold * (sympy.sqrt(drift**2 + 2 * cost) - drift)

    return Cost(chord(1, now.angle, before.angle), loss)


def _persistence(name: Orientation) -> Kernel:
    names = {"probability": "group_hold", "drift": "group_drift", "hold": f"group_{name}_hold"}
    return Kernel(persistence, "group_hold", (name,), (name,), angle=name, names=names)


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
