"""The reliability and the confusion of pose classifiers, as a figure."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from perception.pose.scores import PoseScores

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7")


def reliability_figure(scores: Mapping[str, PoseScores], degrees: Mapping[str, np.ndarray]) -> Figure:
    """Accuracy against confidence of classifiers by name, and the confusion matrix of each.

    Parameters
    ----------
    scores : on the same kind of images
    degrees : (n_pan,) centres of the pan classes of each
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(4.2 + 3.4 * len(scores), 3.9 + 0.16 * len(scores)), layout="constrained")
    curves, *squares = figure.subplots(1, 1 + len(scores), width_ratios=[1.2] + [1.0] * len(scores))
    curves.plot([0, 1], [0, 1], color="#8A8F98", lw=1, ls="--")
    for (name, found), colour in zip(scores.items(), _COLOURS * len(scores), strict=False):
        curve = found.reliability
        label = f"{name.replace('_', ' ')}, error {curve.expected_calibration_error:.3f}"
        curves.plot(curve.confidence, curve.accuracy, color=colour, lw=1.2, label=label)
        curves.scatter(
            curve.confidence, curve.accuracy, s=160 * curve.count / curve.count.sum(), color=colour
        )
    curves.set(xlim=(0, 1), ylim=(0, 1), xlabel="likelihood of the most likely class", ylabel="share right")
    curves.set_title("Reliability (area of a dot: images)", fontsize=10)
    # Below the axes: inside, it would cover curves of classifiers that are too modest.
    curves.legend(
        fontsize=7.5, loc="upper left", bbox_to_anchor=(0.0, -0.16), borderaxespad=0.0, frameon=False
    )
    for (name, found), axes in zip(scores.items(), squares, strict=True):
        _confusion(axes, found, degrees[name], name)
    return figure


def _confusion(axes: Axes, found: PoseScores, degrees: np.ndarray, name: str) -> None:
    share = found.confusion / np.maximum(found.confusion.sum(axis=1, keepdims=True), 1)
    order = np.argsort(degrees)
    share = share[np.ix_(order, order)]
    axes.imshow(share, cmap="Blues", vmin=0.0, vmax=1.0)
    ticks = [f"{degrees[k]:.0f}" for k in order]
    axes.set_xticks(range(len(ticks)), ticks, rotation=90, fontsize=7)
    axes.set_yticks(range(len(ticks)), ticks, fontsize=7)
    for (row, column), value in np.ndenumerate(share):
        if value >= 0.005 and len(ticks) <= 8:
            colour = "white" if value > 0.5 else "black"
            axes.text(column, row, f"{100 * value:.0f}", ha="center", va="center", fontsize=7, color=colour)
    axes.set(xlabel="most likely, degrees", ylabel="true, degrees")
    axes.set_title(f"{name.replace('_', ' ')}: {100 * found.accuracy:.0f} % right", fontsize=10)
