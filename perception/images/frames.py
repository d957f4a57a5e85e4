"""Frames of a video or of a folder of images in order, undecodable frames included.

FFmpeg, which decodes through PyAV, also renders text files and opens the files and addresses of a playlist.
Therefore only files with the signature of a video are passed to it.
"""

from __future__ import annotations

import logging
import warnings
from collections.abc import Callable, Iterable, Iterator
from contextlib import AbstractContextManager, contextmanager, suppress
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import av
import cv2
import numpy as np
from numpy.typing import ArrayLike
from PIL import Image as Headers

from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray
from graphtrack.limits import MemoryLimit
from graphtrack.tracks.schema import LARGEST_FRAME
from perception.images.pixels import Image, as_uint8

_SIGNATURES: tuple[tuple[int, bytes], ...] = (
    *((4, name) for name in (b"ftyp", b"moov", b"mdat", b"wide", b"free", b"skip", b"pnot")),  # MP4, MOV
    (0, b"\x1a\x45\xdf\xa3"),  # Matroska, WebM
    (8, b"AVI "),
    (0, b"OggS"),
    (0, b"FLV\x01"),
    (0, b"\x30\x26\xb2\x75\x8e\x66\xcf\x11"),  # ASF, WMV
    (0, b"\x00\x00\x01\xba"),  # MPEG program stream
    (0, b"\x00\x00\x01\xb3"),  # MPEG-1 and -2 without a container
    (0, b"\x00\x00\x01\x09"),  # H.264 without a container, with and without a leading zero
    (0, b"\x00\x00\x01\x67"),
    (0, b"\x00\x00\x00\x01"),  # H.264 and H.265
    (0, b"\x06\x0e\x2b\x34"),  # MXF
    (0, b"\x1f\x07\x00"),  # DV
    (0, b".RMF"),
    (0, b"DKIF"),
    (0, b"nut/multimedia container"),
)
_PICTURES: tuple[tuple[int, bytes], ...] = (
    (0, b"\xff\xd8\xff"),  # JPEG, or a sequence of them: a video
    (0, b"\x89PNG\r\n\x1a\n"),  # or animated
    (0, b"GIF8"),
    (8, b"WEBP"),
    (0, b"BM"),
    (0, b"II*\x00"),  # TIFF
    (0, b"MM\x00*"),
    *((0, b"P%d" % kind) for kind in range(4, 8)),  # PBM, PGM, PPM, PAM
)
_RAW = b"YUV4MPEG2 "  # raw pixels after a line of text, which may resemble text
_CONTROL = frozenset(range(32)) - frozenset(b"\t\n\f\r\x1b")  # bytes that do not occur in text
_PACKETS = (188, 192, 204)  # bytes of a packet of an MPEG transport stream, which begins with 0x47
HEAD = 4 * 204
"""Bytes by which the type of a file is recognised."""
_VIDEOS = "a video (MP4, MOV, AVI, Matroska, WebM, MPEG, ...) or a folder of images"


def check_video(path: Path) -> bool:
    """Return True if a file may be a single image; refuse files without a signature of image or video.

    Raises
    ------
    InputError
        If it is text (such as subtitles and playlists), empty, or of another type.
    """
    with path.open("rb") as stream:
        return check_head(stream.read(HEAD), path)


def check_head(head: bytes, path: Path) -> bool:
    """Check the first bytes of a video as `check_video` does; ``path`` is for messages."""
    text = head[:2] in (b"\xff\xfe", b"\xfe\xff") or not any(byte in _CONTROL for byte in head)
    if not head:
        found = "an empty file"
    elif text and not head.startswith(_RAW):
        found = "text"
    elif head.startswith(_RAW) or _has(head, _SIGNATURES) or _is_transport_stream(head):
        return False
    elif _has(head, _PICTURES):
        return True
    else:
        found = "something else"
    raise InputError(found, _VIDEOS, path=path)


def _has(head: bytes, signatures: tuple[tuple[int, bytes], ...]) -> bool:
    return any(head.startswith(signature, offset) for offset, signature in signatures)


def _is_transport_stream(head: bytes) -> bool:
    return any(
        all(head[start + k * size : start + k * size + 1] == b"\x47" for k in range(3))
        for size in _PACKETS
        for start in range(size)
    )


_UNEVEN = 0.1  # of the frame interval: largest deviation of time stamps at a constant rate
logger = logging.getLogger("graphtrack")


@dataclass(frozen=True, eq=False)
class Clock:
    """Times of frames by number.

    Attributes
    ----------
    rate : nominal, frames a second
    stamps : (n,) seconds of frames 0, 1, 2 … of a variable rate; None: constant rate
    """

    rate: float
    stamps: FloatArray | None = None

    def seconds(self, frame: ArrayLike) -> FloatArray:
        """Return the times (...,) of frames (...,), with the nominal rate beyond the last time stamp."""
        number = np.asarray(frame)
        if self.stamps is None:
            return np.asarray(number / self.rate, float)
        beyond = np.maximum(number - (len(self.stamps) - 1), 0) / self.rate
        return np.asarray(np.interp(number, np.arange(len(self.stamps)), self.stamps) + beyond, float)


def seconds(frame: ArrayLike, clock: float | Clock) -> FloatArray:
    """Return the times (...,) of frames (...,), from a clock or frames a second."""
    return (clock if isinstance(clock, Clock) else Clock(clock)).seconds(frame)


def _time_stamps(path: Path, rate: float) -> FloatArray | None:
    """Return seconds (n,) of a video's frames since the first; None at a constant rate, or if unknown."""
    try:
        with _opened(path) as container:
            if _is_raw(container):
                return None
            stream = container.streams.best("video")
            packets = [packet for packet in container.demux(stream) if packet.size and not packet.is_discard]
            ticks = sorted(packet.pts for packet in packets if packet.pts is not None)
            tick = float(stream.time_base or 0)
    except av.FFmpegError:
        packets, ticks, tick = [], [], 0.0
    if not ticks or len(ticks) < len(packets):
        logger.warning("times by the nominal rate of %g a second: frames without time stamps", rate)
        return None
    stamps = np.asarray(np.subtract(ticks, ticks[0]) * tick, float)
    if (np.abs(stamps * rate - np.arange(len(stamps))) <= _UNEVEN).all():
        return None
    logger.warning("times by the video's time stamps, which differ from a constant rate of %g a second", rate)
    return stamps


_SUFFIXES = {".jpg", ".jpeg", ".png", ".bmp", ".tif", ".tiff", ".webp", ".pgm", ".ppm"}
_DOUBT = 0.9  # share of its duration at which a video without a number of frames has ended early
_LAST = 1.0  # seconds that its last frame may be shown

Progress = Callable[[int, str], AbstractContextManager[Callable[[int], None]]]
"""Starts a progress report with a total and a unit; yields a function that receives completed counts."""


@dataclass(frozen=True, eq=False)
class Frame:
    """A frame and its number; an undecodable frame has ``image`` None and a ``reason``."""

    number: int
    image: Image | None
    reason: str = ""


@dataclass(frozen=True)
class FrameSource:
    """Video or folder as a source of frames.

    Attributes
    ----------
    path : a video, or a folder with images
    count : number of frames by its metadata
    fps : frames a second by its metadata; None for a folder
    damaged : numbers of the decoded frames with errors that the decoder concealed, of all passes so far
    """

    path: Path
    count: int
    fps: float | None
    damaged: set[int] = field(default_factory=set, compare=False, repr=False)

    @classmethod
    def open(cls, path: str | Path) -> FrameSource:
        """Open a video or a folder.

        Raises
        ------
        InputError
            If it is neither, or has no frames.
        """
        path = Path(path)
        if path.is_dir():
            count = len(_images(path))
            if not count:
                raise InputError("a folder without images", "images such as 0001.jpg", path=path)
            return cls(path, count, None)
        if not path.is_file():
            raise InputError("no such file or folder", "a video or a folder of images", path=path)
        may_be_picture = check_video(path)
        expected = "a whole video (an MP4 that was cut off has lost its index), or a folder of images"
        try:
            with _opened(path) as container:
                stream = container.streams.best("video")
                rate = float(stream.guessed_rate or 0)
                frames, seconds = _declared(container)
                count = (
                    frames or round(seconds * rate) or sum(one.size > 0 for one in container.demux(stream))
                )
        except av.FFmpegError as error:
            raise InputError("no video that can be decoded", expected, path=path) from error
        found = (decoded for decoded in _decoded(path) if not isinstance(decoded, str))
        if next(found, None) is None:
            raise InputError("no video that can be decoded", expected, path=path)
        if may_be_picture and next(found, None) is None:
            expected = "a video, or the folder that the picture is in"
            raise InputError("a single picture", expected, path=path)
        return cls(path, max(count, 1), rate if 0.1 < rate < 1000 else None)

    def clock(self, rate: float) -> Clock:
        """Return the times of the frames: time stamps of a video of variable rate, else from the rate."""
        return Clock(rate, None if self.path.is_dir() else _time_stamps(self.path, rate))

    @staticmethod
    def files(path: Path) -> list[Path]:
        """Return the files that are read as frames: the video, or the images of the folder."""
        return [image for _, image in _images(path)] if path.is_dir() else [path]

    def stamp(self) -> list[tuple[str, int, int]]:
        """Return a key of the content: path, size and time of the video or of every image."""
        states = [(path, path.stat()) for path in self.files(self.path)]
        return [(str(path), state.st_size, state.st_mtime_ns) for path, state in states]

    def frame_of(self, name: str) -> int | None:
        """Return the number of the frame with this image name, without suffix; None if there is none."""
        return self._named.get(name)

    @cached_property
    def _named(self) -> dict[str, int]:
        return {path.stem: number for number, path in _images(self.path)} if self.path.is_dir() else {}

    def size(self) -> tuple[int, int]:
        """Return columns and rows of the first decodable frame.

        Raises
        ------
        InputError
            If none can.
        """
        for frame in self:
            if frame.image is not None:
                return frame.image.shape[1], frame.image.shape[0]
        raise InputError("no frame that can be decoded", "a video or a folder of images", path=self.path)

    @property
    def first(self) -> int:
        """Number of the first frame: 0 in a video, or the lowest of numbered images."""
        return _images(self.path)[0][0] if self.path.is_dir() else 0

    def numbers(self) -> list[int]:
        """Return the numbers of the frames; a video is read through, since its metadata may be wrong."""
        if self.path.is_dir():
            return [number for number, _ in _images(self.path)]
        good = (k for k, found in enumerate(_decoded(self.path)) if not isinstance(found, str))
        return list(range(max(good, default=-1) + 1))

    def __iter__(self) -> Iterator[Frame]:
        return self.where(lambda number: True)

    def where(self, wanted: Callable[[int], bool]) -> Iterator[Frame]:
        """Yield the wanted frames; the pixels of other frames are not decoded."""
        if self.path.is_dir():
            return _from_folder(self.path, wanted)
        return self._from_video(wanted)

    def _from_video(self, wanted: Callable[[int], bool]) -> Iterator[Frame]:
        for number, found in enumerate(_decoded(self.path)):
            if not isinstance(found, str) and found.is_corrupt:
                self.damaged.add(number)
            if wanted(number):
                reason = found.format(number) if isinstance(found, str) else ""
                yield Frame(number, None if isinstance(found, str) else picture_of(found), reason)

    @contextmanager
    def reported(
        self,
        wanted: Callable[[int], bool],
        count: int,
        progress: Progress,
        *,
        unit: str = "frames",
        one_size: bool = False,
    ) -> Iterator[Iterator[Frame]]:
        """Yield the wanted frames, ``count`` in number, with a progress report in a unit.

        Parameters
        ----------
        one_size : whether a change of the frames' size is an `InputError`
        """
        found = of_one_size(self.where(wanted)) if one_size else self.where(wanted)
        with progress(count, unit) as advance:

            def decoded() -> Iterator[Frame]:
                for frame in found:
                    advance(1)
                    yield frame

            yield decoded()


def of_one_size(frames: Iterable[Frame]) -> Iterator[Frame]:
    """Yield the same frames, checked to have one size.

    Raises
    ------
    InputError
        At the first frame of another size.
    """
    size: tuple[int, ...] = ()
    for frame in frames:
        if frame.image is not None:
            h, w = frame.image.shape[:2]
            size = size or (h, w)
            if (h, w) != size:
                raise InputError(
                    f"frame {frame.number} of {w} × {h} pixels", f"{size[1]} × {size[0]} as the first"
                )
        yield frame


def _images(folder: Path) -> list[tuple[int, Path]]:
    """Return images by frame number: the numbers in their names, or 0, 1, 2 … if none has a number."""
    paths = sorted(path for path in folder.iterdir() if path.suffix.lower() in _SUFFIXES)
    numbered = [path for path in paths if path.stem.isascii() and path.stem.isdigit()]
    if not numbered:
        return list(enumerate(paths))
    if len(numbered) < len(paths):
        other = next(path for path in paths if path not in numbered)
        found = f"images {numbered[0].name} and {other.name}"
        raise InputError(found, "names that all are the numbers of frames, or none", path=folder)
    found_at: dict[int, Path] = {}
    for path in numbered:
        number = int(path.stem)
        if number > LARGEST_FRAME:
            raise InputError(f"an image {path.name}", f"frames up to {LARGEST_FRAME}", path=folder)
        if number in found_at:
            both = f"{found_at[number].name} and {path.name}"
            raise InputError(f"two images of frame {number}, {both}", "one image a frame", path=folder)
        found_at[number] = path
    return sorted(found_at.items())


def _from_folder(folder: Path, wanted: Callable[[int], bool]) -> Iterator[Frame]:
    for number, path in _images(folder):
        if not wanted(number):
            continue
        try:
            image = read_image(path)
            yield Frame(number, image, f"{path.name} cannot be decoded" if image is None else "")
        except InputError as error:
            yield Frame(number, None, f"{path.name}: {error.found}")


PIXEL_BYTES = 12
"""Memory of a decoded pixel: as the file has it, as 8 bits of three colours, and copies of these."""


def check_pixels(path: Path, columns: float, rows: float) -> None:
    """Raise InputError for an image of so many pixels that it takes more memory than a file may."""
    MemoryLimit(path).check(PIXEL_BYTES * columns * rows, f"an image of {columns:.0f} × {rows:.0f} pixels")


def read_image(path: Path) -> Image | None:
    """Return an image (h, w, 3); None if it cannot be decoded.

    Raises
    ------
    InputError
        For an image of too many pixels, or with others than 8 or 16 bits.
    """
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", Headers.DecompressionBombWarning)  # the limit is checked here
            with Headers.open(path) as header:  # which decodes nothing
                check_pixels(path, *header.size)
        image = cv2.imread(str(path), cv2.IMREAD_ANYCOLOR | cv2.IMREAD_ANYDEPTH)  # upright by Exif
    except Headers.DecompressionBombError as error:
        raise InputError("an image of too many pixels", "a smaller one", path=path) from error
    except (OSError, ValueError, SyntaxError, cv2.error):
        return None
    return None if image is None else as_uint8(np.asarray(image))


@contextmanager
def _opened(path: Path) -> Iterator[Any]:
    """Open a video by its absolute path, since FFmpeg interprets "name:" as a protocol, and no other file.

    Raises
    ------
    av.FFmpegError
        If it has no video stream, or cannot be opened.
    """
    with av.open(str(path.absolute()), options={"protocol_whitelist": "file"}) as container:
        stream = container.streams.best("video")
        if stream is None or stream.codec_context is None:
            raise av.InvalidDataError(0, "no video stream")
        check_pixels(path, stream.codec_context.width, stream.codec_context.height)
        yield container


def _is_raw(container: Any) -> bool:
    """Return True for a stream without a container, whose time stamps are invented (AVFMT_NOTIMESTAMPS)."""
    return bool(container.format.flags & 0x80)


def _declared(container: Any) -> tuple[int, float]:
    """Return the number of frames and the duration in seconds by the metadata of a video; 0 if unknown."""
    stream = container.streams.best("video")
    if _is_raw(container):
        return 0, 0.0  # a duration from a guessed bit rate
    seconds = float(stream.duration * stream.time_base) if stream.duration else 0.0
    return stream.frames, seconds or (container.duration or 0) / av.time_base


def _decoded(path: Path) -> Iterator[av.VideoFrame | str]:
    """Yield the frames of a video from number 0, in the order of their times.

    An undecodable frame is a reason, with ``{}`` for its number. At the end undecodable frames are one: an
    early end.
    """
    with _opened(path) as container:
        stream = container.streams.best("video")
        declared, duration = _declared(container)
        failed: list[int | None] = []  # time stamps of undecodable frames that are not yielded yet
        number = 0
        times: list[float] = []  # of the first frame and the newest
        for packet in _packets(container, stream):
            declared -= packet is not None and packet.is_discard and declared > 0
            try:
                frames = stream.codec_context.decode(packet)
            except av.FFmpegError:
                if packet is not None:
                    failed.append(packet.pts)
                continue
            for frame in frames:
                check_pixels(path, frame.width, frame.height)
                before = [one for one in failed if one is None or frame.pts is None or one < frame.pts]
                failed = [one for one in failed if one not in before]
                yield from ["frame {} cannot be decoded"] * len(before)
                yield frame
                if frame.pts is not None:
                    times = [*times[:1], float(frame.pts * stream.time_base)]
                number += 1 + len(before)
        if number < declared:
            yield f"the video ends at frame {{}} of {declared}"
        elif not declared and times and times[-1] - times[0] + _LAST < _DOUBT * duration:
            yield f"the video ends at frame {{}}, after {times[-1] - times[0]:.1f} of {duration:.1f} s"


def _packets(container: Any, stream: Any) -> Iterator[Any]:
    """Yield the packets of a stream and, at the end or at an error of the container, None to flush."""
    with suppress(av.FFmpegError):
        yield from (packet for packet in container.demux(stream) if packet.size)
    yield None


def picture_of(frame: av.VideoFrame) -> Image:
    """Return a decoded frame (h, w, 3), upright by its rotation."""
    image = as_uint8(frame.to_ndarray(format="bgr24"))
    turns = round(frame.rotation / 90.0) % 4
    return np.ascontiguousarray(np.rot90(image, turns)) if turns else image
