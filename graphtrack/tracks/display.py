"""Text and colours for people: lists, counts, durations, small HTML tables, and what stands for whom."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from html import escape
from typing import Final

BODY_COLOUR: Final = "#0072B2"
HEAD_COLOUR: Final = "#D55E00"
VELOCITY_COLOUR: Final = "#009E73"
PERSON_COLOURS: Final = ("#56B4E9", "#E69F00", "#CC79A7", "#8A8F98", "#94641A", "#8C4A7B")
"""Colours of Okabe & Ito (2008), which people with any common colour blindness can tell apart."""

MOST = 10
"""Rows of a table, and names in a list, beyond which the rest is only counted."""

LONGEST = 40
"""Characters of a label that are shown."""


def html_table(caption: str, header: Sequence[str], rows: Iterable[Sequence[object]], more: int = 0) -> str:
    """A table as HTML, with the number of rows that are not shown; whatever stands in it is text."""
    lines = [f"<table><caption>{escape(caption)}</caption>"]
    if header:
        lines.append("<tr>" + "".join(f"<th>{escape(name)}</th>" for name in header) + "</tr>")
    for row in rows:
        lines.append("<tr>" + "".join(f"<td>{escape(str(cell))}</td>" for cell in row) + "</tr>")
    if more:
        lines.append(f'<tr><td colspan="{len(header)}">… and {more} more</td></tr>')
    return "".join([*lines, "</table>"])


def html_pairs(caption: str, pairs: Mapping[str, object]) -> str:
    """Names and what they stand for, as an HTML table."""
    return html_table(caption, (), pairs.items())


def listed(names: Iterable[object], most: int = MOST) -> str:
    """Names with commas; of many the first and how many more."""
    known = [one if len(one := str(name)) <= 2 * LONGEST else f"{one[: LONGEST - 1]}…" for name in names]
    more = f" and {len(known) - most} more" if len(known) > most else ""
    return ", ".join(known[:most]) + more


def counted(count: int, noun: str) -> str:
    """A number and its noun, with an s where there are several."""
    return f"{count} {noun}" if count == 1 else f"{count} {noun}s"


def duration(seconds: float) -> str:
    """Seconds with the digits that count: thousandths below one, tenths above."""
    return f"{seconds:.3f} s" if seconds < 1.0 else f"{seconds:.1f} s"


def shortened(text: str) -> str:
    """A text of any length and its quotes; no more than `LONGEST` characters of it."""
    return repr(text if len(text) <= LONGEST else text[: LONGEST - 1] + "…")


def person_colour(index: int) -> str:
    """The colour of the person at ``index`` in the set; colours repeat after six people."""
    return PERSON_COLOURS[index % len(PERSON_COLOURS)]


def rgb(colour: str) -> tuple[int, int, int]:
    """Red, green and blue, from 0 to 255, of a colour such as ``#0072B2``."""
    return int(colour[1:3], 16), int(colour[3:5], 16), int(colour[5:7], 16)
