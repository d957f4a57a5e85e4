"""Run a program's command line, and end it with one line and a status."""

from __future__ import annotations

import atexit
import gc
import sys
from typing import Any

import typer

from graphtrack.cli.console import BAD_INPUT, fail, printed_log
from graphtrack.errors import GraphtrackError
from graphtrack.io.library_errors import ERRORS, described

UsageError: Any = typer.BadParameter.__base__
"""Click's error of that name, which typer brings along or imports, depending on its version."""


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


def run_app(program: typer.Typer, name: str) -> None:
    """Run an application: wrong use and bad input end with one line and exit status 2.

    Raises
    ------
    KeyboardInterrupt
        At Ctrl-C, also where a library has replaced it by an error of its own.
    """
    atexit.register(leave_garbage)
    # Importing and compiling keep what they make: looking for garbage took a tenth of a short command.
    gc.set_threshold(100_000, 20, 50)
    try:
        with printed_log():
            code = program(prog_name=name, standalone_mode=False)
        raise SystemExit(code or 0)
    except UsageError as error:
        fail_usage(error)
    except GraphtrackError as error:
        fail(str(error))
    except typer.Abort:
        raise KeyboardInterrupt from None
    except Exception as error:
        if _is_interrupt(error):
            raise KeyboardInterrupt from None
        if not isinstance(error, ERRORS):
            raise
        place = f"{error.filename}: " if isinstance(error, OSError) and error.filename else ""
        fail(f"{place}{described(error)}")


def _is_interrupt(error: BaseException | None) -> bool:
    """Return True if an error was raised because of Ctrl-C."""
    seen: set[int] = set()
    while error is not None and id(error) not in seen:
        if isinstance(error, KeyboardInterrupt):
            return True
        seen.add(id(error))
        error = error.__cause__ or error.__context__
    return False
