"""Properties of every tracker, and differences of the paper's form."""

import warnings
from collections.abc import Callable

import numpy as np
import pytest

from graphtrack.errors import InputError
from perception.experiments.head_trackers import followed, tracking_error
from perception.experiments.sigma_pi_runs import run_all
from perception.images.pixels import enlarged
from perception.synthetic.head_clips import HeadClip, HeadClipParameters, head_clip
from perception.trackers.color import ColourParameters, ColourTracker, bhattacharyya, box_colours, hue_bins
from perception.trackers.head_exemplars import load_head_exemplars
from perception.trackers.head_graph import HeadGraphParameters, HeadGraphTracker
from perception.trackers.mixed_state import MixedStateParameters, MixedStateTracker
from perception.trackers.registry import IN_THE_GRAPH, TRACKERS, make_tracker, parameters_of
from perception.trackers.tracker import BoxDynamics, Cloud, Proposal, Tracker, boxes_of, predict, states_of

FACING = load_head_exemplars().within(np.pi / 2.0)
MAKE: dict[str, Callable[..., Tracker]] = {
    "color": lambda **options: ColourTracker(exemplars=FACING, **options),
    "mixed-state": lambda **options: MixedStateTracker(exemplars=FACING, **options),
    "sampled": lambda **options: MixedStateTracker(
        MixedStateParameters(labels="sampled", colour=False), exemplars=FACING, **options
    ),
    "sigma-pi": lambda **options: make_tracker("sigma-pi", **options),
    "head-graph": lambda seed=0, particles=200: HeadGraphTracker(
        HeadGraphParameters(windows=particles, engine="fixed-lag"), exemplars=FACING
    ),
}
of_heads = pytest.mark.parametrize("name", ["color", "mixed-state", "sampled", "head-graph"])


@pytest.fixture(scope="module")
def clip() -> HeadClip:
    return head_clip(np.random.default_rng(4), HeadClipParameters(frames=12, clutter=0.5))


# -- motion and colour -------------------------------------------------------------------------------------


def test_boxes_move_as_the_autoregression_says() -> None:
    n, dynamics = 40_000, BoxDynamics(0.5, 0.1, 0.2, 0.03, 0.25)
    now = np.tile([50.0, 60.0, np.log(20.0), np.log(30.0)], (n, 1))
    np.testing.assert_allclose(states_of(boxes_of(now[:1])), now[:1], atol=1e-12)
    cloud = Cloud(now, now - [4.0, -2.0, 0.1, 0.0], np.full(n, 1.0 / n))
    after = predict(cloud, np.log([10.0, 30.0]), dynamics, np.random.default_rng(0)).now
    mean = [52.0, 59.0, np.log(20.0) + 0.02 - 0.25 * np.log(2.0), np.log(30.0)]
    std = np.array([2.0, 3.0, 0.03, 0.03])
    np.testing.assert_allclose((after.mean(axis=0) - mean) / std, 0.0, atol=5.0 / np.sqrt(n))
    np.testing.assert_allclose(after.std(axis=0), std, rtol=0.02)


def test_a_proposal_draws_its_share_of_the_centres() -> None:
    n = 20_000
    now = np.tile([50.0, 60.0, 3.0, 3.0], (n, 1))
    proposal = Proposal(np.array([200.0, 10.0]), np.array([[4.0, 1.0], [1.0, 9.0]]))
    cloud, dynamics = Cloud(now, now, np.full(n, 1.0 / n)), BoxDynamics(guided_share=0.3)
    after = predict(cloud, np.zeros(2), dynamics, np.random.default_rng(1), proposal)
    guided = after.now[:, 0] > 125.0
    assert guided.mean() == pytest.approx(0.3, abs=0.02)
    np.testing.assert_allclose(np.cov(after.now[guided, :2].T), proposal.covariance, atol=0.4)
    np.testing.assert_array_equal(after.before[guided, :2], after.now[guided, :2])  # no step behind them


def test_histograms_count_the_pixels_of_their_boxes() -> None:
    bins = np.random.default_rng(2).integers(0, 110, (40, 50))
    boxes = np.array([[5.0, 6.0, 24.0, 12.0], [20.0, 14.0, 24.0, 24.0]])
    histograms = box_colours(bins, boxes)
    for found, (left, top, width, height) in zip(histograms, boxes.astype(int), strict=True):
        inside = bins[top : top + height, left : left + width]
        np.testing.assert_allclose(found, np.bincount(inside.ravel(), minlength=110) / inside.size)
    similar = bhattacharyya(histograms, histograms[1])
    assert similar[1] == pytest.approx(1.0) and similar[0] < 0.999


def test_pale_pixels_have_no_hue() -> None:
    image = np.array([[[0, 0, 255], [128, 128, 128], [4, 0, 0], [255, 0, 0]]], np.uint8)
    red, grey, dark, blue = hue_bins(image)[0]
    assert red < 100 and blue < 100 and red != blue
    assert grey == 100 + 5 and dark == 100


def test_the_colour_tracker_remembers_at_its_rate() -> None:
    rng = np.random.default_rng(0)

    def frame(share: float) -> np.ndarray:
        image = rng.integers(100, 140, (120, 160, 3)).astype(np.uint8)
        part = np.where(rng.random((30, 24, 1)) < share, (40, 60, 220), (220, 60, 40))
        image[40:70, 60:84] = part.astype(np.uint8)
        return image

    found = {}
    for rate in (0.0, 0.1):
        parameters = ColourParameters(60, rate=rate, dynamics=BoxDynamics(centre_std=0.01, size_std=0.0))
        tracker = ColourTracker(parameters, seed=0)
        tracker.start(frame(0.9), (60.0, 40.0, 24.0, 30.0))
        found[rate] = [tracker.step(frame(0.9 - 0.01 * k)) for k in range(70)][-1].confidence
    assert found[0.1] > found[0.0] + 0.1
    with pytest.raises(InputError, match="rate"):
        ColourParameters(rate=1.5)


# -- every tracker -----------------------------------------------------------------------------------------


@pytest.mark.slow
@of_heads
def test_a_head_is_followed(name: str, clip: HeadClip) -> None:
    found = followed(MAKE[name](seed=0, particles=120), clip)
    assert tracking_error(np.array([item.box for item in found]), clip.boxes).mean() < 0.35
    for item in found:
        assert item.found and item.weights.sum() == pytest.approx(1.0)
        assert item.particles.shape == (120, 4)
        assert item.pan is not None and item.pan.sum() == pytest.approx(1.0)
        assert item.pan_likelihood is not None and (item.pan_likelihood >= 0.0).all()
        # Pans that were left out stay so.
        assert item.pan[np.abs(FACING.classes.pan) > 1.6].max() == 0.0


@pytest.mark.parametrize("name", [name for name in MAKE if name not in IN_THE_GRAPH])
def test_the_seed_decides(name: str, clip: HeadClip) -> None:
    first, *rest = clip.images[:4]
    runs = []
    for seed in (3, 3, 4):
        tracker = MAKE[name](seed=seed, particles=20)
        tracker.start(first, tuple(clip.boxes[0]))
        runs.append(np.array([tracker.step(image).box for image in rest]))
    # Sums of vectorised code depend on how memory is aligned: equal up to rounding.
    np.testing.assert_allclose(runs[0], runs[1], rtol=1e-9)
    assert np.abs(runs[0] - runs[2]).max() > 1e-3


@pytest.mark.parametrize("colour", [(0, 0, 0), (140, 90, 20)])
@of_heads
def test_a_target_that_is_gone_is_not_found(name: str, colour: tuple[int, int, int], clip: HeadClip) -> None:
    tracker = MAKE[name](seed=0, particles=60)
    empty = np.full_like(clip.images[0], colour)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        tracker.start(clip.images[0], tuple(clip.boxes[0]))
        last = [tracker.step(empty) for _ in range(10)][-1]
    assert not last.found
    assert np.isfinite(last.weights).all() and np.isfinite(last.box).all()


@pytest.mark.parametrize("name", MAKE)
def test_what_cannot_be_used_is_refused(name: str, clip: HeadClip) -> None:
    image, box = clip.images[0], tuple(clip.boxes[0])
    thin, beside, nowhere = (60.0, 40.0, 1.5, 30.0), (315.0, 40.0, 24.0, 30.0), (500.0, 10.0, 20.0, 20.0)
    for bad in (thin, beside, nowhere, (0.0, 0.0, 0.0, 5.0), (float("nan"), 0.0, 9.0, 9.0)):
        with pytest.raises(InputError, match="no target in the first frame: a box"):
            MAKE[name](seed=0).start(image, bad)
    tracker = MAKE[name](seed=0, particles=10)
    tracker.start(image, box)
    with pytest.raises(InputError, match="320 × 240"):
        tracker.step(image[:-2])
    if name != "sigma-pi":
        with pytest.raises(InputError):
            tracker.step(image[..., 0])
        with pytest.raises(InputError):
            MAKE[name](seed=0).start(image, None)
    with pytest.raises(InputError, match=r"at least [28]"):
        MAKE[name](particles=1)


@pytest.mark.parametrize("name", [name for name in TRACKERS if name not in IN_THE_GRAPH])
def test_every_tracker_has_its_papers_parameters(name: str) -> None:
    ours, paper = parameters_of(name), parameters_of(name, as_in_the_paper=True)
    assert type(ours) is type(paper) and ours.particles == paper.particles
    assert (ours == paper) == (name == "color")
    with pytest.raises(InputError, match="tracker 'magic'"):
        parameters_of("magic")
    image = np.random.default_rng(0).integers(0, 255, (60, 80, 3)).astype(np.uint8)
    if name == "sigma-pi":
        assert make_tracker(name, background=[image]).name == name
    else:
        with pytest.raises(InputError, match="sigma-pi, cue-graph, or none"):
            make_tracker(name, background=[image])


# -- how they are judged -----------------------------------------------------------------------------------


def test_the_tracking_error_is_that_of_the_paper() -> None:
    box = np.array([[0.0, 0.0, 10.0, 10.0]])
    for shift, error in ((0.0, 0.0), (5.0, 0.5), (20.0, 1.0)):
        assert tracking_error(box, box + np.array([shift, 0.0, 0.0, 0.0]))[0] == pytest.approx(error)
    around = np.array([[-5.0, -5.0, 20.0, 20.0]])
    assert tracking_error(around, box)[0] == pytest.approx(0.5 * (0.0 + 0.75))
    np.testing.assert_allclose(enlarged(box, 2.0), around)


def _square(value: int) -> int:
    return value**2


@pytest.mark.parametrize("processes", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_runs_come_in_the_order_of_their_jobs(processes: int) -> None:
    done: list[int] = []
    assert run_all(_square, range(5), done.append, processes=processes) == [0, 1, 4, 9, 16]
    assert sum(done) == 5
