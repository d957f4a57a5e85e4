"""Term 2: body and head turn by rotational diffusion. Von Mises factors are native."""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

import gtsam
import numpy as np
from scipy import special

from graphtrack.geometry.angles import FloatArray
from graphtrack.geometry.camera import GroundCamera
from graphtrack.model.kernels.packing import PackedTracks
from graphtrack.model.steps import States, Step
from graphtrack.model.term import Term, Variable
from graphtrack.tracks import Track


def von_mises_noise(kappa: float) -> gtsam.noiseModel.Base:
    """Noise with which a Frobenius factor on Rot2 costs exactly κ·(1 − cos Δ)."""
    # ‖R(a) − R(b)‖² = 4(1 − cos Δ), and the factor costs half of it over σ²: hence σ² = 2/κ.
    return gtsam.noiseModel.Isotropic.Sigma(4, float(np.sqrt(2.0 / kappa)))


def von_mises_prior(key: int, mean: float, kappa: float) -> gtsam.NonlinearFactor:
    """A native factor that costs κ·(1 − cos(angle − mean)); κ > 0."""
    return gtsam.FrobeniusPriorRot2(key, gtsam.Rot2(mean).matrix(), von_mises_noise(kappa))


def von_mises_between(first: int, second: int, kappa: float) -> gtsam.NonlinearFactor:
    """A native factor that costs κ·(1 − cos(second − first)); κ > 0."""
    return gtsam.FrobeniusBetweenFactorRot2(first, second, gtsam.Rot2(), von_mises_noise(kappa))


def _turn_kappa(dt: FloatArray, diffusion: float) -> FloatArray:
    return np.divide(1.0, diffusion * dt, out=np.zeros_like(dt), where=dt > 0.0)


def _turns_normaliser(track: Track, diffusion: float) -> float:
    """log 2π·I₀(κ)·e^−κ of each turn, and log 2π of the first orientation, which may be any."""
    kappa = 1.0 / (diffusion * np.diff(track.t))
    return float(np.log(2.0 * np.pi * special.i0e(kappa)).sum() + np.log(2.0 * np.pi))


class BodyDynamics(Term):
    """V(θ_t; θ_{t−1}, 1/(diffusion·Δt)) (002 eq. 8, first factor)."""

    uses: ClassVar[frozenset[Variable]] = frozenset({"body"})

    def factors(self, step: Step) -> Sequence[gtsam.NonlinearFactor]:
        """One native factor from the step before."""
        if step.previous is None or step.dt is None:
            return []
        kappa = 1.0 / (self.parameters.orientation.body_diffusion * step.dt)
        return [von_mises_between(step.previous.body_key, step.body_key, kappa)]

    def cost(self, states: States, track: Track, camera: GroundCamera | None = None) -> float:
        """Σ κ(Δt)·(1 − cos Δθ)."""
        kappa = 1.0 / (self.parameters.orientation.body_diffusion * np.diff(track.t))
        return float(np.sum(kappa * (1.0 - np.cos(np.diff(states.body)))))

    def log_normaliser(self, track: Track, camera: GroundCamera | None = None) -> float:
        """Of the von Mises densities of the turns."""
        return _turns_normaliser(track, self.parameters.orientation.body_diffusion)

    def pack(self, packed: PackedTracks) -> None:
        """κ between frames."""
        packed.records["body_turn_kappa"] = _turn_kappa(packed.dt, self.parameters.orientation.body_diffusion)


class HeadDynamics(Term):
    """V(α_t; α_{t−1}, 1/(diffusion·Δt)) (002 eq. 10, first factor)."""

    uses: ClassVar[frozenset[Variable]] = frozenset({"head"})

    def factors(self, step: Step) -> Sequence[gtsam.NonlinearFactor]:
        """One native factor from the step before."""
        if step.previous is None or step.dt is None:
            return []
        kappa = 1.0 / (self.parameters.orientation.head_diffusion * step.dt)
        return [von_mises_between(step.previous.head_key, step.head_key, kappa)]

    def cost(self, states: States, track: Track, camera: GroundCamera | None = None) -> float:
        """Σ κ(Δt)·(1 − cos Δα)."""
        kappa = 1.0 / (self.parameters.orientation.head_diffusion * np.diff(track.t))
        return float(np.sum(kappa * (1.0 - np.cos(np.diff(states.head)))))

    def log_normaliser(self, track: Track, camera: GroundCamera | None = None) -> float:
        """Of the von Mises densities of the turns."""
        return _turns_normaliser(track, self.parameters.orientation.head_diffusion)

    def pack(self, packed: PackedTracks) -> None:
        """κ between frames."""
        packed.records["head_turn_kappa"] = _turn_kappa(packed.dt, self.parameters.orientation.head_diffusion)
