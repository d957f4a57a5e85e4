"""Rendering of frames: people among furniture on a floor, with exact labels."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from graphtrack.geometry.angles import FloatArray
from perception.images.pixels import Image
from perception.synthetic.cameras import Camera, ImageSensor, develop
from perception.synthetic.people import Appearance, Posture, RobotLook, person_solids, robot_solids
from perception.synthetic.raycast import Cast, Light, TiledFloor, cast
from perception.synthetic.solids import Builder, Solids, rotation_z

_GREY_FLOOR = TiledFloor((0.42, 0.45, 0.47))


@dataclass(frozen=True)
class Furniture:
    """Box (or column) on the floor.

    Attributes
    ----------
    position : (2,) metres, its centre
    size : length, width and height in metres
    angle : radians, its direction in the world
    colour : albedo, blue green red
    round : whether it is a column of diameter ``size[0]``
    """

    position: tuple[float, float]
    size: tuple[float, float, float]
    angle: float = 0.0
    colour: tuple[float, float, float] = (0.3, 0.35, 0.4)
    round: bool = False


@dataclass(frozen=True)
class Person:
    """Person or robot in a scene: appearance and posture."""

    look: Appearance | RobotLook
    posture: Posture

    def solids(self) -> tuple[Solids, Solids]:
        """Body and head in the world (metres)."""
        if isinstance(self.look, RobotLook):
            return robot_solids(self.look, self.posture)
        return person_solids(self.look, self.posture)


@dataclass(frozen=True)
class Label:
    """Ground truth of one person in a frame.

    Attributes
    ----------
    body_box : left, top, width, height in pixels of the unoccluded person inside the image; None if
        outside
    head_box : encloses skull, cap of hair and face, but not hanging hair, buns, brims or hoods
    visibility : visible share of the person's pixels inside the image, 0…1
    position : (2,) metres on the ground
    """

    body_box: tuple[float, float, float, float] | None
    head_box: tuple[float, float, float, float] | None
    visibility: float
    position: tuple[float, float]


@dataclass(frozen=True)
class Scene:
    """Static content of a frame, without people.

    Attributes
    ----------
    backdrop : light (3,) behind floor and furniture, blue green red
    """

    camera: Camera
    light: Light
    ground: TiledFloor | None = _GREY_FLOOR
    furniture: tuple[Furniture, ...] = ()
    backdrop: tuple[float, float, float] = (0.5, 0.5, 0.48)


@dataclass(frozen=True, eq=False)
class RenderedFrame:
    """An image (h, w, 3) uint8, and the labels of its people in their order."""

    image: Image
    labels: tuple[Label, ...]


def render_frame(
    scene: Scene,
    people: Sequence[Person],
    sensor: ImageSensor,
    rng: np.random.Generator,
    *,
    oversampling: int = 2,
    backdrop: NDArray[np.float32] | None = None,
) -> RenderedFrame:
    """Render one frame.

    Parameters
    ----------
    oversampling : rays per pixel and axis
    backdrop : (h, w, 3) light instead of the scene's uniform backdrop
    """
    shown = cast_scene(scene, people, scene.camera.rays(oversampling))
    return developed(scene, people, shown, sensor, rng, oversampling=oversampling, backdrop=backdrop)


def cast_scene(scene: Scene, people: Sequence[Person], rays: FloatArray) -> Cast:
    """Cast the camera's rays (h, w, 3); groups 3k … 3k + 2 are person k, the last groups furniture."""
    parts: list[Solids] = []
    for k, person in enumerate(people):
        body, head = person.solids()
        parts += [body.in_group(3 * k), replace(head, group=head.group + 3 * k + 1)]
    parts += [furniture_solids(item).in_group(3 * len(people) + k) for k, item in enumerate(scene.furniture)]
    owner = np.concatenate([np.arange(3 * len(people)) // 3, len(people) + np.arange(len(scene.furniture))])
    return cast(
        np.array(scene.camera.position),
        rays,
        Solids.together(Builder().build(), *parts),
        scene.light,
        ground=scene.ground,
        n_groups=len(owner),
        owner=owner,
    )


def developed(
    scene: Scene,
    people: Sequence[Person],
    shown: Cast,
    sensor: ImageSensor,
    rng: np.random.Generator,
    *,
    oversampling: int,
    backdrop: NDArray[np.float32] | None = None,
) -> RenderedFrame:
    """Return the frame of the hits of `cast_scene`."""
    camera = scene.camera
    w, h = camera.size
    colour, covered = shown.colour, shown.covered.astype(np.float32)
    if oversampling > 1:
        colour = cv2.resize(colour, (w, h), interpolation=cv2.INTER_AREA)
        covered = cv2.resize(covered, (w, h), interpolation=cv2.INTER_AREA)
    behind = np.array(scene.backdrop, np.float32) if backdrop is None else backdrop
    light = colour + (1.0 - covered[..., None]) * behind
    labels = tuple(_label(k, person.posture.position, shown, oversampling) for k, person in enumerate(people))
    return RenderedFrame(develop(light, sensor, rng), labels)


def furniture_solids(item: Furniture) -> Solids:
    """A piece of furniture in the world (metres)."""
    make = Builder()
    length, width, height = item.size
    x, y = item.position
    if item.round:
        make.limb((x, y, 0.0), (x, y, height), length / 2.0, item.colour)
    else:
        make.box(
            (x, y, height / 2.0),
            (length / 2, width / 2, height / 2),
            item.colour,
            rotation=rotation_z(item.angle),
        )
    return make.build()


def _label(k: int, position: tuple[float, float], shown: Cast, oversampling: int) -> Label:
    body, head, extra = shown.extent[3 * k : 3 * k + 3]
    found = [e for e in (body, head, extra) if e[0] >= 0]
    outline = None
    if found:
        corners = np.array(found)
        outline = np.array(
            [corners[:, 0].min(), corners[:, 1].max(), corners[:, 2].min(), corners[:, 3].max()]
        )
    covers, shows = int(shown.covers[k]), int(shown.shows[k])
    observed_head = _box(head if head[0] >= 0 else None, oversampling)
    visibility = shows / covers if covers else 0.0
    return Label(_box(outline, oversampling), observed_head, visibility, position)


def _box(extent: FloatArray | None, oversampling: int) -> tuple[float, float, float, float] | None:
    if extent is None:
        return None
    left, right, top, bottom = (float(value) for value in extent)
    return (
        left / oversampling,
        top / oversampling,
        (right + 1.0 - left) / oversampling,
        (bottom + 1.0 - top) / oversampling,
    )


_MARGIN = 3
"""Margin in pixels around the boxes of moving objects, since a lens bends edges outwards."""
_CORNERS = np.array([[x, y, z] for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)])


class StillScene:
    """Renderer of the same frames as `render_frame`, faster for mostly static scenes.

    Parameters
    ----------
    scene : static content
    oversampling : rays per pixel and axis
    """

    def __init__(self, scene: Scene, *, oversampling: int = 2) -> None:
        self._scene, self._oversampling = scene, oversampling
        self._rays = scene.camera.rays(oversampling)
        self._still = cast_scene(scene, (), self._rays)
        self._chosen = np.full_like(self._rays, np.nan)

    def render(
        self,
        people: Sequence[Person],
        sensor: ImageSensor,
        rng: np.random.Generator,
        *,
        moving: Sequence[Furniture] = (),
    ) -> RenderedFrame:
        """Render one frame with people, and with furniture that is not part of the scene."""
        scene = replace(self._scene, furniture=(*self._scene.furniture, *moving))
        solids = [person.solids() for person in people]
        movers = [*(Solids.together(*parts) for parts in solids), *(furniture_solids(f) for f in moving)]
        areas = [self._area(mover) for mover in movers]
        for area in areas:
            self._chosen[area] = self._rays[area]
        shown = cast_scene(scene, people, self._chosen)
        colour, covered = self._still.colour.copy(), self._still.covered.copy()
        for area in areas:
            colour[area], covered[area] = shown.colour[area], shown.covered[area]
            self._chosen[area] = np.nan
        shown = replace(shown, colour=colour, covered=covered)
        return developed(scene, people, shown, sensor, rng, oversampling=self._oversampling)

    def _area(self, solids: Solids) -> tuple[slice, slice]:
        """Return rows and columns of the rays that may hit the solids or their shadow on the ground."""
        half = np.abs(solids.axes).sum(axis=2)
        corners = (solids.centre[:, None] + half[:, None] * _CORNERS).reshape(-1, 3)
        toward = np.array(self._scene.light.direction)
        shadow = corners - corners[:, 2:] / toward[2] * toward
        pixels: FloatArray = self._scene.camera.project(np.vstack([corners, shadow]))
        if not np.isfinite(pixels).all():
            return slice(None), slice(None)
        low = np.maximum((np.floor(pixels.min(axis=0)) - _MARGIN) * self._oversampling, 0).astype(int)
        high = np.maximum((np.ceil(pixels.max(axis=0)) + _MARGIN) * self._oversampling, 0).astype(int)
        return slice(low[1], high[1]), slice(low[0], high[0])
