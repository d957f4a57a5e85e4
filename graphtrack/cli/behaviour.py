"""Commands `graphtrack groups`, `attention`, `forecast` and `crowd`, and the score of a table of groups."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from graphtrack.cli import options
from graphtrack.cli.console import emit, input_warnings_as_notes, print_table, write_json
from graphtrack.errors import InputError
from graphtrack.tracks.display import counted

if TYPE_CHECKING:
    from graphtrack.interaction.group_files import GroupLabels
    from graphtrack.interaction.scores import GroupScore
    from graphtrack.tracks.track import TrackSet


Table = Annotated[Path, typer.Option("--output", "-o", help="File to write: .csv or .csv.gz.")]
Smoothing = Annotated[
    str | None,
    typer.Option(
        "--model",
        help="Smooth observations first, with this preset or model file (.toml); by default the table is "
        "used unchanged.",
        show_default=False,
    ),
]


def groups(
    inputs: options.Inputs,
    output: Table,
    reading: options.SceneReading,
    truth: Path | None = None,
    model: Smoothing = None,
    parameters: Path | None = None,
    online: bool = False,
    json_path: options.Json = None,
) -> None:
    """Detect conversation groups, and people walking together, in every frame.

    Parameters
    ----------
    truth : Labelled groups to score against: a SALSA or ETH file, or a table of groups.
    parameters : Output of 'graphtrack fit --groups' (.toml).
    online : Use only the past of each frame, as in a live scene.
    """
    from graphtrack.interaction.groups import groups as find
    from graphtrack.interaction.parameters import GroupParameters
    from graphtrack.interaction.scores import score_groups
    from graphtrack.io.read_write import write_table
    from graphtrack.tracks.table import with_names

    options.check_outputs(
        {"--output": output, "--json": json_path},
        {**reading.inputs(inputs, model), "--truth": truth, "--parameters": parameters},
    )
    check_csv(output)
    chosen = None if parameters is None else GroupParameters.load(parameters)
    tracks = estimated(reading.tracks(inputs), model)
    labels = None if truth is None else read_quietly(truth, tracks.ids)
    with input_warnings_as_notes():
        found = find(tracks, chosen, online=online)
    true = None if labels is None else labels.labels(found.frame, found.t, found.track_id)
    write_table(with_names(found.columns(), tracks.as_read), output)
    count = counted(int(found.group.max(initial=-1)) + 1, "group")
    emit(f"wrote {output}: {counted(len(found), 'row')}, {count}, {found.per_frame:.2f} a frame")
    if true is not None:
        show(score_groups(found.frame, found.track_id, found.group, true), json_path)


def crowd(
    inputs: options.Inputs,
    output: Annotated[Path, typer.Option("--output", "-o", metavar="FOLDER", file_okay=False)],
    reading: options.SceneReading,
    places: options.InputFile,
    walkable: options.Walkable = None,
    model: Smoothing = None,
    json_path: options.Json = None,
) -> None:
    """Measure density, speed and flow in zones and across lines, and count people, with PedPy.

    Parameters
    ----------
    output : Folder for zones.csv, density.csv (over time), visits.csv (of each person), lines.csv,
        crossings.csv and flow.csv.
    places : CSV of zones and lines: name and x, y, radius, or name and polygon (x y x y …), of which two
        points are a line.
    """
    from graphtrack.interaction.crowd import crowd_measures
    from graphtrack.io.read_write import write_table
    from graphtrack.report.crowd import LINES, ZONES, shown_rows
    from graphtrack.tracks.table import with_names

    tables = {
        name: output / f"{name}.csv" for name in ("zones", "density", "visits", "lines", "crossings", "flow")
    }
    given = {**reading.inputs(inputs, model), "--places": places, "--walkable": walkable}
    options.check_outputs({"--output": list(tables.values()), "--json": json_path}, given, to_make=[output])
    tracks = estimated(reading.tracks(inputs), model)
    with input_warnings_as_notes():
        found = crowd_measures(tracks, places, walkable=walkable)
    summaries = {"Zones": shown_rows(found.zones, ZONES), "Lines": shown_rows(found.lines, LINES)}
    for title, rows in summaries.items():
        if rows:
            print_table(title, rows)
    output.mkdir(parents=True, exist_ok=True)
    for name, path in tables.items():
        if columns := getattr(found, name):
            named = "track_id" in columns
            write_table(with_names(columns, tracks.as_read) if named else columns, path)
    write_json(json_path, {title.lower(): rows for title, rows in summaries.items()})
    emit(f"wrote {output}")


def estimated(tracks: TrackSet, model: str | None) -> TrackSet:
    """Read the tracks, and smooth them if a model is named."""
    if model is None:
        if all(track.covariance is None for track in tracks):
            from graphtrack.constants.directions import proposed_convention

            for remark in proposed_convention(tracks)[1]:
                emit(f"  note: {remark}")
        return tracks
    from graphtrack.inference.engines import Solution, engine_of
    from graphtrack.model import Model
    from graphtrack.smoothing import solve_tracks

    chosen = Model.named(model)
    found = solve_tracks(tracks, chosen, engine_of(chosen, "auto"))
    return tracks.with_tracks(result.track for result in found if isinstance(result, Solution))


def check_csv(output: Path) -> None:
    """Refuse an output table whose name is not CSV."""
    if not output.name.lower().endswith((".csv", ".csv.gz")):
        raise InputError(f"the file name {output.name!r}", "one of the endings .csv, .csv.gz", path=output)


def read_quietly(path: Path, ids: Mapping[str, int]) -> GroupLabels:
    """Read labelled groups of people with these identities; warnings become notes."""
    from graphtrack.interaction.group_files import read_groups

    with input_warnings_as_notes():
        return read_groups(path, ids)


def show(found: GroupScore, json_path: Path | None) -> None:
    """Print a score of groups, and write it."""
    print_table(f"Groups against the truth, {counted(found.frames, 'frame')}", found.shown())
    write_json(json_path, found.to_dict())


def score_tables(inputs: list[Path], truth: list[Path], json_path: Path | None) -> None:
    """Run `graphtrack score` on a table of groups."""
    from graphtrack.interaction.scores import score_groups
    from graphtrack.interaction.tables import labelled_ids, read_group_table

    if len(inputs) != 1 or len(truth) != 1:
        raise InputError(f"{len(inputs)} tables of groups, {len(truth)} truths", "one of each")
    options.check_outputs({"--json": json_path}, {"the input": inputs, "--truth": truth})
    found = read_group_table(inputs[0])
    true = read_quietly(truth[0], labelled_ids(inputs[0])).labels(found.frame, found.t, found.track_id)
    show(score_groups(found.frame, found.track_id, found.group, true), json_path)


def attention(
    inputs: options.Inputs,
    output: Table,
    reading: options.SceneReading,
    places: options.Places = None,
    model: Smoothing = None,
    online: bool = False,
    json_path: Annotated[Path | None, typer.Option("--json")] = None,
    parameters: Path | None = None,
    truth: Path | None = None,
) -> None:
    """Estimate gaze targets, people and named places, in every frame, with probabilities.

    Parameters
    ----------
    online : Use only the past of each frame, as in a live scene.
    json_path : Write gaze between people, dwell times on places and mutual gaze, in seconds.
    parameters : Output of 'graphtrack fit --attention' (.toml).
    truth : Labelled gaze targets to score against (.csv): frame, track_id and target.
    """
    from graphtrack.interaction.attention import (
        AttentionParameters,
        attention_columns,
        rows_near_prior,
        summary_of,
    )
    from graphtrack.interaction.attention import attention as find
    from graphtrack.interaction.people import read_places
    from graphtrack.interaction.scores import score_gaze
    from graphtrack.interaction.tables import read_gaze
    from graphtrack.io.read_write import write_table
    from graphtrack.tracks.table import with_names

    options.check_outputs(
        {"--output": output, "--json": json_path},
        {
            **reading.inputs(inputs, model),
            "--places": places,
            "--parameters": parameters,
            "--truth": truth,
        },
    )
    check_csv(output)
    known = [] if places is None else read_places(places)
    chosen = AttentionParameters() if parameters is None else AttentionParameters.load(parameters)
    tracks = estimated(reading.tracks(inputs), model)
    labels = None if truth is None else read_gaze(truth, tracks.ids)
    with input_warnings_as_notes():
        found = find(tracks, known, chosen, online=online)
    score = None if labels is None else score_gaze(found, labels)
    columns = attention_columns(found)
    write_table(with_names(columns, tracks.as_read), output)
    emit(
        f"wrote {output}: {counted(len(columns['frame']), 'row')}; {counted(len(found), 'track')}, "
        f"{counted(len(known), 'place')}"
    )
    duration = 1.0 / chosen.switching
    near_prior = rows_near_prior(tracks, found, duration, online=online)
    if near_prior:
        rows = counted(near_prior, "person-frame")
        emit(f"  note: no head observed within {duration:.3g} s of {rows}: their probabilities are the prior")
    if score is not None:
        print_table(f"Gaze against the truth, {counted(score.frames, 'label')}", score.shown())
    if json_path is not None:
        named = None if tracks.as_read is None else tracks.as_read.names
        write_json(json_path, summary_of(found).to_dict(named))


def forecast(
    inputs: options.Inputs,
    reading: options.SceneReading,
    output: options.OutputPath,
    horizon: options.Seconds = 4.8,
    step: options.Seconds = 0.4,
    every: options.Seconds | None = None,
    history: options.Seconds | None = None,
    samples: Annotated[int, typer.Option(metavar="N", min=0, max=1000)] = 0,
    parameters: Path | None = None,
    walkable: options.Walkable = None,
    seed: options.Seed = 0,
) -> None:
    """Predict each person's future positions, with uncertainty, from the observations up to each frame.

    Parameters
    ----------
    output : Table to write: .csv, .csv.gz, .parquet or .ndjson.
    horizon : Longest time ahead.
    step : Interval between predicted times.
    every : Interval between forecasts; by default one at each frame.
    history : Shortest observed history of a person; by default two frames.
    samples : Number of sampled paths, written as columns.
    parameters : Output of graphtrack fit --forecast (.toml); by default, parameters learned on streets.
    """
    from graphtrack.forecasting.recorded import forecast as forecast_tracks
    from graphtrack.io.read_write import check_table_name, write_table
    from graphtrack.tracks.table import with_names

    options.check_outputs(
        {"--output": output}, {**reading.inputs(inputs), "--parameters": parameters, "--walkable": walkable}
    )
    check_table_name(output)
    tracks = reading.tracks(inputs)
    with input_warnings_as_notes():
        found = forecast_tracks(
            tracks,
            horizon=horizon,
            step=step,
            every=every,
            history=history,
            samples=samples,
            parameters=parameters,
            seed=seed,
            walkable=walkable,
        )
    write_table(with_names(found.columns, tracks.as_read), output)
    if found.too_short:
        needed = "two frames" if history is None else f"{history:g} s"
        count = counted(len(found.too_short), "track")
        emit(f"  note: no forecast of {count} observed for less than {needed}")
    of = counted(found.people, "track")
    emit(f"forecast {of}, {len(found)} rows\nwrote {output}")
