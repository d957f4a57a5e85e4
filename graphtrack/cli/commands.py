"""The application and its commands."""

from __future__ import annotations

from typing import Annotated

import typer

from graphtrack.cli import (
    attention,
    compare,
    convert,
    demo,
    fit,
    forecast,
    groups,
    info,
    report,
    reproduce,
    score,
    serve,
    simulate,
    smooth,
    track,
    view,
)
from graphtrack.cli.options import expanded

app = typer.Typer(
    name="graphtrack",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)


def show_version(wanted: bool) -> None:
    """Print the version and end."""
    if wanted:
        import graphtrack

        print(graphtrack.__version__)
        raise typer.Exit


@app.callback()
def start(
    version: Annotated[
        bool,
        typer.Option("--version", is_eager=True, callback=show_version, help="Print the version and end."),
    ] = False,
) -> None:
    """Where pedestrians are, how they move and where their bodies and heads point."""


app.command("smooth")(expanded(smooth.smooth))
app.command("track")(expanded(track.track))
app.command("serve")(expanded(serve.serve))
app.command("compare", cls=compare.CompareCommand)(expanded(compare.compare))
app.command("score")(expanded(score.score))
app.command("groups")(expanded(groups.groups))
app.command("attention")(expanded(attention.attention))
app.command("fit")(expanded(fit.fit))
app.command("forecast")(expanded(forecast.forecast))
app.command("report")(expanded(report.report))
app.command("view")(expanded(view.view))
app.command("reproduce")(reproduce.reproduce)
app.command("demo")(demo.demo)
app.command("simulate")(simulate.simulate)
app.command("add-noise")(expanded(simulate.add_noise))
app.command("convert")(expanded(convert.convert))
app.command("info")(expanded(info.info))
app.command("formats")(info.formats)
