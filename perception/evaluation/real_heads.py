"""The trackers of heads on real heads of Oxford Town Centre, at the few frames a second that are at hand."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from graphtrack.errors import InputError
from graphtrack.evaluation.reproduce.experiment import Cell, Progress, Table
from graphtrack.geometry.angles import FloatArray, difference, direction
from graphtrack.geometry.camera import GroundCamera
from graphtrack.io.cameras import read_calibration
from graphtrack.io.readers.towncentre import FPS, read_boxes
from graphtrack.io.source import Source
from perception.adaptation.alignment import HEAD_HEIGHT, HEAD_WIDTH
from perception.images.frames import Frame, FrameSource
from perception.reproduce.head_runs import mean_pan, tracking_error
from perception.trackers.color import ColourParameters, ColourTracker
from perception.trackers.dynamics import BoxDynamics
from perception.trackers.mixed_state.exemplars import load_head_exemplars
from perception.trackers.mixed_state.tracker import MixedStateParameters, MixedStateTracker
from perception.trackers.tracker import BoxEstimate, Proposal, Tracker

_STEP = 10
"""Frames of the recording from one picture to the next."""
_SCALE = 2.0
"""Size of the pictures, in that of the recording of which the boxes are."""
_FEWEST, _MOST = 12, 25
"""Pictures in a row that somebody must be in, and that are looked at."""
_WALKING = 0.5
"""Metres a second on average: who walks faces where they go, so that the pan of the head is known."""
_TOLD = 0.5
"""1-σ, in sizes of the head, of the place that trackers are told."""
_HEAD_TOP = 0.005
"""Of a head's box, in heights of the person's box below its top."""


@dataclass(frozen=True, eq=False)
class WalkingHead:
    """A head in n pictures one after the other.

    Attributes
    ----------
    person : number
    frame : (n,) of the pictures
    boxes : (n, 4) of the head, pixels, by the person's labelled box
    pan : (n,) radians, where the person goes in the image frame
    """

    person: int
    frame: NDArray[np.int64]
    boxes: FloatArray
    pan: FloatArray


def slower(dynamics: BoxDynamics, steps: int) -> BoxDynamics:
    """The same motion of the centre over so many frames at once."""
    a = dynamics.persistence
    gone = (1.0 - a ** np.arange(1, steps + 1)) / (1.0 - a)
    return replace(
        dynamics,
        persistence=float(a**steps),
        centre_std=float(dynamics.centre_std * np.sqrt(np.square(gone).sum())),
        size_std=float(dynamics.size_std * np.sqrt(steps)),
        reversion=float(1.0 - (1.0 - dynamics.reversion) ** steps),
    )


def heads_of(folder: Path, most: int) -> tuple[FrameSource, list[WalkingHead]]:
    """Those of the ``most`` people who walk longest in the pictures of a Town Centre folder.

    Raises
    ------
    InputError
        If something of it is not there.
    """
    pictures, truth = folder / "frames_001_150" / "img1", folder / "boxes.csv"
    for path in (pictures, truth, folder / "calibration.ci"):
        if not path.exists():
            raise InputError(
                "no such file or folder", "Town Centre's pictures, boxes and calibration", path=path
            )
    frames, camera = FrameSource.open(pictures), read_calibration(folder / "calibration.ci")
    rows = read_boxes(Source.open(truth))
    last = (frames.count - 1) * _STEP
    there = (rows.frame % _STEP == 0) & (rows.frame <= last)
    found = []
    for person in np.unique(rows.track_id[there]).tolist():
        mine = np.flatnonzero(there & (rows.track_id == person))
        mine = mine[np.argsort(rows.frame[mine])]
        number = rows.frame[mine] // _STEP + 1
        longest = max(np.split(np.arange(len(mine)), np.flatnonzero(np.diff(number) > 1) + 1), key=len)
        run = longest[:_MOST]
        if len(run) >= _FEWEST:
            box = rows.channels["box"][mine[run]] * _SCALE
            found += _head(person, np.asarray(number[run], np.int64), box, camera)
    if not found:
        raise InputError("nobody who walks", f"people in {_FEWEST} pictures in a row", path=truth)
    return frames, sorted(found, key=lambda one: -len(one.frame))[:most]


def _head(person: int, frame: NDArray[np.int64], box: FloatArray, camera: GroundCamera) -> list[WalkingHead]:
    """The head of somebody who walks; none of others."""
    left, top, width, height = box.T
    middle = left + width / 2.0
    position = camera.image_to_ground(np.column_stack([middle, top + height]))
    step = np.gradient(position, axis=0)
    if not np.linalg.norm(step, axis=1).mean() * FPS / _STEP > _WALKING:
        return []
    pan = camera.image_angle(direction(step), position)
    size = np.array([HEAD_WIDTH, HEAD_HEIGHT]) * height[:, None]
    heads = np.column_stack([middle - size[:, 0] / 2.0, top + _HEAD_TOP * height, size])
    return [WalkingHead(person, frame, heads, pan)]


def _methods(seed: int) -> Mapping[str, tuple[Tracker, bool]]:
    """By name: a tracker, and whether it is told about where the head is."""
    exemplars = load_head_exemplars()
    mixed, colour = MixedStateParameters(), ColourParameters()
    slow = replace(mixed, dynamics=slower(mixed.dynamics, _STEP))
    slow_colour = replace(colour, dynamics=slower(colour.dynamics, _STEP))
    return {
        "mixed-state": (MixedStateTracker(mixed, exemplars=exemplars, seed=seed), False),
        "mixed-state, motion of 0.4 s": (MixedStateTracker(slow, exemplars=exemplars, seed=seed), False),
        "mixed-state, told the place": (MixedStateTracker(mixed, exemplars=exemplars, seed=seed), True),
        "colour": (ColourTracker(colour, exemplars=exemplars, seed=seed), False),
        "colour, motion of 0.4 s": (ColourTracker(slow_colour, exemplars=exemplars, seed=seed), False),
        "colour, told the place": (ColourTracker(colour, exemplars=exemplars, seed=seed), True),
    }


def heads_table(folder: Path, people: int, seed: int, progress: Progress) -> Table:
    """What each tracker makes of heads, begun with the first labelled box."""
    frames, heads = heads_of(folder, people)
    rows: list[dict[str, Cell]] = []
    every: dict[str, list[dict[str, float]]] = {}
    for head in heads:
        moved = np.linalg.norm(np.diff(head.boxes[:, :2] + head.boxes[:, 2:] / 2.0, axis=0), axis=1)
        step = float(np.median(moved / head.boxes[1:, 2]))
        pictures = list(frames.where(set(head.frame.tolist()).__contains__))
        for name, (tracker, told) in _methods(seed).items():
            figures = _followed(tracker, pictures, head, told=told)
            every.setdefault(name, []).append({"step": step, **figures})
            who: dict[str, Cell] = {"person": str(head.person), "pictures": len(head.frame), "method": name}
            rows.append({**who, **_row(every[name][-1:])})
        progress(1)
    for name, figures_of in every.items():
        mean: dict[str, Cell] = {"person": "mean", "pictures": None, "method": name}
        rows.append({**mean, **_row(figures_of)})
    return Table.of("Real heads (Town Centre, 2.5 pictures a second), from the first labelled box", rows)


def _row(figures: list[dict[str, float]]) -> dict[str, Cell]:
    names = {
        "step": "step (head widths)",
        "on": "on the head (%)",
        "touching": "touching (%)",
        "until": "pictures until it is lost",
        "pan": "pan, while on it (°)",
    }
    values = {key: [one[key] for one in figures if np.isfinite(one[key])] for key in names}
    return {label: float(np.mean(values[key])) if values[key] else None for key, label in names.items()}


def _followed(
    tracker: Tracker, pictures: Sequence[Frame], head: WalkingHead, *, told: bool
) -> dict[str, float]:
    """Figures of a tracker; one that is told has a proposal about the true place in every picture."""
    said: list[BoxEstimate] = []
    known = []
    at = {frame: k for k, frame in enumerate(head.frame.tolist())}
    for picture in pictures:
        if picture.image is None:
            continue
        k = at[picture.number]
        left, top, width, height = (float(value) for value in head.boxes[k])
        if not said:
            said.append(tracker.start(picture.image, (left, top, width, height)))
        else:
            place = np.array([left + width / 2.0, top + height / 2.0])
            about = Proposal(place, np.diag(np.square([_TOLD * width, _TOLD * height])))
            said.append(tracker.step(picture.image, about if told else None))
        known.append(k)
    boxes, truth = np.array([one.box for one in said]), head.boxes[known]
    centre = boxes[:, :2] + boxes[:, 2:] / 2.0
    inside = (centre >= truth[:, :2]) & (centre <= truth[:, :2] + truth[:, 2:])
    on = np.asarray(inside.all(axis=1))
    off = np.flatnonzero(tracking_error(boxes, truth) >= 1.0)
    assert tracker.pan_classes is not None
    pan = mean_pan(np.array([one.pan for one in said]), tracker.pan_classes)
    error = np.asarray(np.abs(difference(pan, head.pan[known])))
    return {
        "on": 100.0 * float(on[1:].mean()),
        "touching": 100.0 * float(np.mean(tracking_error(boxes, truth)[1:] < 1.0)),
        "until": float(off[0]) if len(off) else float(len(said)),
        "pan": float(np.rad2deg(error[on].mean())) if on.any() else float("nan"),
    }
