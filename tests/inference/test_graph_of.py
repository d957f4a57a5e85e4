"""A recording as one graph of GTSAM: what every engine minimises, and what other factors join."""

from __future__ import annotations

from dataclasses import replace

import gtsam
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from walks import walk

import graphtrack as gt
from graphtrack.errors import InputError, SolveError
from graphtrack.geometry.angles import FloatArray, difference
from graphtrack.smoothing import learn_constants


def people(count: int, seed: int = 0) -> list[gt.Track]:
    """Walks with gaps and groups, of which some have angles, some classes, and some positions alone."""
    rng, found = np.random.default_rng(seed), []
    for k in range(count):
        track = walk(30, seed=seed + k, uneven=k % 2 == 1, classes=k % 3 == 2, track_id=3 * k)
        if k % 3 == 1:
            track = replace(track, body=None, head=None, body_kappa=None, head_kappa=None)
        group = np.column_stack([rng.normal(0.0, 0.4, (30, 2)), rng.uniform(0.0, 1.0, 30)])
        track = replace(track, inputs={"group": group})
        found.append(track[np.sort(rng.permutation(30)[:24])])
    return found


def values_at(track: gt.Track) -> gtsam.Values:
    """The values of estimates, by `key_of`."""
    values = gtsam.Values()
    assert track.velocity is not None
    for k in range(len(track)):
        values.insert(gt.key_of("position", track.track_id, k), track.position[k])
        values.insert(gt.key_of("velocity", track.track_id, k), track.velocity[k])
        for name in ("body", "head"):
            angle = getattr(track, name)
            if angle is not None:
                values.insert(gt.key_of(name, track.track_id, k), gtsam.Rot2(angle[k]))
    return values


def stds(track: gt.Track) -> FloatArray:
    """1-σ (n, 6) of estimates."""
    assert track.covariance is not None
    return np.sqrt(np.einsum("nii->ni", track.covariance))


@pytest.mark.filterwarnings("ignore:not used by the model")
@pytest.mark.parametrize("count", [6, pytest.param(50, marks=pytest.mark.slow)])
@pytest.mark.parametrize("preset", list(gt.presets))
def test_its_error_is_the_cost_and_its_marginals_are_the_covariances(preset: str, count: int) -> None:
    model = gt.Model(preset)
    # Another basin would add to the covariances.
    options = gt.SolverOptions(basin_search=False)
    for track in people(count):
        (solution,) = gt.solve(track, model, engine="chain", constants="default", options=options)
        assert isinstance(solution, gt.Solution), solution
        graph, start = gt.graph_of(track, model)
        values = values_at(solution.track)
        assert set(values.keys()) == set(start.keys())
        assert graph.error(values) == pytest.approx(solution.cost, rel=1e-6)
        back = gt.tracks_of(values, track, model, marginals=gtsam.Marginals(graph, values))[0]
        np.testing.assert_allclose(back.position, solution.track.position, atol=1e-9)
        np.testing.assert_allclose(stds(back), stds(solution.track), rtol=0.01)


@pytest.mark.parametrize("preset", ["joint", "joint-intentional"])
def test_gtsam_finds_of_several_people_what_solve_finds_of_each(preset: str) -> None:
    tracks = gt.TrackSet(people(4)[:2] + people(4)[3:])
    graph, start = gt.graph_of(tracks, preset)
    parameters = gtsam.LevenbergMarquardtParams()
    parameters.setRelativeErrorTol(1e-12)
    parameters.setAbsoluteErrorTol(1e-12)
    found = gtsam.LevenbergMarquardtOptimizer(graph, start, parameters).optimize()
    solved = gt.solve(tracks, preset, constants="default")
    assert graph.error(found) == pytest.approx(sum(one.cost for one in solved), rel=1e-6)
    for back, one in zip(gt.tracks_of(found, tracks, preset), solved, strict=True):
        assert isinstance(one, gt.Solution) and back.covariance is not None
        np.testing.assert_allclose(back.position, one.track.position, atol=1e-4)
        np.testing.assert_allclose(difference(back.head, one.track.head), 0.0, atol=1e-3)
        assert np.isnan(back.covariance).all()


def test_rows_of_one_time_are_one_frame() -> None:
    track = walk(12, seed=3)
    rows = np.repeat(np.arange(12), 2)
    t = track.t[rows] + np.tile([0.0, 1e-6], 12)
    twice = gt.Track(1, np.arange(24), t, track.position[rows])
    graph, values = gt.graph_of(twice, "position")
    assert values.size() == 2 * 12
    found = gtsam.LevenbergMarquardtOptimizer(graph, values).optimize()
    back = gt.tracks_of(found, twice, "position")[0]
    assert len(back) == 24
    np.testing.assert_allclose(back.position, gt.smooth(twice, "position").position, atol=1e-6)


def test_constants_of_people_are_those_of_their_factors() -> None:
    tracks = gt.simulate("joint", n_tracks=3, n_steps=40, rng=np.random.default_rng(4))
    _, constants = learn_constants(tracks)
    models = gt.graph_of(tracks)[0], gt.graph_of(tracks, constants=constants)[0]
    start = gt.graph_of(tracks)[1]
    # A coupling that somebody does not have is no factor.
    assert models[0].size() >= models[1].size() and models[0].error(start) != models[1].error(start)
    assert len(gt.tracks_of(start, tracks, constants=constants)) == 3


@given(st.data())
def test_keys_never_collide(data: st.DataObject) -> None:
    names = st.tuples(
        st.sampled_from(["position", "velocity", "body", "head"]),
        st.integers(0, 2**24 - 1),
        st.integers(0, 2**32 - 1),
    )
    one, two = data.draw(names), data.draw(names)
    assert (gt.key_of(*one) == gt.key_of(*two)) == (one == two)
    symbol = gtsam.Symbol(gt.key_of(*one))
    assert (chr(symbol.chr()), symbol.index()) == (one[0][0].replace("p", "x"), one[1] * 2**32 + one[2])


def test_what_has_no_key_is_told() -> None:
    with pytest.raises(InputError, match="variable 'hat'"):
        gt.key_of("hat", 1, 0)
    with pytest.raises(InputError, match="row -1"):
        gt.key_of("head", 1, -1)
    with pytest.raises(InputError, match=r"track 16777216 .* renumber"):
        gt.graph_of(walk(5, track_id=2**24))
    with pytest.raises(SolveError, match="no variables"):
        gt.tracks_of(gtsam.Values(), walk(5))


def test_factors_of_others_join() -> None:
    """A robot sees a person whom nobody else observes well, and two people walk at a known distance."""
    a, b = walk(10, seed=1, track_id=1, noise=0.3), walk(10, seed=1, track_id=2, noise=0.3)
    tracks = gt.TrackSet([a, replace(b, position=b.position + np.array([0.0, 1.0]))])
    graph, values = gt.graph_of(tracks, "position")
    apart, robot = gtsam.noiseModel.Isotropic.Sigma(1, 0.02), gtsam.symbol("r", 0)
    for k in range(10):
        keys = gt.key_of("position", 1, k), gt.key_of("position", 2, k)
        graph.push_back(gtsam.RangeFactor2(*keys, 0.8, apart))
    graph.push_back(gtsam.PriorFactorPose2(robot, gtsam.Pose2(), gtsam.noiseModel.Isotropic.Sigma(3, 1e-3)))
    seen = a.position[4] + 0.2
    exact = gtsam.noiseModel.Isotropic.Sigma(2, 1e-2)
    bearing, away = gtsam.Rot2.fromAngle(np.arctan2(seen[1], seen[0])), float(np.hypot(*seen))
    graph.push_back(gtsam.BearingRangeFactor2D(robot, gt.key_of("position", 1, 4), bearing, away, exact))
    values.insert(robot, gtsam.Pose2())
    found = gtsam.LevenbergMarquardtOptimizer(graph, values).optimize()
    one, two = gt.tracks_of(found, tracks, "position")
    np.testing.assert_allclose(np.linalg.norm(one.position - two.position, axis=1), 0.8, atol=0.02)
    np.testing.assert_allclose(one.position[4], seen, atol=0.1)
