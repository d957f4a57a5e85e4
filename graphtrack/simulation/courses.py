"""Body and head angles sampled from the graph's own density: chains that diffuse under von Mises pulls.

The density is Π exp(κ_k·cos(θ_k − θ_{k−1}))·Π exp(Re(conj(z_k)·e^{iθ_k})), as the factor graph has it:
nothing is normalised step by step. Messages run back from the last frame on a grid around the circle; then
the course is drawn forward, each angle given the one before and all that is to come.
"""

from __future__ import annotations

import math

import numpy as np

from graphtrack.geometry.angles import FloatArray, wrap
from graphtrack.later import special

FEWEST_BINS, MOST_BINS = 240, 3840
_FEWEST_CELLS = 240
_REACH = 8.0
"""Standard deviations of a turn to each side that the candidates of the next angle lie in."""
_FLOOR = 1e-14
"""Of a message, relative to its greatest value: what lies below is the noise of the Fourier transform."""
_MEMORY = 2**28
"""Bytes of messages that are held at a time."""


def sample_course(t: FloatArray, diffusion: float, pull: np.ndarray, rng: np.random.Generator) -> FloatArray:
    """Angles (n_tracks, n) in radians, in (−π, π], at the times ``t`` (n,) seconds.

    Parameters
    ----------
    diffusion : rad²/s; the concentration of a step of Δt is 1/(diffusion·Δt)
    pull : (n_tracks, n) complex: concentration times e^{i·angle} of the von Mises that pulls each frame; 0:
        nothing does. Without any the first angle is uniform
    """
    n_tracks, n = pull.shape
    kappa = 1.0 / (diffusion * np.diff(t))
    if not np.any(pull):
        turns = rng.vonmises(0.0, np.broadcast_to(kappa, (n_tracks, n - 1)))
        first = rng.uniform(-np.pi, np.pi, (n_tracks, 1))
        return wrap(np.cumsum(np.hstack([first, turns]), axis=1))
    bins = _bins(np.abs(pull), kappa)
    together = max(1, _MEMORY // (4 * n * bins))
    parts = [pull[a : a + together] for a in range(0, n_tracks, together)]
    return np.concatenate([_sample(part, kappa, bins, rng) for part in parts])


def _bins(pull: FloatArray, kappa: FloatArray) -> int:
    """Bins that resolve the narrowest message: one a standard deviation is enough for the transform."""
    narrowest = float(pull.max())
    if len(kappa):
        # Where pulls come at a steady rate their messages are as narrow as √(pull·κ).
        narrowest += math.sqrt(float((pull[:, 1:] * kappa).max()))
    wanted = 2.0 * np.pi * math.sqrt(narrowest)
    return int(min(FEWEST_BINS * 2 ** max(0, math.ceil(math.log2(wanted / FEWEST_BINS))), MOST_BINS))


def _sample(pull: np.ndarray, kappa: FloatArray, bins: int, rng: np.random.Generator) -> FloatArray:
    messages = _messages(pull, kappa, bins)
    n_tracks, n = pull.shape
    width = 2.0 * np.pi / bins
    angles = np.empty((n_tracks, n))
    place = _drawn(messages[0], rng)
    angles[:, 0] = width * place
    rows = np.arange(n_tracks)[:, None]
    for k in range(1, n):
        reach = min(np.pi, _REACH / math.sqrt(kappa[k - 1]))
        count = max(_FEWEST_CELLS, round(bins * reach / np.pi))
        turn = reach * ((2.0 * np.arange(count) + 1.0) / count - 1.0)
        at = (angles[:, k - 1, None] + turn) / width
        below = np.floor(at)
        share = at - below
        index = below.astype(np.int64) % bins
        row = messages[k]
        ahead = (1.0 - share) * row[rows, index] + share * row[rows, (index + 1) % bins]
        chosen = _drawn(ahead + kappa[k - 1] * (np.cos(turn) - 1.0), rng)
        angles[:, k] = angles[:, k - 1] + reach * ((2.0 * chosen + 1.0) / count - 1.0)
    return wrap(angles)


def _drawn(log_weight: FloatArray, rng: np.random.Generator) -> FloatArray:
    """A cell of each row (m, cells), and a place within it: its number, give or take a half."""
    reached = np.cumsum(np.exp(log_weight - log_weight.max(axis=1, keepdims=True)), axis=1)
    chosen = (reached < rng.random((len(reached), 1)) * reached[:, -1:]).sum(axis=1)
    return chosen + rng.uniform(-0.5, 0.5, len(chosen))


def _messages(pull: np.ndarray, kappa: FloatArray, bins: int) -> np.ndarray:
    """Logarithms (n, n_tracks, bins) of what each frame and all after it say of its angle."""
    n_tracks, n = pull.shape
    angle = 2.0 * np.pi * np.arange(bins) / bins
    circle = np.stack([np.cos(angle), np.sin(angle)])
    messages = np.empty((n, n_tracks, bins), np.float32)
    order = np.arange(bins // 2 + 1)
    damping = {one: _fourier(order, one) for one in np.unique(kappa).tolist()}
    ahead = np.zeros((n_tracks, bins))
    for k in range(n - 1, -1, -1):
        if k < n - 1:
            spread = np.fft.irfft(np.fft.rfft(np.exp(ahead)) * damping[float(kappa[k])], bins)
            ahead = np.log(np.maximum(spread, _FLOOR * spread.max(axis=1, keepdims=True)))
        ahead = ahead + np.stack([pull[:, k].real, pull[:, k].imag], axis=1) @ circle
        ahead -= ahead.max(axis=1, keepdims=True)
        messages[k] = ahead
    return messages


def _fourier(order: np.ndarray, kappa: float) -> FloatArray:
    """Fourier coefficients I_m(κ)/I_0(κ) of a von Mises density."""
    if kappa > 1e5:  # a wrapped normal, where Bessel functions of high orders are not to be had
        return np.exp(-0.5 * order**2 / kappa)
    return np.asarray(special.ive(order, kappa) / special.ive(0, kappa))
