"""Where looks fall: on the ground, over time, and who looks at whom."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Circle, Polygon

from graphtrack.behaviour.attention import Attention
from graphtrack.behaviour.looks import LookSummary
from graphtrack.behaviour.places import Place
from graphtrack.geometry.angles import FloatArray
from graphtrack.io.atomic import atomic_path
from graphtrack.report.style import NEUTRAL_COLOUR, new_figure, person_colour, tidy
from graphtrack.tracks import TrackSet

_MOST = 40
"""People whom a timeline and a matrix name."""


def draw_looks(
    tracks: TrackSet,
    places: Sequence[Place],
    found: Sequence[Attention],
    summary: LookSummary,
    paths: Sequence[Path],
) -> None:
    """Write three pictures: a heat map of looks on the ground, a timeline, and the matrix."""
    figures = [new_figure(7.0, 6.0) for _ in paths]
    looks, timeline, matrix = (figure.add_subplot() for figure in figures)
    _heat_map(looks, tracks, places, found)
    _timeline(timeline, found)
    _matrix(matrix, summary)
    for figure, path in zip(figures, paths, strict=True):
        with atomic_path(path) as temporary:
            figure.savefig(temporary)


def _heat_map(axes: Axes, tracks: TrackSet, places: Sequence[Place], found: Sequence[Attention]) -> None:
    """Where people and places are that are looked at, weighted by the probability that they are."""
    points: list[FloatArray] = []
    weights: list[FloatArray] = []
    for one in found:
        for k, person in enumerate(one.people):
            other = tracks[person]
            _, mine, theirs = np.intersect1d(one.frame, other.frame, return_indices=True)
            points.append(other.position[theirs])
            weights.append(one.probability[mine, k])
        for k, place in enumerate(places):
            points.append(np.tile(place.centre, (len(one.frame), 1)))
            weights.append(one.probability[:, len(one.people) + k])
    if points:
        place_of, weight = np.concatenate(points), np.concatenate(weights)
        use = np.isfinite(place_of).all(axis=1) & (weight > 0.0)
        if use.any():
            x, y = place_of[use].T
            drawn = axes.hexbin(x, y, weight[use], gridsize=40, reduce_C_function=np.sum, cmap="magma_r")
            axes.figure.colorbar(drawn, ax=axes, label="looks, frames")
    for place in places:
        disc = Circle((float(place.centre[0]), float(place.centre[1])), place.radius)
        patch = disc if place.radius > 0.0 else Polygon(place.outline)
        patch.set(fill=False, edgecolor=NEUTRAL_COLOUR)
        axes.add_patch(patch)
        axes.annotate(place.name, tuple(place.centre), ha="center", fontsize=8)
    axes.set(xlabel="x, m", ylabel="y, m", title="Where looks fall", aspect="equal")
    tidy(axes)


def _timeline(axes: Axes, found: Sequence[Attention]) -> None:
    """The likeliest target of each person over time; a colour for each target."""
    shown = found[:_MOST]
    names = sorted({target for one in shown for target in one.targets[:-1]})
    for row, one in enumerate(shown):
        best = np.argmax(np.nan_to_num(one.probability, nan=-1.0), axis=1)
        for k, target in enumerate(one.targets[:-1]):
            use = best == k
            if use.any():
                axes.plot(
                    one.t[use], np.full(use.sum(), row), "|", ms=6, color=person_colour(names.index(target))
                )
    axes.set_yticks(range(len(shown)), [str(one.track_id) for one in shown])
    axes.set(xlabel="t, s", ylabel="who looks", title="At whom each looks most probably; blank: at nothing")
    tidy(axes, grid="x")


def _matrix(axes: Axes, summary: LookSummary) -> None:
    """Seconds that each looks at each target."""
    rows = min(len(summary.people), _MOST)
    names = summary.targets[:_MOST] if len(summary.targets) > _MOST else summary.targets
    if rows:
        drawn = axes.imshow(summary.matrix[:rows, : len(names)], cmap="magma_r", aspect="auto")
        axes.figure.colorbar(drawn, ax=axes, label="s")
    axes.set_xticks(range(len(names)), names, rotation=90, fontsize=7)
    axes.set_yticks(range(rows), [str(one) for one in summary.people[:rows]], fontsize=7)
    axes.set(xlabel="at what", ylabel="who looks", title="Who looks at whom")
