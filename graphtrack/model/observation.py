"""One step of a track as factors read it, and the states of a whole track as densities read them."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from graphtrack.errors import NO_POSITION, InputError, SolveError
from graphtrack.geometry.angles import FloatArray
from graphtrack.geometry.camera import GroundCamera
from graphtrack.model.terms.classes import PERSISTENCE, SINCE, TOGETHER, with_seconds_since_classes
from graphtrack.packages import gtsam
from graphtrack.tracks.sensors import Sensor, changed_channels
from graphtrack.tracks.track import Track

Covariance = tuple[tuple[float, ...], ...]
"""Rows of a symmetric matrix."""


@dataclass(frozen=True, eq=False)
class Observation:
    """Observations of one person at one time. ``None`` is a missing channel; units as in `Track`.

    ``sensor`` is the name of the sensor, "" without one. A covariance is a 2 × 2 matrix.
    ``inputs`` has further known values: name → a number or a tuple of numbers. Missing inputs are left out.
    """

    t: float
    frame: int = 0
    position: tuple[float, float] | None = None
    position_std: float | None = None
    pixel: tuple[float, float] | None = None
    body: float | None = None
    body_kappa: float | None = None
    head: float | None = None
    head_kappa: float | None = None
    body_likelihood: tuple[float, ...] | None = None
    head_likelihood: tuple[float, ...] | None = None
    score: float | None = None
    position_covariance: Covariance | None = None
    observed_velocity: tuple[float, float] | None = None
    observed_velocity_covariance: Covariance | None = None
    body_axis: float | None = None
    body_axis_kappa: float | None = None
    sensor: str = ""
    inputs: Mapping[str, float | tuple[float, ...]] = field(default_factory=dict)

    @property
    def axis_std(self) -> float | None:
        """1-σ of each axis of the position, metres: of an ellipse by the mean variance."""
        if self.position_covariance is None:
            return self.position_std
        (xx, _), (_, yy) = self.position_covariance
        return math.sqrt(0.5 * (xx + yy))


CHANNELS = tuple(
    name for name in Observation.__dataclass_fields__ if name not in ("t", "frame", "sensor", "inputs")
)


def observations(track: Track) -> Iterator[Observation]:
    """Yield the observations of a track, frame by frame, as a live source would."""
    channels = {name: value for name in CHANNELS if (value := getattr(track, name)) is not None}
    for k in range(len(track)):
        sensor = "" if track.sensor is None else str(track.sensor[k])
        yield observation_at(k, float(track.t[k]), int(track.frame[k]), channels, track.inputs, sensor)


def observation_at(
    k: int,
    t: float,
    frame: int,
    channels: Mapping[str, FloatArray],
    inputs: Mapping[str, FloatArray] = MappingProxyType({}),
    sensor: str = "",
) -> Observation:
    """Return row k of channels (n, …) as an observation; NaN is a missing value."""
    given: dict[str, Any] = _present(channels, k)
    if inputs:
        given["inputs"] = _present(inputs, k)
    return Observation(t=t, frame=frame, sensor=sensor, **given)


def channels_of(observation: Observation) -> dict[str, FloatArray]:
    """Return the channels that an observation has, each with one row."""
    given = ((name, getattr(observation, name)) for name in CHANNELS)
    return {name: np.array([value], float) for name, value in given if value is not None}


def on_the_ground(observation: Observation, camera: GroundCamera | None) -> Observation:
    """Return an observation with the position of its pixel, if it has no other and there is a camera.

    Raises
    ------
    InputError
        For a pixel of no point on the ground.
    """
    if observation.position is not None or observation.pixel is None or camera is None:
        return observation
    x, y = camera.image_to_ground(np.array(observation.pixel)).tolist()
    if not (math.isfinite(x) and math.isfinite(y)):
        raise InputError(f"pixel = {observation.pixel}", "a point below the horizon")
    return replace(observation, position=(x, y))


def without_errors(observation: Observation, sensor: Sensor) -> Observation:
    """Return an observation without the known errors of its sensor, as `corrected` does with rows."""
    own = channels_of(observation)
    found = changed_channels({"t": np.array([observation.t]), **own}, sensor)
    if not found:
        return observation
    t = float(found.pop("t", [observation.t])[0])
    turned = observation_at(0, t, observation.frame, {**own, **found}, sensor=observation.sensor)
    return replace(turned, inputs=observation.inputs)


def _present(channels: Mapping[str, FloatArray], k: int) -> dict[str, Any]:
    """Return the channels of frame k, without the missing ones."""
    present: dict[str, Any] = {}
    for name, values in channels.items():
        value = values[k]
        if isinstance(value, np.ndarray):
            if np.isfinite(value).all():
                rows = value.tolist()
                present[name] = tuple(map(tuple, rows)) if value.ndim > 1 else tuple(rows)
        elif math.isfinite(value):
            present[name] = float(value)
    return present


class OwnParameters(NamedTuple):
    """Parameters of one person that hold in place of the model's."""

    acceleration_density: float
    body_diffusion: float
    head_diffusion: float
    motion_body_kappa: float
    head_body_kappa: float

    def named(self) -> dict[str, float]:
        """Return the values by the names of parameters, as ``group.key``."""
        return dict(zip(OWN, self, strict=True))


def differs(one: OwnParameters | None, two: OwnParameters, least: float) -> bool:
    """Return whether a parameter differs by more than a factor, or is 0 for one alone."""
    if one is None:
        return True
    for a, b in zip(one, two, strict=True):  # noqa: SIM110  # a third of the time of any()
        if a > least * b or b > least * a:
            return True
    return False


OWN = (
    "motion.acceleration_density",
    "orientation.body_diffusion",
    "orientation.head_diffusion",
    "coupling.motion_body_kappa",
    "coupling.head_body_kappa",
)
"""Parameters that people can have of their own, in the order of `OwnParameters`."""


@dataclass(frozen=True, eq=False)
class Step:
    """One frame of the chain.

    Attributes
    ----------
    index : number of the frame's variables: X(index) … H(index)
    observation : the frame's observation
    previous : the previous step; None at the start of the chain
    dt : seconds since the person's previous frame; None at the first. A chain with a marginalised past has a
        first step with a dt.
    starts : True where the velocity prior applies (at the first step with a position)
    camera : camera of the scene, for the pixel likelihood
    own : parameters in place of the model's
    """

    index: int
    observation: Observation
    previous: Step | None = None
    dt: float | None = None
    starts: bool = False
    camera: GroundCamera | None = None
    own: OwnParameters | None = None

    def alone(self) -> Step:
        """The step without the link to the previous one, which would keep the whole past in memory."""
        if self.previous is None:
            return self
        return Step(self.index, self.observation, None, self.dt, self.starts, self.camera, self.own)

    @property
    def is_ambiguous(self) -> bool:
        """Return True if an observation can have several modes, as class likelihoods and axes do."""
        present = self.observation
        several = (present.body_likelihood, present.head_likelihood, present.body_axis)
        return any(one is not None for one in several)

    @cached_property
    def position_key(self) -> int:
        """GTSAM key of the position."""
        return gtsam.symbol_shorthand.X(self.index)

    @cached_property
    def velocity_key(self) -> int:
        """GTSAM key of the velocity."""
        return gtsam.symbol_shorthand.V(self.index)

    @cached_property
    def body_key(self) -> int:
        """GTSAM key of the body orientation."""
        return gtsam.symbol_shorthand.B(self.index)

    @cached_property
    def head_key(self) -> int:
        """GTSAM key of the head pan."""
        return gtsam.symbol_shorthand.H(self.index)


@dataclass(frozen=True, eq=False)
class States:
    """The states of one track: position (n, 2), velocity (n, 2), body (n,), head (n,); metres, m/s, radians.

    Angles that the model does not estimate are NaN.
    """

    position: FloatArray
    velocity: FloatArray
    body: FloatArray
    head: FloatArray


def chain(track: Track, camera: GroundCamera | None = None, first: int = 0) -> list[Step]:
    """The steps of a whole track, linked; ``first``: index of the first one's variables."""
    present = np.isfinite(track.position).all(axis=1)
    start = int(np.argmax(present)) if present.any() else 0
    steps: list[Step] = []
    for k, observation in enumerate(observations(with_seconds_since_classes(track))):
        previous = steps[-1] if steps else None
        steps.append(
            Step(
                first + k,
                observation,
                previous,
                seconds_between(previous, observation),
                k == start,
                camera,
            )
        )
    return steps


def since_classes(observation: Observation, steps: Sequence[Step], time: float) -> Observation:
    """Return an observation with the seconds since class likelihoods of earlier steps, as inputs `SINCE`.

    Of those whose errors persist: as declared, or ``time`` seconds.
    """
    found: dict[str, float | tuple[float, ...]] = {}
    for name, column in SINCE.items():
        channel = f"{name}_likelihood"
        persists = observation.inputs.get(PERSISTENCE[name], time) != 0.0
        if not persists or getattr(observation, channel) is None or column in observation.inputs:
            continue
        for step in reversed(steps):
            before = step.observation
            if before.t < observation.t - TOGETHER and getattr(before, channel) is not None:
                found[column] = observation.t - before.t
                break
    return replace(observation, inputs={**observation.inputs, **found}) if found else observation


def seconds_between(previous: Step | None, observation: Observation) -> float | None:
    """The ``dt`` of a step; None without a previous step."""
    return None if previous is None else observation.t - previous.observation.t


def require_position(track: Track) -> None:
    """Raise SolveError if a track has no position at all."""
    if not np.isfinite(track.position).all(axis=1).any():
        raise SolveError(track.track_id, NO_POSITION)
