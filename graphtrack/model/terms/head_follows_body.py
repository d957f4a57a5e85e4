"""The head follows the body (Chen et al. 2011, eq. 10)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

import numpy as np

from graphtrack.geometry.angles import FloatArray
from graphtrack.geometry.camera import GroundCamera
from graphtrack.kernels.compilation import compiled
from graphtrack.kernels.layout import BODY, HEAD, Field, Kernel
from graphtrack.model.factors import von_mises_between
from graphtrack.model.observation import States, Step
from graphtrack.model.packing import PackedTracks
from graphtrack.model.term import Term, Variable
from graphtrack.packages import gtsam
from graphtrack.tracks.track import Track


@compiled
def add_head_follows_body(
    body_cos: float,
    body_sin: float,
    head_cos: float,
    head_sin: float,
    head_body_kappa: float,
    head_body_cos: float,
    head_body_sin: float,
    exact: bool,
    gradient: FloatArray,
    hessian: FloatArray,
) -> float:
    """κ₂·(1 − cos(α − θ − δ)); ``head_body_cos`` and ``head_body_sin`` are those of the offset δ."""
    kappa = head_body_kappa
    # The head minus the offset follows the body.
    turned_cos = head_cos * head_body_cos + head_sin * head_body_sin
    turned_sin = head_sin * head_body_cos - head_cos * head_body_sin
    cos = body_cos * turned_cos + body_sin * turned_sin
    pull = kappa * (turned_sin * body_cos - turned_cos * body_sin)
    curvature = kappa * cos if exact else kappa
    gradient[HEAD] += pull
    gradient[BODY] -= pull
    hessian[HEAD, HEAD] += curvature
    hessian[BODY, BODY] += curvature
    hessian[HEAD, BODY] -= curvature
    return kappa * (1.0 - cos)


ADD_HEAD_FOLLOWS_BODY = Kernel(
    add_head_follows_body, gate="head_body_kappa", variables=("body", "head"), switched=True
)


class HeadFollowsBody(Term):
    """κ₂·(1 − cos(α − θ)) (Chen et al. 2011, eq. 10, second factor)."""

    uses: ClassVar[frozenset[Variable]] = frozenset({"body", "head"})

    repeats = True
    reads = ("coupling.head_body_kappa", "coupling.correlation_time")
    fields = (
        Field("head_body_kappa", "κ₂ with the frame's weight"),
        Field("head_body_cos", "of the offset of the coupling from body to head"),
        Field("head_body_sin", ""),
    )
    kernels = (ADD_HEAD_FOLLOWS_BODY,)

    def factors(self, step: Step) -> Sequence[gtsam.NonlinearFactor]:
        """One native factor."""
        coupling = self.parameters.coupling
        kappa = coupling.head_body_kappa * float(coupling.weights(step.dt))
        return [von_mises_between(step.body_key, step.head_key, kappa)] if kappa > 0.0 else []

    def cost(self, states: States, track: Track, camera: GroundCamera | None = None) -> float:
        """Σ κ₂·(1 − cos(α − θ)), weighted by the time since the previous frame."""
        coupling = self.parameters.coupling
        kappa = coupling.head_body_kappa * coupling.weights(track.dt)
        return float(np.sum(kappa * (1.0 - np.cos(states.head - states.body))))

    def pack(self, packed: PackedTracks) -> None:
        """κ₂ with the frames' weights."""
        coupling = self.parameters.coupling
        packed.records["head_body_kappa"] = coupling.head_body_kappa * coupling.weights(packed.dt)
        packed.records["head_body_cos"] = 1.0
