"""The Sigma-Pi tracker on rendered ceilings and on real frames, scored as in Yan et al.'s Table 1."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import cv2
import numpy as np

from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray
from perception.detection.boxes import read_boxes
from perception.images.pixels import Image, as_uint8
from perception.synthetic.ceiling import ALL_KINDS, ceiling_sequence
from perception.trackers.sigma_pi.tracker import SigmaPiParameters, SigmaPiTracker
from perception.trackers.tracker import Box, BoxEstimate

OURS, FIXED, MOTION = "sigma-pi", "motion not adaptive", "motion alone"
PRINTED, LOCAL = "as in the paper", "local features"
METHODS: Mapping[str, SigmaPiParameters] = {
    OURS: SigmaPiParameters(),
    FIXED: SigmaPiParameters(fixed=("motion",)),
    PRINTED: SigmaPiParameters.of_the_paper(),
    MOTION: SigmaPiParameters(cues=("motion",)),
}
"""The tracker; the same with a reliability of motion that is not adaptive, as Yan et al. (2011) have it;
the form as printed in full (`SigmaPiParameters.of_the_paper`); and the same with the motion cue
only, Yan et al.'s comparison."""

FROM_BOXES: Mapping[str, SigmaPiParameters] = {
    OURS: METHODS[OURS],
    LOCAL: SigmaPiParameters(views=False),
    MOTION: METHODS[MOTION],
}
"""For people whose first box is given: the tracker; the same without the view in that box, as it is for
people whom nobody shows it; and motion only."""

_SEEN = 0.5
"""Share of a rendered person that must be visible for the frame to count."""


@dataclass(frozen=True)
class Score:
    """Frames of one run.

    Attributes
    ----------
    frames : in which the person is labelled
    missing : of them, those in which the tracker does not find anybody
    mismatch : of them, those in which it finds somebody whose centre is outside the person's box
    empty, alarms : frames without anybody, and those of them in which the tracker finds somebody
    """

    frames: int
    missing: int
    mismatch: int
    empty: int
    alarms: int

    @property
    def success(self) -> float:
        """Share of the frames in which the centre that is found lies in the labelled box."""
        return 1.0 - (self.missing + self.mismatch) / max(self.frames, 1)


@dataclass(eq=False)
class Tally:
    """Counts estimates against labels, frame by frame, and keeps the cues.

    Attributes
    ----------
    estimates : of every frame
    """

    estimates: list[BoxEstimate] = field(default_factory=list)
    _counts: dict[str, int] = field(default_factory=lambda: dict.fromkeys(Score.__dataclass_fields__, 0))

    def add(self, estimate: BoxEstimate, label: Box | None, *, counts: bool = True) -> None:
        """Take in a frame; one that is not to count, such as of a person half hidden, is only kept."""
        self.estimates.append(estimate)
        if not counts:
            return
        if label is None:
            self._counts["empty"] += 1
            self._counts["alarms"] += estimate.found
            return
        self._counts["frames"] += 1
        if not estimate.found:
            self._counts["missing"] += 1
        elif not holds(label, estimate.centre):
            self._counts["mismatch"] += 1

    @property
    def score(self) -> Score:
        """So far."""
        return Score(**self._counts)


def holds(box: Box, point: FloatArray) -> bool:
    """Whether a point (2,) lies in a box."""
    left, top, width, height = box
    return bool(left <= point[0] <= left + width and top <= point[1] <= top + height)


def rendered(kind: str, seed: Sequence[int], frames: int) -> dict[str, Tally]:
    """Every method on one sequence of a kind; nobody tells them where the person is.

    Parameters
    ----------
    seed : of the sequence and of the particles
    """
    sequence = ceiling_sequence(ALL_KINDS[kind], np.random.default_rng(seed), frames=frames, oversampling=1)
    trackers = {
        name: SigmaPiTracker(parameters, seed=np.random.default_rng([*seed, 1]))
        for name, parameters in METHODS.items()
    }
    tallies = {name: Tally() for name in METHODS}
    for k, frame in enumerate(sequence):
        target = frame.target
        box = None if target is None else target.body_box
        counts = target is None or (box is not None and target.visibility >= _SEEN)
        for name, tracker in trackers.items():
            estimate = tracker.step(frame.image) if k else tracker.start(frame.image)
            tallies[name].add(estimate, box, counts=counts)
    return tallies


@dataclass(frozen=True, eq=False)
class Recording:
    """A labelled person in consecutive frames of a recording.

    Attributes
    ----------
    name, person : of the recording, and the label's number in it
    numbers : of the frames, from the first to the last in which the person is labelled
    folder : of the images
    labels : frame → box
    """

    name: str
    person: int
    numbers: tuple[int, ...]
    folder: Path
    labels: Mapping[int, Box]

    def images(self) -> Iterable[Image]:
        """The frames, in order.

        Raises
        ------
        InputError
            If one cannot be decoded.
        """
        for number in self.numbers:
            path = self.folder / f"{number:04d}.jpg"
            image = cv2.imread(str(path))
            if image is None:
                raise InputError("no image that can be decoded", "a JPEG image", path=path)
            yield as_uint8(np.asarray(image))


def recordings(folder: Path, names: Iterable[str], fewest: int) -> list[Recording]:
    """People of CAVIAR's recordings that are labelled in at least ``fewest`` frames one after the other.

    Parameters
    ----------
    folder : with ``frames/NAME/NUMBER.jpg`` and ``xml/NAME.xml``
    """
    found = []
    for name in names:
        frames, truth = folder / "frames" / name, folder / "xml" / f"{name}.xml"
        if not frames.is_dir() or not truth.is_file():
            continue
        there = {int(path.stem) for path in frames.glob("*.jpg") if path.stem.isdigit()}
        people: dict[int, dict[int, Box]] = {}
        for item in read_boxes(truth):
            if item.frame in there:
                people.setdefault(item.track_id, {})[item.frame] = item.box
        for person, labels in sorted(people.items()):
            numbers = np.array(sorted(labels))
            for run in np.split(numbers, np.flatnonzero(np.diff(numbers) > 1) + 1):
                if len(run) >= fewest:
                    found.append(Recording(name, person, tuple(run.tolist()), frames, labels))
    return found


def on_recording(recording: Recording, seed: Sequence[int], frames: int | None = None) -> dict[str, Tally]:
    """The methods `FROM_BOXES` on one person, begun with the first labelled box.

    Parameters
    ----------
    frames : to look at, from the first; all by default
    """
    trackers = {
        name: SigmaPiTracker(parameters, seed=np.random.default_rng([*seed, 1]))
        for name, parameters in FROM_BOXES.items()
    }
    tallies = {name: Tally() for name in FROM_BOXES}
    for k, (number, image) in enumerate(zip(recording.numbers, recording.images(), strict=True)):
        if k == frames:
            break
        box = recording.labels[number]
        for name, tracker in trackers.items():
            estimate = tracker.step(image) if k else tracker.start(image, box)
            tallies[name].add(estimate, box)
    return tallies


@dataclass(frozen=True, eq=False)
class PersonJob:
    """One sequence with one seed.

    Attributes
    ----------
    sequence : a kind of rendered sequence, or a person of a recording
    seed : of everything that is drawn
    frames : at most; all of a recording for None
    """

    sequence: str | Recording
    seed: tuple[int, ...]
    frames: int | None

    @property
    def name(self) -> str:
        """Of the sequence."""
        if isinstance(self.sequence, str):
            return self.sequence
        one = self.sequence
        return f"{one.name} {one.numbers[0]}–{one.numbers[-1]}, person {one.person}"


def run_job(job: PersonJob) -> dict[str, Tally]:
    """Every method on one sequence."""
    if isinstance(job.sequence, str):
        return rendered(job.sequence, job.seed, job.frames or 0)
    return on_recording(job.sequence, job.seed, job.frames)
