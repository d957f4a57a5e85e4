"""Skeletons of walking and standing people, as output of a simulated pose network.

The pelvis turns against the shoulders as in motion capture of walking people (1-σ: 9°). Heads turn much
farther than there (16°), since the graph already models the coupling of heads and bodies. Heights and widths
are those of anthropometry (Drillis & Contini 1966) and vary between people. Also the joints of rendered
people, and their visibility.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import expit

from graphtrack.geometry.angles import FloatArray, direction, wrap
from perception.pose.keypoints import N_POINTS, USED
from perception.synthetic.cameras import Camera
from perception.synthetic.people import Appearance, Posture, hip_of, placed, random_appearance, shoulder_of
from perception.synthetic.raycast import Light, cast
from perception.synthetic.scene import Furniture, Person, furniture_solids
from perception.synthetic.solids import Builder, Solids, rotation_roll, rotation_up, rotation_z

_TWIST, _HEAD_TURN, _FARTHEST = np.deg2rad([9.0, 35.0, 110.0])
_EVEN = 0.5
"""Share of heads with a uniform turn up to the largest."""
_SIDES = (1.0, -1.0)
"""Left and right."""
_NORMALS = np.array(
    [
        [1.0, 0.0, -0.1],
        [0.92, 0.39, 0.0],
        [0.92, -0.39, 0.0],
        [-0.05, 1.0, 0.0],
        [-0.05, -1.0, 0.0],
        [0.0, 1.0, 0.3],
        [0.0, -1.0, 0.3],
        [0.0, 1.0, 0.0],
        [0.0, -1.0, 0.0],
    ]
)
"""Normals of the points of `USED`, in the frame of head, shoulders or pelvis (x forward, y left, z up)."""
_ROUND = np.array([0.25, 0.08, 0.08, 0.40, 0.40, 0.40, 0.40, 0.30, 0.30])
"""Mean sine of the angle behind the limb up to which each point is visible."""
_DEVIATION = 0.45 * np.array([0.026, 0.025, 0.025, 0.035, 0.035, 0.079, 0.079, 0.107, 0.107])
"""1-σ of a network's points in heights of the person, as between COCO's annotators.

COCO gives it in square roots of the person's area, which are 0.45 heights.
"""
_VISIBLE_LEVEL, _HIDDEN = 2.6, np.array([-2.0] * 5 + [0.8] * 4)
"""Log odds of the confidence in visible and in hidden points."""
_CONFIDENT, _INFORMED = 3.6, 0.4
"""Log odds of networks whose confidences do not follow occlusion, and how far they follow it at most."""
_TURNED_ROUND = 8.0
"""Factor of exchanged backs of such networks, which take backs for fronts more often (MediaPipe: 28 % of
backs of 120 to 450 pixels in Town Centre, 1 % of fronts)."""
_SWAPPED = (0, 2, 1, 4, 3, 6, 5, 8, 7)
N_USED = len(USED)


@dataclass(frozen=True, eq=False)
class Skeletons:
    """Skeletons of n people in front of cameras.

    Attributes
    ----------
    points : (n, 9, 2) pixels of the points of `USED`
    visibility : (n, 9) from 0 (hidden) to 1 (visible)
    height : (n,) of the person in pixels
    body, head : (n,) radians in the image frame: 0 faces the camera, +π/2 the right of the image. The body's
        is that of the shoulders
    """

    points: FloatArray
    visibility: FloatArray
    height: FloatArray
    body: FloatArray
    head: FloatArray

    def __len__(self) -> int:
        return len(self.body)


@dataclass(frozen=True)
class NetworkErrors:
    """Errors and confidence of a pose network; numbers are those of one draw, and vary between draws.

    Attributes
    ----------
    deviation : factor of the points' standard deviation
    pixels : additional 1-σ in pixels, independent of the person's size
    bias : 1-σ of the log odds common to an image
    doubt : 1-σ of the log odds of each point
    swapped : share of people with left and right exchanged; larger for small people
    hallucinated : share of backs of heads reported as faces
    hidden : share of people with some points occluded or outside the image
    cut : share of people without their uncertain points, as in some networks
    unsaid : share of people without confidences
    uninformed : share of people whose confidences are hardly lower where points are occluded, as of networks
        that predict the hidden side from a model of the whole body (BlazePose: a nose of .99 from behind)
    """

    deviation: float = 1.0
    pixels: float = 1.0
    bias: float = 0.7
    doubt: float = 1.0
    swapped: float = 0.03
    hallucinated: float = 0.04
    hidden: float = 0.2
    cut: float = 0.4
    unsaid: float = 0.1
    uninformed: float = 0.25


def make_skeletons(
    count: int, rng: np.random.Generator, size: tuple[float, float] = (20.0, 400.0)
) -> Skeletons:
    """Draw people of heights in pixels in a range (log-uniform), each in front of another camera."""
    body = rng.uniform(-np.pi, np.pi, count)
    turn = np.clip(rng.normal(0.0, _HEAD_TURN, count), -_FARTHEST, _FARTHEST)
    anywhere = rng.uniform(-_FARTHEST, _FARTHEST, count)
    head = body + np.where(rng.random(count) < _EVEN, anywhere, turn)
    pelvis = body + rng.normal(0.0, _TWIST, count)
    tall = np.clip(rng.normal(1.70, 0.10, count), 1.3, 2.0)
    distance = np.exp(rng.uniform(np.log(2.5), np.log(40.0), count))
    high = np.where(rng.random(count) < 0.5, rng.uniform(0.8, 2.5, count), rng.uniform(2.5, 10.0, count))
    high = np.minimum(high, 0.9 + distance * np.tan(np.deg2rad(60.0)))
    # The person stands at the origin, the camera on the x axis: facing it is direction 0.
    camera = np.stack([distance, np.zeros(count), high], axis=1)
    world, normals = _joints(body, head, pelvis, tall, rng)
    to_camera = camera[:, None] - world
    to_camera /= np.linalg.norm(to_camera, axis=2, keepdims=True)
    facing = np.einsum("npk,npk->np", normals, to_camera)
    around = rng.normal(_ROUND, 0.15, facing.shape)  # heads, hair, and networks differ
    visibility = expit((facing + around) / 0.10)
    pixels = np.exp(rng.uniform(np.log(size[0]), np.log(size[1]), count))
    ends = np.zeros((count, 2, 3))
    ends[:, 1, 2] = tall
    projected = _projected(np.concatenate([world, ends], axis=1), camera, rng)
    tall_in_image = np.linalg.norm(projected[:, -1] - projected[:, -2], axis=1)
    points = projected[:, :-2] * (pixels / tall_in_image)[:, None, None]
    return Skeletons(points, visibility, pixels, wrap(body), wrap(head))


def _joints(
    body: FloatArray, head: FloatArray, pelvis: FloatArray, tall: FloatArray, rng: np.random.Generator
) -> tuple[FloatArray, FloatArray]:
    """Return points (n, 9, 3) in metres and their normals, unit vectors (n, 9, 3)."""
    n = len(body)

    def about(mean: float, deviation: float) -> FloatArray:
        return rng.normal(mean, deviation, n)

    side = np.array(_SIDES)
    points, normals = np.zeros((n, N_USED, 3)), np.zeros((n, N_USED, 3))
    lean, sideways = about(0.05, 0.09), about(0.0, 0.05)
    chest = rotation_z(body)
    middle = np.stack(
        [np.sin(lean) * 0.29 * tall, np.sin(sideways) * 0.29 * tall, about(0.815, 0.012) * tall], 1
    )
    shoulders = np.einsum("nij,nj->ni", chest, middle)
    wide, tipped = about(0.118, 0.014) * tall, about(0.0, 0.05)
    for k in range(2):
        offset = np.stack([about(0.0, 0.012), side[k] * wide * np.cos(tipped), side[k] * wide * tipped], 1)
        points[:, 5 + k] = shoulders + np.einsum("nij,nj->ni", chest, offset)
    hips, hip_height = rotation_z(pelvis), about(0.53, 0.015) * tall
    across = about(0.062, 0.012) * tall
    for k in range(2):
        offset = np.stack([about(0.0, 0.01), side[k] * across, hip_height + about(0.0, 0.01)], 1)
        points[:, 7 + k] = np.einsum("nij,nj->ni", hips, offset)
    tilt, roll, size = about(-0.08, 0.26), about(0.0, 0.09), about(1.0, 0.06)
    face = rotation_z(head) @ rotation_up(tilt) @ rotation_roll(roll)
    forward = np.einsum(
        "nij,nj->ni", chest, np.stack([about(0.015, 0.035), about(0.0, 0.015), 0.0 * tall], 1)
    )
    neck = np.array([-0.03, 0.0, -0.10])
    centre = shoulders + forward + np.stack([0.0 * tall, 0.0 * tall, about(0.110, 0.010) * tall], 1) + neck
    eye, ear = about(0.034, 0.004), about(0.077, 0.007)
    points_of_parts = [np.stack([about(0.120, 0.01), about(0.0, 0.003), about(-0.022, 0.008)], 1)]
    front, level = about(0.085, 0.008), about(0.018, 0.008)
    points_of_parts += [np.stack([front, s * eye, level], 1) for s in side]
    back, low = about(-0.005, 0.012), about(0.0, 0.01)
    points_of_parts += [np.stack([back, s * ear, low], 1) for s in side]
    for k, place in enumerate(points_of_parts):
        points[:, k] = centre + np.einsum("nij,nj->ni", face, size[:, None] * place - neck)
    for k, frame in enumerate([face] * 5 + [chest] * 2 + [hips] * 2):
        normals[:, k] = frame @ (_NORMALS[k] / np.linalg.norm(_NORMALS[k]))
    return points, normals


def _projected(world: FloatArray, camera: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Project points (n, k, 3) into cameras (n, 3), in focal lengths; people stand anywhere in the image."""
    n = len(world)
    aside, above = rng.uniform(-0.5, 0.5, n), rng.uniform(-0.25, 0.25, n)
    pitch = np.arctan2(0.9 - camera[:, 2], camera[:, 0]) + above
    yaw = np.pi + aside
    axis = np.stack([np.cos(yaw) * np.cos(pitch), np.sin(yaw) * np.cos(pitch), np.sin(pitch)], 1)
    right = np.stack([np.sin(yaw), -np.cos(yaw), 0.0 * yaw], 1)
    rotation = np.stack([right, np.cross(axis, right), axis], 1)
    projected = np.einsum("nij,nkj->nki", rotation, world - camera[:, None])
    plane = projected[..., :2] / np.maximum(projected[..., 2:], 0.2)
    roll = rng.normal(0.0, 0.04, n)
    turn = np.stack(
        [np.stack([np.cos(roll), -np.sin(roll)], 1), np.stack([np.sin(roll), np.cos(roll)], 1)], 1
    )
    return np.asarray(np.einsum("nij,nkj->nki", turn, plane), float)


def perceived(
    points: FloatArray,
    visibility: FloatArray,
    height: ArrayLike,
    rng: np.random.Generator,
    errors: NetworkErrors = NetworkErrors(),
) -> FloatArray:
    """Simulate a pose network: points (n, 9, 3) with confidences; absent points are 0.

    Parameters
    ----------
    points, visibility, height : as in `Skeletons`
    """
    n = len(points)
    height = np.broadcast_to(np.asarray(height, float), (n,))
    small = np.clip((50.0 - height) / 25.0, 0.0, 1.0)
    hidden, hair = _covered(n, rng, errors.hidden), rng.random(n) < 0.3
    # Networks differ in the confidence of each point, and in their output for hidden points.
    unseen = _HIDDEN + rng.normal(0.0, 0.8, (n, 1))
    level = unseen + (_VISIBLE_LEVEL - unseen) * visibility + rng.normal(0.0, errors.doubt, visibility.shape)
    level[:, 3:5] -= np.where(hair, rng.uniform(1.0, 3.0, n), 0.0)[:, None]
    level -= np.where(hidden, rng.uniform(1.5, 4.0, (n, N_USED)), 0.0)
    from_behind = visibility[:, :3].max(axis=1) < 0.3
    dreamt = from_behind & (rng.random(n) < errors.hallucinated)
    level[:, :3] = np.where(dreamt[:, None], rng.normal(0.3, 0.8, (n, 3)), level[:, :3])
    spread = np.exp(np.clip(0.3 * (_VISIBLE_LEVEL - level), -0.3, 1.4) + rng.normal(0.0, 0.4, (n, 1)))
    spread = spread * _DEVIATION * height[:, None] * errors.deviation
    moved = points + np.hypot(spread, errors.pixels)[..., None] * rng.normal(size=points.shape)
    for part, share in ((slice(0, 5), 0.006), (slice(5, 9), 0.008)):
        moved[:, part] += (share * errors.deviation * height)[:, None, None] * rng.normal(size=(n, 1, 2))
    uninformed, informed = rng.random(n) < errors.uninformed, rng.uniform(0.0, _INFORMED, n)
    kept = np.where(uninformed, informed, 1.0)[:, None]
    level = _CONFIDENT + kept * (level - _CONFIDENT)
    level += rng.normal(0.0, errors.bias, (n, 1)) - 1.2 * small[:, None]
    found = np.concatenate([moved, expit(level)[..., None]], axis=2)
    found = _confused(found, small, from_behind, uninformed, rng, errors)
    return _written(found, rng, errors)


def _covered(n: int, rng: np.random.Generator, share: float) -> NDArray[np.bool_]:
    """Draw occluded points (n, 9): hips, the face, one side, or any."""
    kind = np.where(rng.random(n) < share, rng.integers(1, 5, n), 0)
    covered = np.zeros((n, N_USED), bool)
    covered[:, 7:] |= (kind == 1)[:, None]
    covered[:, :5] |= ((kind == 2) & (rng.random(n) < 0.5))[:, None]
    left = rng.random(n) < 0.5
    for first, of_side in ((1, left), (2, ~left)):
        covered[:, first::2] |= ((kind == 3) & of_side)[:, None]
    return covered | ((kind == 4)[:, None] & (rng.random((n, N_USED)) < 0.35))


def _confused(
    found: FloatArray,
    small: FloatArray,
    from_behind: NDArray[np.bool_],
    uninformed: NDArray[np.bool_],
    rng: np.random.Generator,
    errors: NetworkErrors,
) -> FloatArray:
    """Exchange left and right at random."""
    of_backs = np.where(uninformed, _TURNED_ROUND, 1.5)
    share = errors.swapped * (1.0 + 3.0 * small) * np.where(from_behind, of_backs, 0.7)
    complete = rng.random(len(found)) < share
    found = np.where(complete[:, None, None], found[:, _SWAPPED], found)
    for pair in ((3, 4), (5, 6), (7, 8)):
        one = rng.random(len(found)) < 0.3 * share
        found[:, pair] = np.where(one[:, None, None], found[:, pair[::-1]], found[:, pair])
    return found


def _written(found: FloatArray, rng: np.random.Generator, errors: NetworkErrors) -> FloatArray:
    """Degrade points as in files: without uncertain points, without confidences, or with three levels."""
    n = len(found)
    sure = found[..., 2]
    cut = np.where(rng.random(n) < errors.cut, rng.uniform(0.05, 0.4, n), 0.0)
    unsaid = rng.random(n) < errors.unsaid
    cut = np.where(unsaid, rng.uniform(0.15, 0.5, n), cut)
    lost = (sure < cut[:, None]) | (rng.random(sure.shape) < 0.015)
    steps = unsaid & (rng.random(n) < 0.5)
    confidence = np.where(unsaid[:, None], 1.0, sure)
    confidence = np.where(steps[:, None] & (sure < 0.7), 0.5, confidence)
    result = np.concatenate([found[..., :2], confidence[..., None]], axis=2)
    return np.asarray(np.where(lost[..., None], 0.0, result), float)


_FACE = ((0.126, 0.0, -0.02), *((0.090, side * 0.033, 0.012) for side in _SIDES))
_EARS = tuple((-0.008, side * 0.088, 0.0) for side in _SIDES)
_DEPTH = np.array([0.02, 0.025, 0.025, 0.025, 0.025, 0.13, 0.13, 0.18, 0.18])
"""Metres of the person's own body and clothes allowed in front of a visible point."""
_BALL = 0.004
_LIGHT = Light((0.0, 0.0, 1.0), (0.5, 0.5, 0.5), (0.5, 0.5, 0.5))


def joints_of(look: Appearance, posture: Posture) -> FloatArray:
    """Nose, eyes, ears, shoulders and hips (9, 3) in the world, metres; left before right."""
    upper, legs, head = (
        _balls(points_of_parts).build()
        for points_of_parts in (
            [shoulder_of(look, side) for side in _SIDES],
            [hip_of(look, side) for side in _SIDES],
            [np.array(place) for place in (*_FACE, *_EARS)],
        )
    )
    body, face = placed(look, posture, upper, legs, head.scaled(look.stretch))
    return np.concatenate([face.centre, body.centre])


def _balls(points_of_parts: list[FloatArray]) -> Builder:
    make = Builder()
    for place in points_of_parts:
        make.ellipsoid(place, (_BALL,) * 3, (0.5, 0.5, 0.5))
    return make


def joint_visibility(person: Person, camera: Camera, furniture: tuple[Furniture, ...] = ()) -> FloatArray:
    """Visibility (9,) of `joints_of`: 1, or 0 if occluded."""
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


def projected_keypoints(
    person: Person,
    camera: Camera,
    furniture: tuple[Furniture, ...],
    rng: np.random.Generator,
) -> FloatArray:
    """Simulate COCO's points (17, 3) of a person by a pose network, without limbs."""
    pixels, visibility, height = _projected_person(person, camera, furniture)
    points = np.zeros((N_POINTS, 3))
    points[list(USED)] = perceived(pixels[None], visibility[None], height, rng)[0]
    return points


def _projected_person(
    person: Person, camera: Camera, furniture: tuple[Furniture, ...]
) -> tuple[FloatArray, FloatArray, float]:
    """Pixels (9, 2) of the joints, their visibility (9,), and the person's height in pixels."""
    assert isinstance(person.look, Appearance)
    x, y = person.posture.position
    ends = camera.project([(x, y, 0.0), (x, y, person.look.height)])
    pixels = camera.project(joints_of(person.look, person.posture))
    return pixels, joint_visibility(person, camera, furniture), float(np.linalg.norm(ends[1] - ends[0]))


def make_rendered_skeletons(
    count: int,
    rng: np.random.Generator,
    size: tuple[float, float] = (30.0, 200.0),
) -> Skeletons:
    """Return skeletons of rendered people, whose hair, hats, bags and arms hide points.

    Each is another person in front of another camera; a fifth is partly occluded.
    """
    rows = [_one(rng, size) for _ in range(count)]
    return Skeletons(*(np.array(column) for column in zip(*rows, strict=True)))


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
    projected = _projected_person(Person(look, posture), camera, furniture)
    return *projected, float(wrap(body - toward)), float(wrap(head - toward))
