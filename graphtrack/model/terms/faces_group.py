"""A member of a conversation faces its o-space, weakly, and turns seldom; some do not."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from graphtrack.geometry.angles import FloatArray, unit
from graphtrack.geometry.camera import GroundCamera
from graphtrack.model.kernels.compiled import compiled
from graphtrack.model.kernels.kernel import Kernel
from graphtrack.model.kernels.layout import Field
from graphtrack.model.observation import States
from graphtrack.model.parameters import frame_weights
from graphtrack.model.term import Term, Variable
from graphtrack.tracks import Track

if TYPE_CHECKING:
    from graphtrack.model.kernels.packing import PackedTracks

GROUP = "group"
"""The input: the direction of the o-space, x and y of a vector as long as that is sure, 0 to 1, and the
probability that there is a conversation."""

SLOW = 0.05
"""rad/s up to which a turn is a drift, which costs by its square."""
LEAST_TURN, GREATEST_TURN = 0.01, 0.05
"""Radians within which a drift from a frame to the next is, however near or far that is."""


@compiled
def add_faces_group(
    place: int,
    cos: float,
    sin: float,
    group_weight: float,
    group_cos: float,
    group_sin: float,
    kappa: float,
    group_outliers: float,
    exact: bool,
    gradient: FloatArray,
    hessian: FloatArray,
) -> float:
    """−w·log(ε + (1 − ε)·e^−κ(1 − cos Δ)) of an angle; of its curvature the part that is never negative."""
    close = cos * group_cos + sin * group_sin
    across = sin * group_cos - cos * group_sin
    inside = (1.0 - group_outliers) * math.exp(-kappa * (1.0 - close))
    share = inside / (group_outliers + inside)
    gradient[place] += group_weight * share * kappa * across
    round_part = kappa * close - (1.0 - share) * (kappa * across) ** 2 if exact else kappa
    hessian[place, place] += group_weight * share * round_part
    return -group_weight * math.log(group_outliers + inside)


@compiled
def add_holds(
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
    """w·λ·(√(δ² + 2·(1 − cos Δ)) − δ) between an angle and itself a frame before: about λ·|Δ|."""
    close = cos_before * cos + sin_before * sin
    across = sin * cos_before - cos * sin_before
    size = math.sqrt(group_drift * group_drift + 2.0 * max(1.0 - close, 0.0))
    weight = group_hold * hold / size
    pull = weight * across
    curvature = weight * (close - (across / size) ** 2) if exact else weight
    gradient[place] += pull
    gradient_before[place] -= pull
    hessian[place, place] += curvature
    hessian_before[place, place] += curvature
    transition[place, place] -= curvature
    return group_hold * hold * (size - group_drift)


def _faces(name: Variable) -> Kernel:
    names = {
        "place": name.upper(),
        "cos": f"{name}_cos",
        "sin": f"{name}_sin",
        "kappa": f"group_{name}_kappa",
    }
    return Kernel(add_faces_group, gate="group_weight", variables=(name,), names=names)


def _holds(name: Variable) -> Kernel:
    names = {"place": name.upper(), "hold": f"group_{name}_hold"}
    for part in ("cos", "sin"):
        names |= {part: f"{name}_{part}", f"{part}_before": f"{name}_{part}_before"}
    return Kernel(add_holds, gate="group_hold", variables=(name,), before=(name,), names=names)


class FacesGroup(Term):
    """Body and head of a member face the o-space, and are held.

    −w·log(ε + (1 − ε)·e^−κ(1 − cos Δ)) of body and head, Δ from the direction of the o-space; and
    w·λ·√(δ² + 2·(1 − cos Δ)) of their turns from frame to frame: whoever converses holds still, then turns at
    once. The weight w is the probability of a conversation, in the first with the frame's own and that of the
    direction. Without the input `GROUP` there is none.
    """

    uses: ClassVar[frozenset[Variable]] = frozenset({"body", "head"})
    reads = tuple(
        f"social.{name}"
        for name in ("body_kappa", "head_kappa", "outliers", "correlation_time", "body_hold", "head_hold")
    )
    fields = (
        Field("group_weight", "probability of the conversation with the frame's weight"),
        Field("group_cos", "of the bearing of its o-space"),
        Field("group_sin", ""),
        Field("group_hold", "probability of the conversation; 0 at the first frame"),
        Field("group_drift", "radians up to which a turn is a drift"),
    )
    shared = (
        Field("group_body_kappa", "concentration of bodies about the bearing"),
        Field("group_head_kappa", "of heads"),
        Field("group_outliers", "share of members who face elsewhere"),
        Field("group_body_hold", "cost of a radian's turn"),
        Field("group_head_hold", ""),
    )
    kernels = (_faces("body"), _faces("head"), _holds("body"), _holds("head"))

    def cost(self, states: States, track: Track, camera: GroundCamera | None = None) -> float:
        """Σ over frames, of body and head."""
        social, dt = self.parameters.social, track.dt
        sure, bearing, weight = _told(track.input(GROUP, 3))
        facing = sure * frame_weights(dt, social.correlation_time)
        total = 0.0
        for angle, kappa, hold in (
            (states.body, social.body_kappa, social.body_hold),
            (states.head, social.head_kappa, social.head_hold),
        ):
            close = np.sum(unit(angle) * bearing, axis=1)
            inside = (1.0 - social.outliers) * np.exp(-kappa * (1.0 - close))
            total -= float(np.sum(np.where(facing > 0.0, facing * np.log(social.outliers + inside), 0.0)))
            chord = 2.0 * np.sin(0.5 * np.diff(angle))
            drift = _drift(dt)[1:]
            total += float(np.sum(weight[1:] * hold * (np.hypot(drift, chord) - drift)))
        return total

    def pack(self, packed: PackedTracks) -> None:
        """Weights and bearings of the frames, and the parameters."""
        social, records, shared = self.parameters.social, packed.records, packed.shared
        sure, bearing, weight = _told(packed.input(GROUP, 3))
        records["group_weight"] = sure * frame_weights(packed.dt, social.correlation_time)
        records["group_cos"], records["group_sin"] = bearing.T
        records["group_hold"] = np.where(packed.dt > 0.0, weight, 0.0)
        records["group_drift"] = _drift(packed.dt)
        shared["group_body_kappa"], shared["group_head_kappa"] = social.body_kappa, social.head_kappa
        shared["group_outliers"] = social.outliers
        shared["group_body_hold"], shared["group_head_hold"] = social.body_hold, social.head_hold


def _told(group: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """(n,) weight of the direction, (n, 2) the direction, (n,) of the conversation; 0 where there is none."""
    known = np.asarray(np.isfinite(group).all(axis=1))
    x, y, weight = np.where(known[:, None], group, 0.0).T
    return weight * np.hypot(x, y), unit(np.arctan2(y, x)), weight


def _drift(dt: FloatArray) -> FloatArray:
    """Radians up to which the turn of a frame is a drift."""
    return np.clip(SLOW * dt, LEAST_TURN, GREATEST_TURN)
