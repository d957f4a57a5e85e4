"""Tables of forecasts: recognised by their columns, and read."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np

from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray
from graphtrack.io.readers.native_parquet import damage_told
from graphtrack.io.source import Source

COLUMNS = ("track_id", "frame", "t", "ahead", "x", "y", "x_std", "y_std", "xy_cov", "radius_50", "radius_90")
"""Of a table of forecasts; ``sample_<k>_x`` and ``sample_<k>_y`` may follow."""

_TELLING = ("track_id", "t", "ahead", "radius_50", "radius_90")
_PARQUET = b"PAR1"


def is_forecast(path: Path) -> bool:
    """Return whether a file is a table of forecasts.

    Raise InputError if it cannot be read at all.
    """
    return set(_TELLING) <= set(_names(Source.open(path)))


def read_forecasts(path: Path) -> dict[str, FloatArray]:
    """The columns (rows,) of a table of forecasts.

    Raise InputError with the line and the column that cannot be used.
    """
    import pandas as pd

    source = Source.open(path)
    missing = [name for name in COLUMNS if name != "frame" and name not in _names(source)]
    if missing:
        raise InputError(f"no column {missing[0]}", f"the columns {', '.join(COLUMNS)}", path=path)
    if source.head.startswith(_PARQUET):
        with damage_told(path):
            table = pd.read_parquet(io.BytesIO(source.data))
    else:
        try:
            if _is_json(source):
                table = pd.read_json(io.StringIO(source.text), lines=True, dtype=False)
            else:
                table = pd.read_csv(io.StringIO(source.text), dtype=str, keep_default_na=False)
        except ValueError as error:  # pandas' own errors among them
            raise InputError(" ".join(str(error).split())[:100], "a whole table", path=path) from error
    wanted = [name for name in table.columns if name in COLUMNS or name.startswith("sample_")]
    found: dict[str, FloatArray] = {}
    for name in wanted:
        values = pd.to_numeric(table[name], errors="coerce").to_numpy(float)
        wrong = np.flatnonzero(~np.isfinite(values))
        if len(wrong):
            place = int(wrong[0]) + (1 if source.head.startswith(_PARQUET) or _is_json(source) else 2)
            text = str(table[name].iloc[wrong[0]])[:40]
            raise InputError(repr(text), "a finite number", path=path, line=place, column=name)
        found[name] = values
    if not len(table):
        raise InputError("no rows", "forecasts", path=path)
    for name in ("x_std", "y_std", "radius_50", "radius_90", "ahead"):
        if (found[name] <= 0.0).any():
            place = int(np.argmax(found[name] <= 0.0))
            raise InputError(f"{found[name][place]:g}", "a number above 0", path=path, column=name)
    return found


def _is_json(source: Source) -> bool:
    return source.head.lstrip().startswith(b"{")


def _names(source: Source) -> list[str]:
    if source.head.startswith(_PARQUET):
        import pyarrow.parquet as pq

        with damage_told(source.path):
            return list(pq.read_schema(io.BytesIO(source.data)).names)
    first = next((line for line in source.head.decode("utf-8", "replace").splitlines() if line.strip()), "")
    if _is_json(source):
        return [name for name in _TELLING if f'"{name}"' in first] + [
            name for name in COLUMNS if name not in _TELLING and f'"{name}"' in first
        ]
    return [name.strip().strip('"') for name in first.removeprefix("\ufeff").split(",")]
