"""A tracker without learning: it follows red pixels, and reports the position of a red blob."""

from typing import ClassVar

import numpy as np

from graphtrack.errors import InputError
from perception.pose.classes import PoseClasses
from perception.trackers.tracker import Box, BoxEstimate, Proposal, check_box

SIZE = (160, 120)
BLOB = (16.0, 20.0)


def blob_image(centre: tuple[float, float] | None, size: tuple[int, int] = SIZE) -> np.ndarray:
    """A red box before grey noise; None: the noise alone."""
    image = np.random.default_rng(0).integers(90, 110, (size[1], size[0], 3)).astype(np.uint8)
    if centre is not None:
        left, top = (round(c - s / 2.0) for c, s in zip(centre, BLOB, strict=True))
        image[top : top + int(BLOB[1]), left : left + int(BLOB[0])] = (10, 10, 240)
    return image


class BlobTracker:
    """The centre of the red pixels. It stores the guidance of the graph."""

    name: ClassVar[str] = "blob"

    def __init__(self, *, particles: int = 30, seed: int = 0) -> None:
        self.pan_classes: PoseClasses | None = PoseClasses.circle(12)
        self.proposals: list[Proposal | None] = []
        self._rng = np.random.default_rng(seed)
        self._particles = particles
        self._last: Box = (0.0, 0.0, *BLOB)

    def start(self, image: np.ndarray, box: Box | None) -> BoxEstimate:
        if box is None:
            raise InputError("no target in the first frame", "a box")
        check_box(box, image)
        self._last = box
        return self.step(image)

    def step(self, image: np.ndarray, proposal: Proposal | None = None) -> BoxEstimate:
        self.proposals.append(proposal)
        v, u = np.nonzero(image[..., 2] > 200)
        found = len(u) > 0
        if found:
            self._last = (u.mean() + 0.5 - BLOB[0] / 2.0, v.mean() + 0.5 - BLOB[1] / 2.0, *BLOB)
        boxes = np.tile(self._last, (self._particles, 1))
        boxes[:, :2] += self._rng.normal(0.0, 2.0, (self._particles, 2))
        pan = np.full(12, 0.02)
        pan[3] = 0.78  # the image's right
        weights = np.full(self._particles, 1.0 / self._particles)
        spread = boxes[:, :2].std(axis=0)
        return BoxEstimate(
            self._last, spread, float(found), found, boxes, weights, pan, pan / pan.max(), {"red": 0.5}
        )
