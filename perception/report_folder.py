"""Folder of a report: its stages, annotated video, view from above and page."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray
from graphtrack.geometry.camera import GroundCamera
from graphtrack.io.atomic import atomic_path, check_place
from graphtrack.report.background import Backdrop
from graphtrack.report.content import Note, Picture, Section
from graphtrack.report.figures import figures_of_people, write_figures
from graphtrack.report.html import write_html
from graphtrack.report.interaction import behaviour_found
from graphtrack.report.methods import methods_section
from graphtrack.report.page import tracking_report
from graphtrack.report.plots.scene import plot_tracks
from graphtrack.tracks.track import Track, TrackSet
from graphtrack.viewer.pictures import PersonBoxes
from perception.detection.boxes import PersonBox
from perception.drawing.overlays import DirectionEstimate
from perception.drawing.people import DrawnPerson, draw_people
from perception.images.encoding import pictures
from perception.images.frames import Clock, Frame, FrameSource
from perception.images.pixels import as_uint8
from perception.observation.tables import BOX
from perception.storage import key_of

STAGES = "stages.json"
"""Completed stages and their messages."""
RECORDING = "recording.mkv"
"""Recording of a live source."""
FIGURES = "figures"
"""Folder of figures, if they are asked for."""
TRACKS = "tracks.csv"
"""Estimates; `graphtrack.read` of the folder reads them."""

FILES = {
    "boxes": "boxes.txt",
    "keypoints": "keypoints.json",
    "calibration": "calibration.ci",
    "models": "camera.npz",
    "observations": "observations.csv",
    "tracks": TRACKS,
    "methods": "methods.txt",
    "video": "annotated.mp4",
    "above": "above.png",
    "page": "report.html",
    "assumptions": "assumptions.txt",
}


@dataclass
class ReportFolder:
    """Folder of stages, which run in order and once each.

    Attributes
    ----------
    path : the folder
    emit : receives a message on each stage that begins or is already complete
    count : number of stages
    """

    path: Path
    count: int
    emit: Callable[[str], object]
    _done: dict[str, dict[str, Any]] = field(default_factory=dict)
    _key: str = ""
    _number: int = 0

    def file(self, name: str) -> Path:
        """Path of one of `FILES`."""
        return self.path / FILES[name]

    def open(self) -> None:
        """Create the folder, or read its completed stages.

        Raises
        ------
        InputError
            If it cannot be created, or has other contents.
        """
        check_folder(self.path)
        self.path.mkdir(exist_ok=True)
        stages = self.path / STAGES
        if not stages.is_file():
            self._save()  # marks the folder as a report
            return
        try:
            known = json.loads(stages.read_text("utf-8"))
            self._done = {
                str(name): {"key": str(s["key"]), "said": list(s["said"])} for name, s in known.items()
            }
        except (ValueError, TypeError, KeyError, AttributeError) as error:
            raise InputError("something else", "what `perception report` wrote", path=stages) from error

    def stage(
        self, name: str, asked: object, outputs: Sequence[str], work: Callable[[str], Sequence[str]]
    ) -> list[str]:
        """Run a stage, unless it is complete with the same inputs.

        Parameters
        ----------
        name : description
        asked : all that its outputs depend on, in addition to the stages before it
        outputs : names of `FILES` that it writes
        work : runs it, given a key of its dependencies; returns its messages

        Returns
        -------
        list of str
            Its messages.
        """
        self._number += 1
        self._key = key_of(self._key, name, asked)
        known = self._done.get(name)
        label = f"[{self._number}/{self.count}] {name}"
        if known is not None and known["key"] == self._key and all(self.file(o).is_file() for o in outputs):
            self.emit(f"{label}: done before")
            return list(known["said"])
        self.emit(label)
        lines = list(work(self._key))
        self._done[name] = {"key": self._key, "said": lines}
        self._save()
        return lines

    def _save(self) -> None:
        with atomic_path(self.path / STAGES) as temporary:
            temporary.write_text(json.dumps(self._done, indent=1) + "\n", encoding="utf-8")


def check_folder(path: Path) -> None:
    """Refuse a path that exists and is no folder of a report.

    Raises
    ------
    InputError
        As `check_place` does.
    """
    if not (path / STAGES).is_file():
        check_place(path, directory=True)


_TRAIL = 4.0  # seconds of a drawn path


class ShownPeople(Mapping[int, list[DrawnPerson]]):
    """People to draw in each frame, created on access: only columns are kept in memory."""

    def __init__(self, tracks: Sequence[_Shown]) -> None:
        self._tracks = tracks
        shown = [np.zeros((3, 0), np.int64)]
        for k, one in enumerate(tracks):
            rows = np.flatnonzero(np.isfinite(one.place).all(axis=1))
            shown.append(np.stack([one.track.frame[rows], np.full(len(rows), k), rows]))
        every = np.concatenate(shown, axis=1)
        self._frame, self._number, self._row = every[:, np.argsort(every[0], kind="stable")]

    def __getitem__(self, frame: int) -> list[DrawnPerson]:
        inside = slice(*np.searchsorted(self._frame, (frame, frame + 1)).tolist())
        people = zip(self._number[inside].tolist(), self._row[inside].tolist(), strict=True)
        if found := [self._tracks[number].person(row) for number, row in people]:
            return found
        raise KeyError(frame)

    def __iter__(self) -> Iterator[int]:
        return iter(np.unique(self._frame).tolist())

    def __len__(self) -> int:
        return len(np.unique(self._frame))


@dataclass(frozen=True, eq=False)
class _Shown:
    """A track of n rows in the picture."""

    track: Track
    place: FloatArray  # (n, 4) boxes
    visible: NDArray[np.bool_]
    angles: FloatArray  # (n, 4) of body and head, each with its standard deviation
    pixel: FloatArray  # (n, 2) of the feet
    first: NDArray[np.int64]  # (n,) first row of the drawn path, for each row

    def person(self, row: int) -> DrawnPerson:
        """Return the person in a row."""
        body, head = (
            DirectionEstimate(angle, std) if np.isfinite(angle) else None
            for angle, std in self.angles[row].reshape(2, 2).tolist()
        )
        return DrawnPerson(
            self.track.track_id,
            self.place[row],
            self.track.position[row],
            body,
            head,
            visible=bool(self.visible[row]),
            path=self.pixel[self.first[row] : row + 1],
        )


def shown_by_frame(
    estimates: TrackSet,
    observations: TrackSet,
    boxes: Sequence[PersonBox],
    camera: GroundCamera,
) -> ShownPeople:
    """People to draw in each frame.

    Parameters
    ----------
    estimates, observations : matched by ``track_id``; the latter from `numbered` or `associated`
    boxes : the observed boxes
    """
    observed = {track.track_id: track for track in observations}
    found = []
    for track in estimates:
        place, visible = _boxes_of(track, observed[track.track_id], boxes, camera)
        angles = np.column_stack([*_angle(track, "body"), *_angle(track, "head")])
        first = np.searchsorted(track.t, track.t - _TRAIL)
        pixel = camera.ground_to_image(track.position)
        found.append(_Shown(track, place, visible, angles, pixel, first))
    return ShownPeople(found)


def boxes_shown(people: Mapping[int, Sequence[DrawnPerson]]) -> PersonBoxes:
    """Return the boxes of the people of `shown_by_frame`."""
    shown = [(frame, person.track_id, person.box) for frame, some in people.items() for person in some]
    frame, number, box = zip(*shown, strict=True) if shown else ((), (), ())
    return PersonBoxes(
        np.array(frame, np.int64), np.array(number, np.int64), np.array(box, float).reshape(-1, 4)
    )


def _angle(track: Track, name: Literal["body", "head"]) -> tuple[FloatArray, FloatArray]:
    unknown = np.full(len(track), np.nan)
    angle, std = getattr(track, name), track.std(name)
    return unknown if angle is None else angle, std


def _boxes_of(
    track: Track, observation: Track, boxes: Sequence[PersonBox], camera: GroundCamera
) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Return boxes (n, 4) of an estimate, interpolated where not observed, and the mask (n,) of observed."""
    number = observation.inputs[BOX].reshape(-1)
    known = np.flatnonzero(np.isfinite(number))
    at = {int(observation.frame[k]): boxes[int(number[k])].box for k in known.tolist()}
    visible = np.array([frame in at for frame in track.frame.tolist()])
    found = np.full((len(track), 4), np.nan)
    if not visible.any():
        return found, visible
    found[visible] = [at[frame] for frame in track.frame[visible].tolist()]
    for side in (2, 3):
        found[~visible, side] = np.interp(track.t[~visible], track.t[visible], found[visible, side])
    feet = camera.ground_to_image(track.position[~visible])
    found[~visible, 0], found[~visible, 1] = (
        feet[:, 0] - found[~visible, 2] / 2.0,
        feet[:, 1] - found[~visible, 3],
    )
    return found, visible


_PHOTOS, _PHOTO_WIDTH, _QUALITY = 6, 1100, 85


def write_video(
    path: Path,
    frames: Iterable[Frame],
    people: Mapping[int, Sequence[DrawnPerson]],
    camera: GroundCamera,
    clock: Clock,
) -> int:
    """Write the annotated frames, one in memory at a time; return their number."""
    count = 0
    with pictures(path, clock.rate) as write:
        for frame in frames:
            if frame.image is not None:
                words = f"frame {frame.number}  {clock.seconds(frame.number):.2f} s"
                write(frame.number, draw_people(frame.image, words, people.get(frame.number, ()), camera))
                count += 1
    return count


def background_of(frames: FrameSource, camera: GroundCamera) -> Backdrop | None:
    """Return the first frame that can be read, as an image on the ground; None without one."""
    for frame in frames.where(lambda number: True):
        if frame.image is not None:
            return Backdrop(np.ascontiguousarray(as_uint8(frame.image)[..., ::-1]), camera)
    return None


def write_above(
    path: Path, title: str, estimates: TrackSet, observations: TrackSet, background: Backdrop | None
) -> None:
    """Write an image of all paths from above, with the people's ids."""
    figure = plot_tracks(estimates, observations, title=title, background=background)
    with atomic_path(path) as temporary:
        figure.savefig(temporary, format="png", dpi=160)


def write_page(
    path: Path,
    title: str,
    estimates: TrackSet,
    observations: TrackSet,
    video: Path,
    assumptions: Sequence[str],
    *,
    methods: Sequence[str],
    background: Backdrop | None = None,
    figures: Path | None = None,
) -> None:
    """Write the page, with some frames of the annotated video in it."""
    photos = tuple(
        Picture(f"Frame {k + 1} of {count} that were drawn", data, _DESCRIPTION)
        for k, count, data in _photos(video)
    )
    words = Note(f"All frames are in {video.name}. {_DESCRIPTION}")
    report = tracking_report(
        estimates,
        observations,
        title=title,
        background=background,
        behaviour=behaviour_found(estimates),
        sections=(
            Section("Frames", (words, *photos)),
            Section("What was assumed", tuple(Note(line) for line in assumptions)),
            methods_section(methods),
        ),
    )
    if figures is not None:
        write_figures(figures, report, figures_of_people(estimates, observations))
    write_html(path, report)


_DESCRIPTION = (
    "Boxes and ids in each person's colour, dashed for estimates without an observation; on the "
    "ground the path of the last seconds, an arrow along the body and its 95 % sector; at "
    "the head the same for the head, in a lighter colour."
)


def _photos(video: Path) -> list[tuple[int, int, bytes]]:
    """Return evenly chosen frames of a video as JPEG, with their numbers from 0, and the number of all."""
    frames = FrameSource.open(video)
    wanted = np.linspace(0, frames.count - 1, min(_PHOTOS, frames.count)).round().astype(int).tolist()
    found = []
    for frame in frames.where(wanted.__contains__):
        if frame.image is not None:
            factor = min(1.0, _PHOTO_WIDTH / frame.image.shape[1])
            small = cv2.resize(frame.image, None, fx=factor, fy=factor, interpolation=cv2.INTER_AREA)
            _, data = cv2.imencode(".jpg", small, [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])
            found.append((frame.number, frames.count, np.asarray(data, np.uint8).tobytes()))
    return found
