"""Rates of several sensors: how often each detects a person in view, and how many detections are false."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from graphtrack.association.likelihood import Chains, IntArray
from graphtrack.association.sensors import Views
from graphtrack.geometry.angles import FloatArray
from graphtrack.tracks.sensors import Sensor

_BOUNDS = 0.02, 0.995  # of probabilities of detection
_PRIOR_SCANS = 10.0
"""Scans that the mean of all sensors weighs in the rate of each."""

_PRIOR_FALSE = 1.0
"""False detections, the same."""


@dataclass(frozen=True, eq=False)
class SensorRates:
    """Rates of s sensors, learned or described; (0,) of one sensor alone.

    Attributes
    ----------
    detection : (s,) probability that a person in view is detected in a scan
    false : (s,) false detections a scan and m²
    """

    detection: FloatArray
    false: FloatArray

    @classmethod
    def even(cls, count: int) -> SensorRates:
        """Return equal rates of some sensors: only ratios are used."""
        return cls(np.full(count, 0.9), np.ones(count))

    @classmethod
    def learned(
        cls, chains: Chains, identity: IntArray, views: Views, described: Sequence[Sensor] = ()
    ) -> SensorRates:
        """Count detections and misses; what is described is kept.

        Parameters
        ----------
        chains : the tracks, linked
        identity : (n,) of each detection, from 0; −1: false
        views : fields of view of the sensors
        described : descriptions of all sensors, or none
        """
        count = chains.scans.shape[1]
        hits, tried = _next_scans(chains, identity)
        mean = (hits.sum() + 0.9) / (tried.sum() + 1.0)
        detection = (hits + _PRIOR_SCANS * mean) / (tried + _PRIOR_SCANS)
        false = np.bincount(chains.sensor[identity < 0], minlength=count)
        exposure = chains.scans.max(axis=0) * views.areas
        each = (false.sum() + _PRIOR_FALSE) / max(exposure.sum(), 1.0)
        density = (false + _PRIOR_FALSE) / (exposure + _PRIOR_FALSE / each)
        return cls(detection, density)._as_described(described)

    def _as_described(self, described: Sequence[Sensor]) -> SensorRates:
        """Return these rates, and those of the first sensors as far as they are described."""
        detection, false = self.detection.copy(), self.false.copy()
        for k, one in enumerate(described):
            if one.detection_probability is not None:
                detection[k] = one.detection_probability
            if one.false_density is not None:
                false[k] = max(one.false_density, 1e-9)
        return SensorRates(np.clip(detection, *_BOUNDS), false)

    def extended(self, count: int, described: Sequence[Sensor] = ()) -> SensorRates:
        """Return those of more sensors, of which nothing is known except what is described."""
        more = (0, count - len(self.detection))
        means = (float(one.mean()) if len(one) else 0.5 for one in (self.detection, self.false))
        both = zip((self.detection, self.false), means, strict=True)
        found = SensorRates(*(np.pad(one, more, constant_values=mean) for one, mean in both))
        return found._as_described(described) if described else found

    @property
    def weights(self) -> FloatArray:
        """(s,) evidence of a miss by each sensor, as a multiple of the mean."""
        misses = np.log1p(-self.detection)
        return np.asarray(misses / misses.mean()) if len(misses) else misses

    @property
    def gains(self) -> FloatArray:
        """(s,) log likelihood ratio of a detection by each sensor, over the mean."""
        gains = np.log(self.detection) - np.log(self.false)
        return np.asarray(gains - gains.mean()) if len(gains) else gains


def _next_scans(chains: Chains, identity: IntArray) -> tuple[FloatArray, FloatArray]:
    """Return for each sensor the next scans after detections that detect the person again, and all of them.

    A person who is hidden for long counts as missed once. Scans after the person's last detection, and those
    in whose field of view the person's next place is not, do not count.
    """
    count = chains.scans.shape[1]
    hits, tried = np.zeros(count), np.zeros(count)
    person = np.flatnonzero((identity >= 0) & (chains.following >= 0))
    if not len(person):
        return hits, tried
    last = np.full(int(identity.max()) + 1, -1)
    np.maximum.at(last, identity[identity >= 0], np.flatnonzero(identity >= 0))
    most = int(chains.scans.max()) + 2
    for one in range(count):
        own = person[chains.sensor[person] == one]
        place = chains.scans[own, one].astype(np.int64) + 1
        end = last[identity[own]]
        there = place < chains.scans[end, one] + (chains.sensor[end] == one)
        there &= chains.views[chains.following[own], one] > 0.5
        every = np.flatnonzero((identity >= 0) & (chains.sensor == one))
        detected = identity[every] * most + chains.scans[every, one].astype(np.int64)
        hits[one] = np.isin(identity[own[there]] * most + place[there], detected).sum()
        tried[one] = there.sum()
    return hits, tried
