"""Text files with other marks or another encoding than the readers expect, as their owner says they are."""

from __future__ import annotations

import codecs
import csv
import io
import re
from dataclasses import replace

from graphtrack.errors import InputError
from graphtrack.io.delimiters import SEP_LINE, csv_rows, is_blank
from graphtrack.io.source import Source

DELIMITERS = {"tab": "\t", "space": " ", "comma": ",", "semicolon": ";", "bar": "|"}
"""Words for marks that are hard to type."""

_DECIMAL = re.compile(r"\s*[+-]?(?:\d+,\d*|,\d+)(?:[eE][+-]?\d+)?\s*", re.ASCII)


def delimiter_of(given: str | None) -> str | None:
    """The mark that is meant, one character."""
    if given is None:
        return None
    mark = DELIMITERS.get(given.lower(), given)
    if len(mark) != 1 or mark in "\"'\r\n\0" or mark.isalnum():
        raise InputError(f"delimiter {given!r}", "one mark, such as ; or |, or one of tab, space")
    return mark


def check_decimal(given: str | None) -> None:
    """Raise InputError for what separates no decimals."""
    if given not in (None, ".", ","):
        raise InputError(f"decimal {given!r}", "a point or a comma")


def check_encoding(given: str | None) -> None:
    """Raise InputError for what is no encoding of text."""
    if given is None:
        return
    try:
        codecs.lookup(given)
        "".encode(given)
    except (LookupError, TypeError, ValueError, AttributeError, UnicodeError) as error:
        raise InputError(f"encoding {given!r}", "one of text, such as utf-16 or cp1252") from error


def as_told(source: Source, delimiter: str | None, decimal: str | None, encoding: str | None) -> Source:
    """The file in UTF-8, with commas between its cells and decimal points; lines stay lines."""
    if encoding is not None:
        source = _decoded(source, encoding)
    mark = delimiter_of(delimiter)
    if mark is None and decimal != ",":
        return source
    return replace(source, data=_with_commas(source, mark or ",", decimal).encode())


def _decoded(source: Source, encoding: str) -> Source:
    try:
        text = source.data.decode(encoding)
    except UnicodeError as error:
        place = getattr(error, "start", 0)
        line = source.data.count(b"\n", 0, place) + 1
        found = f"bytes that are not {encoding}"
        raise InputError(found, "another encoding", path=source.path, line=line) from error
    return replace(source, data=text.removeprefix("\ufeff").encode(errors="replace"))


def _with_commas(source: Source, mark: str, decimal: str | None) -> str:
    lines = list(source.lines)
    filled = next((k for k, line in enumerate(lines) if line.strip()), 0)
    if lines and SEP_LINE.fullmatch(lines[filled].strip(" ")):
        lines[filled] = ""
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")

    rows = (
        (line.split() for line in lines)
        if mark == " "
        else (row for _, row in csv_rows(source.path, lines, mark))
    )
    for row in rows:
        if is_blank(row):
            out.write("\n")
        elif decimal == ",":
            writer.writerow([cell.replace(",", ".") if _DECIMAL.fullmatch(cell) else cell for cell in row])
        else:
            writer.writerow(row)
    return out.getvalue()
