"""How everything is compiled: cached on disk, without the interpreter's lock."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

import numba

Function = TypeVar("Function", bound=Callable[..., object])

# Sums may be reordered and fused; NaN and infinity keep their meaning ("nnan" would break isnan).
_FAST = {"contract", "reassoc", "nsz", "arcp"}


def compiled(function: Function) -> Function:
    """The function as machine code; calls between such functions are inlined."""
    return numba.njit(cache=True, nogil=True, error_model="numpy", fastmath=_FAST)(function)
