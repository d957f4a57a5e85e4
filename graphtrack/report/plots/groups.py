"""Groups over time."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from graphtrack.behaviour.groups import Groups
from graphtrack.report.behaviour.spans import GroupSpan
from graphtrack.report.shapes import longest_step
from graphtrack.report.style import group_colour, new_figure, tidy

MOST = 40
"""Groups that a timeline has."""


def plot_group_timeline(groups: Groups, spans: Sequence[GroupSpan]) -> Figure:
    """Draw a band for each group, from when to when it was there, as tall as it had members.

    Those who walk together are hatched. Of more than `MOST` groups those with most person-seconds are shown.

    Parameters
    ----------
    groups : who is in which, over time
    spans : what is said of each group
    """
    largest = sorted(spans, key=lambda span: -span.person_seconds)[:MOST]
    shown = sorted(largest, key=lambda span: (span.start, span.number))
    most = max((span.largest for span in shown), default=1)
    figure = new_figure(9.5, 1.3 + 0.32 * max(len(shown), 3))
    axes = figure.add_subplot()
    for row, span in enumerate(shown):
        rows = groups.group == span.number
        t, size = np.unique(groups.t[rows], return_counts=True)
        step = longest_step(t)
        for part in np.split(np.arange(len(t)), np.flatnonzero(np.diff(t) > step) + 1):
            half = 0.42 * size[part] / most
            # A moment alone has no length of its own: half a step to either side.
            edge = t[part] if len(part) > 1 else t[part][0] + np.array([-step / 5.0, step / 5.0])
            half = half if len(part) > 1 else np.repeat(half, 2)
            axes.fill_between(
                edge,
                row - half,
                row + half,
                step="mid",
                facecolor=group_colour(span.number),
                alpha=0.8,
                hatch="///" if span.kind == 2 else None,
                edgecolor="white",
                linewidth=0.0,
            )
        members = f"{span.smallest}–{span.largest}" if span.smallest < span.largest else str(span.largest)
        axes.annotate(
            members, (span.end, row), xytext=(4, 0), textcoords="offset points", va="center", fontsize=8
        )
    axes.set_yticks(range(len(shown)), [str(span.number) for span in shown])
    axes.set_ylim(max(len(shown), 1) - 0.4, -0.6)
    if len(groups.t):
        # The whole recording, whether or not there were groups at its ends.
        axes.set_xlim(float(groups.t.min()), max(float(groups.t.max()), float(groups.t.min()) + 1e-3))
    axes.set(xlabel="time (s)", ylabel="group")
    tidy(axes, grid="x")
    return figure
