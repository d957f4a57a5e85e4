"""`ReadOptions`: everything that a caller can tell a reader."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal, get_args

from graphtrack.bounds import check_frame_rate, check_positive
from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray
from graphtrack.geometry.camera import GroundCamera
from graphtrack.scene import GivenScene, known_values

Associate = Literal["auto", "never", "always", "repair"]


@dataclass(frozen=True, eq=False)
class ReadOptions:
    """What a caller says about a file beyond the file itself. ``None``: the reader's own rule holds.

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
    scene : what is then known of how people come, go and are detected: `SceneParameters`, or some of them by
        their names; the others are learned
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
    scene: GivenScene = None

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
        object.__setattr__(self, "scene", known_values(self.scene))
