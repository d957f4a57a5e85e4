"""Methods against each other: errors with their spread, and consistency (NEES) with its χ² band."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Literal

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from graphtrack.errors import InputError
from graphtrack.evaluation.calibration import chi_square_band
from graphtrack.report.rows import Records, distinct, records
from graphtrack.report.style import NEUTRAL_COLOUR, new_figure, quantity_colour, tidy

PANELS_A_LINE = 3


def plot_errors(comparison: Records) -> Figure:
    """Draw one panel a metric: the median of each method as a dot, its spread over the tracks as a line.

    Parameters
    ----------
    comparison : DataFrame or list of dict
        With ``method``, ``metric``, ``unit``, ``median``, ``low`` and ``high``, one row a method and metric.
        ``low`` and ``high`` may be NaN; a row without a finite median is left empty.

    Returns
    -------
    matplotlib.figure.Figure

    Raises
    ------
    InputError
        When there are no rows or a column is missing.
    """
    rows = records(comparison, ("method", "metric", "unit"), ("median", "low", "high"))
    methods, metrics = distinct(row["method"] for row in rows), distinct(row["metric"] for row in rows)
    figure, panels = _panels(len(metrics), len(methods))
    for axes, metric in zip(panels, metrics, strict=True):
        mine = [row for row in rows if row["metric"] == metric]
        _draw_errors(axes, mine, methods)
        unit = mine[0]["unit"]
        axes.set_title(_words(metric) + (f" ({unit})" if unit else ""), loc="left", fontsize=10)
    return figure


def plot_nees(consistency: Records) -> Figure:
    """Draw the mean normalised estimation error squared (NEES) of each method against its χ² band.

    A method whose covariances are right has a mean NEES equal to the number of dimensions, 95 % of the time
    within the band; to the right of it the covariances are too small (overconfident), to the left too large.

    Parameters
    ----------
    consistency : DataFrame or list of dict
        With ``method``, ``quantity`` (such as ``position``), ``nees`` (the mean), ``dof`` (dimensions of one
        error) and ``count`` (how many *independent* errors the mean is over: errors of neighbouring frames
        are not independent, so count tracks or well-separated frames).

    Returns
    -------
    matplotlib.figure.Figure

    Raises
    ------
    InputError
        When there are no rows, a column is missing, or ``dof`` or ``count`` is not positive.
    """
    rows = records(consistency, ("method", "quantity"), ("nees", "dof", "count"))
    for row in rows:
        for column in ("dof", "count"):
            if not row[column] > 0.0:
                raise InputError(f"{row[column]} for {row['method']}", "a positive number", column=column)
    methods, quantities = distinct(row["method"] for row in rows), distinct(row["quantity"] for row in rows)
    figure, panels = _panels(len(quantities), len(methods))
    for axes, quantity in zip(panels, quantities, strict=True):
        _draw_nees(axes, [row for row in rows if row["quantity"] == quantity], methods)
        axes.set_title(f"NEES of {_words(quantity)}", loc="left", fontsize=10)
    figure.supxlabel("← covariance too large      grey: 95 % χ² band      covariance too small →", fontsize=9)
    return figure


def _panels(n_panels: int, n_methods: int) -> tuple[Figure, list[Axes]]:
    columns = min(n_panels, PANELS_A_LINE)
    lines = -(-n_panels // columns)
    figure = new_figure(2.2 + 2.9 * columns, lines * (1.0 + 0.34 * n_methods) + 0.2)
    grid = figure.subplots(lines, columns, squeeze=False, sharey=True).ravel()
    for axes in grid[n_panels:]:
        axes.remove()
    return figure, list(grid[:n_panels])


def _method_axis(axes: Axes, methods: Sequence[str]) -> None:
    axes.set_yticks(range(len(methods)), [_words(method) for method in methods])
    axes.set_ylim(len(methods) - 0.4, -0.6)
    tidy(axes, grid="x")
    axes.tick_params(axis="y", length=0)


def _draw_errors(axes: Axes, rows: list[Mapping[str, Any]], methods: Sequence[str]) -> None:
    ends: list[float] = []
    most = max((v for r in rows for v in (r["median"], r["high"]) if np.isfinite(v)), default=0.0)
    for row in rows:
        median, span = row["median"], [row["low"], row["high"]]
        if not np.isfinite(median):
            continue
        y, colour = methods.index(str(row["method"])), quantity_colour(row["metric"])
        if np.isfinite(span).all():
            axes.plot(span, [y, y], color=colour, lw=3.0, alpha=0.35, solid_capstyle="round")
            ends += span
        axes.plot(median, y, "o", color=colour, markersize=7, markeredgecolor="white")
        # A number in the middle above a dot at the axis would lie across it.
        _write_above(axes, median, y, "left" if 0.0 <= median < 0.08 * most else "center")
        ends.append(median)
    _method_axis(axes, methods)
    # From zero, so that lengths compare; a metric that can be negative keeps its own range.
    if ends and min(ends) >= 0.0:
        axes.set_xlim(0.0, max(ends) * 1.12 or 1.0)


def _draw_nees(axes: Axes, rows: list[Mapping[str, Any]], methods: Sequence[str]) -> None:
    shown: list[float] = []
    for row in rows:
        nees, dof = row["nees"], row["dof"]
        y, (low, high) = methods.index(str(row["method"])), chi_square_band(dof, row["count"])
        axes.barh(y, high - low, left=low, height=0.4, color="#C9CED6", zorder=1)
        axes.plot([dof, dof], [y - 0.2, y + 0.2], color=NEUTRAL_COLOUR, linewidth=1.0, zorder=2)
        shown += [low, high]
        if np.isfinite(nees) and nees > 0.0:
            inside = low <= nees <= high
            colour = quantity_colour(row["quantity"])
            # Filled inside the band and hollow outside: the verdict does not hang on a colour.
            axes.plot(
                nees,
                y,
                "o",
                color=colour,
                markerfacecolor=colour if inside else "white",
                markersize=8,
                markeredgewidth=1.8,
                zorder=3,
            )
            _write_above(axes, nees, y)
            shown.append(nees)
    _method_axis(axes, methods)
    axes.set_xscale("log")
    axes.set_xlim(min(shown) / 1.5, max(shown) * 1.5)
    wide = max(shown) / min(shown) > 100.0
    axes.xaxis.set_major_locator(LogLocator(subs=(1.0,) if wide else (1.0, 2.0, 5.0)))
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.xaxis.set_minor_formatter(NullFormatter())


def _write_above(axes: Axes, value: float, y: int, align: Literal["left", "center"] = "center") -> None:
    axes.annotate(f"{value:.3g}", (value, y), xytext=(0, 7), textcoords="offset points", ha=align, fontsize=8)


def _words(name: Any) -> str:
    return str(name).replace("_", " ").replace("$", r"\$")
