"""Anchors of orientations that nothing else holds: a track's first, and those a model does not have."""

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
"""Concentration at which a first orientation is held to its initial value: it says next to nothing, but an
orientation that nothing else determines has a solution."""


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
    """κ·(1 − cos Δ) between an orientation and where the descent began."""
    cos, sin = math.cos(start[place]), math.sin(start[place])
    return add_angle(state_cos, state_sin, place, cos, sin, anchor, 0.0, exact, gradient, hessian)


def _held(name: Variable) -> Kernel:
    names = {"place": name.upper(), "anchor": f"{name}_anchor"}
    names |= {f"state_{part}": f"{name}_{part}" for part in ("cos", "sin")}
    return Kernel(add_anchor, gate=f"{name}_anchor", variables=(name,), names=names)


class Anchor(Term):
    """The engine's own term, in no model's list; an orientation that is not estimated stands still."""

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
        """0: what it adds depends on where a descent began, and says next to nothing."""
        return 0.0

    def pack(self, packed: PackedTracks) -> None:
        """Hold the first orientations, and everywhere those that the model does not have."""
        first = np.where(packed.is_first, ANCHOR_KAPPA, 0.0)
        for field, has in zip(self.fields, self._has, strict=True):
            packed.records[field.name] = first if has else 1.0
