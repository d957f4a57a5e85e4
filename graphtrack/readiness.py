"""Machine code before it is needed: which compiled functions lack it, and what is said while they get it."""

from __future__ import annotations

import gc
import logging
import sys
import threading
import time
from collections.abc import Callable, Container, Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

logger = logging.getLogger("graphtrack")

CompiledFunction = Any
"""A function that `apart`, or numba, has made."""

Costs = Mapping[CompiledFunction, float]
"""Function → seconds that compiling takes on a core, about."""


def is_loaded(kernel: CompiledFunction) -> bool:
    """Whether a compiled function has machine code in this process."""
    # Where numba is told not to compile, functions stay what they are.
    return bool(getattr(kernel, "signatures", True))


def is_cold(kernel: CompiledFunction) -> bool:
    """Whether a compiled function has no machine code yet, neither in this process nor on disk."""
    if is_loaded(kernel):
        return False
    folder, code = kernel.stats.cache_path, kernel.py_func.__code__
    if folder is None:
        return True
    # What else the code depends on is in the folder's name.
    version = f"py{sys.version_info.major}{sys.version_info.minor}"
    return not any(Path(folder).glob(f"*.{code.co_name}-{code.co_firstlineno}.{version}*.nbc"))


UNNOTICED = 3.0
"""Seconds of compiling up to which nothing is said."""


@dataclass(frozen=True)
class Part:
    """A compiled function that can be compiled before what calls it.

    Attributes
    ----------
    function : compiled
    run : calls it
    statement : has another process do so
    """

    function: CompiledFunction
    run: Callable[[], object]
    statement: str


@dataclass(frozen=True)
class Parts:
    """What of something may be compiled before it is called.

    Attributes
    ----------
    here, beside : in this process, and at the same time in another one
    spare : what will be asked for later, compiled there as long as this process compiles the rest: nobody
        waits for it
    """

    here: Sequence[Part] = ()
    beside: Sequence[Part] = ()
    spare: Sequence[Part] = ()


@dataclass(frozen=True)
class Rehearsal:
    """Something made up that calls compiled functions, so that nobody waits for them later.

    Attributes
    ----------
    run : calls them
    called : those that Python calls, and what only they call
    inlined : what they share with others
    parts : what of it may be compiled before
    """

    run: Callable[[], object]
    called: Costs
    inlined: Costs = field(default_factory=dict)
    parts: Callable[[], Parts] = Parts

    @property
    def seconds(self) -> dict[CompiledFunction, float]:
        """What is still to be compiled."""
        if not any(map(is_cold, self.called)):
            return {}
        return {kernel: s for kernel, s in {**self.called, **self.inlined}.items() if is_cold(kernel)}


def make_ready(what: str, *rehearsals: Rehearsal) -> None:
    """Run those whose functions are not loaded; the log says so before and after if that takes long.

    Parameters
    ----------
    what : it is that is compiled, in words
    """
    waiting = [one for one in rehearsals if not all(map(is_loaded, one.called))]
    cold: dict[CompiledFunction, float] = {}
    for one in waiting:
        cold |= one.seconds
    if sum(cold.values()) < UNNOTICED:
        cold = {}
    if cold:
        kept = all(kernel.stats.cache_path is not None for kernel in cold)
        when = "once on this machine" if kept else "in every process: it can be kept in no folder"
        about = 5 * max(1, round(sum(cold.values()) / 5))
        logger.warning("compiling %s, %s: about %d s …", what, when, about)
    start = time.perf_counter()
    with collecting_rarely(), _parts_compiled(waiting) if cold else nullcontext():
        for one in waiting:
            one.run()
    if cold:
        logger.warning("compiled in %.0f s", time.perf_counter() - start)


class _Rarely:
    """Few collections as long as somebody wants few, in whatever thread."""

    def __init__(self) -> None:
        self._mutex, self._wanted = threading.Lock(), 0
        self._before = gc.get_threshold()

    def __enter__(self) -> None:
        with self._mutex:
            if self._wanted == 0:
                self._before = gc.get_threshold()
                # Whoever wants fewer yet, or none, has them.
                if 0 < self._before[0] < 100_000:
                    gc.set_threshold(100_000, 20, 50)
            self._wanted += 1

    def __exit__(self, *_: object) -> None:
        with self._mutex:
            self._wanted -= 1
            if self._wanted == 0:
                gc.set_threshold(*self._before)


_RARELY = _Rarely()  # the collector is the process's


def collecting_rarely() -> AbstractContextManager[None]:
    """Few collections of garbage meanwhile: importing, compiling and solving keep what they make.

    Looking for what they do not keep would take a tenth of a short command's time, and of the time of many
    short tracks, a sixth of compiling.
    """
    return _RARELY


@contextmanager
def _parts_compiled(waiting: Sequence[Rehearsal]) -> Iterator[None]:
    """Before the block runs compile the parts that are cold, in two processes where that is possible."""
    from graphtrack.model.kernels.beside import compiled_beside

    parts = [one.parts() for one in waiting]
    here = {part.function: part for one in parts for part in one.here if is_cold(part.function)}
    beside = _statements(here, (part for one in parts for part in one.beside))
    spare = _statements({**here, **beside}, (part for one in parts for part in one.spare))
    with compiled_beside(list(beside.values()), list(spare.values())) as taken_over:
        for part in here.values():
            if is_cold(part.function):
                part.run()
        taken_over()
        yield


def _statements(known: Container[CompiledFunction], parts: Iterable[Part]) -> dict[CompiledFunction, str]:
    """Those of the parts that are cold and not known, each once."""
    return {
        part.function: part.statement
        for part in parts
        if part.function not in known and is_cold(part.function)
    }
