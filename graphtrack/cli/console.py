"""Messages, tables, files and progress of the commands, and exit with one line and a status."""

from __future__ import annotations

import atexit
import gc
import json
import logging
import re
import shlex
import sys
import time
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any
from unicodedata import category

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
"""Escape sequences such as colours and movements (CSI), and all control characters except the line feed."""

_JOINERS = "\u200c\u200d"  # within words of some scripts, and emoji


def printable(text: str, *, one_line: bool = False) -> str:
    """Return a text without escape sequences and control characters; invalid characters become ?.

    Names and labels come from files, and must not control the terminal. Characters without a shape of their
    own, such as those that reverse the direction of writing, are left out too.

    Parameters
    ----------
    one_line : replace line feeds by spaces
    """
    text = _CONTROL.sub("", text.replace("\t", " ")).encode(errors="replace").decode()
    if not text.isascii():
        text = "".join(one for one in text if one in _JOINERS or category(one) not in ("Cf", "Zl", "Zp"))
    return " ".join(text.splitlines()) if one_line else text


class PlainConsole(Console):
    """Console that prints `printable` text without interpreting markup or emoji."""

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
    """Write numbers as JSON, if a path is given."""
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
"""Longest error message in characters; the middle of a longer message is left out."""

WIDE = 160
"""Width in columns of a table written to a file or a pipe."""


def fail(message: str) -> None:
    """Print an error in one line and exit with status 2."""
    message = printable(message, one_line=True)
    if len(message) > _LONGEST:
        message = f"{message[: _LONGEST // 2]} … {message[-_LONGEST // 2 :]}"
    print(f"error: {message}", file=sys.stderr)
    raise SystemExit(BAD_INPUT)


_REPORTED_AFTER = 20.0  # seconds between lines of progress without a terminal


@contextmanager
def progress_bar(total: int | None, unit: str = "person-frames") -> Iterator[Callable[..., None]]:
    """Show a progress bar on standard error, or lines where that is no terminal.

    Yields the function that advances it: it takes the number of steps done since the last call, and the total
    where that was not known.
    """
    if not console.is_terminal:
        yield _progress_lines(total, unit)
        return
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn(unit),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=console, transient=True) as progress:
        task = progress.add_task("", total=total)
        yield lambda count, total=None: progress.update(task, advance=count, total=total)


def _progress_lines(total: int | None, unit: str) -> Callable[..., None]:
    """Return a function that advances progress, and reports it in a line if that takes long."""
    done, all_of_it, reported = 0, total, time.monotonic()

    def advance(count: int, total: int | None = None) -> None:
        nonlocal done, all_of_it, reported
        done, all_of_it = done + count, all_of_it if total is None else total
        if time.monotonic() - reported >= _REPORTED_AFTER:
            reported = time.monotonic()
            emit(f"{done:,}{'' if all_of_it is None else f' of {all_of_it:,}'} {unit} …")

    return advance


class _Printed(logging.Handler):
    """Print log records as messages, above a progress bar if one is shown."""

    def emit(self, record: logging.LogRecord) -> None:
        emit(record.getMessage())


@contextmanager
def printed_log() -> Iterator[None]:
    """Print the log, which reports slow steps without a progress bar, such as compiling."""
    handler, logger = _Printed(), logging.getLogger("graphtrack")
    logger.addHandler(handler)
    try:
        yield
    finally:
        logger.removeHandler(handler)


@contextmanager
def printed_warnings() -> Iterator[None]:
    """Print warnings about the input as notes, without a place in the source."""
    with warnings.catch_warnings():
        show = warnings.showwarning

        def printed(message: Warning | str, category: type[Warning], *rest: Any) -> None:
            if issubclass(category, InputWarning):
                emit(f"  note: {message}")
            else:
                show(message, category, *rest)

        warnings.showwarning = printed  # type: ignore[assignment]
        yield


@contextmanager
def quiet_input_warnings() -> Iterator[None]:
    """Ignore readers' warnings: the command line prints the same text from the summary's notes."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", InputWarning)
        yield


@contextmanager
def input_warnings_as_notes() -> Iterator[None]:
    """Collect warnings about the input, and print each once at the end, like the readers' notes."""
    printed: dict[str, None] = {}
    with warnings.catch_warnings():
        warnings.simplefilter("always", InputWarning)
        show = warnings.showwarning

        def collect(message: Warning | str, category: type[Warning], *rest: Any) -> None:
            if issubclass(category, InputWarning):
                printed[str(message)] = None
            else:
                show(message, category, *rest)

        warnings.showwarning = collect  # type: ignore[assignment]
        yield
    for message in printed:
        emit(f"  note: {message}")


def option_name(name: str) -> str:
    """Return the command-line spelling of an option from its field name."""
    return "--class" if name == "classes" else f"--{name.replace('_', '-')}"


def command_line(words: Sequence[str], options: Mapping[str, Any]) -> str:
    """Return words and options, by their field names, as they are typed in a shell."""
    typed = [*words]
    for name, value in options.items():
        for one in value if isinstance(value, list) else [value]:
            typed += [option_name(name), f"{one:g}" if isinstance(one, float) else str(one)]
    return printable(shlex.join(typed), one_line=True)


def write_tracks(
    tracks: TrackSet, output: Path, *, spreadsheet: bool = False, intervals: float | None = None
) -> None:
    """Write tracks in the format given by the file name; print the writer's notes, and how a table is read.

    ``spreadsheet``: see `graphtrack.write`; ``intervals``: per cent, or None
    """
    from graphtrack.io.options import options_to_read
    from graphtrack.io.read_write import write
    from graphtrack.io.registry import format_for_writing
    from graphtrack.tracks.track import columns_as_read

    with input_warnings_as_notes():
        share = None if intervals is None else intervals / 100.0
        write(tracks, output, spreadsheet=spreadsheet, intervals=share)
    if tracks.as_read is None or format_for_writing(output).write_columns is None:
        return
    if again := options_to_read(tracks.as_read, columns_as_read(tracks[:1]).keys()):
        emit(f"  {output} is read by: {command_line([], again)}")


def print_summary(tracks: TrackSet, name: str) -> None:
    """Print the numbers of rows read, used and refused, the tracks, and the reader's notes."""
    print_reading(tracks.summary, len(tracks), name)


def print_reading(summary: ReadSummary, tracks: int, name: str) -> None:
    """Print the summary of the input ``name``, and its number of tracks."""
    emit(
        f"{printable(name, one_line=True)}: {summary.format}, rows read {summary.rows_read}, "
        f"used {summary.rows_used}, refused {summary.rows_refused}; {counted(tracks, 'track')}",
    )
    for reason, count in summary.refused.items():
        emit(f"  refused {count}: {reason}")
    for note in summary.notes:
        emit(f"  note: {note}")


def print_table(title: str, rows: Sequence[Mapping[str, Any]]) -> None:
    """Print rows as a table on standard output; the columns are the keys of the first row.

    Headings and phrases are wrapped between words; a table that is still too wide is not cut.
    """
    if not rows:
        return
    table = Table(title=printable(title), title_justify="left", box=SIMPLE_HEAD, padding=0, show_edge=False)
    columns = [[printable(key), *(_cell(row[key]) for row in rows)] for key in rows[0]]
    to = PlainConsole()
    available = (to.width if to.is_terminal else WIDE) - len(columns) + 1
    widths = column_widths(columns, available)
    for (heading, *_), first, width in zip(columns, rows[0].values(), widths, strict=True):
        table.add_column(
            heading, justify="left" if isinstance(first, str) else "right", vertical="top", width=width
        )
    for cells in zip(*(cells for _, *cells in columns), strict=True):
        table.add_row(*cells)
    PlainConsole(width=max(available, sum(widths)) + len(columns) - 1).print(table)
    to.print()


def column_widths(columns: Sequence[Sequence[str]], available: int) -> list[int]:
    """Return the widths of columns of text, at most ``available`` together if no word is to be cut.

    The widest column that can be wrapped between words is narrowed first.
    """
    widths = [max(map(cell_len, cells), default=0) for cells in columns]
    words = [max((cell_len(word) for cell in cells for word in cell.split()), default=0) for cells in columns]
    while sum(widths) > available:
        wider = [k for k, width in enumerate(widths) if width > words[k]]
        if not wider:
            break
        widths[max(wider, key=widths.__getitem__)] -= 1
    return widths


def _cell(value: Any) -> str:
    if value is None or value != value:
        return "–"
    return shown_number(value) if isinstance(value, float) else printable(str(value), one_line=True)


def shown_number(value: float) -> str:
    """Format a number with three significant digits; no exponent for thousands and millions."""
    short = f"{value:.3g}"
    return f"{float(short):,.0f}" if "e+" in short and abs(value) < 1e9 else short


UsageError: Any = typer.BadParameter.__base__
"""Click's error of that name, which typer vendors or imports, depending on its version."""


def fail_usage(error: Any) -> None:
    """Report wrong arguments in one line, and exit with status 2."""
    message = " ".join(error.format_message().split()).rstrip(".")
    if not message:  # no arguments at all: the help has been printed
        raise SystemExit(BAD_INPUT)
    command = getattr(error.ctx, "command_path", "graphtrack")
    fail(f"{message}; see '{command} --help'")


def leave_garbage() -> None:
    """Skip garbage collection when the process ends; it would take a third of a second."""
    # nanobind would report the objects that were not collected as leaks.
    if not {"_duckdb", "onnx"} & sys.modules.keys():
        gc.freeze()


def run_app(program: typer.Typer, name: str) -> None:
    """Run an application; wrong usage and bad input end with one line and exit status 2.

    Raises
    ------
    KeyboardInterrupt
        At Ctrl-C, even if a library has replaced it by another error.
    """
    atexit.register(leave_garbage)
    # Importing and compiling create few garbage objects: collecting took a tenth of a short command.
    gc.set_threshold(100_000, 20, 50)
    try:
        with printed_log(), printed_warnings():
            code = program(prog_name=name, standalone_mode=False)
        raise SystemExit(code or 0)
    except UsageError as error:
        fail_usage(error)
    except GraphtrackError as error:
        fail(str(error))
    except typer.Abort as error:
        # Typer raises it for Ctrl-C, and for a file that ends too early.
        if not isinstance(error.__cause__, EOFError) or _is_interrupt(error):
            raise KeyboardInterrupt from None
        _fail_with(error.__cause__)
    except Exception as error:
        if _is_interrupt(error):
            raise KeyboardInterrupt from None
        _fail_with(error)


def _fail_with(error: Exception) -> None:
    """Exit with one line for an error of a file or of the machine; raise any other."""
    compilation = sys.modules.get("graphtrack.kernels.compilation")
    if compilation is not None and compilation.is_of_kept_code(error):
        folder = compilation.machine_code_folder()
        compilation.discard()
        fail(f"machine code in {folder} cannot be used ({described(error)}) and was deleted; run it again")
    if not isinstance(error, ERRORS):
        raise error
    place = f"{error.filename}: " if isinstance(error, OSError) and error.filename else ""
    fail(f"{place}{described(error)}")


def _is_interrupt(error: BaseException | None) -> bool:
    """Return True if an error was raised because of Ctrl-C."""
    visited: set[int] = set()
    while error is not None and id(error) not in visited:
        if isinstance(error, KeyboardInterrupt):
            return True
        visited.add(id(error))
        error = error.__cause__ or error.__context__
    return False
