"""CAVIAR's lobby adapted to itself: learned on some sequences of the view, judged on another one.

The camera looks down: people stand in the picture as spokes about the point below it, and what is learned
from people who stand upright sees nothing there. So each is turned upright first, by the camera.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from graphtrack.errors import InputError
from graphtrack.evaluation.reproduce.experiment import Cell, Progress, Table, quietly
from graphtrack.geometry.angles import FloatArray, difference
from graphtrack.geometry.camera import GroundCamera
from graphtrack.io.readers.caviar import FPS, LOBBY_HEIGHT, lobby_camera
from perception.adaptation.labels import WalkingLabels, walking_labels
from perception.adaptation.learning import AdaptationParameters, PackageModels, learn, thinned
from perception.adaptation.models import CameraModels
from perception.adaptation.patches import patch_of
from perception.adaptation.teaching import CLASSES
from perception.detection.boxes import PersonBox
from perception.images.frames import FrameSource
from perception.images.pixels import Image
from perception.models import HEAD_POSE, load_classifier, load_head_localiser

_PERSON = 1.75
"""Metres from the floor to above the head."""
_WIDTH = 0.41
"""Of a box, in its heights."""
_SHORTEST = 0.6
"""Length of a person in the picture, in what 1.75 m of the floor measure there: from above, people are not
short but wide."""


@dataclass(frozen=True, eq=False)
class Sequence:
    """People of one sequence, each turned upright.

    Attributes
    ----------
    name : of the sequence
    people : their upright boxes
    pictures : of each the frame, turned
    gaze : (n,) labelled, radians in the image frame; NaN: not labelled
    labels : of those who surely walk
    """

    name: str
    people: list[PersonBox]
    pictures: list[Image]
    gaze: FloatArray
    labels: WalkingLabels


def upright(image: Image, foot: FloatArray, camera: GroundCamera, height: float) -> tuple[Image, FloatArray]:
    """An image turned about a foot point (2,) so that who stands there is upright, and their box (4,).

    Parameters
    ----------
    camera : whose centre is above the origin of the ground
    height : metres of the camera above the ground
    """
    ground = camera.image_to_ground(foot)
    head = camera.ground_to_image(ground * height / (height - _PERSON))
    up = head - foot
    beside = camera.ground_to_image(ground + _PERSON * np.array([[0.5, 0.0], [-0.5, 0.0]]))
    length = max(float(np.linalg.norm(up)), _SHORTEST * float(np.linalg.norm(beside[0] - beside[1])))
    turn = float(np.degrees(np.arctan2(up[0], -up[1])))
    turned = cv2.getRotationMatrix2D((float(foot[0]), float(foot[1])), turn, 1.0)
    size = (image.shape[1], image.shape[0])
    shown = cv2.warpAffine(image, turned, size, flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    box = np.array([foot[0] - _WIDTH * length / 2.0, foot[1] - length, _WIDTH * length, length])
    return np.asarray(shown, np.uint8), box


def sequences_of(folder: Path) -> list[Sequence]:
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


def _sequence(path: Path, frames: Path) -> Sequence:
    camera = lobby_camera()
    of_frame: dict[int, list[tuple[int, FloatArray, float]]] = {}
    for track in quietly(path):
        assert track.pixel is not None
        head = np.full(len(track), np.nan) if track.head is None else np.asarray(track.head)
        gaze = camera.image_angle(head, track.position)
        for k, frame in enumerate(track.frame.tolist()):
            of_frame.setdefault(frame, []).append((track.track_id, track.pixel[k], float(gaze[k])))
    people, pictures, looks = [], [], []
    for picture in FrameSource.open(frames).where(of_frame.__contains__):
        if picture.image is None:
            continue
        for person, foot, angle in of_frame[picture.number]:
            if not np.isfinite(foot).all():
                continue
            shown, box = upright(picture.image, foot, camera, LOBBY_HEIGHT)
            left, top, width, height = (float(value) for value in box)
            people.append(PersonBox(picture.number, person, (left, top, width, height)))
            pictures.append(shown)
            looks.append(angle)
    return Sequence(path.stem, people, pictures, np.array(looks), walking_labels(people, None, camera, FPS))


def _joined(sequences: list[Sequence]) -> tuple[list[Image], WalkingLabels]:
    """Patches and labels of those who surely walk in several sequences."""
    patches: list[Image] = []
    parts = []
    for k, one in enumerate(sequences):
        labels = one.labels
        patches += [patch_of(one.pictures[j], one.people[j].box) for j in labels.box.tolist()]
        parts.append(1000 * k + labels.person)
    n = len(patches)
    return patches, WalkingLabels(
        np.arange(n),
        np.concatenate(parts),
        np.concatenate([one.labels.angle for one in sequences]),
        np.concatenate([one.labels.std for one in sequences]),
        sum(one.labels.tracks for one in sequences),
    )


def adapted_table(sequences: list[Sequence], seed: int, progress: Progress) -> Table:
    """Errors in each sequence by what the others taught."""
    package = PackageModels(
        load_head_localiser(), load_classifier("body_pose"), load_classifier(HEAD_POSE[0])
    )
    parameters, rows = AdaptationParameters(), []
    for one in sequences:
        patches, labels = _joined([other for other in sequences if other is not one])
        labels = thinned(labels, parameters)
        chosen = [patches[k] for k in labels.box.tolist()]
        seconds = sum(len({item.frame for item in other.people}) for other in sequences) / FPS
        size = (one.pictures[0].shape[1], one.pictures[0].shape[0])
        models = learn(chosen, labels, seconds, size, package, np.random.default_rng(seed), parameters)
        rows.append(_judged(models, one, len(np.unique(labels.person))))
        progress(1)
    return Table.of("CAVIAR's lobby, adapted on the other sequences: mean error in degrees (chance 90)", rows)


def _judged(models: CameraModels, sequence: Sequence, taught_by: int) -> dict[str, Cell]:
    labels = sequence.labels
    walking = dict(zip(labels.box.tolist(), labels.angle.tolist(), strict=True))
    wanted = sorted(set(walking) | set(np.flatnonzero(np.isfinite(sequence.gaze)).tolist()))
    body, head = {}, {}
    for k in wanted:
        ((of_body, _, of_heads),) = models.look(sequence.pictures[k], [sequence.people[k].box])
        body[k] = float(CLASSES.mean_pan(of_body[None])[0])
        head[k] = float(CLASSES.mean_pan(of_heads[:1])[0])
    gazes = {k: float(sequence.gaze[k]) for k in wanted if np.isfinite(sequence.gaze[k])}
    figures = models.card.figures
    return {
        "judged on": sequence.name,
        "learned from (people)": taught_by,
        "walking (people)": len(np.unique(labels.person)),
        "boxes": len(walking),
        "body, walking": _error(body, walking),
        "head, walking": _error(head, walking),
        "head against gaze": _error(head, gazes),
        "travel against gaze": _error(walking, gazes),
        "gazes": len(gazes),
        "in learning: body of people left out": figures["body_error_deg"],
        "in learning: the package's body": figures["body_error_deg_package"],
    }


def _error(said: dict[int, float], truth: dict[int, float]) -> float | None:
    """Mean of what is said where the truth is known, degrees."""
    shared = sorted(said.keys() & truth.keys())
    if not shared:
        return None
    apart = difference(np.array([said[k] for k in shared]), np.array([truth[k] for k in shared]))
    return float(np.rad2deg(np.abs(apart).mean()))
