"""What a report shows: the video, the view from above, and the page."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from graphtrack.behaviour.attention import attention
from graphtrack.behaviour.groups import groups
from graphtrack.geometry.camera import GroundCamera
from graphtrack.io.atomic import atomic_path
from graphtrack.report.behaviour.given import Behaviour, behaviour_of
from graphtrack.report.build import tracking_report
from graphtrack.report.content import Card, Note, Picture, Section
from graphtrack.report.html import write_html
from graphtrack.report.plots.scene import plot_tracks
from graphtrack.tracks import TrackSet
from perception.images.drawing.output import pictures
from perception.images.drawing.tracked import ShownPerson, draw_tracked
from perception.images.frames import Frame
from perception.images.pixels import Image

_PHOTOS, _PHOTO_WIDTH, _QUALITY = 6, 1100, 85


def write_video(
    path: Path,
    frames: Iterable[Frame],
    people: Mapping[int, Sequence[ShownPerson]],
    camera: GroundCamera,
    rate: float,
) -> int:
    """Write the frames with their people; how many there are. One at a time is in memory."""
    count = 0
    with pictures(path, rate) as write:
        for frame in frames:
            if frame.image is not None:
                words = f"frame {frame.number}  {frame.number / rate:.2f} s"
                write(frame.number, draw_tracked(frame.image, words, people.get(frame.number, ()), camera))
                count += 1
    return count


def write_above(path: Path, estimates: TrackSet, observations: TrackSet) -> None:
    """Write a picture of everybody's path from above."""
    figure = plot_tracks(estimates, observations)
    with atomic_path(path) as temporary:
        figure.savefig(temporary, format="png", dpi=160)


def write_page(
    path: Path,
    title: str,
    estimates: TrackSet,
    observations: TrackSet,
    video: Path,
    assumptions: Sequence[str],
    cards: tuple[Card, ...] = (),
) -> None:
    """Write the page, with some frames of the annotated video in it."""
    photos = tuple(
        Picture(f"Frame {k + 1} of {count} that were drawn", data, _DESCRIPTION)
        for k, count, data in _photos(video)
    )
    words = Note(f"All frames are in {video.name}. {_DESCRIPTION}")
    report = tracking_report(
        estimates,
        observations,
        title=title,
        cards=cards,
        behaviour=what_they_do(estimates),
        sections=(
            Section("Frames", (words, *photos)),
            Section("What was assumed", tuple(Note(line) for line in assumptions)),
        ),
    )
    write_html(path, report)


def what_they_do(estimates: TrackSet) -> Behaviour | None:
    """Who is in a group with whom and, where heads are known, who looks at whom; None of fewer than two."""
    if len(estimates) < 2:
        return None
    found = groups(estimates)
    known = any(track.head is not None and np.isfinite(track.head).any() for track in estimates)
    looks = attention(estimates, groups=found) if known else None
    return behaviour_of(estimates, groups=found, attention=looks)


_DESCRIPTION = (
    "Boxes and ids in everybody's colour, dashed where nobody was seen and the estimate stands; on the "
    "ground the path of the last seconds, an arrow along the body and the sector that holds it with 95 %; at "
    "the head the same of the head, light."
)


def _photos(video: Path) -> list[tuple[int, int, bytes]]:
    """Numbers of frames of a video, from 0, how many it has, and the frames, evenly chosen, as JPEG."""
    reader = cv2.VideoCapture(str(video.absolute()))
    found = []
    try:
        count = int(reader.get(cv2.CAP_PROP_FRAME_COUNT))
        wanted = set(np.linspace(0, count - 1, min(_PHOTOS, count)).round().astype(int).tolist())
        for k in range(count):
            if not reader.grab():
                break
            if k in wanted:
                good, image = reader.retrieve()
                if good:
                    found.append((k, count, _as_jpeg(np.asarray(image, np.uint8))))
    finally:
        reader.release()
    return found


def _as_jpeg(image: Image) -> bytes:
    factor = min(1.0, _PHOTO_WIDTH / image.shape[1])
    small = cv2.resize(image, None, fx=factor, fy=factor, interpolation=cv2.INTER_AREA)
    _, data = cv2.imencode(".jpg", small, [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])
    encoded: NDArray[np.uint8] = np.asarray(data, np.uint8)
    return encoded.tobytes()
