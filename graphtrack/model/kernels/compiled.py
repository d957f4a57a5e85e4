"""How everything is compiled: cached on disk, without the interpreter's lock."""

from __future__ import annotations

import hashlib
import importlib.util
import os
import re
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import TypeVar

import numba

Function = TypeVar("Function", bound=Callable[..., object])

# Sums may be reordered and fused; NaN and infinity keep their meaning ("nnan" would break isnan).
_FAST = {"contract", "reassoc", "nsz", "arcp"}
_IMPORT = re.compile(rb"^from ([\w.]+) import", re.MULTILINE)


def compiled(function: Function) -> Function:
    """The function as machine code; calls between such functions are inlined.

    The code is kept under ``NUMBA_CACHE_DIR``, or else in the user's cache folder. Numba alone would only
    look whether the function's own file has changed, and run what is inlined from others as it once was.
    """
    given = numba.config.CACHE_DIR
    home = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "graphtrack"
    numba.config.CACHE_DIR = str(Path(given or home) / fingerprint(function.__module__))
    try:
        return numba.njit(cache=True, nogil=True, error_model="numpy", fastmath=_FAST)(function)
    finally:
        numba.config.CACHE_DIR = given


@cache
def fingerprint(module: str) -> str:
    """A digest of the sources of a module and of all that it imports from its package, directly or not."""
    package, _, _ = module.partition(".")
    digest, waiting, seen = hashlib.sha256(), [module], {module}
    while waiting:
        source, imported = _source(waiting.pop())
        digest.update(source)
        for name in imported:
            if name.partition(".")[0] == package and name not in seen:
                seen.add(name)
                waiting.append(name)
    return digest.hexdigest()[:16]


@cache
def _source(module: str) -> tuple[bytes, list[str]]:
    specification = importlib.util.find_spec(module)
    if specification is None or specification.origin is None:
        return b"", []
    source = Path(specification.origin).read_bytes()
    return source, [name.decode() for name in _IMPORT.findall(source)]
