"""`read` and `write`: any format, one call."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence, Set
from dataclasses import replace
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from graphtrack.bounds import LARGEST_ID
from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray
from graphtrack.geometry.camera import GroundCamera
from graphtrack.io.atomic import atomic_path
from graphtrack.io.cameras import read_homography
from graphtrack.io.options import ReadOptions
from graphtrack.io.registry import Format, detect, format_for_writing, format_named, formats
from graphtrack.io.source import Source
from graphtrack.table.columns import to_columns
from graphtrack.table.rows import Rows, check_identities, check_rows
from graphtrack.table.speeds import with_speeds_checked
from graphtrack.tracks import Track, TrackSet

_STAGES, _REPORTED = "stages.json", "tracks.csv"
"""What the folder of a report is known by, and its table of estimates."""


def read(path: str | Path | Sequence[str | Path], *, format: str | None = None, **options: Any) -> TrackSet:
    """Read tracks from one file or several, in any known format.

    Parameters
    ----------
    path : one path, of a file or of a folder that `perception report` wrote, or several whose tracks are
        merged: ids that clash are renumbered, and tracks without a label get the name of their file
    format : name of the format; None: recognised by the content
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
    try:
        read_options = ReadOptions(**options)
    except TypeError as error:
        known = ", ".join(ReadOptions.__dataclass_fields__)
        raise InputError(f"options {', '.join(options)}", f"some of {known}") from error
    return read_with([path] if isinstance(path, str | Path) else list(path), format, read_options)


def read_with(paths: Sequence[str | Path], format: str | None, options: ReadOptions) -> TrackSet:
    """`read`, where the options stand together."""
    if not paths:
        raise InputError("no paths", "at least one")
    sets = [_read_one(one, format, options) for one in paths]
    if len(sets) == 1:
        return sets[0]
    return _merged(sets, [Path(one) for one in paths])


def _read_one(path: str | Path, format: str | None, options: ReadOptions) -> TrackSet:
    path = _table_of(Path(path))
    return tracks_of_rows(rows_of_file(path, format, options), options)


def _table_of(path: Path) -> Path:
    """The estimates in a folder that `perception report` wrote; other paths stay as they are."""
    return path / _REPORTED if (path / _STAGES).is_file() else path


def has_detections(rows: Rows, options: ReadOptions) -> bool:
    """Whether it has to be found out whose the rows of a file are.

    Raises
    ------
    InputError
        If it has to, and is not allowed.
    """
    if options.associate == "never":
        check_identities(rows)
    return not rows.has_identity or options.associate == "always"


def tracks_of_rows(rows: Rows, options: ReadOptions) -> TrackSet:
    """The tracks of a file's rows, whose identities are found out where that is asked for."""
    associates = has_detections(rows, options)
    if not associates and options.associate != "repair":
        return with_speeds_checked(TrackSet.from_rows(rows), rows.path)
    from graphtrack.association.rows import associated

    return associated(rows, options.scene, repair=not associates)


def write_table(columns: Mapping[str, NDArray[Any]], path: str | Path) -> None:
    """Write columns of the native table, such as detections without identities; whole, or not at all.

    Raises
    ------
    InputError
        If the file's name has not the ending of a table, or the place cannot be written to.
    """
    path = Path(path)
    write = check_table_name(path)
    with atomic_path(path) as temporary:
        write(columns, temporary)


def check_table_name(path: Path) -> Callable[[Mapping[str, NDArray[Any]], Path], None]:
    """What writes columns to a file of that name.

    Raises
    ------
    InputError
        If its ending is none of a table.
    """
    write = format_for_writing(path).write_columns
    if write is None:
        names = ", ".join(s for one in formats() if one.write_columns is not None for s in one.suffixes)
        found = f"detections without identities for {path.name}"
        raise InputError(found, f"a name that ends with one of {names}", path=path)
    return write


def read_boxes(path: str | Path, format: str | None = None, options: ReadOptions = ReadOptions()) -> Rows:
    """Read the boxes of a file, in its order, where its format holds any.

    Returns
    -------
    Rows
        With the channel ``box`` (n, 4), left, top, width and height in the file's pixels, NaN where a row has
        none.

    Raises
    ------
    InputError
        With path, line and column, what was found there and what was expected.
    """
    rows = boxes_of_file(path, format, options)
    if rows is None:
        chosen = _chosen(Source.open(path), format)
        names = ", ".join(one.name for one in formats() if one.read_boxes is not None)
        found = f"the format {chosen.name}, of which no boxes are read"
        raise InputError(found, f"a format with boxes: {names}", path=path)
    check_identities(rows)
    check_rows(rows)
    return rows


def boxes_of_file(path: str | Path, format: str | None, options: ReadOptions) -> Rows | None:
    """The rows of `read_boxes`, with identities or without; None if the format holds no boxes."""
    source = Source.open(path)
    chosen = _chosen(source, format)
    return None if chosen.read_boxes is None else chosen.read_boxes(source, options)


def _chosen(source: Source, format: str | None) -> Format:
    return detect(source) if format is None else format_named(format)


def rows_of_file(path: str | Path, format: str | None, options: ReadOptions) -> Rows:
    """The rows of a file, as its reader makes them, in metres and with times."""
    source = Source.open(path)
    return _chosen(source, format).read(source, options)


def _merged(sets: Sequence[TrackSet], paths: Sequence[Path]) -> TrackSet:
    tracks: list[Track] = []
    taken: set[int] = set()
    renumbered = 0
    for tracks_of_file, path in zip(sets, paths, strict=True):
        # The file's own ids stay with it, so that a new one never takes the place of one to come.
        free = _free_ids(taken | {track.track_id for track in tracks_of_file}, len(tracks_of_file))
        for track in tracks_of_file:
            identity = track.track_id
            if identity in taken:
                identity = next(free)
                renumbered += 1
            taken.add(identity)
            tracks.append(replace(track, track_id=identity, label=track.label or _stem(path)))
    summary = sets[0].summary
    for other in sets[1:]:
        summary = summary.merged(other.summary)
    notes = list(summary.notes)
    if renumbered:
        notes.append(f"{renumbered} tracks renumbered because files use the same ids")
    camera = sets[0].camera
    if any(other.camera != camera for other in sets[1:]):
        camera = None
        notes.append("the files have different cameras, so none is kept")
    return TrackSet(tuple(tracks), camera, replace(summary, notes=tuple(notes)))


def _free_ids(used: Set[int], most: int) -> Iterator[int]:
    """Ids that are not used: those after the highest, or where they would end too soon, from 0 on."""
    first = max(used) + 1
    return (k for k in count(first if first + most <= LARGEST_ID else 0) if k not in used)


def _stem(path: Path) -> str:
    # A name need not be UTF-8, but what is written of it must.
    name = path.name.encode(errors="surrogateescape").decode(errors="replace")
    return name.split(".")[0] or name


def write(
    tracks: TrackSet | Track,
    path: str | Path,
    *,
    format: str | None = None,
    homography: FloatArray | str | Path | None = None,
) -> None:
    """Write tracks; the file is there whole or, on any failure, not at all.

    Parameters
    ----------
    tracks : to be written; a track stands for a set of one
    format : name of the format; None: by the ending of the file name
    homography : (3, 3) image → ground, or the path of its nine numbers, for formats with boxes; it replaces
        the camera of the tracks

    Raises
    ------
    InputError
        If the format cannot be written, the tracks lack what it needs, or the place cannot be written to.
    """
    path, tracks = Path(path), TrackSet((tracks,)) if isinstance(tracks, Track) else tracks
    chosen = format_for_writing(path) if format is None else format_named(format)
    if chosen.write is None:
        names = ", ".join(one.name for one in formats() if one.write is not None)
        raise InputError(f"format {chosen.name!r}", f"a format that can be written: {names}")
    if homography is not None:
        matrix = read_homography(homography) if isinstance(homography, str | Path) else homography
        tracks = replace(tracks, camera=GroundCamera.from_homography(matrix))
    with atomic_path(path) as temporary:
        chosen.write(tracks, temporary)


def write_detections(tracks: TrackSet, path: str | Path) -> None:
    """Write tracks as detections of nobody in particular: rows in the order of their frames, with the id −1.

    Raises
    ------
    InputError
        If the place cannot be written to, or its ending is of another format than the native table.
    """
    columns = to_columns(tracks)
    order = np.argsort(columns["frame"], kind="stable")
    columns = {name: values[order] for name, values in columns.items() if name != "label"}
    write_table(columns | {"track_id": np.full(len(order), -1)}, path)
