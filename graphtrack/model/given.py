"""Channels of tracks and observations that a model does not use."""

from __future__ import annotations

from collections.abc import Collection

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
from graphtrack.geometry.camera import GroundCamera
from graphtrack.model.model import Model
from graphtrack.model.observation import CHANNELS, Observation
from graphtrack.model.parameters import LikelihoodParameters, Parameters
from graphtrack.model.terms.classes import HIDDEN, class_evidence, class_weights
from graphtrack.tracks.given import AXES, unused_note, with_position_noise
from graphtrack.tracks.schema import COLUMNS
from graphtrack.tracks.track import BODY_CLASSES, HEAD_CLASSES, Track, channel_of
from graphtrack.tracks.validation import finite_rows

_OF_ESTIMATES = ("velocity", "covariance")
_OF_TRACKS = ("identity_p", "observed", "true_position", "true_body", "true_head")
CLASSES = {"body": BODY_CLASSES, "head": HEAD_CLASSES}

BoolArray = NDArray[np.bool_]


def never_used(model: Model, camera: GroundCamera | None) -> tuple[str, ...]:
    """Return the channels of observations that a smoother with a model uses in no case."""
    if model.own_terms:
        return ()  # they may read everything
    found = ["score"] + ["pixel"] * (camera is None)  # of a row without a position
    found += [name for name in CHANNELS if name.startswith("body") and not model.has_body]
    return (*found, *(name for name in CHANNELS if name.startswith("head") and not model.has_head))


def is_idle(name: str, observation: Observation) -> bool:
    """Return whether an observation has a channel of `never_used`; pixels next to a position are its own."""
    if name == "pixel" and getattr(observation, "position", None) is not None:
        return False
    return getattr(observation, name, None) is not None


EVIDENCE = ("score", "body_deg", "head_deg", *(f"{n}_p{k}" for n, c in CLASSES.items() for k in range(c)))
"""Columns that the association of detections reads, whatever the model."""


def unused_columns(model: Model, camera: GroundCamera | None) -> list[str]:
    """Return the columns of a stream's rows that are not used in any case."""
    if model.own_terms:
        return []
    fields = {*never_used(model, camera), *_OF_ESTIMATES, *_OF_TRACKS}
    return [one.name for one in COLUMNS if one.field in fields and one.name not in ("x_std", "y_std")]


def notes_on(tracks: Collection[Track], model: Model, camera: GroundCamera | None) -> list[str]:
    """Return notes on what a solver with a model does with channels that tracks have."""
    took_axes = any(with_position_noise(track) is not track for track in tracks)
    notes = [AXES] if took_axes else []
    if model.own_terms:
        return notes
    fields = {name for track in tracks for name in _unused(track, model, camera)}
    axes = ("x_std", "y_std") if took_axes else ()
    user = f"the model {model.preset!r}"
    return notes + unused_note(tracks, lambda c: c.field in fields and c.name not in axes, user)


def _unused(track: Track, model: Model, camera: GroundCamera | None) -> list[str]:
    """Return the fields with values that the solver reads in no row, or that another one overrules."""
    in_image = camera is not None and model.parameters.likelihood.image_frame
    pixel = _rows(track, "pixel") & in_image
    found = [*_OF_ESTIMATES]
    if track.identity_p is None:  # else the identities were found with it
        found.append("score")
    alone = _rows(track, "pixel") & ~_rows(track, "position")
    if not pixel.any() and (camera is not None or alone.any()):  # else the position is that of the pixel
        found.append("pixel")
    if (_rows(track, "position") & pixel).any() or not _rows(track, "position").any():
        found.append("position_std")
    for name in ("body", "head"):
        classes, angle = _rows(track, f"{name}_likelihood"), _rows(track, name)
        if not getattr(model, f"has_{name}"):
            found += [channel for channel in CHANNELS if channel.startswith(name)]
            continue
        found += [name] * bool((classes & angle).any())
        found += [f"{name}_kappa"] * (not (angle & ~classes).any())
    return found


def _rows(track: Track, name: str) -> BoolArray:
    """Return (n,) True where a track has a channel."""
    values = channel_of(track, name)
    if values is None:
        return np.zeros(len(track), bool)
    return finite_rows(values)


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
        hidden = track.input(HIDDEN[name])  # type: ignore[index]
        weight = class_weights(track, name, parameters.likelihood)  # type: ignore[arg-type]
        by_class, sharp = angle_of_classes(classes, hidden, weight, parameters.likelihood)
        known = np.isfinite(by_class)
        found[known], kappa[known] = by_class[known], sharp[known]
    return found, np.where(np.isfinite(found), kappa, 0.0)


def angle_of_classes(
    classes: FloatArray, hidden: FloatArray, weight: FloatArray, likelihood: LikelihoodParameters
) -> tuple[FloatArray, FloatArray]:
    """Return directions (n,) and concentrations (n,) of the mean vectors of class likelihoods (n, k).

    With the doubts of the model: ``hidden`` and ``weight`` as in `class_evidence`, and outliers.
    """
    uniform = likelihood.class_outlier_probability
    classes = class_evidence(classes, hidden, weight, uniform, likelihood)
    vectors = vectors_of(None, classes, len(classes))
    known = np.isfinite(vectors).all(axis=1)
    angle, kappa = np.full(len(classes), np.nan), np.zeros(len(classes))
    length = (1.0 - uniform) * np.linalg.norm(vectors[known], axis=1)
    blurred = length * mean_resultant_length(class_kappa(classes.shape[1]))
    angle[known], kappa[known] = direction(vectors[known]), concentration_from_resultant(blurred)
    return angle, kappa


def covariances_of(track: Track, likelihood: LikelihoodParameters) -> FloatArray:
    """Return the covariances (n, 2, 2) of the observed positions, declared or default, m²."""
    found = likelihood.position_stds(track.position_std, len(track))[:, None, None] ** 2 * np.eye(2)
    if track.position_covariance is not None:
        known = np.isfinite(track.position_covariance).all(axis=(1, 2))
        found[known] = likelihood.position_scale**2 * track.position_covariance[known]
    return np.asarray(found)


def velocity_covariances_of(track: Track, likelihood: LikelihoodParameters) -> FloatArray:
    """Return the covariances (n, 2, 2) of the observed velocities, declared or default, m²/s²."""
    found = np.tile(likelihood.velocity_std**2 * np.eye(2), (len(track), 1, 1))
    if track.observed_velocity_covariance is not None:
        known = np.isfinite(track.observed_velocity_covariance).all(axis=(1, 2))
        found[known] = track.observed_velocity_covariance[known]
    return found
