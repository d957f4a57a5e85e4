"""The command line: thin; it parses, calls and prints."""

from perception.cli.main import main

__all__ = ["main"]
