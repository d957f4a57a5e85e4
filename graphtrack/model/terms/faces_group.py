"""A member of a conversation faces its o-space, with weight and with outliers."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import ClassVar

import numpy as np

from graphtrack.geometry.angles import FloatArray, unit
from graphtrack.geometry.camera import GroundCamera
from graphtrack.kernels.compilation import compiled
from graphtrack.kernels.layout import Field, Kernel
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
    names = {
        "place": name.upper(),
        "cos": f"{name}_cos",
        "sin": f"{name}_sin",
        "kappa": f"group_{name}_kappa",
    }
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
