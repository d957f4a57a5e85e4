"""ROS 2 recordings that rosbags wrote, as tracks."""

import math
import re
import subprocess
import sys
from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
from command import ran
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from recordings import (
    START,
    STORE,
    covariance,
    detection,
    detections,
    header,
    make,
    nanoseconds,
    people,
    person,
    pose,
    quaternion,
    record,
    transform,
    transforms,
    turned,
)
from rosbags.rosbag2 import Reader, StoragePlugin

import graphtrack as gt
from graphtrack.io.formats.ros.bag import MARKERS
from graphtrack.io.formats.ros.reading import rows_of_bag
from graphtrack.io.formats.ros.writing import TOPICS
from graphtrack.io.options import ReadOptions
from graphtrack.tracks.table import AsRead
from graphtrack.tracks.time import TimeScale
from graphtrack.tracks.track import Track, TrackSet

TIMES = [0.1 * k for k in range(20)]


def walkers(frame="map", names=("anna", "ben")):
    """Two people who walk along x, a metre apart."""
    return [
        (t, people(t, [person(name, t + k, float(k), 0.5) for k, name in enumerate(names)], frame))
        for t in TIMES
    ]


@pytest.mark.parametrize("plugin", StoragePlugin)
def test_people_keep_their_names_places_and_times(tmp_path, plugin):
    tracks = gt.read(record(tmp_path / "bag", {"/people": walkers()}, plugin))
    assert [one.label for one in tracks] == ["anna", "ben"]
    np.testing.assert_allclose(
        tracks.by_id(2).position, np.column_stack([np.array(TIMES) + 1.0, np.ones(20)])
    )
    np.testing.assert_allclose(np.diff(tracks.by_id(1).t), 0.1, atol=1e-9)
    origin = tracks.as_read.time.origin
    assert origin + round(tracks.by_id(1).t[3] * 1e9) == nanoseconds(TIMES[3])
    np.testing.assert_array_equal(tracks.by_id(1).score, 0.5)
    assert tracks.summary.rows_read == tracks.summary.rows_used == 40


def test_a_file_of_a_bag_is_read_as_the_bag(tmp_path):
    for plugin, suffix in ((StoragePlugin.MCAP, "mcap"), (StoragePlugin.SQLITE3, "db3")):
        folder = record(tmp_path / suffix, {"/people": walkers()}, plugin)
        whole, alone = gt.read(folder), gt.read(folder / f"{suffix}.{suffix}")
        np.testing.assert_array_equal(whole.by_id(1).position, alone.by_id(1).position)


def test_identities_that_are_numbers_in_one_recording_and_text_in_the_next_are_refused(tmp_path):
    first = record(tmp_path / "first", {"/people": walkers(names=("7", "12"))})
    second = record(tmp_path / "second", {"/people": walkers()})
    with pytest.raises(gt.InputError, match=r"identities that are numbers in .*first and text in .*second"):
        gt.read([first, second])


def test_detections_say_orientation_spread_and_score(tmp_path):
    spread = covariance(0.04, 0.09, 0.2)
    told = [(t, detections(t, [detection("a", t, 2.0, 1.2, spread)])) for t in TIMES]
    (track,) = gt.read(record(tmp_path / "bag", {"/detections": told}))
    np.testing.assert_allclose(track.body, 1.2)
    np.testing.assert_allclose(track.body_kappa, 1 / 0.2)
    assert track.position_std is None
    np.testing.assert_allclose(track.position_covariance, [np.diag([0.04, 0.09])] * 20, atol=1e-12)
    np.testing.assert_allclose(track.score, 0.75)
    assert track.head is None


def test_tracked_people_have_bodies_where_their_yaw_is_known(tmp_path):
    def tracked(t, variance):
        where = [
            make(
                "geometry_msgs/msg/PoseWithCovariance",
                pose=pose(t + k, float(k), 0.5),
                covariance=covariance(0.04, 0.09, yaw),
            )
            for k, yaw in enumerate(variance)
        ]
        given = [
            make("spencer_tracking_msgs/msg/TrackedPerson", track_id=7 + k, pose=one)
            for k, one in enumerate(where)
        ]
        return make("spencer_tracking_msgs/msg/TrackedPersons", header=header(t), tracks=given)

    messages = [(t, tracked(t, (0.1, 99999.0))) for t in TIMES]
    tracks = gt.read(record(tmp_path / "bag", {"/tracked": messages}))
    known, unknown = tracks.by_id(7), tracks.by_id(8)
    np.testing.assert_allclose(known.position, np.column_stack([TIMES, np.zeros(20)]), atol=1e-12)
    np.testing.assert_allclose(known.body, 0.5)
    np.testing.assert_allclose(known.body_kappa, 10.0)
    assert unknown.body is None or np.isnan(unknown.body).all()
    np.testing.assert_allclose(unknown.position[:, 1], 1.0)


def test_classes_of_detections_are_picked(tmp_path):
    nothing = np.zeros(36)
    pair = [detection("a", 0.0, 0.0, 0.5, nothing), detection("b", 5.0, 5.0, 0.5, nothing, "dog")]
    told = [(t, detections(t, pair)) for t in TIMES]
    bag = record(tmp_path / "bag", {"/detections": told})
    both, dogs = gt.read(bag), gt.read(bag, classes="dog")
    assert len(both) == 2 and any("dog, person" in note for note in both.summary.notes)
    assert [one.label for one in dogs] == ["b"]
    assert dogs.summary.refused == {"of another class": 20}
    assert dogs.by_id(1).position_std is None and dogs.by_id(1).body_kappa is None


def test_poses_without_names_are_told_apart(tmp_path):
    kind = "geometry_msgs/msg/PoseArray"
    told = [(t, make(kind, header=header(t), poses=[pose(t, 0.0, 0.1), pose(-t, 9.0, 3.0)])) for t in TIMES]
    bag = record(tmp_path / "bag", {"/poses": told})
    tracks = gt.read(bag)
    assert len(tracks) == 2 and tracks.n_frames == 40
    assert sorted(round(float(one.body[0]), 6) for one in tracks) == [0.1, 3.0]
    with pytest.raises(gt.InputError, match="rows without identities"):
        gt.read(bag, associate="never")


def test_a_topic_of_poses_is_one_person_and_a_pattern_several(tmp_path):
    kind, spread = "geometry_msgs/msg/PoseWithCovariance", covariance(0.01, 0.01)

    def told(y):
        where = [make(kind, pose=pose(t, y, 0.3), covariance=spread) for t in TIMES]
        return [
            (t, make(f"{kind}Stamped", header=header(t), pose=one))
            for t, one in zip(TIMES, where, strict=True)
        ]

    bag = record(tmp_path / "bag", {"/p1/pose": told(0.0), "/p2/pose": told(4.0)})
    assert [one.label for one in gt.read(bag)] == ["/p1/pose", "/p2/pose"]
    (one,) = gt.read(bag, topic="/p2/pose")
    assert one.label == "/p2/pose" and one.position[0, 1] == 4.0
    np.testing.assert_allclose(one.position_std, 0.1)
    assert [one.label for one in gt.read(bag, topic="/p*/pose")] == ["/p1/pose", "/p2/pose"]


def test_orientations_that_nobody_set_are_none(tmp_path):
    told = [(t, make("geometry_msgs/msg/PoseStamped", header=header(t), pose=pose(t, 0.0))) for t in TIMES]
    tracks = gt.read(record(tmp_path / "bag", {"/pose": told}))
    assert tracks.by_id(1).body is None
    assert any("treated as unknown" in note for note in tracks.summary.notes)


def test_topics_of_one_type_are_read_together_and_their_names_kept_apart(tmp_path):
    other = [(t + 0.002, people(t + 0.001, [person("anna", t, 8.0)])) for t in TIMES]
    bag = record(tmp_path / "bag", {"/left/people": walkers(), "/right/people": other})
    tracks = gt.read(bag)
    names = ["/left/people/anna", "/left/people/ben", "/right/people/anna"]
    assert [one.label for one in tracks] == names and tracks.summary.rows_used == 60
    assert any("topics /left/people, /right/people (people_msgs" in note for note in tracks.summary.notes)
    for asked in (["/right/people", "/left/people"], ["/*/people"], "/*/people"):
        assert sorted(one.label for one in gt.read(bag, topic=asked)) == names
    assert [one.label for one in gt.read(bag, topic=["/left/people"])] == ["anna", "ben"]
    with pytest.raises(gt.InputError, match="no topic /centre"):
        gt.read(bag, topic=["/left/people", "/centre"])
    done = ran("info", bag, "--topic", "/left/people", "--topic", "/right/people", program="graphtrack")
    assert "60 person-frames" in done.stdout


def test_topics_of_different_types_are_read_if_asked_for(tmp_path):
    told = [(t, detections(t, [detection("c", t, 9.0, 0.3, covariance(0.01, 0.01))])) for t in TIMES]
    bag = record(tmp_path / "bag", {"/people": walkers(), "/detections": told})
    with pytest.raises(gt.InputError, match=r"2 topics with people, of different types.*once for each"):
        gt.read(bag)
    tracks = gt.read(bag, topic=["/people", "/detections"])
    assert [one.label for one in tracks] == ["/people/anna", "/people/ben", "/detections/c"]
    poses = [(t, make(POSES, header=header(t), poses=[pose(t, 0.0)])) for t in TIMES]
    bag = record(tmp_path / "mixed", {"/people": walkers(), "/poses": poses})
    with pytest.raises(gt.InputError, match="topics with the names of people, and topics without"):
        gt.read(bag, topic=["/people", "/poses"])


POSES = "geometry_msgs/msg/PoseArray"


def cameras(offset, split, noise=0.02):
    """Poses of three people by two cameras: people 0 and 1, and people 1 and 2."""
    rng = np.random.default_rng(0)
    told = {topic: [] for topic in ("/a", "/b" if split else "/a")}
    for t in TIMES:
        for topic, delay, seen in (("/a", 0.0, (0, 1)), ("/b" if split else "/a", offset, (1, 2))):
            where = [pose(t + rng.normal(0.0, noise), 3.0 * k + rng.normal(0.0, noise), 0.2) for k in seen]
            told[topic].append((t + delay, make(POSES, header=header(t + delay), poses=where)))
    return told


@pytest.mark.parametrize(("offset", "split"), [(0.0, False), (0.0, True), (0.004, True)])
def test_cameras_that_overlap_are_sensors_that_see_each_person_once(tmp_path, offset, split):
    tracks = gt.read(record(tmp_path / "bag", cameras(offset, split)))
    assert sorted(round(float(np.mean(one.position[:, 1]))) for one in tracks) == [0, 3, 6]
    # Nothing is dropped or averaged: the second person has the rows of both.
    assert sorted(len(one) for one in tracks) == [20, 20, 40] and not tracks.summary.refused
    names = {name for one in tracks for name in one.sensor.tolist()}
    assert names == ({"/a", "/b"} if split else {"", "#2"})
    assert len({t for one in tracks for t in one.t.tolist()}) == (40 if offset else 20)


def test_repeated_messages_are_counted_and_frames_of_a_topic_are_sensors(tmp_path):
    told = cameras(0.0, False)["/a"]
    twice = [one for one in told for _ in range(2)]
    tracks = gt.read(record(tmp_path / "bag", {"/a": twice}))
    assert tracks.summary.refused == {"repeated with the same stamp": 80}
    assert sorted(len(one) for one in tracks) == [20, 20, 40]
    frames = [
        (t, make(POSES, header=header(t, frame), poses=[pose(t, 3.0 * k)]))
        for t in TIMES
        for k, frame in enumerate(("left", "right"))
    ]
    still = [
        (0.0, transforms(transform(0.0, "map", name, 0.0, 0.0, turned(0.0)))) for name in ("left", "right")
    ]
    bag = record(tmp_path / "frames", {"/poses": frames, "/tf_static": still})
    tracks = gt.read(bag, fixed_frame="map")
    assert sorted(set(one.sensor.tolist()) for one in tracks) == [{""}, {"right"}]


def test_people_of_several_topics_have_their_sensor_and_one_topic_has_none(tmp_path):
    other = [(t + 0.002, people(t, [person("anna", t, 8.0)])) for t in TIMES]
    bag = record(tmp_path / "bag", {"/left/people": walkers(), "/right/people": other})
    found = {one.label: set(one.sensor.tolist()) for one in gt.read(bag)}
    assert found["/left/people/anna"] == {"/left/people"} and found["/right/people/anna"] == {"/right/people"}
    assert all(one.sensor is None for one in gt.read(bag, topic="/left/people"))


def test_each_sensor_has_frame_numbers_of_its_own(tmp_path):
    """Two sensors at other rates: no frame without detections comes between those of one of them."""
    rng, told = np.random.default_rng(0), {"/a": [], "/b": []}
    for topic, hz in (("/a", 10.0), ("/b", 12.5)):
        for k in range(int(8 * hz)):
            t = k / hz + rng.uniform(0.0, 0.002)
            told[topic].append((t, make(POSES, header=header(t), poses=[pose(1.2 * t, 0.0, 0.1)])))
    rows = rows_of_bag(record(tmp_path / "bag", told), ReadOptions())
    for topic in told:
        assert set(np.diff(rows.frame[rows.sensor == topic]).tolist()) == {1}


def test_covariances_are_ellipses_in_the_fixed_frame(tmp_path):
    told = [
        (t, detections(t, [detection("7", t, 0.0, 0.0, covariance(0.25, 0.01))], "camera")) for t in TIMES
    ]
    still = [(0.0, transforms(transform(0.0, "map", "camera", 0.0, 0.0, turned(math.pi / 2))))]
    bag = record(tmp_path / "bag", {"/detections": told, "/tf_static": still})
    (track,) = gt.read(bag, fixed_frame="map")
    assert track.position_std is None
    np.testing.assert_allclose(
        track.position_covariance, np.tile(np.diag([0.01, 0.25]), (20, 1, 1)), atol=1e-9
    )


def test_detections_of_one_fast_sensor_stay_apart(tmp_path):
    times = [0.004 * k for k in range(100)]
    told = [(t, make(POSES, header=header(t), poses=[pose(t, 0.0, 0.1)])) for t in times]
    (track,) = gt.read(record(tmp_path / "bag", {"/poses": told}))
    assert len(track) == 100


def turning_robot(rate=0.5, speed=1.0, static=0.3):
    """tf of a robot that drives along x of odom and turns, its laser 0.2 m before it, and odom in map."""
    moving = [
        (t, transforms(transform(t, "odom", "base_link", speed * t, 0.0, turned(rate * t))))
        for t in np.arange(-0.05, 2.2, 0.1).tolist()
    ]
    fixed = transforms(
        transform(0.0, "base_link", "laser", 0.2, 0.0, turned(static)),
        transform(0.0, "map", "odom", 5.0, 6.0, turned(math.pi / 2)),
    )
    return {"/tf": moving, "/tf_static": [(0.0, fixed)]}


def test_tf_brings_people_to_the_fixed_frame(tmp_path):
    def seen(t):
        """The laser's measurement of a person who stands at (3, 2) in odom and faces 1 rad."""
        angle = 0.5 * t + 0.3
        back = np.array([[math.cos(angle), math.sin(angle)], [-math.sin(angle), math.cos(angle)]])
        laser = np.array([t + 0.2 * math.cos(0.5 * t), 0.2 * math.sin(0.5 * t)])
        x, y = back @ (np.array([3.0, 2.0]) - laser)
        return detection("a", float(x), float(y), 1.0 - angle, covariance(0.04, 0.01, 0.1))

    told = [(t, detections(t, [seen(t)], "laser")) for t in TIMES]
    bag = record(tmp_path / "bag", {"/detections": told} | turning_robot())
    (odom,) = gt.read(bag, fixed_frame="odom")
    # Between two tellings of tf the robot is taken to turn and drive steadily, as it does.
    np.testing.assert_allclose(odom.position, np.tile([3.0, 2.0], (20, 1)), atol=1e-6)
    np.testing.assert_allclose(odom.body, 1.0, atol=1e-6)
    (map_,) = gt.read(bag, fixed_frame="/map")
    np.testing.assert_allclose(map_.position, np.tile([5.0 - 2.0, 6.0 + 3.0], (20, 1)), atol=1e-6)
    np.testing.assert_allclose(map_.body, 1.0 + math.pi / 2, atol=1e-6)
    for t, ellipse in zip(TIMES, map_.position_covariance, strict=True):
        angle = 0.5 * t + 0.3 + math.pi / 2
        turn = np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])
        np.testing.assert_allclose(ellipse, turn @ np.diag([0.04, 0.01]) @ turn.T, atol=1e-6)
    as_it_stands = gt.read(bag)
    assert any("--fixed-frame" in note for note in as_it_stands.summary.notes)
    assert not any("WARNING" in note for note in as_it_stands.summary.notes)  # a laser may stand still
    with pytest.raises(
        gt.InputError, match=r"no tf between 'laser' and 'moon', expected one of base_link, laser, map, odom"
    ):
        gt.read(bag, fixed_frame="moon")


def test_tf_of_a_bag_turns_rows_of_a_table_into_the_world(tmp_path):
    """Columns sensor are frames; rows without one are in base_link. Both see somebody who stands in odom."""
    bag = record(tmp_path / "bag", {"/people": walkers()} | turning_robot())
    rows = []
    for k, t in enumerate(TIMES):
        for sensor, ahead, mounted in (("laser", 0.2, 0.3), ("", 0.0, 0.0)):
            place = np.array([t + ahead * math.cos(0.5 * t), ahead * math.sin(0.5 * t)])
            angle = 0.5 * t + mounted
            back = np.array([[math.cos(angle), math.sin(angle)], [-math.sin(angle), math.cos(angle)]])
            x, y = back @ (np.array([3.0, 2.0]) - place)
            stamp = START / 1e9 + t
            rows.append({"track_id": 1, "frame": k, "t": stamp, "x": x, "y": y, "sensor": sensor})
    names = list(rows[0])
    table = {name: [row[name] for row in rows] for name in names}
    (track,) = gt.read(table, poses=bag, fixed_frame="odom")
    np.testing.assert_allclose(track.position, np.tile([3.0, 2.0], (len(rows), 1)), atol=1e-4)
    (track,) = gt.read(table, poses=bag)  # in map, the first of REP 105's names
    np.testing.assert_allclose(track.position, np.tile([3.0, 9.0], (len(rows), 1)), atol=1e-4)
    with pytest.raises(gt.InputError, match="no fixed frame 'moon'"):
        gt.read(table, poses=bag, fixed_frame="moon")
    with pytest.raises(gt.InputError, match="no fixed frame 'map', expected --fixed-frame"):
        gt.read(table, poses=record(tmp_path / "other", {"/people": walkers()}))


def test_rows_at_times_without_tf_are_counted(tmp_path):
    known = {"/tf": turning_robot()["/tf"][:10]}
    tracks = gt.read(record(tmp_path / "bag", {"/people": walkers("base_link")} | known), fixed_frame="odom")
    lost = tracks.summary.refused["at a time without tf"]
    assert 0 < lost < 40 and tracks.summary.rows_used == 40 - lost


def test_humans_are_where_tf_has_their_frames(tmp_path):
    ids = [(t, make("hri_msgs/msg/IdsList", header=header(t, ""), ids=["ann"])) for t in TIMES]
    # The gaze frame has z ahead, x to the right and y down: here z along y of the map.
    gaze = quaternion(-math.sqrt(0.5), 0.0, 0.0, math.sqrt(0.5))
    told = [
        (
            t,
            transforms(
                transform(t, "map", "person_ann", t, 1.0, turned(0.0)),
                transform(t, "map", "body_b1", t, 1.0, turned(0.7)),
                transform(t, "map", "gaze_f1", t, 1.0, gaze),
            ),
        )
        for t in TIMES
    ]
    match = {
        f"/humans/persons/ann/{part}_id": [(0.0, make("std_msgs/msg/String", data=name))]
        for part, name in (("face", "f1"), ("body", "b1"))
    }
    bag = record(tmp_path / "bag", {"/humans/persons/tracked": ids, "/tf": told} | match)
    with pytest.raises(gt.InputError, match="--fixed-frame"):
        gt.read(bag)
    (track,) = gt.read(bag, fixed_frame="map")
    assert track.label == "ann"
    np.testing.assert_allclose(track.position[:, 0], TIMES, atol=1e-6)
    np.testing.assert_allclose(track.body, 0.7, atol=1e-9)
    np.testing.assert_allclose(track.head, math.pi / 2, atol=1e-9)


def test_a_topic_of_another_type_is_told_with_those_there_are(tmp_path):
    other = {"/chatter": [(0.0, make("std_msgs/msg/String", data="hello"))]}
    with pytest.raises(gt.InputError, match=r"no topic with people.*/chatter \(std_msgs/msg/String\)"):
        gt.read(record(tmp_path / "first", other))
    bag = record(tmp_path / "second", {"/people": walkers()} | other)
    assert len(gt.read(bag)) == 2
    for topic in ("/chatter", "/nobody"):
        with pytest.raises(gt.InputError, match=topic):
            gt.read(bag, topic=topic)


def test_frames_of_reference_that_differ_are_refused(tmp_path):
    mixed = walkers()[:10] + walkers("odom")[10:]
    with pytest.raises(gt.InputError, match=r"frames 'map' and 'odom', expected --fixed-frame"):
        gt.read(record(tmp_path / "bag", {"/people": mixed}))


@pytest.mark.parametrize("jump", [-30.0, 1e6])
def test_a_clock_that_jumps_is_told_with_the_message(tmp_path, jump):
    told = walkers()
    told[10:] = [(t, people(t + jump, message.people)) for t, message in told[10:]]
    said = f"line 11, column /people: found a clock that jumps by {jump + 0.1:+.6g} s"
    with pytest.raises(gt.InputError, match=re.escape(said)):
        gt.read(record(tmp_path / "bag", {"/people": told}))


def test_messages_that_overtake_each_other_are_put_in_order(tmp_path):
    told = walkers()
    told[4], told[5] = told[5], told[4]
    tracks = gt.read(record(tmp_path / "bag", {"/people": told}))
    np.testing.assert_allclose(tracks.by_id(1).position[:, 0], TIMES)


def test_without_stamps_times_are_those_of_the_recording(tmp_path):
    told = walkers()
    for _, message in told:
        message.header.stamp = make("builtin_interfaces/msg/Time")
    tracks = gt.read(record(tmp_path / "bag", {"/people": told}))
    np.testing.assert_allclose(np.diff(tracks.by_id(1).t), 0.1, atol=1e-9)


@pytest.mark.parametrize("plugin", StoragePlugin)
@pytest.mark.parametrize("part", [0.0005, 0.3, 0.9, 0.999])
def test_recordings_that_are_cut_are_told(tmp_path, plugin, part):
    folder = record(tmp_path / "bag", {"/people": walkers()}, plugin)
    (data,) = (one for one in folder.iterdir() if one.suffix != ".yaml")
    whole = data.read_bytes()
    data.write_bytes(whole[: int(len(whole) * part)])
    with pytest.raises(gt.InputError, match="bag"):
        gt.read(folder)


@pytest.mark.parametrize(
    ("links", "frame", "said"), [(("ab", "ba"), "a", "circle"), (("ab", "cb"), "b", "in 'a' and in 'c'")]
)
def test_tf_in_a_circle_and_of_two_parents_are_told(tmp_path, links, frame, said):
    told = transforms(*(transform(0.0, *link, 1.0, 0.0, turned(0.0)) for link in links))
    bag = record(tmp_path / "bag", {"/people": walkers(frame), "/tf": [(0.0, told)]})
    with pytest.raises(gt.InputError, match=said):
        gt.read(bag, fixed_frame="map")


def test_options_of_recordings_with_another_file_and_the_reverse_are_refused(tmp_path):
    table = tmp_path / "tracks.csv"
    table.write_text("track_id,frame,t,x,y\n1,0,0,0,0\n1,1,0.1,1,0\n")
    with pytest.raises(gt.InputError, match="no ROS 2 recording"):
        gt.read(table, topic="/people")
    bag = record(tmp_path / "bag", {"/people": walkers()})
    with pytest.raises(gt.InputError, match="for the format bag"):
        gt.read(bag, units="cm")
    with pytest.raises(gt.InputError, match="format 'csv'"):
        gt.read(bag, format="csv")


N = 12


def estimates(n=N, people=3):
    """People whose every quantity is another number; the last is there in the second half alone."""
    rng = np.random.default_rng(3)
    tracks = []
    for k in range(people):
        root = rng.normal(size=(n, 6, 6)) * 0.1
        track = Track(
            k + 1,
            np.arange(n),
            0.1 * np.arange(n),
            rng.normal(size=(n, 2)) + 5.0 * k,
            velocity=rng.normal(size=(n, 2)),
            body=rng.uniform(-3.0, 3.0, n),
            head=rng.uniform(-3.0, 3.0, n),
            covariance=root @ root.transpose(0, 2, 1) + 0.01 * np.eye(6),
            label=f"person {k}",
        )
        tracks.append(track if k < people - 1 else track[n // 2 :])
    return TrackSet(tuple(tracks))


def decoded(path):
    """(topic, type) → messages, by the decoder of mcap-ros2-support."""
    found = {}
    with path.open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()], validate_crcs=True)
        for schema, channel, message, content in reader.iter_decoded_messages():
            found.setdefault((channel.topic, schema.name), []).append((message.log_time, content))
    return found


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    path = tmp_path_factory.mktemp("mcap") / "people.mcap"
    gt.write(estimates(), path)
    return path


def test_positions_orientations_and_spreads_come_back(written):
    tracks, truth = gt.read(written), estimates()
    assert [one.track_id for one in tracks] == [1, 2, 3]
    for one in truth:
        back = tracks.by_id(one.track_id)
        np.testing.assert_allclose(back.t, one.t, atol=1e-9)
        np.testing.assert_array_equal(back.position, one.position)
        np.testing.assert_allclose(back.body, one.body)
        np.testing.assert_allclose(back.head, one.head)
        variance = np.diagonal(one.covariance, axis1=1, axis2=2)
        spread = one.covariance[:, :2, :2]
        for k, ellipse in enumerate(np.broadcast_to(np.nan, (len(one), 2, 2))):
            if back.position_covariance is not None:
                ellipse = back.position_covariance[k]
            if np.isnan(ellipse).any():
                ellipse = back.position_std[k] ** 2 * np.eye(2)
            np.testing.assert_allclose(ellipse, spread[k], rtol=1e-6, atol=1e-12)
        np.testing.assert_allclose(1.0 / back.body_kappa, variance[:, 4])
        np.testing.assert_allclose(1.0 / back.head_kappa, variance[:, 5])


def test_rosbags_reads_the_same_as_another_decoder(written):
    found = decoded(written)
    assert set(found) == set(TOPICS.items())
    counts = Counter()
    with Reader(written) as reader:
        assert {one.topic: one.msgtype for one in reader.connections} == dict(TOPICS)
        for connection, stamp, raw in reader.messages():
            ours = STORE.deserialize_cdr(raw, connection.msgtype)
            at, theirs = found[connection.topic, connection.msgtype][counts[connection.topic]]
            counts[connection.topic] += 1
            assert at == stamp
            assert_same(ours, theirs)
    assert counts == {topic: len(found[topic, kind]) for topic, kind in TOPICS.items()}
    assert counts["/graphtrack/people"] == N


def assert_same(ours, theirs):
    """Two messages of different decoders have the same content."""
    if hasattr(ours, "__msgtype__"):
        for name in ours.__dataclass_fields__:
            if name not in ("__msgtype__", "structure_needs_at_least_one_member"):
                if name not in type(ours).__annotations__ or "ClassVar" in str(
                    type(ours).__annotations__[name]
                ):
                    continue
                assert_same(getattr(ours, name), getattr(theirs, name))
    elif isinstance(ours, list):
        assert len(ours) == len(theirs)
        for a, b in zip(ours, theirs, strict=True):
            assert_same(a, b)
    elif isinstance(ours, np.ndarray):
        np.testing.assert_array_equal(ours, np.array(theirs))
    else:
        assert ours == theirs


def test_arrows_point_where_people_go_and_look(written):
    truth = estimates()
    (markers,) = (told for (_, kind), told in decoded(written).items() if kind == MARKERS)
    stamps = [stamp for stamp, _ in markers]
    assert np.diff(stamps).min() >= 95_000_000
    _, message = markers[0]
    assert message.markers[0].action == 3
    for name, angle in (("body", truth.by_id(1).body[0]), ("head", truth.by_id(1).head[0])):
        (one,) = (m for m in message.markers if m.ns == name and m.id == 0)
        turn = one.pose.orientation
        assert 2.0 * np.arctan2(turn.z, turn.w) == pytest.approx(angle)
    (way,) = (m for m in message.markers if m.ns == "velocity" and m.id == 0)
    (ellipse,) = (m for m in message.markers if m.ns == "position" and m.id == 0)
    assert ellipse.scale.x >= ellipse.scale.y > 0.0
    (body,) = (m for m in message.markers if m.ns == "person" and m.id == 0)
    assert body.pose.position.x == truth.by_id(1).position[0, 0] and body.pose.position.z > 0.0
    assert [m.text for m in message.markers if m.ns == "label"] == ["person 0", "person 1"]
    assert way.scale.x == pytest.approx(np.hypot(*truth.by_id(1).velocity[0]))


def test_names_and_dates_are_written_as_they_were_read(tmp_path):
    origin = 1_763_892_000 * 10**9
    names = {1: "anna", 2: "ben", 3: "cem"}
    as_read = AsRead({}, TimeScale("number", origin=origin), names=names, frame="odom")
    gt.write(replace(estimates(), as_read=as_read), tmp_path / "people.mcap")
    back = gt.read(tmp_path / "people.mcap")
    assert [one.label for one in back] == ["anna", "ben", "cem"]
    assert back.as_read.time.origin + round(back.by_id(1).t[0] * 1e9) == origin
    gt.write(back, tmp_path / "again.mcap")
    (drawn,) = (told for (_, kind), told in decoded(tmp_path / "again.mcap").items() if kind == MARKERS)
    assert {one.header.frame_id for _, message in drawn for one in message.markers} == {"odom"}
    np.testing.assert_array_equal(gt.read(tmp_path / "again.mcap").by_id(2).t, back.by_id(2).t)
    gt.write(back, tmp_path / "people.csv")
    table = gt.read(tmp_path / "people.csv")
    assert table.by_id(1).label == "anna" and table.by_id(1).t[0] == pytest.approx(origin / 1e9)


def test_times_that_ros_cannot_hold_are_refused(tmp_path):
    for t in (-1.0, 3e9):
        track = Track(1, np.arange(2), np.array([t, t + 1.0]), np.zeros((2, 2)))
        with pytest.raises(gt.InputError, match="1970 to 2038"):
            gt.write(track, tmp_path / "people.mcap")
    assert not list(tmp_path.iterdir())


def test_without_the_extra_the_error_names_it(tmp_path):
    code = "import sys; sys.modules['rosbags'] = None\nimport graphtrack as gt, numpy as np\n"
    code += "track = gt.Track(1, np.arange(2), np.arange(2.0), np.zeros((2, 2)))\n"
    code += f"try: gt.write(track, {str(tmp_path / 'people.mcap')!r})\n"
    code += "except gt.InputError as error: print(error)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120)
    assert "graphtrack[ros]" in done.stdout, done.stderr


def test_heads_that_nobody_knows_are_written_and_read_as_none(tmp_path):
    smoothed = gt.smooth(gt.TrackSet((walk_of(30),)), "joint")
    gt.write(smoothed, tmp_path / "tracks.mcap")
    (back,) = gt.read(tmp_path / "tracks.mcap")
    assert np.isfinite(smoothed[0].head).all() and smoothed[0].std("head").min() > 1.8
    assert back.head is None or np.isnan(back.head).all()


def walk_of(n):
    t = 0.1 * np.arange(n)
    return Track(1, np.arange(n), t, np.column_stack([0.0 * t, 0.0 * t]))
