"""The service on a port, until it is told to stop."""

from __future__ import annotations

import logging
import signal
import socket
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import uvicorn

from graphtrack.cli.service.app import Streams, application
from graphtrack.cli.service.metrics import Metrics
from graphtrack.cli.service.settings import Service
from graphtrack.errors import InputError

_GRACE = 4
"""Seconds after which a service that stops cancels what still runs; `Streams.stop` ends all before that."""


class Server(uvicorn.Server):
    """A server that ends its streams when it stops, and exits with status 0 then.

    Parameters
    ----------
    config : of the server
    streams : of the service
    """

    def __init__(self, config: uvicorn.Config, streams: Streams) -> None:
        super().__init__(config)
        self._streams = streams

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        """End streams and connections."""
        self._streams.stop()
        await super().shutdown(sockets)

    @contextmanager
    def capture_signals(self) -> Iterator[None]:
        """Stop at SIGTERM and SIGINT; uvicorn would raise them once more in the end."""
        before = {one: signal.signal(one, self.handle_exit) for one in (signal.SIGTERM, signal.SIGINT)}
        try:
            yield
        finally:
            for one, handler in before.items():
                signal.signal(one, handler)


def run(service: Service, host: str, port: int, report: Callable[[str], None]) -> None:
    """Serve until SIGTERM or SIGINT; `report` is given the address once streams are taken.

    Raises
    ------
    InputError
        If the port cannot be listened on.
    """
    listening = _listen(host, port)
    address, bound = listening.getsockname()[:2]
    shown = f"[{address}]" if ":" in address else address
    said = f"serving ws://{shown}:{bound}/v1/streams/NAME, http://{shown}:{bound}/health"
    logging.getLogger("uvicorn.error").addFilter(_is_ours)
    streams = Streams(service, Metrics())
    config = uvicorn.Config(
        application(streams, lambda: report(said)),
        http=streams.connections.protocol(),
        log_level="warning",
        access_log=False,
        ws="websockets-sansio",
        ws_per_message_deflate=False,  # it took two fifths of this process's time
        ws_max_size=service.limits.line_bytes,
        ws_ping_interval=service.limits.patience / 2.0,
        ws_ping_timeout=service.limits.patience / 2.0,
        timeout_graceful_shutdown=_GRACE,
        lifespan="on",
    )
    Server(config, streams).run(sockets=[listening])


def _is_ours(record: logging.LogRecord) -> bool:
    """Return False for what uvicorn logs as errors and is none of the service.

    That is a text message that is no UTF-8, whose client gets code 1007, and a WebSocket that was refused.
    """
    if record.exc_info and isinstance(record.exc_info[1], UnicodeDecodeError):
        return False
    return "without completing handshake" not in record.getMessage()


def _listen(host: str, port: int) -> socket.socket:
    try:
        family, kind, protocol, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
        listening = socket.socket(family, kind, protocol)
        listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listening.bind(address)
        listening.listen()  # who comes early waits
    except OSError as error:
        found = f"--host {host} --port {port}: {error.strerror or error}"
        raise InputError(found, "an address of this machine and a free port") from error
    return listening
