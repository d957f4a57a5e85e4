"""Log odds that two people are of one group, in each frame in which they are near each other."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from graphtrack.behaviour.facing import facing
from graphtrack.behaviour.features import pair_features
from graphtrack.behaviour.parameters import GroupParameters
from graphtrack.behaviour.people import IntArray, People
from graphtrack.behaviour.smoothing import averaged, merged
from graphtrack.geometry.angles import FloatArray
from graphtrack.saved import from_text, to_text

SLOW = np.array([False, True, False, False, True])
"""Mask of the features that are averaged over ``look_seconds``."""
_SPEED_STEP = 0.1
"""m/s over which standing becomes walking."""
ALONG = 1.5
"""Those who walk together are side by side: a metre along their way counts as so many across it."""
_MOST = 6.0
"""Log odds that one frame of walking says at most."""
_CAME = 0.1
"""Share of the time near each other, not spent together, from which two are known to have met in sight."""
_UNSURE = 0.01
"""How much shorter than 1 the expected direction of a body is that is looked for among the others."""


@dataclass(frozen=True, eq=False)
class PairEvidence:
    """Pairs of people near each other, frame by frame.

    Attributes
    ----------
    left, right : (n,) rows in `People`
    start : (k + 1,) first pair of each frame
    odds : (n,) log odds that they are of one group, averaged over time
    caution : (n,) to be taken from them before people are parted
    walking : (n,) how much both walk, 0 to 1, averaged over time
    """

    left: IntArray
    right: IntArray
    start: IntArray
    odds: FloatArray
    caution: FloatArray
    walking: FloatArray


def with_bodies(people: People, spread: float) -> People:
    """People whose unknown bodies are where their heads point, more or less: 1-σ ``spread`` radians."""
    unseen = np.asarray(~people.body.any(axis=1))
    if not (unseen & people.head.any(axis=1)).any():
        return people
    turned = np.exp(-0.5 * spread**2) * people.head
    return replace(people, body=np.where(unseen[:, None], turned, people.body))


def known_shares(people: People, left: IntArray, right: IntArray) -> FloatArray:
    """(n, 3) how much a pair is one of which positions alone, bodies too, and heads too are known."""
    body, head = (np.linalg.norm(vector, axis=1) for vector in (people.body, people.head))
    bodies, heads = body[left] * body[right], head[left] * head[right]
    return np.column_stack([1.0 - bodies, bodies * (1.0 - heads), bodies * heads])


def conversation_odds(
    shares: FloatArray, features: FloatArray, parameters: GroupParameters
) -> tuple[FloatArray, FloatArray]:
    """Return the log odds of each pair by features, (n,): over a short time, and over a long one."""
    quick, slow = np.zeros(len(features)), np.zeros(len(features))
    for share, weights in zip(shares.T, parameters.conversations, strict=True):
        terms = weights.of_features
        quick += share * (weights.bias + features @ np.where(SLOW, 0.0, terms))
        slow += share * (features @ np.where(SLOW, terms, 0.0))
    return quick, slow


def abreast(people: People, left: IntArray, right: IntArray) -> tuple[FloatArray, FloatArray]:
    """How far apart two walk, (n,) metres, those along their way counted more; square of their velocities'
    difference, (n,) m²/s²."""
    apart = people.position[right] - people.position[left]
    way = people.velocity[right] + people.velocity[left]
    way = way / np.maximum(np.linalg.norm(way, axis=1), 1e-9)[:, None]
    along = np.sum(apart * way, axis=1)
    across = apart[:, 0] * way[:, 1] - apart[:, 1] * way[:, 0]
    return np.hypot(across, ALONG * along), np.sum(
        (people.velocity[right] - people.velocity[left]) ** 2, axis=1
    )


def walking_odds(people: People, left: IntArray, right: IntArray, parameters: GroupParameters) -> FloatArray:
    """Log odds, (n,), that two who walk do so together: how near, side by side and alike they go."""
    far, square = abreast(people, left, right)
    mean, std = parameters.walking_distance, parameters.walking_distance_std
    near = -0.5 * ((far - mean) / std) ** 2 - np.log(
        np.sqrt(2.0 * np.pi) * std * 2.0 * np.pi * np.maximum(far, 0.2)
    )
    alike, other = parameters.walking_speed_std, parameters.others_speed_std
    same = -0.5 * square * (1.0 / alike**2 - 1.0 / other**2) + 2.0 * np.log(other / alike)
    prior = np.log(parameters.walking_share / (1.0 - parameters.walking_share))
    odds: FloatArray = np.clip(prior + near - np.log(parameters.others_density) + same, -_MOST, _MOST)
    return odds


def encounter_odds(share: FloatArray, seconds: FloatArray, parameters: GroupParameters) -> FloatArray:
    """Log odds, (n,), against a conversation of two who met a short time ago: strangers soon part.

    They are encounter_odds · exp(−share · seconds/encounter_seconds). Two who were together for as long as
    they were seen near each other may have met long before: for them there are none.

    Parameters
    ----------
    share : (n,) of the time for which two were near each other that they stood, or walked together
    seconds : (n,) that time, weighted by exp(−|Δt|/look_seconds)
    """
    met = np.minimum((1.0 - share) / _CAME, 1.0)
    decay = np.exp(-share * seconds / parameters.encounter_seconds)
    return np.asarray(parameters.encounter_odds * met * decay)


def walks(people: People, parameters: GroupParameters) -> FloatArray:
    """(n,) how much each walks, 0 to 1, by speed."""
    speed = np.linalg.norm(people.velocity, axis=1)
    share: FloatArray = 0.5 * (1.0 + np.tanh(0.5 * (speed - parameters.walking_speed) / _SPEED_STEP))
    return share


PARTS = 2
"""Values of a pair that are averaged over each of the three times."""


@dataclass(frozen=True, eq=False)
class PairValues:
    """Evidence of pairs near each other from single frames.

    Attributes
    ----------
    left, right : (n,) rows in `People`, the left one first
    values : (n, 6) log odds by places and bodies, and the caution, averaged over ``place_seconds``;
        log odds by looks and the crowd, and the probability that both stand, or walk together, over
        ``look_seconds``; log odds by walking, and how much both walk, over ``walking_seconds``
    """

    left: IntArray
    right: IntArray
    values: FloatArray

    def evidence(
        self, people: People, means: FloatArray, seconds: FloatArray, parameters: GroupParameters
    ) -> PairEvidence:
        """The evidence, given the averages (n, 6) and the seconds (n,) that those of looks are of."""
        start = np.searchsorted(people.frame_of[self.left], np.arange(len(people.frame) + 1))
        place, caution, look, company, alike, walking = means.T
        standing = np.maximum(1.0 - 2.0 * walking, 0.0)  # groups that walk are judged by how they do
        odds = place + look + alike - standing * encounter_odds(company, seconds, parameters)
        return PairEvidence(self.left, self.right, start, odds, caution, walking)


def pair_values(people: People, parameters: GroupParameters) -> PairValues:
    """Return the evidence of single frames; unknown bodies are taken to face where the others stand."""
    people = with_bodies(people, parameters.head_spread)
    found = _values(people, parameters)
    unknown = 1.0 - np.linalg.norm(people.body, axis=1)
    if not (unknown > _UNSURE).any():
        return found
    odds = found.values[:, ::PARTS].sum(axis=1)
    faced = facing(people.position, found.left, found.right, odds, parameters)
    return _values(replace(people, body=people.body + np.maximum(unknown, 0.0)[:, None] * faced), parameters)


def _values(people: People, parameters: GroupParameters) -> PairValues:
    left, right, features = pair_features(people, parameters.stride)
    shares = known_shares(people, left, right)
    quick, slow = conversation_odds(shares, features, parameters)
    caution = shares @ np.array([one.caution for one in parameters.conversations])
    walk = walks(people, parameters)
    walking, standing = walk[left] * walk[right], (1.0 - walk[left]) * (1.0 - walk[right])
    quick = standing * quick + (1.0 - standing - walking) * parameters.apart
    alike = walking_odds(people, left, right, parameters)
    company = standing + walking * 0.5 * (1.0 + np.tanh(0.5 * alike))
    columns = (quick, standing * caution, standing * slow, company, walking * alike, walking)
    return PairValues(left, right, np.column_stack(columns))


def pair_evidence(people: People, parameters: GroupParameters) -> PairEvidence:
    """The evidence of all pairs of a recording, from the past and the future of each frame."""
    found = pair_values(people, parameters)
    pair = people.person[found.left] * len(people.ids) + people.person[found.right]
    t = people.t[people.frame_of[found.left]]
    parts = np.split(found.values, 3, axis=1)
    (place, _), (look, seconds), (walking, _) = (
        averaged(pair, t, values, time) for values, time in zip(parts, parameters.seconds, strict=True)
    )
    return found.evidence(people, np.hstack([place, look, walking]), seconds, parameters)


class OnlineEvidence:
    """`pair_evidence` from the past alone, frame by frame.

    Each pair has averages of its own. What is kept is bounded: the pairs that were within 4 m of each other
    in the last minutes (five times the longest time of averaging).
    """

    def __init__(self, parameters: GroupParameters) -> None:
        self.parameters = parameters
        self._pairs = np.empty((0, 2), dtype=np.int64)  # ids, ascending by the greater, then by the lesser
        self._last = np.empty(0)
        # Of each pair its values, each times the seconds it counts for, and those seconds.
        self._sums = np.empty((0, 3 * PARTS + 3))

    def __len__(self) -> int:
        """The pairs that are known."""
        return len(self._pairs)

    def take(self, people: People) -> PairEvidence:
        """Take in the people of one frame, later than those before, or of none; the evidence of its pairs."""
        found = pair_values(people, self.parameters)
        if not len(people):
            return found.evidence(people, found.values, np.zeros(0), self.parameters)
        pairs, t = np.column_stack([people.ids[found.left], people.ids[found.right]]), float(people.t[0])
        self._pairs, self._last, self._sums, means = merged(
            self._pairs,
            self._last,
            self._sums,
            pairs,
            found.values,
            np.repeat(np.arange(3), PARTS),
            np.array(self.parameters.seconds),
            t,
        )
        here = self._last == t  # in the order of the frame's pairs
        return found.evidence(people, means, self._sums[here, 3 * PARTS + 1], self.parameters)

    def state(self) -> dict[str, Any]:
        """Everything needed to go on elsewhere, as JSON-able data; see `restore`."""
        return {"pairs": self._pairs.tolist(), "last": to_text(self._last), "sums": to_text(self._sums)}

    def restore(self, state: Mapping[str, Any]) -> None:
        """Go on where `state` was taken, given the same parameters."""
        self._pairs = np.array(state["pairs"], dtype=np.int64).reshape(-1, 2)
        self._last = from_text(state["last"]).reshape(len(self._pairs))
        self._sums = from_text(state["sums"]).reshape(len(self._pairs), 3 * PARTS + 3)
