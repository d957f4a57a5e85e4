"""Colours and words that mean the same thing in every figure, chart and page.

The colours are those of Okabe & Ito (2008), which people with any common colour blindness can tell apart.
Three of them are kept for body, head and velocity; people get the others and, since those repeat, a pattern
of dashes and an id beside their path.
"""

from __future__ import annotations

from typing import Final

BODY_COLOUR: Final = "#0072B2"
HEAD_COLOUR: Final = "#D55E00"
VELOCITY_COLOUR: Final = "#009E73"
TRUTH_COLOUR: Final = "#000000"
NEUTRAL_COLOUR: Final = "#5F6672"

PERSON_COLOURS: Final = ("#56B4E9", "#E69F00", "#CC79A7", "#8A8F98", "#94641A", "#8C4A7B")

PERSON_DASHES: Final[tuple[tuple[float, ...], ...]] = ((), (5.0, 2.0), (5.0, 1.5, 1.0, 1.5), (2.0, 1.5))
"""On and off along a line, in widths of the line; none is as short as the dots of what was not observed."""

ANGLE_COLOURS: Final = {"body": BODY_COLOUR, "head": HEAD_COLOUR}


def person_colour(index: int) -> str:
    """The colour of the person at ``index`` in the set; colours repeat after six people."""
    return PERSON_COLOURS[index % len(PERSON_COLOURS)]


def person_dash(index: int) -> tuple[float, ...]:
    """The dashes of the person at ``index`` in the set; with the colour they repeat after 24 people."""
    return PERSON_DASHES[index // len(PERSON_COLOURS) % len(PERSON_DASHES)]


def quantity_colour(name: str) -> str:
    """The colour of what a metric is about, read from its name (``body_error`` is body's)."""
    lowered = name.lower()
    for word, colour in (("body", BODY_COLOUR), ("head", HEAD_COLOUR), ("veloc", VELOCITY_COLOUR)):
        if word in lowered:
            return colour
    return NEUTRAL_COLOUR
