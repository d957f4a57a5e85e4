"""Anchors of undetermined orientations: a track's first, and those that the model does not have."""

from __future__ import annotations

import math

import numpy as np

from graphtrack.geometry.angles import FloatArray
from graphtrack.geometry.camera import GroundCamera
from graphtrack.kernels.compilation import compiled
from graphtrack.kernels.layout import Field, Kernel
from graphtrack.model.observation import States
from graphtrack.model.packing import PackedTracks
from graphtrack.model.parameters import Parameters
from graphtrack.model.term import Term, Variable
from graphtrack.model.terms.pose import add_angle
from graphtrack.tracks.track import Track

ANCHOR_KAPPA = 1e-6
"""Concentration at which a first orientation is held to its initial value: negligible as information, but an
orientation without observations has a solution."""


@compiled
def add_anchor(
    state_cos: float,
    state_sin: float,
    place: int,
    start: FloatArray,
    anchor: float,
    exact: bool,
    gradient: FloatArray,
    hessian: FloatArray,
) -> float:
    """κ·(1 − cos Δ) between an orientation and its initial value."""
    cos, sin = math.cos(start[place]), math.sin(start[place])
    return add_angle(state_cos, state_sin, place, cos, sin, anchor, 0.0, exact, gradient, hessian)


def _held(name: Variable) -> Kernel:
    names = {"place": name.upper(), "anchor": f"{name}_anchor"}
    names |= {f"state_{part}": f"{name}_{part}" for part in ("cos", "sin")}
    return Kernel(add_anchor, gate=f"{name}_anchor", variables=(name,), names=names)


class Anchor(Term):
    """The engine's own term, in no model's list; an orientation that is not estimated stays constant."""

    repeats = True
    fields = (
        Field("body_anchor", "concentration that holds a first orientation to its initial value"),
        Field("head_anchor", ""),
    )
    kernels = (_held("body"), _held("head"))

    def __init__(self, parameters: Parameters, has_body: bool, has_head: bool) -> None:
        super().__init__(parameters)
        self._has = (has_body, has_head)

    def cost(self, states: States, track: Track, camera: GroundCamera | None = None) -> float:
        """0: the anchor depends on the initial values, and is negligible."""
        return 0.0

    def pack(self, packed: PackedTracks) -> None:
        """Anchor the first orientations, and in all frames those that the model does not have."""
        first = np.where(packed.is_first, ANCHOR_KAPPA, 0.0)
        for field, has in zip(self.fields, self._has, strict=True):
            packed.records[field.name] = first if has else 1.0
