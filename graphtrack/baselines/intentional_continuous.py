"""The intentional tracker in continuous time, in seconds and metres, whatever the frame rate.

The velocity is drawn to where the head points at the rate λ: dv = −λ·(v − s·u(head))·dt + noise of density q,
with s the estimated speed. Over a step the velocity keeps exp(−λΔt) of itself, as the variant ``consistent``
of `intentional` keeps γ; the noise is integrated exactly, so that two half steps are one whole step. λ = 0 is
white-noise acceleration (docs/model.md, the terms `Motion` and `IntentionalMotion`).
"""

from __future__ import annotations

import numpy as np

from graphtrack.baselines.isotropic import FilteredStates, Transition, filter_tracks, full_covariance
from graphtrack.baselines.kalman import GaussianStates, as_track, position_std
from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray, unit
from graphtrack.model.observation import observed_angle, require_position
from graphtrack.model.parameters import Parameters
from graphtrack.model.terms.intentional_motion import HEAD_RATE, head_rates, steered_step
from graphtrack.tracks import Track


def intentional_transition(
    dt: float, rate: FloatArray, velocity: FloatArray, head: FloatArray, density: float
) -> Transition:
    """The step of Δt seconds of m tracks.

    Parameters
    ----------
    dt : seconds
    rate : (m,) λ in 1/s, ≥ 0
    velocity : (m, 2) m/s; its length is the speed s that the head steers
    head : (m,) radians; read only where λ > 0
    density : q in m²/s³
    """
    keep, reach, place, cross, spread = steered_step(dt, rate)
    speed = np.linalg.norm(velocity, axis=1, keepdims=True)
    aim = speed * unit(np.where(rate > 0.0, head, 0.0))
    return Transition(
        reach,
        keep,
        (dt - reach)[:, None] * aim,
        (1.0 - keep)[:, None] * aim,
        (density * place, density * cross, density * spread),
    )


def steer(
    position: FloatArray,
    head: FloatArray,
    t: FloatArray,
    variance: FloatArray,
    parameters: Parameters,
    rate: float | FloatArray | None = None,
) -> FilteredStates:
    """Filter m tracks of n steps that share their times.

    Parameters
    ----------
    position : (m, n, 2) metres; NaN where nothing was observed
    head : (m, n) radians; NaN where it was not seen: there λ = 0
    t : (n,) seconds
    variance : (m, n) of each axis of the positions, m²
    parameters : their motion is used
    rate : λ in 1/s, one or (m, n) of the steps that lead to the frames; by default the parameters'
        ``motion.head_rate``

    Raises
    ------
    InputError
        If the rate is negative or not finite.
    """
    motion = parameters.motion
    rates = np.broadcast_to(motion.head_rate if rate is None else rate, head.shape)
    if not (np.isfinite(rates) & (rates >= 0.0)).all():
        raise InputError(f"rate = {rate!r}", "numbers in 1/s, at least 0")

    def transition(k: int, mean: FloatArray) -> Transition:
        seen = head[:, k - 1]
        own = np.where(np.isfinite(seen), rates[:, k], 0.0)
        dt = float(t[k] - t[k - 1])
        return intentional_transition(dt, own, mean[:, 2:], seen, motion.acceleration_density)

    return filter_tracks(position, variance, motion.initial_speed_std**2, transition)


def intentional_states(track: Track, parameters: Parameters, rate: float | None = None) -> FilteredStates:
    """Filtered and predicted states of one track (m = 1), with the log-likelihood of the innovations.

    Without a ``rate`` in 1/s it is the parameters', or the track's input `HEAD_RATE` where it has one.

    Raises
    ------
    InputError
        If the rate is negative or not finite.
    SolveError
        If no position was observed.
    """
    require_position(track)
    head = observed_angle(track, "head")
    variance = position_std(track, parameters) ** 2
    rates = head_rates(track.input(HEAD_RATE), parameters.motion.head_rate) if rate is None else rate
    return steer(track.position[None], head[None], track.t, variance[None], parameters, rates)


def intentional_tracker(
    track: Track, parameters: Parameters | None = None, rate: float | None = None
) -> Track:
    """Online estimates of position and velocity from positions and the head, each from the past alone."""
    parameters = Parameters() if parameters is None else parameters
    states = intentional_states(track, parameters, rate)
    covariance = full_covariance(states.spread[0])
    return as_track(track, GaussianStates(states.mean[0], covariance), parameters.motion)
