"""What a tracker says of a frame, drawn: particles, box, pan, tilt and cues."""

from __future__ import annotations

import cv2
import numpy as np

from graphtrack.geometry.angles import FloatArray
from perception.images.drawing import marks
from perception.images.drawing.marks import FONT
from perception.images.pixels import Image
from perception.pose.classes import PoseClasses
from perception.trackers.tracker import BoxEstimate

_FOUND, _LOST, _PARTICLE = (80, 220, 80), (80, 80, 230), (240, 200, 60)
_PAN = (60, 240, 255)
_TEXT, _PANEL, _TRACK = (225, 225, 225), (38, 38, 38), (80, 80, 80)
_PANEL_WIDTH = 190
_ROW = 24


def draw(image: Image, number: int, estimate: BoxEstimate, pan_classes: PoseClasses | None = None) -> Image:
    """A frame with everything in an estimate, and a panel on its right; always of one size for one video.

    Parameters
    ----------
    number : of the frame
    pan_classes : of the tracker; None for one without pans
    """
    factor = marks.enlargement(image)
    shown = marks.enlarged_image(image)
    _particles(shown, estimate, factor)
    if estimate.pan is not None and pan_classes is not None:
        _pointer(shown, estimate, pan_classes, factor)
    _box(shown, estimate, factor)
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
    marks.box(shown, (left, top, width, height), _FOUND if estimate.found else _LOST, 2)
    if not estimate.found:
        first, last = (round(left), round(top)), (round(left + width), round(top + height))
        cv2.line(shown, first, last, _LOST, 1, cv2.LINE_AA)
        marks.text(shown, "not found", (10, 26), _LOST, 0.7)


def _pointer(shown: Image, estimate: BoxEstimate, pan_classes: PoseClasses, factor: int) -> None:
    """Where the face points, seen from above: down is to the camera, right the image's right."""
    assert estimate.pan is not None
    length = 0.9 * estimate.box[3] * factor

    def place(offset: FloatArray) -> FloatArray:
        return np.asarray(estimate.centre * factor + length * offset[:, ::-1], float)

    marks.fan(shown, place, estimate.pan, pan_classes, _PAN)
    marks.arrow(shown, place, mean_pan(estimate, pan_classes), _PAN, 2)


def _panel(panel: Image, number: int, estimate: BoxEstimate, pan_classes: PoseClasses | None) -> None:
    cv2.putText(panel, f"frame {number}", (10, 22), FONT, 0.5, _TEXT, 1, cv2.LINE_AA)
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
        row += 160
    if estimate.tilt is not None and row + 120 <= len(panel):
        _level(panel, (_PANEL_WIDTH // 2 - 24, row + 68), estimate.tilt)


def _bar(panel: Image, row: int, name: str, value: float, full: float) -> None:
    """A bar that is full at ``full``."""
    whole = _PANEL_WIDTH - 20
    share = float(np.clip(value / full, 0.0, 1.0)) if np.isfinite(value) else 0.0
    # OpenCV's letters are ASCII; a long name is written smaller, so that its end is seen.
    text = f"{name} {value:.2f}".replace("·", " x ").encode("ascii", "replace").decode()
    length = cv2.getTextSize(text, FONT, 0.4, 1)[0][0]
    cv2.putText(panel, text, (10, row + 12), FONT, 0.4 * min(1.0, whole / length), _TEXT, 1, cv2.LINE_AA)
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
    cv2.arrowedLine(panel, middle, tuple(int(value) for value in tip.round()), _PAN, 2, cv2.LINE_AA)
    text = f"pan {round(float(np.rad2deg(pan))):+d} deg"
    cv2.putText(panel, text, (middle[0] - 42, middle[1] - 72), FONT, 0.4, _TEXT, 1, cv2.LINE_AA)


def _level(panel: Image, middle: tuple[int, int], tilt: float) -> None:
    """The tilt, seen from the side: level to the right, the hand above it where the head looks up."""
    radius = 48
    cv2.ellipse(panel, middle, (radius, radius), 0, -90, 90, _TRACK, 1, cv2.LINE_AA)
    cv2.line(panel, middle, (middle[0] + radius, middle[1]), _TRACK, 1, cv2.LINE_AA)
    tip = (round(middle[0] + 0.85 * radius * np.cos(tilt)), round(middle[1] - 0.85 * radius * np.sin(tilt)))
    cv2.arrowedLine(panel, middle, tip, _PAN, 2, cv2.LINE_AA)
    text = f"tilt {round(float(np.rad2deg(tilt))):+d} deg"
    cv2.putText(panel, text, (middle[0] - 18, middle[1] - 54), FONT, 0.4, _TEXT, 1, cv2.LINE_AA)
