"""Text and colours for display: lists, counts, durations, small HTML tables, and colours of people."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from html import escape
from typing import Final

BODY_COLOUR: Final = "#0072B2"
HEAD_COLOUR: Final = "#D55E00"
VELOCITY_COLOUR: Final = "#009E73"
"""Colours of Okabe & Ito (2008)."""

PERSON_COLOURS: Final = (
    *("#56B4E9", "#E69F00", "#543CC0", "#FC486C", "#A80000", "#604860"),
    *("#A8B4A8", "#9C0C90", "#487848", "#C06CA8", "#CCB460", "#8490FC"),
)
"""Colours far apart in CIELAB, also as protanopes, deuteranopes and tritanopes see them (at least 20, and 14
from the three above), and legible on light and dark ground; each is as far as can be from those before."""

MOST = 10
"""Rows of a table, and names in a list, beyond which the rest is only counted."""

LONGEST = 40
"""Characters of a label that are shown."""


def html_table(caption: str, header: Sequence[str], rows: Iterable[Sequence[object]], more: int = 0) -> str:
    """Return a table as HTML, with the number of rows that are not shown; cells are escaped."""
    lines = [f"<table><caption>{escape(caption)}</caption>"]
    if header:
        lines.append("<tr>" + "".join(f"<th>{escape(name)}</th>" for name in header) + "</tr>")
    for row in rows:
        lines.append("<tr>" + "".join(f"<td>{escape(str(cell))}</td>" for cell in row) + "</tr>")
    if more:
        lines.append(f'<tr><td colspan="{len(header)}">… and {more} more</td></tr>')
    return "".join([*lines, "</table>"])


def html_pairs(caption: str, pairs: Mapping[str, object]) -> str:
    """Return names and values as an HTML table."""
    return html_table(caption, (), pairs.items())


def listed(names: Iterable[object], most: int = MOST) -> str:
    """Join names with commas; of many the first and the number of the rest."""
    known = [one if len(one := str(name)) <= 2 * LONGEST else f"{one[: LONGEST - 1]}…" for name in names]
    more = f" and {len(known) - most} more" if len(known) > most else ""
    return ", ".join(known[:most]) + more


def counted(count: int, noun: str) -> str:
    """Return a number and its noun, with an s for the plural."""
    return f"{count} {noun}" if count == 1 else f"{count} {noun}s"


def duration(seconds: float) -> str:
    """Return seconds as text: thousandths below one, tenths above."""
    return f"{seconds:.3f} s" if seconds < 1.0 else f"{seconds:.1f} s"


def shortened(text: str) -> str:
    """Return a quoted text, cut to `LONGEST` characters."""
    return repr(text if len(text) <= LONGEST else text[: LONGEST - 1] + "…")


def person_colour(index: int) -> str:
    """Return the colour of the person at ``index`` in the set; colours repeat after twelve people."""
    return PERSON_COLOURS[index % len(PERSON_COLOURS)]


def rgb(colour: str) -> tuple[int, int, int]:
    """Return red, green and blue, from 0 to 255, of a colour such as ``#0072B2``."""
    return int(colour[1:3], 16), int(colour[3:5], 16), int(colour[5:7], 16)
