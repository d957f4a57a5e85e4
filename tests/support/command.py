"""The command lines, called from tests."""

import json
import re
import sys
from collections.abc import Iterable
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass
from importlib import import_module
from io import BytesIO, StringIO, TextIOWrapper
from typing import Any

import pytest


@dataclass
class Done:
    returncode: int
    stdout: str
    stderr: str


def run(*arguments: object, program: str = "perception", rows: Iterable[Any] | None = None) -> Done:
    """Run a program's command line in this process, since imports take longer than the command.

    ``rows`` come to it as lines of JSON on the standard input; texts are lines already.
    """
    main = import_module(f"{program}.cli").main
    out, err = StringIO(), StringIO()
    with pytest.MonkeyPatch.context() as patch, redirect_stdout(out), redirect_stderr(err):
        patch.setattr(sys, "argv", [program, *map(str, arguments)])
        if rows is not None:
            lines = "".join(f"{row if isinstance(row, str) else json.dumps(row)}\n" for row in rows).encode()
            patch.setattr(sys, "stdin", TextIOWrapper(BytesIO(lines)))
        with pytest.raises(SystemExit) as end:
            main()
    return Done(int(end.value.code or 0), out.getvalue(), err.getvalue())


def ran(*arguments: object, **options: Any) -> Done:
    """Run a program's command line, which must succeed."""
    done = run(*arguments, **options)
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
