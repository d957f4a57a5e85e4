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

from graphtrack.cli.console import console
from graphtrack.display import counted
from graphtrack.errors import InputError
from perception.cli.common import FILE, decoded_frames, in_time

if TYPE_CHECKING:
    from perception.detection.boxes import Detections, PersonBox
    from perception.detection.yolo import NetworkParameters, YoloNetwork
    from perception.images.frames import FrameSource
    from perception.images.pixels import Image
    from perception.observe.journal import FrameJournal

Detector = Annotated[
    Path | None,
    typer.Option("--detector", help="A YOLO network of your own (.onnx), in place of the package's.", **FILE),
]
Keypoints = Annotated[
    Path | None,
    typer.Option(
        "--keypoints",
        help="A YOLO-pose network (.onnx), or keypoints as COCO, OpenPose or MMPose write them (.json, or a "
        "folder with one for each frame): body and head by them, and boxes where none are given.",
        exists=True,
    ),
]
PersonClass = Annotated[
    str | None,
    typer.Option("--person-class", help="Name or number of the network's class of people, if not person."),
]
InputSize = Annotated[
    str | None,
    typer.Option(
        "--input-size",
        help="Size of the network's input, such as 640 or 1280x736, if its file leaves it open.",
    ),
]
LeastScore = Annotated[
    float | None,
    typer.Option("--least-score", min=0.0, max=1.0, help="Of people whom networks find (else 0.25)."),
]


@dataclass(frozen=True, eq=False)
class OwnNetworks:
    """What the options name.

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
        """Whether body and head are told by keypoints."""
        return self.pose is not None or self.known is not None

    @property
    def makes_boxes(self) -> bool:
        """Whether the boxes of people are those of their keypoints, where none are given."""
        return self.has_keypoints and self.detector is None

    def look(self, frame: int, image: Image) -> Detections:
        """The people of a frame with their keypoints."""
        from perception.detection.boxes import Detections

        if self.pose is not None:
            return self.pose.detect(image)
        assert self.known is not None
        return self.known.get(frame) or Detections(np.empty((0, 4)), np.empty(0))


def keypoint_files(keypoints: Path | None) -> list[Path]:
    """The files that `--keypoints` reads."""
    if keypoints is None or not keypoints.is_dir():
        return [] if keypoints is None else [keypoints]
    return sorted(keypoints.glob("*.json"))


def own_networks(
    frames: FrameSource,
    detector: Path | None,
    keypoints: Path | None,
    person_class: str | None,
    input_size: str | None,
    least_score: float | None,
) -> OwnNetworks:
    """Load what the options name.

    Raises
    ------
    InputError
        If it cannot be used, or an option says something of a network where there is none.
    """
    from perception.detection.pointed import found_by_frame
    from perception.pose.keypoints.files import read_keypoints

    is_network = keypoints is not None and keypoints.suffix.lower() == ".onnx" and keypoints.is_file()
    said = {"--person-class": person_class, "--input-size": input_size, "--least-score": least_score}
    for name, value in said.items():
        if value is not None and detector is None and not is_network:
            raise InputError(f"{name} without a network", "--detector, or --keypoints with a network (.onnx)")
    parameters = _parameters(person_class, input_size, least_score)
    networks = [
        _network(path, pose, parameters) for path, pose in ((detector, False), (keypoints, True))
        if path is not None and (is_network or not pose)
    ]  # fmt: skip
    known = None
    if keypoints is not None and not is_network:
        known = found_by_frame(read_keypoints(keypoints, frames.frame_of))
    stamps = [stamp_of(path) for path in (detector, keypoints if is_network else None)]
    return OwnNetworks(
        networks[0] if detector is not None else None,
        networks[-1] if is_network else None,
        known,
        (*stamps, parameters, keypoints is not None),
    )


def _network(path: Path, pose: bool, parameters: NetworkParameters) -> YoloNetwork:
    from perception.detection.yolo import YoloNetwork

    return YoloNetwork(path, pose=pose, parameters=parameters)


def _parameters(
    person_class: str | None, input_size: str | None, least_score: float | None
) -> NetworkParameters:
    from perception.detection.yolo import NetworkParameters

    size = None
    if input_size is not None:
        sides = re.fullmatch(r"(\d{2,4})(?:[x×](\d{2,4}))?", input_size)
        if sides is None:
            raise InputError(f"--input-size {input_size}", "columns, or columns x rows, such as 1280x736")
        size = (int(sides[1]), int(sides[2] or sides[1]))
    if least_score is None:
        return NetworkParameters(size, person_class)
    return NetworkParameters(size, person_class, least_score)


def stamp_of(path: Path | None) -> object:
    """What tells a file from what it is after a change."""
    if path is None:
        return None
    state = path.stat()
    return str(path), state.st_size, state.st_mtime_ns


def say_how_far(journal: FrameJournal[Any]) -> None:
    """Say how much of it is known, if anything is."""
    if journal.frames:
        console.print(f"going on after {counted(len(journal.frames), 'frame')}", markup=False)


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
    console.print(f"looked for keypoints in {in_time(count, time.perf_counter() - start)}", markup=False)
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
