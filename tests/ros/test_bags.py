"""ROS 2 recordings that rosbags wrote, as tracks."""

import math
import re

import numpy as np
import pytest
from command import ran
from recordings import (
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
from rosbags.rosbag2 import StoragePlugin

import graphtrack as gt

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
    np.testing.assert_allclose(track.position_std, math.sqrt((0.04 + 0.09) / 2))
    np.testing.assert_allclose(track.score, 0.75)
    assert track.head is None


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
def test_cameras_that_overlap_see_each_person_once(tmp_path, offset, split):
    tracks = gt.read(record(tmp_path / "bag", cameras(offset, split)))
    assert sorted(round(float(np.mean(one.position[:, 1]))) for one in tracks) == [0, 3, 6]
    assert all(len(one) == 20 for one in tracks)
    assert tracks.summary.refused == {"repeated with the same stamp": 20}
    assert len({t for one in tracks for t in one.t.tolist()}) == 20


def test_detections_of_one_fast_sensor_stay_apart(tmp_path):
    times = [0.004 * k for k in range(100)]
    told = [(t, make(POSES, header=header(t), poses=[pose(t, 0.0, 0.1)])) for t in times]
    (track,) = gt.read(record(tmp_path / "bag", {"/poses": told}))
    assert len(track) == 100


def test_recordings_of_ros_1_are_named(tmp_path):
    old = tmp_path / "old.bag"
    old.write_bytes(b"#ROSBAG V2.0\n" + bytes(range(256)))
    with pytest.raises(gt.InputError, match=r"ROS 1.*rosbags-convert"):
        gt.read(old)
    with pytest.raises(gt.InputError, match="text"):
        gt.read(old.replace(tmp_path / "old.csv"))


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
    # The mean of both variances does not depend on the turn.
    np.testing.assert_allclose(map_.position_std, math.sqrt(0.025))
    as_it_stands = gt.read(bag)
    assert any("--fixed-frame" in note for note in as_it_stands.summary.notes)
    with pytest.raises(
        gt.InputError, match=r"no tf between 'laser' and 'moon', expected one of base_link, laser, map, odom"
    ):
        gt.read(bag, fixed_frame="moon")


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
