"""Report as one self-contained HTML file: no network, no server, no other file.

The replay and the charts fill in the templates ``assets/*.html``; ``assets/*.js`` has their behaviour.
"""

from __future__ import annotations

import base64
import html
import json
import math
import numbers
import zlib
from collections.abc import Mapping
from importlib import resources
from io import BytesIO
from pathlib import Path
from string import Template
from typing import Any

import numpy as np

from graphtrack.io.atomic import atomic_path
from graphtrack.report.content import Card, Chart, DataTable, Note, Picture, Report, Section
from graphtrack.report.lives import UNSURE
from graphtrack.report.style import GROUP_COLOURS
from graphtrack.tracks.display import BODY_COLOUR, HEAD_COLOUR, VELOCITY_COLOUR

_ARROW = (
    '<line x1="2" y1="8" x2="16" y2="8" stroke="var(--{name})" stroke-width="{width}"/>'
    '<path d="M15 {top} L23 8 L15 {bottom} Z" fill="var(--{name})"/>'
)

_KEYS = {
    "trail": '<path d="M2 12 C8 2 15 14 22 5" fill="none" stroke="var(--muted)" stroke-width="2.4"/>',
    "paths": '<path d="M1 13 C8 0 16 16 23 3 M1 5 C9 16 14 0 23 12" fill="none" stroke="var(--muted)" '
    'stroke-opacity=".6"/>',
    "body": _ARROW.format(name="body", width=4, top=2, bottom=14),
    "head": _ARROW.format(name="head", width=2.4, top=3.5, bottom=12.5),
    "velocity": _ARROW.format(name="velocity", width=2, top=4, bottom=12),
    "ellipse": '<ellipse cx="12" cy="8" rx="10" ry="5.5" fill="var(--muted)" fill-opacity=".25" '
    'stroke="var(--muted)"/>',
    "observation": '<circle cx="12" cy="8" r="3.4" fill="var(--ink)"/>',
    "truth": '<circle cx="9" cy="8" r="6" fill="none" stroke="var(--ink)" stroke-width="1.3" '
    'stroke-dasharray="3 2"/><line x1="15" y1="8" x2="22" y2="8" stroke="var(--ink)" stroke-width="2"/>',
    "lives": '<circle cx="6" cy="8" r="4" fill="none" stroke="var(--ink)" stroke-width="1.6"/>'
    '<path d="M14 4 L22 12 M22 4 L14 12" stroke="var(--ink)" stroke-width="1.6"/>',
    "events": '<rect x="7" y="3" width="10" height="10" fill="var(--alarm)"/>',
    "groups": f'<g fill="{GROUP_COLOURS[0]}" fill-opacity=".25" stroke="{GROUP_COLOURS[0]}">'
    '<rect x="1" y="2" width="22" height="12" rx="6"/>'
    '<circle cx="12" cy="8" r="3" stroke-dasharray="2 2"/></g>',
    "looks": '<line x1="2" y1="13" x2="22" y2="3" stroke="var(--head)" stroke-width="1.4"/>',
    "fans": '<path d="M1 8 H20" stroke="var(--muted)" stroke-dasharray="3 2"/><circle cx="17" cy="8" r="6.4" '
    'fill="var(--muted)" fill-opacity=".15" stroke="var(--muted)"/><circle cx="17" cy="8" r="3" '
    'fill="var(--muted)" fill-opacity=".4"/>',
    "places": '<rect x="4" y="3" width="16" height="10" fill="var(--muted)" fill-opacity=".15" '
    'stroke="var(--muted)" stroke-dasharray="2 2"/>',
    "label": '<text x="12" y="13" text-anchor="middle" font-size="13" font-weight="600" fill="var(--ink)">'
    "12</text>",
}

_UNSEEN_KEY = '<circle cx="12" cy="8" r="5" fill="var(--surface)" stroke="var(--muted)" stroke-width="2.5"/>'


_BAND = '<rect x="1" y="{top}" width="22" height="{height}" fill="var(--muted)" fill-opacity="{opacity}"/>'
_LINE = (
    '<line x1="1" y1="8" x2="23" y2="8" stroke="{colour}" stroke-width="{width}" stroke-dasharray="{dash}"/>'
)

_CHART_PICTURES = {
    "estimate": _LINE.format(colour="var(--muted)", width=2.4, dash="none"),
    "±1σ": _BAND.format(top=4, height=8, opacity=0.45),
    "95 %": _BAND.format(top=1, height=14, opacity=0.2),
    "observation": '<circle cx="12" cy="8" r="2.6" fill="var(--muted)"/>',
    "not observed": '<rect x="1" y="1" width="22" height="14" fill="var(--grid)"/>',
    "truth": _LINE.format(colour="var(--ink)", width=1.3, dash="5 3"),
    "the replay's time": '<line x1="12" y1="0" x2="12" y2="16" stroke="var(--muted)"/>',
}
_CHART_KEYS = {words: (picture, words) for words, picture in _CHART_PICTURES.items()}

_DIAMOND = '<path d="M12 2 L18 8 L12 14 L6 8 Z" fill="{fill}" stroke="var(--ink)" stroke-width="1.5"/>'
_CROSS = '<path d="M7 3 L17 13 M17 3 L7 13" stroke="var(--ink)" stroke-width="2" fill="none"/>'
_RING = '<circle cx="12" cy="8" r="5" fill="var(--surface)" stroke="var(--ink)" stroke-width="2"/>'
_ALARM = '<rect x="7" y="3" width="10" height="10" fill="{fill}" stroke="var(--alarm)" stroke-width="1.8"/>'

_LIFE_KEYS = {
    "birth": (_RING, "birth"),
    "death": (_CROSS, "death"),
    "sure": (
        '<rect x="0" y="3" width="11" height="10" fill="var(--muted)"/>'
        '<rect x="13" y="3" width="11" height="10" fill="var(--muted)" fill-opacity=".35"/>',
        "observed, less certain",
    ),
    "filled": (_LINE.format(colour="var(--muted)", width=2.4, dash="2.4 2.4"), "not observed, filled in"),
    "hole": (_LINE.format(colour="var(--muted)", width=1.5, dash="1.5 4"), "not observed, left open"),
    "join": (_DIAMOND.format(fill="var(--ink)"), "observed again, joined"),
    "unsure": (_DIAMOND.format(fill="var(--surface)"), f"joined, less than {100 * UNSURE:.0f}\u202f% sure"),
    "switch": (
        '<path d="M12 0 V16" stroke="var(--alarm)" stroke-width="1.2"/>' + _ALARM.format(fill="var(--alarm)"),
        "identity switch",
    ),
    "fragmentation": (_ALARM.format(fill="var(--surface)"), "found again (fragmentation)"),
}
"""Name → picture and label of the elements of a timeline."""


def render_replay(data: Mapping[str, Any]) -> str:
    """Return the canvas, controls and layers, which serve as the legend; scripts add the list of people.

    Parameters
    ----------
    data : result of `graphtrack.report.replay.replay_data`, with at least one person
    """
    people = data["people"]
    layers = [
        f'<label><input type="checkbox" data-layer="{name}"{" checked" if shown else ""}>'
        f"{svg_key(_KEYS[name])} {words}</label>"
        for name, words, shown in _layers(data)
    ]
    if any(person["seen"] is not None for person in people):
        layers.append(f"<span>{svg_key(_UNSEEN_KEY)} not observed at this time</span>")
    return _template("replay.html").substitute(
        count="1 person" if len(people) == 1 else f"{len(people)} people",
        layers="\n".join(layers),
        example=html.escape(people[0]["id"]),
        step=_frame(data),
        thinned=_thinned(data),
    )


def render_chart(chart: Chart) -> str:
    """Return the canvas, its controls and its legend. It needs the data of a replay in the same page."""
    keys = _CHART_KEYS if chart.kind == "angles" else _LIFE_KEYS
    legend = (f'<span data-key="{name}">{svg_key(key)} {words}</span>' for name, (key, words) in keys.items())
    return _template(f"{chart.kind}.html").substitute(
        title=html.escape(chart.title),
        legend=" ".join(legend),
        note=f'<p class="quiet hint">{html.escape(chart.note)}</p>' if chart.note else "",
    )


def svg_key(content: str) -> str:
    """Return a small picture for a legend, 24 by 16 units, of SVG elements."""
    return f'<svg class="key" viewBox="0 0 24 16" aria-hidden="true">{content}</svg>'


def _template(name: str) -> Template:
    return Template((resources.files("graphtrack.report") / "assets" / name).read_text(encoding="utf-8"))


def _frame(data: Mapping[str, Any]) -> str:
    """Return the duration of a frame, if frames are uniform."""
    frame = data["frame"]
    if frame is None:
        return ""
    frames = np.concatenate([person["t"][1:] for person in data["people"]]) * data["steps"]["time"] / frame
    return f" ({frame:.3g} s)" if np.mean(np.abs(frames - np.round(frames)) < 0.05) > 0.9 else ""


def _thinned(data: Mapping[str, Any]) -> str:
    """Describe the data that the page leaves out."""
    fans = (data["behaviour"] or {}).get("fans")
    left_out = "" if fans is None or fans["every"] == 1 else f" One forecast in {fans['every']} is shown."
    if data["kept"] == data["of"]:
        return left_out
    kept, of = (f"{data[name]:,}".replace(",", "\u202f") for name in ("kept", "of"))
    return (
        f" To keep the page small, the replay and the charts show {kept} of {of} person-frames, "
        f"one every {data['frame']:.3g} s; tables and pictures use all of them.{left_out}"
    )


def _layers(data: Mapping[str, Any]) -> list[tuple[str, str, bool]]:
    """Return name, label and initial visibility of the layers with data."""
    people: list[Mapping[str, Any]] = data["people"]
    behaviour = data["behaviour"]
    known = {
        "body": any(p["body"] is not None for p in people),
        "head": any(p["head"] is not None for p in people),
        "velocity": any(p["vx"] is not None for p in people),
        "ellipse": any(p["major"] is not None for p in people),
        "observation": any(p["seen_x"] is not None for p in people),
        "truth": any(p["true_x"] is not None for p in people),
        "lives": data["lives"],
        "events": bool(data["events"]),
        **dict.fromkeys(("groups", "looks", "fans", "places"), False),
        **(behaviour["has"] if behaviour else {}),
    }
    layers = [
        ("body", "body", True),
        ("head", "head", True),
        ("velocity", "velocity (1 s)", False),
        ("ellipse", "95 % of position", True),
        ("trail", "trail", True),
        ("paths", "whole paths", True),
        ("groups", "groups, o-space", True),
        ("looks", "looks", True),
        ("fans", "forecast, 50 and 90\u202f%", True),
        ("places", "places", True),
        ("observation", "observation", True),
        ("truth", "truth", False),
        ("lives", "births, deaths, joins", True),
        ("events", "switches", True),
        ("label", "id", True),
    ]
    return [layer for layer in layers if known.get(layer[0], True)]


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
"""Scripts in page order; together they form one function."""


_COLOURS = f":root {{ --body: {BODY_COLOUR}; --head: {HEAD_COLOUR}; --velocity: {VELOCITY_COLOUR}; }}"


def write_html(path: str | Path, report: Report) -> None:
    """Write a report as one self-contained HTML file, atomically.

    Raises
    ------
    InputError
        If the path is not writable.
    """
    page = render_report(report)
    with atomic_path(path) as temporary:
        temporary.write_text(page, encoding="utf-8")


def render_report(report: Report) -> str:
    """Return the page as text. Text is escaped; data are packed, so that they cannot end their element."""
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
    """Return JSON compressed (zlib) in base64: a third of its size, and it cannot end its element.

    Raises
    ------
    ValueError
        For a value that JSON cannot represent, such as NaN.
    """
    text = json.dumps(data, separators=(",", ":"), allow_nan=False)
    return base64.b64encode(zlib.compress(text.encode("utf-8"))).decode("ascii")


def format_cell(value: Any) -> str:
    """Format a value: numbers to four digits, a dash for a missing value. Not escaped."""
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
        # Four digits, without an exponent for usual sizes.
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
    # The scripts turn the ids into buttons; without scripts a click does nothing.
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
    # tabindex: a scrolling region must be reachable with the keyboard.
    return (
        f'<div class="panel"><div class="scroll" tabindex="0" role="region" aria-label="{title}">'
        f"<table><caption>{title}</caption><thead><tr>{head}</tr></thead>\n"
        f"<tbody>{body}</tbody></table></div>{note}</div>"
    )


def _asset(name: str) -> str:
    return (resources.files("graphtrack.report") / "assets" / name).read_text(encoding="utf-8")
