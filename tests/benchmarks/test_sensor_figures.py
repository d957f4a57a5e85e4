"""Figures of several sensors: errors, coverage, learned errors and identities, with seeds.

``pytest tests/benchmarks/test_sensor_figures.py -m benchmark -s`` prints them. GRAPHTRACK_SENSOR_SCENES is
the number of scenes of the square (3), GRAPHTRACK_SENSOR_SECONDS their length (15), and
GRAPHTRACK_RECORDING_SECONDS that of the recordings (30). GRAPHTRACK_DATA is the folder of recordings.
"""

import json
import math
import os
import time
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from sensor_scenes import (
    NO_ERRORS,
    Split,
    anonymous,
    coverage_of,
    error_of,
    error_of_people,
    hand_over,
    hermes,
    identified,
    idf1_of,
    kept,
    misses,
    on_robot,
    table_of,
    town_centre,
)

import graphtrack as gt
from graphtrack.simulation.crowd import crossing
from graphtrack.simulation.sensors import SimulatedRows, observe, square
from graphtrack.streaming.answers import Scenes
from graphtrack.streaming.moving import MovingSensors
from graphtrack.tracks.sensors import SimulatedSensor

pytestmark = pytest.mark.benchmark

SCENES = int(os.environ.get("GRAPHTRACK_SENSOR_SCENES", "3"))
SECONDS = float(os.environ.get("GRAPHTRACK_SENSOR_SECONDS", "15"))
RECORDED = float(os.environ.get("GRAPHTRACK_RECORDING_SECONDS", "30"))

LEARNED = ("shift x (m)", "shift y (m)", "rotation (rad)", "angle bias (rad)", "clock (s)")


# -- one sensor ----------------------------------------------------------------------------------------------


def test_one_sensor_needs_nothing() -> None:
    """A column with one name changes neither estimates nor identities."""
    people = crossing(np.random.default_rng(1), people=6, seconds=10.0, fps=10.0)
    sensor = gt.Sensor(position_std=0.1, detection_probability=0.9, simulation=SimulatedSensor())
    rows = table_of(observe(people, {"camera": sensor}, rng=np.random.default_rng(2)))
    for table, find in ((identified(rows), gt.smooth), (anonymous(rows), gt.associate)):
        one, other = find(table), find(table.drop(columns="sensor"))
        assert [track.track_id for track in one] == [track.track_id for track in other]
        for track, same in zip(one, other, strict=True):
            np.testing.assert_array_equal(track.inputs["row"], same.inputs["row"])
            np.testing.assert_allclose(track.position, same.position, atol=1e-12)


# -- ellipses ------------------------------------------------------------------------------------------------

RAY, ACROSS = 0.5, 0.05
MEAN_STD = math.sqrt(0.5 * (RAY**2 + ACROSS**2))


def rows_with_ellipses(people: gt.TrackSet, rng: np.random.Generator) -> pd.DataFrame:
    """Return rows of two cameras that look at people at right angles."""
    simulated = SimulatedSensor(ray_std=RAY, across_std=ACROSS, occlusion_radius=0.0)
    west = gt.Sensor(at=(-15.0, 0.0), detection_probability=0.9, simulation=simulated)
    south = replace(west, at=(0.0, -15.0), simulation=replace(simulated, phase=0.05))
    return identified(table_of(observe(people, {"west": west, "south": south}, rng=rng)))


@pytest.mark.parametrize("people", ["model", "crowd"])
def test_declared_ellipses_reduce_errors_and_cover(people: str) -> None:
    """Coverage is a property of people who move as the model has it; that of a crowd is printed."""
    found = []
    for seed in range(3):
        rng = np.random.default_rng(seed)
        if people == "model":
            walking = gt.simulate("position", n_tracks=20, n_steps=120, rng=rng)
        else:
            walking = crossing(rng, people=16, seconds=40.0, fps=10.0, side=12.0)
        rows = rows_with_ellipses(walking, rng)
        ellipses = ["observed_x_std", "observed_y_std", "observed_xy_corr"]
        circles = rows.drop(columns=ellipses).assign(pos_std=MEAN_STD)
        figures = []
        for estimate in (gt.smooth, gt.track_online):
            one, other = estimate(rows), estimate(circles)
            figures += [error_of(one), error_of(one) / error_of(other), coverage_of(one)]
        found.append(figures)
        print(
            "\nellipses, {}, seed {}: offline {:.3f} m, {:.2f} of that with circles, {:.3f} within 95 %; "
            "online {:.3f} m, {:.2f}, {:.3f}".format(people, seed, *figures)
        )
    _, offline, covered, _, online, covered_online = np.mean(found, axis=0)
    assert max(offline, online) <= 0.75
    if people == "model":
        assert 0.93 <= covered <= 0.97 and 0.93 <= covered_online <= 0.97


# -- four cameras --------------------------------------------------------------------------------------------


@cache
def scene_of_square(seed: int) -> tuple[gt.TrackSet, gt.SensorScene, SimulatedRows]:
    """Return people, cameras with a false detection in ten scans, and their rows."""
    rng = np.random.default_rng(seed)
    people = crossing(rng, people=20, seconds=SECONDS, fps=10.0)
    cameras = {}
    for name, one in square(rng).items():
        area = 0.5 * (one.sector[1] - one.sector[0]) * one.range**2
        cameras[name] = replace(one, false_density=0.1 / area)
    scene = gt.SensorScene(cameras)
    return people, scene, observe(people, scene, rng=rng)


def report_of_learned(name: str, errors: list[np.ndarray], stds: list[np.ndarray]) -> np.ndarray:
    """Print the errors of learned errors; return their root mean squares."""
    error, std = np.concatenate(errors), np.concatenate(stds)
    size = np.sqrt(np.mean(error**2, axis=0))
    inside = np.abs(error) < 1.96 * std
    for column, text in enumerate(LEARNED):
        largest = np.abs(error[:, column]).max()
        print(
            f"{name}: {text} {size[column]:.4f} rms, {largest:.4f} largest, "
            f"{inside[:, column].mean():.2f} of {len(error)} within 95 %"
        )
    print(f"{name}: {inside.mean():.3f} of {inside.size} within their 95 % intervals")
    return size


def assert_learned(size: np.ndarray) -> None:
    assert math.hypot(size[0], size[1]) <= 0.03
    assert math.degrees(size[2]) <= 0.2
    assert size[4] <= 0.020


def test_errors_of_four_cameras_are_learned_from_known_people() -> None:
    ratios, errors, stds = [], [], []
    for seed in range(SCENES):
        _, scene, simulated = scene_of_square(seed)
        rows = identified(table_of(simulated))
        found = gt.learn_sensors(rows, {"south-west": NO_ERRORS})
        known = error_of(gt.smooth(rows, sensors=scene))
        ratios.append(error_of(gt.smooth(rows, sensors=found)) / known)
        error, std = misses(found, scene)
        errors.append(error)
        stds.append(std)
        print(f"\nsquare, seed {seed}: {known:.4f} m with all known, {ratios[-1]:.3f} of that with learned")
    size = report_of_learned("square, known people", errors, stds)
    assert np.mean(ratios) <= 1.1
    assert_learned(size)


def test_people_of_four_cameras_are_associated_and_errors_learned() -> None:
    ratios, scores, errors, stds = [], [], [], []
    for seed in range(SCENES):
        people, scene, simulated = scene_of_square(seed)
        rows = table_of(simulated)
        found = gt.learn_sensors(anonymous(rows), {"south-west": NO_ERRORS})
        tracks = gt.associate(anonymous(rows), sensors=found)
        known = gt.smooth(identified(rows), sensors=scene, resample=10.0)
        ratios.append(error_of_people(gt.smooth(tracks, resample=10.0), simulated.truth))
        ratios[-1] /= error_of_people(known, simulated.truth)
        # The identities of each camera's own tracker.
        own = table_of(observe(people, scene, identities="own", rng=np.random.default_rng(1000 + seed)))
        own = own[own.input_true_id >= 0]
        of_trackers = gt.read(own, sensors=scene, associate="repair")
        scores.append((idf1_of(tracks, rows), idf1_of(of_trackers, own)))
        error, std = misses(found, scene)
        errors.append(error)
        stds.append(std)
        print(
            f"\nsquare, seed {seed}: {ratios[-1]:.3f} of the error with all known; IDF1 {scores[-1][0]:.3f}, "
            f"{scores[-1][1]:.3f} with the identities of each camera"
        )
    size = report_of_learned("square, associated", errors, stds)
    mean = np.mean(scores, axis=0)
    assert np.mean(ratios) <= 1.1
    assert mean[0] / mean[1] >= 0.98
    assert_learned(size)


# -- views that do not overlap -------------------------------------------------------------------------------


@pytest.mark.parametrize("appearance", [True, False], ids=["appearance", "positions"])
@pytest.mark.parametrize("a_minute", [16, 40])
def test_identities_are_kept_between_views_8_m_apart(a_minute: int, appearance: bool) -> None:
    shares = []
    for seed in range(3):
        rows = hand_over(seed, people=16, a_minute=a_minute, gap=8.0)
        if not appearance:
            rows = rows.loc[:, ~rows.columns.str.startswith("appearance_")]
        shares.append(kept(gt.associate(anonymous(rows))))
        print(f"\n{a_minute} people a minute, appearance {appearance}, seed {seed}: {shares[-1]:.2f} kept")
    assert np.mean(shares) >= 0.85


# -- recordings ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("recording", [hermes, town_centre])
def test_a_recording_split_into_two_sensors(recording, data_dir: Path) -> None:
    split = Split.of(recording(data_dir, RECORDED), np.random.default_rng(0))
    found = gt.learn_sensors(anonymous(split.rows), {"first": NO_ERRORS})
    error, std = misses(found, split.scene)
    tracks = gt.associate(anonymous(split.rows), sensors=found)
    scores = idf1_of(tracks, split.rows), idf1_of(gt.associate(anonymous(split.single)), split.single)
    shift, turn, clock = float(np.hypot(*error[0, :2])), abs(math.degrees(error[0, 2])), abs(error[0, 4])
    print(
        f"\n{recording.__name__}: {len(split.rows)} rows; shift off by {shift:.3f} m, rotation {turn:.2f}°, "
        f"clock {1000 * clock:.0f} ms, over 1-σ {np.round(error / std, 1)[0, [0, 1, 2, 4]]}; "
        f"IDF1 {scores[0]:.3f}, of one sensor {scores[1]:.3f}"
    )
    assert shift <= 0.05 and turn <= 0.5 and clock <= 0.040
    assert scores[0] / scores[1] >= 0.98


# -- a robot -------------------------------------------------------------------------------------------------


def test_lasers_of_a_robot_that_turns(tmp_path: Path) -> None:
    covered, scores = [], []
    for seed in range(3):
        simulated = on_robot(seed)
        rows, poses = table_of(simulated), tmp_path / f"{seed}.csv"
        pd.DataFrame(simulated.poses).to_csv(poses, index=False)
        smoothed = gt.smooth(identified(rows), poses=poses)
        covered.append(coverage_of(smoothed))
        scores.append(idf1_of(gt.associate(anonymous(rows), poses=poses), rows))
        print(
            f"\nrobot, seed {seed}: {len(rows)} rows, {error_of(smoothed):.3f} m, {covered[-1]:.3f} "
            f"within 95 %, IDF1 {scores[-1]:.3f}"
        )
    assert 0.93 <= np.mean(covered) <= 0.97
    assert np.mean(scores) >= 0.97


def milliseconds_of_a_scan(simulated: SimulatedRows) -> tuple[float, int]:
    """Return the processor time of a scan in a stream, and the number of scans."""
    columns = ["t", "sensor", "frame", "x", "y", "pos_std"]
    lines = pd.DataFrame(simulated.columns)[columns].to_dict("records")
    scans = len({(one["t"], one["sensor"]) for one in lines})
    if simulated.poses is not None:
        lines += pd.DataFrame(simulated.poses).assign(pose=True).to_dict("records")
    lines.sort(key=lambda one: (one["t"], "frame" in one))  # a pose before the rows of its time
    given = [json.dumps(one).encode() for one in lines]
    scene = Scenes(lambda: gt.OnlineTracker("joint"), None, lambda text: None, moving=MovingSensors(1.0))
    start = time.process_time()
    answers = [one for number, line in enumerate(given, 1) for one in scene.answers(number, line)]
    answers += scene.finish()
    spent = 1000.0 * (time.process_time() - start)
    assert not [one for one in answers if "error" in one]
    return spent / scans, scans


def test_an_online_step_of_moving_lasers_takes_little_longer() -> None:
    milliseconds_of_a_scan(on_robot(0, seconds=2.0))  # compiles
    ratios = []
    for seed in range(3):
        moving, scans = milliseconds_of_a_scan(on_robot(seed))
        fixed, fixed_scans = milliseconds_of_a_scan(on_robot(seed, moves=False))
        ratios.append(moving / fixed)
        print(
            f"\nonline, seed {seed}: {moving:.2f} ms a scan of two moving lasers ({scans}), {fixed:.2f} "
            f"ms of a fixed laser ({fixed_scans})"
        )
    assert np.median(ratios) <= 2.0
