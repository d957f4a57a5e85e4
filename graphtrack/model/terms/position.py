"""The likelihoods of an observed position, in metres or in pixels, and of an observed velocity."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np

from graphtrack.geometry.angles import FloatArray
from graphtrack.kernels.layout import Field
from graphtrack.model.costs import Cost
from graphtrack.model.kernel import Kernel
from graphtrack.model.observation import Covariance, Observation, Step
from graphtrack.model.packing import PackedTracks
from graphtrack.model.parameters import LikelihoodParameters
from graphtrack.model.term import Term
from graphtrack.packages import gtsam, sympy

HUBER, CAUCHY = 1, 2


def robust_weights(distance: FloatArray, likelihood: LikelihoodParameters) -> FloatArray:
    """Weights of iteratively reweighted least squares for residuals ``distance`` standard deviations long."""
    k = likelihood.robust_threshold
    if likelihood.robust == "huber":
        return k / np.maximum(distance, k)
    if likelihood.robust == "cauchy":
        return 1.0 / (1.0 + (distance / k) ** 2)
    return np.ones_like(distance)


def robust_noise(noise: gtsam.noiseModel.Base, likelihood: LikelihoodParameters) -> gtsam.noiseModel.Base:
    """The noise model, with the robust loss of the parameters."""
    estimators = gtsam.noiseModel.mEstimator
    if likelihood.robust == "huber":
        return gtsam.noiseModel.Robust.Create(estimators.Huber.Create(likelihood.robust_threshold), noise)
    if likelihood.robust == "cauchy":
        return gtsam.noiseModel.Robust.Create(estimators.Cauchy.Create(likelihood.robust_threshold), noise)
    return noise


def _loss(robust: Any, k: Any) -> Callable[[Any], Any]:
    """Return the loss of a cost ½·d² with the threshold k of d, as GTSAM's estimators have it."""

    def loss(cost: Any) -> Any:
        huber = sympy.Piecewise((k * sympy.sqrt(2 * cost) - k**2 / 2, 2 * cost > k**2), (cost, True))
        cauchy = k**2 / 2 * sympy.log(1 + 2 * cost / k**2)
        return sympy.Piecewise((cauchy, robust > 1.5), (huber, robust > 0.5), (cost, True))

    return loss


def observed_position(now: Any, x: Any, y: Any, information: Any, robust: Any, robust_threshold: Any) -> Cost:
    """Return the cost of an observed position in metres."""
    root = sympy.sqrt(information)
    return Cost([root * (now.x - x), root * (now.y - y)], _loss(robust, robust_threshold))


def observed_pixel(
    now: Any, u: Any, v: Any, information: Any, to_image: Any, robust: Any, robust_threshold: Any
) -> Cost:
    """Return the cost of an observed foot point in pixels, by the homography from the ground to the image."""
    across, down, depth = (row[0] * now.x + row[1] * now.y + row[2] for row in to_image)
    root = sympy.sqrt(information)
    residuals = [root * (across / depth - u), root * (down / depth - v)]
    return Cost(residuals, _loss(robust, robust_threshold))


def observed_ellipse(
    now: Any, x: Any, y: Any, root_xx: Any, root_xy: Any, root_yy: Any, robust: Any, robust_threshold: Any
) -> Cost:
    """Return the cost of an observed position with a full covariance, by the root of its inverse."""
    right, up = now.x - x, now.y - y
    return Cost([root_xx * right + root_xy * up, root_yy * up], _loss(robust, robust_threshold))


def observed_velocity(now: Any, vx: Any, vy: Any, root_xx: Any, root_xy: Any, root_yy: Any) -> list[Any]:
    """Return the residuals of an observed velocity, by the root of its inverse covariance."""
    right, up = now.vx - vx, now.vy - vy
    return [root_xx * right + root_xy * up, root_yy * up]


OBSERVED_POSITION = Kernel(
    observed_position,
    gate="position_information",
    variables=("position",),
    unless="position_replaced",
    names={"information": "position_information"},
)
_ROOT = ("xx", "xy", "yy")
_ELLIPSE, _VELOCITY = ([f"{name}_{part}" for part in _ROOT] for name in ("ellipse", "velocity"))
OBSERVED_ELLIPSE = Kernel(
    observed_ellipse,
    gate="ellipse_xx",
    variables=("position",),
    names={f"root_{part}": f"ellipse_{part}" for part in _ROOT},
)
OBSERVED_VELOCITY = Kernel(
    observed_velocity,
    gate="velocity_xx",
    variables=("velocity",),
    names={f"root_{part}": f"velocity_{part}" for part in _ROOT} | {"vx": "observed_vx", "vy": "observed_vy"},
)
OBSERVED_PIXEL = Kernel(
    observed_pixel,
    gate="pixel_information",
    variables=("position",),
    names={"information": "pixel_information"},
    shapes={"to_image": (3, 3)},
)


def _roots(covariance: FloatArray) -> FloatArray:
    """Return the upper triangles R (n, 3), as xx, xy, yy, of RᵀR = inverses of covariances (n, 2, 2)."""
    variance, both = covariance[:, 1, 1], covariance[:, 0, 1]
    xx = 1.0 / np.sqrt(covariance[:, 0, 0] - both**2 / variance)
    return np.stack([xx, -xx * both / variance, 1.0 / np.sqrt(variance)], axis=1)


def _root(covariance: Covariance, scale: float) -> tuple[tuple[float, float, float], float]:
    """Return the root of the inverse of a scaled covariance, as `_roots`, and the mean variance, m²."""
    (first, both), (_, second) = covariance
    xx = 1.0 / (scale * math.sqrt(first - both * both / second))
    return (xx, -xx * both / second, 1.0 / (scale * math.sqrt(second))), 0.5 * scale**2 * (first + second)


def _gaussian(covariance: FloatArray) -> gtsam.noiseModel.Base:
    return gtsam.noiseModel.Gaussian.Covariance(covariance)


class PositionLikelihood(Term):
    """Gaussian in metres, or in pixels through the camera (Chen et al. 2011, eq. 12); robust by option.

    A position may have a full covariance. An observed velocity is Gaussian.
    """

    repeats = True
    reads = (
        "likelihood.position_std",
        "likelihood.position_scale",
        "likelihood.velocity_std",
        "likelihood.pixel_std",
        "likelihood.image_frame",
        "likelihood.robust",
        "likelihood.robust_threshold",
    )
    fields = (
        Field("x", "observed position in the world, metres"),
        Field("y", ""),
        Field("position_information", "1/σ²; 0: no position was observed"),
        Field("position_replaced", "1 where a pixel or an ellipse is in place of that"),
        Field("ellipse_xx", "root of the inverse covariance of a position, upper triangle"),
        Field("ellipse_xy", ""),
        Field("ellipse_yy", ""),
        Field("observed_vx", "observed velocity, m/s"),
        Field("observed_vy", ""),
        Field("velocity_xx", "root of the inverse covariance of an observed velocity"),
        Field("velocity_xy", ""),
        Field("velocity_yy", ""),
        Field("u", "observed pixel without the lens"),
        Field("v", ""),
        Field("pixel_information", "1/σ² in pixels⁻²; 0: no likelihood in pixels"),
    )
    shared = (
        Field("robust", "0 none, 1 Huber, 2 Cauchy"),
        Field("robust_threshold", "standard deviations"),
        Field("to_image", "from metres about the world's origin to ideal pixels", (3, 3)),
    )
    kernels = (OBSERVED_POSITION, OBSERVED_PIXEL, OBSERVED_ELLIPSE, OBSERVED_VELOCITY)

    def factors(self, step: Step) -> Sequence[gtsam.NonlinearFactor]:
        """Native priors in metres; in pixels, one from the kernel."""
        likelihood, observed = self.parameters.likelihood, step.observation
        if likelihood.image_frame and observed.pixel is not None and step.camera is not None:
            return self.derived_factors(step)
        found: list[gtsam.NonlinearFactor] = []
        if observed.position is not None:
            if observed.position_covariance is not None:
                noise = _gaussian(likelihood.position_scale**2 * np.array(observed.position_covariance))
            else:
                (std,) = likelihood.position_stds(observed.position_std, 1).tolist()
                noise = gtsam.noiseModel.Isotropic.Sigma(2, std)
            at = np.array(observed.position)
            found.append(gtsam.PriorFactorPoint2(step.position_key, at, robust_noise(noise, likelihood)))
        if observed.observed_velocity is not None:
            if observed.observed_velocity_covariance is not None:
                noise = _gaussian(np.array(observed.observed_velocity_covariance))
            else:
                noise = gtsam.noiseModel.Isotropic.Sigma(2, likelihood.velocity_std)
            at = np.array(observed.observed_velocity)
            found.append(gtsam.PriorFactorPoint2(step.velocity_key, at, noise))
        return found

    def is_linear(self, packed: PackedTracks) -> bool:
        """True without a robust loss, in metres, of positions alone whose axes are alike."""
        records = packed.records
        further = records["position_replaced"].any() or records["velocity_xx"].any()
        return not packed.shared["robust"][0] and not further

    def live(self, observed: Observation) -> Iterable[tuple[str, float]]:
        """The observed position and velocity, and their covariances."""
        if observed.position is None and observed.observed_velocity is None:
            return ()
        likelihood, found = self.parameters.likelihood, list[tuple[str, float]]()
        if observed.position is not None:
            found += zip("xy", observed.position, strict=True)
            if observed.position_covariance is not None:
                root, mean = _root(observed.position_covariance, likelihood.position_scale)
                found += zip(_ELLIPSE, root, strict=True)
                found.append(("position_information", 1.0 / mean))
        if observed.observed_velocity is not None:
            found += zip(("observed_vx", "observed_vy"), observed.observed_velocity, strict=True)
            covariance, std = observed.observed_velocity_covariance, likelihood.velocity_std
            root = (1.0 / std, 0.0, 1.0 / std) if covariance is None else _root(covariance, 1.0)[0]
            found += zip(_VELOCITY, root, strict=True)
        return found

    def pack(self, packed: PackedTracks) -> None:
        """Observed positions or pixels with their information, and the robust loss."""
        likelihood, records = self.parameters.likelihood, packed.records
        std = likelihood.position_stds(packed.channel("position_std"), len(records))
        records["x"], records["y"] = packed.position.T
        # Not `std**-2.0`, which takes ten times as long.
        records["position_information"] = 1.0 / np.square(std)
        if not packed.has_position.all():
            for name in ("x", "y", "position_information"):
                records[name][~packed.has_position] = 0.0
        self._pack_ellipses(packed)
        self._pack_velocities(packed)
        packed.shared["robust"] = {"none": 0, "huber": HUBER, "cauchy": CAUCHY}[likelihood.robust]
        packed.shared["robust_threshold"] = likelihood.robust_threshold
        pixel, camera = packed.channel("pixel"), packed.camera
        if camera is not None:
            packed.shared["to_image"] = np.linalg.inv(camera.homography)
        if not likelihood.image_frame or pixel is None or camera is None:
            return
        observed = np.isfinite(pixel).all(axis=1)
        records["u"][observed], records["v"][observed] = camera.undistort(pixel[observed]).T
        records["pixel_information"][observed] = likelihood.pixel_std**-2
        records["position_replaced"][observed], records["ellipse_xx"][observed] = 1.0, 0.0

    def _pack_ellipses(self, packed: PackedTracks) -> None:
        covariance, records = packed.channel("position_covariance"), packed.records
        if covariance is None:
            return
        known = packed.has_position & np.isfinite(covariance).all(axis=(1, 2))
        scaled = self.parameters.likelihood.position_scale**2 * covariance[known]
        for name, values in zip(_ROOT, _roots(scaled).T, strict=True):
            records[f"ellipse_{name}"][known] = values
        # Of a circle with the mean variance, where a start is wanted.
        records["position_information"][known] = 2.0 / np.trace(scaled, axis1=1, axis2=2)
        records["position_replaced"][known] = 1.0

    def _pack_velocities(self, packed: PackedTracks) -> None:
        velocity, records = packed.channel("observed_velocity"), packed.records
        if velocity is None:
            return
        known = np.isfinite(velocity).all(axis=1)
        covariance = np.tile(self.parameters.likelihood.velocity_std**2 * np.eye(2), (int(known.sum()), 1, 1))
        declared = packed.channel("observed_velocity_covariance")
        if declared is not None:
            given = np.isfinite(declared[known]).all(axis=(1, 2))
            covariance[given] = declared[known][given]
        for name, values in zip(_ROOT, _roots(covariance).T, strict=True):
            records[f"velocity_{name}"][known] = values
        records["observed_vx"][known], records["observed_vy"][known] = velocity[known].T
