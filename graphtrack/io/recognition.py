"""Signatures of the formats: the first bytes of their files, in the order in which they are tried."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from pathlib import Path
from types import MappingProxyType

from graphtrack.io.source import RemoteFile, mostly
from graphtrack.io.text import mostly_numbers, parse_number
from graphtrack.tracks.schema import NAMES

PARQUET, SQLITE, HDF5 = b"PAR1", b"SQLite format 3\0", b"\x89HDF\r\n\x1a\n"
CLASSIC = (b"CDF\x01", b"CDF\x02")
"""netCDF before version 4."""
DEEPLABCUT = b"scorer,"

MOCAP_COLUMNS = ("clip", "frame", "t_s", "x_m", "y_m", "shoulder_yaw_rad", "head_yaw_rad")
"""Columns that a motion-capture table needs."""

_OF_RECORDINGS = (".mcap", ".db3")
_COCO_DATASET = re.compile(rb'"(images|annotations)"\s*:\s*\[')
_MARK = b"\xef\xbb\xbf"


def is_recording(path: Path) -> bool:
    """Return whether a path is a ROS 2 recording: a bag folder, or a file with the suffix of one."""
    if not (path.suffix.lower() in _OF_RECORDINGS or isinstance(path, RemoteFile) or path.is_dir()):
        return False
    from graphtrack.io.formats.ros_bag import is_bag

    return is_bag(path)


def _is_coco(head: bytes) -> bool:
    """Return whether a list has entries with images and boxes, or an object has such a list."""
    text = head.removeprefix(_MARK).lstrip()
    if text.startswith(b"["):
        return b'"image_id"' in text and b'"bbox"' in text
    return text.startswith(b"{") and _COCO_DATASET.search(text) is not None


def _header(head: bytes) -> set[str]:
    first = head.removeprefix(_MARK).lstrip().split(b"\n", 1)[0].decode("utf-8", errors="replace")
    return {cell.strip().strip('"') for cell in first.split(",")}


def _is_caviar(head: bytes) -> bool:
    return b"<dataset" in head and head.removeprefix(_MARK).lstrip().startswith(b"<")


def _is_kitti(line: str) -> bool:
    """Return whether a line is two numbers, a word and fourteen or fifteen more numbers."""
    cells = line.split()
    return len(cells) in (17, 18) and cells[2].isalpha() and parse_number(cells[0]) is not None


def _is_salsa(line: str) -> bool:
    """Return whether a line is a number followed by ``ID_…``."""
    cells = line.split(maxsplit=2)
    return len(cells) > 1 and parse_number(cells[0]) is not None and cells[1].startswith("ID_")


def _is_pedpy(head: bytes) -> bool:
    """Return whether comments are followed by rows of two whole numbers and two numbers."""
    lines = [line.strip() for line in head.decode("utf-8-sig", errors="replace").split("\n")[:-1]]
    lines = [line for line in lines if line]
    rows = [line.split() for line in lines if not line.startswith("#")][:20]
    if not lines or not lines[0].startswith("#") or not rows:
        return False

    def matches(cells: list[str]) -> bool:
        numbers = [parse_number(cell) for cell in cells]
        known = [number for number in numbers[:4] if number is not None]
        return 4 <= len(cells) <= 6 and len(known) == 4 and all(float(n).is_integer() for n in known[:2])

    return sum(map(matches, rows)) * 2 > len(rows)


SIGNATURES: Mapping[str, Callable[[bytes], bool]] = MappingProxyType(
    {
        "parquet": lambda head: head.startswith(PARQUET),
        "coco": _is_coco,
        "trajnet": lambda head: mostly(head, lambda line: line.startswith(('{"scene"', '{"track"'))),
        "ndjson": lambda head: mostly(head, lambda line: line.startswith("{")),
        "movement": lambda head: head.removeprefix(_MARK).startswith((HDF5, *CLASSIC, DEEPLABCUT)),
        "jupedsim": lambda head: head.startswith(SQLITE),
        "mocap": lambda head: _header(head) >= {*MOCAP_COLUMNS},
        "csv": lambda head: len(_header(head) & {*NAMES}) >= 2,
        "caviar": _is_caviar,
        "ucy": lambda head: b"number of splines" in head.split(b"\n", 1)[0].lower(),
        "kitti": lambda head: mostly(head, _is_kitti),
        "salsa": lambda head: mostly(head, _is_salsa),
        "towncentre": lambda head: mostly_numbers(head, ",", (6,)),
        "pedpy": _is_pedpy,
        "mot": lambda head: mostly_numbers(head, ",", range(7, 11)),
        "eth": lambda head: mostly_numbers(head, None, (8,)),
    }
)
"""Name of a format → test of a file's first bytes; the most distinctive contents first."""


def recognised(head: bytes, path: Path) -> str | None:
    """Return the name of the format of a file's first bytes or a recording's path; else None."""
    if is_recording(path):
        return "bag"
    return next((name for name, matches in SIGNATURES.items() if matches(head)), None)
