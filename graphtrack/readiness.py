"""Machine code before it is needed, and what is logged while it is compiled."""

from __future__ import annotations

import logging
import os
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from graphtrack.model.kernels.compiled import machine_code_folder
from graphtrack.tracks import Track

logger = logging.getLogger("graphtrack")

UNNOTICED = 3.0
"""Seconds of compiling up to which nothing is logged."""

TRACK = Track(0, np.arange(4), np.linspace(0.0, 0.3, 4), np.linspace(0.0, 1.0, 8).reshape(4, 2))
"""Synthetic track, 0.1 s a frame, with which compiled functions are called the first time."""

_READY = set[str]()
"""Names of the rehearsals that this process has run: machine code is the process's."""


@dataclass(frozen=True)
class Rehearsal:
    """A small job with made-up data that calls every compiled function of some kind of work.

    Attributes
    ----------
    name : of the kind; of several rehearsals with one name the first is run
    run : does the job
    seconds : processor time that compiling takes, about
    """

    name: str
    run: Callable[[], object]
    seconds: float

    def mark(self) -> Path | None:
        """The file that says that the machine code is on disk; None where it can be kept in no folder."""
        home = machine_code_folder()
        return None if home is None else home / f"{self.name.replace(' ', '-')}.compiled"

    def is_cold(self) -> bool:
        """Whether nothing is compiled yet, neither in this process nor on disk."""
        mark = self.mark()
        return self.name not in _READY and (mark is None or not mark.exists())


def make_ready(what: str, *rehearsals: Rehearsal) -> None:
    """Run the rehearsals that this process has not run; a long compilation is logged before and after.

    Parameters
    ----------
    what : is compiled, in words
    """
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
