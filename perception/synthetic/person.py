"""A walking person made of solids: on the ground at the origin, x where the body points, y left, z up."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from graphtrack.geometry.angles import FloatArray
from perception.synthetic.appearance import Appearance
from perception.synthetic.head import head_solids
from perception.synthetic.solids import Builder, Solids, rotation_up, rotation_z

_REFERENCE_HEIGHT = 1.72
_HEAD_HEIGHT = 1.585
"""Metres of the head's origin above the ground, for a person of the reference height."""
_THIGH = 0.42


@dataclass(frozen=True)
class Posture:
    """Where a person is and how they stand.

    Attributes
    ----------
    position : (2,) metres on the ground
    body, head : world directions (radians) of the torso and of the face, seen from above
    tilt : of the head, radians above the horizontal
    phase : of the step, radians; a step of each leg is 2π
    stride : amplitude of the step, 0 (standing) to 1
    sitting : how far the person has sat down, 0 (upright) to 1 (thighs level, as on a chair)
    """

    position: tuple[float, float]
    body: float
    head: float
    tilt: float = 0.0
    phase: float = 0.0
    stride: float = 0.0
    sitting: float = 0.0


def person_solids(look: Appearance, posture: Posture) -> tuple[Solids, Solids]:
    """Body and head in the world (metres)."""
    return placed(look, posture, _upper_body(look, posture), _legs(look, posture), head_solids(look))


def placed(
    look: Appearance, posture: Posture, upper: Solids, legs: Solids, head: Solids
) -> tuple[Solids, Solids]:
    """Body and head in the world (metres), of parts of a person of the reference height at the origin.

    Parameters
    ----------
    upper, legs : x where the body points, z up from the ground
    head : as of `head_solids`
    """
    size = look.height / _REFERENCE_HEIGHT
    turn, place = rotation_z(posture.body), (*posture.position, 0.0)
    # Who sits down lowers hips, trunk and head by what the thighs lose in height.
    lowered = _THIGH * (1.0 - np.cos(_bend(posture)))
    upper = upper.moved(np.eye(3), (0.0, 0.0, -lowered))
    body = Solids.together(upper, legs).scaled(size).moved(turn, place)
    # The head turns about the neck, which bows forward a little.
    pivot = np.array([-0.03, 0.0, -0.10])
    facing = rotation_z(posture.head - posture.body) @ rotation_up(posture.tilt)
    head = head.moved(np.eye(3), -pivot).moved(facing, pivot + np.array([0.01, 0.0, _HEAD_HEIGHT - lowered]))
    return body, head.scaled(size).moved(turn, place)


def _bend(posture: Posture) -> float:
    """Radians that the thighs are off the vertical because the person sits."""
    return 0.5 * np.pi * posture.sitting


def _upper_body(look: Appearance, posture: Posture) -> Solids:
    make = Builder()
    wide, cloth = look.build, look.top_texture
    top, skin = np.array(look.top), np.array(look.skin)
    swing = posture.stride * np.sin(posture.phase)
    make.limb((-0.02, 0.0, 1.40), (-0.02, 0.0, 1.54), 0.052, skin * 0.9, skin=True)
    make.ellipsoid((-0.01, 0.0, 1.22), (0.115 * wide, 0.185 * wide, 0.26), top, texture=cloth)
    make.ellipsoid((-0.01, 0.0, 1.39), (0.085, 0.20 * wide, 0.075), top, texture=cloth)
    make.ellipsoid((0.0, 0.0, 0.98), (0.115 * wide, 0.165 * wide, 0.16), top, texture=cloth)
    make.ellipsoid((0.0, 0.0, 0.90), (0.112 * wide, 0.160 * wide, 0.12), look.trousers)
    make.ellipsoid((0.06, 0.0, 1.40), (0.035, 0.06, 0.06), skin * 0.9, skin=True)
    if look.open_jacket:
        make.ellipsoid((0.06 * wide, 0.0, 1.18), (0.066, 0.062, 0.24), look.shirt)
    if look.backpack:
        make.ellipsoid((-0.17 * wide, 0.0, 1.20), (0.10, 0.15, 0.21), look.hat_colour)
        for side in (-1.0, 1.0):
            make.ellipsoid((0.02, side * 0.11, 1.30), (0.105 * wide, 0.02, 0.16), look.hat_colour)
    for side in (-1.0, 1.0):
        _arm(make, look, side, -side * swing)
    return make.build()


def _legs(look: Appearance, posture: Posture) -> Solids:
    make = Builder()
    swing = posture.stride * np.sin(posture.phase)
    for side in (-1.0, 1.0):
        _leg(make, look, side, side * swing, posture)
    return make.build()


def _leg(make: Builder, look: Appearance, side: float, swing: float, posture: Posture) -> None:
    bend = _bend(posture)
    hip = hip_of(look, side) - np.array([0.0, 0.0, _THIGH * (1.0 - np.cos(bend))])
    thigh = 0.45 * swing + bend
    # The knee bends while the leg comes forward.
    lifted = max(0.0, side * np.cos(posture.phase)) * posture.stride
    shin = 0.45 * swing - 0.75 * lifted - 0.1 * posture.stride
    knee = hip + _THIGH * np.array([np.sin(thigh), 0.0, -np.cos(thigh)])
    ankle = knee + 0.41 * np.array([np.sin(shin), 0.0, -np.cos(shin)])
    make.limb(hip, knee, 0.078 * look.build, look.trousers)
    make.limb(knee, ankle, 0.054 * look.build, look.trousers)
    make.ellipsoid(ankle + np.array([0.065, 0.0, -0.025]), (0.135, 0.05, 0.044), look.shoes)


def shoulder_of(look: Appearance, side: float) -> FloatArray:
    """The shoulder (3,) of a standing person of the reference height; side 1 is the left."""
    return np.array([-0.01, side * 0.215 * look.build, 1.40])


def hip_of(look: Appearance, side: float) -> FloatArray:
    """The hip (3,), as `shoulder_of`."""
    return np.array([0.0, side * 0.085 * look.build, 0.90])


def _arm(make: Builder, look: Appearance, side: float, swing: float) -> None:
    shoulder = shoulder_of(look, side)
    upper, fore = 0.55 * swing - 0.05, 0.55 * swing + 0.30
    outward = side * 0.04
    elbow = shoulder + np.array([0.28 * np.sin(upper), outward, -0.28 * np.cos(upper)])
    wrist = elbow + np.array([0.25 * np.sin(fore), -outward * 0.5, -0.25 * np.cos(fore)])
    make.limb(shoulder, elbow, 0.055, look.top, texture=look.top_texture)
    if look.bare_arms:
        make.limb(elbow, wrist, 0.038, look.skin, skin=True)
    else:
        make.limb(elbow, wrist, 0.045, look.top, texture=look.top_texture)
    make.ellipsoid(wrist + np.array([0.02, 0.0, -0.07]), (0.035, 0.03, 0.075), look.skin, skin=True)
