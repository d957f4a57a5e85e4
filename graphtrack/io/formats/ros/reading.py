"""Rows of a ROS recording: people of messages and of ``tf`` (REP 155) on the ground of one frame."""

from __future__ import annotations

import re
from array import array
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray
from graphtrack.io.format import Format
from graphtrack.io.formats.ros.bag import (
    DETECTIONS,
    IDS,
    TEXT,
    TRANSFORMS,
    Bag,
    PeopleMessage,
    chosen_topics,
    ellipses_of,
    frame_of,
    is_of_one,
    kappa_of,
    multiplied,
    open_bag,
    sensor_name,
    sightings_of,
    spread_of,
    stamp_of,
    yaw_of,
)
from graphtrack.io.formats.ros.writing import write_mcap
from graphtrack.io.options import ReadOptions
from graphtrack.packages import transform
from graphtrack.tracks.cells import Cells, Layout, rows_of_cells
from graphtrack.tracks.table import AsRead, Rows
from graphtrack.tracks.time import TimeScale

_LONGEST = 100  # frames on the way to the root, above which there must be a circle

_FEW = 500  # transforms of a frame that are kept regardless of age

_REACH = 500_000_000  # nanoseconds of validity before a frame's first and after its last transform


@dataclass(eq=False)
class _Link:
    """Parent of a frame, and the frame's pose in it over time."""

    parent: str
    static: bool
    stamps: array[int] = field(default_factory=lambda: array("q"))
    poses: array[float] = field(default_factory=lambda: array("d"))
    sorted: tuple[NDArray[np.int64], FloatArray] | None = None


@dataclass(frozen=True, eq=False)
class Placement:
    """Poses (n,) of one frame in another.

    Attributes
    ----------
    quaternion : (n, 4)
    translation : (n, 3) metres
    known : (n,) whether tf covers that time
    """

    quaternion: FloatArray
    translation: FloatArray
    known: NDArray[np.bool_]

    def turn(self) -> FloatArray:
        """(n, 3, 3) rotation matrices."""
        return transform.Rotation.from_quat(self.quaternion).as_matrix()

    def after(self, inner: Placement) -> Placement:
        """Compose with a placement in this frame; return that in the outer frame."""
        outer = transform.Rotation.from_quat(self.quaternion)
        turned = outer * transform.Rotation.from_quat(inner.quaternion)
        place = outer.apply(inner.translation) + self.translation
        return Placement(turned.as_quat(), place, self.known & inner.known)

    def inverse(self) -> Placement:
        """Return the inverse placement."""
        back = transform.Rotation.from_quat(self.quaternion).inv()
        return Placement(back.as_quat(), -back.apply(self.translation), self.known)


class Transforms:
    """Transforms of a recording's ``tf`` and ``tf_static``."""

    def __init__(self) -> None:
        self._links: dict[str, _Link] = {}

    def __contains__(self, frame: str) -> bool:
        return frame in self._links or any(link.parent == frame for link in self._links.values())

    def __len__(self) -> int:
        return len(self._links)

    @property
    def frames(self) -> list[str]:
        """Names of all frames."""
        return sorted({*self._links, *(link.parent for link in self._links.values())})

    def add(self, transforms: Iterable[Any], *, static: bool) -> None:
        """Add the transforms of a message."""
        for one in transforms:
            child, parent = one.child_frame_id.lstrip("/"), one.header.frame_id.lstrip("/")
            link = self._links.setdefault(child, _Link(parent, static))
            if link.parent != parent:
                found = f"tf of the frame {child!r} in {link.parent!r} and in {parent!r}"
                raise InputError(found, "each frame with one parent")
            turn, place = one.transform.rotation, one.transform.translation
            pose = (turn.x, turn.y, turn.z, turn.w, place.x, place.y, place.z)
            if not np.isfinite(pose).all() or not any(pose[:4]):
                continue
            stamp = stamp_of(one.header)
            if link.static and link.stamps:  # only the latest pose counts
                if stamp < link.stamps[-1]:
                    continue
                del link.stamps[:], link.poses[:]
            link.sorted = None
            link.stamps.append(stamp)
            link.poses.extend(pose)

    def forget(self, before: int) -> None:
        """Drop transforms before a time (ns) from frames with many of them, except static frames.

        Frames without later transforms, such as those of people who left, are dropped, from the leaves on.
        """
        parents = {link.parent for link in self._links.values()}
        for frame, link in list(self._links.items()):
            is_old = not link.stamps or link.stamps[-1] < before
            if is_old and not link.static and frame not in parents:
                del self._links[frame]
                continue
            half = len(link.stamps) // 2
            if not link.static and half >= _FEW and link.stamps[half] < before:
                del link.stamps[:half], link.poses[: 7 * half]
                link.sorted = None

    def forget_after(self, now: int) -> None:
        """Drop transforms after a time (ns), which a clock emitted before it was set back."""
        for link in self._links.values():
            if link.static:
                continue
            kept = [k for k, stamp in enumerate(link.stamps) if stamp <= now + _REACH]
            link.poses = array("d", (v for k in kept for v in link.poses[7 * k : 7 * k + 7]))
            link.stamps = array("q", (link.stamps[k] for k in kept))
            link.sorted = None

    def placement(self, frame: str, fixed: str, stamps: NDArray[np.int64]) -> Placement:
        """Return the poses of a frame in another at times (n,), in nanoseconds."""
        up, other = self._to_root(frame), self._to_root(fixed)
        shared = next((one for one in up if one in other), None)
        if shared is None:
            raise InputError(f"no tf between {frame!r} and {fixed!r}", f"one of {self._named()}")
        found = self._along(up[: up.index(shared)], stamps)
        return self._along(other[: other.index(shared)], stamps).inverse().after(found)

    def stamps(self, frame: str, fixed: str) -> NDArray[np.int64]:
        """Return the times (n,) ascending, in nanoseconds, of transforms between two frames that change."""
        up, other = self._to_root(frame), self._to_root(fixed)
        shared = next((one for one in up if one in other), None)
        between = [*up[: up.index(shared)], *other[: other.index(shared)]] if shared is not None else []
        moving = [_in_order(self._links[one])[0] for one in between if not self._links[one].static]
        return np.unique(np.concatenate([np.empty(0, np.int64), *moving]))

    def _named(self) -> str:
        frames = self.frames
        return ", ".join(frames[:20]) + (" …" if len(frames) > 20 else "") if frames else "a bag with tf"

    def _to_root(self, frame: str) -> list[str]:
        path = [frame]
        while path[-1] in self._links:
            path.append(self._links[path[-1]].parent)
            if len(path) > _LONGEST or path[-1] in path[:-1]:
                raise InputError(f"tf in a circle, from {frame!r} to {path[-1]!r}", "a tree of frames")
        return path

    def _along(self, frames: list[str], stamps: NDArray[np.int64]) -> Placement:
        """Return the pose of the first frame in the parent of the last."""
        n = len(stamps)
        found = Placement(np.tile([0.0, 0.0, 0.0, 1.0], (n, 1)), np.zeros((n, 3)), np.ones(n, dtype=bool))
        for frame in frames:
            found = _at(self._links[frame], stamps).after(found)
        return found


def _at(link: _Link, stamps: NDArray[np.int64]) -> Placement:
    """Interpolate a link's poses at some times."""
    n = len(stamps)
    known_at, poses = _in_order(link)
    if not len(known_at):
        return Placement(np.tile([0.0, 0.0, 0.0, 1.0], (n, 1)), np.zeros((n, 3)), np.zeros(n, dtype=bool))
    if link.static or len(known_at) == 1:
        known = np.ones(n, dtype=bool) if link.static else np.abs(stamps - known_at[0]) <= _REACH
        return Placement(np.tile(poses[-1, :4], (n, 1)), np.tile(poses[-1, 4:], (n, 1)), known)
    within = np.clip(stamps, known_at[0], known_at[-1])
    # Relative to the first, since a double lacks the digits of an epoch's nanoseconds.
    since, at = (known_at - known_at[0]) / 1e9, (within - known_at[0]) / 1e9
    turn = transform.Slerp(since, transform.Rotation.from_quat(poses[:, :4]))(at).as_quat()
    place = np.column_stack([np.interp(at, since, poses[:, k]) for k in (4, 5, 6)])
    return Placement(turn, place, np.abs(stamps - within) <= _REACH)


def _in_order(link: _Link) -> tuple[NDArray[np.int64], FloatArray]:
    """Return increasing stamps and their poses (m, 7); of several at one time the last."""
    if link.sorted is None:
        stamps = np.array(link.stamps, dtype=np.int64)
        poses = np.array(link.poses, dtype=float).reshape(-1, 7)
        order = np.argsort(stamps, kind="stable")
        last = np.append(np.diff(stamps[order]) > 0, True) if len(order) else np.zeros(0, dtype=bool)
        link.sorted = stamps[order][last], poses[order][last]
    return link.sorted


Part = Literal["person", "body", "face"]
_PARTS: Mapping[str, Part] = {"persons": "person", "bodies": "body", "faces": "face"}
_MATCH = re.compile(r"/humans/persons/([^/]+)/(face|body)_id")


@dataclass(frozen=True)
class Humans:
    """Resolution of the names of people.

    Attributes
    ----------
    part : kind of entity that the names denote
    matched : (person, "face" or "body") → the latest name of that part
    """

    part: Part
    matched: Mapping[tuple[str, str], str]

    @classmethod
    def of(cls, bag: Bag, topic: str) -> Humans:
        """Return the resolution of names of a topic such as /humans/persons/tracked."""
        kind: Part = next((part for plural, part in _PARTS.items() if f"/{plural}/" in topic), "person")
        matched: dict[tuple[str, str], str] = {}
        if kind == "person":
            matches = {
                name: m
                for name, type_ in bag.topics.items()
                if type_ == TEXT and (m := _MATCH.fullmatch(name))
            }
            for one, text in bag.decoded(TEXT, matches, lambda message: str(message.data)):
                if text:
                    matched[matches[one.topic][1], matches[one.topic][2]] = text
        return cls(kind, matched)

    def placed(
        self, name: str, fixed: str, stamps: NDArray[np.int64], transforms: Transforms
    ) -> tuple[FloatArray, FloatArray, FloatArray, NDArray[np.bool_]] | None:
        """Return position (n, 2), body and head (n,), a mask of known rows (n,); None without a frame.

        The position is that of the frame of the name; bodies point along x of ``body_``, heads along z of
        ``gaze_``, else x of ``face_``, else x of ``head_``.
        """
        body = self.matched.get((name, "body"), name)
        face = self.matched.get((name, "face"), name)
        frames = {"person": f"person_{name}", "body": f"body_{body}", "face": f"face_{face}"}
        of_place = [frames[self.part], *(frames[one] for one in ("body", "face") if one != self.part)]
        where = next((one for one in of_place if one in transforms), None)
        if where is None:
            return None
        pose = transforms.placement(where, fixed, stamps)

        def orientation(*candidates: tuple[str, str]) -> FloatArray:
            for frame, axis in candidates:
                if frame in transforms:
                    try:
                        turned = transforms.placement(frame, fixed, stamps)
                    except InputError:  # unknown, since it is not connected
                        continue
                    return np.where(turned.known, yaw_of(turned.quaternion, axis), np.nan)
            return np.full(len(stamps), np.nan)

        head = orientation((f"gaze_{face}", "z"), (frames["face"], "x"), (f"head_{body}", "x"))
        return pose.translation[:, :2], orientation((frames["body"], "x")), head, pose.known


FIXED_FRAMES = ("map", "odom", "world", "earth")
"""Fixed frames of reference, by REP 105."""


_WITHOUT_TF = "the recording has no tf: --poses FILE has the robot's poses"


def may_move(frame: str) -> bool:
    """Return True for the name of a frame of reference that may move with a robot."""
    return frame.lstrip("/") not in (*FIXED_FRAMES, "")


def of_moving_frame(frame: str, way: str) -> str:
    """Return the warning on positions in a frame that may move; ``way``: the option that transforms them."""
    is_of_robot = frame.lstrip("/").startswith("base_")
    moves = f"{frame}, which moves with the robot" if is_of_robot else f"{frame}: if it moves with a robot"
    return (
        f"{'WARNING: ' * is_of_robot}positions are in the frame {moves}, people who stand still seem to "
        f"walk, and velocities are relative to the robot; {way}"
    )


class GroundFrame:
    """Transformation of sightings to the ground of a frame of reference.

    Parameters
    ----------
    fixed : its name; None: that of all messages
    transforms : from tf
    humans : positions of people that messages list by name alone
    has_transforms : whether the recording has tf, read or not

    Attributes
    ----------
    fixed : the frame of reference, once known
    """

    def __init__(
        self, fixed: str | None, transforms: Transforms, humans: Humans | None, has_transforms: bool
    ) -> None:
        self.fixed, self._transforms, self._humans = fixed, transforms, humans
        self._was_given, self._has_transforms = fixed is not None, has_transforms

    def notes(self, *, has_poses: bool = False) -> list[str]:
        """Return notes on assumptions; ``has_poses``: poses move the frame of reference."""
        if self._was_given:
            return [f"positions are in the frame {self.fixed}"]
        if not has_poses and may_move(self.fixed or ""):
            way = "--fixed-frame map (or odom) transforms them by tf"
            return [of_moving_frame(self.fixed or "", way if self._has_transforms else _WITHOUT_TF)]
        return [f"positions are in the frame {self.fixed or 'without a name'}, not transformed"]

    def placed(self, sightings: NDArray[np.void]) -> tuple[dict[str, NDArray[Any]], NDArray[np.bool_]]:
        """Return x, y, pos_std, body_rad, body_kappa, head_rad, head_kappa, score, stamp, name, number.

        And frame_id, and position_covariance in place of pos_std where it is an ellipse.

        Returns
        -------
        columns, known : name → (n,) or (n, 2, 2), and a mask of rows with a known transform (n,)
        """
        if self.fixed is None:
            self.fixed = str(sightings["frame_id"][0])
            if self._humans is not None and self.fixed not in self._transforms:
                there = ", ".join(self._transforms.frames[:20]) or "none: the recording has no tf"
                raise InputError("people with positions in tf", f"--fixed-frame with one of {there}")
        if self._humans is not None:
            return self._placed_by_transforms(sightings, self._humans)
        place, turn, head = sightings["place"], sightings["turn"], sightings["head"]
        known = np.ones(len(sightings), dtype=bool)
        turns: FloatArray | None = None
        for frame_id in sorted(set(sightings["frame_id"].tolist())):
            if frame_id == self.fixed:
                continue
            if not self._was_given:
                found = f"messages in the frames {self.fixed!r} and {frame_id!r}"
                raise InputError(found, "--fixed-frame with the frame to transform them to by tf")
            rows = np.flatnonzero(sightings["frame_id"] == frame_id)
            pose = self._transforms.placement(frame_id, self.fixed, sightings["stamp"][rows])
            if turns is None:
                turns = np.tile(np.eye(3), (len(sightings), 1, 1))
                place, turn, head = place.copy(), turn.copy(), head.copy()
            turns[rows] = pose.turn()
            place[rows] = np.einsum("nij,nj->ni", turns[rows], place[rows]) + pose.translation
            turn[rows] = multiplied(pose.quaternion, turn[rows])
            head[rows] = multiplied(pose.quaternion, head[rows])
            known[rows] = pose.known
        covariance, body_variance = spread_of(sightings["covariance"], turns)
        pos_std, ellipses = ellipses_of(covariance)
        _, head_variance = spread_of(sightings["head_covariance"], turns)
        found_place = np.where(np.isfinite(place[:, :2]).all(axis=1, keepdims=True), place[:, :2], np.nan)
        return {
            **_heading("body", yaw_of(turn), body_variance),
            **_heading("head", yaw_of(head), head_variance),
            **_of_anybody(sightings, found_place),
            "pos_std": pos_std,
            "position_covariance": ellipses,
        }, known

    def _placed_by_transforms(
        self, sightings: NDArray[np.void], humans: Humans
    ) -> tuple[dict[str, NDArray[Any]], NDArray[np.bool_]]:
        assert self.fixed is not None
        n = len(sightings)
        place, known = np.full((n, 2), np.nan), np.zeros(n, dtype=bool)
        body, head = np.full(n, np.nan), np.full(n, np.nan)
        for name in dict.fromkeys(sightings["name"].tolist()):
            rows = np.flatnonzero(sightings["name"] == name)
            found = humans.placed(name, self.fixed, sightings["stamp"][rows], self._transforms)
            if found is not None:
                place[rows], body[rows], head[rows], known[rows] = found
        unknown = np.full(n, np.nan)
        return {
            **_heading("body", body, unknown),
            **_heading("head", head, unknown),
            **_of_anybody(sightings, place),
            "pos_std": unknown,
            "position_covariance": np.full((n, 2, 2), np.nan),
        }, known


def _heading(name: str, angle: FloatArray, variance: FloatArray) -> dict[str, FloatArray]:
    kappa = np.where(np.isfinite(angle), kappa_of(variance), np.nan)
    return {f"{name}_rad": angle, f"{name}_kappa": kappa}


def _of_anybody(sightings: NDArray[np.void], place: FloatArray) -> dict[str, NDArray[Any]]:
    score = np.where(sightings["score"] > 0.0, sightings["score"], np.nan)
    return {
        "stamp": sightings["stamp"],
        "name": sightings["name"],
        "number": sightings["number"],
        "frame_id": sightings["frame_id"],
        "x": place[:, 0],
        "y": place[:, 1],
        "score": score,
    }


_AT_A_TIME = 2048  # messages that are transformed together

_BACK, _AHEAD = 10**9, 86_400 * 10**9
"""Nanoseconds by which stamps may be out of sequence, and ahead of the last."""

_LAYOUT = Layout(
    {"track_id": "name", "t": "stamp", "body_rad": "body_rad", "head_rad": "head_rad"}, time_unit="ns"
)
_STATIC = "tf_static"

_AGAIN = "repeated with the same stamp"
_NO_TRANSFORM = "at a time without tf"
_OTHER_CLASS = "of another class"


@dataclass(eq=False)
class _Columns:
    """Content of the messages read so far, on the ground plane."""

    parts: list[dict[str, NDArray[Any]]] = field(default_factory=list)
    refused: Counter[str] = field(default_factory=Counter)
    kinds: Counter[str] = field(default_factory=Counter)
    turned: bool = False  # whether some orientation is not the identity


def rows_of_bag(path: Path, options: ReadOptions) -> Rows:
    """Return rows of a recording by the options ``topic``, ``fixed_frame`` and ``classes``."""
    with open_bag(path, options.limit(path)) as bag:
        topics = chosen_topics(bag.topics, options.topics, path)
        columns = _Columns()
        try:
            ground = _ground(bag, topics, options.fixed_frame)
            for kind in sorted({bag.topics[name] for name in topics}):
                _read(bag, kind, topics, ground, options.classes, columns)
            # A topic of one person is an identity.
            sensors = [name for name in topics if not is_of_one(bag.topics[name])]
        except InputError as error:
            raise error.at(error.path or path) from error
        kinds = {bag.topics[name] for name in topics}
        shown = ", ".join(f"{name} ({bag.topics[name]})" if len(kinds) > 1 else name for name in topics)
        of_kind = f" ({bag.topics[topics[0]]})" if len(kinds) == 1 else ""
        notes = [
            f"topic{'' if len(topics) == 1 else 's'} {shown}{of_kind}",
            *ground.notes(has_poses=options.poses is not None),
        ]
        if len(columns.kinds) > 1 and not _is_given(options.classes):
            notes.append(f"all classes were read: {', '.join(sorted(columns.kinds))}; --class selects")
        named = topics if len(sensors) > 1 else [""] * len(topics)
        names = [name if topic in sensors else "" for topic, name in zip(topics, named, strict=True)]
        return _rows(path, columns, names, notes, options.reference, ground.fixed or "")


def _is_given(classes: tuple[str, ...]) -> bool:
    """Return whether classes were selected, other than the default, KITTI's classes of people."""
    return classes != ("Pedestrian",)


def _frames(bag: Bag, kind: str, topics: list[str]) -> Iterator[tuple[PeopleMessage, int, int]]:
    """Yield the messages of people of one type, their numbers and the index of their topic.

    Times are those of one clock. Names of several topics are kept apart by those of the topics.
    """
    of_one, several = is_of_one(kind), len(topics) > 1
    of_kind = [name for name in topics if bag.topics[name] == kind]
    before: dict[str, int] = {}
    unstamped = _is_unstamped(bag, kind, of_kind)
    for (topic, logged, _, number), frame in bag.decoded(kind, of_kind, partial(frame_of, kind=kind)):
        if unstamped:
            frame = frame._replace(stamp=logged)
        _check_clock(before.get(topic), frame.stamp, number, topic)
        if of_one:
            frame = frame._replace(people=[frame.people[0]._replace(name=topic)])
        elif several:
            people = [one._replace(name=f"{topic}/{one.name}") if one.name else one for one in frame.people]
            frame = frame._replace(people=people)
        before[topic] = max(frame.stamp, before.get(topic, frame.stamp))
        yield frame, number, topics.index(topic)


def _is_unstamped(bag: Bag, kind: str, topics: list[str]) -> bool:
    """Return whether messages lack stamps: a simulation's first stamp may be 0, but not the second."""
    with open_bag(bag.path, bag.limit) as other:
        frames = other.decoded(kind, topics[:1], partial(frame_of, kind=kind))
        first = [frame.stamp for _, frame in islice(frames, 2)]
    return bool(first) and not any(first)


def _check_clock(before: int | None, stamp: int, number: int, topic: str) -> None:
    if before is not None and not -_BACK <= stamp - before <= _AHEAD:
        found = f"a clock that jumps by {(stamp - before) / 1e9:+.6g} s"
        expected = "continuous stamps; cut the recording where its clock was set (ros2 bag convert)"
        raise InputError(found, expected, line=number, column=topic)


def transforms_of(bag: Bag) -> Transforms:
    """Return the transforms of a recording."""
    transforms = Transforms()
    of_tf = [name for name, type_ in bag.topics.items() if type_ == TRANSFORMS]
    for one, given in bag.decoded(TRANSFORMS, of_tf, lambda message: message.transforms):
        transforms.add(given, static=one.topic.endswith(_STATIC))
    return transforms


def _ground(bag: Bag, topics: list[str], fixed: str | None) -> GroundFrame:
    """Return the transformation to the ground; tf is read where it may be needed."""
    humans = Humans.of(bag, topics[0]) if bag.topics[topics[0]] == IDS else None
    fixed = None if fixed is None else fixed.lstrip("/")
    transforms = Transforms() if fixed is None and humans is None else transforms_of(bag)
    has_transforms = TRANSFORMS in bag.topics.values()
    return GroundFrame(fixed, transforms, humans, has_transforms)


def _read(
    bag: Bag, kind: str, topics: list[str], ground: GroundFrame, classes: tuple[str, ...], columns: _Columns
) -> None:
    """Add the messages of one type to the columns."""
    frames = _frames(bag, kind, topics)
    while some := list(islice(frames, _AT_A_TIME)):
        sightings = sightings_of((frame, number) for frame, number, _ in some)
        if not len(sightings):
            continue
        keep = np.ones(len(sightings), dtype=bool)
        for row, classified in enumerate(sightings["kind"].tolist()):
            if kind == DETECTIONS and _is_given(classes) and classified not in classes:
                keep[row] = False
                columns.refused[_OTHER_CLASS] += 1
            elif classified:
                columns.kinds[classified] += 1
        columns.turned |= kind == IDS or bool((sightings["turn"][:, :3] != 0.0).any())
        found, known = ground.placed(sightings)
        found["topic"] = np.repeat([topic for *_, topic in some], [len(frame.people) for frame, *_ in some])
        columns.refused[_NO_TRANSFORM] += int((keep & ~known).sum())
        keep &= known
        columns.parts.append({name: values[keep] for name, values in found.items()})


def _rows(
    path: Path,
    columns: _Columns,
    topics: Sequence[str],
    notes: list[str],
    reference: AsRead | None,
    frame: str,
) -> Rows:
    """Return the rows; ``topics`` are the names of the topics' sensors."""
    refused = +columns.refused
    joined: dict[str, NDArray[Any]] = {}
    if columns.parts:
        joined = {name: np.concatenate([one[name] for one in columns.parts]) for name in columns.parts[0]}
    columns.parts.clear()
    if not len(joined.get("stamp", ())):
        reasons = "; ".join(f"{count} {reason}" for reason, count in refused.items())
        found = f"no people in the messages ({reasons})" if reasons else "no people in any message"
        raise InputError(found, "people", path=path)
    sensor, again = _sensors(joined, topics)
    refused[_AGAIN] += int(again.sum())
    joined = {name: values[~again] for name, values in (joined | {"sensor": sensor}).items()}
    named = joined["name"] != ""
    if named.any():
        without = np.setdiff1d(joined["topic"], joined["topic"][named])
        if len(without):
            found = "topics with the names of people, and topics without"
            raise InputError(found, "--topic with topics of one of both kinds", path=path)
        first = _first_of_each(joined)
        refused[_AGAIN] += int(len(first) - first.sum())
        joined = {name: values[first] for name, values in joined.items()}
    else:
        del joined["name"]
        order = np.lexsort((joined["number"], joined["sensor"].astype(str), joined["stamp"]))
        joined = {name: values[order] for name, values in joined.items()}
    for name in ("topic", "frame_id", *([] if joined["sensor"].any() else ["sensor"])):
        del joined[name]
    joined |= _columns_of_ellipses(joined.pop("position_covariance"))
    if not columns.turned and np.isfinite(joined["body_rad"]).any():
        joined["body_rad"][:] = np.nan
        notes.append("all orientations equal that of the frame of reference and were treated as unknown")
    number = joined.pop("number")
    void = {name for name, values in joined.items() if values.dtype.kind == "f" and np.isnan(values).all()}
    classified = {name: values for name, values in joined.items() if name not in void}
    layout = replace(_LAYOUT, columns={k: v for k, v in _LAYOUT.columns.items() if v in classified})
    cells = Cells(path, "bag", classified, lambda row: int(number[row]))
    rows = rows_of_cells(cells, layout, reference=reference)
    read = rows.as_read
    assert read is not None and read.time is not None
    # As a table: seconds of the same clock, unchanged when read back.
    as_read = AsRead({}, TimeScale("number", origin=read.time.origin), names=read.names, frame=frame)
    notes = [*notes, *(note for note in rows.notes if note not in notes)]
    return replace(rows, refused=dict(+refused), notes=tuple(notes), as_read=as_read)


def _sensors(
    joined: dict[str, NDArray[Any]], topics: Sequence[str]
) -> tuple[NDArray[np.object_], NDArray[np.bool_]]:
    """Return the name of the sensor of each row, and a mask of the rows of messages that repeat another.

    Messages of one topic and frame of reference with one stamp are of several publishers, unless they are
    equal.
    """
    frames = joined["frame_id"].astype(str)
    names, frame = np.unique(frames, return_inverse=True)
    message = np.column_stack([joined["topic"], frame, joined["stamp"], joined["number"]])
    order = np.lexsort(message.T[::-1])
    message = message[order]
    first_of: dict[int, int] = {}  # topic → frame of its first message
    for row in np.lexsort((joined["number"], joined["topic"])).tolist():
        first_of.setdefault(int(joined["topic"][row]), int(frame[row]))
    changes = np.diff(message, axis=0, prepend=message[:1] - 1) != 0
    begins = np.flatnonzero(changes.any(axis=1))
    is_later = ~changes[begins, :3].any(axis=1)  # another message of that stamp is before
    publisher, again = np.zeros(len(message), np.int64), np.zeros(len(message), bool)
    content = [joined[name].astype(str) if name == "name" else joined[name] for name in ("x", "y", "name")]
    known: list[tuple[Any, ...]] = []
    ends = [*begins[1:].tolist(), len(message)]
    for k in np.flatnonzero(is_later | np.append(is_later[1:], False)).tolist():
        rows = order[begins[k] : ends[k]]
        one = tuple(tuple(values[rows].tolist()) for values in content)
        if not is_later[k]:
            known = []
        if one in known:
            again[rows] = True
        else:
            publisher[rows] = len(known)
            known.append(one)
    parts = np.column_stack([joined["topic"], frame, publisher])
    kinds, kind = np.unique(parts, axis=0, return_inverse=True)
    of_kind = [
        sensor_name(topics[topic], "" if first_of[topic] == place else names[place], number)
        for topic, place, number in kinds.tolist()
    ]
    return np.array(of_kind, dtype=object)[kind.reshape(-1)], again


def _columns_of_ellipses(covariance: FloatArray) -> dict[str, FloatArray]:
    """Return covariances of positions (n, 2, 2) as columns of the native table."""
    x, y = np.sqrt(covariance[:, 0, 0]), np.sqrt(covariance[:, 1, 1])
    correlation = covariance[:, 0, 1] / (x * y)
    return {"observed_x_std": x, "observed_y_std": y, "observed_xy_corr": correlation}


def _first_of_each(joined: dict[str, NDArray[Any]]) -> NDArray[np.bool_]:
    """Return a mask of the first row of each person by each sensor at each stamp."""
    keys = [np.unique(joined[name].astype(str), return_inverse=True)[1] for name in ("name", "sensor")]
    number = keys[0] * (int(keys[1].max()) + 1) + keys[1]
    order = np.lexsort((np.arange(len(number)), joined["stamp"], number))
    again = (np.diff(number[order]) == 0) & (np.diff(joined["stamp"][order]) == 0)
    first = np.ones(len(number), dtype=bool)
    first[order[1:][again]] = joined["name"][order[1:][again]] == ""
    return first


BAG = Format(
    name="bag",
    description="ROS 2 bag or MCAP, or ROS 1 bag: People, Detection3DArray, PoseArray, PoseStamped, IdsList",
    suffixes=(".mcap",),
    read=lambda source, options: rows_of_bag(source.path, options),
    write=write_mcap,
)
