"""Short rendered videos: walking people with head turns, and a street with people pasted into its frames."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import cv2
import numpy as np

from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray, direction
from graphtrack.geometry.camera import GroundCamera
from graphtrack.simulation.sampling import simulate
from graphtrack.tracks.track import Track, TrackSet
from perception.detection.boxes import PersonBox
from perception.images.frames import Frame
from perception.images.pixels import Image
from perception.synthetic.cameras import Camera, ImageSensor, random_light, random_sensor
from perception.synthetic.pedestrians import PedestrianVariation, jittered_box, make_pedestrians
from perception.synthetic.people import Appearance, Posture, random_appearance
from perception.synthetic.raycast import TiledFloor
from perception.synthetic.scene import Furniture, Person, Scene, StillScene

_SIZE = (640, 480)
_FOCAL = 760.0
_AREA = 2.5
"""Metres: range of the middles of paths about the middle of the scene."""
_STEPS_A_METRE = 0.7
"""Of each leg."""
_SMALLEST = 40.0
"""Pixels: smaller people, or people at the border, have no box."""
_VISIBLE = 0.5
_BOX_OFFSET, _BOX_SCALE, _BOX_MARGIN = 0.03, 0.05, 1.06


@dataclass(frozen=True, eq=False)
class Clip:
    """A rendered video.

    Attributes
    ----------
    images : of frames 0, 1, 2 …
    boxes : of people, with errors of a detector
    truth : positions (metres) and angles (radians) of every person in every frame, as a `TrackSet`
    camera : view of the ground
    fps : frames a second
    """

    images: list[Image]
    boxes: list[PersonBox]
    truth: TrackSet
    camera: GroundCamera
    fps: float


@dataclass(frozen=True, eq=False)
class Walks:
    """Walking people in front of a camera, to be rendered.

    Attributes
    ----------
    scene : the scene and its camera
    appearances : appearance of each person
    sensor : of the camera
    truth : positions (metres) and angles (radians) of every person in every frame
    fps : frames a second
    """

    scene: Scene
    appearances: list[Appearance]
    sensor: ImageSensor
    truth: TrackSet
    fps: float

    def __len__(self) -> int:
        return len(self.truth.tracks[0])

    def people(self, k: int) -> list[Person]:
        """Return the people in frame k, in the order of the tracks."""
        postures = [_posture(track, k) for track in self.truth]
        return [Person(*both) for both in zip(self.appearances, postures, strict=True)]

    def frames(self, rng: np.random.Generator) -> Iterator[tuple[Image, list[PersonBox]]]:
        """Render the images of frames 0, 1, 2 …, with people's boxes."""
        place = StillScene(self.scene)
        for k in range(len(self)):
            frame = place.render(self.people(k), self.sensor, rng)
            boxes = []
            for track, label in zip(self.truth, frame.labels, strict=True):
                if label.body_box is not None and label.visibility > _VISIBLE and _inside(label.body_box):
                    box = jittered_box(np.array(label.body_box), _BOX_OFFSET, _BOX_SCALE, _BOX_MARGIN, rng)
                    left, top, width, height = (float(value) for value in box)
                    boxes.append(PersonBox(k, track.track_id, (left, top, width, height)))
            yield frame.image, boxes


def walking_clip(rng: np.random.Generator, *, people: int = 3, steps: int = 30, fps: float = 5.0) -> Clip:
    """Render people who walk by the model "joint", on a tiled floor with some furniture."""
    walks = draw_walks(rng, people=people, steps=steps, fps=fps)
    shown = list(walks.frames(rng))
    boxes = [box for _, of_frame in shown for box in of_frame]
    return Clip([image for image, _ in shown], boxes, walks.truth, walks.scene.camera.ground_camera(), fps)


def draw_walks(rng: np.random.Generator, *, people: int = 3, steps: int = 30, fps: float = 5.0) -> Walks:
    """Draw people who walk by the model "joint", on a tiled floor with some furniture.

    Raises
    ------
    InputError
        For less than two frames.
    """
    if steps < 2:
        raise InputError(f"{steps} frames", "at least 2")
    walks = simulate("joint", n_tracks=people, n_steps=steps, fps=fps, rng=rng)
    camera = Camera((0.0, -11.0, rng.uniform(2.2, 4.0)), np.pi / 2, -0.2, _FOCAL, _SIZE)
    furniture = tuple(
        Furniture(
            (rng.uniform(-4.5, 4.5), rng.uniform(3.5, 6.0)),
            (rng.uniform(0.4, 1.5), rng.uniform(0.4, 1.0), rng.uniform(0.5, 2.0)),
            rng.uniform(0.0, np.pi),
            tuple(rng.uniform(0.1, 0.7, 3)),
        )
        for _ in range(4)
    )
    floor = TiledFloor(tuple(rng.uniform(0.2, 0.6) + rng.normal(0.0, 0.03, 3)), 0.6, rng.uniform(0.0, 0.2))
    scene = Scene(camera, random_light(rng), floor, furniture, tuple(rng.uniform(0.3, 0.7, 3)))
    appearances, sensor = [random_appearance(rng) for _ in range(people)], random_sensor(rng)
    return Walks(scene, appearances, sensor, TrackSet(tuple(_moved(track, rng) for track in walks)), fps)


def _moved(track: Track, rng: np.random.Generator) -> Track:
    """Return a track's ground truth, with the middle of its path moved into view."""
    assert track.true_position is not None
    path = track.true_position
    path = path - (path.min(axis=0) + path.max(axis=0)) / 2.0 + rng.uniform(-_AREA, _AREA, 2)
    return Track(
        track.track_id,
        track.frame,
        track.t,
        path,
        true_position=path,
        true_body=track.true_body,
        true_head=track.true_head,
    )


def _posture(track: Track, k: int) -> Posture:
    assert track.true_body is not None and track.true_head is not None
    walked = np.linalg.norm(np.diff(track.position[: k + 1], axis=0), axis=1).sum()
    now: FloatArray = np.gradient(track.position, track.t, axis=0)[k]
    x, y = (float(value) for value in track.position[k])
    return Posture(
        (x, y),
        float(track.true_body[k]),
        float(track.true_head[k]),
        phase=float(2.0 * np.pi * _STEPS_A_METRE * walked),
        stride=float(np.clip(np.linalg.norm(now) / 1.3, 0.0, 1.0)),
    )


def _inside(box: tuple[float, float, float, float]) -> bool:
    left, top, width, height = box
    edges = left > 1.0 and top > 1.0 and left + width < _SIZE[0] - 1.0 and top + height < _SIZE[1] - 1.0
    return edges and height >= _SMALLEST


SIZE = (320, 240)
CAMERA = Camera((0.0, -14.0, 6.0), np.pi / 2, -0.4, 330.0, SIZE)
FPS = 2.5
_NEAR = 620.0
"""Focal length at which people have the height of their crops."""
_TALL = 64
_STEPS = 7
_MARGIN = 1.5
_VARIATION = PedestrianVariation(
    size=(60, 70), offset=0.0, scale=0.0, margin=_MARGIN, elevation=(0.9, 1.1), occluded=0.0, floor=1.0
)
"""Elevation of a high camera, for which the package's models fail."""


@dataclass(frozen=True, eq=False)
class PastedStreet:
    """Frames, boxes with errors of a detector, and directions of travel in the image frame, (n,) radians."""

    frames: list[Frame]
    boxes: list[PersonBox]
    angle: FloatArray
    camera: GroundCamera


def pasted_street(
    people: int,
    rng: np.random.Generator,
    *,
    offset: float = 0.07,
    speed: float = 1.2,
    upright: bool = False,
) -> PastedStreet:
    """Paste people who walk straight through the middle in turn, in all directions.

    With ``upright`` the camera is nearer, and people have the size and elevation of its view.
    """
    view = replace(CAMERA, focal=_NEAR) if upright else CAMERA
    camera = view.ground_camera()
    positions: list[FloatArray] = []
    angles: list[float] = []
    ways = 2.0 * np.pi * (np.arange(people) + rng.uniform(0, 1, people)) / people
    for way in rng.permutation(ways).tolist():
        velocity = speed * np.array([np.cos(way), np.sin(way)])
        path = velocity * (np.arange(_STEPS) - _STEPS / 2)[:, None] / FPS + rng.uniform(-1.0, 1.0, 2)
        positions += list(path)
        angles += camera.image_angle(np.full(_STEPS, direction(velocity)), path).tolist()
    variation = replace(_VARIATION, elevation=(0.3, 0.5)) if upright else _VARIATION
    shown = make_pedestrians(len(positions), rng, variation, body=np.array(angles))
    frames, boxes = [], []
    for k, (place, picture) in enumerate(zip(positions, shown.images, strict=True)):
        foot = camera.ground_to_image(place)
        tall = float(foot[1] - view.project(np.append(place, 1.7))[1]) if upright else _TALL
        box = np.array([foot[0] - 0.2 * tall, foot[1] - tall, 0.4 * tall, tall])
        image = np.full((SIZE[1], SIZE[0], 3), 110, np.uint8)
        _paste(image, picture, box)
        frames.append(Frame(k, image))
        off = offset * tall * rng.normal(size=2) * (1.0, 0.4)
        left, top, width, height = (box + np.append(off, [0.0, 0.0])).tolist()
        boxes.append(PersonBox(k, 1 + k // _STEPS, (left, top, width, height)))
    return PastedStreet(frames, boxes, np.array(angles), camera)


def _paste(image: Image, picture: Image, box: FloatArray) -> None:
    """Draw a crop with a margin, with its person in the box."""
    height = round(_MARGIN * box[3])
    width = round(height * picture.shape[1] / picture.shape[0])
    left, top = round(box[0] + (box[2] - width) / 2), round(box[1] + (box[3] - height) / 2)
    resized = cv2.resize(picture, (width, height), interpolation=cv2.INTER_AREA)
    rows, columns = slice(max(top, 0), top + height), slice(max(left, 0), left + width)
    part = image[rows, columns]
    part[:] = resized[max(-top, 0) :, max(-left, 0) :][: part.shape[0], : part.shape[1]]
