"""Evaluation of models fitted to a camera: CAVIAR's lobby across sequences, Town Centre by every method.

All people are held out of the models that evaluate them. People lean in the lobby's images;
`perception.ground.upright` rotates them upright.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from graphtrack.errors import InputError
from graphtrack.evaluation.identities import score
from graphtrack.experiments.harness import Cell, Progress, Table, quietly
from graphtrack.geometry.angles import difference, direction
from graphtrack.geometry.camera import GroundCamera
from graphtrack.io import read_identified
from graphtrack.io.cameras import read_calibration
from graphtrack.io.formats.caviar import FPS, lobby_camera
from graphtrack.smoothing import smooth
from graphtrack.tracks.track import Track, TrackSet
from perception.adaptation.directions import CLASSES, folds_of, with_outliers
from perception.adaptation.labels import descriptors_of_people, patches_in, walking_labels
from perception.adaptation.learning import (
    PackageModels,
    Recording,
    adapted,
    learn,
    thinned,
)
from perception.adaptation.models import CameraModels
from perception.detection.boxes import read_boxes
from perception.ground.upright import LeaningView
from perception.images.frames import Clock, FrameSource
from perception.observation.pipeline import Models, PersonObservation, by_frame, observe_frame
from perception.observation.tables import METHODS, associated, estimated, to_detections, to_tracks


@dataclass(frozen=True, eq=False)
class LobbySequence:
    """A sequence of the lobby.

    Attributes
    ----------
    name : of the sequence
    recording : frames and labelled boxes
    gaze : labelled gaze by frame and person, radians in the image frame
    """

    name: str
    recording: Recording
    gaze: dict[tuple[int, int], float]


def sequences_of(folder: Path) -> list[LobbySequence]:
    """Return the lobby's sequences of a CAVIAR folder with available frames.

    Raises
    ------
    InputError
        If there are less than two.
    """
    paths = [path for path in sorted(folder.glob("xml/*.xml")) if (folder / "frames" / path.stem).is_dir()]
    if len(paths) < 2:
        raise InputError(
            f"{len(paths)} sequences", "two or more in frames/NAME and xml/NAME.xml", path=folder
        )
    return [_sequence(path, folder / "frames" / path.stem) for path in paths]


def _sequence(path: Path, folder: Path) -> LobbySequence:
    camera, frames = lobby_camera(), FrameSource.open(folder)
    there = set(frames.numbers())
    people = [item for item in read_boxes(path) if item.frame in there]
    gaze: dict[tuple[int, int], float] = {}
    for track in quietly(path):
        if track.head is None:
            continue
        angle = camera.image_angle(track.head, track.position)
        for frame, value in zip(track.frame.tolist(), angle.tolist(), strict=True):
            if np.isfinite(value):
                gaze[frame, track.track_id] = value
    return LobbySequence(path.stem, Recording(frames, people, FPS), gaze)


def ignored(*values: object) -> None:
    """Suppress reports of progress and of empty boxes."""


def no_progress(count: int, unit: str = "") -> AbstractContextManager[Callable[[int], None]]:
    """Show no progress of decoding and fitting."""
    return nullcontext(ignored)


def adapted_table(sequences: list[LobbySequence], seed: int, progress: Progress) -> Table:
    """Compute errors in each sequence by models fitted to the others."""
    package = PackageModels.load()
    rows = []
    for one in sequences:
        training = [other.recording for other in sequences if other is not one]
        rng = np.random.default_rng(seed)
        found = adapted(training, lobby_camera(), package, rng, no_progress, ignored)
        rows.append(_sequence_errors(found.models, package, one, found.people))
        progress(1)
    return Table.of("CAVIAR's lobby, adapted on the other sequences: mean error in degrees (chance 90)", rows)


def _sequence_errors(
    models: CameraModels, package: PackageModels, sequence: LobbySequence, trained_on: int
) -> dict[str, Cell]:
    camera, recording = lobby_camera(), sequence.recording
    people = recording.people
    view = LeaningView.of(camera, recording.frames.size())
    labels = walking_labels(people, None, camera, recording.clock, view=view)
    walking = {
        (people[k].frame, people[k].track_id): angle
        for k, angle in zip(labels.box.tolist(), labels.angle.tolist(), strict=True)
    }
    wanted = walking.keys() | sequence.gaze.keys()
    parts = package.head_localiser, package.body_pose, package.head_pose
    answered = {}
    for name, of_camera in (("adapted", models), ("package", None)):
        looking = Models(*parts, of_camera=of_camera).seeing(camera, recording.frames.size)
        body, head, everybody = {}, {}, []
        for frame in recording.frames:
            of_frame = [item for item in people if (item.frame, item.track_id) in wanted]
            of_frame = [item for item in of_frame if item.frame == frame.number]
            if frame.image is None or not of_frame:
                continue
            for people_observed in observe_frame(frame.image, frame.number, of_frame, looking, ignored):
                key = people_observed.frame, people_observed.track_id
                everybody += [people_observed] if key in walking else []
                body[key] = float(CLASSES.mean_pan(people_observed.body[None])[0])
                head[key] = float(looking.head_classes.mean_pan(people_observed.pan[:1])[0])
        answered[name] = body, head
        if of_camera is not None:
            smoothed = _smoothed(everybody, of_camera, recording.clock)
    body, head = answered["adapted"]
    return {
        "judged on": sequence.name,
        "learned from (people)": trained_on,
        "walking (people)": len(np.unique(labels.person)),
        "boxes": len(walking),
        "body, walking": _error(body, walking),
        "body, smoothed": _error(smoothed, walking),
        "head, walking": _error(head, walking),
        "head against gaze": _error(head, sequence.gaze),
        "travel against gaze": _error(walking, sequence.gaze),
        "gazes": len(sequence.gaze),
        "the package's body, walking": _error(answered["package"][0], walking),
        "in learning: body of people left out": models.card.figures["body_error_deg"],
    }


def _smoothed(
    people_observed: list[PersonObservation], models: CameraModels, clock: float | Clock
) -> dict[tuple[int, int], float]:
    """Return the body angle smoothed by the graph with motion, radians in the image frame."""
    camera = lobby_camera()
    tracks = to_tracks(by_frame(people_observed), CLASSES.pans, camera, clock).tracks
    found: dict[tuple[int, int], float] = {}
    for track in estimated(tracks, camera, "smoother", ignored, models.graph).tracks:
        if track.body is None:
            continue
        angles = camera.image_angle(track.body, track.position)
        found |= dict(
            zip(((frame, track.track_id) for frame in track.frame.tolist()), angles.tolist(), strict=True)
        )
    return found


def _error(answered: dict[tuple[int, int], float], truth: dict[tuple[int, int], float]) -> float | None:
    """Return the mean error where the truth is known, degrees."""
    shared = sorted(answered.keys() & truth.keys())
    if not shared:
        return None
    apart = difference(np.array([answered[k] for k in shared]), np.array([truth[k] for k in shared]))
    return float(np.rad2deg(np.abs(apart).mean()))


PARTS = 2
"""Number of folds of people."""
RATE = 2.5
"""Frames a second of the recording."""
_MATCH = 1.0
"""Metres on the ground within which an estimate matches a true person."""
_WALKING = 0.5
"""Metres a second."""
_BAND = 1.96


def observed_by_other_people(
    folder: Path, seed: int, progress: Progress
) -> tuple[TrackSet, GroundCamera, float]:
    """Observe Town Centre's first minute with models fitted to other people.

    Walking people are divided into folds; each is observed with models fitted to the rest. Also returns the
    mean of the graph's ``class_outlier_probability`` of these models.
    """
    camera = read_calibration(folder / "calibration.ci")
    frames = FrameSource.open(folder / "frames_001_150" / "img1")
    people = read_boxes(folder / "frames_001_150" / "det.txt")
    appearance, usable = descriptors_of_people(frames, people, ignored)
    found = patches_in(frames, people, ignored)
    labels = walking_labels(people, appearance, camera, RATE)
    rng = np.random.default_rng(seed)
    fold = folds_of(labels.person, rng, PARTS)
    part_of = np.zeros(len(people), np.int64)
    part_of[labels.box] = fold
    seconds = len(frames.numbers()) / RATE
    package = PackageModels.load()
    people_observed: list[PersonObservation] = []
    shares: list[float] = []
    for part in range(PARTS):
        rest = thinned(labels.taken(np.flatnonzero(fold != part)))
        patches = [found[k] for k in rest.box.tolist()]
        models = learn(patches, rest, seconds, frames.size(), package, rng)
        rows = [k for k in np.flatnonzero(usable & (part_of == part)).tolist() if k in found]
        answered = models.look_at([found[k] for k in rows], [people[k].box for k in rows])
        for k, one in zip(rows, answered, strict=True):
            item = people[k]
            people_observed.append(
                PersonObservation(
                    item.frame, item.track_id, item.box, *one, score=item.score, appearance=appearance[k]
                )
            )
        shares.append(models.class_outlier_probability or 0.0)
        progress(1)
    table = to_detections(by_frame(people_observed), CameraModels.classes.pans, camera, RATE)
    return associated(table.columns, table.number, people), camera, float(np.mean(shares))


def methods_table(folder: Path, seed: int, progress: Progress) -> Table:
    """Evaluate position, body and head of walking people, and identities, by every method of the report."""
    tracks, camera, share = observed_by_other_people(folder, seed, progress)
    truth = read_identified(folder / "frames_001_150" / "gt.txt", camera=camera, fps=RATE)
    reference = _travel(truth)
    rows = []
    for method in METHODS:
        for news in (None, share):
            graph = (lambda model: model) if news is None else partial(with_outliers, share=news)
            found = estimated(tracks, camera, method, ignored, graph).tracks
            known = score(found, truth, metres=_MATCH).together
            rows.append(
                {
                    "method": method,
                    "outliers": "as packaged" if news is None else f"{news:.2f}, learned",
                    **_method_errors(found, reference),
                    "IDF1": known.idf1,
                    "MOTA": known.mota,
                }
            )
        progress(1)
    return Table.of("Town Centre's first minute by every method, models of other people", rows)


TRAVEL = np.dtype([("x", float), ("y", float), ("direction", float), ("speed", float)])
"""True position of a person, m, direction of travel, rad, and speed, m/s."""
Reference = dict[int, NDArray[np.void]]
"""By frame, (n,) of `TRAVEL`."""


def _travel(truth: TrackSet) -> Reference:
    """Return true positions, directions of travel and speeds of people labelled in at least four frames."""
    long = truth.with_tracks(replace(track, body=None, head=None) for track in truth if len(track) >= 4)
    found: dict[int, list[tuple[float, ...]]] = {}
    for track in smooth(long, "position", trust="declared"):
        assert track.velocity is not None
        speed, way = np.linalg.norm(track.velocity, axis=1), direction(track.velocity)
        for k, frame in enumerate(track.frame.tolist()):
            found.setdefault(frame, []).append((*track.position[k], way[k], speed[k]))
    return {frame: np.array(rows, TRAVEL) for frame, rows in found.items()}


def _method_errors(found: TrackSet, reference: Reference) -> dict[str, Cell]:
    of_frame: dict[int, list[tuple[Track, int]]] = {}
    for track in found:
        for k, frame in enumerate(track.frame.tolist()):
            of_frame.setdefault(frame, []).append((track, k))
    away: list[float] = []
    errors: dict[str, list[float]] = {"body": [], "head": []}
    inside: dict[str, list[bool]] = {"body": [], "head": []}
    for frame, rows in of_frame.items():
        if frame not in reference:
            continue
        x, y, ways, speeds = (reference[frame][name] for name in TRAVEL.names or ())
        positions = np.column_stack([x, y])
        apart = np.linalg.norm(
            np.array([track.position[k] for track, k in rows])[:, None] - positions, axis=2
        )
        for i, j in zip(*linear_sum_assignment(np.minimum(apart, 2.0 * _MATCH)), strict=True):
            if apart[i, j] > _MATCH or speeds[j] < _WALKING:
                continue
            track, k = rows[i]
            away.append(float(apart[i, j]))
            for name, angle in (("body", track.body), ("head", track.head)):
                if angle is None or not np.isfinite(angle[k]):
                    continue
                error = float(np.abs(difference(angle[k], ways[j])))
                errors[name].append(error)
                std = track.std(name)
                if np.isfinite(std[k]):
                    inside[name].append(error <= _BAND * std[k])
    row: dict[str, Cell] = {"rows": len(away), "position (m)": float(np.median(away))}
    for name, values in errors.items():
        row[f"{name} (°)"] = float(np.rad2deg(np.mean(values))) if values else None
        row[f"{name} within 95 %"] = 100.0 * float(np.mean(inside[name])) if inside[name] else None
    return row
