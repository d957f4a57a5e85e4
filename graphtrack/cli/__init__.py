"""The command line: thin; it parses, calls and prints."""

from graphtrack.cli.main import main

__all__ = ["main"]
