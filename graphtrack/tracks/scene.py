"""Parameters of multi-target tracking in a scene: birth, death, detection, clutter."""

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
    acceleration_density : spectral density q of white-noise acceleration, m²/s³
    speed_std : 1-σ of each axis of a new person's velocity, m/s
    position_std : 1-σ of each axis of a detection without a declared 1-σ, m
    jump_probability : probability that a detection is an outlier, or that its person turned abruptly
    jump_std : 1-σ of each axis of such an outlier, m
    detection_probability : probability that a person in view is detected in a frame
    occlusion_probability : probability that an occlusion begins after a frame
    occlusion_seconds : mean duration of an occlusion, s
    clutter_density : false detections a frame, 1/m²
    duplicate_rate : further detections of a detected person, a frame
    duplicate_spread : 1-σ of each axis of duplicates about the first detection, m
    birth_density : rate at which people come into view, 1/(m² s)
    death_rate : rate at which people leave, 1/s
    longest_gap : time after which a person is not re-identified, s
    body_std, head_std : 1-σ of observed angles, rad
    body_turn, head_turn : rate of turning of bodies and heads, rad/√s
    body_outliers, head_outliers : share of observed angles that carry no information about identities; 1: all
    heading_std, gaze_std : 1-σ of body and head about the direction of travel, rad
    longest_filled : duration of gaps up to which they are filled, s
    look_ahead : number of detections after a cut that are evidence of identities
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

    def described(self) -> str:
        """Return what is known of the scene in words, with units."""
        return (
            f"people are detected in {100.0 * self.detection_probability:.0f} % of the frames "
            f"(σ {self.position_std:.2g} m), {self.clutter_density:.2g} false detections a frame and m², "
            f"{self.duplicate_rate:.2g} duplicates a detection; "
            f"{3600.0 * self.birth_density:.3g} people come an hour and m², "
            f"and stay {1.0 / self.death_rate:.3g} s"
        )

    def packed(self, frame_seconds: float) -> tuple[float, ...]:
        """Return the values for kernels, in the order of `likelihood.SceneRow`, for a frame interval (s)."""
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
"""Fixed values of some fields of `SceneParameters`; the remaining fields are learned."""

NOTHING: Known = MappingProxyType({})

GivenScene: TypeAlias = SceneParameters | Mapping[str, Any] | None
"""Known parameters of a scene: all, some by name, or none."""


def known_values(scene: GivenScene) -> Known:
    """Return the known parameters of a scene by name."""
    if scene is None:
        return {}
    if isinstance(scene, SceneParameters):
        return asdict(scene)
    with_table(SceneParameters(), "scene", scene)
    return dict(scene)
