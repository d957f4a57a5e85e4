"""AdaBoost on stumps, and boosted head detectors on blocks of gradients (Chen et al. 2011, §2.2)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray
from graphtrack.kernels.compilation import kept
from perception.pose.features import BINS, block_corners, grid_lines

LEVELS = 32


@dataclass(frozen=True)
class Stump:
    """h(x) = polarity · sign(x[feature] − threshold), with its weight in the vote."""

    feature: int
    threshold: float
    polarity: int
    weight: float


class Quantised:
    """Quantise features (n, d) by the ``LEVELS − 1`` thresholds of each, which are quantiles."""

    def __init__(self, features: NDArray[np.float32]) -> None:
        shares = np.arange(1, LEVELS) / LEVELS
        self.thresholds = np.quantile(features, shares, axis=0).astype(np.float32)
        self.codes = np.empty((features.shape[1], len(features)), np.uint8)
        for j in range(features.shape[1]):
            self.codes[j] = np.searchsorted(self.thresholds[:, j], features[:, j], side="left")

    def best_stump(self, weights: FloatArray, labels: NDArray[np.int64]) -> tuple[Stump, FloatArray]:
        """Return the stump of least weighted error, and its votes ±1 (n,) on the samples.

        Parameters
        ----------
        weights : (n,) summing to 1
        labels : (n,) −1 or +1
        """
        feature, level, edge = _best(self.codes, weights * labels)
        votes = np.where(self.codes[feature] > level, 1, -1)
        polarity = 1 if edge >= 0.0 else -1
        error = float(np.clip((1.0 - abs(edge)) / 2.0, 1e-6, 1.0 - 1e-6))
        weight = 0.5 * float(np.log((1.0 - error) / error))
        stump = Stump(int(feature), float(self.thresholds[level, feature]), polarity, weight)
        return stump, (polarity * votes).astype(float)


def reweighted(
    weights: FloatArray, labels: NDArray[np.int64], votes: FloatArray, weight: float
) -> FloatArray:
    """Return weights (n,) of the next round: those of wrong samples grow (Freund & Schapire 1997)."""
    grown = weights * np.exp(-weight * labels * votes)
    return np.asarray(grown / grown.sum(), float)


@kept()
def _best(codes: Any, signed: Any) -> Any:
    """Return feature, level and edge Σ w·y·h of the stump sign(code > level) with the largest |edge|."""
    best, feature, level = 0.0, 0, 0
    total = signed.sum()
    sums = np.zeros(32)
    for j in range(len(codes)):
        sums[:] = 0.0
        row = codes[j]
        for i in range(len(row)):
            sums[row[i]] += signed[i]
        below = 0.0
        for k in range(31):
            below += sums[k]
            edge = total - 2.0 * below
            if abs(edge) > abs(best):
                best, feature, level = edge, j, k
    return feature, level, best


Weak = Literal["differential", "fisher"]

_PAIRS = np.array([(a, b) for a in range(BINS) for b in range(a + 1, BINS)])
_RENEWED = 25  # rounds between updates of the Fisher discriminants with the current weights


class BoostedBlocks:
    """H(p) = Σ_t α_t · sign(c_t · f_l(t)(p) − σ_t) over blocks l of 9 gradient directions each.

    A differential weak classifier compares two directions: c_t has one +1 and one −1 (eq. 1). A Fisher
    classifier weights all nine.

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
            If there is only one kind of label, or the weak classifier is unknown.
        """
        if set(np.unique(labels)) != {-1, 1}:
            raise InputError("windows of one kind", "windows with and without heads, labelled 1 and -1")
        if weak not in ("differential", "fisher"):
            raise InputError(f"weak classifiers {weak!r}", "'differential' or 'fisher'")
        n = len(labels)
        weights = np.where(labels > 0, 0.5 / np.sum(labels > 0), 0.5 / np.sum(labels < 0))
        found: list[tuple[int, NDArray[np.float32], float, float]] = []
        directions = (
            np.eye(BINS, dtype=np.float32)[_PAIRS[:, 0]] - np.eye(BINS, dtype=np.float32)[_PAIRS[:, 1]]
        )
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
        rounds : number of weak classifiers that vote, from the first; all by default
        normalised : whether histograms are divided by their sums, as in `block_histograms`
        """
        rows, columns = grid_lines(windows, integral.shape)
        weight = self.weight[:rounds]
        used = np.argsort(self.direction == 0.0, axis=1, kind="stable")
        count = np.count_nonzero(self.direction, axis=1)
        blocks = block_corners()[self.block[:rounds]]
        weak = _WeakClassifiers(blocks, self.direction, used, count, self.threshold, weight)
        total = _scores(integral, rows, columns, weak, normalised)
        return np.asarray(total / float(weight.sum()), float)


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


class _WeakClassifiers(NamedTuple):
    """The t weak classifiers of `BoostedBlocks`, with the directions that they use."""

    corners: NDArray[Any]  # (t, 4) of `block_corners`
    direction: NDArray[Any]  # (t, 9)
    used: NDArray[Any]  # (t, 9) indices of directions, those other than 0 first
    used_count: NDArray[Any]  # (t,) directions other than 0
    threshold: NDArray[Any]  # (t,)
    weight: NDArray[Any]  # (t,)


@kept()
def _scores(integral: Any, rows: Any, columns: Any, weak: _WeakClassifiers, normalised: bool) -> Any:
    """Return votes (n,), from the four corners of each block, in the directions used."""
    n = len(rows)
    total = np.zeros(n)
    for i in range(n):
        for t in range(len(weak.weight)):
            top, bottom, left, right = weak.corners[t]
            low, high = integral[rows[i, top]], integral[rows[i, bottom]]
            a, b = columns[i, left], columns[i, right]
            along = 0.0
            for k in range(weak.used_count[t]):
                d = weak.used[t, k]
                along += weak.direction[t, d] * (high[b, d] - low[b, d] - high[a, d] + low[a, d])
            norm = 1.0
            if normalised:
                norm += high[b, BINS] - low[b, BINS] - high[a, BINS] + low[a, BINS]
            total[i] += weak.weight[t] if along > weak.threshold[t] * norm else -weak.weight[t]
    return total
