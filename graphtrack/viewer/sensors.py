"""Fields of view, and who was seen by which sensor, as entities of a recording."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Final

import numpy as np

from graphtrack.report.sensors import ShownSensor
from graphtrack.report.style import longest_step, probability_ellipse
from graphtrack.tracks.display import rgb
from graphtrack.tracks.track import Track
from graphtrack.tracks.validation import finite_rows
from graphtrack.viewer.people import CIRCLE, GROUND
from graphtrack.viewer.recording import LoggedEntities

SENSORS: Final = f"{GROUND}/sensors"

_LINE, _HALO, _THIN = -1.2, -7.0, -0.6


def show_sensors(to: LoggedEntities, sensors: Sequence[ShownSensor], tracks: Iterable[Track]) -> None:
    """Draw fields of view with the names of sensors, and a halo on each person whom a sensor sees.

    Observations with ellipses have 95 % of them.
    """
    if not sensors:
        return
    rr, tracks = to.rr, list(tracks)
    for number, one in enumerate(sensors):
        path, colour = f"{SENSORS}/{number}", rgb(one.colour)
        if one.outline is not None:
            ring = np.vstack([one.outline, one.outline[:1]])
            style = {"colors": [colour], "radii": [_LINE], "draw_order": -5.0}
            to.static(f"{path}/view", rr.LineStrips2D([ring], labels=[one.title], **style))
        halo = rr.Points2D.from_fields(colors=[(*colour, 110)], radii=[_HALO], draw_order=-1.0)
        to.static(f"{path}/seen", halo)
        to.static(f"{path}/ellipses", rr.LineStrips2D.from_fields(colors=[colour], radii=[_THIN]))
        _show_observations(to, path, [_rows_of(track, one.name) for track in tracks])


def _rows_of(track: Track, name: str) -> Track | None:
    """Return the rows of a sensor with a position; None: there are none."""
    names = np.full(len(track), "") if track.sensor is None else track.sensor
    rows = (names == name) & finite_rows(track.position)
    return track[rows] if rows.any() else None


def _show_observations(to: LoggedEntities, path: str, parts: Sequence[Track | None]) -> None:
    """Log the people whom a sensor sees at each of its times, and their ellipses."""
    own = [one for one in parts if one is not None]
    if not own:
        return
    t, frame, position = (
        np.concatenate([getattr(one, name) for one in own]) for name in ("t", "frame", "position")
    )
    none = [np.full((len(one), 2, 2), np.nan) for one in own]
    given = [
        empty if one.position_covariance is None else one.position_covariance
        for one, empty in zip(own, none, strict=True)
    ]
    order = np.argsort(t, kind="stable")
    t, frame, position, covariance = t[order], frame[order], position[order], np.concatenate(given)[order]
    times, first = np.unique(t, return_index=True)
    counts = np.diff([*first, len(t)])
    rr = to.rr
    to.rows(f"{path}/seen", times, frame[first], rr.Points2D.columns(positions=position).partition(counts))
    hole = longest_step(times)
    ends = np.append(np.diff(times) > hole, True)
    to.clear(f"{path}/seen", times[ends] + hole, frame[first][ends])
    ellipse = probability_ellipse(covariance)
    known = np.isfinite(ellipse.semi_major)
    if not known.any():
        return
    along = np.stack([np.cos(ellipse.angle), np.sin(ellipse.angle)], axis=-1)[known, None, :]
    strips = (
        position[known, None, :]
        + ellipse.semi_major[known, None, None] * np.cos(CIRCLE)[:, None] * along
        + ellipse.semi_minor[known, None, None] * np.sin(CIRCLE)[:, None] * along[..., ::-1] * [-1, 1]
    )
    counts = np.add.reduceat(known.astype(int), first)
    columns = rr.LineStrips2D.columns(strips=strips).partition(counts)
    to.rows(f"{path}/ellipses", times, frame[first], columns)
