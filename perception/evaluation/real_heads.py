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
from graphtrack.io.readers.towncentre import FPS
from perception.images.frames import Frame, FrameSource
from perception.reproduce.head_runs import tracking_error
from perception.reproduce.street_heads import STEP, WALKING, head_boxes, labelled_runs
from perception.trackers.color import ColourParameters, ColourTracker
from perception.trackers.dynamics import BoxDynamics
from perception.trackers.mixed_state.exemplars import load_head_exemplars
from perception.trackers.mixed_state.tracker import MixedStateParameters, MixedStateTracker
from perception.trackers.tracker import BoxEstimate, Proposal, Tracker

_FEWEST, _MOST = 12, 25
"""Pictures in a row that somebody must be in, and that are looked at."""
_TOLD = 0.5
"""1-σ, in sizes of the head, of the place that trackers are told."""


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
    """Return the pictures of a Town Centre folder and the heads of the ``most`` people who walk longest.

    Raises
    ------
    InputError
        If something of it is not there, or nobody walks.
    """
    frames, camera, runs = labelled_runs(folder, _FEWEST)
    found = [head for run in runs for head in _head(*run, camera)]
    if not found:
        expected = f"people in {_FEWEST} pictures in a row"
        raise InputError("nobody who walks", expected, path=folder / "boxes.csv")
    return frames, sorted(found, key=lambda one: -len(one.frame))[:most]


def _head(person: int, frame: NDArray[np.int64], box: FloatArray, camera: GroundCamera) -> list[WalkingHead]:
    """The head of somebody who walks; none of others."""
    left, top, width, height = box[:_MOST].T
    position = camera.image_to_ground(np.column_stack([left + width / 2.0, top + height]))
    step = np.gradient(position, axis=0)
    if not np.linalg.norm(step, axis=1).mean() * FPS / STEP > WALKING:
        return []
    pan = camera.image_angle(direction(step), position)
    return [WalkingHead(person, frame[:_MOST], head_boxes(box[:_MOST]), pan)]


def _methods(seed: int) -> Mapping[str, tuple[Tracker, bool]]:
    """By name: a tracker, and whether it is told about where the head is."""
    exemplars = load_head_exemplars()
    mixed, colour = MixedStateParameters(), ColourParameters()
    slow = replace(mixed, dynamics=slower(mixed.dynamics, STEP))
    slow_colour = replace(colour, dynamics=slower(colour.dynamics, STEP))
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
    pan = tracker.pan_classes.mean_of(np.array([one.pan for one in said]))
    error = np.asarray(np.abs(difference(pan, head.pan[known])))
    return {
        "on": 100.0 * float(on[1:].mean()),
        "touching": 100.0 * float(np.mean(tracking_error(boxes, truth)[1:] < 1.0)),
        "until": float(off[0]) if len(off) else float(len(said)),
        "pan": float(np.rad2deg(error[on].mean())) if on.any() else float("nan"),
    }
