"""A mobile robot made of solids: on the floor at the origin, x where it drives, z up."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from perception.synthetic.person import Posture
from perception.synthetic.solids import CHECKED, Builder, Solids, rotation_z

Colour = tuple[float, float, float]


@dataclass(frozen=True)
class RobotLook:
    """A round base, a trunk with a screen, and a head with cameras.

    Attributes
    ----------
    radius : of the base, metres
    height : of the whole, metres
    base, trunk, screen : albedo, blue green red
    """

    radius: float
    height: float
    base: Colour
    trunk: Colour
    screen: Colour


def random_robot(rng: np.random.Generator) -> RobotLook:
    """Another robot at each call: 0.44 to 0.56 m across, 0.9 to 1.3 m high."""

    def colour() -> Colour:
        b, g, r = (float(v) for v in np.clip(rng.uniform(0.1, 0.85) + rng.normal(0.0, 0.12, 3), 0.04, 0.9))
        return b, g, r

    return RobotLook(
        float(rng.uniform(0.22, 0.28)), float(rng.uniform(0.9, 1.3)), colour(), colour(), colour()
    )


def robot_solids(look: RobotLook, posture: Posture) -> tuple[Solids, Solids]:
    """Body and head in the world (metres); of the posture only place and directions matter."""
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
