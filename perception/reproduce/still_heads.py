"""Ba & Odobez 2003, Tables 1 to 3: identification of the pan of still heads, and which pans are taken for
which."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from graphtrack.evaluation.reproduce.experiment import Cell, Settings, Table
from graphtrack.geometry.angles import FloatArray
from perception.evaluation.recognition import RecognitionRow, recognition_table
from perception.pose.head_pose.exemplars import Density

PANS = (90.0, 67.5, 45.0, 22.5, 0.0, -22.5, -45.0, -67.5, -90.0)
"""Degrees, in the order of Ba & Odobez's Table 2."""

CONFUSION = np.array(
    [
        [100.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
        [14.7, 85.3, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
        [0.0, 0.0, 100.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
        [0.0, 0.0, 5.9, 94.1, 0.0, 0.0, 0.0, 0.0, 0.0],
        [0.0, 0.0, 0.0, 0.0, 100.0, 0.0, 0.0, 0.0, 0.0],
        [0.0, 0.0, 0.0, 0.0, 5.9, 94.1, 0.0, 0.0, 0.0],
        [0.0, 0.0, 0.0, 0.0, 0.0, 5.9, 94.1, 0.0, 0.0],
        [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 3.1, 91.0, 5.9],
        [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 100.0],
    ]
)
"""Ba & Odobez 2003, Table 2, as printed: per cent of the heads of each pan (rows) that are taken for each
pan (columns)."""

_PAPER: dict[tuple[int, Density, int], str] = {
    (68, "gaussian", 1): "90",
    (68, "saturated", 1): "94",
    (68, "gaussian", 2): "87.5",
    (68, "saturated", 2): "94.8",
    (140, "gaussian", 3): "67.2 ± 2.4",
    (140, "saturated", 4): "70.5 ± 2.3",
}
"""Ba & Odobez 2003, Tables 1 and 3: identification in per cent, by people (half of them learned from) and
exemplars."""

FIRST = 68
"""People of Ba & Odobez's Tables 1 and 2."""
_EXEMPLARS = {68: (1, 2), 140: (1, 2, 3, 4)}


def still_heads(settings: Settings) -> tuple[Table, Table, FloatArray]:
    """Tables 1 and 3 in one, Table 2, and our confusion matrix (9, 9) in per cent, in the order of `PANS`."""
    splits = 2 if settings.quick else 10
    records: list[dict[str, Cell]] = []
    confusion = np.zeros((len(PANS), len(PANS)))
    for k, (people, exemplars) in enumerate(_EXEMPLARS.items()):
        if settings.quick:
            people, exemplars = people // 4 // 2 * 2, exemplars[:2]
        rows, found = recognition_table(people, exemplars, settings.rng(100 + k), repetitions=splits)
        printed, _ = recognition_table(
            people, exemplars, settings.rng(100 + k), repetitions=splits, as_published=True
        )
        records += [_record(people, *both) for both in zip(rows, printed, strict=True)]
        if k == 0:
            confusion = found[::-1, ::-1]
    named = Table.of("Identification of nine pans (Ba & Odobez 2003, Tables 1 and 3)", records)
    return named, _confusions(confusion), confusion


def _record(people: int, row: RecognitionRow, printed: RecognitionRow) -> dict[str, Cell]:
    return {
        "people learned from": people // 2,
        "exemplars a pose": row.exemplars,
        "density": row.density,
        "paper (%)": _PAPER.get((people, row.density, row.exemplars)),
        "ours (%)": f"{100.0 * row.rate:.1f} ± {100.0 * row.deviation:.1f}",
        "as printed (%)": f"{100.0 * printed.rate:.1f} ± {100.0 * printed.deviation:.1f}",
    }


def _confusions(ours: FloatArray) -> Table:
    """A row for each true pan, of the paper and of ours."""
    records: list[dict[str, Cell]] = [
        {"true pan (°)": pan, "of": name, **_cells(matrix[k])}
        for k, pan in enumerate(PANS)
        for name, matrix in (("paper", CONFUSION), ("ours", ours))
    ]
    return Table.of(
        "Confusions of pans in per cent, 2 exemplars, saturated density (Ba & Odobez 2003, Table 2)", records
    )


def _cells(row: Sequence[float] | FloatArray) -> dict[str, Cell]:
    return {f"{pan:g}": round(float(value), 1) for pan, value in zip(PANS, row, strict=True)}
