"""Which candidate is the head in each frame of a track: temporal filtering of the places (Chen et al. 2011,
§2.2).

The paper asks for "a separate and simple temporal filtering on the head location candidates by enforcing a
head location smoothness over time", and does not say which.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from graphtrack.geometry.angles import FloatArray
from perception.pose.heads import HeadCandidates

_SMOOTHNESS = 2.0
"""Score that a step of one head height costs."""


class HeadPath:
    """The head of one person, chosen frame by frame from what came before and the frame itself.

    It is the last candidate of the path up to here that has the highest score and moves and grows least: the
    forward pass of the dynamic programming of `select_along_track`.

    Parameters
    ----------
    smoothness : score that a step of one head height costs
    """

    def __init__(self, smoothness: float = _SMOOTHNESS) -> None:
        self.smoothness = smoothness
        self._before: HeadCandidates | None = None
        self._best = np.empty(0)

    def update(self, candidates: HeadCandidates) -> int:
        """Take the candidates of the next frame, in coordinates in which the person stands still."""
        reached = 0.0
        if self._before is not None:
            reached = _through(self._best, self._before, candidates, self.smoothness).max(axis=1)
        self._before, self._best = candidates, reached + candidates.scores
        return int(self._best.argmax())


def select_so_far(
    candidates: Sequence[HeadCandidates], *, smoothness: float = _SMOOTHNESS
) -> NDArray[np.int64]:
    """Which candidate (n,) of each frame of a track, each chosen without the frames after it."""
    path = HeadPath(smoothness)
    return np.array([path.update(found) for found in candidates], np.int64)


def select_along_track(
    candidates: Sequence[HeadCandidates], *, smoothness: float = _SMOOTHNESS
) -> NDArray[np.int64]:
    """Which candidate (n,) of each frame of a track: the path of highest score that moves and grows least.

    Parameters
    ----------
    candidates : of each frame, in coordinates in which the person stands still (those of the crop)
    smoothness : score that a step of one head height costs

    Notes
    -----
    Dynamic programming over the candidates (Viterbi); the cost of a step is the distance of the boxes' four
    numbers over the head's height. A choice may change with every later frame.
    """
    best = candidates[0].scores
    back: list[NDArray[np.int64]] = []
    for before, after in pairwise(candidates):
        total = _through(best, before, after, smoothness)
        back.append(total.argmax(axis=1))
        best = total.max(axis=1) + after.scores
    path = [int(best.argmax())]
    for pointers in reversed(back):
        path.append(int(pointers[path[-1]]))
    return np.array(path[::-1])


def _through(
    best: FloatArray, before: HeadCandidates, after: HeadCandidates, smoothness: float
) -> FloatArray:
    """Scores (after, before) of the best paths to each candidate, by each of those of the frame before."""
    step = np.linalg.norm(after.boxes[:, None, :] - before.boxes[None, :, :], axis=2)
    return np.asarray(best - smoothness * step / np.maximum(after.boxes[:, 3], 1e-9)[:, None], float)
