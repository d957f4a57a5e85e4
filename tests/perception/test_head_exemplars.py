from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from graphtrack.errors import InputError
from perception.images.pixels import enlarged
from perception.pose.classes import PoseClasses
from perception.pose.head_pose.exemplars import filter_log_densities
from perception.trackers.mixed_state.exemplars import HeadExemplars, load_head_exemplars, model_path
from perception.trackers.patches import cut, equalised
from perception.training.head_exemplars import train_head_exemplars


@pytest.fixture(scope="module")
def exemplars() -> HeadExemplars:
    return load_head_exemplars()


def made_up(rng: np.random.Generator, k: int = 3, pans: int = 8) -> HeadExemplars:
    classes = PoseClasses.circle(pans)
    weight = rng.dirichlet(np.ones(k), pans)
    shared = rng.integers(0, 9, (pans * k, pans * k)).astype(np.float32)
    return HeadExemplars(
        classes=classes,
        centre=rng.standard_normal((pans, k, 764)).astype(np.float32),
        deviation=rng.uniform(0.5, 1.5, (pans, k, 764)).astype(np.float32),
        log_weight=np.log(weight),
        background_centre=rng.standard_normal((2, 764)).astype(np.float32),
        background_deviation=np.ones((2, 764), np.float32),
        background_log_weight=np.log([0.25, 0.75]),
        exponent=np.array([0.1, 0.2, 0.3, 0.4]),
        shared=shared,
        slope=1.5,
        intercept=-0.5,
    )


# -- patches -----------------------------------------------------------------------------------------------


def test_a_patch_of_a_ramp_tells_where_its_pixels_are() -> None:
    grey = np.tile(np.arange(200, dtype=np.uint8), (100, 1))
    boxes = np.array([[20.0, 10.0, 64.0, 32.0], [50.0, 30.0, 16.0, 8.0]])
    patches = cut(grey, boxes, 16)
    for patch, (left, _, width, _) in zip(patches, boxes, strict=True):
        at = left + width * (np.arange(16) + 0.5) / 16 - 0.5
        np.testing.assert_allclose(patch, np.tile(at, (16, 1)), atol=1.0)


def test_beyond_the_image_its_border_goes_on() -> None:
    grey = np.zeros((20, 20), np.uint8)
    grey[:, 0] = 200
    assert (cut(grey, np.array([[-30.0, 0.0, 20.0, 20.0]]), 8) == 200).all()


@settings(deadline=None)  # the first call compiles
@given(st.integers(0, 2**32 - 1), st.integers(1, 255))
def test_equalised_is_what_opencv_does_to_one(seed: int, levels: int) -> None:
    patches = np.random.default_rng(seed).integers(0, levels, (3, 9, 7)).astype(np.uint8)
    patches[2] = levels
    np.testing.assert_array_equal(equalised(patches), [cv2.equalizeHist(patch) for patch in patches])


def test_grown_boxes_keep_their_middles() -> None:
    box = np.array([[10.0, 20.0, 30.0, 40.0]])
    bigger = enlarged(box, 1.5)
    np.testing.assert_allclose(bigger[:, :2] + bigger[:, 2:] / 2, box[:, :2] + box[:, 2:] / 2)
    np.testing.assert_allclose(bigger[:, 2:], [[45.0, 60.0]])


# -- likelihoods -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("floor", [-np.inf, -3.0])
def test_densities_are_those_of_the_paper(floor: float) -> None:
    rng = np.random.default_rng(0)
    z, e = rng.standard_normal((4, 764)), rng.standard_normal((2, 3, 764))
    s = rng.uniform(0.3, 2.0, (2, 3, 764))
    found = filter_log_densities(z, e.astype(np.float32), s.astype(np.float32), floor)
    exponent = -0.5 * ((z[:, None, None] - e) / s) ** 2
    each = np.maximum(exponent, floor) - np.log(s)
    np.testing.assert_allclose(found, each.reshape(4, 2, 3, 4, 191).sum(-1), rtol=1e-4, atol=1e-2)


def test_the_ratio_is_that_of_weighed_densities() -> None:
    model = made_up(np.random.default_rng(1))
    z = np.random.default_rng(2).standard_normal((5, 764))
    weights = np.repeat(model.exponent, 191)

    def log_density(centre: np.ndarray, deviation: np.ndarray) -> np.ndarray:
        each = np.maximum(-0.5 * ((z - centre) / deviation) ** 2, -3.0) - np.log(deviation)
        return each @ weights

    no_head = np.logaddexp(
        *(
            log_density(model.background_centre[j], model.background_deviation[j])
            + model.background_log_weight[j]
            for j in range(2)
        )
    )
    of_label = log_density(model.centre[2, 1], model.deviation[2, 1])
    found = model.log_ratio(z)[:, 2 * 3 + 1]
    np.testing.assert_allclose(found, 1.5 * (of_label - no_head) - 0.5, rtol=1e-4, atol=1e-3)


def test_a_pose_sums_its_exemplars() -> None:
    model = made_up(np.random.default_rng(3))
    ratio = np.random.default_rng(4).standard_normal((2, model.labels))
    wanted = np.log((np.exp(ratio).reshape(2, 8, 3) * np.exp(model.log_weight)).sum(axis=2))
    np.testing.assert_allclose(model.pose_log_likelihood(ratio), wanted)


# -- transitions -------------------------------------------------------------------------------------------


def test_transitions_follow_distance_and_shared_people() -> None:
    model = made_up(np.random.default_rng(5))
    table = model.transitions(0.5, 0.1, 0.9)
    np.testing.assert_allclose(table.sum(axis=1), 1.0)
    by_pose = table.reshape(8, 3, 8, 3)
    pose = by_pose.sum(axis=3)
    step = 2.0 * np.pi / 8
    # Between poses: a normal density of their distance, whatever the exemplar.
    np.testing.assert_allclose(pose[0, 0, 2] / pose[0, 0, 1], np.exp(-0.5 * (4 - 1) * (step / 0.5) ** 2))
    np.testing.assert_allclose(pose[0], np.broadcast_to(pose[0, :1], (3, 8)))
    # Within the same pose: mostly the same exemplar.
    np.testing.assert_allclose(np.diagonal(by_pose[4, :, 4]) / pose[4, :, 4], 0.9)
    # To another pose: as many as share people, and one more.
    shared = model.shared.reshape(8, 3, 8, 3)[1, 2, 2] + 1.0
    np.testing.assert_allclose(by_pose[1, 2, 2] / pose[1, 2, 2], shared / shared.sum())


def test_poses_that_face_away_become_impossible() -> None:
    model = made_up(np.random.default_rng(6)).within(np.pi / 2)
    facing = np.abs(model.classes.pan) <= np.pi / 2 + 1e-9
    assert facing.sum() == 5
    possible = np.repeat(facing, 3)
    assert (model.prior()[~possible] == 0.0).all() and model.prior().sum() == pytest.approx(1.0)
    table = model.transitions(0.5, 0.1, 0.9)
    assert (table[:, ~possible] == 0.0).all()
    np.testing.assert_allclose(table.sum(axis=1), 1.0)


# -- the package's model -----------------------------------------------------------------------------------


def test_a_file_gives_the_same_model_again(exemplars: HeadExemplars, tmp_path: Path) -> None:
    exemplars.save(tmp_path / "model.npz")
    again = HeadExemplars.load(tmp_path / "model.npz")
    z = np.random.default_rng(0).standard_normal((3, 764))
    np.testing.assert_allclose(again.log_ratio(z), exemplars.log_ratio(z), rtol=1e-6)
    np.testing.assert_array_equal(again.shared, exemplars.shared)
    assert again.card.figures == exemplars.card.figures


def test_other_files_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError):
        HeadExemplars.load(model_path("templates"))
    with pytest.raises(InputError):
        HeadExemplars.load(tmp_path / "absent.npz")


def test_people_share_exemplars_with_themselves(exemplars: HeadExemplars) -> None:
    shared = exemplars.shared
    np.testing.assert_array_equal(shared, shared.T)
    # Nobody is shared more often than the label has people.
    assert (shared <= np.diag(shared)[:, None]).all()


@pytest.mark.slow
def test_training_on_few_people_gives_a_model_that_knows_its_heads() -> None:
    told: list[int] = []
    model = train_head_exemplars(people=3, scenes=20, exemplars=2, background=4, seed=3, advance=told.append)
    assert sum(told) == 3 * len(model.classes)
    assert model.labels == 48 * 2
    assert model.slope > 0.0
    # Six images, mirrored ones too, of three people in each class.
    assert np.diag(model.shared).reshape(48, 2).sum(axis=1).min() >= 3
    assert model.card.figures["best_of_40_on_the_head"] > 0.3  # by chance about a quarter
    # Every pose has all its exemplars.
    np.testing.assert_allclose(np.exp(model.log_weight).sum(axis=1), 1.0, rtol=1e-5)
