"""The application: its commands, and one way to end badly."""

from __future__ import annotations

import atexit
import gc
import sys
from typing import Annotated, Any

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
from graphtrack.cli.console import BAD_INPUT, fail, printed_log
from graphtrack.cli.options import expanded
from graphtrack.errors import GraphtrackError
from graphtrack.readiness import collecting_rarely

UsageError: Any = typer.BadParameter.__base__
"""Click's error of that name, which typer brings along or imports, depending on its version."""

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


def fail_usage(error: Any) -> None:
    """Say in one line what is wrong with the arguments, and end with status 2."""
    message = " ".join(error.format_message().split()).rstrip(".")
    if not message:  # no arguments at all: the help has been printed
        raise SystemExit(BAD_INPUT)
    command = getattr(error.ctx, "command_path", "graphtrack")
    fail(f"{message}; see '{command} --help'")


def leave_garbage() -> None:
    """Let what is there when the process ends go with it: to look for garbage takes a third of a second."""
    # What nanobind has bound would complain of what nobody took away.
    if not {"_duckdb", "onnx"} & sys.modules.keys():
        gc.freeze()


def main() -> None:
    """Entry point of the command line."""
    run(app, "graphtrack")


def run(program: typer.Typer, name: str) -> None:
    """Run a program's command line: wrong use and bad input end with one line and exit status 2."""
    atexit.register(leave_garbage)
    try:
        with printed_log(), collecting_rarely():
            code = program(prog_name=name, standalone_mode=False)
        raise SystemExit(code or 0)
    except UsageError as error:
        fail_usage(error)
    except GraphtrackError as error:
        fail(str(error))
    except OSError as error:
        place = f"{error.filename}: " if error.filename else ""
        fail(f"{place}{error.strerror or error}")
    except (KeyboardInterrupt, typer.Abort):
        print("interrupted", file=sys.stderr)
        raise SystemExit(130) from None
