"""Body and head by keypoints: the model of the package on people whose skeleton is known."""

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
    HEAD,
    N_POINTS,
    NAMES,
    USED,
    coco_indices,
    in_coco_order,
    mirrored,
)
from perception.synthetic.cameras import Camera
from perception.synthetic.people import Posture, random_appearance
from perception.synthetic.scene import Person
from perception.synthetic.skeletons import (
    NetworkErrors,
    joint_visibility,
    joints_of,
    make_rendered_skeletons,
    make_skeletons,
    perceived,
)
from perception.training import train_keypoints

MODEL = load_keypoint_pose()
CERTAIN = NetworkErrors(0.3, 0.1, 0.2, 0.0, 0.0, 0.0, 0.0, 0.0, 0.3)


def all_17(used: np.ndarray) -> np.ndarray:
    """Points (n, 17, 3) of those (n, 9, 3) that are used."""
    points = np.zeros((len(used), N_POINTS, 3))
    points[:, list(USED)] = used
    return points


@pytest.mark.parametrize("angle", np.deg2rad([0.0, 45.0, 90.0, 135.0, 180.0, -135.0, -90.0, -45.0]))
def test_left_and_right_front_and_back_come_out_right(angle: float) -> None:
    """Keypoints of a rendered person facing along the body, before a camera at 5 m, without errors."""
    rng = np.random.default_rng(3)
    camera = Camera((5.0, 0.0, 1.5), np.pi, -0.1, 400.0, (400, 400))
    found = []
    for _ in range(20):
        person = Person(random_appearance(rng), Posture((0.0, 0.0), angle, angle))
        pixels = camera.project(joints_of(person.look, person.posture))
        seen = joint_visibility(person, camera)
        found.append(perceived(pixels[None], seen[None], 140.0, rng, CERTAIN)[0])
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
