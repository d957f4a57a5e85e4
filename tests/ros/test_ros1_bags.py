"""Recordings of ROS 1 that rosbags wrote, as tracks."""

import math

import numpy as np
import pytest
from recordings import START, covariance, nanoseconds
from rosbags.rosbag1 import Writer as Ros1Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

import graphtrack as gt
from graphtrack.io.formats.ros.bag import DETECTIONS, FIELDS, PEOPLE, TRANSFORMS
from graphtrack.io.formats.ros.writing import Made
from graphtrack.limits import MemoryLimit


def ros1(path, compression=None):
    """A recording of ROS 1 with people, detections of its vision_msgs, and the tf of a camera."""
    store = get_typestore(Stores.ROS1_NOETIC)
    for name in ("people_msgs/msg/People", "people_msgs/msg/Person"):
        store.register(get_types_from_msg("\n".join(FIELDS[name].split("; ")), name))
    store.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", TRANSFORMS))
    pose_type = "geometry_msgs/PoseWithCovariance pose"
    for name, fields in {
        "ObjectHypothesisWithPose": f"int64 id\nfloat64 score\n{pose_type}",
        "BoundingBox3D": "geometry_msgs/Pose center\ngeometry_msgs/Vector3 size",
        "Detection3D": "std_msgs/Header header\nvision_msgs/ObjectHypothesisWithPose[] results\n"
        "vision_msgs/BoundingBox3D bbox\nbool is_tracking\nstring tracking_id",
        "Detection3DArray": "std_msgs/Header header\nvision_msgs/Detection3D[] detections",
    }.items():
        store.register(get_types_from_msg(fields, f"vision_msgs/msg/{name}"))
    one = Made(store)

    def header(t, frame):
        stamp = one("builtin_interfaces/msg/Time", sec=START // 10**9 + int(t), nanosec=round(t % 1 * 1e9))
        return one("std_msgs/msg/Header", stamp=stamp, frame_id=frame)

    def pose_of(x, y):
        place = one("geometry_msgs/msg/Point", x=x, y=y)
        return one(
            "geometry_msgs/msg/Pose", position=place, orientation=one("geometry_msgs/msg/Quaternion", w=1.0)
        )

    writer = Ros1Writer(path)
    if compression is not None:
        writer.set_compression(compression)
    with writer:
        topics = {"/people": PEOPLE, "/boxes": DETECTIONS, "/tf": TRANSFORMS}
        connections = {
            name: writer.add_connection(name, kind, typestore=store) for name, kind in topics.items()
        }
        for k in range(30):
            t, x = 0.1 * k, 0.12 * k
            turned = one("geometry_msgs/msg/Quaternion", z=math.sqrt(0.5), w=math.sqrt(0.5))
            of = one(
                "geometry_msgs/msg/Transform",
                translation=one("geometry_msgs/msg/Vector3", x=5.0),
                rotation=turned,
            )
            stamped = one(
                "geometry_msgs/msg/TransformStamped",
                header=header(t, "map"),
                child_frame_id="odom",
                transform=of,
            )
            person = one("people_msgs/msg/Person", name="ann", position=one("geometry_msgs/msg/Point", x=x))
            posed = one(
                "geometry_msgs/msg/PoseWithCovariance",
                pose=pose_of(x, 1.0),
                covariance=covariance(0.01, 0.01),
            )
            result = one("vision_msgs/msg/ObjectHypothesisWithPose", id=3, score=0.8, pose=posed)
            box = one("vision_msgs/msg/Detection3D", results=[result], tracking_id="ann")
            told = {
                "/people": one(PEOPLE, header=header(t, "odom"), people=[person]),
                "/boxes": one(DETECTIONS, header=header(t, "odom"), detections=[box]),
                "/tf": one(TRANSFORMS, transforms=[stamped]),
            }
            for name, message in told.items():
                raw = store.serialize_ros1(message, topics[name])
                writer.write(connections[name], nanoseconds(t), raw)
    return path


@pytest.mark.parametrize("compression", [None, *Ros1Writer.CompressionFormat])
def test_recordings_of_ros_1_are_read_as_those_of_ros_2(tmp_path, compression):
    path = ros1(tmp_path / "old.bag", compression)
    (track,) = gt.read(path, topic="/people")
    np.testing.assert_allclose(track.position, np.column_stack([0.12 * np.arange(30), np.zeros(30)]))
    np.testing.assert_allclose(np.diff(track.t), 0.1, atol=1e-9)
    (boxes,) = gt.read(path, topic="/boxes", fixed_frame="map")
    np.testing.assert_allclose(
        boxes.position, np.column_stack([np.full(30, 4.0), 0.12 * np.arange(30)]), atol=1e-9
    )
    np.testing.assert_allclose(boxes.position_std, 0.1)
    both = gt.read(path, topic=["/people", "/boxes"])
    assert {one.label for one in both} == {"/people/ann", "/boxes/ann"}


def test_a_recording_of_ros_1_that_unpacks_to_more_than_the_limit_is_refused(tmp_path, monkeypatch):
    path = ros1(tmp_path / "old.bag", Ros1Writer.CompressionFormat.BZ2)
    monkeypatch.setattr(MemoryLimit, "check", _refuse_content)
    with pytest.raises(gt.InputError, match="unpacked content"):
        gt.read(path, topic="/people")


def _refuse_content(self, size, what):
    if what == "unpacked content":
        raise gt.InputError(what, "less")


def test_a_damaged_recording_of_ros_1_is_one_error(tmp_path):
    old = tmp_path / "old.bag"
    old.write_bytes(b"#ROSBAG V2.0\n" + bytes(range(256)))
    with pytest.raises(gt.InputError, match=r"cut or damaged.*rosbag reindex"):
        gt.read(old)
    with pytest.raises(gt.InputError, match="text"):
        gt.read(old.replace(tmp_path / "old.csv"))
