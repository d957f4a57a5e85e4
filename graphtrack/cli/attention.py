"""`graphtrack attention`."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from graphtrack.cli import options
from graphtrack.cli.console import console, print_table, quiet_input_warnings
from graphtrack.cli.groups import Smoothing, Table, check_csv, estimated, tell_learned
from graphtrack.display import counted

if TYPE_CHECKING:
    from graphtrack.tracks import TrackSet

PICTURES = ("looks.png", "timeline.png", "matrix.png")


def attention(
    inputs: options.Inputs,
    output: Table,
    reading: options.SceneReading,
    places: options.Places = None,
    model: Smoothing = None,
    online: Annotated[
        bool, typer.Option("--online", help="In each frame the past alone counts, as in a live scene.")
    ] = False,
    json_path: Annotated[
        Path | None,
        typer.Option(
            "--json", help="Write who looks at whom, dwell times of places and mutual gaze, in seconds."
        ),
    ] = None,
    pictures: Annotated[
        Path | None,
        typer.Option(
            "--pictures", help="Folder for a heat map of looks on the ground, a timeline and the matrix."
        ),
    ] = None,
    parameters: Annotated[
        Path | None,
        typer.Option(
            "--parameters", help="What 'graphtrack fit --attention' wrote (.toml).", show_default=False
        ),
    ] = None,
    truth: Annotated[
        Path | None,
        typer.Option("--truth", help="Labelled looks to judge by (.csv): frame, track_id and target."),
    ] = None,
) -> None:
    """Find who looks at whom, and at which places, in every frame, with probabilities."""
    from graphtrack.behaviour.attention import attention as find
    from graphtrack.behaviour.files import load_attention
    from graphtrack.behaviour.looks import attention_columns, summary_of
    from graphtrack.behaviour.places import read_places
    from graphtrack.behaviour.tables import read_looks
    from graphtrack.behaviour.warm import make_behaviour_ready
    from graphtrack.interaction.scores import score_looks
    from graphtrack.io.groups import write_columns
    from graphtrack.table.as_read import with_names

    options.check_outputs(
        {
            "--output": output,
            "--json": json_path,
            "--pictures": [] if pictures is None else [pictures / name for name in PICTURES],
        },
        {
            **reading.inputs(inputs, model),
            "--places": places,
            "--parameters": parameters,
            "--truth": truth,
        },
        to_make=[] if pictures is None else [pictures],
    )
    check_csv(output)
    known = [] if places is None else read_places(places)
    chosen = None if parameters is None else load_attention(parameters)
    labels = None if truth is None else read_looks(truth)
    tracks = estimated(reading.tracks(inputs), model)
    make_behaviour_ready()
    found = find(tracks, known, chosen, online=online)
    score = None if labels is None else score_looks(found, labels)
    columns = attention_columns(found)
    write_columns(with_names(columns, tracks.as_read), output)
    console.print(
        f"wrote {output}: {counted(len(columns['frame']), 'row')}; {counted(len(found), 'track')}, "
        f"{counted(len(known), 'place')}",
        markup=False,
    )
    if score is not None:
        print_table(f"Looks beside the truth, {counted(score.frames, 'look')}", score.shown())
    summary = summary_of(found)
    if json_path is not None:
        from graphtrack.io import atomic_path

        with atomic_path(json_path) as temporary:
            temporary.write_text(json.dumps(summary.to_dict(), indent=1), encoding="utf-8")
        console.print(f"wrote {json_path}", markup=False)
    if pictures is not None:
        from graphtrack.report.plots.looks import draw_looks

        options.make_folder(pictures)
        draw_looks(tracks, known, found, summary, [pictures / name for name in PICTURES])
        console.print(f"wrote {pictures}", markup=False)


def learn_attention(
    tracks: TrackSet, truth: Path, hold_out: float, output: Path, json_path: Path | None
) -> None:
    """`graphtrack fit --attention`: learn, say how well looks are told, and write the parameters."""
    from graphtrack.behaviour.tables import read_looks
    from graphtrack.learning.attention import fit_attention

    labels = read_looks(truth)
    with console.status("learning"), quiet_input_warnings():
        found = fit_attention(tracks, labels, hold_out=hold_out)
    tell_learned(found, asdict(found.parameters), ("Looks", "look"), output, json_path)
