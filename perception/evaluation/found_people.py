"""Reliability of detections of people in Town Centre, by score."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from graphtrack.experiments.harness import Cell, Progress, Table
from graphtrack.geometry.angles import FloatArray
from graphtrack.geometry.camera import GroundCamera
from graphtrack.io.cameras import read_calibration
from perception.detection.background import Backgrounds, background_samples
from perception.detection.ground_search import Candidates, GroundSearch, joined
from perception.detection.rescoring import PersonProbability, adapt_to_recording
from perception.images.frames import FrameSource

RATE = 2.5
"""Frames a second of the recording."""
_STEP = 10
"""Video frames per available image; the ground truth has a row for every video frame."""
_MATCH = 1.0
"""Metres on the ground within which a detection is correct."""
_BINS = 10


def reliability_table(folder: Path, seed: int, progress: Progress) -> Table:
    """Compute the precision of detections, with each half of the minute adapted to the other.

    The ground truth omits people cut off by the image's border, so detections entirely inside the image are
    also reported separately.
    """
    frames = FrameSource.open(folder / "frames_001_150" / "img1")
    camera, numbers = read_calibration(folder / "calibration.ci"), frames.numbers()
    backgrounds = Backgrounds.of(frames, background_samples(numbers, RATE), numbers)
    search = GroundSearch(camera, frames.size())
    candidates = {}
    for frame in frames:
        if frame.image is not None:
            candidates[frame.number] = search.candidates(frame.image, backgrounds.at(frame.number))
        progress(1)
    truth = _truth(folder / "boxes.csv", camera, len(candidates))
    first, second = np.array_split(np.array(sorted(candidates)), 2)
    parts = []
    for learned, judged in ((first, second), (second, first)):
        of_half = {k: candidates[k] for k in learned.tolist()}
        known = adapt_to_recording(of_half, camera, RATE, np.random.default_rng(seed))
        assert known is not None
        parts += [_judged(candidates[k], known, search, camera, truth.get(k)) for k in judged.tolist()]
    confidence, right, inside, written = np.concatenate(parts).T
    people = sum(map(len, truth.values()))
    rows: list[Mapping[str, Cell]] = []
    place = np.minimum((confidence * _BINS).astype(int), _BINS - 1)
    for k in range(_BINS):
        name = f"{k / _BINS:g}-{(k + 1) / _BINS:g}"
        rows.append(_row(name, confidence, right, inside, place == k) | {"recall (%)": None})
    for name, chosen in (("all", confidence >= 0.0), ("that are written", written > 0)):
        recall = 100.0 * float(right[chosen].sum()) / people
        rows.append(_row(name, confidence, right, inside, chosen) | {"recall (%)": recall})
    title = "Town Centre's first minute: detections within 1 m of a person, model trained on the other half"
    return Table.of(title, rows)


def calibration_error(confidence: FloatArray, right: FloatArray) -> float:
    """Return the expected calibration error of probabilities (n,) of events (n,), in bins of a tenth."""
    place = np.minimum((confidence * _BINS).astype(int), _BINS - 1)
    off = np.bincount(place, confidence - right, _BINS)
    return float(np.abs(off).sum() / max(len(confidence), 1))


def _row(
    name: str, confidence: FloatArray, right: FloatArray, inside: FloatArray, chosen: NDArray[np.bool_]
) -> dict[str, Cell]:
    row: dict[str, Cell] = {"said": name}
    for of, rows in (("", chosen), (" inside", chosen & (inside > 0))):
        some = bool(rows.any())
        row |= {
            f"detections{of}": int(rows.sum()),
            f"mean{of} (%)": 100.0 * float(confidence[rows].mean()) if some else None,
            f"found{of} (%)": 100.0 * float(right[rows].mean()) if some else None,
            f"ECE{of}": calibration_error(confidence[rows], right[rows]) if some else None,
        }
    return row


def _judged(
    candidates: Candidates,
    probability: PersonProbability,
    search: GroundSearch,
    camera: GroundCamera,
    truth: FloatArray | None,
) -> FloatArray:
    """Return per detection its score, and whether it is correct, inside the image, and written."""
    found = joined(candidates.scored(probability.of(candidates)))
    right = np.zeros(len(found))
    if truth is not None:
        away = np.linalg.norm(camera.image_to_ground(found.foot)[:, None] - truth, axis=2)
        one, other = linear_sum_assignment(np.minimum(away, 2.0 * _MATCH))
        right[one] = away[one, other] < _MATCH
    columns, rows = search.size
    top, tolerance = found.foot[:, 1] - found.height, 0.2 * found.height
    inside = (top >= 0.0) & (found.foot[:, 1] < rows)
    inside &= (found.foot[:, 0] >= tolerance) & (found.foot[:, 0] < columns - tolerance)
    return np.column_stack([found.score, right, inside, found.score >= probability.even])


def _truth(path: Path, camera: GroundCamera, frames: int) -> dict[int, FloatArray]:
    """Return positions (n, 2) of the hand-labelled people of the first frames, by image number."""
    rows = np.loadtxt(path, delimiter=",")
    rows = rows[(rows[:, 0] < _STEP * frames) & (rows[:, 0] % _STEP == 0)]
    left, top, width, height = 2.0 * rows[:, 2:6].T  # of images of half the size
    place = camera.image_to_ground(np.column_stack([left + width / 2.0, top + height]))
    number = rows[:, 0].astype(int) // _STEP + 1
    return {k: place[number == k] for k in np.unique(number).tolist()}
