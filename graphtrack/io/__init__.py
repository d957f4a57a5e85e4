"""Reading is strict and says what it did; writing is atomic."""

from __future__ import annotations

from graphtrack.io.atomic import atomic_path
from graphtrack.io.options import ReadOptions
from graphtrack.io.reading import read, write
from graphtrack.io.registry import Format, formats

__all__ = ["Format", "ReadOptions", "atomic_path", "formats", "read", "write"]
