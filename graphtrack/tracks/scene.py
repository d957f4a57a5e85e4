"""Parameters of a scene in which people are detected: birth, death, detection, clutter."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from types import MappingProxyType
from typing import Any, TypeAlias

from graphtrack.tracks.validation import check_numbers, number, with_table


@dataclass(frozen=True)
class SceneParameters:
    """Birth, death, detection and clutter of people.

    Attributes
    ----------
    acceleration_density : q of white-noise acceleration, m²/s³
    speed_std : of a velocity that nothing is known of, m/s on each axis
    position_std : of detections that do not say how noisy they are, m
    jump_probability : that a detection is further off than that, or its person has jumped or turned abruptly
    jump_std : how far, on each axis, m
    detection_probability : of a person in view, in a frame
    occlusion_probability : that a frame is the last one before somebody is hidden
    occlusion_seconds : that one is hidden for, on average
    clutter_density : false detections a frame and square metre
    duplicate_rate : further detections of somebody who was detected, a frame
    duplicate_spread : standard deviation of their places about the first one, on each axis, m
    birth_density : people who come into view, a second and square metre
    death_rate : 1/s at which people leave
    longest_gap : seconds after which nobody is found again
    body_std, head_std : of observed angles, rad
    body_turn, head_turn : what bodies and heads turn, rad/√s
    body_outliers, head_outliers : share of observed angles that have nothing to do with the person; 1: angles
        say nothing of who is who
    heading_std, gaze_std : of the body and the head from where the person goes, rad
    longest_filled : gaps of so many seconds are filled with where the person must have been
    look_ahead : detections of a track after a cut that say whose they are
    """

    acceleration_density: float = number(0.1, 1e-4, 100.0, "m²/s³")
    speed_std: float = number(1.0, 0.05, 30.0, "m/s")
    position_std: float = number(0.1, 1e-4, 100.0, "m")
    jump_probability: float = number(0.01, 0.0, 0.5)
    jump_std: float = number(0.5, 0.01, 10.0, "m")
    detection_probability: float = number(0.9, 0.01, 0.999)
    occlusion_probability: float = number(0.01, 1e-6, 0.5)
    occlusion_seconds: float = number(2.0, 0.05, 60.0, "s")
    clutter_density: float = number(1e-3, 1e-9, 100.0, "1/m²")
    duplicate_rate: float = number(0.02, 0.0, 10.0)
    duplicate_spread: float = number(0.5, 1e-3, 10.0, "m")
    birth_density: float = number(1e-3, 1e-9, 100.0, "1/(m² s)")
    death_rate: float = number(0.05, 1e-6, 10.0, "1/s")
    longest_gap: float = number(6.0, 0.05, 60.0, "s")
    body_std: float = number(0.3, 0.02, 3.0, "rad")
    body_turn: float = number(0.5, 0.01, 10.0, "rad/√s")
    body_outliers: float = number(1.0, 0.01, 1.0)
    head_std: float = number(0.4, 0.02, 3.0, "rad")
    head_turn: float = number(0.8, 0.01, 10.0, "rad/√s")
    head_outliers: float = number(1.0, 0.01, 1.0)
    heading_std: float = number(0.4, 0.05, 3.0, "rad")
    gaze_std: float = number(0.4, 0.05, 3.0, "rad")
    longest_filled: float = number(2.0, 0.0, 60.0, "s")
    look_ahead: int = number(8, 1, 100)

    def __post_init__(self) -> None:
        check_numbers(self)

    def packed(self, frame_seconds: float) -> tuple[float, ...]:
        """The values that kernels read, in the order of `kernels.Scene`, for frames so many seconds apart."""
        return (
            self.acceleration_density,
            self.speed_std**2,
            self.jump_probability,
            self.jump_std**2,
            math.log1p(-self.detection_probability),
            math.log(self.occlusion_probability),
            self.occlusion_seconds,
            math.log(self.birth_density * frame_seconds),
            math.log(-math.expm1(-self.death_rate * frame_seconds)),
            self.longest_gap,
            frame_seconds,
            float(self.look_ahead),
            self.body_std**2,
            self.body_turn**2,
            self.body_outliers,
            self.head_std**2,
            self.head_turn**2,
            self.head_outliers,
            self.heading_std**2,
            self.gaze_std**2,
        )


Known: TypeAlias = Mapping[str, Any]
"""Values of some of the fields of `SceneParameters`, which are kept where the others are learned."""

NOTHING: Known = MappingProxyType({})

GivenScene: TypeAlias = SceneParameters | Mapping[str, Any] | None
"""Known parameters of a scene: all of them, some by their names, or none."""


def known_values(scene: GivenScene) -> Known:
    """The known parameters of a scene by their names."""
    if scene is None:
        return {}
    if isinstance(scene, SceneParameters):
        return asdict(scene)
    with_table(SceneParameters(), "scene", scene)
    return dict(scene)
