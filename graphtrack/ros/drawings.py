"""People as Foxglove (``SceneUpdate``) and RViz (``MarkerArray``) draw them.

Each message stands by itself: it takes back what was drawn before. An arrow from the feet is a second's way,
one at the shoulders shows the body, one at the eyes the head; an ellipse holds the position with 95 %.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from functools import cache
from typing import Any, NamedTuple

from graphtrack.display import BODY_COLOUR, HEAD_COLOUR, VELOCITY_COLOUR, person_colour, rgb
from graphtrack.ros.definitions import MARKERS, SCENE
from graphtrack.ros.estimates import EYES, HEIGHT, WIDTH, Make, Person, header_of, pose_at, time_of

_SHOULDERS = 1.35
_THIN = 0.02
_ABOVE = HEIGHT + 0.25
_WHITE = "#FFFFFF"
_POINT = 0.3
"""Metres of the point of an arrow of body or head."""

_ARROW, _CYLINDER, _TEXT = 0, 3, 9
_DELETE_ALL_MARKERS, _DELETE_ALL_ENTITIES = 3, 1


class Arrow(NamedTuple):
    """An arrow along the ground: what it shows, how high it is, its quaternion's z and w, and its lengths."""

    name: str
    z: float
    turn: tuple[float, float]
    shaft: float
    tip: float
    length: float
    colour: str


def arrows_of(one: Person) -> Iterator[Arrow]:
    """Velocity, body and head, as far as they are known."""
    of = one.of
    if one.moves:
        yield Arrow("velocity", _THIN, (of.way_z, of.way_w), of.shaft, of.tip, of.way, VELOCITY_COLOUR)
    for known, name, z, turn, colour in (
        (one.has_body, "body", _SHOULDERS, (of.body_z, of.body_w), BODY_COLOUR),
        (one.has_head, "head", EYES, (of.head_z, of.head_w), HEAD_COLOUR),
    ):
        if known:
            yield Arrow(name, z, turn, WIDTH - _POINT / 2.0, _POINT / 2.0, WIDTH, colour)


@cache
def _shares(colour: str) -> tuple[float, float, float]:
    """Red, green and blue, from 0 to 1."""
    red, green, blue = rgb(colour)
    return red / 255.0, green / 255.0, blue / 255.0


def scene_message(make: Make, stamp: int, frame_id: str, people: Iterable[Person]) -> Any:
    """``foxglove_msgs/SceneUpdate``: people as cylinders with heads, arrows, ellipses and names.

    Parameters
    ----------
    stamp : nanoseconds
    """
    time = time_of(make, stamp)
    entities = [
        make(
            "foxglove_msgs/msg/SceneEntity",
            timestamp=time,
            frame_id=frame_id,
            id=one.name,
            arrows=[_arrow(make, one, arrow) for arrow in arrows_of(one)],
            spheres=[_head(make, one)],
            cylinders=list(_cylinders(make, one)),
            texts=[_text(make, one)],
        )
        for one in people
    ]
    delete = make("foxglove_msgs/msg/SceneEntityDeletion", timestamp=time, type=_DELETE_ALL_ENTITIES)
    return make(SCENE, deletions=[delete], entities=entities)


def _colour(make: Make, name: str, alpha: float = 1.0) -> Any:
    red, green, blue = _shares(name)
    return make("foxglove_msgs/msg/Color", r=red, g=green, b=blue, a=alpha)


def _size(make: Make, x: float, y: float, z: float) -> Any:
    return make("geometry_msgs/msg/Vector3", x=x, y=y, z=z)


def _arrow(make: Make, one: Person, arrow: Arrow) -> Any:
    return make(
        "foxglove_msgs/msg/ArrowPrimitive",
        pose=pose_at(make, one.of.x, one.of.y, arrow.z, arrow.turn),
        shaft_length=arrow.shaft,
        shaft_diameter=0.05,
        head_length=arrow.tip,
        head_diameter=0.12,
        color=_colour(make, arrow.colour),
    )


def _head(make: Make, one: Person) -> Any:
    return make(
        "foxglove_msgs/msg/SpherePrimitive",
        pose=pose_at(make, one.of.x, one.of.y, EYES, (one.of.head_z, one.of.head_w)),
        size=_size(make, 0.2, 0.16, 0.24),
        color=_colour(make, person_colour(one.number), 0.8),
    )


def _cylinders(make: Make, one: Person) -> Iterator[Any]:
    of = one.of
    found = [((of.body_z, of.body_w), _SHOULDERS, (WIDTH / 2.0, WIDTH), 0.6)]
    if one.is_spread:
        found.append(((of.ellipse_z, of.ellipse_w), _THIN, (of.longer, of.shorter), 0.4))
    for turn, height, extent, alpha in found:
        yield make(
            "foxglove_msgs/msg/CylinderPrimitive",
            pose=pose_at(make, of.x, of.y, height / 2.0, turn),
            size=_size(make, *extent, height),
            bottom_scale=1.0,
            top_scale=1.0,
            color=_colour(make, person_colour(one.number), alpha),
        )


def _text(make: Make, one: Person) -> Any:
    return make(
        "foxglove_msgs/msg/TextPrimitive",
        pose=pose_at(make, one.of.x, one.of.y, _ABOVE),
        billboard=True,
        font_size=0.25,
        color=_colour(make, _WHITE),
        text=one.label,
    )


def markers_message(make: Make, stamp: int, frame_id: str, people: Iterable[Person]) -> Any:
    """``visualization_msgs/MarkerArray``: arrows, ellipses and names, a namespace for each kind.

    Parameters
    ----------
    stamp : nanoseconds
    """
    header = header_of(make, stamp, frame_id)
    found = [make("visualization_msgs/msg/Marker", header=header, action=_DELETE_ALL_MARKERS)]

    def add(name: str, one: Person, kind: int, pose: Any, scale: Any, colour: str, **more: Any) -> None:
        red, green, blue = _shares(colour)
        shade = make("std_msgs/msg/ColorRGBA", r=red, g=green, b=blue, a=more.pop("alpha", 1.0))
        found.append(
            make(
                "visualization_msgs/msg/Marker",
                header=header,
                ns=name,
                id=one.number,
                type=kind,
                pose=pose,
                scale=scale,
                color=shade,
                **more,
            )
        )

    for one in people:
        of = one.of
        for arrow in arrows_of(one):
            pose = pose_at(make, of.x, of.y, arrow.z, arrow.turn)
            add(arrow.name, one, _ARROW, pose, _size(make, arrow.length, 0.05, 0.12), arrow.colour)
        if one.is_spread:
            pose = pose_at(make, of.x, of.y, _THIN / 2.0, (of.ellipse_z, of.ellipse_w))
            scale = _size(make, of.longer, of.shorter, _THIN)
            add("position", one, _CYLINDER, pose, scale, person_colour(one.number), alpha=0.5)
        pose, scale = pose_at(make, of.x, of.y, _ABOVE), _size(make, 0.0, 0.0, 0.25)
        add("label", one, _TEXT, pose, scale, _WHITE, text=one.label)
    return make(MARKERS, markers=found)
