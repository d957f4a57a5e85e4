"""The head tracker whose exemplars are factors of the graph: its factors and solution against a grid."""

import numpy as np
import pytest

from graphtrack.constants.online import OnlineSmoother
from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray, difference
from graphtrack.model import Observation
from perception.experiments.head_trackers import tracking_error
from perception.pose.classes import PoseClasses
from perception.synthetic.head_clips import HeadClipParameters, head_clip
from perception.trackers.head_exemplars import LOOKING_UP, load_head_exemplars
from perception.trackers.head_graph import (
    TILTS,
    HeadGraphParameters,
    HeadGraphTracker,
    angle_of,
    class_shares,
    graph_of_head,
    lattice,
    moment_factor,
)
from perception.trackers.registry import make_tracker, parameters_of
from perception.trackers.tracker import Proposal

GTSAM = HeadGraphParameters(engine="fixed-lag")
"""Without compilation."""
FACING = load_head_exemplars().within(np.pi / 2.0)


def grid(reach: float, count: int) -> FloatArray:
    axis = np.linspace(-reach, reach, count)
    return np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)


def moments(weights: FloatArray, points: FloatArray) -> tuple[FloatArray, FloatArray]:
    weights = weights / weights.sum()
    mean = weights @ points
    return mean, (weights[:, None] * (points - mean)).T @ (points - mean)


def quadratic(numbers: tuple[float, ...], points: FloatArray) -> FloatArray:
    """Return half the square of the residuals (n,) of a factor's five numbers at points (n, 2)."""
    x, y, xx, xy, yy = numbers
    away = points - [x, y]
    return 0.5 * ((xx * away[:, 0] + xy * away[:, 1]) ** 2 + (yy * away[:, 1]) ** 2)


def bumps(points: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Return a likelihood (n,) with several modes at points (n, 2)."""
    places, heights = rng.normal(0.0, 0.8, (3, 2)), rng.uniform(0.5, 2.0, 3)
    return sum(
        h * np.exp(-((points - place) ** 2).sum(axis=1)) for h, place in zip(heights, places, strict=True)
    )


def test_windows_are_spread_as_a_normal_distribution() -> None:
    points = lattice(200)
    np.testing.assert_allclose(points.mean(axis=0), 0.0, atol=1e-9)
    np.testing.assert_allclose(np.cov(points.T), np.eye(4), atol=1e-9)
    assert len({tuple(row) for row in np.round(points, 6).tolist()}) == 200


@pytest.mark.parametrize("seed", range(4))
def test_a_factor_has_the_moments_of_its_likelihood(seed: int) -> None:
    rng = np.random.default_rng(seed)
    mean, root = rng.normal(0.0, 2.0, 2), np.linalg.cholesky([[0.02, 0.008], [0.008, 0.01]])
    points = lattice(4000)[:, :2]
    numbers, peak = moment_factor(points, 1e-7 * bumps(points, np.random.default_rng(seed)), mean, root)
    # The prediction's standard normal distribution on a grid, with the likelihood and with the factor.
    fine = grid(5.0, 401)
    prior = np.exp(-0.5 * (fine**2).sum(axis=1))
    factor = np.exp(-quadratic(numbers, mean + fine @ root.T))
    wanted, spread = moments(prior * bumps(fine, np.random.default_rng(seed)), fine)
    found, its = moments(prior * factor, fine)
    np.testing.assert_allclose(found, wanted, atol=0.03)
    np.testing.assert_allclose(its, spread + 0.1 * np.eye(2), atol=0.05)
    assert peak * (prior @ factor) / prior.sum() == pytest.approx(1.0, rel=1e-3)


def test_a_factor_of_an_even_likelihood_is_nearly_none() -> None:
    points = lattice(200)[:, :2]
    numbers, peak = moment_factor(points, np.ones(200), np.zeros(2), np.eye(2))
    assert quadratic(numbers, grid(1.0, 21)).max() < 0.2 and peak == pytest.approx(1.0, abs=0.1)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
def test_the_graph_has_place_and_pose_of_a_grid_over_the_same_likelihoods(seed: int) -> None:
    rng = np.random.default_rng(seed)
    numbers, odds = (*rng.normal(0.0, 0.1, 2), 6.0, rng.normal(0.0, 2.0), 4.0), rng.uniform(1.0, 30.0)
    pans, tilts = rng.uniform(-1.0, 1.0, 2), rng.uniform(-0.4, 0.4, 2)
    kappas = rng.uniform(1.0, 20.0, 2)
    model = graph_of_head("separate", 2.0, 3.0, 0.5, 1.0)
    smoother = OnlineSmoother(model, constants="default", engine="fixed-lag", lag=0.5)
    for k in (0, 1):
        pose = {"head": pans[k], "head_kappa": kappas[k], "body": tilts[k], "body_kappa": kappas[k]}
        place = {"position": (0.0, 0.0), "position_std": 0.2, "inputs": {"exemplars": (*numbers, odds)}}
        found = smoother.update(Observation(0.04 * k, **pose, **(place if k == 0 else {})))
        if k == 0:
            places = grid(0.5, 501)
            total = (places**2).sum(axis=1) / (2.0 * 0.2**2)
            total -= np.log1p(odds * np.exp(-quadratic(numbers, places)))
            assert np.abs(found.position - places[total.argmin()]).max() < 0.004
    before, now = grid(1.2, 601).T
    for given, diffusion, angle in ((pans, 1.0, found.head), (tilts, 0.5, found.body)):
        density = kappas[0] * np.cos(before - given[0]) + kappas[1] * np.cos(now - given[1])
        density += np.cos(now - before) / (diffusion * 0.04)
        assert abs(angle - now[density.argmax()]) < 0.005


def test_classes_have_a_mean_angle_and_a_concentration() -> None:
    classes = PoseClasses.circle(16)
    angle, kappa = angle_of(np.exp(8.0 * np.cos(classes.pan - 2.0)), classes)
    assert angle == pytest.approx(2.0, abs=0.01) and kappa == pytest.approx(8.0, rel=0.1)
    _, unknown = angle_of(np.ones(16), classes)
    _, either = angle_of(np.eye(16)[0] + np.eye(16)[8], classes)
    angle, sure = angle_of(np.eye(16)[3], classes)
    assert unknown == pytest.approx(0.0, abs=1e-6) and either == pytest.approx(0.0, abs=1e-6)
    assert angle == pytest.approx(classes.pan[3]) and 50.0 < sure < 100.0
    assert angle_of(np.array([0.2, 0.6, 0.2]), TILTS)[0] == pytest.approx(0.0, abs=1e-9)


def test_an_angle_between_classes_is_shared_by_them() -> None:
    classes = PoseClasses.circle(16)
    shares = class_shares(np.pi - 0.1, 0.01, classes)
    assert shares.sum() == pytest.approx(1.0)
    assert abs(difference(classes.mean_of(shares), np.pi - 0.1)) < 0.01
    assert (shares[np.abs(difference(classes.pan, np.pi - 0.1)) > 0.3 + classes.step] == 0.0).all()


@pytest.mark.slow
def test_a_head_is_followed_through_its_turn() -> None:
    clip = head_clip(np.random.default_rng(11), HeadClipParameters(30, clutter=0.3))
    tracker = HeadGraphTracker(GTSAM, exemplars=FACING, rate=clip.fps)
    found = [
        tracker.start(clip.images[0], tuple(clip.boxes[0].tolist())),
        *map(tracker.step, clip.images[1:]),
    ]
    assert tracking_error(np.array([item.box for item in found]), clip.boxes).mean() < 0.3
    pans = FACING.classes.pans.mean_of(np.array([item.pan for item in found]))
    assert np.degrees(np.abs(difference(pans, clip.pan))).mean() < 35.0
    for item in found:
        assert item.found and item.tilt is not None and abs(item.tilt) <= LOOKING_UP
        assert (item.spread > 0.0).all() and (item.spread < 0.3 * clip.boxes[0, 2]).all()


@pytest.mark.slow
def test_a_hidden_head_moves_on_and_a_proposal_moves_it() -> None:
    clip = head_clip(np.random.default_rng(4), HeadClipParameters(12, clutter=0.5))
    black = np.zeros_like(clip.images[0])
    ends = []
    for proposal in (None, Proposal(np.array([250.0, 60.0]), 16.0 * np.eye(2))):
        tracker = HeadGraphTracker(GTSAM, exemplars=FACING)
        tracker.start(clip.images[0], tuple(clip.boxes[0].tolist()))
        last = [tracker.step(image) for image in clip.images[1:]][-1]
        hidden = [tracker.step(black, proposal) for _ in range(6)][-1]
        assert last.found and not hidden.found
        assert (hidden.spread > 1.5 * last.spread).all() == (proposal is None)
        ends.append((last.centre, hidden.centre))
    (last, moved), (_, proposed) = ends
    walked = clip.boxes[-1, 0] - clip.boxes[0, 0]
    assert np.sign(moved[0] - last[0]) == np.sign(walked) and abs(moved[0] - last[0]) > 0.2 * abs(walked)
    assert np.abs(proposed - [250.0, 60.0]).max() < 25.0


def test_what_it_does_not_take_is_refused() -> None:
    with pytest.raises(InputError, match="at least 8"):
        HeadGraphParameters(windows=1)
    for rate in (0.0, float("nan")):
        with pytest.raises(InputError, match="frames a second"):
            HeadGraphTracker(rate=rate)
    with pytest.raises(InputError, match="particles for head-graph"):
        make_tracker("head-graph", 50)
    with pytest.raises(InputError, match="mixed-state"):
        parameters_of("head-graph", as_in_the_paper=True)
    assert make_tracker("head-graph", rate=10.0).name == "head-graph"
