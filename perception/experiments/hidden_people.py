"""Classes of bodies and heads that are partly hidden, and the outlier share that grows with it.

Chen et al. (2011, §5) name wrong estimates due to occlusion as future work.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.special import log_softmax

from graphtrack.evaluation.metrics import bootstrap
from graphtrack.experiments.harness import Cell, Progress, Table, interval_cells
from graphtrack.geometry.angles import FloatArray, difference
from graphtrack.geometry.camera import GroundCamera
from graphtrack.io.formats.caviar import lobby_camera
from perception.adaptation.directions import CLASSES
from perception.adaptation.labels import patches_in, walking_labels
from perception.adaptation.learning import PackageModels, Recording, adapted
from perception.detection.boxes import PersonBox
from perception.evaluation.adapted_cameras import RATE, ignored, no_progress, sequences_of
from perception.experiments.street_heads import labelled_runs
from perception.ground.upright import LeaningView
from perception.observation.hidden import hidden_shares

EDGES = (0.0, 0.02, 0.2, 0.4, 0.6, 1.0)
"""Ends of the ranges of hidden shares that are tabulated."""
_FOLDS = 2
_FEWEST_FRAMES = 4
_NAMES = ("body", "head")


@dataclass(frozen=True, eq=False)
class Classified:
    """Classes of walking people who had no part in the models.

    Attributes
    ----------
    name : of the recording
    log_likelihood : (n, 2, 8) of the classes of body and head, image frame
    angle : (n,) direction of travel in the image frame, radians
    hidden : (n, 2) hidden shares of body and head, 0…1
    person : (n,) numbers
    """

    name: str
    log_likelihood: FloatArray
    angle: FloatArray
    hidden: FloatArray
    person: NDArray[np.int64]

    @property
    def probability(self) -> FloatArray:
        """(n, 2) probability of the class of the direction of travel."""
        of_class = np.exp(log_softmax(self.log_likelihood, axis=2))
        return np.asarray(of_class[np.arange(len(self.angle)), :, CLASSES.index(self.angle)])

    @property
    def error(self) -> FloatArray:
        """(n, 2) error of the mean direction, radians."""
        mean = [CLASSES.mean_pan(self.log_likelihood[:, k]) for k in range(2)]
        return np.asarray(np.abs(difference(np.column_stack(mean), self.angle[:, None])))


def street(folder: Path, seed: int, progress: Progress) -> Classified:
    """Return Town Centre's first minute: half of the walkers by models fitted to the other half, twice."""
    frames, camera, runs = labelled_runs(folder, _FEWEST_FRAMES)
    people = [
        PersonBox(int(number), person, tuple(box))
        for person, numbers, boxes in runs
        for number, box in zip(numbers.tolist(), boxes.tolist(), strict=True)
    ]
    rng = np.random.default_rng(seed)
    numbers = rng.permutation(np.unique([item.track_id for item in people]))
    parts = [set(numbers[k::_FOLDS].tolist()) for k in range(_FOLDS)]
    recordings = [
        Recording(frames, [item for item in people if item.track_id in part], RATE) for part in parts
    ]
    found = []
    for one in recordings:
        rest = [other for other in recordings if other is not one]
        found.append(_of(one, rest, people, camera, seed))
        progress(1)
    return _joined("Town Centre", found)


def lobby(folder: Path, seed: int, progress: Progress) -> Classified:
    """Return CAVIAR's lobby: each sequence by models fitted to the others."""
    sequences = sequences_of(folder)
    found = []
    for k, one in enumerate(sequences):
        rest = [other.recording for other in sequences if other is not one]
        found.append(_of(one.recording, rest, one.recording.people, lobby_camera(), seed, offset=1000 * k))
        progress(1)
    return _joined("CAVIAR's lobby", found)


def _joined(name: str, parts: Sequence[Classified]) -> Classified:
    names = "log_likelihood", "angle", "hidden", "person"
    return Classified(name, *(np.concatenate([getattr(one, key) for one in parts]) for key in names))


def _of(
    judged: Recording,
    training: Sequence[Recording],
    everybody: Sequence[PersonBox],
    camera: GroundCamera,
    seed: int,
    *,
    offset: int = 0,
) -> Classified:
    """Classify the walkers of a recording by models fitted to others.

    Parameters
    ----------
    everybody : all boxes of the judged frames: they may hide the walkers
    offset : of the numbers of people
    """
    package, rng = PackageModels.load(), np.random.default_rng(seed)
    models = adapted(training, camera, package, rng, no_progress, ignored).models
    size = judged.frames.size()
    view = LeaningView.of(camera, size)
    labels = walking_labels(judged.people, None, camera, judged.clock, view=view)
    chosen = [judged.people[k] for k in labels.box.tolist()]
    wanted = {item.frame for item in chosen}
    patches = patches_in(judged.frames.where(wanted.__contains__), chosen, ignored, view)
    rows = sorted(patches)
    answers = models.look_at([patches[k] for k in rows], [chosen[k].box for k in rows])
    of_frame: dict[int, list[PersonBox]] = {}
    for item in everybody:
        of_frame.setdefault(item.frame, []).append(item)
    share: dict[tuple[int, int], FloatArray] = {}
    for frame in wanted:
        there = of_frame[frame]
        shares = hidden_shares([item.box for item in there], size)
        share |= {(frame, item.track_id): one for item, one in zip(there, shares, strict=True)}
    return Classified(
        "",
        np.array([[body, head[0]] for body, _, head in answers]),
        labels.angle[rows],
        np.array([share[chosen[k].frame, chosen[k].track_id] for k in rows]),
        labels.person[rows] + offset,
    )


def tables(found: Sequence[Classified], rng: np.random.Generator) -> tuple[Table, Table]:
    """Errors by hidden share, and the gain of an outlier share that grows with it, on other people."""
    return (
        Table.of("Error of the classes by hidden share", [row for one in found for row in _errors(one, rng)]),
        Table.of(
            "Outlier share that grows with the hidden share: log-likelihood of other people",
            [row for one in found for row in _gains(one, rng)],
        ),
    )


def _errors(one: Classified, rng: np.random.Generator) -> Iterator[dict[str, Cell]]:
    for k, name in enumerate(_NAMES):
        hidden, error = one.hidden[:, k], np.degrees(one.error[:, k])
        for low, high in pairwise(EDGES):
            rows = np.flatnonzero((hidden >= low) & (hidden < high) | (hidden == high) & (high == 1.0))
            if not len(rows):
                continue
            units = one.person[rows].tolist()
            interval = bootstrap(lambda v: v.mean(axis=-1), error[rows], rng=rng, units=units)
            yield {
                "recording": one.name,
                "of": name,
                "hidden": f"{low:.0%}–{high:.0%}".replace("%", " %"),
                "boxes": len(rows),
                "people": len(set(units)),
                **interval_cells("mean error (°)", interval),
                "more than 90° off (%)": 100.0 * float(np.mean(error[rows] > 90.0)),
            }


def fitted_shares(probability: FloatArray, hidden: FloatArray, *, grows: bool) -> tuple[float, float]:
    """Return ε and g of the outlier share 1 − (1 − ε)·(1 − g·h) of maximum likelihood.

    Parameters
    ----------
    probability : (n,) of the true class
    hidden : (n,) shares h
    grows : whether g is fitted; else it is 0
    """

    def loss(point: FloatArray) -> float:
        return -float(_logs(probability, hidden, point[0], point[1] if grows else 0.0).mean())

    bounds = [(0.0, 0.98), (0.0, 1.0)]
    share, gain = minimize(loss, [0.1, 0.3], method="L-BFGS-B", bounds=bounds).x
    return float(share), float(gain) if grows else 0.0


def _logs(probability: FloatArray, hidden: FloatArray, share: float, gain: float) -> FloatArray:
    informed = (1.0 - share) * (1.0 - gain * hidden)
    return np.asarray(np.log(informed * probability + (1.0 - informed) / len(CLASSES)))


def _gains(one: Classified, rng: np.random.Generator) -> Iterator[dict[str, Cell]]:
    people = rng.permutation(np.unique(one.person))
    half = np.isin(one.person, people[::2])
    for k, name in enumerate(_NAMES):
        probability, hidden = one.probability[:, k], one.hidden[:, k]
        gain = np.empty(len(probability))
        weights, shares = [], []
        for mine in (half, ~half):
            logs = []
            for grows in (True, False):
                share, weight = fitted_shares(probability[~mine], hidden[~mine], grows=grows)
                logs.append(_logs(probability[mine], hidden[mine], share, weight))
                if grows:
                    weights.append(weight)
                    shares.append(share)
            gain[mine] = logs[0] - logs[1]
        some = hidden > EDGES[1]
        units = one.person[some].tolist()
        interval = bootstrap(lambda v: v.mean(axis=-1), gain[some], rng=rng, units=units)
        yield {
            "recording": one.name,
            "of": name,
            "hidden boxes": int(some.sum()),
            "people": len(set(units)),
            "ε": float(np.mean(shares)),
            "g": float(np.mean(weights)),
            **interval_cells("gain (nats a hidden box)", interval),
        }
