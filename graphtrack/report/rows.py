"""The plain tables that comparisons arrive in, checked once and typed."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.special import chdtri

from graphtrack.errors import InputError

if TYPE_CHECKING:
    import pandas as pd

    Records = pd.DataFrame | Sequence[Mapping[str, Any]]
else:
    Records = Any


@dataclass(frozen=True)
class ErrorRow:
    """One metric of one method: the median over the tracks and the ends of its spread, in ``unit``."""

    method: str
    metric: str
    unit: str
    median: float
    low: float
    high: float


@dataclass(frozen=True)
class NeesRow:
    """The mean NEES of one method over ``count`` independent errors of ``dof`` dimensions."""

    method: str
    quantity: str
    nees: float
    dof: float
    count: float

    @property
    def band(self) -> tuple[float, float]:
        """The central 95 % of the mean of ``count`` χ² variables with ``dof`` degrees of freedom."""
        total = self.dof * self.count
        low, high = chdtri(total, [0.975, 0.025]) / self.count
        return float(low), float(high)


def error_rows(table: Records) -> list[ErrorRow]:
    """Check and type the rows of a comparison.

    Raises
    ------
    InputError
        When there are no rows or a column is missing.
    """
    return [
        ErrorRow(
            str(r["method"]),
            str(r["metric"]),
            str(r["unit"] or ""),
            *(_number(r, column) for column in ("median", "low", "high")),
        )
        for r in records(table, _columns(ErrorRow))
    ]


def nees_rows(table: Records) -> list[NeesRow]:
    """Check and type the rows of a consistency table.

    Raises
    ------
    InputError
        When there are no rows, a column is missing, or ``dof`` or ``count`` is not positive.
    """
    rows = [
        NeesRow(str(r["method"]), str(r["quantity"]), *(_number(r, c) for c in ("nees", "dof", "count")))
        for r in records(table, _columns(NeesRow))
    ]
    for row in rows:
        for column in ("dof", "count"):
            value = getattr(row, column)
            if not value > 0.0:
                raise InputError(f"{value} for {row.method}", "a positive number", column=column)
    return rows


def records(table: Records, columns: Sequence[str] = ()) -> list[Mapping[str, Any]]:
    """The rows of a DataFrame or list as mappings that have ``columns``.

    Raises
    ------
    InputError
        When there are no rows or a column is missing.
    """
    rows: list[Mapping[str, Any]] = (
        table.to_dict(orient="records") if hasattr(table, "to_dict") else list(table)  # type: ignore[assignment]
    )
    if not rows:
        raise InputError("no rows", "at least one row" + (f" with {', '.join(columns)}" if columns else ""))
    for i, row in enumerate(rows):
        for column in columns:
            if column not in row:
                expected = f"the columns {', '.join(columns)}"
                raise InputError(f"row {i} without {column}", expected, column=column)
    return rows


def distinct(names: Iterable[str]) -> list[str]:
    """The names in the order in which they first appear."""
    return list(dict.fromkeys(names))


def _columns(row: type[ErrorRow] | type[NeesRow]) -> list[str]:
    return [f.name for f in fields(row)]


def _number(row: Mapping[str, Any], column: str) -> float:
    value = row[column]
    if value is None:
        return float(np.nan)
    try:
        return float(value)
    except (TypeError, ValueError):
        raise InputError(repr(value), "a number", column=column) from None
