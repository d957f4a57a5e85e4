"""Transforms between frames of reference, as ``tf`` tells them over time."""

from __future__ import annotations

from array import array
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation, Slerp

from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray
from graphtrack.ros.messages import stamp_of

_LONGEST = 100
"""Frames between one and the root, above which there must be a circle."""

_FEW = 500
"""Tellings of a frame that are kept however old they are."""

_REACH = 500_000_000
"""Nanoseconds by which a transform holds before its first and after its last telling."""


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
    known : (n,) whether tf tells of that time
    """

    quaternion: FloatArray
    translation: FloatArray
    known: NDArray[np.bool_]

    def turn(self) -> FloatArray:
        """(n, 3, 3) rotation matrices."""
        return Rotation.from_quat(self.quaternion).as_matrix()

    def after(self, inner: Placement) -> Placement:
        """Placement, in the outer frame, of one that has a placement in this frame."""
        outer = Rotation.from_quat(self.quaternion)
        turned = outer * Rotation.from_quat(inner.quaternion)
        place = outer.apply(inner.translation) + self.translation
        return Placement(turned.as_quat(), place, self.known & inner.known)

    def inverse(self) -> Placement:
        """The pose of the other in the one."""
        back = Rotation.from_quat(self.quaternion).inv()
        return Placement(back.as_quat(), -back.apply(self.translation), self.known)


class Transforms:
    """All that a recording's ``tf`` and ``tf_static`` say."""

    def __init__(self) -> None:
        self._links: dict[str, _Link] = {}

    def __contains__(self, frame: str) -> bool:
        return frame in self._links or any(link.parent == frame for link in self._links.values())

    def __len__(self) -> int:
        return len(self._links)

    @property
    def frames(self) -> list[str]:
        """The names of all frames."""
        return sorted({*self._links, *(link.parent for link in self._links.values())})

    def add(self, transforms: Iterable[Any], *, static: bool) -> None:
        """Take in the transforms of a message."""
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
            link.sorted = None
            link.stamps.append(stamp_of(one.header))
            link.poses.extend(pose)

    def forget(self, before: int) -> None:
        """Drop what was told before a time (ns), as far as it is much, but not of what stands still."""
        for link in self._links.values():
            half = len(link.stamps) // 2
            if not link.static and half >= _FEW and link.stamps[half] < before:
                del link.stamps[:half], link.poses[: 7 * half]
                link.sorted = None

    def forget_after(self, now: int) -> None:
        """Drop what was told of a time (ns) to come, by a clock that was set back since."""
        for link in self._links.values():
            if link.static:
                continue
            kept = [k for k, stamp in enumerate(link.stamps) if stamp <= now + _REACH]
            link.poses = array("d", (v for k in kept for v in link.poses[7 * k : 7 * k + 7]))
            link.stamps = array("q", (link.stamps[k] for k in kept))
            link.sorted = None

    def placement(self, frame: str, fixed: str, stamps: NDArray[np.int64]) -> Placement:
        """The poses of a frame in another at some times (n,), in nanoseconds."""
        up, other = self._to_root(frame), self._to_root(fixed)
        shared = next((one for one in up if one in other), None)
        if shared is None:
            raise InputError(f"no tf between {frame!r} and {fixed!r}", f"one of {self._named()}")
        found = self._along(up[: up.index(shared)], stamps)
        return self._along(other[: other.index(shared)], stamps).inverse().after(found)

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
        """The pose of the first frame in the parent of the last."""
        n = len(stamps)
        found = Placement(np.tile([0.0, 0.0, 0.0, 1.0], (n, 1)), np.zeros((n, 3)), np.ones(n, dtype=bool))
        for frame in frames:
            found = _at(self._links[frame], stamps).after(found)
        return found


def _at(link: _Link, stamps: NDArray[np.int64]) -> Placement:
    """A link's poses at some times, between those that were told."""
    n = len(stamps)
    told, poses = _in_order(link)
    if not len(told):
        return Placement(np.tile([0.0, 0.0, 0.0, 1.0], (n, 1)), np.zeros((n, 3)), np.zeros(n, dtype=bool))
    if link.static or len(told) == 1:
        known = np.ones(n, dtype=bool) if link.static else np.abs(stamps - told[0]) <= _REACH
        return Placement(np.tile(poses[-1, :4], (n, 1)), np.tile(poses[-1, 4:], (n, 1)), known)
    within = np.clip(stamps, told[0], told[-1])
    # Relative to the first, for a double has not the digits of an epoch's nanoseconds.
    since, at = (told - told[0]) / 1e9, (within - told[0]) / 1e9
    turn = Slerp(since, Rotation.from_quat(poses[:, :4]))(at).as_quat()
    place = np.column_stack([np.interp(at, since, poses[:, k]) for k in (4, 5, 6)])
    return Placement(turn, place, np.abs(stamps - within) <= _REACH)


def _in_order(link: _Link) -> tuple[NDArray[np.int64], FloatArray]:
    """Stamps that increase, and the poses (m, 7) told at them; of several at one time the last."""
    if link.sorted is None:
        stamps = np.array(link.stamps, dtype=np.int64)
        poses = np.array(link.poses, dtype=float).reshape(-1, 7)
        order = np.argsort(stamps, kind="stable")
        last = np.append(np.diff(stamps[order]) > 0, True) if len(order) else np.zeros(0, dtype=bool)
        link.sorted = stamps[order][last], poses[order][last]
    return link.sorted
