"""Columns as Arrow has them: what pyarrow would make of them itself, without pandas."""

from __future__ import annotations

import numpy as np
import pyarrow as pa
import pytest

from graphtrack.tracks.table import arrow_array


@pytest.mark.parametrize(
    "values",
    [
        np.array([1.5, np.nan, -0.0, np.inf]),
        np.arange(20.0)[::2],
        np.array([3, -(2**62)]),
        np.array(["Zoë", None, ""], dtype=object),
        np.array([None, None], dtype=object),
        np.array([], dtype=object),
        np.array([], dtype=float),
        np.array(["2026-01-01", "NaT"], dtype="datetime64[us]"),
        np.array([True, False]),
    ],
)
def test_columns_are_what_pyarrow_makes_of_them(values: np.ndarray) -> None:
    found, expected = arrow_array(values), pa.array(values, from_pandas=True)
    found.validate(full=True)
    assert found.type == expected.type and found.equals(expected)
