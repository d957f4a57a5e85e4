"""`graphtrack attention`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from graphtrack.cli import options
from graphtrack.cli.console import emit, print_table, write_json
from graphtrack.cli.groups import Smoothing, Table, check_csv, estimated
from graphtrack.display import counted

if TYPE_CHECKING:
    pass

PICTURES = ("looks.png", "timeline.png", "matrix.png")


def attention(
    inputs: options.Inputs,
    output: Table,
    reading: options.SceneReading,
    places: options.Places = None,
    model: Smoothing = None,
    online: bool = False,
    json_path: Annotated[Path | None, typer.Option("--json")] = None,
    pictures: Path | None = None,
    parameters: Path | None = None,
    truth: Path | None = None,
) -> None:
    """Find who looks at whom, and at which places, in every frame, with probabilities.

    Parameters
    ----------
    online : In each frame the past alone counts, as in a live scene.
    json_path : Write who looks at whom, dwell times of places and mutual gaze, in seconds.
    pictures : Folder for a heat map of looks on the ground, a timeline and the matrix.
    parameters : What 'graphtrack fit --attention' wrote (.toml).
    truth : Labelled looks to judge by (.csv): frame, track_id and target.
    """
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
    emit(
        f"wrote {output}: {counted(len(columns['frame']), 'row')}; {counted(len(found), 'track')}, "
        f"{counted(len(known), 'place')}"
    )
    if score is not None:
        print_table(f"Looks beside the truth, {counted(score.frames, 'look')}", score.shown())
    summary = summary_of(found)
    write_json(json_path, summary.to_dict())
    if pictures is not None:
        from graphtrack.report.plots.looks import draw_looks

        options.make_folder(pictures)
        draw_looks(tracks, known, found, summary, [pictures / name for name in PICTURES])
        emit(f"wrote {pictures}")
