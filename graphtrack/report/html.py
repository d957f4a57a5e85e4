"""Report as one self-contained HTML file: no network, no server, no other file.

The templates ``assets/*.html`` (Jinja) make the page; ``assets/*.js`` has its behaviour.
"""

from __future__ import annotations

import base64
import json
import math
import numbers
import zlib
from collections.abc import Mapping
from functools import cache
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from graphtrack.io.atomic import atomic_path
from graphtrack.report.content import DataTable, Picture, Report
from graphtrack.report.lives import UNSURE
from graphtrack.report.style import GROUP_COLOURS
from graphtrack.tracks.display import BODY_COLOUR, HEAD_COLOUR, VELOCITY_COLOUR

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

COLOURS = {"body": BODY_COLOUR, "head": HEAD_COLOUR, "velocity": VELOCITY_COLOUR, "group": GROUP_COLOURS[0]}


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
    replay = report.replay if report.replay is not None and report.replay["people"] else None
    values: dict[str, Any] = {"report": report, "replay": replay, "layers": (), "people": ()}
    if replay is not None:
        values |= {"people": replay["people"], "layers": _layers(replay)}
        values |= {"frame": _frame(replay), "thinned": _thinned(replay)}
    return _environment().get_template("page.html").render(values)


@cache
def _environment() -> Environment:
    """Return the templates with what they use; all that they insert is escaped."""
    loader = PackageLoader("graphtrack.report", "assets")
    made = Environment(
        loader=loader,
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    made.globals |= {
        "asset": lambda name: Markup(loader.get_source(made, name)[0]),
        "packed": packed,
        "scripts": SCRIPTS,
        "colours": COLOURS,
        "unsure": UNSURE,
    }
    made.filters |= {"cell": format_cell, "kinds": _kinds, "image": _image}
    made.tests["dataclass"] = lambda item, name: type(item).__name__ == name
    return made


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


def _kinds(table: DataTable) -> list[Markup]:
    """Return the attributes of the cells of each column."""
    # The scripts turn the ids of people into buttons; without scripts a click does nothing.
    numeric = (
        all(isinstance(row[i], numbers.Real) or row[i] is None for row in table.rows)
        for i in range(len(table.columns))
    )
    return [
        Markup((' class="number"' if flag else "") + (" data-person" if name == table.person_column else ""))
        for name, flag in zip(table.columns, numeric, strict=True)
    ]


def _image(picture: Picture) -> dict[str, Any]:
    """Return a picture for an ``img``: its type, width in pixels if known, and content in base64."""
    width: int | None = None
    if isinstance(picture.content, bytes):
        content, media = picture.content, "image/jpeg"
    else:
        buffer = BytesIO()
        picture.content.savefig(buffer, format="png", dpi=160)
        content, media, width = buffer.getvalue(), "image/png", round(96 * picture.content.get_figwidth())
    return {"media": media, "width": width, "encoded": base64.b64encode(content).decode("ascii")}


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


def _layers(data: Mapping[str, Any]) -> set[str]:
    """Return the layers with data."""
    channels = {"body": "body", "head": "head", "velocity": "vx", "ellipse": "major"}
    channels |= {"observation": "seen_x", "truth": "true_x"}
    known = {
        layer
        for layer, channel in channels.items()
        if any(person[channel] is not None for person in data["people"])
    }
    views = any(one["outline"] for one in data["sensors"])
    has = {"lives": data["lives"], "events": bool(data["events"]), "views": views}
    has |= {"background": data["background"] is not None}
    has |= (data["behaviour"] or {"has": {}})["has"]
    return known | {"trail", "paths", "label"} | {layer for layer, there in has.items() if there}
