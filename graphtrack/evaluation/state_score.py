"""Errors of estimated states, and the calibration of their covariances, for people matched with the truth.

A row of the estimates is compared with the person that it matches on the ground, in the matching of HOTA.
Where both have the same identities, a row without a match is compared with the person of its ``track_id``.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from graphtrack.association.associate import tracks_of
from graphtrack.evaluation.identities import hota_matches, identity_pairs, similarity_of, threshold_of
from graphtrack.evaluation.matching import (
    IdentifiedRows,
    mean_times,
    nearest_times,
    renumbered,
    share_frames,
)
from graphtrack.evaluation.metrics import (
    DEGREES,
    TrackCalibration,
    calibration_of,
    chi_square_band,
    pooled,
    squared_errors,
    true_velocity,
)
from graphtrack.geometry.angles import BoolArray, FloatArray, difference
from graphtrack.tracks.display import counted
from graphtrack.tracks.track import Track, TrackSet

if TYPE_CHECKING:
    from graphtrack.evaluation.identities import Threshold
    from graphtrack.io.read_write import Given

IntArray = NDArray[np.int64]

UNITS = {"position": "m", "velocity": "m/s", "body": "°", "head": "°"}

SAME_TIME = 0.1
"""Largest time difference of estimate and truth, as a share of the truth's median step."""


@dataclass(frozen=True)
class StateScore:
    """Errors by quantity.

    Attributes
    ----------
    rows : for position, velocity, body and head, if both files have them: ``quantity``, ``unit``,
        ``tracks`` (people of the truth), ``frames``; ``rmse``, ``mae`` and ``median`` over the frames, of
        distances and wrapped angle errors; ``coverage_95``, the share of frames with the truth in the 95 %
        interval (for positions and velocities the ellipse), mean over the people; ``nees`` per degree of
        freedom, mean over the people, and ``nees_low`` and ``nees_high``, its 95 %
        band if covariances are consistent. None without uncertainty.
    notes : omitted quantities and rows, with reasons
    """

    rows: tuple[dict[str, Any], ...]
    notes: tuple[str, ...]

    def to_dict(self) -> dict[str, Any]:
        """Return JSON-able data."""
        return {"rows": list(self.rows), "notes": list(self.notes)}


@dataclass(frozen=True)
class PersonErrors:
    """Errors of one person of the truth, by quantity.

    Attributes
    ----------
    errors : quantity → (n,) in the units of `UNITS`
    calibration : quantity → NEES and coverage
    """

    errors: dict[str, FloatArray]
    calibration: dict[str, TrackCalibration]


@dataclass(frozen=True)
class Compared:
    """Errors of one sequence.

    Attributes
    ----------
    people : one entry for each person of the truth with rows to compare
    far : number of rows that match nobody and were compared with the person of their ``track_id``
    omitted : number of rows that match nobody and were not compared
    """

    people: tuple[PersonErrors, ...] = ()
    far: int = 0
    omitted: int = 0


def score_states(
    estimates: Given, truth: Given, *, metres: float | None = None, frame_offset: int = 0
) -> StateScore:
    """Compute errors of estimated states against the truth, and the calibration of their uncertainties.

    Rows are compared with the person that they match on the ground. If the ``track_id`` of no track
    contradicts the best pairing of tracks and people, rows without a match are compared with the person of
    their ``track_id``. Times agree to a tenth of the truth's step.

    Parameters
    ----------
    estimates, truth : tracks in any form that `smooth` takes. The truth's true values (``true_x`` …) are
        used if there are any, else its positions, velocities and angles. Missing velocities are central
        differences of the true positions.
    metres : largest distance of a match; 1 m by default
    frame_offset : as in `score`
    """
    threshold, true = threshold_of(metres), tracks_of(truth)
    found = renumbered(tracks_of(estimates), true, frame_offset)
    return summary([state_errors(found, true, threshold)], threshold)


def state_errors(estimates: TrackSet, truth: TrackSet, threshold: Threshold) -> Compared:
    """Return the errors of the people of one sequence; see `score_states` for the rows that are compared."""
    true = [_as_truth(track) for track in truth]
    rows, shared = _matched_rows(estimates, true, threshold)
    pieces = defaultdict[int, list[_Piece]](list)
    unmatched: list[BoolArray] = [np.ones(len(track), dtype=bool) for track in estimates]
    for part in np.split(rows, np.flatnonzero(np.diff(rows[:, [0, 2]], axis=0).any(axis=1)) + 1):
        if len(part):
            track, person = part[0, [0, 2]].tolist()
            unmatched[track][part[:, 1]] = False
            pieces[person].append((estimates[track], part[:, 1], part[:, 3]))
    # Identities of associated detections mean nothing in another file.
    shared = shared and all(track.identity_p is None for track in estimates)
    of_id = {track.track_id: person for person, track in enumerate(true)}
    far = omitted = 0
    for track, alone in zip(estimates, unmatched, strict=True):
        placed: BoolArray = np.asarray(np.isfinite(track.position).all(axis=1))
        own = of_id.get(track.track_id)
        if shared and own is not None:
            here, there = _same_times(track.t, true[own].t)
            here, there = here[alone[here]], there[alone[here]]
            pieces[own].append((track, here, there))
            far += int(placed[here].sum())
            alone[here] = False
        omitted += int((alone & placed).sum())
    found = (_errors(true[person], some) for person, some in sorted(pieces.items()))
    return Compared(tuple(one for one in found if one is not None), far, omitted)


def summary(sequences: Iterable[Compared], threshold: Threshold) -> StateScore:
    """Pool the errors of all people of all sequences."""
    parts = list(sequences)
    people = [person for part in parts for person in part.people]
    far, omitted = sum(part.far for part in parts), sum(part.omitted for part in parts)
    if not people:
        reason = f"no row matches a person {threshold} at the same time, nor by track_id"
        ground = "the same ground (--homography, --calibration), units and times?"
        return StateScore((), (f"errors of the states: {reason}; are both on {ground}",))
    rows, notes = [], []
    if far:
        notes.append(f"{counted(far, 'row')} not {threshold} of anybody: compared by track_id")
    if omitted:
        notes.append(f"{counted(omitted, 'row')} not {threshold} of anybody at the same time: not compared")
    for quantity, degrees in DEGREES.items():
        errors = [person.errors[quantity] for person in people if quantity in person.errors]
        if not errors:
            notes.append(f"{quantity}: not in both estimates and truth")
            continue
        every = np.concatenate(errors)
        row: dict[str, Any] = {
            "quantity": quantity,
            "unit": UNITS[quantity],
            "tracks": len(errors),
            "frames": len(every),
            "rmse": float(np.sqrt(np.mean(every**2))),
            "mae": float(np.mean(np.abs(every))),
            "median": float(np.median(np.abs(every))),
        }
        calibrated = [person.calibration[quantity] for person in people if quantity in person.calibration]
        row |= dict.fromkeys(("coverage_95", "nees", "nees_low", "nees_high"))
        if calibrated:
            low, high = chi_square_band(degrees, len(calibrated))
            row |= {name: pooled(calibrated)[name] for name in ("coverage_95", "nees")}
            row |= {"nees_low": low / degrees, "nees_high": high / degrees}
        else:
            notes.append(f"{quantity}: no uncertainty in the estimates; only errors are scored")
        rows.append(row)
    return StateScore(tuple(rows), tuple(notes))


_Piece = tuple[Track, IntArray, IntArray]
"""A track, its rows (n,), and the rows (n,) of a person of the truth at the same times."""


def _matched_rows(estimates: TrackSet, truth: list[Track], threshold: Threshold) -> tuple[IntArray, bool]:
    """Match rows of estimates and truth on the ground at each time.

    Returns
    -------
    rows : (k, 4) track, its row, person, its row; sorted by track and person
    shared : True if no track is paired, over the whole sequence, with a person of another ``track_id``
    """
    steps = np.concatenate([np.empty(0), *(np.diff(track.t) for track in truth)])
    tolerance = SAME_TIME * _step(steps)
    # Stamps of a frame may differ from person to person.
    times = mean_times(np.unique(np.concatenate([np.empty(0), *(track.t for track in truth)])), tolerance)
    true, true_row = _at_instants(truth, "true_position", times, tolerance)
    found, row = _at_instants(list(estimates), "position", times, tolerance)
    if not np.isin(found.frame, true.frame).any():
        return np.zeros((0, 4), dtype=np.int64), True
    frames = share_frames(true, found, similarity_of(threshold))
    matched = hota_matches(frames, threshold.similarity)
    there, here = frames.row[matched], frames.column[matched]
    rows = np.column_stack([found.track_id[here], row[here], true.track_id[there], true_row[there]])
    people, tracks = np.unique(true.track_id), np.unique(found.track_id)
    person, track, _ = identity_pairs(frames, threshold.similarity)
    pairs = zip(people[person].tolist(), tracks[track].tolist(), strict=True)
    shared = all(truth[one].track_id == estimates[other].track_id for one, other in pairs)
    return rows[np.lexsort((rows[:, 2], rows[:, 0]))], shared


def _at_instants(
    tracks: list[Track], channel: str, times: FloatArray, tolerance: float
) -> tuple[IdentifiedRows, IntArray]:
    """Return rows at known times as detections, and their rows (n,) in the tracks.

    ``track_id`` is the index of the track, and ``frame`` that of the nearest of ``times`` (f,), at most
    ``tolerance`` seconds away.
    """
    if not tracks:
        none = np.empty(0, dtype=np.int64)
        return IdentifiedRows(none, none, np.empty((0, 2))), none
    lengths = [len(track) for track in tracks]
    index = np.repeat(np.arange(len(tracks)), lengths)
    row = np.concatenate([np.arange(length) for length in lengths])
    place = np.concatenate([getattr(track, channel) for track in tracks])
    here, instant = nearest_times(np.concatenate([track.t for track in tracks]), times, tolerance)
    index, row, place = index[here], row[here], place[here]
    order = np.lexsort((index, instant))
    order = order[np.isfinite(place[order]).all(axis=1)]
    return IdentifiedRows(index[order], instant[order], place[order]), row[order]


def _errors(truth: Track, pieces: list[_Piece]) -> PersonErrors | None:
    """Return one person's errors; None without a row at the same time."""
    velocity = truth.velocity
    if velocity is None:
        velocity = true_velocity(truth)
    errors, squared = defaultdict[str, list[FloatArray]](list), defaultdict[str, list[FloatArray]](list)
    for track, here, there in pieces:
        if len(here):
            estimate, true = track[here], truth[there]
            for name, values in _differences(estimate, true, velocity[there]).items():
                errors[name].append(values[np.isfinite(values)])
            for name, values in squared_errors(estimate, true, velocity[there]).items():
                squared[name].append(values)
    joined = {name: np.concatenate(parts) for name, parts in errors.items()}
    known = {name: values for name, values in joined.items() if len(values)}
    if not known:
        return None
    return PersonErrors(known, calibration_of({name: np.concatenate(p) for name, p in squared.items()}))


def _differences(estimate: Track, truth: Track, velocity: FloatArray) -> dict[str, FloatArray]:
    """Return the errors (n,) of an estimate at the truth's rows, in the units of `UNITS`."""
    assert truth.true_position is not None
    found = {"position": np.linalg.norm(estimate.position - truth.true_position, axis=1)}
    if estimate.velocity is not None:
        found["velocity"] = np.linalg.norm(estimate.velocity - velocity, axis=1)
    for name in ("body", "head"):
        angle, known = getattr(estimate, name), getattr(truth, f"true_{name}")
        if angle is not None and known is not None:
            found[name] = np.degrees(difference(angle, known))
    return found


def _as_truth(track: Track) -> Track:
    """Return a track with missing true values filled from its own values."""
    if track.has_truth:
        return replace(track, velocity=None)  # the velocity is that of the observation
    return replace(track, true_position=track.position, true_body=track.body, true_head=track.head)


def _same_times(t: FloatArray, truth: FloatArray) -> tuple[IntArray, IntArray]:
    """Return rows of both with matching times; each row of the truth is the nearest in time."""
    return nearest_times(t, truth, SAME_TIME * _step(np.diff(truth)))


def _step(steps: FloatArray) -> float:
    """Return the median of steps (n,) in seconds; a millisecond if there are none."""
    return float(np.median(steps)) if len(steps) else 1e-3
