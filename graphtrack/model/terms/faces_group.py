"""A member of a conversation faces the others, weakly, and some do not."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from graphtrack.geometry.angles import FloatArray, unit
from graphtrack.geometry.camera import GroundCamera
from graphtrack.model.kernels.compiled import compiled
from graphtrack.model.kernels.kernel import Kernel
from graphtrack.model.kernels.layout import BODY, HEAD, Field
from graphtrack.model.observation import States
from graphtrack.model.term import Term, Variable
from graphtrack.tracks import Track

if TYPE_CHECKING:
    from graphtrack.model.kernels.packing import PackedTracks

GROUP = "group"
"""The input: where companions in conversation are on average, x and y, and how surely there are any."""


@compiled
def add_faces_group_body(
    body_cos: float,
    body_sin: float,
    group_weight: float,
    group_cos: float,
    group_sin: float,
    group_body_kappa: float,
    group_outliers: float,
    exact: bool,
    gradient: FloatArray,
    hessian: FloatArray,
) -> float:
    """−w·log(ε + (1 − ε)·e^−κ(1 − cos Δ)) of the body; of its curvature the part that is never negative."""
    close = body_cos * group_cos + body_sin * group_sin
    across = body_sin * group_cos - body_cos * group_sin
    kappa = group_body_kappa
    inside = (1.0 - group_outliers) * math.exp(-kappa * (1.0 - close))
    share = inside / (group_outliers + inside)
    gradient[BODY] += group_weight * share * kappa * across
    round_part = kappa * close - (1.0 - share) * (kappa * across) ** 2 if exact else kappa
    hessian[BODY, BODY] += group_weight * share * round_part
    return -group_weight * math.log(group_outliers + inside)


@compiled
def add_faces_group_head(
    head_cos: float,
    head_sin: float,
    group_weight: float,
    group_cos: float,
    group_sin: float,
    group_head_kappa: float,
    group_outliers: float,
    exact: bool,
    gradient: FloatArray,
    hessian: FloatArray,
) -> float:
    """−w·log(ε + (1 − ε)·e^−κ(1 − cos Δ)) of the head; of its curvature the part that is never negative."""
    close = head_cos * group_cos + head_sin * group_sin
    across = head_sin * group_cos - head_cos * group_sin
    kappa = group_head_kappa
    inside = (1.0 - group_outliers) * math.exp(-kappa * (1.0 - close))
    share = inside / (group_outliers + inside)
    gradient[HEAD] += group_weight * share * kappa * across
    round_part = kappa * close - (1.0 - share) * (kappa * across) ** 2 if exact else kappa
    hessian[HEAD, HEAD] += group_weight * share * round_part
    return -group_weight * math.log(group_outliers + inside)


class FacesGroup(Term):
    """−w·log(ε + (1 − ε)·e^−κ(1 − cos Δ)) of body and head, Δ from the bearing of the other members.

    The bearing is that from where somebody was seen; the weight w is the probability of the group, with the
    frame's own. Without the input `GROUP` there is none.
    """

    uses: ClassVar[frozenset[Variable]] = frozenset({"body", "head"})
    reads = ("social.body_kappa", "social.head_kappa", "social.outliers", "coupling.correlation_time")
    fields = (
        Field("group_weight", "probability of the conversation with the frame's weight"),
        Field("group_cos", "of the bearing of its other members"),
        Field("group_sin", ""),
    )
    shared = (
        Field("group_body_kappa", "concentration of bodies about the bearing"),
        Field("group_head_kappa", "of heads"),
        Field("group_outliers", "share of members who face elsewhere"),
    )
    kernels = (
        Kernel(add_faces_group_body, gate="group_weight", variables=("body",)),
        Kernel(add_faces_group_head, gate="group_weight", variables=("head",)),
    )

    def _pull(self, position: FloatArray, group: FloatArray, dt: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(n,) weight, none on the spot or where nothing is known; (n, 2) direction of the bearing."""
        away = group[:, :2] - position
        far = np.linalg.norm(away, axis=1)
        weight = np.where(far > 1e-6, group[:, 2], 0.0) * self.parameters.coupling.weights(dt)
        known = np.isfinite(far) & np.isfinite(weight)
        angle = np.arctan2(np.where(known, away[:, 1], 0.0), np.where(known, away[:, 0], 1.0))
        return np.where(known, weight, 0.0), unit(angle)

    def cost(self, states: States, track: Track, camera: GroundCamera | None = None) -> float:
        """Σ over frames, of body and head."""
        social = self.parameters.social
        weight, bearing = self._pull(track.position, track.input(GROUP, 3), track.dt)
        total = 0.0
        for angle, kappa in ((states.body, social.body_kappa), (states.head, social.head_kappa)):
            close = np.sum(unit(angle) * bearing, axis=1)
            inside = (1.0 - social.outliers) * np.exp(-kappa * (1.0 - close))
            total -= float(np.sum(np.where(weight > 0.0, weight * np.log(social.outliers + inside), 0.0)))
        return total

    def pack(self, packed: PackedTracks) -> None:
        """Weights and bearings of the frames, and the parameters."""
        social, shared = self.parameters.social, packed.shared
        weight, bearing = self._pull(packed.position, packed.input(GROUP, 3), packed.dt)
        packed.records["group_weight"] = weight
        packed.records["group_cos"], packed.records["group_sin"] = bearing.T
        shared["group_body_kappa"], shared["group_head_kappa"] = social.body_kappa, social.head_kappa
        shared["group_outliers"] = social.outliers
