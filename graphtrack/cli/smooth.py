"""Commands `graphtrack smooth`, of tracks in memory or a streamed Parquet data set, and `warm-up`."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from graphtrack.cli import options
from graphtrack.cli.console import BAD_INPUT, emit, option_name, print_table, progress_bar, write_tracks
from graphtrack.cli.fit import UNKNOWN, sensors_learned
from graphtrack.cli.report import OnPage
from graphtrack.errors import InputError
from graphtrack.io.atomic import check_place, destination, scratch_folder
from graphtrack.io.source import table_in
from graphtrack.tracks.display import counted, duration

if TYPE_CHECKING:
    from graphtrack.interaction.people import Place
    from graphtrack.io.options import ReadOptions
    from graphtrack.scale import Dataset


LARGE = 512 * 2**20
"""Bytes of a Parquet file from which it is streamed by default."""


def is_streamed(inputs: list[Path], output: Path, asked: bool | None, cluster: str | None) -> bool:
    """Return True if an input is streamed: on request, on a cluster, or a folder or large file."""
    from graphtrack.io.format import is_recording, label_files

    if asked is not None:
        return asked or cluster is not None
    folders = [path for path in inputs if table_in(path).is_dir()]
    if cluster is not None or any(not (is_recording(path) or label_files(path)) for path in folders):
        return True
    if len(inputs) != 1 or not (_is_parquet(inputs[0]) and _is_parquet(output)):
        return False
    return inputs[0].is_file() and inputs[0].stat().st_size >= LARGE


def _is_parquet(path: Path) -> bool:
    return path.name.lower().endswith((".parquet", ".pq"))


def check_streamed(inputs: list[Path], output: Path, unused: Mapping[str, Any]) -> Path:
    """Return the one input of a streamed run; `unused` options, with their values, are refused."""
    if len(inputs) != 1:
        raise InputError(f"{len(inputs)} inputs to stream", "one Parquet file, or a folder of them")
    if not _is_parquet(output):
        raise InputError(f"the file name {output.name!r}", "the ending .parquet, when streaming", path=output)
    given = next((name for name, value in unused.items() if value), None)
    if given is not None:
        raise InputError(f"{given} when streaming", "no such option, or --no-stream")
    return inputs[0]


def smooth_streamed(path: Path, output: Path, read_options: ReadOptions, **options: Any) -> None:
    """Smooth a data set, and print the outcome; exit with status 2 if a track failed.

    Rows without identities are associated first, into a file that is removed in the end.
    """
    from graphtrack.scale import open_dataset

    dataset = open_dataset(path)
    files = "" if len(dataset.files) == 1 else f" in {len(dataset.files)} files"
    emit(f"{path}: parquet, {counted(dataset.n_rows, 'row')}{files}, streamed")
    if read_options.associate == "repair":
        raise InputError("--associate repair when streaming", "auto, always or never, or --no-stream")
    without = "track_id" not in dataset.columns and read_options.associate == "auto"
    if not (without or read_options.associate == "always"):
        _smooth_tracks(dataset, output, read_options=read_options, **options)
        return
    if options["select"]:
        raise InputError(
            "--select for rows without identities", "no such option when streaming, or --no-stream"
        )
    check_place(output)
    with scratch_folder(destination(output)) as folder:
        tracks = folder / output.name
        _associate(dataset, tracks, read_options, options)
        corrected = replace(read_options, sensors=None)
        _smooth_tracks(open_dataset(tracks), output, read_options=corrected, **options)


def _associate(dataset: Dataset, output: Path, read_options: ReadOptions, options: Mapping[str, Any]) -> None:
    """Associate a data set of detections block by block, and print the outcome."""
    from graphtrack.scale import associate_dataset

    start = time.perf_counter()
    with progress_bar(dataset.n_rows, "detections") as advance:
        outcome = associate_dataset(
            dataset,
            output,
            options["model"].scene,
            jobs=options["jobs"] if options["cluster"] == "local" else None,
            cluster=options["cluster"],
            block_rows=options["batch_frames"],
            read_options=read_options,
            progress=advance,
        )
    emit(
        f"associated {counted(outcome.n_detections, 'detection')} in {counted(outcome.blocks, 'block')}: "
        f"{counted(outcome.people, 'track')}, in {duration(time.perf_counter() - start)}"
    )


def _smooth_tracks(dataset: Dataset, output: Path, **options: Any) -> None:
    from graphtrack.scale import smooth_dataset
    from graphtrack.smoothing import make_smoothing_ready

    if options["cluster"] in (None, "local"):
        make_smoothing_ready(options["model"], options["engine"], None, options["constants"])
    start = time.perf_counter()
    with progress_bar(dataset.n_rows) as advance:
        outcome = smooth_dataset(dataset, output, progress=advance, **options)
    seconds = time.perf_counter() - start
    for note in outcome.notes:
        emit(f"  note: {note}")
    emit(
        f"smoothed {outcome.n_smoothed} of {counted(outcome.n_tracks, 'track')}, "
        f"{outcome.n_frames} person-frames in {seconds:.1f} s; engine {outcome.engine}, "
        f"{outcome.n_smoothed - len(outcome.unconverged)} converged"
    )
    for track_id, iterations in outcome.unconverged:
        emit(f"  track {track_id}: not converged in {iterations} steps")
    if outcome.n_smoothed:
        emit(f"wrote {output}")
    for failure in outcome.failures:
        emit(f"error: track {failure.track_id}: {failure.reason}")
    if outcome.failures:
        raise typer.Exit(BAD_INPUT)


def smooth(
    inputs: options.Inputs,
    output: options.Output,
    reading: options.SceneReading,
    page: OnPage,
    model: options.BestModelName = None,
    engine: Annotated[str, typer.Option(metavar="<auto|chain|gtsam>")] = "auto",
    trust: options.TrustNoise = None,
    constants: options.Constants = None,
    fill: bool | None = None,
    split_gap: Annotated[float | None, typer.Option(metavar="SECONDS")] = None,
    resample: Annotated[float | None, typer.Option(metavar="HZ")] = None,
    walkable: options.Walkable = None,
    learn_sensors: Annotated[Path | None, typer.Option(metavar="FILE")] = None,
    intervals: options.Intervals = None,
    jobs: Annotated[int | None, typer.Option(min=1)] = None,
    report: Path | None = None,
    groups: bool = False,
    attention: bool = False,
    stream: bool | None = None,
    batch_frames: Annotated[int, typer.Option(min=1)] = 100_000,
    cluster: Annotated[str | None, typer.Option(metavar="ADDRESS|local")] = None,
) -> None:
    """Smooth tracks offline: positions, velocities, body and head, with their uncertainties.

    Parameters
    ----------
    engine : auto: chain, which is compiled, if the model allows it; isam2 and fixed-lag are for track.
    fill : Estimate the missing frames between a person's rows, and those in which a detector missed the
        person. [default: fill]
    split_gap : An id that comes back after so long, or where nobody walks in the time, is another track;
        default 60, and names stay who they are.
    resample : Frames a second of the estimates.
    learn_sensors : Learn the errors of sensors that --sensors leaves unknown, from this input, and write them
        (.toml).
    jobs : Tracks in parallel: threads (chain; by default one for each processor) or processes (gtsam).
    report : Write an HTML report too.

    Shown with the tracks
    ---------------------
    groups : Find groups, for the report.
    attention : Estimate gaze targets, for the report.

    Data sets larger than memory
    ----------------------------
    stream : Read Parquet in bounded memory, track by track or, without identities, in blocks of time; default
        for folders and files from 512 MB.
    batch_frames : Person-frames or detections held at a time when streaming.
    cluster : Stream to a Dask cluster: its scheduler's address, or --jobs processes of this machine.
    """
    options.check_outputs(
        {"--output": output, "--report": report, "--learn-sensors": learn_sensors},
        {**reading.inputs(inputs, model), "--walkable": walkable, **page.inputs()},
        table=output,
    )
    shown = {"--groups": groups, "--attention": attention, **page.given()}
    if report is None:
        options.refuse(shown, "without --report", "--report with it")
    from graphtrack.geometry.walkable import WalkableArea
    from graphtrack.inference.engines import Failure, Solution, engine_of
    from graphtrack.model import Model
    from graphtrack.smoothing import prepare

    chosen = Model.named(model)
    area = None if walkable is None else WalkableArea.of(walkable)
    solver = engine_of(chosen, engine)
    if is_streamed(inputs, output, stream, cluster):
        unused = {"--report": report, "--fill": fill, "--resample": resample, "--walkable": walkable}
        unused |= {"--split-gap": split_gap, "--learn-sensors": learn_sensors, "--intervals": intervals}
        unused |= {"--trust": trust not in (None, "declared")}
        streamed = ("fps", "select", "format", "associate", "sensors", *options.CAMERA)
        given = reading.given().items()
        unused |= {option_name(name): value for name, value in given if name not in streamed}
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
            constants=constants,
        )
        return
    if learn_sensors is not None:
        if learn_sensors.suffix != ".toml":
            raise InputError(f"--learn-sensors {learn_sensors.name!r}", "a name that ends in .toml")
        known = UNKNOWN if reading.sensors is None else reading.sensors
        _, _, tables = sensors_learned(inputs, reading, known, model, learn_sensors)
        for title, rows in tables.items():
            print_table(title, rows)
        emit(f"wrote {learn_sensors}")
        reading = replace(reading, sensors=learn_sensors)
    tracks = reading.tracks(
        inputs,
        scene=chosen.scene,
        missed_rows=fill is not False,
        camera_used=page.background is not None,
    )
    content = page.content(reading, tracks.camera)
    places: Sequence[Place] = ()
    if page.places is not None:
        from graphtrack.interaction.people import read_places

        places = content["places"] = read_places(page.places)
    work = prepare(
        tracks,
        chosen,
        solver,
        fill=fill is not False,
        split=True,
        split_gap=split_gap,
        resample=resample,
        trust=trust or "check",
        constants=constants,
    )
    for line in work.notes:
        emit(f"  note: {line}")
    tracks, chosen = work.tracks, work.model
    start = time.perf_counter()
    with progress_bar(tracks.n_frames) as advance:
        found = work.solve(jobs=jobs, progress=advance, walkable=area)
    seconds = time.perf_counter() - start
    good = [result for result in found if isinstance(result, Solution)]
    bad = [result for result in found if isinstance(result, Failure)]
    estimates = tracks.with_tracks(result.track for result in good)
    if good:
        write_tracks(work.estimates(found), output, intervals=intervals)
    unconverged = [result for result in good if not result.converged]
    emit(
        f"smoothed {len(good)} of {len(tracks)} tracks, {estimates.n_frames} person-frames in "
        f"{duration(seconds)}; model {chosen.preset}, engine {solver}, "
        f"{len(good) - len(unconverged)} converged"
    )
    for line in next((one.constants.noise_lines() for one in good if one.constants is not None), ()):
        emit(f"  {line}")
    for result in good[: options.SHOWN_CONSTANTS]:
        if result.constants is not None:
            emit(f"  {tracks.person(result.track.track_id)}: {result.constants.described()}")
    for result in unconverged:
        emit(f"  {tracks.person(result.track.track_id)}: not converged in {result.iterations} steps")
    if report is not None and good:
        from graphtrack.report.interaction import behaviour_found, with_observed_angles
        from graphtrack.report.page import write_report

        people = estimates if resample is not None else with_observed_angles(estimates, work.observed)
        done = behaviour_found(people, with_groups=groups, with_attention=attention, places=places)
        if groups and (done is None or done.groups is None):
            emit("  note: no groups: fewer than two people")
        if attention and (done is None or done.attention is None):
            emit("  note: no gaze: no head is known, or there is nobody and no place to look at")
        write_report(
            report,
            estimates,
            work.observed,
            solutions=found,
            model=chosen,
            groups=None if done is None else done.groups,
            attention=None if done is None else done.attention,
            sensors=reading.sensors,
            title="Smoothed tracks",
            **content,
        )
        emit(f"report: {report}")
    if good:
        emit(f"wrote {output}")
    for failure in bad:
        emit(f"error: {tracks.person(failure.track_id)}: {failure.reason}")
    if bad:
        raise typer.Exit(BAD_INPUT)


def warm_up(
    functions: Annotated[list[str] | None, typer.Argument(metavar="FUNCTION...")] = None,
    model: options.BestModelName = None,
    behaviour: Annotated[bool, typer.Option("--behaviour")] = False,
    walls: Annotated[bool, typer.Option("--walls")] = False,
) -> None:
    """Compile what the first calls would wait for, in all processors; once on a machine, or in an image.

    Parameters
    ----------
    functions : Names in Python, as of graphtrack.warm_up; default smooth, OnlineSmoother, OnlineTracker and
        associate.
    behaviour : Groups, attention and forecasts too.
    walls : Walls too, for --walkable.
    """
    from graphtrack import tracking
    from graphtrack.machine_code import kept_files, machine_code_folder, why_not_kept

    if why_not_kept():
        raise InputError(f"no folder for machine code: {why_not_kept()}", "one in NUMBA_CACHE_DIR")
    start, before = time.perf_counter(), len(kept_files())
    tracking.warm_up(model, functions=functions, behaviour=behaviour, walkable=walls)
    files = kept_files()
    size = sum(file.stat().st_size for file in files) / 2**20
    emit(
        f"compiled {counted(len(files) - before, 'function')} in {duration(time.perf_counter() - start)}; "
        f"{counted(len(files), 'function')}, {size:.0f} MB in {machine_code_folder()}"
    )
