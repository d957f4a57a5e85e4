"""Files and tables to tracks and back: strict reading, atomic writing."""

from __future__ import annotations

from typing import TYPE_CHECKING

from graphtrack.packages import imported_names

if TYPE_CHECKING:
    from graphtrack.io.atomic import atomic_path
    from graphtrack.io.format import Format
    from graphtrack.io.options import ReadOptions
    from graphtrack.io.read_write import read_identified, write
    from graphtrack.io.registry import all_formats

__all__ = ["Format", "ReadOptions", "all_formats", "atomic_path", "read_identified", "write"]

__getattr__ = imported_names(
    __name__,
    {
        "atomic": "atomic_path",
        "format": "Format",
        "options": "ReadOptions",
        "read_write": "read_identified write",
        "registry": "all_formats",
    },
)
