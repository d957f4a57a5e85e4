"""Sensors of a scene for display: colours, fields of view, and the errors that were found."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from graphtrack.association.sensors import Views
from graphtrack.geometry.angles import FloatArray
from graphtrack.report.content import DataTable, Section
from graphtrack.report.lives import Pair
from graphtrack.report.style import group_colour
from graphtrack.tracks.sensor_errors import shown_values
from graphtrack.tracks.sensors import Sensor, Sensors, outline_of
from graphtrack.tracks.validation import finite_rows

_FEWEST = 3
"""Fewest positions that a field of view is learned from."""


_NOTE = (
    "Errors of the ground frame, the angles and the clock, each with its 1-σ where it was learned. Noise is "
    "a multiple of what is declared; detected is the probability for a person in view, and false the false "
    "detections, in a scan."
)


@dataclass(frozen=True, eq=False)
class ShownSensor:
    """A sensor for display.

    Attributes
    ----------
    name, colour : text; "" is the sensor of rows without a name
    outline : (k, 2) metres, of the field of view in the world; None: unknown, or it moves
    learned : whether the outline is the convex shape around what it has observed
    rows : number of its observations with a position
    """

    name: str
    colour: str
    outline: FloatArray | None
    learned: bool
    rows: int

    @property
    def title(self) -> str:
        """The name to display."""
        return self.name or "without a name"


def shown_sensors(pairs: Iterable[Pair], described: Sensors | None = None) -> tuple[ShownSensor, ...]:
    """Return the sensors of tracks, those that are described first; none without names and descriptions.

    Parameters
    ----------
    described : name → description; a field of view that it lacks is learned from the positions
    """
    known = {} if described is None else dict(described)
    names, position = _observed(pairs)
    found = [*known, *(name for name in np.unique(names).tolist() if name not in known)]
    if not any(found):
        return ()
    shown = []
    for number, name in enumerate(found):
        own, sensor = position[names == name], known.get(name, Sensor())
        outline = None if sensor.moves else outline_of(sensor, own)
        learned = outline is None and not sensor.moves
        if learned and len(own) >= _FEWEST:
            outline = _learned_outline(own)
        shown.append(ShownSensor(name, group_colour(number), outline, learned, len(own)))
    return tuple(shown)


def _observed(pairs: Iterable[Pair]) -> tuple[np.ndarray, FloatArray]:
    """Return the names of sensors (n,) and the positions (n, 2) that they observed, else the estimates."""
    names, positions = [np.empty(0, dtype=str)], [np.empty((0, 2))]
    for pair in pairs:
        track = pair.estimate if pair.observation is None else pair.observation
        placed = finite_rows(track.position)
        names.append((np.full(len(track), "") if track.sensor is None else track.sensor)[placed])
        positions.append(track.position[placed])
    return np.concatenate(names), np.concatenate(positions)


def _learned_outline(position: FloatArray) -> FloatArray | None:
    """Return the outline (k, 2) of the field of view that association learns from positions (n, 2)."""
    outline = Views.of(position, np.zeros(len(position), dtype=np.int64), 1).outline(0)
    return outline if len(outline) >= _FEWEST else None


def sensors_section(shown: Sequence[ShownSensor], described: Sensors | None = None) -> tuple[Section, ...]:
    """Return the section with the errors of sensors and their 1-σ; none without sensors."""
    if not shown:
        return ()
    known: Mapping[str, Sensor] = {} if described is None else described
    rows = [
        {"sensor": one.title, "observations": one.rows, **_errors(known.get(one.name, Sensor()))}
        for one in shown
    ]
    columns = [name for name in rows[0] if any(row[name] is not None for row in rows)]
    note = _NOTE if len(columns) > 2 else "No errors of sensors were described or learned."
    table = DataTable.of("Sensors", [{name: row[name] for name in columns} for row in rows], note)
    return (Section("Sensors", (table,)),)


def _errors(sensor: Sensor) -> dict[str, float | None]:
    """Return the errors of a sensor by column of the table; None: unknown."""
    found: dict[str, float | None] = {}
    for name, (value, std) in shown_values(sensor).items():
        found |= {name: value, f"± {name.removeprefix('shift ')}": std}
    return found
