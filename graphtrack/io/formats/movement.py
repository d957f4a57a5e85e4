"""Datasets of the package movement, their netCDF files, and files that movement reads (extra ``poses``)."""

from __future__ import annotations

import io
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module
from itertools import chain
from pathlib import Path
from tempfile import TemporaryDirectory
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Unpack

import numpy as np
from numpy.typing import NDArray

from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray, wrap
from graphtrack.io.cameras import camera_or_scale, known_camera, on_ground, place_pixels
from graphtrack.io.format import CLASSIC, HDF5, Format, rate_of, steady_rate
from graphtrack.io.options import Reading, ReadOptions
from graphtrack.io.poses import placed_by_poses
from graphtrack.io.source import Source
from graphtrack.packages import package
from graphtrack.tracks.cells import METRES, Layout, numbered_names, numbered_times
from graphtrack.tracks.display import listed
from graphtrack.tracks.schema import is_input_name, repeated
from graphtrack.tracks.table import AsRead, Rows
from graphtrack.tracks.time import TimeScale, distinct_times, from_dates
from graphtrack.tracks.track import TrackSet, channel_of
from graphtrack.tracks.validation import FIELDS, INPUT, LARGEST_FRAME, LARGEST_ID, SHAPES, STATE

if TYPE_CHECKING:
    import xarray

TIME, SPACE, KEYPOINTS, INDIVIDUALS = "time", "space", "keypoints", "individuals"

FURTHER: Mapping[str, tuple[str, ...]] = MappingProxyType(
    dict.fromkeys((name for name in FIELDS if name not in ("t", "position")), ())
    | {
        "position_covariance": (SPACE, "other_space"),
        "pixel": ("image",),
        "observed_velocity": (SPACE,),
        "observed_velocity_covariance": (SPACE, "other_space"),
        "velocity": (SPACE,),
        "true_position": (SPACE,),
        "body_likelihood": ("body_class",),
        "head_likelihood": ("head_class",),
        "covariance": ("state", "other_state"),
    }
)
"""Attribute of a `Track` → dimensions of its variable of that name other than time and individuals."""

LENGTHS = {
    **dict.fromkeys(("position_std", "velocity", "observed_velocity", "true_position"), 1),
    **dict.fromkeys(("position_covariance", "observed_velocity_covariance"), 2),
}
"""Variables in the unit of the positions, or in that unit a second, and the power of it."""

HAS_ROW = "has_row"
"""Variable (time, individuals), a mask of rows, used if some rows have no position."""

PARTIAL = "with a part of what gives a position"

SPACE_UNITS = {
    **dict.fromkeys(("m", "metre", "metres", "meter", "meters"), "m"),
    **dict.fromkeys(("cm", "centimetre", "centimetres", "centimeter", "centimeters"), "cm"),
    **dict.fromkeys(("mm", "millimetre", "millimetres", "millimeter", "millimeters"), "mm"),
    **dict.fromkeys(("ft", "feet", "foot"), "ft"),
}
"""Value of the positions' ``space_unit`` → unit."""


_WORD = re.compile(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+|\d+")
_SIDES = {"l": "left", "r": "right", "left": "left", "right": "right"}
_SAME = {"snout": "nose"}
_MIDDLES = ("centroid", "center", "centre", "position")

_ON_THE_GROUND = ("hip", "shoulder", "ear", "ankle", "foot")
_IN_AN_IMAGE = ("ankle", "heel", "foot", "hip", "shoulder", "ear")
"""Pairs of keypoints whose middle is the position; in an image the points on the ground come first."""


def keypoint_indices(names: Sequence[str]) -> dict[str, int]:
    """Return plain name, such as ``nose`` or ``left_shoulder`` → index of that keypoint among the names.

    Names may be written as ``LeftShoulder``, ``l-shoulder`` or ``shoulder_left``. Left and right are the
    person's own.
    """
    found: dict[str, int] = {}
    for place, name in enumerate(names):
        found.setdefault(_plain(name), place)
    return found


def _plain(name: str) -> str:
    words = [word.lower() for word in _WORD.findall(name)]
    for side in ("left", "right"):
        if len(words) == 1 and words[0].startswith(side):
            words = [side, words[0].removeprefix(side)]
    sides = [_SIDES[word] for word in words if word in _SIDES]
    rest = [_SAME.get(word, word) for word in words if word and word not in _SIDES]
    return "_".join([*sides[:1], *rest])


def middle(points: FloatArray, names: Sequence[str], *, in_image: bool) -> tuple[FloatArray, str]:
    """Return positions (..., 2) of people by their keypoints (..., k, 2), and the keypoints used.

    A position is the middle of a pair, NaN where one of the two is missing; without a pair, of all points.

    Parameters
    ----------
    in_image : whether the points are pixels; only those at the feet are then on the ground
    """
    indices = keypoint_indices(names)
    if len(names) == 1:
        return points[..., 0, :], names[0]
    for name in _MIDDLES:
        if name in indices:
            return points[..., indices[name], :], names[indices[name]]
    for part in _IN_AN_IMAGE if in_image else _ON_THE_GROUND:
        left, right = (indices.get(f"{side}_{part}") for side in ("left", "right"))
        if left is not None and right is not None:
            description = f"the middle of {names[left]} and {names[right]}"
            return 0.5 * (points[..., left, :] + points[..., right, :]), description
    known = np.isfinite(points).all(axis=-1, keepdims=True)
    count = known.sum(axis=-2)
    total = np.where(known, points, 0.0).sum(axis=-2)
    found = np.where(count > 0, total / np.maximum(count, 1), np.nan)
    return found, f"the middle of the {len(names)} keypoints that were detected"


def orientations(
    points: FloatArray, indices: Mapping[str, int], *, mirrored: bool, nose_is_on_ground: bool
) -> dict[str, FloatArray]:
    """Return orientations (...) of body and head, radians, from points (..., k, 2); NaN if unknown.

    The body is perpendicular to the shoulders. The head is the sum of the perpendicular to the ears and the
    vector from their middle to the nose. A ground homography shifts points of equal height alike, away from
    the camera's foot: it preserves the direction from one shoulder, or ear, to the other, but not the
    direction to a nose of another height.

    Parameters
    ----------
    indices : result of `keypoint_indices`
    mirrored : whether the plane is left-handed as seen from above
    nose_is_on_ground : whether the view is from straight above
    """
    found: dict[str, FloatArray] = {}
    for name, part in (("body", "shoulder"), ("head", "ear")):
        left, right = (indices.get(f"{side}_{part}") for side in ("left", "right"))
        if left is None or right is None:
            continue
        across = points[..., left, :] - points[..., right, :]
        ahead = np.stack([across[..., 1], -across[..., 0]], axis=-1) * (-1.0 if mirrored else 1.0)
        nose = indices.get("nose") if name == "head" and nose_is_on_ground else None
        if nose is not None:
            to_nose = points[..., nose, :] - 0.5 * (points[..., left, :] + points[..., right, :])
            ahead = ahead + np.where(np.isnan(to_nose), 0.0, to_nose)
        angle = np.arctan2(ahead[..., 1], ahead[..., 0])
        found[name] = np.where((ahead == 0.0).all(axis=-1), np.nan, angle)
    return found


def frames_and_times(
    dataset: Any, options: ReadOptions, path: Path
) -> tuple[NDArray[np.int64], FloatArray, TimeScale | None, list[str]]:
    """Return frames (n,) and seconds (n,) of the steps of a dataset, their time scale, and notes.

    Times are those of the coordinate ``time``: dates, seconds, or frames (if the attribute ``time_unit`` is
    "frames", or for whole numbers). The rate of frames is ``fps`` of the options, or the dataset's attribute
    of that name.
    """
    n = dataset.sizes[TIME]
    values = dataset[TIME].to_numpy() if TIME in dataset.coords else np.arange(n)
    rate = options.fps if options.fps is not None else rate_of(dataset.attrs.get("fps"))
    description = dataset.attrs.get("time_unit")
    time: TimeScale | None = None
    notes: list[str] = []
    if values.dtype.kind == "M":
        reference = None if options.reference is None else options.reference.time
        values, time = from_dates(values, "", reference)
    elif values.dtype.kind == "m":
        values = values.astype("m8[ns]").astype(np.int64) / 1e9
    elif values.dtype.kind not in "iuf":
        raise InputError(f"times of type {values.dtype}", "seconds, or frames and --fps", path=path)
    elif description == "frames" or (
        description is None and (values.dtype.kind in "iu") and "frame" not in dataset.coords
    ):
        if rate is None:
            raise InputError("times in frames, and no frame rate", "frames a second (--fps)", path=path)
        frame = _integers(values, path)
        return frame, frame / rate, None, notes
    t = np.asarray(values, dtype=float)
    if not np.isfinite(t).all():
        raise InputError("a time that is missing", "a time for each step", path=path)
    if "frame" in dataset.coords and dataset["frame"].dims == (TIME,):
        frame = _integers(dataset["frame"].to_numpy(), path)
    elif rate is not None and np.abs(t * rate - np.rint(t * rate)).max(initial=0.0) < 0.25:
        frame = _integers(np.rint(t * rate), path)
    else:
        known, place = distinct_times(t)
        numbers, how = numbered_times(known)
        frame = numbers[place].astype(np.int64)
        notes.append(f"no frames: {how}")
    if options.fps is not None:
        notes.append("the frame rate was not used: the file has times")
    return frame, t, time, notes


def _integers(values: NDArray[Any], path: Path) -> NDArray[np.int64]:
    numbers = np.asarray(values, dtype=float)
    bad = ~(np.abs(numbers) <= LARGEST_FRAME) | (numbers != np.rint(numbers))
    if bad.any():
        expected = f"a whole number within ±{LARGEST_FRAME}"
        raise InputError(f"the frame {numbers[bad][0]:g}", expected, path=path)
    return numbers.astype(np.int64)


_SINGULAR = {"keypoint": KEYPOINTS, "individual": INDIVIDUALS}
_NATIVE = ("position", "confidence", "shape", HAS_ROW)


def rows_of_dataset(dataset: Any, options: ReadOptions, path: Path) -> Rows:
    """Return the rows of a dataset, checked, in metres and seconds.

    Positions are lengths if the variable's attribute ``space_unit`` or ``options.units`` is a unit of length,
    and else pixels, which a camera or a scale of the options projects to the ground.

    Parameters
    ----------
    dataset : xarray.Dataset with a variable ``position`` (time, space and perhaps keypoints and individuals,
        in any order); variables that `to_movement` writes are read too
    path : of its file, for messages
    """
    layout = options.layout() or Layout()
    read = _Reading(dataset.rename({k: v for k, v in _SINGULAR.items() if k in dataset.dims}), path)
    points = read.points(layout)
    frame, t, time, notes = frames_and_times(read.dataset, options, path)
    unit = read.unit(layout, options)
    variables, ignored = read.variables()
    if ignored:
        notes.append(f"ignored variables {listed(ignored)}")
    channels = dict(variables)
    in_image = unit is None
    if unit is not None:
        metre = METRES[unit]
        points = points * metre
        channels |= {n: channels[n] * metre**power for n, power in LENGTHS.items() if n in channels}
    else:
        channels = {name: values for name, values in channels.items() if name not in LENGTHS}
    names = read.names(KEYPOINTS, "keypoint_")
    standing, description = middle(points, names, in_image=in_image)
    if in_image and "shape" in read.dataset.data_vars:
        standing = standing + np.stack([np.zeros_like(read.height), 0.5 * read.height], axis=-1)
        description = "the middle of each box's lower edge"
    if len(names) > 1 or in_image:
        notes.append(f"positions are {description}")
    score = read.confidence()
    if score is not None and "score" not in channels:
        channels["score"] = score
    both = np.isfinite(standing).all(axis=-1, keepdims=True)
    channels["pixel" if in_image else "position"] = np.where(both, standing, np.nan)
    kept = read.has_row(channels)
    n_partial = int((np.isfinite(points).any(axis=(-2, -1)) & ~kept).sum())
    people, steps = np.nonzero(kept)
    if not len(people):
        raise read.fail("no positions", "at least one position")
    ids, names_of = read.identities()
    given = {name: values[people, steps] for name, values in channels.items()}
    rows = Rows(
        path,
        "movement",
        ids[people],
        frame[steps],
        {**given, "t": t[steps]},
        lambda row: int(steps[row]) + 1,
        names_of | read.labels(ids),
        refused={PARTIAL: n_partial} if n_partial else {},
        notes=tuple(notes),
        as_read=AsRead(time=time, names=names_of),
    )
    if in_image:
        camera, notes_of_camera = known_camera(options, rows.channels["pixel"])
        if camera is None:
            camera, notes_of_camera = camera_or_scale(options, rows.channels["pixel"], np.ones(1))
        flat = points.reshape(-1, 2)
        points = camera.image_to_ground(flat).reshape(points.shape)
        mirrored, from_above = camera.is_mirrored, options.metres_per_pixel is not None
    else:
        camera, notes_of_camera, mirrored, from_above = None, (), False, True
    facing = orientations(points, keypoint_indices(names), mirrored=mirrored, nose_is_on_ground=from_above)
    for name, angles in facing.items():
        if name not in rows.channels:
            rows = rows.with_channels(**{name: angles[people, steps]})
    return place_pixels(rows, options) if camera is None else on_ground(rows, camera, notes_of_camera)


@dataclass(frozen=True, eq=False)
class _Reading:
    """Access to a dataset's arrays as (individuals, time, …), with errors that name its file."""

    dataset: Any
    path: Path

    def fail(self, found: str, expected: str) -> InputError:
        return InputError(found, expected, path=self.path)

    def array(self, name: str, *further: str) -> FloatArray:
        """Return a variable (individuals, time, *further) as numbers."""
        one = self.dataset[name]
        if KEYPOINTS in one.dims and KEYPOINTS not in further:
            one = one.isel({KEYPOINTS: 0})
        missing = [INDIVIDUALS] if INDIVIDUALS not in one.dims else []
        try:
            found = one.expand_dims(missing).transpose(INDIVIDUALS, TIME, *further).to_numpy()
            return np.asarray(found, dtype=float)
        except (TypeError, ValueError) as error:
            raise self.fail(f"{name} that is no array of numbers", "numbers") from error

    def points(self, layout: Layout) -> FloatArray:
        """Return positions (individuals, time, keypoints, 2) on the ground, or in the image."""
        if "position" not in self.dataset.data_vars:
            there = ", ".join(map(str, self.dataset.data_vars)) or "none"
            raise self.fail(
                f"no variable position (there are: {there})",
                "a dataset as movement makes it: movement.io.load_dataset(file, …).to_netcdf('tracks.nc') "
                "makes one of other software's files",
            )
        dims = self.dataset["position"].dims
        lacking = [name for name in (TIME, SPACE) if name not in dims]
        if lacking:
            raise self.fail(f"position without the dimension {lacking[0]}", "time and space among them")
        dimensions = [str(name) for name in dims if name not in (TIME, SPACE, KEYPOINTS, INDIVIDUALS)]
        if dimensions:
            expected = f"one of it: dataset.sel({dimensions[0]}=…)"
            raise self.fail(f"position with a dimension {dimensions[0]}", expected)
        axes = self.axes(layout)
        if KEYPOINTS in dims:
            return self.array("position", KEYPOINTS, SPACE)[..., axes]
        return self.array("position", SPACE)[..., None, axes]

    def axes(self, layout: Layout) -> list[int]:
        """Return the indices of the ground's two coordinates among those of space."""
        if set(layout.columns) not in (set(), {"x", "y"}):
            raise self.fail(
                "columns of a dataset other than x and y", "coordinates of space: --columns x=x,y=z"
            )
        if layout.time_unit is not None or layout.crs is not None:
            raise self.fail("a unit of time or a crs for a dataset", "--units, --fps or a camera")
        there = self.names(SPACE, "")
        if SPACE not in self.dataset.coords and len(there) == 2:
            return [0, 1]
        wanted = [layout.columns.get(name, name) for name in ("x", "y")]
        if (len(there) > 2 and not layout.columns) or not set(wanted) <= set(there):
            expected = "x and y on the ground; name the two axes with --columns, such as --columns x=z,y=x"
            raise self.fail(f"space {', '.join(there)}", expected)
        return [there.index(name) for name in wanted]

    def names(self, dimension: str, prefix: str) -> list[str]:
        """Return coordinates of a dimension as text; numbers with a prefix where it has none."""
        if dimension not in self.dataset.dims:
            description = self.dataset.coords.get(dimension)
            return [
                str(description.item()) if description is not None and description.ndim == 0 else f"{prefix}0"
            ]
        if dimension in self.dataset.coords:
            return [str(name) for name in self.dataset[dimension].to_numpy().tolist()]
        return [f"{prefix}{k}" for k in range(self.dataset.sizes[dimension])]

    def identities(self) -> tuple[NDArray[np.int64], dict[int, str]]:
        """Return the track ids of the individuals, and id → name for names that are not numbers."""
        names = self.names(INDIVIDUALS, "id_")
        if len(set(names)) < len(names):
            twice = repeated(names)
            raise self.fail(f"the individual {twice!r} twice", "each once")
        if "track_id" not in self.dataset.coords or self.dataset["track_id"].dims != (INDIVIDUALS,):
            return numbered_names(names)
        ids = np.asarray(self.dataset["track_id"].to_numpy(), dtype=float)
        integer = (np.abs(ids) <= LARGEST_ID) & (ids == np.rint(ids))
        if not integer.all() or len(np.unique(ids)) < len(ids):
            raise self.fail("track_id that is no whole number, or comes twice", "one for each individual")
        known = zip(ids.astype(np.int64).tolist(), names, strict=True)
        return ids.astype(np.int64), {k: name for k, name in known if name != str(k)}

    def labels(self, ids: NDArray[np.int64]) -> dict[int, str]:
        """Return labels of people, where the dataset has any."""
        if "label" not in self.dataset.coords or self.dataset["label"].dims != (INDIVIDUALS,):
            return {}
        description = self.dataset["label"].to_numpy().tolist()
        return {k: str(name) for k, name in zip(ids.tolist(), description, strict=True) if name}

    def unit(self, layout: Layout, options: ReadOptions) -> str | None:
        """Return the unit of length of the positions; None for pixels with a camera in the options."""
        attributes = {**self.dataset.attrs, **self.dataset["position"].attrs}
        description = str(attributes.get("space_unit", attributes.get("units", ""))).strip().lower()
        unit = SPACE_UNITS.get(description)
        if unit is not None:
            if layout.units not in (None, unit):
                raise self.fail(
                    f"--units {layout.units} of positions in {description}", f"--units {unit}, or none"
                )
            return unit
        if layout.units is not None:
            return layout.units
        if options.has_camera:
            return None
        expected = "--units m (or cm, mm, ft) for lengths; --homography, --calibration, --point-pairs or "
        expected += "--metres-per-pixel for pixels"
        raise self.fail(f"positions in {description or 'an unknown unit'}", expected)

    @property
    def height(self) -> FloatArray:
        """Return (individuals, time) of the boxes, in pixels."""
        return self.array("shape", SPACE)[..., 1]

    def confidence(self) -> FloatArray | None:
        """Return (individuals, time) confidences, over the keypoints; None where the dataset has none."""
        if "confidence" not in self.dataset.data_vars:
            return None
        poses = KEYPOINTS in self.dataset["confidence"].dims
        found = self.array("confidence", *([KEYPOINTS] if poses else []))
        if poses:
            known = np.isfinite(found)
            total = np.where(known, found, 0.0).sum(axis=-1)
            found = np.where(known.any(axis=-1), total / np.maximum(known.sum(axis=-1), 1), np.nan)
        return found if np.isfinite(found).any() and not (found < 0.0).any() else None

    def variables(self) -> tuple[dict[str, FloatArray], list[str]]:
        """Return channel → (individuals, time, …) of variables of tracks, and the names of others."""
        found: dict[str, FloatArray] = {}
        ignored: list[str] = []
        for name in map(str, self.dataset.data_vars):
            if name in _NATIVE:
                continue
            further = self._further(name)
            if further is None:
                ignored.append(name)
                continue
            values = self.array(name, *further)
            n = values.shape[0] * values.shape[1]
            empty = np.isnan(values).reshape(n, -1)
            if name != "covariance" and (empty.any(axis=1) & ~empty.all(axis=1)).any():
                raise self.fail(f"{name} with missing values", "all of it, or none, in each frame")
            if name in ("body", "head", "true_body", "true_head"):
                with np.errstate(invalid="ignore"):
                    inside = (values > -np.pi) & (values <= np.pi)
                    values = np.where(inside, values, wrap(values))
            found[name] = values
        return found, ignored

    def _further(self, name: str) -> tuple[str, ...] | None:
        """Return a variable's dimensions other than time and individuals; None if tracks do not have it."""
        dims = [str(one) for one in self.dataset[name].dims]
        if KEYPOINTS in dims and self.dataset.sizes[KEYPOINTS] == 1:
            dims.remove(KEYPOINTS)
        rest = [one for one in dims if one not in (TIME, INDIVIDUALS)]
        if TIME not in dims or (INDIVIDUALS in self.dataset.dims and INDIVIDUALS not in dims):
            return None
        if name.startswith(INPUT) and is_input_name(name.removeprefix(INPUT)):
            return tuple(rest) if len(rest) < 2 else None
        wanted = FURTHER.get(name)
        if wanted is None or set(rest) != set(wanted):
            return None
        sizes = tuple(self.dataset.sizes[one] for one in wanted)
        return wanted if sizes == SHAPES[name] else None

    def has_row(self, channels: Mapping[str, FloatArray]) -> NDArray[np.bool_]:
        """Return a mask (individuals, time) of rows."""
        if HAS_ROW in self.dataset.data_vars:
            return self.array(HAS_ROW) > 0.5
        known = [np.isfinite(v).reshape(*v.shape[:2], -1).any(axis=2) for v in channels.values()]
        return np.logical_or.reduce(known)


EXTRA = "movement"
_COORDINATES = {"image": ["u", "v"], "state": list(STATE), "other_state": list(STATE)}
_STD = "std"


def from_movement(dataset: Any, **options: Unpack[Reading]) -> TrackSet:
    """Return tracks from a dataset of the package movement.

    A person's position is the middle of a pair of keypoints (hips, or ankles in an image); body and head are
    computed from shoulders, ears and nose; see docs/formats.md.

    Parameters
    ----------
    dataset : xarray.Dataset of poses or boxes, or one of `to_movement`
    **options : fields of `ReadOptions`: ``units``, or a camera, where the positions have no unit of length;
        ``fps``, where times are frames; ``columns`` with x and y, where space has other axes

    Raises
    ------
    InputError
        For an invalid dataset, and for missing options.
    """
    chosen = ReadOptions.named(**options)
    rows = placed_by_poses(rows_of_dataset(dataset, chosen, Path("dataset")), chosen)
    return TrackSet.from_identified_rows(rows)


def to_movement(tracks: TrackSet) -> xarray.Dataset:
    """Return a dataset of the package movement: poses of one keypoint, metres and seconds.

    Each attribute of a `Track` is a data variable of its name: ``body`` and ``head`` in radians,
    ``covariance``, and so on. ``std`` (time, individuals, state) is the square root of its diagonal.
    `from_movement` restores the same tracks, to the last bit.

    Returns
    -------
    xarray.Dataset
        Its method ``to_netcdf`` writes it.

    Raises
    ------
    InputError
        If the package xarray is not installed.
    """
    if any(track.sensor is not None for track in tracks):
        raise InputError("rows of several sensors", "one row of a person at a time (--resample-hz)")
    xr = package("xarray", EXTRA)
    grid = _Grid(tracks)
    names = {} if tracks.as_read is None else tracks.as_read.names
    ids = [track.track_id for track in tracks]
    position = grid.filled("position", (2,))
    if not len(position):
        position = np.empty((len(grid.moments), 0, 2))
    variables: dict[str, Any] = {
        "position": (
            (TIME, SPACE, KEYPOINTS, INDIVIDUALS),
            np.moveaxis(position, 2, 1)[:, :, None, :],
            {"space_unit": "m"},
        )
    }
    score = grid.filled("score", ())
    variables["confidence"] = ((TIME, KEYPOINTS, INDIVIDUALS), score[:, None, :])
    for name, further in FURTHER.items():
        if name != "score" and any(getattr(track, name) is not None for track in tracks):
            shape = next(getattr(one, name).shape[1:] for one in tracks if getattr(one, name) is not None)
            variables[name] = ((TIME, INDIVIDUALS, *further), grid.filled(name, shape))
    if "covariance" in variables:
        variance = np.diagonal(variables["covariance"][1], axis1=2, axis2=3)
        variables[_STD] = ((TIME, INDIVIDUALS, "state"), np.sqrt(variance))
    for name in sorted({*chain.from_iterable(track.inputs for track in tracks)}):
        shape = next(track.inputs[name].shape[1:] for track in tracks if name in track.inputs)
        further = (f"{name}_number",) if shape else ()
        variables[f"{INPUT}{name}"] = ((TIME, INDIVIDUALS, *further), grid.filled(f"{INPUT}{name}", shape))
    known = np.isfinite(position).all(axis=2)
    if not np.array_equal(known, grid.there):
        variables[HAS_ROW] = ((TIME, INDIVIDUALS), grid.there)
    attributes: dict[str, Any] = {"ds_type": "poses", "source_software": "graphtrack", "time_unit": "seconds"}
    rate = steady_rate(tracks)
    if rate is not None:
        attributes["fps"] = rate
    further_dims = {one for dims, *_ in variables.values() for one in dims}
    coordinates: dict[str, Any] = {
        TIME: np.array(grid.moments["t"], dtype=float),
        SPACE: ["x", "y"],
        KEYPOINTS: ["centroid"],
        INDIVIDUALS: [names.get(k, str(k)) for k in ids],
        "frame": (TIME, np.array(grid.moments["frame"], dtype=np.int64)),
        "track_id": (INDIVIDUALS, np.array(ids, dtype=np.int64)),
    }
    if any(track.label != names.get(track.track_id, "") for track in tracks):
        coordinates["label"] = (INDIVIDUALS, np.array([track.label for track in tracks], dtype=object))
    coordinates |= {name: values for name, values in _COORDINATES.items() if name in further_dims}
    return xr.Dataset(variables, coordinates, attributes)


class _Grid:
    """Rows of tracks on a grid of all people and of all pairs of time and frame, in order."""

    def __init__(self, tracks: TrackSet) -> None:
        kind = np.dtype([("t", float), ("frame", np.int64)])
        pairs = [np.empty(len(one), kind) for one in tracks]
        for pair, one in zip(pairs, tracks, strict=True):
            pair["t"], pair["frame"] = one.t, one.frame
        self.moments = np.unique(np.concatenate(pairs)) if pairs else np.empty(0, kind)
        self._tracks, self._indices = tracks, [np.searchsorted(self.moments, one) for one in pairs]
        self.there = np.zeros((len(self.moments), len(tracks)), dtype=bool)
        for k, place in enumerate(self._indices):
            self.there[place, k] = True

    def filled(self, name: str, shape: tuple[int, ...]) -> NDArray[np.float64]:
        """Return a channel (steps, people, *shape); NaN where there is no row or no value."""
        found = np.full((*self.there.shape, *shape), np.nan)
        for k, (track, place) in enumerate(zip(self._tracks, self._indices, strict=True)):
            values = channel_of(track, name)
            if values is not None:
                found[place, k] = values
        return found


DEEPLABCUT, SLEAP = "DeepLabCut", "SLEAP"
"""Software names of `movement.io.load_dataset`."""

_OF_SLEAP, _OF_DLC = {"tracks", "node_names"}, {"df_with_missing"}  # groups in their HDF5 files


def software_of(source: Source) -> str | None:
    """Return movement's name of the software that wrote a file of poses; None for a dataset."""
    if not source.data.startswith(HDF5):
        return None if source.data.startswith(CLASSIC) else DEEPLABCUT
    try:
        with package("h5py", EXTRA).File(io.BytesIO(source.data), "r") as file:
            names = set(file)
            source.limit.check(_claimed_bytes(file), "arrays")
    except (InputError, MemoryError):
        raise
    except Exception:  # HDF5 raises many kinds for damaged files: reading it as a dataset reports the fault
        return None
    return SLEAP if names >= _OF_SLEAP else DEEPLABCUT if names >= _OF_DLC else None


def _by_movement(source: Source, software: str) -> Any:
    """Return the dataset that movement makes of a file of another software."""
    try:
        movement = import_module("movement.io")
    except ImportError as error:
        raise source.fail(
            f"a file of {software}, and no package movement",
            "pip install 'graphtrack[poses]', or a file that it made where it is installed: "
            f"movement.io.load_dataset(FILE, source_software='{software}').to_netcdf('tracks.nc')",
        ) from error
    with TemporaryDirectory() as folder:
        file = Path(folder) / ("poses.h5" if source.data.startswith(HDF5) else "poses.csv")
        file.write_bytes(source.data)
        try:
            return movement.load_dataset(file, source_software=software).load()
        except Exception as error:  # movement and pandas raise many kinds for invalid files
            description = " ".join(str(error).replace(str(file), "it").split()) or type(error).__name__
            found = f"a file of {software} that movement cannot read ({description[:200]})"
            raise source.fail(found, "a whole one") from error


def read(source: Source, options: ReadOptions) -> Rows:
    """Read a dataset, or a file of DeepLabCut or SLEAP, converted by movement; see `rows_of_dataset`."""
    software = software_of(source)
    if software is not None:
        return rows_of_dataset(_by_movement(source, software), options, source.path)
    xr = package("xarray", EXTRA)
    engine = "scipy" if source.data.startswith(CLASSIC) else "h5netcdf"
    if engine == "h5netcdf":
        _check_packages()
    return rows_of_dataset(_loaded(xr, source, engine), options, source.path)


def _check_packages() -> None:
    for name in ("h5netcdf", "h5py"):
        package(name, EXTRA)


def _loaded(xr: Any, source: Source, engine: str) -> Any:
    try:
        if engine == "h5netcdf":
            # h5py first: xarray repeats an error about a file that it cannot open when it is deleted.
            with package("h5py", EXTRA).File(io.BytesIO(source.data), "r") as file:
                file.visititems(lambda name, item: list(item.attrs) and None)
                list(file.attrs.items())
        with xr.open_dataset(io.BytesIO(source.data), engine=engine, decode_timedelta=False) as dataset:
            return dataset.load()
    except Exception as error:  # HDF5 raises many kinds for invalid files
        description = " ".join(str(error).split()) or type(error).__name__
        found = f"a netCDF file that cannot be read ({description[:200]})"
        raise source.fail(found, "a whole one, of movement's dataset.to_netcdf") from error


def _claimed_bytes(file: Any) -> int:
    """Return the bytes that an open HDF5 file's arrays take as doubles, whether they are stored or not."""

    def size(item: Any) -> int:
        shape = getattr(item, "shape", None)
        return 0 if shape is None else math.prod(shape) * max(item.dtype.itemsize, 8)

    every: list[int] = []
    file.visititems(lambda name, item: every.append(size(item)))
    # Several links to an array are visited once, but read each.
    return max(sum(every), sum(size(file.get(name)) for name in file))


def write(tracks: TrackSet, path: Path) -> None:
    """Write `to_movement`'s dataset as netCDF 4."""
    _check_packages()
    # In memory first: HDF5 aborts the process if the disk is full when it closes a file.
    path.write_bytes(to_movement(tracks).to_netcdf(engine="h5netcdf"))


MOVEMENT = Format(
    name="movement",
    description="netCDF of the package movement (extra movement); DeepLabCut and SLEAP (extra poses)",
    suffixes=(".nc",),
    read=read,
    write=write,
    takes=("columns", "units"),
)
