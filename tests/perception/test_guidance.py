"""The graph in a tracker's loop, with targets whose course is known."""

from dataclasses import replace

import numpy as np
import pytest

from graphtrack.constants.online import OnlineSmoother
from graphtrack.geometry.angles import wrap
from graphtrack.geometry.camera import GroundCamera
from graphtrack.model import Observation
from perception.experiments.head_trackers import graph_on_top, survives
from perception.following import guidance
from perception.following.ground import BoxCamera
from perception.following.guidance import GUIDE_MODEL, GraphGuide
from perception.following.run import Followed, to_track
from perception.pose.classes import PoseClasses
from perception.trackers.tracker import BoxEstimate

FPS = 25.0
STEP = np.array([3.0, 0.5])
BOXES = BoxCamera(GroundCamera.from_scale(0.007), 0.5)


def estimate(
    centre: np.ndarray, *, found: bool = True, confidence: float = 0.95, noise: float = 1.0
) -> BoxEstimate:
    """A box of 30 × 40 pixels with a cloud about it."""
    box = (float(centre[0]) - 15.0, float(centre[1]) - 20.0, 30.0, 40.0)
    cloud = np.tile(box, (20, 1))
    cloud[:, :2] += np.random.default_rng(0).normal(0.0, noise, (20, 2))
    return BoxEstimate(box, np.full(2, noise), confidence, found, cloud, np.full(20, 0.05))


def course(k: int) -> np.ndarray:
    return np.array([60.0, 80.0]) + k * STEP


def guided(frames: int, **options: object) -> GraphGuide:
    guide = GraphGuide(BOXES, **options)
    for k in range(frames):
        guide.observe(k, estimate(course(k)))
    return guide


def test_the_prediction_is_that_of_a_graph_with_an_empty_frame_more() -> None:
    guide, smoother = guided(20), OnlineSmoother(GUIDE_MODEL)
    for k in range(20):
        found = estimate(course(k))
        x, y = BOXES.position(found.box)
        std = BOXES.position_std(found.box, found.particles, found.weights)
        smoother.update(Observation(k / FPS, position=(float(x), float(y)), position_std=std))
    for ahead in (20, 30):
        expected = smoother.update(Observation(ahead / FPS))
        proposal = guide.predict(ahead)
        centre = BOXES.box_centre(expected.position, 40.0)
        np.testing.assert_allclose(proposal.centre, centre, atol=1e-6)
        covariance = BOXES.pixel_covariance(expected.position, expected.covariance[:2, :2])
        floor = (BOXES.smallest_std * 40.0) ** 2 * np.eye(2)
        np.testing.assert_allclose(proposal.covariance, covariance + floor, rtol=1e-6, atol=1e-9)


def test_while_hidden_it_goes_on_and_becomes_less_sure() -> None:
    guide = guided(30)
    sizes = []
    for k in range(30, 55):
        proposal = guide.predict(k)
        assert np.linalg.norm(proposal.centre - course(k)) < 2.0
        sizes.append(np.trace(proposal.covariance))
        guide.observe(k, estimate(np.zeros(2), found=False))
    assert np.all(np.diff(sizes) > 0.0)


def test_what_a_tracker_says_as_its_target_is_covered_is_forgotten(monkeypatch: pytest.MonkeyPatch) -> None:
    """The box stands still for ten frames, as at the edge of a wall, before the tracker reports a loss."""
    errors = {}
    for forget in (0.0, 0.4):
        monkeypatch.setattr(guidance, "FORGET", forget)
        guide = guided(30)
        for k in range(30, 40):
            guide.observe(k, estimate(course(29) + (k - 29) * 0.3 * STEP))
        for k in range(40, 60):
            guide.observe(k, estimate(np.zeros(2), found=False))
        errors[forget] = np.linalg.norm(guide.predict(60).centre - course(60))
    assert errors[0.4] < 0.4 * errors[0.0]


@pytest.mark.parametrize("trusting", [False, True])
def test_a_tracker_that_is_much_less_sure_is_not_believed(
    trusting: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It stays at something like its target, with a confidence that is low for this tracker."""
    if trusting:
        monkeypatch.setattr(guidance, "DEVIATIONS", 1e6)
    rng, guide = np.random.default_rng(0), GraphGuide(BOXES)
    for k in range(60):
        sure = 0.95 + rng.uniform(-0.01, 0.01)
        guide.observe(k, estimate(course(min(k, 35)), confidence=sure if k <= 35 else 0.7))
    assert guide.rejected.issuperset(range(40, 60)) != trusting and 20 not in guide.rejected
    away = np.linalg.norm(guide.predict(60).centre - course(60))
    assert (away < 8.0) != trusting


@pytest.mark.parametrize("on_course", [True, False])
def test_a_target_is_found_again_where_it_is_expected(on_course: bool) -> None:
    guide = guided(30)
    for k in range(30, 45):
        guide.observe(k, estimate(np.zeros(2), found=False))
    for k in range(45, 60):
        # Off the course something like the target stands still.
        guide.observe(k, estimate(course(k) if on_course else course(45)))
    size = np.sqrt(np.trace(guide.predict(60).covariance))
    assert (size < 8.0) == on_course
    assert np.linalg.norm(guide.predict(60).centre - course(60)) < (3.0 if on_course else 8.0)


def test_patience_ends(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(guidance, "PATIENCE", 1.0)
    guide = guided(30)
    for k in range(30, 90):
        guide.observe(k, estimate(np.array([20.0, 20.0]), found=k > 35))
    assert np.linalg.norm(guide.predict(90).centre - 20.0) < 3.0


# -- guidance by the graph ---------------------------------------------------------------------------------


def test_the_graph_lowers_the_errors_of_noisy_boxes_and_pans() -> None:
    rng = np.random.default_rng(1)
    classes = PoseClasses.circle(16)
    n = 100
    pan = 0.5 * np.sin(np.arange(n) / 25.0)
    true = np.array([estimate(course(k)).box for k in range(n)])
    said = []
    for k in range(n):
        seen = estimate(course(k) + rng.normal(0.0, 4.0, 2), noise=4.0)
        about = wrap(classes.pan - (pan[k] + rng.normal(0.0, 0.5)))
        likelihood = np.exp(-0.5 * (about / 0.5) ** 2) + 0.01
        seen = replace(seen, pan=likelihood / likelihood.sum(), pan_likelihood=likelihood)
        said.append(seen)
    figures = graph_on_top(said, true, pan, BOXES, classes, FPS, "separate")
    assert figures.tracker_centre == pytest.approx(4.0 * np.sqrt(np.pi / 2.0) / 30.0, rel=0.15)
    assert figures.graph_centre < 0.7 * figures.tracker_centre
    assert figures.graph_pan < 0.8 * figures.tracker_pan


def test_what_the_graph_rejects_is_no_observation() -> None:
    said = [Followed(k, estimate(course(k)), not 15 <= k < 25) for k in range(40)]
    observed = to_track(said, BOXES, None, FPS)
    np.testing.assert_array_equal(np.isnan(observed.position[:, 0]), [not item.believed for item in said])


def test_survival_counts_from_the_reappearance_on() -> None:
    true = np.array([estimate(course(k)).box for k in range(60)])
    visible = np.ones(60)
    visible[20:30] = 0.0
    visible[30:33] = 0.3
    boxes = true.copy()
    boxes[22:42] += 1000.0  # back on the target nine frames after half of it is visible
    assert survives(boxes, true, visible)
    boxes[42:49] += 1000.0
    assert not survives(boxes, true, visible)
    with pytest.raises(ValueError, match="come back"):
        survives(boxes, true, np.where(np.arange(60) < 55, 1.0, 0.0))
