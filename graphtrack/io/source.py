"""`Source`: the bytes of one input file, and the ways in which getting at them can fail."""

from __future__ import annotations

import gzip
import io
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from graphtrack.errors import InputError
from graphtrack.remote import place_of

MAX_BYTES = 4 * 2**30
"""The largest input that is read, unpacked: a guard against files that unpack without end."""

HEAD_BYTES = 8192
"""How much of a file the formats may look at to recognise it."""

_GZIP_MAGIC = b"\x1f\x8b"
_UTF16_MARKS = (b"\xff\xfe", b"\xfe\xff")


@dataclass(frozen=True, eq=False)
class Source:
    """One input file in memory, gunzipped if it was packed; UTF-16 with its mark at the beginning as UTF-8.

    Attributes
    ----------
    path : where it was read from (for messages and for files that lie beside it)
    data : its content
    """

    path: Path
    data: bytes

    @classmethod
    def open(cls, path: str | Path) -> Source:
        """Read a file whole.

        Raises
        ------
        InputError
            If it is missing, not a file, unreadable, empty, larger than `MAX_BYTES` or a broken gzip file.
        """
        path = place_of(path)
        try:
            if path.is_dir():
                raise InputError("a directory", "a file", path=path)
            if path.exists() and not (path.is_file() or path.is_fifo()):
                raise InputError("a device", "a regular file", path=path)
            with path.open("rb") as stream:
                data = _read_limited(stream, path)
        except FileNotFoundError as error:
            raise InputError("no such file", "an existing file", path=path) from error
        except PermissionError as error:
            raise InputError("a file without permission to read", "a readable file", path=path) from error
        except (OSError, ValueError) as error:  # ValueError: a path with a null byte
            raise InputError(str(error), "a readable file", path=path) from error
        if data.startswith(_GZIP_MAGIC):
            data = _gunzip(data, path)
        if data.startswith(_UTF16_MARKS):
            data = _from_utf16(data)
        if not data:
            raise InputError("an empty file", "rows", path=path)
        return cls(path, data)

    @property
    def head(self) -> bytes:
        """The first bytes, for recognising the format."""
        return self.data[:HEAD_BYTES]

    @cached_property
    def utf16(self) -> str | None:
        """The name of the UTF-16 encoding that the content seems to have, without a mark; None for others."""
        # Of most characters one byte is null, and always the same one.
        first, second = self.head[::2], self.head[1::2]
        for nulls, others, name in ((second, first, "UTF-16LE"), (first, second, "UTF-16BE")):
            if nulls.count(0) > 0.8 * len(nulls) and 0 not in others:
                return name
        return None

    @cached_property
    def text(self) -> str:
        """The content as UTF-8 text, with or without a byte order mark.

        Raises
        ------
        InputError
            On binary files and other encodings, with the line of the first bad byte.
        """
        if self.utf16 is not None:
            expected = f"UTF-8 text, or UTF-16 with a mark at its beginning; --encoding {self.utf16} reads it"
            raise InputError("UTF-16 text", expected, path=self.path, line=1)
        null = self.data.find(b"\0")
        if null >= 0:
            raise InputError("a null byte (a binary file?)", "text", path=self.path, line=self._line(null))
        try:
            return self.data.decode("utf-8-sig")
        except UnicodeDecodeError as error:
            byte = self.data[min(error.start, len(self.data) - 1)]
            raise InputError(
                f"the byte 0x{byte:02x}",
                "UTF-8 text, or --encoding with the name of another, such as cp1252",
                path=self.path,
                line=self._line(error.start),
            ) from error

    @cached_property
    def lines(self) -> list[str]:
        """The lines of `text` without their ends (LF or CR LF).

        Raises
        ------
        InputError
            For a carriage return within a line, which some readers take for an end and others do not.
        """
        lines = [line.removesuffix("\r") for line in self.text.split("\n")]
        if "\r" in self.text:
            for number, line in enumerate(lines, 1):
                if "\r" in line:
                    found = "a carriage return within a line"
                    raise InputError(found, "lines that end in LF or CR LF", path=self.path, line=number)
        return lines

    def _line(self, offset: int) -> int:
        return self.data.count(b"\n", 0, offset) + 1


def mostly(head: bytes, matches: Callable[[str], bool]) -> bool:
    """Whether more than half of the first lines of a file are of some form.

    One bad line among them must not hide the format: its reader is the one to say what is wrong with the
    line.
    """
    lines = head.decode("utf-8-sig", errors="replace").split("\n")
    if len(head) >= HEAD_BYTES and len(lines) > 1:
        lines.pop()  # cut at the end
    lines = [line.strip() for line in lines if line.strip()][:20]
    return sum(map(matches, lines)) * 2 > len(lines)


def _read_limited(stream: io.BufferedIOBase, path: Path) -> bytes:
    data = stream.read(MAX_BYTES + 1)
    if len(data) > MAX_BYTES:
        raise InputError(f"more than {MAX_BYTES} bytes", "a smaller file", path=path)
    return data


def _from_utf16(data: bytes) -> bytes:
    """The text as UTF-8; as it is where it is none, and where it is XML, which says its encoding itself."""
    try:
        text = data.decode("utf-16")
        return data if text.lstrip().startswith("<") else text.encode()
    except UnicodeError:
        return data


def _gunzip(data: bytes, path: Path) -> bytes:
    try:
        with gzip.open(io.BytesIO(data)) as stream:
            return _read_limited(stream, path)
    except (EOFError, zlib.error, OSError) as error:
        found = f"a cut or damaged gzip file ({error})"
        raise InputError(found, "a whole one", path=path) from error
