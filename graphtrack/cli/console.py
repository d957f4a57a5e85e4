"""What the commands print, and how they end."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table

from graphtrack.errors import InputWarning

if TYPE_CHECKING:
    from graphtrack.tracks import TrackSet

console = Console(stderr=True, highlight=False, soft_wrap=True)
"""Messages go to standard error, so that standard output stays free for data."""

BAD_INPUT = 2

WIDE = 160
"""Columns of a table that goes into a file or a pipe, where no terminal says how many there are."""


def fail(message: str) -> None:
    """Print one line of error and end with status 2."""
    print(f"error: {message}", file=sys.stderr)
    raise SystemExit(BAD_INPUT)


@contextmanager
def progress_bar(total: int, unit: str = "person-frames") -> Iterator[Callable[[int], None]]:
    """A progress bar on standard error; yields the function that advances it."""
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn(unit),
        TimeRemainingColumn(),
    )
    # Where nobody watches, nothing is drawn, not even the empty line that a bar leaves behind.
    hidden = not console.is_terminal
    with Progress(*columns, console=console, transient=True, disable=hidden) as progress:
        task = progress.add_task("", total=total)
        yield lambda count: progress.advance(task, count)


@contextmanager
def quiet_input_warnings() -> Iterator[None]:
    """Readers warn and write the same in the summary's notes; the command line shows the notes."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", InputWarning)
        yield


@contextmanager
def input_warnings_as_notes() -> Iterator[None]:
    """What is to be said of the input on the way is said in the end, once each, as the readers' notes are."""
    told: dict[str, None] = {}
    with warnings.catch_warnings():
        warnings.simplefilter("always", InputWarning)
        show = warnings.showwarning

        def collect(message: Warning | str, category: type[Warning], *rest: Any) -> None:
            if issubclass(category, InputWarning):
                told[str(message)] = None
            else:
                show(message, category, *rest)

        warnings.showwarning = collect  # type: ignore[assignment]
        yield
    for message in told:
        console.print(f"  note: {message}", markup=False)


def print_summary(tracks: TrackSet, name: str) -> None:
    """What was read: rows read, used and refused, tracks, and the reader's notes."""
    summary = tracks.summary
    console.print(
        f"{name}: {summary.format}, rows read {summary.rows_read}, used {summary.rows_used}, "
        f"refused {summary.rows_refused}; {counted(len(tracks), 'track')}",
        markup=False,
    )
    for reason, count in summary.refused.items():
        console.print(f"  refused {count}: {reason}", markup=False)
    for note in summary.notes:
        console.print(f"  note: {note}", markup=False)


def counted(count: int, noun: str) -> str:
    """A number and its noun, with an s where there are several."""
    return f"{count} {noun}" if count == 1 else f"{count} {noun}s"


def print_table(title: str, rows: Sequence[Mapping[str, Any]]) -> None:
    """Rows as a table on standard output; the columns are the keys of the first row."""
    if not rows:
        return
    table = Table(title=title, title_justify="left", box=SIMPLE_HEAD, padding=0, show_edge=False)
    for column, first in rows[0].items():
        # Phrases may be folded where the terminal is narrow, numbers and single words never.
        phrases = any(" " in str(row[column]) for row in rows)
        table.add_column(column, justify="left" if isinstance(first, str) else "right", no_wrap=not phrases)
    for row in rows:
        table.add_row(*(_cell(value) for value in row.values()))
    to = Console(highlight=False)
    if not to.is_terminal:
        to = Console(highlight=False, width=WIDE)
    to.print(table)
    to.print()


def _cell(value: Any) -> str:
    if value is None or value != value:
        return "–"
    return f"{value:.3g}" if isinstance(value, float) else str(value)
