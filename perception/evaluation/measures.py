"""The reliability and the confusion of pose classifiers, as a figure."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from graphtrack.geometry.angles import FloatArray
from perception.pose.scores import PoseScores

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7")


def class_rates(confusion: NDArray[np.int64]) -> tuple[FloatArray, FloatArray]:
    """Return the true and false positive rates (k,) of each class; NaN for classes unseen."""
    of_class, said, hits = confusion.sum(axis=1), confusion.sum(axis=0), np.diag(confusion)
    with np.errstate(invalid="ignore", divide="ignore"):
        false = (said - hits) / (of_class.sum() - of_class)
        return hits / of_class, np.where(of_class > 0, false, np.nan)


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
        order = np.argsort(degrees[name])
        ticks = [f"{degree:.0f}" for degree in degrees[name][order]]
        title = f"{name.replace('_', ' ')}: {100 * found.accuracy:.0f} % right"
        draw_confusion(axes, found.confusion[np.ix_(order, order)], ticks, title, numbers=len(ticks) <= 8)
    return figure


def draw_confusion(
    axes: Axes, confusion: NDArray[np.number], names: Sequence[str], title: str, *, numbers: bool = True
) -> None:
    """Draw a confusion matrix (n, n), rows the true classes, in per cent of the true class.

    Parameters
    ----------
    names : of the classes, degrees
    numbers : whether cells show their per cent
    """
    percent = 100.0 * confusion / np.maximum(confusion.sum(axis=1, keepdims=True), 1e-9)
    axes.imshow(percent, cmap="Blues", vmin=0.0, vmax=100.0)
    axes.set_xticks(range(len(names)), names, fontsize=7, rotation=90)
    axes.set_yticks(range(len(names)), names, fontsize=7)
    for (row, column), value in np.ndenumerate(percent):
        if numbers and value >= 0.5:
            colour = "white" if value > 50.0 else "black"
            axes.text(column, row, f"{value:.0f}", ha="center", va="center", fontsize=7, color=colour)
    axes.set(xlabel="most likely (°)", ylabel="true (°)")
    axes.set_title(title, fontsize=9)
