"""Metrics of gaze probabilities against labels."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass

import numpy as np

from graphtrack.behaviour.attention import Attention
from graphtrack.behaviour.tables import LookLabels
from graphtrack.errors import InputError
from graphtrack.geometry.angles import BoolArray, FloatArray
from graphtrack.table.groups import UNLABELLED, IntArray

BINS = 15
"""Of probabilities, for calibration errors."""
LEAST = 1e-3
"""Lower bound of the probability of a look: labels have mistakes, too."""


@dataclass(frozen=True)
class LookScore:
    """Probabilities of looks beside the truth.

    Attributes
    ----------
    frames : of people, that are labelled
    right : share in which the likeliest target is the true one
    log_score : mean logarithm of the probability of the true target
    calibration_error : expected calibration error of the likeliest target (Naeini et al. 2015, 15 bins)
    target_calibration_error : that of all people and targets together
    """

    frames: int
    right: float
    log_score: float
    calibration_error: float
    target_calibration_error: float

    def shown(self) -> list[dict[str, object]]:
        """Rows of a table."""
        return [
            {
                "likeliest target right": self.right,
                "log score": self.log_score,
                "calibration error": self.calibration_error,
                "of all targets": self.target_calibration_error,
            }
        ]

    def to_dict(self) -> dict[str, object]:
        """For a JSON file."""
        return asdict(self)


def true_shares(
    found: Sequence[Attention], labels: LookLabels
) -> list[tuple[Attention, IntArray, BoolArray]]:
    """Of each person: the rows that are labelled, and which of the targets in each is true.

    Whoever is looked at from too far away is nothing of what could be known.
    """
    parts = []
    for one in found:
        target = labels.of(one.track_id, one.frame)
        rows = np.flatnonzero((target > UNLABELLED) & np.isfinite(one.probability[:, -1]))
        true = np.zeros((len(rows), one.probability.shape[1]), dtype=bool)
        people = np.array(one.people, dtype=np.int64)
        true[:, : len(people)] = target[rows, None] == people
        true[:, -1] = ~true[:, : len(people)].any(axis=1)
        parts.append((one, rows, true))
    return parts


def score_looks(
    found: Sequence[Attention], labels: LookLabels, span: tuple[float, float] = (-np.inf, np.inf)
) -> LookScore:
    """Judge looks in the frames that are labelled, from a time to another.

    Raises
    ------
    InputError
        Where no look is labelled.
    """
    p, y, top, hit = [], [], [], []
    for one, rows, true in true_shares(found, labels):
        within = (one.t[rows] > span[0]) & (one.t[rows] <= span[1])
        share, is_true = one.probability[rows[within]], true[within]
        p.append(share.ravel())
        y.append(is_true.ravel())
        top.append(share.max(axis=1))
        hit.append(is_true[np.arange(len(share)), share.argmax(axis=1)])
    if not sum(map(len, top)):
        raise InputError("no frame with labelled looks", "people and frames of the tracks", path=labels.path)
    shares, truth, surest, right = (np.concatenate(one) for one in (p, y, top, hit))
    logs = np.log(np.maximum(shares[truth], LEAST))
    return LookScore(
        len(surest),
        float(right.mean()),
        float(logs.mean()),
        calibration_error(surest, right),
        calibration_error(shares, truth),
    )


def calibration_error(probability: FloatArray, true: BoolArray) -> float:
    """Mean difference of a probability (n,) and of how often what it is of is true (n,), over `BINS`."""
    bins = np.minimum((BINS * probability).astype(int), BINS - 1)
    off = np.bincount(bins, probability, BINS) - np.bincount(bins, true.astype(float), BINS)
    return float(np.abs(off).sum() / len(probability))
