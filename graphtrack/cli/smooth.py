"""`graphtrack smooth`."""

from __future__ import annotations

import time
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from graphtrack.cli import options
from graphtrack.cli.console import BAD_INPUT, console, progress_bar
from graphtrack.cli.dataset import check_streamed, is_streamed, smooth_streamed
from graphtrack.cli.of_tables import OfTables
from graphtrack.display import counted, duration

if TYPE_CHECKING:
    from graphtrack.tracks import TrackSet

_LARGE = "Data sets larger than memory"


def smooth(
    inputs: options.Inputs,
    output: options.Output,
    reading: options.SceneReading,
    model: options.BestModelName = None,
    engine: Annotated[
        str,
        typer.Option(
            "--engine",
            metavar="<auto|chain|gtsam>",
            help="auto takes chain, which is compiled, where it can; isam2 and fixed-lag are for track.",
        ),
    ] = "auto",
    trust: options.TrustNoise = None,
    fill: Annotated[
        bool | None,
        typer.Option(
            "--fill/--no-fill",
            help="Estimate the frames between a person's rows that the table leaves out. [default: fill]",
            show_default=False,
        ),
    ] = None,
    resample: Annotated[
        float | None,
        typer.Option(
            "--resample", metavar="HZ", help="Estimates at so many frames a second.", show_default=False
        ),
    ] = None,
    jobs: Annotated[
        int | None,
        typer.Option(
            "--jobs",
            min=1,
            help="Tracks at a time: threads (chain; by default one for each processor) or processes (gtsam).",
            show_default=False,
        ),
    ] = None,
    report: Annotated[Path | None, typer.Option("--report", help="Write an HTML report here too.")] = None,
    stream: Annotated[
        bool | None,
        typer.Option(
            "--stream/--no-stream",
            help="Parquet track by track, in bounded memory, as folders and files of 512 MB are.",
            show_default=False,
            rich_help_panel=_LARGE,
        ),
    ] = None,
    batch_frames: Annotated[
        int,
        typer.Option(
            "--batch-frames",
            min=1,
            help="Person-frames held at a time when streaming.",
            rich_help_panel=_LARGE,
        ),
    ] = 100_000,
    cluster: Annotated[
        str | None,
        typer.Option(
            "--cluster",
            metavar="ADDRESS|local",
            help="Stream to a Dask cluster: its scheduler's address, or --jobs processes of this machine.",
            rich_help_panel=_LARGE,
        ),
    ] = None,
) -> None:
    """Smooth tracks offline: positions, velocities, body and head, with their uncertainties."""
    from graphtrack.gaps import at_times, with_times_at
    from graphtrack.inference.chain.engine import fit_lanes
    from graphtrack.inference.engines import engine_of
    from graphtrack.inference.solution import Failure, Solution
    from graphtrack.inference.warm import make_solver_ready
    from graphtrack.io import write
    from graphtrack.model import Model
    from graphtrack.smoothing.recording import solve_tracks
    from graphtrack.trust.verdict import trusted

    options.check_outputs(
        {"--output": output, "--report": report},
        reading.inputs(inputs, model),
        table=output,
    )
    chosen = Model.named(model)
    solver = engine_of(chosen, engine)
    if is_streamed(inputs, output, stream, cluster):
        unused: dict[str, object] = {
            "--report": report,
            "--class": reading.classes,
            "--image-scale": reading.image_scale,
        }
        unused["--fill"], unused["--resample"] = fill, resample
        unused["--trust"] = trust not in (None, "declared")
        unused |= {options.option_name(one.name): getattr(reading, one.name) for one in fields(OfTables)}
        unused["--format"] = reading.format not in (None, "parquet")
        smooth_streamed(
            check_streamed(inputs, output, unused),
            output,
            model=chosen,
            engine=solver,
            jobs=jobs,
            cluster=cluster,
            batch_frames=batch_frames,
            select=tuple(reading.select or ()),
            read_options=reading.options(),
        )
        return
    tracks = reading.tracks(inputs, scene=chosen.scene)
    origin = min(float(track.t[0]) for track in tracks)
    if fill is not False:
        tracks = _without_gaps(tracks)
    if resample is not None:
        tracks = with_times_at(tracks, resample)
    observed, chosen, said = trusted(tracks, chosen, trust or "check")
    for line in said:
        console.print(f"  note: {line}", markup=False)
    in_lanes = fit_lanes(observed.tracks, chosen)
    make_solver_ready(chosen, solver, tracks.camera, in_lanes)
    start = time.perf_counter()
    with progress_bar(tracks.n_frames) as advance:
        found = solve_tracks(observed, chosen, solver, jobs=jobs, progress=advance)
    seconds = time.perf_counter() - start
    good = [result for result in found if isinstance(result, Solution)]
    bad = [result for result in found if isinstance(result, Failure)]
    estimates = tracks.with_tracks(result.track for result in good)
    if good:
        write(estimates if resample is None else at_times(estimates, resample, origin), output)
    unconverged = [result for result in good if not result.converged]
    console.print(
        f"smoothed {len(good)} of {len(tracks)} tracks, {estimates.n_frames} person-frames in "
        f"{duration(seconds)}; model {chosen.preset}, engine {solver}, "
        f"{len(good) - len(unconverged)} converged",
        markup=False,
    )
    for result in unconverged:
        console.print(
            f"  track {result.track.track_id}: not converged in {result.iterations} steps", markup=False
        )
    if report is not None and good:
        from graphtrack.report.build import tracking_report
        from graphtrack.report.html import write_report

        write_report(report, tracking_report(estimates, tracks, title="Smoothed tracks"))
        console.print(f"report: {report}", markup=False)
    if good:
        console.print(f"wrote {output}", markup=False)
    for failure in bad:
        console.print(f"error: track {failure.track_id}: {failure.reason}", markup=False)
    if bad:
        raise typer.Exit(BAD_INPUT)


def _without_gaps(tracks: TrackSet) -> TrackSet:
    """Insert missing frames, and report how many there are."""
    from graphtrack.gaps import LONGEST_FILLED, filled, unfilled_gaps

    found = filled(tracks)
    inserted, left = found.n_frames - tracks.n_frames, unfilled_gaps(tracks)
    if inserted:
        share = 100.0 * tracks.n_frames / found.n_frames
        there = f"{tracks.n_frames:,} of {found.n_frames:,} frames have rows ({share:.1f} %)"
        said = f"{there}; the others are filled"
        console.print(f"  note: {said}", markup=False)
    if left:
        console.print(
            f"  note: {counted(left, 'gap')} of more than {LONGEST_FILLED:g} s not filled", markup=False
        )
    return found
