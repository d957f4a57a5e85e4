"""`graphtrack smooth`."""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from graphtrack.cli import options
from graphtrack.cli.console import BAD_INPUT, emit, progress_bar
from graphtrack.cli.dataset import check_streamed, is_streamed, smooth_streamed
from graphtrack.display import counted, duration

if TYPE_CHECKING:
    from graphtrack.tracks import TrackSet


def smooth(
    inputs: options.Inputs,
    output: options.Output,
    reading: options.SceneReading,
    model: options.BestModelName = None,
    engine: Annotated[str, typer.Option(metavar="<auto|chain|gtsam>")] = "auto",
    trust: options.TrustNoise = None,
    fill: bool | None = None,
    resample: Annotated[float | None, typer.Option(metavar="HZ")] = None,
    jobs: Annotated[int | None, typer.Option(min=1)] = None,
    report: Path | None = None,
    stream: bool | None = None,
    batch_frames: Annotated[int, typer.Option(min=1)] = 100_000,
    cluster: Annotated[str | None, typer.Option(metavar="ADDRESS|local")] = None,
) -> None:
    """Smooth tracks offline: positions, velocities, body and head, with their uncertainties.

    Parameters
    ----------
    engine : auto takes chain, which is compiled, where it can; isam2 and fixed-lag are for track.
    fill : Estimate the frames between a person's rows that the table leaves out. [default: fill]
    resample : Estimates at so many frames a second.
    jobs : Tracks at a time: threads (chain; by default one for each processor) or processes (gtsam).
    report : Write an HTML report here too.

    Data sets larger than memory
    ----------------------------
    stream : Parquet track by track, in bounded memory, as folders and files of 512 MB are.
    batch_frames : Person-frames held at a time when streaming.
    cluster : Stream to a Dask cluster: its scheduler's address, or --jobs processes of this machine.
    """
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
        unused = {"--report": report, "--fill": fill, "--resample": resample}
        unused |= {"--trust": trust not in (None, "declared")}
        streamed = ("fps", "select", "format", "associate", *options.CAMERA)
        given = reading.given().items()
        unused |= {options.option_name(name): value for name, value in given if name not in streamed}
        unused |= {"--format": reading.format not in (None, "parquet")}
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
        emit(f"  note: {line}")
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
    emit(
        f"smoothed {len(good)} of {len(tracks)} tracks, {estimates.n_frames} person-frames in "
        f"{duration(seconds)}; model {chosen.preset}, engine {solver}, "
        f"{len(good) - len(unconverged)} converged"
    )
    for result in unconverged:
        emit(f"  track {result.track.track_id}: not converged in {result.iterations} steps")
    if report is not None and good:
        from graphtrack.report.build import tracking_report
        from graphtrack.report.html import write_html

        write_html(report, tracking_report(estimates, tracks, title="Smoothed tracks"))
        emit(f"report: {report}")
    if good:
        emit(f"wrote {output}")
    for failure in bad:
        emit(f"error: track {failure.track_id}: {failure.reason}")
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
        emit(f"  note: {said}")
    if left:
        emit(f"  note: {counted(left, 'gap')} of more than {LONGEST_FILLED:g} s not filled")
    return found
