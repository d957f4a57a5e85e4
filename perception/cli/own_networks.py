"""The options of `perception observe` that take networks of one's own, and keypoints of others."""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import typer

from graphtrack.cli import options
from graphtrack.cli.console import emit
from graphtrack.display import counted
from graphtrack.errors import InputError
from perception.cli.common import decoded_frames, in_time, stamp_of

if TYPE_CHECKING:
    from perception.detection.boxes import Detections, PersonBox
    from perception.detection.yolo import NetworkParameters, YoloNetwork
    from perception.images.frames import FrameSource
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
        from perception.detection.pointed import found_by_frame
        from perception.detection.yolo import YoloNetwork
        from perception.pose.keypoints.files import read_keypoints

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
    from perception.detection.pointed import boxes_of, with_keypoints

    if people is None:
        return boxes_of(found, refuse)
    pointed = with_keypoints(people, found)
    without = sum(item.keypoints is None for item in pointed)
    if without:
        refuse(f"{without} of {len(pointed)} boxes without keypoints: body and head may point anywhere there")
    return pointed
