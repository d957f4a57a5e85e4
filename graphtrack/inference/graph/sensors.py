"""Sensors in the factor graph of a recording: their errors are variables that the factors of people share."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray, unit
from graphtrack.kernels.layout import Orientation
from graphtrack.model import Model, Step
from graphtrack.model.factors import unit_noise
from graphtrack.model.given import covariances_of, observed_direction, velocity_covariances_of
from graphtrack.model.terms.orientation import BodyLikelihood, HeadLikelihood
from graphtrack.model.terms.position import PositionLikelihood, robust_noise
from graphtrack.packages import gtsam
from graphtrack.tracks.sensor_errors import BIAS, CLOCK, ERRORS, PRIOR_STD, ROTATION, X, Y, errors_of
from graphtrack.tracks.sensors import Sensor, Sensors
from graphtrack.tracks.track import Track

OBSERVING = (PositionLikelihood, BodyLikelihood, HeadLikelihood)
"""Terms of observations."""

_J = np.array([[0.0, -1.0], [1.0, 0.0]])


@dataclass(frozen=True, eq=False)
class SensorVariable:
    """The errors of a sensor that are learned, as a variable of the graph.

    Attributes
    ----------
    key : of the vector of its free errors
    free : (k,) places of these among `ERRORS`
    start : (5,) the errors by which rows are corrected
    pivot : (2,) metres
    """

    key: int
    free: np.ndarray
    start: FloatArray
    pivot: FloatArray

    def errors(self, values: gtsam.Values) -> FloatArray:
        """Return all errors (5,) at some values."""
        found = self.start.copy()
        if len(self.free):
            found[self.free] = values.atVector(self.key)
        return found


def sensor_variables(sensors: Sensors) -> dict[str, SensorVariable]:
    """Return the variables of described sensors: errors that have a 1-σ, or are unknown, are free."""
    found: dict[str, SensorVariable] = {}
    for place, (name, one) in enumerate(sensors.items()):
        known = errors_of(one)
        free = np.flatnonzero(np.isnan(known) | is_learned(one))
        pivot = np.array(one.pivot)
        found[name] = SensorVariable(gtsam.symbol("s", place), free, np.nan_to_num(known), pivot)
    return found


def is_learned(sensor: Sensor) -> FloatArray:
    """Return which of the errors (5,) of a sensor have a 1-σ, so that they were learned."""
    of_shift = sensor.shift_std is not None
    given = (sensor.rotation_std, sensor.angle_bias_std, sensor.clock_offset_std)
    return np.array([of_shift, of_shift, *(one is not None for one in given)])


def priors_of(variables: Mapping[str, SensorVariable]) -> list[gtsam.NonlinearFactor]:
    """Return the priors of the errors that are free."""
    found: list[gtsam.NonlinearFactor] = []
    for one in variables.values():
        if len(one.free):
            noise = gtsam.noiseModel.Diagonal.Sigmas(np.array(PRIOR_STD)[one.free])
            found.append(gtsam.PriorFactorVector(one.key, np.zeros(len(one.free)), noise))
    return found


def observation_factors(
    track: Track,
    step_of_row: Sequence[Step],
    variables: Mapping[str, SensorVariable],
    model: Model,
) -> list[gtsam.NonlinearFactor]:
    """Return the factors of the observations of a person, which depend on the errors of their sensors.

    Class likelihoods count as one angle of their mean direction.

    Parameters
    ----------
    track : rows that are corrected for the errors at which the variables start
    step_of_row : the step of each row

    Raises
    ------
    InputError
        For a row of a sensor without a variable.
    """
    found: list[gtsam.NonlinearFactor] = []
    likelihood = model.parameters.likelihood
    covariance = covariances_of(track, likelihood)
    estimated: dict[Orientation, bool] = {"body": model.has_body, "head": model.has_head}
    names = [name for name, has in estimated.items() if has]
    directions = {name: observed_direction(track, name, model.parameters) for name in names}
    velocities = velocity_covariances_of(track, likelihood)
    for row, step in enumerate(step_of_row):
        name = "" if track.sensor is None else str(track.sensor[row])
        if name not in variables:
            expected = f"one of {', '.join(map(repr, variables))}"
            raise InputError(f"a row of the sensor {name!r} in track {track.track_id}", expected)
        own = variables[name]
        if np.isfinite(track.position[row]).all():
            noise = robust_noise(unit_noise(2), likelihood)
            found.append(_Position(own, track.position[row], covariance[row]).factor(step, noise))
        if track.observed_velocity is not None and np.isfinite(track.observed_velocity[row]).all():
            velocity = _Velocity(own, track.observed_velocity[row], velocities[row])
            found.append(velocity.factor(step, unit_noise(2)))
        for part, (angle, kappa) in directions.items():
            if kappa[row] > 0.0:
                one = _Angle(own, part, float(angle[row]), float(kappa[row]), 1)
                found.append(one.factor(step, unit_noise(2)))
        if model.has_body and track.body_axis is not None and np.isfinite(track.body_axis[row]):
            given = None if track.body_axis_kappa is None else track.body_axis_kappa[row]
            quarter = likelihood.kappas("body", given, 1).item() / 4.0
            axis = _Angle(own, "body", float(track.body_axis[row]), quarter, 2)
            found.append(axis.factor(step, unit_noise(2)))
    return found


class _Observed:
    """An observation whose residual depends on a step and on the errors of its sensor."""

    def __init__(self, sensor: SensorVariable) -> None:
        self._sensor = sensor

    def keys(self, step: Step) -> list[int]:
        """Return the keys of the step's variables."""
        raise NotImplementedError

    def residual(
        self, values: gtsam.Values, keys: Sequence[int], errors: FloatArray
    ) -> tuple[FloatArray, list[FloatArray], FloatArray]:
        """Return the residual (2,), its Jacobians for the step's variables, and for all errors (2, 5)."""
        raise NotImplementedError

    def factor(self, step: Step, noise: gtsam.noiseModel.Base) -> gtsam.NonlinearFactor:
        """Return the factor."""
        own, keys = self._sensor, self.keys(step)

        def callback(this: gtsam.CustomFactor, values: gtsam.Values, jacobians: Any) -> FloatArray:
            del this  # a traceback would keep it
            residual, parts, of_errors = self.residual(values, keys, own.errors(values))
            if jacobians is not None:
                if len(own.free):
                    parts = [*parts, of_errors[:, own.free]]
                for i, part in enumerate(parts):
                    jacobians[i] = np.asfortranarray(part)
            return residual

        return gtsam.CustomFactor(noise, [*keys, own.key] if len(own.free) else keys, callback)


def _rotation(angle: float) -> FloatArray:
    return np.column_stack([unit(angle), unit(angle + 0.5 * np.pi)])


class _Position(_Observed):
    def __init__(self, sensor: SensorVariable, position: FloatArray, covariance: FloatArray) -> None:
        super().__init__(sensor)
        turn = _rotation(sensor.start[ROTATION])
        # As it was read, from the pivot; and the root of its information there.
        self._read = turn @ (position - sensor.pivot) + sensor.start[[X, Y]]
        self._root = np.linalg.cholesky(np.linalg.inv(covariance)).T @ turn.T

    def keys(self, step: Step) -> list[int]:
        return [step.position_key, step.velocity_key]

    def residual(
        self, values: gtsam.Values, keys: Sequence[int], errors: FloatArray
    ) -> tuple[FloatArray, list[FloatArray], FloatArray]:
        place, velocity = values.atPoint2(keys[0]), values.atVector(keys[1])
        delay, turn = errors[CLOCK] - self._sensor.start[CLOCK], _rotation(errors[ROTATION])
        root, away = self._root, turn @ (place - delay * velocity - self._sensor.pivot)
        of_errors = np.zeros((2, len(ERRORS)))
        of_errors[:, [X, Y]] = -root
        of_errors[:, ROTATION] = -root @ _J @ away
        of_errors[:, CLOCK] = root @ turn @ velocity
        residual = root @ (self._read - errors[[X, Y]] - away)
        return residual, [-root @ turn, delay * root @ turn], of_errors


class _Velocity(_Observed):
    def __init__(self, sensor: SensorVariable, velocity: FloatArray, covariance: FloatArray) -> None:
        super().__init__(sensor)
        turn = _rotation(sensor.start[ROTATION])
        self._read = turn @ velocity
        self._root = np.linalg.cholesky(np.linalg.inv(covariance)).T @ turn.T

    def keys(self, step: Step) -> list[int]:
        return [step.velocity_key]

    def residual(
        self, values: gtsam.Values, keys: Sequence[int], errors: FloatArray
    ) -> tuple[FloatArray, list[FloatArray], FloatArray]:
        turn, root = _rotation(errors[ROTATION]), self._root
        turned = turn @ values.atVector(keys[0])
        of_errors = np.zeros((2, len(ERRORS)))
        of_errors[:, ROTATION] = -root @ _J @ turned
        return root @ (self._read - turned), [-root @ turn], of_errors


class _Angle(_Observed):
    def __init__(
        self, sensor: SensorVariable, part: Orientation, angle: float, kappa: float, ends: int
    ) -> None:
        super().__init__(sensor)
        self._read = angle + sensor.start[ROTATION] + sensor.start[BIAS]
        self._part, self._root, self._ends = part, np.sqrt(kappa), ends

    def keys(self, step: Step) -> list[int]:
        return [step.body_key if self._part == "body" else step.head_key]

    def residual(
        self, values: gtsam.Values, keys: Sequence[int], errors: FloatArray
    ) -> tuple[FloatArray, list[FloatArray], FloatArray]:
        ends, root = self._ends, self._root
        angle = ends * values.atRot2(keys[0]).theta()
        read = ends * (self._read - errors[ROTATION] - errors[BIAS])
        of_errors = np.zeros((2, len(ERRORS)))
        of_errors[:, [ROTATION, BIAS]] = -ends * root * (_J @ unit(read))[:, None]
        return root * (unit(read) - unit(angle)), [-ends * root * (_J @ unit(angle))[:, None]], of_errors
