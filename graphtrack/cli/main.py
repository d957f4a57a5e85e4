"""The application: its commands, and one way to end badly."""

from __future__ import annotations

import sys
from typing import Annotated

import typer

from graphtrack.cli import compare, demo, info, simulate, smooth, track
from graphtrack.cli.console import fail
from graphtrack.errors import GraphtrackError

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


app.command("smooth")(smooth.smooth)
app.command("track")(track.track)
app.command("compare")(compare.compare)
app.command("demo")(demo.demo)
app.command("simulate")(simulate.simulate)
app.command("add-noise")(simulate.add_noise)
app.command("info")(info.info)
app.command("formats")(info.formats)


def main() -> None:
    """Entry point of the command line."""
    try:
        app()
    except GraphtrackError as error:
        fail(str(error))
    except BrokenPipeError:
        # The reader of our output has gone, as with `| head`.
        sys.stderr.close()
        raise SystemExit(0) from None
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        raise SystemExit(130) from None
