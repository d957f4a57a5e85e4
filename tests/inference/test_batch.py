from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from costs import cost_around, free, gradient, states_of
from scipy import stats
from scipy.spatial.transform import Rotation
from selection import others_slow
from walks import rotation, turned, walk, without

from graphtrack.baselines.kalman import rauch_tung_striebel
from graphtrack.errors import SolveError
from graphtrack.geometry.angles import UNIFORM_STD, difference, wrap
from graphtrack.geometry.camera import GroundCamera
from graphtrack.inference import Failure, Solution, SolverOptions, smooth_track
from graphtrack.inference.engines import OfflineEngine
from graphtrack.model import (
    CouplingParameters,
    LikelihoodParameters,
    Model,
    MotionParameters,
    Parameters,
    presets,
)
from graphtrack.smoothing import smooth, solve
from graphtrack.tracks.track import Track, TrackSet

EXACTLY = SolverOptions(max_iterations=300, relative_tolerance=0.0, step_tolerance=1e-10)
PRESETS = sorted(presets)
EVERY_PRESET = pytest.mark.parametrize("preset", PRESETS)
# Between them they have every term.
MOST_TERMS = pytest.mark.parametrize("preset", others_slow(PRESETS, ["joint-intentional", "social"]))
SYMMETRIC = pytest.mark.parametrize("preset", ["joint", "position", "separate"])


def assert_same_angles(found: np.ndarray | None, expected: np.ndarray | None, tolerance: float) -> None:
    assert (found is None) == (expected is None)
    if found is not None and expected is not None:
        np.testing.assert_allclose(difference(found, expected), 0.0, atol=tolerance)


def assert_covariances_are_proper(track: Track, model: Model) -> None:
    columns = free(model)
    for block in track.covariance[:, columns][:, :, columns]:
        np.testing.assert_allclose(block, block.T, rtol=1e-9, atol=1e-12)
        assert np.linalg.eigvalsh(block).min() > 0.0
    rest = [k for k in range(6) if k not in columns]
    assert np.isnan(track.covariance[:, rest]).all()
    angles = np.sqrt(np.diagonal(track.covariance, axis1=1, axis2=2)[:, [k for k in columns if k > 3]])
    assert np.all(angles <= UNIFORM_STD * (1.0 + 1e-9))


# The linear model.

GAPS = {
    "none": np.array([], dtype=int),
    "inner": np.array([5, 6, 7, 8, 9, 20]),
    "first": np.arange(4),
    "last": np.arange(25, 30),
    "first and last": np.array([0, 1, 12, 13, 14, 28, 29]),
    "all but one": np.delete(np.arange(30), 11),
}


@pytest.mark.parametrize("gaps", GAPS)
@pytest.mark.parametrize("uneven", [False, True], ids=["even", "uneven"])
@pytest.mark.parametrize("own_std", [False, True], ids=["one std", "own stds"])
def test_the_preset_position_equals_rauch_tung_striebel(gaps: str, uneven: bool, own_std: bool) -> None:
    track = without(walk(30, seed=5, uneven=uneven), "position", GAPS[gaps])
    if own_std:
        std = np.linspace(0.03, 0.4, 30)
        std[::7] = np.nan
        track = replace(track, position_std=std)
    parameters = Parameters(motion=MotionParameters(0.7, 1.3))
    found = smooth_track(track, Model("position", parameters)).track
    expected = rauch_tung_striebel(track, parameters)
    np.testing.assert_allclose(found.position, expected.position, atol=1e-8)
    np.testing.assert_allclose(found.velocity, expected.velocity, atol=1e-8)
    np.testing.assert_allclose(
        found.covariance[:, :4, :4], expected.covariance[:, :4, :4], rtol=1e-8, atol=1e-8
    )


def simulated(
    rng: np.random.Generator, n: int, dt: float, parameters: Parameters
) -> tuple[Track, np.ndarray]:
    """A track drawn from the linear model itself, with its true states (n, 4)."""
    density = parameters.motion.acceleration_density
    velocity = rng.normal(0.0, parameters.motion.initial_speed_std, 2)
    position = rng.uniform(-10.0, 10.0, 2)
    states = [np.concatenate([position, velocity])]
    block = density * np.array([[dt**3 / 3.0, dt**2 / 2.0], [dt**2 / 2.0, dt]])
    root = np.linalg.cholesky(block)
    for _ in range(n - 1):
        bend, kick = root @ rng.normal(size=(2, 2))
        position = position + dt * velocity + bend
        velocity = velocity + kick
        states.append(np.concatenate([position, velocity]))
    truth = np.array(states)
    seen = truth[:, :2] + rng.normal(0.0, parameters.likelihood.position_std, (n, 2))
    return Track(1, np.arange(n), dt * np.arange(n), seen), truth


@pytest.mark.slow
@pytest.mark.parametrize("frame", [0, 6, 11])
def test_the_nees_of_positions_and_velocities_lies_in_its_band(frame: int) -> None:
    parameters = Parameters(motion=MotionParameters(0.8, 1.4), likelihood=LikelihoodParameters(0.15))
    rng, model, total, position_total = np.random.default_rng(8), Model("position", parameters), 0.0, 0.0
    for _ in range(200):
        track, truth = simulated(rng, 12, 0.15, parameters)
        track = without(track, "position", [3, 4, 5])
        found = smooth_track(track, model).track
        error = np.concatenate([found.position[frame], found.velocity[frame]]) - truth[frame]
        spread = found.covariance[frame, :4, :4]
        total += error @ np.linalg.solve(spread, error)
        position_total += error[:2] @ np.linalg.solve(spread[:2, :2], error[:2])
    low, high = stats.chi2.ppf([0.025, 0.975], 200 * 4)
    assert low < total < high
    low, high = stats.chi2.ppf([0.025, 0.975], 200 * 2)
    assert low < position_total < high


# Invariances.


GAPPED = without(without(walk(25, seed=1, uneven=True), "body", slice(5, 12)), "position", slice(15, 18))
OUTLIERS = Parameters(likelihood=LikelihoodParameters(robust="huber", body_outliers=0.1, head_outliers=0.1))


@MOST_TERMS
@pytest.mark.parametrize(
    ("track", "parameters", "angle"),
    [
        (GAPPED, None, 0.0),
        (GAPPED, None, np.pi),
        (GAPPED, None, -2.5),
        (walk(15, seed=3, classes=True), None, np.pi / 2.0),
        (walk(15, seed=6), OUTLIERS, 2.0),
    ],
    ids=["shift", "half a turn", "turn", "classes", "outliers"],
)
def test_estimates_move_and_turn_with_the_world(
    preset: str, track: Track, parameters: Parameters | None, angle: float
) -> None:
    assert_equivariant(Model(preset, parameters), track, angle, (30.0, -80.0))


def assert_equivariant(model: Model, track: Track, angle: float, shift: tuple[float, float]) -> None:
    here = smooth_track(track, model, options=EXACTLY)
    there = smooth_track(turned(track, angle, shift), model, options=EXACTLY)
    turn = rotation(angle)
    np.testing.assert_allclose(there.track.position, here.track.position @ turn.T + shift, atol=1e-6)
    np.testing.assert_allclose(there.track.velocity, here.track.velocity @ turn.T, atol=1e-6)
    for name in ("body", "head"):
        before = getattr(here.track, name)
        assert_same_angles(getattr(there.track, name), None if before is None else before + angle, 1e-5)
    whole = np.eye(6)
    whole[:2, :2] = whole[2:4, 2:4] = turn
    columns = np.ix_(range(len(track)), free(model), free(model))
    expected = np.nan_to_num(here.track.covariance)
    expected = whole @ expected @ whole.T
    np.testing.assert_allclose(there.track.covariance[columns], expected[columns], rtol=1e-4, atol=1e-6)
    assert there.cost == pytest.approx(here.cost, rel=1e-7)


@SYMMETRIC  # a head that steers does so forwards in time only
def test_a_walk_seen_backwards_is_the_walk_backwards(preset: str) -> None:
    """No prior distinguishes the first frame from the last; body and head turn with the motion."""
    parameters = Parameters(
        motion=MotionParameters(initial_speed_std=1e3), coupling=CouplingParameters(correlation_time=0.0)
    )
    model, track = Model(preset, parameters), walk(25, seed=7, uneven=True)
    backwards = replace(
        track,
        t=(track.t[0] + track.t[-1] - track.t)[::-1],
        position=track.position[::-1],
        body=wrap(track.body[::-1] + np.pi),
        head=wrap(track.head[::-1] + np.pi),
    )
    one = smooth_track(track, model, options=EXACTLY).track
    other = smooth_track(backwards, model, options=EXACTLY).track
    np.testing.assert_allclose(other.position[::-1], one.position, atol=1e-5)
    np.testing.assert_allclose(-other.velocity[::-1], one.velocity, atol=1e-4)
    for name in ("body", "head"):
        before, after = getattr(one, name), getattr(other, name)
        assert_same_angles(None if after is None else after[::-1] + np.pi, before, 1e-4)
    for name in ("x", "vx", "body", "head"):
        one_std, other_std = one.std(name), other.std(name)
        np.testing.assert_allclose(other_std[::-1], one_std, rtol=1e-4)


# The optimum.


def sparse(n: int) -> Track:
    """A walk with nine tenths of each channel missing."""
    track, missing = walk(n, seed=1, uneven=True), np.random.default_rng(1).permutation(n) > n // 10
    for name in ("position", "body", "head"):
        track = without(track, name, missing)
    return track


SITUATIONS = {
    "angles": (walk(8, seed=1), Parameters()),
    "uneven": (walk(8, seed=2, uneven=True), Parameters()),
    "classes": (walk(8, seed=3, classes=True), Parameters()),
    "gaps": (without(without(walk(8, seed=4), "position", slice(2, 5)), "body", slice(0, 5)), Parameters()),
    "head alone": (without(replace(walk(8, seed=2), body=None), "position", slice(1, 8)), Parameters()),
    "sparse": (sparse(30), Parameters()),
    "outliers": (
        walk(8, seed=5),
        Parameters(likelihood=LikelihoodParameters(body_outliers=0.1, head_outliers=0.1)),
    ),
    "huber": (walk(8, seed=6, noise=0.3), Parameters(likelihood=LikelihoodParameters(robust="huber"))),
    "cauchy": (walk(8, seed=6, noise=0.3), Parameters(likelihood=LikelihoodParameters(robust="cauchy"))),
}


QUICK = [("joint-intentional", situation) for situation in ("classes", "outliers", "cauchy")]
QUICK += [("social", situation) for situation in ("uneven", "gaps")]


@pytest.mark.parametrize(
    ("preset", "situation"),
    # Between them they have every term.
    others_slow([(preset, situation) for preset in PRESETS for situation in SITUATIONS], QUICK),
)
def test_the_gradient_of_the_cost_vanishes_at_the_estimate(preset: str, situation: str) -> None:
    track, parameters = SITUATIONS[situation]
    model = Model(preset, parameters)
    found = smooth_track(track, model, options=EXACTLY).track
    size = len(track) * len(free(model))
    cost = cost_around(states_of(found), track, model)
    at_estimate = gradient(cost, size)
    elsewhere = np.random.default_rng(0).normal(0.0, 0.05, size)
    beside = gradient(lambda vector: cost(elsewhere + vector), size)
    assert np.abs(at_estimate).max() < 1e-4 and np.abs(at_estimate).max() < 1e-5 * np.abs(beside).max()


# Little to go by.


@EVERY_PRESET
@pytest.mark.parametrize("length", [1, 2, 3])
def test_tracks_of_a_few_frames_have_estimates(preset: str, length: int) -> None:
    model = Model(preset)
    for track in (walk(length), walk(length, classes=True), replace(walk(length), body=None, head=None)):
        found = smooth_track(track, model).track
        assert np.isfinite(found.position).all() and np.isfinite(found.velocity).all()
        assert_covariances_are_proper(found, model)
    if length == 1:
        np.testing.assert_allclose(smooth_track(walk(1), Model("separate")).track.position, walk(1).position)


# Likelihoods.


def oblique_camera() -> GroundCamera:
    """5 m above (0, −12), looking down at the walkers."""
    look = Rotation.from_euler("x", -1.1).as_matrix() @ np.diag([1.0, -1.0, -1.0])
    intrinsics = np.array([[900.0, 0.0, 640.0], [0.0, 900.0, 360.0], [0.0, 0.0, 1.0]])
    return GroundCamera.from_calibration(look, -look @ np.array([0.0, -12.0, 5.0]), intrinsics, None)


def test_the_pixel_likelihood_is_left_out_on_request_and_without_a_camera_or_a_pixel() -> None:
    camera, track = oblique_camera(), walk(10, seed=4)
    seen = replace(track, pixel=camera.ground_to_image(track.position) + 5.0)
    expected = smooth_track(track, Model("position")).track
    metres_only = Model("position", Parameters(likelihood=LikelihoodParameters(image_frame=False)))
    blank = replace(track, pixel=np.full((10, 2), np.nan))
    for found in (
        smooth_track(seen, metres_only, camera),
        smooth_track(seen, Model("position")),
        smooth_track(blank, Model("position"), camera),
    ):
        np.testing.assert_array_equal(found.track.position, expected.position)
    assert (
        np.abs(smooth_track(seen, Model("position"), camera).track.position - expected.position).max() > 0.01
    )


# Many tracks.


def some_tracks() -> TrackSet:
    blank = replace(walk(6, track_id=7), position=np.full((6, 2), np.nan))
    return TrackSet((walk(9, track_id=1, seed=1), blank, walk(12, track_id=3, seed=3, classes=True)))


@EVERY_PRESET
def test_a_track_that_fails_is_named_and_the_others_come_out(preset: str) -> None:
    first, failed, last = solve(some_tracks(), preset, constants="default")
    assert isinstance(failed, Failure) and failed.track_id == 7
    assert "no position" in failed.reason and isinstance(first, Solution)
    assert isinstance(last, Solution) and (first.track.track_id, last.track.track_id) == (1, 3)
    alone = smooth_track(some_tracks().by_id(3), Model(preset))
    np.testing.assert_array_equal(last.track.position, alone.track.position)
    with pytest.raises(SolveError, match=r"track 7: .*no position"):
        smooth(some_tracks(), preset)


@pytest.mark.slow
@pytest.mark.parametrize("engine", ["chain", "gtsam"])
def test_two_workers_find_the_same_bytes_as_one(engine: OfflineEngine) -> None:
    tracks = TrackSet((*some_tracks(), *(walk(8, seed=k, track_id=k, uneven=True) for k in range(20, 25))))
    finished: list[int] = []
    alone = solve(tracks, "joint", engine=engine)
    together = solve(tracks, "joint", engine=engine, jobs=2, progress=finished.append)
    assert sum(finished) == tracks.n_frames
    for one, other in zip(alone, together, strict=True):
        assert type(one) is type(other)
        if isinstance(one, Solution) and isinstance(other, Solution):
            assert (one.cost, one.iterations) == (other.cost, other.iterations)
            np.testing.assert_equal(vars(other.track), vars(one.track))


def test_estimates_keep_the_truth_and_drop_the_observations() -> None:
    track = replace(walk(6, seed=1), label="corridor", head_kappa=np.full(6, 3.0))
    estimates = smooth(TrackSet((track,)), "joint")
    found = estimates.by_id(1)
    assert found.label == "corridor"
    np.testing.assert_array_equal(found.t, track.t)
    np.testing.assert_array_equal(found.true_position, track.true_position)
    for name in ("position_std", "pixel", "body_kappa", "head_kappa", "body_likelihood", "head_likelihood"):
        assert getattr(found, name) is None
