"""Scores of groups, as in the literature of F-formations, and of gaze, given labels."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from itertools import pairwise

import numpy as np

from graphtrack.errors import InputError
from graphtrack.geometry.angles import BoolArray, FloatArray
from graphtrack.interaction.attention import Attention
from graphtrack.interaction.group_files import UNLABELLED, IntArray
from graphtrack.interaction.tables import LookLabels
from graphtrack.tracks.display import listed

Group = frozenset[int]

BINS = 15
"""Number of probability bins for calibration errors."""
LEAST = 1e-3
"""Smallest probability of a gaze target in the log score, since labels have errors."""


@dataclass(frozen=True)
class GroupScore:
    """Scores of groups against the truth, averaged over frames.

    Attributes
    ----------
    frames : number of labelled frames
    precision, recall, f1 : share of the estimated and of the true groups that match, and their harmonic mean;
        a match has at least ⌈T·n⌉ of the n members of a true group and at most ⌈(1 − T)·n⌉ other people
        (Setti et al. 2015);
        first at T = 2/3, then at T = 1
    pair_precision, pair_recall, pair_f1 : scores of pairs that share a group, over all frames
    """

    frames: int
    precision: tuple[float, float]
    recall: tuple[float, float]
    f1: tuple[float, float]
    pair_precision: float
    pair_recall: float
    pair_f1: float

    def shown(self) -> list[dict[str, object]]:
        """Return the rows of a table."""
        names = ("groups, two thirds of the members", "groups, all of the members", "pairs")
        precision, recall = (*self.precision, self.pair_precision), (*self.recall, self.pair_recall)
        rows = zip(names, precision, recall, (*self.f1, self.pair_f1), strict=True)
        return [{"": name, "precision": p, "recall": r, "F1": f} for name, p, r, f in rows]

    def to_dict(self) -> dict[str, object]:
        """For a JSON file."""
        return {
            "frames": self.frames,
            "t_two_thirds": _named(self.precision[0], self.recall[0], self.f1[0]),
            "t_one": _named(self.precision[1], self.recall[1], self.f1[1]),
            "pairs": _named(self.pair_precision, self.pair_recall, self.pair_f1),
        }


def matches(estimated: Sequence[Group], true: Sequence[Group], share: float) -> int:
    """Return the number of true groups matched one-to-one by estimated groups."""
    left, count = list(estimated), 0
    for group in true:
        need = math.ceil(share * len(group) - 1e-9)
        most = math.ceil((1.0 - share) * len(group) - 1e-9)
        for place, one in enumerate(left):
            if len(group & one) >= need and len(one - group) <= most:
                del left[place]
                count += 1
                break
    return count


def score_groups(frame: IntArray, track_id: IntArray, estimated: IntArray, true: IntArray) -> GroupScore:
    """Score groups in the labelled frames.

    Parameters
    ----------
    frame, track_id : (n,) of the rows
    estimated, true : (n,) group numbers within a frame, −1 for people alone; `UNLABELLED` if unknown
    """
    used = true != UNLABELLED
    order = np.flatnonzero(used)[np.argsort(frame[used], kind="stable")]
    edges = np.flatnonzero(np.diff(frame[order], prepend=np.nan, append=np.nan))
    shares = (2.0 / 3.0, 1.0)
    precision, recall = [], []
    pairs = np.zeros(3)
    for start, stop in pairwise(edges):
        rows = order[start:stop]
        found, known = (_groups(track_id[rows], labels[rows]) for labels in (estimated, true))
        hits = [matches(found, known, share) for share in shares]
        precision.append([hit / len(found) if found else float(not known) for hit in hits])
        recall.append([hit / len(known) if known else 1.0 for hit in hits])
        pairs += _pairs(found, known)
    mean_precision, mean_recall = (np.mean(values, axis=0) for values in (precision, recall))
    both, of_found, of_known = pairs
    pair = (both / of_found if of_found else 1.0, both / of_known if of_known else 1.0)
    return GroupScore(
        len(precision),
        (float(mean_precision[0]), float(mean_precision[1])),
        (float(mean_recall[0]), float(mean_recall[1])),
        tuple(_f1(p, r) for p, r in zip(mean_precision, mean_recall, strict=True)),  # type: ignore[arg-type]
        float(pair[0]),
        float(pair[1]),
        _f1(*pair),
    )


def _named(precision: float, recall: float, f1: float) -> dict[str, float]:
    return {"precision": precision, "recall": recall, "f1": f1}


def _f1(precision: float, recall: float) -> float:
    total = precision + recall
    return float(2.0 * precision * recall / total) if total > 0.0 else 0.0


def _groups(person: IntArray, label: IntArray) -> list[Group]:
    members: dict[int, set[int]] = {}
    for one, number in zip(person.tolist(), label.tolist(), strict=True):
        if number >= 0:
            members.setdefault(number, set()).add(one)
    return [frozenset(group) for group in members.values() if len(group) > 1]


def _pairs(found: Sequence[Group], known: Sequence[Group]) -> tuple[int, int, int]:
    both = sum(math.comb(len(one & other), 2) for one in found for other in known)
    return both, sum(math.comb(len(g), 2) for g in found), sum(math.comb(len(g), 2) for g in known)


@dataclass(frozen=True)
class LookScore:
    """Scores of gaze probabilities against the truth."""

    frames: int  # labelled person-frames
    right: float  # share with the true target as most probable target
    log_score: float  # mean logarithm of the probability of the true target
    # expected calibration error of the most probable target (Naeini et al. 2015, 15 bins)
    calibration_error: float
    target_calibration_error: float  # the same over all people and targets

    def shown(self) -> list[dict[str, object]]:
        """Return the rows of a table."""
        return [
            {
                "most probable target correct": self.right,
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
    """Return the labelled rows of each person, and the index of the true target in each.

    A target beyond the largest distance counts as no target.

    Raises
    ------
    InputError
        For a labelled place that is none of the gaze targets.
    """
    parts = []
    known = {name for one in found for name in one.places}
    if unknown := [name for name in labels.places if name not in known]:
        there = f"; the places are {listed(sorted(known))}" if known else ""
        expected = f"a person, a place or nobody{there}"
        raise InputError(f"the gaze target {unknown[0]!r}", expected, path=labels.path)
    for one in found:
        target = labels.of(one.track_id, one.frame)
        rows = np.flatnonzero((target != UNLABELLED) & np.isfinite(one.probability[:, -1]))
        true = np.zeros((len(rows), one.probability.shape[1]), dtype=bool)
        people = np.array(one.people, dtype=np.int64)
        true[:, : len(people)] = target[rows, None] == people
        for k, name in enumerate(labels.places):
            if name in one.places:
                true[:, len(people) + one.places.index(name)] = target[rows] == UNLABELLED - 1 - k
        true[:, -1] = ~true[:, :-1].any(axis=1)
        parts.append((one, rows, true))
    return parts


def score_gaze(
    found: Sequence[Attention], labels: LookLabels, span: tuple[float, float] = (-np.inf, np.inf)
) -> LookScore:
    """Score gaze in the labelled frames of a time interval.

    Raise InputError without labelled gaze.
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
    """Return the mean difference of probability (n,) and observed frequency (n,), over `BINS`."""
    bins = np.minimum((BINS * probability).astype(int), BINS - 1)
    off = np.bincount(bins, probability, BINS) - np.bincount(bins, true.astype(float), BINS)
    return float(np.abs(off).sum() / len(probability))
