"""Compiling in a second process beside this one: numba compiles in one thread at a time."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

from numba.core.dispatcher import Dispatcher

from graphtrack.model.kernels.compiled import cache_home

_DONE = "machine code is there"
"""What the other process writes once all that is waited for is there."""
_OWN = "compiling-"
"""Begins the names of folders that another process writes to."""
_LONG = 3600.0
"""Seconds after which nobody compiles any more."""


def processors() -> int:
    """The processors that this process may use."""
    try:
        return len(os.sched_getaffinity(0))
    except AttributeError:  # not on Linux
        return os.cpu_count() or 1


@contextmanager
def compiled_beside(statements: Sequence[str], spare: Sequence[str] = ()) -> Iterator[Callable[[], None]]:
    """Execute statements in another process while the block runs, for the machine code that they leave.

    What is given to the block waits until they are done; then their machine code can be loaded. Those that
    are ``spare`` follow, as far as they come before the block ends. Whatever goes wrong there is compiled
    here when it is called. There is no other process where there is one processor, or no folder that machine
    code is kept in.
    """
    home = cache_home()
    if not statements or home is None or not sys.executable or processors() < 2:
        yield lambda: None
        return
    # A folder of its own: two processes that write about one function at once would spoil each other's work.
    own = Path(tempfile.mkdtemp(prefix=_OWN, dir=home))
    try:
        _remove_leftovers(home)
        _seed(home, own)
        # It ends soon: collecting its garbage would take a sixth of its time.
        first = f"import gc, os, sys; gc.disable(); sys.path[:] = {sys.path!r}"
        # Where this process has been killed, nobody takes over what is spare.
        wanted = f"os.getppid() == {os.getpid()} or sys.exit()"
        lines = (first, *statements, f"print({_DONE!r}, flush=True)")
        lines += tuple(line for one in spare for line in (wanted, one))
        with subprocess.Popen(
            [sys.executable, "-c", "\n".join(lines)],
            env={**os.environ, "NUMBA_CACHE_DIR": str(own)},
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
        ) as other:
            assert other.stdout is not None
            said = map(str.strip, other.stdout)
            try:
                yield lambda: _take_over(own, home) if _DONE in said else None
            finally:
                other.kill()
        _take_over(own, home)
    finally:
        shutil.rmtree(own, ignore_errors=True)


def _remove_leftovers(home: Path) -> None:
    """Remove the folders of processes that were killed: those that nobody has begun within the hour."""
    for folder in home.glob(f"{_OWN}*"):
        with suppress(OSError):
            if time.time() - folder.stat().st_mtime > _LONG:
                shutil.rmtree(folder, ignore_errors=True)


def _seed(home: Path, own: Path) -> None:
    """Put the machine code into another folder that modules of this process have on disk."""
    functions = [
        function
        for name, module in list(sys.modules.items())
        if name.partition(".")[0] == __name__.partition(".")[0]
        for function in list(vars(module).values())
        if isinstance(function, Dispatcher)
    ]
    known = {function.stats.cache_path for function in functions}
    for folder in (Path(path) for path in known if path and Path(path).is_relative_to(home)):
        for path in folder.glob("*.nb[ic]"):
            _link(path, own / path.relative_to(home))


def _link(path: Path, to: Path) -> None:
    """Have a file in two places; numba replaces files and never writes to one."""
    to.parent.mkdir(parents=True, exist_ok=True)
    try:
        to.hardlink_to(path)
    except OSError:
        shutil.copyfile(path, to)


def _take_over(own: Path, home: Path) -> None:
    """Move the machine code of functions that have none in ``home``; an index last, which names the rest."""
    for index in own.rglob("*.nbi"):
        to, codes = home / index.relative_to(own), list(index.parent.glob(f"{index.stem}.*.nbc"))
        # An index is written before the code that it names.
        if to.exists() or not codes:
            continue
        to.parent.mkdir(parents=True, exist_ok=True)
        for code in codes:
            code.replace(to.parent / code.name)
        index.replace(to)
