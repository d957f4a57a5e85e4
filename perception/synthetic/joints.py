"""Where the eyes, ears, shoulders and hips of rendered people are, and whether the camera sees them."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from graphtrack.geometry.angles import FloatArray, direction, wrap
from perception.pose.keypoints.skeleton import N_POINTS, USED
from perception.synthetic.appearance import Appearance, random_appearance
from perception.synthetic.cameras import Camera
from perception.synthetic.person import Posture, hip_of, placed, shoulder_of
from perception.synthetic.raycast import Light, cast
from perception.synthetic.scene import Furniture, Person, furniture_solids
from perception.synthetic.skeletons import N_USED, NetworkErrors, Skeletons, perceived
from perception.synthetic.solids import Builder, Solids

_SIDES = (1.0, -1.0)
_FACE = ((0.126, 0.0, -0.02), *((0.090, side * 0.033, 0.012) for side in _SIDES))
_EARS = tuple((-0.008, side * 0.088, 0.0) for side in _SIDES)
_DEPTH = np.array([0.02, 0.025, 0.025, 0.025, 0.025, 0.13, 0.13, 0.18, 0.18])
"""Metres of the person's own flesh and clothes that may lie in front of a point."""
_BALL = 0.004
_LIGHT = Light((0.0, 0.0, 1.0), (0.5, 0.5, 0.5), (0.5, 0.5, 0.5))


def joints_of(look: Appearance, posture: Posture) -> FloatArray:
    """Nose, eyes, ears, shoulders and hips (9, 3) in the world, metres; left before right."""
    upper, legs, head = (
        _balls(places).build()
        for places in (
            [shoulder_of(look, side) for side in _SIDES],
            [hip_of(look, side) for side in _SIDES],
            [np.array(place) for place in (*_FACE, *_EARS)],
        )
    )
    body, face = placed(look, posture, upper, legs, head.scaled(look.stretch))
    return np.concatenate([face.centre, body.centre])


def _balls(places: list[FloatArray]) -> Builder:
    make = Builder()
    for place in places:
        make.ellipsoid(place, (_BALL,) * 3, (0.5, 0.5, 0.5))
    return make


def seen_joints(person: Person, camera: Camera, furniture: tuple[Furniture, ...] = ()) -> FloatArray:
    """Which of `joints_of` (9,) the camera sees: 1, or 0 where something else is before them."""
    assert isinstance(person.look, Appearance)
    joints = joints_of(person.look, person.posture)
    eye = np.array(camera.position)
    toward = eye - joints
    markers = joints + toward / np.linalg.norm(toward, axis=1, keepdims=True) * _DEPTH[:, None]
    body, head = person.solids()
    parts: list[Solids] = [body.in_group(0), head.in_group(1)]
    parts += [furniture_solids(item).in_group(2) for item in furniture]
    parts += [_balls([place]).build().in_group(3 + k) for k, place in enumerate(markers)]
    rays = markers - eye
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    shown = cast(eye, rays[None], Solids.together(*parts), _LIGHT, n_groups=3 + N_USED)
    return (shown.nearest[0] == 3 + np.arange(N_USED)).astype(float)


def seen_keypoints(
    person: Person,
    camera: Camera,
    furniture: tuple[Furniture, ...],
    rng: np.random.Generator,
    errors: NetworkErrors = NetworkErrors(),
) -> FloatArray:
    """COCO's points (17, 3) of somebody, as a pose network would give them; limbs are not there."""
    pixels, visibility, height = _seen_person(person, camera, furniture)
    points = np.zeros((N_POINTS, 3))
    points[list(USED)] = perceived(pixels[None], visibility[None], height, rng, errors)[0]
    return points


def _seen_person(
    person: Person, camera: Camera, furniture: tuple[Furniture, ...]
) -> tuple[FloatArray, FloatArray, float]:
    """Pixels (9, 2) of the joints, their visibility (9,), and the person's height in pixels."""
    assert isinstance(person.look, Appearance)
    x, y = person.posture.position
    ends = camera.project([(x, y, 0.0), (x, y, person.look.height)])
    pixels = camera.project(joints_of(person.look, person.posture))
    return pixels, seen_joints(person, camera, furniture), float(np.linalg.norm(ends[1] - ends[0]))


def make_rendered_skeletons(
    count: int,
    rng: np.random.Generator,
    size: tuple[float, float] = (30.0, 200.0),
    *,
    advance: Callable[[int], None] = lambda count: None,
) -> Skeletons:
    """The skeletons of people as they are rendered, whose hair, hats, bags and arms hide points.

    Every one is another person before another camera; a fifth stands behind something.
    """
    rows = []
    for _ in range(count):
        rows.append(_one(rng, size))
        advance(1)
    columns = [np.array(column) for column in zip(*rows, strict=True)]
    return Skeletons(*columns)


def _one(
    rng: np.random.Generator, size: tuple[float, float]
) -> tuple[FloatArray, FloatArray, float, float, float]:
    look = random_appearance(rng)
    distance, elevation = rng.uniform(4.0, 20.0), rng.uniform(0.0, 0.8)
    body = rng.uniform(-np.pi, np.pi)
    head, tilt = body + rng.normal(0.0, 0.5), rng.normal(0.0, 0.2)
    stride = 0.0 if rng.random() < 0.25 else rng.uniform(0.5, 1.0)
    posture = Posture((0.0, rng.uniform(-0.3, 0.3) * distance), body, head, tilt, rng.uniform(0, 6.3), stride)
    pixels = float(np.exp(rng.uniform(np.log(size[0]), np.log(size[1]))))
    camera = Camera.above(distance, elevation, pixels * distance / look.height, (1000, 1000), 0.9)
    furniture: tuple[Furniture, ...] = ()
    if rng.random() < 0.2:
        place = (0.8, posture.position[1] + rng.uniform(-0.6, 0.6))
        furniture = (Furniture(place, (0.3, 0.9, rng.uniform(0.3, 1.3))),)
    toward = direction(np.array(camera.position[:2]) - np.array(posture.position))
    seen = _seen_person(Person(look, posture), camera, furniture)
    return *seen, float(wrap(body - toward)), float(wrap(head - toward))
