"""Entry point: import the commands, run one of them, and exit with one line and a status.

This module imports nothing heavy, so that Ctrl-C during the import of the commands is handled as well.
"""

from __future__ import annotations

import contextlib
import io
import os
import signal
import sys
from collections.abc import Iterator
from importlib import import_module
from types import FrameType

INTERRUPTED = 130
"""Exit status after Ctrl-C, as shells have it."""


def main() -> None:
    """Entry point of the command line."""
    run("graphtrack.cli.commands", "graphtrack")


def run(module: str, name: str) -> None:
    """Run a program's command line; wrong usage and bad input end with one line and exit status 2.

    Parameters
    ----------
    module : module with the function ``program``
    name : name of the program
    """
    try:
        print_any_text()
        with ended_at_once():
            from graphtrack.cli.console import run_app

            program = import_module(module).program(next(iter(sys.argv[1:]), None))
        run_app(program, name)
    except KeyboardInterrupt:
        _report_interrupt()
        raise SystemExit(INTERRUPTED) from None


def print_any_text() -> None:
    """Print escapes on standard output and error for characters that their encoding lacks."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")


@contextlib.contextmanager
def ended_at_once() -> Iterator[None]:
    """Exit at Ctrl-C while the block imports.

    Extension modules replace a `KeyboardInterrupt` in their imports by other errors, and there is nothing to
    clean up yet.
    """
    try:
        before = signal.signal(signal.SIGINT, _end)
    except ValueError:  # not the main thread
        yield
        return
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


def _end(number: int, frame: FrameType | None) -> None:
    _report_interrupt()
    os._exit(INTERRUPTED)


def _report_interrupt() -> None:
    with contextlib.suppress(OSError):
        os.write(2, b"interrupted\n")
