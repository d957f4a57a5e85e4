"""Groups and forecasts on the ground, as entities of a recording."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Final

import numpy as np
from numpy.typing import NDArray

from graphtrack.geometry.angles import FloatArray
from graphtrack.interaction.groups import KINDS, Groups
from graphtrack.report.style import group_colour
from graphtrack.tracks.display import rgb
from graphtrack.viewer.layout import Extent
from graphtrack.viewer.people import CIRCLE, GROUND, PEOPLE
from graphtrack.viewer.recording import IntArray, LoggedEntities

GROUPS: Final = "ground/groups"
CENTRES: Final = "ground/groups/centres"

Place = Callable[[int, float], FloatArray | None]
"""Person and time → position (2,); None where unknown."""

_LINE, _DOT = -1.0, -3.0


def arrange_groups(to: LoggedEntities) -> None:
    """Log the style of groups."""
    to.static(GROUPS, to.rr.LineStrips2D.from_fields(radii=[_LINE]))
    to.static(CENTRES, to.rr.Points2D.from_fields(radii=[_DOT], show_labels=True))


def show_groups(to: LoggedEntities, groups: Groups, place: Place) -> None:
    """Draw groups: a line from the centre to each member, labelled with kind and probability.

    Parameters
    ----------
    groups : rows of complete frames, including people alone
    """
    if not len(groups):
        return
    first = np.flatnonzero(np.diff(groups.t, prepend=-np.inf))
    spokes: list[FloatArray] = []
    colours: list[tuple[int, int, int]] = []
    centres: list[FloatArray] = []
    labels: list[str] = []
    of_centres: list[tuple[int, int, int]] = []
    sizes = np.zeros((2, len(first)), dtype=np.int64)
    for k, rows in enumerate(np.split(np.arange(len(groups)), first[1:])):
        known: set[int] = set()
        for row in rows[groups.group[rows] >= 0].tolist():
            number, centre = int(groups.group[row]), groups.centre[row]
            colour = rgb(group_colour(number))
            if number not in known and np.isfinite(centre).all():
                known.add(number)
                centres.append(centre)
                of_centres.append(colour)
                labels.append(f"{KINDS[groups.kind[row]]} {groups.probability[row]:.2f}")
                sizes[1, k] += 1
            member = place(int(groups.track_id[row]), float(groups.t[row]))
            if member is not None and np.isfinite(centre).all():
                spokes.append(np.array([centre, member]))
                colours.append(colour)
                sizes[0, k] += 1
    rr, at = to.rr, (groups.t[first], groups.frame[first])
    strips = np.array(spokes).reshape(-1, 2, 2)
    to.rows(GROUPS, *at, rr.LineStrips2D.columns(strips=strips, colors=colours).partition(sizes[0]))
    points = rr.Points2D.columns(positions=np.array(centres).reshape(-1, 2), colors=of_centres, labels=labels)
    to.rows(CENTRES, *at, points.partition(sizes[1]))


def show_forecasts(to: LoggedEntities, columns: Mapping[str, NDArray[np.generic]], place: Place) -> None:
    """Draw forecasts: the predicted path, and at its end the 90 % circle.

    Parameters
    ----------
    columns : (rows,) as of `graphtrack.forecasting.recorded.Forecasts`, with ``frame``
    """
    track_ids, t = columns["track_id"].astype(np.int64), columns["t"].astype(float)
    order = np.lexsort((columns["ahead"].astype(float), t, track_ids))
    track_ids, t = track_ids[order], t[order]
    there = np.column_stack([columns["x"], columns["y"]]).astype(float)[order]
    radius = columns["radius_90"].astype(float)[order]
    frame = columns["frame"].astype(np.int64)[order]
    new_person = np.flatnonzero(np.diff(track_ids, prepend=track_ids[:1] - 1))
    for rows in np.split(np.arange(len(track_ids)), new_person[1:]) if len(track_ids) else ():
        first = np.flatnonzero(np.diff(t[rows], prepend=-np.inf))
        _of_person(to, int(track_ids[rows[0]]), t[rows], frame[rows], there[rows], radius[rows], first, place)


def _of_person(
    to: LoggedEntities,
    person: int,
    t: FloatArray,
    frame: IntArray,
    there: FloatArray,
    radius: FloatArray,
    first: NDArray[np.intp],
    place: Place,
) -> None:
    strips: list[FloatArray] = []
    for ahead in np.split(np.arange(len(t)), first[1:]):
        now = place(person, float(t[ahead[0]]))
        path = there[ahead] if now is None else np.vstack([now, there[ahead]])
        end = ahead[-1]
        circle = radius[end] * np.column_stack([np.cos(CIRCLE), np.sin(CIRCLE)])
        strips += [path, there[end] + circle]
    columns = to.rr.LineStrips2D.columns(strips=strips).partition(np.full(len(first), 2))
    to.rows(f"{PEOPLE}/{person}/forecast", t[first], frame[first], columns)


def show_ground(to: LoggedEntities, extent: Extent) -> None:
    """Draw the ground: x to the right, y up, and lines each metre, each ten, and so on, at most twenty."""
    spacing = 10.0 ** np.ceil(np.log10(max(extent.size, 1.0) / 20.0))
    (left, bottom), (right, top) = (
        np.floor(extent.low / spacing) * spacing,
        np.ceil(extent.high / spacing) * spacing,
    )
    lines: list[FloatArray] = []
    lines += [np.array([[x, bottom], [x, top]]) for x in np.arange(left, right + spacing / 2, spacing)]
    lines += [np.array([[left, y], [right, y]]) for y in np.arange(bottom, top + spacing / 2, spacing)]
    grid = to.rr.LineStrips2D(lines, colors=[(48, 51, 57)], radii=[-0.5], draw_order=-10.0)
    to.static(f"{GROUND}/grid", grid)
    # Pictures count rows downwards, and so do views of two dimensions.
    to.static(GROUND, to.rr.Transform3D(scale=[1.0, -1.0, 1.0]))
