"""Legible pictures: nothing covers curves, and colours and axes do not exaggerate."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from graphtrack.interaction.attention import Attention, attention
from graphtrack.interaction.groups import groups
from graphtrack.report.plots import plot_reliability
from graphtrack.report.plots.interaction import plot_group_timeline, plot_look_timeline
from graphtrack.tracks.track import Track, TrackSet


def pair(seconds: float = 20.0) -> TrackSet:
    frame = np.arange(int(2 * seconds), dtype=np.int64)

    def still(one: int, x: float, head: float) -> Track:
        place = np.tile([x, 0.0], (len(frame), 1))
        return Track(
            one, frame, 0.5 * frame, place, head=np.full(len(frame), head), body=np.full(len(frame), head)
        )

    return TrackSet((still(1, 0.0, 0.0), still(2, 1.0, np.pi)))


def looking(tracks: TrackSet, share: float) -> list[Attention]:
    """Each person looks at the other with this probability, else at nothing."""
    made = []
    for one in attention(tracks):
        probability = np.zeros_like(one.probability)
        probability[:, 0], probability[:, -1] = share, 1.0 - share
        made.append(replace(one, probability=probability))
    return made


def legends_inside(figure) -> list[bool]:
    figure.canvas.draw()
    return [
        axes.get_window_extent().overlaps(axes.get_legend().get_window_extent())
        for axes in figure.axes
        if axes.get_legend() is not None
    ]


@pytest.mark.parametrize("methods", [1, 2, 6])
def test_the_legend_of_reliability_covers_no_curve(methods: int) -> None:
    shares = np.linspace(0.05, 0.95, 19)
    rows = [
        {"method": f"method {k}", "quantity": q, "nees": 1.0, "confidence": shares, "coverage": shares**0.1}
        for k in range(methods)
        for q in ("position", "velocity", "body")
    ]
    inside = legends_inside(plot_reliability(rows))
    assert len(inside) == 3 and not any(inside)


def test_the_timeline_of_looks_spans_the_recording() -> None:
    tracks = pair()
    found = looking(tracks, 0.9)
    for one in found:
        # Both look at each other for a moment in the middle only.
        late = np.abs(np.arange(len(one.t)) - 20) > 2
        one.probability[late] = 0.0
        one.probability[late, -1] = 1.0
    low, high = plot_look_timeline(found).axes[0].get_xlim()
    assert low <= 0.0 and high >= tracks.by_id(1).t[-1] and high - low < 1.1 * tracks.by_id(1).t[-1] + 1.0


def test_the_timeline_of_groups_spans_the_recording() -> None:
    found = groups(pair())
    low, high = plot_group_timeline(found, ()).axes[0].get_xlim()
    assert (low, high) == (found.t.min(), found.t.max())
