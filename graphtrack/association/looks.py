"""Learning the likelihood ratios of appearance and of detection scores from tracks."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from graphtrack.association.appearance import AppearanceModel
from graphtrack.association.chains import Chains, IntArray
from graphtrack.geometry.angles import FloatArray

_TAUGHT_SECONDS = 0.6
"""Two detections of one person teach what stays the same if they are no further apart."""
_APART = 1.0
"""Metres between two detections of a frame beyond which they show two people."""
_PRIOR = 5.0
"""Pairs of false detections that looks tell nothing of, until more are seen."""
_BINS = 6
"""Into which scores are put, as many in each."""


def learn_appearance(chains: Chains, identity: IntArray, descriptors: FloatArray) -> AppearanceModel:
    """Learn the appearance model of a recording from neighbours in its tracks and from pairs of one frame.

    Parameters
    ----------
    identity : (n,) of each detection; −1: false
    descriptors : (n, d), NaN where one is missing
    """
    later = np.flatnonzero((identity >= 0) & (chains.preceding >= 0))
    earlier = chains.preceding[later]
    near = chains.t[later] - chains.t[earlier] <= _TAUGHT_SECONDS
    pairs = []
    for shift in (1, 2, 3):
        first = np.arange(max(len(identity) - shift, 0))
        second = first + shift
        together = chains.frame[first] == chains.frame[second]
        apart = np.hypot(*(chains.position[first] - chains.position[second]).T) > _APART
        pairs.append(np.column_stack([first, second])[together & apart])
    same = np.column_stack([earlier, later])[near]
    return AppearanceModel.learned(descriptors, same, np.concatenate(pairs))


def constancy(chains: Chains, identity: IntArray, model: AppearanceModel, descriptors: FloatArray) -> float:
    """Log ratio that looks bring on average where nobody changed; at least 0.

    What is false resembles itself from frame to frame as much as a person does, when it is a thing or a part
    of somebody: looks tell who is who, and not whether there is anybody. So a detection with a descriptor
    has as much less to gain.

    Parameters
    ----------
    identity : (n,) of each detection; −1: false
    model, descriptors : what looks say, and the (n, d) descriptors, NaN where one is missing
    """
    later = np.flatnonzero((identity >= 0) & (chains.preceding >= 0))
    ratios = model.log_ratio(descriptors[chains.preceding[later]], descriptors[later])
    has = has_descriptor(descriptors)
    both = has[later] & has[chains.preceding[later]]
    return max(float(ratios[both].mean()), 0.0) if both.any() else 0.0


def resemblance_of_false_ones(
    chains: Chains, identity: IntArray, model: AppearanceModel, descriptors: FloatArray
) -> float:
    """Log ratio that looks bring on average where a false detection follows a near one; at least 0.

    Detections have as much less to gain: `constancy`, as who decides at once can measure it. There
    links are made because looks agree, so that the mean of those of people would rise by itself.

    Parameters
    ----------
    chains : the detections, in the order of time
    """
    false = np.flatnonzero((identity < 0) & has_descriptor(descriptors))
    if not len(false):
        return 0.0
    # Frames far apart on a third axis, as in `duplicates.near`.
    step = np.array([0.0, 0.0, 10.0 * _APART])
    places = np.column_stack([chains.position[false], step[2] * chains.frame[false]])
    distance, before = cKDTree(places).query(places - step, distance_upper_bound=_APART)
    later = np.flatnonzero(np.isfinite(distance))
    ratios = model.log_ratio(descriptors[false[before[later]]], descriptors[false[later]])
    return max(float(ratios.sum()) / (len(ratios) + _PRIOR), 0.0)


def has_descriptor(descriptors: FloatArray) -> NDArray[np.bool_]:
    """Return whether each detection (n,) has a descriptor."""
    return np.asarray(np.isfinite(descriptors).all(axis=1))


def widened(descriptors: FloatArray, size: int) -> FloatArray:
    """Descriptors (n, size): those given, or none of anybody where they have no numbers yet."""
    return descriptors if descriptors.shape[1] == size else np.full((len(descriptors), size), np.nan)


@dataclass(frozen=True, eq=False)
class ScoreRatio:
    """Likelihood ratio of detection scores, people against false detections.

    Attributes
    ----------
    edges : (bins − 1,) between the bins into which scores are put
    ratio : (bins,) log of how much more probable each is of people; none: scores say nothing
    """

    edges: FloatArray = field(default_factory=lambda: np.zeros(0))
    ratio: FloatArray = field(default_factory=lambda: np.zeros(0))

    @classmethod
    def learned(cls, score: FloatArray, identity: IntArray) -> ScoreRatio:
        """By shares of those who are thought to be either, with as much doubt as a few detections outweigh.

        Parameters
        ----------
        score : (n,), NaN where there is none
        identity : (n,) of each detection; −1: false
        """
        known = np.isfinite(score)
        if known.sum() < 10 * _BINS or np.ptp(score[known]) == 0.0:
            return cls()
        edges = np.unique(np.quantile(score[known], np.linspace(0.0, 1.0, _BINS + 1)[1:-1]))
        place, bins = np.searchsorted(edges, score[known], "right"), len(edges) + 1
        person = identity[known] >= 0
        shares = [np.bincount(place[side], minlength=bins) + 3.0 for side in (person, ~person)]
        return cls(edges, np.log(shares[0] / shares[0].sum()) - np.log(shares[1] / shares[1].sum()))

    def of(self, score: FloatArray) -> FloatArray:
        """Log ratio (n,) of scores (n,); 0: not scored."""
        if not len(self.ratio):
            return np.zeros(len(score))
        return np.where(np.isfinite(score), self.ratio[np.searchsorted(self.edges, score, "right")], 0.0)
