"""Model of gaze, compiled: densities of head directions given a target, and a Markov chain over targets."""

from __future__ import annotations

import math

import numpy as np

from graphtrack.geometry.angles import FloatArray
from graphtrack.kernels.arithmetic import log_i0e
from graphtrack.kernels.compilation import allocating, compiled

IntArray = np.ndarray

REACH = 15.0
"""Largest distance in metres of people as gaze targets and occluders; places have no limit."""
SHOULDERS = 0.25
"""Half the width in metres of a person as gaze target or occluder."""
LOOK_STD, NOTHING, DISTANCE, FELLOWS, SWITCHING, CORRELATION = range(6)
"""Indices in an array of `AttentionParameters`."""
_NARROW = 0.26  # radians, slightly more than half the angular width of a person at 1 m
_NOISY_SECONDS = 1.5
_UNIFORM = 1.0 / (2.0 * math.pi)


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
def see(
    own: FloatArray, neighbours: FloatArray, bearing: FloatArray, half: FloatArray, far: FloatArray
) -> None:
    """Fill bearing, half angular width and distance of other people.

    Parameters
    ----------
    own, neighbours : (2,), (n, 2) metres; NaN: absent
    bearing, half, far : (n,) radians, radians and metres
    """
    for j in range(len(neighbours)):
        x, y = neighbours[j, 0] - own[0], neighbours[j, 1] - own[1]
        bearing[j], far[j] = math.atan2(y, x), math.hypot(x, y)
    half[:] = half_angle(SHOULDERS, far)


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
def _in_the_way(bearing: FloatArray, half: FloatArray, far: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return people in the form of `_share_in_sight`."""
    near = np.flatnonzero(far < REACH)
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
def prior_of_gaze(
    bearing: FloatArray,
    half: FloatArray,
    far: FloatArray,
    fellow: np.ndarray,
    people: int,
    parameters: FloatArray,
    prior: FloatArray,
) -> None:
    """Fill (targets + 1,) prior probabilities of gaze targets without a head observation.

    Parameters
    ----------
    bearing, half : (targets,) radians, bearing and half angular width; people come first
    far : (targets,) metres; NaN: absent
    fellow : (people,) True in the observer's group
    """
    around, wide = _in_the_way(bearing[:people], half[:people], far[:people])
    total = 0.0
    for j in range(len(bearing)):
        prior[j] = 0.0
        if not far[j] < (REACH if j < people else math.inf):
            continue
        weight = _share_in_sight(bearing[j], half[j], far[j], around, wide)
        weight /= 1.0 + (far[j] / parameters[DISTANCE]) ** 2
        if j < people and fellow[j]:
            weight *= parameters[FELLOWS]
        prior[j] = weight
        total += weight
    if total > 1e-12:
        prior[:-1] *= (1.0 - parameters[NOTHING]) / total
        prior[-1] = parameters[NOTHING]
    else:  # without a visible person, gaze is at nothing
        prior[:-1] = 0.0
        prior[-1] = 1.0


@allocating
def densities(
    bearing: FloatArray,
    half: FloatArray,
    weights: FloatArray,
    means: FloatArray,
    kappas: FloatArray,
    look_std: float,
    found: FloatArray,
) -> None:
    """Fill (targets + 1,) likelihoods of gaze at each target, given the head's posterior.

    The product of two von Mises densities is integrated, of the head and of gaze at the target; "nothing" has
    the uniform density.

    ``weights``, ``means``, ``kappas``: (modes,) of the head; a NaN weight: unknown
    """
    scale = np.empty(len(kappas))
    for m in range(len(kappas)):
        scale[m] = kappas[m] + log_i0e(kappas[m])
    found[-1] = _UNIFORM
    for j in range(len(bearing)):
        # A disc or a polygon covers an interval, whose variance adds to that of gaze.
        of_target = concentration_of(look_std**2 + min(half[j], math.pi) ** 2 / 3.0)
        of_scale = of_target + log_i0e(of_target)
        total = 0.0
        for m in range(len(kappas)):
            product = 2.0 * kappas[m] * of_target * math.cos(means[m] - bearing[j])
            both = math.sqrt(max(kappas[m] ** 2 + of_target**2 + product, 0.0))
            total += weights[m] * math.exp(both + log_i0e(both) - scale[m] - of_scale)
        found[j] = total * _UNIFORM if not math.isnan(total) else _UNIFORM


@compiled
def carry(
    gap: float,
    head: FloatArray,
    before: FloatArray,
    bearing: FloatArray,
    bearing_before: FloatArray,
    parameters: FloatArray,
    redrawn: FloatArray,
    held: FloatArray,
) -> None:
    """Fill a frame's likelihoods of gaze at a new target, ``redrawn``, in place, and at the same, ``held``.

    The deviation from a target is autoregressive. Gaze at nothing has a persistent direction as well, which
    is the previous head direction. If heads have several modes or are less certain than that, frames closer
    than `_NOISY_SECONDS` repeat the same evidence.

    Parameters
    ----------
    gap : seconds from the frame before; infinite for the first
    head, before : direction, rad, and its variance, rad², infinite if unknown or with several modes;
        in this frame and the previous one
    bearing, bearing_before : (targets,) radians; NaN: absent
    redrawn, held : (targets + 1,)
    """
    memory = math.exp(-gap / parameters[CORRELATION]) if parameters[CORRELATION] > 0.0 else 0.0
    spread = parameters[LOOK_STD] ** 2
    if not max(head[1], before[1]) < spread * (1.0 - memory**2):
        power = min(1.0, gap / _NOISY_SECONDS)
        for j in range(len(redrawn)):
            redrawn[j] = held[j] = redrawn[j] ** power
        return
    noise = head[1] + memory**2 * before[1]
    for j in range(len(bearing)):
        step = turn(turn(head[0] - bearing[j]) - memory * turn(before[0] - bearing_before[j]))
        held[j] = _normal(step if not math.isnan(step) else 0.0, spread * (1.0 - memory**2) + noise)
    variance = 2.0 * spread * (1.0 - memory) + head[1] + before[1]
    held[-1] = _normal(turn(head[0] - before[0]), variance)


@compiled
def _normal(deviation: float, variance: float) -> float:
    return max(math.exp(-0.5 * deviation**2 / variance) / math.sqrt(2.0 * math.pi * variance), 1e-12)


@compiled
def go_on(
    prior: FloatArray,
    redrawn: FloatArray,
    held: FloatArray,
    stay: float,
    before: FloatArray,
    found: FloatArray,
) -> None:
    """Step of the chain over targets: the target stays, or is redrawn from the frame's prior.

    Parameters
    ----------
    stay : probability that the target has not changed; 0 in the first frame
    before, found : (targets + 1,) probabilities in the frame before, and in this one
    """
    total = 0.0
    for j in range(len(prior)):
        value = (1.0 - stay) * prior[j] * redrawn[j]
        if stay > 0.0 and prior[j] > 0.0:
            value += stay * before[j] * held[j]
        found[j] = value
        total += value
    for j in range(len(prior)):
        found[j] = found[j] / total if total > 0.0 else prior[j]


@allocating
def gaze_over_time(
    own: FloatArray,
    neighbours: FloatArray,
    fellow: np.ndarray,
    bearing: FloatArray,
    half: FloatArray,
    far: FloatArray,
    weights: FloatArray,
    means: FloatArray,
    kappas: FloatArray,
    gap: FloatArray,
    both: bool,
    parameters: FloatArray,
) -> FloatArray:
    """Return (n, targets + 1) gaze probabilities in each frame, filtered or smoothed.

    Parameters
    ----------
    own, neighbours : (n, 2), (n, people, 2) metres; NaN: absent
    fellow : (n, people)
    bearing, half, far : (n, targets) of places; the entries of people, which come first, are filled
    weights, means, kappas : (n, modes) of the head
    gap : (n,) seconds from the frame before
    """
    n, count = bearing.shape
    prior, redrawn, held = np.empty((n, count + 1)), np.empty((n, count + 1)), np.empty((n, count + 1))
    stay, found = np.exp(-parameters[SWITCHING] * gap), np.empty((n, count + 1))
    stay[:1] = 0.0
    head = np.empty((n, 2))
    people = fellow.shape[1]
    for f in range(n):
        see(own[f], neighbours[f], bearing[f, :people], half[f, :people], far[f, :people])
        prior_of_gaze(bearing[f], half[f], far[f], fellow[f], people, parameters, prior[f])
        densities(bearing[f], half[f], weights[f], means[f], kappas[f], parameters[LOOK_STD], redrawn[f])
        head[f, 0] = means[f, 0]
        known = weights.shape[1] == 1 and not math.isnan(weights[f, 0])
        head[f, 1] = noise_of(kappas[f, 0]) if known else math.inf
        b = max(f - 1, 0)
        since = gap[f] if f > 0 else math.inf
        carry(since, head[f], head[b], bearing[f], bearing[b], parameters, redrawn[f], held[f])
        go_on(prior[f], redrawn[f], held[f], stay[f], found[b], found[f])
    if both:
        _look_back(prior, redrawn, held, stay, found)
    return found


@compiled
def noise_of(kappa: float) -> float:
    """Return the variance, rad², of a direction with a concentration; at most that of the uniform density."""
    return min(1.0 / max(kappa, 1e-6), math.pi**2 / 3.0)


@allocating
def _look_back(
    prior: FloatArray, redrawn: FloatArray, held: FloatArray, stay: FloatArray, found: FloatArray
) -> None:
    """Backward pass over the chain: turn filtered into smoothed probabilities."""
    n, count = prior.shape
    back = np.ones(count)
    for f in range(n - 2, -1, -1):
        drawn = 0.0
        for j in range(count):
            drawn += prior[f + 1, j] * redrawn[f + 1, j] * back[j]
        total, most = 0.0, 0.0
        for j in range(count):
            goes_on = held[f + 1, j] * back[j] if prior[f + 1, j] > 0.0 else 0.0
            back[j] = stay[f + 1] * goes_on + (1.0 - stay[f + 1]) * drawn
            most = max(most, back[j])
        for j in range(count):
            back[j] = back[j] / most if most > 0.0 else 1.0
            found[f, j] *= back[j]
            total += found[f, j]
        for j in range(count):
            found[f, j] = found[f, j] / total if total > 0.0 else prior[f, j]


@compiled
def _near(position: FloatArray, i: int, j: int) -> bool:
    x, y = position[j, 0] - position[i, 0], position[j, 1] - position[i, 1]
    return i != j and x * x + y * y < REACH * REACH


@allocating
def gaze_of_frame(
    t: float,
    ids: IntArray,
    position: FloatArray,
    angle: FloatArray,
    kappa: FloatArray,
    last_head: np.ndarray,
    group: IntArray,
    place_bearing: FloatArray,
    place_half: FloatArray,
    place_far: FloatArray,
    was: IntArray,
    t_before: FloatArray,
    head_before: FloatArray,
    first_before: IntArray,
    target_before: IntArray,
    bearing_before: FloatArray,
    person_before: FloatArray,
    place_bearing_before: FloatArray,
    place_before: FloatArray,
    parameters: FloatArray,
) -> tuple[FloatArray, IntArray, IntArray, FloatArray, FloatArray, FloatArray]:
    """Step of all people's chains: head, first, target, bearing, person and place, as in `_Known`.

    Parameters
    ----------
    ids, position, angle, kappa, last_head, group : (n,) identity, position, and head direction if observed
    place_bearing, place_half, place_far : (n, places) bearing, half angular width and distance of places
    was : (n,) index of each among the previous people, −1: unknown; the following arguments are theirs
    """
    n, places = place_bearing.shape
    first, head = np.zeros(n + 1, dtype=np.int64), np.empty((n, 2))
    for i in range(n):
        near = 0
        for j in range(n):
            near += _near(position, i, j)
        first[i + 1] = first[i] + near
    target = np.empty(first[-1], dtype=np.int64)
    all_bearing, person = np.empty(first[-1]), np.empty(first[-1])
    place = np.empty((n, places + 1))
    neighbours, fellow, weight = np.empty((n, 2)), np.empty(n, dtype=np.bool_), np.ones(1)
    room = np.empty((9, n + places + 1))
    for i in range(n):
        at, people = first[i], first[i + 1] - first[i]
        count = people + places
        bearing, half, far = room[0, :count], room[1, :count], room[2, :count]
        prior, redrawn, held = room[3, : count + 1], room[4, : count + 1], room[5, : count + 1]
        then, then_bearing, found = room[6, : count + 1], room[7, :count], room[8, : count + 1]
        k = 0
        for j in range(n):
            if _near(position, i, j):
                target[at + k], neighbours[k] = ids[j], position[j]
                fellow[k] = group[i] >= 0 and group[i] == group[j]
                k += 1
        see(position[i], neighbours[:people], bearing[:people], half[:people], far[:people])
        bearing[people:], half[people:], far[people:] = place_bearing[i], place_half[i], place_far[i]
        prior_of_gaze(bearing, half, far, fellow[:people], people, parameters, prior)
        weight[0] = 1.0 if last_head[i] else math.nan
        one = slice(i, i + 1)
        densities(bearing, half, weight, angle[one], kappa[one], parameters[LOOK_STD], redrawn)
        head[i, 0], head[i, 1] = angle[i], noise_of(kappa[i]) if last_head[i] else math.inf
        p = was[i]
        gap, stay, before = math.inf, 0.0, head[i]
        then[:], then_bearing[:] = 0.0, math.nan
        if p >= 0:
            gap, before = t - t_before[p], head_before[p]
            stay = math.exp(-parameters[SWITCHING] * gap)
            b, end = first_before[p], first_before[p + 1]
            for k in range(people):
                while b < end and target_before[b] < target[at + k]:
                    b += 1
                if b < end and target_before[b] == target[at + k]:
                    then[k], then_bearing[k] = person_before[b], bearing_before[b]
            then[people:], then_bearing[people:] = place_before[p], place_bearing_before[p]
        carry(gap, head[i], before, bearing, then_bearing, parameters, redrawn, held)
        go_on(prior, redrawn, held, stay, then, found)
        person[at : at + people], all_bearing[at : at + people] = found[:people], bearing[:people]
        place[i] = found[people:]
    return head, first, target, all_bearing, person, place
