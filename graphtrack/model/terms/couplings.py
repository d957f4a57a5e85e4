"""The couplings of motion, body and head (Chen et al. 2011, eq. 8–10)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, ClassVar

import numpy as np

from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray
from graphtrack.kernels.layout import Field
from graphtrack.model.costs import Cost, chord
from graphtrack.model.factors import von_mises_between
from graphtrack.model.kernel import Kernel
from graphtrack.model.observation import Step
from graphtrack.model.packing import PackedTracks
from graphtrack.model.term import Term, Variable
from graphtrack.packages import gtsam, sympy

BODY_FREE, HEAD_FREE = "body_free", "head_free"
"""Inputs with the share, 0…1, to which a coupling does not hold in a frame: the context of a person, such as
a shop window or a conversation, of which Baxter et al. (2014, §V) expect other priors."""


def held(given: FloatArray | float | tuple[float, ...] | None) -> FloatArray:
    """Return 1 − share of one of these inputs, 1 where it is absent (NaN, None).

    InputError for a share outside of 0…1.
    """
    share = np.asarray(np.nan if given is None else given, dtype=float)
    wrong = share[np.isfinite(share) & ~((share >= 0.0) & (share <= 1.0))]
    if wrong.size:
        raise InputError(f"a share {wrong[0]:g} of a free orientation", "a number from 0 to 1")
    return np.asarray(1.0 - np.nan_to_num(share))


def body_follows_motion(now: Any, kappa: Any, speed_threshold: Any) -> Cost:
    """Return κ₁·(‖v‖ − τ)²·(1 − cos(θ − ang v)) for speeds above τ."""
    speed = sympy.sqrt(now.vx**2 + now.vy**2)
    excess = speed - speed_threshold
    residuals = chord(kappa, now.body, (now.vx / speed, now.vy / speed), excess)
    return Cost(residuals, where=sympy.And(excess > 0, speed > 0))


class BodyFollowsMotion(Term):
    """κ(v)·(1 − cos(θ − ang v)) with κ(v) = κ₁·max(0, ‖v‖ − τ)² (Chen et al. 2011, eq. 8–9).

    κ₁ is 1 − `BODY_FREE` times as large in frames with this input.
    """

    uses: ClassVar[frozenset[Variable]] = frozenset({"body"})

    repeats = True
    reads = ("coupling.motion_body_kappa", "coupling.speed_threshold", "coupling.correlation_time")
    fields = (Field("motion_body_kappa", "κ₁ with the frame's weight"),)
    shared = (Field("speed_threshold", "τ in m/s"),)
    scaled = (("motion_body_kappa", "coupling.motion_body_kappa", 1.0),)
    kernels = (
        Kernel(
            body_follows_motion,
            gate="motion_body_kappa",
            variables=("velocity", "body"),
            names={"kappa": "motion_body_kappa"},
        ),
    )

    def pack(self, packed: PackedTracks) -> None:
        """κ₁ with the frames' weights, and τ."""
        coupling = self.parameters.coupling
        kappa = packed.parameter("coupling.motion_body_kappa", coupling.motion_body_kappa)
        weight = coupling.weights(packed.dt) * held(packed.input(BODY_FREE))
        packed.records["motion_body_kappa"] = kappa * weight
        packed.shared["speed_threshold"] = coupling.speed_threshold


def head_follows_body(now: Any, head_body_kappa: Any) -> list[Any]:
    """Return the residuals of κ₂·(1 − cos(α − θ))."""
    return chord(head_body_kappa, now.head, now.body)


class HeadFollowsBody(Term):
    """κ₂·(1 − cos(α − θ)) (Chen et al. 2011, eq. 10, second factor).

    κ₂ is 1 − `HEAD_FREE` times as large in frames with this input.
    """

    uses: ClassVar[frozenset[Variable]] = frozenset({"body", "head"})

    repeats = True
    reads = ("coupling.head_body_kappa", "coupling.correlation_time")
    fields = (Field("head_body_kappa", "κ₂ with the frame's weight"),)
    scaled = (("head_body_kappa", "coupling.head_body_kappa", 1.0),)
    kernels = (Kernel(head_follows_body, gate="head_body_kappa", variables=("body", "head")),)

    def factors(self, step: Step) -> Sequence[gtsam.NonlinearFactor]:
        """One native factor."""
        coupling = self.parameters.coupling
        free = step.observation.inputs.get(HEAD_FREE)
        kappa = coupling.head_body_kappa * float(coupling.weights(step.dt)) * float(held(free))
        return [von_mises_between(step.body_key, step.head_key, kappa)] if kappa > 0.0 else []

    def pack(self, packed: PackedTracks) -> None:
        """κ₂ with the frames' weights."""
        coupling = self.parameters.coupling
        kappa = packed.parameter("coupling.head_body_kappa", coupling.head_body_kappa)
        weight = coupling.weights(packed.dt) * held(packed.input(HEAD_FREE))
        packed.records["head_body_kappa"] = kappa * weight
