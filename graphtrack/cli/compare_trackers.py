"""`graphtrack compare` of trackers: detections without identities, and a truth that judges."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from graphtrack.cli import options
from graphtrack.cli.console import emit, print_table, progress_bar, quiet_input_warnings, write_json
from graphtrack.errors import InputError

if TYPE_CHECKING:
    from graphtrack.evaluation.tracking.compare import TrackerComparison


def compare_trackers(
    inputs: Sequence[Path],
    truth: Path,
    reading: options.SceneReading,
    methods: Sequence[str],
    metres: float | None,
    fill: bool,
    model: str | None,
    json_path: Path | None,
) -> None:
    """Read detections and truth, run the trackers on them, and print their figures.

    Parameters
    ----------
    methods : names; none: the default ones
    """
    from graphtrack.evaluation.tracking.compare import compare_trackers as compare
    from graphtrack.evaluation.tracking.compare import read_detections
    from graphtrack.evaluation.tracking.methods import TRACKERS

    options.check_outputs({"--json": json_path}, reading.inputs([*inputs, truth], model))
    if len(inputs) > 1:
        raise InputError(f"{len(inputs)} files of detections", "one recording at a time")
    refused = {"--select": reading.select, "--associate never": reading.associate == "never"}
    options.refuse(refused, "with --truth", "all detections, without identities")
    path = inputs[0]
    with quiet_input_warnings():
        detections, summary = read_detections(path, reading.format, reading.options())
    emit(f"{path}: {summary.format}, {len(detections)} detections")
    for note in summary.notes:
        emit(f"  note: {note}")
    true = replace(reading, associate="never", format=None).tracks([truth])
    names = list(methods) or list(TRACKERS)
    with progress_bar(len(names), "methods") as advance:
        found = compare(detections, true, names, metres=metres, fill=fill, model=model, progress=advance)
    print_trackers(found)
    write_json(json_path, found.to_dict())


def print_trackers(found: TrackerComparison) -> None:
    """The figures as a table on standard output, and below it how to read them."""
    from graphtrack.evaluation.tracking.scores import HEADINGS

    rows = []
    for one in found.results:
        told = one.to_dict()
        figures = {HEADINGS.get(name, name): told[name] for name in told if name != "information"}
        rows.append({"method": one.method, "": one.group} | figures)
    for row in rows:
        row.pop("group")
    print_table(f"Trackers on the same {found.detections} detections, {found.threshold}", rows)
    for one in found.results:
        filled = "; smoothed, gaps filled" if found.filled and one.online else ""
        emit(f"  {one.method}: {one.information}{filled}")
    for note in found.notes:
        emit(f"  note: {note}")
