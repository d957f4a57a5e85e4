"""Reading of files, tables and other libraries' detections whose rows may have no identities."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from graphtrack.io.detections import rows_of_supervision, rows_of_ultralytics
from graphtrack.io.given import tracks_of as identified_tracks_of
from graphtrack.io.options import Associate, ReadOptions
from graphtrack.io.reading import read as read_identified
from graphtrack.io.reading import tracks_of_rows as identified_tracks
from graphtrack.scene import GivenScene, known_values
from graphtrack.table.rows import Rows, check_identities
from graphtrack.tracks import TrackSet

if TYPE_CHECKING:
    import pandas as pd

    from graphtrack.io.given import Given


def has_detections(rows: Rows, options: ReadOptions) -> bool:
    """Return whether rows of a file have to be associated.

    Raises
    ------
    InputError
        If they have to, and ``options.associate`` forbids it.
    """
    if options.associate == "never":
        check_identities(rows)
    return not rows.has_identity or options.associate == "always"


def tracks_of_rows(rows: Rows, options: ReadOptions, scene: GivenScene = None) -> TrackSet:
    """Return the tracks of a file's rows, which are associated where they have to be or it is asked for."""
    associates = has_detections(rows, options)
    if not associates and options.associate != "repair":
        return identified_tracks(rows, options)
    from graphtrack.association.rows import associated  # which imports the solver's kernels

    return associated(rows, scene, repair=not associates)


def read(
    path: str | Path | Sequence[str | Path] | pd.DataFrame | Mapping[str, Any],
    *,
    format: str | None = None,
    scene: GivenScene = None,
    **options: Any,
) -> TrackSet:
    """Read tracks from one file or several, in any known format, or from a table in memory.

    Parameters
    ----------
    path : one path, of a file or of a folder that `perception report` wrote or that is a sequence of
        MOTChallenge, or several whose tracks are merged: ids that clash are renumbered, and tracks without a
        label get the name of their file. Or a DataFrame (pandas, polars), another table that speaks Arrow, or
        a mapping name → column
    format : name of the format; None: recognised by the content
    scene : parameters of the scene that are known, for rows without identities; the others are learned
    **options : the fields of `ReadOptions`, such as ``fps`` and ``homography``

    Returns
    -------
    TrackSet
        With a summary in which every row of the input is counted as used or refused.

    Raises
    ------
    InputError
        With path, line and column, what was found there and what was expected.
    """
    to_tracks = partial(tracks_of_rows, scene=known_values(scene))
    return read_identified(path, format=format, to_tracks=to_tracks, **options)


def tracks_of(
    given: Given, associate: Associate = "auto", scene: GivenScene = None, **reading: Any
) -> TrackSet:
    """Return tracks, a track, several of them, files or a table as a set of tracks.

    Parameters
    ----------
    associate, scene : for rows without identities, as in `read`
    **reading : other options of `read`, for paths and tables

    Raises
    ------
    InputError
        For anything else, and for a file or table that cannot be read.
    """
    return identified_tracks_of(given, partial(read, associate=associate, scene=scene), **reading)


def from_supervision(
    detections: Iterable[Any] | Mapping[int, Any], *, fps: float, person: int | None = 0, **options: Any
) -> TrackSet:
    """Tracks of what detectors and trackers found in the frames of a video, as ``supervision.Detections``.

    Where there are ids (``tracker_id``, as after ``tracker.update`` of the package trackers), they are the
    tracks; else detections are associated. A person stands at the middle of the box's lower edge.

    Parameters
    ----------
    detections : one for each frame, from 0 on, or frame → one
    fps : frames a second
    person : the class of people; None: all are people
    **options : fields of `ReadOptions`, such as ``homography``, ``calibration`` or ``metres_per_pixel``

    Raises
    ------
    InputError
        If one is no such object, some frames have ids and others none, or nobody was found.
    """
    chosen = ReadOptions(fps=fps, **options)
    return tracks_of_rows(rows_of_supervision(detections, chosen, person), chosen)


def from_ultralytics(
    results: Iterable[Any] | Mapping[int, Any], *, fps: float, person: int | None = None, **options: Any
) -> TrackSet:
    """Tracks of Ultralytics' ``Results`` of the frames of a video, as ``model.track`` gives them.

    As `from_supervision`; keypoints are for ``perception observe``.

    Parameters
    ----------
    results : one for each frame, from 0 on, or frame → one
    person : the class of people; None: the one that ``results.names`` calls "person", or else 0
    fps, **options : as there

    Raises
    ------
    InputError
        As there.
    """
    chosen = ReadOptions(fps=fps, **options)
    return tracks_of_rows(rows_of_ultralytics(results, chosen, person), chosen)
