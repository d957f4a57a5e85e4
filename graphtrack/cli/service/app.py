"""The service's addresses: streams over WebSocket and HTTP, health and metrics."""

from __future__ import annotations

import asyncio
import hmac
from collections.abc import AsyncGenerator, AsyncIterator, Callable
from contextlib import aclosing, asynccontextmanager, suppress

from starlette.applications import Starlette
from starlette.requests import HTTPConnection, Request
from starlette.responses import JSONResponse, Response
from starlette.routing import Route, WebSocketRoute
from starlette.types import Receive, Scope, Send
from starlette.websockets import WebSocket, WebSocketDisconnect

from graphtrack.cli.service.metrics import Metrics
from graphtrack.cli.service.settings import STREAM_NAME, Service
from graphtrack.cli.service.stream import Stream, open_stream, prepare
from graphtrack.cli.state_file import StateInUse, remove

_NOT_TAKEN = {401: 4401, 404: 4404, 409: 4409, 429: 4429}
"""HTTP's status of a request that is not taken → the code with which a WebSocket is closed."""
_BROKEN = 1011
_UNREAD = 1008
_NOTICED = 2.0
"""Seconds within which it is noticed that a client went."""


class Refused(Exception):
    """A request that is not taken: a status, and why."""

    def __init__(self, status: int, reason: str) -> None:
        super().__init__(reason)
        self.status, self.reason = status, reason


class Streams:
    """The streams of a service, by name: one connection each.

    Parameters
    ----------
    service : what it was told
    metrics : its counters
    """

    def __init__(self, service: Service, metrics: Metrics) -> None:
        self.service, self.metrics = service, metrics
        self._open: dict[str, asyncio.Event] = {}
        self._ending: dict[str, asyncio.Event] = {}

    def names(self) -> list[str]:
        """Of those that are open."""
        return sorted(self._open)

    def check(self, request: HTTPConnection) -> None:
        """Refuse who does not bear the token; browsers, which set no headers, may give it as ``?token=``."""
        token = self.service.token
        given = request.headers.get("authorization", "").removeprefix("Bearer ")
        given = given or request.query_params.get("token", "")
        if token is not None and not hmac.compare_digest(given.encode(), token.encode()):
            raise Refused(401, "no valid token; expected 'Authorization: Bearer TOKEN'")

    def checked_name(self, request: HTTPConnection) -> str:
        """The stream that is asked for."""
        self.check(request)
        name = str(request.path_params["name"])
        if not STREAM_NAME.fullmatch(name):
            raise Refused(404, "no name of a stream; expected up to 64 letters, digits, '.', '_' and '-'")
        return name

    @asynccontextmanager
    async def opened(self, name: str) -> AsyncIterator[Stream]:
        """A stream for one connection; it ends, and what it knows is kept, when the connection is done."""
        await self._left(name)
        if name in self._open:
            raise Refused(409, f"stream {name} has a connection; expected one at a time")
        if len(self._open) >= self.service.limits.streams:
            raise Refused(429, f"{len(self._open)} streams are open, as many as may be")
        self._open[name] = asyncio.Event()
        self.metrics.streams.inc()
        try:
            stream = await open_stream(name, self.service, self.metrics)
            try:
                yield stream
            finally:
                await asyncio.shield(self._ended(stream))
        finally:
            self._close(name)

    async def _ended(self, stream: Stream) -> None:
        """End a stream; until that is done, who asks for it again waits."""
        name = stream.name
        self._ending[name] = asyncio.Event()
        self._close(name)
        try:
            await stream.end()
        finally:
            self._ending.pop(name).set()

    def _close(self, name: str) -> None:
        if name in self._open:
            self._open.pop(name).set()
            self.metrics.streams.dec()

    async def _left(self, name: str) -> None:
        """Wait for who is going: the next may be here before it is noticed that they went."""
        if name in self._open:
            with suppress(TimeoutError):
                await asyncio.wait_for(self._open[name].wait(), _NOTICED)
        while name in self._ending:
            await self._ending[name].wait()

    async def forget(self, name: str) -> None:
        """Remove what is kept of a stream that nobody is connected to."""
        await self._left(name)
        if name in self._open:
            raise Refused(409, f"stream {name} has a connection; expected none")
        state = self.service.state_of(name)
        try:
            is_removed = state is not None and remove(state)
        except StateInUse as error:
            raise Refused(409, f"stream {name} is open in another process; expected none") from error
        if not is_removed:
            raise Refused(404, f"nothing is kept of stream {name}")


def refusal(request: Request, refused: Exception) -> Response:
    """The answer to a request over HTTP that is not taken."""
    assert isinstance(refused, Refused)
    streams: Streams = request.app.state.streams
    streams.metrics.refused.labels(refused.status).inc()
    return JSONResponse({"error": refused.reason}, refused.status)


async def by_websocket(websocket: WebSocket) -> None:
    """Rows in, a message for each or for several lines. An empty message ends.

    An answer a message out, or with ``?answers=together`` all that are ready, in lines.
    """
    streams: Streams = websocket.app.state.streams
    try:
        name = streams.checked_name(websocket)
        async with streams.opened(name) as stream:
            await websocket.accept()
            together = websocket.query_params.get("answers") == "together"
            patience = streams.service.limits.patience
            code, reason = await _exchange(websocket, stream, patience, together)
        # To who does not read there is no way of saying so.
        with suppress(RuntimeError, WebSocketDisconnect, TimeoutError):
            await asyncio.wait_for(websocket.close(code, reason), patience)
    except Refused as refused:
        streams.metrics.refused.labels(refused.status).inc()
        await websocket.accept()
        await websocket.close(_NOT_TAKEN[refused.status], refused.reason)


async def _exchange(websocket: WebSocket, stream: Stream, patience: float, together: bool) -> tuple[int, str]:
    """Pass rows and answers on until either side is done; the code and reason to close with."""

    async def rows() -> bool:
        """Whether the client is there to hear the rest."""
        while True:
            message = await websocket.receive()
            if message["type"] == "websocket.disconnect":
                return False
            data = message.get("bytes") or (message.get("text") or "").encode()
            if not data.strip():
                return True
            await stream.take(data.splitlines())

    async def answers() -> tuple[int, str]:
        loop = asyncio.get_running_loop()
        async for lines in stream.answers():
            try:
                async with asyncio.timeout(patience) as limit:
                    for message in ["\n".join(lines)] if together else lines:
                        await websocket.send_text(message)
                        if loop.time() + 0.9 * patience > (limit.when() or 0.0):
                            limit.reschedule(loop.time() + patience)
            except TimeoutError:
                return _UNREAD, f"answers were not read for {patience:g} s"
            except (WebSocketDisconnect, RuntimeError):
                return 1000, ""
        return 1000, ""

    incoming, outgoing = asyncio.create_task(rows()), asyncio.create_task(answers())
    try:
        done, _ = await asyncio.wait({incoming, outgoing}, return_when=asyncio.FIRST_COMPLETED)
        if incoming not in done:
            status = await stream.status() if not outgoing.result()[1] else 0
            if status:
                return _BROKEN, f"the stream's process ended with status {status}; connect again"
            return await outgoing
        if not incoming.result():
            return 1000, ""
        stream.no_more()
        return await outgoing
    finally:
        for task in (incoming, outgoing):
            task.cancel()
            with suppress(asyncio.CancelledError, OSError, WebSocketDisconnect):
                await task


class Answered(Response):
    """Lines as they come. Starlette's own streams look for a disconnection where the body still comes in."""

    media_type = "application/x-ndjson"

    def __init__(self, lines: AsyncGenerator[bytes, None]) -> None:
        super().__init__()
        del self.headers["content-length"]
        self._lines = lines

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Send head and lines."""
        async with aclosing(self._lines) as lines:
            await send({"type": "http.response.start", "status": 200, "headers": self.raw_headers})
            async for line in lines:
                await send({"type": "http.response.body", "body": line, "more_body": True})
            await send({"type": "http.response.body"})


async def by_http(request: Request) -> Response:
    """A whole stream, or its next piece where states are kept: NDJSON in the body, NDJSON back as it goes."""
    streams: Streams = request.app.state.streams
    opened = streams.opened(streams.checked_name(request))
    stream = await opened.__aenter__()

    async def rows() -> None:
        left, longest = b"", streams.service.limits.line_bytes
        async for chunk in request.stream():
            *lines, left = (left + chunk).split(b"\n")
            await stream.take(lines)
            if len(left) > longest:
                break  # the row is answered by an error, and what follows is not read
        await stream.take([left])
        stream.no_more()

    async def answers() -> AsyncGenerator[bytes, None]:
        feeding = asyncio.create_task(rows())
        try:
            async for lines in stream.answers():
                yield "".join(f"{line}\n" for line in lines).encode()
            await feeding
        finally:
            feeding.cancel()
            with suppress(asyncio.CancelledError, OSError):
                await feeding
            await opened.__aexit__(None, None, None)

    return Answered(answers())


async def listed(request: Request) -> Response:
    """The streams that are open."""
    streams: Streams = request.app.state.streams
    streams.check(request)
    return JSONResponse({"streams": streams.names()})


async def forgotten(request: Request) -> Response:
    """Forget what is kept of a stream."""
    streams: Streams = request.app.state.streams
    await streams.forget(streams.checked_name(request))
    return Response(status_code=204)


async def health(request: Request) -> Response:
    """Whether new streams are taken; needs no token."""
    streams: Streams = request.app.state.streams
    return JSONResponse({"status": "ok", "streams": len(streams.names())})


async def metrics(request: Request) -> Response:
    """Counters in Prometheus' text format."""
    streams: Streams = request.app.state.streams
    streams.check(request)
    return Response(streams.metrics.text(), media_type="text/plain; version=0.0.4")


def application(service: Service, ready: Callable[[], None]) -> Starlette:
    """The service as an ASGI application, which says when it takes streams."""

    @asynccontextmanager
    async def lifespan(app: Starlette) -> AsyncIterator[None]:
        await asyncio.to_thread(prepare, service)
        ready()
        yield

    one = "/v1/streams/{name}"
    routes = [
        Route("/health", health),
        Route("/metrics", metrics),
        Route("/v1/streams", listed),
        Route(one, by_http, methods=["POST"]),
        Route(one, forgotten, methods=["DELETE"]),
        WebSocketRoute(one, by_websocket),
    ]
    app = Starlette(routes=routes, lifespan=lifespan, exception_handlers={Refused: refusal})
    app.state.streams = Streams(service, Metrics())
    return app
