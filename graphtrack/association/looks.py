"""What detections look like, as the chains' kernels compare it; and what a detector's score is worth."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from graphtrack.association.appearance import AppearanceModel
from graphtrack.association.chains import Chains, Scene
from graphtrack.geometry.angles import FloatArray

IntArray = NDArray[np.int64]

_TAUGHT_SECONDS = 0.6
"""Two detections of one person teach what stays the same if they are no further apart."""
_APART = 1.0
"""Metres between two detections of a frame beyond which they show two people."""
_BINS = 6
"""Into which scores are put, as many in each."""


def learned(chains: Chains, identity: IntArray, descriptors: FloatArray) -> AppearanceModel:
    """What looks say in a recording, from neighbours in its tracks and from pairs of one frame.

    Parameters
    ----------
    chains : the tracks
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


def compared(
    chains: Chains, scene: Scene, model: AppearanceModel, descriptors: FloatArray
) -> tuple[Chains, Scene]:
    """Chains and scene that compare looks as the model does."""
    looks = np.ascontiguousarray(model.whitened(descriptors))
    scene = scene._replace(looks_offset=model.offset, looks_slope=model.slope, looks_outliers=model.outlier)
    return chains._replace(looks=looks), scene


def constancy(
    chains: Chains, identity: NDArray[np.int64], model: AppearanceModel, descriptors: FloatArray
) -> FloatArray:
    """(n,) log ratio that looks bring on average where nobody changed; 0: the detection has no descriptor.

    What is false resembles itself from frame to frame as much as a person does, when it is a thing or a part
    of somebody: looks tell who is who, and not whether there is anybody.

    Parameters
    ----------
    chains : the tracks
    identity : (n,) of each detection; −1: false
    model, descriptors : what looks say, and the (n, d) descriptors, NaN where one is missing
    """
    later = np.flatnonzero((identity >= 0) & (chains.preceding >= 0))
    ratios = model.log_ratio(descriptors[chains.preceding[later]], descriptors[later])
    known = np.asarray(np.isfinite(descriptors).all(axis=1))
    both = known[later] & known[chains.preceding[later]]
    return np.where(known, max(float(ratios[both].mean()), 0.0) if both.any() else 0.0, 0.0)


def score_ratio(score: FloatArray, identity: IntArray) -> FloatArray:
    """Log of how much more probable each score (n,) is of people than of false detections; 0: not scored.

    By shares of those who are thought to be either, with as much doubt as a few detections outweigh.
    """
    known = np.isfinite(score)
    if known.sum() < 10 * _BINS or np.ptp(score[known]) == 0.0:
        return np.zeros(len(score))
    edges = np.unique(np.quantile(score[known], np.linspace(0.0, 1.0, _BINS + 1)[1:-1]))
    place, bins = np.searchsorted(edges, score[known], "right"), len(edges) + 1
    person = identity[known] >= 0
    shares = [np.bincount(place[side], minlength=bins) + 3.0 for side in (person, ~person)]
    ratio = np.log(shares[0] / shares[0].sum()) - np.log(shares[1] / shares[1].sum())
    found = np.zeros(len(score))
    found[known] = ratio[place]
    return found
