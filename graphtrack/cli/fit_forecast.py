"""`graphtrack fit --forecast`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path

from graphtrack.cli import options
from graphtrack.cli.console import console, print_table
from graphtrack.cli.fitted import write_all
from graphtrack.errors import InputError


def learn_forecast(
    inputs: list[Path],
    reading: options.SceneReading,
    output: Path,
    report: Path | None,
    json_path: Path | None,
    unused: Mapping[str, bool],
) -> None:
    """Learn how people go on, say what came out, and write it.

    Raises
    ------
    InputError
        For options that mean nothing here, and for whatever nothing can be learned from.
    """
    from graphtrack.learning.forecast import fit_forecast

    for name, given in unused.items():
        if given:
            raise InputError(f"{name} with --forecast", "recordings of people whose identities are known")
    scenes = {str(path): reading.tracks([path]) for path in inputs}
    if len(scenes) < len(inputs):
        raise InputError("a file twice", "each recording once")
    with console.status("learning") as status:
        found = fit_forecast(scenes, progress=lambda what: status.update(f"learning: {what}"))
    found.parameters.save(output)
    start = asdict(found.start)
    fields = type(found.parameters).__dataclass_fields__
    changed: list[dict[str, object]] = [
        {"parameter": name, "before": start[name], "after": value, "unit": fields[name].metadata["unit"]}
        for name, value in asdict(found.parameters).items()
    ]
    bought: list[dict[str, object]] = [
        {
            "recording": name,
            "ADE ratio": round(found.errors[name][0], 3),
            "FDE ratio": round(found.errors[name][1], 3),
            "log density before": found.density[name][0],
            "after": found.density[name][1],
        }
        for name in found.errors
    ]
    tables = {"Parameters": changed, "Errors over those of constant velocity, and density": bought}
    for title, rows in tables.items():
        print_table(title, rows)
    write_all(output, json_path, report, found.to_dict(), ["Judged on what was learned from."], tables)
