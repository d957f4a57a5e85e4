"""Parameters of groups, with their units, and what the literature says of them."""

from __future__ import annotations

from dataclasses import dataclass

from graphtrack.io.source import ParameterFile
from graphtrack.tracks.validation import check_numbers, number


@dataclass(frozen=True)
class GroupParameters(ParameterFile):
    """Parameters of groups.

    Attributes
    ----------
    stride : metres from somebody to the o-space ahead
    space_std : metres, 1-σ on each axis, of one member's o-space about that of the conversation
    reach : metres between two o-spaces at which a conversation is as probable as none
    body_spread, head_spread : radians, 1-σ of bodies and of heads about the direction of the o-space
    apart : log odds of two people who are further apart than 4 m, and the least of others who stand
    persistence_seconds : over which the odds of a pair are averaged
    memory_seconds : over which the time together is counted, and numbers of groups are kept
    walking_speed : m/s above which somebody walks
    walking_distance, walking_distance_std : metres between two who walk together
    walking_speed_std : m/s, 1-σ on each axis, of the velocities of two who do, one from the other's
    strangers_speed_std : of two who happen to walk near each other
    strangers_density : people per square metre who walk near somebody by chance
    walking_share : of near pairs of walkers that are together
    encounter_odds : log odds against a conversation of two who have just come near each other
    encounter_seconds : time constant with which that decays in the seconds for which they stay together
    """

    _table = "groups"

    stride: float = number(0.7, 0.0, 3.0, "m")
    space_std: float = number(0.3, 0.05, 3.0, "m")
    reach: float = number(1.2, 0.0, 4.0, "m")
    body_spread: float = number(0.4, 0.0, 3.0, "rad")
    head_spread: float = number(0.55, 0.0, 3.0, "rad")
    apart: float = number(-2.0, -50.0, 0.0)
    persistence_seconds: float = number(4.0, 0.0, 600.0, "s")
    memory_seconds: float = number(20.0, 0.0, 600.0, "s")
    walking_speed: float = number(0.5, 0.05, 10.0, "m/s")
    walking_distance: float = number(0.8, 0.1, 4.0, "m")
    walking_distance_std: float = number(0.3, 0.05, 4.0, "m")
    walking_speed_std: float = number(0.12, 0.01, 10.0, "m/s")
    strangers_speed_std: float = number(0.6, 0.05, 10.0, "m/s")
    strangers_density: float = number(0.15, 1e-4, 10.0, "1/m²")
    walking_share: float = number(0.2, 0.001, 0.999)
    encounter_odds: float = number(5.0, 0.0, 50.0)
    encounter_seconds: float = number(3.0, 0.1, 600.0, "s")

    def __post_init__(self) -> None:
        check_numbers(self)


DEFAULT = GroupParameters()
"""O-spaces as in Setti et al. (2015) and Cristani et al. (2011); see docs/behaviour.md."""
