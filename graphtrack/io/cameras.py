"""Projection of pixels and boxes to the ground: a reader's camera, its files, and a scale without camera."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType

import numpy as np

from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray
from graphtrack.geometry.camera import GroundCamera, check_homography
from graphtrack.io.atomic import atomic_path
from graphtrack.io.options import ReadOptions
from graphtrack.io.source import Source
from graphtrack.io.text import read_numbers
from graphtrack.tracks.table import Rows, no_camera
from graphtrack.tracks.validation import parse_number

NO_CAMERA = "NO CAMERA IS KNOWN"
"""Beginning of that note: without a camera distances are approximate, and differ between files."""

PERSON_HEIGHT = 1.7
"""Metres; the scale of views without a camera is chosen so that the median person has this size."""

_LARGEST_SETTING = 1e7
_DISTORTION = tuple(f"Distortion{name}" for name in ("K1", "K2", "P1", "P2", "K3"))
_PER_PIXEL, _TILT = "MetresPerPixel", "TiltDegrees"
_FISHEYE = tuple(f"FisheyeK{k}" for k in (1, 2, 3, 4))  # any of these names means a fisheye lens
_QUATERNION = ("RotationX", "RotationY", "RotationZ", "RotationW")

BEYOND_HORIZON = "at or beyond the camera's horizon"


def known_camera(options: ReadOptions, visible: FloatArray) -> tuple[GroundCamera | None, tuple[str, ...]]:
    """Return the camera that the options name, and notes on it; None if they name none.

    Parameters
    ----------
    options : read in the order camera, homography, point pairs, calibration
    visible : (n, 2) pixels of people's feet, which are on the visible side of the horizon
    """
    if options.camera is not None:
        return options.camera, ()
    if options.homography is not None:
        if isinstance(options.homography, str | Path):
            homography = read_homography(options.homography)
        else:
            homography = np.asarray(options.homography, dtype=float)
        camera = GroundCamera.from_homography(homography, visible=visible)
        return camera, _handedness(camera)
    if options.point_pairs is not None:
        return camera_of_point_pairs(options.point_pairs)
    if options.calibration is not None:
        return read_calibration(options.calibration), ()
    return None, ()


def _handedness(camera: GroundCamera) -> tuple[str, ...]:
    if not camera.is_mirrored:
        return ()
    return (
        "the ground of the homography is left-handed as seen from above: so are all positions and angles; "
        "negate its second row, or Y of the point pairs",
    )


def camera_or_scale(
    options: ReadOptions, visible: FloatArray, size: FloatArray, *, size_is: str = "box height"
) -> tuple[GroundCamera, tuple[str, ...]]:
    """Return the camera that the options name or, failing that, a scale.

    Parameters
    ----------
    visible : (n, 2) pixels of people's feet
    size : (n,) pixels, image sizes of people
    size_is : what ``size`` measures, for the note
    """
    camera, notes = known_camera(options, visible)
    if camera is not None:
        return camera, notes
    if options.metres_per_pixel is not None:
        scale = options.metres_per_pixel
        return GroundCamera.from_scale(scale, nadir=options.nadir), (
            f"positions are pixels times {scale:g} m, with no regard to perspective",
        )
    size = size[size > 0.0]
    if not len(size):
        raise InputError(f"no {size_is} above 0", "one to take the scale from, or a camera")
    scale = PERSON_HEIGHT / float(np.median(size))
    return GroundCamera.from_scale(scale, nadir=options.nadir), (
        f"{NO_CAMERA}: positions are pixels times {scale:.4g} m, so that the median {size_is} is "
        f"{PERSON_HEIGHT} m, with no regard to perspective; give homography, point_pairs or metres_per_pixel",
    )


def on_ground(rows: Rows, camera: GroundCamera, notes: tuple[str, ...] = ()) -> Rows:
    """Rows with positions (metres) for their pixels; those beyond the horizon are refused."""
    position = camera.image_to_ground(rows.channels["pixel"])
    unseen = np.isnan(position).any(axis=1) & np.isfinite(rows.channels["pixel"]).all(axis=1)
    rows = rows.with_channels(position=position).with_camera(camera)
    return rows.with_notes(*notes).keep(np.logical_not(unseen), BEYOND_HORIZON)


def place_pixels(rows: Rows, options: ReadOptions) -> Rows:
    """Add positions to rows of the native table, projected from their pixels if they have none."""
    pixel = rows.channels.get("pixel")
    if pixel is None:
        return rows
    camera, notes = known_camera(options, pixel)
    if camera is None and options.metres_per_pixel is not None:
        camera, notes = camera_or_scale(options, pixel, np.ones(1))
    if "position" in rows.channels:
        if camera is None:
            return rows
        kept = "positions are the file's x, y; the camera serves for pixels and pose angles only"
        return rows.with_camera(camera).with_notes(*notes, kept)
    if camera is None:
        raise no_camera(rows)
    return on_ground(rows, camera, notes)


def read_homography(path: str | Path) -> FloatArray:
    """Read a 3×3 matrix from a text file (spaces or commas)."""
    source = Source.open(path)
    numbers = read_numbers(source, delimiter=None, widths=(3, 9), names=(), comments=True)
    if numbers.values.size != 9:
        raise InputError(
            f"{numbers.values.size} numbers", "the nine of a 3×3 homography, image to ground", path=path
        )
    try:
        return check_homography(numbers.values.reshape(3, 3))
    except InputError as error:
        raise error.at(path) from error


def read_homographies(path: str | Path, first: int) -> dict[int, FloatArray]:
    """Read one homography a frame, image to ground, from text (spaces or commas), with a header or without.

    Parameters
    ----------
    path : of lines with ten numbers, the frame and the homography row by row; or with the nine of the
        homography alone, of all frames in order
    first : number of the recording's first frame

    Returns
    -------
    dict
        Frame → (3, 3), as it is in the file.

    Raises
    ------
    InputError
        With the line of a cell that cannot be used, of a second homography of a frame, or of a singular one.
    """
    source = Source.open(path)
    head = next((k for k, line in enumerate(source.lines) if line.partition("#")[0].strip()), 0)
    cells = source.lines[head].replace(",", " ").split()
    titles = bool(cells) and not any(parse_number(cell) is not None for cell in cells)
    table = read_numbers(
        source,
        delimiter=None,
        widths=(9, 10),
        names=(),
        comments=True,
        skip=head + 1 if titles else 0,
    )
    numbered = table.values.shape[1] == 10
    frames = table.integers(0) if numbered else first + np.arange(len(table.values))
    found: dict[int, FloatArray] = {}
    for row, (frame, values) in enumerate(zip(frames.tolist(), table.values[:, -9:], strict=True)):
        if frame in found:
            raise source.fail(f"frame {frame} again", "one homography a frame", line=table.line_of(row))
        try:
            found[frame] = check_homography(values.reshape(3, 3))
        except InputError as error:
            raise error.at(path, table.line_of(row)) from error
    return found


def read_calibration(path: str | Path) -> GroundCamera:
    """Read a camera from the ``Name = number`` lines of an Oxford Town Centre calibration (``.ci``).

    x_cam = R(q)·X + t in metres, z = 0 the ground; skew must be 0. With a line ``FisheyeK1 = number`` (to
    ``FisheyeK4``, 0 where there is none) the lens is a fisheye of OpenCV's model. A line
    ``MetresPerPixel = number`` alone is a view from above at that scale, and with ``TiltDegrees = number``
    one from far away that looks down by that angle.
    """
    values = _read_settings(path)
    if _PER_PIXEL in values and values.keys() <= {_PER_PIXEL, _TILT}:
        scale, tilt = values[_PER_PIXEL], values.get(_TILT, 90.0)
        if not scale > 0.0:
            raise InputError(f"a scale of {scale:g} m a pixel", "more than 0", path=path)
        if not 0.0 < tilt <= 90.0:
            raise InputError(f"a tilt of {tilt:g}°", "above 0 and up to 90", path=path)
        return GroundCamera.from_scale(scale, tilt=math.radians(tilt))

    def take(*names: str) -> list[float]:
        for name in names:
            if name not in values:
                raise InputError(f"no {name}", f"a line {name} = number", path=path)
        return [values[name] for name in names]

    from scipy.spatial.transform import Rotation

    quaternion = np.array(take(*_QUATERNION))
    if not 0.9 < np.linalg.norm(quaternion) < 1.1:
        raise InputError(f"a rotation {quaternion.tolist()}", "a unit quaternion", path=path)
    fx, fy, cx, cy = take("FocalLengthX", "FocalLengthY", "PrincipalPointX", "PrincipalPointY")
    if min(fx, fy) < 1.0:
        raise InputError(f"focal lengths {fx:g}, {fy:g}", "at least a pixel", path=path)
    fisheye = any(name in values for name in _FISHEYE)
    if fisheye and any(values.get(name, 0.0) for name in _DISTORTION):
        raise InputError("FisheyeK… and Distortion…", "one of the two models of a lens", path=path)
    try:
        return GroundCamera.from_calibration(
            Rotation.from_quat(quaternion).as_matrix(),
            np.array(take("TranslationX", "TranslationY", "TranslationZ")),
            np.array([[fx, values.get("Skew", 0.0), cx], [0.0, fy, cy], [0.0, 0.0, 1.0]]),
            np.array([values.get(name, 0.0) for name in (_FISHEYE if fisheye else _DISTORTION)]),
            lens="fisheye" if fisheye else "pinhole",
        )
    except InputError as error:
        raise error.at(path) from error


def write_calibration(
    path: str | Path,
    rotation: FloatArray,
    translation: FloatArray,
    intrinsics: FloatArray,
    *,
    distortion: Sequence[float] | FloatArray = (),
    fisheye: Sequence[float] | FloatArray = (),
    remarks: Mapping[str, float] = MappingProxyType({}),
) -> None:
    """Write a camera that `read_calibration` reads, with a lens of one of the two models.

    Parameters
    ----------
    rotation, translation : (3, 3) and (3,) metres: a point X of the world has camera coordinates R·X + t
    intrinsics : (3, 3) camera matrix in pixels
    distortion : k1, k2, p1, p2, k3 of OpenCV's model; none for a lens without
    fisheye : k1 … k4 of OpenCV's fisheye model; none for a pinhole
    remarks : further lines, such as its uncertainty, under names that `read_calibration` does not know
    """
    from scipy.spatial.transform import Rotation

    values = {
        "FocalLengthX": intrinsics[0, 0],
        "FocalLengthY": intrinsics[1, 1],
        "PrincipalPointX": intrinsics[0, 2],
        "PrincipalPointY": intrinsics[1, 2],
        "Skew": intrinsics[0, 1],
        **dict(zip(_DISTORTION, distortion, strict=len(distortion) > 0)),
        **dict(zip(_FISHEYE, fisheye, strict=len(fisheye) > 0)),
        **dict(zip(("TranslationX", "TranslationY", "TranslationZ"), translation, strict=True)),
        **dict(zip(_QUATERNION, Rotation.from_matrix(rotation).as_quat(), strict=True)),
        **remarks,
    }
    _write_settings(path, values)


def write_scale(path: str | Path, metres_per_pixel: float, tilt: float = math.pi / 2.0) -> None:
    """Write a scale without perspective that `read_calibration` reads; ``tilt`` in radians."""
    tilted = {} if tilt == math.pi / 2.0 else {_TILT: math.degrees(tilt)}
    _write_settings(path, {_PER_PIXEL: metres_per_pixel, **tilted})


def _write_settings(path: str | Path, values: Mapping[str, float]) -> None:
    with atomic_path(path) as temporary, temporary.open("w", encoding="ascii", newline="\n") as stream:
        stream.writelines(f"{name} = {float(value)!r}\n" for name, value in values.items())


def _read_settings(path: str | Path) -> Mapping[str, float]:
    settings: dict[str, float] = {}
    for number, line in enumerate(Source.open(path).lines, 1):
        if not line.strip():
            continue
        name, equals, text = (part.strip() for part in line.partition("="))
        try:
            value = float(text)
        except ValueError:
            value = float("nan")
        if not equals or not abs(value) <= _LARGEST_SETTING:
            raise InputError(repr(line.strip()[:60]), "Name = number", path=path, line=number)
        settings[name] = value
    return settings


def read_point_pairs(path: str | Path) -> FloatArray:
    """Read pixels and their points on the ground (n, 4): u, v, and X, Y in metres."""
    names = ("u", "v", "X", "Y")
    return read_numbers(Source.open(path), delimiter=None, widths=(4,), names=names, comments=True).values


def camera_of_point_pairs(path: str | Path) -> tuple[GroundCamera, tuple[str, ...]]:
    """Return the camera of a file of point pairs, by a homography (DLT), and notes on it.

    Raises
    ------
    InputError
        For fewer than four pairs, or pairs that determine no homography.
    """
    numbers = read_point_pairs(path)
    try:
        camera, fit = GroundCamera.from_point_pairs(numbers[:, :2], numbers[:, 2:])
    except InputError as error:
        raise error.at(path) from error
    exact = " (four pairs always fit exactly)" if fit.n_pairs == 4 else ""
    return camera, (
        f"homography from {fit.n_pairs} point pairs: reprojection error {fit.rms_error:.3g} m RMS, "
        f"{fit.max_error:.3g} m at most{exact}",
        *_odd_pair(numbers, fit.rms_error),
        *_handedness(camera),
    )


_ENOUGH_PAIRS, _ODD = 6, 5.0
"""Pairs from which one can be told from the others, and how much better these fit without it."""


def _odd_pair(numbers: FloatArray, rms_of_all: float) -> tuple[str, ...]:
    """Return a note on the one point pair that the others contradict, if there is one."""
    count = len(numbers)
    if count < _ENOUGH_PAIRS:
        return ()
    pixel, ground = numbers[:, :2], numbers[:, 2:]
    left_out = []
    for k in range(count):
        rest = np.arange(count) != k
        try:
            camera, fit = GroundCamera.from_point_pairs(pixel[rest], ground[rest])
        except InputError:  # those left are on a line
            continue
        away = float(np.linalg.norm(camera.image_to_ground(pixel[k]) - ground[k]))
        left_out.append((fit.rms_error, away, k))
    rms, away, k = min(left_out, default=(np.inf, 0.0, 0))
    if not (_ODD * rms < rms_of_all and away > _ODD * rms):
        return ()
    pair = " ".join(f"{value:g}" for value in numbers[k])
    return (f"the pair {pair} is {away:.3g} m from where the others place it, which fit to {rms:.2g} m",)


def placed_boxes(rows: Rows, options: ReadOptions) -> Rows:
    """Add positions: the file's metres, or the middle of each box's lower edge projected to the ground.

    Parameters
    ----------
    rows : with the channel ``box`` (n, 4), left, top, width and height in pixels, NaN where a row has none
    """
    left, top, width, height = rows.channels["box"].T
    pixel = np.column_stack([left + width / 2.0, top + height])
    rows = rows.with_channels(pixel=pixel)
    if "position" in rows.channels:
        camera, notes = known_camera(options, pixel)
        return rows.with_camera(camera).with_notes(*notes, "positions are columns 8 and 9, in metres")
    known = np.asarray(np.isfinite(pixel).all(axis=1))
    if len(known) and not known.any():
        raise InputError("neither boxes nor metres", "one of them", path=rows.path)
    if not len(rows):
        return rows.with_channels(position=pixel)
    camera, notes = camera_or_scale(options, pixel, rows.channels["box"][known, 3])
    return on_ground(rows, camera, notes)


def boxes_on_ground(position: FloatArray, camera: GroundCamera) -> FloatArray:
    """Return boxes (n, 4) left, top, width and height in pixels of people at positions (n, 2) in metres.

    The middle of the lower edge is the position; a person is `PERSON_HEIGHT` tall and 0.41 times as wide,
    upwards as many pixels as for the same length sideways on the ground. NaN behind the camera.
    """
    foot = camera.ground_to_image(position)
    bearing = camera.ray_bearing(position) + np.pi / 2.0
    aside = 0.5 * PERSON_HEIGHT * np.column_stack([np.cos(bearing), np.sin(bearing)])
    ends = camera.ground_to_image(position + aside), camera.ground_to_image(position - aside)
    height = np.linalg.norm(ends[0] - ends[1], axis=1)
    width = 0.41 * height
    drawable = np.isfinite(foot).all(axis=1) & (height > 1e-3) & (np.abs(foot).max(axis=1) + height < 1e6)
    box = np.column_stack([foot[:, 0] - width / 2.0, foot[:, 1] - height, width, height])
    return np.where(drawable[:, None], box, np.nan)


def with_scores(rows: Rows) -> Rows:
    """Add the channel ``score`` (n,) to detections, from their confidences; rows with identities stay as is.

    Detectors differ in their scale of confidence. Non-negative confidences are kept. Where some are negative,
    such as log odds and distances from a separating plane (the DPM of MOT16), all scores are
    1 / (1 + exp(-confidence)), which keeps their order, and a note is added. -1 throughout means unknown.
    """
    confidence = rows.channels["confidence"]
    if rows.has_identity or (confidence == -1.0).all():
        return rows
    if not (confidence < 0.0).any():
        return rows.with_channels(score=confidence)
    note = "some confidences are negative: scores are 1 / (1 + exp(-confidence))"
    logistic = 0.5 * (1.0 + np.tanh(0.5 * confidence))  # exp would overflow
    return rows.with_channels(score=logistic).with_notes(note)
