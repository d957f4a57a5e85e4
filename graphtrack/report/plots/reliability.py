"""Reliability diagrams: coverage of intervals against their probability."""

from __future__ import annotations

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, PercentFormatter

from graphtrack.display import person_colour
from graphtrack.report.rows import Records, distinct, records
from graphtrack.report.style import NEUTRAL_COLOUR, new_figure, person_dash, tidy

_COLUMNS = ("method", "quantity", "nees", "confidence", "coverage")


def plot_reliability(calibration: Records) -> Figure:
    """Draw one panel a quantity: the share of the truth inside intervals, by the probability they state.

    On the diagonal uncertainties are right, below it too small, above it too large.

    Parameters
    ----------
    calibration : DataFrame or list of dict
        With ``method``, ``quantity`` (such as ``position``), ``nees`` per degree of freedom, ``confidence``
        and ``coverage`` (both sequences of as many shares), one row a method and quantity.

    Returns
    -------
    matplotlib.figure.Figure

    Raises
    ------
    InputError
        When there are no rows or a column is missing.
    """
    rows = records(calibration, _COLUMNS)
    methods = distinct(row["method"] for row in rows)
    quantities = distinct(row["quantity"] for row in rows)
    figure = new_figure(0.9 + 2.7 * len(quantities), 3.4 + 0.17 * len(methods))
    panels = figure.subplots(1, len(quantities), squeeze=False, sharex=True, sharey=True).ravel()
    for axes, quantity in zip(panels, quantities, strict=True):
        axes.plot([0.0, 1.0], [0.0, 1.0], color="#C9CED6", linewidth=4.0, zorder=1)
        for row in rows:
            if row["quantity"] == quantity:
                place = methods.index(str(row["method"]))
                axes.plot(
                    (0.0, *row["confidence"], 1.0),
                    (0.0, *row["coverage"], 1.0),
                    color=person_colour(place),
                    dashes=person_dash(place),
                    linewidth=1.6,
                    label=f"{row['method']}: {row['nees']:.2f}",
                )
        _finish(axes, quantity)
    panels[0].set_ylabel("truth inside", fontsize=9)
    words = "stated probability      grey: right; below: uncertainty too small; with each method its NEES"
    figure.supxlabel(words, fontsize=9, color=NEUTRAL_COLOUR)
    return figure


def _finish(axes: Axes, quantity: str) -> None:
    axes.set_title(quantity, loc="left", fontsize=10)
    axes.set_aspect("equal")
    axes.set_xlim(0.0, 1.0)
    axes.set_ylim(0.0, 1.0)
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_locator(FixedLocator((0.0, 0.25, 0.5, 0.75, 1.0)))
        axis.set_major_formatter(PercentFormatter(1.0, symbol=" %"))
    # Below the panel: inside, it would cover curves of methods that state too much.
    axes.legend(frameon=False, fontsize=7, loc="upper left", bbox_to_anchor=(0.0, -0.12), borderaxespad=0.0)
    tidy(axes)
