"""Heads of CAVIAR's lobby cut out of its frames at the labelled points, as Baxter et al. (2014) do
(§IV-C)."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from graphtrack.evaluation.reproduce.experiment import quietly
from graphtrack.geometry.angles import FloatArray
from graphtrack.geometry.camera import GroundCamera
from graphtrack.io.readers.caviar import LOBBY_HEIGHT, lobby_camera, read_heads
from graphtrack.io.source import Source
from graphtrack.tracks import Track
from perception.images.frames import FrameSource
from perception.images.pixels import Image

LEAST_FRAMES = 20
"""Frames with pixels and a labelled head, of a person who is taken."""

_HEAD_HEIGHT, _HEAD_SIZE = 1.6, 0.27
"""Metres above the floor, as the lobby's camera was found with, and across with the margin of training."""
_SIDE = 32


@dataclass(frozen=True, eq=False)
class PersonWithHeads:
    """A person's frames of which the pixels are there.

    Attributes
    ----------
    name : sequence and number
    track : as labelled, these frames alone
    images : of the heads, upright
    pan : (n,) labelled, radians in the frame of those images
    size : (n,) pixels of the heads in the frames
    """

    name: str
    track: Track
    images: list[Image]
    pan: FloatArray
    size: FloatArray


def people_with_heads(folder: Path) -> list[PersonWithHeads]:
    """Everybody with `LEAST_FRAMES` labelled heads among the frames of ``folder``, a CAVIAR folder.

    It has ``xml/NAME.xml``, and frames in ``frames/NAME`` named by their numbers.
    """
    found: list[PersonWithHeads] = []
    for path in sorted(folder.glob("xml/*.xml")):
        frames = folder / "frames" / path.stem
        if frames.is_dir():
            found += _people_of(path, frames)
    return found


def _people_of(path: Path, frames: Path) -> list[PersonWithHeads]:
    gazes = [track for track in quietly(path) if track.head is not None]
    labelled = {int(k) for track in gazes for k in track.frame[np.isfinite(np.asarray(track.head))]}
    pictures = {
        frame.number: frame.image
        for frame in FrameSource.open(frames).where(lambda number: number in labelled)
        if frame.image is not None
    }
    rows = read_heads(Source.open(path))
    whose = zip(rows.track_id.tolist(), rows.frame.tolist(), strict=True)
    place = dict(zip(whose, rows.channels["head"], strict=True))
    camera, found = lobby_camera(), []
    for track in gazes:
        assert track.head is not None
        usable = [
            k
            for k, frame in enumerate(track.frame.tolist())
            if np.isfinite(track.head[k]) and frame in pictures and (track.track_id, frame) in place
        ]
        if len(usable) < LEAST_FRAMES:
            continue
        part = track[np.array(usable)]
        assert part.head is not None and part.pixel is not None
        cut = []
        for frame, pixel in zip(part.frame.tolist(), part.pixel, strict=True):
            head = place[track.track_id, frame]
            cut.append((upright_head(pictures[frame], head, pixel, camera), head_size(head, camera)))
        found.append(
            PersonWithHeads(
                f"{path.stem} {track.track_id}",
                part,
                [image for image, _ in cut],
                camera.image_angle(part.head, part.position),
                np.array([size for _, size in cut]),
            )
        )
    return found


def head_size(head: FloatArray, camera: GroundCamera) -> float:
    """Pixels across a head whose middle is at a pixel (2,).

    What is at a height is seen larger than the ground behind it, by the ratio of the distances; the ground,
    unlike a head, is also foreshortened, but not across the ray.
    """
    steps = 0.5 * np.array([[1.0, 0.0], [0.0, 1.0]])
    # By differences of raw pixels: `GroundCamera.ground_jacobian` is of those without the lens's distortion.
    slope = camera.image_to_ground(head + steps) - camera.image_to_ground(head - steps)
    metres = float(np.linalg.svd(slope, compute_uv=False).min())
    return _HEAD_SIZE / (metres * (LOBBY_HEIGHT - _HEAD_HEIGHT) / LOBBY_HEIGHT)


def upright_head(image: Image, head: FloatArray, foot: FloatArray, camera: GroundCamera) -> Image:
    """A head (32, 32, 3), turned so that its person stands upright: the lobby is seen from above."""
    up = head - foot
    turn = np.degrees(np.arctan2(up[0], -up[1]))
    zoom = _SIDE / head_size(head, camera)
    centre = (float(head[0]), float(head[1]))
    turned = cv2.getRotationMatrix2D(centre, float(turn), zoom)
    turned[:, 2] += _SIDE / 2.0 - head
    shown = cv2.warpAffine(
        image, turned, (_SIDE, _SIDE), flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
    )
    return np.asarray(shown, np.uint8)
