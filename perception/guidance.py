"""The graph in a tracker's loop: it smooths what the tracker finds, and says where to look next."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from graphtrack.angles import FloatArray
from graphtrack.inference import Estimate, OnlineSmoother
from graphtrack.model import Model, Observation
from graphtrack.model.motion import process_noise, transition_matrix
from perception.box_camera import BoxCamera
from perception.classes import PoseClasses
from perception.trackers.tracker import BoxEstimate, Proposal

_WIDEST = 1e4
"""Pixels: a prediction that is less sure than that says nothing."""


class GraphGuide:
    """An `OnlineSmoother` on the ground beside a tracker in the image.

    After each frame it takes the tracker's estimate as an observation (where the target was not found,
    there is none), and before the next it predicts the middle of the target's box. While the target is
    hidden the prediction goes on with the last velocity and becomes less and less sure.

    Parameters
    ----------
    boxes : from boxes to the ground
    pan_classes : of the tracker; None for one without pans
    model : of the graph; by default the package's
    lag : seconds of history that the graph keeps open
    """

    def __init__(
        self,
        boxes: BoxCamera,
        pan_classes: PoseClasses | None = None,
        *,
        model: Model | str | Path | None = None,
        lag: float = 2.0,
    ) -> None:
        self.boxes, self.pan_classes = boxes, pan_classes
        self._smoother = OnlineSmoother(model, engine="chain", lag=lag)
        self._last: Estimate | None = None
        self._height = 0.0

    def observe(self, estimate: BoxEstimate, t: float) -> None:
        """Take in what the tracker says of the frame at ``t`` seconds."""
        observation = Observation(t)
        place = self.boxes.position(estimate.box)
        if estimate.found and np.isfinite(place).all():
            self._height = estimate.box[3]
            x, y = place.tolist()
            std = self.boxes.position_std(estimate.box, estimate.particles, estimate.weights)
            observation = replace(observation, position=(x, y), position_std=std)
            if estimate.pan_likelihood is not None and self.pan_classes is not None:
                head = self.boxes.head_likelihood(
                    estimate.pan_likelihood[None], self.pan_classes, place[None]
                )
                observation = replace(observation, head_likelihood=tuple(head[0].tolist()))
        self._last = self._smoother.update(observation)

    def predict(self, t: float) -> Proposal | None:
        """Where the middle of the box will be at ``t`` seconds; None where that cannot be said.

        By the velocity of the last estimate and the white noise of the model's acceleration. The box is
        taken to be as high as when it was last found.
        """
        if self._last is None or self._last.status == "waiting":
            return None
        density = self._smoother.model.parameters.motion.acceleration_density
        position, covariance = _moved(self._last, t - self._last.t, density)
        centre = self.boxes.box_centre(position, self._height)
        if not np.isfinite(centre).all():
            return None
        pixel_covariance = self.boxes.pixel_covariance(position, covariance)
        if not np.trace(pixel_covariance) < _WIDEST**2:
            return None
        return Proposal(centre, pixel_covariance)


def _moved(estimate: Estimate, dt: float, acceleration_density: float) -> tuple[FloatArray, FloatArray]:
    """Position (2,) and its covariance (2, 2) ``dt`` seconds after an estimate (MODEL term 1)."""
    step = transition_matrix(dt)
    state = np.concatenate([estimate.position, estimate.velocity])
    covariance = step @ estimate.covariance[:4, :4] @ step.T + process_noise(dt, acceleration_density)
    return (step @ state)[:2], covariance[:2, :2]
