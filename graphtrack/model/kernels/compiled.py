"""How everything is compiled: cached on disk, without the interpreter's lock."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from types import FunctionType
from typing import Literal, TypeVar, cast

import numba

from graphtrack.errors import InputError
from graphtrack.model.kernels.dispatch import Apart, Inner, Linked
from graphtrack.model.kernels.fingerprint import fingerprint, source_file

Function = TypeVar("Function", bound=Callable[..., object])

# Sums may be reordered and fused; NaN and infinity keep their meaning ("nnan" would break isnan).
_FAST = {"contract", "reassoc", "nsz", "arcp"}


UNKEPT = "graphtrack_unkept_"
"""Begins the names of packages whose machine code is of use to one process alone."""


def compiled(function: Function) -> Function:
    """The function as machine code; calls between such functions are inlined where that seems to pay.

    The code is kept under ``NUMBA_CACHE_DIR``, or else in the user's cache folder. Numba alone would only
    look whether the function's own file has changed, and run what is inlined from others as it once was.
    A function without a file, from a notebook's cell or the prompt, and any where no folder can be written
    to, is compiled anew in every process.
    """
    return _dispatched(function, Linked)


def apart(function: Function) -> Function:
    """As `compiled`, for what is large, or called from Python: its callers have a call, not its code.

    So it is compiled once, and where several are needed two processes can share them.
    """
    return _dispatched(function, Apart)


def inner(function: Function) -> Function:
    """As `apart`, for what Python never calls: what lets it do so takes a sixth of the time to compile."""
    return _dispatched(function, Inner)


def inlined(function: Function) -> Function:
    """As `compiled`, for a part that is written into its callers.

    With as many arrays as the frame program hands on, each call would cost as much as a term, even where the
    machine code is inlined.
    """
    return _dispatched(function, Linked, inline="always")


def _dispatched(
    function: Function, kind: type[Apart | Linked], inline: Literal["never", "always"] = "never"
) -> Function:
    if numba.config.DISABLE_JIT:
        expected = "the environment variable NUMBA_DISABLE_JIT unset: the engines are compiled"
        raise InputError("a numba that is told not to compile", expected)
    options = {
        "nopython": True,
        "nogil": True,
        "boundscheck": None,
        "error_model": "numpy",
        "fastmath": _FAST,
        "inline": inline,
        "no_cfunc_wrapper": True,  # nobody calls it from C
    }
    dispatched = kind(function, targetoptions=options)
    folder = _folder(cast(FunctionType, function))
    if folder:
        dispatched.keep_in(folder)
    return cast(Function, dispatched)


def _folder(function: FunctionType) -> str:
    """Where the machine code of a function is kept; "" if nowhere."""
    # `exec` may leave no module at all, and what was written for a cell's kernel goes with the process.
    if function.__module__ is None or function.__module__.startswith(UNKEPT):
        return ""
    source, written = source_file(function.__module__), Path(function.__code__.co_filename)
    # A module may also run what was not written in its file: cells, `exec`.
    if source is None or not written.is_file() or not written.samefile(source):
        return ""
    home = cache_home()
    if home is None:
        return ""
    folder = home / fingerprint(function.__module__)
    return str(folder) if _is_writable(folder) else ""


def cache_home() -> Path | None:
    """The folder in which machine code is kept; None where there is none that can be written to."""
    try:
        user = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "graphtrack"
    except RuntimeError:  # a user without a home
        return None
    home = Path(numba.config.CACHE_DIR or user)
    return home if _is_writable(home) else None


def _is_writable(folder: Path) -> bool:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError:
        return False
    return os.access(folder, os.W_OK)
