"""Descriptions of sensors: their files, fields of view, and the correction of rows when they are read."""

import math
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest
from command import ran, run
from hypothesis import given
from hypothesis import strategies as st

import graphtrack as gt
from graphtrack import InputError
from graphtrack.io.sensors import SensorScene
from graphtrack.model import Observation
from graphtrack.model.observation import CHANNELS, observation_at, without_errors
from graphtrack.tracks.sensors import (
    MOVED_PIXELS,
    Sensor,
    SimulatedSensor,
    corrected,
    distorted,
    sees,
)
from graphtrack.tracks.table import Rows

ANGLE = st.floats(-3.1, 3.1)
METRES = st.floats(-50.0, 50.0)
PAIR = st.tuples(METRES, METRES)
STD = st.floats(0.01, 2.0)


@st.composite
def sensors(draw: st.DrawFn, **known: object) -> Sensor:
    """A sensor with some errors."""

    def perhaps(values: st.SearchStrategy) -> object:
        return draw(st.none() | values)

    values = {
        "position_scale": perhaps(st.floats(0.2, 5.0)),
        "shift": perhaps(PAIR),
        "rotation": perhaps(ANGLE),
        "pivot": draw(PAIR),
        "angle_bias": perhaps(ANGLE),
        "clock_offset": perhaps(st.floats(-10.0, 10.0)),
        "shift_std": perhaps(st.tuples(STD, STD)),
        "rotation_std": perhaps(st.floats(0.0, 0.5)),
    }
    return Sensor(**{**values, **known})


def rows_of(seed: int, n: int = 24, names: tuple[str, ...] = ("a", "b", "")) -> Rows:
    """Rows of several sensors, in no order, with most channels and some missing values."""
    rng = np.random.default_rng(seed)
    factor = rng.normal(size=(n, 2, 2))
    covariance = factor @ np.swapaxes(factor, 1, 2) + 0.1 * np.eye(2)
    channels = {
        "t": rng.uniform(0.0, 20.0, n),
        "position": rng.normal(0.0, 10.0, (n, 2)),
        "position_std": rng.uniform(0.05, 0.5, n),
        "position_covariance": covariance,
        "observed_velocity": rng.normal(size=(n, 2)),
        "observed_velocity_covariance": covariance[::-1].copy(),
        "body": rng.uniform(-np.pi, np.pi, n),
        "body_axis": rng.uniform(-np.pi, np.pi, n),
        "head": rng.uniform(-np.pi, np.pi, n),
        "true_position": rng.normal(size=(n, 2)),
        "input_distance": rng.normal(size=n),
    }
    for name in ("position", "observed_velocity", "body"):
        channels[name][rng.random(n) < 0.2] = np.nan
    return Rows(
        Path("table"),
        "table",
        rng.integers(0, 4, n),
        np.arange(n),
        channels,
        lambda i: i + 1,
        sensor=np.array(names)[rng.integers(0, len(names), n)],
    )


def assert_close(found: Rows, expected: Rows) -> None:
    assert found.channels.keys() == expected.channels.keys()
    for name, values in expected.channels.items():
        if name in ("body", "head", "body_axis"):
            np.testing.assert_allclose(np.exp(1j * found.channels[name]), np.exp(1j * values), atol=1e-9)
        else:
            np.testing.assert_allclose(found.channels[name], values, rtol=1e-9, atol=1e-9)


@given(sensors(), sensors(), st.integers(0, 1000))
def test_correction_is_the_inverse_of_the_errors(first: Sensor, second: Sensor, seed: int) -> None:
    rows, scene = rows_of(seed), {"a": first, "": second, "absent": first}
    bent = distorted(rows, scene)
    assert_close(corrected(bent, scene), rows)
    assert_close(distorted(corrected(rows, scene), scene), rows)
    other = np.flatnonzero(rows.sensor == "b")
    for name, values in rows.channels.items():
        np.testing.assert_array_equal(bent.channels[name][other], values[other])
    assert (bent.sensor == rows.sensor).all() and bent.line_of(3) == rows.line_of(3)
    for name in ("true_position", "input_distance"):
        assert bent.channels[name] is rows.channels[name]


@given(sensors(), st.integers(0, 1000))
def test_errors_are_those_of_the_documentation(sensor: Sensor, seed: int) -> None:
    rows = rows_of(seed, names=("a",))
    bent = distorted(rows, {"a": sensor})
    turn, bias, pivot = sensor.rotation or 0.0, sensor.angle_bias or 0.0, np.array(sensor.pivot)
    matrix = np.array([[math.cos(turn), -math.sin(turn)], [math.sin(turn), math.cos(turn)]])
    for i in range(len(rows)):
        moved = pivot + matrix @ (rows.channels["position"][i] - pivot) + np.array(sensor.shift or (0, 0))
        np.testing.assert_allclose(bent.channels["position"][i], moved, rtol=1e-9, atol=1e-9)
        moved = (
            matrix @ rows.channels["position_covariance"][i] @ matrix.T / (sensor.position_scale or 1) ** 2
        )
        np.testing.assert_allclose(bent.channels["position_covariance"][i], moved, rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(
            bent.channels["observed_velocity"][i], matrix @ rows.channels["observed_velocity"][i], atol=1e-9
        )
    np.testing.assert_allclose(bent.channels["t"], rows.channels["t"] + (sensor.clock_offset or 0.0))
    over = np.exp(1j * (bent.channels["head"] - rows.channels["head"] - turn - bias))
    np.testing.assert_allclose(over, 1.0, atol=1e-9)


def test_a_sensor_without_errors_changes_no_bit() -> None:
    rows = rows_of(1)
    for sensor in (Sensor(), Sensor(shift=(0.0, 0.0), rotation=0.0, angle_bias=0.0, clock_offset=0.0)):
        found = corrected(rows, dict.fromkeys(("a", "b", ""), sensor))
        for name, values in rows.channels.items():
            np.testing.assert_array_equal(found.channels[name], values)


def test_class_likelihoods_turn_with_their_sensor() -> None:
    rng = np.random.default_rng(3)
    classes = rng.uniform(0.0, 1.0, (24, 8))
    rows = rows_of(2, names=("a",)).with_channels(body_likelihood=classes)
    whole = {"a": Sensor(rotation=math.radians(90.0), angle_bias=math.radians(45.0))}
    bent = distorted(rows, whole)
    np.testing.assert_array_equal(bent.channels["body_likelihood"], np.roll(classes, 3, axis=1))
    np.testing.assert_allclose(corrected(bent, whole).channels["body_likelihood"], classes)
    half = distorted(rows, {"a": Sensor(angle_bias=math.radians(-22.5))}).channels["body_likelihood"]
    np.testing.assert_allclose(half, 0.5 * (np.roll(classes, -1, axis=1) + classes))
    np.testing.assert_allclose(half.sum(axis=1), classes.sum(axis=1))


def test_noise_is_declared_where_the_rows_declare_none() -> None:
    rows = rows_of(4, names=("a", "b"))
    std, covariance = rows.channels["position_std"].copy(), rows.channels["position_covariance"].copy()
    std[:12], covariance[6:] = np.nan, np.nan  # the first six have an ellipse, the last twelve a radius
    rows = rows.with_channels(position_std=std, position_covariance=covariance)
    scene = {"a": Sensor(position_std=0.3, position_scale=2.0)}
    found, of_a = corrected(rows, scene).channels, rows.sensor == "a"
    undeclared = np.arange(24) // 6 == 1
    np.testing.assert_array_equal(found["position_std"][of_a & undeclared], 0.3)
    assert np.isnan(found["position_std"][of_a][:2]).any()
    np.testing.assert_allclose(found["position_std"][12:], np.where(of_a[12:], 2.0, 1.0) * std[12:])
    np.testing.assert_allclose(
        found["position_covariance"][:6], np.where(of_a[:6], 4.0, 1.0)[:, None, None] * covariance[:6]
    )
    bare = rows.without("position_std", "position_covariance")
    assert (corrected(bare, scene).channels["position_std"][of_a] == 0.3).all()
    assert np.isnan(corrected(bare, scene).channels["position_std"][~of_a]).all()


def test_deviations_of_a_table_keep_their_root_mean_square_when_turned() -> None:
    spread = np.full((24, 6, 6), np.nan)
    spread[:, range(6), range(6)] = [0.04, 0.01, 0.1, 0.2, 0.3, 0.4]
    rows = rows_of(5, names=("a",)).with_channels(covariance=spread)
    found = corrected(rows, {"a": Sensor(rotation=math.radians(90.0), position_scale=3.0)}).channels
    np.testing.assert_allclose(found["covariance"][0, range(6), range(6)], [0.09, 0.36, 0.2, 0.1, 0.3, 0.4])


def test_pixels_of_moved_positions_are_left_out_with_a_note() -> None:
    rows = rows_of(6, names=("a", "b")).with_channels(pixel=np.ones((24, 2)))
    found = corrected(rows, {"a": Sensor(shift=(1.0, 0.0)), "b": Sensor(clock_offset=1.0)})
    np.testing.assert_array_equal(np.isnan(found.channels["pixel"][:, 0]), rows.sensor == "a")
    assert found.notes == (MOVED_PIXELS,)


# Fields of view


@st.composite
def polygons(draw: st.DrawFn) -> list[tuple[float, float]]:
    """A polygon around the origin, convex or not."""
    turns = draw(st.lists(st.integers(0, 359), min_size=5, max_size=12, unique=True))
    turns.sort()
    if max(np.diff([*turns, turns[0] + 360])) >= 180:
        turns = [0, 100, 200, 300]
    radii = draw(st.lists(st.floats(1.0, 9.0), min_size=len(turns), max_size=len(turns)))
    return [
        (r * math.cos(math.radians(a)), r * math.sin(math.radians(a)))
        for r, a in zip(radii, turns, strict=True)
    ]


def winding(polygon: list[tuple[float, float]], point: np.ndarray) -> int:
    """The number of times that a polygon goes around a point, by the sum of angles."""
    away = np.array(polygon) - point
    bearing = np.arctan2(away[:, 1], away[:, 0])
    return round(float(np.sum(np.angle(np.exp(1j * (np.roll(bearing, -1) - bearing))))) / math.tau)


@given(polygons(), PAIR, st.integers(0, 1000), st.booleans())
def test_polygons_are_seen_as_by_the_winding_number(polygon, centre, seed, backwards) -> None:
    moved = [(x + centre[0], y + centre[1]) for x, y in polygon][:: -1 if backwards else 1]
    points = np.array(centre) + np.random.default_rng(seed).uniform(-10.0, 10.0, (60, 2))
    expected = [winding(moved, point) != 0 for point in points]
    assert sees(Sensor(field_of_view=moved), points).tolist() == expected


@given(
    st.floats(-6.0, 6.0), st.floats(-3.0, 3.0), st.floats(0.1, 3.2), st.floats(1.0, 9.0), st.integers(0, 99)
)
def test_sectors_are_seen_as_by_the_dot_product(heading, begin, half, reach, seed) -> None:
    half = min(half, math.pi)
    at = (2.0, -1.0)
    sensor = Sensor(range=reach, sector=(begin - half, begin + half), at=at, heading=heading)
    points = np.random.default_rng(seed).uniform(-10.0, 10.0, (60, 2))
    middle = np.array([math.cos(heading + begin), math.sin(heading + begin)])
    for point, found in zip(points, sees(sensor, points), strict=True):
        away = point - at
        distance = float(np.linalg.norm(away))
        apart = math.acos(np.clip(away @ middle / distance, -1.0, 1.0))
        if min(abs(apart - half), abs(distance - reach)) > 1e-6:
            assert found == (distance <= reach and apart <= half)


@given(PAIR, ANGLE, st.integers(0, 99))
def test_a_field_of_view_moves_along(place, yaw, seed) -> None:
    sensor = Sensor(moves=True, range=6.0, sector=(-0.8, 0.5), heading=0.2)
    own = np.random.default_rng(seed).uniform(-8.0, 8.0, (40, 2))
    turn = np.array([[math.cos(yaw), -math.sin(yaw)], [math.sin(yaw), math.cos(yaw)]])
    world = own @ turn.T + place
    expected = sees(sensor, own)
    assert (sees(sensor, world, np.array([*place, yaw])) == expected).all() and expected.any()
    poses = np.tile([*place, yaw], (40, 1))
    poses[20:] = np.nan
    assert (sees(sensor, world, poses) == (expected & (np.arange(40) < 20))).all()


def test_without_a_field_of_view_everything_is_seen_but_nothing_where_it_is_unknown() -> None:
    assert sees(Sensor(), np.array([[1e6, -1e6], [np.nan, 0.0]])).tolist() == [True, False]
    assert sees(Sensor(range=1.0, at=(0.0, 0.0)), np.array([[0.6, 0.6], [0.9, 0.9]])).tolist() == [
        True,
        False,
    ]
    assert sees(Sensor(sector=(0.0, 1.0), at=(0.0, 0.0)), np.array([[1e5, 1.0], [1.0, -0.1]])).tolist() == [
        True,
        False,
    ]


# Files

FULL = Sensor(
    position_std=0.15,
    position_scale=1.2,
    shift=(0.2, -0.1),
    rotation=math.radians(1.0),
    pivot=(3.0, 4.0),
    angle_bias=math.radians(-2.5),
    clock_offset=0.1,
    detection_probability=0.85,
    false_density=0.001,
    range=20.0,
    sector=(math.radians(-45.0), math.radians(45.0)),
    at=(-10.0, -10.0),
    heading=math.radians(45.0),
    shift_std=(0.01, 0.02),
    rotation_std=math.radians(0.1),
    angle_bias_std=math.radians(0.3),
    clock_offset_std=0.003,
    simulation=SimulatedSensor(hz=12.5, phase=0.02, ray_std=0.5, across_std=0.05, body_kappa=4.0),
)


def test_a_file_has_degrees_and_reads_back(tmp_path) -> None:
    path = tmp_path / "scene.toml"
    scene = SensorScene(
        {
            "north gate": FULL,
            "": Sensor(field_of_view=[(0, 0), (4, 0), (4, 3)], shift=np.array([0.5, 0.25])),
            "robot.laser": Sensor(moves=True, range=8, simulation=SimulatedSensor(way="circle", radius=2)),
            "nothing": Sensor(),
        }
    )
    scene.save(path)
    text = path.read_text()
    for line in ("rotation_deg = 1.0", "angle_bias_deg = -2.5", "heading_deg = 45.0", "hz = 12.5"):
        assert line in text
    again = SensorScene.load(path)
    assert dict(again) == dict(scene) and list(again) == list(scene)
    assert again["north gate"].sector == FULL.sector
    assert SensorScene.of(str(path)) == scene and SensorScene.of(scene) is scene
    assert SensorScene.of({"a": Sensor()})["a"] == Sensor()


@given(sensors(), sensors(simulation=SimulatedSensor(turn_rate=1.0, pose_yaw_std=0.02)))
def test_every_description_reads_back(first, second) -> None:
    for sensor in (first, second):
        again = Sensor.from_table("sensors.a", sensor.to_table())
        for one in fields(Sensor):
            found, expected = getattr(again, one.name), getattr(sensor, one.name)
            if one.name == "simulation":
                assert found == expected
            else:
                assert found == (None if expected is None else pytest.approx(expected, rel=1e-15))


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("", "no sensors"),
        ("sensors = 3", "no sensors"),
        ("[sensors]", "no sensors"),
        ("[other]\nx = 1\n[sensors.a]", "key other"),
        ("sensors.a = 1", "sensors.a = 1"),
        ("[sensors.a]\ncolour = 1", "key sensors.a.colour"),
        ("[sensors.a]\nrotation = 1", "key sensors.a.rotation"),
        ("[sensors.a]\nrotation_deg = 200", "sensors.a.rotation_deg = 200"),
        ("[sensors.a]\nrotation_deg = true", "sensors.a.rotation_deg = True"),
        ("[sensors.a]\nclock_offset = 'late'", "sensors.a.clock_offset = 'late'"),
        ("[sensors.a]\nclock_offset = nan", "sensors.a.clock_offset = nan"),
        ("[sensors.a]\nclock_offset = 1e999", "sensors.a.clock_offset = inf"),
        ("[sensors.a]\nshift = 0.3", "sensors.a.shift = 0.3"),
        ("[sensors.a]\nshift = [0.3]", "sensors.a.shift = [0.3]"),
        ("[sensors.a]\nshift = [0.3, 'x']", "sensors.a.shift[1] = 'x'"),
        ("[sensors.a]\nshift_std = [-0.3, 0.1]", "sensors.a.shift_std[0] = -0.3"),
        ("[sensors.a]\nmoves = 1", "sensors.a.moves = 1"),
        ("[sensors.a]\nposition_std = 0", "sensors.a.position_std = 0"),
        ("[sensors.a]\ndetection_probability = 1.1", "sensors.a.detection_probability = 1.1"),
        ("[sensors.a]\nfield_of_view = [[0, 0], [1, 1]]", "sensors.a.field_of_view = [[0, 0], [1, 1]]"),
        ("[sensors.a]\nfield_of_view = [[0, 0], [1, 1], [2]]", "sensors.a.field_of_view[2] = [2]"),
        ("[sensors.a]\nfield_of_view = [[0, 0], [2, 2], [2, 0], [0, 2]]", "intersects itself"),
        ("[sensors.a]\nfield_of_view = [[0, 0], [1, 0], [2, 0]]", "no area"),
        ("[sensors.a]\nfield_of_view = [[0, 0], [4, 0], [4, 4], [2, 0]]", "intersects itself"),
        ("[sensors.a]\nfield_of_view = [[0, 0], [4, 0], [4, 4], [4, 0]]", "intersects itself"),
        ("[sensors.a]\nfield_of_view = [[0, 0], [0, 0], [4, 4], [4, 0]]", "a corner twice"),
        ("[sensors.a]\nrange = 3", "range or sector without at"),
        ("[sensors.a]\nrange = 3\nat = [0, 0]\nfield_of_view = [[0, 0], [1, 0], [1, 1]]", "with range"),
        ("[sensors.a]\nheading_deg = 3\nrange = 3\nat = [0, 0]", "heading without sector"),
        ("[sensors.a]\nsector_deg = [45, -45]\nat = [0, 0]", "sector_deg = [45, -45]"),
        ("[sensors.a]\nsector_deg = [-200, 200]\nat = [0, 0]", "sector_deg = [-200, 200]"),
        ("[sensors.a]\nsimulation = 1", "sensors.a.simulation = 1"),
        ("[sensors.a.simulation]\nfps = 1", "key sensors.a.simulation.fps"),
        ("[sensors.a.simulation]\nhz = 0", "sensors.a.simulation.hz = 0"),
        ("[sensors.a.simulation]\nray_std = 0.5", "one of ray_std and across_std"),
        ("[sensors.a.simulation]\nway = 'square'", "way = 'square'"),
        ("[sensors.a.simulation]\nway = 'circle'\npath = 'p.csv'", "way and path"),
        ("[sensors.'" + 101 * "a" + "']", "a sensor named"),
        ('[sensors."two\\nlines"]', "a sensor named"),
        ("[groups]\nx = 1", "the output of 'graphtrack fit --groups'"),
        ("[sensors.a", "no TOML"),
    ],
)
def test_a_file_that_cannot_be_right_is_refused_with_its_key(tmp_path, text, found) -> None:
    path = tmp_path / "scene.toml"
    path.write_text(text)
    with pytest.raises(InputError) as error:
        SensorScene.load(path)
    assert found in error.value.found and error.value.path == str(path) and "\n" not in str(error.value)


def test_descriptions_in_python_are_checked_too() -> None:
    for wrong in (
        {"rotation": 4.0},
        {"shift": "12"},
        {"shift": (1.0, 2.0, 3.0)},
        {"position_std": -1.0},
        {"moves": 1},
        {"simulation": {"hz": 3}},
        {"field_of_view": 2000 * [(0.0, 0.0)]},
    ):
        with pytest.raises(InputError):
            Sensor(**wrong)
    closed = Sensor(field_of_view=[(0, 0), (1, 0), (1, 1), (0, 0)])
    assert closed.field_of_view == ((0.0, 0.0), (1.0, 0.0), (1.0, 1.0))
    for given_ in ({"a": 3}, {"a\nb": Sensor()}, 7):
        with pytest.raises(InputError):
            SensorScene.of(given_)


@given(sensors(position_std=0.3))
def test_an_observation_is_corrected_as_a_row(sensor: Sensor) -> None:
    rows = rows_of(3, names=("a",))
    rng = np.random.default_rng(0)
    likelihood = rng.dirichlet(np.ones(8), len(rows))
    rows = rows.with_channels(body_likelihood=likelihood)
    rows.channels["position_std"][::3] = np.nan
    rows.channels["position_covariance"][::3] = np.nan
    expected = corrected(rows, {"a": sensor})

    def observation(given_: Rows, k: int) -> Observation:
        channels = {name: given_.channels[name] for name in CHANNELS if name in given_.channels}
        inputs = {"distance": given_.channels["input_distance"]}
        return observation_at(k, float(given_.channels["t"][k]), 5, channels, inputs, "a")

    for k in range(len(rows)):
        one, other = without_errors(observation(rows, k), sensor), observation(expected, k)
        if one.position is None and other.position_std != one.position_std:
            other = replace(other, position_std=one.position_std)
        for name in vars(one):
            assert getattr(one, name) == getattr(other, name), name


# Reading


@pytest.fixture
def table(tmp_path) -> Path:
    """A person seen by two sensors, of which b is shifted, turned and late."""
    t = np.arange(40) / 10
    true = np.column_stack([1.2 * t, 0.5 * t])
    rows = []
    turn = math.radians(10.0)
    for k in range(40):
        rows.append(f"7,{k},{t[k]:.6f},{true[k, 0]:.9f},{true[k, 1]:.9f},{20.0},a")
        x = true[k, 0] * math.cos(turn) - true[k, 1] * math.sin(turn) + 0.3
        y = true[k, 0] * math.sin(turn) + true[k, 1] * math.cos(turn)
        rows.append(f"7,{k},{t[k] + 0.2:.6f},{x:.9f},{y:.9f},{35.0},b")
    path = tmp_path / "rows.csv"
    path.write_text("track_id,frame,t,x,y,body_deg,sensor\n" + "\n".join(rows) + "\n")
    return path


LATE = Sensor(shift=(0.3, 0.0), rotation=math.radians(10.0), angle_bias=math.radians(5.0), clock_offset=0.2)


def test_rows_are_corrected_when_they_are_read(table, tmp_path) -> None:
    SensorScene({"a": Sensor(), "b": LATE}).save(tmp_path / "scene.toml")
    (track,) = gt.read(table, sensors=tmp_path / "scene.toml")
    of_a, of_b = track.sensor == "a", track.sensor == "b"
    np.testing.assert_allclose(track.t[of_a], track.t[of_b], atol=1e-6)
    np.testing.assert_allclose(track.position[of_a], track.position[of_b], atol=1e-6)
    np.testing.assert_allclose(track.body, math.radians(20.0), atol=1e-9)
    assert not gt.read(table, sensors={"a": Sensor(), "b": LATE}).summary.notes
    import pandas as pd

    (again,) = gt.read(pd.read_csv(table), sensors={"a": Sensor(), "b": LATE})
    np.testing.assert_array_equal(again.position, track.position)


def test_sensors_that_are_not_described_or_absent_are_named(table) -> None:
    notes = gt.read(table, sensors={"b": LATE, "c": Sensor(), "d": Sensor()}).summary.notes
    assert notes == ("sensors that are not described: a", "described sensors that no row has: c, d")
    (one,) = gt.read(table, sensors={"b": LATE})
    (plain,) = gt.read(table)
    np.testing.assert_array_equal(one.position[one.sensor == "a"], plain.position[plain.sensor == "a"])


def test_rows_without_a_sensor_are_those_of_the_empty_name(tmp_path) -> None:
    path = tmp_path / "rows.csv"
    path.write_text("track_id,frame,t,x,y\n1,0,0.0,1.0,2.0\n1,1,0.1,1.1,2.0\n")
    (track,) = gt.read(path, sensors={"": Sensor(shift=(1.0, 2.0), position_std=0.4)})
    np.testing.assert_allclose(track.position, [[0.0, 0.0], [0.1, 0.0]], atol=1e-12)
    assert (track.position_std == 0.4).all()
    notes = gt.read(path, sensors={"a": Sensor()}).summary.notes
    assert "sensors that are not described: rows without a sensor" in notes


def test_files_of_one_sensor_each_are_described_by_one_scene(table, tmp_path) -> None:
    lines = table.read_text().splitlines()
    paths = []
    for name in ("a", "b"):
        paths.append(tmp_path / f"{name}.csv")
        own = [line for line in lines[1:] if line.endswith(name)]
        paths[-1].write_text("\n".join([lines[0], *own]) + "\n")
    scene = {"a": Sensor(), "b": LATE}
    assert not any("described" in note for note in gt.read(paths, sensors=scene).summary.notes)
    notes = gt.read(paths, sensors={**scene, "c": Sensor()}).summary.notes
    assert "described sensors that no row has: c" in notes


def test_the_command_line_takes_a_description(table, tmp_path) -> None:
    SensorScene({"a": Sensor(), "b": LATE, "c": Sensor()}).save(tmp_path / "scene.toml")
    done = ran(
        "convert",
        table,
        "-o",
        tmp_path / "out.csv",
        "--sensors",
        tmp_path / "scene.toml",
        program="graphtrack",
    )
    assert "described sensors that no row has: c" in done.stderr
    (track,) = gt.read(tmp_path / "out.csv")
    (expected,) = gt.read(table, sensors=tmp_path / "scene.toml")
    np.testing.assert_allclose(track.position, expected.position)
    (tmp_path / "wrong.toml").write_text("[sensors.a]\nrotation_deg = 400\n")
    done = run("info", table, "--sensors", tmp_path / "wrong.toml", program="graphtrack")
    assert done.returncode == 2 and "sensors.a.rotation_deg = 400" in done.stderr
    scene = tmp_path / "scene.toml"
    done = run("convert", table, "-o", scene, "--sensors", scene, program="graphtrack")
    assert done.returncode == 2 and SensorScene.load(scene)["b"] == LATE


def test_a_data_set_that_is_streamed_is_corrected_as_in_memory(table, tmp_path) -> None:
    scene, whole = tmp_path / "scene.toml", tmp_path / "whole.parquet"
    SensorScene({"a": Sensor(), "b": LATE}).save(scene)
    rows, out = tmp_path / "rows.parquet", tmp_path / "out.parquet"
    gt.write(gt.read(table), rows)
    command = ("smooth", rows, "-o", out, "--stream", "--model", "position", "--constants", "default")
    ran(*command, "--sensors", scene, program="graphtrack")
    gt.write(gt.smooth(gt.read(rows, sensors=scene), "position", constants="default"), whole)
    assert out.read_bytes() == whole.read_bytes()
    scene.write_text("[sensors.a]\nshift = 3\n")
    done = run(*command, "--sensors", scene, program="graphtrack")
    assert done.returncode == 2 and "sensors.a.shift = 3" in done.stderr


def test_detections_that_are_streamed_are_corrected_once(table, tmp_path) -> None:
    scene, rows, out = tmp_path / "scene.toml", tmp_path / "rows.parquet", tmp_path / "out.parquet"
    SensorScene({"": Sensor(shift=(5.0, 0.0), clock_offset=0.5)}).save(scene)
    bare = gt.read(table).map(lambda one: replace(one[one.sensor == "a"], sensor=None))
    gt.write(bare, rows)
    command = ("smooth", rows, "-o", out, "--stream", "--associate", "always", "--model", "position")
    ran(*command, "--constants", "default", "--sensors", scene, program="graphtrack")
    (found,), (expected,) = gt.read(out), bare
    np.testing.assert_allclose(found.t, expected.t - 0.5, atol=1e-9)
    np.testing.assert_allclose(found.position, expected.position - [5.0, 0.0], atol=0.1)
