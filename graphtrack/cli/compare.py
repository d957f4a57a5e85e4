"""`graphtrack compare`."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from graphtrack.cli import options
from graphtrack.cli.console import console, print_table, progress_bar
from graphtrack.cli.simulate import BodyKappa, HeadKappa, PositionNoise

if TYPE_CHECKING:
    from graphtrack.evaluation.compare import Comparison


def compare(
    inputs: options.Inputs,
    methods: Annotated[
        str, typer.Option("--methods", help="Comma-separated: kf, rts, smoother, isam2, fixed-lag.")
    ] = "kf,rts,smoother,isam2,fixed-lag",
    model: options.ModelName = "joint",
    occlude: Annotated[
        float | None,
        typer.Option("--occlude", help="Seconds around the sharpest turn to withhold and to score."),
    ] = None,
    position_noise: PositionNoise = None,
    body_kappa: BodyKappa = None,
    head_kappa: HeadKappa = None,
    fps: options.Fps = None,
    format: options.Format = None,
    select: options.Select = None,
    seed: options.Seed = 0,
    json_path: options.Json = None,
    figures: Annotated[Path | None, typer.Option("--figures", help="Folder for figures (PNG).")] = None,
) -> None:
    """Compare methods on tracks whose truth is known, each with the information it says.

    With a noise option the file's own values are the truth, and what the methods see is made from them.
    """
    import numpy as np

    from graphtrack.degrade import add_noise
    from graphtrack.evaluation.compare import compare as compare_methods
    from graphtrack.io import atomic_path

    tracks = options.read_tracks(inputs, format=format, fps=fps, select=select)
    if any(noise is not None for noise in (position_noise, body_kappa, head_kappa)):
        rng = np.random.default_rng(seed)
        tracks = add_noise(
            tracks, position_std=position_noise, body_kappa=body_kappa, head_kappa=head_kappa, rng=rng
        )
    names = [name.strip() for name in methods.split(",") if name.strip()]
    with progress_bar(len(names) * len(tracks), "tracks × methods") as advance:
        found = compare_methods(tracks, names, model=model, occlude_seconds=occlude, progress=advance)
    print_comparison(found)
    if json_path is not None:
        with atomic_path(json_path) as temporary:
            temporary.write_text(json.dumps(found.to_dict(), indent=1), encoding="utf-8")
        console.print(f"wrote {json_path}", markup=False)
    if figures is not None:
        write_figures(found, figures)


def print_comparison(comparison: Comparison) -> None:
    """The comparison as tables on standard output."""
    for metric in dict.fromkeys(str(row["metric"]) for row in comparison.rows):
        rows = [row for row in comparison.rows if row["metric"] == metric]
        print_table(
            f"{metric} ({rows[0]['unit']})",
            [{k: row[k] for k in ("method", "median", "low", "high", "mean", "n")} for row in rows],
        )
    print_table("NEES", comparison.nees)
    console.print(comparison.caption, markup=False)


def write_figures(comparison: Comparison, folder: Path) -> None:
    """Figures of errors and NEES, as PNG files in a folder."""
    from graphtrack.io import atomic_path
    from graphtrack.report.plots import plot_errors, plot_nees

    folder.mkdir(parents=True, exist_ok=True)
    made = {"errors.png": plot_errors(comparison.rows)}
    if comparison.nees:
        made["nees.png"] = plot_nees(comparison.nees)
    for name, figure in made.items():
        with atomic_path(folder / name) as temporary:
            figure.savefig(temporary, format="png", dpi=120)
        console.print(f"wrote {folder / name}", markup=False)
