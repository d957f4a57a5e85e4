"""The command lines, called from tests."""

from __future__ import annotations

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
    """A program's command line, in this process: what it imports takes longer than what it does here."""
    main = import_module(f"{program}.cli").main
    out, err = StringIO(), StringIO()
    with pytest.MonkeyPatch.context() as patch, redirect_stdout(out), redirect_stderr(err):
        patch.setattr(sys, "argv", [program, *map(str, arguments)])
        with pytest.raises(SystemExit) as end:
            main()
    return Done(int(end.value.code or 0), out.getvalue(), err.getvalue())
