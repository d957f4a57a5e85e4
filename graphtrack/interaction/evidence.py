"""Log odds that two people are of one group, frame by frame and averaged over time.

Features of a pair are positions, o-spaces, crowding and gaze; unknown bodies are taken to face where the
others stand, for an o-space is empty, with companions about it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from graphtrack.geometry.angles import FloatArray, unit
from graphtrack.interaction.parameters import RINGS, GroupParameters
from graphtrack.interaction.people import IntArray, People
from graphtrack.kernels.compilation import allocating, compiled
from graphtrack.saved import from_text, to_text

FEATURES = ("shared", "crowd", "far", "rank", "look")  # in order, as in `ConversationWeights`
REACH = 4.0  # metres: people further apart are in no group by themselves, only through others
_SHARED = 0.6  # metres over which two o-spaces count as one
_CROWD = 1.0  # metres over which somebody counts for the crowd about a place
_SOFT = 0.2  # metres of distance that make somebody clearly nearer than another
_LOOK = 0.5  # radians, 1-σ of where a head points about what is looked at
_NOTHING = 0.05  # weight of looks at nobody, where that of a look straight at somebody near is 1


@allocating
def _of_frame(
    position: FloatArray,
    body: FloatArray,
    head: FloatArray,
    stride: float,
    left: IntArray,
    right: IntArray,
    found: FloatArray,
    at: int,
    offset: int,
) -> int:
    """Write the pairs of one frame within reach from place ``at`` on; return the place after them."""
    people = len(position)
    apart, shared = np.zeros((people, people)), np.zeros((people, people))
    look, near = np.zeros((people, people)), np.zeros((people, people))
    space = position + stride * body
    crowd, last_known = np.ones(people), np.full(people, _NOTHING)
    for i in range(people):
        shared[i, i] = 1.0
        for j in range(people):
            if j == i:
                continue
            x, y = position[j, 0] - position[i, 0], position[j, 1] - position[i, 1]
            square = x * x + y * y
            apart[i, j] = math.sqrt(square)
            if apart[i, j] > 3.0 * REACH:
                continue
            crowd[i] += math.exp(-0.5 * square / (_CROWD * _CROWD))
            near[i, j] = math.exp(-apart[i, j] / _SOFT)
            dx, dy = space[j, 0] - space[i, 0], space[j, 1] - space[i, 1]
            shared[i, j] = math.exp(-0.5 * (dx * dx + dy * dy) / (_SHARED * _SHARED))
            length = math.hypot(head[i, 0], head[i, 1])
            if length > 0.0:
                across, along = head[i, 0] * y - head[i, 1] * x, head[i, 0] * x + head[i, 1] * y
                angle = math.atan2(across, along)
                look[i, j] = length * math.exp(-0.5 * (angle / _LOOK) ** 2) / (1.0 + 0.5 * square)
                last_known[i] += look[i, j]
    for i in range(people):
        for j in range(i):
            far = apart[i, j]
            if far > REACH:
                continue
            # Each k is nearer than the other one by a logistic function of distances, which is a ratio. The
            # other one counts for a half, which is taken off, and somebody is not near to themselves.
            both, before_one, before_other = 0.0, -0.5, -0.5
            here = near[i, j]
            for k in range(people):
                both += shared[i, k] * shared[j, k]
                before_one += near[i, k] / (near[i, k] + here)
                before_other += near[j, k] / (near[j, k] + here)
            ahead = math.hypot(space[i, 0] - position[j, 0], space[i, 1] - position[j, 1])
            other = math.hypot(space[j, 0] - position[i, 0], space[j, 1] - position[i, 1])
            found[at, 0] = math.log1p(both)
            found[at, 1] = math.log(crowd[i]) + math.log(crowd[j])
            found[at, 2] = max(ahead, other)
            found[at, 3] = math.log1p(before_one) + math.log1p(before_other)
            found[at, 4] = min(look[i, j] / last_known[i], look[j, i] / last_known[j])
            left[at], right[at] = offset + j, offset + i
            at += 1
    return at


@compiled
def _near_pairs(position: FloatArray, first: IntArray) -> int:
    count = 0
    for k in range(len(first) - 1):
        for i in range(first[k], first[k + 1]):
            for j in range(first[k], i):
                x, y = position[j, 0] - position[i, 0], position[j, 1] - position[i, 1]
                count += math.sqrt(x * x + y * y) <= REACH
    return count


@compiled
def of_frames(
    position: FloatArray,
    body: FloatArray,
    head: FloatArray,
    first: IntArray,
    stride: float,
    left: IntArray,
    right: IntArray,
    found: FloatArray,
) -> int:
    """Write the pairs of all frames, as `pair_features` gives them; how many there are."""
    at = 0
    for k in range(len(first) - 1):
        rows = slice(first[k], first[k + 1])
        at = _of_frame(position[rows], body[rows], head[rows], stride, left, right, found, at, first[k])
    return at


def pair_features(people: People, stride: float) -> tuple[IntArray, IntArray, FloatArray]:
    """Rows (n,) of the two people of each pair within `REACH`, frame by frame, and its `FEATURES` (n, 5).

    ``stride``: metres to the o-space ahead of somebody; where the body is unknown, it is where they stand
    """
    # A pair at the very edge may be counted and not found, as sums are reordered: there is room for more.
    count = _near_pairs(people.position, people.first) + len(people.frame)
    left, right = np.empty(count, dtype=np.int64), np.empty(count, dtype=np.int64)
    found = np.empty((count, len(FEATURES)))
    arrays = (people.position, people.body, people.head, people.first)
    end = of_frames(*arrays, stride, left, right, found)
    return left[:end], right[:end], found[:end]


DIRECTIONS: FloatArray = 2.0 * np.pi * np.arange(36) / 36
"""Radians, of the bodies that are compared."""
_WIDTH = 0.2  # metres, 1-σ of a ring
_FARTHEST = 2.5  # metres from an o-space beyond which somebody tells nothing of it


@allocating
def _add_scores(
    position: FloatArray,
    space: FloatArray,
    rings: FloatArray,
    weights: FloatArray,
    left: IntArray,
    right: IntArray,
    together: FloatArray,
    found: FloatArray,
) -> None:
    weight = np.empty(len(rings))
    for k in range(len(left)):
        weight[:] = together[k] * weights[0] + (1.0 - together[k]) * weights[1]
        x, y = position[right[k], 0] - position[left[k], 0], position[right[k], 1] - position[left[k], 1]
        for d in range(len(space)):
            for side in range(2):
                sign = 1.0 - 2.0 * side
                far = math.hypot(sign * x - space[d, 0], sign * y - space[d, 1])
                if far > _FARTHEST:
                    continue
                total = 0.0
                for r in range(len(rings)):
                    total += weight[r] * math.exp(-0.5 * ((far - rings[r]) / _WIDTH) ** 2)
                found[right[k] if side else left[k], d] += total


def facing_scores(
    position: FloatArray,
    left: IntArray,
    right: IntArray,
    together: FloatArray,
    weights: FloatArray,
    stride: float,
) -> FloatArray:
    """Log odds (n, directions) of each person's body pointing there, of where the others are.

    Parameters
    ----------
    position : (n, 2) metres
    left, right : (k,) rows of the two of a pair of people near each other in one frame
    together : (k,) probability that they are in one conversation
    weights : (2, rings) of companions and of others
    stride : metres to the o-space ahead of a body
    """
    found = np.zeros((len(position), len(DIRECTIONS)))
    space, rings = stride * unit(DIRECTIONS), np.array(RINGS)
    _add_scores(position, space, rings, weights, left, right, together, found)
    return found


def facing(
    position: FloatArray, left: IntArray, right: IntArray, odds: FloatArray, parameters: GroupParameters
) -> FloatArray:
    """(n, 2) expected unit vectors of bodies by where the others stand, given log odds of pairs; or 0."""
    weights = np.stack([parameters.companions.of_rings, parameters.strangers.of_rings])
    together = 0.5 * (1.0 + np.tanh(0.5 * odds))
    score = facing_scores(position, left, right, together, weights, parameters.stride)
    found: FloatArray = np.zeros((len(position), 2))
    met = score.any(axis=1)
    found[met] = probabilities(score[met]) @ unit(DIRECTIONS)
    return found


def probabilities(score: FloatArray) -> FloatArray:
    """(n, k) of log odds (n, k)."""
    likelihood = np.exp(score - score.max(axis=1, keepdims=True))
    return np.asarray(likelihood / likelihood.sum(axis=1, keepdims=True))


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
    if gap > FORGOTTEN * seconds:
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
    sums : (k, 9) of the values of each pair, times the seconds that they count for, and of the seconds
    values : (n, 6)
    of : (6,) which of the times of averaging each value has
    seconds : (3,)
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
            if t - last[k] <= FORGOTTEN * seconds.max():
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


SLOW = np.array([False, True, False, False, True])
"""Mask of the features that are averaged over ``look_seconds``."""
_SPEED_STEP = 0.1  # m/s over which standing becomes walking
ALONG = 1.5
"""Those who walk together are side by side: a metre along their way counts as so many across it."""
_MOST = 6.0  # log odds that one frame of walking says at most
_CAME = 0.1
"""Share of the time near each other, not spent together, from which two are known to have met in sight."""
_UNSURE = 0.01
"""How much shorter than 1 the expected direction of a body is that is looked for among the others."""


@dataclass(frozen=True, eq=False)
class PairEvidence:
    """Pairs of people near each other, frame by frame."""

    left: IntArray  # (n,) rows in `People`
    right: IntArray  # (n,) rows in `People`
    start: IntArray  # (k + 1,) first pair of each frame
    odds: FloatArray  # (n,) log odds that they are of one group, averaged over time
    caution: FloatArray  # (n,) to be taken from them before people are parted
    walking: FloatArray  # (n,) how much both walk, 0 to 1, averaged over time


def with_bodies(people: People, spread: float) -> People:
    """People whose unknown bodies are where their heads point, more or less: 1-σ ``spread`` radians."""
    unseen = np.asarray(~people.body.any(axis=1))
    if not (unseen & people.head.any(axis=1)).any():
        return people
    turned = np.exp(-0.5 * spread**2) * people.head
    return replace(people, body=np.where(unseen[:, None], turned, people.body))


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
    each other, weighted by exp(−|Δt|/look_seconds), in which they stood or walked together.
    """
    met = np.minimum((1.0 - share) / _CAME, 1.0)
    decay = np.exp(-share * seconds / parameters.encounter_seconds)
    return np.asarray(parameters.encounter_odds * met * decay)


def walks(people: People, parameters: GroupParameters) -> FloatArray:
    """(n,) how much each walks, 0 to 1, by speed."""
    speed = np.linalg.norm(people.velocity, axis=1)
    share: FloatArray = 0.5 * (1.0 + np.tanh(0.5 * (speed - parameters.walking_speed) / _SPEED_STEP))
    return share


PARTS = 2  # values of a pair that are averaged over each of the three times


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
    body, head = (np.linalg.norm(vector, axis=1) for vector in (people.body, people.head))
    bodies, heads = body[left] * body[right], head[left] * head[right]
    # How much a pair is one of which positions alone, bodies too, and heads too are known.
    shares = np.column_stack([1.0 - bodies, bodies * (1.0 - heads), bodies * heads])
    quick, slow = np.zeros(len(features)), np.zeros(len(features))
    for share, weights in zip(shares.T, parameters.conversations, strict=True):
        terms = weights.of_features
        quick += share * (weights.bias + features @ np.where(SLOW, 0.0, terms))
        slow += share * (features @ np.where(SLOW, terms, 0.0))
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
