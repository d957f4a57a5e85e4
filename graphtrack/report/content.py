"""Parts of a report as plain data without HTML, and tables of a comparison as checked rows."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from graphtrack.errors import InputError

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

    Records = pd.DataFrame | Sequence[Mapping[str, Any]]
else:
    Records = Any


def records(
    table: Records, columns: Sequence[str] = (), numbers: Sequence[str] = ()
) -> list[Mapping[str, Any]]:
    """Return rows as mappings with ``columns``, and ``numbers`` as floats, NaN for None.

    Raises
    ------
    InputError
        Without rows that have numbers, for a missing column or an invalid number.
    """
    rows: list[Mapping[str, Any]] = (
        table.to_dict(orient="records") if hasattr(table, "to_dict") else list(table)  # type: ignore[assignment]
    )
    wanted = [*columns, *numbers]
    if not rows and wanted:
        raise InputError("no rows", f"at least one row with {', '.join(wanted)}")
    for i, row in enumerate(rows):
        for column in wanted:
            if column not in row:
                expected = f"the columns {', '.join(wanted)}"
                raise InputError(f"row {i} without {column}", expected, column=column)
    return [{**row, **{column: _number(row, column) for column in numbers}} for row in rows]


def distinct(names: Iterable[Any]) -> list[str]:
    """Return the names in order of first appearance."""
    return list(dict.fromkeys(map(str, names)))


def _number(row: Mapping[str, Any], column: str) -> float:
    value = row[column]
    try:
        return float(np.nan) if value is None else float(value)
    except (TypeError, ValueError):
        raise InputError(repr(value), "a number", column=column) from None


MAX_ROWS = 1000
"""Most lines of a table in the page."""


@dataclass(frozen=True)
class Card:
    """Summary number at the top: label, formatted value and a short description."""

    label: str
    value: str
    detail: str = ""


@dataclass(frozen=True)
class Note:
    """A paragraph of plain text."""

    text: str


@dataclass(frozen=True)
class DataTable:
    """A table; numbers are shown to four digits, None and NaN as a dash.

    Attributes
    ----------
    title : str
    columns : headings, with units
    rows : each as long as ``columns``
    note : a sentence below the table
    person_column : the column of track ids, if any; a click on an id selects the person in the replay
    """

    title: str
    columns: tuple[str, ...]
    rows: tuple[tuple[Any, ...], ...]
    note: str = ""
    person_column: str | None = None

    @classmethod
    def of(
        cls,
        title: str,
        table: Records,
        note: str = "",
        *,
        person_column: str | None = None,
        most: int | None = MAX_ROWS,
    ) -> DataTable:
        """Return a table of a DataFrame or dictionaries, with the columns of the first row.

        Of more than ``most`` lines the first are shown, and the note has their number.

        Raises
        ------
        InputError
            If a row lacks a column of the first.
        """
        rows = records(table)
        columns = [str(column) for column in rows[0]] if rows else []
        rows = records(rows, columns)
        if most is not None and len(rows) > most:
            note = f"{note} The first {most} of {len(rows)} lines.".strip()
        cells = tuple(tuple(row[c] for c in columns) for row in rows[:most])
        return cls(title, tuple(columns), cells, note, person_column)


@dataclass(frozen=True, eq=False)
class Picture:
    """A picture: a matplotlib figure or the bytes of a JPEG file, such as a frame of a video.

    Attributes
    ----------
    title : str
    content : matplotlib.figure.Figure or bytes
    description : alternative text
    is_photo : whether it has a photo in it, whose colours stay in dark mode; JPEG files always do
    """

    title: str
    content: Figure | bytes
    description: str = ""
    is_photo: bool = False


@dataclass(frozen=True)
class Chart:
    """A chart that is drawn from the data of the report's replay.

    Attributes
    ----------
    kind : "angles", body and head of the selected person over time, or "timeline", a bar for each person
    title : str
    note : a sentence below
    """

    kind: Literal["angles", "timeline"]
    title: str
    note: str = ""


@dataclass(frozen=True)
class Section:
    """Heading and its content."""

    title: str
    items: tuple[Note | DataTable | Picture | Chart, ...]


@dataclass(frozen=True)
class Report:
    """A page.

    Attributes
    ----------
    title, subtitle : str
    cards : the numbers at the top
    replay : result of `graphtrack.report.replay.replay_data`, or None
    sections : sections below the replay
    """

    title: str
    cards: tuple[Card, ...] = ()
    replay: Mapping[str, Any] | None = None
    sections: tuple[Section, ...] = field(default=())
    subtitle: str = ""
