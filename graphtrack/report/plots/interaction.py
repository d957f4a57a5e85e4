"""Plots of groups over time, and of gaze: on the ground, over time and between people."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import PowerNorm
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Polygon

from graphtrack.geometry.angles import FloatArray
from graphtrack.interaction.attention import Attention, LookSummary, frame_seconds
from graphtrack.interaction.groups import Groups
from graphtrack.interaction.people import HELD, Place, interpolated
from graphtrack.report.interaction import GroupSpan
from graphtrack.report.style import (
    NEUTRAL_COLOUR,
    finite_runs,
    group_colour,
    longest_step,
    new_figure,
    open_holes,
    plain,
    tidy,
)
from graphtrack.tracks.display import listed, person_colour, rgb
from graphtrack.tracks.track import TrackSet
from graphtrack.tracks.validation import finite_rows

MOST = 40
"""Most groups in a timeline."""

_AT_AXIS = 3
"""Most members of a group whose names are at the axis."""


def plot_group_timeline(groups: Groups, spans: Sequence[GroupSpan], people: Mapping[int, str]) -> Figure:
    """Draw a band for each group over its time span, with the number of members as height.

    People walking together are hatched. Of more than `MOST` groups those with most person-seconds are shown.

    Parameters
    ----------
    groups : members of groups over time
    spans : summary of each group
    people : track id → name; the first names of a group's members are at the axis
    """
    largest = sorted(spans, key=lambda span: -span.person_seconds)[:MOST]
    shown = sorted(largest, key=lambda span: (span.start, span.number))
    most = max((span.largest for span in shown), default=1)
    figure = new_figure(9.5, 1.3 + 0.32 * max(len(shown), 3))
    axes = figure.add_subplot()
    for row, span in enumerate(shown):
        rows = groups.group == span.number
        t, size = np.unique(groups.t[rows], return_counts=True)
        step = longest_step(t)
        for part in np.split(np.arange(len(t)), np.flatnonzero(np.diff(t) > step) + 1):
            half = 0.42 * size[part] / most
            # A moment alone has no length of its own: half a step to either side.
            edge = t[part] if len(part) > 1 else t[part][0] + np.array([-step / 5.0, step / 5.0])
            half = half if len(part) > 1 else np.repeat(half, 2)
            axes.fill_between(
                edge,
                row - half,
                row + half,
                step="mid",
                facecolor=group_colour(span.number),
                alpha=0.8,
                hatch="///" if span.kind == 2 else None,
                edgecolor="white",
                linewidth=0.0,
            )
        members = f"{span.smallest}–{span.largest}" if span.smallest < span.largest else str(span.largest)
        axes.annotate(
            members, (span.end, row), xytext=(4, 0), textcoords="offset points", va="center", fontsize=8
        )
    members_of = [plain(listed([people[one] for one in span.members], _AT_AXIS), 40) for span in shown]
    labels = [f"{names}   {span.number}" for names, span in zip(members_of, shown, strict=True)]
    axes.set_yticks(range(len(shown)), labels)
    axes.set_ylim(max(len(shown), 1) - 0.4, -0.6)
    if len(groups.t):
        # The whole recording, whether or not there were groups at its ends.
        axes.set_xlim(float(groups.t.min()), max(float(groups.t.max()), float(groups.t.min()) + 1e-3))
    axes.set(xlabel="time (s)", ylabel="members, group")
    tidy(axes, grid="x")
    return figure


_HEXAGON = 0.3
"""Metres that a hexagon of the heat map is wide: about as wide as a person; in a large scene wider."""

_LEAST_SECONDS = 1.0
"""Smallest range of the heat map's colours in seconds, so that short gaze is drawn faint."""

_LEAST_SHARE = 10.0
"""Per cent of the time that the matrix's colours span at least."""

_WRITTEN = 14
"""Up to so many people and targets the matrix has its numbers."""


def plot_heat_map(tracks: TrackSet, places: Sequence[Place], found: Sequence[Attention]) -> Figure:
    """Draw a heat map of gaze targets on the ground, weighted by expected seconds."""
    drawn = [place for place in places if any(place.name in one.places for one in found)]
    points, weights = _aims(tracks, drawn, found)
    known = np.concatenate([np.zeros((0, 2)), *(t.position[finite_rows(t.position)] for t in tracks)])
    span = np.maximum(np.ptp(known, axis=0), 1.0) if len(known) else np.ones(2)
    height = float(np.clip(6.0 * span[1] / span[0], 3.2, 7.5))
    width = float(np.clip(height * span[0] / span[1], 3.5, 9.0))
    figure = new_figure(width + 1.8, height + 0.9, layout="compressed")
    axes = figure.add_subplot()
    for track in tracks:
        _, x, y = open_holes(track.t, *track.position.T)
        axes.plot(x, y, color=NEUTRAL_COLOUR, linewidth=0.5, alpha=0.35)
    if len(points):
        room = np.maximum(np.ptp(points, axis=0), _HEXAGON)
        size = max(_HEXAGON, float(room.max()) / 60.0)
        wide, high = np.ceil(room / (size, np.sqrt(3.0) * size)).astype(int)
        patches = axes.hexbin(
            points[:, 0],
            points[:, 1],
            C=weights,
            gridsize=(wide, high),
            reduce_C_function=np.sum,
            cmap="magma_r",
        )
        most = max(float(np.asarray(patches.get_array(), dtype=float).max()), _LEAST_SECONDS)
        patches.set_norm(PowerNorm(0.5, vmin=0.0, vmax=most))
        patches.set_zorder(2)
        bar = figure.colorbar(patches, ax=axes, shrink=0.8, pad=0.02)
        bar.set_label("seconds of gaze")
        bar.outline.set_visible(False)
    for place in places:
        _draw_place(axes, place)
    axes.set(xlabel="x (m)", ylabel="y (m)", aspect="equal")
    tidy(axes)
    return figure


def plot_look_timeline(found: Sequence[Attention], people: Mapping[int, str]) -> Figure:
    """Draw the most probable gaze target of each person over time, labelled if there is room; blank: none.

    Of more than `MOST` people those with most gaze at targets are shown.

    Parameters
    ----------
    people : track id → name
    """
    spent = [_seconds(one)[:-1].sum() for one in found]
    shown = [found[k] for k in np.sort(np.argsort(spent, kind="stable")[::-1][:MOST])]
    targets = sorted({target for one in shown for target in one.targets[:-1]}, key=_key)
    names = {target: k for k, target in enumerate(targets)}
    figure = new_figure(9.5, 1.3 + 0.28 * max(len(shown), 4))
    axes = figure.add_subplot()
    joined = np.concatenate([np.zeros(0) if found else np.zeros(1), *(one.t for one in found)])
    second = 9.0 * 72.0 / max(float(np.ptp(joined)), 1e-9)
    for row, one in enumerate(shown):
        best = np.argmax(np.nan_to_num(one.probability, nan=-1.0), axis=1)
        seconds = frame_seconds(one.t)
        for k in np.unique(best[best < len(one.targets) - 1]).tolist():
            target = one.targets[k]
            runs = [run for run in finite_runs(best == k) if seconds[run].sum() > 0.0]
            starts = [float(one.t[run.start] - seconds[run.start] / 2) for run in runs]
            bars = list(zip(starts, [float(seconds[run].sum()) for run in runs], strict=True))
            colour = person_colour(names[target])
            axes.broken_barh(bars, (row - 0.4, 0.8), facecolors=colour, linewidth=0)
            ink = "white" if _is_dark(colour) else "#1C2026"
            name = plain(people[int(target[1])] if target[0] == "person" else target[1])
            for start, length in bars:
                if length * second > 6.5 * len(name):
                    middle = (start + length / 2, row)
                    axes.annotate(name, middle, ha="center", va="center", fontsize=7, color=ink)
    axes.set_yticks(range(len(shown)), [plain(people[one.track_id]) for one in shown])
    axes.set_ylim(len(shown) - 0.4, -0.6)
    half = max((float(frame_seconds(one.t).max(initial=0.0)) / 2.0 for one in found), default=0.0)
    axes.set_xlim(float(joined.min()) - max(half, 1e-3), float(joined.max()) + max(half, 1e-3))
    axes.set(xlabel="time (s)", ylabel="who looks")
    tidy(axes, grid="x")
    return figure


def _is_dark(colour: str) -> bool:
    """Return whether white text on a colour has more contrast than dark text (relative luminance)."""
    red, green, blue = ((c / 255.0) ** 2.2 for c in rgb(colour))
    return 0.2126 * red + 0.7152 * green + 0.0722 * blue < 0.18


def named_targets(summary: LookSummary, people: Mapping[int, str]) -> list[str]:
    """Return the names of the targets of a summary; ``people`` has those of the track ids."""
    return [*(people[one] for one in summary.people), *summary.targets[len(summary.people) :]]


def plot_matrix(summary: LookSummary, order: Sequence[int], people_names: Mapping[int, str]) -> Figure:
    """Draw the share of each person's time with gaze at each target, %; the last column is no target.

    Parameters
    ----------
    order : ids of people, in which they stand. Of more than `MOST` the first.
    people_names : track id → name
    """
    people = list(order)[:MOST]
    rows = [summary.people.index(one) for one in people]
    places = [k for k, name in enumerate(summary.targets) if k >= len(summary.people)]
    columns = [*rows, *places]
    time = summary.matrix.sum(axis=1, keepdims=True)
    share = 100.0 * np.divide(summary.matrix, time, out=np.zeros_like(summary.matrix), where=time > 0.0)
    share = share[np.ix_(rows, columns)]
    targets = named_targets(summary, people_names)
    names = [plain(targets[k]) for k in columns]
    few = len(columns) <= _WRITTEN + 2
    size = 0.42 if few else 0.22
    figure = new_figure(size * len(columns) + 2.4, size * max(len(rows), 3) + 1.6)
    axes = figure.add_subplot()
    # Nothing is the most frequent of all: the colours are for the rest.
    most = max(float(share[:, :-1].max(initial=0.0)), _LEAST_SHARE)
    image = axes.imshow(share, cmap="magma_r", vmin=0.0, vmax=most)
    bar = figure.colorbar(image, ax=axes, shrink=0.8, pad=0.02, extend="max")
    bar.set_label("share of the time (%)")
    bar.outline.set_visible(False)
    for (i, j), value in np.ndenumerate(share) if few else ():
        colour = "white" if value > 0.55 * most else "#1C2026"
        if value >= 0.5:
            axes.annotate(f"{value:.0f}", (j, i), ha="center", va="center", fontsize=8, color=colour)
    axes.set_xticks(range(len(names)), names, rotation=90 if max(map(len, names)) > 3 else 0, fontsize=8)
    axes.set_yticks(range(len(rows)), [plain(people_names[one]) for one in people], fontsize=8)
    axes.axvline(len(columns) - 1.5, color="white", linewidth=3.0)
    axes.set(xlabel="at what", ylabel="who looks")
    axes.spines[:].set_visible(False)
    axes.tick_params(length=0)
    return figure


def _key(target: tuple[str, str]) -> tuple[str, int, str]:
    kind, name = target
    return kind, int(name) if kind == "person" else 0, name


def _seconds(one: Attention) -> FloatArray:
    """Return the expected seconds (targets,) of a person's gaze at each target."""
    total: FloatArray = np.nansum(one.probability * frame_seconds(one.t)[:, None], axis=0)
    return total


def _aims(
    tracks: TrackSet, places: Sequence[Place], found: Sequence[Attention]
) -> tuple[FloatArray, FloatArray]:
    """Return gaze targets (m, 2), and the expected seconds of gaze at each."""
    points: list[FloatArray] = [np.empty((0, 2))]
    weights: list[FloatArray] = [np.empty(0)]
    at = {place.name: place.centre for place in places}
    for one in found:
        seconds = frame_seconds(one.t)
        for k, (kind, name) in enumerate(one.targets[:-1]):
            if kind == "person":
                other = tracks.by_id(int(name))
                known = finite_rows(other.position)
                if not known.any():
                    continue
                place, since, until = interpolated(other.t[known], other.position[known], one.t, online=False)
                points.append(place)
                near = np.minimum(since, until) < HELD
                weights.append(np.where(near, one.probability[:, k] * seconds, 0.0))
            elif name in at:
                points.append(np.tile(at[name], (len(one.frame), 1)))
                weights.append(one.probability[:, k] * seconds)
    where, weight = np.concatenate(points), np.concatenate(weights)
    use = np.isfinite(where).all(axis=1) & (weight > 1e-6)
    return where[use], weight[use]


def _draw_place(axes: Axes, place: Place) -> None:
    disc = Circle((float(place.centre[0]), float(place.centre[1])), place.radius)
    patch = disc if place.radius > 0.0 else Polygon(place.outline)
    patch.set(fill=False, edgecolor=NEUTRAL_COLOUR, linestyle=":", zorder=3)
    axes.add_patch(patch)
    above = place.outline[:, 1].max() + place.radius
    axes.annotate(
        plain(place.name),
        (place.centre[0], above),
        xytext=(0, 2),
        textcoords="offset points",
        ha="center",
        fontsize=8,
        zorder=4,
    )
