"""Parameters of groups, with their units, and their learned values."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np

from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray
from graphtrack.tracks.validation import check_numbers, number, with_table


@dataclass(frozen=True)
class ConversationWeights:
    """Weights of a pair's features in the log odds that the two are in one conversation.

    Attributes
    ----------
    bias : log odds to begin with
    shared : for log(1 + people who share the o-space of both), the two counted too
    crowd : for log of how many stand about the one, and of how many about the other
    far : for each metre from the o-space ahead of the one to the other, the longer way of the two
    rank : for log(1 + people nearer to the one than the other is), summed over both
    look : for the share of looks at the other, of the one who looks less
    caution : taken from the log odds of every pair before people are parted into groups
    """

    bias: float = number(0.0, -50.0, 50.0)
    shared: float = number(0.0, 0.0, 50.0)
    crowd: float = number(0.0, -50.0, 0.0)
    far: float = number(0.0, -50.0, 0.0, "1/m")
    rank: float = number(0.0, -50.0, 0.0)
    look: float = number(0.0, 0.0, 50.0)
    caution: float = number(0.0, -10.0, 10.0)

    def __post_init__(self) -> None:
        check_numbers(self)

    @property
    def of_features(self) -> FloatArray:
        """(5,) weights in the order of `features.FEATURES`."""
        return np.array([self.shared, self.crowd, self.far, self.rank, self.look])


RINGS = (0.0, 0.3, 0.6, 0.9, 1.2, 1.6)
"""Metres from an o-space, in the order of the fields of `FacingWeights`."""


@dataclass(frozen=True)
class FacingWeights:
    """Log odds that somebody adds to a body direction, by its distance from the o-space ahead in cm.

    Attributes
    ----------
    at_0, at_30, at_60, at_90, at_120, at_160 : for each person at that distance
    """

    at_0: float = number(0.0, -50.0, 50.0)
    at_30: float = number(0.0, -50.0, 50.0)
    at_60: float = number(0.0, -50.0, 50.0)
    at_90: float = number(0.0, -50.0, 50.0)
    at_120: float = number(0.0, -50.0, 50.0)
    at_160: float = number(0.0, -50.0, 50.0)

    def __post_init__(self) -> None:
        check_numbers(self)

    @property
    def of_rings(self) -> FloatArray:
        """(6,) in the order of `RINGS`."""
        return np.array([self.at_0, self.at_30, self.at_60, self.at_90, self.at_120, self.at_160])


@dataclass(frozen=True)
class GroupParameters:
    """Parameters of groups.

    Attributes
    ----------
    places, bodies, heads : weights where positions alone are known, with the bodies, and with the heads too
    companions, strangers : where a body faces by where companions, and others, stand
    stride : metres to the o-space ahead of a body
    place_seconds : over which what places and bodies say is averaged
    look_seconds : over which looks, and the crowd, are averaged
    apart : log odds of two people who are further apart than 4 m
    head_spread : radians, 1-σ of heads about bodies, where heads stand for bodies that nobody saw
    walking_speed : m/s above which somebody walks
    walking_distance, walking_distance_std : metres between two who walk together
    walking_speed_std : m/s, 1-σ on each axis, of the velocities of two who do, one from the other's
    strangers_speed_std : of two who happen to walk near each other
    strangers_density : people per square metre who walk near somebody by chance
    walking_seconds : over which walking is averaged
    walking_share : of near pairs of walkers that are together
    encounter_odds : log odds against a conversation of two who have just come near each other
    encounter_seconds : time constant with which that decays in the seconds for which they stay together
    """

    places: ConversationWeights = field(default_factory=ConversationWeights)
    bodies: ConversationWeights = field(default_factory=ConversationWeights)
    heads: ConversationWeights = field(default_factory=ConversationWeights)
    companions: FacingWeights = field(default_factory=FacingWeights)
    strangers: FacingWeights = field(default_factory=FacingWeights)
    stride: float = number(0.65, 0.0, 3.0, "m")
    place_seconds: float = number(6.0, 0.0, 600.0, "s")
    look_seconds: float = number(20.0, 0.0, 600.0, "s")
    apart: float = number(-4.0, -50.0, 0.0)
    head_spread: float = number(0.6, 0.0, 3.0, "rad")
    walking_speed: float = number(0.5, 0.05, 10.0, "m/s")
    walking_distance: float = number(0.8, 0.1, 4.0, "m")
    walking_distance_std: float = number(0.3, 0.05, 4.0, "m")
    walking_speed_std: float = number(0.12, 0.01, 10.0, "m/s")
    strangers_speed_std: float = number(0.6, 0.05, 10.0, "m/s")
    strangers_density: float = number(0.15, 1e-4, 10.0, "1/m²")
    walking_seconds: float = number(4.0, 0.0, 600.0, "s")
    walking_share: float = number(0.2, 0.001, 0.999)
    encounter_odds: float = number(8.0, 0.0, 50.0)
    encounter_seconds: float = number(7.0, 0.1, 600.0, "s")

    def __post_init__(self) -> None:
        check_numbers(self)

    def with_weights(self, name: str, weights: ConversationWeights) -> GroupParameters:
        """With other weights in place of ``places``, ``bodies`` or ``heads``."""
        changed: dict[str, Any] = {name: weights}
        return replace(self, **changed)

    @property
    def conversations(self) -> tuple[ConversationWeights, ...]:
        """The weights in the order of what is known of people: their places, bodies, heads."""
        return self.places, self.bodies, self.heads

    @property
    def seconds(self) -> tuple[float, float, float]:
        """The times over which a pair's values are averaged, as `PairValues` has them."""
        return self.place_seconds, self.look_seconds, self.walking_seconds

    @classmethod
    def from_dict(cls, tables: dict[str, Any], start: GroupParameters) -> GroupParameters:
        """Parameters from nested tables; what is not named is as in ``start``.

        Raise InputError for an unknown name, and for a value out of its range.
        """
        # Earlier files call strangers others.
        given = {name.replace("others", "strangers"): value for name, value in tables.items()}
        parts = {}
        for name in ("places", "bodies", "heads", "companions", "strangers"):
            if name in given:
                table = given.pop(name)
                if not isinstance(table, dict):
                    raise InputError(f"{name} = {table!r}", f"a table [groups.{name}]")
                parts[name] = with_table(getattr(start, name), f"groups.{name}", table)
        return replace(with_table(start, "groups", given), **parts)

    def to_dict(self) -> dict[str, Any]:
        """Return nested tables: the inverse of `from_dict`."""
        return asdict(self)


DEFAULT = GroupParameters(
    places=ConversationWeights(bias=12.863, shared=0.831, crowd=-3.054, far=-2.781, caution=-0.5),
    bodies=ConversationWeights(bias=9.127, shared=5.338, crowd=-3.536, far=-1.124, rank=-0.307, caution=0.5),
    heads=ConversationWeights(
        bias=8.282, shared=5.03, crowd=-3.32, far=-0.767, rank=-0.506, look=11.482, caution=0.5
    ),
    companions=FacingWeights(at_0=-0.39, at_30=0.901, at_60=1.413, at_90=1.416, at_120=0.747, at_160=-0.098),
    strangers=FacingWeights(at_0=-0.875, at_30=-0.043, at_60=0.019, at_90=0.107, at_120=0.175, at_160=-0.438),
)
"""By ``graphtrack fit --groups`` from SALSA's rows up to t = 1000 s; see docs/behaviour.md."""
