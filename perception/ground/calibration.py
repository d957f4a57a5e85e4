"""Calibration of a camera's view of the ground from boxes of people, refused if not observable."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray
from graphtrack.geometry.camera import GroundCamera
from graphtrack.io.cameras import PERSON_HEIGHT, write_calibration
from perception.detection.boxes import PersonBox, foot_point
from perception.ground.fitting import CameraFit, HeightData, PinholeView, fitted
from perception.images.pixels import intersection_over_union

_OVERLAP = 0.3
_BORDER = 2.0


def complete_boxes(box: FloatArray, size: tuple[int, int]) -> NDArray[np.bool_]:
    """Return a mask (n,) of boxes (n, 4) that do not touch the border of an image (columns, rows)."""
    left, top, width, height = box.T
    columns, rows = size
    inside = (left > _BORDER) & (left + width < columns - _BORDER)
    return np.asarray(inside & (top > _BORDER) & (top + height < rows - _BORDER))


def people_of(boxes: Sequence[PersonBox]) -> NDArray[np.int64]:
    """Return the person (n,) in each box, from 0, by identities or by overlap between frames.

    Lost and recovered people count as two.
    """
    if boxes and boxes[0].identified:
        ids = np.array([item.track_id for item in boxes])
        return np.asarray(np.unique(ids, return_inverse=True)[1], np.int64)
    frame = np.array([item.frame for item in boxes], np.int64)
    box = np.array([item.box for item in boxes], float).reshape(-1, 4)
    person: NDArray[np.int64] = np.full(len(boxes), -1)
    order = np.argsort(frame, kind="stable")
    before: NDArray[np.int64] = np.zeros(0, np.int64)
    count = 0
    for now in np.split(order, np.flatnonzero(np.diff(frame[order])) + 1) if len(order) else ():
        if len(before):
            overlap = intersection_over_union(box[now][:, None], box[before])
            first, second = linear_sum_assignment(-overlap)
            near = overlap[first, second] > _OVERLAP
            person[now[first[near]]] = person[before[second[near]]]
        new = now[person[now] < 0]
        person[new] = count + np.arange(len(new))
        count += len(new)
        before = now
    return person


def thinned(person: NDArray[np.int64], most: int, rng: np.random.Generator) -> NDArray[np.int64]:
    """Return indices of at most ``most`` boxes, evenly over people, in their order.

    Parameters
    ----------
    person : (n,) person in each box
    """
    if len(person) <= most:
        return np.arange(len(person))
    order = rng.permutation(len(person))
    by_person = order[np.argsort(person[order], kind="stable")]
    start = np.flatnonzero(np.diff(person[by_person], prepend=-1))
    turn = np.arange(len(person)) - np.repeat(start, np.diff(np.append(start, len(person))))
    # Round robin over people, in random order within a round.
    chosen = by_person[np.lexsort((rng.permutation(len(person)), turn))[:most]]
    return np.sort(chosen)


_DRAWS, _BEYOND = 200, 1e3
_STEEPEST = np.deg2rad(60.0)


class ViewUnknown(InputError):
    """Error: boxes that do not determine the camera's view of the ground."""


# Requirements of a calibration.
_LEAST_PEOPLE, _LEAST_BOXES, _MOST_BOXES = 6, 20, 3000
_LEAST_GROWTH = 1.15  # of the boxes' heights, the 95th percentile over the 5th
_LARGEST_FOCAL, _LARGEST_TILT, _LARGEST_DISTANCE = 0.45, float(np.deg2rad(9.0)), 0.3
"""1-σ of focal length (relative), tilt (radians) and ground distances (relative), at most."""
_WIDE = 0.5  # share of these above which the view is reported as uncertain
_LEAST_INLIERS = 0.5  # least share of inliers


@dataclass(frozen=True, eq=False)
class FoundView:
    """View estimated from boxes.

    Attributes
    ----------
    view : focal length, tilt, roll and height
    std : 1-σ of each, in the same units, by the names of `PinholeView`
    distance_std : relative 1-σ of distances on the ground between people, for a given mean height of people
    size : columns and rows of the image
    boxes, people : numbers used in the fit
    inliers : share of inlier boxes
    notes : assumptions and warnings
    """

    view: PinholeView
    std: Mapping[str, float]
    distance_std: float
    size: tuple[int, int]
    boxes: int
    people: int
    inliers: float
    notes: tuple[str, ...]

    @property
    def camera(self) -> GroundCamera:
        """Return the view as a `GroundCamera`."""
        return self.view.camera(self.size)

    def write(self, path: str | Path) -> None:
        """Write a calibration with uncertainties, readable by `graphtrack.io.cameras.read_calibration`.

        Raises
        ------
        InputError
            If the path cannot be written to.
        """
        view = self.view
        remarks = {
            "TiltDegrees": np.degrees(view.tilt),
            "RollDegrees": np.degrees(view.roll),
            "CameraHeight": view.height,
            "FocalLengthStd": self.std["focal"],
            "TiltDegreesStd": np.degrees(self.std["tilt"]),
            "RollDegreesStd": np.degrees(self.std["roll"]),
            "CameraHeightStd": self.std["height"],
            "GroundDistanceRelativeStd": self.distance_std,
        }
        write_calibration(path, view.rotation, view.translation, view.intrinsics(self.size), remarks=remarks)


def found_view(
    boxes: Sequence[PersonBox],
    size: tuple[int, int],
    rng: np.random.Generator,
    person_height: float = PERSON_HEIGHT,
) -> FoundView:
    """Estimate the view of a camera over the ground from the heights of people's boxes.

    The lens is assumed to have no distortion, and its principal point in the middle of the image.

    Parameters
    ----------
    boxes : of people, with some false detections; with or without identities
    size : columns and rows of the image
    rng : samples boxes if there are more than needed
    person_height : mean height of people (or of the contents of boxes) in metres

    Raises
    ------
    ViewUnknown
        If the view is not determined: too few people, all at one depth, a view from above, or too large an
        uncertainty.
    InputError
        If the boxes are of another image size.
    """
    _check_size(boxes, size)
    box = np.array([item.box for item in boxes], float).reshape(-1, 4)
    kept = np.flatnonzero(complete_boxes(box, size))
    person = people_of(boxes)[kept]
    rows = thinned(person, _MOST_BOXES, rng)
    kept, person = kept[rows], np.unique(person[rows], return_inverse=True)[1]
    people = int(person.max(initial=-1)) + 1
    if people < _LEAST_PEOPLE or len(kept) < _LEAST_BOXES:
        raise ViewUnknown(
            f"{len(kept)} whole boxes of {people} people: too few to calibrate the view",
            f"at least {_LEAST_BOXES} of {_LEAST_PEOPLE}, or a calibration",
        )
    feet = np.array([foot_point(item.box) for item in boxes])[kept] - np.array(size) / 2.0
    height = box[kept, 3]
    low, high = np.percentile(height, [5.0, 95.0])
    if high < _LEAST_GROWTH * low:
        raise ViewUnknown(
            f"people all at one depth, in boxes of {low:.0f} to {high:.0f} pixels: "
            "the ground plane is not observable",
            "people near and far, or a calibration",
        )
    fit = fitted(HeightData(feet, height, person, people, float(max(size))))
    draws = rng.multivariate_normal(fit.vector, fit.covariance, _DRAWS)
    distance_std = _distance_std(draws, fit.vector, feet, size, rng)
    _check_options(fit, distance_std)
    view = PinholeView.from_vector(fit.vector, person_height)
    deviation = np.sqrt(np.diag(fit.covariance)).tolist()
    std = {
        "focal": deviation[0] * view.focal,
        "tilt": deviation[1],
        "roll": deviation[2],
        "height": deviation[3] * view.height,
    }
    return FoundView(
        view,
        std,
        distance_std,
        size,
        len(kept),
        people,
        fit.inliers,
        _notes(fit, distance_std, person_height),
    )


def _check_size(boxes: Sequence[PersonBox], size: tuple[int, int]) -> None:
    """Refuse boxes that are outside the image."""
    feet = np.array([foot_point(item.box) for item in boxes]).reshape(-1, 2)
    inside = ((feet > 0.0) & (feet < np.array(size) * 1.05)).all(axis=1)
    if len(feet) and inside.mean() < 0.5:
        raise InputError(
            f"{int((~inside).sum())} of {len(feet)} boxes outside the image of {size[0]} × {size[1]} pixels",
            "boxes in the pixels of these frames",
        )


def _distance_std(
    draws: FloatArray, best: FloatArray, feet: FloatArray, size: tuple[int, int], rng: np.random.Generator
) -> float:
    """Return the median relative 1-σ of ground distances between positions of people."""
    chosen = feet[rng.integers(len(feet), size=(2, 200))] + np.array(size) / 2.0

    def distances(vector: FloatArray) -> FloatArray:
        ground = PinholeView.from_vector(vector, 1.0).camera(size).image_to_ground(chosen)
        return np.asarray(np.linalg.norm(ground[0] - ground[1], axis=-1), float)

    known = distances(best)
    far = np.isfinite(known) & (known > 1.0)
    if not far.any():
        return float("inf")
    ratio = np.stack([distances(one)[far] / known[far] for one in draws])
    # Samples beyond the horizon are treated as infinitely far.
    low, high = np.quantile(
        np.where(np.isfinite(ratio), ratio, _BEYOND), (0.16, 0.84), axis=0, method="nearest"
    )
    return float(np.median((high - low) / 2.0))


def _check_options(fit: CameraFit, distance_std: float) -> None:
    focal, tilt = np.sqrt(np.diag(fit.covariance))[:2].tolist()
    if fit.inliers < _LEAST_INLIERS or fit.error > 0.3:
        raise ViewUnknown(
            f"boxes whose heights follow no ground plane ({100 * fit.inliers:.0f} % do)",
            "people who stand upright on one plane, before a camera that does not move",
        )
    if abs(fit.vector[1]) > _STEEPEST:
        raise ViewUnknown(
            f"a view from above ({np.degrees(fit.vector[1]):.0f}° down): "
            "the ground plane is not observable from the heights of boxes",
            "a camera that looks down by less than 60°, or a calibration",
        )
    if _share(fit, distance_std) > 1.0:
        raise ViewUnknown(
            f"boxes that do not determine the ground plane: focal length ± {100 * focal:.0f} %, tilt ± "
            f"{np.degrees(tilt):.0f}°, distances ± {100 * distance_std:.0f} %",
            "more people, nearer and farther ones, or a calibration",
        )


def _share(fit: CameraFit, distance_std: float) -> float:
    """Return the largest uncertainty relative to its limit."""
    focal, tilt = np.sqrt(np.diag(fit.covariance))[:2].tolist()
    return max(focal / _LARGEST_FOCAL, tilt / _LARGEST_TILT, distance_std / _LARGEST_DISTANCE)


def _notes(fit: CameraFit, distance_std: float, person_height: float) -> tuple[str, ...]:
    notes = [
        f"scale: people's boxes are taken to be {person_height:g} m high on average",
        "the lens is taken to be without distortion, its axis to pass through the middle of the image",
    ]
    if _share(fit, distance_std) > _WIDE:
        notes.append("this view is uncertain: people at more distances would improve it")
    return tuple(notes)
