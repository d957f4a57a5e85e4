"""Sensors in the report: fields of view, who was seen by which sensor, ellipses, and the errors found."""

import base64
import json
import math
import re
import zlib
from pathlib import Path

import numpy as np
import pytest
from command import ran
from hypothesis import given
from hypothesis import strategies as st
from page_scripts import decoded, delta_decode, in_node

import graphtrack as gt
from graphtrack.association.sensors import Views
from graphtrack.report.html import render_report
from graphtrack.report.lives import pair_tracks
from graphtrack.report.page import tracking_report
from graphtrack.report.plots.scene import plot_pairs
from graphtrack.report.replay import replay_data
from graphtrack.report.sensors import outline_of, shown_sensors
from graphtrack.tracks.sensors import Sensor, sees
from graphtrack.tracks.track import Track, TrackSet

ELLIPSES = {"east": np.diag([0.04, 0.01]), "west": np.diag([0.01, 0.04])}


def seen(track_id=1, n=20, offset=0.0, covariances=True):
    """Rows of one person, of two sensors at one time or a little apart; each counts its own frames."""
    rng = np.random.default_rng(track_id)
    rows = [
        (0.1 * k + offset * number, k, name)
        for k in range(n)
        for number, name in enumerate(ELLIPSES)
        if (k < 15) or name == "west"
    ]
    t, frame, sensor = zip(*rows, strict=True)
    position = np.column_stack([np.array(t), np.full(len(t), float(track_id))])
    position += rng.normal(0.0, 0.05, position.shape)
    given = {"position_covariance": np.array([ELLIPSES[name] for name in sensor])} if covariances else {}
    return Track(track_id, np.array(frame), np.array(t), position, sensor=np.array(sensor), **given)


def estimates_of(track):
    n = len(track)
    velocity, covariance = np.tile([1.0, 0.0], (n, 1)), np.tile(0.01 * np.eye(6), (n, 1, 1))
    return Track(
        track.track_id,
        track.frame,
        track.t,
        np.column_stack([track.t, np.full(n, float(track.track_id))]),
        velocity=velocity,
        covariance=covariance,
        sensor=track.sensor,
    )


@pytest.mark.parametrize("offset", [0.0, 0.03])
def test_rows_of_several_sensors_are_paired_and_replayed(offset):
    track = seen(offset=offset)
    (pair,) = pair_tracks(TrackSet((estimates_of(track),)), TrackSet((track,)))
    np.testing.assert_array_equal(pair.observed_position, track.position)
    np.testing.assert_array_equal(pair.observed_covariance, track.position_covariance)
    assert pair.sensor.tolist() == track.sensor.tolist()
    shown = shown_sensors([pair])
    data = replay_data([pair], sensors=shown)
    (person,) = data["people"]
    assert data["frame"] > 0.0 and [one["title"] for one in data["sensors"]] == ["east", "west"]
    n = len(track)
    names = [shown[int(k)].name for k in delta_decode(person["sensor"], 1.0, n)]
    assert names == track.sensor.tolist()
    major = delta_decode(person["seen_major"], data["steps"]["length"], n)
    np.testing.assert_allclose(major, 0.2 * math.sqrt(5.991), atol=2e-3)
    code = f"{decoded(data)} return [...people[0].t].map((t, at) => samplesTogether(people[0], at).length);"
    assert in_node(("replay_data.js",), code) == [2 if k < 30 and not offset else 1 for k in range(n)]


def test_estimates_without_sensors_take_those_of_the_observations_at_their_times():
    track = seen(covariances=False)
    n = 20
    estimate = Track(1, np.arange(n), 0.1 * np.arange(n), np.zeros((n, 2)))
    (pair,) = pair_tracks(TrackSet((estimate,)), TrackSet((track,)))
    assert np.isfinite(pair.observed_position).all() and set(pair.sensor.tolist()) == {"east", "west"}


@given(
    st.floats(1.0, 30.0),
    st.floats(-3.0, 3.0),
    st.floats(0.2, 3.0),
    st.tuples(st.floats(-9.0, 9.0), st.floats(-9.0, 9.0)),
)
def test_outlines_of_sectors_are_on_the_edge_of_what_is_seen(reach, heading, width, at):
    sensor = Sensor(range=reach, sector=(-0.5 * width, 0.5 * width), at=at, heading=heading)
    outline = outline_of(sensor, np.empty((0, 2)))
    middle = np.array(at) + 0.5 * reach * np.array([math.cos(heading), math.sin(heading)])
    assert sees(sensor, middle + 0.99 * (outline - middle)).mean() > 0.9 or width > 2.0
    assert not sees(sensor, middle + 1.02 * (outline[1:-1] - middle)).any()


def test_a_field_of_view_that_is_not_described_is_the_one_that_association_learns():
    rng = np.random.default_rng(0)
    position = rng.uniform(0.0, 5.0, (400, 2))
    t = 0.1 * np.arange(400)
    track = Track(1, np.arange(400), t, position, sensor=np.full(400, "laser"))
    (one,) = shown_sensors(pair_tracks(TrackSet((track,))))
    assert one.learned and one.rows == 400 and len(one.outline) >= 4
    views = Views.of(position, np.zeros(400, dtype=np.int64), 1)
    np.testing.assert_allclose(views.at(one.outline).ravel(), 0.5, atol=1e-9)  # on the edge
    described = {"laser": Sensor(moves=True)}
    assert shown_sensors(pair_tracks(TrackSet((track,))), described)[0].outline is None
    polygon = {"laser": Sensor(field_of_view=((0.0, 0.0), (9.0, 0.0), (9.0, 9.0)))}
    (one,) = shown_sensors(pair_tracks(TrackSet((track,))), polygon)
    assert not one.learned and one.outline.tolist() == [[0.0, 0.0], [9.0, 0.0], [9.0, 9.0]]
    line = Track(1, np.arange(9), t[:9], np.zeros((9, 2)), sensor=np.full(9, "laser"))
    shown_sensors(pair_tracks(TrackSet((line,))))  # all in one place


def test_without_sensors_a_page_is_as_it_was():
    track = Track(1, np.arange(9), 0.1 * np.arange(9), np.zeros((9, 2)))
    pairs = pair_tracks(TrackSet((track,)))
    assert shown_sensors(pairs) == ()
    page = render_report(tracking_report(TrackSet((track,))))
    assert "fields of view" not in page and "data-sensor" not in page and "clock (ms)" not in page


def test_the_page_shows_fields_of_view_sensors_and_the_errors_found():
    track = seen()
    errors = {
        "shift": (0.21, -0.04),
        "shift_std": (0.01, 0.02),
        "clock_offset": 0.1,
        "clock_offset_std": 0.004,
    }
    described = {
        "west": Sensor(range=9.0, sector=(-0.5, 0.5), at=(-3.0, 0.0), heading=0.0, **errors),
        "east": Sensor(rotation=math.radians(1.5), rotation_std=math.radians(0.2)),
    }
    report = tracking_report(TrackSet((estimates_of(track),)), TrackSet((track,)), sensors=described)
    (section,) = [one for one in report.sections if one.title == "Sensors"]
    (table,) = section.items
    rows = [dict(zip(table.columns, row, strict=True)) for row in table.rows]
    assert [row["sensor"] for row in rows] == ["west", "east"]
    assert (rows[0]["shift x (m)"], rows[0]["± x (m)"], rows[0]["clock (ms)"]) == (0.21, 0.01, 100.0)
    assert rows[1]["rotation (°)"] == pytest.approx(1.5) and rows[1]["± rotation (°)"] == pytest.approx(0.2)
    assert "angles (°)" not in table.columns and rows[1]["clock (ms)"] is None
    page = render_report(report)
    assert 'data-layer="views"' in page and page.count("<span data-sensor>") == 2
    outlines = [one["outline"] for one in report.replay["sensors"]]
    assert outlines[0][0] == [-3.0, 0.0] and len(outlines[1]) > 3
    json.dumps(report.replay, allow_nan=False)
    shown = shown_sensors(pair_tracks(TrackSet((estimates_of(track),)), TrackSet((track,))), described)
    figure = plot_pairs(pair_tracks(TrackSet((estimates_of(track),)), TrackSet((track,))), sensors=shown)
    assert {"west", "east"} <= {text.get_text() for text in figure.legends[0].get_texts()}


def test_estimates_are_not_corrected_again_by_the_command(cwd: Path):
    track = seen(covariances=False)
    gt.write(TrackSet((track,)), "rows.csv")
    gt.write(TrackSet((estimates_of(track),)), "smoothed.csv")
    Path("scene.toml").write_text("[sensors.west]\nshift = [5.0, 0.0]\n", encoding="utf-8")
    options = ["smoothed.csv", "--observations", "rows.csv", "--sensors", "scene.toml", "-o", "page.html"]
    ran("report", *options, program="graphtrack")
    (text,) = re.findall('id="replay-data"[^>]*>([^<]*)<', Path("page.html").read_text(encoding="utf-8"))
    data = json.loads(zlib.decompress(base64.b64decode(text)))
    (person,), length = data["people"], data["steps"]["length"]
    n = len(track)
    np.testing.assert_allclose(delta_decode(person["x"], length, n), track.t, atol=1e-3)
    moved = track.position[:, 0] - np.where(track.sensor == "west", 5.0, 0.0)
    np.testing.assert_allclose(delta_decode(person["seen_x"], length, n), moved, atol=1e-3)
