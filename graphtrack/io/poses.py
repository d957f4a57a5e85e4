"""Readers of poses of moving sensors, and rows of a file turned into the world by them.

Tables (CSV, Parquet, NDJSON), text of TUM, KITTI odometry and EuRoC, KITTI's oxts, and tf of ROS 2 recordings
are recognised by their content.

References
----------
Sturm, Engelhard, Endres, Burgard & Cremers, A benchmark for the evaluation of RGB-D SLAM systems, IROS 2012.
Geiger, Lenz & Urtasun, Are we ready for autonomous driving? The KITTI vision benchmark suite, CVPR 2012.
Burri et al., The EuRoC micro aerial vehicle datasets, IJRR 2016.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray
from graphtrack.geometry.poses import PosePath
from graphtrack.io.column_names import with_synonyms
from graphtrack.io.format import is_recording, recognised
from graphtrack.io.options import PoseAxes, ReadOptions
from graphtrack.io.registry import format_named
from graphtrack.io.source import Source, place_of
from graphtrack.io.text import Numbers, mostly_numbers, read_numbers
from graphtrack.packages import transform
from graphtrack.tracks.cells import METRES, Cells, labels, numbers, times
from graphtrack.tracks.display import listed
from graphtrack.tracks.moving import EVERY, rows_in_world
from graphtrack.tracks.table import Rows
from graphtrack.tracks.time import from_nanoseconds, from_numbers
from graphtrack.tracks.validation import LARGEST_DEGREES, LARGEST_METRES, SENSOR_NAME, is_sensor_name

_QUATERNION = ("qx", "qy", "qz", "qw")
_EUROC = b"#timestamp"
_BASE = "base_link"
"""Frame of rows without a sensor, by REP 105."""

_STEEP = 0.1
"""Horizontal part of a forward axis below which it has no heading."""

_UNITS = ((1e11, "s"), (1e14, "ms"), (1e17, "us"), (np.inf, "ns"))
"""Upper bound of times that count from 1970 → their unit."""


@dataclass(frozen=True, eq=False)
class PoseFile:
    """Content of a file of poses.

    Attributes
    ----------
    paths : name of a sensor → its poses; `EVERY` for those without a name
    origin : nanoseconds since 1970 at t = 0; 0 for times of another beginning
    notes : what was assumed, one sentence each
    """

    paths: Mapping[str, PosePath]
    origin: int = 0
    notes: tuple[str, ...] = ()


def placed_by_poses(rows: Rows, options: ReadOptions) -> Rows:
    """Return rows turned into the world by the options' poses; rows as they are without poses.

    Raises
    ------
    InputError
        If the rows are in the world already, no sensor of theirs has poses, or no row has a time with a pose.
    """
    given = options.poses
    if given is None:
        return rows
    if rows.format == "kitti":
        expected = "no poses: labels of KITTI are read into the world with --oxts"
        raise InputError("poses with labels of KITTI", expected, path=rows.path)
    names = [""] if rows.sensor is None else np.unique(rows.sensor).tolist()
    if isinstance(given, str | Path):
        path: str | Path = given
        found = read_poses(given, options, names)
        beginning = 0 if rows.as_read is None or rows.as_read.time is None else rows.as_read.time.origin
        paths = {name: one.shifted((found.origin - beginning) / 1e9) for name, one in found.paths.items()}
    else:
        path, beginning = "the poses", 0
        paths = {EVERY: given} if isinstance(given, PosePath) else dict(given)
        found = PoseFile(paths)
    own = [name for name in names if EVERY in paths or name in paths]
    if not own:
        there = listed(name or "without a name" for name in paths)
        of_rows = listed(names) if names != [""] else "without a column sensor"
        raise InputError(f"poses of {there}, and rows {of_rows}", "rows of these sensors", path=path)
    t = rows.channels["t"]
    placed = rows_in_world(rows, paths)
    if len(rows) and not len(placed):
        begin, end = t.min() + beginning / 1e9, t.max() + beginning / 1e9
        first = min(one.t[0] for one in paths.values()) + beginning / 1e9
        last = max(one.t[-1] for one in paths.values()) + beginning / 1e9
        text = f"poses from {first:.15g} to {last:.15g} s, and rows from {begin:.15g} to {end:.15g} s"
        raise InputError(text, "times of one clock (--time-unit is that of the rows)", path=path)
    return placed.with_notes(*found.notes)


def read_poses(
    path: str | Path, options: ReadOptions = ReadOptions(), names: Collection[str] = (EVERY,)
) -> PoseFile:
    """Read poses of any known format.

    Parameters
    ----------
    path : of a file; of a folder of KITTI's raw data with ``timestamps.txt`` and ``data``; or of a recording
    options : frame rate of poses without times, ``pose_axes``, and ``fixed_frame`` of a recording
    names : sensors whose poses are wanted, of a recording with any number of frames

    Raises
    ------
    InputError
        With path, line and column, the value found and the value expected.
    """
    place = place_of(path)
    try:
        if is_recording(place):
            return _of_recording(place, options, names)
        return _of_folder(place, options) if place.is_dir() else _of_file(place, options)
    except InputError as error:
        raise error.at(error.path or place) from error


def _of_file(place: Path, options: ReadOptions) -> PoseFile:
    source = Source.open(place, options.limit(place))
    if source.head.startswith((_EUROC, b"\xef\xbb\xbf" + _EUROC)):
        return _of_euroc(source, options)
    for count, reader in ((8, _of_tum), (12, _of_odometry), (30, _of_oxts)):
        if mostly_numbers(_without_comments(source), None, (count,)):
            return reader(source, options)
    known = recognised(source.head, source.path)
    table = format_named("csv" if known not in ("parquet", "ndjson") else known)
    assert table.cells is not None
    return _of_table(table.cells(source, ReadOptions()), options)


def _without_comments(source: Source) -> bytes:
    lines = (line for line in source.head.split(b"\n") if not line.lstrip().startswith(b"#"))
    return b"\n".join(lines)


def _of_table(cells: Cells, options: ReadOptions) -> PoseFile:
    """Read columns t, x, y and yaw_deg or a quaternion, with optional deviations and sensors."""
    names = list(cells.columns)
    known, notes = with_synonyms(names, ReadOptions(), cells.path)
    named = {"t": "t", "x": "x", "y": "y", **(known.columns if isinstance(known.columns, Mapping) else {})}
    turned = [name for name in _QUATERNION if name in names]
    needed = [*(named[key] for key in ("t", "x", "y")), *(("z", *_QUATERNION) if turned else ("yaw_deg",))]
    missing = next((name for name in needed if name not in names), None)
    if missing is not None:
        expected = "columns t, x, y, yaw_deg or t, x, y, z, qx, qy, qz, qw; or text of TUM, KITTI or EuRoC"
        raise cells.fail(f"no column {missing} of poses", expected, column=missing)
    metre = METRES[known.units or "m"]
    t, scale, _ = times(cells, named["t"], known.time_unit or _unit_of(cells, named["t"]), None)
    cells.refuse(np.isnan(t), named["t"], "a time")

    def column(name: str, low: float, high: float) -> FloatArray:
        values = numbers(cells, name)
        with np.errstate(invalid="ignore"):
            cells.refuse(~((values >= low) & (values <= high)), name, f"a number from {low:g} to {high:g}")
        return values

    x, y = (metre * column(named[key], -LARGEST_METRES, LARGEST_METRES) for key in ("x", "y"))
    if turned:
        z = column("z", -LARGEST_METRES, LARGEST_METRES)
        quaternion = np.column_stack([column(name, -1.1, 1.1) for name in _QUATERNION])
        x, y, yaw = _in_plane(
            np.column_stack([x, y, metre * z]),
            _rotations(quaternion, lambda row, e: cells.fail("a quaternion of another length", e, row, "qw")),
            options.pose_axes,
            lambda row, found, expected: cells.fail(found, expected, row),
        )
    else:
        yaw = np.deg2rad(column("yaw_deg", -LARGEST_DEGREES, LARGEST_DEGREES))
    covariance = np.zeros((len(t), 3, 3))
    for k, (name, unit) in enumerate((("x_std", metre), ("y_std", metre), ("yaw_std_deg", np.pi / 180.0))):
        if name in names:
            covariance[:, k, k] = (unit * column(name, 0.0, LARGEST_METRES)) ** 2
    if ("x_std" in names) != ("y_std" in names):
        alone = "x_std" if "x_std" in names else "y_std"
        raise cells.fail(f"{alone} alone", "both x_std and y_std, or neither", column=alone)
    sensor = np.full(len(t), EVERY, dtype=object)
    if "sensor" in names:
        sensor = labels(cells, "sensor")
        cells.refuse(np.array([not is_sensor_name(one) for one in sensor.tolist()]), "sensor", SENSOR_NAME)
    paths = {}
    for name in dict.fromkeys(sensor.tolist()):
        own = np.flatnonzero(sensor == name)
        _check_order(t[own], partial(_of_rows, cells, own, named["t"]))
        of_sensor = f" of the sensor {name}" if name else ""
        if len(own) < 2:
            raise cells.fail(f"one pose{of_sensor}", "two at least")
        paths[name] = PosePath(t[own], x[own], y[own], yaw[own], covariance[own])
    return PoseFile(paths, scale.origin, notes)


def _of_rows(
    cells: Cells, rows: NDArray[np.int64], name: str, row: int, found: str, expected: str
) -> InputError:
    return cells.fail(found, expected, int(rows[row]), name)


def _unit_of(cells: Cells, name: str) -> str | None:
    """Return the unit of times that count from 1970, by their size; None for other times."""
    values = cells.columns[name]
    if values.dtype.kind not in "iufO":
        return None
    try:
        size = float(np.median(np.abs(values.astype(float))))
    except (TypeError, ValueError):  # text, or cells that are refused later
        return None
    return _by_size(size) if size >= _UNITS[0][0] else None


def _by_size(size: float) -> str:
    return next((unit for high, unit in _UNITS if size < high), "s")


_SPATIAL = ("tx", "ty", "tz", *_QUATERNION)


def _of_tum(source: Source, options: ReadOptions) -> PoseFile:
    table = read_numbers(source, delimiter=None, widths=(8,), names=("timestamp", *_SPATIAL), comments=True)
    return _of_numbers(table, table.values[:, 4:8], options)


def _of_euroc(source: Source, options: ReadOptions) -> PoseFile:
    names = ("timestamp", *_SPATIAL[:3], "qw", "qx", "qy", "qz")
    table = read_numbers(source, delimiter=None, widths=(8, 17), names=names, comments=True)
    return _of_numbers(table, table.values[:, [5, 6, 7, 4]], options)


def _of_numbers(table: Numbers, quaternion: FloatArray, options: ReadOptions) -> PoseFile:
    """Return the poses of rows with time, position and a quaternion (n, 4) as x, y, z, w."""
    times_ = table.values[:, 0]
    t, scale = from_numbers(times_, _by_size(float(np.median(np.abs(times_)))))
    rotations = _rotations(quaternion, lambda row, expected: table.fail(row, 4, expected))
    return PoseFile(
        {EVERY: _in_space(t, _places(table, (1, 2, 3)), rotations, options.pose_axes, table)}, scale.origin
    )


def _of_odometry(source: Source, options: ReadOptions) -> PoseFile:
    """Read KITTI odometry: the upper three rows of a matrix a line, of a camera."""
    table = read_numbers(source, delimiter=None, widths=(12,), names=())
    matrices = table.values.reshape(-1, 3, 4)
    rotations = matrices[:, :, :3]
    wrong = np.abs(rotations @ rotations.transpose(0, 2, 1) - np.eye(3)).max(axis=(1, 2)) > 0.01
    if wrong.any():
        raise table.fail(int(wrong.argmax()), 0, "twelve numbers of a rotation and a position")
    t, note = _times_of_frames(source, len(matrices), options)
    path = _in_space(t, _places(table, (3, 7, 11)), rotations, options.pose_axes or "camera", table)
    return PoseFile({EVERY: path}, notes=note)


def _of_oxts(source: Source, options: ReadOptions) -> PoseFile:
    """Read KITTI's ego motion, a line a frame."""
    from graphtrack.io.formats.kitti import FPS, ego_poses

    poses = ego_poses(source)
    rate = options.fps or FPS
    return PoseFile(
        {EVERY: _level(np.arange(len(poses)) / rate, poses, source)},
        notes=(f"{len(poses)} poses of KITTI's oxts at {rate:g} frames a second",),
    )


def _of_folder(folder: Path, options: ReadOptions) -> PoseFile:
    """Read a folder oxts of KITTI's raw data: a file a frame, and their times as text."""
    from graphtrack.io.formats.kitti import ego_poses

    files = sorted((folder / "data").glob("*.txt"))
    if not files or not (folder / "timestamps.txt").is_file():
        raise InputError("a folder", "a file of poses, or KITTI's folder oxts with its data", path=folder)
    lines = [Source.open(one, options.limit(one)).text.strip() for one in files]
    stamps = [line for line in Source.open(folder / "timestamps.txt").lines if line.strip()]
    if len(stamps) != len(lines):
        found = f"{len(stamps)} times of {len(lines)} files in data"
        raise InputError(found, "a time for each", path=folder / "timestamps.txt")
    cells = Cells(
        folder / "timestamps.txt", "oxts", {"t": np.array(stamps, dtype=object)}, lambda row: row + 1
    )
    t, scale, _ = times(cells, "t", "iso", None)
    source = Source(folder / "data", "\n".join(lines).encode())
    return PoseFile({EVERY: _level(t, ego_poses(source), source)}, scale.origin)


def _level(t: FloatArray, poses: FloatArray, source: Source) -> PosePath:
    """Return the path of poses (n, 4, 4) of a vehicle: forward, left and up."""
    _check_order(t, lambda row, found, expected: source.fail(found, expected, row + 1))
    return PosePath(t, poses[:, 0, 3], poses[:, 1, 3], np.arctan2(poses[:, 1, 0], poses[:, 0, 0]))


def _times_of_frames(source: Source, n: int, options: ReadOptions) -> tuple[FloatArray, tuple[str, ...]]:
    """Return times (n,) of frames from 0 on: at the frame rate, or those of a file ``times.txt``."""
    if options.fps is not None:
        return np.arange(n) / options.fps, ()
    folder, stem = source.path.absolute().parent, source.path.stem
    places = (folder / "times.txt", folder.parent / "sequences" / stem / "times.txt")
    place = next((one for one in places if one.is_file()), None)
    if place is None:
        raise source.fail("poses without times", "a frame rate (--fps), or times.txt in the same folder")
    table = read_numbers(Source.open(place), delimiter=None, widths=(1,), names=("t",))
    if len(table.values) != n:
        raise InputError(f"{len(table.values)} times of {n} poses", "a time for each", path=place)
    return table.values[:, 0], (f"times of poses from {place.name}",)


def _of_recording(path: Path, options: ReadOptions, names: Collection[str]) -> PoseFile:
    """Read the frames of tf that are named like sensors, and base_link for all other rows."""
    from graphtrack.io.formats.ros.bag import open_bag, yaw_of
    from graphtrack.io.formats.ros.reading import FIXED_FRAMES, transforms_of

    with open_bag(path, options.limit(path)) as bag:
        transforms = transforms_of(bag)
    frames = transforms.frames
    fixed = options.fixed_frame or next((one for one in FIXED_FRAMES if one in frames), None)
    if fixed is None or fixed.lstrip("/") not in frames:
        there = listed(frames, 20) if frames else "none: the recording has no tf"
        raise InputError(
            f"no fixed frame {fixed or 'map'!r}", f"--fixed-frame with one of {there}", path=path
        )
    fixed = fixed.lstrip("/")
    moving: dict[str, tuple[NDArray[np.int64], Any]] = {}
    for name in {*names, EVERY}:
        frame = (name or _BASE).lstrip("/")
        if frame not in frames or frame == fixed:
            continue
        try:
            stamps = transforms.stamps(frame, fixed)
            found = transforms.placement(frame, fixed, stamps)
        except InputError as error:
            raise error.at(path) from error
        known = found.known & np.isfinite(yaw_of(found.quaternion))
        if known.sum() > 1:
            yaw = yaw_of(found.quaternion[known])
            moving[name] = stamps[known], (*found.translation[known, :2].T, yaw)
    if not moving:
        raise InputError(
            f"no tf of {listed(n or _BASE for n in names)} in {fixed!r}", "moving frames", path=path
        )
    origin = from_nanoseconds(np.concatenate([stamps for stamps, _ in moving.values()]), None)[1]
    paths = {name: PosePath((stamps - origin) / 1e9, *pose) for name, (stamps, pose) in moving.items()}
    shown = listed(sorted(name or _BASE for name in moving))
    return PoseFile(paths, origin, (f"poses of {shown} in {fixed}, from tf",))


def _places(table: Numbers, columns: tuple[int, int, int]) -> FloatArray:
    return np.column_stack([table.metres(column) for column in columns])


def _in_space(
    t: FloatArray, position: FloatArray, rotation: FloatArray, axes: PoseAxes | None, table: Numbers
) -> PosePath:
    def fail(row: int, found: str, expected: str) -> InputError:
        return table.source.fail(found, expected, table.line_of(row))

    _check_order(t, fail)
    return PosePath(t, *_in_plane(position, rotation, axes, fail))


Fail: TypeAlias = Callable[[int, str, str], InputError]
"""Function that makes the error for a row, what was found and what was expected."""


def _check_order(t: FloatArray, fail: Fail) -> None:
    back = np.flatnonzero(np.diff(t) <= 0.0)
    if len(back):
        raise fail(int(back[0]) + 1, f"t = {t[back[0] + 1]:.15g} after {t[back[0]]:.15g} s", "a later time")


def _rotations(quaternion: FloatArray, fail: Callable[[int, str], InputError]) -> FloatArray:
    """Return rotation matrices (n, 3, 3) of quaternions x, y, z, w."""
    length = np.linalg.norm(quaternion, axis=1)
    wrong = np.abs(length - 1.0) > 0.1
    if wrong.any():
        raise fail(int(wrong.argmax()), "a quaternion of length 1")
    return np.asarray(transform.Rotation.from_quat(quaternion).as_matrix(), dtype=float)


def _in_plane(
    position: FloatArray, rotation: FloatArray, axes: PoseAxes | None, fail: Fail
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return x, y and the heading of the forward axis (n,) on the ground plane.

    The world's z axis points up, unless a camera's y axis (down) points along the world's: then the ground is
    that of the first camera, z forward and x right, as in KITTI odometry and ORB-SLAM.
    """
    camera = axes == "camera"
    forward = rotation[:, :, 2 if camera else 0]
    if camera and rotation[:, 1, 1].mean() > 0.7:
        ground = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0]])
        up = np.array([0.0, -1.0, 0.0])
    else:
        ground, up = np.eye(3)[:2], np.array([0.0, 0.0, 1.0])
    place, heading, height = position @ ground.T, forward @ ground.T, position @ up
    other = "robot (x forward, z up)" if camera else "camera (z forward, y down)"
    if np.ptp(height) > max(1.0, float(np.ptp(place, axis=0).max())):
        found = f"poses that rise by {np.ptp(height):.3g} m and move by {np.ptp(place, axis=0).max():.3g} m"
        raise fail(0, found, f"motion on the ground; --pose-axes {other} for other axes")
    steep = np.linalg.norm(heading, axis=1) < _STEEP
    if steep.any():
        found = f"a sensor whose {'z' if camera else 'x'} axis points up or down"
        raise fail(int(steep.argmax()), found, f"a forward axis; --pose-axes {other} for other axes")
    return place[:, 0], place[:, 1], np.arctan2(heading[:, 1], heading[:, 0])
