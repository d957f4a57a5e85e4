"""Shared style of figures, charts and pages: colours, an empty figure, plain axes.

The colours are those of Okabe & Ito (2008), which people with any common colour blindness can tell apart.
Three of them are kept for body, head and velocity; people get the others and, since those repeat, a pattern
of dashes and an id beside their path.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final, Literal

from graphtrack.display import BODY_COLOUR, HEAD_COLOUR, PERSON_COLOURS, VELOCITY_COLOUR

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

TRUTH_COLOUR: Final = "#000000"
NEUTRAL_COLOUR: Final = "#5F6672"

GROUP_COLOURS: Final = ("#4477AA", "#EE6677", "#228833", "#B8860B", "#66CCEE", "#AA3377")
"""Those of Tol (2021), "bright", the yellow darker."""

PERSON_DASHES: Final[tuple[tuple[float, ...], ...]] = ((), (5.0, 2.0), (5.0, 1.5, 1.0, 1.5), (2.0, 1.5))
"""On and off along a line, in widths of the line; none is as short as the dots of what was not observed."""

ANGLE_COLOURS: Final = {"body": BODY_COLOUR, "head": HEAD_COLOUR}


def person_dash(index: int) -> tuple[float, ...]:
    """The dashes of the person at ``index`` in the set; with the colour they repeat after 24 people."""
    return PERSON_DASHES[index // len(PERSON_COLOURS) % len(PERSON_DASHES)]


def group_colour(number: int) -> str:
    """The colour of a group; colours repeat after six of them."""
    return GROUP_COLOURS[number % len(GROUP_COLOURS)]


def quantity_colour(name: str) -> str:
    """The colour of what a metric is about, read from its name (``body_error`` is body's)."""
    lowered = name.lower()
    for word, colour in (("body", BODY_COLOUR), ("head", HEAD_COLOUR), ("veloc", VELOCITY_COLOUR)):
        if word in lowered:
            return colour
    return NEUTRAL_COLOUR


def new_figure(
    width: float, height: float, layout: Literal["constrained", "compressed"] = "constrained"
) -> Figure:
    """An empty figure (inches) that can be saved without pyplot."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from matplotlib.layout_engine import ConstrainedLayoutEngine

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
