"""`graphtrack report`."""

from __future__ import annotations

from pathlib import Path

from graphtrack.cli import options
from graphtrack.cli.console import emit


def report(
    inputs: options.Inputs,
    output: options.OutputPath,
    reading: options.SceneReading,
    observations: list[Path] | None = None,
    groups: Path | None = None,
    attention: Path | None = None,
    places: Path | None = None,
    forecast: Path | None = None,
    title: str = "Tracks",
) -> None:
    """Write the HTML report of tracks that are there already, with groups, looks and forecasts.

    Parameters
    ----------
    output : Page to write (.html).
    title : At the top of the page.

    What is shown beside the tracks
    -------------------------------
    observations : What the tracks were estimated from; repeat for more files.
    groups : What 'graphtrack groups' wrote.
    attention : What 'graphtrack attention' wrote.
    places : The places that 'graphtrack attention' was given.
    forecast : What 'graphtrack forecast' wrote.
    """
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
    emit(f"wrote {output}: {output.stat().st_size / 1e6:.1f} MB")
