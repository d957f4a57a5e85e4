"""Guidance of a tracker by the graph, which smooths its estimates and predicts the next box."""

from __future__ import annotations

from collections import deque
from pathlib import Path

import numpy as np
from scipy.special import logit

from graphtrack.constants.online import OnlineSmoother
from graphtrack.geometry.angles import FloatArray
from graphtrack.inference import Estimate
from graphtrack.model import Model, Observation, Parameters
from graphtrack.model.parameters import MotionParameters
from perception.following.ground import BoxCamera
from perception.images.frames import Clock, seconds
from perception.pose.classes import PoseClasses
from perception.trackers.tracker import BoxEstimate, Proposal

GUIDE_MODEL = Model("position", Parameters(MotionParameters(acceleration_density=0.01)))
"""Model of steady walking: white noise of 0.01 m²/s³ fits the deviations of rendered walkers within one or
two seconds. The package's own models allow for turning and running, so their predictions soon diverge."""

_WIDEST = 1e4  # pixels: largest standard deviation of a useful prediction


FORGET, _FORGET_AT_MOST = 0.4, 1.0
"""Box widths of travel, and seconds, before a loss: later observations are removed from the graph."""
DEVIATIONS, _LEAST_DEVIATION = 3.0, 0.4
"""An estimate is rejected if the log-odds of its confidence (the median of some frames) are so many standard
deviations below their mean; least standard deviation."""
_MEMORY, _RECENT = 4.0, 0.2  # seconds of the history of log-odds, and of the newest frames
_WARM_UP = 0.4
"""Initial seconds that are accepted but not used for learning, since the first box is the tracker's
template."""
_REGAIN, _GATE, PATIENCE = 0.3, 2.5, 2.5
"""Seconds of detections before a lost target is accepted again; gate in standard deviations of its position
and motion; seconds after which it is accepted unconditionally."""
_FEWEST = 8  # least number of frames for a standard deviation


class Doubt:
    """Log-odds of a tracker's confidence while it was accepted."""

    def __init__(self) -> None:
        self._learned: deque[tuple[float, float]] = deque()
        self._recent: deque[tuple[float, float]] = deque()
        self._first: float | None = None

    def sure(self, confidence: float, t: float) -> bool:
        """Return True if a confidence (0…1) at ``t`` seconds is consistent with the learned distribution."""
        odds = float(logit(np.clip(confidence, 1e-9, 1.0 - 1e-9)))
        if self._first is None:
            self._first = t
        if t - self._first < _WARM_UP:
            return True
        _append(self._recent, (t, odds), t - _RECENT)
        if len(self._learned) < _FEWEST:
            return True
        known = np.array([value for _, value in self._learned])
        middle = np.median(known)
        deviation = max(1.4826 * float(np.median(np.abs(known - middle))), _LEAST_DEVIATION)
        return bool(np.median([value for _, value in self._recent]) >= middle - DEVIATIONS * deviation)

    def learn(self) -> None:
        """Learn from the newest accepted estimate."""
        if self._recent:
            _append(self._learned, self._recent[-1], self._recent[-1][0] - _MEMORY)

    def start_again(self) -> None:
        """Reset the learned distribution."""
        self._learned.clear()


def _append(queue: deque[tuple[float, float]], item: tuple[float, float], since: float) -> None:
    queue.append(item)
    while queue[0][0] < since:
        queue.popleft()


class GraphGuide:
    """An `OnlineSmoother` on the ground, coupled to a tracker in the image.

    After each frame it takes the tracker's estimate as an observation (none if the target was not found),
    and before the next frame it predicts the middle of the target's box. While the target is hidden the
    prediction continues with the last velocity and growing uncertainty.

    A tracker is biased towards the visible part of a target at the start of an occlusion. Therefore estimates
    of much lower confidence than before are rejected (`Doubt`); and when the target is lost or rejected, the
    observations of the last box width of travel are removed from the graph.

    Parameters
    ----------
    boxes : mapping from boxes to the ground
    pan_classes : of the tracker; None for one without pans
    clock : times of the frames, or frames a second
    model : of the graph; by default `GUIDE_MODEL`
    lag : smoothing window of the graph in seconds

    Attributes
    ----------
    rejected : numbers of frames without observation in the graph, or with a removed one
    """

    def __init__(
        self,
        boxes: BoxCamera,
        pan_classes: PoseClasses | None = None,
        *,
        clock: float | Clock = 25.0,
        model: Model | str | Path = GUIDE_MODEL,
        lag: float = 2.0,
    ) -> None:
        self.boxes, self.pan_classes, self.clock = boxes, pan_classes, clock
        self._doubt = Doubt()
        self._new_smoother = lambda: OnlineSmoother(model, engine="chain", lag=lag)
        self._smoother = self._new_smoother()
        self._last: Estimate | None = None
        self._height = 0.0
        self.rejected: set[int] = set()
        self._lost_at: float | None = None
        self._again: list[Observation] = []
        self._sightings: deque[tuple[int, Observation, FloatArray]] = deque()
        """Frames of the last ``lag`` seconds: numbers, observations and the middles of their boxes."""

    def observe(self, frame: int, estimate: BoxEstimate) -> None:
        """Add the tracker's estimate of a frame, with its number."""
        t = float(seconds(frame, self.clock))
        observation = Observation(t)
        if estimate.found and self._doubt.sure(estimate.confidence, t):
            sighting = self.boxes.sighting(estimate, self.pan_classes)
            if sighting is not None:
                x, y = sighting.position.tolist()
                head = None if sighting.head_likelihood is None else tuple(sighting.head_likelihood.tolist())
                observation = Observation(
                    t, position=(x, y), position_std=sighting.position_std, head_likelihood=head
                )
        if observation.position is None and self._lost_at is None and self._sightings:
            self._lost_at = t
            self._forget(FORGET * estimate.box[2])
        if observation.position is None:
            self._again.clear()
        elif self._lost_at is not None:
            self._again.append(observation)
            if self._is_target():
                self._lost_at = None
            elif t - self._lost_at > PATIENCE:
                self._lost_at = None
                self._doubt.start_again()
            else:
                observation = Observation(t)
        if observation.position is not None:
            self._height = estimate.box[3]
            self._doubt.learn()
            self._again.clear()
        else:
            self.rejected.add(frame)
        self._last = self._smoother.update(observation)
        self._sightings.append((frame, observation, estimate.centre))
        while self._sightings[0][1].t < t - self._smoother.lag:
            self._sightings.popleft()

    def _is_target(self) -> bool:
        """Return True if the position and motion of a recovered target match the prediction."""
        first, newest = self._again[0], self._again[-1]
        since = newest.t - first.t
        if self._last is None or since < _REGAIN:
            return False
        assert first.position and newest.position and first.position_std and newest.position_std
        density = self._smoother.model.parameters.motion.acceleration_density
        expected, covariance = self._last.ahead(newest.t - self._last.t, density)
        away = np.array(newest.position) - expected
        covariance = covariance + newest.position_std**2 * np.eye(2)
        moved = np.subtract(newest.position, first.position) - since * self._last.velocity
        of_move = since**2 * self._last.covariance[2:4, 2:4]
        of_move = of_move + (first.position_std**2 + newest.position_std**2) * np.eye(2)
        distances = [d @ np.linalg.solve(c, d) for d, c in ((away, covariance), (moved, of_move))]
        return bool(max(distances) < _GATE**2)

    def _forget(self, width: float) -> None:
        """Remove the observations since the target was ``width`` pixels from its last position."""
        sighting = list(self._sightings)
        _, last, centre = sighting[-1]
        from_there = last.t - _FORGET_AT_MOST
        for _, observation, before in sighting:
            if np.linalg.norm(before - centre) > width:
                from_there = max(from_there, observation.t)
        self._smoother = self._new_smoother()
        for place, (frame, observation, middle) in enumerate(sighting):
            if observation.t > from_there and place > 0:
                observation = Observation(observation.t)
                self.rejected.add(frame)
                self._sightings[place] = frame, observation, middle
            self._last = self._smoother.update(observation)

    def predict(self, frame: int) -> Proposal | None:
        """Predict the middle of the box in a frame; None if that is not possible.

        The prediction uses the velocity of the last estimate and the model's white noise of acceleration,
        with the height of the last found box.
        """
        if self._last is None or self._last.status == "waiting":
            return None
        density = self._smoother.model.parameters.motion.acceleration_density
        position, covariance = self._last.ahead(float(seconds(frame, self.clock)) - self._last.t, density)
        centre = self.boxes.box_centre(position, self._height)
        if not np.isfinite(centre).all():
            return None
        least = self.boxes.smallest_std * self._height
        pixel_covariance = self.boxes.pixel_covariance(position, covariance) + least**2 * np.eye(2)
        if not np.trace(pixel_covariance) < _WIDEST**2:
            return None
        return Proposal(centre, pixel_covariance)
