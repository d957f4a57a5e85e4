"""Rows of one person at one time, or nearly: both count, in every engine."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from selection import others_slow

import graphtrack as gt
from graphtrack import Observation, Track
from graphtrack.geometry.camera import GroundCamera
from graphtrack.inference.online import OnlineSolver
from graphtrack.model import Model, Parameters
from graphtrack.model.observation import observations
from graphtrack.model.parameters import LikelihoodParameters
from graphtrack.model.same_time import APART as SOON
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


NOISES = [(density, std) for density in (0.01, 0.15, 10.0) for std in ((0.005, 0.02), (0.1, 0.1), (1.0, 0.3))]


@pytest.mark.parametrize(("density", "std"), others_slow(NOISES, NOISES[::4]))
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


@pytest.mark.parametrize(
    ("engine", "sign", "first"),
    others_slow(
        [(engine, sign, first) for engine in ENGINES for sign in (1.0, -1.0) for first in (0.0, 1.7e9)],
        [("chain", 1.0, 0.0), ("chain", -1.0, 1.7e9), ("fixed-lag", -1.0, 1.7e9), ("isam2", 1.0, 1.7e9)],
    ),
)
def test_a_second_sensor_online_equals_the_kalman_filter(engine, sign, first) -> None:
    density, std = 0.15, (0.1, 0.02)
    for apart in APART:
        t, x, stds = two_sensors(sign * apart, std, n=15, first=first)
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


RATES = [
    (hertz, *noise)
    for hertz in (200, 1000)
    for noise in ((0.01, 0.15), (0.1, 0.15), (1.0, 0.15), (0.1, 0.01))
]


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize(("hertz", "std", "density"), others_slow(RATES, [RATES[3], RATES[4], RATES[6]]))
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
@settings(max_examples=25)
def test_angles_of_one_time_are_multiplied(given_angles) -> None:
    parts = [Observation(t=0.0, head=angle, head_kappa=kappa) for angle, kappa in given_angles]
    one, grid = merged(parts, LIKELIHOOD, None), np.linspace(-np.pi, np.pi, 17)
    expected = sum(kappa * np.cos(grid - angle) for angle, kappa in given_angles)
    np.testing.assert_allclose(one.head_kappa * np.cos(grid - one.head), expected, atol=1e-9)


@given(st.lists(st.tuples(st.floats(-50, 50), st.floats(1e-3, 10.0)), min_size=2, max_size=4))
@settings(max_examples=25)
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


def test_gross_errors_have_no_product_with_what_they_contradict() -> None:
    robust = replace(LIKELIHOOD, robust="cauchy")
    parts = [Observation(t=0.0, position=(x, 0.0), position_std=0.1) for x in (0.0, 0.05, 7.0)]
    assert merged(parts[:2], robust, None).position == pytest.approx((0.025, 0.0))
    assert merged(parts, robust, None) is None and merged(parts, LIKELIHOOD, None) is not None
    t, x = np.array([0.0, 0.1, 0.1, 0.1, 0.2, 0.3]), np.array([0.0, 0.1, 0.15, 7.0, 0.2, 0.3])
    track = Track(1, np.arange(6), t, np.column_stack([x, 0.0 * x]), sensor=np.array(list("aabcaa")))
    model = Model("position").with_parameters(Parameters(likelihood=robust))
    found = gt.smooth(track, model)
    assert np.abs(found.position[1:4] - [0.11, 0.0]).max() < 0.06


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


@pytest.mark.parametrize("both", CONTRADICT.values(), ids=list(CONTRADICT))
def test_what_has_no_product_is_an_observation_soon_after(both) -> None:
    rows = [Observation(t=0.1 * k, position=(0.1 * k, 0.0)) for k in range(5)]
    first, second = (Observation(t=0.5, **one) for one in both)
    found = []
    for apart in (0.0, 1e-9, SOON):
        smoother = OnlineSolver("joint", camera=CAMERA)
        for one in (*rows, first):
            smoother.update(one)
        found.append(smoother.update(replace(second, t=0.5 + apart)))
        assert found[-1].status == "new"
        # A further one of that time is late.
        assert smoother.update(Observation(t=0.5, body=0.3, body_kappa=5.0)).status in ("late", "new")
    for one in found[:2]:
        np.testing.assert_allclose(one.position, found[2].position, atol=1e-6)
        np.testing.assert_allclose(one.covariance, found[2].covariance, atol=1e-6)


@pytest.mark.parametrize("engine", ["chain", "gtsam"])
def test_rows_whose_inputs_contradict_each_other_are_both_used(engine) -> None:
    t = np.array([0.0, 0.1, 0.1 + 1e-9, 0.1 + 2e-9, 0.2])
    position, frame = np.column_stack([t, t]), np.arange(5)
    position[3] = 0.5
    inputs = {"distance": np.array([1.0, 2.0, 3.0, 4.0, 5.0])}
    found = gt.smooth(Track(1, frame, t, position, inputs=inputs), "position", engine=engine)
    apart = np.array([0.0, 0.1, 0.1 + SOON, 0.1 + 2.0 * SOON, 0.2])
    expected = gt.smooth(Track(1, frame, apart, position, inputs=inputs), "position", engine=engine)
    np.testing.assert_allclose(found.position, expected.position, atol=1e-9)


@pytest.mark.slow
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


# -- sensors with names --------------------------------------------------------------------------------------

OF_TWO = np.random.default_rng(5)
TIMES = np.arange(25) / 10.0
WAY = np.column_stack([1.2 * TIMES, 0.3 * np.sin(TIMES)])
SHAPE = np.array([[0.04, 0.015], [0.015, 0.01]])
FIRST = WAY + 0.1 * OF_TWO.standard_normal(WAY.shape)
SECOND = WAY + OF_TWO.multivariate_normal([0.0, 0.0], SHAPE, len(WAY))
HEADS = 0.3 * np.cos(TIMES)


def both_at(k: int) -> tuple[Observation, Observation]:
    """The observations of a laser with an ellipse and of a camera at one time."""
    return (
        Observation(t=TIMES[k], position=tuple(FIRST[k]), position_std=0.1, head=HEADS[k], sensor="camera"),
        Observation(
            t=TIMES[k],
            position=tuple(SECOND[k]),
            position_covariance=tuple(map(tuple, SHAPE)),
            observed_velocity=(1.2, 0.3),
            body_axis=0.2,
            sensor="laser",
        ),
    )


def one_at(k: int) -> Observation:
    """One observation with the information of both, by the formula of two Gaussians."""
    camera, laser = both_at(k)
    information = [np.eye(2) / 0.1**2, np.linalg.inv(SHAPE)]
    covariance = np.linalg.inv(sum(information))
    mean = covariance @ (information[0] @ FIRST[k] + information[1] @ SECOND[k])
    return replace(laser, position=tuple(mean), position_covariance=covariance, head=camera.head, sensor="")


def track_of(rows: list[Observation], sensor: Any = None) -> Track:
    channels = {
        name: np.array(
            [np.full(np.shape(size), np.nan) if (v := getattr(one, name)) is None else v for one in rows]
        )
        for name, size in {
            "position": (0.0, 0.0),
            "position_std": 0.0,
            "position_covariance": np.eye(2),
            "observed_velocity": (0.0, 0.0),
            "body_axis": 0.0,
            "head": 0.0,
        }.items()
    }
    return Track(1, np.arange(len(rows)), np.array([one.t for one in rows]), sensor=sensor, **channels)


OPTIONS: list[dict[str, str]] = [{}, {"constants": "default"}, {"model": "position"}]


@pytest.mark.slow
@pytest.mark.parametrize("options", OPTIONS, ids=str)
@pytest.mark.parametrize("engine", ["chain", "gtsam"])
def test_two_sensors_at_one_time_smooth_as_one(engine, options) -> None:
    rows = [one for k in range(len(TIMES)) for one in both_at(k)]
    sensors = np.array([one.sensor for one in rows])
    found = gt.smooth(track_of(rows, sensors), engine=engine, **options)
    expected = gt.smooth(track_of([one_at(k) for k in range(len(TIMES))]), engine=engine, **options)
    assert found.sensor.tolist() == sensors.tolist()
    for row in (0, 1):
        np.testing.assert_allclose(found.position[row::2], expected.position, atol=1e-9)
        np.testing.assert_allclose(found.covariance[row::2], expected.covariance, atol=1e-9)
    if "model" not in options:
        np.testing.assert_allclose(np.cos(found.body[::2] - expected.body), 1.0, atol=1e-9)


WITH = [(engine, options) for options in OPTIONS for engine in ENGINES]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("engine", "options"),
    others_slow(
        WITH, [("chain", {}), ("fixed-lag", {"constants": "default"}), ("isam2", {"model": "position"})]
    ),
)
def test_two_sensors_at_one_time_online_are_one_in_either_order(engine, options) -> None:
    if engine == "isam2":
        # It linearises a step that changes again: equal within its thresholds, which are small here.
        options = options | {"relinearize_threshold": 1e-6, "step_tolerance": 1e-9}
    one, two, other = (gt.OnlineSmoother(engine=engine, **options) for _ in range(3))
    for k in range(len(TIMES)):
        expected = one.update(one_at(k))
        for smoother, order in ((two, both_at(k)), (other, both_at(k)[::-1])):
            found = [smoother.update(part) for part in order]
            assert [part.status for part in found] == ["new", "late"]
            tolerance = 1e-9 if engine != "isam2" or options.get("model") else 1e-5
            np.testing.assert_allclose(found[1].position, expected.position, atol=tolerance)
            np.testing.assert_allclose(found[1].covariance, expected.covariance, atol=tolerance)
            assert smoother.update(order[0]).status == "duplicate"


@pytest.mark.parametrize("engine", ENGINES)
def test_a_sensor_counts_once_at_a_time(engine) -> None:
    smoother = gt.OnlineSmoother(engine=engine)
    for k in range(5):
        smoother.update(Observation(t=k / 10, position=(0.1 * k, 0.0), sensor="a"))
    before = smoother.last
    found = smoother.update(Observation(t=0.4, position=(9.0, 9.0), sensor="a"))
    assert found.status == "duplicate"
    np.testing.assert_array_equal(found.position, before.position)
    assert smoother.update(Observation(t=0.4, position=(0.4, 0.0), sensor="b")).status == "late"
    assert smoother.update(Observation(t=0.4, head=0.1, sensor="a")).status == "late"


@pytest.mark.slow
def test_a_smoother_saved_between_two_sensors_goes_on_to_the_same_bits() -> None:
    whole = gt.OnlineSmoother()
    stopped = gt.OnlineSmoother()
    for k in range(12):
        for part in both_at(k):
            expected, found = whole.update(part), stopped.update(part)
            np.testing.assert_array_equal(found.position, expected.position)
            np.testing.assert_array_equal(found.covariance, expected.covariance)
            stopped = gt.OnlineSmoother.from_state(json.loads(json.dumps(stopped.state())))


def test_an_ellipse_a_velocity_and_an_axis_move_the_estimate_as_they_should() -> None:
    one = Observation(t=0.0, position=(0.0, 0.0), position_covariance=((1.0, 0.0), (0.0, 1e-4)))
    smoother = OnlineSolver("joint")
    smoother.update(one)
    found = smoother.update(replace(one, t=0.0, position=(2.0, 0.02), sensor="b"))
    np.testing.assert_allclose(found.position, [1.0, 0.01], atol=1e-6)
    assert found.covariance[0, 0] == pytest.approx(0.5, rel=1e-3)
    assert found.covariance[1, 1] == pytest.approx(5e-5, rel=1e-3)
    moving = OnlineSolver("joint").update(
        Observation(t=0.0, position=(0.0, 0.0), observed_velocity=(3.0, 0.0), body_axis=0.1 + np.pi)
    )
    assert moving.velocity[0] == pytest.approx(3.0 / (1.0 + (0.3 / 1.5) ** 2), rel=0.02)
    # The way tells which end is the front.
    assert abs(moving.body - 0.1) < 0.1


def test_an_axis_alone_has_two_ends() -> None:
    axis = Observation(t=0.0, position=(0.0, 0.0), body_axis=0.5, body_axis_kappa=50.0)
    for turn in (0.0, np.pi):
        smoother = OnlineSolver("joint")
        smoother.update(replace(axis, head=0.5 + turn, head_kappa=10.0))
        found = smoother.update(replace(axis, t=0.1, head=0.5 + turn, head_kappa=10.0))
        assert np.cos(found.body - (0.5 + turn)) > 0.99


def test_a_covariance_must_be_positive_definite() -> None:
    for wrong in (np.ones((2, 2)), [[1.0, 0.0]], np.diag([1.0, -1.0]), [[1.0, 0.3], [0.2, 1.0]]):
        with pytest.raises(gt.InputError, match="position_covariance"):
            OnlineSolver("position").update(
                Observation(t=0.0, position=(0.0, 0.0), position_covariance=wrong)
            )
