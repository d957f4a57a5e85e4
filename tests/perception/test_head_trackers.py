from __future__ import annotations

import warnings
from collections.abc import Callable

import cv2
import numpy as np
import pytest

from graphtrack.errors import InputError
from perception.images.pixels import enlarged
from perception.pose.features.gabor import gabor_features
from perception.reproduce.head_runs import followed, tracking_error
from perception.reproduce.side_by_side import run_all
from perception.synthetic.head_clips import HeadClip, HeadClipParameters, head_clip
from perception.trackers.color import ColourTracker
from perception.trackers.colours import BoxColours, bhattacharyya
from perception.trackers.dynamics import BoxDynamics, predict
from perception.trackers.mixed_state.exemplars import load_head_exemplars
from perception.trackers.mixed_state.tracker import MixedStateParameters, MixedStateTracker
from perception.trackers.patches import PATCH_MARGIN, cut, equalised
from perception.trackers.tracker import Cloud, Proposal, Tracker, boxes_of, states_of

FACING = load_head_exemplars().within(np.pi / 2.0)
STILL = BoxDynamics(centre_std=0.0, size_std=0.0)

MAKE: dict[str, Callable[..., Tracker]] = {
    "color": lambda **options: ColourTracker(exemplars=FACING, **options),
    "mixed-state": lambda **options: MixedStateTracker(exemplars=FACING, **options),
    "sampled": lambda **options: MixedStateTracker(
        MixedStateParameters(labels="sampled", colour=None), exemplars=FACING, **options
    ),
}


@pytest.fixture(scope="module")
def clip() -> HeadClip:
    return head_clip(np.random.default_rng(4), HeadClipParameters(frames=12, clutter=0.5))


# -- motion ------------------------------------------------------------------------------------------------


def test_states_are_boxes() -> None:
    boxes = np.array([[3.0, 4.0, 10.0, 20.0], [0.0, -5.0, 7.0, 8.0]])
    np.testing.assert_allclose(boxes_of(states_of(boxes)), boxes, atol=1e-12)


def test_boxes_move_as_the_autoregression_says() -> None:
    n, dynamics = 40_000, BoxDynamics(0.5, 0.1, 0.2, 0.03, 0.25)
    now = np.tile([50.0, 60.0, np.log(20.0), np.log(30.0)], (n, 1))
    before = now - [4.0, -2.0, 0.1, 0.0]
    cloud = Cloud(now, before, np.full(n, 1.0 / n))
    reference = np.log([10.0, 30.0])
    after = predict(cloud, reference, dynamics, np.random.default_rng(0)).now
    mean = [52.0, 59.0, np.log(20.0) + 0.02 - 0.25 * np.log(2.0), np.log(30.0)]
    std = np.array([2.0, 3.0, 0.03, 0.03])
    np.testing.assert_allclose((after.mean(axis=0) - mean) / std, 0.0, atol=5.0 / np.sqrt(n))
    np.testing.assert_allclose(after.std(axis=0), std, rtol=0.02)


def test_a_proposal_draws_its_share_of_the_centres() -> None:
    n = 20_000
    now = np.tile([50.0, 60.0, 3.0, 3.0], (n, 1))
    proposal = Proposal(np.array([200.0, 10.0]), np.array([[4.0, 1.0], [1.0, 9.0]]))
    dynamics = BoxDynamics(guided_share=0.3)
    cloud = Cloud(now, now, np.full(n, 1.0 / n))
    after = predict(cloud, np.zeros(2), dynamics, np.random.default_rng(1), proposal)
    guided = after.now[:, 0] > 125.0
    assert guided.mean() == pytest.approx(0.3, abs=0.02)
    np.testing.assert_allclose(np.cov(after.now[guided, :2].T), proposal.covariance, atol=0.4)
    # They have no step behind them.
    np.testing.assert_array_equal(after.before[guided, :2], after.now[guided, :2])


# -- colour ------------------------------------------------------------------------------------------------


def test_histograms_count_the_pixels_of_their_boxes() -> None:
    rng = np.random.default_rng(2)
    colours = BoxColours(samples=12)
    bins = rng.integers(0, 110, (40, 50))
    boxes = np.array([[5.0, 6.0, 12.0, 12.0], [30.0, 20.0, 12.0, 12.0]])
    histograms = colours.of_boxes(bins, boxes)
    for found, (left, top, width, height) in zip(histograms, boxes.astype(int), strict=True):
        inside = bins[top : top + height, left : left + width]
        np.testing.assert_allclose(found, np.bincount(inside.ravel(), minlength=110) / inside.size)


def test_pale_pixels_have_no_hue() -> None:
    image = np.array([[[0, 0, 255], [128, 128, 128], [4, 0, 0], [255, 0, 0]]], np.uint8)
    red, grey, dark, blue = BoxColours().of_pixels(image)[0]
    assert red < 100 and blue < 100 and red != blue
    assert grey == 100 + 5 and dark == 100


def test_the_bhattacharyya_coefficient_is_1_for_equal_histograms_only() -> None:
    histogram = np.random.default_rng(3).dirichlet(np.ones(110), 5)
    found = bhattacharyya(histogram, histogram[2])
    assert found[2] == pytest.approx(1.0)
    assert (np.delete(found, 2) < 0.999).all()


# -- the label's filter ------------------------------------------------------------------------------------


def test_summed_labels_are_the_forward_algorithm_of_a_hidden_markov_chain(clip: HeadClip) -> None:
    # With one box that does not move, the exact filter is known.
    parameters = MixedStateParameters(particles=3, colour=None, dynamics=STILL, start_std=0.0)
    tracker = MixedStateTracker(parameters, exemplars=FACING, seed=0)
    box = tuple(clip.boxes[0])
    found = [tracker.start(clip.images[0], box), *(tracker.step(image) for image in clip.images[1:5])]
    transitions = FACING.transitions(parameters.pan_std, parameters.tilt_share, parameters.stay)
    belief, wanted = FACING.prior(), None
    for k, item in enumerate(found):
        grey = np.asarray(cv2.cvtColor(clip.images[k], cv2.COLOR_BGR2GRAY))
        patch = equalised(cut(grey, enlarged(np.array([box]), PATCH_MARGIN), 64))
        likelihood = np.exp(FACING.log_ratio(gabor_features(patch))[0])
        belief = (belief if k == 0 else belief @ transitions) * likelihood
        belief /= belief.sum()
        wanted = belief.reshape(3, 16, -1).sum(axis=(0, 2))
        assert item.pan is not None
        np.testing.assert_allclose(item.pan, wanted, atol=1e-6)
        np.testing.assert_allclose(item.box, box, atol=1e-6)


@pytest.mark.slow
def test_sampled_labels_tend_to_the_summed_ones(clip: HeadClip) -> None:
    box = tuple(clip.boxes[0])
    pans = {}
    for labels in ("sampled", "summed"):
        parameters = MixedStateParameters(2000, labels, dynamics=STILL, start_std=0.0)  # type: ignore[arg-type]
        tracker = MixedStateTracker(parameters, exemplars=FACING, seed=1)
        tracker.start(clip.images[0], box)
        pans[labels] = tracker.step(clip.images[1]).pan
    np.testing.assert_allclose(pans["sampled"], pans["summed"], atol=0.12)


# -- both trackers -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", MAKE)
def test_a_head_is_followed(name: str, clip: HeadClip) -> None:
    tracker = MAKE[name](seed=0, particles=120)
    found = followed(tracker, clip)
    error = tracking_error(np.array([item.box for item in found]), clip.boxes)
    assert error.mean() < 0.35
    assert all(item.found for item in found)
    for item in found:
        assert item.weights.sum() == pytest.approx(1.0)
        assert item.particles.shape == (120, 4)
        assert item.pan is not None and item.pan.sum() == pytest.approx(1.0)
        assert item.pan_likelihood is not None and (item.pan_likelihood >= 0.0).all()
        # Pans that were left out stay so.
        assert item.pan[np.abs(FACING.classes.pan) > 1.6].max() == 0.0


def test_the_seed_decides(clip: HeadClip) -> None:
    first, *rest = clip.images[:4]
    for make in MAKE.values():
        runs = []
        for seed in (3, 3, 4):
            tracker = make(seed=seed, particles=20)
            tracker.start(first, tuple(clip.boxes[0]))
            runs.append(np.array([tracker.step(image).box for image in rest]))
        # Sums of vectorised code depend on how memory is aligned: equal up to rounding.
        np.testing.assert_allclose(runs[0], runs[1], rtol=1e-9)
        assert np.abs(runs[0] - runs[2]).max() > 1e-3


@pytest.mark.parametrize("name", MAKE)
def test_a_black_video_is_no_target(name: str, clip: HeadClip) -> None:
    tracker = MAKE[name](seed=0, particles=30)
    black = np.zeros_like(clip.images[0])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        tracker.start(clip.images[0], tuple(clip.boxes[0]))
        found = [tracker.step(black) for _ in range(8)]
    assert not found[-1].found
    assert np.isfinite(found[-1].weights).all() and np.isfinite(found[-1].box).all()


@pytest.mark.parametrize("name", MAKE)
def test_a_target_that_leaves_is_not_found(name: str, clip: HeadClip) -> None:
    tracker = MAKE[name](seed=0, particles=60)
    tracker.start(clip.images[0], tuple(clip.boxes[0]))
    empty = np.full_like(clip.images[0], (140, 90, 20))
    assert not [tracker.step(empty) for _ in range(10)][-1].found


@pytest.mark.parametrize("name", MAKE)
def test_what_cannot_be_used_is_refused(name: str, clip: HeadClip) -> None:
    image, box = clip.images[0], tuple(clip.boxes[0])
    for bad in (None, (0.0, 0.0, 0.0, 5.0), (500.0, 10.0, 20.0, 20.0), (float("nan"), 0.0, 9.0, 9.0)):
        with pytest.raises(InputError):
            MAKE[name](seed=0).start(image, bad)
    tracker = MAKE[name](seed=0, particles=10)
    tracker.start(image, box)
    with pytest.raises(InputError, match="as the first one"):
        tracker.step(image[:-2])
    with pytest.raises(InputError):
        tracker.step(image[..., 0])
    with pytest.raises(InputError):
        MAKE[name](particles=1)


@pytest.mark.slow
def test_a_wall_hides_the_head_and_the_tracker_says_so() -> None:
    parameters = HeadClipParameters(frames=34, clutter=0.0, occlusion=(12, 10))
    hidden = head_clip(np.random.default_rng(11), parameters)
    found = followed(MAKE["mixed-state"](seed=0, particles=80), hidden)
    covered = hidden.visible < 0.05
    confidence = np.array([item.confidence for item in found])
    assert confidence[:10].min() > 0.5
    assert confidence[np.flatnonzero(covered)[5:]].mean() < 0.5


# -- figures -----------------------------------------------------------------------------------------------


def test_the_tracking_error_is_that_of_the_paper() -> None:
    box = np.array([[0.0, 0.0, 10.0, 10.0]])
    assert tracking_error(box, box)[0] == 0.0
    assert tracking_error(box, box + np.array([20.0, 0.0, 0.0, 0.0]))[0] == 1.0
    # Half of each; and a box of four times the area around it.
    assert tracking_error(box, box + np.array([5.0, 0.0, 0.0, 0.0]))[0] == pytest.approx(0.5)
    around = np.array([[-5.0, -5.0, 20.0, 20.0]])
    assert tracking_error(around, box)[0] == pytest.approx(0.5 * (0.0 + 0.75))


def _square(value: int) -> int:
    return value**2


@pytest.mark.parametrize("processes", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_runs_come_in_the_order_of_their_jobs(processes: int) -> None:
    done: list[int] = []
    assert run_all(_square, range(5), done.append, processes=processes) == [0, 1, 4, 9, 16]
    assert sum(done) == 5
