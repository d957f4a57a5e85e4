"""Compilation by numba's public decorator, cached on disk, releasing the interpreter's lock.

`compiled` declares a function, `allocating` one that makes arrays; `make_ready` compiles ahead, with a log.
"""

from __future__ import annotations

import contextlib
import errno
import logging
import os
import re
import threading
import time
import traceback
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar, cast

import numpy as np

from graphtrack.errors import InputError
from graphtrack.machine_code import discard, machine_code_folder, mark, use_own_folder, why_not_kept
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

_CACHE_DIR = threading.Lock()  # Held while numba's cache folder is changed

_KEPT: list[Any] = []  # Declared functions whose machine code is kept


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


def kept(**options: Any) -> Callable[[Function], Function]:
    """Return a decorator: numba's ``njit`` with these options alone, and the machine code is kept."""
    return lambda function: _kept(function, **options)


def _declared(function: Function, **options: bool | str) -> Function:
    return _kept(function, **OPTIONS, **options)


def _kept(function: Function, **options: Any) -> Function:
    if numba.config.DISABLE_JIT:
        expected = "the environment variable NUMBA_DISABLE_JIT unset: the engines are compiled"
        raise InputError("compilation disabled by NUMBA_DISABLE_JIT", expected)
    found = numba.njit(**options)(function)
    home = machine_code_folder()
    if home is not None:
        try:
            _keep_in(home, [found])
        except RuntimeError:  # of a function without a file: from the prompt, or `exec`
            pass
        else:
            _KEPT.append(found)
    return cast(Function, found)


def _keep_in(home: Path, functions: Iterable[Any]) -> None:
    """Keep the machine code of declared functions in a folder."""
    # Numba reads the setting when caching is enabled.
    with _CACHE_DIR:
        given, numba.config.CACHE_DIR = numba.config.CACHE_DIR, str(home)
        try:
            for function in functions:
                function.enable_caching()
        finally:
            numba.config.CACHE_DIR = given


logger = logging.getLogger("graphtrack")

UNNOTICED = 3.0  # Seconds of compiling up to which nothing is logged

_ATTEMPTS = 3  # Runs of a rehearsal: with kept machine code, compiled again, and kept elsewhere

_READS_AND_WRITES = ("numba", "core", "caching.py")
"""End of the path of numba's module that does so, as tracebacks have it."""

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

    def is_cold(self) -> bool:
        """Return True if nothing is compiled yet, neither in this process nor on disk."""
        there = mark(self.name)
        return self.name not in _READY and (there is None or not there.exists())


def make_ready(what: str, *rehearsals: Rehearsal) -> None:
    """Run the rehearsals that this process has not run; a long compilation of ``what`` is logged."""
    waiting = [one for one in rehearsals if one.name not in _READY]
    expected = sum(one.seconds for one in waiting if one.is_cold())
    if expected >= UNNOTICED:
        reason = why_not_kept()
        when = f"in every process: {reason}" if reason else "once on this machine"
        logger.warning("compiling %s, %s: about %d s …", what, when, 5 * max(1, round(expected / 5)))
    start = time.perf_counter()
    for one in waiting:
        _READY.add(one.name)  # what the rehearsal calls asks for it too
        try:
            _rehearse(one)
        except BaseException:
            _READY.discard(one.name)
            raise
        there = mark(one.name)
        if there is not None:
            with contextlib.suppress(OSError):  # a full disk
                there.touch()
    if expected >= UNNOTICED:
        logger.warning("compiled in %.0f s", time.perf_counter() - start)


def _rehearse(one: Rehearsal) -> None:
    """Run a rehearsal; machine code that cannot be read is replaced, or else kept for this process alone."""
    for attempt in range(_ATTEMPTS):
        try:
            one.run()
            return
        except Exception as error:
            if not is_of_kept_code(error) or attempt == _ATTEMPTS - 1:
                raise
            full = isinstance(error, OSError) and error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
            _replace_kept_code(error, damaged=not attempt and not full)


def _replace_kept_code(error: Exception, *, damaged: bool) -> None:
    """Delete damaged machine code, or keep it elsewhere."""
    folder, reason = machine_code_folder(), " ".join(str(error).split()) or type(error).__name__
    if damaged:
        logger.warning("machine code in %s cannot be read (%s): compiling again …", folder, reason)
        discard()
        return
    logger.warning("machine code in %s cannot be used (%s): compiling for this process …", folder, reason)
    _keep_in(use_own_folder(), _KEPT)


def is_of_kept_code(error: Exception) -> bool:
    """Return True if an error was raised where numba reads or writes machine code, not where it compiles."""
    frames = (frame for frame, _ in traceback.walk_tb(error.__traceback__))
    return any(Path(frame.f_code.co_filename).parts[-3:] == _READS_AND_WRITES for frame in frames)


def processors() -> int:
    """The number of processors that this process may use."""
    try:
        return len(os.sched_getaffinity(0))
    except AttributeError:  # not on Linux
        return os.cpu_count() or 1
