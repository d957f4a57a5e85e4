"""`ReadOptions`: all options of reading; `Layout`: the columns and units of a table."""

from __future__ import annotations

import csv
import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, TypedDict, Unpack, get_args

from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray
from graphtrack.geometry.camera import GroundCamera
from graphtrack.geometry.conventions import AngleConvention, Sense, Zero
from graphtrack.geometry.poses import PosePath
from graphtrack.io.sensors import SensorScene, SensorsLike
from graphtrack.io.text import check_decimal, check_encoding, delimiter_of
from graphtrack.limits import MemoryLimit
from graphtrack.tracks.cells import METRES, WILD, Layout
from graphtrack.tracks.schema import BOX_KEYS, CLASS, is_column
from graphtrack.tracks.table import ANGLES, DEGREES, AsRead
from graphtrack.tracks.time import UNIT_OF
from graphtrack.tracks.validation import check_frame_rate, check_positive, is_number

SHORT = {"id": "track_id", "time": "t"}
"""Short names of columns, in addition to those of the native table."""

EXPECTED = "pairs such as id=agent,t=timestamp,x=pos_x,y=pos_y"


def parse_columns(given: Mapping[str, object] | str | None) -> dict[str, str]:
    """Return native name → name in the file, from a mapping or text such as ``id=agent,t=timestamp``.

    A name that holds a comma is put, with its key, in double quotes.
    """
    if given is None:
        return {}
    pairs = _split(given) if isinstance(given, str) else [(str(k), str(v)) for k, v in given.items()]
    if not pairs:
        raise InputError("no columns", EXPECTED)
    found: dict[str, str] = {}
    for key, name in pairs:
        key, name = key.strip(), name.strip()
        if not name or not key:
            raise InputError(f"columns {key}={name}, without a name", EXPECTED)
        native = SHORT.get(key, key)
        if not (is_column(native) or native in (*DEGREES, *ANGLES, *BOX_KEYS, "confidence", CLASS)):
            known = ", ".join((*SHORT, "frame", "t", "x", "y", *DEGREES, "label", *ANGLES, *BOX_KEYS, CLASS))
            raise InputError(f"columns {key}={name}", f"one of {known}, or a column of the native table")
        if native in found:
            raise InputError(f"columns with {key} twice", "each once")
        if name in found.values():
            raise InputError(f"column {name!r} for two meanings", "one meaning for each column")
        found[native] = name
    _check_places(found)
    return found


def columns_text(columns: Mapping[str, str]) -> str:
    """Return the text that `parse_columns` reads."""
    pairs = ["=".join(pair) for pair in columns.items()]
    return ",".join(
        '"' + pair.replace('"', '""') + '"' if "," in pair or '"' in pair else pair for pair in pairs
    )


def options_to_read(as_read: AsRead, written: Collection[str]) -> dict[str, str]:
    """Return the options that read a table again that was written with the names and units of another.

    Parameters
    ----------
    as_read : names and units
    written : columns of the table
    """
    renamed = {
        "id" if key == "track_id" else key: name
        for key, name in as_read.columns.items()
        if key != name and name in written
    }
    found = {"columns": columns_text(renamed)} if renamed else {}
    scale = as_read.time
    if scale is not None and scale.kind == "number" and (unit := UNIT_OF.get(scale.unit, "s")) != "s":
        found["time_unit"] = unit
    if as_read.metre != 1.0:
        found["units"] = next(unit for unit, metre in METRES.items() if metre == as_read.metre)
    if as_read.angles is not None:
        found["angles"] = str(as_read.angles)
    return found


def _split(text: str) -> list[tuple[str, str]]:
    try:
        parts = next(csv.reader([text], skipinitialspace=True, strict=True), [])
    except csv.Error as error:
        raise InputError(f"columns {text!r} ({error})", EXPECTED) from error
    pairs = []
    for part in parts:
        key, equals, name = part.partition("=")
        if not equals:
            raise InputError(f"columns {part!r}", EXPECTED)
        pairs.append((key, name))
    return pairs


def _check_places(columns: Mapping[str, str]) -> None:
    degrees = [key for key in DEGREES if key in columns]
    if len(degrees) == 1:
        raise InputError(f"columns with {degrees[0]} alone", "both lat and lon")
    if degrees and ("x" in columns or "y" in columns):
        raise InputError("columns with x, y and lat, lon", "one of the two pairs")
    for radians, native in ANGLES.items():
        if radians in columns and native in columns:
            raise InputError(f"columns with {radians} and {native}", "one of the two")
    wild = [name for name in columns.values() if WILD in name]
    if wild and "track_id" in columns:
        raise InputError(f"columns with {wild[0]} and id", f"one of them: {WILD} stands for the identity")
    if any(name.count(WILD) > 1 for name in wild):
        raise InputError(f"columns with {wild[0]}", f"one {WILD}, for the identity")


def _image_size(given: tuple[int, int] | str | None) -> tuple[int, int] | None:
    """Return width and height in pixels."""
    numbers = re.fullmatch(r"(\d{1,6})\s*[x×,]\s*(\d{1,6})", given) if isinstance(given, str) else None
    size = tuple(map(int, numbers.groups())) if numbers else given
    if size is None:
        return None
    if not (
        isinstance(size, tuple | list) and len(size) == 2 and all(is_number(one) and one > 0 for one in size)
    ):
        raise InputError(f"image_size = {given!r}", "width and height in pixels, such as 1920x1080")
    return int(size[0]), int(size[1])


Associate = Literal["auto", "never", "always", "repair"]

Poses = str | Path | PosePath | Mapping[str, PosePath]
"""A file of poses, the path of all sensors, or name of a sensor → its path."""

PoseAxes = Literal["robot", "camera"]
"""Axes of a sensor with poses in space: x forward and z up, or z forward and y down."""


class ReadingBase(TypedDict, total=False):
    """Keywords of reading other than camera and frame rate: fields of `ReadOptions`."""

    homography: FloatArray | str | Path | None
    point_pairs: str | Path | None
    calibration: str | Path | None
    metres_per_pixel: float | None
    nadir: tuple[float, float] | None
    oxts: str | Path | None
    ego_calibration: str | Path | None
    classes: tuple[str, ...]
    associate: Associate
    missed_rows: bool
    columns: Mapping[str, str] | str | None
    time_unit: str | None
    units: str | None
    crs: str | None
    angles: AngleConvention | str | None
    angle_zero: Zero | None
    angle_sense: Sense | None
    delimiter: str | None
    decimal: str | None
    encoding: str | None
    topic: str | Sequence[str] | None
    fixed_frame: str | None
    sensors: SensorsLike | None
    poses: Poses | None
    pose_axes: PoseAxes | None
    reference: AsRead | None
    max_memory: float | None
    image_size: tuple[int, int] | str | None


class Placing(ReadingBase, total=False):
    """Keywords of reading other than the frame rate."""

    camera: GroundCamera | None


class Reading(Placing, total=False):
    """Keywords of reading: the fields of `ReadOptions`."""

    fps: float | None


class FileReading(Reading, total=False):
    """Keywords of reading files: those of `Reading`, and the format's name."""

    format: str | None


@dataclass(frozen=True, eq=False)
class ReadOptions:
    """Options of reading a file. ``None``: the reader's default.

    Attributes
    ----------
    fps : frames a second, for files without times
    camera : a camera; it takes precedence over the next four
    homography : (3, 3) image → ground (metres), or the path of a text file with its nine numbers
    point_pairs : path of a text file with rows ``u v X Y``, X and Y in metres
    calibration : path of a camera calibration (``.ci``)
    metres_per_pixel : scale of a view from straight above (or approximated as one)
    nadir : pixel (u, v) straight below a camera that looks down, where people stretch away from it
    oxts, ego_calibration : paths of KITTI's ego motion and calibration
    classes : classes of objects to read, where a file has several
    associate : "auto": rows without identities become tracks, see `association`; "always": identities in
        the file are ignored; "repair": they are kept unless the evidence is against them; "never": rows
        without identities are an error
    missed_rows : give detections that become tracks a row for each frame in which the person was missed
    columns : of a table with foreign names: name in the native table (``id`` and ``time`` for short,
        ``lat`` and ``lon``, ``body_rad`` and ``head_rad``) → name in the file, or text such as
        ``"id=agent,t=timestamp"``
    time_unit : of numbers in its column of times, "s", "ms", "us" or "ns"; "iso" for text of ISO 8601
    units : of its lengths, "m", "cm", "mm" or "ft"
    crs : coordinate reference system of its positions, such as "EPSG:4326", converted to local metres
    angles : convention of its angles, an `AngleConvention` or text such as "clockwise from image up"; None:
        counter-clockwise from +x, and in tables with ``lat`` and ``lon`` compass bearings
    angle_zero, angle_sense : in place of ``angles``: the direction of zero, and "ccw" or "cw"
    delimiter, decimal : cell separator and decimal mark of a text file
    encoding : of a text file that is not UTF-8
    topic : of a ROS 2 recording, the topic with people, or a pattern; several, whose identities are kept
        apart by the names of the topics
    fixed_frame : the frame of reference of its positions, to which ``tf`` transforms them
    sensors : descriptions of the sensors by name, or their file; rows are corrected for the errors
    poses : of sensors that move, whose rows are in their frame (x forward, y left, metres): a file, or in
        Python a `PosePath`, or name in the column ``sensor`` → `PosePath` with the times of the tracks
    pose_axes : of a sensor with poses in space: "robot", x forward and z up; "camera", z forward and y down.
        By default "camera" for KITTI odometry, else "robot"
    reference : layout of another table with the same origins of time and local metres
    max_memory : GiB that the content of the file may take; None: 4, and no more than 200 times the size of
        the file, or 64 MiB where that is more
    image_size : width and height of the images in pixels, or text such as "1920x1080", for boxes relative to
        them (YOLO's labels)
    """

    fps: float | None = None
    camera: GroundCamera | None = None
    homography: FloatArray | str | Path | None = None
    point_pairs: str | Path | None = None
    calibration: str | Path | None = None
    metres_per_pixel: float | None = None
    nadir: tuple[float, float] | None = None
    oxts: str | Path | None = None
    ego_calibration: str | Path | None = None
    classes: tuple[str, ...] = ("Pedestrian",)
    associate: Associate = "auto"
    missed_rows: bool = True
    columns: Mapping[str, str] | str | None = None
    time_unit: str | None = None
    units: str | None = None
    crs: str | None = None
    angles: AngleConvention | str | None = None
    angle_zero: Zero | None = None
    angle_sense: Sense | None = None
    delimiter: str | None = None
    decimal: str | None = None
    encoding: str | None = None
    topic: str | Sequence[str] | None = None
    fixed_frame: str | None = None
    sensors: SensorsLike | None = None
    poses: Poses | None = None
    pose_axes: PoseAxes | None = None
    reference: AsRead | None = None
    max_memory: float | None = None
    image_size: tuple[int, int] | str | None = None

    def __post_init__(self) -> None:
        check_frame_rate(self.fps)
        check_positive("metres_per_pixel", self.metres_per_pixel, 1e6)
        check_positive("max_memory", self.max_memory, 1e6)
        if self.associate not in get_args(Associate):
            raise InputError(f"associate = {self.associate!r}", f"one of {', '.join(get_args(Associate))}")
        if self.pose_axes is not None and self.pose_axes not in get_args(PoseAxes):
            raise InputError(f"pose_axes = {self.pose_axes!r}", f"one of {', '.join(get_args(PoseAxes))}")
        if self.pose_axes is not None and not isinstance(self.poses, str | Path):
            raise InputError("pose_axes without a file of poses", "poses, the path of a file")
        if self.camera is not None and not isinstance(self.camera, GroundCamera):
            expected = "a GroundCamera; files are homography, point_pairs or calibration"
            raise InputError(f"camera = {self.camera!r}", expected)
        paths = self.poses.values() if isinstance(self.poses, Mapping) else [self.poses]
        if not all(one is None or isinstance(one, str | Path | PosePath) for one in paths):
            raise InputError("poses of another type", "a file, a PosePath, or name of a sensor → PosePath")
        object.__setattr__(
            self, "classes", (self.classes,) if isinstance(self.classes, str) else tuple(self.classes)
        )
        if self.columns is not None:
            object.__setattr__(self, "columns", parse_columns(self.columns))
        if self.angles is not None:
            object.__setattr__(self, "angles", AngleConvention.of(self.angles))
            if self.angle_zero is not None or self.angle_sense is not None:
                raise InputError("angles with angle_zero or angle_sense", "angles alone, or zero and sense")
        _ = self.angle_convention  # checks it
        object.__setattr__(self, "delimiter", delimiter_of(self.delimiter))
        check_decimal(self.decimal)
        if self.delimiter is not None and self.delimiter == self.decimal:
            found = f"delimiter and decimal {self.delimiter!r}"
            raise InputError(found, "two different marks, such as --delimiter ';' --decimal ,")
        check_encoding(self.encoding)
        object.__setattr__(self, "image_size", _image_size(self.image_size))
        object.__setattr__(self, "sensors", self.sensor_scene)
        self.layout()

    @classmethod
    def named(cls, **options: Unpack[Reading]) -> ReadOptions:
        """Return options by their names; raise an InputError for an unknown name.

        The fields and `Reading` name the same options with the same types.
        """
        unknown = ", ".join(name for name in options if name not in cls.__dataclass_fields__)
        if unknown:
            raise InputError(f"unknown options {unknown}", f"some of {', '.join(cls.__dataclass_fields__)}")
        return cls(**options)

    def limit(self, path: Path, stored: int | None = None) -> MemoryLimit:
        """Return the limit of the memory that the content of a file of so many bytes may take."""
        return MemoryLimit(path, stored, self.max_memory, "--max-memory")

    @property
    def has_camera(self) -> bool:
        """Return whether a camera or a scale is given, which maps pixels to the ground."""
        given = (self.camera, self.homography, self.point_pairs, self.calibration, self.metres_per_pixel)
        return any(one is not None for one in given)

    @property
    def topics(self) -> tuple[str, ...]:
        """The topics that were asked for, or patterns."""
        return (self.topic,) if isinstance(self.topic, str) else tuple(self.topic or ())

    @property
    def sensor_scene(self) -> SensorScene | None:
        """The descriptions of the sensors; None without them."""
        return None if self.sensors is None else SensorScene.of(self.sensors)

    @property
    def angle_convention(self) -> AngleConvention | None:
        """The convention of angles that is declared; None: none."""
        if self.angle_zero is None and self.angle_sense is None:
            assert not isinstance(self.angles, str)
            return self.angles
        return AngleConvention.between(self.angle_zero, self.angle_sense)

    def layout(self) -> Layout | None:
        """Return the columns and units of a table, without its angles; None for those of the native table.

        Raises
        ------
        InputError
            For options that contradict each other.
        """
        declared = (self.time_unit, self.units, self.crs)
        if self.columns is None and not any(declared):
            return None
        assert not isinstance(self.columns, str)
        return Layout(self.columns or {}, *declared, exclusive=self.columns is not None)
