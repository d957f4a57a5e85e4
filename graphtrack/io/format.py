"""`Format`, the interface of a module of `graphtrack.io.formats`, and how formats are recognised.

Formats are tried by signatures of the first bytes of a file, the most distinctive ones first.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray
from graphtrack.io.options import ReadOptions
from graphtrack.io.source import HEAD_BYTES, RemoteFile, Source, mostly
from graphtrack.io.text import mostly_numbers, trailing_number
from graphtrack.tracks.cells import Cells
from graphtrack.tracks.schema import NAMES
from graphtrack.tracks.table import Rows
from graphtrack.tracks.track import TrackSet, columns_as_read
from graphtrack.tracks.validation import check_frame_rate, parse_number


@dataclass(frozen=True)
class Format:
    """One file format.

    Attributes
    ----------
    name : value of ``format=``
    description : one line for users
    suffixes : endings of file names in lower case; they choose the format on writing
    read : (source, options) → rows, whose cells are checked; formats that are tables have ``cells`` instead
    cells : (source, options) → raw cells of a table, with any names of columns
    write : (tracks, path) → None, when the format can be written; ``path`` may be written to directly
    write_columns : (columns of the table, path) → None; for tables, which may lack identities and need no
        ``write``
    is_read : False for formats that are only written
    takes : options of tables, fields of `ReadOptions`, that the reader itself handles
    read_boxes : (source, options) → rows with the channel ``box`` (n, 4), left, top, width and height in
        pixels, NaN where a row has none; for formats that hold boxes
    default_fps : frames a second of a table without times, unless an option gives them; a note says so
    """

    name: str
    description: str
    suffixes: tuple[str, ...]
    read: Callable[[Source, ReadOptions], Rows] | None = None
    write: Callable[[TrackSet, Path], None] | None = None
    write_columns: Callable[[Mapping[str, NDArray[Any]], Path], None] | None = None
    is_read: bool = True
    takes: tuple[str, ...] = ()
    read_boxes: Callable[[Source, ReadOptions], Rows] | None = None
    cells: Callable[[Source, ReadOptions], Cells] | None = None
    default_fps: float | None = None

    def __post_init__(self) -> None:
        if self.write is None and self.write_columns is not None:
            object.__setattr__(self, "write", self._write_table)

    def _write_table(self, tracks: TrackSet, path: Path) -> None:
        assert self.write_columns is not None
        self.write_columns(columns_as_read(tracks), path)


COMPANIONS: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {
        "mot": ("seqinfo.ini", "../seqinfo.ini"),  # a sequence's frame rate
        "ucy": ("H.txt",),  # the data set's homography
        "kitti": ("../oxts/{name}", "../calib/{name}"),  # ego motion and calibration
        "towncentre": ("calibration.ci",),  # calibration of the camera
    }
)
"""Name of a format → paths, relative to a file's folder, of files that its reader uses too.

``{name}`` stands for the file's name.
"""


def companion_paths(path: Path, format: str) -> tuple[Path, ...]:
    """Return the paths of a file's `COMPANIONS`, if it is of that format."""
    name = path.name.removesuffix(".gz")
    places = COMPANIONS[format]
    return tuple(Path(os.path.normpath(path.parent / place.format(name=name))) for place in places)


def companion_files(path: Path) -> tuple[Path, ...]:
    """Return the companion files of ``path`` that a reader of some format would read with it."""
    places = (place for format in COMPANIONS for place in companion_paths(path, format))
    return tuple(place for place in places if place.is_file())


_AMISS = 0.1  # tolerance of a time from that of its frame, in frames


def steady_rate(tracks: TrackSet) -> float | None:
    """Return frames a second, if the times of all tracks follow their frames at one rate; else None."""
    if not len(tracks):
        return None
    frame = np.concatenate([track.frame for track in tracks]).astype(float)
    t = np.concatenate([track.t for track in tracks])
    first, last = int(np.argmin(frame)), int(np.argmax(frame))
    if frame[last] == frame[first]:
        # A single frame determines a rate only if it counts from t = 0.
        rate = frame[first] / t[first] if t[first] != 0.0 else 0.0
        return float(rate) if rate > 0.0 and np.ptp(t) == 0.0 else None
    if not t[last] > t[first]:
        return None
    between = float((frame[last] - frame[first]) / (t[last] - t[first]))
    rounded = float(f"{between:.9g}")  # 25, and not 24.999999999999996
    amiss = (t - t[first]) * rounded - (frame - frame[first])
    return rounded if np.abs(amiss).max() < _AMISS else None


def rate_of(declared: Any) -> float | None:
    """Return the frame rate that a file declares; None if it is no rate."""
    try:
        rate = float(declared)
    except (TypeError, ValueError):
        return None
    return rate if 0.0 < rate <= 1e6 else None


def rate_to_write(tracks: TrackSet, path: Path | None = None, given: float | None = None) -> float:
    """Return the frame rate of tracks for a format without times; for a single frame the one ``given``."""
    check_frame_rate(given)
    if given is not None:
        return given
    found = steady_rate(tracks)
    if found is None:
        expected = "a time for each frame at one rate, or a format with times, such as .csv or .nc"
        raise InputError("times without a steady frame rate", expected, path=path)
    return found


def times_are_exact(frame: FloatArray, t: FloatArray, rate: float) -> bool:
    """Return whether frames (n,) at a rate reproduce the times (n,) to the last bit."""
    return bool(np.array_equal(frame / rate, t))


PARQUET, SQLITE, HDF5 = b"PAR1", b"SQLite format 3\0", b"\x89HDF\r\n\x1a\n"
CLASSIC = (b"CDF\x01", b"CDF\x02")
"""netCDF before version 4."""
DEEPLABCUT = b"scorer,"

MOCAP_COLUMNS = ("clip", "frame", "t_s", "x_m", "y_m", "shoulder_yaw_rad", "head_yaw_rad")
"""Columns that a motion-capture table needs."""

_OF_RECORDINGS = (".mcap", ".db3", ".bag")
_COCO_DATASET = re.compile(rb'"(images|annotations)"\s*:\s*\[')
_MARK = b"\xef\xbb\xbf"


def is_recording(path: Path) -> bool:
    """Return whether a path is a ROS 2 recording: a bag folder, or a file with the suffix of one."""
    if not (path.suffix.lower() in _OF_RECORDINGS or isinstance(path, RemoteFile) or path.is_dir()):
        return False
    from graphtrack.io.formats.ros.bag import is_bag

    return is_bag(path)


def _is_coco(head: bytes) -> bool:
    """Return whether a list has entries with images and boxes, or an object has such a list."""
    text = head.removeprefix(_MARK).lstrip()
    if text.startswith(b"["):
        return b'"image_id"' in text and b'"bbox"' in text
    return text.startswith(b"{") and _COCO_DATASET.search(text) is not None


def _is_json(head: bytes) -> bool:
    """Return whether a file is a list of objects, or of lists of them, or an object of lists of them."""
    text = head.removeprefix(_MARK).lstrip()
    return re.match(rb'\[\s*(\[\s*)*[{\]]|\{\s*"[^"]*"\s*:\s*\[\s*[{\]]', text) is not None


def _is_label(line: str) -> bool:
    """Return whether a line is a class and a box relative to the image, as of YOLO."""
    numbers = [parse_number(cell) for cell in line.split()]
    known = [number for number in numbers[:5] if number is not None]
    return (
        len(known) == 5
        and known[0].is_integer()
        and known[0] >= 0.0
        and all(0.0 < n <= 1.0 for n in known[1:])
    )


def _is_of_sdd(line: str) -> bool:
    """Return whether a line is nine whole numbers and a word in quotation marks."""
    cells = line.split()
    return (
        len(cells) == 10
        and cells[9].startswith('"')
        and all(cell.lstrip("-").isdigit() for cell in cells[:9])
    )


def label_files(folder: Path) -> list[Path]:
    """Return the texts of a folder of YOLO's labels, or of its folder ``labels``, in the order of frames."""
    for place in (folder / "labels", folder):
        if place.is_dir():
            files = [one for one in place.glob("*.txt") if trailing_number(one.stem) is not None]
            head = next((one.read_bytes()[:HEAD_BYTES] for one in files if one.stat().st_size), b"")
            if files and mostly(head, _is_label):
                return sorted(files, key=lambda one: (trailing_number(one.stem), one.name))
    return []


def _header(head: bytes) -> set[str]:
    first = head.removeprefix(_MARK).lstrip().split(b"\n", 1)[0].decode("utf-8", errors="replace")
    return {cell.strip().strip('"') for cell in first.split(",")}


_OF_VICON = re.compile(
    rb"\s*[A-Z][A-Za-z ]{4,20},*\r?\n\d+(\.\d+)?[,\t]*\r?\n[^\n]*\r?\nFrame[,\t]Sub Frame[,\t]"
)


def _is_vicon(head: bytes) -> bool:
    """Return whether a file begins with a section, its rate, a row of names and Frame, Sub Frame."""
    return _OF_VICON.match(head.removeprefix(_MARK)) is not None


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
        "json": _is_json,
        "trajnet": lambda head: mostly(head, lambda line: line.startswith(('{"scene"', '{"track"'))),
        "ndjson": lambda head: mostly(head, lambda line: line.startswith("{")),
        "movement": lambda head: head.removeprefix(_MARK).startswith((HDF5, *CLASSIC, DEEPLABCUT)),
        "jupedsim": lambda head: head.startswith(SQLITE),
        "motive": lambda head: head.removeprefix(_MARK).startswith(b"Format Version,"),
        "vicon": _is_vicon,
        "qualisys": lambda head: head.removeprefix(_MARK).startswith(b"NO_OF_FRAMES"),
        "mocap": lambda head: _header(head) >= {*MOCAP_COLUMNS},
        "csv": lambda head: len(_header(head) & {*NAMES}) >= 2,
        "caviar": _is_caviar,
        "ucy": lambda head: b"number of splines" in head.split(b"\n", 1)[0].lower(),
        "kitti": lambda head: mostly(head, _is_kitti),
        "yolo": lambda head: mostly(head, _is_label),
        "sdd": lambda head: mostly(head, _is_of_sdd),
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
    if path.is_dir():
        return "yolo" if label_files(path) else None
    return next((name for name, matches in SIGNATURES.items() if matches(head)), None)
