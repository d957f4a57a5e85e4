"""Log odds that two people are of one group, frame by frame and averaged over time.

A conversation has an o-space (Kendon 1990): an empty place that its members face, each from about the same
distance. The odds of a pair are those of the distance between the o-spaces of both, given how surely bodies
and heads point there, and where the other people stand.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from graphtrack.geometry.angles import FloatArray, concentration_from_resultant, unit
from graphtrack.interaction.parameters import GroupParameters
from graphtrack.interaction.people import IntArray, People
from graphtrack.kernels.compilation import allocating, compiled
from graphtrack.saved import Saved
from graphtrack.tracks.time import TIME_TOLERANCE

REACH = 4.0  # metres: people further apart are in no group by themselves, only through others


@allocating
def _near_pairs(position: FloatArray, first: IntArray) -> tuple[IntArray, IntArray]:
    """Rows of the two people of each pair within `REACH`, frame by frame."""
    count = 0
    left, right = np.empty(64, dtype=np.int64), np.empty(64, dtype=np.int64)
    for k in range(len(first) - 1):
        for i in range(first[k], first[k + 1]):
            for j in range(first[k], i):
                x, y = position[j, 0] - position[i, 0], position[j, 1] - position[i, 1]
                if math.sqrt(x * x + y * y) > REACH:
                    continue
                if count == len(left):
                    left, right = np.append(left, left), np.append(right, right)
                left[count], right[count] = j, i
                count += 1
    return left[:count].copy(), right[:count].copy()


def near_pairs(people: People) -> tuple[IntArray, IntArray]:
    """Rows (n,) of the two people of each pair within `REACH`, frame by frame."""
    return _near_pairs(people.position, people.first)


DIRECTIONS: FloatArray = 2.0 * np.pi * np.arange(36) / 36
"""Radians, of the o-spaces that are compared."""
_UNITS = unit(DIRECTIONS)
_SURE = 1.0 - 1e-4
"""Mean resultant length of the surest direction."""
_FARTHEST = 2.5  # metres from an o-space beyond which a person is no evidence of it
_RING = 0.2  # metres, 1-σ of the distance of members from their o-space about ``stride``
_OUTLIER = 0.1  # least share of the density at the members' distance that a companion has anywhere
_INSIDE = 0.6  # metres about an o-space in which nobody stands, 1-σ


@allocating
def _add_scores(
    position: FloatArray,
    space: FloatArray,
    stride: float,
    left: IntArray,
    right: IntArray,
    together: FloatArray,
    found: FloatArray,
) -> None:
    for k in range(len(left)):
        x, y = position[right[k], 0] - position[left[k], 0], position[right[k], 1] - position[left[k], 1]
        for d in range(len(space)):
            for side in range(2):
                sign = 1.0 - 2.0 * side
                far = math.hypot(sign * x - space[d, 0], sign * y - space[d, 1])
                if far > _FARTHEST:
                    continue
                near = math.exp(-0.5 * ((far - stride) / _RING) ** 2)
                member = math.log((near + _OUTLIER) / _OUTLIER)
                outside = math.log(1.0 - 0.5 * math.exp(-0.5 * (far / _INSIDE) ** 2))
                found[right[k] if side else left[k], d] += together[k] * member + outside


def facing_scores(
    position: FloatArray, left: IntArray, right: IntArray, odds: FloatArray, parameters: GroupParameters
) -> FloatArray:
    """Log density (n, directions), up to a constant, of each person's o-space lying there.

    Companions stand about an o-space at the distance at which people stand from theirs, and nobody within.

    Parameters
    ----------
    position : (n, 2) metres
    left, right : (k,) rows of the two of a pair of people near each other in one frame
    odds : (k,) log odds that they are in one conversation
    """
    found = np.zeros((len(position), len(DIRECTIONS)))
    together = 0.5 * (1.0 + np.tanh(0.5 * odds))
    _add_scores(position, parameters.stride * _UNITS, parameters.stride, left, right, together, found)
    return found


def facing(
    position: FloatArray, left: IntArray, right: IntArray, odds: FloatArray, parameters: GroupParameters
) -> FloatArray:
    """(n, 2) expected unit vectors of bodies by where the others stand, given log odds of pairs; or 0."""
    score = facing_scores(position, left, right, odds, parameters)
    found: FloatArray = np.zeros((len(position), 2))
    met = score.any(axis=1)
    found[met] = probabilities(score[met]) @ _UNITS
    return found


def probabilities(score: FloatArray) -> FloatArray:
    """(n, k) of log odds (n, k)."""
    likelihood = np.exp(score - score.max(axis=1, keepdims=True))
    return np.asarray(likelihood / likelihood.sum(axis=1, keepdims=True))


def observed_scores(people: People, parameters: GroupParameters) -> FloatArray:
    """Log density (n, directions), up to a constant, of o-spaces given the body and the head of each.

    Both point there, each with a spread of its own about which its uncertainty comes: who has no body known
    has a wider o-space, who has neither one all around.
    """
    toward = np.zeros((len(people), 2))
    for vector, spread in ((people.body, parameters.body_spread), (people.head, parameters.head_spread)):
        length = np.linalg.norm(vector, axis=1)
        kappa = concentration_from_resultant(np.minimum(np.exp(-0.5 * spread**2) * length, _SURE))
        toward += np.where(length > 0.0, kappa / np.maximum(length, 1e-9), 0.0)[:, None] * vector
    return np.asarray(toward @ _UNITS.T)


def o_spaces(people: People, score: FloatArray, stride: float) -> tuple[FloatArray, FloatArray]:
    """Mean (n, 2) and covariance (n, 2, 2) of o-spaces, m and m², ``stride`` metres ahead.

    ``score``: (n, directions) log densities
    """
    probability = probabilities(score)
    mean = probability @ _UNITS
    square = np.einsum("nd,da,db->nab", probability, _UNITS, _UNITS)
    spread = square - mean[:, :, None] * mean[:, None, :]
    return people.position + stride * mean, stride**2 * spread


def conversation_odds(
    space: FloatArray, spread: FloatArray, left: IntArray, right: IntArray, parameters: GroupParameters
) -> FloatArray:
    """Log odds, (k,), that two who stand are in one conversation, by the distance of their o-spaces.

    The difference of two o-spaces of one conversation is Gaussian, with ``space_std`` for each and what is
    unknown of their directions; it is as probable as by chance at ``reach`` where directions are known. The
    odds are ``apart`` at least.

    Parameters
    ----------
    space, spread : (n, 2) metres and (n, 2, 2) m², the means and covariances of o-spaces
    """
    exact = 2.0 * parameters.space_std**2
    total = spread[left] + spread[right] + exact * np.eye(2)
    x, y = (space[left] - space[right]).T
    size = total[:, 0, 0] * total[:, 1, 1] - total[:, 0, 1] ** 2
    square = (total[:, 1, 1] * x**2 - 2.0 * total[:, 0, 1] * x * y + total[:, 0, 0] * y**2) / size
    nearest = 0.5 * parameters.reach**2 / exact
    odds = nearest - 0.5 * np.log(size / exact**2) - 0.5 * square
    return np.logaddexp(odds, parameters.apart)


_BEGINNING = 0.5  # seconds that the first frame counts for where nobody knows when the next one will come
FORGOTTEN = 5.0
"""Times of averaging after which, where the past alone counts, two who meet again meet for the first time."""


def averaged(
    pair: IntArray, t: FloatArray, values: FloatArray, seconds: float
) -> tuple[FloatArray, FloatArray]:
    """Averages (n, k) with weights exp(−|Δt|/seconds) within each pair (n,), and the sums of weights (n,) s.

    Each frame counts for the time about it, so that the frame rate is without effect, but no frame for more
    than `seconds`. Without averaging (0 s) the values stay, and the sums are 0.
    """
    if seconds <= 0.0 or not len(pair):
        return values, np.zeros(len(pair))
    order: NDArray[np.int64] = np.lexsort((t, pair))
    found, weight = np.empty_like(values), np.empty(len(pair))
    found[order], weight[order] = _averaged(pair[order], t[order], values[order], seconds)
    return found, weight


@allocating
def _averaged(
    pair: IntArray, t: FloatArray, values: FloatArray, seconds: float
) -> tuple[FloatArray, FloatArray]:
    n, size = values.shape
    about, found, overall = np.empty(n), np.empty((n, size)), np.empty(n)
    for k in range(n):
        low = t[k] - t[k - 1] if k > 0 and pair[k - 1] == pair[k] else math.inf
        high = t[k + 1] - t[k] if k + 1 < n and pair[k + 1] == pair[k] else math.inf
        if low == math.inf or high == math.inf:
            about[k] = min(low, high, seconds)
        else:
            about[k] = 0.5 * (min(low, seconds) + min(high, seconds))
        fade = math.exp(-low / seconds)
        overall[k] = about[k]
        found[k] = about[k] * values[k]
        if fade > 0.0:
            overall[k] += fade * overall[k - 1]
            found[k] += fade * found[k - 1]
    after, total = np.zeros(size), 0.0
    for k in range(n - 1, -1, -1):
        if k + 1 < n and pair[k + 1] == pair[k]:
            fade = math.exp(-(t[k + 1] - t[k]) / seconds)
            after[:] = fade * (after + about[k + 1] * values[k + 1])
            total = fade * (total + about[k + 1])
        else:
            after[:] = 0.0
            total = 0.0
        overall[k] += total
        found[k] = (found[k] + after) / overall[k]
    return found, overall


@compiled
def since(gap: float, seconds: float) -> tuple[float, float]:
    """Return the seconds a frame counts for where the past alone does, and the share of the past that stays.

    ``gap``: seconds from the frame before; infinite for the first
    """
    if gap > FORGOTTEN * seconds + TIME_TOLERANCE:
        return min(_BEGINNING, seconds), 0.0
    return min(gap, seconds), math.exp(-gap / seconds)


@allocating
def merged(
    known: IntArray,
    last: FloatArray,
    sums: FloatArray,
    pairs: IntArray,
    values: FloatArray,
    of: IntArray,
    seconds: FloatArray,
    t: float,
) -> tuple[IntArray, FloatArray, FloatArray, FloatArray]:
    """Take in a frame's pairs: all that are still known, when last seen, their sums; the averages of these.

    Parameters
    ----------
    known, pairs : (k, 2), (n, 2) ids, both ascending by the second, then by the first
    last : (k,) seconds
    sums : (k, 6) of the values of each pair, times the seconds that they count for, and of the seconds
    values : (n, 4)
    of : (4,) which of the times of averaging each value has
    seconds : (2,)
    """
    size, count = values.shape[1], len(pairs)
    room = len(known) + count
    all_pairs, all_last = np.empty((room, 2), dtype=np.int64), np.empty(room)
    all_sums, means = np.empty((room, sums.shape[1])), np.empty((count, size))
    at, k, n = 0, 0, 0
    while k < len(known) or n < count:
        before = n == count or (
            k < len(known)
            and (known[k, 1] < pairs[n, 1] or (known[k, 1] == pairs[n, 1] and known[k, 0] < pairs[n, 0]))
        )
        if before:
            if t - last[k] <= FORGOTTEN * seconds.max() + TIME_TOLERANCE:
                all_pairs[at], all_last[at], all_sums[at] = known[k], last[k], sums[k]
                at += 1
            k += 1
            continue
        met = k < len(known) and known[k, 0] == pairs[n, 0] and known[k, 1] == pairs[n, 1]
        gap = t - last[k] if met else math.inf
        all_pairs[at], all_last[at] = pairs[n], t
        for part in range(len(seconds)):
            about, fade = since(gap, seconds[part])
            weight = about
            if fade > 0.0:
                weight += fade * sums[k, size + part]
            all_sums[at, size + part] = weight
            for j in range(size):
                if of[j] != part:
                    continue
                total = about * values[n, j]
                if fade > 0.0:
                    total += fade * sums[k, j]
                all_sums[at, j] = total
                means[n, j] = total / weight if seconds[part] > 0.0 else values[n, j]
        at += 1
        k += met
        n += 1
    return all_pairs[:at].copy(), all_last[:at].copy(), all_sums[:at].copy(), means


_SPEED_STEP = 0.1  # m/s over which standing becomes walking
ALONG = 1.5
"""Those who walk together are side by side: a metre along their way counts as so many across it."""
_MOST = 6.0  # log odds that one frame of walking says at most
_STANDING = 0.02
"""Share of the time that two who stand all along appear not to stand, by the smooth step of speeds."""
_PASSING = 0.2
"""Share of the people who walk within 4 m that pass within the reach of an o-space."""
_CAME = 0.1
"""Share of the time near each other, not spent together, from which two are known to have met in sight."""


@dataclass(frozen=True, eq=False)
class PairEvidence:
    """Pairs of people near each other, frame by frame."""

    left: IntArray  # (n,) rows in `People`
    right: IntArray  # (n,) rows in `People`
    start: IntArray  # (k + 1,) first pair of each frame
    odds: FloatArray  # (n,) log odds that they are of one group, averaged over time
    walking: FloatArray  # (n,) how much both walk, 0 to 1, averaged over time


def abreast(people: People, left: IntArray, right: IntArray) -> tuple[FloatArray, FloatArray]:
    """Distances of walkers (n,) m, along their way counted more; squared velocity differences (n,) m²/s²."""
    apart = people.position[right] - people.position[left]
    unlike = people.velocity[right] - people.velocity[left]
    way = people.velocity[right] + people.velocity[left]
    way = way / np.maximum(np.linalg.norm(way, axis=1), 1e-9)[:, None]
    along = np.sum(apart * way, axis=1)
    across = apart[:, 0] * way[:, 1] - apart[:, 1] * way[:, 0]
    return np.hypot(across, ALONG * along), np.sum(unlike**2, axis=1)


def walking_odds(people: People, left: IntArray, right: IntArray, parameters: GroupParameters) -> FloatArray:
    """Log odds, (n,), that two who walk do so together: how near, side by side and alike they go."""
    far, square = abreast(people, left, right)
    mean, std = parameters.walking_distance, parameters.walking_distance_std
    near = -0.5 * ((far - mean) / std) ** 2 - np.log(
        np.sqrt(2.0 * np.pi) * std * 2.0 * np.pi * np.maximum(far, 0.2)
    )
    alike, other = parameters.walking_speed_std, parameters.strangers_speed_std
    same = -0.5 * square * (1.0 / alike**2 - 1.0 / other**2) + 2.0 * np.log(other / alike)
    prior = np.log(parameters.walking_share / (1.0 - parameters.walking_share))
    odds: FloatArray = np.clip(prior + near - np.log(parameters.strangers_density) + same, -_MOST, _MOST)
    return odds


def encounter_odds(share: FloatArray, seconds: FloatArray, parameters: GroupParameters) -> FloatArray:
    """Log odds, (n,), against a conversation of two who met a short time ago: strangers soon part.

    encounter_odds · exp(−share · seconds/encounter_seconds), and none for two who were together for as long
    as they were near each other, since they may have met before. ``share``: (n,) of the ``seconds`` (n,) near
    each other, weighted by exp(−|Δt|/memory_seconds), in which they stood or walked together.
    """
    met = np.clip((1.0 - share - _STANDING) / _CAME, 0.0, 1.0)
    decay = np.exp(-share * seconds / parameters.encounter_seconds)
    return np.asarray(parameters.encounter_odds * met * decay)


def walks(people: People, parameters: GroupParameters) -> FloatArray:
    """(n,) how much each walks, 0 to 1, by speed."""
    speed = np.linalg.norm(people.velocity, axis=1)
    share: FloatArray = 0.5 * (1.0 + np.tanh(0.5 * (speed - parameters.walking_speed) / _SPEED_STEP))
    return share


@dataclass(frozen=True, eq=False)
class PairValues:
    """Evidence of pairs near each other from single frames.

    Attributes
    ----------
    left, right : (n,) rows in `People`, the left one first
    values : (n, 4) log odds of one group, and how much both walk, averaged over ``persistence_seconds``; the
        probability that both stand, or walk together, and the number of walkers near them, over
        ``memory_seconds``
    """

    left: IntArray
    right: IntArray
    values: FloatArray

    def evidence(
        self, people: People, means: FloatArray, seconds: FloatArray, parameters: GroupParameters
    ) -> PairEvidence:
        """The evidence, given the averages (n, 4) and the seconds (n,) that the last ones are of."""
        start = np.searchsorted(people.frame_of[self.left], np.arange(len(people.frame) + 1))
        odds, walking, company, walkers = means.T
        standing = np.maximum(1.0 - 2.0 * walking, 0.0)  # groups that walk are judged by how they do
        # Two who stand may also be any of the people who walk there and have stopped.
        odds = odds - standing * (encounter_odds(company, seconds, parameters) + np.log1p(_PASSING * walkers))
        return PairEvidence(self.left, self.right, start, odds, walking)


_OF = np.array([0, 0, 1, 1])
"""Which of the times of averaging each of a pair's values has."""


def pair_values(people: People, parameters: GroupParameters) -> PairValues:
    """Return the evidence of single frames: by bodies and heads, and again with where the others stand."""
    left, right = near_pairs(people)
    observed = observed_scores(people, parameters)
    odds = conversation_odds(*o_spaces(people, observed, parameters.stride), left, right, parameters)
    score = observed + facing_scores(people.position, left, right, odds, parameters)
    odds = conversation_odds(*o_spaces(people, score, parameters.stride), left, right, parameters)
    walk = walks(people, parameters)
    walking, standing = walk[left] * walk[right], (1.0 - walk[left]) * (1.0 - walk[right])
    alike = walking_odds(people, left, right, parameters)
    company = standing + walking * 0.5 * (1.0 + np.tanh(0.5 * alike))
    odds = standing * odds + (1.0 - standing - walking) * parameters.apart + walking * alike
    walkers = np.bincount(left, walk[right], len(people)) + np.bincount(right, walk[left], len(people))
    near = np.minimum(walkers[left] - walk[right], walkers[right] - walk[left])
    return PairValues(left, right, np.column_stack([odds, walking, company, np.maximum(near, 0.0)]))


def pair_evidence(people: People, parameters: GroupParameters) -> PairEvidence:
    """The evidence of all pairs of a recording, from the past and the future of each frame."""
    found = pair_values(people, parameters)
    pair = people.person[found.left] * len(people.ids) + people.person[found.right]
    t = people.t[people.frame_of[found.left]]
    persistence, memory = parameters.seconds
    odds, _ = averaged(pair, t, found.values[:, :2], persistence)
    company, seconds = averaged(pair, t, found.values[:, 2:], memory)
    return found.evidence(people, np.hstack([odds, company]), seconds, parameters)


class OnlineEvidence(Saved):
    """`pair_evidence` from the past alone, frame by frame.

    Each pair has averages of its own. What is kept is bounded: the pairs that were within 4 m of each other
    in the last minutes (five times the longest time of averaging).
    """

    _saved: ClassVar = dict.fromkeys(("_pairs", "_last", "_sums"), np.ndarray)

    def __init__(self, parameters: GroupParameters) -> None:
        self.parameters = parameters
        self._pairs = np.empty((0, 2), dtype=np.int64)  # ids, ascending by the greater, then by the lesser
        self._last = np.empty(0)
        # Of each pair its values, each times the seconds it counts for, and those seconds.
        self._sums = np.empty((0, 6))

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
            _OF,
            np.array(self.parameters.seconds),
            t,
        )
        here = self._last == t  # in the order of the frame's pairs
        return found.evidence(people, means, self._sums[here, 5], self.parameters)
