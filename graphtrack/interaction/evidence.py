"""Log odds that two people are of one group, frame by frame and averaged over time.

A conversation has an o-space (Kendon 1990): an empty place that its members face, each from about the same
distance. The odds of a pair are those of the distance between the o-spaces of both, given how surely bodies
and heads point there, and where the other people stand.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from graphtrack.geometry.angles import FloatArray, concentration_from_resultant, unit
from graphtrack.interaction.parameters import GroupParameters
from graphtrack.interaction.people import IntArray, People, presence
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
    pair: IntArray, t: FloatArray, values: FloatArray, share: FloatArray, seconds: float
) -> tuple[FloatArray, FloatArray]:
    """Averages (k, n) with weights exp(−|Δt|/seconds) within each pair (n,), and the sums of weights (n,) s.

    ``values``: (n, k).

    Each frame counts for a share (n,) of the time about it, so that the frame rate is without effect, but no
    frame for more than `seconds`. Without averaging (0 s) the values stay, and the sums are 0.
    """
    if seconds <= 0.0 or not len(pair):
        return values.T, np.zeros(len(pair))
    order: NDArray[np.int64] = np.lexsort((t, pair))
    found, weight = np.empty_like(values), np.empty(len(pair))
    found[order], weight[order] = _averaged(pair[order], t[order], values[order], share[order], seconds)
    return found.T, weight


@allocating
def _averaged(
    pair: IntArray, t: FloatArray, values: FloatArray, share: FloatArray, seconds: float
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
        about[k] *= share[k]
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


class PairValues(NamedTuple):
    """Evidence of pairs of people near each other in one frame, or averaged over time.

    Attributes
    ----------
    left, right : (n,) rows in `People`, the left one first
    odds : (n,) log odds of one group, averaged over ``persistence_seconds``
    walking : (n,) how much both walk, 0 to 1, averaged likewise
    company : (n,) probability that both stand, or walk together, averaged over ``memory_seconds``
    walkers : (n,) walkers near them, averaged likewise
    share : (n,) by which these count: less, the longer ago either person was observed
    """

    left: IntArray
    right: IntArray
    odds: FloatArray
    walking: FloatArray
    company: FloatArray
    walkers: FloatArray
    share: FloatArray

    def evidence(self, people: People, seconds: FloatArray, parameters: GroupParameters) -> PairEvidence:
        """Return the evidence of averages, given the seconds (n,) that ``company`` and ``walkers`` are of."""
        start = np.searchsorted(people.frame_of[self.left], np.arange(len(people.frame) + 1))
        standing = np.maximum(1.0 - 2.0 * self.walking, 0.0)  # groups that walk are judged by how they do
        # Two who stand may also be any of the people who walk there and have stopped.
        against = encounter_odds(self.company, seconds, parameters) + np.log1p(_PASSING * self.walkers)
        odds = self.odds - standing * against
        # Of one group are those alone who are still there.
        odds = np.where(self.share < 1.0, np.log(self.share) - np.log(1.0 - self.share + np.exp(-odds)), odds)
        return PairEvidence(self.left, self.right, start, odds, self.walking)


KNOWN = np.dtype(
    [
        ("lesser", np.int64),  # ids
        ("greater", np.int64),
        ("t", float),  # seconds, when they were last near each other
        ("odds", float),  # sums of `PairValues`, each times the seconds that it counts for
        ("walking", float),
        ("persistence", float),  # these seconds
        ("company", float),
        ("walkers", float),
        ("memory", float),
    ]
)
"""Pair that is known from the past."""


@allocating
def merged(
    known: NDArray[np.void],
    lesser: IntArray,
    greater: IntArray,
    found: PairValues,
    persistence: float,
    memory: float,
    t: float,
) -> tuple[NDArray[np.void], PairValues]:
    """Take in a frame's pairs: return all that are still known, and the averages of the frame's.

    Parameters
    ----------
    known : (k,) of `KNOWN`
    lesser, greater : (n,) ids of the frame's pairs; both ascend by the greater, then by the lesser
    persistence, memory : seconds of averaging
    """
    count, blank = len(lesser), np.zeros(1, KNOWN)
    every = np.empty(len(known) + count, KNOWN)
    odds, walking = found.odds.copy(), found.walking.copy()
    company, walkers = found.company.copy(), found.walkers.copy()
    at, k, n = 0, 0, 0
    while k < len(known) or n < count:
        if n == count or (
            k < len(known)
            and (
                known[k].greater < greater[n]
                or (known[k].greater == greater[n] and known[k].lesser < lesser[n])
            )
        ):
            if t - known[k].t <= FORGOTTEN * max(persistence, memory) + TIME_TOLERANCE:
                every[at] = known[k]
                at += 1
            k += 1
            continue
        met = k < len(known) and known[k].lesser == lesser[n] and known[k].greater == greater[n]
        old, new = known[k] if met else blank[0], every[at]
        gap = t - old.t if met else math.inf
        new.lesser, new.greater, new.t = lesser[n], greater[n], t
        about, stays = since(gap, persistence)
        about *= found.share[n]
        new.persistence = about + stays * old.persistence
        new.odds = about * odds[n] + stays * old.odds
        new.walking = about * walking[n] + stays * old.walking
        if persistence > 0.0:
            odds[n], walking[n] = new.odds / new.persistence, new.walking / new.persistence
        about, stays = since(gap, memory)
        about *= found.share[n]
        new.memory = about + stays * old.memory
        new.company = about * company[n] + stays * old.company
        new.walkers = about * walkers[n] + stays * old.walkers
        if memory > 0.0:
            company[n], walkers[n] = new.company / new.memory, new.walkers / new.memory
        at += 1
        k += met
        n += 1
    return every[:at].copy(), PairValues(
        found.left, found.right, odds, walking, company, walkers, found.share
    )


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
    share = presence(people.age)
    return PairValues(left, right, odds, walking, company, np.maximum(near, 0.0), share[left] * share[right])


def pair_evidence(people: People, parameters: GroupParameters) -> PairEvidence:
    """The evidence of all pairs of a recording, from the past and the future of each frame."""
    found = pair_values(people, parameters)
    pair = people.person[found.left] * len(people.ids) + people.person[found.right]
    t = people.t[people.frame_of[found.left]]
    lasting = np.column_stack([found.odds, found.walking])
    remembered = np.column_stack([found.company, found.walkers])
    (odds, walking), _ = averaged(pair, t, lasting, found.share, parameters.persistence_seconds)
    (company, walkers), seconds = averaged(pair, t, remembered, found.share, parameters.memory_seconds)
    means = found._replace(odds=odds, walking=walking, company=company, walkers=walkers)
    return means.evidence(people, seconds, parameters)


class OnlineEvidence(Saved):
    """`pair_evidence` from the past alone, frame by frame.

    Each pair has averages of its own. What is kept is bounded: the pairs that were within 4 m of each other
    in the last minutes (five times the longest time of averaging).
    """

    _saved: ClassVar = {"_known": np.ndarray}

    def __init__(self, parameters: GroupParameters) -> None:
        self.parameters = parameters
        self._known = np.empty(0, KNOWN)  # ascending by the greater id, then by the lesser

    def __len__(self) -> int:
        """The pairs that are known."""
        return len(self._known)

    def take(self, people: People) -> PairEvidence:
        """Take in the people of one frame, later than those before, or of none; the evidence of its pairs."""
        found = pair_values(people, self.parameters)
        if not len(people):
            return found.evidence(people, np.zeros(0), self.parameters)
        t, parameters = float(people.t[0]), self.parameters
        ids = people.ids[found.left], people.ids[found.right]
        seconds = parameters.persistence_seconds, parameters.memory_seconds
        self._known, means = merged(self._known, *ids, found, *seconds, t)
        here = self._known["t"] == t  # in the order of the frame's pairs
        return means.evidence(people, self._known["memory"][here], parameters)
