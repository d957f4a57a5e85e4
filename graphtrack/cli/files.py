"""Commands `graphtrack info`, `graphtrack formats` and `graphtrack convert`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from graphtrack.cli import options
from graphtrack.cli.console import (
    command_line,
    console,
    emit,
    option_name,
    print_table,
    quiet_input_warnings,
    write_json,
    write_tracks,
)
from graphtrack.errors import InputError
from graphtrack.tracks.display import counted
from graphtrack.tracks.validation import finite_rows

if TYPE_CHECKING:
    from graphtrack.io.suggestion import Suggestion
    from graphtrack.tracks.track import Track, TrackSet


def info(
    inputs: options.Inputs,
    reading: options.SceneReading,
    model: str | None = None,
    json_path: options.Json = None,
    suggest: bool = False,
    constants: bool = False,
) -> None:
    """Summarise a file: tracks, rates, gaps, channels, speeds, refused rows.

    Parameters
    ----------
    model : Model file (.toml) with the [scene] of people without identities.
    suggest : Print a command line that reads the file, derived from its columns.
    constants : Learn and show the constants of each person, and the noise where none is declared.
    """
    if suggest:
        options.refuse({"--constants": constants}, "with --suggest", "--suggest alone")
        _suggest(inputs, reading, json_path)
        return
    options.check_outputs({"--json": json_path}, reading.inputs(inputs, model))
    scene = None
    if model is not None:
        from graphtrack.model import Model  # a model loads SciPy

        scene = Model.named(model).scene
    tracks = reading.tracks(inputs, scene=scene)
    most = len(tracks) if json_path is not None else _MOST_SHOWN
    rows = [describe(track) for track in islice(tracks, most)]
    if constants:
        _add_constants(rows, tracks)
    optional = [name for name in ("label", "truth") if not any(row[name] for row in rows)]
    units = {"rate_hz": "Hz", "speed_m_s": "m/s"}
    headings = {name: units.get(name, name) for name in rows[0] if name not in optional} if rows else {}
    shown = [{heading: _shown(row[name]) for name, heading in headings.items()} for row in rows[:_MOST_SHOWN]]
    print_table(f"{counted(len(tracks), 'track')}, {tracks.n_frames} person-frames", shown)
    if len(tracks) > _MOST_SHOWN:
        emit(f"  note: only the first {_MOST_SHOWN:,} tracks are shown; --json writes all")
    write_json(json_path, rows)


def _add_constants(rows: Sequence[dict[str, Any]], tracks: TrackSet) -> None:
    """Learn the constants of each person, write them into the rows of tracks, and print the learned noise."""
    from graphtrack.smoothing import learn_constants

    with console.status("learning"):
        _, people = learn_constants(tracks)
    for line in next((one.noise_lines() for one in people.values()), ()):
        emit(f"  {line}")
    for row, track in zip(rows, tracks, strict=False):
        own = people.get(track.track_id)
        row["constants"] = "" if own is None else own.described()


_KEPT = (
    *options.CAMERA,
    *("image_size", "fps", "classes", "delimiter", "decimal", "encoding", "units", "time_unit", "crs"),
)
"""Options that --suggest takes, and keeps in the line that it prints."""


def _suggest(inputs: list[Path], reading: options.SceneReading, json_path: Path | None) -> None:
    """Print the command line that reads a file; assumptions are printed as notes."""
    from graphtrack.io.suggestion import suggest

    given = reading.given()
    unknown = [option_name(name) for name in given if name not in _KEPT]
    if len(inputs) != 1 or unknown or json_path is not None:
        found_ = f"--suggest with {', '.join(unknown) or 'other outputs or several files'}"
        known = ", ".join(map(option_name, _KEPT))
        raise InputError(found_, f"one file, and no options but {known}")
    found = _with_angles(suggest(inputs[0], given), inputs[0])
    for remark in found.remarks:
        emit(f"  note: {remark}")
    print(command_line(["graphtrack", "info", str(inputs[0])], found.options))


def _with_angles(found: Suggestion, path: Path) -> Suggestion:
    """Return a suggestion with the convention that the angles of people in motion fit."""
    from graphtrack.constants.directions import proposed_convention
    from graphtrack.io.read_write import rows_of_file
    from graphtrack.tracks.track import TrackSet

    with quiet_input_warnings():
        rows = rows_of_file(path, None, found.read_options)
        tracks = TrackSet.from_rows(rows) if rows.has_identity else TrackSet(())
    convention, remarks = proposed_convention(tracks)
    found = replace(found, remarks=(*found.remarks, *remarks))
    return found if convention is None else found.with_option("angles", str(convention))


def _shown(value: Any) -> Any:
    return ("yes" if value else "no") if isinstance(value, bool) else value


_MOST_SHOWN = 1_000
"""Most tracks in the table; rows of a million take minutes."""

_WINDOW = 0.5
"""Half width in seconds of the window in which a line is fitted to the positions."""


def _speeds(track: Track) -> Any:
    """Return speeds (m/s) along the smoothed path; differences of noisy positions overestimate them.

    They are slopes of straight lines fitted by least squares to the observations around each frame.
    `travel_velocity` of Baxter et al.'s statistics is unsuitable: the published mean of differences over a
    number of frames is too noisy for a standing person.
    """
    import numpy as np

    from graphtrack.tracks.time import TIME_TOLERANCE

    has_position = np.isfinite(track.position).all(axis=1)
    t, position = track.t[has_position] - track.t[0], track.position[has_position]
    begin = np.searchsorted(t, t - _WINDOW - TIME_TOLERANCE)
    end = np.searchsorted(t, t + _WINDOW + TIME_TOLERANCE)
    columns = np.column_stack([np.ones(len(t)), t, t * t, position, t[:, None] * position])
    sums = np.concatenate([np.zeros((1, columns.shape[1])), np.cumsum(columns, axis=0)])
    n, first, second, x, y, tx, ty = (sums[end] - sums[begin]).T
    spread = n * second - first**2
    with np.errstate(invalid="ignore", divide="ignore"):
        slopes = (n * np.array([tx, ty]) - first * np.array([x, y])) / spread
    return np.linalg.norm(slopes[:, (n > 1) & (spread > 1e-9)], axis=0)


def describe(track: Track) -> dict[str, Any]:
    """Return a track's row: extent, rate, gaps, observed channels, median speed of the smoothed path."""
    import numpy as np

    has_position = np.isfinite(track.position).all(axis=1)
    steps = np.diff(track.t)
    usual = float(np.median(steps)) if len(steps) else float("nan")
    step_frames = np.diff(track.frame)
    frames = int(np.median(step_frames)) if len(step_frames) else 1
    speeds = _speeds(track)

    def count(name: str) -> int:
        values = [getattr(track, channel) for channel in (name, f"{name}_likelihood")]
        known = [finite_rows(one) for one in values if one is not None]
        return int(np.any(known, axis=0).sum()) if known else 0

    return {
        "track": track.track_id,
        "label": track.label,
        "rows": len(track),
        "frames": f"{track.frame[0]}–{track.frame[-1]}",
        "seconds": float(track.t[-1] - track.t[0]),
        "rate_hz": 1.0 / usual if usual > 0 else None,
        "gaps": int(np.sum(step_frames > frames)),
        "positions": int(has_position.sum()),
        "body": count("body"),
        "head": count("head"),
        "speed_m_s": float(np.median(speeds)) if len(speeds) else None,
        "truth": track.has_truth,
    }


def formats() -> None:
    """List the file formats that can be read and written."""
    from graphtrack.io import all_formats

    rows = [
        {"format": one.name, "written": ", ".join(one.suffixes) if one.write else "", "what": one.description}
        for one in all_formats()
    ]
    print_table("Formats", rows)


def convert(
    inputs: options.Inputs,
    output: options.Output,
    reading: options.MovingReading,
    spreadsheet: Annotated[bool, typer.Option("--spreadsheet")] = False,
    intervals: options.Intervals = None,
) -> None:
    """Write tracks unchanged in another format, given by the ending of the output.

    Parameters
    ----------
    spreadsheet : Put an apostrophe before text in CSV that a spreadsheet would run as a formula, such as a
        label =1+1 of a file from outside.
    """
    options.check_outputs({"--output": output}, reading.inputs(inputs), table=output)
    tracks = reading.tracks(inputs)
    write_tracks(tracks, output, spreadsheet=spreadsheet, intervals=intervals)
    people, rows = counted(len(tracks), "track"), counted(tracks.n_frames, "person-frame")
    emit(f"wrote {output}: {people}, {rows}")
