"""Association across sensors: scans of each with a clock of its own, fields of view, and hand-over."""

import json
from typing import Any

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import graphtrack as gt
from graphtrack.association.appearance import Colours
from graphtrack.association.associate import detections_of, rows_of
from graphtrack.association.likelihood import chains_of, link_by, log_between, log_gap, log_misses, scene_of
from graphtrack.association.offline import _Search
from graphtrack.association.online import OnlineAssociation
from graphtrack.association.parallel import evidence_of, join_parallel, tracks_of
from graphtrack.association.scene import gaps_of
from graphtrack.association.sensors import Views, scans_of
from graphtrack.association.tracker import track_rows
from graphtrack.tracks.scene import SceneParameters


def walks(
    seed: int, *, people: int = 5, seconds: float = 12.0, hertz: float = 8.0, reach: float = 30.0
) -> pd.DataFrame:
    """Detections of people on straight ways by two sensors, whose views reach so far over the middle."""
    rng = np.random.default_rng(seed)
    begin = rng.uniform(-6.0, 6.0, (people, 2))
    velocity = np.column_stack([rng.choice([-1.2, 1.2], people), rng.uniform(-0.3, 0.3, people)])
    begin[:, 0] = -0.5 * seconds * velocity[:, 0] + rng.uniform(-2.0, 2.0, people)
    begin[:, 1] = np.linspace(-5.0, 5.0, people)
    rows = []
    for name, phase, sign in (("east", 0.0, 1.0), ("west", 0.45 / hertz, -1.0)):
        for frame in range(round(seconds * hertz)):
            t = phase + frame / hertz
            for person in range(people):
                place = begin[person] + t * velocity[person]
                if sign * place[0] > -reach and rng.random() > 0.1:
                    rows.append(
                        (name, 100 * (name == "west") + frame, t, *(place + 0.1 * rng.normal(size=2)), person)
                    )
    table = pd.DataFrame(rows, columns=["sensor", "frame", "t", "x", "y", "input_true"])
    return table.assign(pos_std=0.1).sort_values("t").reset_index(drop=True)


def purity(found: gt.TrackSet) -> tuple[float, int]:
    """Share of rows in the track that has most of their person, and the number of tracks."""
    table = found.to_table().dropna(subset=["x", "input_true"])
    table = table[table.observed > 0]
    counts = table.groupby(["input_true", "track_id"]).size()
    return counts.groupby("input_true").max().sum() / len(table), table.track_id.nunique()


@given(
    st.lists(st.tuples(st.integers(0, 2), st.integers(0, 30)), min_size=1, max_size=40),
    st.lists(st.floats(0.0, 0.2), min_size=3, max_size=3),
)
@settings(max_examples=100, deadline=None)
def test_scans_are_in_the_order_of_time_with_those_without_detections(rows, phases) -> None:
    sensor, frame = np.array(rows).T
    sensor = np.unique(sensor, return_inverse=True)[1]
    t = frame / 10.0 + np.array(phases)[sensor]
    scans = scans_of(t, frame, sensor)
    assert (np.diff(scans.t) >= 0.0).all() and (np.diff(scans.ordered) > 0.0).all()
    np.testing.assert_allclose(scans.t[scans.number], t, atol=1e-9)
    np.testing.assert_array_equal(scans.sensor[scans.number], sensor)
    np.testing.assert_array_equal(scans.frame[scans.number], frame)
    for one in np.unique(sensor):
        own = np.unique(frame[sensor == one])
        step = np.unique(np.diff(own), return_counts=True) if len(own) > 1 else ([1], [1])
        if len(own) > 1 and step[0][np.argmax(step[1])] == 1:
            assert (scans.sensor == one).sum() == own[-1] - own[0] + 1
        before = np.cumsum(scans.sensor == one) - (scans.sensor == one)
        np.testing.assert_array_equal(scans.before[:, one], before)


def test_scans_outside_of_a_field_of_view_are_no_misses() -> None:
    table = walks(0, reach=-3.0)  # views 6 m apart
    _, detections = detections_of(rows_of(table))
    chains = chains_of(detections)
    rows = rows_of(table)
    link_by(chains, rows.channels["input_true"].astype(int)[detections.row])
    frames, missed = gaps_of(chains, np.zeros(len(table), np.int64))
    assert missed.mean() < 0.2 < 0.4 < frames.mean()
    linked = np.flatnonzero(chains.preceding >= 0)
    across = chains.sensor[linked] != chains.sensor[chains.preceding[linked]]
    # On the way between the views there are many scans, and few misses.
    assert frames[across].min() > 20 and (missed[across] < 0.5 * frames[across]).all()
    views = Views.of(detections.position, detections.sensor, 2)
    scene = scene_of(SceneParameters(), detections.step_seconds)
    scene = scene._replace(views=views.heights, weights=np.ones(2))
    for place in np.flatnonzero(across).tolist():
        m = int(linked[place])
        gap = int(frames[place])
        found = log_between(chains, int(chains.preceding[m]), m, scene)
        assert found == pytest.approx(log_misses(missed[place], gap, scene))
        assert found > log_gap(gap, scene)
    assert log_misses(0.0, 50, scene) == 0.0


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_people_of_two_sensors_are_found_once(seed) -> None:
    table = walks(seed, people=4, seconds=8.0)
    assert purity(gt.associate(table)) == (pytest.approx(1.0, abs=0.02), 4)
    online = track_rows(rows_of(table), gt.OnlineTracker("position"))
    share, tracks = purity(online)
    assert share > 0.95 and tracks <= 5
    assert set(np.unique(online[0].sensor)) == {"east", "west"}
    # A row for each person of each scan, in order.
    assert all((np.diff(track.t) >= 0.0).all() for track in online)


@pytest.mark.slow
def test_trackers_of_sensors_are_joined() -> None:
    table = walks(3)
    own = table.assign(track_id=table.input_true.astype(int) + 1)
    # Ids of the second sensor mean other people.
    own.loc[own.sensor == "west", "track_id"] = 5 - own.track_id[own.sensor == "west"] + 1
    found = gt.read(own, associate="repair")
    assert purity(found) == (pytest.approx(1.0, abs=0.02), 5)


@pytest.mark.slow
def test_a_switch_of_one_tracker_is_mended_by_the_other() -> None:
    table = walks(4)
    own = table.assign(track_id=table.input_true.astype(int) + 1)
    later = (own.sensor == "east") & (own.t > 6.0)
    own.loc[later, "track_id"] = own.track_id[later].replace({1: 2, 2: 1})
    own.loc[own.sensor == "west", "track_id"] += 10
    assert purity(gt.read(own, associate="repair")) == (pytest.approx(1.0, abs=0.02), 5)


def crossings(seed: int, people: int = 12, gap: float = 8.0) -> pd.DataFrame:
    """People who walk from one view into another, ``gap`` metres away, which has other colours."""
    rng = np.random.default_rng(seed)
    looks, change = rng.normal(size=(people, 6)), (np.exp(0.3 * rng.normal(size=6)), rng.normal(size=6))
    rows = []
    for person in range(people):
        speed, y = rng.uniform(1.0, 1.6), rng.uniform(-2.0, 2.0)
        for k in range(round((16.0 + gap) / speed * 8.0)):
            x, t = -8.0 - gap / 2 + speed * k / 8.0, 2.5 * person + k / 8.0
            if abs(x) < gap / 2 or rng.random() < 0.1:
                continue
            look = looks[person] + 0.4 * rng.normal(size=6)
            look = look if x < 0 else change[0] * look + change[1]
            name = "first" if x < 0 else "second"
            rows.append(
                (name, round(8 * t), t, x + 0.1 * rng.normal(), y + 0.1 * rng.normal(), person, *look)
            )
    names = ["sensor", "frame", "t", "x", "y", "input_true", *(f"appearance_{k}" for k in range(6))]
    return pd.DataFrame(rows, columns=names).assign(pos_std=0.1).sort_values("t").reset_index(drop=True)


def kept(found: gt.TrackSet) -> float:
    """Share of people who have one identity in both views."""
    table = found.to_table().dropna(subset=["x", "input_true"])
    most = table.groupby(["input_true", "sensor"]).track_id.agg(lambda ids: ids.mode()[0]).unstack()
    return float((most["first"] == most["second"]).mean())


@pytest.mark.slow
def test_identities_are_kept_between_views_that_do_not_overlap() -> None:
    assert kept(gt.associate(crossings(0))) >= 0.85


@given(st.integers(0, 2**32 - 1), st.integers(2, 4))
@settings(max_examples=30, deadline=None)
def test_a_change_of_colours_is_found_and_removed(seed, size) -> None:
    rng = np.random.default_rng(seed)
    people, each = 30, 4
    looks = np.repeat(rng.normal(size=(people, size)), 2 * each, axis=0)
    identity = np.repeat(np.arange(people), 2 * each)
    sensor = np.tile(np.repeat([0, 1], each), people)
    scale, shift = np.exp(0.3 * rng.normal(size=size)), rng.normal(size=size)
    seen = np.where(sensor[:, None] == 1, scale * looks + shift, looks)
    found = Colours.learned(seen, sensor, identity)
    assert found is not None
    left = found.removed(seen, sensor) - looks
    # Scales are weighed against unchanged ones.
    assert np.abs(left.mean(axis=0)).max() < 0.15 and np.sqrt(np.mean(left**2)) < 0.25
    np.testing.assert_array_equal(found.removed(seen, np.zeros_like(sensor)), seen)
    assert Colours.learned(seen, np.zeros_like(sensor), identity) is None


def test_joining_parallel_tracks_raises_the_evidence() -> None:
    table = walks(5)
    rows, detections = detections_of(rows_of(table))
    search = _Search(detections, {})
    true = rows.channels["input_true"].astype(int)[detections.row]
    # The worst start: a track for each person of each sensor.
    link_by(search.chains, 2 * true + detections.sensor)
    search.filter_from(0)
    before = [evidence_of(search.chains, order, search.packed) for order in tracks_of(search.chains)]
    joints = join_parallel(search.chains, search.packed)
    search.filter_from(0)
    after = [evidence_of(search.chains, order, search.packed) for order in tracks_of(search.chains)]
    assert joints == 5 and len(after) == 5
    assert sum(max(one, 0.0) for one in after) > sum(max(one, 0.0) for one in before)
    for order in tracks_of(search.chains):
        assert len(np.unique(true[order])) == 1 and (np.diff(search.chains.frame[order]) > 0).all()


def test_a_part_of_a_track_is_joined_too() -> None:
    rows, detections = detections_of(rows_of(walks(5)))
    search = _Search(detections, {})
    true = rows.channels["input_true"].astype(int)[detections.row]
    # In the middle third one person's detections by one sensor are in the track of another person.
    t = search.chains.t
    middle = (np.abs(t - t.mean()) < (t[-1] - t[0]) / 6.0) & ((detections.sensor == 0) | (true == 2))
    middle &= (true == 1) | (true == 2)
    mixed = np.where(middle, np.where(true == 1, 2, 5), true)
    link_by(search.chains, mixed)
    search.filter_from(0)
    assert join_parallel(search.chains, search.packed) >= 1
    foreign = 0
    for order in tracks_of(search.chains):
        foreign += len(order) - np.bincount(true[order]).max()
    # The ends of the part are found to a few detections.
    assert foreign < 0.3 * (middle & (true == 1)).sum()


@pytest.mark.slow
def test_an_update_is_a_scan_of_one_sensor() -> None:
    tracker = gt.OnlineTracker("position")
    for k in range(20):
        at = [gt.Observation(t=0.1 * k, position=(0.1 * k, 0.0), sensor="a")]
        tracker.update(0.1 * k, at)
        # Another sensor at the same time, and one that detects nobody.
        both = tracker.update(0.1 * k, [(0.1 * k + 0.05, 0.02)], sensor="b")
        tracker.update(0.1 * k, [], sensor="c")
    assert [one.track_id for one in both] == [1]
    with pytest.raises(gt.InputError, match="a time in seconds after"):
        tracker.update(1.9, [(0.0, 0.0)], sensor="b")
    with pytest.raises(gt.InputError, match="as of other sensors"):
        tracker.update(0.3, [(0.0, 0.0)], sensor="d")
    mixed = [gt.Observation(t=2.7, position=(0.0, 0.0), sensor=name) for name in "ab"]
    with pytest.raises(gt.InputError, match="an update for each sensor"):
        tracker.update(2.7, mixed)


@pytest.mark.slow
def test_a_saved_association_of_sensors_goes_on_to_the_same_bits() -> None:
    table = walks(6, people=3, seconds=5.0)
    whole, stopped = OnlineAssociation(), OnlineAssociation()
    for (t, name), rows in table.groupby(["t", "sensor"], sort=True):
        arguments: Any = t, rows[["x", "y"]].to_numpy(), np.full(len(rows), 0.1)
        expected = whole.update(*arguments, sensor=name)
        found = stopped.update(*arguments, sensor=name)
        np.testing.assert_array_equal(found.identity, expected.identity)
        np.testing.assert_array_equal(found.probability, expected.probability)
        stopped = OnlineAssociation.from_state(json.loads(json.dumps(stopped.state())))
    assert whole.sensors == ["east", "west"] and whole.learned


def test_a_field_of_view_is_the_convex_shape_of_what_was_detected() -> None:
    rng = np.random.default_rng(0)
    position = np.concatenate([rng.uniform(0.0, 10.0, (4000, 2)), rng.uniform(20.0, 30.0, (4000, 2))])
    views = Views.of(position, np.repeat([0, 1], 4000), 2)
    found = views.at(np.array([[5.0, 5.0], [25.0, 25.0], [15.0, 15.0], [12.0, 5.0]]))
    np.testing.assert_allclose(found, [[1.0, 0.0], [0.0, 1.0], [0.0, 0.0], [0.0, 0.0]])
