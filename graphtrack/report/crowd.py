"""Page section on crowd measures: zones, lines, density and speed over time, and flow."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from matplotlib.figure import Figure

from graphtrack.geometry.walkable import AreaLike
from graphtrack.interaction.crowd import Columns, CrowdMeasures, crowd_measures
from graphtrack.interaction.people import Place
from graphtrack.report.content import DataTable, Note, Picture, Section
from graphtrack.report.methods import with_references
from graphtrack.report.style import group_colour, new_figure, tidy
from graphtrack.tracks.track import TrackSet

ZONES = {
    "zone": "zone",
    "area": "area (m²)",
    "people": "people",
    "entered": "entered",
    "left": "left",
    "mean_people": "mean number",
    "most_people": "largest number",
    "mean_stay": "mean stay (s)",
    "mean_density": "mean density (1/m²)",
    "most_density": "largest density (1/m²)",
    "mean_speed": "mean speed (m/s)",
}
"""Column of the summary of zones → heading."""

LINES = {
    "line": "line",
    "length": "length (m)",
    "crossed": "crossed",
    "to_left": "to the left",
    "to_right": "to the right",
    "flow": "flow (1/s)",
    "specific_flow": "specific flow (1/(m s))",
}
"""Column of the summary of lines → heading."""


_METHODS = (
    "Densities, speeds and flows were measured with PedPy ({pedpy}): densities by Voronoi cells, which end "
    "1 m from a person ({steffen}), and speeds in 0.4 s of the path."
)


def shown_rows(columns: Columns, headings: dict[str, str]) -> list[dict[str, object]]:
    """Return the rows of a summary under their headings."""
    parts = [columns[name].tolist() for name in headings] if columns else []
    return [dict(zip(headings.values(), row, strict=True)) for row in zip(*parts, strict=True)]


def crowd_sections(
    tracks: TrackSet, places: Sequence[Place] | str | Path, walkable: AreaLike | None = None
) -> tuple[Section, ...]:
    """Return the section on crowd measures, as `crowd_measures`."""
    found = crowd_measures(tracks, places, walkable=walkable)
    items: list[DataTable | Picture | Note] = []
    if found.zones:
        note = "Densities are those of Voronoi cells, measured by PedPy; a stay is a visit of one person."
        items.append(DataTable.of("Zones", shown_rows(found.zones, ZONES), note))
        items.append(Picture("Density over time, and speed against density", plot_density(found)))
    if found.lines:
        note = (
            "A person's first crossing counts; left and right of the way from the first to the second point."
        )
        items.append(DataTable.of("Lines", shown_rows(found.lines, LINES), note))
        times = [t for track in tracks for t in (float(track.t[0]), float(track.t[-1]))]
        figure = plot_crossings(found, min(times), max(times))
        items.append(Picture("People who have crossed each line", figure))
    text, works = with_references(_METHODS)
    items += [Note(text), *(Note(f"{one.cited}: {one.work}.") for one in works)]
    return (Section("Crowd measures", tuple(items)),)


def plot_density(found: CrowdMeasures) -> Figure:
    """Draw the Voronoi density of each zone over time, and speed against density."""
    figure = new_figure(9.5, 3.2)
    over_time, fundamental = figure.subplots(1, 2, width_ratios=(2, 1))
    columns = found.density
    for number, zone in enumerate(found.zones["zone"].tolist()):
        rows = columns["zone"] == zone
        density, colour = columns["voronoi_density"][rows], group_colour(number)
        over_time.plot(columns["t"][rows], density, color=colour, linewidth=1.2, label=str(zone))
        fundamental.scatter(density, columns["speed"][rows], s=8, color=colour, alpha=0.6, linewidths=0)
    over_time.set(xlabel="time (s)", ylabel="density (1/m²)")
    fundamental.set(xlabel="density (1/m²)", ylabel="speed (m/s)")
    over_time.legend(fontsize=8)
    for axes in (over_time, fundamental):
        axes.set_ylim(bottom=0.0)
        tidy(axes)
    return figure


def plot_crossings(found: CrowdMeasures, start: float, end: float) -> Figure:
    """Draw the number of people who have crossed each line, from the start to the end (seconds)."""
    figure = new_figure(9.5, 3.0)
    axes = figure.add_subplot()
    for number, line in enumerate(found.lines["line"].tolist()):
        rows = found.crossings["line"] == line
        t, count = found.crossings["t"][rows], found.crossings["count"][rows]
        steps = [start, *t.tolist(), end], [0, *count.tolist(), len(count)]
        axes.step(*steps, where="post", color=group_colour(number), label=str(line))
    axes.set(xlabel="time (s)", ylabel="people")
    axes.set_ylim(bottom=0.0)
    axes.legend(fontsize=8)
    tidy(axes)
    return figure
