"""CAVIAR ground truth (XML): boxes, and in some clips labelled feet, shoulders and gaze.

Two views. In the corridors people stand upright in the image and the foot point is the middle of the
box's lower edge. In the lobby the camera points down through a wide-angle lens: people extend away from
the pixel below the camera, and the feet are near the end of the box that is closest to it. The median
error of that point against 1,551 labelled pairs of feet is 2.0 px; that of the middle of the lower edge
is 15.7 px.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from itertools import islice
from typing import TYPE_CHECKING

import numpy as np

from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray, direction, wrap
from graphtrack.geometry.camera import GroundCamera
from graphtrack.io.cameras import camera_or_scale, known_camera, on_ground
from graphtrack.io.format import Format
from graphtrack.io.options import ReadOptions
from graphtrack.io.source import Source
from graphtrack.io.text import parse_number
from graphtrack.tracks.table import Rows
from graphtrack.tracks.validation import LARGEST_FRAME, LARGEST_ID, LARGEST_PIXELS

if TYPE_CHECKING:
    from xml.etree.ElementTree import Element

FPS = 25.0

LOBBY_NADIR = (295.0, 221.0)
"""Pixel of the lobby view to which the lines from labelled heads to labelled feet converge."""

LOBBY_HEIGHT = 5.35
"""Height of the lobby's camera above the floor, metres, assuming heads 1.6 m above feet."""

_TOWARDS_NADIR = 0.8  # position of the feet between the box's centre (0) and its edge towards the nadir (1)

_LOBBY_SIZE = (384.0, 288.0)
_WIDE_SHARE = 0.2
"""Share of boxes wider than high from which a view counts as the lobby: 67–99 % there, 0 % in a corridor."""


def lobby_camera() -> GroundCamera:
    """The camera of CAVIAR's lobby, origin below it, y towards the top of the image.

    No calibration of it is published. This one was fitted (least squares, soft L1) to 1,545 labelled
    pairs of head and feet, with heads 1.6 m above the feet and the principal point in the middle of the
    image; the median error of heads predicted from feet is 2.7 px. The scale depends on the 1.6 m; walking
    speeds are 1.3–1.6 m/s.
    """
    from scipy.spatial.transform import Rotation

    downward = np.diag([1.0, -1.0, -1.0])
    rotation = Rotation.from_euler("xy", [-0.294, 0.628]).as_matrix() @ downward
    centre = np.array([0.0, 0.0, LOBBY_HEIGHT])
    intrinsics = np.array([[231.0, 0.0, 192.0], [0.0, 231.0, 144.0], [0.0, 0.0, 1.0]])
    distortion = np.array([-0.322, 0.0993, 0.0, 0.0, 0.0])
    return GroundCamera.from_calibration(rotation, -rotation @ centre, intrinsics, distortion)


@dataclass(frozen=True)
class _Observation:
    """One object of one frame; pixels, NaN where something is not labelled."""

    frame: int
    identity: int
    box: tuple[float, float, float, float]
    foot: tuple[float, float]
    left: tuple[float, float]
    right: tuple[float, float]
    head: tuple[float, float]
    gaze: float


def read(source: Source, options: ReadOptions) -> Rows:
    """Read each labelled object of each frame.

    The position is the middle of the labelled feet, else a point of the box (see the module), on the
    ground of the camera of the options; failing that, of `lobby_camera` or of a scale. Body heading is
    square to the shoulders; head is the gaze, an image direction. ``<orientation>`` is the axis of a
    blob, not a heading, and is not read.
    """
    observations = _Reader(source).observations()
    boxes = np.array([o.box for o in observations])
    pixel, foot_note, in_lobby = _foot_points(observations, boxes, options)
    camera, notes = _camera(options, pixel, boxes, in_lobby)
    rows = _rows(source, observations, {"pixel": pixel, **_orientations(observations, camera, pixel)})
    return on_ground(rows.with_notes(foot_note), camera, notes).with_times(options.fps or FPS)


def read_boxes(source: Source, options: ReadOptions = ReadOptions()) -> Rows:
    """Return the labelled objects in the order of the file, without empty boxes.

    The channel is ``box`` (n, 4): left, top, width and height in pixels.
    """
    observations = _Reader(source).observations()
    centre, size = np.hsplit(np.array([o.box for o in observations]), 2)
    return _rows(source, observations, {"box": np.hstack([centre - size / 2.0, size])})


def read_heads(source: Source) -> Rows:
    """Return the labelled heads in the order of the file, without objects that lack one.

    The channel is ``head`` (n, 2): the pixel of the head's middle.
    """
    observations = _Reader(source).observations()
    rows = _rows(source, observations, {"head": np.array([o.head for o in observations])})
    return rows.keep(~np.isnan(rows.channels["head"][:, 0]), "without a head")


def _rows(source: Source, observations: list[_Observation], channels: dict[str, FloatArray]) -> Rows:
    """Return observations with their channels, without empty boxes."""
    rows = Rows(
        source.path,
        "caviar",
        np.array([o.identity for o in observations], dtype=np.int64),
        np.array([o.frame for o in observations], dtype=np.int64),
        channels,
        lambda row: _line_of_object(source, row),
    )
    full = np.array([min(o.box[2:]) > 0.0 for o in observations])
    return rows.keep(full, "with an empty box")


def _foot_points(
    observations: list[_Observation], boxes: FloatArray, options: ReadOptions
) -> tuple[FloatArray, str, bool]:
    """Return foot pixels (n, 2), a note on them, and whether the view is classified as the lobby's."""
    labelled = np.array([o.foot for o in observations])
    centre, half = boxes[:, :2], boxes[:, 2:] / 2.0
    within = bool(np.all(centre <= _LOBBY_SIZE))
    in_lobby = within and bool(np.mean(half[:, 0] > half[:, 1]) > _WIDE_SHARE)
    nadir = options.nadir or (LOBBY_NADIR if in_lobby else None)
    if nadir is None:
        guess = centre + np.column_stack([np.zeros(len(half)), half[:, 1]])
        where = "the middle of the box's lower edge"
    else:
        towards = np.asarray(nadir) - centre
        with np.errstate(divide="ignore", invalid="ignore"):
            to_edge = np.nanmin(np.where(towards != 0.0, half / np.abs(towards), np.inf), axis=1)
        guess = centre + towards * np.minimum(_TOWARDS_NADIR * to_edge, 1.0)[:, None]
        where = f"near the box's edge towards the pixel ({nadir[0]:g}, {nadir[1]:g}) below the camera"
    has_feet = np.isfinite(labelled).all(axis=1)
    note = f"foot points: {int(has_feet.sum())} from labelled feet, {int((~has_feet).sum())} {where}"
    return np.where(has_feet[:, None], labelled, guess), note, in_lobby


def _camera(
    options: ReadOptions, pixel: FloatArray, boxes: FloatArray, in_lobby: bool
) -> tuple[GroundCamera, tuple[str, ...]]:
    camera, notes = known_camera(options, pixel)
    if camera is not None:
        return camera, notes
    if in_lobby and options.metres_per_pixel is None:
        return lobby_camera(), (
            "boxes wider than high: taken to be CAVIAR's lobby, whose camera is known only from heads 1.6 m "
            "above feet; give homography, point_pairs or metres_per_pixel for another view",
        )
    return camera_or_scale(options, pixel, boxes[:, 3])


def _orientations(
    observations: list[_Observation], camera: GroundCamera, foot: FloatArray
) -> dict[str, FloatArray]:
    """Return body and head (n,) in the world, radians."""
    left = camera.image_to_ground([o.left for o in observations])
    right = camera.image_to_ground([o.right for o in observations])
    across = left - right
    quarter = -np.pi / 2.0 if not camera.is_mirrored else np.pi / 2.0
    apart = np.linalg.norm(across, axis=1) > 1e-6
    body = np.where(apart, wrap(direction(across) + quarter), np.nan)
    gaze = np.array([o.gaze for o in observations])
    head_pixel = np.array([o.head for o in observations])
    head = camera.image_direction_to_world(gaze, head_pixel)
    head = np.where(np.isnan(head), camera.image_direction_to_world(gaze, foot), head)
    return {"body": body, "head": head}


class _Reader:
    """Parser of the XML; it keeps the position of the current object for messages."""

    def __init__(self, source: Source) -> None:
        self._source = source
        self._objects = 0

    def observations(self) -> list[_Observation]:
        """Return all objects of all frames; at least one."""
        found = []
        for frame in self._root().iter("frame"):
            number = self._number(frame, "number", LARGEST_FRAME, integer=True)
            for element in frame.findall("objectlist/object"):
                found.append(self._observation(element, int(number)))
                self._objects += 1
        if not found:
            raise self._source.fail("no objects in frames", "at least one")
        return found

    def _root(self) -> Element:
        from xml.etree.ElementTree import ParseError

        from defusedxml import DefusedXmlException
        from defusedxml.ElementTree import fromstring

        path = self._source.path
        try:
            return fromstring(self._source.data, forbid_dtd=True)
        except DefusedXmlException as error:
            raise InputError(
                f"a document type or entity ({type(error).__name__})", "plain XML without them", path=path
            ) from error
        except ParseError as error:
            line, column = error.position
            message = str(error).split(":")[0]
            raise InputError(
                f"damaged XML ({message})", "well-formed XML", path=path, line=line, column=column + 1
            ) from error
        except (ValueError, LookupError) as error:  # an encoding that does not exist or does not fit
            raise InputError(f"undecodable XML ({error})", "XML in UTF-8", path=path) from error

    def _observation(self, element: Element, frame: int) -> _Observation:
        box = element.find("box")
        if box is None:
            raise self._fail(f"object without a box in frame {frame}", "a box", "box")
        low = -LARGEST_PIXELS
        xc, yc = (self._number(box, name, low=low) for name in ("xc", "yc"))
        width, height = (self._number(box, name, low=0.0) for name in ("w", "h"))
        feet = [self._point(element.find(f"body/feet/{side}")) for side in ("left", "right")]
        finite_feet = [foot for foot in feet if np.isfinite(foot[0])]
        foot = (
            tuple(float(np.mean(axis)) for axis in zip(*finite_feet, strict=True))
            if finite_feet
            else (np.nan, np.nan)
        )
        head = element.find("body/head")
        gaze = -1.0
        if head is not None and head.get("gaze") is not None:
            gaze = self._number(head, "gaze", 360.0, low=-360.0)
        return _Observation(
            frame,
            int(self._number(element, "id", LARGEST_ID, low=0.0, integer=True)),
            (xc, yc, width, height),
            (foot[0], foot[1]),
            self._point(element.find("body/shoulders/left")),
            self._point(element.find("body/shoulders/right")),
            self._point(head),
            float("nan") if gaze == -1.0 else float(np.deg2rad(gaze)),
        )

    def _point(self, element: Element | None) -> tuple[float, float]:
        """Return the pixel of a part of the body; NaN where it is not labelled."""
        if element is None or element.get("xc") is None or element.get("yc") is None:
            return float("nan"), float("nan")
        low = -LARGEST_PIXELS
        return self._number(element, "xc", low=low), self._number(element, "yc", low=low)

    def _number(
        self,
        element: Element,
        name: str,
        high: float = LARGEST_PIXELS,
        *,
        low: float | None = None,
        integer: bool = False,
    ) -> float:
        low = -high if low is None else low
        text = element.get(name)
        value = None if text is None else parse_number(text)
        if value is None or not low <= value <= high or (integer and value != int(value)):
            found = f"<{element.tag}> without it" if text is None else repr(text[:40])
            kind = "whole number" if integer else "number"
            raise self._fail(found, f"a {kind} from {low:g} to {high:g}", f"{element.tag} {name}")
        return value

    def _fail(self, found: str, expected: str, column: str) -> InputError:
        line = _line_of_object(self._source, self._objects)
        return self._source.fail(found, expected, line=line, column=column)


def _line_of_object(source: Source, index: int) -> int:
    """Return the line of the ``index``-th object of the file, counted only for a message."""
    places = (match.start() for match in re.finditer(rb"<object[\s>]", source.data))
    place = max(islice(places, index + 1), default=0)
    return source.data.count(b"\n", 0, place) + 1


CAVIAR = Format(
    name="caviar",
    description="CAVIAR ground truth (XML)",
    suffixes=(".xml",),
    read=read,
    read_boxes=read_boxes,
)
