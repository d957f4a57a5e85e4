"""The report as one HTML file that needs nothing else: no network, no server, no other file."""

from __future__ import annotations

import base64
import html
import json
import math
import numbers
import zlib
from importlib import resources
from io import BytesIO
from pathlib import Path
from typing import Any

from graphtrack.display import BODY_COLOUR, HEAD_COLOUR, VELOCITY_COLOUR
from graphtrack.io.atomic import atomic_path
from graphtrack.report.content import Card, Chart, DataTable, Note, Picture, Report, Section
from graphtrack.report.replay_html import render_chart, render_replay

SECURITY = (
    "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data: blob:; "
    "base-uri 'none'; form-action 'none'"
)
"""Content security policy: the page loads nothing over the network."""

SCRIPTS = (
    "replay_data.js",
    "lives.js",
    "people.js",
    "behaviour.js",
    "canvas_pointer.js",
    "replay_draw.js",
    "behaviour_draw.js",
    "replay_pick.js",
    "replay_pointer.js",
    "replay_controls.js",
    "people_list.js",
    "angles_draw.js",
    "angles_chart.js",
    "timeline_draw.js",
    "timeline.js",
    "tables.js",
    "page.js",
)
"""In the order in which they stand in the page; together they are one function."""


_COLOURS = f":root {{ --body: {BODY_COLOUR}; --head: {HEAD_COLOUR}; --velocity: {VELOCITY_COLOUR}; }}"


def write_html(path: str | Path, report: Report) -> None:
    """Write a report as one self-contained HTML file, which appears whole or not at all.

    Raises
    ------
    InputError
        When the place cannot be written to.
    """
    page = render_report(report)
    with atomic_path(path) as temporary:
        temporary.write_text(page, encoding="utf-8")


def render_report(report: Report) -> str:
    """The page as text. Words are escaped; data stand in it packed, so that they cannot end their element."""
    has_replay = report.replay is not None and bool(report.replay["people"])
    names = (["Replay"] if has_replay else []) + [section.title for section in report.sections]
    anchors = [f"section-{i}" for i in range(len(names))]
    parts = [_header(report, dict(zip(anchors, names, strict=True)))]
    if has_replay and report.replay is not None:
        parts += [
            f'<section aria-labelledby="{anchors[0]}"><h2 id="{anchors[0]}">Replay</h2>',
            render_replay(report.replay),
            f'<script type="application/octet-stream" id="replay-data">{packed(report.replay)}</script>',
            "</section>",
        ]
    for anchor, section in zip(anchors[has_replay:], report.sections, strict=True):
        parts.append(_section(anchor, section))
    scripts = "\n".join(_asset(name) for name in SCRIPTS)
    return "\n".join(
        [
            '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">',
            f'<meta http-equiv="Content-Security-Policy" content="{SECURITY}">',
            '<meta name="viewport" content="width=device-width, initial-scale=1">',
            f"<title>{html.escape(report.title)}</title>",
            f"<style>\n{_COLOURS}\n{_asset('page.css')}</style>\n</head>\n<body>\n" + '<main class="wrap">',
            *parts,
            "</main>",
            f'<script>(function () {{\n"use strict";\n{scripts}}})();</script>\n</body>\n</html>\n',
        ]
    )


def packed(data: Any) -> str:
    """JSON, compressed (zlib) and in base64: a third of its size, and it cannot end its element.

    Raises
    ------
    ValueError
        For a value that JSON does not have, such as NaN.
    """
    text = json.dumps(data, separators=(",", ":"), allow_nan=False)
    return base64.b64encode(zlib.compress(text.encode("utf-8"))).decode("ascii")


def format_cell(value: Any) -> str:
    """A value as a reader wants it: numbers to four digits, a dash where there is none. Not escaped."""
    if value is None:
        return "–"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, numbers.Integral):
        return str(int(value))
    if isinstance(value, numbers.Real):
        number = float(value)
        if math.isnan(number):
            return "–"
        # Four digits, but never an exponent for the sizes that people walk at.
        return f"{number:.0f}" if 1e3 <= abs(number) < 1e9 else f"{number:.4g}"
    return str(value)


def _header(report: Report, anchors: dict[str, str]) -> str:
    subtitle = f'<p class="quiet">{html.escape(report.subtitle)}</p>' if report.subtitle else ""
    cards = "".join(_card(card) for card in report.cards)
    links = "".join(f'<li><a href="#{key}">{html.escape(name)}</a></li>' for key, name in anchors.items())
    return (
        f"<header><h1>{html.escape(report.title)}</h1>{subtitle}"
        + (f'<nav aria-label="Sections"><ul>{links}</ul></nav>' if len(anchors) > 1 else "")
        + (f'<dl class="cards">{cards}</dl>' if cards else "")
        + "</header>"
    )


def _card(card: Card) -> str:
    detail = f"<dd>{html.escape(card.detail)}</dd>" if card.detail else ""
    return f"<div><dt>{html.escape(card.label)}</dt><dd>{html.escape(card.value)}</dd>{detail}</div>"


def _section(anchor: str, section: Section) -> str:
    body = "\n".join(_item(item) for item in section.items)
    heading = f'<h2 id="{anchor}">{html.escape(section.title)}</h2>'
    return f'<section aria-labelledby="{anchor}">{heading}\n{body}\n</section>'


def _item(item: Note | DataTable | Picture | Chart) -> str:
    if isinstance(item, DataTable):
        return _table(item)
    if isinstance(item, Picture):
        return _picture(item)
    return render_chart(item) if isinstance(item, Chart) else f"<p>{html.escape(item.text)}</p>"


def _picture(picture: Picture) -> str:
    content, media, size = picture.content, "image/jpeg", ""
    if not isinstance(content, bytes):
        buffer = BytesIO()
        content.savefig(buffer, format="png", dpi=160)
        media, size = "image/png", f' width="{round(96 * content.get_figwidth())}"'
        content = buffer.getvalue()
    encoded, title = base64.b64encode(content).decode("ascii"), html.escape(picture.title)
    return (
        f'<figure class="panel"><img{size} alt="{html.escape(picture.description) or title}" '
        f'src="data:{media};base64,{encoded}"><figcaption>{title}</figcaption></figure>'
    )


def _table(table: DataTable) -> str:
    numeric = [
        all(isinstance(row[i], numbers.Real) or row[i] is None for row in table.rows)
        for i in range(len(table.columns))
    ]
    # The scripts make buttons of the ids: without them there is nothing that a click could do.
    kinds = [
        (' class="number"' if flag else "") + (" data-person" if column == table.person_column else "")
        for column, flag in zip(table.columns, numeric, strict=True)
    ]
    head = "".join(
        f'<th scope="col"{k}>{html.escape(c)}</th>' for c, k in zip(table.columns, kinds, strict=True)
    )
    body = "".join(
        "<tr>"
        + "".join(f"<td{k}>{html.escape(format_cell(cell))}</td>" for cell, k in zip(row, kinds, strict=True))
        + "</tr>\n"
        for row in table.rows
    )
    note = f'<p class="quiet">{html.escape(table.note)}</p>' if table.note else ""
    title = html.escape(table.title)
    # tabindex: a region that scrolls must be reachable with the keyboard.
    return (
        f'<div class="panel"><div class="scroll" tabindex="0" role="region" aria-label="{title}">'
        f"<table><caption>{title}</caption><thead><tr>{head}</tr></thead>\n"
        f"<tbody>{body}</tbody></table></div>{note}</div>"
    )


def _asset(name: str) -> str:
    return (resources.files("graphtrack.report") / "assets" / name).read_text(encoding="utf-8")
