"""Log odds that two people are of one group, in each frame in which they are near each other."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from graphtrack.behaviour.facing import facing
from graphtrack.behaviour.features import pair_features
from graphtrack.behaviour.parameters import GroupParameters
from graphtrack.behaviour.people import IntArray, People
from graphtrack.behaviour.smoothing import averaged, averaged_seconds
from graphtrack.geometry.angles import FloatArray

_SLOW = np.array([False, True, False, False, True])
"""Which of the features are averaged over ``look_seconds``."""
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
    """What features say of each pair, (n,): what is averaged over a short time, and over a long one."""
    quick, slow = np.zeros(len(features)), np.zeros(len(features))
    for share, weights in zip(shares.T, parameters.conversations, strict=True):
        terms = weights.of_features
        quick += share * (weights.bias + features @ np.where(_SLOW, 0.0, terms))
        slow += share * (features @ np.where(_SLOW, terms, 0.0))
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


@dataclass(frozen=True, eq=False)
class PairValues:
    """What each frame says by itself of pairs of people near each other.

    Attributes
    ----------
    left, right : (n,) rows in `People`, the left one first
    place : (n, 2) log odds by places and bodies, and the caution; averaged over ``place_seconds``
    look : (n, 2) log odds by looks and the crowd, and the probability that both stand, or walk together;
        averaged over ``look_seconds``
    walking : (n, 2) log odds by walking, and how much both walk; averaged over ``walking_seconds``
    """

    left: IntArray
    right: IntArray
    place: FloatArray
    look: FloatArray
    walking: FloatArray

    def evidence(
        self,
        people: People,
        place: FloatArray,
        look: FloatArray,
        walking: FloatArray,
        seconds: FloatArray,
        parameters: GroupParameters,
    ) -> PairEvidence:
        """The evidence, given the averages of the three, and the seconds (n,) that those of looks are of."""
        start = np.searchsorted(people.frame_of[self.left], np.arange(len(people.frame) + 1))
        odds = place[:, 0] + look[:, 0] + walking[:, 0]
        standing = np.maximum(1.0 - 2.0 * walking[:, 1], 0.0)  # groups that walk are judged by how they do
        odds = odds - standing * encounter_odds(look[:, 1], seconds, parameters)
        return PairEvidence(self.left, self.right, start, odds, place[:, 1], walking[:, 1])


def pair_values(people: People, parameters: GroupParameters) -> PairValues:
    """What each frame says of all pairs; bodies face where the others stand, as far as they are unknown."""
    people = with_bodies(people, parameters.head_spread)
    found = _values(people, parameters)
    unknown = 1.0 - np.linalg.norm(people.body, axis=1)
    if not (unknown > _UNSURE).any():
        return found
    odds = found.place[:, 0] + found.look[:, 0] + found.walking[:, 0]
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
    return PairValues(
        left,
        right,
        np.column_stack([quick, standing * caution]),
        np.column_stack([standing * slow, company]),
        np.column_stack([walking * alike, walking]),
    )


def pair_evidence(people: People, parameters: GroupParameters, *, both_sides: bool = True) -> PairEvidence:
    """The evidence of all pairs.

    Parameters
    ----------
    both_sides : whether the future counts, or the past alone
    """
    values = pair_values(people, parameters)
    pair = people.person[values.left] * len(people.ids) + people.person[values.right]
    t = people.t[people.frame_of[values.left]]

    def mean(columns: FloatArray, seconds: float) -> FloatArray:
        found = [averaged(pair, t, column, seconds, both_sides=both_sides) for column in columns.T]
        return np.column_stack(found)

    long = parameters.look_seconds
    company, seconds = averaged_seconds(pair, t, values.look[:, 1], long, both_sides=both_sides)
    return values.evidence(
        people,
        mean(values.place, parameters.place_seconds),
        np.column_stack([mean(values.look[:, :1], long), company]),
        mean(values.walking, parameters.walking_seconds),
        seconds,
        parameters,
    )
