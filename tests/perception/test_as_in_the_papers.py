"""What the trackers do as their papers have it, beside what is better: the switches, and their equations."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from scipy.special import softmax

from graphtrack.errors import InputError
from perception.images.pixels import enlarged, grey_stack
from perception.pose.features.gabor import gabor_features
from perception.reproduce.head_figure import failures
from perception.reproduce.head_runs import METHODS, Run, followed, scored, tracking_error
from perception.reproduce.still_heads import CONFUSION, PANS
from perception.synthetic.head_clips import HeadClip, HeadClipParameters, head_clip
from perception.synthetic.heads import HeadVariation, make_heads
from perception.trackers.color import ColourParameters, ColourTracker
from perception.trackers.dynamics import BoxDynamics
from perception.trackers.mixed_state.exemplars import LOOKING_UP, load_head_exemplars
from perception.trackers.mixed_state.tracker import MixedStateParameters, MixedStateTracker
from perception.trackers.patches import PATCH_MARGIN, cut, equalised
from perception.trackers.registry import TRACKERS, make_tracker, parameters_of
from perception.trackers.sigma_pi.network import TERM_NAMES
from perception.trackers.sigma_pi.tracker import SigmaPiParameters, SigmaPiTracker

FACING = load_head_exemplars().within(np.pi / 2.0)
STILL = BoxDynamics(centre_std=0.0, size_std=0.0)


@pytest.fixture(scope="module")
def clip() -> HeadClip:
    return head_clip(np.random.default_rng(4), HeadClipParameters(frames=12, clutter=0.5))


def responses(clip: HeadClip, k: int, box: np.ndarray) -> np.ndarray:
    grey = np.asarray(cv2.cvtColor(clip.images[k], cv2.COLOR_BGR2GRAY))
    return gabor_features(equalised(cut(grey, enlarged(box[None], PATCH_MARGIN), 64)))


# -- Ba & Odobez 2003
# ---------------------------------------------------------------------------------------------------


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


def test_by_densities_the_filter_is_that_of_a_hidden_markov_chain(clip: HeadClip) -> None:
    parameters = MixedStateParameters(
        3, labels="summed", likelihood="density", colour=None, dynamics=STILL, start_std=0.0
    )
    tracker = MixedStateTracker(parameters, exemplars=FACING, seed=0)
    box = clip.boxes[0]
    found = [tracker.start(clip.images[0], tuple(box)), *(tracker.step(i) for i in clip.images[1:4])]
    transitions = FACING.transitions(parameters.pan_std, parameters.tilt_share, parameters.stay)
    belief = FACING.prior()
    for k, item in enumerate(found):
        belief = belief if k == 0 else belief @ transitions
        with np.errstate(divide="ignore"):
            belief = softmax(FACING.log_density(responses(clip, k, box))[0] + np.log(belief))
        assert item.pan is not None and item.tilt is not None
        np.testing.assert_allclose(item.pan, belief.reshape(3, 16, -1).sum(axis=(0, 2)), atol=1e-3)
        assert item.tilt == pytest.approx(FACING.mean_tilt(belief), abs=1e-3)


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
    assert "colour" not in found[-1].cues


def test_the_colour_tracker_remembers_as_far_as_it_is_told_to() -> None:
    rng = np.random.default_rng(0)
    box = (60.0, 40.0, 24.0, 30.0)

    def frame(share: float) -> np.ndarray:
        image = rng.integers(100, 140, (120, 160, 3)).astype(np.uint8)
        part = np.where(rng.random((30, 24, 1)) < share, (40, 60, 220), (220, 60, 40))
        image[40:70, 60:84] = part.astype(np.uint8)
        return image

    found = {}
    for rate in (0.0, 0.1):
        parameters = ColourParameters(60, rate=rate, dynamics=BoxDynamics(centre_std=0.01, size_std=0.0))
        tracker = ColourTracker(parameters, seed=0)
        tracker.start(frame(0.9), box)
        found[rate] = [tracker.step(frame(0.9 - 0.01 * k)) for k in range(70)][-1].confidence
    assert found[0.1] > found[0.0] + 0.1
    with pytest.raises(InputError, match="rate"):
        ColourParameters(rate=1.5)


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


def test_mean_and_mode_are_scored_apart(clip: HeadClip) -> None:
    found = followed(MixedStateTracker(exemplars=FACING, particles=20, seed=0), clip)
    run = scored(found, FACING.classes.pans, clip)
    pans = FACING.classes.pan
    mode = pans[[int(np.argmax(item.pan)) for item in found if item.pan is not None]]
    np.testing.assert_allclose(run.mode_error, np.abs(np.angle(np.exp(1j * (mode - clip.pan)))), atol=1e-9)
    assert not np.array_equal(run.mode_error, run.pan_error)
    tilt = np.array([item.tilt for item in found], float)
    np.testing.assert_allclose(run.tilt_error, np.abs(tilt - clip.tilt))


def test_failures_are_the_worst_frames_in_which_the_head_is_not_lost(clip: HeadClip) -> None:
    found = followed(MixedStateTracker(exemplars=FACING, particles=10, seed=0), clip)
    run = scored(found, FACING.classes.pans, clip)
    error = np.array([0.1] * 8 + [0.6, 0.7, 1.0, 1.0])
    runs: dict[str, Run] = dict.fromkeys(METHODS, replace(run, error=error, pan_error=np.ones(12)))
    (one,) = failures([(clip, runs)])
    assert one.frame == 9


def test_the_papers_confusions_are_as_printed() -> None:
    # The rows of the paper sum to 100 %, as far as it has rounded.
    np.testing.assert_allclose(CONFUSION.sum(axis=1), 100.0, atol=0.11)
    assert CONFUSION[PANS.index(67.5), PANS.index(90.0)] == 14.7
    assert CONFUSION[PANS.index(-67.5), PANS.index(-45.0)] == 3.1


# -- Yan et al. 2011
# ---------------------------------------------------------------------------------------------------


def test_a_fixed_reliability_stays_and_the_others_learn() -> None:
    rng = np.random.default_rng(0)
    person = rng.integers(0, 255, (36, 32, 3)).astype(np.uint8)
    tracks = {}
    for name, parameters in (("ours", SigmaPiParameters()), ("paper", SigmaPiParameters.of_the_paper())):
        tracker = SigmaPiTracker(parameters, seed=0)
        found = []
        for k in range(25):
            image = np.full((150, 200, 3), 120, np.uint8)
            image[50:86, 20 + 3 * k : 52 + 3 * k] = person
            box = (20.0, 50.0, 32.0, 36.0)
            estimate = tracker.step(image) if k else tracker.start(image, box)
            found.append([estimate.cues[f"reliability {term}"] for term in TERM_NAMES])
        tracks[name] = np.array(found)
    assert (tracks["paper"][:, 0] == 1.0).all()
    assert np.ptp(tracks["ours"][:, 0]) > 0.05
    assert (np.ptp(tracks["paper"][:, 1:], axis=0) > 0.05).all()
    with pytest.raises(InputError, match="smell"):
        SigmaPiParameters(fixed=("smell",))


# -- all ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", TRACKERS)
def test_every_tracker_has_its_papers_parameters(name: str) -> None:
    ours, paper = parameters_of(name), parameters_of(name, as_in_the_paper=True)
    assert type(ours) is type(paper) and ours.particles == paper.particles
    assert (ours == paper) == (name == "color")
    with pytest.raises(InputError, match="tracker 'magic'"):
        parameters_of("magic")


def test_a_background_is_for_sigma_pi_alone() -> None:
    image = np.random.default_rng(0).integers(0, 255, (60, 80, 3)).astype(np.uint8)
    assert make_tracker("sigma-pi", background=[image]).name == "sigma-pi"
    for name in ("color", "mixed-state"):
        with pytest.raises(InputError, match="sigma-pi, or none"):
            make_tracker(name, background=[image])
