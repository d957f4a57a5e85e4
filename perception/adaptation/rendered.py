"""Rendered people where a camera saw people walk, who count as a few more where few walk.

Real people teach better than rendered ones, and many need no help; of few, nothing tells apart what is
common to people from what these have on. The others are as large as people at these places, seen from as
high, and before what the camera sees there. How much they count is chosen by people left out.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from graphtrack.geometry.angles import FloatArray
from graphtrack.geometry.camera import GroundCamera
from perception.adaptation.patches import ABOVE, COLUMNS, ROWS, TALL, as_patch, of_patch, surroundings
from perception.detection.boxes import PersonBox
from perception.ground.upright import LeaningView, feet_of, standing_in, upright_picture
from perception.images.frames import Frame
from perception.images.pixels import Image

if TYPE_CHECKING:
    from perception.synthetic.inserted import Place

_COUNT = 900
_PLACES = 60
"""Of a recording, in which people are rendered."""
_FRAMES = 20
"""Of which the median is what a place looks like without people."""
_STEEPEST = 1.2
"""Radians; from straight above nobody is upright."""
_UNKNOWN = (0.0, 0.45), 10.0
"""Elevation, from and to, and distance in metres where the camera's are not known."""
_MIDDLE = 0.9
"""Metres above the ground of a person's middle."""


class Scenery:
    """What a camera sees where people walk, as it is without them.

    Parameters
    ----------
    walkers : boxes of those who walk
    people : everybody's boxes in the recording
    """

    def __init__(
        self,
        walkers: Sequence[PersonBox],
        people: Sequence[PersonBox],
        view: LeaningView | None,
        camera: GroundCamera,
    ) -> None:
        self._walkers = [walkers[k] for k in _evenly(len(walkers), _PLACES)]
        numbers = sorted({item.frame for item in people})
        self.frames = frozenset(numbers[k] for k in _evenly(len(numbers), _FRAMES))
        """Numbers of the frames that are looked at."""
        self._view, self._camera = view, camera
        self._seen: list[list[Image]] = [[] for _ in self._walkers]

    def watched(self, frames: Iterable[Frame]) -> Iterator[Frame]:
        """The same frames; those that are needed are looked at on the way."""
        for frame in frames:
            if frame.image is not None and frame.number in self.frames:
                for item, seen in zip(self._walkers, self._seen, strict=True):
                    found = surroundings(
                        *upright_picture(frame.image, item.box, standing_in(self._view, item.box))
                    )
                    seen.append(as_patch(found) if len(found) > ROWS else found)
            yield frame

    def places(self, rng: np.random.Generator) -> list[Place]:
        """Of some of those who walk."""
        from perception.synthetic.inserted import Place

        feet = self._camera.image_to_ground(feet_of(self._walkers, self._view))
        found = []
        for item, foot, seen in zip(self._walkers, feet, self._seen, strict=True):
            if not seen:
                continue
            image = np.median(np.stack(seen), axis=0).astype(np.uint8)
            standing = standing_in(self._view, item.box)
            _, _, width, height = item.box if standing is None else standing.box
            scale = len(image) / ROWS
            wide = TALL * width / height
            box = scale * (COLUMNS - wide) / 2.0, scale * ABOVE, scale * wide, scale * TALL
            found.append(Place(image, box, *_seen_from(self._camera, foot, rng)))
        return found


def _evenly(n: int, most: int) -> list[int]:
    return [int(k) for k in np.unique(np.linspace(0, n - 1, min(n, most)).astype(int))]


def _seen_from(camera: GroundCamera, foot: FloatArray, rng: np.random.Generator) -> tuple[float, float]:
    """Elevation of the camera above somebody who stands at ``foot`` (2,), and its distance in metres."""
    centre = camera.optical_centre_on_ground
    if camera.height is None or centre is None:
        elevation, distance = _UNKNOWN
        return float(rng.uniform(*elevation)), distance
    away, rise = float(np.linalg.norm(foot - centre)), max(camera.height - _MIDDLE, 0.0)
    return min(float(np.arctan2(rise, away)), _STEEPEST), max(float(np.hypot(away, rise)), 1.0)


@dataclass(frozen=True, eq=False)
class RenderedPeople:
    """Patches of people, the middles (n, 2) of their heads, and where they go (n,), as `learn` has them."""

    patches: Sequence[Image]
    head: FloatArray
    angle: FloatArray


def rendered_people(places: Sequence[Place], rng: np.random.Generator, count: int = _COUNT) -> RenderedPeople:
    """People who walk, in all directions alike, where the camera sees people walk."""
    from perception.synthetic.inserted import with_person

    angle = rng.uniform(-np.pi, np.pi, count)
    patches, heads = [], []
    for where, body in zip(rng.integers(0, len(places), count).tolist(), angle.tolist(), strict=True):
        picture, head = with_person(places[where], body, rng)
        patches.append(as_patch(picture))
        heads.append(of_patch(head * (ROWS / len(picture))))
    return RenderedPeople(patches, np.array(heads), angle)
