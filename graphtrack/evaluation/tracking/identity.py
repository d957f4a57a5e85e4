"""IDF1: how many rows one lasting pairing of true people and tracks gets right.

Ristani, Solera, Zou, Cucchiara and Tomasi, *Performance measures and a data set for multi-target,
multi-camera tracking*, ECCV workshops 2016, section 3.2: true and computed trajectories are paired once,
for the whole sequence, and
IDP = IDTP / (IDTP + IDFP), IDR = IDTP / (IDTP + IDFN), IDF1 = 2·IDTP / (2·IDTP + IDFP + IDFN).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import linear_sum_assignment

from graphtrack.evaluation.tracking.similarity import SharedFrames, Summed


@dataclass(frozen=True)
class IdentityCounts(Summed):
    """Rows of the truth and of the estimates under the best pairing: IDTP, IDFN, IDFP."""

    true_positives: int
    misses: int
    false_positives: int

    @property
    def idp(self) -> float:
        """The share of the estimates that is paired rightly."""
        return self.true_positives / max(1, self.true_positives + self.false_positives)

    @property
    def idr(self) -> float:
        """The share of the truth that is paired rightly."""
        return self.true_positives / max(1, self.true_positives + self.misses)

    @property
    def idf1(self) -> float:
        """The harmonic mean of both."""
        wrong = self.misses + self.false_positives
        return 2 * self.true_positives / max(1, 2 * self.true_positives + wrong)


def identity_counts(frames: SharedFrames, threshold: float) -> IdentityCounts:
    """Pair every true person with one track at most, for the whole sequence, and count.

    Pairs with as few misses and false positives as possible have as many rows in common as
    possible: each such row is one of either less.

    Parameters
    ----------
    threshold : similarity from which on two rows can be the same person's
    """
    common = np.zeros((len(frames.truth_rows), len(frames.estimate_rows)), dtype=np.int64)
    for truth, estimates, similarity in zip(frames.truth, frames.estimates, frames.similarity, strict=True):
        close = np.nonzero(similarity >= threshold)
        common[truth[close[0]], estimates[close[1]]] += 1
    paired = int(common[linear_sum_assignment(common, maximize=True)].sum())
    return IdentityCounts(
        paired, int(frames.truth_rows.sum()) - paired, int(frames.estimate_rows.sum()) - paired
    )
