"""Causal rows of observations, frame by frame."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

import numpy as np

from graphtrack.geometry.camera import GroundCamera
from graphtrack.tracks.track import Track, TrackSet, to_columns
from perception.detection.boxes import PersonBox
from perception.ground.camera_motion import CameraFollower, Lost
from perception.ground.views import Ground, followed_views
from perception.images.frames import Clock
from perception.images.pixels import Image
from perception.observation.pipeline import (
    FrameObservation,
    Models,
    PersonObservation,
    channels_of,
    in_heights,
    observe_frame,
    why_nowhere,
)
from perception.observation.tables import scaled_camera
from perception.pose.features import Projection
from perception.pose.head_detection import HeadPath


class LiveObserver:
    """Rows of each frame, equal to those of the causal `perception.observation.tables.to_tracks`.

    Parameters
    ----------
    models : models of bodies and heads
    ground : a camera that is still or moves; None: a scale at which the median box of the first frame with
        people has the height of a person
    clock : times of the frames, or frames a second
    identified : False: the boxes have no identities
    follower : follower of the camera's motion since the first frame, whose view is ``ground``
    """

    def __init__(
        self,
        models: Models,
        ground: Ground | None,
        clock: float | Clock,
        *,
        identified: bool = True,
        follower: CameraFollower | None = None,
    ) -> None:
        self.models, self.ground, self.clock, self.identified = models, ground, clock, identified
        self.follower = follower
        self._paths: dict[int, HeadPath] = {}
        self._projection = Projection.fixed()

    def rows(
        self, image: Image, frame: int, boxes: Iterable[PersonBox], refuse: Callable[[str], object]
    ) -> list[dict[str, Any]]:
        """Return a row of the native table for each person of a frame, in the order of ids.

        Frames come in order. ``refuse`` receives empty boxes and people without a position.
        """
        boxes = list(boxes)
        motion = None if self.follower is None else self.follower.step(image, boxes)
        observed = observe_frame(image, frame, boxes, self.models, refuse)
        if not observed:
            return []
        if self.ground is None:
            self.ground = scaled_camera({frame: FrameObservation(observed, [])}, causal=True)
        ground = self.ground
        if motion is not None:
            assert isinstance(ground, GroundCamera)
            if isinstance(motion, Lost):
                refuse(f"frame {frame}: {motion.reason}")
            ground = followed_views(ground, {frame: motion})
        found = [self._row(item, ground, refuse) for item in sorted(observed, key=lambda item: item.track_id)]
        return [row for row in found if row is not None]

    def _row(
        self, item: PersonObservation, ground: Ground, refuse: Callable[[str], object]
    ) -> dict[str, Any] | None:
        if reason := why_nowhere(item, ground):
            refuse(f"frame {item.frame}, track {item.track_id}: {reason}")
            return None
        path = self._paths.setdefault(item.track_id, HeadPath()) if self.identified else HeadPath()
        head = np.array([path.update(in_heights(item))])
        classes = self.models.head_classes
        known = channels_of([item], head, classes, ground, self.clock, projection=self._projection)
        track = Track(track_id=item.track_id, **known)
        row = {name: values[0].item() for name, values in to_columns(TrackSet((track,))).items()}
        return row if self.identified else row | {"track_id": -1}
