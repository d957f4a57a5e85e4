"""Packages that are not there for everybody, and the extra of this one that brings them."""

from __future__ import annotations

from importlib import import_module
from typing import Any

from graphtrack.errors import InputError


def package(name: str, extra: str) -> Any:
    """A package, imported when it is needed.

    Raises
    ------
    InputError
        If it is not there, with the extra that brings it.
    """
    try:
        return import_module(name)
    except ImportError as error:
        raise InputError(f"no package {name}", f"the extra: pip install 'graphtrack[{extra}]'") from error
