"""Likelihood of two detections' angles and appearance if they are one person's."""

from __future__ import annotations

import math

from graphtrack.association.chains import BODY, HEAD, Row, Scene
from graphtrack.geometry.angles import FloatArray
from graphtrack.model.kernels.bessel import log_i0e
from graphtrack.model.kernels.compiled import compiled


@compiled
def looks_ratio(looks: FloatArray, k: int, m: int, scene: Scene) -> float:
    """Log likelihood ratio of how two detections look; see `AppearanceModel`."""
    if scene.looks_outliers >= 1.0:
        return 0.0
    square = 0.0
    for i in range(looks.shape[1]):
        square += (looks[k, i] - looks[m, i]) ** 2
    if math.isnan(square):
        return 0.0
    score = scene.looks_offset - scene.looks_slope * math.log(max(square, 1e-12))
    odds = math.exp(min(max(score, -50.0), 50.0))
    sure, unsure = 1.0 - scene.looks_outliers, scene.looks_outliers
    return math.log((sure * odds + unsure) / (sure + unsure * odds))


@compiled
def see_angle(
    angle: float, prior_x: float, prior_y: float, noise: float, outliers: float, state: FloatArray, place: int
) -> float:
    """Take an observed angle into the direction at ``place`` of a state; its log ratio to one by chance.

    Parameters
    ----------
    angle : radians; NaN: not observed
    prior_x, prior_y : the direction that is expected, with its concentration
    outliers : share of observations that have nothing to do with the direction; 1: none is looked at
    """
    if outliers >= 1.0 or math.isnan(angle):
        return 0.0
    kappa, share, ratio = math.hypot(prior_x, prior_y), 1.0 - outliers, 0.0
    if kappa > 1e-6:
        kappa = 1.0 / (1.0 / kappa + noise)
        deviation = angle - math.atan2(prior_y, prior_x)
        density = share * math.exp(kappa * (math.cos(deviation) - 1.0) - log_i0e(kappa))
        ratio = math.log(density + outliers)
        share = density / (density + outliers)
    state[place] += share * math.cos(angle) / noise
    state[place + 1] += share * math.sin(angle) / noise
    return ratio


@compiled
def see_facing(earlier: Row, before: FloatArray, later: Row, scene: Scene, state: FloatArray) -> float:
    """Take body and head of a later detection into the state; their log likelihood ratio.

    They turn little since the earlier one, where the state was ``before``, and the body faces where the
    person goes, who moves as the state says, and is then taken to go more as body and head point.
    """
    if scene.body_outliers >= 1.0 and scene.head_outliers >= 1.0:
        return 0.0
    dt = later.t - earlier.t
    for place, turn in ((BODY, scene.body_turn), (HEAD, scene.head_turn)):
        x, y = before[place], before[place + 1]
        less = 1.0 / (1.0 + math.hypot(x, y) * turn * dt)
        state[place], state[place + 1] = less * x, less * y
    x, y = state[BODY], state[BODY + 1]
    square = state[2] * state[2] + state[3] * state[3]
    if square > 1e-4:
        # Who hardly moves goes nowhere in particular.
        length = 1.0 / ((scene.heading_variance + state[6] / square) * math.sqrt(square))
        x, y = x + length * state[2], y + length * state[3]
    ratio = see_angle(later.body, x, y, scene.body_variance, scene.body_outliers, state, BODY)
    x, y = state[HEAD], state[HEAD + 1]
    ratio += see_angle(later.head, x, y, scene.head_variance, scene.head_outliers, state, HEAD)
    steer(later.body, scene.body_variance + scene.heading_variance, scene.body_outliers, state)
    steer(later.head, scene.head_variance + scene.gaze_variance, scene.head_outliers, state)
    return ratio


@compiled
def steer(angle: float, variance: float, outliers: float, state: FloatArray) -> None:
    """Turn the velocity of a state towards an observed angle, as far as that says where the person goes.

    The update of an extended Kalman filter: the velocity across is speed · sin(deviation), says the angle.

    Parameters
    ----------
    angle : radians, of body or head; NaN: not observed
    variance : of the angle about the direction of travel
    outliers : share of angles that have nothing to do with it
    """
    speed = math.hypot(state[2], state[3])
    if outliers >= 1.0 or math.isnan(angle) or speed < 1e-2:
        return
    across_x, across_y = -state[3] / speed, state[2] / speed
    deviation = angle - math.atan2(state[3], state[2])
    kappa = 1.0 / (variance + state[6] / (speed * speed))
    density = (1.0 - outliers) * math.exp(kappa * (math.cos(deviation) - 1.0) - log_i0e(kappa))
    share = density / (density + outliers)
    gain = share * kappa / (speed * speed)
    off = speed * math.sin(deviation)
    p_gain, v_gain = gain * state[5], gain * state[6]
    state[0] += p_gain * off * across_x
    state[1] += p_gain * off * across_y
    state[2] += v_gain * off * across_x
    state[3] += v_gain * off * across_y
    # Of the two axes one is known better; the covariance is their mean.
    state[4] -= 0.5 * p_gain * state[5]
    state[5] -= 0.5 * p_gain * state[6]
    state[6] -= 0.5 * v_gain * state[6]
