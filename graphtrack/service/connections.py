"""Connections of the service: clients that left or never finish a request are noticed within seconds."""

from __future__ import annotations

import asyncio
import select
import socket
from collections.abc import Sequence
from typing import Any

from starlette.datastructures import Headers
from starlette.responses import JSONResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send
from uvicorn.config import Config
from uvicorn.protocols.http.h11_impl import H11Protocol
from uvicorn.server import ServerState

INTERVAL = 0.5
"""Seconds between two checks. One check notices that a client leaves, the next ends its stream."""

_LEFT = select.POLLHUP | select.POLLERR | getattr(select, "POLLRDHUP", 0)


class Connection:
    """One client's connection.

    While a stream is behind, nothing is read from its client, so the event loop does not notice a client that
    leaves: `check` asks the socket.

    Attributes
    ----------
    gone : set once the client left, or was dropped
    requests : number of requests in progress
    idle_since : time of the event loop at which the last request ended
    """

    def __init__(self) -> None:
        self.gone = asyncio.Event()
        self.requests = 0
        self.idle_since = asyncio.get_running_loop().time()
        self._transport: asyncio.Transport | None = None
        self._leaving_since: float | None = None

    def made(self, transport: asyncio.Transport) -> None:
        """Watch a transport."""
        self._transport = transport

    def drop(self) -> None:
        """Close the connection without sending what was not read."""
        self.gone.set()
        if self._transport is not None:
            self._transport.abort()

    def check(self, patience: float) -> None:
        """Notice that the client left, or has not completed a request's headers for `patience`."""
        assert self._transport is not None
        now = asyncio.get_running_loop().time()
        if self._transport.is_closing() or self._left():
            if self._leaving_since is not None:
                self.gone.set()
                self._transport.close()  # once what is left is sent
            self._leaving_since = self._leaving_since or now
        since = self._leaving_since or (None if self.requests else self.idle_since)
        if since is not None and now - since > patience:
            self.drop()

    @property
    def is_closed(self) -> bool:
        """Return True once the socket is closed."""
        return self._socket().fileno() < 0

    def _left(self) -> bool:
        poll = select.poll()
        poll.register(self._socket().fileno(), _LEFT)
        return bool(poll.poll(0))

    def _socket(self) -> socket.socket:
        assert self._transport is not None
        found: socket.socket = self._transport.get_extra_info("socket")
        return found


class Connections:
    """All connections of a service.

    Parameters
    ----------
    patience : seconds that a connection may take for a request's headers
    """

    def __init__(self, patience: float) -> None:
        self._patience = patience
        self._all: set[Connection] = set()

    def protocol(self) -> type[asyncio.Protocol]:
        """Return uvicorn's HTTP protocol with its connections among these.

        The request's state has the `Connection` as ``connection``.
        """
        connections = self

        class Watched(H11Protocol):
            def __init__(
                self,
                config: Config,
                server_state: ServerState,
                app_state: dict[str, Any],
                _loop: asyncio.AbstractEventLoop | None = None,
            ) -> None:
                self.watched = Connection()
                super().__init__(config, server_state, {**app_state, "connection": self.watched}, _loop)

            def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
                self.watched.made(transport)
                connections._all.add(self.watched)
                super().connection_made(transport)

            def connection_lost(self, exc: Exception | None) -> None:
                self.watched.gone.set()
                super().connection_lost(exc)

        return Watched

    async def watch(self) -> None:
        """Check all connections until cancelled."""
        while True:
            await asyncio.sleep(INTERVAL)
            for connection in list(self._all):
                if connection.is_closed:
                    connection.gone.set()
                    self._all.discard(connection)
                else:
                    connection.check(self._patience)

    def drop(self) -> None:
        """Drop all connections."""
        for connection in self._all:
            connection.drop()


class Requests:
    """Middleware that counts the requests in progress on each connection."""

    def __init__(self, app: ASGIApp) -> None:
        self.app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on."""
        connection: Connection | None = scope.get("state", {}).get("connection")
        if connection is None:  # the lifespan has none
            return await self.app(scope, receive, send)
        connection.requests += 1
        try:
            await self.app(scope, receive, send)
        finally:
            connection.requests -= 1
            connection.idle_since = asyncio.get_running_loop().time()


class JsonErrors:
    """Middleware that gives errors of the libraries, which are plain text, the form ``{"error": …}``."""

    def __init__(self, app: ASGIApp) -> None:
        self.app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on."""
        status, text = 0, b""  # of an error in plain text

        async def convert(message: Message) -> None:
            nonlocal status, text
            if message["type"] == "http.response.start":
                kind = Headers(raw=message["headers"]).get("content-type", "")
                if message["status"] >= 400 and kind.startswith("text/plain"):
                    status = message["status"]
                    return
            elif status:
                text += message.get("body", b"")
                if not message.get("more_body", False):
                    await JSONResponse({"error": text.decode()}, status)(scope, receive, send)
                return
            await send(message)

        await self.app(scope, receive, convert if scope["type"] == "http" else send)


class TrustedOrigin:
    """Middleware that refuses requests of web pages of other origins, over HTTP and WebSocket.

    Browsers name the page's origin in the header ``Origin``; other clients send none. The service's own
    origin, that of the header ``Host``, is accepted: Starlette's `TrustedHostMiddleware` checks ``Host``.

    Parameters
    ----------
    app : the application
    origins : accepted besides; ``*`` stands for all
    """

    def __init__(self, app: ASGIApp, origins: Sequence[str]) -> None:
        self.app, self.origins = app, frozenset(origin.lower() for origin in origins)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on, or answer 403."""
        if scope["type"] in ("http", "websocket"):
            headers = Headers(scope=scope)
            host = headers.get("host", "").lower()
            accepted = self.origins | {f"http://{host}", f"https://{host}"}
            found = [one for one in headers.getlist("origin") if one.lower() not in accepted]
            if found and "*" not in self.origins:
                reason = f"a page of origin {found[0][:200]!r}; expected one named by --allow-origin"
                return await JSONResponse({"error": reason}, 403)(scope, receive, send)
        await self.app(scope, receive, send)
