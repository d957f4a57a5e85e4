"""The position likelihood, in metres or in pixels."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

import numpy as np

from graphtrack.geometry.angles import FloatArray
from graphtrack.geometry.camera import GroundCamera, apply_homography
from graphtrack.kernels.compilation import compiled
from graphtrack.kernels.lanes import choose
from graphtrack.kernels.layout import Field, Kernel, X, Y
from graphtrack.model.observation import Observation, States, Step
from graphtrack.model.packing import PackedTracks
from graphtrack.model.parameters import LikelihoodParameters
from graphtrack.model.term import Term
from graphtrack.packages import gtsam
from graphtrack.tracks.track import Track

HUBER, CAUCHY = 1, 2


def robust_loss(distance: FloatArray, likelihood: LikelihoodParameters) -> FloatArray:
    """Cost of residuals ``distance`` standard deviations long, as GTSAM's estimators define it."""
    k = likelihood.robust_threshold
    if likelihood.robust == "huber":
        return np.where(distance <= k, 0.5 * distance**2, k * (distance - 0.5 * k))
    if likelihood.robust == "cauchy":
        return 0.5 * k**2 * np.log1p((distance / k) ** 2)
    return 0.5 * distance**2


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


@compiled
def robust_weight(square: float, robust: float, robust_threshold: float) -> tuple[float, float, float]:
    """Cost ρ of a residual whose squared length is ``square``, and twice its derivatives ρ' and ρ'' by that.

    The doubling makes ρ' the weight of iteratively reweighted least squares: 1 without a robust loss.
    """
    cost, weight, slope = 0.5 * square, 1.0, 0.0
    scale = robust_threshold * robust_threshold
    if robust == HUBER:
        outside = square > scale
        distance = math.sqrt(choose(outside, square, scale))
        weight = robust_threshold / distance
        cost = choose(outside, robust_threshold * (distance - 0.5 * robust_threshold), cost)
        slope = choose(outside, -0.5 * weight / square, 0.0)
    if robust == CAUCHY:
        weight = scale / (scale + square)
        cost, slope = 0.5 * scale * math.log1p(square / scale), -weight * weight / scale
    return cost, weight, slope


@compiled
def add_position(
    state: FloatArray,
    origin_x: float,
    origin_y: float,
    x: float,
    y: float,
    position_information: float,
    robust: float,
    robust_threshold: float,
    exact: bool,
    gradient: FloatArray,
    hessian: FloatArray,
) -> float:
    """An observed position in metres."""
    information = position_information
    dx, dy = state[X] - (x - origin_x), state[Y] - (y - origin_y)
    cost, weight, slope = robust_weight(information * (dx * dx + dy * dy), robust, robust_threshold)
    pull = weight * information
    gradient[X] += pull * dx
    gradient[Y] += pull * dy
    bend = 2.0 * slope * information * information if exact else 0.0
    hessian[X, X] += pull + bend * dx * dx
    hessian[Y, X] += bend * dx * dy
    hessian[Y, Y] += pull + bend * dy * dy
    return cost


@compiled
def add_pixel(
    state: FloatArray,
    origin_x: float,
    origin_y: float,
    u: float,
    v: float,
    pixel_information: float,
    to_image: FloatArray,
    robust: float,
    robust_threshold: float,
    exact: bool,
    gradient: FloatArray,
    hessian: FloatArray,
) -> float:
    """An observed foot point in pixels, through the homography from the ground to the image."""
    information = pixel_information
    x, y = state[X] + origin_x, state[Y] + origin_y
    depth = to_image[2, 0] * x + to_image[2, 1] * y + to_image[2, 2]
    pu = (to_image[0, 0] * x + to_image[0, 1] * y + to_image[0, 2]) / depth
    pv = (to_image[1, 0] * x + to_image[1, 1] * y + to_image[1, 2]) / depth
    cx, cy = to_image[2, 0] / depth, to_image[2, 1] / depth
    ux, uy = to_image[0, 0] / depth - pu * cx, to_image[0, 1] / depth - pu * cy
    vx, vy = to_image[1, 0] / depth - pv * cx, to_image[1, 1] / depth - pv * cy
    du, dv = pu - u, pv - v
    cost, weight, slope = robust_weight(information * (du * du + dv * dv), robust, robust_threshold)
    pull = weight * information
    gx, gy = ux * du + vx * dv, uy * du + vy * dv
    gradient[X] += pull * gx
    gradient[Y] += pull * gy
    hxx, hyx, hyy = ux * ux + vx * vx, uy * ux + vy * vx, uy * uy + vy * vy
    bend = 0.0
    if exact:
        # The second derivatives of a projection follow from the first.
        hxx -= 2.0 * cx * gx
        hyx -= cx * gy + cy * gx
        hyy -= 2.0 * cy * gy
        bend = 2.0 * slope * information * information
    hessian[X, X] += pull * hxx + bend * gx * gx
    hessian[Y, X] += pull * hyx + bend * gx * gy
    hessian[Y, Y] += pull * hyy + bend * gy * gy
    return cost


ADD_POSITION = Kernel(
    add_position, gate="position_information", variables=("position",), unless="pixel_information"
)
ADD_PIXEL = Kernel(add_pixel, gate="pixel_information", variables=("position",))


class PositionLikelihood(Term):
    """Gaussian in metres, or in pixels through the camera (Chen et al. 2011, eq. 12); robust by option."""

    repeats = True
    reads = (
        "likelihood.position_std",
        "likelihood.position_scale",
        "likelihood.pixel_std",
        "likelihood.image_frame",
        "likelihood.robust",
        "likelihood.robust_threshold",
    )
    fields = (
        Field("x", "observed position in the world, metres"),
        Field("y", ""),
        Field("position_information", "1/σ²; 0: no position was observed"),
        Field("u", "observed pixel without the lens"),
        Field("v", ""),
        Field("pixel_information", "1/σ² in pixels⁻²; 0: no likelihood in pixels"),
    )
    shared = (
        Field("robust", "0 none, 1 Huber, 2 Cauchy"),
        Field("robust_threshold", "standard deviations"),
        Field("to_image", "from metres about the world's origin to ideal pixels", (3, 3)),
    )
    kernels = (ADD_POSITION, ADD_PIXEL)

    def factors(self, step: Step) -> Sequence[gtsam.NonlinearFactor]:
        """A native prior in metres; in pixels, one from the kernel."""
        likelihood, observed = self.parameters.likelihood, step.observation
        if likelihood.image_frame and observed.pixel is not None and step.camera is not None:
            return self.derived_factors(step)
        if observed.position is None:
            return []
        (std,) = likelihood.position_stds(observed.position_std, 1).tolist()
        noise = robust_noise(gtsam.noiseModel.Isotropic.Sigma(2, std), likelihood)
        return [gtsam.PriorFactorPoint2(step.position_key, np.array(observed.position), noise)]

    def cost(self, states: States, track: Track, camera: GroundCamera | None = None) -> float:
        """Negative log density of the observed positions."""
        likelihood = self.parameters.likelihood
        std = likelihood.position_stds(track.position_std, len(track))
        residual = (states.position - track.position) / std[:, None]
        if likelihood.image_frame and track.pixel is not None and camera is not None:
            observed = np.isfinite(track.pixel).all(axis=1)
            to_image = np.linalg.inv(camera.homography)
            predicted = apply_homography(to_image, states.position[observed])
            residual[observed] = (predicted - camera.undistort(track.pixel[observed])) / likelihood.pixel_std
        residual = residual[np.isfinite(residual).all(axis=1)]
        return float(robust_loss(np.linalg.norm(residual, axis=1), likelihood).sum())

    def is_linear(self, packed: PackedTracks) -> bool:
        """True without a robust loss and in metres."""
        return not packed.shared["robust"][0] and not packed.records["pixel_information"].any()

    def live(self, observed: Observation) -> Iterable[tuple[str, float]]:
        """The observed position."""
        return () if observed.position is None else zip("xy", observed.position, strict=True)

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
