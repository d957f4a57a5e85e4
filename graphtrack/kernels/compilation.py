"""Compilation by numba's public decorator, cached on disk, releasing the interpreter's lock.

`compiled` declares a function, `allocating` one that makes arrays; `make_ready` compiles ahead, in several
processes, with a log.
"""

from __future__ import annotations

import contextlib
import errno
import logging
import os
import pickle
import re
import subprocess
import sys
import threading
import time
import traceback
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar, cast

import numpy as np

from graphtrack.errors import InputError
from graphtrack.machine_code import (
    discard,
    folder_of,
    is_marked,
    machine_code_folder,
    mark,
    use_own_folder,
    why_not_kept,
)
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

_NUMBERS = ("None", "bool", "int", "float", "Any", "tuple")
"""Annotations of numbers."""

_CACHE_DIR = threading.Lock()  # Held while numba's cache folder is changed

_KEPT = dict[Any, None]()  # Declared functions whose machine code is kept

_FOLDERS = dict[tuple[str, str], Path | None]()  # Folder of a source file, for numba's setting


def compiled(function: Function, **options: bool) -> Function:
    """Compile a function that makes and returns no arrays, without reference counting of arrays.

    Raises
    ------
    TypeError
        If the annotation is not of numbers: numba would free an array in use.
    """
    annotation = getattr(function, "__annotations__", {}).get("return")
    returned = str(getattr(annotation, "__name__", annotation))
    if not _is_of_numbers(returned, getattr(function, "__globals__", {})):
        raise TypeError(f"{function.__name__} returns {returned}, expected numbers, or @allocating")
    return _declared(function, **{"_nrt": False, **options})


def _is_of_numbers(annotation: Any, known: Mapping[str, object]) -> bool:
    """Return True for numbers, tuples of them, and named tuples with fields of them."""
    text = str(getattr(annotation, "__forward_arg__", annotation))
    return all(
        name in _NUMBERS or _is_of_numbers_alone(known.get(name), known) for name in re.findall(r"\w+", text)
    )


def _is_of_numbers_alone(kind: object, known: Mapping[str, object]) -> bool:
    fields = getattr(kind, "__annotations__", {})
    return bool(fields) and all(_is_of_numbers(field, known) for field in fields.values())


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
    with contextlib.suppress(RuntimeError):  # of a function without a file: from the prompt, or `exec`
        _keep([found])
    return cast(Function, found)


def _keep(functions: Sequence[Any]) -> None:
    """Keep the machine code of declared functions in the folders of their sources."""
    # Numba reads the setting when caching is enabled.
    with _CACHE_DIR:
        given = numba.config.CACHE_DIR
        sources = {function.py_func.__code__.co_filename for function in functions}
        for key in {(source, given) for source in sources}.difference(_FOLDERS):
            _FOLDERS[key] = folder_of(key[0])
        try:
            for function in functions:
                if (folder := _FOLDERS[function.py_func.__code__.co_filename, given]) is not None:
                    numba.config.CACHE_DIR = str(folder)
                    function.enable_caching()
                    _KEPT.setdefault(function)
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
    """A small job with synthetic data that calls every compiled function of some kind of work, run once.

    Attributes
    ----------
    run : the job; another process can do it if it can be pickled
    seconds : approximate processor time of compilation, without the parts
    parts : independent rehearsals of functions that it calls, for other processes to compile first
    """

    name: str
    run: Callable[[], object]
    seconds: float
    parts: tuple[Rehearsal, ...] = ()

    def is_cold(self) -> bool:
        """Return True if nothing is compiled yet, neither in this process nor on disk."""
        return self.name not in _READY and not is_marked(self.name)


def make_ready(what: str, *rehearsals: Rehearsal) -> None:
    """Run the rehearsals that this process has not run; a long compilation of ``what`` is logged."""
    waiting = [one for one in rehearsals if one.name not in _READY]
    rounds = _shared(waiting)
    expected = sum(max(sum(one.seconds for one in some) for some in shares) for shares in rounds)
    if expected >= UNNOTICED:
        reason = why_not_kept()
        count = max(map(len, rounds))
        when = f"in every process: {reason}" if reason else "once on this machine"
        when += f", in {count} processes" if count > 1 else ""
        logger.warning("compiling %s, %s: from %d s on …", what, when, 5 * max(1, round(expected / 5)))
    start = time.perf_counter()
    for own, *elsewhere in rounds:
        _compile_together(own, elsewhere)
    for one in waiting:
        _make_ready(one)
    if expected >= UNNOTICED:
        logger.warning("compiled in %.0f s", time.perf_counter() - start)


def _shared(waiting: Sequence[Rehearsal]) -> list[list[list[Rehearsal]]]:
    """Return rounds of compilation, each a list of rehearsals for each process, the first for this one.

    The parts come first. Without a folder that keeps machine code this process does all.
    """
    cold = [one for one in waiting if one.is_cold()]
    parts = {part.name: part for one in cold for part in one.parts if part.is_cold()}
    rounds = []
    for some in (list(parts.values()), cold):
        share = 1 if why_not_kept() or not sys.executable else min(processors(), len(some))
        processes: list[list[Rehearsal]] = [[] for _ in range(share)]
        for one in sorted(some, key=lambda one: -one.seconds):
            min(processes, key=lambda own: sum(one.seconds for one in own)).append(one)
        if some:
            rounds.append(processes)
    return rounds


_HELP = "from graphtrack.kernels import compilation; compilation._help()"


def _help() -> None:
    """Run the rehearsals on standard input, in a process of `_compile_together`."""
    for one in pickle.load(sys.stdin.buffer):
        _make_ready(one)


def _compile_together(own: Sequence[Rehearsal], elsewhere: Sequence[Sequence[Rehearsal]]) -> None:
    """Run rehearsals here, and lists of rehearsals each in a process that keeps its code on disk.

    What a process fails to compile, this one compiles when it runs the same rehearsal.
    """
    path = os.pathsep.join(str(Path(place).absolute()) for place in sys.path)
    environment = {**os.environ, "PYTHONPATH": path, "OPENBLAS_NUM_THREADS": "1"}
    if numba.config.CACHE_DIR:
        environment["NUMBA_CACHE_DIR"] = str(numba.config.CACHE_DIR)
    silent: dict[str, Any] = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    helpers: list[subprocess.Popen[bytes]] = []
    try:
        for some in elsewhere:
            # A script's own objects may not be importable, and a process may not start.
            with contextlib.suppress(OSError, pickle.PicklingError, AttributeError, TypeError):
                text = pickle.dumps(some)
                command = [sys.executable, "-P", "-c", _HELP]
                helper = subprocess.Popen(command, stdin=subprocess.PIPE, env=environment, **silent)
                helpers.append(helper)
                assert helper.stdin is not None
                helper.stdin.write(text)
                helper.stdin.close()
        for one in own:
            _make_ready(one)
        for helper in helpers:
            helper.wait()
    finally:
        for helper in helpers:
            helper.kill()
            helper.wait()


def _make_ready(one: Rehearsal) -> None:
    """Run a rehearsal that this process has not run, and mark it as compiled."""
    if one.name in _READY:
        return
    _READY.add(one.name)  # what the rehearsal calls asks for it too
    try:
        _rehearse(one)
    except BaseException:
        _READY.discard(one.name)
        raise
    mark(one.name, {function.py_func.__code__.co_filename for function in _KEPT})


def compile_for(function: Callable[..., object], *arguments: object) -> None:
    """Compile a declared function for the types of arguments, without calling it."""
    cast(Any, function).compile(tuple(numba.typeof(one) for one in arguments))


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
    use_own_folder()
    _FOLDERS.clear()
    _keep(list(_KEPT))


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
