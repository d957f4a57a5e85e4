"""Rows of observations from a dataset of movement: poses, boxes, or tracks that were written as one."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from graphtrack.bounds import INPUT, LARGEST_ID, SHAPES
from graphtrack.display import listed
from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray, wrap
from graphtrack.io.cameras import camera_or_scale, known_camera, on_ground, place_pixels
from graphtrack.io.layout import METRES, Layout
from graphtrack.io.movement.keypoints import middle, orientations, places_of
from graphtrack.io.movement.layout import (
    FURTHER,
    HAS_ROW,
    INDIVIDUALS,
    KEYPOINTS,
    LENGTHS,
    SPACE,
    SPACE_UNITS,
    TIME,
)
from graphtrack.io.movement.times import frames_and_times
from graphtrack.io.options import ReadOptions
from graphtrack.io.tables.values import numbered_names
from graphtrack.table.as_read import AsRead
from graphtrack.table.rows import Rows
from graphtrack.table.schema import is_input_name, repeated

_SINGULAR = {"keypoint": KEYPOINTS, "individual": INDIVIDUALS}
_NATIVE = ("position", "confidence", "shape", HAS_ROW)


def rows_of_dataset(dataset: Any, options: ReadOptions, path: Path) -> Rows:
    """The rows of a dataset, checked, in metres and seconds.

    Positions are metres if the variable's attribute ``space_unit`` or ``options.units`` says a unit of
    length, and else pixels, which a camera or a scale of the options brings to the ground.

    Parameters
    ----------
    dataset : xarray.Dataset with a variable ``position`` (time, space and perhaps keypoints and individuals,
        in any order); variables that `to_movement` writes are read too
    path : where it comes from, for messages
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
        channels |= {name: channels[name] * metre for name in LENGTHS if name in channels}
    else:
        channels = {name: values for name, values in channels.items() if name not in LENGTHS}
    names = read.names(KEYPOINTS, "keypoint_")
    standing, said = middle(points, names, in_image=in_image)
    if in_image and "shape" in read.dataset.data_vars:
        standing = standing + np.stack([np.zeros_like(read.height), 0.5 * read.height], axis=-1)
        said = "the middle of each box's lower edge"
    if len(names) > 1 or in_image:
        notes.append(f"positions are {said}")
    score = read.confidence()
    if score is not None and "score" not in channels:
        channels["score"] = score
    channels["pixel" if in_image else "position"] = _both(standing)
    kept = read.has_row(channels)
    people, steps = np.nonzero(kept)
    if not len(people):
        raise read.fail("nobody who is anywhere", "at least one position")
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
        notes=tuple(notes),
        as_read=AsRead(time=time, names=names_of),
    )
    if in_image:
        camera, told_of = known_camera(options, rows.channels["pixel"])
        if camera is None:
            camera, told_of = camera_or_scale(options, rows.channels["pixel"], np.ones(1))
        flat = points.reshape(-1, 2)
        points = camera.image_to_ground(flat).reshape(points.shape)
        mirrored, from_above = camera.is_mirrored, options.metres_per_pixel is not None
    else:
        camera, told_of, mirrored, from_above = None, (), False, True
    facing = orientations(points, places_of(names), mirrored=mirrored, nose_is_on_ground=from_above)
    for name, angles in facing.items():
        if name not in rows.channels:
            rows = rows.with_channels(**{name: angles[people, steps]})
    return place_pixels(rows, options) if camera is None else on_ground(rows, camera, told_of)


def _both(position: FloatArray) -> FloatArray:
    """Positions (..., 2) with both coordinates or none."""
    return np.where(np.isfinite(position).all(axis=-1, keepdims=True), position, np.nan)


@dataclass(frozen=True, eq=False)
class _Reading:
    """A dataset that is read, arrays of it as (individuals, time, …), and what is wrong with it."""

    dataset: Any
    path: Path

    def fail(self, found: str, expected: str) -> InputError:
        return InputError(found, expected, path=self.path)

    def array(self, name: str, *further: str) -> FloatArray:
        """A variable (individuals, time, *further) as numbers."""
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
        """Positions (individuals, time, keypoints, 2) on the ground, or in the image."""
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
        others = [str(name) for name in dims if name not in (TIME, SPACE, KEYPOINTS, INDIVIDUALS)]
        if others:
            expected = f"one of it: dataset.sel({others[0]}=…)"
            raise self.fail(f"position with a dimension {others[0]}", expected)
        axes = self.axes(layout)
        if KEYPOINTS in dims:
            return self.array("position", KEYPOINTS, SPACE)[..., axes]
        return self.array("position", SPACE)[..., None, axes]

    def axes(self, layout: Layout) -> list[int]:
        """The places of the ground's two coordinates among those of space."""
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
            expected = "x and y on the ground; --columns says which two are, such as --columns x=z,y=x"
            raise self.fail(f"space {', '.join(there)}", expected)
        return [there.index(name) for name in wanted]

    def names(self, dimension: str, prefix: str) -> list[str]:
        """Coordinates of a dimension as text; numbers with a prefix where it has none."""
        if dimension not in self.dataset.dims:
            said = self.dataset.coords.get(dimension)
            return [str(said.item()) if said is not None and said.ndim == 0 else f"{prefix}0"]
        if dimension in self.dataset.coords:
            return [str(name) for name in self.dataset[dimension].to_numpy().tolist()]
        return [f"{prefix}{k}" for k in range(self.dataset.sizes[dimension])]

    def identities(self) -> tuple[NDArray[np.int64], dict[int, str]]:
        """The track ids of the individuals, and those of them that have names that are no numbers."""
        names = self.names(INDIVIDUALS, "id_")
        if len(set(names)) < len(names):
            twice = repeated(names)
            raise self.fail(f"the individual {twice!r} twice", "each once")
        if "track_id" not in self.dataset.coords or self.dataset["track_id"].dims != (INDIVIDUALS,):
            return numbered_names(names)
        ids = np.asarray(self.dataset["track_id"].to_numpy(), dtype=float)
        whole = (np.abs(ids) <= LARGEST_ID) & (ids == np.rint(ids))
        if not whole.all() or len(np.unique(ids)) < len(ids):
            raise self.fail("track_id that is no whole number, or comes twice", "one for each individual")
        known = zip(ids.astype(np.int64).tolist(), names, strict=True)
        return ids.astype(np.int64), {k: name for k, name in known if name != str(k)}

    def labels(self, ids: NDArray[np.int64]) -> dict[int, str]:
        """Labels of people, where the dataset has any."""
        if "label" not in self.dataset.coords or self.dataset["label"].dims != (INDIVIDUALS,):
            return {}
        said = self.dataset["label"].to_numpy().tolist()
        return {k: str(name) for k, name in zip(ids.tolist(), said, strict=True) if name}

    def unit(self, layout: Layout, options: ReadOptions) -> str | None:
        """The unit of length of the positions; None: they are pixels, and the options have a camera."""
        attributes = {**self.dataset.attrs, **self.dataset["position"].attrs}
        said = str(attributes.get("space_unit", attributes.get("units", ""))).strip().lower()
        unit = SPACE_UNITS.get(said)
        if unit is not None:
            if layout.units not in (None, unit):
                raise self.fail(f"--units {layout.units} of positions in {said}", f"--units {unit}, or none")
            return unit
        if layout.units is not None:
            return layout.units
        by_camera = (options.camera, options.homography, options.point_pairs, options.calibration)
        if any(one is not None for one in (*by_camera, options.metres_per_pixel)):
            return None
        expected = "--units m (or cm, mm, ft) for lengths; --homography, --calibration, --point-pairs or "
        expected += "--metres-per-pixel for pixels"
        raise self.fail(f"positions in {said or 'an unknown unit'}", expected)

    @property
    def height(self) -> FloatArray:
        """(individuals, time) of the boxes, in pixels."""
        return self.array("shape", SPACE)[..., 1]

    def confidence(self) -> FloatArray | None:
        """(individuals, time) of what was found, over its keypoints; None where nothing is said."""
        if "confidence" not in self.dataset.data_vars:
            return None
        poses = KEYPOINTS in self.dataset["confidence"].dims
        found = self.array("confidence", *([KEYPOINTS] if poses else []))
        if poses:
            seen = np.isfinite(found)
            total = np.where(seen, found, 0.0).sum(axis=-1)
            found = np.where(seen.any(axis=-1), total / np.maximum(seen.sum(axis=-1), 1), np.nan)
        return found if np.isfinite(found).any() and not (found < 0.0).any() else None

    def variables(self) -> tuple[dict[str, FloatArray], list[str]]:
        """Channel → (individuals, time, …) of variables that tracks have too, and the names of the others."""
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
                raise self.fail(f"{name} of which a part is missing", "all of it, or none, in each frame")
            if name in ("body", "head", "true_body", "true_head", "gait_offset"):
                with np.errstate(invalid="ignore"):
                    inside = (values > -np.pi) & (values <= np.pi)
                    values = np.where(inside, values, wrap(values))
            found[name] = values
        return found, ignored

    def _further(self, name: str) -> tuple[str, ...] | None:
        """The dimensions of a variable beside those of all; None where it is none of a track."""
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
        return wanted if all(self.dataset.sizes[one] == size for one, size in _sizes(name)) else None

    def has_row(self, channels: Mapping[str, FloatArray]) -> NDArray[np.bool_]:
        """(individuals, time) where somebody has a row."""
        if HAS_ROW in self.dataset.data_vars:
            return self.array(HAS_ROW) > 0.5
        known = [np.isfinite(v).reshape(*v.shape[:2], -1).any(axis=2) for v in channels.values()]
        return np.logical_or.reduce(known)


def _sizes(name: str) -> list[tuple[str, int]]:
    return list(zip(FURTHER[name], SHAPES[name], strict=True))
