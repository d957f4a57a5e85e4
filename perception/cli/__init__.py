"""The command line: thin; it parses, calls and prints."""

from graphtrack.cli.main import run


def main() -> None:
    """Entry point of the command line."""
    run("perception.cli.commands", "perception")
