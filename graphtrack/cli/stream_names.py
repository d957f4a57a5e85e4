"""Rows of a stream under names and in a unit of time of their own: each line in, each answer out."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

from graphtrack.cli.stream import text_of
from graphtrack.errors import InputError
from graphtrack.io.layout import Layout
from graphtrack.io.readers.ndjson import parse_line
from graphtrack.table import schema
from graphtrack.table.moments import NANOSECONDS

_TIMES = ("t", "end")
_DIGITS = 3
"""Of a unit of time: what an answer's time is rounded to, so that whole numbers are whole again."""


@dataclass(frozen=True)
class StreamNames:
    """What a stream calls its columns, and the unit of its times.

    Attributes
    ----------
    columns : name in the native table → name in the stream
    per_second : units of time in a second; 1 leaves times as they are
    """

    columns: Mapping[str, str] = field(default_factory=dict)
    per_second: float = 1.0

    @classmethod
    def of(cls, layout: Layout) -> StreamNames:
        """Of what was said of a table.

        Raises
        ------
        InputError
            For what a row alone cannot be read by: degrees of the earth, radians, columns for each person,
            and text for times.
        """
        for key, name in layout.columns.items():
            if not schema.is_column(key) or name in layout.wild.values():
                raise InputError(f"columns {key}={name} with -", "names of the native table's columns")
        unit = layout.time_unit or "s"
        if unit not in NANOSECONDS:
            raise InputError(f"--time-unit {unit} with -", f"one of {', '.join(NANOSECONDS)}")
        if layout.units is not None or layout.crs is not None:
            raise InputError("--units or --crs with -", "rows in metres")
        return cls(dict(layout.columns), 1e9 / NANOSECONDS[unit])

    @property
    def are_native(self) -> bool:
        """Whether nothing is called or measured otherwise than in the native table."""
        return not self.columns and self.per_second == 1.0

    def settings(self) -> dict[str, Any]:
        """What the answers depend on, for a state."""
        return {"columns": dict(self.columns), "per_second": self.per_second}

    def native_lines(self, lines: Iterator[tuple[int, bytes]]) -> Iterator[tuple[int, bytes]]:
        """Lines with their numbers, as the native table has them."""
        if self.are_native:
            return lines
        return ((number, self.native(line)) for number, line in lines)

    def native(self, line: bytes) -> bytes:
        """A line as the native table has it; one that cannot be read stays, to be told of where rows are."""
        try:
            pairs = parse_line(text_of(line))
        except InputError:
            return line
        meaning = {name: key for key, name in self.columns.items()}
        found: list[tuple[str, Any]] = []
        for name, value in pairs:
            key = meaning.get(name, name)
            if name not in meaning and name in self.columns:  # another column has that meaning
                continue
            is_number = isinstance(value, int | float) and not isinstance(value, bool)
            found.append((key, value / self.per_second if key in _TIMES and is_number else value))
        # A key that stands twice must stay so: it is an error.
        body = ", ".join(f"{json.dumps(key)}: {json.dumps(value)}" for key, value in found)
        return f"{{{body}}}\n".encode()

    def restored(self, answer: Mapping[str, Any]) -> dict[str, Any]:
        """An answer under the stream's own names, in its unit."""
        return {self.columns.get(key, key): self._value(key, value) for key, value in answer.items()}

    def _value(self, key: str, value: Any) -> Any:
        if isinstance(value, list):  # what is revised, and forecasts, are rows themselves
            return [self.restored(one) if isinstance(one, Mapping) else one for one in value]
        return self._time(value) if key in _TIMES else value

    def _time(self, value: Any) -> Any:
        if self.per_second == 1.0 or not isinstance(value, int | float):
            return value
        count = round(value * self.per_second, _DIGITS)
        return int(count) if float(count).is_integer() else count
