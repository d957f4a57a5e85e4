"""Identities in recordings: trackers on the same detections, and on people observed in the images."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, TypeAlias

import cv2
import numpy as np
import pandas as pd

from graphtrack.association.associate import associate
from graphtrack.errors import InputError
from graphtrack.evaluation.identities import SequenceScore, score
from graphtrack.evaluation.trackers import TRACKERS, TUNED, compare_trackers, load, read_detections
from graphtrack.experiments.harness import (
    Cell,
    Experiment,
    Panel,
    Parts,
    Settings,
    Table,
)
from graphtrack.geometry.camera import GroundCamera
from graphtrack.io import read_identified
from graphtrack.io.cameras import read_calibration
from graphtrack.io.options import ReadOptions
from graphtrack.simulation.detector import Detector, detect
from graphtrack.smoothing import smooth
from graphtrack.tracks.detections import Detections
from graphtrack.tracks.track import TrackSet

MATCH = 1.0
"""Metres within which a track matches a person."""

RATE = 2.5
"""Frames a second of Town Centre's images."""

MINUTE = ("towncentre", "frames_001_150")
PUBLISHED = (
    *("NOMTwSDP", "JointMC", "EAMTT", "TSML_CDE", "MDP", "TDAM", "CNNTCM", "SORT", "SCEA", "MHT_DAM"),
    *("RNN", "KSP"),
)
"""Trackers of MOTChallenge 3D, whose tracks of Town Centre's first minute are stored with it."""

EVIDENCE: Mapping[str, tuple[str, ...]] = {
    "positions": ("body_", "head_", "appearance_"),
    "positions, body and head": ("appearance_",),
    "positions and appearance": ("body_", "head_"),
    "positions, body, head and appearance": (),
}
"""Observations used → beginnings of the columns that are left out."""

CROWDS: Mapping[str, tuple[str, ...]] = {
    "zara01": ("ucy", "zara01", "annotation.vsp"),
    "seq_hotel": ("eth", "seq_hotel", "obsmat.txt"),
}
"""Recordings of crowds, which are made into detections."""

EVERY, POSITION_STD, SEEDS = 0.4, 0.1, 3
"""Seconds between frames, metres of noise, and seeds of these detections."""

FAULTS = Detector(missed=0.15, occluded_share=0.5, occluded_seconds=2.0, clutter=1.0, clutter_count="fixed")
STREET_FAULTS = Detector(
    missed=0.15, occluded_share=1.0, occluded_seconds=1.0, clutter=1.0, clutter_count="fixed"
)
"""Errors of the simulated detectors of the crowds, and of KITTI's one pedestrian."""

FEW_FRAMES = 15
"""Frames of a recording where the experiment runs quickly."""

STADTMITTE_FPS = 25.0

FIGURES: Mapping[str, str] = {
    **{"HOTA": "hota", "IDF1": "idf1", "MOTA": "mota"},
    **{name: name for name in ("precision", "recall", "switches", "fragmentations")},
}
"""Column → attribute of `SequenceScore`."""

Row: TypeAlias = dict[str, Cell]


@dataclass(frozen=True, eq=False)
class JudgedScene:
    """Detections without identities, the true people, and what is done to them.

    Attributes
    ----------
    name : of the recording
    detections, truth : of the same frames
    """

    name: str
    detections: Detections
    truth: TrackSet


def figures(one: SequenceScore) -> Row:
    """Return the cells of a score."""
    return {column: getattr(one, name) for column, name in FIGURES.items()}


def methods() -> tuple[str, ...]:
    """Return the trackers that are compared: the peers only where their package is installed."""
    try:
        load("bytetrack")
    except InputError:
        return TRACKERS
    return (*TRACKERS, *TUNED)


def until(detections: Detections, frames: int) -> Detections:
    """Return the detections of the first frames."""
    last = np.unique(detections.frame)[:frames][-1]
    return detections.taken(np.flatnonzero(detections.frame <= last))


def _first(truth: TrackSet, last: int) -> TrackSet:
    return truth.with_tracks(track[track.frame <= last] for track in truth if track.frame[0] <= last)


def shortened(scene: JudgedScene, settings: Settings) -> JudgedScene:
    """Return the first frames of a scene where the experiment runs quickly, else all of it."""
    if not settings.quick:
        return scene
    detections = until(scene.detections, FEW_FRAMES)
    return JudgedScene(scene.name, detections, _first(scene.truth, int(detections.frame.max())))


def compared(scene: JudgedScene, names: Sequence[str], *, fill: bool = False) -> Iterator[Row]:
    """Yield a row for each tracker: its figures and seconds; filled: its gaps are smoothed offline."""
    found = compare_trackers(scene.detections, scene.truth, names, metres=MATCH, fill=fill)
    for one in found.results:
        yield {"method": one.method, "gaps filled": "yes" if fill else "no", **figures(one.score)} | {
            "seconds": one.seconds
        }


def simulated_detections(
    name: str, people: TrackSet, faults: Detector, every: float | None, rng: np.random.Generator
) -> JudgedScene:
    """Return detections of people with known positions, as ``graphtrack add-noise --anonymous`` does."""
    found = detect(people, faults, every=every, position_std=POSITION_STD, rng=rng)
    table = found.anonymous(rng)
    position = np.column_stack([table["x"], table["y"]])
    return JudgedScene(name, Detections(table["frame"], table["t"], position), found.truth)


def over_seeds(rows: Sequence[Sequence[Row]]) -> Iterator[Row]:
    """Yield means and standard deviations of the numbers of rows that are alike in each seed."""
    for alike in zip(*rows, strict=True):
        row: Row = {}
        for column, first in alike[0].items():
            if isinstance(first, str):
                row[column] = first
                continue
            values = np.array([one[column] for one in alike], float)
            spread = float(values.std(ddof=1)) if len(values) > 1 else None
            row |= {column: float(values.mean()), f"{column} ±": spread}
        yield row


def _crowds(settings: Settings) -> Iterator[Row]:
    peers = [name for name in methods() if name not in TRACKERS[:2]]
    for name, parts in CROWDS.items():
        people = settings.tracks(*parts)
        if people is None:
            continue
        rows: list[list[Row]] = []
        for seed in range(settings.few(SEEDS)):
            scene = simulated_detections(name, people, FAULTS, EVERY, settings.rng(seed))
            scene = shortened(scene, settings)
            found = [*compared(scene, methods()), *compared(scene, peers, fill=True)]
            rows.append([{"scene": name, **row} for row in found])
            settings.progress(1)
        yield from over_seeds(rows)


def fitted_homography(path: Path) -> GroundCamera:
    """Return the camera of MOT text with positions: feet of the boxes (pixels) → columns 8 and 9 (metres)."""
    rows = np.loadtxt(path, delimiter=",")
    left, top, width, height = rows[:, 2:6].T
    feet = np.column_stack([left + width / 2.0, top + height])
    homography, _ = cv2.findHomography(feet, rows[:, 7:9])
    return GroundCamera.from_homography(homography)


def _stadtmitte(settings: Settings) -> JudgedScene | None:
    found = settings.recording("tud", "TUD-Stadtmitte", "test.txt")
    truth = settings.recording("tud", "TUD-Stadtmitte", "gt.txt")
    if found is None or truth is None:
        return None
    camera = fitted_homography(truth)
    options = ReadOptions(camera=camera, fps=STADTMITTE_FPS, associate="always")
    detections, _ = read_detections(found, None, options)
    people = read_identified(truth, camera=camera, fps=STADTMITTE_FPS)
    return shortened(JudgedScene("TUD-Stadtmitte", detections, people), settings)


def _more(settings: Settings) -> Iterator[Row]:
    """Yield rows of Stadtmitte, with a detector's boxes, and of KITTI, with simulated detections."""
    scene = _stadtmitte(settings)
    if scene is not None:
        yield from over_seeds([[{"scene": scene.name, **row} for row in compared(scene, methods())]])
        settings.progress(1)
    street = settings.tracks("kitti", "label_02", "0012.txt")
    if street is not None:
        rows: list[list[Row]] = []
        for seed in range(settings.few(SEEDS)):
            scene = simulated_detections("KITTI 0012", street, STREET_FAULTS, None, settings.rng(seed, 1))
            scene = shortened(scene, settings)
            rows.append([{"scene": scene.name, **row} for row in compared(scene, methods())])
            settings.progress(1)
        yield from over_seeds(rows)


def with_evidence(observed: Mapping[str, Any], evidence: str) -> dict[str, Any]:
    """Return the columns of observations that belong to the evidence, one of `EVIDENCE`."""
    return {name: values for name, values in observed.items() if not name.startswith(EVIDENCE[evidence])}


@dataclass(frozen=True, eq=False)
class TownCentre:
    """The first minute of Town Centre: its folder, calibration, camera and true people."""

    folder: Path
    calibration: Path
    camera: GroundCamera
    truth: TrackSet

    @classmethod
    def of(cls, settings: Settings) -> TownCentre | None:
        """Return the minute; None if it is missing."""
        truth = settings.recording(*MINUTE, "gt.txt")
        calibration = settings.recording("towncentre", "calibration.ci")
        if truth is None or calibration is None:
            return None
        camera = read_calibration(calibration)
        return cls(truth.parent, calibration, camera, read_identified(truth, camera=camera, fps=RATE))

    def judged(self, tracks: TrackSet) -> Row:
        """Return the figures of tracks within a metre."""
        return figures(score(tracks, self.truth, metres=MATCH).together)

    def observed(self, *, searched: bool) -> dict[str, Any]:
        """Observe people in the public detections' boxes, or search for them: ``perception observe``."""
        boxes = [] if searched else ["--boxes", str(self.folder / "det.txt")]
        with TemporaryDirectory() as folder:
            table = Path(folder) / "observed.parquet"
            camera = ["--calibration", str(self.calibration), "--fps", f"{RATE:g}"]
            command = ["perception", "observe", str(self.folder / "img1"), *boxes, *camera, "-o", str(table)]
            subprocess.run([sys.executable, "-m", *command], check=True, stdout=subprocess.DEVNULL)
            found = pd.read_parquet(table)
        return {str(name): found[name].to_numpy() for name in found}


def _smoothed_file(town: TownCentre) -> Row:
    """Return the figures of ``graphtrack smooth det.txt``, which uses the detector's scores too."""
    return town.judged(smooth(town.folder / "det.txt", calibration=town.calibration, fps=RATE))


def _minute(town: TownCentre, settings: Settings) -> Iterator[Row]:
    """Yield rows of every input and method; progress is reported after each input."""
    detections, _ = read_detections(town.folder / "det.txt", None, ReadOptions(camera=town.camera, fps=RATE))
    scene = shortened(JudgedScene("Town Centre", detections, town.truth), settings)
    named: Row = {"input": "public detections", "evidence": "positions"}
    for row in compared(scene, methods()):
        yield {**named, **{name: row[name] for name in ("method", *FIGURES)}}
    settings.progress(1)
    if settings.quick:
        return
    yield {**named, "evidence": "positions and score", "method": "associate", **_smoothed_file(town)}
    for boxes, searched in (("public detections, observed", False), ("people searched for", True)):
        observed = town.observed(searched=searched)
        for evidence in EVIDENCE:
            tracks = smooth(associate(with_evidence(observed, evidence)))
            yield {"input": boxes, "evidence": evidence, "method": "associate", **town.judged(tracks)}
        settings.progress(1)


def _published(town: TownCentre) -> Iterator[Row]:
    for name in PUBLISHED:
        path = town.folder / "published" / f"{name}.txt"
        if path.is_file():
            yield {"tracker": name, **town.judged(read_identified(path, camera=town.camera, fps=RATE))}


def _parts(settings: Settings) -> Parts:
    town = TownCentre.of(settings)
    crowds = [name for name, parts in CROWDS.items() if settings.recording(*parts) is not None]
    if town is None and not crowds:
        yield "Town Centre, or a recorded crowd, is needed: --data"
        return
    seeds = settings.few(SEEDS)
    settings.expect(len(crowds) * seeds + (0 if town is None else settings.few(3)) + seeds + 1)
    if town is not None:
        minute = Table.of("Town Centre's first minute", _minute(town, settings))
        yield minute
        yield Table.of("Published trackers", _published(town))
        shown = [row for row in minute.records() if row["method"] == "associate"]
        yield Panel("Town Centre's first minute", shown, "evidence", "IDF1", "input")
    rows = list(_crowds(settings))
    yield Table.of("Crowds", rows)
    if more := list(_more(settings)):
        yield Table.of("Street and square", more)
    for name in crowds:
        own = [row for row in rows if row["scene"] == name]
        yield Panel(name, own, "method", "IDF1", "gaps filled")
    yield (
        f"Matches within {MATCH:g} m on the ground. Town Centre at {RATE} Hz, by the positions of the files, "
        "of observed people the feet through the calibration; crowds are recorded people made into "
        "detections every "
        f"{EVERY:g} s (σ = {POSITION_STD} m, 15 % missed, half of the people hidden for 2 s, one false "
        f"detection a frame), means and standard deviations of {seeds} seeds."
    )
    if len(methods()) == len(TRACKERS):
        yield "The package trackers is missing: no ByteTrack, no OC-SORT."


EXPERIMENT = Experiment(
    "identities",
    "no paper's: data association and published trackers on the same recordings",
    f"{FEW_FRAMES} frames of each recording, one seed, no images",
    _parts,
)
