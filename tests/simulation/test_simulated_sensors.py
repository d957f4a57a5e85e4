"""Simulated sensors observe with the rates, noise, errors and occlusions of their description."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd
import pytest
from command import ran, run
from scipy import stats

import graphtrack as gt
from graphtrack import InputError
from graphtrack.geometry.angles import difference
from graphtrack.io.sensors import SensorScene
from graphtrack.simulation.crowd import crossing
from graphtrack.simulation.sensors import hidden, observe, square
from graphtrack.tracks.sensors import Sensor, SimulatedSensor, into_frame, sees
from graphtrack.tracks.track import Track, TrackSet

SIMULATED = SimulatedSensor(hz=8.0, body_kappa=6.0, head_kappa=3.0, occlusion_radius=0.0)


def walkers(n: int = 12, seconds: float = 40.0, seed: int = 0, side: float = 16.0) -> TrackSet:
    """People who are there all the time and walk in circles about places of their own."""
    rng = np.random.default_rng(seed)
    t = np.arange(round(10.0 * seconds) + 1) / 10.0
    tracks = []
    for k in range(n):
        phase, centre = rng.uniform(0.0, 2.0 * np.pi), rng.uniform(-0.5 * side, 0.5 * side, 2)
        angle = phase + 0.6 * t
        position = centre + 2.0 * np.column_stack([np.cos(angle), np.sin(angle)])
        body = np.angle(1j * np.exp(1j * angle))
        head = np.angle(np.exp(1j * (body + 0.3)))
        tracks.append(
            Track(10 + k, np.arange(len(t)), t, position, body=body, head=head, label=f"walker {k}")
        )
    return TrackSet(tuple(tracks))


PEOPLE = walkers()


def seen(
    sensors: dict[str, Sensor], people: TrackSet = PEOPLE, seed: int = 1, **options: Any
) -> pd.DataFrame:
    found = observe(people, sensors, rng=np.random.default_rng(seed), **options)
    return pd.DataFrame(found.columns)


def true_position(people: TrackSet, row: Any, t: float) -> np.ndarray:
    track = people.by_id(int(row.true_id))
    return np.array([np.interp(t, track.t, column) for column in track.position.T])


def test_rows_come_at_the_rate_of_each_sensor_with_its_misses() -> None:
    sensors = {
        "a": Sensor(position_std=0.1, detection_probability=0.7, simulation=replace(SIMULATED, hz=5.0)),
        "b": Sensor(position_std=0.1, simulation=replace(SIMULATED, hz=12.5, phase=0.03), clock_offset=0.5),
    }
    rows = seen(sensors)
    a, b = (rows[rows.sensor == name] for name in "ab")
    np.testing.assert_allclose(np.unique(a.t), np.arange(201) / 5.0)
    np.testing.assert_allclose(np.unique(b.t), 0.53 + np.arange(500) / 12.5)
    assert len(b) == 12 * 500 and not b.true_id.isna().any()
    low, high = stats.binom.ppf([1e-4, 1.0 - 1e-4], 12 * 201, 0.7)
    assert low < len(a) < high
    np.testing.assert_allclose(a.frame / 5.0, a.t, atol=1e-9)
    assert (np.diff(rows.t) >= 0.0).all()


def test_noise_and_errors_are_those_described() -> None:
    described = Sensor(
        position_std=0.2,
        position_scale=2.0,
        shift=(0.5, -0.25),
        rotation=math.radians(20.0),
        pivot=(1.0, 2.0),
        angle_bias=math.radians(15.0),
        clock_offset=-0.7,
        simulation=SIMULATED,
    )
    rows = seen({"a": described})
    assert (rows.pos_std == 0.1).all() and (rows.body_kappa == 6.0).all()
    n, true = len(rows), rows[["true_x", "true_y"]].to_numpy()
    for row in rows.iloc[::500].itertuples():
        np.testing.assert_allclose(
            [row.true_x, row.true_y], true_position(PEOPLE, row, row.t + 0.7), atol=1e-9
        )
    turn = math.radians(20.0)
    matrix = np.array([[math.cos(turn), -math.sin(turn)], [math.sin(turn), math.cos(turn)]])
    moved = (true - [1.0, 2.0]) @ matrix.T + [1.5, 1.75]
    error = rows[["x", "y"]].to_numpy() - moved
    assert np.abs(error.mean(axis=0)).max() < 4.0 * 0.2 / math.sqrt(n)
    low, high = stats.chi2.ppf([1e-4, 1.0 - 1e-4], 2 * n)
    assert low < np.sum(error**2) / 0.2**2 < high
    for name, kappa in (("body", 6.0), ("head", 3.0)):
        apart = np.radians(rows[f"{name}_deg"] - rows[f"true_{name}_deg"]) - math.radians(35.0)
        length = stats.vonmises(kappa).expect(np.cos, lb=-np.pi, ub=np.pi)
        assert np.mean(np.cos(apart)) == pytest.approx(length, abs=4.0 / math.sqrt(n))
        assert np.mean(np.sin(apart)) == pytest.approx(0.0, abs=4.0 / math.sqrt(n))
    tracks = gt.read(rows, sensors={"a": described})
    left = np.concatenate([one.position - one.true_position for one in tracks])
    np.testing.assert_allclose(left.std(), 0.2, rtol=0.03)
    assert all(np.allclose(one.position_std, 0.2) for one in tracks)


def test_an_ellipse_lies_along_the_ray_and_is_declared_in_the_sensors_frame() -> None:
    simulation = replace(SIMULATED, ray_std=0.5, across_std=0.05)
    described = Sensor(
        at=(-20.0, 3.0), rotation=math.radians(40.0), position_scale=0.5, simulation=simulation
    )
    rows = seen({"a": described})
    assert "pos_std" not in rows and {"observed_x_std", "observed_y_std", "observed_xy_corr"} <= set(rows)
    tracks = gt.read(rows, sensors={"a": described})
    squares, along = [], []
    for one in tracks:
        error = one.position - one.true_position
        squares.append(np.einsum("ni,nij,nj->n", error, np.linalg.inv(one.position_covariance), error))
        ray = one.true_position - np.array([-20.0, 3.0])
        along.append(np.sum(error * ray, axis=1) / np.linalg.norm(ray, axis=1))
    squares, along = np.concatenate(squares), np.concatenate(along)
    low, high = stats.chi2.ppf([1e-4, 1.0 - 1e-4], 2 * len(squares))
    assert low < squares.sum() < high and along.std() == pytest.approx(0.5, rel=0.05)
    # A box of the deviations says nothing of the ray: the same without declaring.
    quiet = seen({"a": replace(described, simulation=replace(simulation, declares=False))})
    assert not {"observed_x_std", "pos_std", "body_kappa"} & set(quiet)
    np.testing.assert_array_equal(quiet.x, rows.x)


def test_false_detections_have_their_density_in_the_field_of_view() -> None:
    view = [(-6.0, -6.0), (6.0, -6.0), (6.0, 0.0), (0.0, 0.0), (0.0, 6.0), (-6.0, 6.0)]
    sensors = {
        "polygon": Sensor(position_std=0.1, field_of_view=view, false_density=0.05, simulation=SIMULATED),
        "sector": Sensor(
            position_std=0.1,
            at=(5.0, 5.0),
            range=8.0,
            sector=(-1.0, 0.5),
            heading=3.0,
            false_density=0.02,
            simulation=SIMULATED,
        ),
        "everywhere": Sensor(position_std=0.1, false_density=0.01, simulation=SIMULATED),
    }
    rows = seen(sensors)
    places = np.concatenate([one.position for one in PEOPLE])
    areas = {"polygon": 108.0, "sector": 0.5 * 8.0**2 * 1.5, "everywhere": np.ptp(places, axis=0).prod()}
    for name, sensor in sensors.items():
        false = rows[(rows.sensor == name) & rows.true_id.isna()]
        low, high = stats.poisson.ppf([1e-4, 1.0 - 1e-4], 321 * sensor.false_density * areas[name])
        assert low < len(false) < high, name
        assert sees(sensor, false[["x", "y"]].to_numpy()).all()
        assert false[["true_x", "true_y", "true_body_deg"]].isna().all(axis=None)
        assert false.body_deg.between(-180.0, 180.0).all() and (false.label == "false").all()
        true = rows[(rows.sensor == name) & ~rows.true_id.isna()]
        assert sees(sensor, true[["true_x", "true_y"]].to_numpy()).all() and len(true)
    assert rows[rows.true_id.isna()].track_id.is_unique
    assert not set(rows[rows.true_id.isna()].track_id) & {one.track_id for one in PEOPLE}
    known = rows[~rows.true_id.isna()]
    assert (known.track_id == known.true_id).all() and (
        known.label == "walker " + (known.true_id - 10).astype(int).astype(str)
    ).all()


def test_people_behind_others_are_hidden() -> None:
    away = np.array([[4.0, 0.0], [8.0, 0.2], [8.0, 1.5], [-4.0, 0.1], [2.0, 3.0]])
    assert hidden(away, 0.3).tolist() == [False, True, False, False, False]
    assert not hidden(away, 0.05).any() and not hidden(away[:1], 0.3).any()
    rng = np.random.default_rng(0)
    for _ in range(50):
        crowd = rng.uniform(-10.0, 10.0, (15, 2))
        expected = []
        for person in crowd:
            ray = person / np.linalg.norm(person)
            expected.append(
                any(
                    0.0 < other @ ray < np.linalg.norm(person)
                    and np.linalg.norm(other) < np.linalg.norm(person)
                    and np.linalg.norm(other - (other @ ray) * ray) < 0.3
                    for other in crowd
                    if other is not person
                )
            )
        assert hidden(crowd, 0.3).tolist() == expected
    t = np.arange(50) / 10.0
    near = Track(1, np.arange(50), t, np.column_stack([np.full(50, 4.0), t - 2.5]))
    far = Track(2, np.arange(50), t, np.tile([8.0, 0.0], (50, 1)))
    sensor = Sensor(position_std=0.01, at=(0.0, 0.0), simulation=SimulatedSensor(hz=10.0))
    rows = seen({"a": sensor}, TrackSet((near, far)))
    assert (rows.true_id == 1).sum() == 50
    missing = np.setdiff1d(np.arange(50), rows[rows.true_id == 2].frame)
    np.testing.assert_array_equal(missing, np.flatnonzero(np.abs(t - 2.5) < 0.3 / 0.9))
    side = replace(sensor, at=(8.0, -10.0))
    assert (seen({"a": side}, TrackSet((near, far))).true_id == 2).sum() == 50


def test_own_identities_differ_between_sensors_and_after_a_loss() -> None:
    view = [(-20.0, -20.0), (0.0, -20.0), (0.0, 20.0), (-20.0, 20.0)]
    simulation = replace(SIMULATED, lost_after=0.5)
    sensors = {
        "half": Sensor(position_std=0.1, field_of_view=view, false_density=0.001, simulation=simulation),
        "all": Sensor(
            position_std=0.1, detection_probability=0.9, simulation=replace(SIMULATED, lost_after=3.0)
        ),
    }
    rows = seen(sensors, identities="own")
    half, everything = (rows[rows.sensor == name] for name in ("half", "all"))
    assert not set(half.track_id) & set(everything.track_id) and "label" not in rows
    assert everything.groupby("true_id").track_id.nunique().eq(1).all()
    assert half[half.true_id.isna()].track_id.is_unique and len(half[half.true_id.isna()])
    visits = 0
    for _, own in half[~half.true_id.isna()].groupby("true_id"):
        own = own.sort_values("t")
        new = own.track_id.diff().ne(0)
        np.testing.assert_array_equal(new[1:], own.t.diff()[1:] > 0.5)
        assert own.track_id.nunique() == new.sum()
        visits += new.sum()
    assert visits > 12
    assert half[~half.true_id.isna()].groupby("track_id").true_id.nunique().eq(1).all()


def test_identities_are_swapped_when_people_meet() -> None:
    t = np.arange(100) / 10.0
    ways = [np.column_stack([t - 5.0, np.full(100, 0.2)]), np.column_stack([5.0 - t, np.zeros(100)])]
    people = TrackSet(tuple(Track(k, np.arange(100), t, way) for k, way in enumerate(ways)))
    simulation = SimulatedSensor(hz=10.0, switch_probability=1.0)
    rows = seen({"a": Sensor(position_std=0.01, simulation=simulation)}, people, identities="own")
    for _, own in rows.groupby("true_id"):
        own = own.sort_values("t")
        assert own.track_id.diff().ne(0).sum() == 2 and own.t[own.track_id.diff().ne(0)].iloc[1] < 5.1
    assert rows.track_id.nunique() == 2
    never = Sensor(position_std=0.01, simulation=replace(simulation, switch_probability=0.0))
    assert seen({"a": never}, people, identities="own").groupby("track_id").true_id.nunique().eq(1).all()


def test_without_identities_rows_have_none_and_no_order() -> None:
    rows = seen({"a": Sensor(position_std=0.1, simulation=SIMULATED)}, identities="none")
    assert "track_id" not in rows and "label" not in rows
    scan = rows[rows.frame == 3]
    assert len(scan) == 12 and not scan.true_id.is_monotonic_increasing


ROBOT = Sensor(
    position_std=0.05,
    moves=True,
    range=9.0,
    sector=(-2.0, 2.0),
    shift=(0.1, 0.0),
    clock_offset=0.3,
    simulation=SimulatedSensor(
        hz=12.5,
        way="circle",
        centre=(1.0, -1.0),
        radius=2.0,
        turn_rate=1.0,
        pose_hz=20.0,
        pose_std=0.03,
        pose_yaw_std=math.radians(1.0),
        body_kappa=50.0,
        occlusion_radius=0.0,
    ),
)


def on_circle(t: np.ndarray, rate: float = 1.0) -> np.ndarray:
    side = math.copysign(1.0, rate)
    x, y = 1.0 + side * 2.0 * np.sin(rate * t), -1.0 - side * 2.0 * np.cos(rate * t)
    return np.column_stack([x, y, rate * t])


@pytest.mark.parametrize("rate", [1.0, -0.7])
def test_a_sensor_that_moves_has_rows_in_its_own_frame_and_noisy_poses(rate) -> None:
    robot = replace(ROBOT, simulation=replace(ROBOT.simulation, turn_rate=rate))
    found = observe(PEOPLE, {"robot": robot}, rng=np.random.default_rng(3))
    rows, poses = pd.DataFrame(found.columns), pd.DataFrame(found.poses)
    pose = on_circle(rows.t.to_numpy() - 0.3, rate)
    ahead = on_circle(rows.t.to_numpy() - 0.3 + 1e-4, rate) - pose
    heading = np.column_stack([np.cos(pose[:, 2]), np.sin(pose[:, 2])])
    np.testing.assert_allclose(ahead[:, :2] / (2e-4 * abs(rate)), heading, atol=1e-3)
    own = into_frame(rows[["true_x", "true_y"]].to_numpy(), pose)
    error = rows[["x", "y"]].to_numpy() - own - [0.1, 0.0]
    assert error.std() == pytest.approx(0.05, rel=0.05)
    assert sees(robot, own).all() and len(rows) < 0.9 * 12 * 501
    body = np.radians(rows.body_deg) + pose[:, 2] - np.radians(rows.true_body_deg)
    assert np.abs(difference(body, 0.0)).mean() < 0.2
    assert list(poses) == ["t", "x", "y", "yaw_deg", "x_std", "y_std", "yaw_std_deg", "sensor"]
    assert poses.t.iloc[0] == 0.0 and poses.t.iloc[-1] == 40.0 and len(poses) == 801
    off = poses[["x", "y"]].to_numpy() - on_circle(poses.t.to_numpy(), rate)[:, :2]
    assert off.std() == pytest.approx(0.03, rel=0.1)
    turned = difference(np.radians(poses.yaw_deg), on_circle(poses.t.to_numpy(), rate)[:, 2])
    assert turned.std() == pytest.approx(math.radians(1.0), rel=0.1)
    assert (poses.yaw_std_deg - 1.0).abs().max() < 1e-9 and (poses.sensor == "robot").all()


def test_a_way_is_read_from_a_file_and_known_between_its_rows(tmp_path) -> None:
    t = np.arange(5.0, 30.0, 0.25)
    path = pd.DataFrame({"t": t, "x": 0.1 * t, "y": -0.2 * t, "yaw_deg": (170.0 + 10.0 * t) % 360.0})
    path["sensor"] = "robot"
    other = path.assign(sensor="other", x=1e6)
    pd.concat([other, path]).to_csv(tmp_path / "way.csv", index=False)
    simulation = SimulatedSensor(hz=10.0, path="way.csv")
    robot = Sensor(position_std=0.05, moves=True, simulation=simulation)
    found = observe(PEOPLE, {"robot": robot}, folder=tmp_path, rng=np.random.default_rng(3))
    rows = pd.DataFrame(found.columns)
    assert rows.t.min() == 5.0 and rows.t.max() == pytest.approx(29.7)
    at = rows.t.to_numpy()
    pose = np.column_stack([0.1 * at, -0.2 * at, np.radians(170.0 + 10.0 * at)])
    error = rows[["x", "y"]].to_numpy() - into_frame(rows[["true_x", "true_y"]].to_numpy(), pose)
    assert error.std() == pytest.approx(0.05, rel=0.05)
    assert list(found.poses) == ["t", "x", "y", "yaw_deg", "sensor"]
    for text, expected in (
        ("t,x,y\n0,1,2\n", "yaw_deg"),
        ("t,x,y,yaw_deg\n0,1,2,\n", "a number"),
        ("t,x,y,yaw_deg\n0,1,2,3\n0,1,2,3\n", "a time after"),
        ("t,x,y,yaw_deg,sensor\n0,1,2,3,other\n", "its poses"),
        ("t,x,y,yaw_deg\n100,1,2,3\n101,1,2,3\n", "where its way is known"),
    ):
        (tmp_path / "way.csv").write_text(text)
        with pytest.raises(InputError, match=expected):
            observe(PEOPLE, {"robot": robot}, folder=tmp_path, rng=np.random.default_rng(3))


def test_what_is_not_known_well_enough_is_refused() -> None:
    fine = Sensor(position_std=0.1, simulation=SIMULATED)
    for sensor, found in (
        (Sensor(), "no noise"),
        (replace(fine, moves=True), "without a way"),
        (Sensor(simulation=SimulatedSensor(ray_std=0.1, across_std=0.1)), "ray_std without at"),
        (replace(fine, sector=(0.0, 1.0), at=(0.0, 0.0), false_density=0.1), "false_density without an area"),
        (replace(fine, simulation=SimulatedSensor(phase=100.0)), "no scan"),
        (replace(fine, field_of_view=[(900, 0), (901, 0), (901, 1)]), "no detections"),
    ):
        with pytest.raises(InputError, match=found):
            seen({"a": sensor})
    with pytest.raises(InputError, match="moves = true"):
        Sensor(simulation=SimulatedSensor(way="circle"))
    with pytest.raises(InputError, match="identities"):
        seen({"a": fine}, identities="false")


def test_one_sensor_does_not_change_with_the_others() -> None:
    fine = Sensor(position_std=0.1, detection_probability=0.5, simulation=SIMULATED)
    one = seen({"a": fine, "b": fine})
    other = seen({"a": fine, "b": replace(fine, false_density=0.1)})
    pd.testing.assert_frame_equal(
        one[one.sensor == "a"].reset_index(drop=True), other[other.sensor == "a"].reset_index(drop=True)
    )


def test_the_square_is_seen_by_four_cameras_that_overlap() -> None:
    scene = square(np.random.default_rng(5))
    assert len(scene) == 4 and len({one.simulation.phase for one in scene.values()}) == 4
    first, *others = scene.values()
    assert first.shift == (0.0, 0.0) and first.rotation == first.angle_bias == first.clock_offset == 0.0
    for one in others:
        assert math.hypot(*one.shift) == pytest.approx(0.2) and abs(one.clock_offset) == 0.1
        assert abs(one.rotation) == abs(one.angle_bias) == math.radians(1.0)
    grid = np.stack(np.meshgrid(np.linspace(-10, 10, 41), np.linspace(-10, 10, 41)), axis=-1).reshape(-1, 2)
    seen_by = np.sum([sees(one, grid) for one in scene.values()], axis=0)
    assert seen_by.min() >= 1 and seen_by.mean() > 3.0
    assert square() == square() and square() != scene


def test_people_who_cross_have_bodies_and_heads_of_their_paths() -> None:
    people = crossing(np.random.default_rng(2), people=60, seconds=120.0, fps=10.0)
    assert 35 < len(people) < 90
    apart = []
    for one in people:
        assert np.abs(one.position).max() < 14.0 and one.has_truth
        np.testing.assert_array_equal(one.body, one.true_body)
        velocity = np.gradient(one.position, one.t, axis=0) if len(one) > 1 else np.zeros((1, 2))
        moves = np.hypot(*velocity.T) > 0.5
        course = np.arctan2(velocity[:, 1], velocity[:, 0])
        apart.append(difference(one.body, course)[moves])
    assert np.median(np.abs(np.concatenate(apart))) < math.radians(10.0)


# The command


def test_the_command_writes_rows_poses_and_truth(cwd) -> None:
    scene = dict(square())
    scene["robot"] = ROBOT
    SensorScene(scene).save("scene.toml")
    given = ("simulate", "--scene", "crossing", "--tracks", 8, "--steps", 150, "--sensors", "scene.toml")
    done = ran(
        *given,
        "-o",
        "rows.csv",
        "--poses-out",
        "poses.csv",
        "--truth-output",
        "truth.csv",
        program="graphtrack",
    )
    assert "5 sensors" in done.stderr and "the truth" in done.stderr
    rows, poses, truth = pd.read_csv("rows.csv"), pd.read_csv("poses.csv"), gt.read("truth.csv")
    assert set(rows.sensor) == set(scene) and set(poses.sensor) == {"robot"}
    assert set(rows.true_id.dropna().astype(int)) <= {one.track_id for one in truth}
    again = ran(*given, "-o", "again.csv", program="graphtrack")
    assert "poses of moving sensors are not written" in again.stderr
    pd.testing.assert_frame_equal(pd.read_csv("again.csv"), rows)
    ran(*given, "-o", "other.csv", "--seed", 1, program="graphtrack")
    assert not pd.read_csv("other.csv").equals(rows)
    tracks = gt.read("rows.csv", sensors="scene.toml")
    assert not any("true_id" in note or "described" in note for note in tracks.summary.notes)
    error = [
        (one.position - one.true_position)[one.sensor != "robot"] for one in tracks if one.label != "false"
    ]
    assert np.concatenate(error).std() == pytest.approx(0.15, rel=0.05)
    for kind in ("own", "none"):
        ran(*given, "-o", f"{kind}.ndjson", "--identities", kind, program="graphtrack")
    assert gt.read("own.ndjson").n_frames == len(rows)


@pytest.mark.parametrize("people", [("--scenario",), ("--scene", "party"), ("--model", "joint")])
def test_all_people_are_observed(cwd, people) -> None:
    SensorScene({"a": Sensor(position_std=0.1, simulation=SIMULATED)}).save("scene.toml")
    ran(
        "simulate", *people, "--steps", 120, "--sensors", "scene.toml", "-o", "rows.csv", program="graphtrack"
    )
    tracks = gt.read("rows.csv")
    assert len(tracks) in (6, 10) and all(one.head is not None and one.has_truth for one in tracks)


def test_the_command_refuses_what_does_not_go_together(cwd) -> None:
    fine = Sensor(position_std=0.1, simulation=SIMULATED)
    SensorScene({"a": fine}).save("scene.toml")
    for arguments, found in (
        (("--identities", "own"), "--identities without --sensors"),
        (("--poses-out", "p.csv"), "--poses-out without --sensors"),
        (("--truth-output", "p.csv"), "--truth-output without --sensors"),
        (("--sensors", "scene.toml", "--missing", 0.1), "--missing with --sensors"),
        (("--sensors", "scene.toml", "--poses-out", "p.csv"), "--poses-out with sensors at rest"),
        (("--sensors", "scene.toml", "--truth-output", "scene.toml"), "scene.toml"),
        (("--scene", "crossing", "--gaze", "g.csv"), "--groups or --gaze"),
    ):
        done = run("simulate", "-o", "rows.csv", *arguments, program="graphtrack")
        assert done.returncode == 2 and found in done.stderr, done.stderr
    SensorScene({"a": Sensor()}).save("scene.toml")
    done = run("simulate", "-o", "rows.csv", "--sensors", "scene.toml", program="graphtrack")
    assert done.returncode == 2 and "scene.toml: found [sensors.a] no noise" in done.stderr
    done = run("simulate", "-o", "rows.txt", "--sensors", "scene.toml", program="graphtrack")
    assert done.returncode == 2 and "rows.txt" in done.stderr


def test_a_correction_by_the_description_leaves_the_noise_alone() -> None:
    scene = square()
    found = observe(PEOPLE, scene, rng=np.random.default_rng(0))
    tracks = gt.read(pd.DataFrame(found.columns), sensors=scene)
    for name in scene:
        parts = [(one.position - one.true_position)[one.sensor == name] for one in tracks if one.has_truth]
        error = np.concatenate(parts)
        assert np.abs(np.nanmean(error, axis=0)).max() < 4.0 * 0.15 / math.sqrt(len(error))
