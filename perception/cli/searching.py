"""Detection of people and keypoints in a recording, with progress, journals and the user's own networks."""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack, contextmanager, nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import typer

from graphtrack.cli import options
from graphtrack.cli.console import option_name
from graphtrack.errors import InputError
from graphtrack.tracks.display import counted
from perception.cli.options import PRINTED, Reports, in_time, stamp_of, stamp_of_camera
from perception.storage import key_of

if TYPE_CHECKING:
    from graphtrack.geometry.camera import GroundCamera
    from perception.detection.boxes import FrameDetections, PersonBox
    from perception.detection.ground_search import Candidates, GroundSearch
    from perception.detection.rescoring import PersonProbability
    from perception.detection.top_down import PoseOfBox
    from perception.detection.yolo import YoloNetwork
    from perception.images.frames import Clock, Frame, FrameSource
    from perception.images.live import LiveFrames
    from perception.images.pixels import Image
    from perception.observation.journal import FrameJournal
    from perception.observation.pipeline import FrameObservation, Models


@dataclass(frozen=True, eq=False)
class OwnNetworks:
    """Networks and keypoints given by options.

    Attributes
    ----------
    detector : detects boxes; None: the package's detector
    pose : detects people with keypoints, or keypoints in the boxes of people; None: none, or they are known
    known : keypoints by frame, from files; None: no files
    asked : all settings that the results depend on, except files with keypoints
    """

    detector: YoloNetwork | None
    pose: YoloNetwork | PoseOfBox | None
    known: Mapping[int, FrameDetections] | None
    asked: tuple[object, ...]

    @property
    def has_keypoints(self) -> bool:
        """Return True if body and head are estimated from keypoints."""
        return self.pose is not None or self.known is not None

    @property
    def makes_boxes(self) -> bool:
        """Return True if missing boxes are derived from keypoints."""
        return self.has_keypoints and self.detector is None and not self.needs_boxes

    @property
    def needs_boxes(self) -> bool:
        """Return True if keypoints are detected in boxes."""
        from perception.detection.top_down import PoseOfBox

        return isinstance(self.pose, PoseOfBox)

    def look(self, frame: int, image: Image, people: Sequence[PersonBox]) -> FrameDetections:
        """Return the people of a frame with keypoints, in the boxes of ``people`` if these are needed."""
        from perception.detection.boxes import FrameDetections
        from perception.detection.top_down import PoseOfBox

        if isinstance(self.pose, PoseOfBox):
            return self.pose.detect(image, [item.box for item in people])
        if self.pose is not None:
            return self.pose.detect(image)
        assert self.known is not None
        return self.known.get(frame) or FrameDetections(np.empty((0, 4)), np.empty(0))

    def notes(self) -> list[str]:
        """Return sentences on networks whose scores cannot be right."""
        networks = [network for network in (self.detector, self.pose) if network is not None]
        return [line for network in networks for line in network.checked.notes()]


@dataclass(frozen=True)
class NetworkOptions:
    """Options of the user's own networks and keypoints.

    Networks and keypoints of your own
    ----------------------------------
    detector : A YOLO network of your own (.onnx), in place of the package's.
    keypoints : A YOLO-pose or RTMPose network (.onnx), the word mediapipe for that package, or keypoints of
        COCO, OpenPose, MMPose or MediaPipe (.json, or a folder with one file per frame): they give body and
        head, and boxes if there are none.
    person_class : Name or number of the network's class of people, if not person.
    input_size : Size of the network's input, such as 640 or 1280x736, if its file leaves it open.
    least_score : Least score of detections by networks (default 0.25).
    """

    detector: options.InputFile | None = None
    keypoints: Annotated[Path | None, typer.Option(metavar="FILE|FOLDER|mediapipe")] = None
    person_class: str | None = None
    input_size: str | None = None
    least_score: Annotated[float | None, typer.Option(min=0.0, max=1.0)] = None

    @property
    def files(self) -> dict[str, Path | list[Path] | None]:
        """Return the files to read, by option name."""
        points: Path | list[Path] | None = None if self.is_mediapipe else self.keypoints
        if self.keypoints is not None and self.keypoints.is_dir():
            points = sorted(self.keypoints.glob("*.json"))
        elif isinstance(points, Path) and not points.exists():
            raise InputError("no such file", "an existing file or folder, or mediapipe", path=points)
        return {"--detector": self.detector, "--keypoints": points}

    @property
    def is_mediapipe(self) -> bool:
        """Return True if keypoints are those of the package mediapipe."""
        from perception.detection.top_down import MEDIAPIPE

        return self.keypoints == MEDIAPIPE and not MEDIAPIPE.exists()

    @property
    def reads_keypoints(self) -> bool:
        """Return True if keypoints are those of files, and not detected."""
        points = self.keypoints
        return points is not None and not self.is_mediapipe and points.suffix.lower() != ".onnx"

    def load(self, frames: FrameSource | LiveFrames) -> OwnNetworks:
        """Load the networks and keypoints."""
        from perception.detection.keypoint_files import read_keypoints
        from perception.detection.onnx_network import OnnxNetwork
        from perception.detection.top_down import MediaPipePose, SimccNetwork
        from perception.detection.yolo import YoloNetwork

        points = self.keypoints
        pose_file = None if points is None or self.is_mediapipe or self.reads_keypoints else points
        for name in ("person_class", "input_size", "least_score"):
            if getattr(self, name) is not None and self.detector is None and pose_file is None:
                expected = "--detector, or --keypoints with a network (.onnx)"
                raise InputError(f"{option_name(name)} without a network", expected)
        settings: dict[str, Any] = {"size": self._size(), "person": self.person_class}
        if self.least_score is not None:
            settings["least"] = self.least_score

        known = detector = None
        pose: YoloNetwork | PoseOfBox | None = None
        if points is not None and self.reads_keypoints:
            known = read_keypoints(points, frames.frame_of, size=frames.size, first=frames.first)
        elif pose_file is not None:
            opened = OnnxNetwork(pose_file)
            if SimccNetwork.fits(opened):
                if self.detector is None:
                    unused = {"--person-class": self.person_class, "--least-score": self.least_score}
                    options.refuse(unused, "with a network of keypoints in boxes", "--detector with it")
                pose = SimccNetwork(opened, None if self.detector else self._size())
            else:
                pose = YoloNetwork(opened, pose=True, **settings)
        elif points is not None:
            pose = MediaPipePose()
        if self.detector is not None:
            detector = YoloNetwork(self.detector, **settings)
        asked = (
            stamp_of(self.detector),
            stamp_of(pose_file),
            settings,
            str(points) if pose else points is not None,
        )
        return OwnNetworks(detector, pose, known, asked)

    def _size(self) -> tuple[int, int] | None:
        if self.input_size is None:
            return None
        sides = re.fullmatch(r"(\d{2,4})(?:[x×](\d{2,4}))?", self.input_size)
        if sides is None:
            expected = "columns, or columns x rows, such as 1280x736"
            raise InputError(f"--input-size {self.input_size}", expected)
        return int(sides[1]), int(sides[2] or sides[1])


Refuse = Callable[[str], object]
"""Receives the reason why a frame or a box is skipped."""


def searched(
    frames: FrameSource,
    journal: FrameJournal[FrameDetections],
    detect: Callable[[int, Image], FrameDetections],
    refuse: Refuse,
    numbers: set[int] | None = None,
    *,
    unit: str = "frames searched",
    one_size: bool,
    reports: Reports,
) -> int:
    """Detect people in the frames missing from the journal, add them, and return the number of frames.

    Parameters
    ----------
    refuse : receives frames that cannot be decoded
    numbers : frames that may show people; None: all
    """
    known, count = frozenset(journal), 0

    def wanted(number: int) -> bool:
        return number not in known and (numbers is None or number in numbers)

    left = max((frames.count if numbers is None else len(numbers)) - len(known), 0)
    with frames.reported(wanted, left, reports.progress, unit=unit, one_size=one_size) as decoded:
        for frame in decoded:
            if frame.image is None:
                refuse(frame.reason)
            else:
                journal.add(frame.number, detect(frame.number, frame.image))
                count += 1
    return count


def report_progress(journal: FrameJournal[Any], reports: Reports) -> None:
    """Report the number of known frames, if there are any."""
    if journal:
        reports.emit(f"going on after {counted(len(journal), 'frame')}")


def find_keypoints(
    frames: FrameSource,
    networks: OwnNetworks,
    people: list[PersonBox] | None,
    journal: FrameJournal[FrameDetections],
    refuse: Refuse,
    *,
    one_size: bool,
    reports: Reports,
) -> list[PersonBox]:
    """Return the people with their keypoints; without known boxes, with boxes from the keypoints.

    ``refuse`` receives the number of people without keypoints. Frames in the journal are not processed again.
    """
    from perception.detection.boxes import boxes_by_frame, boxes_of, with_keypoints

    found = networks.known
    if found is None:
        start = time.perf_counter()
        report_progress(journal, reports)
        in_frame = boxes_by_frame(people or ())
        numbers = None if people is None else set(in_frame)

        def look(number: int, image: Image) -> FrameDetections:
            return networks.look(number, image, in_frame.get(number, ()))

        count = searched(
            frames,
            journal,
            look,
            refuse,
            numbers,
            unit="frames",
            one_size=one_size,
            reports=reports,
        )
        reports.emit(f"detected keypoints in {in_time(count, time.perf_counter() - start)}")
        found = journal
    if people is None:
        return boxes_of(found, refuse)
    pointed = with_keypoints(people, found)
    without = sum(item.keypoints is None for item in pointed)
    if without:
        refuse(f"{without} of {len(pointed)} boxes without keypoints: body and head may point anywhere there")
    return pointed


def look_at_people(
    frames: FrameSource,
    people: Iterable[PersonBox],
    models: Models,
    journal: FrameJournal[FrameObservation],
    refuse: Refuse,
    empty: frozenset[int] = frozenset(),
    *,
    one_size: bool = True,
    reports: Reports = PRINTED,
) -> int:
    """Observe all people in the frames missing from the journal, add them; return the number of frames.

    Parameters
    ----------
    empty : frames without people
    """
    from perception.observation import pipeline

    report_progress(journal, reports)
    known = frozenset(journal) | empty
    left = frames.count - len(known)
    with frames.reported(
        lambda number: number not in known, left, reports.progress, one_size=one_size
    ) as decoded:
        return pipeline.observe(decoded, people, models, journal, refuse=refuse)


def search_journals(output: Path) -> list[Path]:
    """Return the journals next to an output, which hold the progress of its search."""
    return [output.with_name(f"{output.name}.{name}") for name in ("detections", "adapted")]


def keypoints_journal(output: Path) -> Path:
    """Return the journal of keypoints next to an output."""
    return output.with_name(f"{output.name}.keypoints")


@dataclass(frozen=True, eq=False)
class PeopleSearch:
    """Search for people in a recording.

    Attributes
    ----------
    frames : the recording
    camera : view of the ground; None: people may have any size
    clock : times of the frames
    output : of the command; journals are written next to it
    asked : settings that the result depends on, in addition to frames, camera and clock
    causal : whether a detection depends on its frame alone, without background or learning
    one_size : whether frames of several sizes are refused, as with a camera
    detector : the user's own, for every frame; None: the package's
    reports : receives messages and progress
    """

    frames: FrameSource
    camera: GroundCamera | None
    clock: Clock
    output: Path
    asked: tuple[object, ...] = ()
    causal: bool = False
    one_size: bool = True
    detector: YoloNetwork | None = None
    reports: Reports = PRINTED

    @contextmanager
    def people(self, refuse: Refuse) -> Iterator[tuple[list[PersonBox], frozenset[int]]]:
        """Return detections of people, without identities, and the searched frames.

        If the run is interrupted within this context, the journals stay, and their frames are not searched
        again. ``refuse`` receives frames that cannot be decoded.
        """
        from perception.detection.boxes import FrameDetections, boxes_of
        from perception.detection.hog import PeopleDetector
        from perception.detection.rescoring import PersonProbability
        from perception.observation.journal import FrameJournal

        view = stamp_of_camera(self.camera)
        key = key_of(self.frames.stamp(), self.clock, self.causal, view, *self.asked)
        of_detections, of_adapted = search_journals(self.output)
        started, before = time.process_time(), time.perf_counter()
        with ExitStack() as journals:
            journal = journals.enter_context(FrameJournal(of_detections, key, FrameDetections))
            adapted = journals.enter_context(FrameJournal(of_adapted, key, PersonProbability))
            report_progress(journal, self.reports)
            count = len(journal)
            if self.detector is None and self.camera is not None:
                self._on_ground(self.camera, journal, adapted, refuse)
            else:
                detector = self.detector or PeopleDetector()

                def find(number: int, image: Image) -> FrameDetections:
                    return detector.detect(image)

                searched(self.frames, journal, find, refuse, one_size=self.one_size, reports=self.reports)
            count = len(journal) - count
            spent = (time.process_time() - started) / max(count, 1)
            self.reports.emit(
                f"searched for people in {in_time(count, time.perf_counter() - before)}, "
                f"{spent:.2f} s of processor time each"
            )
            yield boxes_of(journal), frozenset(journal)

    @contextmanager
    def with_keypoints(
        self, networks: OwnNetworks, given: list[PersonBox] | None, refuse: Refuse
    ) -> Iterator[tuple[list[PersonBox], frozenset[int]]]:
        """Return people, given or detected, with the keypoints of networks or files; and the searched frames.

        Without given boxes and a detector, boxes follow from keypoints. Journals are kept as by `people`.
        """
        from perception.detection.boxes import FrameDetections
        from perception.observation.journal import FrameJournal

        people, known = given, frozenset[int]()
        with ExitStack() as journals:
            if people is None and not networks.makes_boxes:
                people, known = journals.enter_context(self.people(refuse))
            if networks.has_keypoints:
                place = keypoints_journal(self.output)
                key = key_of(self.frames.stamp(), networks.asked, people if networks.needs_boxes else None)
                found = journals.enter_context(FrameJournal(place, key, FrameDetections))
                size, reports = self.one_size, self.reports
                people = find_keypoints(
                    self.frames, networks, people, found, refuse, one_size=size, reports=reports
                )
                known |= frozenset(found)
            assert people is not None
            if not people:
                for line in networks.notes():
                    self.reports.emit(f"  note: {line}")
            yield people, known

    def _on_ground(
        self,
        camera: GroundCamera,
        journal: FrameJournal[FrameDetections],
        known: FrameJournal[PersonProbability],
        refuse: Refuse,
    ) -> None:
        from perception.detection.background import Backgrounds, background_samples
        from perception.detection.rescoring import PersonProbability, learning_frames

        numbers, rate = self.frames.numbers(), self.clock.rate
        rest = set(numbers) - set(journal)
        samples = [] if self.causal or not rest else background_samples(numbers, rate)
        wanted = {number for part in samples for number in part}
        with self._some(wanted, "frames for the background") as decoded:
            backgrounds = Backgrounds.of(decoded, samples, numbers if rest else [])
        search: GroundSearch | None = None

        def searching(image: Image) -> GroundSearch:
            nonlocal search
            search = search or ground_search(camera, image)
            return search

        candidates: dict[int, Candidates] = {}
        probability = known.get(0)
        if probability is None and rest and not self.causal:
            with self._some(set(learning_frames(numbers, rate)), "frames to learn from") as decoded:
                for frame in decoded:
                    if frame.image is None:
                        refuse(frame.reason)
                    else:
                        background = backgrounds.at(frame.number)
                        candidates[frame.number] = searching(frame.image).candidates(frame.image, background)
            probability = self._adapted(camera, candidates)
        probability = probability or PersonProbability.of_package(foreground=bool(backgrounds.parts))
        if not known:
            known.add(0, probability)
        for number, of_frame in candidates.items():
            if number not in journal:
                journal.add(number, probability.detections(of_frame))

        def detect(number: int, image: Image) -> FrameDetections:
            return probability.detections(searching(image).candidates(image, backgrounds.at(number)))

        searched(self.frames, journal, detect, refuse, one_size=True, reports=self.reports)

    def _some(self, wanted: set[int], unit: str) -> AbstractContextManager[Iterator[Frame]]:
        """Decode some frames, with a progress bar; none if none are wanted."""
        if not wanted:
            return nullcontext(iter(()))
        progress = self.reports.progress
        return self.frames.reported(wanted.__contains__, len(wanted), progress, unit=unit, one_size=True)

    def _adapted(
        self, camera: GroundCamera, candidates: Mapping[int, Candidates]
    ) -> PersonProbability | None:
        from perception.detection.rescoring import adapt_to_recording

        found = adapt_to_recording(candidates, camera, self.clock, np.random.default_rng(0))
        if found is None:
            self.reports.emit(
                "  note: too few walking people: the detector is not adapted to this recording, and its "
                "scores are not calibrated for it"
            )
        else:
            self.reports.emit(
                f"adapted to {counted(found.boxes, 'detection')} of {found.people} walking people"
            )
        return found


def ground_search(camera: GroundCamera, image: np.ndarray) -> GroundSearch:
    """Return the search for images of this size; a calibration of another size is refused."""
    from perception.adaptation.labels import check_camera
    from perception.detection.ground_search import GroundSearch

    size = image.shape[1], image.shape[0]
    check_camera(camera, size)
    return GroundSearch(camera, size)
