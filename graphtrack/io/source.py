"""`Source`: the bytes of one input file or URL (extra ``cloud``), and folders that stand for a file."""

from __future__ import annotations

import codecs
import contextlib
import gzip
import io
import tomllib
import zlib
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar, Self

import tomli_w

from graphtrack.errors import InputError
from graphtrack.io.atomic import atomic_path
from graphtrack.limits import MemoryLimit
from graphtrack.packages import package
from graphtrack.tracks.validation import with_table

_MARK = "://"


class RemoteFile(type(Path())):  # type: ignore[misc]
    """Path of a remote file: it is fetched when it is opened, and has no companion files."""

    def __new__(cls, url: str) -> RemoteFile:  # noqa: D102
        made = super().__new__(cls, url)
        made.url = url
        return made

    def __init__(self, url: str) -> None:
        if Path.__init__ is not object.__init__:  # from Python 3.12 on
            super().__init__(url)

    def __str__(self) -> str:
        return vars(self).get("url") or super().__str__()

    def __reduce__(self) -> tuple[object, ...]:
        return type(self), (str(self),)

    def open(self, *arguments: Any, **options: Any) -> Any:
        """Read the content and return it as a stream."""
        url = str(self)
        fsspec = package("fsspec", "cloud")
        try:
            with fsspec.open(url, "rb") as stream:
                return io.BytesIO(MemoryLimit(self).read(stream, "content"))
        except InputError:
            raise
        except FileNotFoundError as error:
            raise InputError("no such file", "an existing file", path=url) from error
        except ImportError as error:
            reason = " ".join(str(error).split())
            expected = "fsspec's packages for such URLs (for http: pip install requests aiohttp)"
            raise InputError(reason, expected, path=url) from error
        except Exception as error:  # each store has errors of its own
            reason = " ".join(str(error).split()) or type(error).__name__
            raise InputError(reason, "the URL of a file that can be read", path=url) from error


def place_of(given: str | Path) -> Path:
    """Return a path, or the remote file of a URL such as ``s3://bucket/tracks.parquet``."""
    if isinstance(given, RemoteFile):
        return given
    return RemoteFile(given) if isinstance(given, str) and _MARK in given else Path(given)


HEAD_BYTES = 8192
"""Bytes of a file by which its format is recognised."""

_GZIP_MAGIC, _ZIP_MAGIC = b"\x1f\x8b", b"PK\x03\x04"
_BYTE_ORDER_MARKS = {
    codecs.BOM_UTF32_LE: "utf-32",  # before UTF-16, whose byte order mark it begins with
    codecs.BOM_UTF32_BE: "utf-32",
    codecs.BOM_UTF16_LE: "utf-16",
    codecs.BOM_UTF16_BE: "utf-16",
}
"""Byte order mark → encoding."""

_SHORTEST, _LINES_FROM = 4, 10**6
"""Mean characters a line, below which a text of so many lines is refused: the shortest row has 9."""


_OF_ANY_FILE = MemoryLimit(Path("file"))


@dataclass(frozen=True, eq=False)
class Source:
    """One input file in memory, unpacked if it was gzipped; UTF-16 and UTF-32 with byte order mark as UTF-8.

    Attributes
    ----------
    path : of the file (for messages and companion files)
    data : content
    limit : of the memory that the content may take
    """

    path: Path
    data: bytes
    limit: MemoryLimit = _OF_ANY_FILE

    @classmethod
    def open(cls, path: str | Path, limit: MemoryLimit | None = None) -> Source:
        """Read a file whole, within a limit of memory."""
        path = place_of(path)
        limit = limit or MemoryLimit(path)
        try:
            if path.is_dir():
                raise InputError("a directory", "a file", path=path)
            if path.exists() and not (path.is_file() or path.is_fifo()):
                raise InputError("a device", "a regular file", path=path)
            with path.open("rb") as stream:
                data = limit.read(stream, "content")
        except FileNotFoundError as error:
            raise InputError("no such file", "an existing file", path=path) from error
        except PermissionError as error:
            raise InputError("a file without permission to read", "a readable file", path=path) from error
        except (OSError, ValueError) as error:  # ValueError: a path with a null byte
            raise InputError(str(error), "a readable file", path=path) from error
        limit = replace(limit, stored=len(data))
        if data.startswith(_GZIP_MAGIC):
            data = _gunzip(data, limit)
        encoding = next((name for mark, name in _BYTE_ORDER_MARKS.items() if data.startswith(mark)), None)
        if encoding is not None:
            data = _decoded(data, encoding)
        if not data:
            raise InputError("an empty file", "rows", path=path)
        return cls(path, data, limit)

    def fail(
        self, found: str, expected: str, line: int | None = None, column: str | int | None = None
    ) -> InputError:
        """Return the error for this file, with the place in it."""
        return InputError(found, expected, path=self.path, line=line, column=column)

    @property
    def head(self) -> bytes:
        """First bytes, for recognising the format."""
        return self.data[:HEAD_BYTES]

    @cached_property
    def wide(self) -> str | None:
        """Guessed UTF-16 or UTF-32 encoding of content without a byte order mark; None for others."""
        for name in ("UTF-32LE", "UTF-32BE"):
            # No UTF-16 text and hardly any binary file is valid UTF-32.
            complete = self.head[: len(self.head) // 4 * 4]
            if len(complete) >= 8:
                with contextlib.suppress(UnicodeError):
                    if "\0" not in complete.decode(name):
                        return name
        # Most characters in UTF-16 have one null byte, always at the same position.
        first, second = self.head[::2], self.head[1::2]
        for nulls, counterpart, name in ((second, first, "UTF-16LE"), (first, second, "UTF-16BE")):
            if nulls.count(0) > 0.8 * len(nulls) and 0 not in counterpart:
                return name
        return None

    @cached_property
    def text(self) -> str:
        """Content as UTF-8 text, with or without a byte order mark."""
        if self.wide is not None:
            kind = self.wide[:6]
            expected = f"UTF-8 text, or {kind} with a mark at its beginning; --encoding {self.wide} reads it"
            raise self.fail(f"{kind} text", expected, 1)
        if self.data.startswith(_ZIP_MAGIC):
            expected = "text: an archive unpacked, the sheet of a workbook saved as CSV"
            raise self.fail("a ZIP archive (an Excel workbook?)", expected)
        null = self.data.find(b"\0")
        if null >= 0:
            raise self.fail("a null byte (a binary file?)", "text", self._line(null))
        try:
            return self.data.decode("utf-8").lstrip("\ufeff")
        except UnicodeDecodeError as error:
            byte = self.data[min(error.start, len(self.data) - 1)]
            expected = "UTF-8 text, or --encoding with the name of another, such as cp1252"
            raise self.fail(f"the byte 0x{byte:02x}", expected, self._line(error.start)) from error

    @cached_property
    def lines(self) -> list[str]:
        """Lines of `text` without their ends (LF or CR LF)."""
        text = self.text
        count = text.count("\n")
        if count >= _LINES_FROM and len(text) < (1 + _SHORTEST) * count:
            found = f"{count} lines of fewer than {_SHORTEST} characters on the average"
            raise self.fail(found, "rows of a table")
        lines = [line.removesuffix("\r") for line in text.split("\n")]
        if "\r" in self.text:
            for number, line in enumerate(lines, 1):
                if "\r" in line:
                    found = "a carriage return within a line"
                    raise self.fail(found, "lines that end in LF or CR LF", number)
        return lines

    def _line(self, offset: int) -> int:
        return self.data.count(b"\n", 0, offset) + 1


def mostly(head: bytes, matches: Callable[[str], bool]) -> bool:
    """Return whether more than half of the first lines of a file match a form.

    One bad line must not hide the format: the format's reader reports the line.
    """
    lines = head.decode("utf-8-sig", errors="replace").split("\n")
    if len(head) >= HEAD_BYTES and len(lines) > 1:
        lines.pop()  # cut at the end
    lines = [line.strip() for line in lines if line.strip()][:20]
    return sum(map(matches, lines)) * 2 > len(lines)


def _decoded(data: bytes, encoding: str) -> bytes:
    """Return the text as UTF-8; unchanged if it is not text, or XML, which declares its encoding."""
    try:
        text = data.decode(encoding)
        return data if text.lstrip().startswith("<") else text.encode()
    except UnicodeError:
        return data


def _gunzip(data: bytes, limit: MemoryLimit) -> bytes:
    """Return the unpacked content; stop early at a file that unpacks without end."""
    try:
        with gzip.open(io.BytesIO(data)) as stream:
            return limit.read(stream, "unpacked content")
    except (EOFError, zlib.error, OSError) as error:
        found = f"a cut or damaged gzip file ({error})"
        raise InputError(found, "a whole one", path=limit.path) from error


_STAGES, _REPORTED = "stages.json", "tracks.csv"
"""The file by which the folder of a report is recognised, and its table of estimates."""

_OF_SEQUENCE = ("gt/gt.txt", "det/det.txt")
"""Tracks of a MOTChallenge sequence, and its detections, which are read if there are no tracks."""


def sequence_file(folder: Path) -> Path | None:
    """Return the tracks, or else the detections, of a folder that is a MOTChallenge sequence."""
    if not folder.is_dir():
        return None
    return next((folder / name for name in _OF_SEQUENCE if (folder / name).is_file()), None)


def table_in(path: Path) -> Path:
    """Return the table of a folder of MOTChallenge or of `perception report`; else the path itself."""
    if (path / _STAGES).is_file():
        return path / _REPORTED
    return sequence_file(path) or path


def read_toml(path: str | Path, expected: str) -> dict[str, Any]:
    """Return the content of a TOML file; ``expected`` describes it in messages.

    Raise InputError for a file that cannot be read, or is of another kind that graphtrack has.
    """
    try:
        with Path(path).open(encoding="utf-8") as stream:
            text = stream.read(_MOST_CHARACTERS + 1)  # a device may be endless
        if len(text) > _MOST_CHARACTERS:
            raise InputError(f"more than {_MOST_CHARACTERS:,} characters", expected, path=path)
        # The parser takes quadratic time and memory for a key of many parts.
        for number, line in enumerate(text.split("\n"), 1):
            if line.count(".") > _MOST_PARTS and not _is_numbers(line):
                raise InputError(
                    "more than 100 dots", f"keys of few parts: {expected}", path=path, line=number
                )
        content = tomllib.loads(text)
    except OSError as error:
        raise InputError(error.strerror or str(error), f"a readable file: {expected}", path=path) from error
    except ValueError as error:  # no TOML, no UTF-8, or an integer of thousands of digits
        raise InputError(f"no TOML ({error})", expected, path=path) from error
    except RecursionError as error:
        raise InputError("brackets within brackets without end", expected, path=path) from error
    kinds = [kind for kind, keys in _KINDS.items() if not content.keys().isdisjoint(keys)]
    if len(kinds) == 1 and not kinds[0].startswith(expected):
        raise InputError(kinds[0], expected, path=path)
    return content


_KINDS = {
    "a model file (for --model)": ("preset", "motion", "orientation", "likelihood", "social", "scene"),
    "a description of sensors (for --sensors)": ("sensors",),
    "a file of constants (for --constants)": ("acceleration_density", "body_diffusion", "head_diffusion"),
    "the output of 'graphtrack fit --forecast' (for graphtrack forecast --parameters)": ("forecast",),
    "the output of 'graphtrack fit --groups' (for graphtrack groups --parameters)": ("groups",),
    "the output of 'graphtrack fit --attention' (for graphtrack attention --parameters)": ("attention",),
}
"""Kind of a file, and the option that takes it → keys that no other kind has."""
_MOST_PARTS = 100
_MOST_CHARACTERS = 10**8


def _is_numbers(line: str) -> bool:
    """Return whether a line is a part of an array of numbers, perhaps after its key."""
    key, _, values = line.rpartition("=")
    has_text = '"' in values or "'" in values
    return (
        key.count(".") <= _MOST_PARTS
        and not has_text
        and all(one.count(".") < 2 for one in values.split(","))
    )


class ParameterFile:
    """Base of a dataclass of parameters that ``graphtrack fit`` writes as a table of a TOML file.

    Attributes
    ----------
    _table : name of the table, and of the option of ``fit``
    """

    _table: ClassVar[str]

    def save(self, path: str | Path) -> None:
        """Write a parameter file, atomically."""
        content = tomli_w.dumps({self._table: asdict(self)})  # type: ignore[call-overload]
        with atomic_path(path) as temporary:
            temporary.write_text(content, encoding="utf-8")

    @classmethod
    def load(cls, path: str | Path) -> Self:
        """Read a parameter file; missing keys have the defaults.

        Raise InputError with the file and the invalid key.
        """
        expected = f"the output of 'graphtrack fit --{cls._table}'"
        content = read_toml(path, expected)
        try:
            if cls._table not in content:
                found = ", ".join(content) or "an empty file"
                raise InputError(f"no table [{cls._table}] ({found})", expected)
            return with_table(cls(), cls._table, content[cls._table])
        except InputError as error:
            raise error.at(path) from error
