"""Objectives of learning: held-out predictive log-likelihood, evidence, likelihood of the truth.

Couplings are products that are not normalised, so that an evidence of them is not known; how well they
foretell observations is.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from graphtrack.geometry.angles import FloatArray, class_centres, class_kappa
from graphtrack.later import special
from graphtrack.model import Model
from graphtrack.model.kernels.layout import BODY, HEAD
from graphtrack.model.kernels.packing import PackedTracks
from graphtrack.tracks import Track

FOLDS = 3
"""Each observation is hidden in one of so many smoothings."""

STRETCH = 1.0
"""Seconds that are hidden at a time: more than neighbours bridge, since that is where couplings help."""

_CHANNELS = (("position", "pixel"), ("body", "body_likelihood"), ("head", "head_likelihood"))


def hidden_frames(track: Track, channel: int, fold: int) -> NDArray[np.bool_]:
    """Frames (n,) of which a fold hides a channel (0 position, 1 body, 2 head): stretches, by turns."""
    seconds = track.t - track.t[0]
    stretch = min(STRETCH, 1.001 * float(seconds[-1]) / FOLDS)
    return (np.floor_divide(seconds, stretch).astype(int) + channel) % FOLDS == fold


def told(track: Track, fold: int) -> Track:
    """The track without what a fold hides."""
    changes: dict[str, FloatArray] = {}
    for channel, names in enumerate(_CHANNELS):
        hidden = hidden_frames(track, channel, fold)
        for name in names:
            values = getattr(track, name)
            if values is not None:
                changes[name] = np.where(hidden.reshape(-1, *[1] * (values.ndim - 1)), np.nan, values)
    if not np.isfinite(changes["position"]).all(axis=1).any():
        changes["position"] = track.position
    return replace(track, **changes)  # type: ignore[arg-type]


def foretold(
    packed: PackedTracks, model: Model, states: FloatArray, covariance: FloatArray, fold: int
) -> FloatArray:
    """Log density (N,) of what was hidden in each frame.

    Parameters
    ----------
    packed : the tracks with all that was observed, packed with the model
    states, covariance : (N, 6) in the world and (N, 6, 6), from what the fold was told
    """
    hidden = [
        np.concatenate([hidden_frames(track, channel, fold) for track in packed.tracks])
        for channel in range(len(_CHANNELS))
    ]
    total = np.zeros(len(states))
    seen = hidden[0] & packed.has_position
    error = states[seen, :2] - packed.position[seen]
    information = packed.records["position_information"][seen]
    spread = covariance[seen][:, :2, :2] + np.eye(2) / information[:, None, None]
    squares = np.einsum("ni,nij,nj->n", error, np.linalg.inv(spread), error)
    total[seen] -= 0.5 * (squares + np.log(np.linalg.det(2.0 * math.pi * spread)))
    for channel, (has, name, place) in enumerate(
        ((model.has_body, "body", BODY), (model.has_head, "head", HEAD)), start=1
    ):
        if has:
            estimate, kappa = states[:, place], 1.0 / covariance[:, place, place]
            total += _foretold_angles(packed, model, name, estimate, kappa, hidden[channel])
    return total


def _foretold_angles(
    packed: PackedTracks,
    model: Model,
    name: str,
    estimate: FloatArray,
    kappa: FloatArray,
    hidden: NDArray[np.bool_],
) -> FloatArray:
    likelihood, total = model.parameters.likelihood, np.zeros(len(estimate))
    angle, classes = packed.channel(name), packed.channel(f"{name}_likelihood")
    if angle is not None:
        # The records have no concentration where nothing was seen, and where classes stand for the angle.
        noise = packed.records[f"{name}_kappa"]
        seen = hidden & (noise > 0.0)
        density = log_blurred(angle[seen] - estimate[seen], noise[seen], kappa[seen])
        total[seen] = _or_any(density, likelihood.outlier_probability)
    if classes is not None:
        weight = classes.sum(axis=1)
        seen = hidden & np.isfinite(weight) & (weight > 0.0)
        n, share = classes.shape[1], classes[seen] / weight[seen, None]
        apart = class_centres(n) - estimate[seen, None]
        densities = log_blurred(apart, np.asarray(class_kappa(n)), kappa[seen, None])
        density = special.logsumexp(densities, axis=1, b=share)
        total[seen] = _or_any(density, likelihood.class_outlier_probability)
    return total


def _or_any(log_density: FloatArray, outliers: float) -> FloatArray:
    """log of ε/2π + (1 − ε)·L: of angles that are outliers with the probability ε."""
    with np.errstate(divide="ignore"):  # without outliers
        anywhere = np.log(outliers / (2.0 * math.pi))
    return np.logaddexp(math.log1p(-outliers) + log_density, anywhere)


def log_blurred(apart: FloatArray, first: FloatArray, second: FloatArray) -> FloatArray:
    """log ∫ VM(θ; 0, κ₁)·VM(θ; ``apart``, κ₂) dθ: of an angle of concentration κ₁ about an estimate.

    That is I₀(|κ₁ + κ₂·e^{i·apart}|)/(2π·I₀(κ₁)·I₀(κ₂)), exactly; far from sure estimates it is smaller than
    any double, its logarithm is not.
    """
    resultant = np.abs(first + second * np.exp(1j * apart))
    scaled = special.i0e(resultant) / (2.0 * math.pi * special.i0e(first) * special.i0e(second))
    return np.asarray(np.log(scaled) + (resultant - first - second))
