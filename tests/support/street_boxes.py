"""Boxes of people in simulated streets, before cameras with lenses, by detectors of several kinds."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from graphtrack.geometry.angles import FloatArray
from perception.detection.boxes import PersonBox
from perception.ground.fitting import PinholeView

Detector = Literal["exact", "noisy", "fragments"]
DETECTORS: tuple[Detector, ...] = ("exact", "noisy", "fragments")
_RATE = 5.0  # frames a second
_SIZES = ((1920, 1080), (1280, 720), (768, 576), (640, 480))
_TAIL = 0.5  # seconds for which an error of a detector lasts


@dataclass(frozen=True, eq=False)
class Street:
    """View, size of the image, and boxes of the people who walk there."""

    view: PinholeView
    size: tuple[int, int]
    boxes: list[PersonBox]
    detector: Detector
    people: int


def random_view(
    rng: np.random.Generator, size: tuple[int, int], k1: tuple[float, float] = (-0.25, 0.05)
) -> PinholeView:
    """Draw a view whose lens bends the corners of the image by no more than a half of what is possible."""
    while True:
        focal = size[0] * float(np.exp(rng.uniform(np.log(0.6), np.log(1.8))))
        lens = float(rng.uniform(*k1))
        if lens * (np.hypot(*size) / 2.0 / focal) ** 2 > -2.0 / 27.0:
            break
    tilt, roll = np.deg2rad(rng.uniform(8.0, 40.0)), np.deg2rad(rng.normal(0.0, 1.5))
    across, along = (0.01 * size[0] * rng.normal(size=2)).tolist()
    return PinholeView(focal, float(tilt), float(roll), float(rng.uniform(2.5, 9.0)), lens, (across, along))


def _bodies(at: FloatArray, way: FloatArray, phase: FloatArray, tall: float, stout: float) -> FloatArray:
    """Return points (n, m, 3) on the outline of a walking person: feet, shoulders and head.

    ``stout`` is the breadth of all parts, 1 for usual ones and 0 for a vertical line.
    """
    around = 2.0 * np.pi * np.arange(12) / 12.0
    ring = np.column_stack([np.cos(around), np.sin(around)])
    ahead = np.column_stack([np.cos(way), np.sin(way)])
    aside = np.column_stack([-np.sin(way), np.cos(way)])
    parts = []
    for side in (1.0, -1.0):
        step = stout * side * (0.2 * np.sin(phase)[:, None] * ahead + 0.05 * aside)
        foot = at + tall * step
        parts += [
            np.insert((foot + tall * stout * 0.06 * k * ahead)[:, None], 2, 0.0, axis=2) for k in (-1, 1)
        ]
    for height, radius in ((0.8, 0.12), (0.5, 0.1), (1.0, 0.04), (0.93, 0.06)):
        disk = at[:, None] + tall * stout * radius * ring
        parts.append(np.insert(disk, 2, tall * height, axis=2))
    return np.concatenate(parts, axis=1)


def _projected(view: PinholeView, size: tuple[int, int], point: FloatArray) -> FloatArray:
    """Return pixels (..., 2) of points (..., 3) in the world; NaN behind the camera or past the lens."""
    seen = point @ view.rotation.T + view.translation
    with np.errstate(divide="ignore", invalid="ignore"):
        plane = seen[..., :2] / seen[..., 2:]
    square = (plane**2).sum(axis=-1, keepdims=True)
    bent = 1.0 + view.k1 * square
    pixel = view.focal * bent * plane + np.array(view.centre) + np.array(size) / 2.0
    good = (seen[..., 2:] > 0.1) & (1.0 + 3.0 * view.k1 * square > 0.0)
    return np.where(good, pixel, np.nan)


def street(
    seed: int,
    *,
    detector: Detector | None = None,
    view: PinholeView | None = None,
    size: tuple[int, int] | None = None,
    people: int | None = None,
    k1: tuple[float, float] = (-0.25, 0.05),
) -> Street:
    """Return the boxes of a simulated street.

    Parameters
    ----------
    detector : "exact": boxes around outlines; "noisy": with errors that last, a margin, misses and false
        detections; "fragments": so, and identities that change again and again
    """
    rng = np.random.default_rng(seed)
    size = size or _SIZES[int(rng.integers(len(_SIZES)))]
    view = view or random_view(rng, size, k1)
    detector = detector or DETECTORS[int(rng.integers(len(DETECTORS)))]
    count = people or int(rng.integers(10, 50))
    mean, breadth = rng.normal(1.7, 0.03), rng.uniform(0.0, 1.4)
    noisy = detector != "exact"
    margin = rng.normal(0.0, 0.03) if noisy else 0.0
    sharp = rng.uniform(0.015, 0.04) if noisy else 0.0
    found: list[PersonBox] = []
    number, frame, tries = 0, 0, 0
    camera = view.camera(size)
    while number < count and tries < 5000:
        tries += 1
        start = camera.image_to_ground(rng.uniform((0.0, 0.0), size))
        if not np.linalg.norm(start) < 60.0:  # too far, or beyond the horizon
            continue
        steps = int(rng.integers(10, 90))
        way = rng.uniform(0.0, 2.0 * np.pi) + rng.normal(0.0, 0.05) * np.arange(steps) / _RATE
        speed = rng.uniform(0.8, 1.6)
        move = speed / _RATE * np.column_stack([np.cos(way), np.sin(way)])
        at = start + np.cumsum(move, axis=0) - move[0]
        phase = rng.uniform(0.0, 6.0) + np.arange(steps) * 2.0 * np.pi * 0.9 / _RATE
        tall, stout = rng.normal(mean, 0.09), breadth * rng.uniform(0.8, 1.2)
        pixel = _projected(view, size, _bodies(at, way, phase, tall, stout))
        known = np.isfinite(pixel).all(axis=(1, 2))
        low, high = pixel.min(axis=1), pixel.max(axis=1)
        if noisy:
            low, high = _detected(low, high, margin, sharp, rng)
        low, high = np.maximum(low, 0.0), np.minimum(high, np.array(size, float))
        known &= ((high - low) > (0.0, 0.03 * size[1])).all(axis=1)
        known &= (low[:, 1] < size[1] - 1.0) & (high[:, 0] > 1.0) & (low[:, 0] < size[0] - 1.0)
        known &= high[:, 1] < size[1] * 1.02
        if known.sum() < 5:
            continue
        if noisy:
            known &= rng.random(steps) < 0.9
        for k in np.flatnonzero(known).tolist():
            box = (*low[k].tolist(), *(high[k] - low[k]).tolist())
            found.append(PersonBox(frame + k, number, box))
        number += 1
        frame += int(rng.integers(0, 20))
    if noisy:
        for k in range(round(0.04 * len(found))):
            height = rng.uniform(0.05, 0.3) * size[1]
            corner = rng.uniform((0.0, 0.0), (size[0] - 0.4 * height, size[1] - height))
            box = (*corner.tolist(), 0.4 * height, height)
            found.append(PersonBox(int(rng.integers(frame + 1)), 10_000 + k, box))
    if detector == "fragments":
        found = fragmented(found, rng)
    return Street(view, size, found, detector, number)


def _detected(
    low: FloatArray, high: FloatArray, margin: float, sharp: float, rng: np.random.Generator
) -> tuple[FloatArray, FloatArray]:
    """Return boxes with errors of a detector: of each side, white and lasting, and of a person."""
    tall = (high - low)[:, 1:]
    keep = float(np.exp(-1.0 / _RATE / _TAIL))
    white, last = rng.normal(size=(2, len(low), 4))
    for k in range(1, len(last)):
        last[k] = keep * last[k - 1] + np.sqrt(1.0 - keep**2) * last[k]
    error = sharp * (white + last) + 0.5 * sharp * rng.normal(size=4)
    return low - tall * (0.5 * margin + error[:, :2]), high + tall * (0.5 * margin + error[:, 2:])


def fragmented(boxes: list[PersonBox], rng: np.random.Generator, longest: int = 12) -> list[PersonBox]:
    """Return boxes whose identities end after some frames, and go on as others."""
    number, left, names = 0, {}, {}
    found = []
    for item in boxes:
        if left.get(item.track_id, 0) == 0:
            left[item.track_id] = int(rng.integers(2, longest + 1))
            names[item.track_id], number = number, number + 1
        left[item.track_id] -= 1
        found.append(PersonBox(item.frame, names[item.track_id], item.box))
    return found
