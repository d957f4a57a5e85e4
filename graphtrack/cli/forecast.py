"""`graphtrack forecast`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from graphtrack.cli import options
from graphtrack.cli.console import emit
from graphtrack.display import counted


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
    seed: options.Seed = 0,
) -> None:
    """Predict where each person will be, with the uncertainty, at every time from observations until then.

    Parameters
    ----------
    output : Table to write: .csv, .csv.gz, .parquet or .ndjson.
    horizon : How far ahead.
    step : Between the times ahead that are told.
    every : Between the times at which forecasts are made; by default at each frame.
    history : How long somebody must have been seen; by default in two frames.
    samples : Paths to draw, as columns.
    parameters : What graphtrack fit --forecast learned (.toml); by default, what it learned of streets.
    """
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
        emit(f"  note: no forecast of {who} seen for less than {needed}")
    of = counted(found.people, "track")
    emit(f"forecast {of}, {len(found)} rows\nwrote {output}")
