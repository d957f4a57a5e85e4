"""A Kalman smoother that chooses its constants on the recording: what a model of people has to beat.

Each axis of the position follows white-noise acceleration, each angle rotational diffusion; their densities
are those with the likeliest innovations, for each person. An angle that is not observed is the direction of
travel.
"""

import math

import numpy as np

from graphtrack.geometry.angles import wrap
from graphtrack.tracks.track import Track

DENSITIES = np.geomspace(0.01, 10.0, 13)  # m²/s³
DIFFUSIONS = np.radians(np.geomspace(2.0, 120.0, 13)) ** 2  # rad²/s


def smooth(z, variance, transition, noise, state, covariance, turns):
    """Return the log likelihood of the innovations of z (n,), and the smoothed states (n, d)."""
    n, total = len(z), 0.0
    means, spreads, before, prior = [], [], [], []
    for k in range(n):
        if k:
            state = transition[k] @ state
            covariance = transition[k] @ covariance @ transition[k].T + noise[k]
        before.append(state), prior.append(covariance)
        if np.isfinite(z[k]):
            spread = covariance[0, 0] + variance[k]
            away = wrap(z[k] - state[0]) if turns else z[k] - state[0]
            total -= 0.5 * (away * away / spread + math.log(2.0 * math.pi * spread))
            gain = covariance[:, 0] / spread
            state, covariance = state + gain * away, covariance - np.outer(gain, covariance[0])
        means.append(state), spreads.append(covariance)
    for k in range(n - 2, -1, -1):
        gain = spreads[k] @ transition[k + 1].T @ np.linalg.inv(prior[k + 1])
        means[k] = means[k] + gain @ (means[k + 1] - before[k + 1])
    return float(total), np.array(means)


def estimates(track: Track) -> dict[str, np.ndarray]:
    """Return position (n, 2), m, and body and head (n,), rad, of a track with declared noise."""
    dt, first = track.dt, track.position[np.isfinite(track.position[:, 0])][0]
    transition = np.array([[[1.0, d], [0.0, 1.0]] for d in dt])
    noise = np.array([[[d**3 / 3.0, d * d / 2.0], [d * d / 2.0, d]] for d in dt])
    variance, start = track.position_std**2, np.diag([1.0, 2.25])
    found = []
    for q in DENSITIES:
        given = [
            (track.position[:, a], variance, transition, q * noise, np.array([first[a], 0.0])) for a in (0, 1)
        ]
        axes = [smooth(*one, start, turns=False) for one in given]
        found.append((sum(likelihood for likelihood, _ in axes), [states for _, states in axes]))
    _, axes = max(found, key=lambda one: one[0])
    course = np.arctan2(axes[1][:, 1], axes[0][:, 1])
    result = {"position": np.column_stack([axes[0][:, 0], axes[1][:, 0]])}
    for name in ("body", "head"):
        angle = getattr(track, name)
        if angle is None:
            result[name] = course
            continue
        still, begin = np.ones((len(track), 1, 1)), angle[np.isfinite(angle)][:1]
        spread = 1.0 / getattr(track, f"{name}_kappa")
        turned = [
            smooth(angle, spread, still, (d * dt)[:, None, None], begin, np.eye(1) * 10.0, turns=True)
            for d in DIFFUSIONS
        ]
        result[name] = wrap(max(turned, key=lambda one: one[0])[1][:, 0])
    return result
