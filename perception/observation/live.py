"""Causal rows of observations, frame by frame."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

import numpy as np

from graphtrack.geometry.camera import GroundCamera
from graphtrack.tracks.track import Track, TrackSet, to_columns
from perception.detection.boxes import PersonBox
from perception.images.frames import Clock
from perception.images.pixels import Image
from perception.observation.pipeline import (
    FrameObservation,
    Models,
    PersonObservation,
    channels_of,
    in_heights,
    is_on_ground,
    observe_frame,
)
from perception.observation.tables import scaled_camera
from perception.pose.features import Projection
from perception.pose.head_detection import HeadPath


class LiveObserver:
    """Rows of each frame, equal to those of the causal `perception.observation.tables.to_tracks`.

    Parameters
    ----------
    models : models of bodies and heads
    camera : the ground plane; None: a scale at which the median box of the first frame with people has the
        height of a person
    clock : times of the frames, or frames a second
    identified : False: the boxes have no identities
    """

    def __init__(
        self, models: Models, camera: GroundCamera | None, clock: float | Clock, *, identified: bool = True
    ) -> None:
        self.models, self.camera, self.clock, self.identified = models, camera, clock, identified
        self._paths: dict[int, HeadPath] = {}
        self._projection = Projection.fixed()

    def rows(
        self, image: Image, frame: int, boxes: Iterable[PersonBox], refuse: Callable[[str], object]
    ) -> list[dict[str, Any]]:
        """Return a row of the native table for each person of a frame, in the order of ids.

        Frames come in order. ``refuse`` receives empty boxes and feet beyond the horizon.
        """
        observed = observe_frame(image, frame, boxes, self.models, refuse)
        if self.camera is None and observed:
            self.camera = scaled_camera({frame: FrameObservation(observed, [])}, causal=True)
        found = [self._row(item, refuse) for item in sorted(observed, key=lambda item: item.track_id)]
        return [row for row in found if row is not None]

    def _row(self, item: PersonObservation, refuse: Callable[[str], object]) -> dict[str, Any] | None:
        assert self.camera is not None
        if not is_on_ground(item, self.camera):
            refuse(f"frame {item.frame}, track {item.track_id}: feet beyond the horizon")
            return None
        path = self._paths.setdefault(item.track_id, HeadPath()) if self.identified else HeadPath()
        head = np.array([path.update(in_heights(item))])
        classes = self.models.head_classes
        known = channels_of([item], head, classes, self.camera, self.clock, projection=self._projection)
        track = Track(track_id=item.track_id, **known)
        row = {name: values[0].item() for name, values in to_columns(TrackSet((track,))).items()}
        return row if self.identified else row | {"track_id": -1}
