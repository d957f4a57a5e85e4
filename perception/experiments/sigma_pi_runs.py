"""Runs of the Sigma-Pi tracker on rendered ceilings and real frames (Yan et al. 2011, Table 1)."""

from __future__ import annotations

import multiprocessing
import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import TypeVar

import cv2
import numpy as np

from graphtrack.errors import InputError
from graphtrack.experiments.harness import Progress
from perception.detection.boxes import read_boxes
from perception.images.pixels import Image, as_uint8
from perception.synthetic.ceiling import ALL_KINDS, CEILING_RATE, ceiling_sequence
from perception.trackers.cue_graph import CueGraphParameters, CueGraphTracker
from perception.trackers.cue_tracker import CueTracker
from perception.trackers.sigma_pi import SigmaPiTracker
from perception.trackers.sigma_pi_network import SigmaPiParameters
from perception.trackers.tracker import Box, BoxEstimate

Task = TypeVar("Task")
Answer = TypeVar("Answer")


def run_all(
    function: Callable[[Task], Answer],
    jobs: Sequence[Task],
    progress: Progress,
    *,
    processes: int | None = None,
) -> list[Answer]:
    """Return the results of a module's function for all jobs, in their order.

    Parameters
    ----------
    processes : number of parallel processes; by default one per processor. With 1, none is started.
    """
    count = min(os.cpu_count() or 1 if processes is None else processes, len(jobs))
    results = []
    if count <= 1:
        for job in jobs:
            results.append(function(job))
            progress(1)
        return results
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(count, mp_context=context, initializer=_alone) as pool:
        for result in pool.map(function, jobs):
            results.append(result)
            progress(1)
    return results


def _alone() -> None:
    """Use one thread in this process, to avoid oversubscription."""
    from threadpoolctl import threadpool_limits

    cv2.setNumThreads(1)
    threadpool_limits(1)


OURS, FIXED, MOTION = "sigma-pi", "motion not adaptive", "motion alone"
PRINTED, LOCAL, GRAPH = "as in the paper", "local features", "cue-graph"
METHODS: Mapping[str, SigmaPiParameters | CueGraphParameters] = {
    OURS: SigmaPiParameters(),
    FIXED: SigmaPiParameters(fixed=("motion",)),
    PRINTED: SigmaPiParameters.of_the_paper(),
    MOTION: SigmaPiParameters(cues=("motion",)),
    GRAPH: CueGraphParameters(),
}
"""The tracker; with a fixed reliability of motion (Yan et al. 2011, §2.2); fully as published; with the
motion cue only, the paper's comparison; and the cues as factors of the graph. No box is given."""

FROM_BOXES: Mapping[str, SigmaPiParameters | CueGraphParameters] = {
    OURS: METHODS[OURS],
    LOCAL: SigmaPiParameters(views=False),
    MOTION: METHODS[MOTION],
    GRAPH: METHODS[GRAPH],
}
"""Methods with the first box: the tracker; without views; motion only; and the graph."""

LEAST_LOST = 2.0
"""Least time (s) at the end of a run without a success for which the person counts as lost for good."""

_CAVIAR_RATE = 25.0  # frames a second
_LEAST_VISIBLE = 0.5
"""Share of a rendered person that must be visible for the frame to count."""


@dataclass(eq=False)
class Tally:
    """Count the estimates of one run against labels.

    Attributes
    ----------
    rate : frames a second
    frames : in which the person is labelled
    missing : of them, those without a found person
    mismatch : of them, those with an estimated centre outside the person's box
    failing : of them, those since the last success
    longest : most of them in a row without a success
    empty, alarms : frames without people, and those of them with a found person
    """

    rate: float
    frames: int = 0
    missing: int = 0
    mismatch: int = 0
    failing: int = 0
    longest: int = 0
    empty: int = 0
    alarms: int = 0

    def add(self, estimate: BoxEstimate, label: Box | None, *, counts: bool = True) -> None:
        """Add a frame; excluded frames, such as of a half hidden person, do not count."""
        if not counts:
            return
        if label is None:
            self.empty += 1
            self.alarms += estimate.found
            return
        self.frames += 1
        low, size = np.array(label[:2]), np.array(label[2:])
        self.failing += 1
        if not estimate.found:
            self.missing += 1
        elif not ((low <= estimate.centre) & (estimate.centre <= low + size)).all():
            self.mismatch += 1
        else:
            self.failing = 0
        self.longest = max(self.longest, self.failing)

    @property
    def success(self) -> float:
        """Share of the frames in which the estimated centre lies in the labelled box."""
        return 1.0 - (self.missing + self.mismatch) / max(self.frames, 1)

    @property
    def lost_frames(self) -> int:
        """Frames at the end without a success, if they last for `LEAST_LOST` or longer; else 0.

        The person is present in all of them: a run that has such frames has lost the person for good.
        """
        return self.failing if self.failing >= LEAST_LOST * self.rate else 0


def pooled_success(tallies: Sequence[Tally]) -> float:
    """Success over the frames of several runs, in per cent, as the total of Yan et al. 2011, Table 1.

    Their 90.28 % is 1 − (534 + 356) / 9155, and not the mean of the six sequences' rates.
    """
    failures = sum(tally.missing + tally.mismatch for tally in tallies)
    return 100.0 * (1.0 - failures / max(sum(tally.frames for tally in tallies), 1))


@dataclass(frozen=True, eq=False)
class LabelledPerson:
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

    def images(self) -> Iterator[Image]:
        """Read the frames, in order.

        Raises
        ------
        InputError
            If a frame cannot be decoded.
        """
        for number in self.numbers:
            path = self.folder / f"{number:04d}.jpg"
            image = cv2.imread(str(path))
            if image is None:
                raise InputError("no image that can be decoded", "a JPEG image", path=path)
            yield as_uint8(np.asarray(image))


def recordings(folder: Path, names: Iterable[str], fewest: int) -> list[LabelledPerson]:
    """Return the people of CAVIAR's recordings labelled in ``fewest`` consecutive frames or more.

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
                    found.append(LabelledPerson(name, person, tuple(run.tolist()), frames, labels))
    return found


@dataclass(frozen=True, eq=False)
class PersonJob:
    """One sequence with one seed.

    Attributes
    ----------
    sequence : a kind of rendered sequence, or a person of a recording with the first labelled box
    seed : of all random numbers
    frames : at most; all of a recording for None
    """

    sequence: str | LabelledPerson
    seed: tuple[int, ...]
    frames: int | None

    @property
    def name(self) -> str:
        """Name of the sequence."""
        if isinstance(self.sequence, str):
            return self.sequence
        one = self.sequence
        return f"{one.name} {one.numbers[0]}–{one.numbers[-1]}, person {one.person}"

    @property
    def rate(self) -> float:
        """Frames a second."""
        return CEILING_RATE if isinstance(self.sequence, str) else _CAVIAR_RATE

    def tracker(self, parameters: SigmaPiParameters | CueGraphParameters) -> CueTracker:
        """Make a tracker for it."""
        if isinstance(parameters, CueGraphParameters):
            return CueGraphTracker(parameters, rate=self.rate)
        return SigmaPiTracker(parameters, seed=np.random.default_rng([*self.seed, 1]))

    def labelled(self) -> Iterator[tuple[Image, Box | None, bool]]:
        """Yield each image, the person's box in it, and whether the frame counts."""
        if isinstance(self.sequence, LabelledPerson):
            images = zip(self.sequence.numbers, self.sequence.images(), strict=True)
            for number, image in islice(images, self.frames):
                yield image, self.sequence.labels[number], True
            return
        kind, rng = ALL_KINDS[self.sequence], np.random.default_rng(self.seed)
        for frame in ceiling_sequence(kind, rng, frames=self.frames or 0, oversampling=1):
            target = frame.target
            box = None if target is None else target.body_box
            yield (
                frame.image,
                box,
                target is None or (box is not None and target.visibility >= _LEAST_VISIBLE),
            )


def run_job(job: PersonJob) -> dict[str, Tally]:
    """Run every method on one sequence."""
    given = isinstance(job.sequence, LabelledPerson)
    methods = FROM_BOXES if given else METHODS
    trackers = {name: job.tracker(parameters) for name, parameters in methods.items()}
    tallies = {name: Tally(job.rate) for name in methods}
    for k, (image, box, counts) in enumerate(job.labelled()):
        for name, tracker in trackers.items():
            estimate = tracker.step(image) if k else tracker.start(image, box if given else None)
            tallies[name].add(estimate, box, counts=counts)
    return tallies
