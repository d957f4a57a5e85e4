"""Model of gaze, compiled: densities of head directions given a target, and a Markov chain over targets."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from graphtrack.geometry.angles import BoolArray, FloatArray
from graphtrack.kernels.arithmetic import log_i0e, wrapped
from graphtrack.kernels.compilation import allocating, compiled
from graphtrack.tracks.time import TIME_TOLERANCE

IntArray = np.ndarray

REACH = 15.0
"""Largest distance in metres of people as gaze targets and occluders; places have no limit."""
SHOULDERS = 0.25
"""Half the width in metres of a person as gaze target or occluder."""
PERSON = np.dtype([("x", float), ("y", float), ("variance", float), ("presence", float)])
"""Position of a person, m, its variance, m², and the share of the presence that is certain."""
VIEW = np.dtype(
    [
        ("bearing", float),  # rad
        ("half_angle", float),  # half the angular width, rad
        ("distance", float),  # m; NaN: absent
        ("blur", float),  # variance of a predicted bearing, rad²
        ("presence", float),  # share of the presence that is certain
    ]
)
"""Target as an observer sees it."""
BELIEF = np.dtype([("probability", float), ("mean", float), ("variance", float)])
"""Probability of a target, and the head's deviation from its bearing, rad and rad²."""
WAYS = 24
"""Directions of gaze at no target; they follow the targets."""
_NARROW = 0.26  # radians, slightly more than half the angular width of a person at 1 m
_REPEATED = 1.5  # seconds, twice the correlation time of the errors of heads
_HIDDEN = 0.4  # seconds, mean duration of gaze at a target that other people hide
SETTLING = 0.5
"""Seconds from an observer's first frame in which, online, each frame is as the first one: until then the
other people's first rows may be missing, and with them most of the prior."""
_UNIFORM = 1.0 / (2.0 * math.pi)
_WIDEST = math.pi**2 / 3.0  # rad², variance of the uniform density
_WAY = 2.0 * math.pi / WAYS  # radians between two directions


class GazeParameters(NamedTuple):
    """`AttentionParameters` for kernels."""

    look_std: float
    nothing: float
    distance: float
    fellows: float
    switching: float
    correlation_time: float


class HeadMixture(NamedTuple):
    """Von Mises mixture of a head in n frames."""

    weights: FloatArray  # (n, modes) NaN: unknown
    means: FloatArray  # (n, modes) rad
    kappas: FloatArray  # (n, modes)
    variance: FloatArray  # (n,) rad², of a single mode


class Targets(NamedTuple):
    """Gaze targets of an observer in a frame: people, places and `WAYS`."""

    bearing: FloatArray  # (n,) rad; NaN: absent
    spread: FloatArray  # (n,) rad², variance of heads about the target
    prior: FloatArray  # (n,) probability without a head observation
    likelihood: FloatArray  # (n,) of a head with several modes; 1 for others


class Everybody(NamedTuple):
    """People of a frame, observed or predicted."""

    ids: IntArray  # (m,) ascending
    people: NDArray[np.void]  # (m,) of `PERSON`
    group: IntArray  # (m,) −1: none


class Observers(NamedTuple):
    """People of a frame who are observed."""

    row: IntArray  # (n,) in `Everybody`
    previous: IntArray  # (n,) index among the previous observers, −1: none
    gap: FloatArray  # (n,) seconds from each one's frame before; infinite without one
    head_gap: FloatArray  # (n,) seconds from the last observed head; infinite without one
    head: FloatArray  # (n,) rad; NaN: unknown
    head_variance: FloatArray  # (n,) rad²


class Beliefs(NamedTuple):
    """Beliefs of n observers over their targets."""

    first: IntArray  # (n + 1,) first target of each observer
    target: IntArray  # (k,) ids of people near enough, ascending for each observer
    person: NDArray[np.void]  # (k,) of `BELIEF`, in these
    elsewhere: NDArray[np.void]  # (n, places + WAYS) of `BELIEF`


@compiled
def half_angle(radius: float, distance: float) -> float:
    """Return half the angular width, radians, of a disc from a distance in metres; π from inside it."""
    return math.asin(radius / distance) if distance > radius else math.pi


@allocating
def half_angles(radius: float, distance: FloatArray) -> FloatArray:
    """`half_angle` from (n,) metres."""
    found = np.empty(len(distance))
    for k in range(len(distance)):
        found[k] = half_angle(radius, distance[k])
    return found


@compiled
def view_people(own: Any, neighbours: Any, view: Any) -> None:
    """Fill the view (n,) of other people (n,) of `PERSON` by one; those beyond `REACH` are absent."""
    for j in range(len(neighbours)):
        other, target = neighbours[j], view[j]
        x, y = other.x - own.x, other.y - own.y
        target.bearing, target.distance = math.atan2(y, x), math.hypot(x, y)
        square = max(x * x + y * y, 1e-12)
        target.blur = min((own.variance + other.variance) / square, _WIDEST)
        target.presence = other.presence
        if not target.distance < REACH:
            target.bearing = target.distance = math.nan
        target.half_angle = half_angle(SHOULDERS, target.distance)


@compiled
def concentration_of(variance: float) -> float:
    """Return the von Mises κ of the mean resultant length e^(−variance/2); Fisher (1993), eq. 4.40."""
    r = math.exp(-0.5 * max(variance, 1e-6))
    if r < 0.53:
        return 2.0 * r + r**3 + 5.0 * r**5 / 6.0
    if r < 0.85:
        return -0.4 + 1.39 * r + 0.43 / (1.0 - r)
    return 1.0 / (r**3 - 4.0 * r**2 + 3.0 * r)


@allocating
def concentration(variance: FloatArray) -> FloatArray:
    """`concentration_of` each of (n,) variances; NaN stays so."""
    found = np.empty(len(variance))
    for k in range(len(variance)):
        found[k] = concentration_of(variance[k]) if not math.isnan(variance[k]) else math.nan
    return found


@compiled
def _covered(apart: float, half: float, of_target: float) -> float:
    """Return the angle of a target occluded by a person; negative without overlap."""
    return min(apart + half, of_target) - max(apart - half, -of_target)


@compiled
def _share_in_sight(target: Any, around: Any, wide: Any) -> float:
    """Return the visible share of a target's angle, not occluded by nearer people.

    ``around``, ``wide``: (k,) views of people: of all by their bearing, three times round, and of those who
    cover more than `_NARROW` to either side
    """
    covered, half = 0.0, target.half_angle
    for k in range(len(wide)):
        if wide[k].distance < target.distance:
            apart = abs(wrapped(wide[k].bearing - target.bearing))
            covered = max(covered, _covered(apart, wide[k].half_angle, half))
    middle = wrapped(target.bearing)
    for k in range(np.searchsorted(around.bearing, middle - half - _NARROW), len(around)):
        if around[k].bearing > middle + half + _NARROW:
            break
        if around[k].distance < target.distance:
            covered = max(covered, _covered(abs(around[k].bearing - middle), around[k].half_angle, half))
    return 1.0 - covered / (2.0 * half) if half > 0.0 else 1.0


@allocating
def _occluders(view: Any) -> tuple[Any, Any]:
    """Return people in the form of `_share_in_sight`: those whose bearing is known within their width."""
    near = np.flatnonzero((view.blur < view.half_angle**2) & ~np.isnan(view.distance))
    near = near[np.argsort(view.bearing[near])]
    count = len(near)
    around, wide = np.empty(3 * count, VIEW), np.empty(count, VIEW)
    size = 0
    for place in range(count):
        one = view[near[place]]
        for lap in range(3):
            around[place + lap * count] = one
            around[place + lap * count].bearing += 2.0 * math.pi * (lap - 1)
        if one.half_angle > _NARROW:
            wide[size] = one
            size += 1
    return around, wide[:size]


@allocating
def gaze_prior(view: Any, fellow: BoolArray, parameters: GazeParameters, prior: FloatArray) -> None:
    """Fill prior probabilities of targets and `WAYS`, (targets + WAYS,), without a head observation.

    Without a target that is certain to be present, the probability of no target is greater.

    Parameters
    ----------
    view : (targets,) of `VIEW`; people come first
    fellow : (people,) True in the observer's group
    """
    people = len(fellow)
    around, wide = _occluders(view[:people])
    total, surest = 0.0, 0.0
    for j in range(len(view)):
        prior[j] = 0.0
        one = view[j]
        if math.isnan(one.distance):
            continue
        weight = _share_in_sight(one, around, wide) * one.presence
        weight /= 1.0 + (one.distance / parameters.distance) ** 2
        if j < people and fellow[j]:
            weight *= parameters.fellows
        prior[j] = weight
        total += weight
        surest = max(surest, one.presence if weight > 0.0 else 0.0)
    if not total > 1e-12:
        total, surest = 1.0, 0.0
    at_any = surest * (1.0 - parameters.nothing)
    prior[:-WAYS] *= at_any / total
    prior[-WAYS:] = (1.0 - at_any) / WAYS


@compiled
def head_variances(view: Any, look_std: float, spread: FloatArray) -> None:
    """Fill the variances (targets + WAYS,), rad², of heads about targets.

    The variance of gaze, and those of the interval that a target covers and of its predicted bearing. Gaze at
    no target has no fixed aim: twice the variance.
    """
    for j in range(len(view)):
        spread[j] = look_std**2 + min(view[j].half_angle, math.pi) ** 2 / 3.0 + view[j].blur
    spread[-WAYS:] = 2.0 * look_std**2


@allocating
def densities(
    bearing: FloatArray,
    spread: FloatArray,
    weights: FloatArray,
    means: FloatArray,
    kappas: FloatArray,
    found: FloatArray,
) -> None:
    """Fill likelihoods of gaze at each target (n,), given a head's posterior with several modes.

    The product of two von Mises densities is integrated, of the head and of gaze at the target.

    ``bearing``, ``spread``: (n,) rad and rad²; ``weights``, ``means``, ``kappas``: (modes,) of the head
    """
    scale = np.empty(len(kappas))
    for m in range(len(kappas)):
        scale[m] = kappas[m] + log_i0e(kappas[m])
    for j in range(len(bearing)):
        of_target = concentration_of(spread[j])
        of_scale = of_target + log_i0e(of_target)
        total = 0.0
        for m in range(len(kappas)):
            product = 2.0 * kappas[m] * of_target * math.cos(means[m] - bearing[j])
            both = math.sqrt(max(kappas[m] ** 2 + of_target**2 + product, 0.0))
            total += weights[m] * math.exp(both + log_i0e(both) - scale[m] - of_scale)
        found[j] = total * _UNIFORM


@compiled
def _normal(deviation: float, variance: float) -> float:
    return max(math.exp(-0.5 * deviation**2 / variance) / math.sqrt(2.0 * math.pi * variance), 1e-12)


@compiled
def new_share(since: float) -> float:
    """Return the share of a head's observation that is new ``since`` seconds after the one before.

    Its errors are correlated over time, so that the information of a second does not depend on the rate.
    """
    return math.tanh(since / _REPEATED)


@compiled
def update_belief(
    gap: float,
    head: float,
    head_variance: float,
    targets: Targets,
    parameters: GazeParameters,
    belief: Any,
    held: FloatArray,
    drawn: FloatArray,
) -> None:
    """Step of the filter over targets: the target stays, or is drawn from the frame's prior.

    A head's deviation from each target is an Ornstein-Uhlenbeck process about 0, with a Kalman filter of its
    own; the two cases are merged into one Gaussian.

    Parameters
    ----------
    gap : seconds from the frame before; infinite for the first
    head, head_variance : direction, rad, and rad²; NaN if unknown or with several modes
    belief : (n,) of `BELIEF`, filtered in place
    held, drawn : (n,) filled: likelihoods, times the probability of staying, and of being drawn
    """
    bearing, spread, prior, likelihood = targets
    stay = math.exp(-parameters.switching * gap)
    hidden = stay * math.exp(-gap / _HIDDEN)
    correlation = max(parameters.correlation_time, 1e-9)
    ways = len(prior) - WAYS
    for j in range(ways):
        if belief[j].probability == 0.0 and prior[j] > 0.0:
            # Gaze in the direction of a target that appears may have been at this target.
            way = ways + math.floor(bearing[j] / _WAY + 0.5) % WAYS
            belief[j].probability = belief[way].probability * prior[j] / max(prior[way], 1e-12)
            belief[j].mean = wrapped(belief[way].mean + bearing[way] - bearing[j])
            belief[j].variance = belief[way].variance
    total = 0.0
    for j in range(len(prior)):
        one = belief[j]
        known = not math.isnan(bearing[j])
        held[j] = (stay if prior[j] > 0.0 else hidden) * likelihood[j] if known else 0.0
        drawn[j] = (1.0 - stay) * prior[j] * likelihood[j]
        fresh_mean, fresh = 0.0, spread[j] if known else 1.0
        # Wide targets have longer memories, else the movement of a head would tell them from narrow ones.
        memory = math.exp(-gap / correlation * parameters.look_std**2 / fresh)
        mean = memory * one.mean
        variance = memory**2 * one.variance + (1.0 - memory**2) * fresh
        if known and not math.isnan(head):
            deviation = wrapped(head - bearing[j])
            off = wrapped(deviation - mean)
            held[j] *= _normal(off, variance + head_variance)
            drawn[j] *= _normal(deviation, fresh + head_variance)
            mean += variance / (variance + head_variance) * off
            variance *= head_variance / (variance + head_variance)
            fresh_mean = fresh / (fresh + head_variance) * deviation
            fresh *= head_variance / (fresh + head_variance)
        stayed = one.probability * held[j]
        value = stayed + drawn[j]
        share = stayed / value if value > 0.0 else 0.0
        apart = wrapped(mean - fresh_mean)
        one.probability = value
        one.mean = fresh_mean + share * apart
        one.variance = share * variance + (1.0 - share) * fresh + share * (1.0 - share) * apart**2
        total += value
    for j in range(len(prior)):
        belief[j].probability = belief[j].probability / total if total > 0.0 else prior[j]


@allocating
def view_targets(
    own: Any,
    neighbours: Any,
    fellow: BoolArray,
    places: Any,
    parameters: GazeParameters,
    view: Any,
    targets: Targets,
) -> None:
    """Fill the view (people + places,) of a frame, and the targets.

    Parameters
    ----------
    own, neighbours : of `PERSON`, and (people,) of it
    fellow : (people,) True in the observer's group
    places : (places,) of `VIEW`
    """
    people, count = len(neighbours), len(view)
    view_people(own, neighbours, view[:people])
    view[people:] = places
    targets.bearing[:count], targets.bearing[count:] = view.bearing, _WAY * np.arange(WAYS)
    head_variances(view, parameters.look_std, targets.spread)
    gaze_prior(view, fellow, parameters, targets.prior)
    targets.likelihood[:] = 1.0


@allocating
def gaze_over_time(
    own: Any,
    neighbours: Any,
    fellow: BoolArray,
    places: Any,
    head: HeadMixture,
    gap: FloatArray,
    both: bool,
    parameters: GazeParameters,
) -> FloatArray:
    """Return (n, targets + 1) gaze probabilities in each frame, filtered or smoothed.

    Parameters
    ----------
    own, neighbours : (n,), (n, people) of `PERSON`; NaN: absent
    fellow : (n, people)
    places : (n, places) of `VIEW`
    gap : (n,) seconds from the frame before
    """
    n, people = fellow.shape
    count = people + places.shape[1]
    size = count + WAYS
    view = np.empty(count, VIEW)
    targets = Targets(np.empty(size), np.empty(size), np.empty(size), np.empty(size))
    held, drawn, found = np.empty((n, size)), np.empty((n, size)), np.empty((n, size))
    belief: Any = np.zeros(size, BELIEF)
    likelihood = targets.likelihood
    since, elapsed = math.inf, 0.0
    for f in range(n):
        before = gap[f] if f > 0 else math.inf
        since += before
        elapsed += gap[f] if f > 0 else 0.0
        if not both and elapsed < SETTLING - TIME_TOLERANCE:
            before = since = math.inf
        view_targets(own[f], neighbours[f], fellow[f], places[f], parameters, view, targets)
        direction = variance = math.nan
        if not math.isnan(head.weights[f, 0]):
            share = new_share(since)
            since = 0.0
            if head.weights.shape[1] > 1:
                modes = head.weights[f], head.means[f], head.kappas[f]
                densities(targets.bearing, targets.spread, *modes, likelihood)
                likelihood[:] = likelihood**share
            else:
                direction, variance = head.means[f, 0], head.variance[f] / share
        update_belief(before, direction, variance, targets, parameters, belief, held[f], drawn[f])
        found[f] = belief.probability
    if both:
        _smooth_backward(held, drawn, found)
    return with_nothing(found, count)


@allocating
def with_nothing(found: FloatArray, count: int) -> FloatArray:
    """Return the (n, targets + 1) probabilities of targets and of none, from (n, targets + WAYS)."""
    summed = np.empty((len(found), count + 1))
    summed[:, :count] = found[:, :count]
    for f in range(len(found)):
        summed[f, count] = found[f, count:].sum()
    return summed


@allocating
def _smooth_backward(held: FloatArray, drawn: FloatArray, found: FloatArray) -> None:
    """Backward pass over the chain: turn filtered into smoothed probabilities."""
    n, count = found.shape
    back, smoothed = np.ones(count), np.empty(count)
    for f in range(n - 2, -1, -1):
        at_new, most, total = 0.0, 0.0, 0.0
        for j in range(count):
            at_new += drawn[f + 1, j] * back[j]
        for j in range(count):
            back[j] = held[f + 1, j] * back[j] + at_new
            most = max(most, back[j])
        for j in range(count):
            back[j] = back[j] / most if most > 0.0 else 1.0
            smoothed[j] = found[f, j] * back[j]
            total += smoothed[j]
        if total > 0.0:
            found[f] = smoothed / total


@compiled
def _near(people: Any, i: int, j: int) -> bool:
    x, y = people[j].x - people[i].x, people[j].y - people[i].y
    return i != j and x * x + y * y < REACH * REACH


@allocating
def gaze_of_frame(
    everybody: Everybody, observers: Observers, places: Any, before: Beliefs, parameters: GazeParameters
) -> Beliefs:
    """Step of all observers' filters from their beliefs ``before``.

    ``places``: (n, places) of `VIEW`
    """
    ids, people, group = everybody
    n, count = len(observers.row), places.shape[1]
    first = np.zeros(n + 1, dtype=np.int64)
    for i in range(n):
        near = 0
        for j in range(len(ids)):
            near += _near(people, observers.row[i], j)
        first[i + 1] = first[i] + near
    target, person = np.empty(first[-1], dtype=np.int64), np.empty(first[-1], BELIEF)
    elsewhere = np.empty((n, count + WAYS), BELIEF)
    size = len(ids) + count + WAYS
    neighbours, fellow = np.empty(len(ids), PERSON), np.empty(len(ids), dtype=np.bool_)
    views, beliefs = np.empty(size, VIEW), np.empty(size, BELIEF)
    bearing, spread, prior, likelihood = np.empty(size), np.empty(size), np.empty(size), np.empty(size)
    held, drawn = np.empty(size), np.empty(size)
    for i in range(n):
        at, nearby, row = first[i], first[i + 1] - first[i], observers.row[i]
        last = nearby + count + WAYS
        belief = beliefs[:last]
        k = 0
        for j in range(len(ids)):
            if _near(people, row, j):
                target[at + k], neighbours[k] = ids[j], people[j]
                fellow[k] = group[row] >= 0 and group[row] == group[j]
                k += 1
        targets = Targets(bearing[:last], spread[:last], prior[:last], likelihood[:last])
        view = views[: nearby + count]
        view_targets(people[row], neighbours[:nearby], fellow[:nearby], places[i], parameters, view, targets)
        for k in range(last):
            belief[k].probability = belief[k].mean = belief[k].variance = 0.0
        p = observers.previous[i]
        if p >= 0:
            b, end = before.first[p], before.first[p + 1]
            for k in range(nearby):
                while b < end and before.target[b] < target[at + k]:
                    b += 1
                if b < end and before.target[b] == target[at + k]:
                    belief[k] = before.person[b]
            belief[nearby:] = before.elsewhere[p]
        variance = observers.head_variance[i] / new_share(observers.head_gap[i])
        update_belief(
            observers.gap[i],
            observers.head[i],
            variance,
            targets,
            parameters,
            belief,
            held[:last],
            drawn[:last],
        )
        person[at : at + nearby], elsewhere[i] = belief[:nearby], belief[nearby:]
    return Beliefs(first, target, person, elsewhere)
