"""Products of von Mises densities."""

import numpy as np
from numpy.typing import ArrayLike

from graphtrack.geometry.angles import FloatArray


def von_mises_product(
    mean_1: ArrayLike, kappa_1: ArrayLike, mean_2: ArrayLike, kappa_2: ArrayLike
) -> tuple[FloatArray, FloatArray]:
    """Mean (radians) and concentration of the normalised product of two von Mises densities.

    It is again a von Mises, with the resultant κ₁·u(μ₁) + κ₂·u(μ₂).
    """
    resultant = np.asarray(kappa_1) * np.exp(1j * np.asarray(mean_1))
    resultant = resultant + np.asarray(kappa_2) * np.exp(1j * np.asarray(mean_2))
    return np.angle(resultant), np.abs(resultant)
