"""Plots of methods (errors, reliability diagrams) and of body and head over time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Literal

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, PercentFormatter

from graphtrack.report.content import Records, distinct, records
from graphtrack.report.lives import Pair, has_angle, observed_angle, pair_track
from graphtrack.report.style import (
    ANGLE_COLOURS,
    NEUTRAL_COLOUR,
    NORMAL_95,
    TRUTH_COLOUR,
    angle_bands,
    break_at_seam,
    finite_runs,
    new_figure,
    open_holes,
    person_dash,
    plain,
    quantity_colour,
    tidy,
)
from graphtrack.tracks.display import LONGEST, VELOCITY_COLOUR, person_colour
from graphtrack.tracks.track import Track

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


def _write_above(axes: Axes, value: float, y: int, align: Literal["left", "center"] = "center") -> None:
    axes.annotate(f"{value:.3g}", (value, y), xytext=(0, 7), textcoords="offset points", ha=align, fontsize=8)


def _words(name: Any) -> str:
    return plain(str(name).replace("_", " "), LONGEST)


_COLUMNS = ("method", "quantity", "nees", "confidence", "coverage")


def plot_reliability(calibration: Records, of: str = "truth") -> Figure:
    """Draw one panel a quantity: coverage of intervals against their nominal probability.

    Uncertainties are correct on the diagonal, too small below it, too large above it.

    Parameters
    ----------
    calibration : DataFrame or list of dict
        With ``method``, ``quantity`` (such as ``position``), ``nees`` per degree of freedom, ``confidence``
        and ``coverage`` (both sequences of as many shares), one row a method and quantity.
    of : what the intervals should contain, for the axis

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
    panels[0].set_ylabel(f"{of} inside", fontsize=9)
    words = "nominal probability      grey: correct; below: uncertainty too small; NEES next to each method"
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
    # Below the panel: inside, it would cover curves of underconfident methods.
    axes.legend(frameon=False, fontsize=7, loc="upper left", bbox_to_anchor=(0.0, -0.12), borderaxespad=0.0)
    tidy(axes)


def plot_angles(estimate: Track, observation: Track | None = None) -> Figure:
    """Draw the body and head orientation of one person over time, in degrees.

    One panel for each angle that is estimated or observed: the estimate with its ±1σ and 95 % bands, the
    observations as dots and the truth where it is known. Lines and bands that leave at +180° come in at
    −180°. Times without an observation of the angle are shaded.

    Parameters
    ----------
    estimate : with ``body`` and ``head`` where they are known, and ``covariance`` for the bands
    observation : the track it was estimated from

    Returns
    -------
    matplotlib.figure.Figure
    """
    pair = pair_track(estimate, observation)
    names = [name for name in ANGLE_COLOURS if has_angle(pair, name)]
    figure = new_figure(9.4, 1.0 + 2.3 * max(len(names), 1))
    figure.suptitle(plain(pair.title, LONGEST), x=0.01, ha="left", fontsize=11)
    if not names:
        axes = figure.add_subplot()
        axes.set_axis_off()
        axes.text(0.5, 0.5, "no angle was estimated or observed", ha="center", color=NEUTRAL_COLOUR)
        return figure
    panels = figure.subplots(len(names), 1, sharex=True, squeeze=False)[:, 0]
    for axes, name in zip(panels, names, strict=True):
        _draw_angle(axes, pair, name)
        axes.legend(loc="center left", bbox_to_anchor=(1.01, 0.5), frameon=False, fontsize=9)
    panels[-1].set_xlabel("time (s)")
    return figure


def plot_person(pair: Pair) -> Figure | None:
    """Draw speed, heading, body and head of one person over time, with 95 % intervals; None: none known.

    The heading is drawn where its interval is narrower than a half turn: nobody who stands has one.
    """
    moves = pair.estimate.velocity is not None and bool(np.isfinite(pair.estimate.velocity).any())
    names = ["speed", "heading"] if moves else []
    names += [name for name in ANGLE_COLOURS if has_angle(pair, name)]
    if not names:
        return None
    figure = new_figure(9.4, 0.8 + 1.7 * len(names))
    figure.suptitle(plain(pair.title, LONGEST), x=0.01, ha="left", fontsize=11)
    panels = figure.subplots(len(names), 1, sharex=True, squeeze=False)[:, 0]
    for axes, name in zip(panels, names, strict=True):
        if name in ANGLE_COLOURS:
            _draw_angle(axes, pair, name)
        else:
            _draw_motion(axes, pair.estimate, name)
        axes.legend(loc="center left", bbox_to_anchor=(1.01, 0.5), frameon=False, fontsize=9)
    panels[-1].set_xlabel("time (s)")
    return figure


def _draw_motion(axes: Axes, track: Track, name: str) -> None:
    """Draw the speed or the heading with its 95 % interval."""
    low, high = track.interval(name)
    if name == "speed":
        t, low, high, value = open_holes(track.t, low, high, track.speed)
        axes.fill_between(t, low, high, color=VELOCITY_COLOUR, alpha=0.2, linewidth=0, label="95 %")
        axes.set_ylim(bottom=0.0)
        axes.set_ylabel("speed (m/s)")
    else:
        half = 0.5 * (high - low)
        heading = np.where(half >= np.pi / 2.0, np.nan, track.heading)
        for i, band in enumerate(angle_bands(*open_holes(track.t, heading, half))):
            edges = np.degrees(band.lower), np.degrees(band.upper)
            label = "95 %" if i == 0 else None
            axes.fill_between(band.t, *edges, color=VELOCITY_COLOUR, alpha=0.2, linewidth=0, label=label)
        t, value = break_at_seam(*open_holes(track.t, heading))
        value = np.degrees(value)
        axes.set_ylim(-180.0, 180.0)
        axes.set_yticks(np.arange(-180, 181, 90))
        axes.set_ylabel("heading (°)")
    axes.plot(t, value, color=VELOCITY_COLOUR, linewidth=1.6, label="estimate", zorder=3)
    tidy(axes)


def _draw_angle(axes: Axes, pair: Pair, name: str) -> None:
    colour, estimate = ANGLE_COLOURS[name], pair.estimate
    angle, std = getattr(estimate, name), estimate.std(name)
    if pair.observation is not None:
        _draw_observed_angle(axes, pair.observation, name, colour)
    if angle is not None and np.isfinite(std).any():
        for scale, alpha, label in ((NORMAL_95, 0.16, "95 %"), (1.0, 0.26, "±1σ")):
            for i, band in enumerate(angle_bands(*open_holes(estimate.t, angle, scale * std))):
                axes.fill_between(
                    band.t,
                    np.degrees(band.lower),
                    np.degrees(band.upper),
                    color=colour,
                    alpha=alpha,
                    linewidth=0,
                    label=label if i == 0 else None,
                    zorder=1.5,
                )
    truth = pair.true_angle(name)
    if np.isfinite(truth).any():
        t, cut = break_at_seam(*open_holes(estimate.t, truth))
        axes.plot(t, np.degrees(cut), color=TRUTH_COLOUR, lw=1.0, dashes=(5, 2.5), label="truth", zorder=4)
    if angle is not None and np.isfinite(angle).any():
        t, cut = break_at_seam(*open_holes(estimate.t, angle))
        # A line needs two points: an angle known at a single frame between unknown ones would be invisible.
        alone = [run.start for run in finite_runs(np.isfinite(angle)) if run.stop - run.start == 1]
        axes.plot(t, np.degrees(cut), color=colour, linewidth=1.6, label="estimate", zorder=3)
        axes.plot(estimate.t[alone], np.degrees(angle[alone]), "D", color=colour, markersize=4, zorder=3)
    axes.set_ylim(-180.0, 180.0)
    axes.set_yticks(np.arange(-180, 181, 90))
    axes.set_ylabel(f"{name} (°)")
    tidy(axes)


def _draw_observed_angle(axes: Axes, observation: Track, name: str, colour: str) -> None:
    observed = observed_angle(observation, name)
    if observed is None:
        return
    known = np.isfinite(observed)
    axes.plot(
        observation.t[known],
        np.degrees(observed[known]),
        "o",
        color=colour,
        markersize=2.6,
        alpha=0.5,
        markeredgewidth=0,
        linewidth=0,
        label="observation",
        zorder=2,
    )
    shaded = False
    for run in finite_runs(~known):
        # From the last observation before the gap to the first one after it.
        start, stop = observation.t[max(run.start - 1, 0)], observation.t[min(run.stop, len(observation) - 1)]
        if run.stop - run.start >= 3:
            label = None if shaded else "not observed"
            axes.axvspan(start, stop, color="#EEF0F3", linewidth=0, zorder=0.5, label=label)
            shaded = True
