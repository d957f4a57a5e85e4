"""Members of a conversation face its o-space, with weight and with outliers, and seldom turn."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import ClassVar

import numpy as np

from graphtrack.geometry.angles import FloatArray, unit
from graphtrack.geometry.camera import GroundCamera
from graphtrack.kernels.compilation import compiled
from graphtrack.kernels.lanes import choose
from graphtrack.kernels.layout import Field, Kernel, names_of
from graphtrack.model.observation import Observation, States
from graphtrack.model.packing import PackedTracks
from graphtrack.model.term import Term, Variable
from graphtrack.tracks.track import Track

GROUP = "group"
"""The input: the direction of the o-space, x and y of a vector whose length is the weight of the frame, and
the probability that there is a conversation."""

Group = tuple[float, float, float]  # The value of `GROUP` in a frame


def with_group_at(observation: Observation, group: Group | None) -> Observation:
    """Return the observation with the input `GROUP`, unless it has it or ``group`` is None."""
    if group is None or GROUP in observation.inputs:
        return observation
    return replace(observation, inputs={**observation.inputs, GROUP: group})


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
    """−w·log(ε + (1 − ε)·e^−κ(1 − cos Δ)) of an angle; only the non-negative part of its curvature."""
    close = cos * group_cos + sin * group_sin
    across = sin * group_cos - cos * group_sin
    inside = (1.0 - group_outliers) * math.exp(-kappa * (1.0 - close))
    share = inside / (group_outliers + inside)
    gradient[place] += group_weight * share * kappa * across
    slope = kappa * across
    round_part = kappa * close - (1.0 - share) * slope * slope if exact else 1.0 * kappa
    hessian[place, place] += group_weight * share * round_part
    return -group_weight * math.log(group_outliers + inside)


def _faces(name: Variable) -> Kernel:
    names = names_of(name, kappa=f"group_{name}_kappa")
    return Kernel(add_faces_group, gate="group_weight", variables=(name,), names=names)


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

    def cost(self, states: States, track: Track, camera: GroundCamera | None = None) -> float:
        """Σ over frames, for body and head."""
        social = self.parameters.social
        weight, bearing = _weight_and_bearing(track.input(GROUP, 3))
        total = 0.0
        for angle, kappa in ((states.body, social.body_kappa), (states.head, social.head_kappa)):
            close = np.sum(unit(angle) * bearing, axis=1)
            inside = (1.0 - social.outliers) * np.exp(-kappa * (1.0 - close))
            total -= float(np.sum(np.where(weight > 0.0, weight * np.log(social.outliers + inside), 0.0)))
        return total

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
    names = names_of(name, hold=f"group_{name}_hold")
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
