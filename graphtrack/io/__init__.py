"""Reading is strict and says what it did; writing is atomic."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

from graphtrack.io.atomic import atomic_path
from graphtrack.io.options import ReadOptions
from graphtrack.io.registry import Format, formats

if TYPE_CHECKING:
    from graphtrack.io.reading import read, write

__all__ = ["Format", "ReadOptions", "atomic_path", "formats", "read", "write"]


def __getattr__(name: str) -> object:
    """`read` and `write` when they are first used: reading may associate, which stands on the model."""
    if name not in ("read", "write"):
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module("graphtrack.io.reading"), name)
