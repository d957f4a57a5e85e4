"""Recordings of Rerun, read back."""

from collections import defaultdict
from pathlib import Path
from typing import Any

import numpy as np
from rerun.chunk import RrdReader

Rows = dict[int, Any]
"""Nanoseconds → what is there from then on; of what was logged twice the last."""


def read_recording(path: Path) -> dict[str, dict[str, Rows]]:
    """Entity → component → its rows; static values are at −1."""
    found: dict[str, dict[str, list[tuple[bytes, int, Any]]]] = defaultdict(lambda: defaultdict(list))
    for chunk in RrdReader(path).stream():
        batch = chunk.to_record_batch()
        names = batch.schema.names
        rows = batch.column(names.index("rerun.controls.RowId")).to_pylist()
        times = [-1] * batch.num_rows
        if not chunk.is_static and "time" in names:
            times = batch.column(names.index("time")).cast("int64").to_pylist()
        for name in names:
            if ":" in name:
                values = batch.column(names.index(name)).to_pylist()
                entries = zip(rows, times, values, strict=True)
                found[chunk.entity_path][name] += [e for e in entries if e[2] is not None]
    return {
        entity: {name: {t: v for _, t, v in sorted(rows, key=lambda e: e[0])} for name, rows in of.items()}
        for entity, of in found.items()
    }


def nanoseconds(t: Any) -> list[int]:
    """Seconds as a recording has them."""
    return np.round(np.asarray(t, float) * 1e9).astype(np.int64).tolist()
