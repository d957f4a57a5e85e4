"""Model of gaze, compiled: densities of head directions given a target, and a Markov chain over targets."""

from __future__ import annotations

import math

import numpy as np

from graphtrack.geometry.angles import FloatArray
from graphtrack.kernels.arithmetic import log_i0e
from graphtrack.kernels.compilation import allocating, compiled
from graphtrack.tracks.time import TIME_TOLERANCE

IntArray = np.ndarray

REACH = 15.0
"""Largest distance in metres of people as gaze targets and occluders; places have no limit."""
SHOULDERS = 0.25
"""Half the width in metres of a person as gaze target or occluder."""
LOOK_STD, NOTHING, DISTANCE, FELLOWS, SWITCHING, CORRELATION = range(6)
"""Indices in an array of `AttentionParameters`."""
BEARING, HALF, FAR, BLUR, PRESENCE = range(5)
"""Rows of a view of targets: bearing and half the angular width, rad; distance, m; variance of a predicted
bearing, rad²; share of the presence that is certain. The distance of an absent target is NaN."""
PROBABILITY, MEAN, VARIANCE = range(3)
"""Columns of a belief over targets: probability, and the head's deviation from the bearing, rad and rad²."""
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


@compiled
def turn(angle: float) -> float:
    """Wrap an angle to ±π."""
    return angle - 2.0 * math.pi * np.floor(angle / (2.0 * math.pi) + 0.5)


@allocating
def half_angle(radius: float, far: FloatArray) -> FloatArray:
    """Return half the angular width, radians, of a disc from (n,) metres; π from inside it."""
    found = np.empty(len(far))
    for k in range(len(far)):
        found[k] = math.asin(radius / far[k]) if far[k] > radius else math.pi
    return found


@allocating
def see(own: FloatArray, neighbours: FloatArray, view: FloatArray) -> None:
    """Fill the `BEARING`, … of other people in a view (5, n); those beyond `REACH` are absent.

    ``own``, ``neighbours``: (3,), (n, 4) position, m, its variance, m², and the share of the presence
    """
    for j in range(len(neighbours)):
        x, y = neighbours[j, 0] - own[0], neighbours[j, 1] - own[1]
        view[BEARING, j], view[FAR, j] = math.atan2(y, x), math.hypot(x, y)
        square = max(x * x + y * y, 1e-12)
        view[BLUR, j] = min((own[2] + neighbours[j, 2]) / square, _WIDEST)
        view[PRESENCE, j] = neighbours[j, 3]
        if not view[FAR, j] < REACH:
            view[BEARING, j] = view[FAR, j] = math.nan
    view[HALF] = half_angle(SHOULDERS, view[FAR])


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
def _share_in_sight(bearing: float, half: float, far: float, around: FloatArray, wide: FloatArray) -> float:
    """Return the visible share of a target's angle, not occluded by nearer people.

    ``around``, ``wide``: (3, k) bearing, half the angle and distance of people: of all by their bearing,
    three times round, and of those who cover more than `_NARROW` to either side
    """
    covered = 0.0
    for k in range(wide.shape[1]):
        if wide[2, k] < far:
            covered = max(covered, _covered(abs(turn(wide[0, k] - bearing)), wide[1, k], half))
    middle = turn(bearing)
    for k in range(np.searchsorted(around[0], middle - half - _NARROW), around.shape[1]):
        if around[0, k] > middle + half + _NARROW:
            break
        if around[2, k] < far:
            covered = max(covered, _covered(abs(around[0, k] - middle), around[1, k], half))
    return 1.0 - covered / (2.0 * half) if half > 0.0 else 1.0


@allocating
def _in_the_way(view: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return people in the form of `_share_in_sight`: those whose bearing is known within their width."""
    bearing, half, far = view[BEARING], view[HALF], view[FAR]
    near = np.flatnonzero(view[BLUR] < half**2)
    near = near[~np.isnan(far[near])]
    near = near[np.argsort(bearing[near])]
    count = len(near)
    around, wide = np.empty((3, 3 * count)), np.empty((3, count))
    size = 0
    for place in range(count):
        k = near[place]
        for lap in range(3):
            at = place + lap * count
            around[0, at] = bearing[k] + 2.0 * math.pi * (lap - 1)
            around[1, at], around[2, at] = half[k], far[k]
        if half[k] > _NARROW:
            wide[0, size], wide[1, size], wide[2, size] = bearing[k], half[k], far[k]
            size += 1
    return around, wide[:, :size]


@allocating
def prior_of_gaze(view: FloatArray, fellow: np.ndarray, parameters: FloatArray, prior: FloatArray) -> None:
    """Fill prior probabilities of targets and `WAYS`, (targets + WAYS,), without a head observation.

    Without a target that is certain to be present, the probability of no target is greater.

    Parameters
    ----------
    view : (5, targets) of the targets; people come first
    fellow : (people,) True in the observer's group
    """
    people = len(fellow)
    around, wide = _in_the_way(view[:, :people])
    total, surest = 0.0, 0.0
    for j in range(view.shape[1]):
        prior[j] = 0.0
        far = view[FAR, j]
        if math.isnan(far):
            continue
        weight = _share_in_sight(view[BEARING, j], view[HALF, j], far, around, wide) * view[PRESENCE, j]
        weight /= 1.0 + (far / parameters[DISTANCE]) ** 2
        if j < people and fellow[j]:
            weight *= parameters[FELLOWS]
        prior[j] = weight
        total += weight
        surest = max(surest, view[PRESENCE, j] if weight > 0.0 else 0.0)
    if not total > 1e-12:
        total, surest = 1.0, 0.0
    at_any = surest * (1.0 - parameters[NOTHING])
    prior[:-WAYS] *= at_any / total
    prior[-WAYS:] = (1.0 - at_any) / WAYS


@compiled
def spread_of(view: FloatArray, look_std: float, spread: FloatArray) -> None:
    """Fill the variances (targets + WAYS,), rad², of heads about targets.

    The variance of gaze, and those of the interval that a target covers and of its predicted bearing. Gaze at
    no target has no fixed aim: twice the variance.
    """
    for j in range(view.shape[1]):
        spread[j] = look_std**2 + min(view[HALF, j], math.pi) ** 2 / 3.0 + view[BLUR, j]
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
def go_on(
    gap: float,
    head: FloatArray,
    likelihood: FloatArray,
    bearing: FloatArray,
    spread: FloatArray,
    prior: FloatArray,
    parameters: FloatArray,
    belief: FloatArray,
    held: FloatArray,
    drawn: FloatArray,
) -> None:
    """Step of the filter over targets: the target stays, or is drawn from the frame's prior.

    A head's deviation from each target is an Ornstein-Uhlenbeck process about 0, with a Kalman filter of its
    own; the two cases are merged into one Gaussian.

    Parameters
    ----------
    gap : seconds from the frame before; infinite for the first
    head : direction, rad, and its variance, rad²; NaN if unknown or with several modes
    likelihood : (n,) of a head with several modes at each target; 1 for others
    bearing, spread, prior : (n,) of the targets and `WAYS`; NaN bearing: absent
    belief : (n, 3) `PROBABILITY`, `MEAN` and `VARIANCE`, filtered in place
    held, drawn : (n,) filled: likelihoods, times the probability of staying, and of being drawn
    """
    stay = math.exp(-parameters[SWITCHING] * gap)
    hidden = stay * math.exp(-gap / _HIDDEN)
    correlation = max(parameters[CORRELATION], 1e-9)
    ways = len(prior) - WAYS
    for j in range(ways):
        if belief[j, PROBABILITY] == 0.0 and prior[j] > 0.0:
            # Gaze in the direction of a target that appears may have been at this target.
            way = ways + math.floor(bearing[j] / _WAY + 0.5) % WAYS
            belief[j, PROBABILITY] = belief[way, PROBABILITY] * prior[j] / max(prior[way], 1e-12)
            belief[j, MEAN] = turn(belief[way, MEAN] + bearing[way] - bearing[j])
            belief[j, VARIANCE] = belief[way, VARIANCE]
    total = 0.0
    for j in range(len(prior)):
        known = not math.isnan(bearing[j])
        held[j] = (stay if prior[j] > 0.0 else hidden) * likelihood[j] if known else 0.0
        drawn[j] = (1.0 - stay) * prior[j] * likelihood[j]
        fresh_mean, fresh = 0.0, spread[j] if known else 1.0
        # Wide targets have longer memories, else the movement of a head would tell them from narrow ones.
        memory = math.exp(-gap / correlation * parameters[LOOK_STD] ** 2 / fresh)
        mean = memory * belief[j, MEAN]
        variance = memory**2 * belief[j, VARIANCE] + (1.0 - memory**2) * fresh
        if known and not math.isnan(head[0]):
            deviation = turn(head[0] - bearing[j])
            off = turn(deviation - mean)
            held[j] *= _normal(off, variance + head[1])
            drawn[j] *= _normal(deviation, fresh + head[1])
            mean += variance / (variance + head[1]) * off
            variance *= head[1] / (variance + head[1])
            fresh_mean = fresh / (fresh + head[1]) * deviation
            fresh *= head[1] / (fresh + head[1])
        stayed = belief[j, PROBABILITY] * held[j]
        value = stayed + drawn[j]
        share = stayed / value if value > 0.0 else 0.0
        apart = turn(mean - fresh_mean)
        belief[j, PROBABILITY] = value
        belief[j, MEAN] = fresh_mean + share * apart
        belief[j, VARIANCE] = share * variance + (1.0 - share) * fresh + share * (1.0 - share) * apart**2
        total += value
    for j in range(len(prior)):
        belief[j, PROBABILITY] = belief[j, PROBABILITY] / total if total > 0.0 else prior[j]


@allocating
def gaze_over_time(
    own: FloatArray,
    neighbours: FloatArray,
    fellow: np.ndarray,
    places: FloatArray,
    weights: FloatArray,
    means: FloatArray,
    kappas: FloatArray,
    noise: FloatArray,
    gap: FloatArray,
    both: bool,
    parameters: FloatArray,
) -> FloatArray:
    """Return (n, targets + 1) gaze probabilities in each frame, filtered or smoothed.

    Parameters
    ----------
    own, neighbours : (n, 3), (n, people, 4) as for `see`; NaN: absent
    fellow : (n, people)
    places : (n, 5, places) view of the places
    weights, means, kappas : (n, modes) of the head; NaN weights: unknown
    noise : (n,) rad², variance of the head if it has a single mode
    gap : (n,) seconds from the frame before
    """
    n, people = fellow.shape
    count = people + places.shape[2]
    size = count + WAYS
    view, prior, spread, bearing = np.empty((5, count)), np.empty(size), np.empty(size), np.empty(size)
    bearing[count:] = _WAY * np.arange(WAYS)
    held, drawn, found = np.empty((n, size)), np.empty((n, size)), np.empty((n, size))
    belief, likelihood, head = np.zeros((size, 3)), np.ones(size), np.empty(2)
    since, elapsed = math.inf, 0.0
    for f in range(n):
        before = gap[f] if f > 0 else math.inf
        since += before
        elapsed += gap[f] if f > 0 else 0.0
        if not both and elapsed < SETTLING - TIME_TOLERANCE:
            before = since = math.inf
        see(own[f], neighbours[f], view[:, :people])
        view[:, people:] = places[f]
        bearing[:count] = view[BEARING]
        spread_of(view, parameters[LOOK_STD], spread)
        prior_of_gaze(view, fellow[f], parameters, prior)
        head[:] = math.nan
        likelihood[:] = 1.0
        if not math.isnan(weights[f, 0]):
            share = new_share(since)
            since = 0.0
            if weights.shape[1] > 1:
                densities(bearing, spread, weights[f], means[f], kappas[f], likelihood)
                likelihood[:] = likelihood**share
            else:
                head[0], head[1] = means[f, 0], noise[f] / share
        go_on(before, head, likelihood, bearing, spread, prior, parameters, belief, held[f], drawn[f])
        found[f] = belief[:, PROBABILITY]
    if both:
        _look_back(held, drawn, found)
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
def _look_back(held: FloatArray, drawn: FloatArray, found: FloatArray) -> None:
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
def _near(everybody: FloatArray, i: int, j: int) -> bool:
    x, y = everybody[j, 0] - everybody[i, 0], everybody[j, 1] - everybody[i, 1]
    return i != j and x * x + y * y < REACH * REACH


@allocating
def gaze_of_frame(
    ids: IntArray,
    everybody: FloatArray,
    group: IntArray,
    rows: IntArray,
    gap: FloatArray,
    head: FloatArray,
    places: FloatArray,
    was: IntArray,
    first_before: IntArray,
    target_before: IntArray,
    person_before: FloatArray,
    elsewhere_before: FloatArray,
    parameters: FloatArray,
) -> tuple[IntArray, IntArray, FloatArray, FloatArray]:
    """Step of all observers' filters: first, target, person and elsewhere, as in `_Known`.

    Parameters
    ----------
    ids, everybody, group : (m,) identity, ascending, (m, 4) as for `see`, and group of all people
    rows : (n,) of these, the observers
    gap : (n, 2) seconds from each one's frame before, and from the last observed head; infinite without one
    head : (n, 2) direction, rad, and its variance, rad²; NaN direction: unknown
    places : (n, 5, places) view of the places
    was : (n,) index of each among the previous observers, −1: none; the following arguments are theirs
    """
    n, count = len(rows), places.shape[2]
    first = np.zeros(n + 1, dtype=np.int64)
    for i in range(n):
        near = 0
        for j in range(len(ids)):
            near += _near(everybody, rows[i], j)
        first[i + 1] = first[i] + near
    target, person = np.empty(first[-1], dtype=np.int64), np.empty((first[-1], 3))
    elsewhere = np.empty((n, count + WAYS, 3))
    size = len(ids) + count + WAYS
    neighbours, fellow = np.empty((len(ids), 4)), np.empty(len(ids), dtype=np.bool_)
    room, all_views, beliefs = np.empty((5, size)), np.empty((5, size)), np.empty((size, 3))
    likelihood, scaled = np.ones(size), np.empty(2)
    ways = _WAY * np.arange(WAYS)
    for i in range(n):
        at, people, row = first[i], first[i + 1] - first[i], rows[i]
        targets, last = people + count, people + count + WAYS
        prior, spread, bearing = room[0, :last], room[1, :last], room[2, :last]
        held, drawn = room[3, :last], room[4, :last]
        view, belief = all_views[:, :targets], beliefs[:last]
        k = 0
        for j in range(len(ids)):
            if _near(everybody, row, j):
                target[at + k], neighbours[k] = ids[j], everybody[j]
                fellow[k] = group[row] >= 0 and group[row] == group[j]
                k += 1
        see(everybody[row], neighbours[:people], view[:, :people])
        view[:, people:] = places[i]
        bearing[:targets], bearing[targets:] = view[BEARING], ways
        spread_of(view, parameters[LOOK_STD], spread)
        prior_of_gaze(view, fellow[:people], parameters, prior)
        belief[:] = 0.0
        p = was[i]
        if p >= 0:
            b, end = first_before[p], first_before[p + 1]
            for k in range(people):
                while b < end and target_before[b] < target[at + k]:
                    b += 1
                if b < end and target_before[b] == target[at + k]:
                    belief[k] = person_before[b]
            belief[people:] = elsewhere_before[p]
        scaled[0], scaled[1] = head[i, 0], head[i, 1] / new_share(gap[i, 1])
        of_head = likelihood[:last]
        go_on(gap[i, 0], scaled, of_head, bearing, spread, prior, parameters, belief, held, drawn)
        person[at : at + people], elsewhere[i] = belief[:people], belief[people:]
    return first, target, person, elsewhere
