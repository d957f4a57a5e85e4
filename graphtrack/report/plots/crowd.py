"""Many people from above: how long they were where, and which ways they went."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import PowerNorm
from matplotlib.figure import Figure
from scipy import ndimage

from graphtrack.display import BODY_COLOUR
from graphtrack.geometry.angles import FloatArray
from graphtrack.report.pairing import Pair, finite_rows
from graphtrack.report.shapes import longest_step, open_holes
from graphtrack.report.style import new_figure, tidy

STAYS = 2.0
"""Metres from a track's first to its last position below which it has no direction of its own."""

DIRECTIONS = ("+x", "+y", "−x", "−y")

_CELLS = 160
"""Cells along the longer side of the scene."""


def plot_crowd(pairs: Sequence[Pair], extent: FloatArray, title: str = "") -> Figure:
    """A map of the time that people spent under everybody's path, and a small one for each way they went.

    Parameters
    ----------
    pairs : the people
    extent : (2, 2) metres, lower and upper corner of what is drawn
    title : shown above

    Returns
    -------
    matplotlib.figure.Figure
    """
    walks = [_walk(pair) for pair in pairs]
    groups = _by_direction(walks)
    figure, main, small = _layout(extent[1] - extent[0], len(groups))
    _frame(main, extent)
    main.set_xlabel("x (m)")
    main.set_ylabel("y (m)")
    if title:
        main.set_title(title, loc="left", fontsize=11)
    seconds = _time_spent(pairs, extent)
    most = float(seconds.max()) or 1.0
    norm = PowerNorm(0.5, vmin=0.0, vmax=most)
    corners = (extent[0, 0], extent[1, 0], extent[0, 1], extent[1, 1])
    # Where nobody was the page stays white.
    seen = np.ma.masked_less(seconds, 1e-3 * most)
    image = main.imshow(
        seen.T, origin="lower", extent=corners, cmap="YlOrRd", norm=norm, interpolation="bilinear", zorder=1
    )
    main.add_collection(
        LineCollection(walks, colors="#1C2026", linewidths=0.4, alpha=_faint(len(walks)), zorder=2)
    )
    bar = figure.colorbar(image, ax=main, shrink=0.8, pad=0.02)
    bar.set_label("person-seconds a square metre")
    bar.outline.set_visible(False)
    for axes, (words, group) in zip(small, groups, strict=True):
        _draw_group(axes, extent, words, [walks[i] for i in group])
    return figure


def _layout(span: FloatArray, n_small: int) -> tuple[Figure, Axes, list[Axes]]:
    """A large map and the small ones where the scene leaves room: below a wide one, beside a tall one."""
    ratio = float(span[1] / span[0])
    if ratio < 0.75:
        rows, columns = 1, max(n_small, 3)
        height, below = 9.0 * ratio, 9.6 / columns * ratio + 0.35
        figure = new_figure(10.6, height + below + 0.7)
        parts = figure.subfigures(2, 1, height_ratios=[height + 0.7, below], squeeze=False)
    else:
        rows, columns = max(-(-n_small // 2), 2), 2
        height = min(7.5, 5.0 * ratio)
        width, beside = height / ratio + 1.6, 2.0 * max((height / rows - 0.35) / ratio + 0.2, 1.9)
        figure = new_figure(width + beside, height + 0.7)
        parts = figure.subfigures(1, 2, width_ratios=[width, beside], squeeze=False)
    large, rest = np.ravel(parts)
    main = large.subplots()
    panels = rest.subplots(rows, columns, squeeze=False).ravel()
    for axes in panels[n_small:]:
        axes.remove()
    return figure, main, list(panels[:n_small])


def _draw_group(axes: Axes, extent: FloatArray, words: str, walks: list[FloatArray]) -> None:
    _frame(axes, extent)
    axes.tick_params(labelbottom=False, labelleft=False)
    axes.set_title(f"{words}: {len(walks)}", loc="left", fontsize=9)
    axes.add_collection(LineCollection(walks, colors=BODY_COLOUR, linewidths=0.6, alpha=_faint(len(walks))))
    ends = np.array([walk[finite_rows(walk)][-1] for walk in walks])
    axes.plot(*ends.T, "o", color=BODY_COLOUR, markersize=2.2, markeredgewidth=0)


def _frame(axes: Axes, extent: FloatArray) -> None:
    axes.set_aspect("equal", adjustable="box")
    axes.set_xlim(extent[0, 0], extent[1, 0])
    axes.set_ylim(extent[0, 1], extent[1, 1])
    tidy(axes)


def _faint(count: int) -> float:
    """Opacity of each of so many lines: a bundle of them is dark, one of them still seen."""
    return float(np.clip(3.0 / np.sqrt(max(count, 1)), 0.25, 0.9))


def _walk(pair: Pair) -> FloatArray:
    """(m, 2) metres, with a NaN in every hole, so that a line ends there."""
    estimate = pair.estimate
    _, x, y = open_holes(estimate.t, *estimate.position.T)
    return np.stack([x, y], axis=1)


def _by_direction(walks: Sequence[FloatArray]) -> list[tuple[str, list[int]]]:
    """Whom to draw together: by the quarter into which they went from first to last, and those who stayed."""
    groups: dict[int, list[int]] = {k: [] for k in range(5)}
    for i, walk in enumerate(walks):
        known = walk[finite_rows(walk)]
        if not len(known):
            continue
        dx, dy = known[-1] - known[0]
        quarter = int(np.round(np.arctan2(dy, dx) / (np.pi / 2.0))) % 4
        groups[4 if np.hypot(dx, dy) < STAYS else quarter].append(i)
    words = [f"towards {name}" for name in DIRECTIONS] + [f"stayed within {STAYS:g} m"]
    return [(words[k], group) for k, group in groups.items() if group]


def _time_spent(pairs: Sequence[Pair], extent: FloatArray) -> FloatArray:
    """(columns, rows) of person-seconds a square metre in square cells, a little smoothed."""
    span = extent[1] - extent[0]
    cell = float(span.max()) / _CELLS
    shape = np.maximum(np.round(span / cell).astype(int), 1)
    total = np.zeros(shape)
    for pair in pairs:
        points, seconds = _short_steps(pair.estimate.t, pair.estimate.position, cell / 2.0)
        at = np.clip(((points - extent[0]) / span * shape).astype(int), 0, shape - 1)
        np.add.at(total, (at[:, 0], at[:, 1]), seconds)
    area = float(np.prod(span / shape))
    smooth: FloatArray = ndimage.gaussian_filter(total, 1.0) / area
    return smooth


def _short_steps(t: FloatArray, position: FloatArray, longest: float) -> tuple[FloatArray, FloatArray]:
    """A walk in steps of at most ``longest`` metres: the middle of each (m, 2), and its seconds (m,).

    Holes of the track are left out.
    """
    step, seconds = np.diff(position, axis=0), np.diff(t)
    known = np.nonzero(finite_rows(step) & (seconds <= longest_step(t)))[0]
    parts = np.maximum(np.ceil(np.hypot(*step[known].T) / longest).astype(int), 1)
    of = np.repeat(known, parts)
    within = np.arange(len(of)) - np.repeat(np.cumsum(parts) - parts, parts)
    fraction = (within + 0.5) / np.repeat(parts, parts)
    return position[of] + fraction[:, None] * step[of], seconds[of] / np.repeat(parts, parts)
