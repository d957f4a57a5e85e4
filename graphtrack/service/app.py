"""Network service: streams over WebSocket and HTTP, health and metrics."""

from __future__ import annotations

import asyncio
import errno
import hmac
import json
import logging
import signal
import socket
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import asynccontextmanager, contextmanager, suppress
from typing import Any

import uvicorn
from starlette.applications import Starlette
from starlette.middleware import Middleware
from starlette.middleware.cors import CORSMiddleware
from starlette.middleware.trustedhost import TrustedHostMiddleware
from starlette.requests import ClientDisconnect, HTTPConnection, Request
from starlette.responses import HTMLResponse, JSONResponse, PlainTextResponse, Response
from starlette.routing import Route, WebSocketRoute
from starlette.types import Receive, Scope, Send
from starlette.websockets import WebSocket, WebSocketDisconnect

from graphtrack import __version__
from graphtrack.errors import InputError
from graphtrack.service import description
from graphtrack.service.client import STREAM_NAME
from graphtrack.service.connections import Connection, Connections, JsonErrors, Requests, TrustedOrigin
from graphtrack.service.settings import Metrics, Service
from graphtrack.service.stream import Stream, open_stream, prepare
from graphtrack.streaming.saved_state import StateInUse, remove

_NOT_TAKEN = {401: 4401, 404: 4404, 409: 4409, 429: 4429, 503: 1013}
"""HTTP status of a refused request → close code of a WebSocket."""
_BROKEN, _NO_TEXT, _UNREAD = 1011, 1007, 1008
_NOTICED, _SAVED = 2.0, 5.0
"""Seconds within which a disconnected client is detected, and its stream is saved in most cases."""
_INTERVAL = 0.02
_DROPPED, _KILLED = 2.0, 3.0
"""Seconds after which a stopping service drops its connections and kills its processes."""
_LACKING = (errno.EMFILE, errno.ENFILE, errno.ENOMEM, errno.ENOSPC)
"""Errors of the system that may be gone at the next try."""
_STOPPING = "the service is stopping; connect again"


async def _until(holds: Callable[[], bool], seconds: float) -> None:
    """Wait until a condition holds, or for some seconds."""
    with suppress(TimeoutError):
        async with asyncio.timeout(seconds):
            while not holds():
                await asyncio.sleep(_INTERVAL)


class Refused(Exception):
    """Refusal of a request: status and reason."""

    def __init__(self, status: int, reason: str) -> None:
        super().__init__(reason)
        self.status, self.reason = status, reason


class Streams:
    """The streams of a service, by name: one connection each.

    Parameters
    ----------
    service : settings of the service
    metrics : counters of the service
    """

    def __init__(self, service: Service, metrics: Metrics) -> None:
        self.service, self.metrics = service, metrics
        self.connections = Connections(service.limits.patience)
        self.prepared, self.stopping = asyncio.Event(), asyncio.Event()
        self._running: set[Stream] = set()
        self._open: set[str] = set()  # until the process has ended
        self._ending: set[str] = set()

    def names(self) -> list[str]:
        """Return the names of streams with a process."""
        return sorted(self._open)

    @property
    def is_ready(self) -> bool:
        """Return True if streams can be opened: all code is compiled, and the service is not stopping."""
        return self.prepared.is_set() and not self.stopping.is_set()

    def check(self, request: HTTPConnection) -> None:
        """Refuse requests without the token; browsers, which set no headers, use ``?token=``."""
        token = self.service.token
        given = request.headers.get("authorization", "").removeprefix("Bearer ")
        given = given or request.query_params.get("token", "")
        if token is not None and not hmac.compare_digest(given.encode(), token.encode()):
            raise Refused(401, "no valid token; expected 'Authorization: Bearer TOKEN'")

    def checked_name(self, request: HTTPConnection) -> str:
        """Return the name of the requested stream."""
        self.check(request)
        name = str(request.path_params["name"])
        if not STREAM_NAME.fullmatch(name):
            raise Refused(404, "invalid stream name; expected up to 64 letters, digits, '.', '_' and '-'")
        return name

    @asynccontextmanager
    async def opened(self, name: str, resumes: bool = False) -> AsyncIterator[Stream]:
        """Open a stream for one connection; it ends, and its state is saved, when the connection ends.

        ``resumes``: whether the client resumes by itself where the connection breaks off
        """
        await self.prepared.wait()
        if self.stopping.is_set():
            raise Refused(503, _STOPPING)
        most = self.service.limits.streams
        await self._left(name, "one at a time")
        await _until(lambda: len(self._open) < most or not self._ending, _SAVED)
        if len(self._open) >= most:
            raise Refused(429, f"{len(self._open)} streams are open, the maximum")
        if name in self._open:
            raise Refused(409, f"stream {name} has a connection; expected one at a time")
        self._open.add(name)
        self.metrics.streams.inc()
        try:
            stream = await open_stream(name, self.service, self.metrics, resumes)
        except (OSError, EOFError) as error:
            self._release(name)
            reason = getattr(error, "strerror", None) or "its processes cannot be started"
            raise Refused(503, f"the service cannot open another stream now: {reason}; try again") from error
        except BaseException:
            self._release(name)
            raise
        self._running.add(stream)
        try:
            yield stream
        finally:
            await asyncio.shield(self._end(stream))

    async def _end(self, stream: Stream) -> None:
        """End a stream, whose name and place are free when its process has ended."""
        self._ending.add(stream.name)
        try:
            await stream.end()
        finally:
            self._ending.discard(stream.name)
            self._running.discard(stream)
            self._release(stream.name)

    def _release(self, name: str) -> None:
        self._open.discard(name)
        self.metrics.streams.dec()

    async def _left(self, name: str, expected: str) -> None:
        """Wait for a leaving client, whose disconnection is detected later, and for the end of its stream.

        Raises
        ------
        Refused
            If the stream stays open, or does not end in time.
        """
        await _until(lambda: name not in self._open or name in self._ending, _NOTICED)
        await _until(lambda: name not in self._ending, _SAVED)
        if name in self._ending:
            raise Refused(409, f"stream {name} is ending; try again")
        if name in self._open:
            raise Refused(409, f"stream {name} has a connection; expected {expected}")

    def stop(self) -> None:
        """End all streams; kill the processes that do not end within some seconds."""
        self.stopping.set()
        self.prepared.set()  # waiting requests are refused
        loop = asyncio.get_running_loop()
        loop.call_later(_DROPPED, self.connections.drop)
        loop.call_later(_KILLED, self._kill)

    def _kill(self) -> None:
        for stream in self._running:
            stream.kill()

    async def forget(self, name: str) -> None:
        """Remove the saved state of a stream without a connection."""
        await self._left(name, "none")
        state = self.service.state_of(name)
        try:
            is_removed = state is not None and remove(state)
        except StateInUse as error:
            raise Refused(409, f"stream {name} is open in another process; expected none") from error
        except (InputError, OSError) as error:
            found = error.found if isinstance(error, InputError) else error.strerror
            status = 503 if isinstance(error, OSError) and error.errno in _LACKING else 409
            raise Refused(status, f"the state of stream {name} cannot be removed: {found}") from error
        if not is_removed:
            raise Refused(404, f"no saved state of stream {name}")


def refusal(request: Request, refused: Exception) -> Response:
    """Return the response to a refused HTTP request."""
    assert isinstance(refused, Refused)
    streams: Streams = request.app.state.streams
    streams.metrics.refused.labels(refused.status).inc()
    return JSONResponse({"error": refused.reason}, refused.status)


async def by_websocket(websocket: WebSocket) -> None:
    """Receive rows, one or several lines a message. An empty message ends the stream.

    Each answer is one message, or with ``?answers=together`` a message has all ready answers in lines. With
    ``?resume=1`` a message ``{"ready": rows}`` comes first, after the answers that are given again.
    """
    streams: Streams = websocket.app.state.streams
    try:
        name = streams.checked_name(websocket)
        async with streams.opened(name, websocket.query_params.get("resume") == "1") as stream:
            await websocket.accept()
            together = websocket.query_params.get("answers") == "together"
            patience = streams.service.limits.patience
            code, reason = await _exchange(websocket, stream, patience, together)
        # A client that does not read cannot be notified.
        with suppress(RuntimeError, WebSocketDisconnect, TimeoutError):
            await asyncio.wait_for(websocket.close(code, reason), patience)
    except Refused as refused:
        streams.metrics.refused.labels(refused.status).inc()
        await websocket.accept()
        await websocket.close(_NOT_TAKEN[refused.status], refused.reason)


async def _exchange(websocket: WebSocket, stream: Stream, patience: float, together: bool) -> tuple[int, str]:
    """Pass rows and answers on until either side ends; return the close code and reason."""

    async def rows() -> tuple[int, str] | None:
        """Return the code and reason to close with at once; None if remaining rows are answered first."""
        while True:
            message = await websocket.receive()
            if message["type"] == "websocket.disconnect":
                return 1000, ""
            data = message.get("bytes") or (message.get("text") or "").encode()
            try:
                data.decode()
            except UnicodeDecodeError as error:
                return _NO_TEXT, f"byte {error.start + 1} of a message is not UTF-8; expected rows as JSON"
            if not data.strip():
                return None
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

    connection: Connection = websocket.state.connection
    incoming, outgoing = asyncio.create_task(rows()), asyncio.create_task(answers())
    gone = asyncio.create_task(connection.gone.wait())
    try:
        await asyncio.wait({incoming, outgoing, gone}, return_when=asyncio.FIRST_COMPLETED)
        if gone.done():
            return 1000, ""
        if incoming.done():
            if closing := incoming.result():
                return closing
            await stream.finish()
        code, reason = await outgoing
        failure = "" if reason else await stream.failure()
        return (_BROKEN, failure) if failure else (code, reason)
    finally:
        await _cancel(incoming, outgoing, gone)


class Exchange(Response):
    """HTTP response of a stream: rows in the request's body, answers in the response's body.

    Starlette's streaming responses watch for a disconnection by reading the body, which is still arriving.

    Parameters
    ----------
    request : the request
    name : of the stream
    """

    media_type = "application/x-ndjson"

    def __init__(self, request: Request, name: str) -> None:
        super().__init__()
        del self.headers["content-length"]
        self._request, self._name = request, name

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Send answers until all are sent, the client leaves or is silent, or the service stops."""
        streams: Streams = self._request.app.state.streams
        connection: Connection = self._request.state.connection
        patience = streams.service.limits.patience
        async with streams.opened(self._name) as stream:
            # Request the body first: a client that sent ``Expect: 100-continue`` waits for that.
            incoming = asyncio.create_task(self._rows(stream, patience))
            outgoing = asyncio.create_task(self._answers(stream, send, patience))
            gone = asyncio.create_task(connection.gone.wait())
            stopping = asyncio.create_task(streams.stopping.wait())
            tasks = (outgoing, incoming, gone, stopping)
            try:
                await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
                reason = _STOPPING if stopping.done() else ""
                if incoming.done() and not gone.done():
                    reason = incoming.result() or reason
                if reason:
                    incoming.cancel()
                    stream.no_more()
                await asyncio.wait((outgoing, gone), return_when=asyncio.FIRST_COMPLETED)
                if gone.done() or not outgoing.result():
                    connection.drop()
                else:
                    # With status 1 the process has sent the reason itself.
                    if not reason and await stream.status() not in (0, 1):
                        reason = await stream.failure()
                    line = json.dumps({"error": reason}) + "\n" if reason else ""
                    async with asyncio.timeout(patience):
                        await send({"type": "http.response.body", "body": line.encode()})
            except TimeoutError:
                connection.drop()
            finally:
                await _cancel(*tasks)

    async def _rows(self, stream: Stream, patience: float) -> str:
        """Pass the body's rows on; return a reason if they are refused before the body ends."""
        left, longest = b"", self._request.app.state.streams.service.limits.line_bytes
        body = self._request.stream()
        while True:
            try:
                async with asyncio.timeout(patience):
                    chunk = await anext(body)
            except StopAsyncIteration:
                break
            except ClientDisconnect:  # drop a truncated row
                stream.no_more()
                return ""
            except TimeoutError:
                return f"no row came for {patience:g} s; connect again"
            *lines, left = (left + chunk).split(b"\n")
            await stream.take(lines)
            if len(left) > longest:
                break  # the row is answered by an error, and the rest is not read
        await stream.take([left])
        stream.no_more()
        return ""

    async def _answers(self, stream: Stream, send: Send, patience: float) -> bool:
        """Send answers; return False if they stayed unread."""
        try:
            async with asyncio.timeout(patience):
                await send({"type": "http.response.start", "status": 200, "headers": self.raw_headers})
            async for lines in stream.answers():
                body = "".join(f"{line}\n" for line in lines).encode()
                async with asyncio.timeout(patience):
                    await send({"type": "http.response.body", "body": body, "more_body": True})
        except TimeoutError:
            return False
        return True


async def by_http(request: Request) -> Response:
    """Answer a stream, or its next part with saved states: NDJSON in the body, NDJSON in the response."""
    streams: Streams = request.app.state.streams
    name = streams.checked_name(request)
    encoding = request.headers.get("content-encoding", "identity")
    if encoding.lower() != "identity":
        raise Refused(415, f"a body with the encoding {encoding[:40]!r}; expected uncompressed rows")
    return Exchange(request, name)


async def _cancel(*tasks: asyncio.Task[Any]) -> None:
    for task in tasks:
        task.cancel()
        with suppress(asyncio.CancelledError, OSError, WebSocketDisconnect):
            await task


async def forgotten(request: Request) -> Response:
    """Remove the saved state of a stream."""
    streams: Streams = request.app.state.streams
    await streams.forget(streams.checked_name(request))
    return Response(status_code=204)


def ready(streams: Streams) -> Response:
    """Return status 200 if streams can be opened, else 503."""
    if streams.is_ready:
        return JSONResponse({"status": "ready"})
    reason = _STOPPING if streams.stopping.is_set() else "the service is compiling; try again"
    return JSONResponse({"error": reason}, 503)


_PAGES: dict[str, tuple[bool, Callable[[Streams], Response]]] = {
    "/": (False, lambda streams: PlainTextResponse(description.text())),
    "/health": (False, lambda streams: JSONResponse({"status": "ok", "streams": len(streams.names())})),
    "/ready": (False, ready),
    "/version": (False, lambda streams: JSONResponse({"version": __version__})),
    "/openapi.json": (False, lambda streams: JSONResponse(description.openapi())),
    "/docs": (False, lambda streams: HTMLResponse(description.page())),
    "/metrics": (
        True,
        lambda streams: Response(streams.metrics.text(), media_type="text/plain; version=0.0.4"),
    ),
    "/v1/streams": (True, lambda streams: JSONResponse({"streams": streams.names()})),
}
"""Path → True if it needs the token, and the response to GET; see ``assets/openapi.json``."""


async def page(request: Request) -> Response:
    """Return one of `_PAGES`."""
    streams: Streams = request.app.state.streams
    needs_token, make = _PAGES[request.url.path]
    if needs_token:
        streams.check(request)
    return make(streams)


def application(streams: Streams) -> Starlette:
    """Return the service as an ASGI application."""

    @asynccontextmanager
    async def lifespan(app: Starlette) -> AsyncIterator[None]:
        watching = asyncio.create_task(streams.connections.watch())
        yield
        await _cancel(watching)

    one = "/v1/streams/{name}"
    routes = [
        *(Route(path, page) for path in _PAGES),
        Route(one, by_http, methods=["POST"]),
        Route(one, forgotten, methods=["DELETE"]),
        WebSocketRoute(one, by_websocket),
    ]
    clients = streams.service.clients
    middleware = [
        Middleware(Requests),
        Middleware(JsonErrors),
        Middleware(TrustedHostMiddleware, allowed_hosts=clients.hosts, www_redirect=False),
        Middleware(TrustedOrigin, origins=clients.origins),
    ]
    if clients.origins:
        middleware.append(
            Middleware(
                CORSMiddleware,
                allow_origins=clients.origins,
                allow_methods=("GET", "POST", "DELETE"),
                allow_headers=("authorization", "content-type"),
            )
        )
    app = Starlette(
        routes=routes, middleware=middleware, lifespan=lifespan, exception_handlers={Refused: refusal}
    )
    app.state.streams = streams
    return app


_GRACE = 4
"""Seconds after which a stopping service cancels running tasks; `Streams.stop` ends all before that."""


class Server(uvicorn.Server):
    """Server that ends its streams when it stops, and then exits with status 0.

    Parameters
    ----------
    config : configuration of the server
    streams : streams of the service
    report : called once streams are accepted
    """

    def __init__(self, config: uvicorn.Config, streams: Streams, report: Callable[[], None]) -> None:
        super().__init__(config)
        self._streams, self._report = streams, report
        self._preparing: asyncio.Task[None] | None = None

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        """Listen, and compile the code of the streams."""
        await super().startup(sockets)
        self._preparing = asyncio.create_task(self._prepare())

    async def _prepare(self) -> None:
        try:
            await asyncio.to_thread(prepare, self._streams.service)
        except BaseException:
            self.should_exit = True
            raise
        self._streams.prepared.set()
        self._report()

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        """End streams and connections.

        Raises
        ------
        Exception
            The error that prevented the start.
        """
        self._streams.stop()
        await super().shutdown(sockets)
        if self._preparing is not None and self._preparing.done():
            self._preparing.result()

    @contextmanager
    def capture_signals(self) -> Iterator[None]:
        """Stop at SIGTERM and SIGINT; uvicorn would raise them again at the end."""
        before = {one: signal.signal(one, self.handle_exit) for one in (signal.SIGTERM, signal.SIGINT)}
        try:
            yield
        finally:
            for one, handler in before.items():
                signal.signal(one, handler)


def run(service: Service, host: str, port: int, report: Callable[[str], None]) -> None:
    """Serve until SIGTERM or SIGINT; `report` receives the address once streams are accepted.

    Raises
    ------
    InputError
        If the port cannot be listened on.
    """
    listening = _listen(host, port)
    address, bound = listening.getsockname()[:2]
    shown = f"[{address}]" if ":" in address else address
    address_line = f"serving ws://{shown}:{bound}/v1/streams/NAME, http://{shown}:{bound}/health"
    logging.getLogger("uvicorn.error").addFilter(_is_ours)
    streams = Streams(service, Metrics())
    config = uvicorn.Config(
        application(streams),
        http=streams.connections.protocol(),
        log_level="warning",
        access_log=False,
        ws="websockets-sansio",
        ws_per_message_deflate=False,  # compression took 40 % of this process's time
        ws_max_size=service.limits.line_bytes,
        ws_ping_interval=service.limits.patience / 2.0,
        ws_ping_timeout=service.limits.patience / 2.0,
        timeout_graceful_shutdown=_GRACE,
        lifespan="on",
    )
    Server(config, streams, lambda: report(address_line)).run(sockets=[listening])


def _is_ours(record: logging.LogRecord) -> bool:
    """Return False for errors in uvicorn's log that are a client's.

    These are a text message that is not UTF-8, closed with code 1007, and a refused WebSocket.
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
        listening.listen()  # early clients wait
    except OSError as error:
        found = f"--host {host} --port {port}: {error.strerror or error}"
        raise InputError(found, "an address of this machine and a free port") from error
    return listening
