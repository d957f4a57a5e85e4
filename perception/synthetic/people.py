"""People and robots composed of solids: appearance, head, body and posture.

Frames: x is the direction of the face or body, y left, z up; the origin is between the ears (heads) or on the
ground.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from graphtrack.geometry.angles import FloatArray
from perception.synthetic.solids import (
    CHECKED,
    PLAIN,
    SPECKLED,
    STRIPED,
    Builder,
    Solids,
    rotation_up,
    rotation_z,
)

Reflectance = tuple[float, float, float]
Hair = Literal["short", "long", "bun", "bald", "receding", "afro", "ponytail"]
Hat = Literal["none", "cap", "beanie", "brim", "hood"]

_SKIN = np.array(
    [
        [0.62, 0.72, 0.88],
        [0.50, 0.62, 0.80],
        [0.40, 0.54, 0.72],
        [0.27, 0.39, 0.56],
        [0.16, 0.24, 0.37],
        [0.10, 0.15, 0.24],
    ]
)
_HAIR = np.array(
    [
        [0.04, 0.045, 0.05],
        [0.06, 0.09, 0.13],
        [0.10, 0.17, 0.27],
        [0.25, 0.42, 0.58],
        [0.50, 0.52, 0.55],
        [0.08, 0.18, 0.42],
    ]
)
_HAIR_SHARE = (0.34, 0.26, 0.16, 0.10, 0.10, 0.04)
_STYLES: tuple[Hair, ...] = get_args(Hair)
_STYLE_SHARE = (0.40, 0.20, 0.08, 0.08, 0.08, 0.06, 0.10)
_HATS: tuple[Hat, ...] = get_args(Hat)
_HAT_SHARE = (0.88, 0.04, 0.04, 0.02, 0.02)
_TEXTURES = (PLAIN, SPECKLED, STRIPED, CHECKED)
_TEXTURE_SHARE = (0.55, 0.15, 0.18, 0.12)


@dataclass(frozen=True)
class Appearance:
    """Appearance of one person.

    Attributes
    ----------
    skin, hair_colour, hat_colour, top, shirt, trousers, shoes : albedo, blue green red in 0…1
    hair, hat : style
    glasses, beard : whether present
    open_jacket : whether a strip of shirt shows on the chest
    backpack : whether present, in ``hat_colour``
    bare_arms : whether the forearms are skin
    top_texture : texture of the upper clothes, as in `Solids.texture`
    stretch : factors of the head's length, width and height
    height : metres
    build : factor of the body's width
    """

    skin: Reflectance
    hair_colour: Reflectance
    hair: Hair
    hat: Hat
    hat_colour: Reflectance
    glasses: bool
    beard: bool
    top: Reflectance
    shirt: Reflectance
    trousers: Reflectance
    shoes: Reflectance
    open_jacket: bool
    backpack: bool
    bare_arms: bool
    top_texture: tuple[int, float, float]
    stretch: tuple[float, float, float]
    height: float
    build: float


def random_appearance(rng: np.random.Generator) -> Appearance:
    """Draw one person."""

    def cloth(low: float = 0.03, high: float = 0.9) -> Reflectance:
        grey = rng.uniform(low, high)
        return _colour(np.clip(grey + rng.normal(0.0, 0.12, 3), 0.02, 0.95))

    share = rng.random()
    tone = _SKIN[int(share * 5)] * (1 - share * 5 % 1) + _SKIN[int(share * 5) + 1] * (share * 5 % 1)
    hair = _STYLES[rng.choice(len(_STYLES), p=_STYLE_SHARE)]
    return Appearance(
        skin=_colour(tone * rng.uniform(0.92, 1.08, 3)),
        hair_colour=_colour(_HAIR[rng.choice(len(_HAIR), p=_HAIR_SHARE)] * rng.uniform(0.8, 1.2)),
        hair=hair,
        hat=_HATS[rng.choice(len(_HATS), p=_HAT_SHARE)],
        hat_colour=cloth(0.03, 0.7),
        glasses=bool(rng.random() < 0.25),
        beard=bool(rng.random() < 0.15 and hair in ("short", "bald", "receding")),
        top=cloth(),
        shirt=cloth(0.3, 0.95),
        trousers=cloth(0.03, 0.45),
        shoes=cloth(0.02, 0.4),
        open_jacket=bool(rng.random() < 0.4),
        backpack=bool(rng.random() < 0.2),
        bare_arms=bool(rng.random() < 0.35),
        top_texture=(
            int(_TEXTURES[rng.choice(4, p=_TEXTURE_SHARE)]),
            float(rng.uniform(0.1, 0.5)),
            float(rng.uniform(3.0, 9.0)),
        ),
        stretch=tuple(rng.normal(1.0, 0.04, 3)),
        height=float(np.clip(rng.normal(1.72, 0.09), 1.45, 2.0)),
        build=float(rng.uniform(0.85, 1.25)),
    )


def _colour(values: np.ndarray) -> Reflectance:
    b, g, r = (float(value) for value in values)
    return b, g, r


CORE, EXTRA = 0, 1
"""Groups of a head's solids: inside its box, and protruding."""

_DARK = (0.03, 0.03, 0.035)


def head_solids(look: Appearance) -> Solids:
    """Build skull, face, ears, hair, hat, glasses and beard (metres).

    Group CORE is the skull with its cap of hair, the face, and hats that fit closely; group EXTRA long hair,
    buns, brims and hoods, which do not define the position of the head.
    """
    make, extra = Builder(), Builder()
    _face(make, look)
    if look.hat != "hood":
        _hair(make, look)
        _long_hair(extra, look)
    _hat(make, extra, look)
    if look.glasses:
        for side in (-1.0, 1.0):
            make.ellipsoid((0.094, side * 0.034, 0.012), (0.010, 0.026, 0.017), _DARK)
            make.limb((0.080, side * 0.066, 0.016), (0.0, side * 0.079, 0.016), 0.004, _DARK)
        make.limb((0.104, -0.012, 0.014), (0.104, 0.012, 0.014), 0.004, _DARK)
    return Solids.together(make.build(CORE), extra.build(EXTRA)).scaled(look.stretch)


def _face(make: Builder, look: Appearance) -> None:
    skin = np.array(look.skin)
    make.ellipsoid((-0.008, 0.0, 0.035), (0.097, 0.076, 0.092), skin, skin=True)
    make.ellipsoid((0.034, 0.0, -0.040), (0.060, 0.057, 0.078), skin, skin=True)
    make.ellipsoid((0.055, 0.0, -0.095), (0.032, 0.034, 0.024), skin, skin=True)
    make.ellipsoid((0.100, 0.0, -0.020), (0.026, 0.016, 0.017), skin * 0.97, skin=True)
    make.ellipsoid((0.090, 0.0, 0.005), (0.014, 0.010, 0.030), skin, skin=True)
    make.ellipsoid((0.090, 0.0, -0.062), (0.010, 0.026, 0.008), skin * (0.55, 0.5, 0.75), skin=True)
    for side in (-1.0, 1.0):
        make.ellipsoid((0.079, side * 0.033, 0.014), (0.012, 0.019, 0.013), skin * 0.55, skin=True)
        make.ellipsoid((0.086, side * 0.033, 0.012), (0.008, 0.012, 0.006), (0.7, 0.7, 0.7))
        make.ellipsoid((0.090, side * 0.033, 0.012), (0.006, 0.006, 0.006), _DARK)
        make.ellipsoid((0.086, side * 0.035, 0.034), (0.010, 0.021, 0.005), np.array(look.hair_colour) * 0.7)
        make.ellipsoid((-0.012, side * 0.079, 0.000), (0.021, 0.011, 0.033), skin * 0.93, skin=True)
        make.ellipsoid((-0.008, side * 0.088, 0.000), (0.010, 0.005, 0.018), skin * 0.6, skin=True)
    if look.beard:
        make.ellipsoid(
            (0.040, 0.0, -0.062),
            (0.064, 0.060, 0.062),
            look.hair_colour,
            clip=(0.5, 0.0, 0.87, 0.42),
            texture=(SPECKLED, 0.25, 6.0),
        )


def _hair(make: Builder, look: Appearance) -> None:
    colour, strands = look.hair_colour, (SPECKLED, 0.22, 8.0)
    # Hair in front of and below the hair line is cut off: at the face and below the ears.
    line = (0.70, 0.0, 0.72, -0.22) if look.hair == "bald" else (0.80, 0.0, -0.60, 0.16)
    size = {"afro": 1.38, "bald": 1.02}.get(look.hair, 1.09)
    semi = np.array((0.097, 0.076, 0.092)) * size
    if look.hair == "receding":
        make.ellipsoid((-0.012, 0.0, 0.030), semi, colour, clip=(0.75, 0.0, -0.35, 0.0), texture=strands)
    else:
        make.ellipsoid((-0.014, 0.0, 0.036), semi, colour, clip=line, texture=strands)
    make.ellipsoid((-0.055, 0.0, -0.030), (0.052, 0.068, 0.070), colour, texture=strands)


def _long_hair(make: Builder, look: Appearance) -> None:
    colour, strands = look.hair_colour, (SPECKLED, 0.22, 8.0)
    if look.hair == "long":
        make.ellipsoid((-0.052, 0.0, -0.075), (0.055, 0.088, 0.135), colour, texture=strands)
        for side in (-1.0, 1.0):
            make.ellipsoid((-0.010, side * 0.074, -0.050), (0.050, 0.020, 0.115), colour, texture=strands)
    elif look.hair == "bun":
        make.ellipsoid((-0.108, 0.0, 0.080), (0.040, 0.042, 0.040), colour, texture=strands)
    elif look.hair == "ponytail":
        make.ellipsoid((-0.112, 0.0, 0.040), (0.028, 0.026, 0.030), colour, texture=strands)
        make.ellipsoid((-0.122, 0.0, -0.050), (0.024, 0.030, 0.095), colour, texture=strands)


def _hat(make: Builder, extra: Builder, look: Appearance) -> None:
    colour = look.hat_colour
    dome = np.array((0.108, 0.088, 0.104))
    if look.hat == "cap":
        make.ellipsoid((-0.010, 0.0, 0.042), dome, colour, clip=(0.0, 0.0, -1.0, -0.12))
        extra.ellipsoid((0.115, 0.0, 0.058), (0.070, 0.070, 0.009), np.array(colour) * 0.8)
    elif look.hat == "beanie":
        make.ellipsoid(
            (-0.012, 0.0, 0.044),
            dome * 1.02,
            colour,
            clip=(0.25, 0.0, -0.97, 0.02),
            texture=(SPECKLED, 0.15, 7.0),
        )
    elif look.hat == "brim":
        make.ellipsoid((-0.010, 0.0, 0.062), (0.104, 0.086, 0.105), colour, clip=(0.0, 0.0, -1.0, 0.0))
        extra.ellipsoid((-0.008, 0.0, 0.066), (0.170, 0.152, 0.010), np.array(colour) * 0.85)
    elif look.hat == "hood":
        extra.ellipsoid((-0.020, 0.0, 0.010), (0.122, 0.100, 0.140), look.top, clip=(1.0, 0.0, 0.0, 0.35))


def neck_and_shoulders(look: Appearance) -> Solids:
    """Build neck and shoulders, in the body's frame with the head's origin at 0."""
    make = Builder()
    make.limb((-0.022, 0.0, -0.05), (-0.030, 0.0, -0.17), 0.052, np.array(look.skin) * 0.9, skin=True)
    make.ellipsoid(
        (-0.035, 0.0, -0.235), (0.090, 0.130 * look.build, 0.075), look.top, texture=look.top_texture
    )
    make.ellipsoid(
        (-0.035, 0.0, -0.40), (0.115, 0.205 * look.build, 0.19), look.top, texture=look.top_texture
    )
    if look.open_jacket:
        make.ellipsoid((0.030, 0.0, -0.33), (0.060, 0.055, 0.16), look.shirt)
    if look.hat == "hood":
        make.ellipsoid((-0.05, 0.0, -0.16), (0.09, 0.10, 0.06), look.top)
    return make.build()


_REFERENCE_HEIGHT = 1.72
_HEAD_HEIGHT = 1.585
"""Metres of the head's origin above the ground, for a person of the reference height."""
_THIGH = 0.42


@dataclass(frozen=True)
class Posture:
    """Position and posture of a person.

    Attributes
    ----------
    position : (2,) metres on the ground
    body, head : world directions (radians) of the torso and of the face, from above
    tilt : of the head, radians above the horizontal
    phase : of the step, radians; a step of each leg is 2π
    stride : amplitude of the step, 0 (standing) to 1
    sitting : degree of sitting, 0 (upright) to 1 (thighs level, as on a chair)
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
    upper, legs : x in the body's direction, z up from the ground
    head : as of `head_solids`
    """
    size = look.height / _REFERENCE_HEIGHT
    turn, place = rotation_z(posture.body), (*posture.position, 0.0)
    # Sitting lowers hips, trunk and head by the vertical loss of the thighs.
    lowered = _THIGH * (1.0 - np.cos(_bend(posture)))
    upper = upper.moved(np.eye(3), (0.0, 0.0, -lowered))
    body = Solids.together(upper, legs).scaled(size).moved(turn, place)
    # The head turns about the neck, which leans forward slightly.
    pivot = np.array([-0.03, 0.0, -0.10])
    facing = rotation_z(posture.head - posture.body) @ rotation_up(posture.tilt)
    head = head.moved(np.eye(3), -pivot).moved(facing, pivot + np.array([0.01, 0.0, _HEAD_HEIGHT - lowered]))
    return body, head.scaled(size).moved(turn, place)


def _bend(posture: Posture) -> float:
    """Return the angle of the thighs from the vertical due to sitting, radians."""
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
    make, bend = Builder(), _bend(posture)
    for side in (-1.0, 1.0):
        swing = side * posture.stride * np.sin(posture.phase)
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
    return make.build()


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


@dataclass(frozen=True)
class RobotLook:
    """Robot of a round base, a trunk with a screen, and a head with cameras.

    Attributes
    ----------
    radius : of the base, metres
    height : of the whole, metres
    base, trunk, screen : albedo, blue green red
    """

    radius: float
    height: float
    base: Reflectance
    trunk: Reflectance
    screen: Reflectance


def random_robot(rng: np.random.Generator) -> RobotLook:
    """Draw a robot, 0.44 to 0.56 m across and 0.9 to 1.3 m high."""

    def colour() -> Reflectance:
        return _colour(np.clip(rng.uniform(0.1, 0.85) + rng.normal(0.0, 0.12, 3), 0.04, 0.9))

    return RobotLook(
        float(rng.uniform(0.22, 0.28)), float(rng.uniform(0.9, 1.3)), colour(), colour(), colour()
    )


def robot_solids(look: RobotLook, posture: Posture) -> tuple[Solids, Solids]:
    """Body and head in the world (metres); only position and directions of the posture are used."""
    place, r, top = (*posture.position, 0.0), look.radius, look.height
    body = Builder()
    body.ellipsoid((0.0, 0.0, 0.14), (r, r, 0.13), look.base, texture=(CHECKED, 0.35, 6.0))
    body.ellipsoid((0.0, 0.0, 0.26), (0.8 * r, 0.8 * r, 0.10), look.trunk)
    body.limb((-0.05, 0.0, 0.28), (-0.05, 0.0, top - 0.2), 0.4 * r, look.trunk)
    body.box((0.11, 0.0, 0.62 * top), (0.015, 0.13, 0.1), look.screen)
    head = Builder()
    head.ellipsoid((0.0, 0.0, top - 0.1), (0.11, 0.14, 0.1), look.base)
    for side in (-1.0, 1.0):
        head.ellipsoid((0.09, side * 0.05, top - 0.09), (0.03, 0.03, 0.03), (0.05, 0.05, 0.05))
    turned = head.build().moved(rotation_z(posture.head), place)
    return body.build().moved(rotation_z(posture.body), place), turned
