"""`OnlineTracker`: online tracking of a scene from detections, with groups and forecasts."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Self

import numpy as np

from graphtrack.association.packing import pack_tree, unpack_tree
from graphtrack.association.tracker import DetectionTracker, PersonEstimate
from graphtrack.behaviour.forecast.forecaster import Forecast, Forecaster, times_ahead
from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray
from graphtrack.geometry.camera import GroundCamera
from graphtrack.inference.engines import OnlineEngine
from graphtrack.interaction.coupled import CONVERSATIONS, Conversations
from graphtrack.model import Model, Observation
from graphtrack.saved import DAMAGES, damaged, whole
from graphtrack.scene import GivenScene

_UNASKED = 1500
"""Frames that are kept for forecasts until one is asked for."""

_KNOWN_HEAD = 0.6
"""Standard deviation of a head's direction, rad, above which it says nothing of where somebody goes."""


class OnlineTracker(DetectionTracker):
    """Track everybody in a scene online, from detections that do not say of whom they are.

    Identities are given at once; while later detections can tell better, they are revised, and the estimates
    with them. New people are reported once they are more probable than false detections. With a model that
    has groups, these are found on the way.

    Parameters
    ----------
    model, engine, lag, camera : as in `OnlineSmoother`; decisions, too, may change within ``lag`` seconds
    scene : what is known of how people come, go and are detected: `SceneParameters`, or some of them by their
        names. The others are as the model has them, else learned from what is seen

    Attributes
    ----------
    revised : what the last update took back of what was said before

    Examples
    --------
    >>> tracker = OnlineTracker("joint")
    >>> for k in range(4):
    ...     people = tracker.update(0.4 * k, [(0.5 * k, 0.0), (3.0 - 0.5 * k, 4.0)])
    >>> [(person.track_id, person.detection) for person in people]
    [(1, 0), (2, 1)]
    """

    def __init__(
        self,
        model: Model | str | Path | None = None,
        *,
        scene: GivenScene = None,
        engine: OnlineEngine = "auto",
        lag: float | None = 2.0,
        camera: GroundCamera | None = None,
    ) -> None:
        chosen = Model.named(model)
        self._conversations = Conversations(chosen) if chosen.has_groups else None
        super().__init__(
            chosen, scene=scene, engine=engine, lag=lag, camera=camera, groups=self._conversations
        )
        self._forecaster: Forecaster | None = None
        self._frames: deque[tuple[Any, ...]] = deque(maxlen=_UNASKED)
        self._present: list[int] = []

    def update(
        self, t: float, detections: Sequence[Observation] | FloatArray | Sequence[Sequence[float]]
    ) -> list[PersonEstimate]:
        """Take in a frame's detections, as `DetectionTracker.update`; forecasts know of them from then on."""
        people = super().update(t, detections)
        # Positions as they were observed: a forecast estimates their noise by itself.
        self._present = [one.track_id for one in people]
        seen = [(one, self.newest[one.detection]) for one in people if one.observed]
        position = np.array([observation.position for _, observation in seen], float).reshape(-1, 2)
        std = np.array([observation.position_std for _, observation in seen], float)  # None becomes NaN
        heads = [one.head if one.covariance[5, 5] < _KNOWN_HEAD**2 else math.nan for one, _ in seen]
        frame = t, [one.track_id for one, _ in seen], position, std, np.array(heads)
        if self._forecaster is None:
            self._frames.append(frame)
        else:
            self._forecaster.update(*frame)
        return people

    def forecast(
        self,
        horizon: float = 4.8,
        step: float = 0.4,
        *,
        samples: int = 0,
        random: np.random.Generator | None = None,
    ) -> Forecast:
        """Where everybody will be whom the last update told of and who has been seen twice.

        The first call looks back at the last frames, 1,500 at most; from then on each update is taken in.
        `state` keeps what forecasts know from that call on.

        Parameters
        ----------
        horizon, step : every ``step`` seconds up to ``horizon``
        samples, random : as in `Forecaster.forecast`

        Raises
        ------
        InputError
            For times that make no sense, and before the first update.
        """
        ahead = times_ahead(horizon, step)
        if not self.updates:
            raise InputError("no frame", "an update before a forecast")
        if self._forecaster is None:
            self._forecaster = Forecaster()
            for frame in self._frames:
                self._forecaster.update(*frame)
            self._frames.clear()
        people = self._forecaster.known(self._present)
        return self._forecaster.forecast(ahead, people, samples=samples, random=random)

    def state(self) -> dict[str, Any]:
        """Everything needed to go on elsewhere, as JSON-able data; see `from_state`."""
        found = super().state()
        if self._conversations is not None:
            found[CONVERSATIONS] = self._conversations.state()
        if self._forecaster is not None:
            found |= {"forecaster": pack_tree(self._forecaster.state()), "present": self._present}
        return found

    @classmethod
    def from_state(
        cls, state: Mapping[str, Any], model: Model | str | Path | None = None, **options: Any
    ) -> Self:
        """A tracker that goes on where `state` was taken; as `DetectionTracker.from_state`."""
        tracker = super().from_state(state, model, **options)
        try:
            if tracker._conversations is not None:
                found = Conversations.from_state(state[CONVERSATIONS], tracker.model)
                tracker._conversations = tracker._groups = found
            if "forecaster" in state:
                tracker._forecaster = Forecaster.from_state(unpack_tree(state["forecaster"]))
                tracker._present = list(map(whole, state["present"]))
        except DAMAGES as error:
            raise damaged(error) from error
        return tracker
