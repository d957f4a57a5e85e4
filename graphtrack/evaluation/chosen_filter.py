"""A Kalman filter that chooses its constants on the recording: the peer that learned constants have to beat.

Each axis of the position follows white-noise acceleration, each angle rotational diffusion, with the density
whose innovations are likeliest, for each person. An angle that is not observed is the direction of travel.
"""

from __future__ import annotations

import numpy as np

from graphtrack.baselines.kalman import kalman_filter, rauch_tung_striebel
from graphtrack.constants.filters import motion_evidence, turning_evidence
from graphtrack.constants.population import DENSITIES, DIFFUSIONS
from graphtrack.geometry.angles import FloatArray, direction, wrap
from graphtrack.model import Parameters
from graphtrack.model.given import observed_direction
from graphtrack.tracks.track import Track

_ANYWHERE = 10.0
"""Variance of a first angle, rad²."""


def chosen_filter(track: Track, *, online: bool) -> Track:
    """Return the estimates of a track, filtered or smoothed with its likeliest constants.

    The choice is made on the whole track in both cases.
    """
    parameters = Parameters()
    best = DENSITIES[int(np.argmax(motion_evidence([track], parameters, DENSITIES)[0][0]))]
    own = parameters.with_values({"motion.acceleration_density": float(best)})
    found = (kalman_filter if online else rauch_tung_striebel)(track, own)
    assert found.velocity is not None and found.covariance is not None
    covariance = found.covariance.copy()
    angles: dict[str, FloatArray] = {}
    for place, name in ((4, "body"), (5, "head")):
        angle, kappa = observed_direction(track, name, parameters)
        if not kappa.any():
            angles[name] = direction(found.velocity)
            continue
        turning = DIFFUSIONS[int(np.argmax(turning_evidence([track], name, parameters, DIFFUSIONS)[0]))]
        angles[name], covariance[:, place, place] = _diffusing(angle, kappa, turning * track.dt, online)
    return found.with_estimates(
        position=found.position, velocity=found.velocity, covariance=covariance, **angles
    )


def _diffusing(
    angle: FloatArray, kappa: FloatArray, noise: FloatArray, online: bool
) -> tuple[FloatArray, FloatArray]:
    """Return an angle (n,) and its variance by a Kalman filter, or smoother, of rotational diffusion.

    Parameters
    ----------
    angle, kappa : observed, and the inverse variance; 0 without an observation
    noise : variance that the angle gains since the frame before
    """
    first = int(np.argmax(kappa > 0.0))
    mean, variance = np.full(len(angle), angle[first]), np.full(len(angle), _ANYWHERE)
    ahead = np.full(len(angle), _ANYWHERE)
    for k in range(len(angle)):
        if k:
            mean[k], ahead[k] = mean[k - 1], variance[k - 1] + noise[k]
        variance[k] = 1.0 / (1.0 / ahead[k] + kappa[k])
        if kappa[k] > 0.0:
            mean[k] += variance[k] * kappa[k] * wrap(angle[k] - mean[k])
    if not online:
        for k in range(len(angle) - 2, -1, -1):
            gain = variance[k] / ahead[k + 1]
            mean[k] += gain * (mean[k + 1] - mean[k])
            variance[k] += gain * gain * (variance[k + 1] - ahead[k + 1])
    return wrap(mean), variance
