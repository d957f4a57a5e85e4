"""The position likelihood, in metres or in pixels."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np

from graphtrack.geometry.angles import FloatArray
from graphtrack.kernels.layout import Field
from graphtrack.model.costs import Cost
from graphtrack.model.kernel import Kernel
from graphtrack.model.observation import Observation, Step
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


OBSERVED_POSITION = Kernel(
    observed_position,
    gate="position_information",
    variables=("position",),
    unless="pixel_information",
    names={"information": "position_information"},
)
OBSERVED_PIXEL = Kernel(
    observed_pixel,
    gate="pixel_information",
    variables=("position",),
    names={"information": "pixel_information"},
    shapes={"to_image": (3, 3)},
)


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
    kernels = (OBSERVED_POSITION, OBSERVED_PIXEL)

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
