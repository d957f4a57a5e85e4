"""Options that say where a view goes."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from graphtrack.viewer.recording import Target

_WHERE = "Where it is shown; by default in a window that opens"

Save = Annotated[
    Path | None,
    typer.Option(
        "--save",
        help="Write a recording (.rrd), for 'rerun FILE'.",
        show_default=False,
        rich_help_panel=_WHERE,
    ),
]
Connect = Annotated[
    str | None,
    typer.Option(
        "--connect",
        metavar="URL",
        help="Show it in a viewer that runs, such as rerun+http://127.0.0.1:9876/proxy.",
        show_default=False,
        rich_help_panel=_WHERE,
    ),
]


@dataclass(frozen=True)
class Showing:
    """Where a view goes; see `graphtrack.cli.options.expanded`."""

    save: Save = None
    connect: Connect = None

    def target(self) -> Target:
        """Where it goes, checked."""
        from graphtrack.viewer.recording import Target

        found = Target(self.save, self.connect)
        found.check()
        if self.connect is not None:
            # A viewer that does not answer is one error, without the lines of Rerun's own log before it.
            os.environ.setdefault("RUST_LOG", "off")
        return found
