"""Class likelihoods as evidence: pictures that are hidden, and errors of a classifier that persist.

Frames that follow each other closely show nearly the same picture, and a classifier makes the same error in
them. Rows declare how long: T, the integral of the errors' autocorrelation. They count w = min(1, Δt/T)
times, with the time Δt since the likelihoods before; in Chen et al. (2011, eq. 13–14) T = 0.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray
from graphtrack.kernels.layout import Orientation
from graphtrack.model.parameters import LikelihoodParameters
from graphtrack.tracks.track import Track

HIDDEN: Mapping[Orientation, str] = {"body": "body_hidden", "head": "head_hidden"}
"""Orientation → the input with the share of its picture that is hidden in each frame, 0…1; NaN: none."""

PERSISTENCE: Mapping[Orientation, str] = {"body": "body_persistence", "head": "head_persistence"}
"""Orientation → the input with the time T in seconds; NaN: the model's ``class_correlation_time``."""

SINCE: Mapping[Orientation, str] = {"body": "body_class_dt", "head": "head_class_dt"}
"""Orientation → the input with the seconds since its class likelihoods before, of a frame by itself."""

TOGETHER = 2e-3
"""Seconds. Class likelihoods that are nearer are of several sensors at one time, and count each in full."""


def seconds_since_classes(track: Track, name: Orientation) -> FloatArray:
    """Return the seconds (n,) since the class likelihoods before.

    NaN at the first, at those that are `TOGETHER`, and where there are none. Where the track has the input
    `SINCE`, as a frame of a longer track has, it is that.
    """
    found, classes = np.full(len(track), np.nan), getattr(track, f"{name}_likelihood")
    if classes is not None:
        rows = np.flatnonzero(np.isfinite(classes).all(axis=1))
        apart = np.diff(track.t[rows])
        found[rows[1:]] = np.where(apart > TOGETHER, apart, np.nan)
    given = track.input(SINCE[name])
    return np.where(np.isfinite(given), given, found)


def with_seconds_since_classes(track: Track) -> Track:
    """Return the track with the inputs `SINCE` of what it has class likelihoods of."""
    found = {
        SINCE[name]: seconds_since_classes(track, name)
        for name in SINCE
        if getattr(track, f"{name}_likelihood") is not None
    }
    return replace(track, inputs={**track.inputs, **found}) if found else track


def persistence(track: Track, name: Orientation, likelihood: LikelihoodParameters) -> FloatArray:
    """Return the times T (n,) in seconds, declared or the model's; InputError for a negative one."""
    declared = track.input(PERSISTENCE[name])
    if np.any(declared < 0.0):
        found = f"input {PERSISTENCE[name]!r} of {declared[declared < 0.0][0]:g} s in track {track.track_id}"
        raise InputError(found, "0 or more")
    return np.where(np.isfinite(declared), declared, likelihood.class_correlation_time)


def class_weights(track: Track, name: Orientation, likelihood: LikelihoodParameters) -> FloatArray:
    """Return how often (n,) the class likelihoods of each row count: min(1, Δt/T)."""
    seconds, time = seconds_since_classes(track, name), persistence(track, name, likelihood)
    return np.divide(seconds, time, out=np.ones(len(track)), where=seconds < time)


def class_evidence(
    classes: FloatArray,
    hidden: FloatArray,
    weight: FloatArray,
    uniform: float,
    likelihood: LikelihoodParameters,
) -> FloatArray:
    """Return class likelihoods (n, k) as the evidence that they are.

    With probability ``hidden_outliers`` times the hidden share of a picture they say nothing: Chen et al.
    (2011, §5) name occlusion as a cause of wrong poses. InputError for a share outside of 0…1.

    Parameters
    ----------
    hidden : (n,) share of the picture that is hidden, NaN where unknown
    weight : (n,) as from `class_weights`
    uniform : outlier share ε of the likelihoods
    """
    known = hidden[np.isfinite(hidden)]
    if known.size and not (known.min() >= 0.0 and known.max() <= 1.0):
        raise InputError(f"a hidden share of {known[(known < 0) | (known > 1)][0]:g}", "a number from 0 to 1")
    if likelihood.hidden_outliers > 0.0 and known.any():
        informed = 1.0 - likelihood.hidden_outliers * np.nan_to_num(hidden)
        classes = _with_uniform(classes, informed[:, None])
    if np.all(weight == 1.0):
        return classes
    total = classes.sum(axis=1, keepdims=True)
    shares = np.divide(classes, total, out=np.zeros_like(classes), where=total > 0.0)
    tempered = _with_uniform(shares, 1.0 - uniform) ** weight[:, None]
    return np.asarray(np.where((weight[:, None] < 1.0) & (total > 0.0), tempered, classes))


def _with_uniform(classes: FloatArray, informed: FloatArray | float) -> FloatArray:
    """Return class likelihoods (n, k), a share of which say nothing."""
    uniform = classes.sum(axis=1, keepdims=True) / classes.shape[1]
    return np.asarray(informed * classes + (1.0 - informed) * uniform)
