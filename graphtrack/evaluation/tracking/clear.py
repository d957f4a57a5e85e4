"""CLEAR MOT: misses, false positives, switches of identity and fragmentations, frame by frame.

Bernardin and Stiefelhagen, *Evaluating multiple object tracking performance: the CLEAR MOT metrics*, EURASIP
Journal on Image and Video Processing 2008, section 2; mostly tracked, mostly lost and fragmentations as in
Li, Huang and Nevatia, *Learning to associate*, CVPR 2009. Where those leave something open, it is as in
TrackEval, so that figures can be compared.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from scipy.optimize import linear_sum_assignment

from graphtrack.evaluation.tracking.detections import IntArray
from graphtrack.evaluation.tracking.similarity import EPSILON, SharedFrames
from graphtrack.geometry.angles import BoolArray, FloatArray

MOSTLY_TRACKED, MOSTLY_LOST = 0.8, 0.2
"""More than this share of somebody's rows is found, or less."""

KEEPING = 1000.0
"""Worth of a pair that stays together; more than all similarities of a frame."""

NOBODY = -1


@dataclass(frozen=True)
class ClearCounts:
    """What was counted.

    Attributes
    ----------
    matches, misses, false_positives : rows
    switches : rows of the truth matched to another track than the last time they were matched
    fragmentations : times that somebody is found again after having been lost
    mostly_tracked, partly_tracked, mostly_lost : people
    similarity : sum over the matches
    """

    matches: int
    misses: int
    false_positives: int
    switches: int
    fragmentations: int
    mostly_tracked: int
    partly_tracked: int
    mostly_lost: int
    similarity: float

    def __add__(self, other: ClearCounts) -> ClearCounts:
        return ClearCounts(*(getattr(self, f.name) + getattr(other, f.name) for f in fields(self)))

    @property
    def mota(self) -> float:
        """1 − (misses + false positives + switches) / rows of the truth; below zero where many are wrong."""
        wrong = self.false_positives + self.switches
        return (self.matches - wrong) / max(1, self.matches + self.misses)

    @property
    def motp(self) -> float:
        """The mean similarity of the matches; 0 without any."""
        return self.similarity / max(1, self.matches)

    @property
    def recall(self) -> float:
        """The share of the truth that is matched."""
        return self.matches / max(1, self.matches + self.misses)

    @property
    def precision(self) -> float:
        """The share of the estimates that is matched."""
        return self.matches / max(1, self.matches + self.false_positives)


@dataclass(eq=False)
class _People:
    """What is remembered of each true person, (n,) each, from frame to frame.

    Attributes
    ----------
    last : track of the last match, however long ago
    now : track of the match in the last frame that had both truth and estimates
    found : frames with a match
    stretches : times that a stretch of matches began
    """

    last: IntArray
    now: IntArray
    found: IntArray
    stretches: IntArray

    @classmethod
    def unseen(cls, count: int) -> _People:
        nobody, zero = np.full(count, NOBODY, dtype=np.int64), np.zeros(count, dtype=np.int64)
        return cls(nobody, nobody.copy(), zero, zero.copy())

    def see(self, truth: IntArray, estimates: IntArray) -> int:
        """Remember the matches of a frame, and say how many of them are switches."""
        before = self.last[truth]
        switches = int(np.count_nonzero((before != NOBODY) & (before != estimates)))
        self.last[truth] = estimates
        was_lost = self.now == NOBODY
        self.now[:] = NOBODY
        self.now[truth] = estimates
        self.found[truth] += 1
        self.stretches += was_lost & (self.now != NOBODY)
        return switches


def clear_counts(frames: SharedFrames, threshold: float) -> ClearCounts:
    """Match truth and estimates frame by frame, and count.

    Parameters
    ----------
    threshold : similarity from which on two rows can be matched
    """
    people = _People.unseen(len(frames.truth_rows))
    matches, switches, total = 0, 0, 0.0
    for truth, estimates, similarity in zip(frames.truth, frames.estimates, frames.similarity, strict=True):
        # As in TrackEval a frame without any truth or any estimates ends no stretch.
        if not similarity.size:
            continue
        rows, columns = _matched(similarity, estimates == people.now[truth][:, None], threshold)
        switches += people.see(truth[rows], estimates[columns])
        matches += len(rows)
        total += float(similarity[rows, columns].sum())
    tracked, lost = _mostly(people.found / frames.truth_rows)
    n_people = len(frames.truth_rows)
    return ClearCounts(
        matches=matches,
        misses=int(frames.truth_rows.sum()) - matches,
        false_positives=int(frames.estimate_rows.sum()) - matches,
        switches=switches,
        fragmentations=int(np.maximum(people.stretches - 1, 0).sum()),
        mostly_tracked=tracked,
        partly_tracked=n_people - tracked - lost,
        mostly_lost=lost,
        similarity=total,
    )


def _matched(similarity: FloatArray, kept: BoolArray, threshold: float) -> tuple[IntArray, IntArray]:
    """Rows and columns of the matches: pairs of the frame before are kept, then similarity is highest."""
    worth = np.where(similarity >= threshold - EPSILON, KEEPING * kept + similarity, 0.0)
    rows, columns = linear_sum_assignment(worth, maximize=True)
    matched = worth[rows, columns] > EPSILON
    return rows[matched], columns[matched]


def _mostly(share: FloatArray) -> tuple[int, int]:
    """How many people are mostly tracked, and how many mostly lost, by the share of their rows found."""
    return int(np.count_nonzero(share > MOSTLY_TRACKED)), int(np.count_nonzero(share < MOSTLY_LOST))
