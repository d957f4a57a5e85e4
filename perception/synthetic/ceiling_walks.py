"""What people do in a room under a ceiling camera, and the ways they go."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from graphtrack.geometry.angles import FloatArray, direction
from perception.synthetic.person import Posture

ROOM = np.array([3.3, 2.4])
"""Half of the room's length and width in metres; the door is in the middle of the side towards +x."""
INSIDE = ROOM - np.array([1.15, 1.05])
"""People walk within these halves, clear of what stands along the walls."""
_OUTSIDE = np.array([ROOM[0] + 1.6, 0.0])
_STEPS_A_METRE = 0.7
_TURNING = 4.0
"""1/s: how fast bodies turn to where they go."""


@dataclass(frozen=True)
class CeilingKind:
    """What happens in a sequence; times are shares of its length.

    Attributes
    ----------
    speed : of walking, metres a second
    pauses : seconds of a halt at a place, least and most
    sits : spans in which the person sits on a chair
    moves : spans in which a piece of furniture is moved
    distracter : span in which somebody else is in the room
    target : "person", or "robot": a mobile robot is to be tracked
    """

    speed: float = 1.0
    pauses: tuple[float, float] = (0.2, 1.0)
    sits: tuple[tuple[float, float], ...] = ()
    moves: tuple[tuple[float, float], ...] = ()
    distracter: tuple[float, float] | None = None
    target: Literal["person", "robot"] = "person"


@dataclass(frozen=True, eq=False)
class Walk:
    """Somebody's way through the room, n frames.

    Attributes
    ----------
    there : (n,) whether they are in the room or on the way in or out
    position : (n, 2) metres
    body : (n,) radians
    phase : (n,) radians of the step
    stride, sitting : (n,) in 0…1
    """

    there: np.ndarray
    position: FloatArray
    body: FloatArray
    phase: FloatArray
    stride: FloatArray
    sitting: FloatArray

    def posture(self, k: int) -> Posture | None:
        """How they stand in frame k; None where they are not there."""
        if not self.there[k]:
            return None
        x, y = (float(value) for value in self.position[k])
        body = float(self.body[k])
        return Posture(
            (x, y), body, body, -0.15, float(self.phase[k]), float(self.stride[k]), float(self.sitting[k])
        )


def walk(
    kind: CeilingKind,
    rng: np.random.Generator,
    frames: int,
    fps: float,
    first: int,
    last: int,
    chair: FloatArray,
) -> Walk:
    """Through the door in frame ``first``, to and fro, with halts and seats; out again by ``last``.

    Parameters
    ----------
    frames, fps : length of the sequence, and frames a second
    last : frame by which they are out again; not at all where it is ``frames``
    chair : (2,) metres
    """
    there = np.zeros(frames, bool)
    position, sitting = np.tile(_OUTSIDE, (frames, 1)), np.zeros(frames)
    there[first:] = True
    step, k, place = kind.speed / fps, first, _OUTSIDE
    sits = [tuple(round(share * frames) for share in span) for span in kind.sits]
    goals: list[FloatArray] = [np.array([INSIDE[0], 0.0])]
    leaving = False
    while k < frames:
        due = bool(sits) and k >= sits[0][0] - _steps(place, chair, step) and not goals
        if not goals:
            goals = [chair] if due else [_goal(place, rng)]
            if last < frames and k >= last - _steps(place, _OUTSIDE, step):
                goals, leaving = [np.array([INSIDE[0], 0.0]), _OUTSIDE], True
        goal = goals.pop(0)
        count = max(_steps(place, goal, step), 1)
        for j in range(1, count + 1):
            if k < frames:
                position[k] = place + (goal - place) * j / count
                k += 1
        place = goal
        if leaving:
            if not goals:
                there[k:] = False
                break
            continue
        if due:
            halt = max(sits.pop(0)[1] - k, round(2 * fps))
            down = np.minimum(np.arange(halt), np.arange(halt)[::-1]) / (0.8 * fps)
            sitting[k : k + halt] = np.clip(down, 0.0, 1.0)[: frames - k]
        else:
            halt = round(rng.uniform(*kind.pauses) * fps)
        position[k : k + halt] = place
        k += halt
    return _moving(there, position, sitting, fps)


def _steps(start: FloatArray, end: FloatArray, step: float) -> int:
    return int(np.ceil(np.linalg.norm(end - start) / step))


def _goal(place: FloatArray, rng: np.random.Generator) -> FloatArray:
    while True:
        goal = rng.uniform(-1.0, 1.0, 2) * INSIDE
        if np.linalg.norm(goal - place) > 0.8:
            return np.asarray(goal, float)


def _moving(there: np.ndarray, position: FloatArray, sitting: FloatArray, fps: float) -> Walk:
    """Bodies that turn to where they go, and steps that fit the way."""
    step = np.diff(position, axis=0, prepend=position[:1])
    length = np.linalg.norm(step, axis=1)
    body = np.empty(len(position))
    facing = np.array([-1.0, 0.0])
    gain = 1.0 - np.exp(-_TURNING / fps)
    for k in range(len(position)):
        if length[k] > 1e-9:
            facing = facing + gain * (step[k] / length[k] - facing)
        body[k] = direction(facing)
    stride = np.convolve(np.clip(length * fps / 1.3, 0.0, 1.0), np.ones(3) / 3, mode="same")
    return Walk(there, position, body, 2.0 * np.pi * _STEPS_A_METRE * np.cumsum(length), stride, sitting)
