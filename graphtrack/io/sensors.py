"""Files that describe sensors, and rows corrected by them when they are read."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import TypeAlias

import numpy as np
import tomli_w

from graphtrack.errors import InputError
from graphtrack.io.atomic import atomic_path
from graphtrack.io.source import read_toml
from graphtrack.tracks.display import listed
from graphtrack.tracks.sensors import Sensor, corrected
from graphtrack.tracks.table import Rows
from graphtrack.tracks.validation import SENSOR_NAME, is_sensor_name

_EXPECTED = "a description of sensors"


class SensorScene(Mapping[str, Sensor]):
    """Descriptions of the sensors of a scene, by name.

    Parameters
    ----------
    sensors : name → description; "" is the sensor of rows without a name

    Raises
    ------
    InputError
        For a name that no sensor may have, or another type.
    """

    def __init__(self, sensors: Mapping[str, Sensor]) -> None:
        for name, sensor in sensors.items():
            if not is_sensor_name(name):
                raise InputError(f"a sensor named {name!r}"[:80], SENSOR_NAME)
            if not isinstance(sensor, Sensor):
                raise InputError(f"a {type(sensor).__name__} for the sensor {name!r}", "a Sensor")
        self._sensors = dict(sensors)

    def __getitem__(self, name: str) -> Sensor:
        return self._sensors[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._sensors)

    def __len__(self) -> int:
        return len(self._sensors)

    def __repr__(self) -> str:
        return f"SensorScene({self._sensors!r})"

    @classmethod
    def of(cls, given: SensorsLike) -> SensorScene:
        """Return a scene from the path of its file, or from descriptions by name."""
        if isinstance(given, str | Path):
            return cls.load(given)
        if not isinstance(given, Mapping):
            expected = "a SensorScene, the path of its file, or descriptions by name"
            raise InputError(f"sensors of type {type(given).__name__}", expected)
        return given if isinstance(given, cls) else cls(given)

    def save(self, path: str | Path) -> None:
        """Write a file (TOML) with a table ``[sensors.NAME]`` for each, atomically."""
        content = tomli_w.dumps({"sensors": {name: one.to_table() for name, one in self.items()}})
        with atomic_path(path) as temporary:
            temporary.write_text(content, encoding="utf-8")

    @classmethod
    def load(cls, path: str | Path) -> SensorScene:
        """Read a file of `save`; InputError names the file and the key."""
        content = read_toml(path, _EXPECTED)
        try:
            other = next((key for key in content if key != "sensors"), None)
            if other is not None:
                raise InputError(f"key {other}", "tables [sensors.NAME] alone")
            tables = content.get("sensors")
            if not isinstance(tables, Mapping) or not tables:
                raise InputError("no sensors", "tables [sensors.NAME], one at least")
            return cls({name: Sensor.from_table(f"sensors.{name}", one) for name, one in tables.items()})
        except InputError as error:
            raise error.at(path) from error


SensorsLike: TypeAlias = SensorScene | Mapping[str, Sensor] | str | Path
"""A scene of sensors, descriptions by name, or the path of their file."""


def with_known_sensors(rows: Rows, scene: SensorScene | None) -> Rows:
    """Return rows corrected by the descriptions of their sensors, with a note on those that have none."""
    if scene is None:
        return rows
    unknown = [name for name in sorted(names_in(rows)) if name not in scene]
    found = corrected(rows, scene)
    return found.with_notes(f"sensors that are not described: {_named(unknown)}") if unknown else found


def names_in(rows: Rows) -> set[str]:
    """Return the names of the sensors that rows have; "" of rows without one."""
    return {""} if rows.sensor is None else set(np.unique(rows.sensor).tolist())


def absent_note(scene: SensorScene | None, names: Iterable[str]) -> tuple[str, ...]:
    """Return a note on described sensors that are not among the ``names`` in the rows; or none."""
    absent = sorted({*(scene or ())} - {*names})
    return (f"described sensors that no row has: {_named(absent)}",) if absent else ()


def _named(names: Iterable[str]) -> str:
    return listed(name or "rows without a sensor" for name in names)
