"""`graphtrack reproduce`."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from graphtrack.cli import options
from graphtrack.cli.console import console, input_warnings_as_notes, print_table, progress_bar
from graphtrack.errors import InputError

if TYPE_CHECKING:
    from graphtrack.evaluation.reproduce.experiment import Table
    from graphtrack.experiments import Reproduction

BESIDE = Path("..") / "shared" / "data"
"""Where recordings are looked for when nobody says where they are."""

RECORDINGS = ("mocap", "salsa", "caviar")
"""The folders of recordings that the experiments read."""


def reproduce(
    name: Annotated[
        str,
        typer.Argument(
            help="baxter-simulated, baxter-caviar, baxter-occlusion, baxter-statistics, baxter-network, "
            "chen-joint, chen-classes, chen-pixels, ba-mixed-state, yan-sigma-pi, gaits, honesty, meetings, "
            "strangers, unseen-people, or all.",
            show_default=False,
        ),
    ],
    out: Annotated[Path, typer.Option("--out", help="Folder for figures (PNG) and tables (JSON).")],
    json_path: options.Json = None,
    quick: Annotated[bool, typer.Option("--quick", help="Few tracks, for a first look.")] = False,
    data: Annotated[
        Path | None,
        typer.Option(
            "--data",
            envvar="GRAPHTRACK_DATA",
            help="Folder with mocap, salsa and caviar in it; else ../shared/data if that is there.",
        ),
    ] = None,
    seed: options.Seed = 0,
) -> None:
    """Run an experiment of the papers again: tables with their numbers beside ours, and a page of figures."""
    from graphtrack.experiments import Settings, all_experiments

    experiments = all_experiments()
    if name != "all" and name not in experiments:
        raise InputError(f"experiment {name!r}", f"one of {', '.join(experiments)}, or all")
    if data is not None and not data.is_dir():
        raise InputError("no such folder", "a folder of recordings", path=data)
    folder = data if data is not None else BESIDE if BESIDE.is_dir() else None
    chosen = experiments if name == "all" else {name: experiments[name]}
    options.check_outputs(
        {
            "--json": json_path,
            "--out": [out / f"{one}.{ending}" for one in chosen for ending in ("png", "json")],
        },
        {"--data": [] if folder is None else [folder / kind for kind in RECORDINGS]},
        to_make=[out],
    )
    options.make_folder(out)
    if folder is None:
        console.print("no recordings: simulated people only; --data names a folder of them", markup=False)
    settings = Settings(quick=quick, seed=seed, data=folder)
    tables: list[Table] = []
    for experiment in chosen.values():
        console.print(f"{experiment.name}: {experiment.source}", markup=False)
        with input_warnings_as_notes(), progress_bar(experiment.work(settings), "parts") as advance:
            found = experiment.run(settings, advance)
        write(found, out, experiment.quick if quick else "")
        tables += found.tables
    if json_path is not None:
        write_tables(json_path, tables)
        console.print(f"wrote {json_path}", markup=False)


def write(found: Reproduction, folder: Path, quick: str = "") -> None:
    """Print the tables and notes of an experiment and write its page and tables to a folder.

    Parameters
    ----------
    quick : how few people were judged, where it ran quickly
    """
    from graphtrack.io import atomic_path

    for table in found.tables:
        print_table(table.title, table.records())
    for note in found.notes:
        console.print(f"  {note}", markup=False)
    if found.figure is None:
        return
    if quick:
        console.print(f"  --quick: {quick}. So few prove nothing: it shows that it runs.", markup=False)
    page, numbers = folder / f"{found.name}.png", folder / f"{found.name}.json"
    with atomic_path(page) as temporary:
        found.figure.savefig(temporary, format="png", dpi=120)
    write_tables(numbers, found.tables)
    console.print(f"wrote {page} and {numbers}", markup=False)


def write_tables(path: Path, tables: Sequence[Table]) -> None:
    """Tables as JSON: title, columns and rows of each."""
    from graphtrack.io import atomic_path

    text = json.dumps([table.to_dict() for table in tables], indent=1, ensure_ascii=False)
    with atomic_path(path) as temporary:
        Path(temporary).write_text(text, encoding="utf-8")
