"""Frames of live sources as they arrive: webcams, network streams (RTSP, HTTP, …), FIFOs and standard input.

A network stream or a webcam does not wait: a thread decodes it, only the newest frame is kept, and frames
that nobody took in time are counted as dropped. A lost connection is made again. A pipe, or a video on a web
server, waits for its reader: every frame is kept, with the times of its container.
"""

from __future__ import annotations

import re
import stat
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, BinaryIO

import av
import numpy as np
from numpy.typing import ArrayLike

from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray
from perception.images.encoding import VideoFile
from perception.images.frames import HEAD, Clock, Frame, check_head, check_pixels, of_one_size, picture_of

_URL = re.compile(r"(rtsps?|https?|rtmps?|tcp|udp|rtp|srt)://", re.IGNORECASE)
_PASSWORD = re.compile(r"(?<=://)[^/@]*@")
_OPTIONS = {"fflags": "nobuffer", "flags": "low_delay", "rtsp_flags": "prefer_tcp"}
_PROTOCOLS = "rtsp,rtsps,rtp,srtp,rtmp,rtmps,http,https,httpproxy,tcp,tls,udp,srt,crypto"
"""Protocols that a network stream may use: a playlist on a server opens no file of this machine."""
_TIMEOUT = 10.0
"""Seconds without data after which a connection is lost."""
_WAITS = (0.5, 8.0)
"""Seconds to the first attempt to connect again, and at most, doubled in between."""
_EVERY = 10.0
"""Seconds between reports on the rate and latency."""
_RATE = 25.0
_REMEMBERED = 1000
"""Frames whose times are kept."""


@dataclass(frozen=True)
class LiveSource:
    """Address of a live source.

    Attributes
    ----------
    address : for FFmpeg, or the path of a FIFO; - for standard input
    kind : network, device or pipe
    """

    address: str
    kind: str

    @property
    def name(self) -> str:
        """Return the address for messages, without a password."""
        return "standard input" if self.address == "-" else _PASSWORD.sub("", self.address)

    @classmethod
    def of(cls, text: str) -> LiveSource | None:
        """Return the live source that a text names; None for other paths.

        A number is a webcam, unless a file has that name.
        """
        if text == "-":
            return cls(text, "pipe")
        if _URL.match(text):
            return cls(text, "network")
        path = Path(text)
        mode = path.stat().st_mode if path.exists() else 0
        if stat.S_ISFIFO(mode):
            return cls(text, "pipe")
        if stat.S_ISCHR(mode) or text.startswith("/dev/video"):
            return cls(text, "device")
        if not mode and text.isascii() and text.isdigit() and len(text) < 4:
            return cls(f"/dev/video{text}" if sys.platform.startswith("linux") else text, "device")
        return None


class _Pipe:
    """Bytes of a pipe as they come, from the first ones on, which were read to recognise its type."""

    def __init__(self, stream: BinaryIO, head: bytes) -> None:
        self._stream, self._head = stream, head

    def read(self, size: int) -> bytes:
        """Return at most ``size`` bytes, as soon as there are some."""
        if self._head:
            found, self._head = self._head[:size], self._head[size:]
            return found
        return self._stream.read1(size)  # type: ignore[attr-defined]


@dataclass(frozen=True, eq=False)
class ArrivalClock(Clock):
    """Times of the newest frames, seconds since the first one."""

    times: dict[int, float] = field(default_factory=dict)

    def add(self, frame: int, seconds: float) -> None:
        """Add the time of the next frame."""
        self.times[frame] = seconds
        if len(self.times) > _REMEMBERED:
            del self.times[next(iter(self.times))]

    def seconds(self, frame: ArrayLike) -> FloatArray:
        """Return the times (...,) of frames (...,)."""
        number = np.asarray(frame)
        return np.array([self.times[k] for k in number.ravel().tolist()], float).reshape(number.shape)


@dataclass(frozen=True, eq=False)
class _Arrived:
    """A decoded frame, its number, its time in seconds since the first, and when it arrived."""

    number: int
    picture: av.VideoFrame
    seconds: float
    at: float


class LiveFrames:
    """Frames of a live source, numbered as they arrive, dropped ones included; a context that connects.

    It has what the stream of `perception observe` needs of a `FrameSource`.

    Parameters
    ----------
    source : its address
    reconnect : seconds for which a lost connection is tried again; 0: it is the end
    report : receives lines on lost connections, and on rate, dropped frames and latency

    Attributes
    ----------
    received, dropped : numbers of frames
    damaged : numbers of frames with concealed errors, of those that were taken
    """

    first: int = 0
    fps: float | None = None
    waits = True
    """Whether the source waits for its reader, so that no frame is dropped."""

    def __init__(
        self, source: LiveSource, *, reconnect: float = 60.0, report: Callable[[str], object] = print
    ) -> None:
        self.source, self.path = source, Path(source.name)
        self.received, self.dropped = 0, 0
        self.damaged: set[int] = set()
        self._reconnect, self._report = reconnect, report
        self._clock = ArrivalClock(_RATE)
        self._begun: float | None = None
        self._size = 0, 0
        self._container: Any = None
        self._stopped = threading.Event()
        self._latency: list[float] = []
        self._shown = (time.monotonic(), 0, 0)

    def __enter__(self) -> LiveFrames:
        self._container = self._open()
        served = self.source.address.lower().startswith("http") and bool(self._container.duration)
        self.waits = self.source.kind == "pipe" or served
        return self

    def __exit__(self, *error: object) -> None:
        self._stopped.set()

    def frame_of(self, name: str) -> int | None:
        """Return None: frames have no names."""
        return None

    def size(self) -> tuple[int, int]:
        """Return columns and rows of the frames."""
        return self._size

    def clock(self, rate: float) -> ArrivalClock:
        """Return the times of the frames that have come, whatever the rate."""
        return self._clock

    def _open(self) -> Any:
        """Connect.

        Raises
        ------
        InputError
            If that is not possible, or there is no video.
        """
        kind, address = self.source.kind, self.source.address
        expected = "a webcam (0, /dev/video0), rtsp:// or http:// with video, a FIFO, or - with a video"
        try:
            if kind == "pipe":
                container = self._piped()
            elif kind == "device":
                container = av.open(address, format=_device_format(), timeout=_TIMEOUT)
            else:
                options = {**_OPTIONS, "protocol_whitelist": _PROTOCOLS}
                container = av.open(address, options=options, timeout=_TIMEOUT)
        except (av.FFmpegError, OSError, ValueError) as error:
            why = getattr(error, "strerror", None) or str(error)
            raise InputError(f"no video ({why})", expected, path=self.source.name) from error
        stream = container.streams.best("video")
        if stream is None or stream.codec_context is None:
            container.close()
            raise InputError("no video stream", expected, path=self.source.name)
        self._size = stream.codec_context.width, stream.codec_context.height
        check_pixels(self.path, *self._size)
        return container

    def _piped(self) -> Any:
        address = self.source.address
        stream: Any = sys.stdin.buffer if address == "-" else Path(address).open("rb")  # noqa: SIM115
        head = b""
        while len(head) < HEAD and (more := stream.read1(HEAD - len(head))):
            head += more
        check_head(head, self.path)
        kind = "mjpeg" if head.startswith(b"\xff\xd8\xff") else None
        return av.open(_Pipe(stream, head), format=kind, options={"protocol_whitelist": "pipe"})

    def _arriving(self) -> Iterator[_Arrived]:
        """Yield frames of the connection, and of those that follow when it is lost."""
        waits, lost, wait = self.waits, None, _WAITS[0]
        while not self._stopped.is_set():
            reason = "the stream ended"
            try:
                for one in self._of_connection(waits):
                    if lost is not None:
                        self._report(f"  note: {self.source.name}: connected again")
                    lost, wait = None, _WAITS[0]
                    yield one
            except (av.FFmpegError, OSError) as error:
                reason = getattr(error, "strerror", None) or str(error)
            finally:
                with suppress(av.FFmpegError, OSError):
                    self._container.close()
            if waits or not self._reconnect or self._stopped.is_set():
                return
            if lost is None:
                lost = time.monotonic()
                self._report(f"  note: {self.source.name}: {reason}; connecting again")
            while not self._stopped.wait(wait):
                if time.monotonic() - lost > self._reconnect:
                    expected = f"a source that comes back within {self._reconnect:g} s (--reconnect)"
                    raise InputError(
                        f"a connection that was lost ({reason})", expected, path=self.source.name
                    )
                wait = min(2.0 * wait, _WAITS[1])
                with suppress(InputError):
                    self._container = self._open()
                    break

    def _of_connection(self, waits: bool) -> Iterator[_Arrived]:
        stream = self._container.streams.best("video")
        rate, start = float(stream.guessed_rate or 0) or _RATE, None
        for packet in self._container.demux(stream):
            if self._stopped.is_set():
                return
            try:
                frames = packet.decode()
            except av.InvalidDataError:
                continue
            for frame in frames:
                now = time.monotonic()
                self._begun = now if self._begun is None else self._begun
                seconds = now - self._begun
                if waits:
                    known = None if frame.pts is None else float(frame.pts * frame.time_base)
                    start = known if start is None else start
                    seconds = self.received / rate if known is None or start is None else known - start
                yield _Arrived(self.received, frame, seconds, now)
                self.received += 1

    def _newest(self) -> Iterator[_Arrived]:
        """Yield the newest frame each time, from a thread that drops others."""
        newest: list[_Arrived] = []
        failed: list[BaseException] = []
        changed, ended = threading.Condition(), threading.Event()

        def receive() -> None:
            try:
                for one in self._arriving():
                    with changed:
                        self.dropped += len(newest)
                        newest[:] = [one]
                        changed.notify()
            except BaseException as error:
                failed.append(error)
            ended.set()

        threading.Thread(target=receive, name="live frames", daemon=True).start()
        while True:
            is_last = ended.is_set()
            with changed:
                if not newest:
                    changed.wait(0.1)  # not for ever, so that the end and an interrupt are noticed
                taken = newest[:]
                newest.clear()
            yield from taken
            if is_last and not taken:
                break
        if failed:
            raise failed[0]

    def __iter__(self) -> Iterator[Frame]:
        self._shown = (time.monotonic(), 0, 0)
        for one in self._arriving() if self.waits else self._newest():
            check_pixels(self.path, one.picture.width, one.picture.height)
            self._clock.add(one.number, one.seconds)
            if one.picture.is_corrupt:
                self.damaged.add(one.number)
            yield Frame(one.number, picture_of(one.picture))
            self._latency.append(time.monotonic() - one.at)
            if time.monotonic() - self._shown[0] > _EVERY:
                self._report(f"  live: {self.state()}")
                self._latency.clear()
                self._shown = (time.monotonic(), self.received, self.dropped)
        if not self.received:
            expected = (
                "video; an MP4 needs its index in front (-movflags frag_keyframe+empty_moov), or MPEG-TS"
            )
            raise InputError("a stream without a frame", expected, path=self.source.name)

    def state(self) -> str:
        """Describe rate, dropped frames, and latency from arrival to output, since the last report."""
        since, received, dropped = self._shown
        taken = self.received - received - (self.dropped - dropped)
        rate = taken / max(time.monotonic() - since, 1e-3)
        latency = f", latency {np.median(self._latency):.2f} s" if self._latency else ""
        lost = "" if self.waits else f", {self.dropped} of {self.received} dropped"
        return f"{rate:.1f} frames a second{lost}{latency}"


def _device_format() -> str:
    formats = {"linux": "v4l2", "darwin": "avfoundation", "win32": "dshow"}
    return formats.get(sys.platform, "v4l2")


def record(frames: LiveFrames, path: Path, seconds: float | None) -> int:
    """Record a live source into a Matroska video with the times of arrival; return the number of frames.

    It ends with the source, after some seconds, or at an interrupt (Ctrl-C).

    Raises
    ------
    InputError
        If the size of the frames changes, or as `LiveFrames` raises it.
    """
    count, newest = 0, -1
    with VideoFile(path, _RATE) as video, suppress(KeyboardInterrupt):
        for frame in of_one_size(frames):
            assert frame.image is not None
            at = float(frames.clock(_RATE).seconds(frame.number))
            if seconds is not None and at > seconds:
                break
            newest = max(round(1000.0 * at), newest + 1)
            video.write(frame.image, newest)
            count += 1
    return count
