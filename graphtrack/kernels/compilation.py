"""Compilation by numba's public decorator, cached on disk, releasing the interpreter's lock.

`compiled` declares a function, `allocating` one that makes arrays; `make_ready` compiles ahead, with a log.
"""

from __future__ import annotations

import hashlib
import logging
import os
import re
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TypeVar, cast

import numpy as np

from graphtrack.errors import InputError
from graphtrack.tracks.track import Track

try:
    import numba
except ValueError as error:  # numba reads its settings when it is imported
    settings = " ".join(f"{name}={value}" for name, value in os.environ.items() if name.startswith("NUMBA_"))
    expected = f"environment variables that numba takes (“{error}”)"
    raise InputError(settings or "settings that numba refuses", expected) from error

Function = TypeVar("Function", bound=Callable[..., object])

OPTIONS = {
    "nogil": True,
    "error_model": "numpy",
    # Sums may be reordered and fused; NaN and infinity stay valid ("nnan" would break isnan).
    "fastmath": {"contract", "reassoc", "nsz", "arcp"},
    "no_cfunc_wrapper": True,  # they are not called from C
}
INNER = {"_nrt": False, "no_cpython_wrapper": True}
"""Options of functions that only compiled code calls and that make no arrays."""

_NUMBERS = re.compile(r"(None|bool|int|float|Any|tuple|\W|\.\.\.)+")
"""Annotations of numbers; "Any": floats or `lanes`."""

_DECLARES = re.compile(rb"^@(compiled|inner|merged|allocating|inner_allocating)\b", re.MULTILINE)
"""Text that marks sources with compiled functions."""

_CACHE_DIR = threading.Lock()  # Held while numba's cache folder is changed


def compiled(function: Function, **options: bool) -> Function:
    """Compile a function that makes and returns no arrays, without reference counting of arrays.

    Raises
    ------
    TypeError
        If the annotation is not of numbers: numba would free an array in use.
    """
    annotation = getattr(function, "__annotations__", {}).get("return")
    returned = str(getattr(annotation, "__name__", annotation))
    if not _NUMBERS.fullmatch(returned):
        raise TypeError(f"{function.__name__} returns {returned}, expected numbers, or @allocating")
    return _declared(function, **{"_nrt": False, **options})


def inner(function: Function) -> Function:
    """`compiled`, for functions that only compiled code calls: without the wrapper for Python."""
    return compiled(function, **INNER)


def merged(function: Function) -> Function:
    """`compiled`, for a function with one caller, into which it is inlined."""
    return _declared(function, inline="always")


def allocating(function: Function) -> Function:
    """Compile a function that makes or returns arrays."""
    return _declared(function, _nrt=True)  # else it would be as its first caller is


def inner_allocating(function: Function) -> Function:
    """`allocating`, for functions that only compiled code calls."""
    return _declared(function, _nrt=True, no_cpython_wrapper=True)


def _declared(function: Function, **options: bool | str) -> Function:
    if numba.config.DISABLE_JIT:
        expected = "the environment variable NUMBA_DISABLE_JIT unset: the engines are compiled"
        raise InputError("compilation disabled by NUMBA_DISABLE_JIT", expected)
    home = machine_code_folder()
    if home is not None:
        # Numba reads the folder when a function is declared.
        with _CACHE_DIR:
            given, numba.config.CACHE_DIR = numba.config.CACHE_DIR, str(home)
            try:
                return cast(Function, numba.njit(cache=True, **OPTIONS, **options)(function))
            except RuntimeError:  # of a function without a file: from the prompt, or `exec`
                pass
            finally:
                numba.config.CACHE_DIR = given
    return cast(Function, numba.njit(**OPTIONS, **options)(function))


def machine_code_folder() -> Path | None:
    """The folder of machine code, in ``NUMBA_CACHE_DIR`` or the user's cache, one for each source state."""
    try:
        user = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "graphtrack"
        folder = Path(numba.config.CACHE_DIR or user) / _digest()
        folder.mkdir(parents=True, exist_ok=True)
    except (OSError, RuntimeError):  # RuntimeError: a user without a home
        return None
    return folder if os.access(folder, os.W_OK) else None


@cache
def _digest() -> str:
    """A digest of numba's version and of the sources in this package that declare compiled functions."""
    digest = hashlib.sha256(numba.__version__.encode())
    package = next(folder for folder in Path(__file__).parents if folder.name == "graphtrack")
    for path in sorted(package.rglob("*.py")):
        source = path.read_bytes()
        if path.parent == Path(__file__).parent or _DECLARES.search(source):
            digest.update(source)
    return digest.hexdigest()[:16]


logger = logging.getLogger("graphtrack")

UNNOTICED = 3.0  # Seconds of compiling up to which nothing is logged

TRACK = Track(0, np.arange(4), np.linspace(0.0, 0.3, 4), np.linspace(0.0, 1.0, 8).reshape(4, 2))
"""Synthetic track, 0.1 s per frame, for the first call of compiled functions."""

_READY = set[str]()  # Names of the rehearsals that this process has run


@dataclass(frozen=True)
class Rehearsal:
    """A small job with synthetic data that calls every compiled function of some kind of work.

    ``seconds`` : approximate processor time of compilation. Rehearsals of one name are run once.
    """

    name: str
    run: Callable[[], object]
    seconds: float

    def mark(self) -> Path | None:
        """The marker file of machine code on disk; None where no folder can keep it."""
        home = machine_code_folder()
        return None if home is None else home / f"{self.name.replace(' ', '-')}.compiled"

    def is_cold(self) -> bool:
        """Return True if nothing is compiled yet, neither in this process nor on disk."""
        mark = self.mark()
        return self.name not in _READY and (mark is None or not mark.exists())


def make_ready(what: str, *rehearsals: Rehearsal) -> None:
    """Run the rehearsals that this process has not run; a long compilation of ``what`` is logged."""
    waiting = [one for one in rehearsals if one.name not in _READY]
    expected = sum(one.seconds for one in waiting if one.is_cold())
    if expected >= UNNOTICED:
        kept = machine_code_folder() is not None
        when = "once on this machine" if kept else "in every process: it can be kept in no folder"
        logger.warning("compiling %s, %s: about %d s …", what, when, 5 * max(1, round(expected / 5)))
    start = time.perf_counter()
    for one in waiting:
        one.run()
        _READY.add(one.name)
        mark = one.mark()
        if mark is not None:
            mark.touch()
    if expected >= UNNOTICED:
        logger.warning("compiled in %.0f s", time.perf_counter() - start)


def processors() -> int:
    """The number of processors that this process may use."""
    try:
        return len(os.sched_getaffinity(0))
    except AttributeError:  # not on Linux
        return os.cpu_count() or 1
