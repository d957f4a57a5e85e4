"""What a file given as a video is, by its first bytes.

FFmpeg, with which OpenCV decodes, takes far more than videos: it draws text as a terminal does, shows any
bytes as text-mode art, and opens the files and addresses that a playlist names. So only files that begin as
videos do are given to it.
"""

from __future__ import annotations

from pathlib import Path

from graphtrack.errors import InputError

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
    (0, b"\xff\xd8\xff"),  # JPEG, or one after the other: a video
    (0, b"\x89PNG\r\n\x1a\n"),  # or animated
    (0, b"GIF8"),
    (8, b"WEBP"),
    (0, b"BM"),
    (0, b"II*\x00"),  # TIFF
    (0, b"MM\x00*"),
    *((0, b"P%d" % kind) for kind in range(4, 8)),  # PBM, PGM, PPM, PAM
)
_RAW = b"YUV4MPEG2 "
"""Raw pixels after a line of text: they may look like text themselves."""
_CONTROL = frozenset(range(32)) - frozenset(b"\t\n\f\r\x1b")
"""Bytes that no text has."""
_PACKETS = (188, 192, 204)
"""Bytes of a packet of an MPEG transport stream, which begins with 0x47; the first may be cut."""
_HEAD = 4 * 204
_VIDEOS = "a video (MP4, MOV, AVI, Matroska, WebM, MPEG, ...) or a folder of images"


def check_video(path: Path) -> bool:
    """Refuse a file that does not begin as a video or a picture does; whether it may be a single picture.

    Raises
    ------
    InputError
        If it is text (subtitles and playlists are), empty, or anything else.
    """
    with path.open("rb") as stream:
        head = stream.read(_HEAD)
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


def a_picture(path: Path) -> InputError:
    """The error for a single picture in place of a video."""
    return InputError("a single picture", "a video, or the folder that the picture is in", path=path)


def _has(head: bytes, signatures: tuple[tuple[int, bytes], ...]) -> bool:
    return any(head.startswith(signature, offset) for offset, signature in signatures)


def _is_transport_stream(head: bytes) -> bool:
    return any(
        all(head[start + k * size : start + k * size + 1] == b"\x47" for k in range(3))
        for size in _PACKETS
        for start in range(size)
    )


def is_cut_off(path: Path) -> bool:
    """Whether a file is an MP4 without its index, which stands at the end of most."""
    place, length = 0, path.stat().st_size
    with path.open("rb") as stream:
        if stream.read(8)[4:] != b"ftyp":
            return False
        while place + 8 <= length:
            stream.seek(place)
            head = stream.read(16)
            if head[4:8] == b"moov":
                return False
            size = int.from_bytes(head[:4], "big")
            if size == 1:  # the size stands after the name
                size = int.from_bytes(head[8:16], "big")
            if size < 8:
                break
            place += size
    return True
