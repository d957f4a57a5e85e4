"""Errors of sensors are learned as the joint graph has them, with uncertainties that hold."""

import math
from dataclasses import replace
from typing import Any

import gtsam
import numpy as np
import pandas as pd
import pytest
from command import ran, run
from sensor_scenes import NO_ERRORS, misses

import graphtrack as gt
from graphtrack.io.sensors import SensorScene
from graphtrack.learning.alignment import aligned, joined, ways_of
from graphtrack.learning.sensors import _People, _Problem, learn_sensors
from graphtrack.model import Model
from graphtrack.simulation.crowd import crossing
from graphtrack.simulation.sensors import observe, square
from graphtrack.tracks.cells import rows_of_table
from graphtrack.tracks.sensor_errors import CLOCK, ERRORS, errors_of, with_errors
from graphtrack.tracks.sensors import corrected
from graphtrack.tracks.table import Rows
from graphtrack.tracks.track import TrackSet


def recording(
    seed: int, *, people: int = 10, seconds: float = 20.0, identities: Any = "true", count: int = 4
) -> tuple[pd.DataFrame, SensorScene]:
    """Rows of some of the square's cameras, with the identities of people, and what the cameras are."""
    rng = np.random.default_rng(seed)
    walking = crossing(rng, people=people, seconds=seconds, fps=10.0)
    scene = SensorScene(dict(list(square(rng).items())[:count]))
    seen = pd.DataFrame(observe(walking, scene, identities=identities, rng=rng).columns)
    true_id = pd.to_numeric(seen.true_id, errors="coerce")
    seen["input_true_id"] = true_id.fillna(-1.0)
    if identities == "true":
        seen = seen[true_id.notna()].assign(track_id=true_id[true_id.notna()].astype(int) + 1)
    return seen.drop(columns="true_id").reset_index(drop=True), scene


def rows_in_order(rows: Rows, sensors: SensorScene) -> Rows:
    """Rows in the order that they have once corrected."""
    times = corrected(rows, sensors).channels["t"]
    return rows.taken(np.lexsort((rows.sensor, times, rows.track_id)))


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1])
def test_errors_are_found_within_what_is_stated(seed) -> None:
    rows, scene = recording(seed)
    found = learn_sensors(rows, {"south-west": NO_ERRORS})
    errors, std = misses(found, scene)
    assert (np.abs(errors) < 4.0 * std).all()
    assert np.sqrt(np.mean((errors / std) ** 2)) < 1.6
    assert errors_of(found["south-west"]).tolist() == [0.0] * len(ERRORS)


@pytest.mark.slow
def test_the_joint_graph_has_the_same_optimum_and_uncertainty() -> None:
    rows, _ = recording(3, people=8, seconds=10.0, count=2)
    found = learn_sensors(rows, {"south-west": NO_ERRORS})
    tracks = gt.read(rows, sensors=found)
    tracks = tracks.with_tracks(one for one in tracks if len(one) > 40)
    constants = {one.track.track_id: one.constants for one in gt.solve(tracks)}
    graph, values = gt.graph_of(tracks, constants=constants, sensors=found)
    best = values
    for _ in range(8):  # Gauss and Newton's method: GTSAM's own copies all values for each callback
        best = best.retract(graph.linearize(best).optimize())
    key = gtsam.symbol("s", 1)
    sensor = found["south-east"]
    std = np.array([*sensor.shift_std, sensor.rotation_std, sensor.angle_bias_std, sensor.clock_offset_std])
    joint = np.sqrt(np.diag(gtsam.Marginals(graph, best).marginalCovariance(key)))
    off = (best.atVector(key) - errors_of(sensor)) / std
    assert np.abs(off[[0, 1, 2, 4]]).max() < 0.03 and abs(off[3]) < 0.4
    # Of angles the compiled engine has the exact curvature, GTSAM that of Gauss and Newton.
    np.testing.assert_allclose(joint[[0, 1, 2, 4]], std[[0, 1, 2, 4]], rtol=0.02)
    assert 0.5 < joint[3] / std[3] < 1.1
    solved = gt.tracks_of(best, tracks, constants=constants)
    for one, two in zip(solved, gt.smooth(tracks), strict=True):
        assert np.abs(one.position - two.position).max() < 0.02


def test_the_gradient_is_that_of_the_cost() -> None:
    rows, scene = recording(4, people=12, seconds=10.0, count=2)
    raw = rows_in_order(rows_of_table(rows), scene)
    sensor = np.array([list(scene).index(name) for name in raw.sensor.tolist()])
    people = len(np.unique(raw.track_id))
    personal = {
        "motion.acceleration_density": np.full(people, 0.1),
        "orientation.body_diffusion": np.full(people, 0.2),
        "orientation.head_diffusion": np.full(people, 0.2),
        "coupling.motion_body_kappa": np.full(people, 5.0),
        "coupling.head_body_kappa": np.full(people, 2.0),
    }
    start = {name: with_errors(one, errors_of(one)) for name, one in scene.items()}
    problem = _Problem(raw, sensor, _People(Model(), personal), start)

    def cost(change: np.ndarray) -> float:
        moved = {n: with_errors(s, errors_of(s) + change[k]) for k, (n, s) in enumerate(start.items())}
        tracks = TrackSet.from_rows(corrected(raw, moved))
        from graphtrack.inference.offline import solve_each

        return sum(one.cost for one in solve_each(tracks, Model(), "chain", personal=personal))

    found = problem.gradient(start, np.zeros((2, len(ERRORS))))
    for place in range(CLOCK):
        step = np.zeros((2, len(ERRORS)))
        step[1, place] = 1e-3
        numerical = (cost(step) - cost(-step)) / 2e-3
        assert found[1, place] == pytest.approx(numerical, rel=2e-3, abs=0.05), ERRORS[place]


@pytest.mark.slow
def test_noise_detection_and_false_detections_of_each_sensor_are_learned() -> None:
    rng = np.random.default_rng(6)
    walking = crossing(rng, people=10, seconds=15.0, fps=10.0)
    scene = dict(list(square(rng).items())[:2])
    scene["south-east"] = replace(
        scene["south-east"], detection_probability=0.6, false_density=3e-3, position_scale=1.5
    )
    rows = pd.DataFrame(observe(walking, scene, rng=rng, identities="true").columns).drop(columns="true_id")
    found = learn_sensors(rows, {"south-west": NO_ERRORS})
    for name, sensor in scene.items():
        one = found[name]
        # Somebody behind another person is missed too.
        assert -0.12 < one.detection_probability - sensor.detection_probability < 0.03
        assert 0.7 < one.false_density / sensor.false_density < 1.6
        assert abs(one.position_scale / (sensor.position_scale or 1.0) - 1.0) < 0.1
    # What is described is kept.
    given = replace(scene["south-east"], shift=None)
    kept = learn_sensors(rows, {"south-west": NO_ERRORS, "south-east": given})["south-east"]
    assert (kept.position_scale, kept.detection_probability, kept.false_density) == (1.5, 0.6, 3e-3)


@pytest.mark.slow
def test_sensors_with_identities_of_their_own_are_aligned_first() -> None:
    rows, scene = recording(5, people=15, identities="own")
    rows = rows[rows.input_true_id >= 0].reset_index(drop=True)
    found = learn_sensors(rows, {"south-west": NO_ERRORS}, identities="own")
    errors, std = misses(found, scene)
    assert (np.abs(errors) < 4.0 * std + 1e-3).all()


def test_alignment_finds_a_large_shift_and_a_clock_that_is_late() -> None:
    rng = np.random.default_rng(0)
    table = rows_of_table(gt.simulate("joint", n_tracks=12, n_steps=150, rng=rng, missing=0.0).to_table())
    ways = ways_of(table)
    errors = np.array([1.1, -0.7, 0.05, 0.0, 0.35])
    pivot = ways.position.mean(axis=0)
    turn = np.array([[math.cos(0.05), -math.sin(0.05)], [math.sin(0.05), math.cos(0.05)]])
    other = ways._replace(
        t=ways.t + errors[4], position=pivot + (ways.position - pivot) @ turn.T + errors[:2]
    )
    free = np.array([True, True, True, False, True])
    found, _ = aligned(other, joined([ways]), np.zeros(5), free, pivot)
    np.testing.assert_allclose(found, errors, atol=0.05)
    back = other.moved(errors, pivot)
    np.testing.assert_allclose(back.position, ways.position, atol=1e-9)
    np.testing.assert_allclose(back.t, ways.t, atol=1e-12)


def test_what_cannot_be_learned_is_refused() -> None:
    rows, _ = recording(6, people=4, seconds=5.0, count=2)
    with pytest.raises(gt.InputError, match="rows of one sensor"):
        learn_sensors(rows[rows.sensor == "south-west"])
    apart = rows.assign(track_id=rows.track_id + 1000 * (rows.sensor == "south-east"))
    with pytest.raises(gt.InputError, match="no person whom two sensors observe"):
        learn_sensors(apart)


@pytest.mark.slow
def test_known_errors_stay_as_they_are() -> None:
    rows, scene = recording(7, people=5, seconds=10.0, count=2)
    known = replace(scene["south-east"], rotation=None, clock_offset=None)
    found = learn_sensors(rows, {"south-west": NO_ERRORS, "south-east": known})
    assert found["south-east"].shift == scene["south-east"].shift
    assert found["south-east"].shift_std is None and found["south-east"].clock_offset_std is not None
    assert found["south-east"].clock_offset == pytest.approx(scene["south-east"].clock_offset, abs=0.05)


@pytest.mark.slow
def test_the_command_learns_and_smooth_uses_it(tmp_path) -> None:
    rows, scene = recording(8, people=6, seconds=10.0, count=2)
    path, learned, both = tmp_path / "rows.csv", tmp_path / "learned.toml", tmp_path / "both.toml"
    rows.to_csv(path, index=False)
    SensorScene({"south-west": NO_ERRORS}).save(tmp_path / "known.toml")
    known = tmp_path / "known.toml"
    said = ran("fit", path, "--sensors", known, "-o", learned, program="graphtrack")
    assert "±" in said.stdout and "graphtrack smooth" in said.stderr
    found = SensorScene.load(learned)
    errors, std = misses(found, scene)
    assert (np.abs(errors) < 4.0 * std).all()
    for name, options in (
        ("a.csv", ["--sensors", learned]),
        ("b.csv", ["--sensors", known, "--learn-sensors", both]),
    ):
        ran("smooth", path, "-o", tmp_path / name, *options, program="graphtrack")
    one, two = (pd.read_csv(tmp_path / name) for name in ("a.csv", "b.csv"))
    np.testing.assert_allclose(one[["x", "y"]], two[["x", "y"]])
    assert np.hypot(one.x - one.true_x, one.y - one.true_y).mean() < 0.1
    failed = run("fit", path, "--sensors", "unknown", "--scene", "-o", learned, program="graphtrack")
    assert failed.returncode == 2 and "--scene" in failed.stderr
