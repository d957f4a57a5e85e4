"""People of messages on the ground of one frame of reference."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray
from graphtrack.ros.humans import Humans
from graphtrack.ros.messages import Frame, Sighting
from graphtrack.ros.rotation import kappa_of, multiplied, spread_of, yaw_of
from graphtrack.ros.transforms import Transforms

_USUAL = ("map", "odom", "world", "earth", "")
"""Frames of reference that do not move, by REP 105."""

_UNTOLD = (0.0, 0.0, 0.0, 0.0)
_NOWHERE = (np.nan, np.nan, np.nan)
_UNKNOWN = np.zeros(36)


@dataclass(frozen=True, eq=False)
class Seen:
    """n sightings as arrays.

    Attributes
    ----------
    stamp, number : (n,) nanoseconds, and the message of its topic, from 1
    frame_id, name, kinds : (n,) text
    place : (n, 3) metres
    turn, head : (n, 4) quaternions, 0 where unknown
    covariance, head_covariance : (n, 36)
    score : (n,) 0 where unsaid
    """

    stamp: NDArray[np.int64]
    number: NDArray[np.int64]
    frame_id: NDArray[Any]
    name: NDArray[Any]
    kinds: list[str]
    place: FloatArray
    turn: FloatArray
    head: FloatArray
    covariance: FloatArray
    head_covariance: FloatArray
    score: FloatArray

    def __len__(self) -> int:
        return len(self.stamp)

    @classmethod
    def of(cls, frames: Sequence[tuple[Frame, int]]) -> Seen:
        """The sightings of some messages."""
        people: list[Sighting] = [one for frame, _ in frames for one in frame.people]
        counts = [len(frame.people) for frame, _ in frames]

        def table(name: str, missing: Any) -> FloatArray:
            values = [missing if (v := getattr(one, name)) is None else v for one in people]
            return np.array(values, dtype=float).reshape(len(people), len(missing))

        def text(values: list[str]) -> NDArray[Any]:
            found = np.empty(len(values), dtype=object)
            found[:] = values
            return found

        frame_ids = [frame.frame_id for frame, _ in frames]
        return cls(
            stamp=np.repeat(np.array([frame.stamp for frame, _ in frames], dtype=np.int64), counts),
            number=np.repeat([number for _, number in frames], counts),
            frame_id=np.repeat(text(frame_ids), counts),
            name=text([one.name.strip() for one in people]),
            kinds=[one.kind for one in people],
            place=table("place", _NOWHERE),
            turn=table("turn", _UNTOLD),
            head=table("head", _UNTOLD),
            covariance=table("covariance", _UNKNOWN),
            head_covariance=table("head_covariance", _UNKNOWN),
            score=np.array([one.score for one in people], dtype=float),
        )

    def is_turned(self) -> bool:
        """Return whether any orientation is told that is another than none at all."""
        return bool((self.turn[:, :3] != 0.0).any())


class Ground:
    """Brings sightings to the ground of a frame of reference.

    Parameters
    ----------
    fixed : its name; None: that of all messages
    transforms : what tf says
    humans : what places people of whom a message has the name alone
    has_transforms : whether the recording has tf, read or not

    Attributes
    ----------
    fixed, notes : the frame of reference, as it is known by now, and what was assumed
    """

    def __init__(
        self, fixed: str | None, transforms: Transforms, humans: Humans | None, has_transforms: bool
    ) -> None:
        self.fixed, self._transforms, self._humans = fixed, transforms, humans
        self._was_given, self._has_transforms = fixed is not None, has_transforms

    @property
    def notes(self) -> list[str]:
        """Notes on assumptions."""
        if self._was_given:
            return [f"places are in the frame {self.fixed}"]
        hint = "; --fixed-frame brings them to one that does not move" if self._may_move else ""
        return [f"places are in the frame {self.fixed or 'that has no name'}, as they stand{hint}"]

    @property
    def _may_move(self) -> bool:
        return self._has_transforms and self.fixed not in _USUAL

    def placed(self, seen: Seen) -> tuple[dict[str, NDArray[Any]], NDArray[np.bool_]]:
        """Columns x, y, pos_std, body_rad, body_kappa, head_rad, head_kappa, score, stamp, name, number.

        Returns
        -------
        columns, known : name → (n,), and whether tf places a row (n,)
        """
        if self.fixed is None:
            self.fixed = str(seen.frame_id[0])
            if self._humans is not None and self.fixed not in self._transforms:
                there = ", ".join(self._transforms.frames[:20]) or "none: the recording has no tf"
                raise InputError("people whom tf places", f"--fixed-frame with one of {there}")
        if self._humans is not None:
            return self._placed_by_transforms(seen, self._humans)
        place, turn, head = seen.place, seen.turn, seen.head
        known = np.ones(len(seen), dtype=bool)
        turns: FloatArray | None = None
        for frame_id in sorted(set(seen.frame_id.tolist())):
            if frame_id == self.fixed:
                continue
            if not self._was_given:
                found = f"messages in the frames {self.fixed!r} and {frame_id!r}"
                raise InputError(found, "--fixed-frame: the one that tf brings them to")
            rows = np.flatnonzero(seen.frame_id == frame_id)
            pose = self._transforms.placement(frame_id, self.fixed, seen.stamp[rows])
            if turns is None:
                turns = np.tile(np.eye(3), (len(seen), 1, 1))
                place, turn, head = place.copy(), turn.copy(), head.copy()
            turns[rows] = pose.turn()
            place[rows] = np.einsum("nij,nj->ni", turns[rows], place[rows]) + pose.translation
            turn[rows] = multiplied(pose.quaternion, turn[rows])
            head[rows] = multiplied(pose.quaternion, head[rows])
            known[rows] = pose.known
        pos_std, body_variance = spread_of(seen.covariance, turns)
        _, head_variance = spread_of(seen.head_covariance, turns)
        found_place = np.where(np.isfinite(place[:, :2]).all(axis=1, keepdims=True), place[:, :2], np.nan)
        return {
            **_heading("body", yaw_of(turn), body_variance),
            **_heading("head", yaw_of(head), head_variance),
            **_of_anybody(seen, found_place),
            "pos_std": pos_std,
        }, known

    def _placed_by_transforms(
        self, seen: Seen, humans: Humans
    ) -> tuple[dict[str, NDArray[Any]], NDArray[np.bool_]]:
        assert self.fixed is not None
        n = len(seen)
        place, known = np.full((n, 2), np.nan), np.zeros(n, dtype=bool)
        body, head = np.full(n, np.nan), np.full(n, np.nan)
        for name in dict.fromkeys(seen.name.tolist()):
            rows = np.flatnonzero(seen.name == name)
            found = humans.placed(name, self.fixed, seen.stamp[rows], self._transforms)
            if found is not None:
                place[rows], body[rows], head[rows], known[rows] = found
        unknown = np.full(n, np.nan)
        return {
            **_heading("body", body, unknown),
            **_heading("head", head, unknown),
            **_of_anybody(seen, place),
            "pos_std": unknown,
        }, known


def _heading(name: str, angle: FloatArray, variance: FloatArray) -> dict[str, FloatArray]:
    kappa = np.where(np.isfinite(angle), kappa_of(variance), np.nan)
    return {f"{name}_rad": angle, f"{name}_kappa": kappa}


def _of_anybody(seen: Seen, place: FloatArray) -> dict[str, NDArray[Any]]:
    score = np.where(seen.score > 0.0, seen.score, np.nan)
    return {
        "stamp": seen.stamp,
        "name": seen.name,
        "number": seen.number,
        "x": place[:, 0],
        "y": place[:, 1],
        "score": score,
    }
