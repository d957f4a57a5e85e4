"""Attributes of open detections alongside their chains."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from graphtrack.association.chains import IntArray
from graphtrack.geometry.angles import FloatArray

NOBODY = -1


@dataclass
class Notes:
    """Attributes of n detections alongside their chains.

    Attributes
    ----------
    std : metres that a detection says itself; NaN: it does not
    place : of it in its update
    said : track id that was last said of it
    number : track id of the track that begins with it, once there is one
    before : detections of its track that are forgotten by now
    clutter : how many times the mean rate detections are false there
    score : the detector's own; NaN: none
    descriptor : (n, d) of looks, NaN where one is missing; d is 0 until the first one comes
    """

    std: FloatArray
    place: IntArray
    said: IntArray
    number: IntArray
    before: IntArray
    clutter: FloatArray
    score: FloatArray
    descriptor: FloatArray

    @classmethod
    def of(cls, std: FloatArray, clutter: FloatArray, score: FloatArray, descriptor: FloatArray) -> Notes:
        """Of the detections of a new frame."""
        n = len(std)
        nobody = np.full(n, NOBODY)
        return cls(
            std, np.arange(n), nobody, nobody.copy(), np.zeros(n, np.int64), clutter, score, descriptor
        )

    def extended(self, new: Notes) -> Notes:
        """With those of further detections."""
        both = zip(vars(self).values(), vars(new).values(), strict=True)
        return Notes(*(np.concatenate(pair) for pair in both))

    def of_some(self, some: IntArray) -> Notes:
        """Those of some detections."""
        return Notes(*(values[some] for values in vars(self).values()))
