"""Evidence of constants of motion and of turning: predictions of each person's observations, one step ahead.

A filter goes through the observations of a person with each of some candidates; the likelihood of its
innovations is the evidence of a candidate. Positions follow white-noise acceleration in a Kalman filter,
angles rotational diffusion in a filter of von Mises densities.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from graphtrack.geometry.angles import (
    FloatArray,
    class_kappa,
    concentration_from_resultant,
    direction,
    mean_resultant_length,
    vectors_of,
)
from graphtrack.kernels.arithmetic import log_i0e
from graphtrack.kernels.compilation import TRACK, Rehearsal, allocating
from graphtrack.model.parameters import Parameters
from graphtrack.tracks.track import Track


def motion_evidence(tracks: Sequence[Track], parameters: Parameters, densities: FloatArray) -> FloatArray:
    """Return the log evidence (m, q) of spectral densities of white-noise acceleration, m²/s³."""
    likelihood = parameters.likelihood
    variance = [likelihood.position_stds(track.position_std, len(track)) ** 2 for track in tracks]
    position = np.concatenate([track.position - _origin(track) for track in tracks])
    found = np.zeros((len(tracks), len(densities)))
    filter_positions(
        *_times(tracks),
        position,
        np.concatenate(variance),
        parameters.motion.initial_speed_std**2,
        densities,
        found,
    )
    return found


def turning_evidence(
    tracks: Sequence[Track], name: str, parameters: Parameters, diffusions: FloatArray
) -> FloatArray:
    """Return the log evidence (m, d) of rotational diffusions of "body" or "head", rad²/s."""
    observed = [observed_direction(track, name, parameters) for track in tracks]
    angle, kappa = (np.concatenate(part) for part in zip(*observed, strict=True))
    found = np.zeros((len(tracks), len(diffusions)))
    if kappa.any():
        outliers = float(parameters.likelihood.outlier_probability)
        filter_angles(*_times(tracks), np.nan_to_num(angle), kappa, outliers, diffusions, found)
    return found


def observed_direction(track: Track, name: str, parameters: Parameters) -> tuple[FloatArray, FloatArray]:
    """Return the observed angles (n,) of "body" or "head" and their concentrations (n,), NaN and 0 without.

    Class likelihoods count as one angle, of the direction and concentration of their mean vector.
    """
    angle, classes = getattr(track, name), getattr(track, f"{name}_likelihood")
    if angle is None and classes is None:
        return np.full(len(track), np.nan), np.zeros(len(track))
    kappa = parameters.likelihood.kappas(name, getattr(track, f"{name}_kappa"), len(track))  # type: ignore[arg-type]
    found = np.full(len(track), np.nan) if angle is None else angle.copy()
    if classes is not None:
        vectors = vectors_of(None, classes, len(track))
        known = np.isfinite(vectors).all(axis=1)
        length = np.linalg.norm(vectors[known], axis=1)
        blurred = length * mean_resultant_length(class_kappa(classes.shape[1]))
        found[known], kappa[known] = direction(vectors[known]), concentration_from_resultant(blurred)
    return found, np.where(np.isfinite(found), kappa, 0.0)


def _origin(track: Track) -> FloatArray:
    """Return the first position (2,), so that coordinates are small."""
    placed = np.flatnonzero(np.isfinite(track.position).all(axis=1))
    return track.position[placed[0]] if len(placed) else np.zeros(2)


def _times(tracks: Sequence[Track]) -> tuple[NDArray[np.int64], FloatArray]:
    """Return the tracks' first frames and the end (m + 1,), and the seconds since the frame before (N,)."""
    offsets = np.concatenate([[0], np.cumsum([len(track) for track in tracks])])
    return offsets.astype(np.int64), np.concatenate([track.dt for track in tracks])


@allocating
def filter_positions(
    offsets: NDArray[np.int64],
    dt: FloatArray,
    position: FloatArray,
    variance: FloatArray,
    speed_variance: float,
    densities: FloatArray,
    found: FloatArray,
) -> None:
    """Write the log density of the positions (N, 2) of each track into ``found`` (m, q).

    ``variance`` (N,) of a position on each axis, ``speed_variance`` of the first velocity
    """
    for track in range(len(offsets) - 1):
        for candidate in range(len(densities)):
            q, total, begun = densities[candidate], 0.0, False
            x = y = vx = vy = pp = pv = vv = 0.0
            for k in range(offsets[track], offsets[track + 1]):
                if begun:
                    d = dt[k]
                    x, y = x + d * vx, y + d * vy
                    pp += d * (2.0 * pv + d * vv) + q * d * d * d / 3.0
                    pv += d * vv + 0.5 * q * d * d
                    vv += q * d
                zx, zy, noise = position[k, 0], position[k, 1], variance[k]
                if not (math.isfinite(zx) and math.isfinite(zy)):
                    continue
                if not begun:
                    x, y, pp, vv, begun = zx, zy, noise, speed_variance, True
                    continue
                spread, dx, dy = pp + noise, zx - x, zy - y
                total -= 0.5 * (dx * dx + dy * dy) / spread + math.log(2.0 * math.pi * spread)
                gain_p, gain_v = pp / spread, pv / spread
                x, y, vx, vy = x + gain_p * dx, y + gain_p * dy, vx + gain_v * dx, vy + gain_v * dy
                vv -= gain_v * pv
                pv -= gain_v * pp
                pp -= gain_p * pp
            found[track, candidate] = total


@allocating
def filter_angles(
    offsets: NDArray[np.int64],
    dt: FloatArray,
    angle: FloatArray,
    kappa: FloatArray,
    outliers: float,
    diffusions: FloatArray,
    found: FloatArray,
) -> None:
    """Write the log density of the angles (N,) of each track into ``found`` (m, d).

    The state is a von Mises density, in its natural parameters: a vector whose length is the concentration.
    ``kappa`` (N,) of the observations, 0 without; a share of ``outliers`` is uniform.
    """
    for track in range(len(offsets) - 1):
        for candidate in range(len(diffusions)):
            diffusion, total, x, y = diffusions[candidate], 0.0, 0.0, 0.0
            for k in range(offsets[track], offsets[track + 1]):
                size = math.sqrt(x * x + y * y)
                # The variance grows: 1/κ is that of a concentrated density.
                kept = 1.0 / (1.0 + size * diffusion * dt[k])
                x, y, size = kept * x, kept * y, kept * size
                noise = kappa[k]
                if noise <= 0.0:
                    continue
                ox, oy = noise * math.cos(angle[k]), noise * math.sin(angle[k])
                if size > 0.0:
                    both = math.sqrt((x + ox) * (x + ox) + (y + oy) * (y + oy))
                    density = log_i0e(both) + both - log_i0e(size) - size - log_i0e(noise) - noise
                    if outliers > 0.0:
                        inlier = (1.0 - outliers) * math.exp(density)
                        density = math.log(inlier + outliers)
                        share = inlier / (inlier + outliers)
                        ox, oy = share * ox, share * oy
                    total += density - math.log(2.0 * math.pi)
                x, y = x + ox, y + oy
            found[track, candidate] = total


def _rehearse() -> None:
    offsets, dt = _times([TRACK])
    one, numbers = np.ones(1), np.ones(len(TRACK))
    filter_positions(offsets, dt, TRACK.position, numbers, 1.0, one, np.zeros((1, 1)))
    filter_angles(offsets, dt, numbers, numbers, 0.0, one, np.zeros((1, 1)))


REHEARSAL = Rehearsal("learned constants", _rehearse, 3.0)
