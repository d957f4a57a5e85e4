"""Crowds in datasets of trajectories: BIWI (ETH) and OpenTraj tables, UCY's splines, and TrajNet++.

Lines of TrajNet++ are JSON objects, a ``scene`` or a position of a ``track`` (Kothari et al. 2021).
"""

from __future__ import annotations

import json
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from graphtrack.errors import InputError
from graphtrack.geometry.camera import GroundCamera
from graphtrack.io.cameras import camera_or_scale, on_ground, read_homography
from graphtrack.io.format import Format, companion_paths, rate_to_write
from graphtrack.io.formats.ndjson import parse_line
from graphtrack.io.options import ReadOptions
from graphtrack.io.source import Source
from graphtrack.io.text import parse_number, read_numbers
from graphtrack.tracks.detections import frames_between
from graphtrack.tracks.table import Rows
from graphtrack.tracks.track import TrackSet
from graphtrack.tracks.validation import LARGEST_FRAME, LARGEST_ID, LARGEST_METRES, LARGEST_PIXELS, is_number

ANNOTATED_HZ = 2.5

_OBSMAT = ("frame", "id", "x", "z", "y", "vx", "vz", "vy")


def _read_eth(source: Source, options: ReadOptions) -> Rows:
    """Read positions (metres) of an ``obsmat`` table; its velocities are differences and are left out."""
    table = read_numbers(source, delimiter=None, widths=(8,), names=_OBSMAT)
    frame = table.integers(0)
    notes = ["the velocities of the file are differences of its positions and were not read"]
    fps = options.fps
    if fps is None:
        step = frames_between(frame)
        fps = ANNOTATED_HZ * step
        notes.append(
            f"frame rate {fps:g} Hz: the frames step by {step} and are annotated at {ANNOTATED_HZ} Hz"
        )
    rows = Rows(
        source.path,
        "eth",
        table.integers(1, LARGEST_ID),
        frame,
        {"position": np.column_stack([table.metres(2), table.metres(4)])},
        table.line_of,
        notes=tuple(notes),
    )
    return rows.with_times(fps)


ETH = Format(
    name="eth",
    description="BIWI (ETH) obsmat: frame id x z y vx vz vy",
    suffixes=(),
    read=_read_eth,
)


_UCY_FPS = 25.0
_CENTRE = (360.0, 288.0)  # the file's origin in its 720×576 image, as (u, v)

_FROM_PIXEL = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
"""(u, v) → (row, column), the input of the homographies that come with the data."""

_MIRROR = np.diag([1.0, -1.0, 1.0])

_COUNT = re.compile(r"(\d{1,9})\s*(-.*)?", re.ASCII)
_COMMENT = re.compile(r" - | ?\(")
_POINT = ("x", "y", "frame", "gaze")
_OBSTACLES = re.compile(r"\s*\d{1,9}.*number of (line|cylinder) obstacles", re.ASCII | re.IGNORECASE)
_INTEGERS = {"frame"}


@dataclass(frozen=True)
class _ControlPoint:
    spline: int
    u: float
    v: float
    frame: int
    line: int


def _read_ucy(source: Source, options: ReadOptions) -> Rows:
    """Read each control point as one observation in its frame."""
    lines = _Lines(source)
    points = _control_points(lines)
    pixel = np.array([(point.u, point.v) for point in points]).reshape(-1, 2)
    notes = [
        "gaze was not read: most of it is the direction to the next control point, a future position",
        *_obstacles(lines),
    ]
    camera, more = _camera(source, options, pixel)
    frame = np.array([point.frame for point in points], dtype=np.int64)
    spline = np.array([point.spline for point in points], dtype=np.int64)
    rows = Rows(
        source.path, "ucy", spline, frame, {"pixel": pixel}, lambda row: points[row].line, notes=tuple(notes)
    )
    rows = on_ground(rows, camera, more)
    # Annotators at times set two control points in one frame; the first is kept.
    _, first = np.unique(np.column_stack([rows.track_id, rows.frame]), axis=0, return_index=True)
    kept = np.zeros(len(rows), dtype=bool)
    kept[first] = True
    rows = rows.keep(kept, "second control point of a spline in one frame")
    return rows.with_times(options.fps or _UCY_FPS)


def _camera(source: Source, options: ReadOptions, pixel: np.ndarray) -> tuple[GroundCamera, tuple[str, ...]]:
    if options.camera is not None:
        return options.camera, ()
    given = options.homography
    notes: tuple[str, ...] = ()
    if given is None and options.point_pairs is None and options.calibration is None:
        (found,) = companion_paths(source.path, "ucy")
        if found.is_file():
            given, notes = found, ("homography from H.txt next to the file",)
        elif options.metres_per_pixel is None:
            raise source.fail(
                "no homography", "H.txt next to the file, or a homography (row, column → metres)"
            )
    if given is None:
        return camera_or_scale(options, pixel, np.ones(1))
    homography = read_homography(given) if isinstance(given, str | Path) else np.asarray(given, dtype=float)
    if homography.shape != (3, 3):
        raise InputError(f"a homography of shape {homography.shape}", "shape (3, 3)")
    camera = GroundCamera.from_homography(homography @ _FROM_PIXEL, visible=pixel)
    if camera.is_mirrored:
        camera = GroundCamera(_MIRROR @ camera.homography)
        notes = (
            *notes,
            "the ground of the homography is mirrored: y has been negated to make it right-handed",
        )
    return camera, notes


class _Lines:
    """Iterator over the non-empty lines of a file."""

    def __init__(self, source: Source) -> None:
        self._source = source
        self._lines = [(number, line.strip()) for number, line in enumerate(source.lines, 1) if line.strip()]
        self._place = 0

    @property
    def number(self) -> int:
        """Number of the current line in the file, or of the last line at the end."""
        return self._lines[self._place][0] if self.left else len(self._source.lines)

    @property
    def left(self) -> bool:
        """Return whether there is a current line."""
        return self._place < len(self._lines)

    def text(self, expected: str) -> str:
        """Return the current line; raise an error at the end of the file."""
        if not self.left:
            raise self.fail("the end of the file", expected)
        return self._lines[self._place][1]

    def fail(self, found: str, expected: str, column: str | None = None) -> InputError:
        """Return the error for the current line."""
        return self._source.fail(found, expected, line=self.number, column=column)

    def count(self, expected: str) -> int:
        """Return the count at the beginning of the current line, and advance."""
        text = self.text(expected)
        match = _COUNT.fullmatch(text)
        if match is None:
            raise self.fail(repr(text[:40]), expected)
        self._place += 1
        return int(match[1])

    def numbers(self, names: tuple[str, ...], expected: str) -> list[float]:
        """Return the numbers of the current line, before its comment, and advance."""
        text = self.text(expected)
        cells = _COMMENT.split(text, maxsplit=1)[0].split()
        if len(cells) != len(names):
            raise self.fail(f"{len(cells)} columns", f"{len(names)}: {' '.join(names)}")
        values = []
        for name, cell in zip(names, cells, strict=True):
            value, integer = parse_number(cell), name in _INTEGERS
            highest = LARGEST_FRAME if integer else LARGEST_PIXELS
            if value is None or abs(value) > highest or (integer and value != int(value)):
                kind = "whole number" if integer else "number"
                raise self.fail(repr(cell[:40]), f"a {kind} within ±{highest:g}", name)
            values.append(value)
        self._place += 1
        return values


def _control_points(lines: _Lines) -> list[_ControlPoint]:
    """Return all control points, in the order of the file."""
    splines = lines.count("the number of splines")
    points: list[_ControlPoint] = []
    for spline in range(splines):
        of = f"of spline {spline + 1} of {splines}"
        for _ in range(lines.count(f"the number of control points {of}")):
            number = lines.number
            x, y, frame, _gaze = lines.numbers(_POINT, f"a control point {of}")
            points.append(_ControlPoint(spline, x + _CENTRE[0], _CENTRE[1] - y, int(frame), number))
    return points


def _obstacles(lines: _Lines) -> tuple[str, ...]:
    """Return a note on obstacles, which may follow the splines and are not read."""
    if not lines.left:
        return ()
    expected = "the end of the file, or the number of line or cylinder obstacles, after the splines"
    text = lines.text(expected)
    if _OBSTACLES.match(text) is None:
        raise lines.fail(repr(text[:40]), expected)
    return ("obstacles not read",)


UCY = Format(
    name="ucy",
    description="UCY crowds: splines of control points (.vsp)",
    suffixes=(".vsp",),
    read=_read_ucy,
)


_KINDS = ("scene", "track")
_PREDICTED = "prediction_number"
_LARGEST = {"f": LARGEST_FRAME, "p": LARGEST_ID, "x": LARGEST_METRES, "y": LARGEST_METRES}
_PREDICTIONS = "predictions of a scene"
_TRAJNET_LINE = 'a line {"scene": {…}} or {"track": {"f": frame, "p": person, "x": metres, "y": metres}}'


def _read_trajnet(source: Source, options: ReadOptions) -> Rows:
    """Read positions in metres. Scenes state the frame rate; predictions are refused."""
    cells: list[list[float]] = []
    lines: list[int] = []
    rates: set[float] = set()
    for number, line in enumerate(source.lines, 1):
        if not line.strip():
            continue
        kind, values = _trajnet_line(source.path, number, line)
        if kind == "scene":
            if is_number(values.get("fps")) and values["fps"] > 0.0:
                rates.add(float(values["fps"]))
            continue
        cells.append([_trajnet_number(source.path, number, values, key) for key in _LARGEST])
        cells[-1].append(float(values.get(_PREDICTED) is not None))
        lines.append(number)
    if not cells:
        raise source.fail("no track", _TRAJNET_LINE)
    table = np.array(cells)
    frame = table[:, 0].astype(np.int64)
    rows = Rows(
        source.path,
        "trajnet",
        table[:, 1].astype(np.int64),
        frame,
        {"position": table[:, 2:4]},
        lambda row: lines[row],
    )
    rows = rows.keep(table[:, 4] == 0.0, _PREDICTIONS)
    if options.fps is not None:
        return rows.with_times(options.fps)
    if len(rates) != 1:
        found = "no frame rate in a scene" if not rates else f"scenes of {len(rates)} frame rates"
        raise source.fail(found, "one rate in all scenes, or --fps")
    step, rate = frames_between(rows.frame), rates.pop()
    note = f"frame rate {rate * step:g} Hz: the scenes have {rate:g} Hz and the frames step by {step}"
    return rows.with_notes(note).with_times(rate * step)


def _trajnet_line(path: Path, number: int, line: str) -> tuple[str, dict[str, Any]]:
    """Return kind and values of a line."""
    try:
        pairs = parse_line(line)
    except InputError as error:
        raise error.at(path, number) from error
    if len(pairs) == 1 and pairs[0][0] in _KINDS and isinstance(pairs[0][1], tuple):
        return pairs[0][0], dict(pairs[0][1])
    raise InputError(repr(line.strip()[:60]), _TRAJNET_LINE, path=path, line=number)


def _trajnet_number(path: Path, line: int, values: dict[str, Any], key: str) -> float:
    value: Any = values.get(key)
    is_integer = key in ("f", "p")
    if is_number(value) and abs(value) <= _LARGEST[key] and not (is_integer and value != int(value)):
        return float(value)
    kind = "an integer" if is_integer else "metres"
    expected = f"{kind} within ±{_LARGEST[key]:g}"
    raise InputError(repr(value)[:60], expected, path=path, line=line, column=key)


def _write_trajnet(tracks: TrackSet, path: Path) -> None:
    """Write positions, and a scene for each track, from its first frame with a position to its last."""
    rate = rate_to_write(tracks, path)
    known = [np.isfinite(track.position).all(axis=1) for track in tracks]
    frames = [track.frame[some] for track, some in zip(tracks, known, strict=True)]
    fps = rate / frames_between(np.concatenate(frames)) if any(map(len, frames)) else rate
    positions = sorted(
        (frame, track.track_id, *place)
        for track, some in zip(tracks, known, strict=True)
        for frame, place in zip(track.frame[some].tolist(), track.position[some].tolist(), strict=True)
    )
    with path.open("w", encoding="ascii", newline="\n") as stream:
        for k, (track, own) in enumerate(zip(tracks, frames, strict=True)):
            if len(own):
                scene = {"id": k, "p": track.track_id, "s": int(own[0]), "e": int(own[-1]), "fps": fps}
                stream.write(json.dumps({"scene": scene}) + "\n")
        for values in positions:
            stream.write(json.dumps({"track": dict(zip(_LARGEST, values, strict=True))}) + "\n")


TRAJNET = Format(
    name="trajnet",
    description="TrajNet++: scenes and positions, a JSON object a line",
    suffixes=(".trajnet.ndjson",),
    read=_read_trajnet,
    write=_write_trajnet,
)
