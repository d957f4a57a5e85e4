"""Files and tables to tracks and back: strict reading, atomic writing."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from graphtrack.io.atomic import atomic_path
    from graphtrack.io.format import Format
    from graphtrack.io.options import ReadOptions
    from graphtrack.io.read_write import read, write
    from graphtrack.io.registry import FORMATS

__all__ = ["FORMATS", "Format", "ReadOptions", "atomic_path", "read", "write"]

_HOMES = {
    "FORMATS": "registry",
    "Format": "format",
    "ReadOptions": "options",
    "atomic_path": "atomic",
    "read": "read_write",
    "write": "read_write",
}


def __getattr__(name: str) -> object:
    """Import a name when it is first used (PEP 562): command lines need few of the readers."""
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)
