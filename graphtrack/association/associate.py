"""Tracks from files, tables and other libraries' detections whose rows may have no identities."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias, Unpack

import numpy as np
from numpy.typing import NDArray

from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray
from graphtrack.io.libraries import rows_of_supervision, rows_of_ultralytics
from graphtrack.io.options import Associate, FileReading, Placing, Reading, ReadOptions
from graphtrack.io.read_write import (
    identified_tracks,
    is_table,
    read_identified,
    rows_of_file,
    rows_of_frame,
    tracks_given,
)
from graphtrack.tracks.cells import rows_of_table
from graphtrack.tracks.detections import APPEARANCE, Detections, frames_between
from graphtrack.tracks.display import counted, listed
from graphtrack.tracks.gaps import (
    FASTEST,
    frames_increase,
    has_several_sensors,
    only_sensor,
    times_of,
    usual_rate,
    with_rows,
)
from graphtrack.tracks.given import AXES, position_noise
from graphtrack.tracks.scene import GivenScene, SceneParameters, known_values
from graphtrack.tracks.sensors import NO_SENSORS, Sensor, Sensors
from graphtrack.tracks.table import Rows, check_identities
from graphtrack.tracks.time import TIME_TOLERANCE
from graphtrack.tracks.track import Track, TrackSet, of_axes, to_columns

if TYPE_CHECKING:
    import pandas as pd

    from graphtrack.io.read_write import Given
    from graphtrack.model import Model

    Detected: TypeAlias = TrackSet | Track | str | Path | pd.DataFrame | Mapping[str, Any] | Sequence[Track]

FALSE = "taken for false detections"
NOWHERE = "detections without a position"
REPEATED = "repeated in the same frame"

_ALONG = (
    "position_std",
    "score",
    "body",
    "head",
    "body_likelihood",
    "head_likelihood",
    APPEARANCE,
)
"""Channels that the evidence reads in addition to the position."""


def associated(
    rows: Rows,
    scene: GivenScene = None,
    *,
    sensors: Sensors = NO_SENSORS,
    repair: bool = False,
    missed_rows: bool = True,
) -> TrackSet:
    """The tracks of associated detections, with a row for each frame from first to last.

    Parameters
    ----------
    scene : known parameters; the others are learned
    sensors : descriptions of several sensors: rates and fields of view that they lack are learned
    repair : the rows have a tracker's identities, which are kept unless the evidence is against them
    missed_rows : False: without the rows of frames in which a person was missed
    """
    known = known_values(scene)
    identified = with_repaired_identities if repair else with_identities
    found = identified(rows, known, sensors)
    tracks = TrackSet.from_rows(found)
    return with_every_frame(tracks, SceneParameters(**known).longest_filled) if missed_rows else tracks


def with_identities(rows: Rows, scene: GivenScene = None, sensors: Sensors = NO_SENSORS) -> Rows:
    """The rows of detections with the most probable identities; false detections are left out.

    Parameters
    ----------
    rows : on the ground, with times; their own identities are not read
    scene, sensors : as of `associated`
    """
    rows, detections = detections_of(rows, sensors)
    from graphtrack.association.offline import associate_detections  # SciPy takes long to load

    found = associate_detections(detections, scene)
    replaced = [name for name in ("identity_p", "observed") if name in rows.channels]
    if replaced := [*replaced, *["label"] * bool(rows.labels)]:
        rows = rows.with_notes(f"association replaces {listed(replaced)}")
    identity, probability = np.empty(len(rows), np.int64), np.empty(len(rows))
    identity[detections.row], probability[detections.row] = found.identity, found.probability
    people, false = int(identity.max()) + 1, int((identity < 0).sum())
    as_read = None if rows.as_read is None else rows.as_read.without_identities()
    rows = replace(rows, track_id=identity + 1, has_identity=True, labels={}, as_read=as_read)
    rows = rows.with_channels(identity_p=probability, observed=np.ones(len(rows)))
    declared = known_values(scene).get("position_std")
    if declared is not None:
        std = rows.channels.get("position_std", np.full(len(rows), np.nan))
        rows = rows.with_channels(position_std=np.where(np.isnan(std), declared, std))
    notes = [f"associated {len(rows)} detections: {people} people; {false} {FALSE}"]
    if false > 0.5 * len(rows):
        notes.append(
            f"most detections are {FALSE}: are the scale (--homography, --units) and the rate (--fps) right?"
        )
    return rows.keep(identity >= 0, FALSE).with_notes(*notes, learned_scene(found.scene))


def with_repaired_identities(rows: Rows, scene: GivenScene = None, sensors: Sensors = NO_SENSORS) -> Rows:
    """The rows of a tracker: tracks split at identity switches and joined across gaps.

    Parameters
    ----------
    rows : on the ground, with times and identities; those with the identity −1 have none
    scene, sensors : as of `associated`
    """
    # Rows of joined tracks may be out of order.
    in_order = rows.frame if rows.sensor is None else rows.channels["t"]
    rows, detections = detections_of(rows.taken(np.argsort(in_order, kind="stable")), sensors)
    known, place = _given_identities(rows)
    given = np.where(rows.track_id == -1, -1, place)[detections.row]
    from graphtrack.association.offline import repair_detections

    found = repair_detections(detections, given, scene)
    # New people get the numbers after the highest.
    names = np.concatenate([known, known.max() + 1 + np.arange(len(rows))])
    track_id, probability = np.empty(len(rows), np.int64), np.empty(len(rows))
    track_id[detections.row], probability[detections.row] = names[found.identity], found.probability
    moved = int((track_id != rows.track_id).sum())
    before, after = len(known[known != -1]), len(np.unique(track_id))
    labels = {one: rows.labels[one] for one in np.unique(track_id).tolist() if one in rows.labels}
    rows = replace(rows, track_id=track_id, has_identity=True, labels=labels)
    rows = rows.with_channels(identity_p=probability, observed=np.ones(len(rows)))
    note = f"repaired {before} tracks: now {after}; {moved} of {len(rows)} rows changed identity"
    return rows.with_notes(note, learned_scene(found.scene))


def _given_identities(rows: Rows) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the track ids of given identities, and the index of each row's (n,).

    Trackers of several sensors have identities of their own: one that another sensor has too gets a new id.
    """
    if rows.sensor is None:
        return np.unique(rows.track_id, return_inverse=True)
    sensor = np.unique(rows.sensor, return_inverse=True)[1]
    pairs = np.column_stack([sensor, rows.track_id])
    different, place = np.unique(pairs, axis=0, return_inverse=True)
    ids = different[:, 1].copy()
    _, first = np.unique(ids, return_index=True)
    again = np.setdiff1d(np.arange(len(ids)), first)
    ids[again] = ids.max() + 1 + np.arange(len(again))
    return ids, place.ravel()


def learned_scene(scene: SceneParameters, when: str = "") -> str:
    """Return a note that shows what was learned of a scene, so that a misunderstood scene is recognised."""
    return f"scene, learned{when}: {scene.described()}"


def usable(rows: Rows) -> Rows:
    """The rows that have a position, without repeated rows.

    Raise InputError with the line, where times do not increase from frame to frame.
    """
    rows = rows.keep(np.asarray(np.isfinite(rows.channels["position"]).all(axis=1)), NOWHERE)
    if not len(rows):
        return rows
    noise = position_noise(rows.channels.get("position_std"), rows.channels.get("covariance"))
    if noise is not None and noise is not rows.channels.get("position_std"):
        rows = rows.with_channels(position_std=noise).with_notes(AXES)
    frames = rows.frame
    if rows.sensor is None:
        _check_times(rows)
    else:
        _, sensor = np.unique(rows.sensor, return_inverse=True)
        frames = np.unique(np.column_stack([sensor, rows.frame]), axis=0, return_inverse=True)[1].ravel()
    labelled = np.column_stack([frames, rows.channels["position"]])
    _, first = np.unique(labelled, axis=0, return_index=True)
    return rows.keep(np.isin(np.arange(len(rows)), first), REPEATED)


def _check_times(rows: Rows) -> None:
    t = rows.channels["t"]
    frame, first, place = np.unique(rows.frame, return_index=True, return_inverse=True)
    other = np.flatnonzero(np.abs(t - t[first][place]) > TIME_TOLERANCE)
    if len(other):
        i = int(other[0])
        raise InputError(
            f"frame {rows.frame[i]} at t = {t[i]:.15g}",
            f"t = {t[first][place[i]]:.15g}, as in its other rows",
            path=rows.path,
            line=rows.line_of(i),
        )
    back = np.flatnonzero(np.diff(t[first]) <= TIME_TOLERANCE)
    if len(back):
        i = int(first[back[0] + 1])
        raise InputError(
            f"frame {rows.frame[i]} at t = {t[i]:.15g}",
            f"a time after that of frame {frame[back[0]]}, {t[first[back[0]]]:.15g}",
            path=rows.path,
            line=rows.line_of(i),
        )


def detections_of(rows: Rows, sensors: Sensors = NO_SENSORS) -> tuple[Rows, Detections]:
    """The usable rows, and their channels that the evidence reads; ``sensors`` as of `associated`."""
    rows = usable(rows)
    if not len(rows):
        why = ", ".join(f"{counted(n, 'row')} {reason}" for reason, n in rows.refused.items())
        expected = "at least one; --class NAME reads others than people"
        raise InputError(f"no detections ({why or 'no rows'})", expected, path=rows.path)
    channels = {name: rows.channels[name] for name in _ALONG if name in rows.channels}
    if "position_covariance" in rows.channels:
        std = of_axes(rows.channels.get("position_std"), rows.channels["position_covariance"])
        assert std is not None
        channels["position_std"] = std
    if rows.sensor is not None:
        from graphtrack.association.sensors import Views, scans_of, with_views

        names, sensor = np.unique(rows.sensor, return_inverse=True)
        scans = scans_of(rows.channels["t"], rows.frame, sensor)
        position = rows.channels["position"]
        own = scans.number
        described = tuple(sensors.get(name, Sensor()) for name in names.tolist())
        of_sensors: dict[str, Any] = {"sensor": sensor, "scans": scans.before[own], "sensors": described}
        detections = Detections(own, scans.ordered[own], position, channels, **of_sensors)
        return rows, with_views(detections, Views.of(position, sensor, len(names), described))
    _, first, place = np.unique(rows.frame, return_index=True, return_inverse=True)
    t = rows.channels["t"][first][place]  # of its frame: rounding must not change the order within it
    return rows, Detections(rows.frame, t, rows.channels["position"], channels)


def with_every_frame(tracks: TrackSet, longest_filled: float = SceneParameters.longest_filled) -> TrackSet:
    """Tracks with an empty row for each frame without a detection, in gaps that are short.

    ``longest_filled``: seconds of a gap that is filled
    """
    if has_several_sensors(tracks) or not all(map(frames_increase, tracks)):
        return tracks  # each sensor has frames of its own
    frames, first = np.unique(np.concatenate([track.frame for track in tracks]), return_index=True)
    t = np.concatenate([track.t for track in tracks])[first]
    if (np.diff(t) <= 0.0).any():  # the numbers of a sensor do not count time
        return tracks
    step = frames_between(frames)
    return tracks.map(lambda track: _filled(track, frames, t, step, longest_filled))


def _filled(track: Track, frames: np.ndarray, t: FloatArray, step: int, longest: float) -> Track:
    # A gap of two steps holds one frame without a detection.
    short = np.diff(track.t) - np.diff(t).min() <= longest + TIME_TOLERANCE
    short &= np.diff(track.frame) <= FASTEST * usual_rate([(frames, t)]) * np.diff(track.t)
    gaps = [pair for pair, fill in zip(pairwise(track.frame.tolist()), short, strict=True) if fill]
    # Frames without any detection are missing from the recording: they are inserted a step apart.
    between = [np.arange(a, b, step) for a, b in gaps]
    inside = [frames[(frames > a) & (frames < b)] for a, b in gaps if b - a > step]
    frame = np.unique(np.concatenate([track.frame, *inside, *between]))
    return with_rows(track, frame, times_of(frame, frames, t), only_sensor(track, len(frame)))


def associate(
    detections: Detected,
    scene: GivenScene = None,
    *,
    model: Model | str | Path | None = None,
    **options: Unpack[FileReading],
) -> TrackSet:
    """Associate the detections of a recording: a track for each person, with a row for each frame.

    Parameters
    ----------
    detections : a file, a table with or without ``track_id``, or tracks whose identities are forgotten
    scene : known parameters of birth, death and detection: `SceneParameters`, or a mapping of some of them by
        name. The others are the model's, else learned from the detections
    model : a model, or a model file, whose scene it is
    **options : fields of `ReadOptions`, such as ``fps`` where there are no times, and for files ``format``

    Returns
    -------
    TrackSet
        Observations, to be smoothed. ``identity_p`` is the probability that a row is of the same person as
        the track's row before; ``observed`` is 0 in frames without a detection. Detections classified as
        false are left out, and counted in the summary.

    Raises
    ------
    InputError
        If the input cannot be read, or has no detection with a position.
    """
    from graphtrack.model import Model  # loads the compiler

    of_model = {} if model is None else Model.named(model).scene
    return associated(rows_of(detections, **options), {**of_model, **known_values(scene)})


def rows_of(detections: Detected, *, format: str | None = None, **options: Unpack[Reading]) -> Rows:
    """The rows of a file, a table or tracks, with the identities that they have.

    Raise InputError if the input cannot be read.

    ``format``: of a file; None: recognised by its content
    """
    if isinstance(detections, str | Path):
        return rows_of_file(detections, format, ReadOptions.named(**options))
    if is_table(detections):
        return rows_of_frame(detections, ReadOptions.named(**options))
    return rows_of_table(to_columns(tracks_given(detections)))


def has_detections(rows: Rows, options: ReadOptions) -> bool:
    """Return whether rows of a file have to be associated.

    Raise InputError if they have to, and ``options.associate`` forbids it.
    """
    if options.associate == "never":
        check_identities(rows)
    return not rows.has_identity or options.associate == "always"


def tracks_of_rows(rows: Rows, options: ReadOptions, scene: GivenScene = None) -> TrackSet:
    """Return the tracks of a file's rows, which are associated where they have to be or it is asked for."""
    associates = has_detections(rows, options)
    if not associates and options.associate != "repair":
        return identified_tracks(rows, options)

    known = NO_SENSORS if options.sensor_scene is None else options.sensor_scene
    return associated(rows, scene, sensors=known, repair=not associates, missed_rows=options.missed_rows)


def read(
    path: str | Path | Sequence[str | Path] | pd.DataFrame | Mapping[str, Any],
    *,
    format: str | None = None,
    scene: GivenScene = None,
    **options: Unpack[Reading],
) -> TrackSet:
    """Read tracks from one file or several, in any known format, or from a table in memory.

    Parameters
    ----------
    path : one path, of a file, of a folder that `perception report` wrote or of a MOTChallenge sequence; or
        several, whose tracks are merged: ids that clash are renumbered, and tracks without a label get the
        name of their file. Or a DataFrame (pandas, polars), another Arrow table, or a mapping name → column
    format : name of the format; None: recognised by the content
    scene : known parameters of the scene, for rows without identities; the others are learned
    **options : the fields of `ReadOptions`, such as ``fps`` and ``homography``

    Returns
    -------
    TrackSet
        With a summary in which every row of the input is counted as used or refused.

    Raises
    ------
    InputError
        With path, line and column, the value found and the value expected.
    """
    to_tracks = partial(tracks_of_rows, scene=known_values(scene))
    return read_identified(path, format=format, to_tracks=to_tracks, **options)


def tracks_of(
    given: Given, scene: GivenScene = None, *, identified: bool = False, **reading: Unpack[FileReading]
) -> TrackSet:
    """Return tracks, a track, several of them, files or a table as a set of tracks.

    Raise InputError for anything else, and for a file or table that cannot be read.

    Parameters
    ----------
    scene : for rows without identities, as in `read`
    identified : raise an error for rows without identities, unless ``associate`` is set
    **reading : options of `read`, for paths and tables
    """
    associate: Associate = "never" if identified else "auto"
    return tracks_given(given, partial(read, scene=scene, associate=associate), **reading)


def from_supervision(
    detections: Iterable[Any] | Mapping[int, Any],
    *,
    fps: float,
    person: int | None = 0,
    **options: Unpack[Placing],
) -> TrackSet:
    """Tracks of the detections in the frames of a video, as ``supervision.Detections``.

    Ids (``tracker_id``, as after ``tracker.update`` of the package trackers) are kept as tracks; without ids
    the detections are associated. A person stands at the middle of the box's lower edge.

    Parameters
    ----------
    detections : one object for each frame, from 0 on, or frame → object
    fps : frames a second
    person : the class of people; None: all are people
    **options : fields of `ReadOptions`, such as ``homography``, ``calibration`` or ``metres_per_pixel``

    Raises
    ------
    InputError
        If an object has no such fields, some frames have ids and others none, or there is no person.
    """
    chosen = ReadOptions.named(fps=fps, **options)
    return tracks_of_rows(rows_of_supervision(detections, chosen, person), chosen)


def from_ultralytics(
    results: Iterable[Any] | Mapping[int, Any],
    *,
    fps: float,
    person: int | None = None,
    **options: Unpack[Placing],
) -> TrackSet:
    """Tracks of Ultralytics' ``Results`` of the frames of a video, as ``model.track`` gives them.

    As `from_supervision`; keypoints are for ``perception observe``.

    Parameters
    ----------
    results : one for each frame, from 0 on, or frame → one
    person : the class of people; None: the class named "person" in ``results.names``, or else 0
    fps, **options : as in `from_supervision`

    Raises
    ------
    InputError
        As `from_supervision`.
    """
    chosen = ReadOptions.named(fps=fps, **options)
    return tracks_of_rows(rows_of_ultralytics(results, chosen, person), chosen)
