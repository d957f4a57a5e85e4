"""Calibration of a camera from boxes of people, with intervals; a scale only where they are wide."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray
from graphtrack.geometry.camera import GroundCamera
from graphtrack.io.cameras import PERSON_HEIGHT, write_calibration, write_scale
from perception.detection.boxes import PersonBox, foot_point
from perception.ground.fitting import (
    ACROSS,
    ALONG,
    FOCAL,
    HEIGHT,
    LENS,
    PRIOR_MEAN,
    PRIOR_STD,
    ROLL,
    TILT,
    HeightData,
    PinholeView,
    ViewPosterior,
    box_heights,
    found_mode,
    ground_points,
    lens_of,
    posterior,
)
from perception.ground.scale import ViewScale
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


_WAY, _GROWN = 0.5, 0.15
"""Way of the feet, in heights of the box, and change of the log height that make another observation."""


def spread_rows(boxes: Sequence[PersonBox], person: NDArray[np.int64]) -> list[NDArray[np.int64]]:
    """Return the indices of the boxes of each observation: a person on half a height of the way.

    Errors of boxes last while a person hardly moves, at any frame rate.
    """
    foot = np.array([foot_point(item.box) for item in boxes]).reshape(-1, 2)
    height = np.array([item.box[3] for item in boxes])
    order = np.lexsort((np.array([item.frame for item in boxes]), person))
    cuts, first = [], -1
    for k, row in enumerate(order.tolist()):
        if first >= 0 and person[row] == person[first]:
            way = np.hypot(*(foot[row] - foot[first])) / height[first]
            if way < _WAY and abs(np.log(height[row] / height[first])) < _GROWN:
                continue
        if first >= 0:
            cuts.append(k)
        first = row
    return np.split(order, cuts) if len(order) else []


_SAME, _SHARED = 0.6, 0.5
"""Overlap of two boxes of one person in one frame; share of frames of the shorter of two such tracks."""
_GAP, _PACE = 2.4, 0.8
"""Way in heights for which a person is looked for after the end of a track; heights a second of walking."""
_NEAR, _SPREAD, _LIKE = 0.4, 0.6, 0.3
"""Largest distance of the next track, in heights and as a share of the way; and of log heights."""


def chains_of(boxes: Sequence[PersonBox], person: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the person (tracks,) of each track, from 0: tracks that continue or cover each other are joined.

    They are joined generously, and may be two people: only the number of independent people follows from it.

    Parameters
    ----------
    person : (n,) track of each box, from 0
    """
    count = int(person.max(initial=-1)) + 1
    joined = [*_continued(boxes, person, count), *_covered(boxes, person)]
    first, second = np.array(joined, int).reshape(-1, 2).T
    links = coo_array((np.ones(len(joined)), (first, second)), shape=(count, count))
    return np.asarray(connected_components(links, directed=False)[1], np.int64)


def _continued(
    boxes: Sequence[PersonBox], person: NDArray[np.int64], count: int
) -> Iterator[tuple[int, int]]:
    """Yield pairs of tracks, the second of which begins near to where the first would be then."""
    frame = np.array([item.frame for item in boxes], np.int64)
    foot = np.array([foot_point(item.box) for item in boxes]).reshape(-1, 2)
    size = np.array([item.box[3] for item in boxes])
    order = np.lexsort((frame, person))
    starts = np.searchsorted(person[order], np.arange(count))
    ends = np.append(starts[1:], len(order)) - 1
    first, last = order[starts], order[ends]
    lasted = frame[last] - frame[first]
    way = (foot[last] - foot[first]) / np.maximum(lasted, 1)[:, None]
    pace = np.hypot(*way.T) / np.sqrt(size[first] * size[last])
    walked = pace[(ends - starts >= 3) & (pace > 0.0)]
    usual = float(np.clip(np.median(walked) if len(walked) else _PACE / 25.0, 0.005, 1.0))
    found = []
    for k in range(count):
        gap = frame[first[k]] - frame[last]
        near = np.flatnonzero((gap > 0) & (gap <= max(2.0, _GAP / usual)))
        stood = foot[last[near]] - foot[first[k]]
        walking = stood + way[near] * gap[near, None]
        away = np.minimum(np.hypot(*stood.T), np.hypot(*walking.T)) / size[last[near]]
        like = np.abs(np.log(size[first[k]] / size[last[near]])) < _LIKE
        good = like & (away < _NEAR + _SPREAD * usual * gap[near])
        found += [
            (cost, before, k) for cost, before in zip(away[good].tolist(), near[good].tolist(), strict=True)
        ]
    begun, ended = set[int](), set[int]()
    for _, before, after in sorted(found):
        if before not in ended and after not in begun:
            ended.add(before)
            begun.add(after)
            yield before, after


def _covered(boxes: Sequence[PersonBox], person: NDArray[np.int64]) -> Iterator[tuple[int, int]]:
    """Yield pairs of tracks whose boxes cover each other in most frames of the shorter track."""
    frame = np.array([item.frame for item in boxes], np.int64)
    box = np.array([item.box for item in boxes], float).reshape(-1, 4)
    length, shared = np.bincount(person), Counter[tuple[int, int]]()
    order = np.argsort(frame, kind="stable")
    for now in np.split(order, np.flatnonzero(np.diff(frame[order])) + 1):
        overlap = np.triu(intersection_over_union(box[now][:, None], box[now]), 1)
        pairs = np.sort(person[now][np.argwhere(overlap > _SAME)], axis=1)
        shared.update((int(one), int(other)) for one, other in pairs)
    for (one, other), frames in shared.items():
        if frames >= _SHARED * min(length[one], length[other]):
            yield one, other


_DRAWS, _EVERY, _BEYOND = 2000, 10, 1e3
_STEEPEST = np.deg2rad(60.0)
_LEAST_PEOPLE, _LEAST_OBSERVATIONS, _MOST_OBSERVATIONS = 6, 20, 1000
_LEAST_BOXES = 3  # of a person; detections that are fewer are taken to be false
_TALL = 1.25  # height of a tall person's box over the mean, and of the mean over a small one's
_SMALLEST = 0.01  # quantile of heights that is the least that is detected
_WIDE = 0.25
"""Half width of a 95 % interval, as a share of the value, above which the view is a scale only."""
_LARGEST_FOCAL, _LARGEST_TILT, _LARGEST_DISTANCE = 0.45, float(np.deg2rad(9.0)), 0.3
"""Largest 1-σ of focal length (relative), tilt (radians) and ground distances (relative)."""
_LEAST_INLIERS, _LARGEST_ERROR = 0.5, 0.3
_SCALE = 0.05
"""1-σ of the logarithm of the mean height of people's boxes: crowds differ, and so do margins of boxes."""
_LEVEL = 0.95


@dataclass(frozen=True, eq=False)
class FoundScale:
    """Scale from the heights of people, where boxes determine no perspective.

    Attributes
    ----------
    scale : at which the median box has the height of a person
    boxes : their number
    reason : why there is no perspective
    """

    scale: ViewScale
    boxes: int
    reason: str
    notes: tuple[str, ...] = ()

    @property
    def camera(self) -> GroundCamera:
        """Return the view at this scale."""
        return self.scale.camera

    def write(self, path: str | Path) -> None:
        """Write a calibration that `graphtrack.io.cameras.read_calibration` reads.

        Raises
        ------
        InputError
            If the path cannot be written to.
        """
        write_scale(path, self.scale.metres_per_pixel, self.scale.tilt)

    def described(self) -> str:
        """Describe the scale and its reason."""
        return (
            f"scale only, {self.scale.metres_per_pixel:.3g} m a pixel, {self.scale.described()}, from "
            f"{self.boxes} boxes: {self.reason}"
        )


@dataclass(frozen=True, eq=False)
class FoundView:
    """View estimated from boxes.

    Attributes
    ----------
    view : focal length, tilt, roll, height and lens
    std : 1-σ of focal, tilt, roll, height, in the units of `PinholeView`
    interval : 95 % interval of each
    distance_std : relative 1-σ of distances on the ground between people, for a given mean height of people
    size : columns and rows of the image
    boxes, people : numbers used in the fit; tracks that continue each other count as one person
    inliers : share of inlier observations
    notes : assumptions and warnings
    """

    view: PinholeView
    std: Mapping[str, float]
    interval: Mapping[str, tuple[float, float]]
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

    @property
    def scale_only(self) -> bool:
        """Return True if an interval of focal length, tilt or height is wider than ± 25 %."""
        return any(
            high - low > 2.0 * _WIDE * abs(getattr(self.view, name))
            for name, (low, high) in self.interval.items()
            if name != "roll"
        )

    def write(self, path: str | Path) -> None:
        """Write a calibration with uncertainties, readable by `graphtrack.io.cameras.read_calibration`.

        Raises
        ------
        InputError
            If the path cannot be written to.
        """
        view = self.view
        names = {
            "focal": "FocalLength",
            "tilt": "TiltDegrees",
            "roll": "RollDegrees",
            "height": "CameraHeight",
        }
        remarks = {
            "TiltDegrees": np.degrees(view.tilt),
            "RollDegrees": np.degrees(view.roll),
            "CameraHeight": view.height,
            "GroundDistanceRelativeStd": self.distance_std,
            "ScaleOnly": float(self.scale_only),
        }
        for name, title in names.items():
            unit = 180.0 / np.pi if name in ("tilt", "roll") else 1.0
            low, high = self.interval[name]
            remarks |= {f"{title}Std": unit * self.std[name], f"{title}Low95": unit * low}
            remarks[f"{title}High95"] = unit * high
        matrix = view.intrinsics(self.size)
        write_calibration(
            path, view.rotation, view.translation, matrix, distortion=view.distortion, remarks=remarks
        )

    def described(self) -> str:
        """Describe the view with its uncertainty."""

        def value(name: str, digits: int, unit: str, scale: float = 1.0) -> str:
            best, std = scale * getattr(self.view, name), scale * self.std[name]
            low, high = (scale * end for end in self.interval[name])
            return f"{best:.{digits}f} ± {std:.{digits}f}{unit} (95 %: {low:.{digits}f} to {high:.{digits}f})"

        degrees = float(np.degrees(1.0))
        return (
            f"{'scale only, ' if self.scale_only else ''}"
            f"from {self.boxes} boxes of {self.people} people ({100 * self.inliers:.0f} % inliers): "
            f"focal length {value('focal', 0, ' pixels')}, tilt {value('tilt', 1, '°', degrees)}, "
            f"roll {value('roll', 1, '°', degrees)}, height {value('height', 2, ' m')}; "
            f"distances on the ground ± {100 * self.distance_std:.0f} %"
        )


def found_view(
    boxes: Sequence[PersonBox],
    size: tuple[int, int],
    rng: np.random.Generator,
    person_height: float = PERSON_HEIGHT,
) -> FoundView | FoundScale:
    """Estimate the view of a camera over the ground from the heights of people's boxes.

    Parameters
    ----------
    boxes : at least one, of people, with some false detections; with or without identities
    size : columns and rows of the image
    rng : chooses observations if there are more than needed, and draws from the posterior
    person_height : mean height of people (or of the contents of boxes) in metres

    Raises
    ------
    InputError
        If there are no boxes, or they are of another image size.
    """
    if not boxes:
        raise InputError("no boxes of people", "at least one person")
    _check_size(boxes, size)
    scale = ViewScale.of([item.box for item in boxes], person_height)
    kept = np.flatnonzero(complete_boxes(np.array([item.box for item in boxes], float), size))
    tracks = people_of(boxes)
    chain = chains_of(boxes, tracks)[tracks]
    lasting = np.bincount(chain) >= _LEAST_BOXES
    kept = kept[lasting[chain[kept]]]
    data, people = _height_data(boxes, kept, tracks, chain, size, rng)
    if data is not None:
        mode = found_mode(data)
        fits = _fits_in(mode.vector, boxes, kept, size)
        if not fits.all():
            kept = kept[fits]
            data, people = _height_data(boxes, kept, tracks, chain, size, rng)
            mode = mode if data is None else found_mode(data, mode.vector)
    if data is None:
        reason = f"{len(kept)} complete boxes of {people} people are too few to calibrate a perspective"
        return FoundScale(scale, len(boxes), reason)
    found = posterior(data, mode)
    width = float(max(size))
    draws = found.draws(_DRAWS, rng)
    best = found.median()
    distance_std = _distance_std(draws, best, data, rng)
    unknown = _no_perspective(found, draws, best, distance_std)
    if unknown is not None:
        return FoundScale(scale, len(boxes), unknown)
    view = PinholeView(
        width * float(np.exp(best[FOCAL])),
        float(best[TILT]),
        float(best[ROLL]),
        person_height * float(np.exp(best[HEIGHT])),
        float(lens_of(best, data.corner)),
        (width * float(best[ACROSS]), width * float(best[ALONG])),
    )
    values = {
        "focal": width * np.exp(draws[:, FOCAL]),
        "tilt": draws[:, TILT],
        "roll": draws[:, ROLL],
        "height": person_height * np.exp(draws[:, HEIGHT] + _SCALE * rng.normal(size=_DRAWS)),
    }
    std = {name: float(value.std()) for name, value in values.items()}
    ends = (0.5 * (1.0 - _LEVEL), 0.5 * (1.0 + _LEVEL))
    interval = {}
    for name, value in values.items():
        low, high = np.quantile(value, ends).tolist()
        interval[name] = (low, high)
    answer = FoundView(
        view,
        std,
        interval,
        distance_std,
        size,
        len(kept),
        people,
        found.mode.inliers,
        _notes(person_height, view),
    )
    return replace(answer, notes=(*answer.notes, _SCALE_ONLY)) if answer.scale_only else answer


def _height_data(
    boxes: Sequence[PersonBox],
    kept: NDArray[np.int64],
    tracks: NDArray[np.int64],
    chain: NDArray[np.int64],
    size: tuple[int, int],
    rng: np.random.Generator,
) -> tuple[HeightData | None, int]:
    """Return the observations in the boxes that are kept (None: too few), and the number of people."""
    complete = [boxes[k] for k in kept.tolist()]
    observed = spread_rows(complete, tracks[kept])
    first = np.array([rows[0] for rows in observed], np.int64)
    chosen = thinned(np.unique(tracks[kept][first], return_inverse=True)[1], _MOST_OBSERVATIONS, rng)
    _, start, person = np.unique(tracks[kept][first[chosen]], return_index=True, return_inverse=True)
    people, of_track = np.unique(chain[kept][first[chosen]][start], return_inverse=True)
    if len(people) < _LEAST_PEOPLE or len(chosen) < _LEAST_OBSERVATIONS:
        return None, len(people)
    width = float(max(size))
    feet = (np.array([foot_point(item.box) for item in complete]) - np.array(size) / 2.0) / width
    log_height = np.log(np.array([item.box[3] for item in complete]) / width)
    data = HeightData(
        np.array([np.median(feet[observed[k]], axis=0) for k in chosen.tolist()]),
        np.array([np.median(log_height[observed[k]]) for k in chosen.tolist()]),
        person.astype(np.int64),
        of_track.astype(np.int64),
        float(np.hypot(*size)) / 2.0 / width,
    )
    return data, len(people)


def _fits_in(
    vector: FloatArray, boxes: Sequence[PersonBox], kept: NDArray[np.int64], size: tuple[int, int]
) -> NDArray[np.bool_]:
    """Return a mask of boxes at whose feet a tall person would be in the image, and a small one detected.

    Where only the small ones are complete, complete boxes are too small; where only the large ones are
    detected, detected boxes are too large.
    """
    width = float(max(size))
    feet = np.array([foot_point(boxes[k].box) for k in kept.tolist()])
    middle = np.array(size) / 2.0
    height = width * box_heights(vector, (feet - middle) / width, float(np.hypot(*size)) / 2.0 / width)
    least = float(np.quantile([boxes[k].box[3] for k in kept.tolist()], _SMALLEST))
    with np.errstate(invalid="ignore"):
        return np.asarray(~((feet[:, 1] < _TALL * height + _BORDER) | (height < _TALL * least)))


_SCALE_ONLY = (
    "scale only: focal length, tilt or height of the camera are not known to ± 25 % (95 %); the heights of "
    "people give the scale at each position in the image, distances in depth and directions are approximate"
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


def _distance_std(draws: FloatArray, best: FloatArray, data: HeightData, rng: np.random.Generator) -> float:
    """Return the median relative 1-σ of ground distances between positions of people."""
    pairs = rng.integers(len(data.feet), size=(2, 200))

    def distances(vector: FloatArray) -> FloatArray:
        first, second = (ground_points(vector, data.feet[rows], data.corner) for rows in pairs)
        return np.asarray(np.linalg.norm(first - second, axis=0), float)

    known = distances(best)
    far = np.isfinite(known) & (known > 1.0)
    if not far.any():
        return float("inf")
    ratio = distances(draws[::_EVERY])[:, far] / known[far]
    # Samples beyond the horizon are treated as infinitely far.
    low, high = np.quantile(
        np.where(np.isfinite(ratio), ratio, _BEYOND), (0.16, 0.84), axis=0, method="nearest"
    )
    return float(np.median((high - low) / 2.0))


def _no_perspective(
    found: ViewPosterior, draws: FloatArray, best: FloatArray, distance_std: float
) -> str | None:
    """Return the reason for which boxes determine no perspective; None if they do."""
    if found.mode.inliers < _LEAST_INLIERS or found.mode.error > _LARGEST_ERROR:
        return f"the heights of boxes follow no ground plane ({100 * found.mode.inliers:.0f} % do)"
    if abs(best[TILT]) > _STEEPEST:
        down = np.degrees(best[TILT])
        return f"the view is from above ({down:.0f}° down): heights of boxes do not show the ground plane"
    focal, tilt = draws[:, [FOCAL, TILT]].std(axis=0).tolist()
    if focal > _LARGEST_FOCAL or tilt > _LARGEST_TILT or distance_std > _LARGEST_DISTANCE:
        distances = f"± {100 * distance_std:.0f} %" if distance_std < 10.0 else "not known"
        return (
            f"boxes do not determine the ground plane: focal length ± {100 * focal:.0f} %, tilt ± "
            f"{np.degrees(tilt):.0f}°, distances {distances}; people nearer and farther would"
        )
    return None


def _notes(person_height: float, view: PinholeView) -> tuple[str, ...]:
    return (
        f"scale: people's boxes are taken to be {person_height:g} m high on average, ± {100 * _SCALE:g} %",
        f"lens: k1 = {view.k1:.2f}, by a prior of {PRIOR_MEAN[LENS]:g} ± {PRIOR_STD[LENS]:g} and the boxes",
    )
