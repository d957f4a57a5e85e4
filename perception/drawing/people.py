"""Drawing of observed, estimated and tracked people into their frames."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import cv2
import numpy as np

from graphtrack.geometry.angles import FloatArray
from graphtrack.geometry.camera import GroundCamera
from graphtrack.tracks.track import BODY_CLASSES, HEAD_CLASSES
from perception.drawing import overlays
from perception.drawing.overlays import FONT, DrawnDirection, Likelihoods, Place
from perception.images.pixels import Image
from perception.observation.pipeline import FrameObservation, head_in_image
from perception.observation.tables import ObservedTracks
from perception.pose.classes import PoseClasses
from perception.trackers.tracker import BoxEstimate

_BODY, _HEAD = PoseClasses.circle(BODY_CLASSES), PoseClasses.circle(HEAD_CLASSES)
_RADII = 0.8, 0.6  # metres on the ground, of the arrows of body and head
_HEAD_BELOW = 0.08  # depth of the head's middle below the top of a box without a known head, in its heights


@dataclass(frozen=True, eq=False)
class DrawnPerson:
    """An observed or estimated person in one frame.

    Attributes
    ----------
    track_id : determines the colour
    box : (4,) left, top, width, height in pixels
    position : (2,) metres
    body, head : directions in the world; None where not known
    head_box : (4,) as ``box``; None where not known
    visible : whether the person was observed; else the box is predicted, and dashed
    path : (n, 2) pixels on the ground, of the last seconds
    """

    track_id: int
    box: FloatArray
    position: FloatArray
    body: DrawnDirection | None
    head: DrawnDirection | None
    head_box: FloatArray | None = None
    visible: bool = True
    path: FloatArray = field(default_factory=lambda: np.empty((0, 2)))

    def planes(self, camera: GroundCamera, factor: int) -> tuple[Place, Place]:
        """Return the ground at the feet and its copy at the head, in a drawing enlarged by ``factor``."""
        head = self.box * (1.0, 1.0, 1.0, 2.0 * _HEAD_BELOW) if self.head_box is None else self.head_box
        middle = head[:2] + head[2:] / 2.0
        return overlays.planes(camera, self.position, middle, _RADII, lambda pixel: pixel * factor)


def people_by_frame(
    observed: ObservedTracks, frames: Mapping[int, FrameObservation]
) -> dict[int, list[DrawnPerson]]:
    """Return the people to draw in each frame, from tracks and their observations."""
    row_of = {
        (track.track_id, frame): (track, row)
        for track in observed.tracks
        for row, frame in enumerate(track.frame.tolist())
    }
    found: dict[int, list[DrawnPerson]] = {}
    for number in sorted(frames):
        for item in sorted(frames[number].people, key=lambda item: item.track_id):
            if (item.track_id, number) not in row_of:
                continue
            track, row = row_of[item.track_id, number]
            assert track.body_likelihood is not None and track.head_likelihood is not None
            person = DrawnPerson(
                track.track_id,
                np.array(item.box),
                track.position[row],
                Likelihoods(track.body_likelihood[row], _BODY),
                Likelihoods(track.head_likelihood[row], _HEAD),
                head_in_image(item, int(observed.heads[track.track_id][row])),
            )
            found.setdefault(number, []).append(person)
    return found


def draw_people(image: Image, words: str, people: Sequence[DrawnPerson], camera: GroundCamera) -> Image:
    """Draw a frame with people's boxes, ids and paths in individual colours, and body and head directions.

    Marks on the ground at the feet show the directions with 95 % of the body's probability, and an arrow the
    likeliest one. Lighter marks at the head show the same for the head.

    Parameters
    ----------
    words : text in the corner
    camera : over the ground
    """
    picture, factor = overlays.enlarged_image(image), overlays.enlargement(image)
    width = overlays.line_width(picture)
    people = sorted(people, key=lambda person: float(person.box[1] + person.box[3]))  # nearer people in front
    for person in people:
        path = person.path[np.isfinite(person.path).all(axis=1)] * factor
        if len(path) > 1:
            for shade, wide in ((overlays.DARK, width + 2), (overlays.person_colour(person.track_id), width)):
                cv2.polylines(
                    picture, [overlays.points(path)], False, shade, wide, cv2.LINE_AA, overlays.FRACTION
                )
    for person in people:  # sectors before boxes, so that they hide none
        colours = overlays.person_colour(person.track_id), overlays.LIGHT
        for angle, place, colour in zip(_angles(person), person.planes(camera, factor), colours, strict=True):
            if angle is not None:
                angle.shade(picture, place, colour)
    for person in people:
        colour = overlays.person_colour(person.track_id)
        (overlays.box if person.visible else overlays.dashed_box)(picture, person.box * factor, colour, width)
        if person.head_box is not None:
            overlays.box(picture, person.head_box * factor, overlays.LIGHT, width)
        arrows = ((colour, 2 * width), (overlays.LIGHT, width))
        for angle, place, mark in zip(_angles(person), person.planes(camera, factor), arrows, strict=True):
            if angle is not None:
                overlays.arrow(picture, place, angle.likeliest, *mark)
        overlays.identity(picture, person.track_id, person.box * factor, colour, width)
    overlays.text(picture, words, (8, round(16 + 12 * width)), overlays.LIGHT, 0.3 + 0.25 * width)
    return picture


def _angles(person: DrawnPerson) -> tuple[DrawnDirection | None, DrawnDirection | None]:
    return person.body, person.head


_FOUND, _LOST, _PARTICLE = (80, 220, 80), (80, 80, 230), (240, 200, 60)
_PAN = (60, 240, 255)
_TEXT, _PANEL, _TRACK = (225, 225, 225), (38, 38, 38), (80, 80, 80)
_PANEL_WIDTH = 190
_ROW = 24


def draw(image: Image, number: int, estimate: BoxEstimate, pan_classes: PoseClasses | None = None) -> Image:
    """Draw a frame with an estimate, and a panel on its right; the size is constant for a video.

    Parameters
    ----------
    number : of the frame
    pan_classes : of the tracker; None for one without pans
    """
    factor = overlays.enlargement(image)
    shown = overlays.enlarged_image(image)
    _particles(shown, estimate, factor)
    if estimate.pan is not None and pan_classes is not None:
        _pointer(shown, estimate, pan_classes, factor)
    _box(shown, estimate, factor)
    panel = np.full((shown.shape[0], _PANEL_WIDTH, 3), _PANEL, np.uint8)
    _panel(panel, number, estimate, pan_classes)
    return np.asarray(np.hstack([shown, panel]), np.uint8)


def _particles(shown: Image, estimate: BoxEstimate, factor: int) -> None:
    """Draw the middles of the particles, with size by weight."""
    centres = estimate.particles[:, :2] + estimate.particles[:, 2:] / 2.0
    share = estimate.weights / max(float(estimate.weights.max()), 1e-300)
    for (u, v), weight in zip((centres * factor).round().astype(int).tolist(), share.tolist(), strict=True):
        cv2.circle(shown, (u, v), 1 + round(2.0 * weight), _PARTICLE, -1, cv2.LINE_AA)


def _box(shown: Image, estimate: BoxEstimate, factor: int) -> None:
    left, top, width, height = (value * factor for value in estimate.box)
    overlays.box(shown, (left, top, width, height), _FOUND if estimate.found else _LOST, 2)
    if not estimate.found:
        first, last = (round(left), round(top)), (round(left + width), round(top + height))
        cv2.line(shown, first, last, _LOST, 1, cv2.LINE_AA)
        overlays.text(shown, "not found", (10, 26), _LOST, 0.7)


def _pointer(shown: Image, estimate: BoxEstimate, pan_classes: PoseClasses, factor: int) -> None:
    """Draw the face's direction from above: down is to the camera, right the image's right."""
    assert estimate.pan is not None
    length = 0.9 * estimate.box[3] * factor

    def place(offset: FloatArray) -> FloatArray:
        return np.asarray(estimate.centre * factor + length * offset[:, ::-1], float)

    Likelihoods(estimate.pan, pan_classes).shade(shown, place, _PAN)
    overlays.arrow(shown, place, float(pan_classes.mean_of(estimate.pan)), _PAN, 2)


def _panel(panel: Image, number: int, estimate: BoxEstimate, pan_classes: PoseClasses | None) -> None:
    """Write frame, pan and tilt, and draw a bar for the confidence and each cue."""
    lines = [f"frame {number}"]
    if estimate.pan is not None and pan_classes is not None:
        lines.append(f"pan {np.rad2deg(pan_classes.mean_of(estimate.pan)):+.0f} deg")
    if estimate.tilt is not None:
        lines.append(f"tilt {np.rad2deg(estimate.tilt):+.0f} deg")
    for k, line in enumerate(lines):
        cv2.putText(panel, line, (10, 22 + _ROW * k), FONT, 0.5, _TEXT, 1, cv2.LINE_AA)
    bars = {"confidence": estimate.confidence, **estimate.cues}
    # Cues are in 0…1; larger values, such as reliabilities, are drawn relative to the largest.
    greatest = max(1.0, *(value for value in bars.values() if np.isfinite(value)))
    rows = range(10 + _ROW * len(lines), len(panel) - _ROW, _ROW)
    for row, (name, value) in zip(rows, bars.items(), strict=False):
        _bar(panel, row, name, value, greatest if name.startswith("reliability") else 1.0)


def _bar(panel: Image, row: int, name: str, value: float, full: float) -> None:
    """Draw a bar with its full length at ``full``."""
    width = _PANEL_WIDTH - 20
    share = float(np.clip(value / full, 0.0, 1.0)) if np.isfinite(value) else 0.0
    # OpenCV's font is ASCII; long names are written smaller to fit.
    text = f"{name} {value:.2f}".replace("·", " x ").encode("ascii", "replace").decode()
    length = cv2.getTextSize(text, FONT, 0.4, 1)[0][0]
    cv2.putText(panel, text, (10, row + 12), FONT, 0.4 * min(1.0, width / length), _TEXT, 1, cv2.LINE_AA)
    cv2.rectangle(panel, (10, row + 16), (10 + width, row + 20), _TRACK, -1)
    cv2.rectangle(panel, (10, row + 16), (10 + round(share * width), row + 20), _PARTICLE, -1)
