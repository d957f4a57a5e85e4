"""Prediction through an occlusion with the network's heads on Oxford Town Centre's frames (Baxter et al.
2014, Table I and Fig. 5b, on a street of the group whose recording they use).

Only the labels of the available frames are read, those of the recording's first minute.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from graphtrack.baselines.intentional import OWN_FILTERS
from graphtrack.errors import InputError
from graphtrack.evaluation.metrics import bootstrap, reduction
from graphtrack.experiments.baxter_occlusion import (
    Predictor,
    error_of,
    hidden_only,
    in_steps,
    intentional,
    kalman,
)
from graphtrack.experiments.harness import Row, Table, fit, interval_cells, model_of
from graphtrack.geometry.angles import BoolArray, FloatArray, difference, direction
from graphtrack.geometry.camera import GroundCamera
from graphtrack.io.cameras import read_calibration
from graphtrack.io.formats.mot import DEFAULT_FPS, read_towncentre_boxes
from graphtrack.io.source import Source
from graphtrack.model import Model
from graphtrack.simulation.degrade import withhold
from graphtrack.tracks.track import Track
from perception.adaptation.directions import HEAD_HEIGHT, HEAD_WIDTH
from perception.evaluation.classifiers import hidden_both_ways, softmax_layer
from perception.images.frames import FrameSource
from perception.images.pixels import Image, crop, enlarged
from perception.pose.deep_belief import DeepBelief

STEP, SCALE = 10, 2.0
"""Frames of the recording per image, and size of the images relative to the labels."""

FEWEST = 15
"""Least number of consecutive images of a person: six seconds."""

BEFORE, HIDDEN, APART = 6, 5, 4
"""Images before a window, in it (two seconds), and between the starts of windows."""

WALKING = 0.5
"""Metres a second: the head of a faster person is assumed to point in the direction of travel."""

PARTS = 3
"""Number of parts of people, in rotation: to train the last layer, to fit parameters, to test."""

_HEAD_TOP, _MARGIN = 0.005, 1.06
"""Top of a head's box below the person's, in heights of the person, and the training margin."""

HEADS = ("network", "network, last layer of this street")
CONSTANT = "constant velocity"
"""Fitted Kalman filter, the baseline."""


@dataclass(frozen=True, eq=False)
class StreetPerson:
    """A person in n consecutive images.

    Attributes
    ----------
    track : labelled positions in metres, at the pictures' times
    images : of the heads, cut out at the top of the labelled boxes
    size : (n,) pixels of the heads
    travel : (n,) direction of travel, radians in the image frame, while walking; else NaN
    """

    track: Track
    images: list[Image]
    size: FloatArray
    travel: FloatArray


def street_people(folder: Path) -> tuple[list[StreetPerson], GroundCamera]:
    """Return people in `FEWEST` consecutive images of a Town Centre folder, and its camera.

    Labels of frames without an image are not used.
    """
    frames, camera, runs = labelled_runs(folder, FEWEST)
    pictures = {
        frame.number: frame.image
        for frame in frames.where({k for _, number, _ in runs for k in number.tolist()}.__contains__)
        if frame.image is not None
    }
    return [_person(*run, pictures, camera) for run in runs], camera


def labelled_runs(
    folder: Path, fewest: int
) -> tuple[FrameSource, GroundCamera, list[tuple[int, NDArray[np.int64], FloatArray]]]:
    """Read a Town Centre folder: ``frames_001_150/img1``, ``calibration.ci`` and ``boxes.csv``.

    Returns
    -------
    The images, the camera, and for every person in ``fewest`` consecutive images: number, images (n,) of the
    longest such run, and labelled boxes (n, 4) in their pixels.

    Raises
    ------
    InputError
        If a file is missing.
    """
    pictures, truth, calibration = (
        folder / name for name in ("frames_001_150/img1", "boxes.csv", "calibration.ci")
    )
    for path in (pictures, truth, calibration):
        if not path.exists():
            raise InputError(
                "no such file or folder", "Town Centre's pictures, boxes and calibration", path=path
            )
    frames, rows = FrameSource.open(pictures), read_towncentre_boxes(Source.open(truth))
    there = (rows.frame % STEP == 0) & (rows.frame <= (frames.count - 1) * STEP)
    runs: list[tuple[int, NDArray[np.int64], FloatArray]] = []
    for person in np.unique(rows.track_id[there]).tolist():
        mine = np.flatnonzero(there & (rows.track_id == person))
        mine = mine[np.argsort(rows.frame[mine])]
        number = np.asarray(rows.frame[mine] // STEP + 1, np.int64)
        run = max(np.split(np.arange(len(mine)), np.flatnonzero(np.diff(number) > 1) + 1), key=len)
        if len(run) >= fewest:
            runs.append((person, number[run], rows.channels["box"][mine[run]] * SCALE))
    return frames, read_calibration(calibration), runs


def head_boxes(box: FloatArray) -> FloatArray:
    """Return boxes (n, 4) of heads, at the top of the labelled boxes (n, 4) of upright people."""
    left, top, width, height = box.T
    size = np.array([HEAD_WIDTH, HEAD_HEIGHT]) * height[:, None]
    return np.column_stack([left + width / 2.0 - size[:, 0] / 2.0, top + _HEAD_TOP * height, size])


def _person(
    number: int,
    frame: NDArray[np.int64],
    box: FloatArray,
    pictures: Mapping[int, Image],
    camera: GroundCamera,
) -> StreetPerson:
    left, top, width, height = box.T
    t = (frame - 1) * STEP / DEFAULT_FPS
    position = camera.image_to_ground(np.column_stack([left + width / 2.0, top + height]))
    velocity = np.gradient(position, t, axis=0)
    travel = camera.image_angle(direction(velocity), position)
    heads = head_boxes(box)
    return StreetPerson(
        Track(number, frame, t, position, true_position=position),
        [crop(pictures[k], one) for k, one in zip(frame.tolist(), enlarged(heads, _MARGIN), strict=True)],
        heads[:, 2],
        np.where(np.linalg.norm(velocity, axis=1) > WALKING, travel, np.nan),
    )


def packaged_pans(model: DeepBelief, people: Sequence[StreetPerson]) -> list[FloatArray]:
    """Return the likeliest pans (n,) of each person, in the image frame."""
    return [model.classes.most_likely_pan(model.log_likelihoods(person.images)) for person in people]


def pans_by_travel(
    model: DeepBelief, people: Sequence[StreetPerson], teachers: Sequence[StreetPerson]
) -> list[FloatArray]:
    """Return pans by a last layer trained on other people's directions of travel, and reflections."""
    classes = model.classes
    inputs: list[NDArray[np.floating]] = []
    labels: list[NDArray[np.int64]] = []
    for person in teachers:
        walks = np.flatnonzero(np.isfinite(person.travel))
        if len(walks):
            label = classes.index(person.travel[walks])
            inputs += hidden_both_ways(model, [person.images[k] for k in walks.tolist()])
            labels += [label, classes.reflected(label)]
    weight, bias = softmax_layer(np.concatenate(inputs), np.concatenate(labels), len(classes), penalty=0.1)
    found = [model.hidden(model.features(person.images)) @ weight + bias for person in people]
    return [classes.pan[scores.argmax(axis=1)] for scores in found]


def windows(track: Track, pan: FloatArray, camera: GroundCamera) -> list[tuple[Track, BoolArray]]:
    """Return copies of a track that end with a window of withheld positions each.

    Parameters
    ----------
    pan : (n,) of the head in the image frame. In a window it is converted to the world by the line of sight
        to the last position before it, since later positions are withheld.
    """
    found = []
    for begin in range(BEFORE, len(track) - HIDDEN + 1, APART):
        part, window = track[: begin + HIDDEN], np.arange(begin + HIDDEN) >= begin
        viewpoint = np.where(window[:, None], track.position[begin - 1], part.position)
        head = camera.world_angle(pan[: begin + HIDDEN], viewpoint)
        found.append((withhold(replace(part, head=head), window, ("position",)), window))
    return found


def _fitted(pairs: Sequence[tuple[Track, BoolArray]], kappa: float, evaluations: int) -> dict[str, Predictor]:
    """Return the methods by name, with the parameters of least error in these windows."""

    def best(make: Callable[..., Predictor], *start: float) -> Predictor:
        def error(*values: float) -> float:
            return float(np.mean(error_of(make(*values), pairs)))

        return make(*fit(error, start, evaluations=evaluations * len(start)))

    steered = model_of("joint-intentional")

    def graph(density: float, factor: float, rate: float) -> Predictor:
        model: Model = steered(density, factor, rate)
        likelihood = replace(model.parameters.likelihood, head_kappa=kappa)
        return hidden_only(model.with_parameters(replace(model.parameters, likelihood=likelihood)))

    found = {
        CONSTANT: best(kalman, 0.2),
        "intentional": best(intentional, 0.2, 0.5),
        "graph, joint-intentional": best(graph, 0.2, 1.0, 0.5),
    }
    own_filters = {name: in_steps(own) for name, own in OWN_FILTERS.items()}
    return found | {"Kalman filter of Baxter et al.": in_steps(None)} | own_filters


def occlusion_tables(
    folder: Path, model: DeepBelief, rng: np.random.Generator, *, quick: bool
) -> list[Table]:
    """Compute errors of the network's heads, and of prediction with them in withheld windows of two seconds.

    Parameters
    ----------
    folder : of Town Centre
    model : the package's network
    rng : source of the parts and of the intervals
    quick : fewer people, and a shorter search
    """
    people, camera = street_people(folder)
    people = people[:9] if quick else people
    part = rng.permutation(np.arange(len(people)) % PARTS)
    by_part = [[person for person, p in zip(people, part, strict=True) if p == k] for k in range(PARTS)]
    errors: dict[str, list[FloatArray]] = {heads: [] for heads in HEADS}
    squares: dict[tuple[str, str, str], list[float]] = {}
    for k in range(PARTS):
        judged, fitting, teaching = (by_part[(k + shift) % PARTS] for shift in range(PARTS))
        for heads in HEADS:
            both = [*fitting, *judged]
            pans = packaged_pans(model, both) if heads == HEADS[0] else pans_by_travel(model, both, teaching)
            off = [difference(pan, person.travel) for pan, person in zip(pans, both, strict=True)]
            errors[heads] += off[len(fitting) :]
            pairs = [windows(person.track, pan, camera) for person, pan in zip(both, pans, strict=True)]
            kappa = concentration(np.concatenate(off[: len(fitting)]))
            training = [pair for of in pairs[: len(fitting)] for pair in of]
            methods = _fitted(training, kappa, 4 if quick else 20)
            for visibility, hide in (("visible", False), ("hidden", True)):
                for of in pairs[len(fitting) :]:
                    shown = [(withhold(t, w, ("head",)), w) for t, w in of] if hide else of
                    for name, predictor in methods.items():
                        mean = float(np.mean(error_of(predictor, shown)))
                        squares.setdefault((heads, visibility, name), []).append(mean)
    sizes = np.concatenate([person.size for person in people])
    return [
        Table.of(
            "Heads of Town Centre against the direction of travel of those who walk",
            _heads_rows(errors, len(people), float(np.median(sizes))),
        ),
        Table.of(
            "Town Centre: error in windows of two seconds without a position, against constant velocity",
            _window_rows(squares, rng),
        ),
    ]


def concentration(error: FloatArray) -> float:
    """Return κ of angular errors (n,) with NaN, by the mean resultant length R: R(2 − R²)/(1 − R²)."""
    length = float(np.abs(np.nanmean(np.exp(1j * error))))
    return length * (2.0 - length**2) / max(1.0 - length**2, 1e-6)


def _heads_rows(errors: Mapping[str, Sequence[FloatArray]], people: int, size: float) -> Iterator[Row]:
    for heads, found in errors.items():
        off = np.degrees(np.abs(np.concatenate(found)))
        off = off[np.isfinite(off)]
        yield {
            "heads": heads,
            "people": people,
            "number": len(off),
            "head (pixels)": size,
            "mean error (°)": float(off.mean()),
            "median (°)": float(np.median(off)),
            "within 22.5° (%)": 100.0 * float((off < 22.5).mean()),
        }


def _window_rows(
    squares: Mapping[tuple[str, str, str], Sequence[float]], rng: np.random.Generator
) -> Iterator[Row]:
    for (heads, visibility, name), found in squares.items():
        own = np.array(found)
        base = np.array(squares[heads, visibility, CONSTANT])
        yield {
            "heads": heads,
            "in the window": visibility,
            "method": name,
            "people": len(own),
            "RMSE (m)": float(np.sqrt(own.mean())),
            **interval_cells("reduction %", bootstrap(reduction, own, base, rng=rng), scale=100.0),
            "people improved (%)": 100.0 * float((own < base).mean()),
        }
