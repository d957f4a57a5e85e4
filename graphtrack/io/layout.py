"""A caller's description of a table: the meaning of its columns, and their units."""

from __future__ import annotations

import csv
from collections.abc import Mapping
from dataclasses import dataclass, field

from graphtrack.errors import InputError
from graphtrack.table.as_read import ANGLES, DEGREES
from graphtrack.table.moments import check_time_unit
from graphtrack.table.schema import is_column

METRES = {"m": 1.0, "cm": 0.01, "mm": 0.001, "ft": 0.3048}
"""Metres of each unit of length."""

SHORT = {"id": "track_id", "time": "t"}
"""Short names of columns, beside those of the native table."""

WILD = "*"
"""In the name of a column what stands for an identity: a table with columns for each person."""

EXPECTED = "pairs such as id=agent,t=timestamp,x=pos_x,y=pos_y"


@dataclass(frozen=True)
class Layout:
    """A table's columns and units.

    Attributes
    ----------
    columns : name in the native table, or one of `DEGREES` and `ANGLES` → name in the file
    time_unit : of numbers in the column of times; "iso" asks for text; None: seconds, and ISO 8601
    units : unit of length
    crs : coordinate reference system of the places; None: a ground in ``units``, and for degrees WGS 84
    """

    columns: Mapping[str, str] = field(default_factory=dict)
    time_unit: str | None = None
    units: str | None = None
    crs: str | None = None

    def __post_init__(self) -> None:
        check_time_unit(self.time_unit)
        if self.units is not None and self.units not in METRES:
            raise InputError(f"units = {self.units!r}", f"one of {', '.join(METRES)}")
        if self.crs is not None and self.units not in (None, "m"):
            raise InputError(f"units {self.units} with crs", "one of them: a crs has units of its own")

    @property
    def metre(self) -> float:
        """Metres of the unit of length."""
        return METRES[self.units or "m"]

    @property
    def by_number(self) -> bool:
        """Return whether columns are counted from 1, as where no line of names is above them."""
        return bool(self.columns) and all(name.isdecimal() for name in self.columns.values())

    @property
    def wild(self) -> dict[str, str]:
        """The columns of which there is one for each person."""
        return {key: name for key, name in self.columns.items() if WILD in name}


def parse_columns(given: Mapping[str, object] | str | None) -> dict[str, str]:
    """Native name → name in the file, from a mapping or from text such as ``id=agent,t=timestamp``.

    A name that holds a comma stands, with its key, in double quotes.
    """
    if given is None:
        return {}
    pairs = _split(given) if isinstance(given, str) else [(str(k), str(v)) for k, v in given.items()]
    if not pairs:
        raise InputError("no columns", EXPECTED)
    found: dict[str, str] = {}
    for key, name in pairs:
        key, name = key.strip(), name.strip()
        if not name or not key:
            raise InputError(f"columns {key}={name}, without a name", EXPECTED)
        native = SHORT.get(key, key)
        if not (is_column(native) or native in DEGREES or native in ANGLES):
            known = ", ".join((*SHORT, "frame", "t", "x", "y", *DEGREES, "label", *ANGLES))
            raise InputError(f"columns {key}={name}", f"one of {known}, or a column of the native table")
        if native in found:
            raise InputError(f"columns with {key} twice", "each once")
        if name in found.values():
            raise InputError(f"column {name!r} for two meanings", "one meaning for each column")
        found[native] = name
    _check_places(found)
    return found


def _split(text: str) -> list[tuple[str, str]]:
    try:
        parts = next(csv.reader([text], skipinitialspace=True, strict=True), [])
    except csv.Error as error:
        raise InputError(f"columns {text!r} ({error})", EXPECTED) from error
    pairs = []
    for part in parts:
        key, equals, name = part.partition("=")
        if not equals:
            raise InputError(f"columns {part!r}", EXPECTED)
        pairs.append((key, name))
    return pairs


def _check_places(columns: Mapping[str, str]) -> None:
    degrees = [key for key in DEGREES if key in columns]
    if len(degrees) == 1:
        raise InputError(f"columns with {degrees[0]} alone", "both lat and lon")
    if degrees and ("x" in columns or "y" in columns):
        raise InputError("columns with x, y and lat, lon", "one of the two pairs")
    for radians, native in ANGLES.items():
        if radians in columns and native in columns:
            raise InputError(f"columns with {radians} and {native}", "one of the two")
    wild = [name for name in columns.values() if WILD in name]
    if wild and "track_id" in columns:
        raise InputError(f"columns with {wild[0]} and id", f"one of them: {WILD} stands for the identity")
    if any(name.count(WILD) > 1 for name in wild):
        raise InputError(f"columns with {wild[0]}", f"one {WILD}, for the identity")
