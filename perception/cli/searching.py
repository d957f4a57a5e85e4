"""The search for people and keypoints in a recording, with progress, journals and a user's own networks."""

from __future__ import annotations

import hashlib
import re
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Self

import numpy as np
import typer

from graphtrack.cli import options
from graphtrack.cli.console import emit
from graphtrack.errors import InputError
from graphtrack.tracks.display import counted
from perception.cli.options import decoded_frames, in_time, stamp_of

if TYPE_CHECKING:
    from graphtrack.geometry.camera import GroundCamera
    from perception.detection.background import Backgrounds
    from perception.detection.boxes import Detections, Detector, PersonBox
    from perception.detection.ground_search import Candidates, GroundSearch
    from perception.detection.rescoring import PersonProbability
    from perception.detection.yolo import NetworkParameters, YoloNetwork
    from perception.images.frames import Clock, Frame, FrameSource
    from perception.images.pixels import Image
    from perception.observe.journal import FrameJournal


@dataclass(frozen=True, eq=False)
class OwnNetworks:
    """Networks and keypoints that the options name.

    Attributes
    ----------
    detector : finds boxes; None: the package's
    pose : finds keypoints; None: none, or they are known
    known : keypoints by frame, of files; None: of none
    asked : all that the results depend on, but files with keypoints
    """

    detector: YoloNetwork | None
    pose: YoloNetwork | None
    known: Mapping[int, Detections] | None
    asked: tuple[object, ...]

    @property
    def has_keypoints(self) -> bool:
        """Return True if body and head are told by keypoints."""
        return self.pose is not None or self.known is not None

    @property
    def makes_boxes(self) -> bool:
        """Return True if the boxes of people are those of their keypoints, where none are given."""
        return self.has_keypoints and self.detector is None

    def look(self, frame: int, image: Image) -> Detections:
        """The people of a frame with their keypoints."""
        from perception.detection.boxes import Detections

        if self.pose is not None:
            return self.pose.detect(image)
        assert self.known is not None
        return self.known.get(frame) or Detections(np.empty((0, 4)), np.empty(0))


@dataclass(frozen=True)
class NetworkOptions:
    """Options of networks of one's own, and of keypoints of others.

    Networks and keypoints of your own
    ----------------------------------
    detector : A YOLO network of your own (.onnx), in place of the package's.
    keypoints : A YOLO-pose network (.onnx), or keypoints as COCO, OpenPose or MMPose write them (.json, or a
        folder with one for each frame): body and head by them, and boxes where none are given.
    person_class : Name or number of the network's class of people, if not person.
    input_size : Size of the network's input, such as 640 or 1280x736, if its file leaves it open.
    least_score : Of people whom networks find (else 0.25).
    """

    detector: options.InputFile | None = None
    keypoints: Annotated[Path | None, typer.Option(exists=True)] = None
    person_class: str | None = None
    input_size: str | None = None
    least_score: Annotated[float | None, typer.Option(min=0.0, max=1.0)] = None

    @property
    def files(self) -> dict[str, Path | list[Path] | None]:
        """The files to read, by the names of their options."""
        points: Path | list[Path] | None = self.keypoints
        if self.keypoints is not None and self.keypoints.is_dir():
            points = sorted(self.keypoints.glob("*.json"))
        return {"--detector": self.detector, "--keypoints": points}

    def load(self, frames: FrameSource) -> OwnNetworks:
        """Load what the options name."""
        from perception.detection.boxes import found_by_frame
        from perception.detection.yolo import YoloNetwork
        from perception.pose.keypoints import read_keypoints

        points = self.keypoints
        pose_file = points if points and points.suffix.lower() == ".onnx" and points.is_file() else None
        for name in ("person_class", "input_size", "least_score"):
            if getattr(self, name) is not None and self.detector is None and pose_file is None:
                expected = "--detector, or --keypoints with a network (.onnx)"
                raise InputError(f"{options.option_name(name)} without a network", expected)
        parameters = self._parameters()

        def network(path: Path | None, pose: bool) -> YoloNetwork | None:
            return None if path is None else YoloNetwork(path, pose=pose, parameters=parameters)

        known = None
        if points is not None and pose_file is None:
            known = found_by_frame(read_keypoints(points, frames.frame_of))
        asked = (stamp_of(self.detector), stamp_of(pose_file), parameters, points is not None)
        return OwnNetworks(network(self.detector, False), network(pose_file, True), known, asked)

    def _parameters(self) -> NetworkParameters:
        from perception.detection.yolo import NetworkParameters

        size = None
        if self.input_size is not None:
            sides = re.fullmatch(r"(\d{2,4})(?:[x×](\d{2,4}))?", self.input_size)
            if sides is None:
                expected = "columns, or columns x rows, such as 1280x736"
                raise InputError(f"--input-size {self.input_size}", expected)
            size = (int(sides[1]), int(sides[2] or sides[1]))
        if self.least_score is None:
            return NetworkParameters(size, self.person_class)
        return NetworkParameters(size, self.person_class, self.least_score)


def say_how_far(journal: FrameJournal[Any]) -> None:
    """Say how much of it is known, if anything is."""
    if journal.frames:
        emit(f"going on after {counted(len(journal.frames), 'frame')}")


def find_keypoints(
    frames: FrameSource,
    networks: OwnNetworks,
    numbers: set[int] | None,
    journal: FrameJournal[Detections],
    refuse: Callable[[str], object],
    *,
    one_size: bool,
) -> Mapping[int, Detections]:
    """Keypoints by frame; frames that the journal has are not looked at again.

    Parameters
    ----------
    numbers : of the frames that hold somebody; None: any may
    """
    if networks.known is not None:
        return networks.known
    assert networks.pose is not None
    start, count = time.perf_counter(), 0
    try:
        journal.open()
        say_how_far(journal)
        left = (frames.count if numbers is None else len(numbers)) - len(journal.frames)

        def wanted(number: int) -> bool:
            return number not in journal.frames and (numbers is None or number in numbers)

        with decoded_frames(frames, wanted, left, one_size=one_size) as decoded:
            for frame in decoded:
                if frame.image is None:
                    refuse(frame.reason)
                else:
                    journal.add(frame.number, networks.pose.detect(frame.image))
                    count += 1
    finally:
        journal.close(remove=False)
    emit(f"looked for keypoints in {in_time(count, time.perf_counter() - start)}")
    return journal.frames


def with_their_keypoints(
    people: list[PersonBox] | None, found: Mapping[int, Detections], refuse: Callable[[str], object]
) -> list[PersonBox]:
    """The same people with their keypoints; where no boxes are known, those of the keypoints.

    ``refuse`` is told how many have none.
    """
    from perception.detection.boxes import boxes_of, with_keypoints

    if people is None:
        return boxes_of(found, refuse)
    pointed = with_keypoints(people, found)
    without = sum(item.keypoints is None for item in pointed)
    if without:
        refuse(f"{without} of {len(pointed)} boxes without keypoints: body and head may point anywhere there")
    return pointed


Refuse = Callable[[str], object]


def key_of(*asked: object) -> str:
    """Key of a run, from all that its result depends on."""
    return hashlib.sha256(repr(asked).encode()).hexdigest()


def search_journals(output: Path) -> list[Path]:
    """The files beside an output that know how far the search for it came."""
    return [output.with_name(f"{output.name}.{name}") for name in ("detections", "taught")]


@dataclass(eq=False)
class PeopleSearch:
    """Looks for people in a recording; what is known goes to journals beside the output.

    Attributes
    ----------
    frames : the recording
    camera : over the ground; None: people may have any size
    clock : times of the frames
    output : of the command
    asked : what the result depends on besides the frames
    causal : whether a detection depends on its frame alone: without a background, and nothing is learned
    one_size : whether frames of several sizes are refused, as they are with a camera
    detector : of the user's own, for every frame; None: the package's
    found : by frame, what was found so far
    """

    frames: FrameSource
    camera: GroundCamera | None
    clock: Clock
    output: Path
    asked: tuple[object, ...] = ()
    causal: bool = False
    one_size: bool = False
    detector: Detector | None = None
    _journals: list[FrameJournal[Any]] = field(default_factory=list)

    @property
    def found(self) -> Mapping[int, Detections]:
        """By frame, what was found so far."""
        return self._journals[0].frames if self._journals else {}

    def people(self, refuse: Refuse) -> list[PersonBox]:
        """Detect people, without identities; frames that a journal has are not searched again.

        ``refuse`` is told of frames that cannot be decoded.
        """
        from perception.detection.boxes import Detections, boxes_of
        from perception.detection.rescoring import PersonProbability
        from perception.observe.journal import FrameJournal

        key = key_of(self.frames.stamp(), self.clock, self.causal, *self.asked)
        detections, taught = search_journals(self.output)
        journal = FrameJournal(detections, key, Detections.to_record, Detections.from_record)
        known = FrameJournal(taught, key, PersonProbability.to_record, PersonProbability.from_record)
        self._journals = [journal, known]
        started, before = time.process_time(), time.perf_counter()
        try:
            journal.open()
            say_how_far(journal)
            count = len(journal.frames)
            if self.detector is not None or self.camera is None:
                self._frame_by_frame(journal, refuse)
            else:
                self._on_ground(self.camera, journal, known, refuse)
        except InputError:  # the same command would end in the same way
            self.close(remove=True)
            raise
        finally:
            self.close(remove=False)
        count = len(journal.frames) - count
        spent = (time.process_time() - started) / max(count, 1)
        emit(
            f"looked for people in {in_time(count, time.perf_counter() - before)}, "
            f"{spent:.2f} s of processor time each"
        )
        return boxes_of(journal.frames)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, *rest: object) -> None:
        """The journals stay only where the run was broken off: the same command would refuse as it did."""
        self.close(remove=kind is None or issubclass(kind, InputError))

    def close(self, *, remove: bool) -> None:
        """End writing; ``remove`` when the run is complete."""
        for journal in self._journals:
            journal.close(remove=remove)

    def _frame_by_frame(self, journal: FrameJournal[Detections], refuse: Refuse) -> None:
        from perception.detection.hog import PeopleDetector

        detector = self.detector or PeopleDetector()
        for frame in self._unknown(journal, one_size=self.one_size):
            if frame.image is None:
                refuse(frame.reason)
            else:
                journal.add(frame.number, detector.detect(frame.image))

    def _unknown(self, journal: FrameJournal[Detections], *, one_size: bool) -> Iterator[Frame]:
        """The frames that the journal has not, with a progress bar; and where a video ends too early."""
        known = frozenset(journal.frames)
        with decoded_frames(
            self.frames,
            lambda number: number not in known,
            max(self.frames.count - len(known), 0),
            unit="frames searched",
            one_size=one_size,
        ) as decoded:
            yield from decoded

    def _on_ground(
        self,
        camera: GroundCamera,
        journal: FrameJournal[Detections],
        known: FrameJournal[PersonProbability],
        refuse: Refuse,
    ) -> None:
        from perception.detection.rescoring import GroundDetector, PersonProbability

        numbers = self.frames.numbers()
        rest = set(numbers) - set(journal.frames)
        backgrounds = self._backgrounds(numbers if rest else [])
        known.open()
        probability = known.frames.get(0)
        search: GroundSearch | None = None
        candidates: dict[int, Candidates] = {}
        if probability is None and rest and not self.causal:
            search, candidates = self._candidates(camera, numbers, backgrounds, refuse)
            probability = self._taught(camera, candidates)
        if probability is None:
            probability = PersonProbability.untaught(foreground=bool(backgrounds.parts))
        if not known.frames:
            known.add(0, probability)
        if search is not None:
            detector = GroundDetector(search, probability)
            for number, of_frame in candidates.items():
                if number not in journal.frames:
                    journal.add(number, detector.chosen(of_frame))
        for frame in self._unknown(journal, one_size=True):
            if frame.image is None:
                refuse(frame.reason)
            else:
                search = search or ground_search(camera, frame.image)
                detector = GroundDetector(search, probability, backgrounds.at(frame.number))
                journal.add(frame.number, detector.detect(frame.image))

    def _backgrounds(self, numbers: list[int]) -> Backgrounds:
        from perception.detection.background import Backgrounds, background_samples

        samples = [] if self.causal else background_samples(numbers, self.clock.rate)
        wanted = {number for part in samples for number in part}
        if not wanted:
            return Backgrounds.of((), samples, numbers)
        with decoded_frames(
            self.frames, wanted.__contains__, len(wanted), unit="frames for the background", one_size=True
        ) as decoded:
            return Backgrounds.of(decoded, samples, numbers)

    def _candidates(
        self, camera: GroundCamera, numbers: list[int], backgrounds: Backgrounds, refuse: Refuse
    ) -> tuple[GroundSearch | None, dict[int, Candidates]]:
        """Candidates for people in the frames that are learned from."""
        from perception.detection.rescoring import learning_frames

        wanted = frozenset(learning_frames(numbers, self.clock.rate))
        search: GroundSearch | None = None
        found: dict[int, Candidates] = {}
        with decoded_frames(
            self.frames, wanted.__contains__, len(wanted), unit="frames to learn from", one_size=True
        ) as decoded:
            for frame in decoded:
                if frame.image is None:
                    refuse(frame.reason)
                    continue
                search = search or ground_search(camera, frame.image)
                found[frame.number] = search.candidates(frame.image, backgrounds.at(frame.number))
        return search, found

    def _taught(self, camera: GroundCamera, candidates: dict[int, Candidates]) -> PersonProbability | None:
        from perception.detection.rescoring import taught

        found = taught(candidates, camera, self.clock, np.random.default_rng(0))
        if found is None:
            emit(
                "  note: too few people surely walk: detections are not taught by this recording, and their "
                "scores are no probabilities of it"
            )
        else:
            emit(f"taught by {counted(found.boxes, 'detection')} of {found.people} people who surely walk")
        return found


def ground_search(camera: GroundCamera, image: np.ndarray) -> GroundSearch:
    """The search in images like this one; a calibration of another size is refused."""
    from perception.adaptation.labels import check_camera
    from perception.detection.ground_search import GroundSearch

    size = image.shape[1], image.shape[0]
    check_camera(camera, size)
    return GroundSearch(camera, size)
