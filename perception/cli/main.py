"""The application: its commands, and one way to end badly."""

from __future__ import annotations

import sys

import typer

from graphtrack.cli.console import fail
from graphtrack.cli.main import UsageError, fail_usage
from graphtrack.errors import GraphtrackError
from perception.cli import observe, train

app = typer.Typer(
    name="perception", no_args_is_help=True, add_completion=False, pretty_exceptions_enable=False
)


@app.callback()
def start() -> None:
    """From video to the observations that graphtrack smooths."""


app.command("observe")(observe.observe)
app.command("train")(train.train)
app.command("card")(train.card)
app.command("contact-sheet")(train.sheet)


def main() -> None:
    """Entry point of the command line."""
    try:
        code = app(prog_name="perception", standalone_mode=False)
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
