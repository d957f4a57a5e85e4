"""The page of figures of yan-sigma-pi: cues and reliabilities over time, and success."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from graphtrack.report.style import new_figure, tidy
from perception.trackers.sigma_pi.network import CUES, TERM_NAMES
from perception.trackers.tracker import BoxEstimate

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_COLOURS = {
    "motion": "#0072B2",
    "colour": "#D55E00",
    "shape": "#009E73",
    "motion·colour": "#CC79A7",
    "motion·shape": "#56B4E9",
    "colour·shape": "#E69F00",
    "motion·colour·shape": "#5F6672",
    "sigma-pi": "#0072B2",
    "motion not adaptive": "#56B4E9",
    "as in the paper": "#66C7A3",
    "local features": "#E69F00",
    "motion alone": "#9AA1AB",
}


def page(
    shown: str,
    estimates: Sequence[BoxEstimate],
    success: Mapping[str, Mapping[str, np.ndarray]],
    paper: Mapping[str, float],
) -> Figure:
    """Cues and reliabilities in one sequence, and the success of all.

    Parameters
    ----------
    shown, estimates : name and estimates of the sequence
    success : sequence → method → (seeds,) per cent
    paper : sequence → per cent
    """
    figure = new_figure(12.0, 11.0)
    cues, reliabilities, bars = figure.subplots(3, 1, height_ratios=[1.0, 1.0, 1.3])
    frames = np.arange(len(estimates))
    for name in CUES:
        cues.plot(frames, [e.cues[name] for e in estimates], color=_COLOURS[name], lw=1.1, label=name)
    lost = np.array([not e.found for e in estimates])
    cues.fill_between(frames, 0, 1, where=lost, color="#D9DCE1", step="mid", label="not found", zorder=0)
    cues.set(ylabel="activity at the estimate", ylim=(0.0, 1.02), title=shown)
    for name in TERM_NAMES:
        values = [e.cues[f"reliability {name}"] for e in estimates]
        style = "-" if name in CUES else "--"
        reliabilities.plot(frames, values, style, color=_COLOURS[name], lw=1.1, label=name)
    reliabilities.set(ylabel="reliability α", xlabel="frame")
    for axes in (cues, reliabilities):
        axes.set_xlim(0, len(estimates) - 1)
        axes.legend(frameon=False, fontsize=8, loc="center left", bbox_to_anchor=(1.0, 0.5))
        tidy(axes, grid="y")
    _bars(bars, success, paper)
    return figure


def _bars(axes: Axes, success: Mapping[str, Mapping[str, np.ndarray]], paper: Mapping[str, float]) -> None:
    labelled = set()
    for k, (name, found) in enumerate(success.items()):
        width = 0.8 / len(found)
        for j, (method, values) in enumerate(found.items()):
            x = k + (j - (len(found) - 1) / 2.0) * width
            label = None if method in labelled else method
            labelled.add(method)
            axes.bar(x, values.mean(), 0.92 * width, color=_COLOURS[method], label=label, zorder=2)
            if len(values) > 1:
                axes.plot([x, x], [values.min(), values.max()], color="#222222", lw=1.0, zorder=3)
        if name in paper:
            label = "Yan et al. 2011, Table 1" if k == 0 else None
            axes.plot([k - 0.4, k + 0.4], [paper[name]] * 2, color="#D55E00", lw=1.6, zorder=4, label=label)
    many = len(success) > 6
    names = [name if many else name.replace(" and ", "\nand ") for name in success]
    axes.set_xticks(range(len(success)), names, fontsize=8)
    if many:
        axes.tick_params(axis="x", labelrotation=30)
        for tick in axes.get_xticklabels():
            tick.set_horizontalalignment("right")
    seeds = max(len(values) for found in success.values() for values in found.values())
    spread = f"; lines: least to greatest of {seeds} seeds" if seeds > 1 else ", one seed"
    axes.set(ylabel=f"success (%){spread}", ylim=(0.0, 102.0))
    axes.legend(frameon=False, fontsize=8, loc="center left", bbox_to_anchor=(1.0, 0.5))
    tidy(axes, grid="y")
