"""`graphtrack serve`."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated, Literal

import typer

from graphtrack.cli import options
from graphtrack.cli.console import emit
from graphtrack.cli.track import asked_of, horizon_of
from graphtrack.errors import InputError

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
    state: Annotated[Path | None, typer.Option(file_okay=False)] = None,
    save_every: Annotated[float, typer.Option(metavar="SECONDS", min=0.1, max=86400.0)] = 10.0,
    token_file: options.InputFile | None = None,
    allow_host: Annotated[list[str] | None, typer.Option(metavar="NAME")] = None,
    allow_origin: Annotated[list[str] | None, typer.Option(metavar="ORIGIN")] = None,
    max_streams: Annotated[int, typer.Option(min=1)] = 64,
    max_people: Annotated[int, typer.Option(min=1)] = 200,
    max_rate: Annotated[float, typer.Option(min=1.0)] = 5000.0,
    max_line: Annotated[int, typer.Option(min=256, max=1048576)] = 1 << 16,
    forget_after: Annotated[float, typer.Option(min=1.0)] = 60.0,
    patience: Annotated[float, typer.Option(min=1.0)] = 30.0,
) -> None:
    """Serve streams of rows over WebSocket and HTTP, with health and metrics.

    Parameters
    ----------
    host : Address to listen on.
    port : Port to listen on; 0: any that is free.
    engine : As of graphtrack track.
    lag : History that is kept open.
    fps : Frames a second, for rows without a time.
    homography : File with 3×3 numbers: image → ground in metres.
    forecast : Tell where people will be, every 0.4 s up to so many seconds ahead.
    groups : Tell who stands in conversation, or walks, with whom.
    attention : Tell who looks at whom, and at which --places.
    state : Folder in which streams are kept, to be gone on with; made if it is not there.
    save_every : As of graphtrack track.

    Clients
    -------
    token_file : File with the token that clients have to bear; else the variable GRAPHTRACK_TOKEN; else none.
    allow_host : Name in clients' URLs, besides localhost and --host; '*': any. Repeatable.
    allow_origin : Web pages that may use the service, as https://site.example; '*': any. Repeatable.

    Limits
    ------
    max_streams : Open at once.
    max_people : With identities, at once in a stream.
    max_rate : Rows a second of a stream; who is faster is slowed down.
    max_line : Bytes of a message.
    forget_after : Seconds without a row until a person is forgotten.
    patience : Seconds that answers may stay unread, or a client silent to pings.
    """
    from graphtrack.geometry.camera import GroundCamera
    from graphtrack.inference.engines import check_lag, online_engine
    from graphtrack.io.cameras import read_homography
    from graphtrack.model import Model

    try:
        from graphtrack.cli.service.run import run
    except ModuleNotFoundError as error:
        raise InputError(f"no {error.name}", "pip install 'graphtrack[serve]'") from error
    from graphtrack.cli.live import Answers
    from graphtrack.cli.service.settings import Limits, Service, clients_of, is_wildcard
    from graphtrack.cli.stream import StreamBounds

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
        bounds=StreamBounds(max_people, forget_after),
    )
    limits = Limits(max_streams, max_rate, max_line, patience)
    token = os.environ.get(TOKEN) if token_file is None else _read_token(token_file)
    if token == "":
        raise InputError("an empty token", "some characters, or none at all", path=token_file)
    if token is not None and not all("!" <= character <= "~" for character in token):
        expected = "printable ASCII characters without spaces, which a header can hold"
        raise InputError("a token with other characters", expected, path=token_file)
    if token is None and host not in ("127.0.0.1", "::1", "localhost"):
        emit(f"note: no token: whoever reaches {host} may open streams")
    clients = clients_of(host, allow_host or [], allow_origin or [])
    if not allow_host and is_wildcard(host):
        said = "note: requests are taken for localhost alone; --allow-host NAME adds a name"
        emit(said)
    run(Service(answers, limits, state, token, clients, save_every), host, port, emit)


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
