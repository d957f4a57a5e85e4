"""What a service does, and how much of it."""

from __future__ import annotations

import re
from dataclasses import dataclass
from ipaddress import ip_address
from pathlib import Path

from graphtrack.cli.stream import LONGEST_LINE, StreamBounds
from graphtrack.cli.stream_behaviour import Asked
from graphtrack.errors import InputError
from graphtrack.geometry.camera import GroundCamera
from graphtrack.inference.engines import OnlineEngine
from graphtrack.io.options import Associate
from graphtrack.model import Model

STREAM_NAME = re.compile(r"[A-Za-z0-9_][A-Za-z0-9._-]{0,63}")
"""What a stream may be called: it becomes the name of a file."""


@dataclass(frozen=True)
class Answers:
    """How all streams of a service are answered; as in `graphtrack.cli.live.track_stream`."""

    model: Model
    engine: OnlineEngine = "auto"
    lag: float | None = 2.0
    fps: float | None = None
    camera: GroundCamera | None = None
    associate: Associate = "auto"
    horizon: tuple[float, float] | None = None
    asked: Asked | None = None
    save_every: float = 10.0


@dataclass(frozen=True)
class Limits:
    """What a client may ask for.

    Attributes
    ----------
    streams : at once
    people : with identities, at once in a stream
    forget_after : seconds of the stream's own time without a row after which a person is forgotten
    rows_per_second : of a stream; who sends faster is slowed down
    line_bytes : of a row
    patience : seconds that a client may leave answers unread
    """

    streams: int = 64
    people: int = 200
    forget_after: float = 60.0
    rows_per_second: float = 5000.0
    line_bytes: int = LONGEST_LINE
    patience: float = 30.0

    @property
    def of_stream(self) -> StreamBounds:
        """What the stream itself has to keep to."""
        return StreamBounds(self.people, self.forget_after)


_HOST = re.compile(r"\*|(\*\.)?[A-Za-z0-9._-]+|\[?[0-9A-Fa-f:.]*:[0-9A-Fa-f:.]*\]?")
_ORIGIN = re.compile(r"\*|null|[a-z][a-z0-9+.-]*://([A-Za-z0-9._-]+|\[[0-9A-Fa-f:.]+\])(:[0-9]+)?")
LOOPBACK = ("localhost", "127.0.0.1", "[::1]")
"""Names of the loopback in the header ``Host``."""


@dataclass(frozen=True)
class Clients:
    """The clients whose requests are taken.

    Attributes
    ----------
    hosts : names and addresses that the header ``Host`` may have; ``*``: any
    origins : of web pages that may use the service; ``*``: any
    """

    hosts: tuple[str, ...] = LOOPBACK
    origins: tuple[str, ...] = ()


@dataclass(frozen=True)
class Service:
    """Everything that a service is told at its start.

    Attributes
    ----------
    states : folder of the streams' states; None: streams end with their connections
    token : that every request has to bear; None: all are welcome
    """

    answers: Answers
    limits: Limits = Limits()
    states: Path | None = None
    token: str | None = None
    clients: Clients = Clients()

    def state_of(self, name: str) -> Path | None:
        """The file in which a stream is kept."""
        return None if self.states is None else self.states / f"{name}.state"


def is_wildcard(host: str) -> bool:
    """Return True for an address that stands for all of a machine's."""
    try:
        return ip_address(host).is_unspecified
    except ValueError:
        return not host


def clients_of(host: str, hosts: list[str], origins: list[str]) -> Clients:
    """Return the clients of a service that listens on `host`, with names and origins added.

    Raises
    ------
    InputError
        If a name is none, or an origin has more than scheme, name and port.
    """
    for name in hosts:
        if not _HOST.fullmatch(name):
            expected = "a name or an address without a port, '*.site.example', or '*'"
            raise InputError(f"--allow-host {name}", expected)
    for origin in origins:
        if not _ORIGIN.fullmatch(origin):
            raise InputError(
                f"--allow-origin {origin}", "an origin as https://site.example or http://site:8000"
            )
    own = () if is_wildcard(host) else (host,)
    named = (f"[{name}]" if ":" in name and not name.startswith("[") else name for name in (*own, *hosts))
    return Clients((*LOOPBACK, *named), tuple(origins))
