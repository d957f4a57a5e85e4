"""The chart of body and head as HTML: ``assets/angles.html`` with its legend.

What it draws and does is in ``assets/angles_*.js``.
"""

from __future__ import annotations

import html
from importlib import resources
from string import Template

from graphtrack.report.content import AngleChart
from graphtrack.report.replay_html import svg_key

_BAND = '<rect x="1" y="{top}" width="22" height="{height}" fill="var(--muted)" fill-opacity="{opacity}"/>'
_LINE = (
    '<line x1="1" y1="8" x2="23" y2="8" stroke="{colour}" stroke-width="{width}" stroke-dasharray="{dash}"/>'
)

_KEYS = {
    "estimate": _LINE.format(colour="var(--muted)", width=2.4, dash="none"),
    "±1σ": _BAND.format(top=4, height=8, opacity=0.45),
    "95 %": _BAND.format(top=1, height=14, opacity=0.2),
    "observation": '<circle cx="12" cy="8" r="2.6" fill="var(--muted)"/>',
    "truth": _LINE.format(colour="var(--ink)", width=1.3, dash="5 3"),
    "the replay's time": '<line x1="12" y1="0" x2="12" y2="16" stroke="var(--muted)"/>',
}


def render_angle_chart(chart: AngleChart) -> str:
    """The canvas, its controls and its legend. It needs the data of a replay in the same page."""
    template = (resources.files("graphtrack.report") / "assets" / "angles.html").read_text(encoding="utf-8")
    return Template(template).substitute(
        title=html.escape(chart.title),
        legend=" ".join(
            f'<span data-key="{words}">{svg_key(key)} {words}</span>' for words, key in _KEYS.items()
        ),
        note=f'<p class="quiet hint">{html.escape(chart.note)}</p>' if chart.note else "",
    )
