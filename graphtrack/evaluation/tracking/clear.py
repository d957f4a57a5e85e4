"""CLEAR MOT: misses, false positives, switches of identity and fragmentations, frame by frame.

Bernardin and Stiefelhagen, *Evaluating multiple object tracking performance: the CLEAR MOT metrics*, EURASIP
Journal on Image and Video Processing 2008, section 2; mostly tracked, mostly lost and fragmentations as in
Li, Huang and Nevatia, *Learning to associate*, CVPR 2009. Where those leave something open, it is as in
TrackEval, so that figures can be compared.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.optimize import linear_sum_assignment

from graphtrack.evaluation.tracking.detections import IntArray
from graphtrack.evaluation.tracking.similarity import EPSILON, SharedFrames, Summed
from graphtrack.geometry.angles import BoolArray, FloatArray

MOSTLY_TRACKED, MOSTLY_LOST = 0.8, 0.2
"""More than this share of somebody's rows is found, or less."""

KEEPING = 1000.0
"""Worth of a pair that stays together; more than all similarities of a frame."""

NOBODY = -1


@dataclass(frozen=True)
class ClearCounts(Summed):
    """Counts of CLEAR MOT.

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


@dataclass(frozen=True, eq=False)
class FrameMatches:
    """Matches in a frame that has both truth and estimates, k pairs.

    Attributes
    ----------
    frame : its place among the shared frames
    truth, estimates : (k,) people and tracks, numbered as in `SharedFrames`
    similarity : (k,)
    before : (k,) the track that each of these people was matched with last; `NOBODY` at their first match
    lost : (k,) whether they were without a match in the frame before that had both
    """

    frame: int
    truth: IntArray
    estimates: IntArray
    similarity: FloatArray
    before: IntArray
    lost: BoolArray

    @property
    def switched(self) -> BoolArray:
        """(k,) whether another track has them than the last time."""
        return (self.before != NOBODY) & (self.before != self.estimates)

    @property
    def found_again(self) -> BoolArray:
        """(k,) whether they had been lost, which ends a fragmentation."""
        return (self.before != NOBODY) & self.lost


def clear_matches(frames: SharedFrames, threshold: float) -> Iterator[FrameMatches]:
    """Match truth and estimates frame by frame.

    Parameters
    ----------
    threshold : similarity from which on two rows can be matched
    """
    last = np.full(len(frames.truth_rows), NOBODY, dtype=np.int64)
    now = last.copy()
    every = zip(frames.truth, frames.estimates, frames.similarity, strict=True)
    for k, (truth, estimates, similarity) in enumerate(every):
        # As in TrackEval a frame without any truth or any estimates ends no stretch.
        if not similarity.size:
            continue
        rows, columns = _matched(similarity, estimates == now[truth][:, None], threshold)
        people, tracks = truth[rows], estimates[columns]
        yield FrameMatches(k, people, tracks, similarity[rows, columns], last[people], now[people] == NOBODY)
        now[:] = NOBODY
        last[people] = now[people] = tracks


def clear_counts(frames: SharedFrames, threshold: float) -> ClearCounts:
    """Match truth and estimates frame by frame, and count.

    Parameters
    ----------
    threshold : similarity from which on two rows can be matched
    """
    found = np.zeros(len(frames.truth_rows), dtype=np.int64)
    matches, switches, fragmentations, total = 0, 0, 0, 0.0
    for matched in clear_matches(frames, threshold):
        matches += len(matched.truth)
        switches += int(np.count_nonzero(matched.switched))
        fragmentations += int(np.count_nonzero(matched.found_again))
        total += float(matched.similarity.sum())
        found[matched.truth] += 1
    share = found / frames.truth_rows
    tracked, lost = (int(np.count_nonzero(some)) for some in (share > MOSTLY_TRACKED, share < MOSTLY_LOST))
    n_people = len(frames.truth_rows)
    return ClearCounts(
        matches=matches,
        misses=int(frames.truth_rows.sum()) - matches,
        false_positives=int(frames.estimate_rows.sum()) - matches,
        switches=switches,
        fragmentations=fragmentations,
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
