"""`graphtrack forecast`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from graphtrack.cli import options
from graphtrack.cli.console import console
from graphtrack.display import counted


def forecast(
    inputs: options.Inputs,
    reading: options.SceneReading,
    output: Annotated[
        Path,
        typer.Option("--output", "-o", help="Table to write: .csv, .csv.gz, .parquet or .ndjson."),
    ],
    horizon: Annotated[float, typer.Option("--horizon", metavar="SECONDS", help="How far ahead.")] = 4.8,
    step: Annotated[
        float, typer.Option("--step", metavar="SECONDS", help="Between the times ahead that are told.")
    ] = 0.4,
    every: Annotated[
        float | None,
        typer.Option(
            "--every",
            metavar="SECONDS",
            help="Between the times at which forecasts are made; by default at each frame.",
            show_default=False,
        ),
    ] = None,
    history: Annotated[
        float | None,
        typer.Option(
            "--history",
            metavar="SECONDS",
            help="How long somebody must have been seen; by default in two frames.",
            show_default=False,
        ),
    ] = None,
    samples: Annotated[
        int, typer.Option("--samples", metavar="N", min=0, max=1000, help="Paths to draw, as columns.")
    ] = 0,
    parameters: Annotated[
        Path | None,
        typer.Option(
            "--parameters",
            help="What graphtrack fit --forecast learned (.toml); by default, what it learned of streets.",
            show_default=False,
        ),
    ] = None,
    seed: options.Seed = 0,
) -> None:
    """Where each person will be, with the uncertainty: at every time from what was seen until then."""
    from graphtrack.behaviour.forecast.recorded import forecast as forecast_tracks
    from graphtrack.io.reading import check_table_name, write_table
    from graphtrack.table.as_read import with_names

    options.check_outputs(
        {"--output": output}, {**reading.inputs(inputs), "--parameters": [parameters] if parameters else []}
    )
    check_table_name(output)
    tracks = reading.tracks(inputs)
    found = forecast_tracks(
        tracks,
        horizon=horizon,
        step=step,
        every=every,
        history=history,
        samples=samples,
        parameters=parameters,
        seed=seed,
    )
    write_table(with_names(found.columns, tracks.as_read), output)
    if found.too_short:
        needed = "two frames" if history is None else f"{history:g} s"
        who = counted(len(found.too_short), "track")
        console.print(f"  note: no forecast of {who} seen for less than {needed}", markup=False)
    of = counted(found.people, "track")
    console.print(f"forecast {of}, {len(found)} rows\nwrote {output}", markup=False)
