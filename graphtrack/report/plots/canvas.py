"""What the figures share: a figure with its own canvas, and plain axes."""

from __future__ import annotations

from typing import Any, Literal

from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine


def new_figure(
    width: float, height: float, layout: Literal["constrained", "compressed"] = "constrained"
) -> Figure:
    """An empty figure (inches) that can be saved without pyplot."""
    # Matplotlib's own margin is too narrow beside axes of equal aspect: it cuts the label of the y axis.
    engine = ConstrainedLayoutEngine(compress=layout == "compressed", w_pad=0.15, h_pad=0.1)
    figure = Figure(figsize=(width, height), dpi=120, layout=engine, facecolor="white")
    FigureCanvasAgg(figure)
    return figure


def tidy(axes: Axes, *, grid: str = "both") -> None:
    """A light grid behind the data and no frame where nothing is read off."""
    axes.set_axisbelow(True)
    options: dict[str, Any] = {"color": "#E3E6EA", "linewidth": 0.7}
    axes.grid(True, axis=grid, **options)  # type: ignore[arg-type]
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    for side in ("left", "bottom"):
        axes.spines[side].set_color("#9AA1AB")
    axes.tick_params(color="#9AA1AB", labelsize=9)
