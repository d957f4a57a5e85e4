"""The usual report of a tracking run, from tracks and comparison tables to a `Report`."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from graphtrack.angles import mean_absolute_error
from graphtrack.report.charts import angles_chart, errors_charts
from graphtrack.report.content import Card, Chart, Note, Picture, Report, Section, Table
from graphtrack.report.pairing import Pair, finite_rows, pair_tracks
from graphtrack.report.plots import plot_angles, plot_errors, plot_nees, plot_tracks
from graphtrack.report.plots.scene import CROWD
from graphtrack.report.replay import replay_data
from graphtrack.report.rows import Rows
from graphtrack.report.shapes import probability_ellipse
from graphtrack.tracks import ReadSummary, Track, TrackSet

MAX_CHARTS = 40
"""People with a chart of their own angles; the replay and the table have everybody."""

CLOCK_TIMES = 1e6
"""Seconds from which on times must be those of a clock, not of a recording."""

MAX_PICTURES = 6
"""The same for still pictures, which are larger."""


def tracking_report(
    estimates: TrackSet,
    observations: TrackSet | None = None,
    *,
    title: str = "Tracks",
    subtitle: str = "",
    comparison: Rows | None = None,
    consistency: Rows | None = None,
    cards: tuple[Card, ...] = (),
    sections: tuple[Section, ...] = (),
    interactive: bool = True,
) -> Report:
    """Put together what a reader of a tracking run wants to see.

    Parameters
    ----------
    estimates : the result
    observations : what it was estimated from, matched by ``track_id``; its summary of the reading is shown
    title, subtitle : str
    comparison : methods against each other, as for `graphtrack.report.plots.plot_errors`
    consistency : NEES of the methods, as for `graphtrack.report.plots.plot_nees`
    cards : further numbers for the top of the page
    sections : further sections, put at the end
    interactive : charts that zoom and hover (adds the 4.8 MB of plotly to the page) instead of still pictures

    Returns
    -------
    Report
        For `graphtrack.report.html.write_report`.

    Raises
    ------
    InputError
        When a comparison table has no rows or lacks a column.
    """
    estimates, observations, origin = _from_zero(estimates, observations)
    if origin:
        subtitle = f"{subtitle} Times count from {origin:.0f} s.".strip()
    pairs = pair_tracks(estimates, observations)
    picture = Picture(
        "Everybody's path from above" + (", with body and head at regular times" * (len(pairs) <= CROWD)),
        plot_tracks(estimates, observations),
        f"Bird's-eye view of the paths of {len(pairs)} people.",
    )
    parts = [
        Section("From above", (picture,)),
        _angles_section(pairs, interactive),
        Section("People", (people_table(pairs),)),
    ]
    if comparison is not None or consistency is not None:
        parts.append(_methods_section(comparison, consistency, interactive))
    summary = (estimates if observations is None else observations).summary
    if summary.rows_read or summary.notes:
        parts.append(Section("What was read", reading_items(summary)))
    return Report(
        title=title,
        subtitle=subtitle,
        cards=(*_cards(pairs), *cards),
        replay=replay_data(estimates, observations),
        sections=(*parts, *sections),
    )


def people_table(pairs: tuple[Pair, ...]) -> Table:
    """One line a person: extent in time, what was observed, uncertainty and, where truth is known, errors."""
    table: list[dict[str, Any]] = []
    for pair in pairs:
        estimate, line = pair.estimate, _errors(pair)
        step = np.diff(estimate.position[finite_rows(estimate.position)], axis=0)
        body_std, head_std = (_median_degrees(estimate.std(name)) for name in ("body", "head"))
        table.append(
            {
                "person": estimate.track_id,
                "label": estimate.label or (pair.observation.label if pair.observation is not None else ""),
                "from (s)": float(estimate.t[0]),
                "to (s)": float(estimate.t[-1]),
                "frames": len(estimate),
                "observed (%)": None if pair.seen is None else 100.0 * float(pair.seen.mean()),
                "path (m)": float(np.hypot(*step.T).sum()),
                "95 % radius (m)": _median_radius(pair),
                "body ±1σ (°)": body_std,
                "head ±1σ (°)": head_std,
                **line,
            }
        )
    columns = [c for c in (table[0] if table else {"person": 0}) if any(_is_known(row[c]) for row in table)]
    note = (
        "Uncertainties are medians over the frames; the 95 % radius is the longer half-axis of the ellipse."
    )
    return Table(
        "Results of each person", tuple(columns), tuple(tuple(row[c] for c in columns) for row in table), note
    )


def reading_items(summary: ReadSummary) -> tuple[Table | Note, ...]:
    """The reader's account: rows read, used and refused, reasons, and what was assumed."""
    rows: list[tuple[str, int]] = [("read", summary.rows_read), ("used", summary.rows_used)]
    rows += [(f"refused: {reason}", count) for reason, count in summary.refused.items()]
    table = Table(f"Rows of the input ({summary.format})", ("rows", "number"), tuple(rows))
    return (table, *(Note(note) for note in summary.notes))


def _from_zero(estimates: TrackSet, observations: TrackSet | None) -> tuple[TrackSet, TrackSet | None, float]:
    """Clock times such as seconds since 1970 are unreadable on an axis: count from the first whole second."""
    origin = float(np.floor(min((track.t[0] for track in estimates), default=0.0)))
    if origin < CLOCK_TIMES:
        return estimates, observations, 0.0

    def shift(track: Track) -> Track:
        return replace(track, t=track.t - origin)

    return estimates.map(shift), None if observations is None else observations.map(shift), origin


def _angles_section(pairs: tuple[Pair, ...], interactive: bool) -> Section:
    angled = [p for p in pairs if p.estimate.body is not None or p.estimate.head is not None]
    if not angled:
        return Section("Body and head", (Note("No body or head angle was estimated."),))
    if not interactive:
        pictures = [
            Picture(
                pair.name, plot_angles(pair.estimate, pair.observation), f"Angles of {pair.name} over time."
            )
            for pair in angled[:MAX_PICTURES]
        ]
        return Section("Body and head", (*pictures, *_left_out(len(angled), MAX_PICTURES)))
    charts = {pair.name: angles_chart(pair.estimate, pair.observation) for pair in angled[:MAX_CHARTS]}
    note = "Click on a point to take the replay to its time."
    chart = Chart("Orientation over time", charts, note=note, has_time=True)
    return Section("Body and head", (chart, *_left_out(len(angled), MAX_CHARTS)))


def _left_out(count: int, limit: int) -> tuple[Note, ...]:
    return (Note(f"The first {limit} of {count} people are shown."),) if count > limit else ()


def _methods_section(comparison: Rows | None, consistency: Rows | None, interactive: bool) -> Section:
    items: list[Note | Table | Picture | Chart] = []
    if comparison is not None:
        words = "Error of each method: the median, and its spread over the tracks"
        if interactive:
            items.append(Chart(words, errors_charts(comparison), choose=False))
        else:
            items.append(Picture(words, plot_errors(comparison)))
        items.append(Table.from_records("Comparison of methods", comparison))
    if consistency is not None:
        words = "Consistency: the mean NEES of each method, and the 95 % band it should lie in"
        items += [Picture(words, plot_nees(consistency)), Table.from_records("Consistency", consistency)]
    return Section("Methods", tuple(items))


def _cards(pairs: tuple[Pair, ...]) -> tuple[Card, ...]:
    frames = sum(len(pair.estimate) for pair in pairs)
    times = [pair.estimate.t for pair in pairs]
    seconds = max(t[-1] for t in times) - min(t[0] for t in times) if times else 0.0
    cards = [Card("People", str(len(pairs))), Card("Person-frames", f"{frames:,}".replace(",", "\u202f"))]
    cards.append(Card("Duration", f"{seconds:.1f} s"))
    seen = [pair.seen for pair in pairs if pair.seen is not None]
    if seen:
        cards.append(Card("Observed", f"{100.0 * np.concatenate(seen).mean():.1f} %", "of the person-frames"))
    errors = [_errors(pair) for pair in pairs]
    for column, label, unit in (
        ("position RMSE (m)", "Position error", "m"),
        ("body error (°)", "Body error", "°"),
        ("head error (°)", "Head error", "°"),
    ):
        known = [value for e in errors if (value := e[column]) is not None]
        if known:
            cards.append(Card(label, f"{np.median(known):.3g} {unit}", "median over people"))
    return tuple(cards)


def _errors(pair: Pair) -> dict[str, float | None]:
    """Errors of one person where the truth is known, else None."""
    estimate = pair.estimate
    squared = ((estimate.position - pair.true_position) ** 2).sum(axis=1)
    squared = squared[np.isfinite(squared)]
    line: dict[str, float | None] = {
        "position RMSE (m)": float(np.sqrt(squared.mean())) if squared.size else None
    }
    for name in ("body", "head"):
        angle = getattr(estimate, name)
        error = np.nan if angle is None else np.degrees(mean_absolute_error(angle, pair.true_angle(name)))
        line[f"{name} error (°)"] = float(error) if np.isfinite(error) else None
    return line


def _median_radius(pair: Pair) -> float | None:
    if pair.estimate.covariance is None:
        return None
    radius = probability_ellipse(pair.estimate.covariance[:, :2, :2]).semi_major
    radius = radius[np.isfinite(radius)]
    return float(np.median(radius)) if radius.size else None


def _median_degrees(std: Any) -> float | None:
    std = None if std is None else std[np.isfinite(std)]
    return None if std is None or not std.size else float(np.degrees(np.median(std)))


def _is_known(value: Any) -> bool:
    return value is not None and value != ""
