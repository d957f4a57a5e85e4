"""Folders of rendered clips and crops with boxes, camera, labels and truth; contact sheets."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

import cv2
import numpy as np

from graphtrack.errors import InputError
from graphtrack.io import atomic_path, write
from graphtrack.io.cameras import write_calibration
from graphtrack.io.read_write import write_table
from graphtrack.tracks.track import Track, TrackSet
from perception.detection.boxes import PersonBox, as_points, write_boxes
from perception.detection.keypoint_files import write_keypoints
from perception.images.encoding import pictures
from perception.images.pixels import Image
from perception.synthetic.cameras import Camera
from perception.synthetic.ceiling import ALL_KINDS as CEILING_KINDS
from perception.synthetic.ceiling import CeilingSequence, ceiling_sequence
from perception.synthetic.clips import Walks, draw_walks
from perception.synthetic.head_clips import HeadClipParameters, head_clip
from perception.synthetic.heads import HeadVariation, make_heads
from perception.synthetic.pedestrians import make_pedestrians
from perception.synthetic.skeletons import projected_keypoints


def contact_sheet(images: Sequence[Image], columns: int, cell: tuple[int, int] = (64, 64)) -> Image:
    """Arrange crops (h, w, 3) in rows of cells (width, height), enlarged without smoothing."""
    width, height = cell
    sheet = np.zeros((-(-len(images) // columns) * height, columns * width, 3), np.uint8)
    for k, image in enumerate(images):
        factor = min(width / image.shape[1], height / image.shape[0])
        shown = cv2.resize(image, None, fx=factor, fy=factor, interpolation=cv2.INTER_NEAREST)[
            :height, :width
        ]
        top, left = k // columns * height, k % columns * width
        sheet[top : top + shown.shape[0], left : left + shown.shape[1]] = shown
    return sheet


VIDEO, IMAGES, BOXES, TRUTH, LABELS = "video.mp4", "images", "boxes.txt", "truth.csv", "labels.csv"
HOMOGRAPHY, CALIBRATION, KEYPOINTS = "homography.txt", "camera.ci", "keypoints.json"

Advance = Callable[[int], None]
TARGETS = {"person": "person moving 1", "robot": "robot moving"}
"""Target in the room → kind of the sequence."""
_BATCH = 20
_UNTIL_THERE = 30
_ALL_WAYS = HeadVariation(tilt_deviation=None)
"""Heads with enough tilts for every class of pan and tilt."""


def write_street(
    folder: Path,
    rng: np.random.Generator,
    advance: Advance,
    *,
    people: int = 3,
    frames: int = 25,
    fps: float = 5.0,
    images: bool = False,
) -> list[PersonBox]:
    """Write walking people: frames, boxes with a detector's errors, keypoints, camera and ground truth.

    Like all of `KINDS` it creates the folder atomically, and returns the boxes, if there are any.

    Parameters
    ----------
    advance : receives the number of newly completed frames or crops
    images : whether the frames are images in a folder, named by their numbers, instead of a video
    """
    walks = draw_walks(rng, people=people, steps=frames, fps=fps)
    camera = walks.scene.camera
    with atomic_path(folder, directory=True) as made:
        boxes = _write_frames(made, walks.frames(rng), fps, images, advance)
        np.savetxt(made / HOMOGRAPHY, camera.ground_camera().homography)
        _write_camera(made, camera)
        write(walks.truth, made / TRUTH)
        _write_keypoints(made / KEYPOINTS, walks, boxes, rng)
    return boxes


def _write_keypoints(path: Path, walks: Walks, boxes: Iterable[PersonBox], rng: np.random.Generator) -> None:
    """Write the simulated output of a pose network for the people in boxes, as COCO results."""
    place = {track.track_id: number for number, track in enumerate(walks.truth)}
    found = []
    for item in boxes:
        person = walks.people(item.frame)[place[item.track_id]]
        points = projected_keypoints(person, walks.scene.camera, walks.scene.furniture, rng)
        found.append(replace(item, keypoints=as_points(points), confidence=0.9))
    write_keypoints(found, path)


def write_ceiling(
    folder: Path,
    rng: np.random.Generator,
    advance: Advance,
    *,
    frames: int = 150,
    fps: float = 12.5,
    images: bool = False,
    target: str = "person",
) -> list[PersonBox]:
    """Write a person entering a room under a fisheye camera: frames, exact boxes, camera, ground truth.

    Parameters
    ----------
    target : "person", or "robot" for a mobile robot

    Raises
    ------
    InputError
        For too few frames until the entrance, or another target.
    """
    if target not in TARGETS:
        raise InputError(f"--target {target}", f"one of {', '.join(TARGETS)}")
    if frames < _UNTIL_THERE:
        raise InputError(
            f"{frames} frames", f"at least {_UNTIL_THERE}, since the person enters after a while"
        )
    sequence = ceiling_sequence(CEILING_KINDS[TARGETS[target]], rng, frames=frames, fps=fps)
    with atomic_path(folder, directory=True) as made:
        boxes = _write_frames(made, _labelled(sequence), fps, images, advance)
        _write_camera(made, sequence.scene.camera)
        write(_walk_of(sequence), made / TRUTH)
    return boxes


def write_head(
    folder: Path,
    rng: np.random.Generator,
    advance: Advance,
    *,
    frames: int = 75,
    fps: float = 25.0,
    images: bool = False,
) -> list[PersonBox]:
    """Write a moving and turning head in front of clutter: frames, exact boxes of the head, and angles."""
    clip = head_clip(rng, HeadClipParameters(frames=frames, fps=fps, clutter=0.3), advance=advance)
    of_frame = [
        PersonBox(k, 1, (float(left), float(top), float(width), float(height)))
        for k, (left, top, width, height) in enumerate(clip.boxes)
    ]
    with atomic_path(folder, directory=True) as made:
        shown = ((image, [box]) for image, box in zip(clip.images, of_frame, strict=True))
        boxes = _write_frames(made, shown, fps, images)
        angles = {"pan_deg": np.rad2deg(clip.pan), "tilt_deg": np.rad2deg(clip.tilt)}
        write_table({"frame": np.arange(frames), **angles, "visible": clip.visible}, made / TRUTH)
    return boxes


def write_heads(
    folder: Path, rng: np.random.Generator, advance: Advance, *, count: int = 400
) -> list[PersonBox]:
    """Write crops of heads with the labels of `perception train` for head pose."""

    def drawn(size: int) -> tuple[list[Image], dict[str, Any]]:
        heads = make_heads(size, rng, _ALL_WAYS)
        return heads.images, {"pan_deg": np.rad2deg(heads.pan), "tilt_deg": np.rad2deg(heads.tilt)}

    return _write_crops(folder, drawn, count, advance)


def write_people(
    folder: Path, rng: np.random.Generator, advance: Advance, *, count: int = 400
) -> list[PersonBox]:
    """Write crops of people with the labels of `perception train` for body pose and head boxes."""

    def drawn(size: int) -> tuple[list[Image], dict[str, Any]]:
        people = make_pedestrians(size, rng)
        sides = zip(("left", "top", "width", "height"), people.head_box.T, strict=True)
        return people.images, {"body_deg": np.rad2deg(people.body), **dict(sides)}

    return _write_crops(folder, drawn, count, advance)


KINDS: Mapping[str, Callable[..., list[PersonBox]]] = MappingProxyType(
    {
        "street": write_street,
        "ceiling": write_ceiling,
        "head": write_head,
        "heads": write_heads,
        "people": write_people,
    }
)
"""Kinds of folders; the keywords are the options of each."""


def _write_frames(
    folder: Path,
    shown: Iterable[tuple[Image, Sequence[PersonBox]]],
    fps: float,
    images: bool,
    advance: Advance = lambda count: None,
) -> list[PersonBox]:
    """Write frames and boxes during rendering; return all boxes."""
    boxes: list[PersonBox] = []
    with pictures(folder / (IMAGES if images else VIDEO), fps) as write_picture:
        for k, (image, of_frame) in enumerate(shown):
            write_picture(k, image)
            boxes += of_frame
            advance(1)
    write_boxes(boxes, folder / BOXES)
    return boxes


def _write_camera(folder: Path, camera: Camera) -> None:
    fisheye = (0.0, 0.0, 0.0, 0.0) if camera.lens == "fisheye" else ()
    place = folder / CALIBRATION
    write_calibration(place, camera.rotation, camera.translation, camera.intrinsics, fisheye=fisheye)


def _labelled(sequence: CeilingSequence) -> Iterator[tuple[Image, list[PersonBox]]]:
    for k, frame in enumerate(sequence):
        box = None if frame.target is None else frame.target.body_box
        yield frame.image, [] if box is None else [PersonBox(k, 1, box)]


def _walk_of(sequence: CeilingSequence) -> TrackSet:
    """Return the ground truth of the person in a room."""
    walk = sequence.walks[0]
    frame = np.flatnonzero(walk.there)
    position, body = walk.position[frame], walk.body[frame]
    track = Track(
        1,
        frame,
        frame / sequence.fps,
        position,
        true_position=position,
        true_body=body,
        true_head=body,
    )
    return TrackSet((track,))


def _write_crops(
    folder: Path, drawn: Callable[[int], tuple[list[Image], dict[str, Any]]], count: int, advance: Advance
) -> list[PersonBox]:
    """Draw crops in batches and write them, named by their numbers, with a table of their labels."""
    columns: dict[str, list[Any]] = {"image": []}
    with atomic_path(folder, directory=True) as made:
        while len(columns["image"]) < count:
            first = len(columns["image"])
            images, labels = drawn(min(_BATCH, count - first))
            for k, image in enumerate(images):
                columns["image"].append(f"{first + k:05d}.png")
                (made / columns["image"][-1]).write_bytes(cv2.imencode(".png", image)[1].tobytes())
            for name, values in labels.items():
                columns.setdefault(name, []).extend(values.tolist())
            advance(len(images))
        names = np.array(columns.pop("image"), object)
        write_table({"image": names} | {k: np.array(v) for k, v in columns.items()}, made / LABELS)
    return []
