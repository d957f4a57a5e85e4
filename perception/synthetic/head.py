"""A head made of solids, in its own frame: origin between the ears, x where the face points, y left, z up."""

from __future__ import annotations

import numpy as np

from perception.synthetic.appearance import Appearance
from perception.synthetic.solids import PLAIN, SPECKLED, Builder, Solids

NECK_BELOW = 0.10
"""Metres from the head's origin down to the neck's pivot."""

CORE, EXTRA = 0, 1
"""Groups of a head's solids: what its box encloses, and what hangs or sticks out."""

_DARK = (0.03, 0.03, 0.035)


def head_solids(look: Appearance) -> Solids:
    """Skull, face, ears, hair, hat, glasses and beard (metres).

    Group CORE is the skull with its cap of hair, the face, and hats that fit closely; group EXTRA long hair,
    buns, brims and hoods, which say little about where the head itself is.
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
    # Everything in front of and below the hair line is cut off: the face and what is below the ears.
    lines = {"receding": (0.80, 0.0, 0.10, 0.02), "bald": (0.70, 0.0, 0.72, -0.22)}
    line = lines.get(look.hair, (0.80, 0.0, -0.60, 0.16))
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
    colour, cloth = look.hat_colour, (PLAIN, 0.0, 0.0)
    dome = np.array((0.108, 0.088, 0.104))
    if look.hat == "cap":
        make.ellipsoid((-0.010, 0.0, 0.042), dome, colour, clip=(0.0, 0.0, -1.0, -0.12), texture=cloth)
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
    """What shows below a head, in the body's frame with the head's origin at 0."""
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
