"""Files and tables to tracks and back: strict reading, atomic writing."""

from graphtrack.io.atomic import atomic_path
from graphtrack.io.format import Format
from graphtrack.io.options import ReadOptions
from graphtrack.io.read_write import read, write
from graphtrack.io.registry import FORMATS

__all__ = ["FORMATS", "Format", "ReadOptions", "atomic_path", "read", "write"]
