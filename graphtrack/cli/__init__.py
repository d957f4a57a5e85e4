"""Command-line interface: parses arguments, calls the library and prints results."""

from graphtrack.cli.main import main

__all__ = ["main"]
