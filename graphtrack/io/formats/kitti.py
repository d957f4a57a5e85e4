"""KITTI tracking labels, transformed from the moving camera to the world by ego motion and calibration.

The files are described in Geiger, Lenz, Stiller & Urtasun, Vision meets robotics: the KITTI dataset,
IJRR 2013, and in the development kits of the raw data and of the tracking benchmark.
"""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import numpy as np

from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray, wrap
from graphtrack.io.format import Format, companion_paths
from graphtrack.io.options import ReadOptions
from graphtrack.io.source import Source
from graphtrack.io.text import read_numbers
from graphtrack.tracks.table import Rows
from graphtrack.tracks.validation import LARGEST_ID, parse_number

FPS = 10.0

_LABEL = (
    *("frame", "id", "class", "truncated", "occluded", "alpha", "left", "top", "right", "bottom"),
    *("height", "width", "length", "x", "y", "z", "rotation_y", "score"),
)
OXTS_COLUMNS = 30
"""Numbers of a line of ego motion."""
_EARTH_RADIUS = 6378137.0  # metres; as in the devkit, the WGS 84 ellipsoid at the equator


def read(source: Source, options: ReadOptions) -> Rows:
    """Read positions and headings in an east-north-up world with its origin at the first ego pose.

    Positions are transformed from the rectified camera by R_rect, Tr_velo_cam, Tr_imu_velo and the ego pose.
    Body heading = ego yaw − rotation_y − π/2. Ego motion and calibration are those of the options, or
    ``../oxts/NAME`` and ``../calib/NAME``. 10 frames a second unless ``fps`` is given.
    """
    labels = read_numbers(source, delimiter=None, widths=(17, 18), names=_LABEL, text=(2,))
    classes = np.array(labels.text[2], dtype=object)
    frame, identity = labels.integers(0), labels.integers(1, LARGEST_ID)
    location = np.column_stack([labels.metres(13), labels.metres(14), labels.metres(15)])
    rotation = labels.bounded(16, -1e4, 1e4)
    wanted = np.isin(classes, options.classes)
    refused = {f"of class {name}": n for name, n in Counter(classes[~wanted].tolist()).items()}
    # A result without a 3-D box has −1000 as position and −10 as rotation.
    placed = wanted & (location[:, 0] > -999.0)
    if (wanted & ~placed).any():
        refused["without a place in space"] = int((wanted & ~placed).sum())
    kept = np.flatnonzero(placed)
    if (identity[kept] < 0).any():
        row = int(kept[np.argmax(identity[kept] < 0)])
        raise labels.fail(row, 1, "an id from 0: these are detections without identity")
    notes: list[str] = []
    of_motion, of_sensors = companion_paths(source.path.absolute(), "kitti")
    oxts = _given_or_companion(of_motion, "oxts", options.oxts, source.path, notes)
    calibration = _given_or_companion(
        of_sensors, "ego_calibration", options.ego_calibration, source.path, notes
    )
    poses = ego_poses(Source.open(oxts))
    outside = (frame[kept] < 0) | (frame[kept] >= len(poses))
    if outside.any():
        row = int(kept[np.argmax(outside)])
        raise labels.fail(row, 0, f"a frame from 0 to {len(poses) - 1}, for which {oxts} has ego poses")
    camera_to_imu = _read_camera_to_imu(calibration)
    pose = poses[frame[kept]]
    in_imu = location[kept] @ camera_to_imu[:3, :3].T + camera_to_imu[:3, 3]
    in_world = np.einsum("nij,nj->ni", pose[:, :3, :3], in_imu) + pose[:, :3, 3]
    yaw = np.arctan2(pose[:, 1, 0], pose[:, 0, 0])
    heading = np.where(rotation[kept] > -9.9, wrap(yaw - rotation[kept] - np.pi / 2.0), np.nan)
    rows = Rows(
        source.path,
        "kitti",
        identity[kept],
        frame[kept],
        {"position": in_world[:, :2], "body": heading},
        lambda row: labels.line_of(int(kept[row])),
        refused=refused,
        notes=(*notes, "world axes are east and north, from the first ego pose"),
    )
    return rows.with_times(options.fps or FPS)


def _given_or_companion(
    found: Path, option: str, given: str | Path | None, labels: Path, notes: list[str]
) -> Path:
    """Return the path that was given, or the one ``found`` next to the labels."""
    if given is not None:
        return Path(given)
    if not found.is_file():
        raise InputError(f"no {found}", f"that file, or its path as {option}", path=labels)
    notes.append(f"{found.parent.name} from ../{found.parent.name}/{found.name}")
    return found


def ego_poses(source: Source) -> FloatArray:
    """Return ego poses (n, 4, 4), inertial unit → world, from latitude, longitude, altitude and attitude.

    The unit's axes are forward, left and up; those of the world east, north and up, from the first pose.
    """
    from scipy.spatial.transform import Rotation

    names = ("lat", "lon", "alt", "roll", "pitch", "yaw")
    table = read_numbers(source, delimiter=None, widths=(OXTS_COLUMNS,), names=names)
    latitude, longitude = table.bounded(0, -89.0, 89.0), table.bounded(1, -180.0, 180.0)
    altitude = table.metres(2)
    angles = np.column_stack([table.bounded(k, -1e3, 1e3) for k in (5, 4, 3)])
    # The devkit's Mercator projection, true to scale at the latitude of the first pose.
    scale = np.cos(np.deg2rad(latitude[0])) * _EARTH_RADIUS
    poses = np.tile(np.eye(4), (len(latitude), 1, 1))
    poses[:, 0, 3] = scale * np.deg2rad(longitude)
    poses[:, 1, 3] = scale * np.log(np.tan(np.deg2rad(90.0 + latitude) / 2.0))
    poses[:, 2, 3] = altitude
    poses[:, :3, 3] -= poses[0, :3, 3].copy()
    poses[:, :3, :3] = Rotation.from_euler("ZYX", angles).as_matrix()
    return poses


_CALIBRATION = (
    (("R_rect", "R0_rect", "R_rect_00"), 9),
    (("Tr_velo_cam", "Tr_velo_to_cam"), 12),
    (("Tr_imu_velo", "Tr_imu_to_velo"), 12),
)  # names of a matrix and number of its elements


def _read_camera_to_imu(path: Path) -> FloatArray:
    """Return the rigid motion (4, 4) from the rectified camera to the inertial unit."""
    lines = {}
    for number, line in enumerate(Source.open(path).lines, 1):
        head, _, numbers = line.strip().partition(" ")
        lines[head.rstrip(":")] = (number, numbers)
    to_camera = np.eye(4)
    for names, size in _CALIBRATION:
        name = next((one for one in names if one in lines), None)
        if name is None:
            raise InputError(f"no {names[0]}", f"a line {' or '.join(names)}", path=path)
        number, text = lines[name]
        values = [parse_number(cell) for cell in text.split()]
        if len(values) != size or not all(v is not None and abs(v) < 1e4 for v in values):
            expected = f"{size} numbers within ±1e4"
            raise InputError(repr(text[:40]), expected, path=path, line=number, column=name)
        matrix = np.eye(4)
        matrix[:3, : size // 3] = np.array(values, dtype=float).reshape(3, -1)
        if not np.allclose(matrix[:3, :3] @ matrix[:3, :3].T, np.eye(3), atol=1e-3):
            raise InputError("a matrix that is no rotation", "one", path=path, line=number, column=name)
        # From the left: rectification ∘ (laser → camera) ∘ (inertial unit → laser).
        to_camera = to_camera @ matrix
    return np.asarray(np.linalg.inv(to_camera), dtype=float)


KITTI = Format(
    name="kitti",
    description="KITTI tracking labels with ego motion and calibration",
    suffixes=(),
    read=read,
)
