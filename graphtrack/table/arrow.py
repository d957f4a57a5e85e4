"""NumPy arrays as Arrow has them, without pandas, which pyarrow imports to convert anything itself."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    import pyarrow as pa

_LONGEST = 2**31 - 1
"""Bytes of all texts of a column: Arrow's offsets have 32 bits."""


def arrow_array(values: NDArray[Any]) -> pa.Array:
    """A column (n,) as Arrow has it; NaN and None are missing there."""
    import pyarrow as pa

    if values.dtype in (np.float64, np.int64):
        kind = pa.float64() if values.dtype == np.float64 else pa.int64()
        return _array(kind, ~np.isnan(values), [pa.py_buffer(np.ascontiguousarray(values))])
    if values.dtype == object and any(values) and all(isinstance(one, str | None) for one in values):
        texts = [(one or "").encode() for one in values]
        ends = np.cumsum([0, *map(len, texts)])
        if ends[-1] <= _LONGEST:
            there = np.array([one is not None for one in values])
            buffers = [pa.py_buffer(ends.astype(np.int32)), pa.py_buffer(b"".join(texts))]
            return _array(pa.string(), there, buffers)
    return pa.array(values, from_pandas=True)


def _array(kind: pa.DataType, there: NDArray[np.bool_], buffers: list[pa.Buffer]) -> pa.Array:
    """An array of buffers, with those elements that are ``there``."""
    import pyarrow as pa

    valid = None if there.all() else pa.py_buffer(np.packbits(there, bitorder="little"))
    return pa.Array.from_buffers(kind, len(there), [valid, *buffers])
