"""CAVIAR's lobby adapted to itself: learned on some sequences of the view, judged on another one.

The camera looks down, so that people lean in the picture; `perception.ground.upright` turns them upright.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from graphtrack.errors import InputError
from graphtrack.evaluation.reproduce.experiment import Cell, Progress, Table, quietly
from graphtrack.geometry.angles import difference
from graphtrack.io.readers.caviar import FPS, lobby_camera
from perception.adaptation.adapting import Recording, adapted
from perception.adaptation.labels import walking_labels
from perception.adaptation.learning import PackageModels
from perception.adaptation.models import CameraModels
from perception.adaptation.teaching import CLASSES
from perception.detection.boxes import read_boxes
from perception.ground.upright import LeaningView
from perception.images.frames import FrameSource
from perception.models import HEAD_POSE, load_classifier, load_head_localiser
from perception.observe.estimates import estimated
from perception.observe.identified import to_tracks
from perception.observe.pipeline import Models, observe_frame
from perception.observe.seen import SeenPerson, by_frame


@dataclass(frozen=True, eq=False)
class LobbySequence:
    """A sequence of the lobby.

    Attributes
    ----------
    name : of the sequence
    recording : frames and labelled boxes
    gaze : by frame and person the labelled one, radians in the image frame
    """

    name: str
    recording: Recording
    gaze: dict[tuple[int, int], float]


def sequences_of(folder: Path) -> list[LobbySequence]:
    """The lobby's sequences of a CAVIAR folder, as far as their frames are there.

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


def _silent(count: int, unit: str = "") -> AbstractContextManager[Callable[[int], None]]:
    """Tells nobody how far it came."""
    return nullcontext(lambda done: None)


def adapted_table(sequences: list[LobbySequence], seed: int, progress: Progress) -> Table:
    """Errors in each sequence by what the others taught."""
    package = PackageModels(
        load_head_localiser(), load_classifier("body_pose"), load_classifier(HEAD_POSE[0])
    )
    rows = []
    for one in sequences:
        others = [other.recording for other in sequences if other is not one]
        rng = np.random.default_rng(seed)
        found = adapted(others, lobby_camera(), package, rng, _silent, lambda reason: None)
        rows.append(_sequence_errors(found.models, package, one, found.people))
        progress(1)
    return Table.of("CAVIAR's lobby, adapted on the other sequences: mean error in degrees (chance 90)", rows)


def _sequence_errors(
    models: CameraModels, package: PackageModels, sequence: LobbySequence, taught_by: int
) -> dict[str, Cell]:
    camera, recording = lobby_camera(), sequence.recording
    people = recording.people
    view = LeaningView.of(camera, recording.frames.size())
    labels = walking_labels(people, None, camera, recording.rate, view=view)
    walking = {
        (people[k].frame, people[k].track_id): angle
        for k, angle in zip(labels.box.tolist(), labels.angle.tolist(), strict=True)
    }
    wanted = walking.keys() | sequence.gaze.keys()
    parts = package.head_localiser, package.body_pose, package.head_pose
    said = {}
    for name, of_camera in (("taught", models), ("package", None)):
        looking = Models(*parts, of_camera=of_camera).seeing(camera, recording.frames.size)
        body, head, everybody = {}, {}, []
        for frame in recording.frames:
            of_frame = [item for item in people if (item.frame, item.track_id) in wanted]
            of_frame = [item for item in of_frame if item.frame == frame.number]
            if frame.image is None or not of_frame:
                continue
            for seen in observe_frame(frame.image, frame.number, of_frame, looking, lambda reason: None):
                key = seen.frame, seen.track_id
                everybody += [seen] if key in walking else []
                body[key] = float(CLASSES.mean_pan(seen.body[None])[0])
                head[key] = float(looking.head_classes.mean_pan(seen.pan[:1])[0])
        said[name] = body, head
        if of_camera is not None:
            smoothed = _smoothed(everybody, of_camera, recording.rate)
    body, head = said["taught"]
    return {
        "judged on": sequence.name,
        "learned from (people)": taught_by,
        "walking (people)": len(np.unique(labels.person)),
        "boxes": len(walking),
        "body, walking": _error(body, walking),
        "body, smoothed": _error(smoothed, walking),
        "head, walking": _error(head, walking),
        "head against gaze": _error(head, sequence.gaze),
        "travel against gaze": _error(walking, sequence.gaze),
        "gazes": len(sequence.gaze),
        "the package's body, walking": _error(said["package"][0], walking),
        "in learning: body of people left out": models.card.figures["body_error_deg"],
    }


def _smoothed(seen: list[SeenPerson], models: CameraModels, rate: float) -> dict[tuple[int, int], float]:
    """The body as the graph has it, which knows how people move besides, radians in the image frame."""
    camera = lobby_camera()
    tracks = to_tracks(by_frame(seen), CLASSES.pans, camera, rate).tracks
    found: dict[tuple[int, int], float] = {}
    for track in estimated(tracks, camera, "smoother", lambda count: None, models.graph)[0]:
        if track.body is None:
            continue
        angles = camera.image_angle(track.body, track.position)
        found |= dict(
            zip(((frame, track.track_id) for frame in track.frame.tolist()), angles.tolist(), strict=True)
        )
    return found


def _error(said: dict[tuple[int, int], float], truth: dict[tuple[int, int], float]) -> float | None:
    """Mean of what is said where the truth is known, degrees."""
    shared = sorted(said.keys() & truth.keys())
    if not shared:
        return None
    apart = difference(np.array([said[k] for k in shared]), np.array([truth[k] for k in shared]))
    return float(np.rad2deg(np.abs(apart).mean()))
