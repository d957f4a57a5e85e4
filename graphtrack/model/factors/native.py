"""Native GTSAM factors of von Mises densities."""

from __future__ import annotations

import numpy as np

from graphtrack.later import gtsam


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
