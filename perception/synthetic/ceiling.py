"""Rendered rooms under a fisheye camera: the kinds of sequence of Yan, Weber & Wermter (2011), Table 1.

A person enters, walks and sits, furniture is moved, and a distracter enters; boxes are exact.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Literal

import numpy as np

from graphtrack.geometry.angles import FloatArray, direction, unit
from perception.images.pixels import Image
from perception.synthetic.cameras import Camera, ImageSensor
from perception.synthetic.people import Appearance, Posture, RobotLook, random_appearance, random_robot
from perception.synthetic.raycast import Light, TiledFloor
from perception.synthetic.scene import Furniture, Label, Person, Scene, StillScene

ROOM = np.array([3.3, 2.4])
"""Half of the room's length and width in metres; the door is in the middle of the side towards +x."""
INSIDE = ROOM - np.array([1.15, 1.05])
"""Half extents of the walking area, clear of furniture along the walls."""
_OUTSIDE = np.array([ROOM[0] + 1.6, 0.0])
_STEPS_A_METRE = 0.7
_TURNING = 4.0
"""1/s: rate at which bodies turn to the direction of travel."""


@dataclass(frozen=True)
class CeilingKind:
    """Events of a sequence; times are shares of its length.

    Attributes
    ----------
    speed : of walking, metres a second
    pauses : least and largest seconds of a halt
    sits : spans in which the person sits on a chair
    moves : spans in which a piece of furniture is moved
    distracter : span in which another person is in the room
    target : "person", or "robot" for a mobile robot
    """

    speed: float = 1.0
    pauses: tuple[float, float] = (0.2, 1.0)
    sits: tuple[tuple[float, float], ...] = ()
    moves: tuple[tuple[float, float], ...] = ()
    distracter: tuple[float, float] | None = None
    target: Literal["person", "robot"] = "person"


@dataclass(frozen=True, eq=False)
class Walk:
    """Path of a person through the room, n frames.

    Attributes
    ----------
    there : (n,) whether the person is in the room or at the door
    position : (n, 2) metres
    body : (n,) radians
    phase : (n,) radians of the step
    stride, sitting : (n,) in 0…1
    """

    there: np.ndarray
    position: FloatArray
    body: FloatArray
    phase: FloatArray
    stride: FloatArray
    sitting: FloatArray

    def posture(self, k: int) -> Posture | None:
        """Return the posture in frame k, None outside the room."""
        if not self.there[k]:
            return None
        x, y = (float(value) for value in self.position[k])
        body = float(self.body[k])
        return Posture(
            (x, y), body, body, -0.15, float(self.phase[k]), float(self.stride[k]), float(self.sitting[k])
        )


def walk(
    kind: CeilingKind,
    rng: np.random.Generator,
    frames: int,
    fps: float,
    first: int,
    last: int,
    chair: FloatArray,
) -> Walk:
    """Draw a path through the door in frame ``first``, with halts and seats, and out by ``last``.

    Parameters
    ----------
    frames, fps : length of the sequence, and frames a second
    last : frame by which the person has left; ``frames``: never
    chair : (2,) metres
    """
    there = np.zeros(frames, bool)
    position, sitting = np.tile(_OUTSIDE, (frames, 1)), np.zeros(frames)
    there[first:] = True
    step, k, place = kind.speed / fps, first, _OUTSIDE
    sits = [tuple(round(share * frames) for share in span) for span in kind.sits]
    goals: list[FloatArray] = [np.array([INSIDE[0], 0.0])]
    leaving = False
    while k < frames:
        due = bool(sits) and k >= sits[0][0] - _steps(place, chair, step) and not goals
        if not goals:
            goals = [chair] if due else [_goal(place, rng)]
            if last < frames and k >= last - _steps(place, _OUTSIDE, step):
                goals, leaving = [np.array([INSIDE[0], 0.0]), _OUTSIDE], True
        goal = goals.pop(0)
        count = max(_steps(place, goal, step), 1)
        for j in range(1, count + 1):
            if k < frames:
                position[k] = place + (goal - place) * j / count
                k += 1
        place = goal
        if leaving:
            if not goals:
                there[k:] = False
                break
            continue
        if due:
            halt = max(sits.pop(0)[1] - k, round(2 * fps))
            down = np.minimum(np.arange(halt), np.arange(halt)[::-1]) / (0.8 * fps)
            sitting[k : k + halt] = np.clip(down, 0.0, 1.0)[: frames - k]
        else:
            halt = round(rng.uniform(*kind.pauses) * fps)
        position[k : k + halt] = place
        k += halt
    return _moving(there, position, sitting, fps)


def _steps(start: FloatArray, end: FloatArray, step: float) -> int:
    return int(np.ceil(np.linalg.norm(end - start) / step))


def _goal(place: FloatArray, rng: np.random.Generator) -> FloatArray:
    while True:
        goal = rng.uniform(-1.0, 1.0, 2) * INSIDE
        if np.linalg.norm(goal - place) > 0.8:
            return np.asarray(goal, float)


def _moving(there: np.ndarray, position: FloatArray, sitting: FloatArray, fps: float) -> Walk:
    """Return a walk with bodies turned to the direction of travel, and consistent steps."""
    step = np.diff(position, axis=0, prepend=position[:1])
    length = np.linalg.norm(step, axis=1)
    body = np.empty(len(position))
    facing = np.array([-1.0, 0.0])
    gain = 1.0 - np.exp(-_TURNING / fps)
    for k in range(len(position)):
        if length[k] > 1e-9:
            facing = facing + gain * (step[k] / length[k] - facing)
        body[k] = direction(facing)
    stride = np.convolve(np.clip(length * fps / 1.3, 0.0, 1.0), np.ones(3) / 3, mode="same")
    return Walk(there, position, body, 2.0 * np.pi * _STEPS_A_METRE * np.cumsum(length), stride, sitting)


SIZE = (320, 240)
CEILING_RATE = 12.5  # frames a second
_HEIGHT, _FOCAL = 2.9, 118.0
"""Metres of the camera above the floor; pixels a radian."""
_DOOR = 0.55
_CHAIR = (0.42, 0.42, 0.40)
_TABLE = (1.0, 0.6, 0.72)


KINDS: Mapping[str, CeilingKind] = MappingProxyType(
    {
        "person moving 1": CeilingKind(),
        "person moving 2": CeilingKind(1.3, (0.5, 3.0)),
        "person moving and sitting 1": CeilingKind(sits=((0.45, 0.80),)),
        "person moving and sitting 2": CeilingKind(0.8, sits=((0.25, 0.50), (0.62, 0.95))),
        "changed environment": CeilingKind(0.9, (0.5, 2.5), moves=((0.35, 0.42), (0.65, 0.72))),
        "changed environment and distracter": CeilingKind(
            0.9, (0.5, 2.5), moves=((0.35, 0.42), (0.7, 0.77)), distracter=(0.45, 0.9)
        ),
    }
)
"""Kinds of sequences by name, as in Yan et al.'s Table 1."""

ALL_KINDS: Mapping[str, CeilingKind] = MappingProxyType(
    {**KINDS, "robot moving": CeilingKind(0.6, (0.5, 2.0), target="robot")}
)
"""`KINDS`, and a mobile robot, which Yan et al. (2011) mention (§4) without figures."""


@dataclass(frozen=True, eq=False)
class CeilingFrame:
    """An image (h, w, 3) uint8, and the labels of the person and of the distracter; None if absent."""

    image: Image
    target: Label | None
    distracter: Label | None


@dataclass(frozen=True, eq=False)
class CeilingSequence:
    """Sequence that is rendered on iteration; each iteration gives the same frames.

    Attributes
    ----------
    scene : the room and static furniture
    appearances : appearance of the person or robot, and of the distracter
    walks : of the person, and of the distracter if there is one
    moved : moved furniture, with positions (n, 2) in metres
    sensor : of the camera
    seed : of the noise
    fps : frames a second
    oversampling : rays per pixel and axis
    """

    scene: Scene
    appearances: tuple[Appearance | RobotLook, Appearance]
    walks: tuple[Walk, ...]
    moved: tuple[tuple[Furniture, FloatArray], ...]
    sensor: ImageSensor
    seed: int
    fps: float
    oversampling: int

    def __len__(self) -> int:
        return len(self.walks[0].there)

    def __iter__(self) -> Iterator[CeilingFrame]:
        rng = np.random.default_rng(self.seed)
        room = None
        for k in range(len(self)):
            furniture, pushed = self._furniture(k)
            # Furniture at rest is part of the room, which is then cast again once.
            if room is None or room[0] != furniture:
                scene = replace(self.scene, furniture=(*self.scene.furniture, *furniture))
                room = furniture, StillScene(scene, oversampling=self.oversampling)
            postures = [one.posture(k) for one in self.walks]
            present = [(i, posture) for i, posture in enumerate(postures) if posture is not None]
            people = [Person(self.appearances[i], posture) for i, posture in present]
            frame = room[1].render(people, self.sensor, rng, moving=pushed)
            labels = {i: label for (i, _), label in zip(present, frame.labels, strict=True)}
            yield CeilingFrame(frame.image, labels.get(0), labels.get(1))

    def _furniture(self, k: int) -> tuple[list[Furniture], list[Furniture]]:
        """Return the moved furniture at rest in frame k, and the furniture in motion."""
        resting: list[Furniture] = []
        pushed: list[Furniture] = []
        for item, positions in self.moved:
            near = positions[max(k - 1, 0) : k + 2]
            placed = replace(item, position=(float(positions[k, 0]), float(positions[k, 1])))
            (resting if (near == positions[k]).all() else pushed).append(placed)
        return resting, pushed


def ceiling_sequence(
    kind: CeilingKind,
    rng: np.random.Generator,
    *,
    frames: int = 500,
    fps: float = CEILING_RATE,
    empty: int = 15,
    oversampling: int = 2,
) -> CeilingSequence:
    """Draw a room, its people and their actions.

    Parameters
    ----------
    frames, fps : length of the sequence, and frames a second
    empty : frames before the person enters
    """
    furniture = _furniture(rng)
    place = rng.uniform(-1.0, 1.0, 2) * INSIDE
    chair = Furniture((float(place[0]), float(place[1])), _CHAIR, rng.uniform(0.0, np.pi), _colour(rng))
    tables = tuple(_table(rng, k) for k in range(len(kind.moves)))
    bearing, height = rng.uniform(-np.pi, np.pi), rng.uniform(1.0, 1.45)
    tint, key = rng.normal(1.0, 0.04, 3), rng.uniform(0.2, 0.5)
    light = Light.above(bearing, height, key * tint, rng.uniform(0.4, 0.6) * tint[::-1])
    floor = TiledFloor(
        tuple(rng.uniform(0.3, 0.6) + rng.normal(0.0, 0.03, 3)), rng.uniform(0.3, 0.7), rng.uniform(0.05, 0.2)
    )
    camera = Camera((0.0, 0.0, _HEIGHT), np.pi / 2, -np.pi / 2, _FOCAL, SIZE, "fisheye")
    still = (*_walls(rng), *furniture, *([chair] if kind.sits else []))
    walks = [walk(kind, rng, frames, fps, empty, frames, np.array(chair.position))]
    if kind.distracter is not None:
        first, last = (round(share * frames) for share in kind.distracter)
        walks.append(walk(replace(kind, sits=()), rng, frames, fps, first, last, np.zeros(2)))
    sensor = ImageSensor(
        gain=float(rng.uniform(0.8, 1.1)),
        gamma=float(rng.uniform(0.5, 0.7)),
        blur=0.5,
        noise=float(rng.uniform(1.0, 4.0)),
        jpeg_quality=int(rng.integers(70, 96)),
    )
    return CeilingSequence(
        Scene(camera, light, floor, still, (0.3, 0.3, 0.3)),
        (random_robot(rng) if kind.target == "robot" else random_appearance(rng), random_appearance(rng)),
        tuple(walks),
        tuple((table, _pushed(table, kind.moves[k], frames, rng)) for k, table in enumerate(tables)),
        sensor,
        int(rng.integers(2**31)),
        fps,
        oversampling,
    )


def _colour(rng: np.random.Generator, low: float = 0.08, high: float = 0.75) -> tuple[float, float, float]:
    b, g, r = (float(v) for v in np.clip(rng.uniform(low, high) + rng.normal(0.0, 0.09, 3), 0.03, 0.9))
    return b, g, r


def _walls(rng: np.random.Generator) -> list[Furniture]:
    """Return four walls with a door, and the corridor's wall behind it."""
    x, y = ROOM
    colour = _colour(rng, 0.55, 0.75)
    side = y - _DOOR
    return [
        Furniture((0.0, y + 0.05), (2 * x, 0.1, 2.6), 0.0, colour),
        Furniture((0.0, -y - 0.05), (2 * x, 0.1, 2.6), 0.0, colour),
        Furniture((-x - 0.05, 0.0), (0.1, 2 * y, 2.6), 0.0, colour),
        Furniture((x + 0.05, _DOOR + side / 2), (0.1, side, 2.6), 0.0, colour),
        Furniture((x + 0.05, -_DOOR - side / 2), (0.1, side, 2.6), 0.0, colour),
    ]


def _furniture(rng: np.random.Generator) -> list[Furniture]:
    """Draw a sofa, shelves, tables and columns along the walls, and a rug."""
    x, y = ROOM
    rug = Furniture(
        tuple(rng.uniform(-0.6, 0.6, 2)),
        (*rng.uniform(1.0, 2.0, 2), 0.01),
        rng.uniform(0.0, np.pi),
        _colour(rng),
    )
    found = [rug]
    for side in (-1.0, 1.0):
        for at in (-2.1, -0.7, 0.7, 2.1):
            if rng.random() < 0.75:
                size = (rng.uniform(0.5, 1.2), rng.uniform(0.35, 0.6), rng.uniform(0.4, 1.3))
                place = (at + rng.uniform(-0.1, 0.1), side * (y - size[1] / 2 - 0.05))
                round_ = bool(rng.random() < 0.2)
                size = (size[1], size[1], size[2]) if round_ else size
                found.append(Furniture(place, size, 0.0, _colour(rng), round_))
                if rng.random() < 0.6:  # an object on it
                    small = (rng.uniform(0.1, 0.3), rng.uniform(0.1, 0.3), size[2] + rng.uniform(0.05, 0.3))
                    found.append(Furniture(place, small, rng.uniform(0.0, np.pi), _colour(rng)))
    size = (rng.uniform(0.4, 0.6), rng.uniform(1.0, 1.8), rng.uniform(0.5, 1.8))
    found.append(Furniture((-x + size[0] / 2 + 0.05, rng.uniform(-0.4, 0.4)), size, 0.0, _colour(rng)))
    return found


def _table(rng: np.random.Generator, k: int) -> Furniture:
    """Draw a table to be moved, initially in a corner on the left."""
    place = (-INSIDE[0] - 0.35, (1.0 if k % 2 else -1.0) * (INSIDE[1] - 0.1))
    size = tuple(np.array(_TABLE) * rng.uniform(0.75, 1.1, 3))
    return Furniture(place, size, rng.uniform(-0.4, 0.4), _colour(rng))


def _pushed(item: Furniture, span: tuple[float, float], frames: int, rng: np.random.Generator) -> FloatArray:
    """Draw positions (frames, 2) of a piece of furniture that is pushed 1 to 2 m."""
    start = np.array(item.position)
    end = start + rng.uniform(1.0, 2.0) * unit(rng.uniform(-0.35, 0.35))
    share = np.clip((np.arange(frames) / frames - span[0]) / (span[1] - span[0]), 0.0, 1.0)
    return start + share[:, None] * (end - start)
