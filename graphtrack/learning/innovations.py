"""Evidence of constants of motion and of turning: predictions of each person's observations, one step ahead.

A filter goes through the observations of a person with each of some candidates, all people and candidates at
once; the likelihood of its innovations is the evidence of a candidate. Positions follow white-noise
acceleration, angles rotational diffusion.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from graphtrack.diagnostics import LONGEST, Pieces, angle_log_density, position_log_density
from graphtrack.geometry.angles import (
    FloatArray,
    class_kappa,
    concentration_from_resultant,
    direction,
    mean_resultant_length,
    vectors_of,
)
from graphtrack.model.parameters import Parameters
from graphtrack.tracks.track import Track

MOST_PIECES = 10
"""Pieces of `diagnostics.LONGEST` frames that are filtered of one person, evenly spread over the track."""


def motion_evidence(tracks: Sequence[Track], parameters: Parameters, densities: FloatArray) -> FloatArray:
    """Return the log evidence (m, q) of spectral densities of white-noise acceleration, m²/s³."""
    likelihood = parameters.likelihood
    values = [(track.position, likelihood.position_stds(track.position_std, len(track))) for track in tracks]
    pieces = _pieces(tracks, values, 2)
    same = np.ones(len(densities))
    found = position_log_density(
        pieces, likelihood.position_std, parameters.motion.initial_speed_std, same, densities, 0.0 * same
    )
    return _by_track(found, pieces, len(tracks))


def turning_evidence(
    tracks: Sequence[Track], name: str, parameters: Parameters, diffusions: FloatArray
) -> FloatArray:
    """Return the log evidence (m, d) of rotational diffusions of "body" or "head", rad²/s."""
    likelihood = parameters.likelihood
    values = [observed_direction(track, name, parameters) for track in tracks]
    pieces = _pieces(tracks, values, 1)
    same = np.ones(len(diffusions))
    outliers = likelihood.outlier_probability * same
    found = angle_log_density(pieces, float(getattr(likelihood, f"{name}_kappa")), same, diffusions, outliers)
    return _by_track(found, pieces, len(tracks))


def observed_direction(track: Track, name: str, parameters: Parameters) -> tuple[FloatArray, FloatArray]:
    """Return the observed angles (n,) of "body" or "head" and their concentrations (n,), NaN and 0 without.

    Class likelihoods count as one angle, of the direction and concentration of their mean vector.
    """
    angle, classes = getattr(track, name), getattr(track, f"{name}_likelihood")
    kappa = parameters.likelihood.kappas(name, getattr(track, f"{name}_kappa"), len(track))  # type: ignore[arg-type]
    found = np.full(len(track), np.nan) if angle is None else angle.copy()
    if classes is not None:
        vectors = vectors_of(None, classes, len(track))
        known = np.isfinite(vectors).all(axis=1)
        length = np.linalg.norm(vectors[known], axis=1)
        blurred = length * mean_resultant_length(class_kappa(classes.shape[1]))
        found[known], kappa[known] = direction(vectors[known]), concentration_from_resultant(blurred)
    return found, np.where(np.isfinite(found), kappa, 0.0)


def _pieces(tracks: Sequence[Track], values: Sequence[tuple[FloatArray, FloatArray]], width: int) -> Pieces:
    """Return pieces of all tracks, those of one after another, with values (n, width) and their spread."""
    chosen: list[tuple[int, slice]] = []
    for m, track in enumerate(tracks):
        count = -(-len(track) // LONGEST)
        every = np.unique(np.linspace(0, count - 1, min(count, MOST_PIECES)).round().astype(int))
        chosen += [(m, slice(LONGEST * k, LONGEST * (k + 1))) for k in every.tolist()]
    longest = max((len(tracks[m].t[part]) for m, part in chosen), default=0)
    shape = longest, len(chosen)
    dt, spread, value = np.zeros(shape), np.full(shape, np.nan), np.full((*shape, width), np.nan)
    for p, (m, part) in enumerate(chosen):
        t, (own, declared) = tracks[m].t[part], values[m]
        dt[: len(t), p] = np.diff(t, prepend=t[:1])
        value[: len(t), p], spread[: len(t), p] = own[part].reshape(len(t), width), declared[part]
    return Pieces(dt, value, spread, np.array([m for m, _ in chosen], dtype=np.int64))


def _by_track(log_density: FloatArray, pieces: Pieces, count: int) -> FloatArray:
    """Return the sums (m, candidates) of the log densities (candidates, pieces) of each track."""
    found = np.zeros((count, len(log_density)))
    np.add.at(found, pieces.track, log_density.T)
    return found
