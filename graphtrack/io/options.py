"""`ReadOptions`: everything that a caller can tell a reader."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, get_args

from graphtrack.bounds import check_frame_rate, check_positive
from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray
from graphtrack.geometry.camera import GroundCamera
from graphtrack.io.layout import Layout, parse_columns
from graphtrack.io.marks import check_decimal, check_encoding, delimiter_of
from graphtrack.table.as_read import AsRead

Associate = Literal["auto", "never", "always", "repair"]


@dataclass(frozen=True, eq=False)
class ReadOptions:
    """Options of reading a file. ``None``: the reader's own rule holds.

    Attributes
    ----------
    fps : frames a second, for files without times
    camera : the camera, when the caller has one already; it wins over the next four
    homography : (3, 3) image → ground (metres), or the path of a text file with its nine numbers
    point_pairs : path of a text file with rows ``u v X Y``
    point_pairs_unit : unit of X and Y there, "m" or "cm"
    point_pairs_rows : the rows to use, from 1, such as ``"5-8"`` or ``"1,2,5-8"``
    calibration : path of a camera calibration (``.ci``)
    metres_per_pixel : scale of a view from straight above (or taken to be one)
    image_scale : factor from the file's pixels to those of the calibrated image
    nadir : pixel (u, v) straight below a camera that looks down, where people stretch away from it
    oxts, ego_calibration : paths of KITTI's ego motion and calibration
    classes : the classes of object to read, where a file has several
    associate : "auto": rows without identities become tracks, see `association`; "always": those with
        identities too, which are forgotten; "repair": these are kept but where the evidence is against them;
        "never": rows without identities are an error
    columns : of a table with names of its own: name in the native table (``id`` and ``time`` for short,
        ``lat`` and ``lon``, ``body_rad`` and ``head_rad``) → name in the file, or text such as
        ``"id=agent,t=timestamp"``
    time_unit : of numbers in its column of times, "s", "ms", "us" or "ns"; "iso" for text of ISO 8601
    units : of its lengths, "m", "cm", "mm" or "ft"
    crs : the coordinate reference system of its places, such as "EPSG:4326", which become local metres
    delimiter, decimal : marks between the cells of a text file, and before its decimals
    encoding : of a text file that is not UTF-8
    topic : of a ROS 2 recording, the topic that tells of people, or a pattern for topics of one person each
    fixed_frame : the frame of reference of its places, to which ``tf`` brings them
    beside : what another table was read as; times and local metres count from the same
    """

    fps: float | None = None
    camera: GroundCamera | None = None
    homography: FloatArray | str | Path | None = None
    point_pairs: str | Path | None = None
    point_pairs_unit: str = "m"
    point_pairs_rows: str | None = None
    calibration: str | Path | None = None
    metres_per_pixel: float | None = None
    image_scale: float | None = None
    nadir: tuple[float, float] | None = None
    oxts: str | Path | None = None
    ego_calibration: str | Path | None = None
    classes: tuple[str, ...] = ("Pedestrian",)
    associate: Associate = "auto"
    columns: Mapping[str, str] | str | None = None
    time_unit: str | None = None
    units: str | None = None
    crs: str | None = None
    delimiter: str | None = None
    decimal: str | None = None
    encoding: str | None = None
    topic: str | None = None
    fixed_frame: str | None = None
    beside: AsRead | None = None

    def __post_init__(self) -> None:
        check_frame_rate(self.fps)
        check_positive("metres_per_pixel", self.metres_per_pixel, 1e6)
        check_positive("image_scale", self.image_scale, 1e3)
        if self.point_pairs_unit not in ("m", "cm"):
            raise InputError(f"point_pairs_unit = {self.point_pairs_unit!r}", "'m' or 'cm'")
        if self.associate not in get_args(Associate):
            raise InputError(f"associate = {self.associate!r}", f"one of {', '.join(get_args(Associate))}")
        object.__setattr__(
            self, "classes", (self.classes,) if isinstance(self.classes, str) else tuple(self.classes)
        )
        if self.columns is not None:
            object.__setattr__(self, "columns", parse_columns(self.columns))
        object.__setattr__(self, "delimiter", delimiter_of(self.delimiter))
        check_decimal(self.decimal)
        if self.delimiter is not None and self.delimiter == self.decimal:
            found = f"delimiter and decimal {self.delimiter!r}"
            raise InputError(found, "two different marks, such as --delimiter ';' --decimal ,")
        check_encoding(self.encoding)
        self.layout()

    def layout(self) -> Layout | None:
        """The columns and units of a table; None: it is the native one.

        Raises
        ------
        InputError
            For what makes no sense together.
        """
        said = (self.time_unit, self.units, self.crs)
        if self.columns is None and not any(said):
            return None
        assert not isinstance(self.columns, str)
        return Layout(self.columns or {}, *said)
