"""`graphtrack track`."""

from __future__ import annotations

import time
from collections.abc import Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from graphtrack.cli import options
from graphtrack.cli.console import BAD_INPUT, console, progress_bar
from graphtrack.cli.showing import Showing
from graphtrack.errors import NO_POSITION, InputError, SolveError
from graphtrack.remote import place_of

if TYPE_CHECKING:
    from graphtrack.cli.stream_behaviour import Asked
    from graphtrack.inference.engines import OnlineEngine
    from graphtrack.model import Model
    from graphtrack.table.rows import Rows


def track(
    input: Annotated[
        str,
        typer.Argument(help="File with tracks, or - for NDJSON rows on standard input.", show_default=False),
    ],
    reading: options.SceneReading,
    output: Annotated[
        Path | None,
        typer.Option(
            "--output",
            "-o",
            help="File to write: .csv, .csv.gz, .parquet, .ndjson, .txt (MOT), .nc and others (graphtrack "
            "formats); with -, none.",
        ),
    ] = None,
    model: options.BestModelName = None,
    engine: Annotated[
        Literal["auto", "chain", "fixed-lag", "isam2"],
        typer.Option(
            "--engine",
            help="chain: a fixed lag, compiled; fixed-lag: the same with GTSAM; isam2: GTSAM's incremental "
            "smoother; auto: chain where it can be.",
        ),
    ] = "auto",
    lag: Annotated[
        str,
        typer.Option(
            "--lag",
            metavar="SECONDS|none",
            help="History that is kept open, to be estimated anew; none: all of it, with isam2.",
        ),
    ] = "2",
    state: Annotated[
        Path | None,
        typer.Option(
            "--state",
            help="With -: keep in this file what going on takes, and go on from it. A row is in it before it "
            "is answered.",
            dir_okay=False,
        ),
    ] = None,
    save_every: Annotated[
        float,
        typer.Option(
            "--save-every",
            metavar="SECONDS",
            min=0.1,
            max=86400.0,
            help="Seconds between flushings of --state to the disk: what is lost if the power fails. A kill "
            "loses nothing.",
        ),
    ] = 10.0,
    forecast: Annotated[
        float | None,
        typer.Option(
            "--forecast",
            metavar="SECONDS",
            help="With -: tell where people will be, every 0.4 s up to so many seconds ahead.",
            show_default=False,
        ),
    ] = None,
    groups: Annotated[
        bool, typer.Option("--groups", help="With -: tell who stands in conversation, or walks, with whom.")
    ] = False,
    attention: Annotated[
        bool, typer.Option("--attention", help="With -: tell who looks at whom, and at which --places.")
    ] = False,
    places: options.Places = None,
    view: Annotated[
        bool, typer.Option("--view", help="With -: show the answers in Rerun as they come.")
    ] = False,
    showing: Showing = Showing(),
    trust: Annotated[
        Literal["declared", "check"],
        typer.Option(
            "--trust",
            help="Of a file with tracks: check, a note says in the end where the data contradict the noise "
            "that it or the model declares; declared, nothing is checked.",
        ),
    ] = "declared",
    person: Annotated[
        int | None,
        typer.Option(
            "--person",
            metavar="ID",
            help="With --view: whose series are drawn; by default theirs who come first.",
            show_default=False,
        ),
    ] = None,
) -> None:
    """Track online: the estimate at each frame from what came before it alone."""
    from graphtrack.display import duration
    from graphtrack.inference.engines import check_lag, online_engine
    from graphtrack.inference.online import OnlineSmoother
    from graphtrack.io import write
    from graphtrack.model import Model
    from graphtrack.smoothing.recording import track_online
    from graphtrack.trust.verdict import trusted

    options.check_outputs(
        {"--output": output, "--state": state, "--save": showing.save},
        {**reading.inputs([] if input == "-" else [place_of(input)], model), "--places": places},
        table=output,
    )
    _check_view(view, {"--save": showing.save, "--connect": showing.connect, "--person": person}, input)
    chosen = Model.named(model)
    kept = _seconds(lag)
    if reading.associate == "repair":
        raise InputError("--associate repair", "graphtrack smooth: to repair tracks is to look ahead")
    check_lag(kept, online_engine(chosen, engine))
    if input == "-":
        _refuse_with_stream({"output": output, "trust": trust == "check"} | reading.given())
        horizon, asked = horizon_of(forecast), asked_of(groups, attention, places)
        shown = (showing, person) if view else None
        _track_stream(chosen, engine, kept, reading, state, save_every, horizon, asked, shown)
        return
    if forecast is not None:
        raise InputError("--forecast with a file", "graphtrack forecast, which writes a table")
    for name, given in (("groups", groups), ("attention", attention or places is not None)):
        if given:
            raise InputError(
                f"--{name} with a file", f"graphtrack {name} --online, on the file that --output writes"
            )
    if output is None:
        raise InputError("no output", "a file to write (--output)")
    if state is not None:
        raise InputError("--state with a file", "- as the input: only a stream can be gone on with")
    rows, are_detections = reading.rows(place_of(input))
    if are_detections:
        if reading.select:
            raise InputError("--select", "identities to select by; these rows have none")
        if trust == "check":
            raise InputError("--trust check", "tracks: these rows have no identities")
        _track_detections(rows, output, chosen, engine, kept)
        return
    tracks = reading.tracks([place_of(input)], rows)
    OnlineSmoother(chosen, engine=engine, lag=kept)  # the first one compiles
    start = time.perf_counter()
    with progress_bar(tracks.n_frames) as advance:
        everybody = track_online(tracks, chosen, engine=engine, lag=kept, progress=advance)
    seconds = time.perf_counter() - start
    found = [one for one in everybody if any(x == x for x in one.position[:, 0].tolist())]
    unseen = sorted({one.track_id for one in everybody} - {one.track_id for one in found})
    estimates = tracks.with_tracks(found)
    if found:
        write(estimates, output)
        console.print(
            f"tracked {len(found)} people, {estimates.n_frames} person-frames in {duration(seconds)} "
            f"({1e3 * seconds / estimates.n_frames:.2f} ms each); "
            f"engine {online_engine(chosen, engine)}, model {chosen.preset}\n"
            f"wrote {output}",
            markup=False,
        )
    # What is tracked at a frame cannot have waited for it: it is said, and not corrected.
    for line in trusted(tracks, chosen, trust)[2]:
        console.print(f"  note: {line}", markup=False)
    for track_id in unseen:
        console.print(f"error: {SolveError(track_id, NO_POSITION)}", markup=False)
    if unseen:
        raise typer.Exit(BAD_INPUT)


def _track_detections(
    rows: Rows, output: Path, model: Model, engine: OnlineEngine, lag: float | None
) -> None:
    """Track the detections of a file online, and write what was said at once."""
    from graphtrack.association.recorded import track_rows
    from graphtrack.cli.console import print_summary
    from graphtrack.display import duration
    from graphtrack.inference.engines import online_engine
    from graphtrack.io import write
    from graphtrack.smoothing.tracker import OnlineTracker

    tracker = OnlineTracker(model, engine=engine, lag=lag, camera=rows.camera)
    start = time.perf_counter()
    with progress_bar(len(rows), "detections") as advance:
        tracks = track_rows(rows, tracker, advance)
    seconds = time.perf_counter() - start
    write(tracks, output)
    print_summary(tracks, str(rows.path))
    console.print(
        f"tracked {len(tracks)} people, {tracks.n_frames} person-frames in {duration(seconds)} "
        f"({1e3 * seconds / len(rows):.2f} ms each); "
        f"engine {online_engine(model, engine)}, model {model.preset}\n"
        f"wrote {output}",
        markup=False,
    )


def _seconds(lag: str) -> float | None:
    if lag.strip().lower() == "none":
        return None
    try:
        return float(lag)
    except ValueError:
        raise InputError(f"--lag {lag}", "a number of seconds, or none") from None


def horizon_of(forecast: float | None) -> tuple[float, float] | None:
    """The horizon and step of forecasts; InputError for what is none."""
    if forecast is None:
        return None
    from graphtrack.behaviour.forecast.forecaster import times_ahead
    from graphtrack.cli.stream_forecast import STEP

    step = min(STEP, forecast)
    times_ahead(forecast, step)
    return forecast, step


def asked_of(groups: bool, attention: bool, places: Path | None) -> Asked | None:
    """The groups and looks that are told; None: neither."""
    if places is not None and not attention:
        raise InputError("--places alone", "--attention beside it: who looks at them")
    if not (groups or attention):
        return None
    from graphtrack.behaviour.places import read_places
    from graphtrack.cli.stream_behaviour import Asked

    return Asked(groups, attention, () if places is None else tuple(read_places(places)))


def _check_view(view: bool, given: Mapping[str, object], input: str) -> None:
    if view and input != "-":
        raise InputError("--view with a file", "graphtrack view, on the file that --output writes")
    alone = next((name for name, value in given.items() if value is not None and not view), None)
    if alone is not None:
        raise InputError(f"{alone} alone", "--view beside it")


_OF_A_STREAM = ("fps", "homography", "point_pairs_unit", "associate", "columns", "time_unit")


def _refuse_with_stream(given: Mapping[str, object]) -> None:
    names = [options.option_name(name) for name, value in given.items() if value and name not in _OF_A_STREAM]
    if names:
        raise InputError(f"{', '.join(names)} with -", "these options with a file only")


def _track_stream(
    model: Model,
    engine: OnlineEngine,
    lag: float | None,
    reading: options.SceneReading,
    state: Path | None,
    save_every: float,
    horizon: tuple[float, float] | None,
    asked: Asked | None,
    shown: tuple[Showing, int | None] | None,
) -> None:
    from graphtrack.cli.live import Listener, print_note, track_stream
    from graphtrack.cli.stream_names import StreamNames
    from graphtrack.geometry.camera import GroundCamera
    from graphtrack.io.cameras import read_homography

    given = reading.options()
    layout = given.layout()
    camera = None
    if reading.homography is not None:
        camera = GroundCamera.from_homography(read_homography(reading.homography))
    with ExitStack() as stack:
        pipe = None
        if shown is not None:
            from graphtrack.cli.view_pipe import ViewPipe

            showing, person = shown
            pipe = ViewPipe(showing.target(), person, print_note)
            stack.callback(pipe.close)
        rows, wrong = track_stream(
            model,
            engine=engine,
            lag=lag,
            fps=given.fps,
            camera=camera,
            state=state,
            save_every=save_every,
            associate=given.associate,
            horizon=horizon,
            asked=asked,
            names=StreamNames() if layout is None else StreamNames.of(layout),
            copy=pipe,
            # Rows that are kept one by one are given again one by one.
            listener=Listener() if state is None else Listener(most_together=1),
        )
    if wrong:
        console.print(f"error: {wrong} of {rows} rows could not be used", markup=False)
        raise typer.Exit(BAD_INPUT)
