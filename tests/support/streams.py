"""What the tests of `graphtrack track -` share."""

import re
import sys

COMMAND = [sys.executable, "-c", "from graphtrack.cli import main; main()", "track", "-"]

_SAID = re.compile(
    r"going on from .*, after (\d+) rows?"
    r"(?: \(the last is line (\d+)\))?(; the answer to row \d+ is given again)?"
)


def going_on(said):
    """The line after which a run goes on, and how many of the answers so far are to be kept."""
    rows, line, again = _SAID.search(said).groups()
    return int(line or rows), int(rows) - bool(again)
