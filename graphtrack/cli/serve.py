"""`graphtrack serve`."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated, Literal

import typer

from graphtrack.cli import options
from graphtrack.cli.console import console
from graphtrack.errors import InputError

TOKEN = "GRAPHTRACK_TOKEN"
_LONGEST_TOKEN = 4096


def serve(
    host: Annotated[str, typer.Option("--host", help="Address to listen on.")] = "127.0.0.1",
    port: Annotated[
        int, typer.Option("--port", help="Port to listen on; 0: any that is free.", min=0, max=65535)
    ] = 8765,
    model: options.BestModelName = None,
    engine: Annotated[
        Literal["auto", "chain", "fixed-lag"], typer.Option("--engine", help="As of graphtrack track.")
    ] = "auto",
    lag: Annotated[float, typer.Option("--lag", metavar="SECONDS", help="History that is kept open.")] = 2.0,
    fps: Annotated[
        float | None, typer.Option("--fps", help="Frames a second, for rows without a time.")
    ] = None,
    homography: options.Homography = None,
    forecast: Annotated[
        float | None,
        typer.Option(
            "--forecast",
            metavar="SECONDS",
            help="Tell where people will be, every 0.4 s up to so many seconds ahead.",
            show_default=False,
        ),
    ] = None,
    groups: Annotated[
        bool, typer.Option("--groups", help="Tell who stands in conversation, or walks, with whom.")
    ] = False,
    attention: Annotated[
        bool, typer.Option("--attention", help="Tell who looks at whom, and at which --places.")
    ] = False,
    places: options.Places = None,
    state: Annotated[
        Path | None,
        typer.Option(
            "--state",
            help="Folder in which streams are kept, to be gone on with; made if it is not there.",
            file_okay=False,
        ),
    ] = None,
    save_every: Annotated[
        float,
        typer.Option("--save-every", metavar="SECONDS", min=0.1, max=86400.0, help="As of graphtrack track."),
    ] = 10.0,
    token_file: Annotated[
        Path | None,
        typer.Option(
            "--token-file",
            help=f"File with the token that clients have to bear; else the variable {TOKEN}; else none.",
            exists=True,
            dir_okay=False,
        ),
    ] = None,
    allow_host: Annotated[
        list[str] | None,
        typer.Option(
            "--allow-host",
            metavar="NAME",
            help="Name in clients' URLs, besides localhost and --host; '*': any. Repeatable.",
            show_default=False,
        ),
    ] = None,
    allow_origin: Annotated[
        list[str] | None,
        typer.Option(
            "--allow-origin",
            metavar="ORIGIN",
            help="Web pages that may use the service, as https://site.example; '*': any. Repeatable.",
            show_default=False,
        ),
    ] = None,
    max_streams: Annotated[int, typer.Option("--max-streams", min=1, help="Open at once.")] = 64,
    max_people: Annotated[
        int, typer.Option("--max-people", min=1, help="With identities, at once in a stream.")
    ] = 200,
    max_rate: Annotated[
        float,
        typer.Option("--max-rate", min=1.0, help="Rows a second of a stream; who is faster is slowed down."),
    ] = 5000.0,
    max_line: Annotated[int, typer.Option("--max-line", min=256, max=1 << 20, help="Bytes of a message.")] = 1
    << 16,
    forget_after: Annotated[
        float,
        typer.Option("--forget-after", min=1.0, help="Seconds without a row until a person is forgotten."),
    ] = 60.0,
    patience: Annotated[
        float,
        typer.Option(
            "--patience", min=1.0, help="Seconds that answers may stay unread, or a client silent to pings."
        ),
    ] = 30.0,
) -> None:
    """Serve streams of rows over WebSocket and HTTP, with health and metrics."""
    from graphtrack.cli.track import asked_of, horizon_of
    from graphtrack.geometry.camera import GroundCamera
    from graphtrack.inference.engines import check_lag, online_engine
    from graphtrack.io.cameras import read_homography
    from graphtrack.model import Model

    try:
        from graphtrack.cli.service.run import run
    except ModuleNotFoundError as error:
        raise InputError(f"no {error.name}", "pip install 'graphtrack[serve]'") from error
    from graphtrack.cli.service.settings import Answers, Limits, Service, clients_of, is_wildcard

    chosen = Model.named(model)
    check_lag(lag, online_engine(chosen, engine))
    if state is not None:
        state.mkdir(parents=True, exist_ok=True)
    answers = Answers(
        chosen,
        engine,
        lag,
        fps,
        None if homography is None else GroundCamera.from_homography(read_homography(homography)),
        asked=asked_of(groups, attention, places),
        horizon=horizon_of(forecast),
        save_every=save_every,
    )
    limits = Limits(max_streams, max_people, forget_after, max_rate, max_line, patience)
    token = os.environ.get(TOKEN) if token_file is None else _read_token(token_file)
    if token == "":
        raise InputError("an empty token", "some characters, or none at all", path=token_file)
    if token is not None and not all("!" <= character <= "~" for character in token):
        expected = "printable ASCII characters without spaces, which a header can hold"
        raise InputError("a token with other characters", expected, path=token_file)
    if token is None and host not in ("127.0.0.1", "::1", "localhost"):
        console.print(f"note: no token: whoever reaches {host} may open streams", markup=False)
    clients = clients_of(host, allow_host or [], allow_origin or [])
    if not allow_host and is_wildcard(host):
        said = "note: requests are taken for localhost alone; --allow-host NAME adds a name"
        console.print(said, markup=False, soft_wrap=True)
    run(Service(answers, limits, state, token, clients), host, port)


def _read_token(path: Path) -> str:
    with path.open("rb") as file:
        content = file.read(_LONGEST_TOKEN + 1)  # of a device there may be no end
    if len(content) > _LONGEST_TOKEN:
        raise InputError(f"more than {_LONGEST_TOKEN} bytes", "a token in one line", path=path)
    try:
        return content.decode().strip()
    except UnicodeDecodeError as error:
        found = f"byte {error.start + 1} is no UTF-8"
        raise InputError(found, "a token as text, in one line", path=path) from error
