"""The entry point of ``perception``."""

from __future__ import annotations

from graphtrack.cli.main import run


def main() -> None:
    """Entry point of the command line."""
    run("perception.cli.commands", "perception")
