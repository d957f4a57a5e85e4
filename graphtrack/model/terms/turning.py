"""Body and head turn by rotational diffusion. Von Mises factors are native."""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

import numpy as np

from graphtrack.geometry.angles import FloatArray
from graphtrack.geometry.camera import GroundCamera
from graphtrack.kernels.compilation import compiled
from graphtrack.kernels.layout import Field, Kernel, names_of
from graphtrack.model.factors import von_mises_between
from graphtrack.model.observation import States, Step
from graphtrack.model.packing import PackedTracks
from graphtrack.model.term import Term, Variable
from graphtrack.packages import gtsam, special
from graphtrack.tracks.track import Track


@compiled
def add_turn(
    cos_before: float,
    sin_before: float,
    cos: float,
    sin: float,
    place: int,
    turn_kappa: float,
    exact: bool,
    gradient_before: FloatArray,
    gradient: FloatArray,
    hessian_before: FloatArray,
    hessian: FloatArray,
    transition: FloatArray,
) -> float:
    """κ·(1 − cos Δ) between an angle and its previous value."""
    close = cos_before * cos + sin_before * sin
    pull = turn_kappa * (sin * cos_before - cos * sin_before)
    curvature = turn_kappa * close if exact else turn_kappa
    gradient[place] += pull
    gradient_before[place] -= pull
    hessian[place, place] += curvature
    hessian_before[place, place] += curvature
    transition[place, place] -= curvature
    return turn_kappa * (1.0 - close)


def _turning(name: Variable) -> Kernel:
    gate = f"{name}_turn_kappa"
    names = names_of(name, turn_kappa=gate)
    return Kernel(add_turn, gate=gate, variables=(name,), before=(name,), names=names)


_READ = ("diffusion", "white_share", "turn_rate", "turn_time")


class _OrientationDynamics(Term):
    """Rotational diffusion of one orientation."""

    name: ClassVar[Variable]

    @property
    def _diffusion(self) -> float:
        return float(getattr(self.parameters.orientation, f"{self.name}_diffusion"))

    def factors(self, step: Step) -> Sequence[gtsam.NonlinearFactor]:
        """One native factor from the previous step."""
        if step.previous is None or step.dt is None:
            return []
        key = f"{self.name}_key"
        kappa = 1.0 / (self._diffusion * step.dt)
        return [von_mises_between(getattr(step.previous, key), getattr(step, key), kappa)]

    def cost(self, states: States, track: Track, camera: GroundCamera | None = None) -> float:
        """Σ κ(Δt)·(1 − cos Δ)."""
        turn = np.diff(getattr(states, self.name))
        return float(np.sum((1.0 - np.cos(turn)) / (self._diffusion * np.diff(track.t))))

    def turns_normaliser(self, track: Track, camera: GroundCamera | None = None) -> float:
        """log 2π·I₀(κ)·e^−κ of each turn, and log 2π of the first orientation, which is uniform."""
        kappa = 1.0 / (self._diffusion * np.diff(track.t))
        return float(np.log(2.0 * np.pi * special.i0e(kappa)).sum() + np.log(2.0 * np.pi))

    def pack(self, packed: PackedTracks) -> None:
        """κ between frames."""
        variance = self._diffusion * packed.dt
        kappa = np.divide(1.0, variance, out=np.zeros_like(variance), where=variance > 0.0)
        packed.records[f"{self.name}_turn_kappa"] = kappa


class BodyDynamics(_OrientationDynamics):
    """V(θ_t; θ_{t−1}, 1/(diffusion·Δt)) (Chen et al. 2011, eq. 8, first factor)."""

    name = "body"
    uses: ClassVar[frozenset[Variable]] = frozenset({"body"})
    repeats = True
    reads = tuple(f"orientation.body_{name}" for name in _READ)
    fields = (Field("body_turn_kappa", "of rotational diffusion since the frame before; 0 at the first"),)
    kernels = (_turning("body"),)
    log_normaliser = _OrientationDynamics.turns_normaliser


class HeadDynamics(_OrientationDynamics):
    """V(α_t; α_{t−1}, 1/(diffusion·Δt)) (Chen et al. 2011, eq. 10, first factor)."""

    name = "head"
    uses: ClassVar[frozenset[Variable]] = frozenset({"head"})
    repeats = True
    reads = tuple(f"orientation.head_{name}" for name in _READ)
    fields = (Field("head_turn_kappa", "of rotational diffusion since the frame before; 0 at the first"),)
    kernels = (_turning("head"),)
    log_normaliser = _OrientationDynamics.turns_normaliser
