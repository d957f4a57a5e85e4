"""UCY crowds: splines (``.vsp``) whose control points are the observations."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from graphtrack.errors import InputError
from graphtrack.geometry import GroundCamera
from graphtrack.io.cameras import camera_or_scale, on_ground, read_homography
from graphtrack.io.numbers import parse_number
from graphtrack.io.options import ReadOptions
from graphtrack.io.registry import Format
from graphtrack.io.rows import Rows, to_tracks
from graphtrack.io.schema import LARGEST_FRAME, LARGEST_PIXELS
from graphtrack.io.source import Source
from graphtrack.tracks import TrackSet

FPS = 25.0
_CENTRE = (360.0, 288.0)
"""The file's origin in its 720×576 image, as (u, v)."""

_FROM_PIXEL = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
"""(u, v) → (row, column), which is what the homographies that come with the data expect."""

_MIRROR = np.diag([1.0, -1.0, 1.0])

_POINTS = re.compile(r"(\d{1,9})\s*(-.*)?", re.ASCII)


def looks_like(head: bytes, path: Path) -> bool:
    """Whether the first line counts splines."""
    return b"number of splines" in head.split(b"\n", 1)[0].lower()


@dataclass(frozen=True)
class _ControlPoint:
    spline: int
    u: float
    v: float
    frame: int
    line: int


def read(source: Source, options: ReadOptions) -> TrackSet:
    """Read each control point as one observation in its frame.

    Needs the homography of the data set, (row, column) → ground in metres; ``H.txt`` beside the file is found
    by itself. A mirrored ground is turned right-handed by negating y. 25 frames a second unless ``fps`` is
    given.

    Raises
    ------
    InputError
        With the line of the first thing that cannot be used, or if there is no homography.
    """
    points = _control_points(source)
    pixel = np.array([(point.u, point.v) for point in points]).reshape(-1, 2)
    notes = [
        "gaze was not read: most of it is the direction to the next control point, which tells the future",
    ]
    camera, more = _camera(source, options, pixel)
    frame = np.array([point.frame for point in points], dtype=np.int64)
    spline = np.array([point.spline for point in points], dtype=np.int64)
    rows = Rows(
        source.path,
        "ucy",
        spline,
        frame,
        {"pixel": pixel},
        lambda row: points[row].line,
        notes=tuple(notes),
    )
    rows = on_ground(rows, camera, more)
    # Annotators at times set two control points in one frame; the first one stands.
    _, first = np.unique(np.column_stack([rows.track_id, rows.frame]), axis=0, return_index=True)
    kept = np.zeros(len(rows), dtype=bool)
    kept[first] = True
    rows = rows.keep(kept, "second control point of a spline in one frame")
    return to_tracks(rows.with_times(options.fps or FPS))


def _camera(source: Source, options: ReadOptions, pixel: np.ndarray) -> tuple[GroundCamera, tuple[str, ...]]:
    if options.camera is not None:
        return options.camera, ()
    given = options.homography
    notes: tuple[str, ...] = ()
    if given is None and options.point_pairs is None and options.calibration is None:
        beside = source.path.parent / "H.txt"
        if beside.is_file():
            given, notes = beside, ("homography from H.txt beside the file",)
        elif options.metres_per_pixel is None:
            raise InputError(
                "no homography",
                "H.txt beside the file, or a homography (row, column → metres)",
                path=source.path,
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


def _control_points(source: Source) -> list[_ControlPoint]:
    """All control points, in the order of the file."""
    lines = [(number, line.strip()) for number, line in enumerate(source.lines, 1) if line.strip()]
    place = 0

    def fail(found: str, expected: str, column: str | None = None) -> InputError:
        line = lines[place][0] if place < len(lines) else len(source.lines)
        return InputError(found, expected, path=source.path, line=line, column=column)

    def count(what: str) -> int:
        if place >= len(lines):
            raise fail("the end of the file", what)
        match = _POINTS.fullmatch(lines[place][1])
        if match is None:
            raise fail(repr(lines[place][1][:40]), what)
        return int(match[1])

    splines = count("the number of splines")
    place = 1
    points: list[_ControlPoint] = []
    for spline in range(splines):
        expected_points = count(f"the number of control points of spline {spline + 1} of {splines}")
        place += 1
        for _ in range(expected_points):
            if place >= len(lines):
                raise fail("the end of the file", f"a control point of spline {spline + 1} of {splines}")
            number, text = lines[place]
            cells = text.split(" - ")[0].split()
            if len(cells) != 4:
                raise fail(f"{len(cells)} columns", "4: x y frame gaze")
            values = [parse_number(cell) for cell in cells]
            for name, cell, value in zip(("x", "y", "frame", "gaze"), cells, values, strict=True):
                highest = LARGEST_FRAME if name == "frame" else LARGEST_PIXELS
                if value is None or abs(value) > highest or (name == "frame" and value != int(value)):
                    whole = "whole " if name == "frame" else ""
                    raise fail(repr(cell[:40]), f"a {whole}number within ±{highest:g}", name)
            x, y, frame, _gaze = (value or 0.0 for value in values)
            points.append(_ControlPoint(spline, x + _CENTRE[0], _CENTRE[1] - y, int(frame), number))
            place += 1
    if place < len(lines):
        raise fail(repr(lines[place][1][:40]), f"the end of the file after {splines} splines")
    return points


FORMAT = Format(
    name="ucy",
    description="UCY crowds: splines of control points (.vsp)",
    suffixes=(".vsp",),
    looks_like=looks_like,
    read=read,
)
