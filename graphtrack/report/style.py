"""Shared style of figures, charts and pages, and the shapes in them: ellipses, curves and bands cut at ±π.

Three colours of Okabe & Ito (2008) are reserved for body, head and velocity; people get twelve others that
are distinguishable with common colour blindness and, since these repeat, a dash pattern and an id next to
their path.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, Final, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from graphtrack.geometry.angles import FloatArray
from graphtrack.geometry.planar import half_width, without_unknown_correlations
from graphtrack.tracks.display import BODY_COLOUR, HEAD_COLOUR, PERSON_COLOURS, VELOCITY_COLOUR

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from graphtrack.tracks.track import Track


TRUTH_COLOUR: Final = "#000000"
NEUTRAL_COLOUR: Final = "#5F6672"

GROUP_COLOURS: Final = ("#4477AA", "#EE6677", "#228833", "#B8860B", "#66CCEE", "#AA3377")
"""Colours "bright" of Tol (2021), with a darker yellow."""

PERSON_DASHES: Final[tuple[tuple[float, ...], ...]] = ((), (5.0, 2.0), (5.0, 1.5, 1.0, 1.5), (2.0, 1.5))
"""Dash patterns in line widths; all longer than the dots of unobserved intervals."""

ANGLE_COLOURS: Final = {"body": BODY_COLOUR, "head": HEAD_COLOUR}


def person_dash(index: int) -> tuple[float, ...]:
    """Return the dashes of the person at ``index``; with the colour they repeat after 48 people."""
    return PERSON_DASHES[index // len(PERSON_COLOURS) % len(PERSON_DASHES)]


def group_colour(number: int) -> str:
    """Return the colour of a group; colours repeat after six groups."""
    return GROUP_COLOURS[number % len(GROUP_COLOURS)]


def quantity_colour(name: str) -> str:
    """Return the colour of a metric's quantity, from its name (``body_error``: body)."""
    lowered = name.lower()
    for word, colour in (("body", BODY_COLOUR), ("head", HEAD_COLOUR), ("veloc", VELOCITY_COLOUR)):
        if word in lowered:
            return colour
    return NEUTRAL_COLOUR


NAME_LENGTH = 20
"""Most characters of a name at an axis."""


def plain(text: str, most: int = NAME_LENGTH) -> str:
    """Return a name for a figure, cut to ``most`` characters, without mathematics between dollars."""
    return (text if len(text) <= most else f"{text[: most - 1]}…").replace("$", r"\$")


def new_figure(
    width: float, height: float, layout: Literal["constrained", "compressed"] = "constrained"
) -> Figure:
    """An empty figure (inches) that can be saved without pyplot."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from matplotlib.layout_engine import ConstrainedLayoutEngine

    # Matplotlib's margin is too narrow next to axes of equal aspect: it cuts the label of the y axis.
    engine = ConstrainedLayoutEngine(compress=layout == "compressed", w_pad=0.15, h_pad=0.1)
    figure = Figure(figsize=(width, height), dpi=120, layout=engine, facecolor="white")
    FigureCanvasAgg(figure)
    return figure


def tidy(axes: Axes, *, grid: str = "both") -> None:
    """Draw a light grid behind the data, and remove the unused frame."""
    axes.set_axisbelow(True)
    options: dict[str, Any] = {"color": "#E3E6EA", "linewidth": 0.7}
    axes.grid(True, axis=grid, **options)  # type: ignore[arg-type]
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    for side in ("left", "bottom"):
        axes.spines[side].set_color("#9AA1AB")
    axes.tick_params(color="#9AA1AB", labelsize=9)


NORMAL_95 = half_width(0.95)
"""Half-width of the central 95 % interval of a normal variable, in standard deviations."""


class Ellipse(NamedTuple):
    """Semi-axes (metres) and the angle of the major one from +x (radians), each of the shape of the batch."""

    semi_major: FloatArray
    semi_minor: FloatArray
    angle: FloatArray


class BandPiece(NamedTuple):
    """One unbroken piece of a band: times (seconds) and its lower and upper edge (radians), each (m,)."""

    t: FloatArray
    lower: FloatArray
    upper: FloatArray


def probability_ellipse(covariance: FloatArray, probability: float = 0.95) -> Ellipse:
    """Return the ellipse that contains a 2-D Gaussian with the given probability.

    Parameters
    ----------
    covariance : (..., 2, 2) square metres; NaN gives a NaN ellipse, an unknown correlation is none
    probability : between 0 and 1
    """
    covariance = without_unknown_correlations(covariance)
    xx, xy, yy = covariance[..., 0, 0], covariance[..., 0, 1], covariance[..., 1, 1]
    # Closed form: unlike an eigenvalue routine it takes NaN and needs no loop.
    middle, spread = (xx + yy) / 2.0, np.hypot((xx - yy) / 2.0, xy)
    scale = chdtri(2, 1.0 - probability)
    return Ellipse(
        semi_major=np.sqrt(scale * np.maximum(middle + spread, 0.0)),
        semi_minor=np.sqrt(scale * np.maximum(middle - spread, 0.0)),
        angle=np.arctan2(2.0 * xy, xx - yy) / 2.0,
    )


def finite_runs(finite: NDArray[np.bool_]) -> list[slice]:
    """Return the maximal runs of True."""
    edges = np.diff(np.concatenate([[0], np.asarray(finite, dtype=int), [0]]))
    starts, stops = np.nonzero(edges == 1)[0], np.nonzero(edges == -1)[0]
    return [slice(int(start), int(stop)) for start, stop in zip(starts, stops, strict=True)]


def longest_step(t: FloatArray) -> float:
    """Return the sample interval in seconds above which a track has a hole, which is not drawn."""
    times = np.unique(t)  # rows of several sensors may have one time
    return max(0.5, 2.5 * float(np.median(np.diff(times)))) if len(times) > 1 else 0.5


def open_holes(t: FloatArray, *values: FloatArray) -> tuple[FloatArray, ...]:
    """Insert a missing value into every hole of a track, so that lines and bands end there.

    Parameters
    ----------
    t : (n,) seconds
    values : any number of (n,) series

    Returns
    -------
    t and the series, each (n + number of holes,)
    """
    if len(t) < 2:
        return (t, *values)
    before = np.nonzero(np.diff(t) > longest_step(t))[0]
    middle = (t[before] + t[before + 1]) / 2.0
    return (np.insert(t, before + 1, middle), *(np.insert(v, before + 1, np.nan) for v in values))


def break_at_seam(t: FloatArray, angle: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Cut a curve of wrapped angles wherever it passes ±π, so that drawing it crosses no seam.

    Each passage becomes a point on the one edge, a NaN, and a point on the other edge, at the time
    where the straight path between the two samples meets the edge.

    Parameters
    ----------
    t : (n,) seconds
    angle : (n,) radians in (−π, π], NaN where unknown

    Returns
    -------
    t, angle : (m,) with m = n + 3 × the number of passages
    """
    if len(t) < 2:
        return np.array(t, dtype=float), np.array(angle, dtype=float)
    step = np.diff(angle)
    before = np.nonzero(np.abs(step) > np.pi)[0]
    edge = np.where(step[before] < 0.0, np.pi, -np.pi)
    travelled = np.abs(edge - angle[before])
    remainder = 2.0 * np.pi - np.abs(step[before])
    fraction = np.divide(travelled, remainder, out=np.zeros_like(remainder), where=remainder > 0.0)
    crossing = t[before] + fraction * (t[before + 1] - t[before])
    where = np.repeat(before + 1, 3)
    new_t = np.repeat(crossing, 3)
    new_angle = np.stack([edge, np.full_like(edge, np.nan), -edge], axis=1).ravel()
    return np.insert(t, where, new_t), np.insert(angle, where, new_angle)


def angle_bands(t: FloatArray, angle: FloatArray, half_width: FloatArray) -> list[BandPiece]:
    """Return the band ``angle ± half_width`` on the circle, as pieces within [−π, π].

    A band that crosses one edge continues at the other. Half-widths are limited to π, the whole circle.

    Parameters
    ----------
    t : (n,) seconds
    angle, half_width : (n,) radians, NaN where unknown
    """
    pieces = []
    for run in finite_runs(np.isfinite(angle) & np.isfinite(half_width)):
        centre, half = np.unwrap(angle[run]), np.minimum(half_width[run], np.pi)
        lower, upper = centre - half, centre + half
        first = int(np.ceil((-np.pi - upper.max()) / (2.0 * np.pi)))
        last = int(np.floor((np.pi - lower.min()) / (2.0 * np.pi)))
        for turn in range(first, last + 1):
            shifted_lower = np.clip(lower + 2.0 * np.pi * turn, -np.pi, np.pi)
            shifted_upper = np.clip(upper + 2.0 * np.pi * turn, -np.pi, np.pi)
            inside = shifted_upper > shifted_lower
            # One sample more on each side closes the piece at the edge it leaves through.
            inside = inside | np.append(inside[1:], False) | np.insert(inside[:-1], 0, False)
            pieces += [
                BandPiece(t[run][part], shifted_lower[part], shifted_upper[part])
                for part in finite_runs(inside)
                if part.stop - part.start > 1
            ]
    return pieces


KNOWN_ANGLE = math.radians(60.0)
"""1-σ from which a direction is not drawn: an arrow would say more than is known."""


def known_angle(track: Track, name: str) -> FloatArray:
    """Return "body" or "head" of n frames (n,) in radians, NaN where its 1-σ is not below `KNOWN_ANGLE`."""
    angle = getattr(track, name)
    if angle is None:
        return np.full(len(track), np.nan)
    return np.where(track.std(name) >= KNOWN_ANGLE, np.nan, angle)
