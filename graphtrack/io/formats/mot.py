"""MOTChallenge text ``frame,id,left,top,width,height,confidence,x,y,z``, and Oxford Town Centre's boxes.

Frames of MOT text are numbered from 1, and programs such as TrackEval refuse a frame 0. A table whose frames
begin at 0 is therefore written with one added to each, and its last column, z, is ``-0`` in place of ``0``:
zero metres for every reader, and for this one the mark to restore the original frames.
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from graphtrack.errors import InputError, InputWarning
from graphtrack.geometry.angles import FloatArray
from graphtrack.geometry.camera import GroundCamera
from graphtrack.io.cameras import (
    boxes_on_ground,
    camera_or_scale,
    known_camera,
    on_ground,
    placed_boxes,
    read_calibration,
    with_scores,
)
from graphtrack.io.format import Format, companion_paths
from graphtrack.io.options import ReadOptions
from graphtrack.io.source import Source
from graphtrack.io.text import Numbers, read_numbers
from graphtrack.tracks.table import Rows
from graphtrack.tracks.track import Track, TrackSet
from graphtrack.tracks.validation import (
    LARGEST_ID,
    LARGEST_LIKELIHOOD,
    LARGEST_PIXELS,
)

DEFAULT_FPS = 25.0

IGNORED = "marked to be ignored"

_NAMES = ("frame", "id", "left", "top", "width", "height", "confidence", "x", "y", "z")

_CLASSES = (
    "Pedestrian",
    "PersonOnVehicle",
    "Car",
    "Bicycle",
    "Motorbike",
    "NonMotorisedVehicle",
    "StaticPerson",
    "Distractor",
    "Occluder",
    "OccluderOnGround",
    "OccluderFull",
    "Reflection",
    "Crowd",
)
"""The classes 1, 2, … of ground truth with nine columns (MOT16 and later)."""


_VISDRONE = (
    *("Pedestrian", "People", "Bicycle", "Car", "Van", "Truck", "Tricycle", "AwningTricycle", "Bus", "Motor"),
    "Others",
)
"""The classes 1, 2, … of VisDrone, whose rows have a class, truncation and occlusion after the confidence."""

_MOST_CLASSES = 90  # of COCO


FROM_ZERO = "-0"
"""Mark in the last column: the row's frame is one less in the original table."""

SHIFTED = "frames are those of the table from which it was written, numbered from 0 (-0 in the last column)"
"""Note on a file with that mark in all rows."""


def read(source: Source, options: ReadOptions) -> Rows:
    """Read boxes with ids, and positions where the file has them.

    Columns 8 and 9 are metres unless all are −1; a row of −1 among metres is a missing position. With
    nine columns they are class and visibility (ground truth of MOT16 and later), and with ten where they look
    like that (see `_has_classes`). Without metres, or with a camera or scale in the options, the foot point,
    the middle of the box's lower edge, is projected to the ground by the camera or by a scale. A confidence
    of 0 marks a row to be ignored, unless all are 0. The confidence of detections is the channel
    ``score``, see `with_scores`. Frames are those of the file or of the original table (see the module). The
    frame rate is ``fps``, or that of a ``seqinfo.ini`` nearby, or 25.
    """
    rows = read_boxes(source, options)
    fps, note = _frame_rate(source.path, options)
    rows = placed_boxes(rows, options).with_notes(*note).with_times(fps)
    return with_scores(rows).without("box", "confidence")


def read_boxes(source: Source, options: ReadOptions = ReadOptions()) -> Rows:
    """Return rows with ids, in the order of the file, without ignored rows and other classes.

    The channels are ``box`` (n, 4), left, top, width and height in pixels, NaN where the row has no box;
    ``confidence`` (n,), possibly negative; and ``position`` (n, 2) in metres, where the file has any.
    """
    table = read_numbers(source, delimiter=",", widths=(7, 8, 9, 10), names=_NAMES)
    identity = table.integers(1, LARGEST_ID)
    unknown = identity < 0
    nobodys = bool((identity == -1).all())
    if unknown.any() and not nobodys:
        raise table.fail(
            int(np.argmax(unknown)),
            1,
            f"an id from 0, or -1 in all rows: {unknown.sum()} of {len(unknown)} are detections without "
            "identity",
        )
    channels = {
        "box": _boxes_of(table),
        "confidence": table.bounded(6, -LARGEST_LIKELIHOOD, LARGEST_LIKELIHOOD),
    }
    classes = _has_classes(table)
    world = None if classes else _world(table)
    boxed = bool(np.isfinite(channels["box"][:, 0]).all())
    notes: tuple[str, ...] = ()
    if world is not None and options.has_camera and boxed:
        notes = ("positions are those of the boxes, by the camera: columns 8 and 9 are not read",)
    elif world is not None:
        channels["position"] = world
    frame, from_zero = table.integers(0), _counted_from_zero(table)
    notes += (SHIFTED,) if from_zero.all() else ()
    rows = Rows(source.path, "mot", identity, frame - from_zero, channels, table.line_of, notes=notes)
    rows = replace(rows, has_identity=not nobodys)
    if table.values.shape[1] == 9 or classes:
        rows = _of_classes(rows, table, options)
    confidence = rows.channels["confidence"]
    if not (table.values[:, 6] != 0.0).any():
        unmarked = "all confidences are 0: they are no mark of rows to be ignored"
        return rows.with_notes(unmarked).with_channels(confidence=np.full(len(rows), -1.0))
    if nobodys and (confidence < 0.0).any():  # 0 is a valid confidence there
        return rows
    return rows.keep(confidence != 0.0, IGNORED)


def _counted_from_zero(table: Numbers) -> NDArray[np.bool_]:
    """Return a mask (n,) of rows with the mark `FROM_ZERO`."""
    z = table.values[:, 9] if table.values.shape[1] == 10 else np.ones(len(table.values))
    return np.signbit(z) & (z == 0.0)


def _boxes_of(table: Numbers) -> FloatArray:
    """Return boxes (n, 4) in pixels; NaN in rows whose box is −1, −1, −1, −1: no box."""
    absent = np.all(table.values[:, 2:6] == -1.0, axis=1)
    for column in (4, 5):
        bad = (table.values[:, column] <= 0.0) & ~absent
        if bad.any():
            raise table.fail(int(np.argmax(bad)), column, "a size above 0, or -1,-1,-1,-1 for no box")
    sizes = [table.bounded(column, -1.0, LARGEST_PIXELS) for column in (4, 5)]
    box = np.column_stack([table.pixels(2), table.pixels(3), *sizes])
    return np.where(absent[:, None], np.nan, box)


def _has_classes(table: Numbers) -> bool:
    """Return whether columns 8, 9 and 10 of ten are a class, and truncation and occlusion, or −1.

    These are small whole numbers, and a person keeps the class; metres would be those of people who stand.
    """
    if table.values.shape[1] < 10:
        return False
    kind, *further = table.values[:, 7:10].T
    absent = (table.values[:, 7:9] == -1.0).all() or _counted_from_zero(table).any()
    small = (kind == np.rint(kind)).all() and (kind >= 0.0).all() and (kind <= _MOST_CLASSES).all()
    levels = all(np.isin(values, (-1.0, 0.0, 1.0, 2.0)).all() for values in further)
    if absent or not small or not levels:
        return False
    kinds_of = {(identity, kind) for identity, kind in table.values[:, [1, 7]].tolist()}
    return len(kinds_of) == len({identity for identity, _ in kinds_of}) or bool(
        (table.values[:, 1] == -1.0).all()
    )


def _world(table: Numbers) -> FloatArray | None:
    """Return positions (n, 2) in metres, if the file has any."""
    if table.values.shape[1] < 10:
        return None
    absent = np.all(table.values[:, 7:9] == -1.0, axis=1)
    if absent.all():
        return None
    return np.where(absent[:, None], np.nan, np.column_stack([table.metres(7), table.metres(8)]))


def _of_classes(rows: Rows, table: Numbers, options: ReadOptions) -> Rows:
    """Return the rows of the selected classes; other rows are refused and counted by class."""
    number = table.integers(7)
    if (number < 1).all():  # −1: a result without classes; 0: people, of a detector whose classes begin there
        return rows
    known: tuple[str, ...] = _CLASSES
    wanted = set(options.classes)
    if table.values.shape[1] == 10:
        from_zero = (table.values[:, 8:] == -1.0).all()
        known = ("Pedestrian",) if from_zero else _VISDRONE
        wanted |= {"People"} if wanted == {*ReadOptions().classes} else set()
        number = number + 1 if from_zero else number
    rows = rows.with_channels(number=number.astype(float))
    for k in np.unique(number):
        name = known[k - 1] if 1 <= k <= len(known) else f"number {k}"
        if name not in wanted:
            rows = rows.keep(rows.channels["number"] != k, f"of class {name}")
    return rows.without("number")


def _frame_rate(path: Path, options: ReadOptions) -> tuple[float, tuple[str, ...]]:
    if options.fps is not None:
        return options.fps, ()
    for info in companion_paths(path, "mot"):
        if info.is_file():
            text = Source.open(info).text
            rate, width, height = (_setting(text, name) for name in ("frameRate", "imWidth", "imHeight"))
            if rate is not None:
                size = f" and images of {width} × {height}" if width and height else ""
                return float(rate), (f"frame rate {rate} Hz{size} from seqinfo.ini",)
    return DEFAULT_FPS, (f"no frame rate is given: {DEFAULT_FPS:g} Hz assumed",)


def _setting(text: str, name: str) -> str | None:
    """Return a number above 0 of a ``seqinfo.ini``, as text."""
    match = re.search(rf"(?m)^{name}\s*=\s*(\d{{1,6}}(?:\.\d+)?)\s*$", text)
    return match[1] if match is not None and float(match[1]) > 0.0 else None


def write(tracks: TrackSet, path: Path) -> None:
    """Write rows with positions in metres in columns 8 and 9.

    With a camera boxes are those of `boxes_on_ground`.
    Without a camera, or behind it, the box is −1, −1, −1, −1. Ids are those of the tracks; frames too, unless
    they begin at 0 (see the module).

    Warns
    -----
    InputWarning
        If the frames begin at 0, and are written with one added.
    """
    _write_rows(tracks, path, [(track.position, _boxes(track, tracks)) for track in tracks])


def write_2d(tracks: TrackSet, path: Path) -> None:
    """Write boxes alone, with −1 in columns 8 and 9, of rows within the view of the camera; else as `write`.

    Raises
    ------
    InputError
        Without a camera.
    """
    if tracks.camera is None:
        raise InputError("tracks without a camera", "--homography, which makes boxes of them", path=path)
    boxes = [_boxes(track, tracks) for track in tracks]
    nowhere = [np.where(box[:, 2:3] > 0.0, [-1.0, -1.0], np.nan) for box in boxes]
    _write_rows(tracks, path, list(zip(nowhere, boxes, strict=True)))


def _write_rows(tracks: TrackSet, path: Path, values: Sequence[tuple[FloatArray, FloatArray]]) -> None:
    """Write columns 8 and 9 (n, 2) and boxes (n, 4) of each track; rows without the former are left out."""
    negative = next((track.track_id for track in tracks if track.track_id < 0), None)
    if negative is not None:
        raise InputError(f"track id {negative}", "ids from 0 in MOT text")
    first = min((int(track.frame[0]) for track in tracks), default=1)
    if first < 0:
        raise InputError(f"frame {first}", "frames from 0 in MOT text")
    if first == 0:
        note = "frames begin at 0, and at 1 in MOT text: each is written as one more"
        warnings.warn(note, InputWarning, stacklevel=3)
    lines = [
        line for track, one in zip(tracks, values, strict=True) for line in _lines(track, *one, first == 0)
    ]
    lines.sort(key=lambda line: line[:2])
    with path.open("w", encoding="ascii", newline="\n") as stream:
        stream.writelines(text + "\n" for _, _, text in lines)


def _lines(track: Track, place: FloatArray, boxes: FloatArray, from_zero: bool) -> list[tuple[int, int, str]]:
    result = []
    for frame, box, position in zip(track.frame.tolist(), boxes, place, strict=True):
        if np.isfinite(position).all():
            cells = [repr(float(value)) for value in (*np.round(box, 3), 1.0, *position)]
            cells = [str(frame + from_zero), str(track.track_id), *(one.removesuffix(".0") for one in cells)]
            result.append((frame, track.track_id, ",".join([*cells, FROM_ZERO if from_zero else "0"])))
    return result


def _boxes(track: Track, tracks: TrackSet) -> FloatArray:
    """Return boxes (n, 4) left, top, width, height."""
    if tracks.camera is None:
        return np.full((len(track), 4), -1.0)
    return np.nan_to_num(boxes_on_ground(track.position, tracks.camera), nan=-1.0)


MOT = Format(
    name="mot",
    description="MOTChallenge text: frame,id,left,top,width,height,confidence,x,y,z",
    suffixes=(".txt",),
    read=read,
    write=write,
    read_boxes=read_boxes,
)

MOT_2D = Format(
    name="mot2d",
    description="MOTChallenge text of boxes alone, for 2-D evaluation (TrackEval); needs a camera",
    suffixes=(".2d.txt",),
    read=read,
    write=write_2d,
    is_read=False,
)


def read_towncentre(source: Source, options: ReadOptions) -> Rows:
    """Read boxes and project their bottom centres to the ground.

    The calibration is that of the options or ``calibration.ci`` next to the file. The boxes may be those of
    an image of half the calibrated size: that is recognised when all upper edges are centred within it,
    unless the camera itself is given. 25 frames a second unless ``fps`` is given.
    """
    rows = read_towncentre_boxes(source)
    left, top, width, height = rows.channels["box"].T
    pixel = np.column_stack([left + width / 2.0, top + height])
    camera, notes = _camera(source, options, pixel, height)
    rows = rows.with_channels(pixel=pixel).without("box")
    return on_ground(rows, camera, notes).with_times(options.fps or DEFAULT_FPS)


def read_towncentre_boxes(source: Source, options: ReadOptions = ReadOptions()) -> Rows:
    """Return rows with the channel ``box`` (n, 4), left, top, width and height in the file's pixels."""
    table = read_numbers(source, delimiter=",", widths=(6,), names=_NAMES[:6])
    box = np.column_stack([table.pixels(2), table.pixels(3), table.sizes(4), table.sizes(5)])
    track_id, frame = table.integers(1, LARGEST_ID), table.integers(0)
    return Rows(source.path, "towncentre", track_id, frame, {"box": box}, table.line_of)


def _camera(
    source: Source, options: ReadOptions, pixel: FloatArray, height: FloatArray
) -> tuple[GroundCamera, tuple[str, ...]]:
    camera, notes = known_camera(options, pixel)
    (found,) = companion_paths(source.path, "towncentre")
    if camera is None and options.metres_per_pixel is None and found.is_file():
        camera, notes = read_calibration(found), ("calibration from calibration.ci next to the file",)
    if camera is None:
        return camera_or_scale(options, pixel, height)
    if options.camera is None and _is_half(camera, pixel - np.column_stack([np.zeros_like(height), height])):
        note = "the boxes fit into half of the calibrated image: their pixels are doubled"
        camera, notes = camera.resized(0.5), (*notes, note)
    return camera, notes


def _is_half(camera: GroundCamera, top_centre: FloatArray) -> bool:
    """Return whether pixels (n, 2) are those of an image of half the calibrated size."""
    if camera.intrinsics is None:
        return False
    # The principal point is the middle of the calibrated image; half the image ends there. Boxes of people
    # at the border extend below the image, so only their upper edges must lie within it.
    return bool(np.all(top_centre <= camera.intrinsics[:2, 2] + 0.5))


TOWNCENTRE = Format(
    name="towncentre",
    description="Oxford Town Centre boxes: frame,id,left,top,width,height",
    suffixes=(),
    read=read_towncentre,
    read_boxes=read_towncentre_boxes,
)
