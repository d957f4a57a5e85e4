"""Boosted detectors of heads, by two directions of a block or by its Fisher discriminant (Chen et al. 2011,
§2.2)."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
from numba import njit
from numpy.typing import NDArray

from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray
from perception.pose.boosting import Quantised, reweighted
from perception.pose.features.blocks import block_corners, grid_lines
from perception.pose.features.hog import BINS

Weak = Literal["differential", "fisher"]

_PAIRS = np.array([(a, b) for a in range(BINS) for b in range(a + 1, BINS)])
_RENEWED = 25
"""Rounds after which the Fisher discriminants are learned anew with the weights of then."""


class BoostedBlocks:
    """H(p) = Σ_t α_t · sign(c_t · f_l(t)(p) − σ_t) over blocks l of 9 gradient directions each.

    A differential weak classifier compares two directions: c_t has one +1 and one −1 (eq. 1). A Fisher one
    weighs all nine.

    Attributes
    ----------
    block : (t,) index of the block; direction : (t, 9) c; threshold : (t,) σ; weight : (t,) α
    """

    def __init__(
        self, block: NDArray[Any], direction: NDArray[Any], threshold: NDArray[Any], weight: NDArray[Any]
    ) -> None:
        self.block = np.asarray(block, np.int64)
        self.direction = np.asarray(direction, np.float32)
        self.threshold, self.weight = np.asarray(threshold, np.float32), np.asarray(weight, np.float32)

    @classmethod
    def fit(
        cls, histograms: NDArray[np.float32], labels: NDArray[np.int64], weak: Weak, *, rounds: int = 500
    ) -> BoostedBlocks:
        """Learn from block histograms (n, 441, 9) and labels (n,) of −1 or +1.

        Raises
        ------
        InputError
            If there is only one kind of label, or no such weak classifier.
        """
        if set(np.unique(labels)) != {-1, 1}:
            raise InputError("windows of one kind", "windows with and without heads, labelled 1 and -1")
        if weak not in ("differential", "fisher"):
            raise InputError(f"weak classifiers {weak!r}", "'differential' or 'fisher'")
        n = len(labels)
        weights = np.where(labels > 0, 0.5 / np.sum(labels > 0), 0.5 / np.sum(labels < 0))
        found: list[tuple[int, NDArray[np.float32], float, float]] = []
        directions = _pair_directions()
        quantised = None
        if weak == "differential":
            differences = histograms[:, :, _PAIRS[:, 0]] - histograms[:, :, _PAIRS[:, 1]]
            quantised = Quantised(differences.reshape(n, -1))
        for round_ in range(rounds):
            if weak == "fisher" and round_ % _RENEWED == 0:
                directions = _fisher_directions(histograms, labels, weights)
                quantised = Quantised(np.einsum("nlb,lb->nl", histograms, directions))
            assert quantised is not None
            stump, votes = quantised.best_stump(weights, labels)
            if weak == "differential":
                block, pair = divmod(stump.feature, len(_PAIRS))
                direction = directions[pair]
            else:
                block, direction = stump.feature, directions[stump.feature]
            found.append((block, stump.polarity * direction, stump.polarity * stump.threshold, stump.weight))
            weights = reweighted(weights, labels, votes, stump.weight)
        block_, direction_, threshold, weight = zip(*found, strict=True)
        return cls(np.array(block_), np.array(direction_), np.array(threshold), np.array(weight))

    def scores(
        self,
        integral: NDArray[np.float32],
        windows: FloatArray,
        *,
        rounds: int | None = None,
        normalised: bool = True,
    ) -> FloatArray:
        """Confidence (n,) in −1…1 of windows (n, 4) in an `integral_histogram`.

        Parameters
        ----------
        rounds : how many of the weak classifiers vote, from the first; all by default
        normalised : whether histograms are divided by their sums, as in `block_histograms`
        """
        rows, columns = grid_lines(windows, integral.shape)
        weight = self.weight[:rounds]
        used = np.argsort(self.direction == 0.0, axis=1, kind="stable")
        count = np.count_nonzero(self.direction, axis=1)
        blocks = block_corners()[self.block[:rounds]]
        total = _scores(
            integral, rows, columns, blocks, self.direction, used, count, self.threshold, weight, normalised
        )
        return np.asarray(total / float(weight.sum()), float)


def _pair_directions() -> NDArray[np.float32]:
    directions = np.zeros((len(_PAIRS), BINS), np.float32)
    directions[np.arange(len(_PAIRS)), _PAIRS[:, 0]] = 1.0
    directions[np.arange(len(_PAIRS)), _PAIRS[:, 1]] = -1.0
    return directions


def _fisher_directions(
    histograms: NDArray[np.float32], labels: NDArray[np.int64], weights: FloatArray
) -> NDArray[np.float32]:
    """Fisher's linear discriminant (441, 9) of every block, under sample weights."""
    within, means = np.zeros((histograms.shape[1], BINS, BINS)), []
    for label in (1, -1):
        share = weights[labels == label]
        share = share / share.sum()
        blocks = histograms[labels == label].transpose(1, 0, 2)
        mean = np.einsum("n,lnb->lb", share, blocks)
        centred = (blocks - mean[:, None, :]) * np.sqrt(share)[None, :, None]
        within += centred.transpose(0, 2, 1) @ centred
        means.append(mean)
    within += 1e-3 * np.eye(BINS) * np.trace(within, axis1=1, axis2=2)[:, None, None] / BINS + 1e-9 * np.eye(
        BINS
    )
    found = np.linalg.solve(within, (means[0] - means[1])[:, :, None])[:, :, 0]
    return np.asarray(found / np.linalg.norm(found, axis=1, keepdims=True), np.float32)


@njit(cache=True)
def _scores(
    integral: Any,
    rows: Any,
    columns: Any,
    block: Any,
    direction: Any,
    used: Any,
    count: Any,
    threshold: Any,
    weight: Any,
    normalised: bool,
) -> Any:
    """Votes (n,): each looks at the four corners of its block, in the directions that it uses."""
    n = len(rows)
    total = np.zeros(n)
    for i in range(n):
        for t in range(len(weight)):
            top, bottom, left, right = block[t]
            low, high = integral[rows[i, top]], integral[rows[i, bottom]]
            a, b = columns[i, left], columns[i, right]
            along = 0.0
            for k in range(count[t]):
                d = used[t, k]
                along += direction[t, d] * (high[b, d] - low[b, d] - high[a, d] + low[a, d])
            whole = 1.0
            if normalised:
                whole += high[b, BINS] - low[b, BINS] - high[a, BINS] + low[a, BINS]
            total[i] += weight[t] if along > threshold[t] * whole else -weight[t]
    return total
