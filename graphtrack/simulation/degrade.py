"""Degradation of known tracks: noise, withheld windows, and angles from simulated classifiers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from graphtrack.errors import InputError
from graphtrack.geometry.angles import BoolArray, FloatArray, difference, direction, wrap
from graphtrack.io.read_write import tracks_given
from graphtrack.tracks.track import BODY_CLASSES, HEAD_CLASSES, Track, TrackSet
from graphtrack.tracks.validation import (
    LARGEST_CONCENTRATION,
    LARGEST_METRES,
    LARGEST_SECONDS,
    SMALLEST,
    check_within,
)

if TYPE_CHECKING:
    from graphtrack.io.read_write import Given


WITHHELD = ("position", "position_std", "pixel", "body", "body_kappa", "body_likelihood")
"""Channels withheld by `occlude`: all but the head, which is visible longest above an obstacle."""

OBSERVED = (*WITHHELD, "head", "head_kappa", "head_likelihood")
"""Channels that are missing if a person is not detected."""

TURN_SECONDS = 1.0
"""Default time over which a turn is measured: from the motion of the first half to that of the second."""

MOVING_SPEED = 0.3  # m/s below which the direction of motion is undefined


def add_noise(
    tracks: Given,
    *,
    position_std: float | None = None,
    body_kappa: float | None = None,
    head_kappa: float | None = None,
    persistence: float | None = None,
    rng: np.random.Generator,
) -> TrackSet:
    """Take the tracks' values as the truth, and observe them with noise.

    The values move to ``true_position``, ``true_body`` and ``true_head``; an existing truth is
    used instead. Missing observations stay missing; an absent channel with known truth is observed at every
    frame. Estimates are dropped, and so are pixels and class
    likelihoods of a channel that gets noise.

    Parameters
    ----------
    tracks : exact tracks, in any form that `graphtrack.solve` takes
    position_std : metres, 1-σ of each axis; None: positions without noise
    body_kappa, head_kappa : von Mises concentrations, ≥ 0; None: angles without noise
    persistence : seconds that an error of an angle lasts in the mean (exponential): errors Δt apart have the
        correlation exp(−Δt / persistence); None: independent errors
    rng : generator of the noise

    Raises
    ------
    InputError
        For a negative or non-finite amount of noise.
    """
    check_within(0.0, LARGEST_METRES, position_std=position_std)
    check_within(0.0, LARGEST_CONCENTRATION, body_kappa=body_kappa, head_kappa=head_kappa)
    check_within(0.0, LARGEST_SECONDS, persistence=persistence)
    kappas = {"body": body_kappa, "head": head_kappa}
    return tracks_given(tracks).map(lambda track: _noisy(track, position_std, kappas, persistence, rng))


def _noisy(
    track: Track,
    position_std: float | None,
    kappas: Mapping[str, float | None],
    persistence: float | None,
    rng: np.random.Generator,
) -> Track:
    true_position = motion(track)
    changes: dict[str, Any] = {"true_position": true_position, "velocity": None, "covariance": None}
    if position_std is not None:
        noisy = true_position + position_std * rng.standard_normal((len(track), 2))
        has_position = np.isfinite(track.position).all(axis=1)
        if has_position.any():
            noisy[~has_position] = np.nan
        # A σ of 0 is no noise model: the model's default applies.
        std = np.full(len(track), position_std) if position_std > 0.0 else None
        changes |= {"position": noisy, "position_std": std, "pixel": None}
    for name, kappa in kappas.items():
        observed, truth = getattr(track, name), getattr(track, f"true_{name}")
        truth = observed if truth is None else truth
        changes[f"true_{name}"] = truth
        if kappa is None or truth is None:
            continue
        errors = rng.vonmises(0.0, kappa, len(track))
        angles = wrap(truth + errors[_lasting(track, persistence, rng)])
        if observed is not None:
            angles[~np.isfinite(observed)] = np.nan
        changes |= {name: angles, f"{name}_kappa": np.full(len(track), kappa), f"{name}_likelihood": None}
    return replace(track, **changes)


def _lasting(track: Track, persistence: float | None, rng: np.random.Generator) -> NDArray[np.intp]:
    """Return for each frame (n,) the frame whose error it has, as a renewal process of that mean duration."""
    frames = np.arange(len(track))
    if not persistence:
        return frames
    renewed = rng.random(len(track)) >= np.exp(-track.dt / persistence)
    renewed[:1] = True
    return np.maximum.accumulate(np.where(renewed, frames, 0))


def motion(track: Track) -> FloatArray:
    """Return the true positions (n, 2), or the observed positions without truth."""
    return track.true_position if track.true_position is not None and track.has_truth else track.position


@dataclass(frozen=True, eq=False)
class Occlusion:
    """Tracks with a window withheld."""

    tracks: TrackSet  # tracks with room for a window
    windows: Mapping[int, BoolArray]  # track_id → (n,) bool, true at the withheld frames
    # track_id → why the track is not among ``tracks``
    left_out: Mapping[int, str] = field(default_factory=dict)


def occlude(
    tracks: TrackSet, seconds: float, *, margin: float = 1.0, turn_seconds: float = TURN_SECONDS
) -> Occlusion:
    """Withhold position and body, but not the head, around each person's sharpest turn.

    The sharpest turn is the largest change of the direction of true motion (observed, without truth) over
    ``turn_seconds``, among the times of motion. Raise InputError for a
    length or a time of turning that is not positive, or a negative margin.

    Parameters
    ----------
    seconds : length of the window, > 0
    margin : seconds of the track that must remain on both sides of the window, with a position in each
    turn_seconds : time over which a turn is measured, > 0; long enough that noise in the
        truth does not count as turning

    Returns
    -------
    Occlusion
        Tracks that are too short, or without motion, are left out with their reason.
    """
    check_within(SMALLEST, LARGEST_SECONDS, seconds=seconds, turn_seconds=turn_seconds)
    check_within(0.0, LARGEST_SECONDS, margin=margin)
    kept, windows, left_out = [], {}, {}
    for track in tracks:
        window = turn_window(track, seconds, margin, turn_seconds)
        if isinstance(window, str):
            left_out[track.track_id] = window
            continue
        windows[track.track_id] = window
        kept.append(withhold(track, window))
    return Occlusion(tracks.with_tracks(kept), windows, left_out)


def withhold(track: Track, window: BoolArray, channels: tuple[str, ...] = WITHHELD) -> Track:
    """Return the track without observations of ``channels`` at the frames where ``window`` (n,) is true."""
    changes: dict[str, Any] = {}
    for name in channels:
        values = getattr(track, name)
        if values is not None:
            changes[name] = np.where(window.reshape(-1, *[1] * (values.ndim - 1)), np.nan, values)
    return replace(track, **changes)


def turn_window(track: Track, seconds: float, margin: float, turn_seconds: float) -> BoolArray | str:
    """Return a mask (n,) of ``seconds`` around the sharpest turn, or the reason why there is no room."""
    t, reach = track.t, 0.5 * seconds + margin
    room = np.asarray((t - t[0] >= reach - 1e-9) & (t[-1] - t >= reach - 1e-9))
    if not room.any():
        return f"{t[-1] - t[0]:.1f} s are too short for a window of {seconds:g} s and {margin:g} s around it"
    sharpness = np.where(room, turning(track, turn_seconds), np.nan)
    if not np.isfinite(sharpness).any():
        return "the person does not move where a window would fit"
    centre = t[int(np.nanargmax(sharpness))]
    # Half open, so that a window has no extra frame.
    window = np.asarray((t >= centre - 0.5 * seconds - 1e-9) & (t < centre + 0.5 * seconds - 1e-9))
    has_position = np.asarray(np.isfinite(track.position).all(axis=1))
    first, last = np.flatnonzero(window)[[0, -1]]
    if not has_position[:first].any() or not has_position[last + 1 :].any():
        return "no position is known before the window, or none after it"
    return window


def turning(track: Track, turn_seconds: float = TURN_SECONDS) -> FloatArray:
    """Return |change of the direction of motion| (n,) in radians over ``turn_seconds`` around each frame.

    NaN without motion, or without data half of that time before and after.
    """
    position = motion(track)
    known = np.asarray(np.isfinite(position).all(axis=1))
    if not known.any():
        return np.full(len(track), np.nan)
    half, first, last = 0.5 * turn_seconds, track.t[known][0], track.t[known][-1]

    def at(time: FloatArray) -> FloatArray:
        # Rounding must not put a time that is just the first or the last outside.
        time = np.where(np.abs(time - first) < 1e-9, first, np.where(np.abs(time - last) < 1e-9, last, time))
        columns = [np.interp(time, track.t[known], p, left=np.nan, right=np.nan) for p in position[known].T]
        return np.stack(columns, axis=-1)

    before, after = at(track.t) - at(track.t - half), at(track.t + half) - at(track.t)
    moves = np.minimum(np.linalg.norm(before, axis=1), np.linalg.norm(after, axis=1)) >= MOVING_SPEED * half
    return np.where(moves, np.abs(difference(direction(after), direction(before))), np.nan)


def confusion_matrix(n_classes: int, *, flipped: float = 0.2, at_random: float = 0.1) -> FloatArray:
    """Return the probability (n, n) of each predicted class (column) given each true class (row).

    ``flipped``: share of front–back confusions; ``at_random``: share of uniformly random classes. Raise
    InputError for an odd number of classes, or invalid shares.
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
    persistence: float | None = None,
    rng: np.random.Generator,
) -> TrackSet:
    """Observe the orientations of tracks by classifiers with known confusion matrices.

    In each frame with a known orientation, a class is drawn from the confusion matrix's row of its true class
    (the nearest centre, 360·k/n degrees), and the likelihoods are those of the drawn class. The orientations
    become the truth unless there is one. ``body`` (8, 8), ``head`` (12, 12): confusions, rows true classes;
    None: `confusion_matrix`. ``persistence``: seconds that a confusion lasts in the mean, as in `add_noise`:
    the drawn class stays as far from the true one. Raise InputError for another shape, rows that are no
    distributions, or a negative duration.
    """
    check_within(0.0, LARGEST_SECONDS, persistence=persistence)
    confusions = {
        name: confusion_matrix(n) if given is None else _checked(name, given, n)
        for name, given, n in (("body", body, BODY_CLASSES), ("head", head, HEAD_CLASSES))
    }
    return tracks_given(tracks).map(lambda track: _classified(track, confusions, persistence, rng))


def _checked(name: str, confusion: FloatArray, n_classes: int) -> FloatArray:
    matrix = np.asarray(confusion, dtype=float)
    if matrix.shape != (n_classes, n_classes):
        raise InputError(f"a {name} confusion of shape {matrix.shape}", f"({n_classes}, {n_classes})")
    if not ((matrix >= 0.0).all() and np.allclose(matrix.sum(axis=1), 1.0)):
        raise InputError(f"a {name} confusion whose rows are no distributions", "rows that sum to 1")
    return matrix


def _classified(
    track: Track, confusions: dict[str, FloatArray], persistence: float | None, rng: np.random.Generator
) -> Track:
    changes: dict[str, Any] = {"velocity": None, "covariance": None}
    for name, confusion in confusions.items():
        observed, truth = getattr(track, name), getattr(track, f"true_{name}")
        truth = observed if truth is None else truth
        if truth is None:
            continue
        n_classes = len(confusion)
        known = np.isfinite(truth)
        true_class = np.round(np.nan_to_num(truth) * n_classes / (2.0 * np.pi)).astype(int) % n_classes
        classes = (true_class[:, None] + np.arange(n_classes)) % n_classes
        reached = np.take_along_axis(confusion[true_class], classes, axis=1).cumsum(axis=1)
        drawn = rng.random(len(track))[_lasting(track, persistence, rng)]
        apart = (drawn[:, None] * reached[:, -1:] >= reached).sum(axis=1)
        answer = (true_class + np.minimum(apart, n_classes - 1)) % n_classes
        likelihood = confusion.T[answer]
        likelihood[~known] = np.nan
        changes |= {name: None, f"{name}_kappa": None}
        changes |= {f"{name}_likelihood": likelihood, f"true_{name}": truth}
    return replace(track, **changes)
