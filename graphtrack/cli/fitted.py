"""What `graphtrack fit` writes beside the model: the numbers, and a page."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from graphtrack.cli.console import console


def write_all(
    output: Path,
    json_path: Path | None,
    report: Path | None,
    content: dict[str, Any],
    notes: Sequence[str],
    tables: Mapping[str, list[dict[str, object]]],
) -> None:
    """Say that the model is written; write what was learned as JSON, and as HTML, where that is asked for."""
    from graphtrack.io import atomic_path
    from graphtrack.report.content import DataTable, Note, Report, Section
    from graphtrack.report.html import write_html

    written = [output]
    if json_path is not None:
        with atomic_path(json_path) as temporary:
            temporary.write_text(json.dumps(content, indent=1), encoding="utf-8")
        written.append(json_path)
    if report is not None:
        items: tuple[Note | DataTable, ...] = (
            *[Note(line) for line in notes],
            *[DataTable.from_records(title, rows) for title, rows in tables.items()],
        )
        write_html(report, Report("Learned parameters", sections=(Section("Learning", items),)))
        written.append(report)
    for path in written:
        console.print(f"wrote {path}", markup=False)
