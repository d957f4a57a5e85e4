"""Bound on the memory that a file may take, checked before the memory is taken."""

from __future__ import annotations

import io
import math
import sqlite3
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from graphtrack.errors import InputError

GIB = 2**30
LARGEST = 4 * GIB
"""Bytes that the content of a file may take, unless an option gives another limit."""

RATIO, RATIO_FROM = 200, 2**26
"""Content of more bytes than the second may take so many times the size of its file; tables have 3 to 30."""

_CHUNK = 2**20
_UNITS = (("GiB", GIB), ("MiB", 2**20), ("KiB", 2**10))


class _Stream(Protocol):
    def read(self, size: int, /) -> bytes: ...


@dataclass(frozen=True)
class MemoryLimit:
    """Limit of the bytes that the content of one file may take.

    That of a small file may take `RATIO` times its size, or `RATIO_FROM` bytes if that is more; that of any
    file `LARGEST` bytes.

    Attributes
    ----------
    path : of the file
    stored : its bytes, packed if it is; None if unknown
    gib : limit in GiB, which replaces the default
    option : name of the option that gives ``gib``; "" if there is none
    """

    path: Path
    stored: int | None = None
    gib: float | None = None
    option: str = ""

    @property
    def most(self) -> int:
        """Largest number of bytes."""
        if self.gib is not None:
            return round(self.gib * GIB)
        return LARGEST if self.stored is None else min(LARGEST, max(RATIO_FROM, RATIO * self.stored))

    def check(self, size: float, what: str) -> None:
        """Raise InputError if a part of the content, ``what``, takes more than the limit of bytes."""
        if size <= self.most:
            return
        by_ratio = self.gib is None and self.most < LARGEST
        found = f"{what} of {_shown(size)}" + (f", more than {RATIO} times its size" if by_ratio else "")
        hint = f"; {self.option} {math.ceil(size / GIB)} reads it" if self.option else ""
        raise InputError(found, f"at most {_shown(self.most)}{hint}", path=self.path)

    def read(self, stream: _Stream, what: str) -> bytes:
        """Return the whole content of a stream that unpacks data; stop early beyond the limit."""
        content = io.BytesIO()
        while chunk := stream.read(_CHUNK):
            content.write(chunk)
            self.check(content.tell(), what)
        return content.getvalue()


def _shown(size: float) -> str:
    unit, count = next((pair for pair in _UNITS if size >= pair[1]), ("bytes", 1))
    return f"{size / count:.3g} {unit}"


def array_bytes(shape: tuple[int, ...] | None, itemsize: int) -> int:
    """Return the bytes of an array of numbers, each of which takes those of a double or more; 0 for None."""
    return 0 if shape is None else math.prod(shape) * max(itemsize, 8)


def check_stored(connection: sqlite3.Connection, table: str, path: Path) -> None:
    """Raise InputError unless a table's rows are stored: a view can compute any number of rows."""
    kinds = "select type, rootpage from sqlite_master where name = ?"
    found = connection.execute(kinds, (table,)).fetchone()
    if found is None:
        raise InputError(f"a database without a table {table}", "one with it", path=path)
    kind, page = found
    computed = any(hidden for *_, hidden in connection.execute(f"pragma table_xinfo({table})"))
    if kind != "table" or not page or computed:
        what = "table with computed content" if kind == "table" else kind
        raise InputError(f"{table}, which is a {what}", "a table that stores its rows", path=path)
