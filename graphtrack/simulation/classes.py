"""Orientations as classifiers see them: the likelihoods of the classes that they answered."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray
from graphtrack.io.given import tracks_of
from graphtrack.tracks import BODY_CLASSES, HEAD_CLASSES, Track, TrackSet

if TYPE_CHECKING:
    from graphtrack.io.given import Given


def confusion_matrix(n_classes: int, *, flipped: float = 0.2, at_random: float = 0.1) -> FloatArray:
    """Probability (n, n) of each answer (column) to each true class (row).

    Raise InputError for an odd number of classes, or shares that are none.

    Parameters
    ----------
    flipped : share of the answers that take front for back
    at_random : share that is any class
    """
    if n_classes < 2 or n_classes % 2:
        raise InputError(f"{n_classes} classes", "an even number of them")
    if not (flipped >= 0.0 and at_random >= 0.0 and flipped + at_random <= 1.0):
        raise InputError(f"shares {flipped} and {at_random}", "two numbers from 0, at most 1 together")
    right = np.eye(n_classes)
    back = np.roll(right, n_classes // 2, axis=1)
    return (1.0 - flipped - at_random) * right + flipped * back + at_random / n_classes


def add_class_likelihoods(
    tracks: Given,
    *,
    body: FloatArray | None = None,
    head: FloatArray | None = None,
    rng: np.random.Generator,
) -> TrackSet:
    """Observe the orientations of tracks by classifiers whose confusion is known.

    In each frame in which an orientation is known, its class (the nearest centre, 360·k/n degrees) is
    answered as the confusion matrix has it, and the likelihoods are those of that answer: calibrated, and as
    far as one answer tells. The orientations become the truth unless there is one. Raise InputError for a
    matrix of another shape, or one whose rows are no distributions.

    Parameters
    ----------
    body : (8, 8) confusion of the body's classes, rows true classes; None: `confusion_matrix`
    head : (12, 12) of the head's
    """
    confusions = {
        "body": confusion_matrix(BODY_CLASSES) if body is None else _checked("body", body, BODY_CLASSES),
        "head": confusion_matrix(HEAD_CLASSES) if head is None else _checked("head", head, HEAD_CLASSES),
    }
    return tracks_of(tracks).map(lambda track: _classified(track, confusions, rng))


def _checked(name: str, confusion: FloatArray, n_classes: int) -> FloatArray:
    matrix = np.asarray(confusion, dtype=float)
    if matrix.shape != (n_classes, n_classes):
        raise InputError(f"a {name} confusion of shape {matrix.shape}", f"({n_classes}, {n_classes})")
    if not ((matrix >= 0.0).all() and np.allclose(matrix.sum(axis=1), 1.0)):
        raise InputError(f"a {name} confusion whose rows are no distributions", "rows that sum to 1")
    return matrix


def _classified(track: Track, confusions: dict[str, FloatArray], rng: np.random.Generator) -> Track:
    changes: dict[str, Any] = {"velocity": None, "covariance": None}
    for name, confusion in confusions.items():
        observed, truth = getattr(track, name), getattr(track, f"true_{name}")
        truth = observed if truth is None else truth
        if truth is None:
            continue
        n_classes = len(confusion)
        known = np.isfinite(truth)
        true_class = np.round(np.nan_to_num(truth) * n_classes / (2.0 * np.pi)).astype(int) % n_classes
        reached = confusion.cumsum(axis=1)[true_class]
        answer = (rng.random((len(track), 1)) * reached[:, -1:] >= reached).sum(axis=1)
        likelihood = confusion.T[np.minimum(answer, n_classes - 1)]
        likelihood[~known] = np.nan
        changes |= {
            name: None,
            f"{name}_kappa": None,
            f"{name}_likelihood": likelihood,
            f"true_{name}": truth,
        }
    return replace(track, **changes)
