"""Written MCAP files: read here, by rosbags and by another decoder."""

import subprocess
import sys
from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from recordings import STORE
from rosbags.rosbag2 import Reader

import graphtrack as gt
from graphtrack.io.formats.ros_bag import MARKERS
from graphtrack.io.formats.ros_writing import TOPICS
from graphtrack.tracks.table import AsRead
from graphtrack.tracks.time import TimeScale
from graphtrack.tracks.track import Track, TrackSet

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
        np.testing.assert_allclose(back.position_std**2, variance[:, :2].mean(axis=1))
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
