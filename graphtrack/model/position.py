"""Term 6: the position likelihood, in metres or in pixels."""

from __future__ import annotations

from collections.abc import Sequence

import gtsam
import numpy as np

from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray
from graphtrack.geometry.camera import GroundCamera
from graphtrack.geometry.homography import apply_homography, jacobian
from graphtrack.model.custom import custom_factor, unit_noise
from graphtrack.model.kernels.packing import PackedTracks
from graphtrack.model.kernels.position import CAUCHY, HUBER
from graphtrack.model.parameters import LikelihoodParameters
from graphtrack.model.steps import States, Step
from graphtrack.model.term import Term
from graphtrack.tracks import Track


def robust_loss(distance: FloatArray, likelihood: LikelihoodParameters) -> FloatArray:
    """Cost of residuals ``distance`` standard deviations long, as GTSAM's estimators define it."""
    k = likelihood.robust_threshold
    if likelihood.robust == "huber":
        return np.where(distance <= k, 0.5 * distance**2, k * (distance - 0.5 * k))
    if likelihood.robust == "cauchy":
        return 0.5 * k**2 * np.log1p((distance / k) ** 2)
    return 0.5 * distance**2


def robust_noise(noise: gtsam.noiseModel.Base, likelihood: LikelihoodParameters) -> gtsam.noiseModel.Base:
    """The noise model, made robust as the parameters say."""
    estimators = gtsam.noiseModel.mEstimator
    if likelihood.robust == "huber":
        return gtsam.noiseModel.Robust.Create(estimators.Huber.Create(likelihood.robust_threshold), noise)
    if likelihood.robust == "cauchy":
        return gtsam.noiseModel.Robust.Create(estimators.Cauchy.Create(likelihood.robust_threshold), noise)
    return noise


def _mass(likelihood: LikelihoodParameters) -> float:
    """∫ exp(−ρ(d))·d dd from 0: the mass of the loss over that of a Gaussian in the plane."""
    square = likelihood.robust_threshold**2
    if likelihood.robust == "huber":
        return 1.0 + float(np.exp(-0.5 * square)) / square
    if likelihood.robust == "cauchy":
        if square <= 2.0:
            raise InputError(
                f"likelihood.robust_threshold = {likelihood.robust_threshold:g} with the Cauchy loss",
                "more than √2, below which it is no density",
            )
        return square / (square - 2.0)
    return 1.0


class PositionLikelihood(Term):
    """Gaussian in metres, or in pixels through the camera (002 eq. 12); robust by option."""

    linear = True  # where `PackedTracks.is_linear` finds neither pixels nor a robust loss

    def factors(self, step: Step) -> Sequence[gtsam.NonlinearFactor]:
        """A native prior in metres, or a custom factor in pixels."""
        likelihood, seen = self.parameters.likelihood, step.observation
        if likelihood.image_frame and seen.pixel is not None and step.camera is not None:
            return [self._pixel_factor(step.position_key, np.array(seen.pixel), step.camera)]
        if seen.position is None:
            return []
        std = likelihood.position_std if seen.position_std is None else seen.position_std
        noise = robust_noise(gtsam.noiseModel.Isotropic.Sigma(2, std), likelihood)
        return [gtsam.PriorFactorPoint2(step.position_key, np.array(seen.position), noise)]

    def _pixel_factor(self, key: int, pixel: FloatArray, camera: GroundCamera) -> gtsam.NonlinearFactor:
        # The lens is taken out of the observation once; what remains is the plane's homography.
        ideal, std = camera.undistort(pixel), self.parameters.likelihood.pixel_std
        to_image = np.linalg.inv(camera.homography)

        def residual(values: gtsam.Values) -> FloatArray:
            return (apply_homography(to_image, values.atPoint2(key)) - ideal) / std

        def linearised(values: gtsam.Values) -> tuple[FloatArray, Sequence[FloatArray]]:
            position = values.atPoint2(key)
            return residual(values), [jacobian(to_image, position) / std]

        noise = robust_noise(unit_noise(2), self.parameters.likelihood)
        return custom_factor([key], 2, residual, linearised, noise)

    def cost(self, states: States, track: Track, camera: GroundCamera | None = None) -> float:
        """Negative log density of the observed positions."""
        likelihood = self.parameters.likelihood
        std = np.full(len(track), likelihood.position_std)
        if track.position_std is not None:
            std = np.where(np.isfinite(track.position_std), track.position_std, std)
        residual = (states.position - track.position) / std[:, None]
        if likelihood.image_frame and track.pixel is not None and camera is not None:
            seen = np.isfinite(track.pixel).all(axis=1)
            to_image = np.linalg.inv(camera.homography)
            predicted = apply_homography(to_image, states.position[seen])
            residual[seen] = (predicted - camera.undistort(track.pixel[seen])) / likelihood.pixel_std
        residual = residual[np.isfinite(residual).all(axis=1)]
        return float(robust_loss(np.linalg.norm(residual, axis=1), likelihood).sum())

    def log_normaliser(self, track: Track, camera: GroundCamera | None = None) -> float:
        """log 2πσ² of each observed position, with the mass of the robust loss's tails.

        Raises
        ------
        InputError
            For a Cauchy loss with k² ≤ 2, whose tails have no finite mass.
        """
        likelihood = self.parameters.likelihood
        std = np.full(len(track), likelihood.position_std)
        if track.position_std is not None:
            std = np.where(np.isfinite(track.position_std), track.position_std, std)
        seen = np.isfinite(track.position).all(axis=1)
        if likelihood.image_frame and track.pixel is not None and camera is not None:
            in_image = np.isfinite(track.pixel).all(axis=1)
            std[in_image] = likelihood.pixel_std
            seen |= in_image
        return float(np.log(2.0 * np.pi * std[seen] ** 2).sum() + seen.sum() * np.log(_mass(likelihood)))

    def pack(self, packed: PackedTracks) -> None:
        """Observed positions or pixels with their information, and the robust loss."""
        likelihood, records = self.parameters.likelihood, packed.records
        std = np.full(len(records), likelihood.position_std)
        given = packed.channel("position_std")
        if given is not None:
            std = np.where(np.isfinite(given), given, std)
        records["x"], records["y"] = np.nan_to_num(packed.local_position).T
        records["position_information"] = np.where(packed.has_position, std**-2.0, 0.0)
        packed.shared["robust"] = {"none": 0, "huber": HUBER, "cauchy": CAUCHY}[likelihood.robust]
        packed.shared["robust_threshold"] = likelihood.robust_threshold
        pixel, camera = packed.channel("pixel"), packed.camera
        if not likelihood.image_frame or pixel is None or camera is None:
            return
        seen = np.isfinite(pixel).all(axis=1)
        records["u"][seen], records["v"][seen] = camera.undistort(pixel[seen]).T
        records["pixel_information"][seen] = likelihood.pixel_std**-2
        packed.shared["to_image"] = np.linalg.inv(camera.homography)
