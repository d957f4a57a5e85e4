"""`graphtrack groups`, and `score` of its tables."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from graphtrack.cli import options
from graphtrack.cli.console import emit, input_warnings_as_notes, print_table, write_json
from graphtrack.display import counted
from graphtrack.errors import InputError

if TYPE_CHECKING:
    from graphtrack.behaviour.parameters import GroupParameters
    from graphtrack.interaction.scores import GroupScore
    from graphtrack.table.groups import GroupLabels
    from graphtrack.tracks import TrackSet

Table = Annotated[Path, typer.Option("--output", "-o", help="File to write: .csv or .csv.gz.")]
ParametersFile = Annotated[
    Path | None,
    typer.Option("--parameters", help="What 'graphtrack fit --groups' wrote (.toml).", show_default=False),
]
Smoothing = Annotated[
    str | None,
    typer.Option(
        "--model",
        help="Smooth observations first, with this preset or model file (.toml); by default they are taken "
        "as they are.",
        show_default=False,
    ),
]


def groups(
    inputs: options.Inputs,
    output: Table,
    reading: options.SceneReading,
    truth: Path | None = None,
    model: Smoothing = None,
    parameters: ParametersFile = None,
    online: bool = False,
    json_path: options.Json = None,
) -> None:
    """Find who stands in conversation with whom, and who walks together, in every frame.

    Parameters
    ----------
    truth : Labelled groups to judge by: SALSA's or ETH's file, or a table of groups.
    online : In each frame the past alone counts, as in a live scene.
    """
    from graphtrack.behaviour.groups import groups as find
    from graphtrack.behaviour.warm import make_behaviour_ready
    from graphtrack.interaction.scores import score_groups
    from graphtrack.io.groups import write_columns
    from graphtrack.table.as_read import with_names

    options.check_outputs(
        {"--output": output, "--json": json_path},
        {**reading.inputs(inputs, model), "--truth": truth, "--parameters": parameters},
    )
    check_csv(output)
    chosen = parameters_of(parameters)
    labels = None if truth is None else read_quietly(truth)
    tracks = estimated(reading.tracks(inputs), model)
    make_behaviour_ready()
    found = find(tracks, chosen, online=online)
    true = None if labels is None else labels.labels(found.frame, found.t, found.track_id)
    write_columns(with_names(found.columns(), tracks.as_read), output)
    count = counted(int(found.group.max(initial=-1)) + 1, "group")
    most = {frame: len(one) for frame, one in found.members().items()}
    emit(
        f"wrote {output}: {counted(len(found), 'row')}, {count}, "
        f"{sum(most.values()) / max(len(most), 1):.2f} a frame"
    )
    if true is not None:
        show(score_groups(found.frame, found.track_id, found.group, true), json_path)


def estimated(tracks: TrackSet, model: str | None) -> TrackSet:
    """The tracks, smoothed if a model is named."""
    if model is None:
        return tracks
    from graphtrack.inference.engines import engine_of
    from graphtrack.inference.solution import Solution
    from graphtrack.model import Model
    from graphtrack.smoothing.recording import solve_tracks

    chosen = Model.named(model)
    found = solve_tracks(tracks, chosen, engine_of(chosen, "auto"))
    return tracks.with_tracks(result.track for result in found if isinstance(result, Solution))


def check_csv(output: Path) -> None:
    """Refuse a name of a table that is not CSV."""
    if not output.name.lower().endswith((".csv", ".csv.gz")):
        raise InputError(f"the file name {output.name!r}", "one of the endings .csv, .csv.gz", path=output)


def read_quietly(path: Path) -> GroupLabels:
    """Read labelled groups; warnings become notes."""
    from graphtrack.io.groups import read_groups

    with input_warnings_as_notes():
        return read_groups(path)


def parameters_of(path: Path | None) -> GroupParameters | None:
    """Parameters from a file; None without one."""
    if path is None:
        return None
    from graphtrack.behaviour.files import load_parameters

    return load_parameters(path)


def show(found: GroupScore, json_path: Path | None) -> None:
    """Print a score of groups, and write it."""
    print_table(f"Groups beside the truth, {counted(found.frames, 'frame')}", found.shown())
    write_json(json_path, found.to_dict())


def score_tables(inputs: list[Path], truth: list[Path], json_path: Path | None) -> None:
    """`graphtrack score` of a table of groups."""
    from graphtrack.interaction.scores import score_groups
    from graphtrack.io.groups import read_group_rows

    if len(inputs) != 1 or len(truth) != 1:
        raise InputError(f"{len(inputs)} tables of groups, {len(truth)} truths", "one of each")
    options.check_outputs({"--json": json_path}, {"the input": inputs, "--truth": truth})
    rows = read_group_rows(inputs[0])
    labels = read_quietly(truth[0])
    true = labels.labels(rows["frame"], rows["t"], rows["track_id"])
    show(score_groups(rows["frame"], rows["track_id"], rows["group"], true), json_path)
