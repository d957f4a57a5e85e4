"""The command line: parsing of options and printing of results."""

from graphtrack.cli.main import run


def main() -> None:
    """Run the command line."""
    run("perception.cli.commands", "perception")
