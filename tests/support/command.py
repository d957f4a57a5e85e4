"""The command lines, called from tests."""

from __future__ import annotations

import re
import sys
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass
from importlib import import_module
from io import StringIO

import pytest


@dataclass
class Done:
    returncode: int
    stdout: str
    stderr: str


def run(*arguments: object, program: str = "perception") -> Done:
    """Run a program's command line in this process, since imports take longer than the command."""
    main = import_module(f"{program}.cli").main
    out, err = StringIO(), StringIO()
    with pytest.MonkeyPatch.context() as patch, redirect_stdout(out), redirect_stderr(err):
        patch.setattr(sys, "argv", [program, *map(str, arguments)])
        with pytest.raises(SystemExit) as end:
            main()
    return Done(int(end.value.code or 0), out.getvalue(), err.getvalue())


def ran(*arguments: object, program: str = "perception") -> Done:
    """Run a program's command line, which must succeed."""
    done = run(*arguments, program=program)
    assert done.returncode == 0, done.stderr
    return done


TRACK_STREAM = [sys.executable, "-c", "from graphtrack.cli import main; main()", "track", "-"]

_SAID = re.compile(
    r"resuming from .*, after (\d+) rows?"
    r"(?: \(the last is line (\d+)\))?(; the answer to row \d+ is repeated)?"
)


def going_on(said: str) -> tuple[int, int]:
    """The line after which a run continues, and the number of answers to keep."""
    rows, line, again = _SAID.search(said).groups()
    return int(line or rows), int(rows) - bool(again)
