"""Rerun recording: its destination, and rows of entities with their times."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray
from graphtrack.io.atomic import atomic_path

TIME, FRAME = "time", "frame"
"""The time lines: seconds of the table, and its frames."""

CLOCK_TIMES = 1e6
"""Seconds from which times are clock times, since 1970, not times of a recording."""

_LATEST = 9e9
_PATIENCE = 10.0
_MEMORY = "2GB"

IntArray = NDArray[np.int64]


def rerun() -> Any:
    """The package ``rerun``.

    Raises
    ------
    InputError
        If it is not installed.
    """
    try:
        import rerun
        import rerun.blueprint
    except ModuleNotFoundError as error:
        raise InputError("no package rerun", "the extra: pip install 'graphtrack[view]'") from error
    return rerun


@dataclass(frozen=True)
class Target:
    """Destination of a view: a file, a running viewer, or else a new window.

    Attributes
    ----------
    save : the file (.rrd)
    connect : the URL of the viewer, such as ``rerun+http://127.0.0.1:9876/proxy``
    """

    save: Path | None = None
    connect: str | None = None

    def check(self) -> None:
        """Refuse a destination that cannot be used.

        Raises
        ------
        InputError
            Without the package or a display, and for an invalid path or URL.
        """
        if find_spec("rerun") is None:
            rerun()
        if self.save is not None:
            if self.connect is not None:
                raise InputError("--save with --connect", "one of them")
            if self.save.suffix.lower() != ".rrd":
                raise InputError(f"the file name {self.save.name!r}", "the ending .rrd", path=self.save)
        elif self.connect is not None:
            schemes = ("rerun://", "rerun+http://", "rerun+https://")
            if not self.connect.startswith(schemes) or not self.connect.endswith("/proxy"):
                expected = "a URL such as rerun+http://127.0.0.1:9876/proxy"
                raise InputError(f"--connect {self.connect}", expected)
        elif sys.platform == "linux" and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
            raise InputError("no display", "a file to write (--save run.rrd), or a viewer (--connect URL)")


class LoggedEntities:
    """Entities of a recording, as columns with times.

    Parameters
    ----------
    clock : True if times are seconds since 1970
    """

    def __init__(self, *, clock: bool = False) -> None:
        self.rr = rerun()
        self.stream = self.rr.RecordingStream("graphtrack")
        self._clock = clock

    def static(self, path: str, *what: Any) -> None:
        """Log static properties of an entity."""
        self.stream.log(path, *what, static=True)

    def rows(self, path: str, t: FloatArray, frame: IntArray, *columns: Any) -> None:
        """Log rows of an entity.

        Parameters
        ----------
        t : (n,) seconds
        frame : (n,)
        columns : as archetypes of Rerun make them
        """
        if len(t):
            self.stream.send_columns(path, self._times(t, frame), *columns)

    def clear(self, path: str, t: FloatArray, frame: IntArray) -> None:
        """From these times (n,) on there is nothing of an entity, and of those below it."""
        if len(t):
            self.rows(path, t, frame, self.rr.Clear.columns(is_recursive=np.ones(len(t), bool)))

    def at(self, t: float, frame: int) -> None:
        """The time of what is logged next."""
        (time, number) = self._times(np.array([t]), np.array([frame]))
        kind = "timestamp" if self._clock else "duration"
        nanoseconds = np.array(time.as_arrow_array())[0]
        self.stream.set_time(TIME, **{kind: nanoseconds})
        self.stream.set_time(FRAME, sequence=int(np.array(number.as_arrow_array())[0]))

    def _times(self, t: FloatArray, frame: IntArray) -> list[Any]:
        if np.max(np.abs(t)) > _LATEST:
            raise InputError(
                f"a time of {np.max(np.abs(t)):g} s", f"times within ±{_LATEST:g} s, to view them"
            )
        nanoseconds = np.round(t * 1e9).astype(np.int64)
        column = self.rr.TimeColumn
        if self._clock:
            time = column(TIME, timestamp=nanoseconds.astype("datetime64[ns]"))
        else:
            time = column(TIME, duration=nanoseconds.astype("timedelta64[ns]"))
        return [time, column(FRAME, sequence=frame)]

    def arrange(self, layout: Any) -> None:
        """Rearrange the window."""
        self.stream.send_blueprint(layout)


@contextmanager
def recording(
    target: Target, layout: Any, *, clock: bool = False, complete: bool = True
) -> Iterator[LoggedEntities]:
    """A recording that goes to its target, complete at the end.

    Parameters
    ----------
    layout : of the window, as `graphtrack.viewer.layout` makes it
    clock : True if times are seconds since 1970
    complete : whether a file is there whole or not at all; else it grows, and what is in it can be seen

    Raises
    ------
    InputError
        If the file cannot be written, no window opened, or the viewer not reached.
    """
    if target.save is not None and complete:
        with (
            atomic_path(target.save) as temporary,
            recording(Target(temporary), layout, clock=clock, complete=False) as made,
        ):
            yield made
        return
    made = LoggedEntities(clock=clock)
    stream, options = made.stream, {"default_blueprint": layout}
    if target.save is not None:
        _or_error(target, lambda: stream.save(target.save, **options))
    elif target.connect is not None:
        _or_error(target, lambda: stream.connect_grpc(target.connect, **options))
    else:
        window = {"memory_limit": _MEMORY, "executable_path": _program(), "recording": stream}
        _or_error(target, lambda: made.rr.spawn(**window, **options))
    try:
        yield made
        _or_error(target, lambda: stream.flush(timeout_sec=_PATIENCE if target.save is None else 1e9))
    finally:
        stream.disconnect()


def _program() -> str | None:
    """The viewer that came with the package; another version may lie on the path."""
    found = find_spec("rerun_cli")
    if found is None or found.origin is None:
        return None
    program = Path(found.origin).with_name("rerun.exe" if sys.platform == "win32" else "rerun")
    return str(program) if program.is_file() else None


def _or_error(target: Target, act: Callable[[], object]) -> None:
    try:
        act()
    except (RuntimeError, ValueError, OSError) as error:
        found = " ".join(str(error).split())[:200]
        expected = "a viewer that listens there" if target.connect else "a window, or --save run.rrd"
        expected = "a place to write to" if target.save else expected
        raise InputError(found, expected, path=target.save or target.connect) from error
