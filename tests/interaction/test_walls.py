"""Estimates and forecasts of people in corridors stay within them."""

import numpy as np
import pytest
import shapely

import graphtrack as gt
from graphtrack.geometry.walkable import WalkableArea
from graphtrack.interaction.walls import with_walls
from graphtrack.model import Model
from graphtrack.model.observation import States
from graphtrack.model.terms.walls import WALL_INPUT, StaysInside

CORRIDOR = shapely.union_all([shapely.box(0, 0, 20, 2), shapely.box(18, 0, 20, 12)])
NOISE = 0.3


def walkers(count, rng, noise=NOISE):
    """People who walk round the corner of a corridor, some close to its walls."""
    found = []
    for k in range(count):
        aside = rng.uniform(0.12, 1.88)
        corners = np.array([[0.3, aside], [20.0 - aside, aside], [20.0 - aside, 11.7]])
        along = np.r_[0.0, np.cumsum(np.linalg.norm(np.diff(corners, axis=0), axis=1))]
        at = np.arange(0.0, along[-1], 0.26)
        path = np.column_stack([np.interp(at, along, corners[:, axis]) for axis in range(2)])
        observed = path + rng.normal(0.0, noise, path.shape)
        steps = np.arange(len(at))
        std = np.full(len(at), noise)
        found.append(gt.Track(k, steps, 0.2 * steps, observed, position_std=std, true_position=path))
    return gt.TrackSet(found)


def share_outside(tracks, tolerance=0.0):
    area = WalkableArea(CORRIDOR.buffer(tolerance) if tolerance else CORRIDOR)
    return 1.0 - area.contains(np.concatenate([track.position for track in tracks])).mean()


def error(tracks, truth):
    return np.sqrt(
        np.mean([np.square(a.position - b.true_position).mean() for a, b in zip(tracks, truth, strict=True)])
    )


def test_smoothed_tracks_stay_inside_and_are_no_worse():
    truth = walkers(12, np.random.default_rng(3))
    plain = gt.smooth(truth, "position", engine="gtsam")
    walled = gt.smooth(truth, "position", engine="gtsam", walkable=CORRIDOR)
    assert share_outside(plain) > 0.002 and share_outside(walled) <= 0.001
    assert error(walled, truth) <= error(plain, truth)
    assert all(WALL_INPUT not in track.inputs for track in walled)


def test_tracks_far_from_walls_are_not_touched():
    truth = walkers(2, np.random.default_rng(0), 0.02)
    far = shapely.box(-50, -50, 50, 50)
    for plain, walled in zip(
        *(gt.smooth(truth, "position", walkable=area) for area in (None, far)), strict=True
    ):
        np.testing.assert_array_equal(plain.position, walled.position)
        np.testing.assert_array_equal(plain.covariance, walled.covariance)


def test_tracked_online_fewer_estimates_are_outside():
    truth = walkers(6, np.random.default_rng(4))
    plain, walled = (
        gt.track_online(truth, "position", engine="fixed-lag", walkable=area) for area in (None, CORRIDOR)
    )
    assert share_outside(plain) > 0.02 and share_outside(walled) <= 0.001


def test_the_barrier_has_the_derivatives_of_its_cost():
    rng = np.random.default_rng(5)
    track = walkers(1, rng).tracks[0]
    track = with_walls(track, track.position, WalkableArea(CORRIDOR))
    term = StaysInside(Model("position").parameters)
    position = track.true_position + rng.normal(0.0, 0.4, track.true_position.shape)
    zero = np.zeros(len(track))

    def cost(at):
        return term.cost(States(at, np.zeros_like(at), zero, zero), track)

    assert cost(position) > 0.0
    factors = gt.solve(track, Model("position", terms=[StaysInside]), engine="gtsam")
    assert factors[0].converged
    found = factors[0].track.position
    for frame, axis in ((3, 0), (10, 1), (40, 0)):
        step = np.zeros_like(found)
        step[frame, axis] = 1e-6
        # At the minimum of all terms the barrier pushes as the others pull: its cost falls inwards.
        slope = (cost(found + step) - cost(found - step)) / 2e-6
        walls = track.inputs[WALL_INPUT][frame].reshape(-1, 3)
        depth = np.maximum(0.05 - (walls[:, :2] @ found[frame] - walls[:, 2]), 0.0)
        expected = -np.sum(np.where(walls[:, :2].any(axis=1), depth, 0.0) * walls[:, axis]) / 0.01**2
        assert slope == pytest.approx(expected, abs=1e-3)


def test_forecasts_cross_no_wall():
    truth = walkers(4, np.random.default_rng(6))  # near a wall some are observed outside
    assert share_outside(truth) > 0.002
    free = gt.forecast(truth, horizon=4.8)
    kept = gt.forecast(truth, horizon=4.8, samples=5, walkable=CORRIDOR)
    area = WalkableArea(CORRIDOR.buffer(1e-6))
    points = [np.column_stack([one.columns["x"], one.columns["y"]]) for one in (free, kept)]
    assert area.contains(points[0]).mean() < 0.9 and area.contains(points[1]).all()


@pytest.mark.slow
def test_the_compiled_engine_agrees_with_gtsam():
    truth = walkers(8, np.random.default_rng(7))
    for preset in ("position", "joint"):
        chain, graph = (
            gt.smooth(truth, preset, engine=engine, walkable=CORRIDOR, constants="default")
            for engine in ("chain", "gtsam")
        )
        for one, other in zip(chain, graph, strict=True):
            np.testing.assert_allclose(one.position, other.position, atol=2e-3)
        assert share_outside(chain) <= 0.001


def test_an_unobserved_person_is_not_predicted_through_a_wall():
    corridor = shapely.box(0, 0, 6, 2)
    plain, walled = (
        gt.OnlineSmoother("position", engine="fixed-lag", walkable=area) for area in (None, corridor)
    )
    observed = [gt.Observation(t=0.2 * k, position=(2.0 + 0.26 * k, 1.0)) for k in range(14)]
    unseen = [gt.Observation(t=2.8 + 0.2 * k) for k in range(8)]
    for smoother in (plain, walled):
        found = [smoother.update(one).position for one in (*observed, *unseen)]
        inside = WalkableArea(corridor).contains(np.array(found))
        assert inside[:14].all() and inside.all() == (smoother is walled)
    again = gt.OnlineSmoother.from_state(walled.state(), "position", engine="fixed-lag", walkable=corridor)
    here, there = (one.update(gt.Observation(t=4.6)).position for one in (walled, again))
    np.testing.assert_array_equal(here, there)
    with pytest.raises(gt.InputError, match="a state of a model with the terms"):
        gt.OnlineSmoother.from_state(walled.state(), "position", engine="fixed-lag")
