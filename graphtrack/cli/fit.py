"""`graphtrack fit`."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from graphtrack.cli import options
from graphtrack.cli.console import console, print_table
from graphtrack.display import counted
from graphtrack.errors import InputError

if TYPE_CHECKING:
    from graphtrack.learning import Fit


def fit(
    inputs: options.Inputs,
    reading: options.Reading,
    output: Annotated[Path, typer.Option("--output", "-o", help="Model file to write (.toml).")],
    model: options.ModelName = "separate",
    criterion: Annotated[
        Literal["truth", "evidence", "prediction"] | None,
        typer.Option(
            "--criterion",
            help="By default the truth, where there is one, else the evidence or, with couplings, the "
            "prediction.",
        ),
    ] = None,
    hold_out: Annotated[
        float, typer.Option("--hold-out", min=0.0, max=0.9, help="Share of the tracks that only judge.")
    ] = 0.25,
    max_frames: Annotated[
        int, typer.Option("--max-frames", min=2, help="Person-frames to learn from at most.")
    ] = 20_000,
    report: Annotated[
        Path | None, typer.Option("--report", help="Write what changed and what it bought as HTML.")
    ] = None,
    json_path: options.Json = None,
    seed: options.Seed = 0,
) -> None:
    """Learn the parameters of a model from tracks, with their truth or without.

    If it is interrupted, the same command goes on from the progress file beside the output.
    """
    from graphtrack.io import atomic_path
    from graphtrack.learning import fit as learn

    if output.suffix != ".toml":
        raise InputError(f"output {output.name!r}", "a name that ends in .toml", path=output)
    journal = output.with_name(output.name + ".progress")
    options.check_outputs(
        {
            "--output": output,
            "the progress file of --output": journal,
            "--report": report,
            "--json": json_path,
        },
        reading.inputs(inputs, model),
    )
    tracks = reading.tracks(inputs)
    if journal.is_file():
        console.print(f"  going on from {journal}, if it is of the same data and options", markup=False)
    with console.status("learning") as status:
        found = learn(
            tracks,
            model,
            criterion=criterion,
            hold_out=hold_out,
            seed=seed,
            max_frames=max_frames,
            journal=journal,
            progress=lambda count: status.update(f"learning: {count} evaluations"),
        )
    found.model.save(output)
    print_table("Parameters", parameter_rows(found))
    print_table("What it bought: log density a frame", score_rows(found))
    console.print(caption(found), markup=False)
    for line in advice(found):
        console.print(line, markup=False)
    console.print(f"wrote {output}", markup=False)
    if json_path is not None:
        with atomic_path(json_path) as temporary:
            temporary.write_text(json.dumps(found.to_dict(), indent=1), encoding="utf-8")
        console.print(f"wrote {json_path}", markup=False)
    if report is not None:
        write_page(found, report)
        console.print(f"wrote {report}", markup=False)


def parameter_rows(found: Fit) -> list[dict[str, object]]:
    """What changed, a row for each parameter."""
    return [
        {
            "parameter": one.name,
            "before": one.start,
            "after": one.value,
            "95 % from": one.low,
            "to": one.high,
            "": one.note,
        }
        for one in found.learned
    ]


def score_rows(found: Fit) -> list[dict[str, object]]:
    """What it bought, a row for each part of the tracks."""
    return [
        {"tracks": name, "n": n, "before": before, "after": after, "gain": after - before}
        for (name, (before, after)), n in zip(found.scores.items(), found.tracks, strict=False)
    ]


def caption(found: Fit) -> str:
    """What was made great, in words."""
    what = {
        "truth": "the likelihood of the true positions and angles under the smoother's covariances",
        "evidence": "the Laplace evidence of the observations",
        "prediction": "the density of observations that were hidden from the smoother, a part at a time",
    }[found.criterion]
    return f"Learned by {what}; preset {found.model.preset}, {found.evaluations} evaluations."


def advice(found: Fit) -> list[str]:
    """What to do where learning did not help tracks that it had not seen; nothing where it did."""
    before, after = found.scores.get("held out", (0.0, 0.0))
    if after >= before:
        return []
    learned, held = found.tracks
    return [
        f"Learning made it worse on {counted(held, 'track')} held out, by {before - after:.3g} a frame: "
        f"keep the model that it started from ({found.start.preset}), or learn from more than "
        f"{counted(learned, 'track')}."
    ]


def write_page(found: Fit, path: Path) -> None:
    """The tables as one HTML file."""
    from graphtrack.report.content import DataTable, Note, Report, Section
    from graphtrack.report.html import write_report

    items: tuple[Note | DataTable, ...] = (
        *[Note(line) for line in (*advice(found), caption(found))],
        DataTable.from_records("What changed", parameter_rows(found)),
        DataTable.from_records("What it bought: log density a frame", score_rows(found)),
    )
    write_report(path, Report("Learned parameters", sections=(Section("Learning", items),)))
