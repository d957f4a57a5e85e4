"""Commands `graphtrack track` and `graphtrack serve`: files, standard input, and a network service."""

from __future__ import annotations

import os
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from graphtrack.cli import options
from graphtrack.cli.console import (
    BAD_INPUT,
    emit,
    input_warnings_as_notes,
    option_name,
    progress_bar,
    write_tracks,
)
from graphtrack.errors import NO_POSITION, InputError
from graphtrack.io.source import place_of
from graphtrack.tracks.display import counted, duration

if TYPE_CHECKING:
    from graphtrack.geometry.camera import GroundCamera
    from graphtrack.inference.engines import OnlineEngine
    from graphtrack.io.options import ReadOptions
    from graphtrack.io.sensors import SensorScene
    from graphtrack.model import Model
    from graphtrack.streaming.behaviour import Asked
    from graphtrack.streaming.session import Answers
    from graphtrack.tracks.table import Rows


def track(
    input: Annotated[str, typer.Argument()],
    reading: options.SceneReading,
    output: options.OutputPath | None = None,
    model: options.BestModelName = None,
    engine: Literal["auto", "chain", "fixed-lag", "isam2"] = "auto",
    lag: Annotated[str, typer.Option(metavar="SECONDS|none")] = "2",
    state: Annotated[Path | None, typer.Option(dir_okay=False)] = None,
    save_every: Annotated[float, typer.Option(metavar="SECONDS", min=0.1, max=86400.0)] = 10.0,
    forget_after: Annotated[float | None, typer.Option(metavar="SECONDS", min=1.0)] = None,
    max_delay: Annotated[float | None, typer.Option(metavar="SECONDS", min=0.0, max=60.0)] = None,
    max_people: Annotated[int | None, typer.Option(min=1)] = None,
    forecast: options.Seconds | None = None,
    groups: bool = False,
    attention: bool = False,
    places: options.Places = None,
    walkable: options.Walkable = None,
    constants: options.Constants = None,
    verbose: bool = False,
) -> None:
    """Track online: estimate each frame from the observations up to it.

    Parameters
    ----------
    input : File with tracks, or - for NDJSON rows on standard input.
    output : File to write: .csv, .csv.gz, .parquet, .ndjson, .txt (MOT), .nc and others (graphtrack formats);
        none with -.
    engine : chain: a fixed lag, compiled; fixed-lag: the same with GTSAM; isam2: GTSAM's incremental
        smoother; auto: chain where it can be.
    lag : Length of the history that is re-estimated; none: all of it, with isam2.
    verbose : Print what is learned about the scene from detections, whenever it is learned again.

    Streams: with - as the input
    ----------------------------
    state : Save the state in this file, and resume from it. A row is saved before it is answered.
    save_every : Seconds between flushes of --state to disk, the most that a power failure loses. A killed
        process loses nothing.
    forget_after : Seconds of the stream without a row until a person, or one of several streams of
        detections, is forgotten; by default 60.
    max_delay : Seconds for which detections wait at most for those of a slower sensor, once some came out of
        sequence; by default 0.25.
    max_people : Most people with identities at one time; by default 10000.
    forecast : Predict positions every 0.4 s up to this many seconds ahead.
    groups : Report conversation groups and people walking together.
    attention : Report gaze targets: people and --places.
    places : CSV of other gaze targets: name and x, y, radius, or name and polygon (x y x y …).
    """
    options.check_outputs(
        {"--output": output, "--state": state},
        {
            **reading.inputs([] if input == "-" else [place_of(input)], model),
            "--places": places,
            "--walkable": walkable,
        },
        table=output,
    )
    from graphtrack.constants.online import OnlineSmoother
    from graphtrack.constants.personal import known_constants
    from graphtrack.inference.engines import check_lag, online_engine
    from graphtrack.model import Model
    from graphtrack.tracking import track_online

    chosen = Model.named(model)
    kept = _seconds(lag)
    if reading.associate == "repair":
        raise InputError("--associate repair", "graphtrack smooth: repairing tracks needs future frames")
    check_lag(kept, online_engine(chosen, engine))
    if input == "-":
        of_streams = ("fps", "associate", "columns", "time_unit", "sensors", *options.CAMERA, *options.ANGLES)
        given_options = {"output": output} | reading.given()
        refused = [name for name, value in given_options.items() if value and name not in of_streams]
        if refused:
            names = ", ".join(map(option_name, refused))
            raise InputError(f"{names} with -", "these options with a file only")
        from graphtrack.geometry.walkable import WalkableArea
        from graphtrack.streaming.answers import StreamBounds
        from graphtrack.streaming.reordering import MAX_DELAY
        from graphtrack.streaming.session import Answers

        answers = Answers(
            chosen,
            engine,
            kept,
            reading.options().fps,
            camera_of(reading.options()),
            reading.options().associate,
            horizon_of(forecast),
            asked_of(groups, attention, places),
            StreamBounds(max_people or StreamBounds.people, forget_after or StreamBounds.forget_after),
            None if walkable is None else WalkableArea.of(walkable),
            known_constants(constants),
            reading.options().sensor_scene,
            reading.options().angle_convention,
            MAX_DELAY if max_delay is None else max_delay,
        )
        _track_stream(answers, reading, state, save_every)
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
        raise InputError("--state with a file", "- as the input: only a stream can be resumed")
    bounds_of_streams = {
        "--forget-after": forget_after,
        "--max-delay": max_delay,
        "--max-people": max_people,
    }
    options.refuse(bounds_of_streams, "with a file", "- as the input: these options are for streams")
    rows, are_detections = reading.rows(place_of(input))
    if are_detections:
        if reading.select:
            raise InputError("--select", "identities to select by; these rows have none")
        known = reading.options().sensor_scene
        _track_detections(rows, output, chosen, engine, kept, walkable, constants, verbose, known)
        return
    tracks = reading.tracks([place_of(input)], rows)
    # The first one compiles.
    OnlineSmoother(chosen, engine=engine, lag=kept, walkable=walkable, constants=constants)
    start = time.perf_counter()
    with input_warnings_as_notes(), progress_bar(tracks.n_frames) as advance:
        everybody = track_online(
            tracks,
            chosen,
            engine=engine,
            lag=kept,
            progress=advance,
            walkable=walkable,
            constants=constants,
        )
    seconds = time.perf_counter() - start
    found = [one for one in everybody if any(x == x for x in one.position[:, 0].tolist())]
    unseen = sorted({one.track_id for one in everybody} - {one.track_id for one in found})
    estimates = tracks.with_tracks(found)
    if found:
        write_tracks(estimates, output)
        emit(
            f"tracked {len(found)} people, {estimates.n_frames} person-frames in {duration(seconds)} "
            f"({1e3 * seconds / estimates.n_frames:.2f} ms each); "
            f"engine {online_engine(chosen, engine)}, model {chosen.preset}\n"
            f"wrote {output}"
        )
    for track_id in unseen:
        emit(f"error: {tracks.person(track_id)}: {NO_POSITION}")
    if unseen:
        raise typer.Exit(BAD_INPUT)


def _track_detections(
    rows: Rows,
    output: Path,
    model: Model,
    engine: OnlineEngine,
    lag: float | None,
    walkable: Path | None,
    constants: str | None,
    verbose: bool,
    sensors: SensorScene | None,
) -> None:
    """Track the detections of a file online, and write the estimates without revision."""
    from graphtrack.association.associate import learned_scene
    from graphtrack.association.tracker import track_rows
    from graphtrack.cli.console import print_summary
    from graphtrack.inference.engines import online_engine
    from graphtrack.tracking import OnlineTracker

    tracker = OnlineTracker(
        model,
        engine=engine,
        lag=lag,
        camera=rows.camera,
        walkable=walkable,
        constants=constants,
        sensors=sensors,
    )
    learned: list[str] = []

    def note(t: float) -> None:
        learned.append(f"  {learned_scene(tracker.scene, f' at {t:g} s')}")

    start = time.perf_counter()
    with progress_bar(len(rows), "detections") as advance:
        tracks = track_rows(rows, tracker, advance, note)
    seconds = time.perf_counter() - start
    write_tracks(tracks, output)
    print_summary(tracks, str(rows.path))
    for line in learned if verbose else learned[-1:]:
        emit(line)
    emit(
        f"tracked {len(tracks)} people, {tracks.n_frames} person-frames in {duration(seconds)} "
        f"({1e3 * seconds / len(rows):.2f} ms each); "
        f"engine {online_engine(model, engine)}, model {model.preset}\n"
        f"wrote {output}"
    )


def _seconds(lag: str) -> float | None:
    if lag.strip().lower() == "none":
        return None
    try:
        return float(lag)
    except ValueError:
        raise InputError(f"--lag {lag}", "a number of seconds, or none") from None


def horizon_of(forecast: float | None) -> tuple[float, float] | None:
    """Return the horizon and step of forecasts; raise InputError if they are invalid."""
    if forecast is None:
        return None
    from graphtrack.forecasting.forecaster import times_ahead
    from graphtrack.streaming.behaviour import STEP

    step = min(STEP, forecast)
    times_ahead(forecast, step)
    return forecast, step


def asked_of(groups: bool, attention: bool, places: Path | None) -> Asked | None:
    """Return the settings of reported groups and gaze; None: neither."""
    if places is not None and not attention:
        raise InputError("--places alone", "--attention too, which reports gaze at them")
    if not (groups or attention):
        return None
    from graphtrack.interaction.people import read_places
    from graphtrack.streaming.behaviour import Asked

    return Asked(groups, attention, () if places is None else tuple(read_places(places)))


def camera_of(reading: ReadOptions) -> GroundCamera | None:
    """Return the camera or scale of the options; None without any."""
    import numpy as np

    from graphtrack.geometry.camera import GroundCamera
    from graphtrack.io.cameras import known_camera

    camera, notes = known_camera(reading, np.empty((0, 2)))
    for note in notes:
        emit(f"note: {note}")
    scale = reading.metres_per_pixel
    return GroundCamera.from_scale(scale) if camera is None and scale is not None else camera


def _track_stream(
    answers: Answers, reading: options.SceneReading, state: Path | None, save_every: float
) -> None:
    from graphtrack.streaming.protocol import StreamNames
    from graphtrack.streaming.session import MOST_TOGETHER, Listener, track_stream

    layout = reading.options().layout()

    def went_on(row: int, line: int, again: int) -> None:
        lines = "" if line == row else f" (the last is line {line})"
        last = f"; the answer to row {row} is repeated" if again else ""
        if again > 1:
            last = f"; the answers to rows {row - again + 1} to {row} are repeated"
        emit(f"resuming from {state}, after {counted(row, 'row')}{lines}{last}")

    rows, wrong = track_stream(
        answers,
        state=state,
        save_every=save_every,
        names=StreamNames() if layout is None else StreamNames.of(layout),
        # Rows that were saved one by one are replayed one by one.
        listener=Listener(
            lambda text: emit(f"note: {text}"),
            went_on,
            progress=progress_bar,
            most_together=MOST_TOGETHER if state is None else 1,
        ),
    )
    if wrong:
        emit(f"error: {wrong} of {rows} rows could not be used")
        raise typer.Exit(BAD_INPUT)


TOKEN = "GRAPHTRACK_TOKEN"
_LONGEST_TOKEN = 4096


def serve(
    host: str = "127.0.0.1",
    port: Annotated[int, typer.Option(min=0, max=65535)] = 8765,
    model: options.BestModelName = None,
    engine: Literal["auto", "chain", "fixed-lag"] = "auto",
    lag: options.Seconds = 2.0,
    fps: float | None = None,
    homography: options.InputFile | None = None,
    forecast: options.Seconds | None = None,
    groups: bool = False,
    attention: bool = False,
    places: options.Places = None,
    walkable: options.Walkable = None,
    sensors: options.InputFile | None = None,
    angles: Annotated[str | None, typer.Option(metavar="TEXT")] = None,
    state: Annotated[Path | None, typer.Option(file_okay=False)] = None,
    save_every: Annotated[float, typer.Option(metavar="SECONDS", min=0.1, max=86400.0)] = 10.0,
    token_file: options.InputFile | None = None,
    allow_host: Annotated[list[str] | None, typer.Option(metavar="NAME")] = None,
    allow_origin: Annotated[list[str] | None, typer.Option(metavar="ORIGIN")] = None,
    max_streams: Annotated[int, typer.Option(min=1)] = 64,
    max_people: Annotated[int, typer.Option(min=1)] = 200,
    max_rate: Annotated[float, typer.Option(min=1.0)] = 5000.0,
    max_line: Annotated[int, typer.Option(min=256, max=1048576)] = 1 << 16,
    forget_after: Annotated[float, typer.Option(metavar="SECONDS", min=1.0)] = 60.0,
    max_delay: Annotated[float, typer.Option(metavar="SECONDS", min=0.0, max=60.0)] = 0.25,
    patience: Annotated[float, typer.Option(metavar="SECONDS", min=1.0, max=86400.0)] = 30.0,
) -> None:
    """Serve streams of rows over WebSocket and HTTP, with health and metrics.

    Parameters
    ----------
    host : Address to listen on.
    port : Port to listen on; 0: any that is free.
    engine : chain: a fixed lag, compiled; fixed-lag: the same with GTSAM; auto: chain where it can be.
    lag : Length of the history that is re-estimated.
    fps : Frames a second, for rows without a time.
    homography : File with 3×3 numbers: image → ground in metres.
    forecast : Predict positions every 0.4 s up to this many seconds ahead.
    groups : Report conversation groups and people walking together.
    attention : Report gaze targets: people and --places.
    sensors : Description of the sensors (.toml); rows are corrected for their known errors.
    angles : Convention of the angles of rows and answers, such as 'clockwise from image up' or compass; by
        default degrees counter-clockwise from x.
    state : Folder for saved streams, which can be resumed; created if missing.
    save_every : Seconds between flushes of --state to disk, the most that a power failure loses.

    Clients
    -------
    token_file : File with the clients' token, else GRAPHTRACK_TOKEN; required unless --host is loopback.
    allow_host : Name in clients' URLs, besides localhost and --host; '*': any. Repeatable.
    allow_origin : Web pages that may use the service, as https://site.example; '*': any. Repeatable.

    Limits
    ------
    max_streams : Most open streams.
    max_people : Most people with identities in a stream at one time.
    max_rate : Most rows a second of a stream; faster clients are throttled.
    max_line : Most bytes of a message.
    forget_after : Seconds of a stream without a row until a person, or one of several streams of detections,
        is forgotten.
    max_delay : Seconds for which detections wait at most for those of a slower sensor, once some came out of
        sequence.
    patience : Seconds that answers may stay unread, pings unanswered, or rows without an answer of the
        stream's process (at least 10), which is killed then.
    """
    from graphtrack.geometry.conventions import AngleConvention
    from graphtrack.geometry.walkable import WalkableArea
    from graphtrack.inference.engines import check_lag, online_engine
    from graphtrack.io.sensors import SensorScene
    from graphtrack.model import Model

    try:
        from graphtrack.service.app import run
    except ModuleNotFoundError as error:
        raise InputError(f"no {error.name}", "pip install 'graphtrack[serve]'") from error
    from graphtrack.io.options import ReadOptions
    from graphtrack.service.settings import Limits, Service, clients_of, is_loopback, is_wildcard
    from graphtrack.streaming.answers import StreamBounds
    from graphtrack.streaming.session import Answers

    chosen = Model.named(model)
    check_lag(lag, online_engine(chosen, engine))
    if state is not None:
        state.mkdir(parents=True, exist_ok=True)
    answers = Answers(
        chosen,
        engine,
        lag,
        fps,
        camera_of(ReadOptions(homography=homography)),
        asked=asked_of(groups, attention, places),
        horizon=horizon_of(forecast),
        bounds=StreamBounds(max_people, forget_after),
        walkable=None if walkable is None else WalkableArea.of(walkable),
        sensors=None if sensors is None else SensorScene.load(sensors),
        angles=None if angles is None else AngleConvention.of(angles),
        max_delay=max_delay,
    )
    limits = Limits(max_streams, max_rate, max_line, patience)
    token = os.environ.get(TOKEN) if token_file is None else _read_token(token_file)
    if token == "":
        raise InputError("an empty token", "a non-empty token, or no token file", path=token_file)
    if token is not None and not all("!" <= character <= "~" for character in token):
        expected = "printable ASCII characters without spaces, which a header can hold"
        raise InputError("a token with other characters", expected, path=token_file)
    if token is None and not is_loopback(host):
        expected = f"--token-file, or the variable {TOKEN}: other machines can reach that address"
        raise InputError(f"--host {host} without a token", expected)
    clients = clients_of(host, allow_host or [], allow_origin or [])
    if not allow_host and is_wildcard(host):
        emit("note: only requests for localhost are accepted; --allow-host NAME adds a name")
    run(Service(answers, limits, state, token, clients, save_every), host, port, emit)


def _read_token(path: Path) -> str:
    with path.open("rb") as file:
        content = file.read(_LONGEST_TOKEN + 1)  # a device file may be endless
    if len(content) > _LONGEST_TOKEN:
        raise InputError(f"more than {_LONGEST_TOKEN} bytes", "a token in one line", path=path)
    try:
        return content.decode().strip()
    except UnicodeDecodeError as error:
        found = f"byte {error.start + 1} is no UTF-8"
        raise InputError(found, "a token as text, in one line", path=path) from error
