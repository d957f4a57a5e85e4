"""Colours of the methods, the same in every figure; from Okabe & Ito (2008)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes

from graphtrack.evaluation.reproduce.experiment import ISAM2
from graphtrack.geometry.angles import FloatArray
from graphtrack.report.style import tidy

COLOURS = {
    "observation": "#9AA1AB",
    "kf": "#5F6672",
    "kf fitted": "#94641A",
    "printed": "#E69F00",
    "consistent": "#D55E00",
    "intentional": "#CC79A7",
    "particle": "#009E73",
    "particle joint": "#009E73",
    "particle joint-intentional": "#66C7A3",
    "graph": "#0072B2",
    "graph joint": "#0072B2",
    "graph joint-intentional": "#56B4E9",
    "rts": "#5F6672",
    "ffbs": "#009E73",
    "ffbs joint": "#009E73",
    "ffbs joint-intentional": "#66C7A3",
    "smoother": "#0072B2",
    "smoother joint": "#0072B2",
    "smoother joint-intentional": "#56B4E9",
}
"""Method → colour; an offline method has that of its online like."""


def colour_of(method: str) -> str:
    """The colour of a method, whichever engine solves it."""
    return COLOURS[method.removesuffix(ISAM2)]


def filling(method: str) -> str:
    """What its markers are filled with: those of iSAM2 are hollow, for it would lie on the chain's."""
    return "white" if method.endswith(ISAM2) else colour_of(method)


def bars(
    axes: Axes,
    groups: Sequence[str],
    values: Mapping[str, Sequence[float]],
    spans: Mapping[str, Sequence[tuple[float, float]]] | None = None,
) -> None:
    """Bars of several methods side by side for each group, with spans as whiskers."""
    width = 0.8 / len(values)
    place = np.arange(len(groups), dtype=float)
    for k, (method, heights) in enumerate(values.items()):
        x = place + (k - 0.5 * (len(values) - 1)) * width
        axes.bar(
            x,
            heights,
            0.92 * width,
            facecolor=filling(method),
            edgecolor=colour_of(method),
            hatch="////" if method.endswith(ISAM2) else None,
            label=method,
            zorder=2,
        )
        if spans is not None:
            for at, (low, high) in zip(x, spans[method], strict=True):
                axes.plot([at, at], [low, high], color="#222222", linewidth=1.0, zorder=3)
    axes.set_xticks(place, list(groups))
    tidy(axes, grid="y")


def with_whiskers(
    axes: Axes, x: FloatArray, median: FloatArray, half: FloatArray, method: str, *, line: bool = True
) -> None:
    """Medians with ± whiskers."""
    axes.errorbar(
        x,
        median,
        yerr=half,
        color=colour_of(method),
        markerfacecolor=filling(method),
        marker="o",
        markersize=4.5,
        linewidth=1.2 if line else 0.0,
        elinewidth=1.0,
        capsize=2.0,
        label=method,
        zorder=3,
    )
