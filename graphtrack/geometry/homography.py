"""Homographies of the plane: fitting, applying, and refusing those that cannot be trusted."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray

LARGEST_CONDITION = 1e10
"""The condition number, after normalising the coordinates, from which a homography counts as singular."""


LARGEST_ENTRY = 1e15
"""The largest number in a homography, and in a point to fit one to, that is not a mistake."""


@dataclass(frozen=True, eq=False)
class HomographyFit:
    """A homography fitted to pairs of points.

    Attributes
    ----------
    homography : (3, 3) source → target
    rms_error, max_error : distance between mapped source and target, in the target's units
    n_pairs : number of pairs; with four the errors are 0 whatever the points are worth
    """

    homography: FloatArray
    rms_error: float
    max_error: float
    n_pairs: int


def fit_homography(source: ArrayLike, target: ArrayLike) -> HomographyFit:
    """The homography that takes ``source`` to ``target``, by the normalised direct linear transform.

    Parameters
    ----------
    source, target : (n, 2), n ≥ 4, any units

    Raises
    ------
    InputError
        With fewer than four pairs, values that are not finite, or points that do not determine a homography
        (three of four in a line, for instance).

    Notes
    -----
    Hartley & Zisserman, Multiple View Geometry, 2nd ed., algorithm 4.2.
    """
    source, target = np.array(source, dtype=float), np.array(target, dtype=float)
    if source.ndim != 2 or source.shape != target.shape or source.shape[1] != 2:
        raise InputError(f"points of shapes {source.shape} and {target.shape}", "two arrays of shape (n, 2)")
    if len(source) < 4:
        raise InputError(f"{len(source)} point pairs", "at least 4")
    if not (np.all(np.abs(source) <= LARGEST_ENTRY) and np.all(np.abs(target) <= LARGEST_ENTRY)):
        raise InputError("a point beyond reason", f"coordinates within ±{LARGEST_ENTRY:g}")
    into_source, into_target = _normaliser(source), _normaliser(target)
    (u, v), (x, y) = apply_homography(into_source, source).T, apply_homography(into_target, target).T
    one, zero = np.ones_like(u), np.zeros_like(u)
    equations = np.concatenate(
        [
            np.column_stack([u, v, one, zero, zero, zero, -x * u, -x * v, -x]),
            np.column_stack([zero, zero, zero, u, v, one, -y * u, -y * v, -y]),
        ]
    )
    _, singular, rows = np.linalg.svd(equations)
    if singular[7] <= singular[0] * 1e-9:
        raise InputError("points in a line (or the same point again)", "4 points, no 3 of them in a line")
    normalised = rows[-1].reshape(3, 3)
    if np.linalg.cond(normalised) > LARGEST_CONDITION:
        raise InputError("points in a line", "4 points, no 3 of them in a line")
    homography = np.linalg.inv(into_target) @ normalised @ into_source
    # What a camera sees of a plane lies on one side of its horizon; the sign shall be positive there.
    depth = homography[2, :2] @ source.T + homography[2, 2]
    if np.median(depth) < 0.0:
        homography, depth = -homography, -depth
    if np.any(depth <= 0.0):
        raise InputError("points on both sides of the horizon", "pairs that one camera can see")
    error = np.linalg.norm(apply_homography(homography, source) - target, axis=1)
    return HomographyFit(homography, float(np.sqrt(np.mean(error**2))), float(error.max()), len(source))


def apply_homography(homography: ArrayLike, points: ArrayLike) -> FloatArray:
    """Map points (..., 2); points on the line that goes to infinity give NaN."""
    homography, points = np.asarray(homography, dtype=float), np.asarray(points, dtype=float)
    mapped = points @ homography[:, :2].T + homography[:, 2]
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        result = mapped[..., :2] / mapped[..., 2:]
    return np.where(np.isfinite(result), result, np.nan)


def jacobian(homography: ArrayLike, points: ArrayLike) -> FloatArray:
    """Derivative (..., 2, 2) of `apply_homography` at points (..., 2)."""
    homography, points = np.asarray(homography, dtype=float), np.asarray(points, dtype=float)
    mapped = points @ homography[:, :2].T + homography[:, 2]
    w = mapped[..., 2, None, None]
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        result = (homography[:2, :2] - mapped[..., :2, None] / w * homography[2, :2]) / w
    return np.where(np.isfinite(result), result, np.nan)


def check_homography(homography: ArrayLike) -> FloatArray:
    """The homography as a (3, 3) array of determinate sign and size.

    Raises
    ------
    InputError
        If it has another shape, is not finite or is singular for all practical purposes.
    """
    homography = np.array(homography, dtype=float)
    if homography.shape != (3, 3):
        raise InputError(f"a homography of shape {homography.shape}", "shape (3, 3)")
    if not np.all(np.abs(homography) <= LARGEST_ENTRY):
        raise InputError("a homography with a value beyond reason", f"nine numbers within ±{LARGEST_ENTRY:g}")
    # Balance rows and columns first: metres and pixels rightly differ in size, that is not singular.
    balanced = homography.copy()
    for _ in range(10):
        for axis in (0, 1):
            size = np.linalg.norm(balanced, axis=axis, keepdims=True)
            if np.any(size < 1.0 / LARGEST_ENTRY**2):
                raise InputError("a singular homography", "an invertible one")
            balanced = balanced / size
    if not np.linalg.cond(balanced) < LARGEST_CONDITION:
        raise InputError("a singular homography", "an invertible one")
    return homography


def _normaliser(points: FloatArray) -> FloatArray:
    """The similarity that brings points to mean 0 and mean distance √2."""
    centre = points.mean(axis=0)
    distance = float(np.mean(np.linalg.norm(points - centre, axis=1)))
    if not 0.0 < distance < np.inf:
        raise InputError("the same point again and again", "4 points, no 3 of them in a line")
    scale = np.sqrt(2.0) / distance
    return np.array([[scale, 0.0, -scale * centre[0]], [0.0, scale, -scale * centre[1]], [0.0, 0.0, 1.0]])
