"""The commands of the program `perception`."""

from __future__ import annotations

import typer

from graphtrack.cli.options import program_of

COMMANDS = {
    "adapt": "perception.cli.adapt:adapt",
    "calibrate": "perception.cli.adapt:calibrate",
    "report": "perception.cli.report:report",
    "observe": "perception.cli.observe:observe",
    "follow": "perception.cli.follow:follow",
    "simulate": "perception.cli.train:simulate",
    "train": "perception.cli.train:train",
    "evaluate": "perception.cli.evaluate:evaluate",
    "card": "perception.cli.train:card",
}
"""Name of a command → its module and function."""


def program(command: str | None = None) -> typer.Typer:
    """Return the program: with one command alone, whose modules load faster, or with all."""
    return program_of(
        "perception", "From video to the observations that graphtrack smooths.", COMMANDS, command
    )
