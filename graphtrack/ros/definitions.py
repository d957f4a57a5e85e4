"""Definitions of the messages that are read and written, and the store that knows them (package rosbags)."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from typing import TYPE_CHECKING, Any

from graphtrack.later import package

if TYPE_CHECKING:
    from rosbags.typesys.store import Typestore

PEOPLE = "people_msgs/msg/People"
DETECTIONS = "vision_msgs/msg/Detection3DArray"
POSES = "geometry_msgs/msg/PoseArray"
POSE = "geometry_msgs/msg/PoseStamped"
POSE_WITH_COVARIANCE = "geometry_msgs/msg/PoseWithCovarianceStamped"
IDS = "hri_msgs/msg/IdsList"
GAZE = "hri_msgs/msg/Gaze"
GROUP = "hri_msgs/msg/Group"
MARKERS = "visualization_msgs/msg/MarkerArray"
SCENE = "foxglove_msgs/msg/SceneUpdate"
TRANSFORMS = "tf2_msgs/msg/TFMessage"
TEXT = "std_msgs/msg/String"

OF_PEOPLE = (PEOPLE, DETECTIONS, POSES, POSE, POSE_WITH_COVARIANCE, IDS)
"""Types of the topics that say where people are."""

_PRIMITIVE = "foxglove_msgs/Color color"

FIELDS: Mapping[str, str] = {
    PEOPLE: "std_msgs/Header header; people_msgs/Person[] people",
    "people_msgs/msg/Person": "string name; geometry_msgs/Point position; geometry_msgs/Point velocity; "
    "float64 reliability; string[] tagnames; string[] tags",
    DETECTIONS: "std_msgs/Header header; vision_msgs/Detection3D[] detections",
    "vision_msgs/msg/Detection3D": "std_msgs/Header header; vision_msgs/ObjectHypothesisWithPose[] results; "
    "vision_msgs/BoundingBox3D bbox; string id",
    "vision_msgs/msg/ObjectHypothesisWithPose": "vision_msgs/ObjectHypothesis hypothesis; "
    "geometry_msgs/PoseWithCovariance pose",
    "vision_msgs/msg/ObjectHypothesis": "string class_id; float64 score",
    "vision_msgs/msg/BoundingBox3D": "geometry_msgs/Pose center; geometry_msgs/Vector3 size",
    IDS: "std_msgs/Header header; string[] ids",
    GAZE: "std_msgs/Header header; string sender; string receiver",
    GROUP: "std_msgs/Header header; string group_id; string[] members",
    SCENE: "foxglove_msgs/SceneEntityDeletion[] deletions; foxglove_msgs/SceneEntity[] entities",
    "foxglove_msgs/msg/SceneEntityDeletion": "uint8 MATCHING_ID=0; uint8 ALL=1; "
    "builtin_interfaces/Time timestamp; uint8 type; string id",
    "foxglove_msgs/msg/SceneEntity": "builtin_interfaces/Time timestamp; string frame_id; string id; "
    "builtin_interfaces/Duration lifetime; bool frame_locked; foxglove_msgs/KeyValuePair[] metadata; "
    "foxglove_msgs/ArrowPrimitive[] arrows; foxglove_msgs/CubePrimitive[] cubes; "
    "foxglove_msgs/SpherePrimitive[] spheres; foxglove_msgs/CylinderPrimitive[] cylinders; "
    "foxglove_msgs/LinePrimitive[] lines; foxglove_msgs/TriangleListPrimitive[] triangles; "
    "foxglove_msgs/TextPrimitive[] texts; foxglove_msgs/ModelPrimitive[] models",
    "foxglove_msgs/msg/KeyValuePair": "string key; string value",
    "foxglove_msgs/msg/Color": "float64 r; float64 g; float64 b; float64 a",
    "foxglove_msgs/msg/ArrowPrimitive": "geometry_msgs/Pose pose; float64 shaft_length; "
    f"float64 shaft_diameter; float64 head_length; float64 head_diameter; {_PRIMITIVE}",
    "foxglove_msgs/msg/CubePrimitive": f"geometry_msgs/Pose pose; geometry_msgs/Vector3 size; {_PRIMITIVE}",
    "foxglove_msgs/msg/SpherePrimitive": f"geometry_msgs/Pose pose; geometry_msgs/Vector3 size; {_PRIMITIVE}",
    "foxglove_msgs/msg/CylinderPrimitive": "geometry_msgs/Pose pose; geometry_msgs/Vector3 size; "
    f"float64 bottom_scale; float64 top_scale; {_PRIMITIVE}",
    "foxglove_msgs/msg/LinePrimitive": "uint8 LINE_STRIP=0; uint8 LINE_LOOP=1; uint8 LINE_LIST=2; "
    "uint8 type; geometry_msgs/Pose pose; float64 thickness; bool scale_invariant; "
    f"geometry_msgs/Point[] points; {_PRIMITIVE}; foxglove_msgs/Color[] colors; uint32[] indices",
    "foxglove_msgs/msg/TriangleListPrimitive": "geometry_msgs/Pose pose; geometry_msgs/Point[] points; "
    f"{_PRIMITIVE}; foxglove_msgs/Color[] colors; uint32[] indices",
    "foxglove_msgs/msg/TextPrimitive": "geometry_msgs/Pose pose; bool billboard; float64 font_size; "
    f"bool scale_invariant; {_PRIMITIVE}; string text",
    "foxglove_msgs/msg/ModelPrimitive": "geometry_msgs/Pose pose; geometry_msgs/Vector3 scale; "
    f"{_PRIMITIVE}; bool override_color; string url; string media_type; uint8[] data",
}
"""Type → its fields, for the types that are not among ROS's own common interfaces."""


def need_rosbags() -> None:
    """Raise InputError if the packages that read and write bags are not there."""
    for name in ("mcap", "rosbags"):
        package(name, "ros")


@cache
def own_types() -> dict[str, Any]:
    """The definitions above as rosbags takes them."""
    from rosbags.typesys import get_types_from_msg

    found: dict[str, Any] = {}
    for name, fields in FIELDS.items():
        found |= get_types_from_msg("\n".join(fields.split("; ")), name)
    return found


def typestore(embedded: Mapping[str, Any] | None = None) -> Typestore:
    """A store of ROS 2's common interfaces and of `FIELDS`.

    Parameters
    ----------
    embedded : definitions that a bag has itself; they go before ours, not before ROS's own
    """
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    given = {name: one for name, one in (embedded or {}).items() if name not in store.fielddefs}
    store.register({**own_types(), **given})
    return store
