"""`graphtrack report`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from graphtrack.cli import options
from graphtrack.cli.console import console

_SHOWN = "What is shown beside the tracks"


def _table(name: str, what: str) -> typer.models.OptionInfo:
    return typer.Option(name, help=what, show_default=False, rich_help_panel=_SHOWN)


def report(
    inputs: options.Inputs,
    output: Annotated[Path, typer.Option("--output", "-o", help="Page to write (.html).")],
    reading: options.SceneReading,
    observations: Annotated[
        list[Path] | None,
        _table("--observations", "What the tracks were estimated from; repeat for more files."),
    ] = None,
    groups: Annotated[Path | None, _table("--groups", "What 'graphtrack groups' wrote.")] = None,
    attention: Annotated[Path | None, _table("--attention", "What 'graphtrack attention' wrote.")] = None,
    places: Annotated[
        Path | None, _table("--places", "The places that 'graphtrack attention' was given.")
    ] = None,
    forecast: Annotated[Path | None, _table("--forecast", "What 'graphtrack forecast' wrote.")] = None,
    title: Annotated[str, typer.Option("--title", help="At the top of the page.")] = "Tracks",
) -> None:
    """Write the HTML report of tracks that are there already, with groups, looks and forecasts."""
    from graphtrack.report.page import write_report

    tables = {"--groups": groups, "--attention": attention, "--places": places, "--forecast": forecast}
    options.check_outputs(
        {"--output": output}, {**reading.inputs(inputs), "--observations": observations, **tables}
    )
    tracks = reading.tracks(inputs)
    seen = None if not observations else reading.tracks(observations)
    write_report(
        output,
        tracks,
        seen,
        groups=groups,
        attention=attention,
        forecast=forecast,
        places=places,
        title=title,
    )
    console.print(f"wrote {output}: {output.stat().st_size / 1e6:.1f} MB", markup=False)
