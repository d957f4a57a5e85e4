"""Commands `graphtrack reproduce`, the papers' experiments, `graphtrack demo` and `graphtrack cite`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from graphtrack.cli import options
from graphtrack.cli.compare import FIGURES, print_comparison, write_figures
from graphtrack.cli.console import (
    emit,
    input_warnings_as_notes,
    print_table,
    progress_bar,
    save_figure,
    write_json,
)
from graphtrack.errors import InputError

if TYPE_CHECKING:
    from graphtrack.experiments import Reproduction
    from graphtrack.experiments.harness import Table


DATA_FOLDER = Path("..") / "shared" / "data"
"""Folder of recordings when none is given."""


def reproduce(
    name: Annotated[str, typer.Argument()],
    out: Path,
    json_path: options.Json = None,
    quick: bool = False,
    data: Annotated[Path | None, typer.Option(envvar="GRAPHTRACK_DATA")] = None,
    seed: options.Seed = 0,
) -> None:
    """Reproduce an experiment of the papers: tables of published and own numbers, and a page of figures.

    Parameters
    ----------
    name : baxter-simulated, baxter-caviar, baxter-occlusion, baxter-statistics, baxter-weight,
        baxter-network, chen-joint, chen-classes, chen-pixels, ba-mixed-state, yan-sigma-pi, gaits, honesty,
        unseen-people, robustness, meetings, strangers, parties, forecasts, identities, or all.
    out : Folder for figures (PNG) and tables (JSON).
    quick : Few tracks, for a first look.
    data : Folder with mocap, salsa and caviar; by default ../shared/data, if it exists.
    """
    from graphtrack.experiments import Settings, all_experiments

    experiments = all_experiments()
    if name != "all" and name not in experiments:
        raise InputError(f"experiment {name!r}", f"one of {', '.join(experiments)}, or all")
    if data is not None and not data.is_dir():
        raise InputError("no such folder", "a folder of recordings", path=data)
    folder = data if data is not None else DATA_FOLDER if DATA_FOLDER.is_dir() else None
    chosen = experiments if name == "all" else {name: experiments[name]}
    options.check_outputs(
        {
            "--json": json_path,
            "--out": [out / f"{one}.{ending}" for one in chosen for ending in ("png", "json")],
        },
        {"--data": [] if folder is None else [folder / kind for kind in ("mocap", "salsa", "caviar")]},
        to_make=[out],
    )
    options.make_folder(out)
    if folder is None:
        emit("no recordings: simulated people only; --data names a folder of them")
    settings = Settings(quick=quick, seed=seed, data=folder)
    tables: list[Table] = []
    for experiment in chosen.values():
        emit(f"{experiment.name}: {experiment.source}")
        with input_warnings_as_notes(), progress_bar(None, "parts") as advance:
            found = experiment.run(settings, advance, lambda parts: advance(0, parts))
        write(found, out, experiment.quick if quick else "")
        tables += found.tables
    write_json(json_path, [table.to_dict() for table in tables])


def write(found: Reproduction, folder: Path, quick: str = "") -> None:
    """Print the tables and notes of an experiment and write its page and tables to a folder.

    Parameters
    ----------
    quick : description of the reduced number of people, if it ran quickly
    """
    for table in found.tables:
        print_table(table.title, table.records())
    for note in found.notes:
        emit(f"  {note}")
    if found.figure is None:
        return
    if quick:
        emit(f"  --quick: {quick}. So few prove nothing; this is a functional check.")
    save_figure(found.figure, folder / f"{found.name}.png")
    write_json(folder / f"{found.name}.json", [table.to_dict() for table in found.tables])


OBSERVATIONS, ESTIMATES, REPORT, TRACKS = "observations.csv", "estimates.csv", "report.html", "tracks.png"


def demo(
    out: Path = Path("demo"),
    model: options.BestModelName = None,
    seconds: float = 30.0,
    seed: options.Seed = 0,
) -> None:
    """Simulate people, smooth them offline, track them online, compare with filters, and write a report.

    Parameters
    ----------
    out : Folder for the results.
    seconds : Length of the scene.
    """
    import numpy as np

    from graphtrack.evaluation.compare import compare
    from graphtrack.evaluation.observed import observed_calibration
    from graphtrack.inference.engines import Solution, engine_of
    from graphtrack.io import write
    from graphtrack.model import Model
    from graphtrack.report.html import write_html
    from graphtrack.report.lives import pair_tracks
    from graphtrack.report.page import run_sections, tracking_report
    from graphtrack.report.plots import plot_reliability
    from graphtrack.report.plots.scene import plot_pairs
    from graphtrack.simulation.scenario import scenario
    from graphtrack.smoothing import prepare

    observed = scenario(np.random.default_rng(seed), seconds=seconds)
    names = (OBSERVATIONS, ESTIMATES, REPORT, TRACKS, *FIGURES)
    options.check_outputs({"--out": options.files_in(out, names)}, {"--model": options.model_file(model)})
    chosen = Model.named(model)
    options.make_folder(out)
    emit(f"{len(observed)} people, {observed.n_frames} person-frames, simulated; smoothing")
    write(observed, out / OBSERVATIONS)
    work = prepare(observed, chosen, engine_of(chosen, "auto"))
    with progress_bar(observed.n_frames) as advance:
        found = [one for one in work.solve(progress=advance) if isinstance(one, Solution)]
    estimates = work.estimates(found)
    write(estimates, out / ESTIMATES)
    methods = ["kf", "chain", "isam2", "rts", "smoother"]
    emit(f"comparing {', '.join(methods)}")
    with progress_bar(observed.n_frames) as advance:
        comparison = compare(observed, methods, model=chosen, progress=advance)
    print_comparison(comparison)
    write_figures(comparison, out)
    # On the observations, as anybody can have it: against the truth it is in the report.
    checked = observed_calibration(work.observed, found, work.model)
    save_figure(plot_reliability(checked, "observations"), out / FIGURES[1])
    save_figure(plot_pairs(pair_tracks(estimates, observed), title="Smoothed tracks"), out / TRACKS)
    report = tracking_report(
        estimates,
        observed,
        title="graphtrack demo",
        comparison=comparison.rows,
        calibration=comparison.calibration,
        sections=run_sections(work.observed, found, work.model, checked),
    )
    write_html(out / REPORT, report)
    emit(f"the report is {out / REPORT}")


def cite(
    reading: options.SceneReading,
    inputs: Annotated[list[Path] | None, typer.Argument(metavar="[FILE...]")] = None,
    model: options.BestModelName = None,
    engine: Annotated[str, typer.Option(metavar="<auto|chain|gtsam|isam2|fixed-lag>")] = "auto",
    constants: options.Constants = None,
    groups: Annotated[bool, typer.Option("--groups")] = False,
    attention: Annotated[bool, typer.Option("--attention")] = False,
    bibtex: bool = False,
) -> None:
    """Print a methods paragraph and its references, for a paper.

    With files it says what was read and refused. 'graphtrack smooth --report' writes the paragraph with the
    constants that were learned.

    Parameters
    ----------
    inputs : Tracks or detections, to say what was read of them.
    engine : Of the run; isam2 and fixed-lag are those of track.
    groups : Say how groups were found.
    attention : Say how gaze targets were estimated.
    bibtex : Print the BibTeX entries of this version and of the references too.
    """
    from graphtrack.constants.personal import is_learned, known_constants
    from graphtrack.inference.engines import engine_of, online_engine
    from graphtrack.model import Model
    from graphtrack.report.methods import bibtex_entries, methods_lines, methods_text

    chosen = Model.named(model)
    is_online = engine in ("isam2", "fixed-lag")
    solver = online_engine(chosen, engine) if is_online else engine_of(chosen, engine)  # type: ignore[arg-type]
    known = known_constants(constants)
    words = (
        "learned" if is_learned(known, chosen) else "the defaults" if constants != "default" else "default"
    )
    summary = reading.tracks(inputs).summary if inputs else None
    computed = [name for name, asked in (("groups", groups), ("attention", attention)) if asked]
    text, works = methods_text(chosen, solver, constants=words, summary=summary, behaviour=computed)
    text, *lines = methods_lines(text, works)
    typer.echo(text)
    for line in lines:
        typer.echo(f"  {line}")
    if bibtex:
        typer.echo(bibtex_entries(works))
