"""The mixed-state tracker and its exemplars against the equations of Ba & Odobez 2003."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from scipy.special import softmax

from graphtrack.errors import InputError
from perception.experiments.head_trackers import followed, scored, tracking_error
from perception.images.pixels import enlarged, grey_stack
from perception.models import model_path
from perception.pose.classes import PoseClasses
from perception.pose.features import gabor_features
from perception.synthetic.head_clips import HeadClip, HeadClipParameters, head_clip
from perception.synthetic.heads import HeadVariation, make_heads
from perception.trackers.head_exemplars import LOOKING_UP, HeadExemplars, load_head_exemplars
from perception.trackers.mixed_state import TRANSITIONS, MixedStateParameters, MixedStateTracker
from perception.trackers.tracker import PATCH_MARGIN, BoxDynamics, cut, equalised
from perception.training import train_head_exemplars

FACING = load_head_exemplars().within(np.pi / 2.0)
STILL = BoxDynamics(centre_std=0.0, size_std=0.0)


@pytest.fixture(scope="module")
def clip() -> HeadClip:
    return head_clip(np.random.default_rng(4), HeadClipParameters(frames=12, clutter=0.5))


def responses(clip: HeadClip, k: int, box: np.ndarray) -> np.ndarray:
    grey = np.asarray(cv2.cvtColor(clip.images[k], cv2.COLOR_BGR2GRAY))
    return gabor_features(equalised(cut(grey, enlarged(box[None], PATCH_MARGIN), 64)))


def made_up(rng: np.random.Generator, k: int = 3, pans: int = 8) -> HeadExemplars:
    return HeadExemplars(
        classes=PoseClasses.circle(pans),
        log_weight=np.log(rng.dirichlet(np.ones(k), pans)),
        shared=rng.integers(0, 9, (pans * k, pans * k)).astype(np.float32),
        centre=rng.standard_normal((pans, k, 764)).astype(np.float32),
        deviation=rng.uniform(0.5, 1.5, (pans, k, 764)).astype(np.float32),
        background_centre=rng.standard_normal((2, 764)).astype(np.float32),
        background_deviation=np.ones((2, 764), np.float32),
        background_log_weight=np.log([0.25, 0.75]),
        exponent=np.array([0.1, 0.2, 0.3, 0.4]),
        slope=1.5,
        intercept=-0.5,
    )


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


def test_densities_are_those_of_equation_5(clip: HeadClip) -> None:
    z = responses(clip, 0, clip.boxes[0])
    found = FACING.log_density(z)[0]
    centre, deviation = (
        a.reshape(FACING.labels, -1).astype(float) for a in (FACING.centre, FACING.deviation)
    )
    factor = np.maximum(np.exp(-0.5 * ((z[0] - centre) / deviation) ** 2), np.exp(-3.0))
    np.testing.assert_allclose(found, np.log(factor / deviation).sum(axis=1), rtol=1e-4)
    fit = FACING.fit(found[None])[0]
    np.testing.assert_allclose(fit, np.exp(np.log(factor).mean(axis=1)), rtol=1e-3)
    same = FACING.fit(FACING.log_density(centre[[7]]))[0]
    assert same[7] == pytest.approx(1.0, abs=1e-4) and same.argmax() == 7


def test_transitions_follow_distance_and_shared_people() -> None:
    model = made_up(np.random.default_rng(5))
    table = model.transitions(0.5, 0.1, 0.9)
    np.testing.assert_allclose(table.sum(axis=1), 1.0)
    by_pose = table.reshape(8, 3, 8, 3)
    pose = by_pose.sum(axis=3)
    step = 2.0 * np.pi / 8
    # Between poses: a normal density of their distance, for any exemplar.
    np.testing.assert_allclose(pose[0, 0, 2] / pose[0, 0, 1], np.exp(-0.5 * (4 - 1) * (step / 0.5) ** 2))
    np.testing.assert_allclose(pose[0], np.broadcast_to(pose[0, :1], (3, 8)))
    # Within the same pose: mostly the same exemplar.
    np.testing.assert_allclose(np.diagonal(by_pose[4, :, 4]) / pose[4, :, 4], 0.9)
    # To another pose: as many as share people, and one more.
    shared = model.shared.reshape(8, 3, 8, 3)[1, 2, 2] + 1.0
    np.testing.assert_allclose(by_pose[1, 2, 2] / pose[1, 2, 2], shared / shared.sum())


def test_transitions_between_exemplars_are_the_shares_of_common_people() -> None:
    classes = PoseClasses.circle(4)
    model = replace(load_head_exemplars(plain=True), classes=classes, log_weight=np.log(np.full((4, 2), 0.5)))
    shared = np.zeros((8, 8), np.float32)
    shared[0, 2:4] = 3.0, 1.0  # of exemplar 0 of the first pose with those of the second
    for plain, expected in ((True, [3 / 4, 1 / 4]), (False, [4 / 6, 2 / 6])):
        matrix = replace(model, shared=shared, plain=plain).transitions(1.0, 0.0, 0.9)
        np.testing.assert_allclose(matrix.sum(axis=1), 1.0)
        np.testing.assert_allclose(matrix[0, 2:4] / matrix[0, 2:4].sum(), expected)
        np.testing.assert_allclose(matrix[1, 2:4] / matrix[1, 2:4].sum(), [0.5, 0.5])  # no person in common


def test_poses_that_face_away_become_impossible() -> None:
    model = made_up(np.random.default_rng(6)).within(np.pi / 2)
    facing = np.abs(model.classes.pan) <= np.pi / 2 + 1e-9
    assert facing.sum() == 5
    possible = np.repeat(facing, 3)
    assert (model.prior()[~possible] == 0.0).all() and model.prior().sum() == pytest.approx(1.0)
    table = model.transitions(0.5, 0.1, 0.9)
    assert (table[:, ~possible] == 0.0).all()
    np.testing.assert_allclose(table.sum(axis=1), 1.0)


def test_the_tilt_is_the_mean_over_its_classes() -> None:
    everywhere = np.ones(FACING.labels) / FACING.labels
    assert FACING.mean_tilt(everywhere) == pytest.approx(0.0, abs=1e-12)
    for level, expected in enumerate((-LOOKING_UP, 0.0, LOOKING_UP)):
        one = np.zeros((3, FACING.labels // 3))
        one[level, 5] = 1.0
        assert FACING.mean_tilt(one.ravel()) == pytest.approx(expected)


def test_heads_that_look_up_and_down_are_told_apart() -> None:
    rng, count = np.random.default_rng(5), 40
    tilt = np.where(np.arange(count) % 2, 0.75, -0.75)
    heads = make_heads(count, rng, HeadVariation(), pan=rng.uniform(-1.2, 1.2, count), tilt=tilt)
    ratio = FACING.log_ratio(gabor_features(grey_stack(heads.images, 64, 64, equalise=True)))
    with np.errstate(divide="ignore"):
        belief = softmax(ratio + np.log(FACING.prior()), axis=1)
    said = np.array([FACING.mean_tilt(one) for one in belief])
    assert said[tilt > 0].mean() > 0.2 and said[tilt < 0].mean() < -0.2


@pytest.mark.parametrize("plain", [False, True])
def test_a_file_gives_the_same_model_again(plain: bool, tmp_path: Path) -> None:
    model = load_head_exemplars(plain=plain)
    model.save(tmp_path / "model.npz")
    again = HeadExemplars.load(tmp_path / "model.npz")
    z = np.random.default_rng(0).standard_normal((3, 764))
    np.testing.assert_allclose(again.log_ratio(z), model.log_ratio(z), rtol=1e-6)
    np.testing.assert_array_equal(again.deviation, model.deviation)
    # People share exemplars with themselves; no person is shared more often than the label has people.
    np.testing.assert_array_equal(again.shared, model.shared.T)
    assert (model.shared <= np.diag(model.shared)[:, None]).all()
    assert again.card.figures == model.card.figures and again.plain == plain
    with pytest.raises(InputError):
        HeadExemplars.load(model_path("templates"))


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


@pytest.fixture
def at_one_place(monkeypatch: pytest.MonkeyPatch) -> None:
    """All particles begin with the given box."""
    monkeypatch.setattr("perception.trackers.tracker.START_STD", 0.0)


# -- the tracker -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("likelihood", ["ratio", "density"])
def test_with_one_box_the_filter_is_that_of_a_hidden_markov_chain(
    likelihood: str, clip: HeadClip, at_one_place: None
) -> None:
    options: dict[str, Any] = {"likelihood": likelihood, "colour": False, "dynamics": STILL}
    tracker = MixedStateTracker(MixedStateParameters(3, **options), exemplars=FACING, seed=0)
    box = clip.boxes[0]
    found = [tracker.start(clip.images[0], tuple(box)), *(tracker.step(i) for i in clip.images[1:4])]
    transitions = FACING.transitions(*TRANSITIONS)
    log_likelihood = FACING.log_ratio if likelihood == "ratio" else FACING.log_density
    belief = FACING.prior()
    for k, item in enumerate(found):
        belief = belief if k == 0 else belief @ transitions
        with np.errstate(divide="ignore"):
            belief = softmax(log_likelihood(responses(clip, k, box))[0] + np.log(belief))
        assert item.pan is not None and item.tilt is not None
        np.testing.assert_allclose(item.pan, belief.reshape(3, 16, -1).sum(axis=(0, 2)), atol=1e-3)
        assert item.tilt == pytest.approx(FACING.mean_tilt(belief), abs=1e-3)


@pytest.mark.slow
def test_sampled_labels_tend_to_the_summed_ones(clip: HeadClip, at_one_place: None) -> None:
    box = tuple(clip.boxes[0])
    pans = {}
    for labels in ("sampled", "summed"):
        parameters = MixedStateParameters(2000, labels, dynamics=STILL)  # type: ignore[arg-type]
        tracker = MixedStateTracker(parameters, exemplars=FACING, seed=1)
        tracker.start(clip.images[0], box)
        pans[labels] = tracker.step(clip.images[1]).pan
    np.testing.assert_allclose(pans["sampled"], pans["summed"], atol=0.12)


def test_the_papers_tracker_follows_a_head_and_knows_none_that_is_hidden(clip: HeadClip) -> None:
    tracker = MixedStateTracker(MixedStateParameters.of_the_paper(120), seed=0)
    found = followed(tracker, clip)
    assert tracking_error(np.array([item.box for item in found]), clip.boxes).mean() < 0.35
    black = [tracker.step(np.zeros_like(clip.images[0])) for _ in range(4)]
    assert all(item.found for item in (*found, *black))
    # To a density nothing is very like a head: that is why ours is divided by that of no head.
    assert black[-1].confidence > found[-1].confidence
    assert all(np.exp(-3.0) <= item.confidence <= 1.0 for item in (*found, *black))
    assert found[-1].pan is not None
    assert found[-1].pan[np.abs(FACING.classes.pan) > 1.6].max() == 0.0
    assert "colour" not in found[-1].cues and tracker.exemplars.plain
    assert tracker.exemplars.deviation.min() < 0.1 and (tracker.exemplars.exponent == 1.0).all()


def test_runs_are_scored_by_mean_and_mode(clip: HeadClip) -> None:
    found = followed(MixedStateTracker(exemplars=FACING, particles=20, seed=0), clip)
    run = scored(found, FACING.classes.pans, clip)
    mode = FACING.classes.pan[[int(np.argmax(item.pan)) for item in found if item.pan is not None]]
    np.testing.assert_allclose(run.mode_error, np.abs(np.angle(np.exp(1j * (mode - clip.pan)))), atol=1e-9)
    assert not np.array_equal(run.mode_error, run.pan_error)
    tilt = np.array([item.tilt for item in found], float)
    np.testing.assert_allclose(run.tilt_error, np.abs(tilt - clip.tilt))
