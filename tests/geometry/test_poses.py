"""Poses of moving sensors: interpolation, uncertainty, and observations in the world."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray, difference, unit, wrap
from graphtrack.geometry.poses import PosePath
from graphtrack.model.parameters import LikelihoodParameters
from graphtrack.tracks.moving import UNDECLARED, channels_in_world

angles = st.floats(-10.0, 10.0)
metres = st.floats(-50.0, 50.0)
SPREAD = np.array([[0.04, 0.01, 0.002], [0.01, 0.09, -0.003], [0.002, -0.003, 0.0009]])


def standing(x: float, y: float, yaw: float, covariance: FloatArray | None = None) -> PosePath:
    spread = None if covariance is None else np.tile(covariance, (3, 1, 1))
    return PosePath(np.arange(3.0), np.full(3, x), np.full(3, y), np.full(3, yaw), spread)


@given(x=metres, y=metres, yaw=angles, p=arrays(float, (4, 2), elements=metres), body=angles)
def test_rows_become_what_the_matrix_of_the_pose_makes_of_them(x, y, yaw, p, body):
    c, s = np.cos(yaw), np.sin(yaw)
    matrix = np.array([[c, -s, x], [s, c, y], [0.0, 0.0, 1.0]])
    given_ = {"position": p, "body": np.full(4, wrap(body)), "head": np.full(4, np.nan)}
    found = channels_in_world(given_, np.linspace(0.0, 2.0, 4), standing(x, y, yaw))
    expected = (matrix @ np.column_stack([p, np.ones(4)]).T).T[:, :2]
    np.testing.assert_allclose(found["position"], expected, atol=1e-9)
    np.testing.assert_allclose(difference(found["body"], body + yaw), 0.0, atol=1e-9)
    assert np.isnan(found["head"]).all()
    assert not {"position_std", "position_covariance"} & set(found)  # neither declared nor uncertain


@pytest.mark.parametrize("own", ["round", "ellipse", "undeclared"])
def test_covariances_are_those_of_drawn_poses_and_errors(own):
    rng, n = np.random.default_rng(3), 200_000
    p, ellipse = np.array([6.0, -3.0]), np.array([[0.05, 0.02], [0.02, 0.03]])
    noise = {"round": 0.2**2 * np.eye(2), "ellipse": ellipse, "undeclared": UNDECLARED[0] ** 2 * np.eye(2)}[
        own
    ]
    channels = {"position": p[None]}
    if own == "round":
        channels["position_std"] = np.array([0.2])
    elif own == "ellipse":
        channels["position_covariance"] = ellipse[None]
    found = channels_in_world(channels, np.array([1.0]), standing(1.0, 2.0, 2.5, SPREAD))
    drawn = rng.multivariate_normal([1.0, 2.0, 2.5], SPREAD, n)
    local = rng.multivariate_normal(p, noise, n)
    c, s = np.cos(drawn[:, 2]), np.sin(drawn[:, 2])
    world = (
        np.column_stack([c * local[:, 0] - s * local[:, 1], s * local[:, 0] + c * local[:, 1]]) + drawn[:, :2]
    )
    np.testing.assert_allclose(found["position_covariance"][0], np.cov(world.T), rtol=0.03, atol=2e-3)
    assert "position_std" not in found


def test_defaults_of_undeclared_noise_are_those_of_the_models():
    likelihood = LikelihoodParameters()
    assert (likelihood.position_std, likelihood.velocity_std) == UNDECLARED


def test_declared_noise_is_kept_as_it_is_where_the_pose_is_exact():
    channels = {"position": np.ones((1, 2)), "position_std": np.array([0.3])}
    found = channels_in_world(channels, np.array([1.0]), standing(1.0, 2.0, 0.5))
    assert found["position_std"] == 0.3 and "position_covariance" not in found


@given(yaw=angles, k=st.sampled_from([8, 12]), part=st.integers(0, 11))
def test_class_likelihoods_turn_with_the_sensor(yaw, k, part):
    """The direction of their first harmonic turns by yaw; a turn by whole classes moves them."""
    name = "body_likelihood" if k == 8 else "head_likelihood"
    heights = 1.0 + np.cos(2.0 * np.pi * np.arange(k) / k - 0.4)[None]
    found = channels_in_world({name: heights}, np.array([1.0]), standing(0.0, 0.0, yaw))[name]
    ring = np.exp(2j * np.pi * np.arange(k) / k)
    assert abs(difference(np.angle(found[0] @ ring), 0.4 + yaw)) < 0.02
    assert found.sum() == pytest.approx(heights.sum()) and (found >= 0.0).all()
    whole = 2.0 * np.pi * (part % k) / k
    found = channels_in_world({name: heights}, np.array([1.0]), standing(0.0, 0.0, whole))[name]
    np.testing.assert_allclose(found, np.roll(heights, part % k, axis=1), atol=1e-9)


def test_concentrations_shrink_by_the_variance_of_yaw():
    channels = {"body_axis": np.array([0.3, 0.3]), "body_axis_kappa": np.array([10.0, np.nan])}
    found = channels_in_world(channels, np.array([0.5, 1.0]), standing(0.0, 0.0, 0.0, SPREAD))
    assert found["body_axis_kappa"][0] == pytest.approx(1.0 / (0.1 + 0.0009))
    assert np.isnan(found["body_axis_kappa"][1])


@given(yaw=angles, turn=st.floats(-3.0, 3.0), w=st.floats(0.0, 1.0))
def test_yaw_is_interpolated_the_short_way(yaw, turn, w):
    path = PosePath(np.array([0.0, 2.0]), np.array([0.0, 4.0]), np.zeros(2), wrap([yaw, yaw + turn]))
    (pose,), _ = path.at(np.array([2.0 * w]))
    assert pose[0] == pytest.approx(4.0 * w) and abs(difference(pose[2], yaw + w * turn)) < 1e-9


def circle(t: FloatArray) -> FloatArray:
    return np.column_stack([np.sin(t), 1.0 - np.cos(t), t])


NOISE = np.array([0.03, 0.03, np.deg2rad(1.0)])


def driven(seed: int, correlation: float, rate: float = 12.5, seconds: float = 40.0) -> PosePath:
    """A robot that drives at 1 m/s and turns at 1 rad/s; errors of poses are first-order Markov."""
    rng, t = np.random.default_rng(seed), np.arange(0.0, seconds, 1.0 / rate)
    errors = rng.standard_normal((len(t), 3))
    for k in range(1, len(t)):
        errors[k] = correlation * errors[k - 1] + np.sqrt(1.0 - correlation**2) * errors[k]
    poses = circle(t) + errors * NOISE
    return PosePath(t, *poses.T, np.tile(np.diag(NOISE**2), (len(t), 1, 1)))


@pytest.mark.parametrize("correlation", [0.0, 0.95])
@pytest.mark.parametrize("at", ["poses", "between", "anywhere"])
def test_regions_of_a_turning_robots_rows_hold_what_they_should(correlation, at):
    inside, n = 0, 0
    for seed in range(20):
        path, rng = driven(seed, correlation), np.random.default_rng(100 + seed)
        t = (
            path.t[2:-2]
            + {"poses": 0.0, "between": 0.04, "anywhere": rng.uniform(0.0, 0.08, len(path) - 4)}[at]
        )
        world, pose = rng.uniform(-6.0, 6.0, (len(t), 2)), circle(t)
        apart, c, s = world - pose[:, :2], np.cos(pose[:, 2]), np.sin(pose[:, 2])
        local = np.column_stack([c * apart[:, 0] + s * apart[:, 1], c * apart[:, 1] - s * apart[:, 0]])
        local += 0.05 * rng.standard_normal(local.shape)
        channels = {"position": local, "position_std": np.full(len(t), 0.05)}
        found = channels_in_world(channels, t, path)
        error = found["position"] - world
        squares = np.einsum("ni,nij,nj->n", error, np.linalg.inv(found["position_covariance"]), error)
        inside, n = inside + int((squares < 5.991).sum()), n + len(t)
    assert 0.935 < inside / n < 0.965


def test_a_gap_between_poses_is_as_uncertain_as_the_turns_around_it():
    t = np.concatenate([np.arange(0.0, 5.0, 0.08), np.arange(6.0, 11.0, 0.08)])
    path = PosePath(t, *circle(t).T)
    middle = np.array([5.46])
    pose, covariance = path.at(middle)
    error = np.abs(pose - circle(middle))[0]
    deviation = np.sqrt(np.diagonal(covariance[0]))
    assert error[:2].max() > 0.05 and (error[:2] < 3.0 * deviation[:2]).all() and deviation[:2].max() < 0.3
    _, covariance = path.at(np.array([2.02]))
    assert np.sqrt(covariance[0, 0, 0]) < 2e-3


def test_velocities_are_those_in_the_world():
    """People stand still, so that their velocity relative to the robot is the negative of its own."""
    t = np.arange(0.0, 10.0, 0.08)
    path, at = PosePath(t, *circle(t).T), t[10:-10]
    pose = circle(at)
    c, s = np.cos(at), np.sin(at)

    def local(v):
        return np.column_stack([c * v[:, 0] + s * v[:, 1], c * v[:, 1] - s * v[:, 0]])

    position = local(np.array([5.0, 1.0]) - pose[:, :2])
    seen = local(-unit(at)) - np.column_stack([-position[:, 1], position[:, 0]])
    found = channels_in_world({"position": position, "observed_velocity": seen}, at, path)
    assert np.abs(found["observed_velocity"]).max() < 0.05  # 8 mm/s of the chord, and the turn at 6 m
    lone = channels_in_world({"observed_velocity": seen}, at, path)
    assert np.isnan(lone["observed_velocity"]).all()


@pytest.mark.slow
def test_covariances_of_velocities_are_those_of_drawn_paths():
    at, errors, declared = np.array([20.0]), [], []
    channels = {"position": np.array([[4.0, 2.0]]), "observed_velocity": np.array([[0.5, -1.0]])}
    channels |= {
        "position_std": np.array([0.05]),
        "observed_velocity_covariance": 0.1**2 * np.eye(2)[None],
    }
    rng = np.random.default_rng(8)
    for seed in range(400):
        drawn = dict(channels)
        drawn["position"] = channels["position"] + 0.05 * rng.standard_normal((1, 2))
        drawn["observed_velocity"] = channels["observed_velocity"] + 0.1 * rng.standard_normal((1, 2))
        found = channels_in_world(drawn, at, driven(seed, 0.0))
        errors.append(found["observed_velocity"][0])
        declared.append(found["observed_velocity_covariance"][0])
    scatter = np.cov(np.array(errors).T)
    np.testing.assert_allclose(np.mean(declared, axis=0).diagonal(), scatter.diagonal(), rtol=0.35)


def test_poses_are_extrapolated_by_one_usual_step_and_no_more():
    path = driven(0, 0.0)
    (_, before), (_, after) = path.at(path.t[-1:]), path.at(path.t[-1:] + 0.08)
    assert after[0, 0, 0] > 2.0 * before[0, 0, 0]
    assert np.linalg.eigvalsh(after).min() > 0.0
    with pytest.raises(InputError, match=r"found t = 40.02, expected a time from 0 to 39.92 s, with poses"):
        path.at(np.array([40.02]))
    assert path.covers(np.array([-0.08, -0.09])).tolist() == [True, False]


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"t": np.array([0.0, 1.0, 1.0])}, "t = 1 after t = 1"),
        ({"x": np.array([0.0, np.nan, 1.0])}, "x of poses"),
        ({"yaw": np.zeros(2)}, r"yaw of poses of shape \(2,\)"),
        ({"covariance": -np.tile(np.eye(3), (3, 1, 1))}, "covariance"),
        ({"t": np.zeros(1)}, "1 pose"),
    ],
)
def test_paths_that_are_none_are_refused(change, said):
    good = {"t": np.arange(3.0), "x": np.zeros(3), "y": np.zeros(3), "yaw": np.zeros(3)}
    with pytest.raises(InputError, match=said):
        PosePath(**(good | change))
