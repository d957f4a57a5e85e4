"""Command table of the program graphtrack."""

from __future__ import annotations

import typer

from graphtrack.cli.options import program_of

COMMANDS = {
    "smooth": "graphtrack.cli.smooth:smooth",
    "track": "graphtrack.cli.track:track",
    "serve": "graphtrack.cli.track:serve",
    "score": "graphtrack.cli.score:score",
    "compare": "graphtrack.cli.compare:compare",
    "groups": "graphtrack.cli.behaviour:groups",
    "attention": "graphtrack.cli.behaviour:attention",
    "fit": "graphtrack.cli.fit:fit",
    "forecast": "graphtrack.cli.behaviour:forecast",
    "crowd": "graphtrack.cli.behaviour:crowd",
    "report": "graphtrack.cli.report:report",
    "view": "graphtrack.cli.report:view",
    "reproduce": "graphtrack.cli.reproduce:reproduce",
    "demo": "graphtrack.cli.reproduce:demo",
    "cite": "graphtrack.cli.reproduce:cite",
    "simulate": "graphtrack.cli.simulate:simulate",
    "add-noise": "graphtrack.cli.simulate:add_noise",
    "convert": "graphtrack.cli.files:convert",
    "info": "graphtrack.cli.files:info",
    "formats": "graphtrack.cli.files:formats",
    "warm-up": "graphtrack.cli.smooth:warm_up",
}
"""Name of a command → its module and function."""


def program(command: str | None = None) -> typer.Typer:
    """Return the program: with one command alone, whose modules load faster, or with all."""
    return program_of(
        "graphtrack",
        "Pedestrian tracking: positions, velocities, and body and head orientations.",
        COMMANDS,
        command,
    )
