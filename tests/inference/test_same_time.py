"""Rows of one person at one time, or nearly: both count, in every engine."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import graphtrack as gt
from graphtrack import Observation, Track
from graphtrack.geometry.camera import GroundCamera
from graphtrack.inference.online import OnlineSolver
from graphtrack.model import Model, Parameters
from graphtrack.model.observation import observations
from graphtrack.model.parameters import LikelihoodParameters
from graphtrack.model.same_time import SAME_TIME, merged

ENGINES: list[Any] = ["chain", "fixed-lag", "isam2"]
PRESETS = ["position", "separate", "joint", "joint-intentional"]
LIKELIHOOD = LikelihoodParameters()
EXTENDED = np.longdouble


def model_of(density: float, preset: str = "position") -> Model:
    """A model whose covariances are those of the filter."""
    motion = {"acceleration_density": density}
    return Model(preset).with_parameters(Parameters.from_dict({"motion": motion}))


def kalman_and_rts(t: Any, x: Any, std: Any, density: float, speed_std: float = 1.5) -> tuple[Any, ...]:
    """Filtered and smoothed means (n, 2) and covariances (n, 2, 2) of one axis, in extended precision.

    In covariance form, which loses nothing where the steps are short.
    """
    n, t, x = len(t), np.asarray(t, EXTENDED), np.asarray(x, EXTENDED)
    noise = np.broadcast_to(np.asarray(std, EXTENDED), n) ** 2
    mean, ahead = np.zeros((2, n, 2), EXTENDED)
    cov, cov_ahead = np.zeros((2, n, 2, 2), EXTENDED)
    mean[0], cov[0] = [x[0], 0], np.diag([noise[0], EXTENDED(speed_std) ** 2])
    for k in range(1, n):
        dt = t[k] - t[k - 1]
        step = np.array([[1, dt], [0, 1]], EXTENDED)
        spread = density * np.array([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]], EXTENDED)
        ahead[k], cov_ahead[k] = step @ mean[k - 1], step @ cov[k - 1] @ step.T + spread
        gain = cov_ahead[k][:, 0] / (cov_ahead[k][0, 0] + noise[k])
        mean[k] = ahead[k] + gain * (x[k] - ahead[k][0])
        cov[k] = cov_ahead[k] - np.outer(gain, cov_ahead[k][0])
    smooth, cov_smooth = mean.copy(), cov.copy()
    for k in range(n - 2, -1, -1):
        step = np.array([[1, t[k + 1] - t[k]], [0, 1]], EXTENDED)
        (a, b), (c, d) = cov_ahead[k + 1]
        inverse = np.array([[d, -b], [-c, a]], EXTENDED) / (a * d - b * c)
        gain = cov[k] @ step.T @ inverse
        smooth[k] = mean[k] + gain @ (smooth[k + 1] - ahead[k + 1])
        cov_smooth[k] = cov[k] + gain @ (cov_smooth[k + 1] - cov_ahead[k + 1]) @ gain.T
    return tuple(one.astype(float) for one in (mean, cov, smooth, cov_smooth))


def product(x: Any, std: Any) -> tuple[float, float]:
    """Mean and 1-σ of the product of Gaussians."""
    weight = 1.0 / np.square(std)
    return float(weight @ x / weight.sum()), float(weight.sum() ** -0.5)


APART = [0.0, 2e-16, 1e-12, 1e-9, 1e-7, 1e-6, 1e-5, 1e-4, 4.9e-4, 5.1e-4, 1e-3]


def two_sensors(apart: float, std: Any, n: int = 30, first: float = 0.0) -> tuple[Any, Any, Any]:
    """Times, positions and 1-σ of two sensors at 10 Hz, the second ``apart`` seconds behind; as they come."""
    rng = np.random.default_rng(3)
    t = (first + np.arange(n) / 10.0)[:, None] + np.array([0.0, apart])
    std = np.broadcast_to(np.asarray(std), (n, 2))
    return t, 1.3 * (t - first) + std * rng.standard_normal((n, 2)), std


@pytest.mark.parametrize("density", [0.01, 0.15, 10.0])
@pytest.mark.parametrize("std", [(0.005, 0.02), (0.1, 0.1), (1.0, 0.3)], ids=str)
@pytest.mark.parametrize(
    ("engine", "preset"), [("chain", "position"), ("chain", "separate"), ("gtsam", "joint")]
)
def test_rows_a_hair_apart_equal_the_kalman_smoother(engine, preset, std, density) -> None:
    preset = "position" if preset == "joint" else preset  # with angles GTSAM takes long
    for apart in (one for one in APART if one):
        t, x, stds = two_sensors(apart, std)
        row = t.ravel()
        if not (np.diff(row) > 0.0).all():
            continue  # the same double: a track has each time once
        position = np.column_stack([x.ravel(), np.zeros(row.size)])
        track = Track(1, np.arange(row.size), row, position, position_std=stds.ravel())
        found = gt.smooth(track, model_of(density, preset), engine=engine)
        *_, smooth, covariance = kalman_and_rts(row, x.ravel(), stds.ravel(), density)
        spread = np.sqrt(covariance[:, 0, 0])
        # Rows that count as one time differ from it by up to 0.65 mm.
        shift = 1.4 * apart if apart < SAME_TIME else 0.0
        assert (np.abs(found.position[:, 0] - smooth[:, 0]) <= 0.02 * spread + shift).all(), apart
        np.testing.assert_allclose(np.sqrt(found.covariance[:, 0, 0]), spread, rtol=0.01)
        np.testing.assert_allclose(
            np.sqrt(found.covariance[:, 2, 2]), np.sqrt(covariance[:, 1, 1]), rtol=0.01
        )
        np.testing.assert_array_equal(found.t, row)


@pytest.mark.parametrize("first", [0.0, 1.7e9], ids=["from 0", "Unix"])
@pytest.mark.parametrize("sign", [1.0, -1.0], ids=["after", "before"])
@pytest.mark.parametrize("engine", ENGINES)
def test_a_second_sensor_online_equals_the_kalman_filter(engine, sign, first) -> None:
    density, std = 0.15, (0.1, 0.02)
    for apart in APART:
        t, x, stds = two_sensors(sign * apart, std, first=first)
        smoother, one_time = (
            OnlineSolver(model_of(density), engine=engine),
            abs(t[5, 1] - t[5, 0]) < SAME_TIME,
        )
        both = [product(*pair) for pair in zip(x, stds, strict=True)]
        rows = [
            [Observation(t=t[k, i], position=(x[k, i], 0.0), position_std=std[i]) for i in (0, 1)]
            for k in range(len(t))
        ]
        if sign < 0.0 and not one_time:
            del rows[0][1]  # it is older than the window
        for some in rows:
            found = [smoother.update(one) for one in some]
            expected = ["new", "late" if one_time or sign < 0.0 else "new"]
            assert [one.status for one in found] == expected[: len(some)]
        if one_time:
            values = t[:, 0], *map(np.array, zip(*both, strict=True))
        else:
            used = sorted((one.t, *one.position[:1], one.position_std) for some in rows for one in some)
            values = tuple(map(np.array, zip(*used, strict=True)))
        mean, cov, *_ = kalman_and_rts(values[0] - first, *values[1:], density)
        spread = cov[-1, 0, 0] ** 0.5
        assert abs(found[1].position[0] - mean[-1, 0]) < 1e-3 * spread, apart
        assert found[1].covariance[0, 0] ** 0.5 == pytest.approx(spread, rel=1e-3)
        # The first sensor alone has never the accuracy of the second.
        assert found[0].covariance[0, 0] > found[1].covariance[0, 0]


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("hertz", [200, 1000])
@pytest.mark.parametrize(("std", "density"), [(0.01, 0.15), (0.1, 0.15), (1.0, 0.15), (0.1, 0.01)])
def test_high_rates_equal_the_kalman_filter(engine, hertz, std, density) -> None:
    n, rng = 60, np.random.default_rng(0)
    t = np.arange(n) / hertz
    x = 1.3 * t + std * rng.standard_normal(n)
    mean, cov, *_ = kalman_and_rts(t, x, std, density)
    smoother = OnlineSolver(model_of(density), engine=engine, lag=0.05)
    for k in range(n):
        found = smoother.update(Observation(t=t[k], position=(x[k], 0.0), position_std=std))
        assert found.status == "new"
        spread = cov[k, 0, 0] ** 0.5
        assert abs(found.position[0] - mean[k, 0]) < 1e-3 * spread
        assert found.covariance[0, 0] ** 0.5 == pytest.approx(spread, rel=1e-3)


@pytest.mark.parametrize("engine", ENGINES)
def test_orientations_at_high_rates_are_found_too(engine) -> None:
    rng = np.random.default_rng(0)
    smoother = OnlineSolver("joint", engine=engine, lag=0.05)
    for k in range(60):
        t, head = k / 500, 0.5 + 0.1 * rng.standard_normal()
        position = (1.3 * t + 0.01 * rng.standard_normal(), 0.0)
        found = smoother.update(
            Observation(t=t, position=position, position_std=0.01, head=head, head_kappa=100.0)
        )
        assert found.status == "new"
    assert abs(found.head - 0.5) < 0.1


@pytest.mark.parametrize("preset", PRESETS)
@pytest.mark.parametrize("engine", ENGINES)
def test_the_second_row_of_a_time_is_used_whatever_the_order(engine, preset) -> None:
    rows = [
        [
            Observation(t=k / 10, position=(0.13 * k, 0.0), position_std=0.1, head=0.1, head_kappa=20.0),
            Observation(t=k / 10 + 1e-12 * (-1) ** k, position=(0.13 * k + 0.05, 0.02), position_std=0.05),
            Observation(t=k / 10, head=0.3, head_kappa=10.0, body=0.2),
        ]
        for k in range(12)
    ]
    found = []
    for order in ((0, 1, 2), (0, 2, 1)):
        smoother = OnlineSolver(preset, engine=engine)
        for some in rows:
            estimates = [smoother.update(some[i]) for i in order]
            assert [one.status for one in estimates] == ["new", "late", "late"]
            # What was sent already counts once.
            again = [smoother.update(some[i]) for i in order]
            assert [one.status for one in again] == ["duplicate"] * 3
        found.append(again[-1])
    # Within the tolerances of the solvers, which began from different states.
    np.testing.assert_allclose(found[0].position, found[1].position, atol=2e-3)
    spreads = [np.sqrt(np.diagonal(one.covariance)) for one in found]
    np.testing.assert_allclose(*spreads, rtol=0.03)


ANGLES = st.floats(-3.1, 3.1)


@given(st.lists(st.tuples(ANGLES, st.floats(0.1, 50.0)), min_size=2, max_size=4))
@settings(max_examples=50)
def test_angles_of_one_time_are_multiplied(given_angles) -> None:
    parts = [Observation(t=0.0, head=angle, head_kappa=kappa) for angle, kappa in given_angles]
    one, grid = merged(parts, LIKELIHOOD, None), np.linspace(-np.pi, np.pi, 17)
    expected = sum(kappa * np.cos(grid - angle) for angle, kappa in given_angles)
    np.testing.assert_allclose(one.head_kappa * np.cos(grid - one.head), expected, atol=1e-9)


@given(st.lists(st.tuples(st.floats(-50, 50), st.floats(1e-3, 10.0)), min_size=2, max_size=4))
@settings(max_examples=50)
def test_positions_of_one_time_are_multiplied_in_any_order(given_positions) -> None:
    parts = [Observation(t=0.0, position=(x, 1.0), position_std=std) for x, std in given_positions]
    mean, std = product(*np.array(given_positions).T)
    for some in (parts, parts[::-1]):
        one = merged(some, LIKELIHOOD, None)
        assert one.position == pytest.approx((mean, 1.0)) and one.position_std == pytest.approx(std)
    # The noise that nobody declares is the model's, before and after the scale of declared ones.
    scaled = replace(LIKELIHOOD, position_scale=2.0, position_std=0.3)
    undeclared = merged([replace(one, position_std=None) for one in parts], scaled, None)
    assert scaled.position_stds(undeclared.position_std, 1)[0] == pytest.approx(0.3 / len(parts) ** 0.5)


def test_a_robust_loss_leaves_out_the_position_that_two_others_contradict() -> None:
    robust = replace(LIKELIHOOD, robust="cauchy")
    parts = [Observation(t=0.0, position=(x, 0.0), position_std=0.1) for x in (0.0, 0.05, 7.0)]
    one = merged(parts, robust, None)
    assert abs(one.position[0] - 0.025) < 0.05 and 0.07 < one.position_std < 0.08
    pair = merged([parts[0], parts[2]], robust, None)
    assert pair.position == pytest.approx((3.5, 0.0)) and pair.position_std > 0.7


def test_classes_of_one_time_are_multiplied() -> None:
    first, second = (0.5, 0.5, *[0.0] * 6), (0.2, 0.6, *[0.2] * 6)
    parts = [Observation(t=0.0, body_likelihood=one) for one in (first, second)]
    np.testing.assert_allclose(merged(parts, LIKELIHOOD, None).body_likelihood, [0.25, 0.75, *[0.0] * 6])


CAMERA = GroundCamera.from_homography([[0.02, 0.0, -6.0], [0.0, -0.03, 14.0], [0.0, 0.01, 1.0]])
CONTRADICT = {
    "pixel": [{"pixel": (300.0, 200.0)}, {"pixel": (301.0, 200.0)}],
    "position": [{"pixel": (300.0, 200.0)}, {"position": (1.0, 2.0)}],
    "class likelihoods of the head": [{"head": 0.1}, {"head_likelihood": (1.0,) * 12}],
    "classes of the body that exclude": [
        {"body_likelihood": (1.0, *[0.0] * 7)},
        {"body_likelihood": (0.0, 1.0, *[0.0] * 6)},
    ],
    "input 'distance'": [{"inputs": {"distance": 1.0}}, {"inputs": {"distance": 2.0}}],
}


@pytest.mark.parametrize(("named", "both"), CONTRADICT.items())
def test_what_has_no_product_is_refused_by_name(named, both) -> None:
    smoother = OnlineSolver("joint", camera=CAMERA)
    rows = [Observation(t=0.1 * k, position=(0.1 * k, 0.0)) for k in range(5)]
    for one in rows:
        smoother.update(one)
    first, second = (Observation(t=0.5, **one) for one in both)
    before = smoother.update(first)
    failed = smoother.update(replace(second, t=0.5 + 1e-9))
    assert failed.status == "failed" and named in failed.reason
    np.testing.assert_array_equal(failed.position, before.position)


def test_a_track_whose_inputs_contradict_each_other_fails_alone() -> None:
    t = np.array([0.0, 0.1, 0.1 + 1e-9, 0.2])
    position, frame = np.column_stack([t, t]), np.arange(4)
    wrong = Track(1, frame, t, position, inputs={"distance": np.array([1.0, 2.0, 3.0, 4.0])})
    failed, right = gt.solve([wrong, Track(2, frame, t, position)], "position")
    assert "two values of the input 'distance'" in failed.reason and len(right.track) == 4


@pytest.mark.parametrize("engine", ENGINES)
def test_merged_observations_survive_a_state(engine) -> None:
    options: dict[str, Any] = {"engine": engine, "lag": 1.0}
    whole, row = OnlineSolver("joint", **options), Observation(t=0.0, position=(0.0, 0.0))
    stopped = OnlineSolver("joint", **options)
    for k in range(30):
        for one in (
            replace(row, t=k / 10, position=(0.1 * k, 0.0)),
            replace(row, t=k / 10, position=(0.1 * k, 0.1), position_std=0.05),
            replace(row, t=k / 10, position=(0.1 * k, 0.0)),
        ):
            expected, found = whole.update(one), stopped.update(one)
            assert found.status == expected.status
            np.testing.assert_allclose(found.position, expected.position, atol=1e-3)
            state = json.loads(json.dumps(stopped.state()))
            stopped = OnlineSolver.from_state(state, "joint", **options)
        assert expected.status == "duplicate"
    assert len(whole._parts) <= 12  # those of the window


def test_revised_detections_take_their_share_back() -> None:
    smoother, plain = OnlineSolver("position"), OnlineSolver("position")
    rows = [Observation(t=k / 10, position=(0.1 * k, 0.0)) for k in range(10)]
    for one in rows:
        smoother.update(one), plain.update(one)
    smoother.update(Observation(t=0.9 + 1e-9, position=(5.0, 5.0)))
    found = smoother.revise(0.9 + 1e-10, [Observation(t=1.0, position=(1.0, 0.0))])
    expected = plain.update(Observation(t=1.0, position=(1.0, 0.0)))
    np.testing.assert_allclose(found.position, expected.position, atol=1e-9)
    np.testing.assert_allclose(found.covariance, expected.covariance, atol=1e-9)


@pytest.mark.parametrize("engine", ["chain", "gtsam"])
def test_a_result_that_rounding_hides_is_a_failure_with_the_reason(engine) -> None:
    t = np.arange(50) * SAME_TIME * 1.01
    track = Track(1, np.arange(50), t, np.column_stack([t, t]), position_std=np.full(50, 1.0))
    (failed,) = gt.solve(track, model_of(1e-4), engine=engine)
    assert "rounding hides the observations: 0.000505 s between two frames" in failed.reason
    assert "acceleration_density = 0.0001" in failed.reason
    (fine,) = gt.solve(track, model_of(0.15), engine=engine)
    assert np.isfinite(fine.track.covariance[:, 0, 0]).all()


@pytest.mark.parametrize("engine", ENGINES)
def test_an_online_result_that_rounding_hides_is_a_failure_too(engine) -> None:
    smoother = OnlineSolver(model_of(1e-5), engine=engine)
    found = [
        smoother.update(Observation(t=k * SAME_TIME * 1.01, position=(0.0, 0.0), position_std=50.0))
        for k in range(3)
    ]
    assert [one.status for one in found] == ["new", "failed", "failed"]
    assert "lost by rounding" in found[1].reason or "no unique solution" in found[1].reason
    assert found[2].t == 0.0


def test_recorded_tracks_have_an_estimate_in_each_row_online_too() -> None:
    t, x, stds = two_sensors(1e-9, (0.1, 0.02))
    position = np.column_stack([x.ravel(), np.zeros(x.size)])
    track = Track(1, np.arange(x.size), t.ravel(), position, position_std=stds.ravel())
    found = gt.track_online(track, "position")
    expected = [OnlineSolver("position")]
    rows = [expected[0].update(one) for one in observations(track)]
    np.testing.assert_array_equal(found.position, [one.position for one in rows])
    assert len(found) == len(track)
