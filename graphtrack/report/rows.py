"""Tables of a comparison as plain rows, checked to have their columns."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from graphtrack.errors import InputError

if TYPE_CHECKING:
    import pandas as pd

    Records = pd.DataFrame | Sequence[Mapping[str, Any]]
else:
    Records = Any


def records(
    table: Records, columns: Sequence[str] = (), numbers: Sequence[str] = ()
) -> list[Mapping[str, Any]]:
    """The rows of a DataFrame or list as mappings with ``columns``, and floats, NaN for None, in ``numbers``.

    Raises
    ------
    InputError
        When there are no rows, a column is missing or a number is none.
    """
    rows: list[Mapping[str, Any]] = (
        table.to_dict(orient="records") if hasattr(table, "to_dict") else list(table)  # type: ignore[assignment]
    )
    wanted = [*columns, *numbers]
    if not rows:
        raise InputError("no rows", "at least one row" + (f" with {', '.join(wanted)}" if wanted else ""))
    for i, row in enumerate(rows):
        for column in wanted:
            if column not in row:
                expected = f"the columns {', '.join(wanted)}"
                raise InputError(f"row {i} without {column}", expected, column=column)
    return [{**row, **{column: _number(row, column) for column in numbers}} for row in rows]


def distinct(names: Iterable[Any]) -> list[str]:
    """The names in the order in which they first appear."""
    return list(dict.fromkeys(map(str, names)))


def _number(row: Mapping[str, Any], column: str) -> float:
    value = row[column]
    try:
        return float(np.nan) if value is None else float(value)
    except (TypeError, ValueError):
        raise InputError(repr(value), "a number", column=column) from None
