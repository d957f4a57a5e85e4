"""Messages, tables, files and progress of the commands, and how a program ends: one line and a status."""

from __future__ import annotations

import atexit
import gc
import json
import logging
import re
import sys
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer
from rich.box import SIMPLE_HEAD
from rich.cells import cell_len
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table

from graphtrack.errors import GraphtrackError, InputWarning
from graphtrack.io.atomic import ERRORS, described
from graphtrack.tracks.display import counted

if TYPE_CHECKING:
    from graphtrack.tracks.track import ReadSummary, TrackSet


_CONTROL = re.compile(r"(?:\x1b\[|\x9b)[0-?]*[ -/]*[@-~]|[\x00-\x09\x0b-\x1f\x7f-\x9f]")
"""Escape sequences such as colours and movements (CSI), and every control character but the line feed."""


def printable(text: str, *, one_line: bool = False) -> str:
    """A text without escape sequences and control characters, and with ? for what is no character.

    Names and labels come from files, and must not steer the terminal that shows them.

    Parameters
    ----------
    one_line : whether line feeds become spaces
    """
    text = _CONTROL.sub("", text.replace("\t", " ")).encode(errors="replace").decode()
    return " ".join(text.splitlines()) if one_line else text


class PlainConsole(Console):
    """A console that prints text as it is, without markup and emoji, as far as it is `printable`."""

    def __init__(self, **options: Any) -> None:
        super().__init__(highlight=False, markup=False, emoji=False, **options)

    def print(self, *objects: Any, **options: Any) -> None:
        """Print as `rich.console.Console` does."""
        super().print(*(printable(o) if isinstance(o, str) else o for o in objects), **options)


console = PlainConsole(stderr=True, soft_wrap=True)
"""Messages go to standard error, so that standard output stays free for data."""

BAD_INPUT = 2


def emit(text: str) -> None:
    """Print a message on standard error."""
    console.print(text)


def write_json(path: Path | None, content: object) -> None:
    """Write numbers as JSON, where that is asked for."""
    if path is None:
        return
    from graphtrack.io.atomic import atomic_path

    with atomic_path(path) as temporary:
        temporary.write_text(json.dumps(content, indent=1, ensure_ascii=False), encoding="utf-8")
    emit(f"wrote {path}")


def save_figure(figure: Any, path: Path, dpi: int = 120) -> None:
    """Write a figure as PNG, and report it."""
    from graphtrack.io.atomic import atomic_path

    with atomic_path(path) as temporary:
        figure.savefig(temporary, format="png", dpi=dpi)
    emit(f"wrote {path}")


_LONGEST = 2000
"""Characters of an error message, beyond which its middle is left out."""

WIDE = 160
"""Columns of a table that goes into a file or a pipe, where no terminal says how many there are."""


def fail(message: str) -> None:
    """Print one line of error and end with status 2."""
    message = printable(message, one_line=True)
    if len(message) > _LONGEST:
        message = f"{message[: _LONGEST // 2]} … {message[-_LONGEST // 2 :]}"
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


class _Printed(logging.Handler):
    """Print log records as messages; above a progress bar, where there is one."""

    def emit(self, record: logging.LogRecord) -> None:
        emit(record.getMessage())


@contextmanager
def printed_log() -> Iterator[None]:
    """Print the log, which tells of what takes long without a progress bar, such as compiling."""
    handler, logger = _Printed(), logging.getLogger("graphtrack")
    logger.addHandler(handler)
    try:
        yield
    finally:
        logger.removeHandler(handler)


@contextmanager
def quiet_input_warnings() -> Iterator[None]:
    """Readers warn and write the same in the summary's notes; the command line shows the notes."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", InputWarning)
        yield


@contextmanager
def input_warnings_as_notes() -> Iterator[None]:
    """Collect warnings about the input and print each once in the end, as the readers' notes are."""
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
        emit(f"  note: {message}")


def write_tracks(tracks: TrackSet, output: Path) -> None:
    """Write tracks in the format that the file name asks for, and print what its writer notes."""
    from graphtrack.io.read_write import write

    with input_warnings_as_notes():
        write(tracks, output)


def print_summary(tracks: TrackSet, name: str) -> None:
    """Print rows read, used and refused, tracks, and the reader's notes."""
    print_reading(tracks.summary, len(tracks), name)


def print_reading(summary: ReadSummary, tracks: int, name: str) -> None:
    """Print the summary of the input ``name``, and how many tracks it made."""
    emit(
        f"{printable(name, one_line=True)}: {summary.format}, rows read {summary.rows_read}, "
        f"used {summary.rows_used}, refused {summary.rows_refused}; {counted(tracks, 'track')}",
    )
    for reason, count in summary.refused.items():
        emit(f"  refused {count}: {reason}")
    for note in summary.notes:
        emit(f"  note: {note}")


def print_table(title: str, rows: Sequence[Mapping[str, Any]]) -> None:
    """Rows as a table on standard output; the columns are the keys of the first row.

    Headings and phrases are folded between words; a table that is still too wide for the terminal is not cut.
    """
    if not rows:
        return
    table = Table(title=printable(title), title_justify="left", box=SIMPLE_HEAD, padding=0, show_edge=False)
    for key, first in rows[0].items():
        words = [word for row in rows for word in _cell(row[key]).split()] + printable(key).split()
        table.add_column(
            printable(key),
            justify="left" if isinstance(first, str) else "right",
            vertical="top",
            min_width=max(map(cell_len, words), default=0),
        )
    for row in rows:
        table.add_row(*(_cell(row[key]) for key in rows[0]))
    to = PlainConsole()
    width = to.width if to.is_terminal else WIDE
    needed = sum(column.min_width or 0 for column in table.columns) + len(table.columns) - 1
    PlainConsole(width=max(width, needed)).print(table)
    to.print()


def _cell(value: Any) -> str:
    if value is None or value != value:
        return "–"
    return shown_number(value) if isinstance(value, float) else printable(str(value), one_line=True)


def shown_number(value: float) -> str:
    """Three digits that count; no exponent where thousands and millions can be read."""
    short = f"{value:.3g}"
    return f"{float(short):,.0f}" if "e+" in short and abs(value) < 1e9 else short


UsageError: Any = typer.BadParameter.__base__
"""Click's error of that name, which typer brings along or imports, depending on its version."""


def fail_usage(error: Any) -> None:
    """Say in one line what is wrong with the arguments, and end with status 2."""
    message = " ".join(error.format_message().split()).rstrip(".")
    if not message:  # no arguments at all: the help has been printed
        raise SystemExit(BAD_INPUT)
    command = getattr(error.ctx, "command_path", "graphtrack")
    fail(f"{message}; see '{command} --help'")


def leave_garbage() -> None:
    """Let what is there when the process ends go with it: to look for garbage takes a third of a second."""
    # What nanobind has bound would complain of what nobody took away.
    if not {"_duckdb", "onnx"} & sys.modules.keys():
        gc.freeze()


def run_app(program: typer.Typer, name: str) -> None:
    """Run an application: wrong use and bad input end with one line and exit status 2.

    Raises
    ------
    KeyboardInterrupt
        At Ctrl-C, also where a library has replaced it by an error of its own.
    """
    atexit.register(leave_garbage)
    # Importing and compiling keep what they make: looking for garbage took a tenth of a short command.
    gc.set_threshold(100_000, 20, 50)
    try:
        with printed_log():
            code = program(prog_name=name, standalone_mode=False)
        raise SystemExit(code or 0)
    except UsageError as error:
        fail_usage(error)
    except GraphtrackError as error:
        fail(str(error))
    except typer.Abort:
        raise KeyboardInterrupt from None
    except Exception as error:
        if _is_interrupt(error):
            raise KeyboardInterrupt from None
        if not isinstance(error, ERRORS):
            raise
        place = f"{error.filename}: " if isinstance(error, OSError) and error.filename else ""
        fail(f"{place}{described(error)}")


def _is_interrupt(error: BaseException | None) -> bool:
    """Return True if an error was raised because of Ctrl-C."""
    seen: set[int] = set()
    while error is not None and id(error) not in seen:
        if isinstance(error, KeyboardInterrupt):
            return True
        seen.add(id(error))
        error = error.__cause__ or error.__context__
    return False
