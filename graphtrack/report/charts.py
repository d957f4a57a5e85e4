"""Interactive charts (plotly) for the HTML report; they work in a notebook as well."""

from __future__ import annotations

from typing import Any

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from graphtrack.angles import FloatArray
from graphtrack.report.pairing import Pair, has_angle, observed_angle, pair_track
from graphtrack.report.replay import thin
from graphtrack.report.rows import ErrorRow, Rows, distinct, error_rows
from graphtrack.report.shapes import NORMAL_95, angle_bands, break_at_seam, open_holes
from graphtrack.report.style import ANGLE_COLOURS, quantity_colour
from graphtrack.tracks import Track

MARGIN = {"l": 60, "r": 10, "t": 30, "b": 45}
FONT = {"family": "system-ui, -apple-system, Segoe UI, Roboto, sans-serif", "size": 13}


def angles_chart(estimate: Track, observation: Track | None = None, *, max_rate: float = 20.0) -> Any:
    """Body and head of one person over time, as in `graphtrack.report.plots.plot_angles`, to zoom and hover.

    Parameters
    ----------
    estimate, observation : the same person's tracks
    max_rate : samples a second that are drawn

    Returns
    -------
    plotly.graph_objects.Figure
    """
    thinned = estimate[thin(estimate.t, max_rate)]
    pair = pair_track(thinned, None if observation is None else observation[thin(observation.t, max_rate)])
    names = [name for name in ANGLE_COLOURS if has_angle(pair, name)]
    panels = max(len(names), 1)
    figure = make_subplots(rows=panels, cols=1, shared_xaxes=True, vertical_spacing=0.06)
    shown: set[str] = set()
    for row, name in enumerate(names, start=1):
        for trace in _angle_traces(pair, name):
            # One entry in the legend switches a kind of trace in both panels.
            trace.update(showlegend=trace["legendgroup"] not in shown)
            shown.add(trace["legendgroup"])
            figure.add_trace(go.Scatter(trace), row=row, col=1)
        figure.update_yaxes(
            title_text=f"{name} (°)",
            range=[-180, 180],
            tickvals=[-180, -90, 0, 90, 180],
            fixedrange=True,
            row=row,
        )
    figure.update_xaxes(title_text="time (s)", row=panels)
    figure.update_layout(
        template="none",
        height=80 + 200 * panels,
        margin=MARGIN,
        font=FONT,
        legend={"orientation": "h", "y": 1.02, "yanchor": "bottom", "x": 0},
        hovermode="closest",
    )
    return figure


def errors_charts(comparison: Rows) -> dict[str, Any]:
    """A chart for each metric: a line a method with the median and its spread over the tracks.

    Parameters
    ----------
    comparison : DataFrame or list of dict
        As for `graphtrack.report.plots.plot_errors`.

    Returns
    -------
    dict
        Metric with its unit → plotly.graph_objects.Figure.

    Raises
    ------
    InputError
        When there are no rows or a column is missing.
    """
    rows = error_rows(comparison)
    methods = distinct(row.method for row in rows)
    charts = {}
    for metric in distinct(row.metric for row in rows):
        mine = [row for row in rows if row.metric == metric]
        unit = mine[0].unit
        title = metric.replace("_", " ") + (f" ({unit})" if unit else "")
        charts[title] = _errors_chart(mine, methods, quantity_colour(metric))
    return charts


def _errors_chart(rows: list[ErrorRow], methods: list[str], colour: str) -> Any:
    known = [row for row in rows if np.isfinite(row.median)]
    spread = {
        "type": "data",
        "array": [_positive(row.high - row.median) for row in known],
        "arrayminus": [_positive(row.median - row.low) for row in known],
        "color": colour,
        "thickness": 2,
    }
    figure = go.Figure(
        go.Scatter(
            x=[row.median for row in known],
            y=[_text(row.method) for row in known],
            mode="markers",
            marker={"size": 10, "color": colour},
            error_x=spread,
            hovertemplate="%{y}: %{x:.4g} " + _text(rows[0].unit) + "<extra></extra>",
        )
    )
    order = [_text(method) for method in methods]
    figure.update_yaxes(type="category", categoryorder="array", categoryarray=order, automargin=True)
    figure.update_yaxes(range=[len(order) - 0.5, -0.5], fixedrange=True)
    figure.update_xaxes(rangemode="tozero")
    margin = {**MARGIN, "l": 10, "t": 10, "b": 30}
    figure.update_layout(template="none", height=60 + 34 * len(methods), margin=margin, font=FONT)
    return figure


def _angle_traces(pair: Pair, name: str) -> list[dict[str, Any]]:
    colour, estimate = ANGLE_COLOURS[name], pair.estimate
    angle, std = getattr(estimate, name), estimate.std(name)
    traces: list[dict[str, Any]] = []
    if angle is not None and std is not None:
        for scale, opacity, label in ((NORMAL_95, 0.18, "95 %"), (1.0, 0.28, "±1σ")):
            outline = _band_outline(*open_holes(estimate.t, angle, scale * std))
            fill = {"fill": "toself", "fillcolor": _translucent(colour, opacity), "hoverinfo": "skip"}
            traces.append({**outline, "mode": "lines", "line": {"width": 0}, "name": label, **fill})
    observed = None if pair.observation is None else observed_angle(pair.observation, name)
    if pair.observation is not None and observed is not None and np.isfinite(observed).any():
        known = np.isfinite(observed)
        points = _points(pair.observation.t[known], observed[known])
        marker = {"size": 4, "color": colour, "opacity": 0.65}
        traces.append({**points, "mode": "markers", "marker": marker, "name": "observation"})
    if angle is not None and np.isfinite(angle).any():
        line = {"color": colour, "width": 2}
        mode = "lines" if len(estimate) > 1 else "markers"
        cut = _points(*break_at_seam(*open_holes(estimate.t, angle)))
        traces.append({**cut, "mode": mode, "line": line, "marker": {"color": colour}, "name": "estimate"})
    truth = pair.true_angle(name)
    if np.isfinite(truth).any():
        line = {"color": "#808080", "width": 1.5, "dash": "dash"}
        cut = _points(*break_at_seam(*open_holes(estimate.t, truth)))
        traces.append({**cut, "mode": "lines", "line": line, "name": "truth", "meta": "truth"})
    for trace in traces:
        trace["legendgroup"] = trace["name"]
        trace.setdefault("hovertemplate", f"%{{x:.2f}} s: {name} %{{y:.1f}}°<extra>{trace['name']}</extra>")
    return traces


def _points(t: FloatArray, angle: FloatArray) -> dict[str, list[float | None]]:
    """Lists short enough for a page: 1 ms and 0.1°."""
    return {
        "x": [round(float(value), 3) for value in t],
        "y": [round(float(np.degrees(value)), 1) if np.isfinite(value) else None for value in angle],
    }


def _band_outline(t: FloatArray, angle: FloatArray, half_width: FloatArray) -> dict[str, list[float | None]]:
    """All pieces of a band as closed outlines with a break between them."""
    x: list[float | None] = []
    y: list[float | None] = []
    for band in angle_bands(t, angle, half_width):
        times, edges = np.concatenate([band.t, band.t[::-1]]), np.concatenate([band.lower, band.upper[::-1]])
        piece = _points(times, edges)
        x += [*piece["x"], None]
        y += [*piece["y"], None]
    return {"x": x[:-1], "y": y[:-1]}


def _translucent(colour: str, opacity: float) -> str:
    red, green, blue = (int(colour[i : i + 2], 16) for i in (1, 3, 5))
    return f"rgba({red},{green},{blue},{opacity})"


def _positive(value: float) -> float:
    return max(value, 0.0) if np.isfinite(value) else 0.0


def _text(name: str) -> str:
    # Plotly reads a subset of HTML in its texts.
    return name.replace("_", " ").replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;")
