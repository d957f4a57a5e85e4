"""`graphtrack fit` of a scene: from detections, or from tracks with ``--scene``."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from graphtrack.cli.console import console, print_table
from graphtrack.cli.fitted import write_all
from graphtrack.display import counted
from graphtrack.errors import InputError

if TYPE_CHECKING:
    from graphtrack.io.options import Associate
    from graphtrack.learning import SceneFit
    from graphtrack.table.rows import Rows


def learn_scene(
    rows: Rows | None,
    associate: Associate,
    model: str | None,
    hold_out: float,
    output: Path,
    report: Path | None,
    json_path: Path | None,
    unused: Mapping[str, bool],
) -> None:
    """Learn a scene, say what came out, and write it.

    Parameters
    ----------
    rows : of the input; None: there are several
    associate : "always": the identities of the input are forgotten
    model : whose scene it is to be; None: the best preset
    hold_out : share of the recording that only judges
    output, report, json_path : what to write
    unused : options that mean nothing here, and whether they were given

    Raises
    ------
    InputError
        For several inputs, such an option, and whatever nothing can be learned from.
    """
    from graphtrack.learning import fit_scene

    for name, given in {**unused, "--associate repair": associate == "repair"}.items():
        if given:
            raise InputError(f"{name} with a scene", "all rows of a recording, with identities or without")
    if rows is None:
        raise InputError("several files", "one recording at a time, to learn a scene")
    labelled = rows.has_identity and associate != "always"
    console.print(f"{rows.path}: {rows.format}, {counted(len(rows), 'row')}", markup=False)
    with console.status("learning") as status:
        found = fit_scene(
            rows,
            model,
            labelled=labelled,
            hold_out=hold_out,
            progress=lambda done, total: status.update(f"learning: {done} of {total} sweeps"),
        )
    found.model.save(output)
    tables = {
        "The scene": parameter_rows(found),
        "What it bought: log density a detection": part_rows(found),
    }
    for title, lines in tables.items():
        print_table(title, lines)
    notes = [*advice(found), caption(found)]
    for line in reversed(notes):
        console.print(line, markup=False)
    write_all(output, json_path, report, found.to_dict(), notes, tables)


def parameter_rows(found: SceneFit) -> list[dict[str, object]]:
    """What changed, a row for each parameter."""
    return [
        {
            "parameter": f"scene.{one.name}",
            "before": one.start,
            "after": one.value,
            "unit": one.unit,
            "": f"{one.note}: not learned" if one.note else "",
        }
        for one in found.learned
    ]


def part_rows(found: SceneFit) -> list[dict[str, object]]:
    """What it bought, a row for each part of the recording."""
    return [
        {
            "": name,
            "seconds": part.seconds,
            "detections": part.detections,
            "people": part.people,
            "false": part.false,
            "before": part.before,
            "after": part.after,
            "gain": part.after - part.before,
        }
        for name, part in found.parts.items()
    ]


def caption(found: SceneFit) -> str:
    """What was learned from, in words."""
    part = found.parts["learned from"]
    how = "given" if found.labelled else "found"
    return (
        f"Learned from {counted(part.detections, 'detection')} in {part.seconds:.0f} s: "
        f"{part.people} people {how}, {part.false} detections false."
    )


def advice(found: SceneFit) -> list[str]:
    """What to do where learning did not help what it had not seen; nothing where it did."""
    held = found.parts.get("held out")
    if held is None or held.after >= held.before:
        return []
    return [
        f"Learning made it worse on {held.seconds:.0f} s held out, by {held.before - held.after:.3g} a "
        "detection: learn from a longer recording."
    ]
