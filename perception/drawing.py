"""What a tracker says, drawn: particles, box, pan and cues; as a video or a folder of images."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import cv2
import numpy as np

from graphtrack.errors import InputError
from graphtrack.io.atomic import atomic_path
from perception.classes import PoseClasses
from perception.images import Image
from perception.trackers.tracker import BoxEstimate

_VIDEOS = {".mp4": "mp4v", ".avi": "MJPG"}
_FOUND, _LOST, _PARTICLE = (80, 220, 80), (80, 80, 230), (240, 200, 60)
_TEXT, _PANEL, _TRACK = (225, 225, 225), (38, 38, 38), (80, 80, 80)
_PANEL_WIDTH = 190
_LEAST_HEIGHT = 400
"""Rows: smaller images are drawn enlarged, so that text and particles can be told apart."""
_ROW = 24
_FONT = cv2.FONT_HERSHEY_SIMPLEX

Show = Callable[[int, Image, BoxEstimate], None]


def draw(image: Image, number: int, estimate: BoxEstimate, pan_classes: PoseClasses | None = None) -> Image:
    """A frame with everything in an estimate, and a panel on its right; always of one size for one video.

    Parameters
    ----------
    number : of the frame
    pan_classes : of the tracker; None for one without pans
    """
    factor = max(1, -(-_LEAST_HEIGHT // image.shape[0]))
    shown = cv2.resize(image, None, fx=factor, fy=factor, interpolation=cv2.INTER_LINEAR)
    _particles(shown, estimate, factor)
    _box(shown, estimate, factor)
    if estimate.pan is not None and pan_classes is not None:
        _arrow(shown, estimate, pan_classes, factor)
    panel = np.full((shown.shape[0], _PANEL_WIDTH, 3), _PANEL, np.uint8)
    _panel(panel, number, estimate, pan_classes)
    return np.asarray(np.hstack([shown, panel]), np.uint8)


def mean_pan(estimate: BoxEstimate, pan_classes: PoseClasses) -> float:
    """Circular mean (radians, image frame) of the tracker's distribution of the pan."""
    assert estimate.pan is not None
    return float(pan_classes.mean_of(estimate.pan))


def _particles(shown: Image, estimate: BoxEstimate, factor: int) -> None:
    """Middles of the particles; the heavier one, the larger."""
    centres = estimate.particles[:, :2] + estimate.particles[:, 2:] / 2.0
    share = estimate.weights / max(float(estimate.weights.max()), 1e-300)
    for (u, v), weight in zip((centres * factor).round().astype(int).tolist(), share.tolist(), strict=True):
        cv2.circle(shown, (u, v), 1 + round(2.0 * weight), _PARTICLE, -1, cv2.LINE_AA)


def _box(shown: Image, estimate: BoxEstimate, factor: int) -> None:
    left, top, width, height = (value * factor for value in estimate.box)
    first, last = (round(left), round(top)), (round(left + width), round(top + height))
    cv2.rectangle(shown, first, last, _FOUND if estimate.found else _LOST, 2, cv2.LINE_AA)
    if not estimate.found:
        cv2.line(shown, first, last, _LOST, 1, cv2.LINE_AA)
        cv2.putText(shown, "not found", (10, 26), _FONT, 0.7, _LOST, 2, cv2.LINE_AA)


def _arrow(shown: Image, estimate: BoxEstimate, pan_classes: PoseClasses, factor: int) -> None:
    """Where the face points, seen from above: down is to the camera, right the image's right."""
    left, top, width, height = (value * factor for value in estimate.box)
    pan = mean_pan(estimate, pan_classes)
    start = np.array([left + width / 2.0, top + height / 2.0])
    end = start + 0.9 * height * np.array([np.sin(pan), np.cos(pan)])
    points = [tuple(int(value) for value in point.round()) for point in (start, end)]
    cv2.arrowedLine(shown, points[0], points[1], (40, 40, 40), 5, cv2.LINE_AA, tipLength=0.25)
    cv2.arrowedLine(shown, points[0], points[1], (60, 240, 255), 2, cv2.LINE_AA, tipLength=0.25)


def _panel(panel: Image, number: int, estimate: BoxEstimate, pan_classes: PoseClasses | None) -> None:
    cv2.putText(panel, f"frame {number}", (10, 22), _FONT, 0.5, _TEXT, 1, cv2.LINE_AA)
    row = 34
    bars = {"confidence": estimate.confidence, **estimate.cues}
    # Cues are shares; what goes beyond 1, such as reliabilities, is drawn against the greatest.
    greatest = max(1.0, *(value for value in bars.values() if np.isfinite(value)))
    for name, value in bars.items():
        if row + _ROW > len(panel):
            return
        _bar(panel, row, name, value, greatest if name.startswith("reliability") else 1.0)
        row += _ROW
    if estimate.pan is not None and pan_classes is not None and row + 150 <= len(panel):
        _clock(panel, (_PANEL_WIDTH // 2, row + 85), estimate, pan_classes)


def _bar(panel: Image, row: int, name: str, value: float, full: float) -> None:
    """A bar that is full at ``full``."""
    whole = _PANEL_WIDTH - 20
    share = float(np.clip(value / full, 0.0, 1.0)) if np.isfinite(value) else 0.0
    # OpenCV's letters are ASCII; a long name is written smaller, so that its end is seen.
    text = f"{name} {value:.2f}".replace("·", " x ").encode("ascii", "replace").decode()
    length = cv2.getTextSize(text, _FONT, 0.4, 1)[0][0]
    cv2.putText(panel, text, (10, row + 12), _FONT, 0.4 * min(1.0, whole / length), _TEXT, 1, cv2.LINE_AA)
    cv2.rectangle(panel, (10, row + 16), (10 + whole, row + 20), _TRACK, -1)
    cv2.rectangle(panel, (10, row + 16), (10 + round(share * whole), row + 20), _PARTICLE, -1)


def _clock(panel: Image, middle: tuple[int, int], estimate: BoxEstimate, pan_classes: PoseClasses) -> None:
    """The distribution of the pan around a circle, 0 below and +90° right, and a hand at its mean."""
    assert estimate.pan is not None
    centre, radius = np.array(middle), 48.0
    cv2.circle(panel, middle, round(radius), _TRACK, 1, cv2.LINE_AA)
    highest = max(float(estimate.pan.max()), 1e-300)
    for pan, p in zip(pan_classes.pan.tolist(), (estimate.pan / highest).tolist(), strict=True):
        out = np.array([np.sin(pan), np.cos(pan)])
        ends = [centre + r * out for r in (radius, radius + 1.0 + 18.0 * p)]
        points = [tuple(int(value) for value in end.round()) for end in ends]
        cv2.line(panel, points[0], points[1], _PARTICLE, 3, cv2.LINE_AA)
    pan = mean_pan(estimate, pan_classes)
    tip = centre + 0.85 * radius * np.array([np.sin(pan), np.cos(pan)])
    cv2.arrowedLine(panel, middle, tuple(int(value) for value in tip.round()), (60, 240, 255), 2, cv2.LINE_AA)
    text = f"pan {np.rad2deg(pan):+.0f} deg"
    cv2.putText(panel, text, (middle[0] - 42, middle[1] - 72), _FONT, 0.4, _TEXT, 1, cv2.LINE_AA)


def check_render(path: Path) -> None:
    """Refuse, before any work is done, where no pictures could be written.

    Raises
    ------
    InputError
        For another suffix than .mp4, .avi or none, or a folder that is missing or holds something.
    """
    if path.suffix and not path.is_dir() and path.suffix.lower() not in _VIDEOS:
        raise InputError(f"{path.suffix} files", "a video .mp4 or .avi, or a folder", path=path)
    if not path.absolute().parent.is_dir():
        raise InputError(f"no folder {path.parent}", "a folder that exists", path=path)
    if path.is_dir() and any(path.iterdir()):
        raise InputError("a folder that is not empty", "a new or an empty folder, or a video", path=path)


@contextmanager
def renderer(path: Path, fps: float, pan_classes: PoseClasses | None = None) -> Iterator[Show]:
    """A function that draws one frame after the other; video or folder are there when all went well.

    Parameters
    ----------
    path : .mp4 or .avi; without suffix, or where there is one, a folder of images named by their frames
    fps : frames a second of the video

    Raises
    ------
    InputError
        If the place cannot be written to.
    """
    check_render(path)
    folder = path.is_dir() or not path.suffix
    with atomic_path(path, directory=folder) as temporary:
        if folder:

            def save(number: int, image: Image, estimate: BoxEstimate) -> None:
                picture = draw(image, number, estimate, pan_classes)
                cv2.imwrite(str(temporary / f"{number:06d}.png"), picture)

            yield save
            return
        with _video(temporary, fps) as write:
            yield lambda number, image, estimate: write(draw(image, number, estimate, pan_classes))


@contextmanager
def _video(path: Path, fps: float) -> Iterator[Callable[[Image], None]]:
    """A function that adds a picture; the video is opened with the size of the first."""
    writer: cv2.VideoWriter | None = None

    def write(picture: Image) -> None:
        nonlocal writer
        if writer is None:
            code = cv2.VideoWriter.fourcc(*_VIDEOS[path.suffix.lower()])
            writer = cv2.VideoWriter(str(path), code, fps, (picture.shape[1], picture.shape[0]))
            if not writer.isOpened():
                raise InputError(
                    "a video that cannot be opened for writing", "another name or a folder", path=path
                )
        writer.write(picture)

    try:
        yield write
    finally:
        if writer is not None:
            writer.release()
