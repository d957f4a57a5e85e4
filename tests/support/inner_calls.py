"""Calls from Python of functions that compiled code alone calls."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

import numba


@cache
def from_python(function: Callable[..., Any]) -> Callable[..., Any]:
    """What calls an `inner` function."""

    @numba.njit
    def call(*arguments: Any) -> Any:
        return function(*arguments)

    return call  # type: ignore[no-any-return]
