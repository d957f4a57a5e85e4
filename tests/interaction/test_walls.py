"""Estimates and forecasts of people in corridors stay within them: of tracks and of streams."""

import json
import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import shapely
from command import Done, run
from corridors import CORRIDOR, corridor_walkers, share_outside

import graphtrack as gt
from graphtrack.geometry.walkable import WalkableArea
from graphtrack.interaction.walls import with_walls
from graphtrack.model import Model
from graphtrack.model.observation import States
from graphtrack.model.terms.walls import WALL_INPUT, StaysInside


def outside(tracks):
    return share_outside(np.concatenate([track.position for track in tracks]))


def error(tracks, truth):
    return np.sqrt(
        np.mean([np.square(a.position - b.true_position).mean() for a, b in zip(tracks, truth, strict=True)])
    )


def test_smoothed_tracks_stay_inside_and_are_no_worse():
    truth = corridor_walkers(12, np.random.default_rng(3))
    plain = gt.smooth(truth, "position", engine="gtsam")
    walled = gt.smooth(truth, "position", engine="gtsam", walkable=CORRIDOR)
    assert outside(plain) > 0.002 and outside(walled) <= 0.001
    assert error(walled, truth) <= error(plain, truth)
    assert all(WALL_INPUT not in track.inputs for track in walled)


def test_tracks_far_from_walls_are_not_touched():
    truth = corridor_walkers(2, np.random.default_rng(0), 0.02)
    far = shapely.box(-50, -50, 50, 50)
    for plain, walled in zip(
        *(gt.smooth(truth, "position", walkable=area) for area in (None, far)), strict=True
    ):
        np.testing.assert_array_equal(plain.position, walled.position)
        np.testing.assert_array_equal(plain.covariance, walled.covariance)


@pytest.mark.slow
def test_tracked_online_fewer_estimates_are_outside():
    truth = corridor_walkers(4, np.random.default_rng(4))
    plain, walled = (
        gt.track_online(truth, "position", engine="fixed-lag", walkable=area) for area in (None, CORRIDOR)
    )
    assert outside(plain) > 0.02 and outside(walled) <= 0.001


def test_the_barrier_has_the_derivatives_of_its_cost():
    rng = np.random.default_rng(5)
    track = corridor_walkers(1, rng).tracks[0]
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


@pytest.mark.slow
def test_forecasts_cross_no_wall():
    truth = corridor_walkers(4, np.random.default_rng(6))  # near a wall some are observed outside
    assert outside(truth) > 0.002
    free = gt.forecast(truth, horizon=4.8)
    kept = gt.forecast(truth, horizon=4.8, samples=5, walkable=CORRIDOR)
    area = WalkableArea(CORRIDOR.buffer(1e-6))
    points = [np.column_stack([one.columns["x"], one.columns["y"]]) for one in (free, kept)]
    assert area.contains(points[0]).mean() < 0.9 and area.contains(points[1]).all()


@pytest.mark.slow
def test_the_compiled_engine_agrees_with_gtsam():
    truth = corridor_walkers(8, np.random.default_rng(7))
    for preset in ("position", "joint"):
        chain, graph = (
            gt.smooth(truth, preset, engine=engine, walkable=CORRIDOR, constants="default")
            for engine in ("chain", "gtsam")
        )
        for one, other in zip(chain, graph, strict=True):
            np.testing.assert_allclose(one.position, other.position, atol=2e-3)
        assert outside(chain) <= 0.001


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


Rows = list[dict[str, Any]]


def corridor_rows(people: int, seed: int, identities: bool = True, aside: float | None = None) -> Rows:
    walkers = corridor_walkers(people, np.random.default_rng(seed), aside=aside, apart=20)
    table = walkers.to_table()[["track_id", "frame", "t", "x", "y", "pos_std"]].round(3)
    return (
        table.sort_values(["frame", "track_id"])
        .drop(columns=[] if identities else "track_id")
        .to_dict("records")
    )


def outside_of(answers: Rows, least: int) -> float:
    position = np.array([[one["x"], one["y"]] for one in answers if one.get("x") is not None])
    assert len(position) > least
    return share_outside(position)


@pytest.fixture
def area(tmp_path: Path) -> Path:
    path = tmp_path / "corridor.wkt"
    path.write_text(CORRIDOR.wkt)
    return path


def track(rows: Rows, *options: object) -> tuple[Done, Rows]:
    given = ("--model", "position", "--engine", "fixed-lag", *options)
    done = run("track", "-", *given, program="graphtrack", rows=rows)
    return done, [json.loads(line) for line in done.stdout.splitlines()]


@pytest.mark.slow
def test_estimates_of_a_stream_stay_inside(area: Path) -> None:
    rows = corridor_rows(3, 4)
    _, plain = track(rows)
    done, walled = track(rows, "--walkable", area)
    assert done.returncode == 0 and len(walled) == len(plain) == len(rows) > 300
    assert outside_of(plain, 200) > 0.01 and outside_of(walled, 200) <= 0.001


@pytest.mark.slow
def test_tracked_detections_of_a_stream_stay_inside(area: Path) -> None:
    rows = corridor_rows(2, 5, identities=False, aside=0.15)
    _, plain = track(rows, "--lag", "1")
    _, walled = track(rows, "--lag", "1", "--walkable", area, "--forecast", "2")
    assert outside_of(plain, 200) > 0.01 and outside_of(walled, 200) == 0.0
    ahead = np.array([[at["x"], at["y"]] for one in walled if "forecast" in one for at in one["forecast"]])
    assert len(ahead) > 1000 and WalkableArea(CORRIDOR.buffer(1e-6)).contains(ahead).all()


def test_an_area_travels_to_other_processes() -> None:
    area = pickle.loads(pickle.dumps(WalkableArea(CORRIDOR)))
    position = np.random.default_rng(0).uniform(-1.0, 13.0, (50, 2))
    np.testing.assert_array_equal(area.walls(position), WalkableArea(CORRIDOR).walls(position))
    assert area.digest() == WalkableArea(CORRIDOR.reverse()).digest()
    assert area.digest() != WalkableArea(CORRIDOR.buffer(0.01)).digest()


@pytest.mark.parametrize("command", [["track", "-"], ["serve", "--port", "0"]])
def test_an_area_that_is_none_is_refused_before_any_row(command: list[str], tmp_path: Path) -> None:
    path = tmp_path / "line.wkt"
    path.write_text("LINESTRING (0 0, 1 1)")
    done = run(*command, "--walkable", path, program="graphtrack")
    assert done.returncode == 2 and "no polygon" in done.stderr
