"""The scene from above: paths, observations, arrows, uncertainty and gaps."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Ellipse as EllipsePatch
from matplotlib.patches import Patch
from numpy.typing import NDArray

from graphtrack.geometry.angles import FloatArray, unit
from graphtrack.report.lives import Pair, pair_tracks
from graphtrack.report.style import (
    ANGLE_COLOURS,
    NEUTRAL_COLOUR,
    TRUTH_COLOUR,
    finite_runs,
    known_angle,
    longest_step,
    new_figure,
    open_holes,
    person_dash,
    plain,
    probability_ellipse,
    tidy,
)
from graphtrack.tracks.display import person_colour
from graphtrack.tracks.track import Track, TrackSet
from graphtrack.tracks.validation import finite_rows

if TYPE_CHECKING:
    from graphtrack.report.background import Backdrop, GroundImage
    from graphtrack.report.sensors import ShownSensor

MARKED_GAP = 3
"""Gaps of at least this many frames get a marker at each end; shorter ones are only dotted."""

DOTS: Any = (0.0, (0.01, 1.7))
"""Line style, with round caps, of an unobserved path."""

NAMED_PEOPLE = 10
"""Up to this many people are named in the legend; with more, only ids next to the paths are drawn."""

CROWD = 40
"""With more people than this only paths are drawn: arrows, ellipses and ids would hide them."""


ARROW_INCHES = {"body": 0.33, "head": 0.24}
"""Lengths of arrows on paper, so that they can be read in a room and in a car park."""

ASIDE_INCHES = 0.055
"""Offset of arrows from the path, the body's to the left and the head's to the right."""

VISIBLE_INCHES = 0.08
"""Median semi-axis below which ellipses are enlarged by a factor that the legend states."""


def plot_tracks(
    estimates: TrackSet,
    observations: TrackSet | None = None,
    *,
    arrow_interval: float | None = None,
    title: str = "",
    background: Backdrop | None = None,
) -> Figure:
    """Draw all paths from above, in metres with equal axes.

    Body and head arrows, next to the path, and the 95 % ellipses of the position are drawn at regular
    intervals of time where the person was observed. Elsewhere the path is dotted, and longer gaps end in
    hollow circles. Ellipses too small to be seen are enlarged; the legend states the factor. Of more than
    `CROWD` people only the paths are drawn, in thin lines.

    Parameters
    ----------
    estimates : tracks with whatever channels they have; people without a finite position are left out
    observations : the tracks they were estimated from, matched by ``track_id``

    arrow_interval : seconds between arrows; by default about a dozen for each person, fewer in a crowd
    title : shown above the axes
    background : a photo or a floor plan to draw under the paths

    Returns
    -------
    matplotlib.figure.Figure

    Raises
    ------
    InputError
        For a background that shows none of the paths.
    """
    pairs = pair_tracks(estimates, observations)
    ground = None if background is None else background.on_ground([track.position for track in estimates])
    return plot_pairs(pairs, arrow_interval=arrow_interval, title=title, background=ground)


def plot_pairs(
    pairs: tuple[Pair, ...],
    *,
    arrow_interval: float | None = None,
    title: str = "",
    sensors: Sequence[ShownSensor] = (),
    background: GroundImage | None = None,
) -> Figure:
    """`plot_tracks` of tracks that are already paired with their observations, with fields of view.

    With ``sensors``, observations have the colours of their sensors; with a ``background`` an image is under
    the paths.
    """
    extent = _extent(pairs)
    span_x, span_y = extent[1] - extent[0]
    # The page follows the scene, within what fits a screen: inches for the axes, then room for the legend.
    height = float(np.clip(7.0 * span_y / span_x, 3.2, 8.0))
    width = height * span_x / span_y
    inch = float(span_y) / height
    # The margin holds an arrow from the outermost position; axes come out somewhat smaller than planned.
    margin = 1.3 * (ARROW_INCHES["body"] + ASIDE_INCHES) * inch
    extent = extent + margin * np.array([[-1.0], [1.0]])
    figure = new_figure(width + 3.0, height + 0.9, layout="compressed")
    axes = figure.add_subplot()
    axes.set_aspect("equal", adjustable="box")
    axes.set_xlim(extent[0, 0], extent[1, 0])
    axes.set_ylim(extent[0, 1], extent[1, 1])
    axes.set_xlabel("x (m)")
    axes.set_ylabel("y (m)")
    if title:
        axes.set_title(title, loc="left", fontsize=11)
    tidy(axes)
    if background is not None:
        background.draw(axes)
    for one in sensors:
        if one.outline is not None:
            ring = np.vstack([one.outline, one.outline[:1]])
            style = (0.0, (5.0, 3.0)) if one.learned else "-"
            axes.plot(*ring.T, color=one.colour, linewidth=1.1, linestyle=style, zorder=1)
    colours = {one.name: one.colour for one in sensors}
    if is_crowd(pairs):
        for index, pair in enumerate(pairs):
            _, x, y = open_holes(pair.estimate.t, *pair.estimate.position.T)
            axes.plot(x, y, color=person_colour(index), linewidth=0.6, alpha=0.6)
        _name_some(axes, pairs, inch)
        return figure
    size = 1.0 if len(pairs) <= 8 else 0.65
    interval = _nice_interval(pairs) if arrow_interval is None else arrow_interval
    chosen = [_regular_samples(pair.estimate.t, _worth_an_arrow(pair), interval) for pair in pairs]
    enlarged = _enlargement(pairs, chosen, inch)
    for index, (pair, at) in enumerate(zip(pairs, chosen, strict=True)):
        colour, dash = person_colour(index), person_dash(index)
        _draw_observations(axes, pair, colour, colours)
        axes.plot(*pair.true_position.T, color=TRUTH_COLOUR, linewidth=0.9, dashes=(5, 2.5), zorder=2.5)
        _draw_path(axes, pair, colour, dash)
        _draw_ellipses(axes, pair, at, colour, enlarged)
        for name in ("body", "head"):
            _draw_heading(axes, pair.estimate, name, at, size, inch)
        _draw_id(axes, pair, colour)
    handles = _legend(pairs, enlarged)
    handles += [_key(one.title, linewidth=1.1, marker=".", color=one.colour) for one in sensors]
    if handles:
        figure.legend(handles=handles, loc="outside right upper", frameon=False, fontsize=9)
    else:
        nothing = "no positions to draw"
        axes.text(0.5, 0.5, nothing, transform=axes.transAxes, ha="center", color=NEUTRAL_COLOUR)
    return figure


def is_crowd(pairs: tuple[Pair, ...]) -> bool:
    """True if more than `CROWD` people have a position to draw."""
    return sum(bool(finite_rows(pair.estimate.position).any()) for pair in pairs) > CROWD


def _extent(pairs: tuple[Pair, ...]) -> FloatArray:
    """Lower and upper corner (2, 2) of all that is drawn, with a margin, at least two metres wide."""
    clouds = [pair.estimate.position for pair in pairs]
    clouds += [pair.observation.position for pair in pairs if pair.observation is not None]
    clouds += [pair.true_position for pair in pairs]
    points = np.concatenate([np.empty((0, 2)), *clouds])
    points = points[finite_rows(points)]
    if not len(points):
        return np.array([[-1.0, -1.0], [1.0, 1.0]])
    low, high = points.min(axis=0), points.max(axis=0)
    half = np.maximum((high - low) / 2.0, 1.0)
    # A scene much longer than wide would leave a strip too thin to read: show more around it.
    half = np.maximum(half, half.max() / 3.0) * 1.08
    middle = (low + high) / 2.0
    return np.stack([middle - half, middle + half])


def _nice_interval(pairs: tuple[Pair, ...]) -> float:
    longest = max((float(np.ptp(pair.estimate.t)) for pair in pairs), default=0.0)
    return _round_up(longest / (12.0 if len(pairs) <= 8 else 7.0)) if longest > 0.0 else 1.0


def _round_up(wanted: float) -> float:
    """Return the smallest of 1, 2, 5 times a power of ten that is at least ``wanted``."""
    decade = 10.0 ** np.floor(np.log10(wanted))
    # 10 catches what rounding lets through.
    return float(decade * next((step for step in (1.0, 2.0, 5.0) if step * decade >= wanted), 10.0))


def _regular_samples(t: FloatArray, usable: NDArray[np.bool_], interval: float) -> NDArray[np.intp]:
    """The first usable sample of every interval of time, so that all people get arrows at the same times."""
    at = np.nonzero(usable)[0]
    slot = np.floor(t[at] / interval + 1e-9)
    return at[np.unique(slot, return_index=True)[1]]


def _worth_an_arrow(pair: Pair) -> NDArray[np.bool_]:
    """Observed samples with a position, or all with a position where none was observed."""
    placed = finite_rows(pair.estimate.position)
    observed = placed if pair.was_observed is None else placed & pair.was_observed
    return observed if observed.any() else placed


def _enlargement(pairs: tuple[Pair, ...], chosen: list[NDArray[np.intp]], inch: float) -> float:
    """Factor, from 1, 2, 5, 10 …, that makes the median ellipse visible at ``inch`` metres an inch."""
    axes = [
        probability_ellipse(pair.estimate.covariance[at, :2, :2]).semi_major
        for pair, at in zip(pairs, chosen, strict=True)
        if pair.estimate.covariance is not None
    ]
    sizes = np.concatenate([np.empty(0), *axes])
    sizes = sizes[np.isfinite(sizes) & (sizes > 0.0)]
    if not len(sizes):
        return 1.0
    wanted = VISIBLE_INCHES * inch / float(np.median(sizes))
    return 1.0 if wanted <= 1.0 else _round_up(wanted)


def _draw_observations(axes: Axes, pair: Pair, colour: str, of_sensors: Mapping[str, str]) -> None:
    if pair.observation is None:
        return
    x, y = pair.observation.position.T
    names = pair.observation.sensor
    shades = colour if names is None else [of_sensors.get(name, colour) for name in names.tolist()]
    axes.scatter(x, y, s=5, color=shades, alpha=0.55, linewidths=0, zorder=2)


def _draw_path(axes: Axes, pair: Pair, colour: str, dash: tuple[float, ...]) -> None:
    position = pair.estimate.position
    was_observed = np.ones(len(position), dtype=bool) if pair.was_observed is None else pair.was_observed
    if len(position) == 1:
        axes.plot(*position.T, "o", color=colour, markersize=5, zorder=3)
        return
    # Dotted unless both ends of a piece were observed and nothing is missing between them.
    continuous = (
        was_observed[:-1] & was_observed[1:] & (np.diff(pair.estimate.t) <= longest_step(pair.estimate.t))
    )
    for flags, style, cap in ((continuous, _line_style(dash), "butt"), (~continuous, DOTS, "round")):
        for run in finite_runs(flags):
            piece = position[run.start : run.stop + 1]
            axes.plot(*piece.T, linestyle=style, color=colour, linewidth=1.8, dash_capstyle=cap, zorder=3)
    for run in finite_runs(~was_observed):
        if run.stop - run.start >= MARKED_GAP:
            ends = position[[run.start, run.stop - 1]]
            axes.plot(*ends.T, "o", color=colour, markerfacecolor="white", markersize=4.0, zorder=3.2)


def _line_style(dash: tuple[float, ...]) -> Any:
    return (0.0, dash) if dash else "-"


def _draw_ellipses(axes: Axes, pair: Pair, at: NDArray[np.intp], colour: str, enlarged: float) -> None:
    if pair.estimate.covariance is None:
        return
    ellipse = probability_ellipse(pair.estimate.covariance[at, :2, :2])
    for centre, major, minor, angle in zip(pair.estimate.position[at], *ellipse, strict=True):
        if np.isfinite([major, minor, angle]).all():
            patch = EllipsePatch(
                (float(centre[0]), float(centre[1])),
                2.0 * enlarged * major,
                2.0 * enlarged * minor,
                angle=float(np.degrees(angle)),
                facecolor=colour,
                edgecolor=colour,
                linewidth=0.8,
                zorder=1.5,
            )
            patch.set_facecolor((*patch.get_facecolor()[:3], 0.25))
            axes.add_patch(patch)


def _draw_heading(
    axes: Axes, estimate: Track, name: str, at: NDArray[np.intp], size: float, inch: float
) -> None:
    """Draw arrows of one length on paper, next to the path, which they would otherwise hide."""
    angles = known_angle(estimate, name)
    at = at[np.isfinite(angles[at])]
    if not len(at):
        return
    # The head is drawn last, shorter and thinner: both stay visible when they point the same way.
    width, layer, side = (0.024, 4.5, 1.0) if name == "body" else (0.018, 5.0, -1.0)
    aside = side * ASIDE_INCHES * inch * unit(angles[at] + np.pi / 2.0)
    axes.quiver(
        *(estimate.position[at] + aside).T,
        *unit(angles[at]).T,
        color=ANGLE_COLOURS[name],
        edgecolor="white",
        linewidth=0.4,
        units="inches",
        scale_units="inches",
        scale=1.0 / (ARROW_INCHES[name] * size),
        width=width * size,
        headwidth=3.6,
        headlength=4.0,
        headaxislength=3.6,
        zorder=layer,
    )


def _draw_id(axes: Axes, pair: Pair, colour: str) -> None:
    placed = np.nonzero(finite_rows(pair.estimate.position))[0]
    if not len(placed):
        return
    x, y = pair.estimate.position[placed[0]]
    axes.plot(x, y, "o", color=colour, markersize=4.5, markeredgecolor="white", zorder=3.5)
    box = {"boxstyle": "round,pad=0.18", "facecolor": "white", "edgecolor": colour, "alpha": 0.9}
    axes.annotate(
        plain(pair.name),
        (x, y),
        xytext=(-5, -5),
        textcoords="offset points",
        ha="right",
        va="top",
        fontsize=8,
        zorder=6,
        bbox=box,
    )


def _name_some(axes: Axes, pairs: Sequence[Pair], inch: float) -> None:
    """Write names at the ends of paths, each where it covers none that is there already."""
    taken: list[tuple[float, float, float]] = []
    high = 0.09 * inch  # metres of a letter's height on paper
    for index, pair in enumerate(pairs):
        placed = np.flatnonzero(finite_rows(pair.estimate.position))
        if not len(placed):
            continue
        (x, y), name = pair.estimate.position[placed[-1]].tolist(), plain(pair.name)
        wide = 0.6 * high * len(name)
        if any(abs(x - u) < 0.5 * (wide + w) and abs(y - v) < high for u, v, w in taken):
            continue
        taken.append((x, y, wide))
        colour = person_colour(index)
        axes.annotate(name, (x, y), ha="center", va="center", fontsize=6, color=colour, zorder=6)


def _legend(pairs: tuple[Pair, ...], enlarged: float) -> list[Line2D | Patch]:
    """Handles for what the figure really holds."""
    estimates = [pair.estimate for pair in pairs]
    if not any(finite_rows(estimate.position).any() for estimate in estimates):
        return []
    grey = {"color": NEUTRAL_COLOUR}
    arrow = {"linewidth": 0, "marker": r"$\rightarrow$", "markersize": 13}
    handles: list[Line2D | Patch] = [_key("path", linewidth=1.8, **grey)]
    if any(pair.was_observed is not None and not pair.was_observed.all() for pair in pairs):
        handles.append(
            _key(
                "not observed",
                linestyle=DOTS,
                dash_capstyle="round",
                linewidth=1.8,
                marker="o",
                markersize=4,
                markerfacecolor="white",
                **grey,
            )
        )
    if any(pair.observation is not None for pair in pairs):
        handles.append(_key("observation", linewidth=0, marker=".", **grey))
    for name, colour in ANGLE_COLOURS.items():
        if any(getattr(e, name) is not None and np.isfinite(getattr(e, name)).any() for e in estimates):
            handles.append(_key(name, color=colour, **arrow))
    if any(e.covariance is not None for e in estimates):
        words = "95 % of position" + (f", enlarged {enlarged:g}×" if enlarged > 1.0 else "")
        faint = (*to_rgb(NEUTRAL_COLOUR), 0.25)
        handles.append(Patch(facecolor=faint, edgecolor=NEUTRAL_COLOUR, linewidth=0.8, label=words))
    if any(np.isfinite(pair.true_position).any() for pair in pairs):
        handles.append(_key("truth", color=TRUTH_COLOUR, linewidth=0.9, dashes=(5, 2.5)))
    if len(pairs) <= NAMED_PEOPLE:
        for i, pair in enumerate(pairs):
            handles.append(
                _key(
                    _short(pair.title),
                    color=person_colour(i),
                    linestyle=_line_style(person_dash(i)),
                    linewidth=1.8,
                )
            )
    return handles


def _key(label: str, **style: Any) -> Line2D:
    return Line2D([], [], label=label, **style)


def _short(name: str, width: int = 28) -> str:
    """A name on at most two lines of a legend."""
    lines = textwrap.fill(name, width, max_lines=2, placeholder=" …")
    return plain(lines, len(lines))
