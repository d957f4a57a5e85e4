"""The replay's controls as HTML: ``assets/replay.html`` with what the data decide filled in.

What the controls do is in ``assets/replay_*.js``.
"""

from __future__ import annotations

import html
from collections.abc import Mapping
from importlib import resources
from string import Template
from typing import Any

_ARROW = (
    '<line x1="2" y1="8" x2="16" y2="8" stroke="var(--{name})" stroke-width="{width}"/>'
    '<path d="M15 {top} L23 8 L15 {bottom} Z" fill="var(--{name})"/>'
)

_KEYS = {
    "trail": '<path d="M2 12 C8 2 15 14 22 5" fill="none" stroke="var(--muted)" stroke-width="2.4"/>',
    "body": _ARROW.format(name="body", width=4, top=2, bottom=14),
    "head": _ARROW.format(name="head", width=2.4, top=3.5, bottom=12.5),
    "velocity": _ARROW.format(name="velocity", width=2, top=4, bottom=12),
    "ellipse": '<ellipse cx="12" cy="8" rx="10" ry="5.5" fill="var(--muted)" fill-opacity=".25" '
    'stroke="var(--muted)"/>',
    "observation": '<circle cx="12" cy="8" r="3.4" fill="var(--ink)"/>',
    "truth": '<circle cx="9" cy="8" r="6" fill="none" stroke="var(--ink)" stroke-width="1.3" '
    'stroke-dasharray="3 2"/><line x1="15" y1="8" x2="22" y2="8" stroke="var(--ink)" stroke-width="2"/>',
    "label": '<text x="12" y="13" text-anchor="middle" font-size="13" font-weight="600" fill="var(--ink)">'
    "12</text>",
}

_PERSON_KEY = '<circle cx="12" cy="8" r="6" fill="{colour}"/>'
_UNSEEN_KEY = '<circle cx="12" cy="8" r="5" fill="var(--surface)" stroke="var(--muted)" stroke-width="2.5"/>'


def render_replay(data: Mapping[str, Any]) -> str:
    """The stage, the controls, the layers that double as the legend, and a box for each person.

    Parameters
    ----------
    data : what `graphtrack.report.replay.replay_data` returned, with at least one person
    """
    people = data["people"]
    layers = [_layer(name, words, shown) for name, words, shown in _layers(people)]
    if any(person["seen"] is not None for person in people):
        layers.append(f"<span>{_svg(_UNSEEN_KEY)} not observed at this time</span>")
    template = (resources.files("graphtrack.report") / "assets" / "replay.html").read_text(encoding="utf-8")
    return Template(template).substitute(
        count="1 person" if len(people) == 1 else f"{len(people)} people",
        layers="\n".join(layers),
        people="\n".join(_person(person) for person in people),
        thinned="" if data["rate"] is None else f" Shown at {data['rate']:g} samples a second.",
    )


def _layers(people: list[Mapping[str, Any]]) -> list[tuple[str, str, bool]]:
    """Name, words and whether it starts switched on, for the layers that there are data for."""
    known = {
        "body": any(p["body"] is not None for p in people),
        "head": any(p["head"] is not None for p in people),
        "velocity": any(p["vx"] is not None for p in people),
        "ellipse": any(p["major"] is not None for p in people),
        "observation": any(p["seen_x"] is not None for p in people),
        "truth": any(p["true_x"] is not None for p in people),
    }
    layers = [
        ("body", "body", True),
        ("head", "head", True),
        ("velocity", "velocity (1 s)", False),
        ("ellipse", "95 % of position", True),
        ("trail", "path", True),
        ("observation", "observation", True),
        ("truth", "truth", False),
        ("label", "id", True),
    ]
    return [layer for layer in layers if known.get(layer[0], True)]


def _layer(name: str, words: str, shown: bool) -> str:
    checked = " checked" if shown else ""
    return f'<label><input type="checkbox" data-layer="{name}"{checked}>{_svg(_KEYS[name])} {words}</label>'


def _person(person: Mapping[str, Any]) -> str:
    words = html.escape(str(person["id"]) + (f" {person['label']}" if person["label"] else ""))
    key = _svg(_PERSON_KEY.format(colour=html.escape(str(person["colour"]))))
    return f'<label><input type="checkbox" data-person checked>{key} {words}</label>'


def _svg(content: str) -> str:
    return f'<svg class="key" viewBox="0 0 24 16" aria-hidden="true">{content}</svg>'
