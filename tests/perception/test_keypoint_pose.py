"""Body and head by keypoints: the model of the package on people whose skeleton is known."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from selection import others_slow

from graphtrack.geometry.angles import difference, wrap
from perception.models import load_keypoint_pose
from perception.pose.classifier import reliability
from perception.pose.keypoints import (
    BODY,
    BY_NUMBER,
    EARS,
    HEAD,
    HIPS,
    N_POINTS,
    NAMES,
    SHOULDERS,
    USED,
    coco_indices,
    facing,
    in_coco_order,
    mirrored,
)
from perception.synthetic.cameras import Camera
from perception.synthetic.people import Posture, random_appearance
from perception.synthetic.scene import Person
from perception.synthetic.skeletons import (
    NetworkErrors,
    Skeletons,
    joint_visibility,
    joints_of,
    make_rendered_skeletons,
    make_skeletons,
    perceived,
)
from perception.training import train_keypoints

MODEL = load_keypoint_pose()
CERTAIN = NetworkErrors(0.3, 0.1, 0.2, 0.0, 0.0, 0.0, 0.0, 0.0, 0.3, uninformed=0.0)
CONFIDENT = replace(CERTAIN, unsaid=0.0, uninformed=1.0)
"""Of a network whose confidences do not follow occlusion."""


def all_17(used: np.ndarray) -> np.ndarray:
    """Points (n, 17, 3) of those (n, 9, 3) that are used."""
    points = np.zeros((len(used), N_POINTS, 3))
    points[:, list(USED)] = used
    return points


@pytest.mark.parametrize("errors", [CERTAIN, CONFIDENT], ids=["certain", "confident"])
@pytest.mark.parametrize("angle", np.deg2rad([0.0, 45.0, 90.0, 135.0, 180.0, -135.0, -90.0, -45.0]))
def test_left_and_right_front_and_back_come_out_right(angle: float, errors: NetworkErrors) -> None:
    """Keypoints of a rendered person facing along the body, before a camera at 5 m, without errors."""
    rng = np.random.default_rng(3)
    camera = Camera((5.0, 0.0, 1.5), np.pi, -0.1, 400.0, (400, 400))
    found = []
    for _ in range(20):
        person = Person(random_appearance(rng), Posture((0.0, 0.0), angle, angle))
        pixels = camera.project(joints_of(person.look, person.posture))
        seen = joint_visibility(person, camera)
        found.append(perceived(pixels[None], seen[None], 140.0, rng, errors)[0])
    body, head = MODEL.log_likelihoods(all_17(np.array(found)))
    for classes, said in ((BODY, body), (HEAD, head)):
        error = np.degrees(np.abs(difference(classes.mean_pan(said), angle)))
        assert np.median(error) < 45.0 and (error > 90.0).mean() <= 0.1


def test_the_mirror_image_has_the_mirrored_likelihoods() -> None:
    rng = np.random.default_rng(0)
    people = make_skeletons(50, rng)
    points = all_17(perceived(people.points, people.visibility, people.height, rng))
    for said, turned in zip(
        MODEL.log_likelihoods(points), MODEL.log_likelihoods(mirrored(points)), strict=True
    ):
        np.testing.assert_allclose(turned, said[:, (-np.arange(said.shape[1])) % said.shape[1]], atol=1e-5)
    np.testing.assert_array_equal(mirrored(mirrored(points)), points)


def test_likelihoods_are_flat_where_no_point_is_there_and_flatter_where_few_are() -> None:
    rng = np.random.default_rng(1)
    people = make_skeletons(400, rng, (80.0, 200.0))
    points = all_17(perceived(people.points, people.visibility, people.height, rng, CERTAIN))
    for said in MODEL.log_likelihoods(points * 0.0):
        np.testing.assert_allclose(said, -np.log(said.shape[1]))

    def sure(given: np.ndarray) -> tuple[float, float]:
        body, head = (np.exp(said).max(axis=1).mean() for said in MODEL.log_likelihoods(given))
        return float(body), float(head)

    without_face, unsure = points.copy(), points.copy()
    without_face[:, :5] = 0.0
    unsure[..., 2] = np.where(points[..., 2] > 0.0, 0.08, 0.0)
    alone = points.copy()
    alone[:, 1:] = 0.0
    body, head = sure(points)
    assert sure(without_face)[1] < head - 0.2
    assert sure(unsure)[0] < body - 0.15 and sure(unsure)[1] < head - 0.15
    assert sure(alone)[0] < 0.45 and sure(alone)[1] < 0.5
    # Likelihoods are exact numbers for points far away or on top of each other too.
    for odd in (points + np.array([1e7, -1e7, 0.0]), points * [0.0, 0.0, 1.0]):
        assert all(np.isfinite(said).all() for said in MODEL.log_likelihoods(odd))


def test_an_unseen_face_above_shoulders_that_are_seen_from_behind_says_so() -> None:
    rng = np.random.default_rng(2)
    people = make_skeletons(6000, rng, (80.0, 200.0))
    behind = (np.abs(difference(people.head, np.pi)) < 0.3) & (np.abs(difference(people.body, np.pi)) < 0.5)
    points = perceived(people.points, people.visibility, people.height, rng, CERTAIN)[behind]
    assert np.median(points[:, :3, 2]) < 0.2
    points[:, :3] = 0.0  # as networks that leave out uncertain keypoints
    _, head = MODEL.log_likelihoods(all_17(points))
    p = np.exp(head)
    back = np.abs(wrap(HEAD.pan - np.pi)) < np.deg2rad(50.0)
    assert p[:, back].sum(axis=1).mean() > 0.7


@pytest.mark.parametrize("nose", [0.1, 0.5, 0.99])
def test_the_order_of_shoulders_and_hips_decides_between_front_and_back(nose: float) -> None:
    """The order of left and right of a back is a back's, whatever the confidence of the face."""
    points = np.zeros((2, N_POINTS, 3))
    left = {0: (0.0, 0.06), 1: (-3.0, 0.04), 3: (-7.0, 0.05), 5: (-19.0, 0.2), 11: (-10.0, 0.5)}
    for k, (x, y) in left.items():
        points[0, k] = 100.0 + x, 50.0 + 160.0 * y, nose if k <= 3 else 0.95
        if k:
            points[0, k + 1] = 100.0 - x, 50.0 + 160.0 * y, nose if k <= 3 else 0.95
    points[1] = points[0]
    points[1, 1:] = points[0, [j for k in range(1, 17, 2) for j in (k + 1, k)]]  # left and right exchanged
    body, _ = MODEL.log_likelihoods(points)
    back = np.abs(wrap(BODY.pan - np.pi)) < np.deg2rad(50.0)
    assert np.exp(body[0])[back].sum() > 0.7
    if nose > 0.3:
        assert np.exp(body[1])[np.abs(BODY.pan) < np.deg2rad(50.0)].sum() > 0.5


def in_space(people: Skeletons, rng: np.random.Generator) -> np.ndarray:
    """Points (n, 17, 3) in space of people who face as these, as `Joints`, turned with the camera's tilt."""
    points = np.zeros((len(people), N_POINTS, 3))
    pairs = (EARS, people.head, 0.08, 1.56), (SHOULDERS, people.body, 0.2, 1.4), (HIPS, people.body, 0.1, 0.9)
    for pair, angle, half, height in pairs:
        for k, side in zip(pair, (1.0, -1.0), strict=True):
            points[:, k] = np.stack(
                [side * half * np.cos(angle), 0 * angle - height, side * half * np.sin(angle)], 1
            )
    nose = np.stack([np.sin(people.head), 0 * people.head, -np.cos(people.head)], 1)
    points[:, 0] = points[:, EARS].mean(axis=1) + 0.12 * nose
    tilt = rng.uniform(-0.2, 0.8, len(people))
    y, z = points[..., 1].copy(), points[..., 2].copy()
    cos, sin = np.cos(tilt)[:, None], np.sin(tilt)[:, None]
    points[..., 1], points[..., 2] = cos * y - sin * z, sin * y + cos * z
    return points


def test_points_in_space_give_the_directions_under_any_tilt() -> None:
    rng = np.random.default_rng(4)
    people = make_skeletons(200, rng)
    joints = in_space(people, rng)
    for found, angle in zip(facing(joints), (people.body, people.head), strict=True):
        np.testing.assert_allclose(difference(found, angle), 0.0, atol=1e-6)
    turned = facing(mirrored(joints))
    for found, angle in zip(turned, (people.body, people.head), strict=True):
        np.testing.assert_allclose(difference(found, -angle), 0.0, atol=1e-6)


def test_points_in_space_decide_where_those_of_the_image_are_poor() -> None:
    rng = np.random.default_rng(5)
    people = make_skeletons(2000, rng)
    points = all_17(
        perceived(people.points, people.visibility, people.height, rng, replace(CONFIDENT, swapped=0.1))
    )
    joints = in_space(people, rng)
    joints[::2] = np.nan
    flat, both = MODEL.log_likelihoods(points), MODEL.log_likelihoods(points, joints)
    for classes, before, after, angle in zip(
        (BODY, HEAD), flat, both, (people.body, people.head), strict=True
    ):
        np.testing.assert_array_equal(after[::2], before[::2])
        np.testing.assert_allclose(np.exp(after).sum(axis=1), 1.0)
        errors = [np.abs(difference(classes.mean_pan(said), angle))[1::2].mean() for said in (before, after)]
        assert errors[1] < 0.5 * errors[0]


@pytest.mark.parametrize("rendered", others_slow([False, True], [False]))
def test_likelihoods_are_calibrated(rendered: bool) -> None:
    rng = np.random.default_rng(11)
    people = make_rendered_skeletons(600, rng) if rendered else make_skeletons(6000, rng)
    points = all_17(perceived(people.points, people.visibility, people.height, rng))
    for classes, said, angle, most in zip(
        (BODY, HEAD), MODEL.log_likelihoods(points), (people.body, people.head), (30.0, 22.0), strict=True
    ):
        error = np.degrees(np.abs(difference(classes.mean_pan(said), angle)))
        assert error.mean() < most
        curve = reliability(said, classes.index(angle))
        assert curve.expected_calibration_error < (0.10 if rendered else 0.04)


@pytest.mark.slow
def test_training_learns_and_is_the_same_again(tmp_path: Path) -> None:
    models = [train_keypoints(2000, test_skeletons=500, seed=4) for _ in range(2)]
    rng = np.random.default_rng(0)
    people = make_skeletons(200, rng)
    points = all_17(perceived(people.points, people.visibility, people.height, rng))
    models[0].save(tmp_path / "k.npz")
    said = [model.log_likelihoods(points)[1] for model in (*models, load_keypoint_pose(tmp_path / "k.npz"))]
    for other in said[1:]:
        np.testing.assert_array_equal(other, said[0])
    assert models[0].card.figures["head_mean_error_deg"] < 45.0


def test_conventions_are_turned_into_cocos_points() -> None:
    for number, places in BY_NUMBER.items():
        points = np.zeros((number, 3))
        points[:, 0], points[:, 2] = np.arange(number), 1.0
        assert in_coco_order(points, places)[:, 0].tolist() == list(map(float, places))
    assert coco_indices([name.upper().replace("_", " ") for name in reversed(NAMES)]) == tuple(
        range(16, -1, -1)
    )
    assert coco_indices(["nose", "left_eye"]) is None
    unknown = in_coco_order(np.full((17, 3), np.nan), range(17))
    np.testing.assert_array_equal(unknown, np.zeros((17, 3)))
