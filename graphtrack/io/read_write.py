"""`read_identified` and `write`: any format, one file or several, a table or tracks."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence, Set
from dataclasses import replace
from functools import partial
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias, TypeGuard, Unpack

import numpy as np
from numpy.typing import NDArray

from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray
from graphtrack.geometry.camera import GroundCamera
from graphtrack.geometry.conventions import BEARINGS, AngleConvention
from graphtrack.io.atomic import atomic_path, check_read_once, read_errors
from graphtrack.io.cameras import place_pixels, placed_boxes, read_homography, with_scores
from graphtrack.io.column_names import names_of, names_tracks, unit_notes, with_synonyms
from graphtrack.io.format import Format, companion_files, is_recording, label_files, recognised
from graphtrack.io.formats.native import CSV
from graphtrack.io.libraries import checked_boxes, of_classes
from graphtrack.io.options import FileReading, Reading, ReadOptions
from graphtrack.io.poses import placed_by_poses
from graphtrack.io.registry import (
    all_formats,
    detect,
    format_for_writing,
    format_named,
    hint_for,
)
from graphtrack.io.sensors import absent_note, names_in, with_known_sensors
from graphtrack.io.source import Source, place_of, sequence_file, table_in
from graphtrack.io.text import in_utf8
from graphtrack.tracks.cells import Cells, Layout, cells_of_frame, rows_of_cells
from graphtrack.tracks.display import counted, listed
from graphtrack.tracks.table import (
    ANGLES,
    DEGREES,
    IN_DEGREES,
    Rows,
    check_identities,
    check_rows,
    merged,
)
from graphtrack.tracks.track import Track, TrackSet, columns_as_read
from graphtrack.tracks.validation import LARGEST_ID

if TYPE_CHECKING:
    import pandas as pd

    Scene: TypeAlias = (
        TrackSet | Sequence[Track] | str | Path | Sequence[str | Path] | pd.DataFrame | Mapping[str, Any]
    )
    Given: TypeAlias = Track | Scene


def merged_tracks(sets: Sequence[TrackSet], paths: Sequence[Path]) -> TrackSet:
    """Join the tracks of several files under unique ids; tracks without a label get one."""
    tracks: list[Track] = []
    taken: set[int] = set()
    numbered: list[dict[int, int]] = []
    renumbered = 0
    _check_kinds(sets, paths)
    for tracks_of_file, path in zip(sets, paths, strict=True):
        # Ids of the file are reserved, so that a new id never collides with a later one.
        numbered.append({})
        free = _free_ids(taken | {track.track_id for track in tracks_of_file}, len(tracks_of_file))
        for track in tracks_of_file:
            identity = track.track_id
            if identity in taken:
                identity = next(free)
                renumbered += 1
            taken.add(identity)
            numbered[-1][track.track_id] = identity
            tracks.append(replace(track, track_id=identity, label=track.label or _stem(path)))
    summary = sets[0].summary
    for other in sets[1:]:
        summary = summary.merged(other.summary)
    notes = list(summary.notes)
    if renumbered:
        notes.append(f"{renumbered} tracks renumbered because files use the same ids")
    as_read = merged([(one.as_read, ids) for one, ids in zip(sets, numbered, strict=True)])
    camera = sets[0].camera
    if any(other.camera != camera for other in sets[1:]):
        camera = None
        notes.append("the files have different cameras, so none is kept")
    return TrackSet(tuple(tracks), camera, replace(summary, notes=tuple(notes)), as_read)


def _check_kinds(sets: Sequence[TrackSet], paths: Sequence[Path]) -> None:
    """Refuse a mixture of files with numbers and files with text as identities."""
    kinds = [bool(one.as_read.names) for one in sets if one.as_read is not None]
    if len(kinds) == len(sets) and len({*kinds}) > 1:
        number, text = paths[kinds.index(False)], paths[kinds.index(True)]
        found = f"identities that are numbers in {number} and text in {text}"
        raise InputError(found, "one kind in all files", path=text)


def _free_ids(used: Set[int], most: int) -> Iterator[int]:
    """Return unused ids: those after the highest or, where too few are left, from 0 on."""
    first = max(used) + 1
    return (k for k in count(first if first + most <= LARGEST_ID else 0) if k not in used)


def _stem(path: Path) -> str:
    # A file name need not be UTF-8, but a written label must.
    name = path.name.encode(errors="surrogateescape").decode(errors="replace")
    return name.split(".")[0] or name


BAG = "bag"
"""The format of recordings, which are streamed."""

ToTracks = Callable[[Rows, ReadOptions], TrackSet]
"""Function that converts the rows of one file to tracks."""


def identified_tracks(rows: Rows, options: ReadOptions) -> TrackSet:
    """Return the tracks of a file's rows, which have identities."""
    return TrackSet.from_identified_rows(rows)


def read_identified(
    path: str | Path | Sequence[str | Path] | pd.DataFrame | Mapping[str, Any],
    *,
    format: str | None = None,
    to_tracks: ToTracks = identified_tracks,
    **options: Unpack[Reading],
) -> TrackSet:
    """Read tracks whose rows have identities; `graphtrack.read` also associates rows that have none.

    Parameters
    ----------
    path, format, **options : as in `graphtrack.read`
    to_tracks : (rows of a file, options) → tracks
    """
    read_options = ReadOptions.named(**options)
    if is_table(path):
        if format is not None:
            raise InputError(f"format {format!r} of a table", "a file, or no format")
        return to_tracks(rows_of_frame(path, read_options), read_options)
    paths = [path] if isinstance(path, str | Path) else path
    if not are_paths(paths):
        raise InputError(f"a {type(path).__name__}", "a path, several paths, or a table")
    return read_with(list(paths), format, read_options, to_tracks)


def are_paths(given: object) -> TypeGuard[Sequence[str | Path]]:
    """Return whether a value is a list or tuple of paths."""
    return isinstance(given, list | tuple) and all(isinstance(one, str | Path) for one in given)


def is_table(given: object) -> TypeGuard[pd.DataFrame | Mapping[str, Any]]:
    """Return whether a value is a table in memory: a DataFrame, an Arrow table, or name → column."""
    return isinstance(given, Mapping) or hasattr(given, "columns") or hasattr(given, "__arrow_c_stream__")


def rows_of_frame(table: Any, options: ReadOptions) -> Rows:
    """Return the rows of a table in memory; see `read_identified`."""
    rows = with_known_sensors(rows_of_table(cells_of_frame(table), options), options.sensor_scene)
    rows = placed_by_poses(rows, options)
    notes = (*_unused_camera(rows, options), *absent_note(options.sensor_scene, names_in(rows)))
    return rows.with_notes(*notes)


NO_PIXELS = "not used: the input has no pixels"
"""End of the note on a camera that reading does not use."""


def _unused_camera(rows: Rows, options: ReadOptions) -> tuple[str, ...]:
    """Return a note on options of a camera, where the input has no pixels."""
    names = ("camera", "homography", "point_pairs", "calibration", "metres_per_pixel")
    given = [name.replace("_", "-") for name in names if getattr(options, name) is not None]
    if not given or rows.camera is not None:
        return ()
    return (f"--{', --'.join(given)} {NO_PIXELS}",)


def rows_of_table(cells: Cells, options: ReadOptions, *, strict: bool = False) -> Rows:
    """Return the rows of a table's cells, in metres and with times; ``strict``: see `rows_of_cells`."""
    rows = _unplaced_rows(cells, options, strict=strict)
    if "box" in rows.channels:
        rows = with_scores(placed_boxes(rows, options)).without("box", "confidence")
    elif "pixel" in rows.channels:
        rows = place_pixels(rows, options)
    return rows.with_headings()


def _unplaced_rows(cells: Cells, options: ReadOptions, *, strict: bool) -> Rows:
    """Return the rows of a table's cells, those with pixels or boxes without positions."""
    found, notes = with_synonyms(list(cells.columns), options, cells.path)
    layout = found.layout()
    if layout is not None and options.columns is None:
        layout = replace(layout, exclusive=False)  # the names are well-known ones
    cells = of_classes(cells, layout, options)
    meaning = layout or Layout()
    convention, note_on_angles = _convention(cells, meaning, found)
    try:
        rows = rows_of_cells(
            cells,
            replace(meaning, angles=convention),
            fps=found.fps,
            reference=found.reference,
            strict=strict and layout is None,
        )
    except InputError as error:
        native = strict and options.layout() is None
        raise error.at(hint=hint_for(error, native=native)) from error
    if found is not options:
        notes += unit_notes(found, rows.channels["t"])
    return checked_boxes(rows.with_notes(*notes, *note_on_angles), options)


def _convention(
    cells: Cells, layout: Layout, options: ReadOptions
) -> tuple[AngleConvention | None, tuple[str, ...]]:
    """Return the convention of a table's angles and a note on one that was assumed; None: the native one."""
    given = options.angle_convention
    names = {*layout.columns, *(name for name in cells.columns if name not in layout.columns.values())}
    if given is not None or not names & {*IN_DEGREES, *ANGLES}:
        return given, ()
    if DEGREES[0] in layout.columns:
        return BEARINGS, (
            "angles in a table with lat and lon are taken as compass bearings: "
            "--angles 'counter-clockwise from east' for others",
        )
    if layout.crs is not None:
        return None, ("angles were taken counter-clockwise from east: --angles compass for bearings",)
    return None, ()


def read_with(
    paths: Sequence[str | Path],
    format: str | None,
    options: ReadOptions,
    to_tracks: ToTracks = identified_tracks,
) -> TrackSet:
    """Implement `read_identified` for consistent options."""
    if not paths:
        raise InputError("no paths", "at least one")
    sets: list[TrackSet] = []
    sensors: set[str] = set()
    check_read_once([place_of(one) for one in paths])
    for one in paths:
        rows = _corrected_rows(one, format, options)
        sensors |= names_in(rows)
        if len(sets) == len(paths) - 1:
            rows = rows.with_notes(*absent_note(options.sensor_scene, sensors))
        sets.append(to_tracks(rows, options))
        options = replace(options, reference=options.reference or sets[0].as_read)
    if len(sets) == 1:
        return sets[0]
    return merged_tracks(sets, [place_of(one) for one in paths])


def write_table(columns: Mapping[str, NDArray[Any]], path: str | Path) -> None:
    """Write columns of the native table, such as detections without identities, atomically."""
    path = Path(path)
    write = check_table_name(path)
    with atomic_path(path) as temporary:
        write(columns, temporary)


def check_table_name(path: Path) -> Callable[[Mapping[str, NDArray[Any]], Path], None]:
    """Return the function that writes columns to a file of that name."""
    write = format_for_writing(path).write_columns
    if write is None:
        names = ", ".join(s for one in all_formats() if one.write_columns is not None for s in one.suffixes)
        found = f"a table without tracks, such as detections without identities, for {path.name}"
        raise InputError(found, f"a name that ends with one of {names}", path=path)
    return write


def read_boxes(path: str | Path, format: str | None = None, options: ReadOptions = ReadOptions()) -> Rows:
    """Read the boxes of a file, in its order, if its format holds any.

    Returns
    -------
    Rows
        With the channel ``box`` (n, 4), left, top, width and height in the file's pixels, NaN where a row has
        none.
    """
    rows = boxes_of_file(path, format, options)
    if rows is None:
        chosen = _chosen(_opened(path, options), format)
        names = ", ".join(one.name for one in all_formats() if one.read_boxes is not None)
        found = f"the format {chosen.name}, which has no boxes"
        raise InputError(found, f"a format with boxes: {names}", path=path)
    check_identities(rows)
    check_rows(rows)
    return rows


def boxes_of_file(path: str | Path, format: str | None, options: ReadOptions) -> Rows | None:
    """Return the rows of `read_boxes`, with identities or without; None if the format holds no boxes."""
    source = _opened(path, options)
    chosen = _chosen(source, format, options)
    if options.angle_convention is not None:
        raise InputError("angles with boxes", "boxes as their format has them", path=path)
    if chosen.cells is not None:  # times are of no account
        timed = replace(options, fps=options.fps or 1.0)
        rows = _unplaced_rows(_cells(source, chosen, timed), timed, strict=True)
        return rows if "box" in rows.channels else None
    return None if chosen.read_boxes is None else chosen.read_boxes(source, options)


def _opened(path: str | Path, options: ReadOptions) -> Source:
    """Return the source with text as UTF-8, commas and decimal points, by the options; for a bag its path."""
    place = table_in(place_of(path))
    if is_recording(place):
        return Source(place, b"", options.limit(place))
    if place.is_dir() and label_files(place):
        return Source(place, b"", options.limit(place))
    if place.is_dir():
        expected = (
            "a file, a ROS 2 bag, a folder of YOLO's labels (one text a frame, its number at the end of "
        )
        expected += "the name), or a sequence of MOTChallenge (with gt/gt.txt or det/det.txt)"
        raise InputError("a directory", expected, path=path)
    of_rows = options.fixed_frame is not None and options.poses is None
    if options.topic is not None or of_rows:
        found = "--topic or --fixed-frame with a file that is no ROS 2 recording"
        raise InputError(found, "a bag or MCAP file", path=path)
    with read_errors(place):
        source = Source.open(place, options.limit(place))
        return in_utf8(source, options.delimiter, options.decimal, options.encoding)


def rows_of_file(path: str | Path, format: str | None, options: ReadOptions) -> Rows:
    """Return the rows of a file, or of a folder that stands for one, in metres, the world and with times."""
    rows = _corrected_rows(path, format, options)
    return rows.with_notes(*absent_note(options.sensor_scene, names_in(rows)))


def _corrected_rows(path: str | Path, format: str | None, options: ReadOptions) -> Rows:
    """Return the rows of a file in the world, without the known errors of their sensors."""
    rows = with_known_sensors(_rows_of_file(path, format, options), options.sensor_scene)
    rows = placed_by_poses(rows, options)
    rows = rows.with_notes(*_unused_camera(rows, options))
    file = sequence_file(place_of(path))
    return rows if file is None else rows.with_notes(f"read {file.relative_to(path)} of the sequence")


def _rows_of_file(path: str | Path, format: str | None, options: ReadOptions) -> Rows:
    source = _opened(path, options)
    chosen = _chosen(source, format, options)
    if not source.data and chosen.name != (kind := recognised(b"", source.path)):
        raise InputError(f"format {chosen.name!r} of a folder or recording", str(kind), path=path)
    with read_errors(source.path):
        if chosen.cells is not None:
            assumed = chosen.default_fps if options.fps is None else None
            timed = options if assumed is None else replace(options, fps=assumed)
            rows = rows_of_table(_cells(source, chosen, timed), timed, strict=True)
            note = () if assumed is None else (f"no frame rate is given: {assumed:g} Hz assumed",)
            return rows.with_notes(*note)
        _check_taken(chosen, options, source.path)
        if chosen.read is None:
            expected = "a table, such as GeoParquet; geopandas.read_file makes one of a GeoPackage"
            raise source.fail("a format that is only written", expected)
        return chosen.read(source, options)


def _chosen(source: Source, format: str | None, options: ReadOptions = ReadOptions()) -> Format:
    """Return the format by name or content; with columns or units declared, or well-known names, a table."""
    if format is not None:
        return format_named(format)
    known = recognised(source.head, source.path)
    header = known in _OF_NUMBERS and "x" not in names_of(source) and names_tracks(source, options)
    if not source.data or (options.layout() is None and known is not None and not header):
        return detect(source)
    found = None if known is None else format_named(known)
    if options.layout() is not None:
        is_table = found is not None and (found.cells is not None or found.takes)
        return found if found is not None and is_table else CSV
    return CSV if names_tracks(source, options) else detect(source)


_OF_NUMBERS = ("mot", "towncentre", "eth")
"""Formats without a header: a table with one, of as many columns, has names."""


def _check_taken(chosen: Format, options: ReadOptions, path: Path) -> None:
    """Refuse options of tables that a format does not know."""
    for name in ("columns", "time_unit", "units", "crs", "angles", "angle_zero", "angle_sense"):
        if getattr(options, name) is not None and name not in chosen.takes:
            known = " or ".join(f"--{one}" for one in chosen.takes) or "a table: csv, parquet or ndjson"
            raise InputError(f"--{name.replace('_', '-')} for the format {chosen.name}", known, path=path)


def cells_of_file(path: str | Path, options: ReadOptions) -> Cells:
    """Return the raw cells of a file that is a table."""
    source = _opened(path, options)
    chosen = _chosen(source, None, options)
    return _cells(source, CSV if chosen.cells is None else chosen, options)


def _cells(source: Source, chosen: Format, options: ReadOptions) -> Cells:
    assert chosen.cells is not None
    cells, layout = chosen.cells(source, options), options.layout()
    if layout is not None and layout.by_number and not (cells.numbered or layout.of_names(cells.columns)):
        raise source.fail("numbers for columns", "their names")
    return cells


def write(
    tracks: TrackSet | Track,
    path: str | Path,
    *,
    format: str | None = None,
    homography: FloatArray | str | Path | None = None,
    spreadsheet: bool = False,
    intervals: float | None = None,
) -> None:
    """Write tracks atomically: on any failure nothing is left behind.

    Parameters
    ----------
    tracks : a set, or a single track
    format : name of the format; None: by the file name's suffix
    homography : (3, 3) image → ground, or the path of its nine numbers, for formats with boxes; it replaces
        the camera of the tracks
    spreadsheet : put an apostrophe before text, such as labels, that a spreadsheet would run as a formula
        (it begins with =, +, -, @, a tab or a carriage return); for CSV
    intervals : probability of the intervals of speed, heading, body and head that are written too, for
        tables; see `TrackSet.to_table`

    Raises
    ------
    InputError
        If the format cannot be written, the tracks lack data that it needs, or the path cannot be written to.
    """
    if not isinstance(path, str | Path):
        raise InputError(f"a {type(path).__name__} to write to", "the path of a file")
    path, tracks = Path(path), TrackSet((tracks,)) if isinstance(tracks, Track) else tracks
    if not isinstance(tracks, TrackSet):
        expected = "a TrackSet or a Track; gt.read makes one of a table"
        raise InputError(f"a {type(tracks).__name__} to write", expected, path=path)
    chosen = format_for_writing(path) if format is None else format_named(format)
    if chosen.write is None:
        names = ", ".join(one.name for one in all_formats() if one.write is not None)
        raise InputError(f"format {chosen.name!r}", f"a format that can be written: {names}")
    if homography is not None:
        matrix = read_homography(homography) if isinstance(homography, str | Path) else homography
        tracks = replace(tracks, camera=GroundCamera.from_homography(matrix))
    if spreadsheet:
        if chosen is not CSV:
            raise InputError(f"--spreadsheet for the format {chosen.name}", "csv", path=path)
        tracks = _without_formulas(tracks)
    writer = partial(chosen.write, tracks)
    if intervals is not None:
        if chosen.write_columns is None:
            raise InputError(f"intervals for the format {chosen.name}", "csv, parquet or ndjson", path=path)
        if all(track.covariance is None for track in tracks):
            raise InputError("intervals of tracks without uncertainties", "estimates, as smooth writes them")
        columns = columns_as_read(tracks, intervals)
        writer = partial(chosen.write_columns, columns)
    with atomic_path(path) as temporary:
        writer(temporary)


_FORMULAS = ("=", "+", "-", "@", "\t", "\r")


def _without_formulas(tracks: TrackSet) -> TrackSet:
    """Return tracks whose labels, text identities and names of columns are no formulas of a spreadsheet."""

    def text(given: str) -> str:
        return f"'{given}" if given.startswith(_FORMULAS) else given

    as_read = tracks.as_read
    if as_read is not None:
        columns = {key: text(name) for key, name in as_read.columns.items()}
        names = {key: text(name) for key, name in as_read.names.items()}
        as_read = replace(as_read, columns=columns, names=names)
    labelled = tracks.map(lambda track: replace(track, label=text(track.label)))
    return replace(labelled, as_read=as_read)


def tracks_given(
    given: Given, read: Callable[..., TrackSet] = read_identified, **reading: Unpack[FileReading]
) -> TrackSet:
    """Convert tracks, a track, a list of tracks, one or several paths, or a table to a set of tracks.

    Parameters
    ----------
    read : function that reads files, and tables with options
    **reading : its options
    """
    if isinstance(given, str | Path) or (are_paths(given) and given):
        return read(given, **reading)
    if is_table(given):
        return read(given, **reading) if reading else TrackSet.from_table(given)
    if reading:
        found = f"{', '.join(reading)} with a {type(given).__name__}"
        raise InputError(found, "options of reading with a path or a table")
    if isinstance(given, TrackSet):
        return given
    if isinstance(given, Track):
        return TrackSet((given,))
    if isinstance(given, list | tuple) and given and all(isinstance(one, Track) for one in given):
        return TrackSet(tuple(given))
    shape = _shape(given)
    found = f"a {type(given).__name__}" + (f" of shape {shape}" if shape else "")
    raise InputError(found, f"a TrackSet, a Track, a table or the path of a file{_hint(shape)}")


def _hint(shape: tuple[int, ...]) -> str:
    """Return advice to make a track of an array of positions."""
    if len(shape) != 2 or shape[1] != 2:
        return ""
    n = shape[0]
    return (
        "; positions have no times of their own: "
        f"Track(0, frame=np.arange({n}), t=np.arange({n}) / fps, position=positions)"
    )


def _shape(given: Any) -> tuple[int, ...]:
    try:
        return np.shape(given)
    except ValueError:  # rows of different lengths
        return ()


def paired_files(estimates: Sequence[Path], truth: Sequence[Path]) -> dict[str, tuple[Path, Path]]:
    """Pair files by the name of their sequence, the file name without suffix.

    One file on either side is a pair, regardless of its name. A folder stands for its files, except hidden
    files and companion files such as a calibration; a folder that is a MOTChallenge sequence, or that
    contains such sequences, counts each sequence as one file.

    Raises
    ------
    InputError
        If a folder has no files, two files on one side have the same name, or one has no partner.
    """
    first, second = _files(estimates), _files(truth)
    if len(first) == len(second) == 1:
        return {_name(first[0]): (first[0], second[0])}
    named, true = _by_name(first), _by_name(second)
    for mine, reference, what in ((named, true, "the truth"), (true, named, "estimates")):
        alone = [path for name, path in mine.items() if name not in reference]
        if alone:
            count = f"{counted(len(first), 'file')} of estimates and {len(second)} of the truth"
            raise InputError(
                f"{count}, and nothing to go with {listed(path.name for path in alone)}",
                f"{what} of each in a file of the same name",
            )
    return {name: (path, true[name]) for name, path in named.items()}


def _files(paths: Sequence[Path]) -> list[Path]:
    return [file for path in paths for file in (_files_in(path) if table_in(path).is_dir() else [path])]


def _files_in(folder: Path) -> list[Path]:
    files = sorted(path for path in folder.iterdir() if path.is_file() and not path.name.startswith("."))
    files += sorted(path for path in folder.iterdir() if sequence_file(path) is not None)
    reference = {place for path in files for place in companion_files(path)}
    found = [path for path in files if path not in reference]
    if not found:
        raise InputError("a folder without files", "files with tracks", path=folder)
    return found


def _by_name(paths: Sequence[Path]) -> dict[str, Path]:
    found: dict[str, Path] = {}
    for path in paths:
        other = found.setdefault(_name(path), path)
        if other is not path:
            raise InputError(f"{other} and {path}", "a name for each sequence")
    return found


def _name(path: Path) -> str:
    return Path(path.name.removesuffix(".gz")).stem
