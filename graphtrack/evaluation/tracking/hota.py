"""HOTA: detection and association in one figure, over all demands on how close a match has to be.

Luiten, Ošep, Dendorfer, Torr, Geiger, Leal-Taixé and Leibe, *HOTA: a higher order metric for evaluating
multi-object tracking*, International Journal of Computer Vision 129, 2021, section 5: at one α

    HOTA = √(Σ_c A(c) / (TP + FN + FP)),    A(c) = TPA(c) / (TPA(c) + FNA(c) + FPA(c)),

over the matches c, where TPA(c) counts the frames in which the same two are matched, FNA(c) and FPA(c) the
other rows of the true person and of the track. With DetA = TP / (TP + FN + FP) and AssA the mean of A(c) it
is √(DetA·AssA). The figure is the mean over α.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import linear_sum_assignment

from graphtrack.evaluation.tracking.detections import IntArray
from graphtrack.evaluation.tracking.similarity import EPSILON, SharedFrames, Summed
from graphtrack.geometry.angles import FloatArray

ALPHAS = np.arange(0.05, 0.99, 0.05)
"""(19,) the similarities from which on two rows can be matched: α = 0.05, 0.1 … 0.95."""


@dataclass(frozen=True, eq=False)
class HotaCounts(Summed):
    """Sums over the rows, (19,) each, one a value of `ALPHAS`.

    Attributes
    ----------
    matches, misses, false_positives : TP, FN, FP
    association, association_recall, association_precision : sums over the matches of A(c), and of
        it without FPA(c) or without FNA(c)
    similarity : sum over the matches
    """

    matches: FloatArray
    misses: FloatArray
    false_positives: FloatArray
    association: FloatArray
    association_recall: FloatArray
    association_precision: FloatArray
    similarity: FloatArray

    def curves(self) -> dict[str, FloatArray]:
        """The figures at each α, (19,) each: HOTA, DetA, AssA and what they are made of, and LocA."""
        matches = np.maximum(1.0, self.matches)
        rows = self.matches + self.misses
        detection = self.matches / np.maximum(1.0, rows + self.false_positives)
        association = self.association / matches
        return {
            "HOTA": np.sqrt(detection * association),
            "DetA": detection,
            "AssA": association,
            "DetRe": self.matches / np.maximum(1.0, rows),
            "DetPr": self.matches / np.maximum(1.0, self.matches + self.false_positives),
            "AssRe": self.association_recall / matches,
            "AssPr": self.association_precision / matches,
            # Where nothing is matched, nothing is off.
            "LocA": np.where(self.matches > 0.0, self.similarity / matches, 1.0),
        }


def hota_counts(frames: SharedFrames) -> HotaCounts:
    """Match truth and estimates, so that people stay with their tracks, and sum up for every α."""
    truth, estimates, similarity = _matches(frames)
    sums = [_sums(frames, truth, estimates, similarity, alpha) for alpha in ALPHAS]
    matches, *rest = np.array(sums).T
    misses, false_positives = frames.truth_rows.sum() - matches, frames.estimate_rows.sum() - matches
    return HotaCounts(matches, misses, false_positives, *rest)


def _matches(frames: SharedFrames) -> tuple[IntArray, IntArray, FloatArray]:
    """True person, track and similarity of everything that is matched at the lowest α, (k,) each.

    In each frame the sum of similarities is highest, each weighted by how alike the two are over the whole
    sequence: with the one matching for all α that TrackEval makes of it.
    """
    alike = _alike(frames)
    found = []
    for truth, estimates, similarity in zip(frames.truth, frames.estimates, frames.similarity, strict=True):
        rows, columns = linear_sum_assignment(alike[np.ix_(truth, estimates)] * similarity, maximize=True)
        found.append((truth[rows], estimates[columns], similarity[rows, columns]))
    true_person, track, close = (np.concatenate(parts) for parts in zip(*found, strict=True))
    return true_person, track, close


def _alike(frames: SharedFrames) -> FloatArray:
    """Similarity of true people and tracks over the whole sequence, (people, tracks), from 0 to 1.

    The rows that they may have in common over the rows of both. In a frame a pair counts by its similarity
    over all similarities of either of them, so that a crowd gives nobody more than one row.
    """
    common = np.zeros((len(frames.truth_rows), len(frames.estimate_rows)))
    for truth, estimates, similarity in zip(frames.truth, frames.estimates, frames.similarity, strict=True):
        either = similarity.sum(axis=0) + similarity.sum(axis=1)[:, None] - similarity
        share = np.divide(similarity, either, out=np.zeros_like(either), where=either > EPSILON)
        common[np.ix_(truth, estimates)] += share
    return common / (frames.truth_rows[:, None] + frames.estimate_rows - common)


def _sums(
    frames: SharedFrames, truth: IntArray, estimates: IntArray, similarity: FloatArray, alpha: float
) -> tuple[float, ...]:
    """Number of matches at one α, and the sums of `HotaCounts` over them."""
    close = similarity >= alpha - EPSILON
    pair, rows = np.unique(truth[close] * len(frames.estimate_rows) + estimates[close], return_counts=True)
    person, track = np.divmod(pair, max(1, len(frames.estimate_rows)))
    of_person, of_track = frames.truth_rows[person], frames.estimate_rows[track]
    return (
        float(rows.sum()),
        float(np.sum(rows * rows / (of_person + of_track - rows))),
        float(np.sum(rows * rows / of_person)),
        float(np.sum(rows * rows / of_track)),
        float(similarity[close].sum()),
    )
