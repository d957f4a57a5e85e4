"""The parts of a forecast, and how far from its mean people are expected to be."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from graphtrack.behaviour.forecast.motion import ComplexArray
from graphtrack.behaviour.forecast.near import kernel_means
from graphtrack.behaviour.forecast.parameters import ForecastParameters
from graphtrack.behaviour.forecast.places import LAGS
from graphtrack.geometry.angles import FloatArray

_WALKING = 0.3
"""Speed, m/s, at which people half count as walking."""


@dataclass(frozen=True, eq=False)
class Expected:
    """The parts of a forecast of n people at A times: for `Forecaster`, and for learning.

    Attributes
    ----------
    mean : (n, A) complex
    direction, speed : (n,) of motion, of unit length and m/s
    estimate : (n, A) variance on each axis of where people would be if they went straight on, m²
    weight, square : (n, A) of what was seen in the place, about the mean; m² on each axis
    """

    mean: ComplexArray
    direction: ComplexArray
    speed: FloatArray
    estimate: FloatArray
    weight: FloatArray
    square: FloatArray


def together(
    position: ComplexArray, velocity: ComplexArray, others: NDArray[np.int64], parameters: ForecastParameters
) -> ComplexArray:
    """Velocities (n,) of people who keep together with whoever is near and goes as they do.

    Parameters
    ----------
    position, velocity : (n,) of people on their own
    others : (m,) which of them count as others
    """
    near, alike = parameters.companion_distance, parameters.companion_velocity
    points, ways = (np.ascontiguousarray(one).view(float).reshape(-1, 2) for one in (position, velocity))
    found = kernel_means(points, ways, others, near, alike, parameters.companion_weight)
    return np.asarray(found.view(complex)[:, 0])


def spreads(
    parameters: ForecastParameters, expected: Expected, ahead: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """1-σ (n, A) along and across the direction of motion, in a scene like others; metres."""
    speed = expected.speed[:, None]
    usual = parameters.spread_standing**2 + (parameters.spread_walking * speed) ** 2
    usual = usual * ahead ** (2.0 * parameters.spread_power)
    prior = parameters.spread_prior
    variance = (prior * usual + expected.weight * expected.square) / (prior + expected.weight)
    variance = variance + expected.estimate
    ratio = parameters.spread_along ** (2.0 * speed / (speed + _WALKING))
    return np.sqrt(variance * 2.0 * ratio / (1.0 + ratio)), np.sqrt(variance * 2.0 / (1.0 + ratio))


def lead(angle: FloatArray, sure: FloatArray, parameters: ForecastParameters) -> FloatArray:
    """Return the angle (n,) by which the motion will turn to the head, radians.

    Parameters
    ----------
    angle : (n,) from the direction of motion to the head
    sure : (n,) 1 for a head that was seen and holds still, 0 for one that was not
    """
    counts = sure * np.exp(-((angle / parameters.head_limit) ** 2))
    turn: FloatArray = parameters.head_share * counts * angle
    return turn


def mean_turn(ahead: FloatArray, parameters: ForecastParameters) -> FloatArray:
    """Of a turn that is approached exponentially, the mean up to each time (A,), as a share of it."""
    x = ahead / parameters.head_seconds
    mean: FloatArray = 1.0 + np.expm1(-x) / x
    return mean


def between_lags(ahead: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Weights (A, G) of `LAGS` for each time, and by what to multiply: 0 now, on and on after the last."""
    inner = np.clip(ahead, LAGS[0], LAGS[-1])
    weights = np.stack([np.interp(inner, LAGS, one) for one in np.eye(len(LAGS))], axis=1)
    return weights, ahead / inner
