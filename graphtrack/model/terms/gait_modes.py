"""Modes of the couplings: where they do not hold, a drifting offset takes their place, or nothing.

A hidden Markov chain over modes and offsets, for each coupling. A frame's mode is *aligned* (the coupling
rests near 0) or *free* (at an offset that drifts around the circle). A row of probabilities has `BINS`
offsets of the free mode on a grid, then `NEAR` small ones of the aligned mode.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from graphtrack.geometry.angles import FloatArray
from graphtrack.model.kernels.compiled import compiled
from graphtrack.model.kernels.lanes import LANES, choose, greatest_lane, load_part, store_part, sum_of
from graphtrack.model.kernels.vector_math import exp, log
from graphtrack.model.parameters import GaitParameters

BINS, NEAR = 36, 7
"""Offsets of the free mode, all around, and of the aligned mode, about 0."""

ROW = BINS + NEAR

MOST_DRIFT = 100


class Modes(NamedTuple):
    """Parameters of one coupling's modes; see `GaitParameters`."""

    aligned: float
    switching: float  # 1/s
    drift: float  # rad²/s
    strength: float
    free_strength: float
    lead: float  # seconds
    cos: FloatArray  # (ROW,) of the offsets
    sin: FloatArray
    anywhere: FloatArray  # (BINS,) of the free mode's offsets in it; they sum to 1
    share: FloatArray  # (NEAR,) of the aligned mode's offsets in it; they sum to 1
    own: FloatArray  # (BINS,) probability that such an offset is the person's, and not the classifier's


class Gait(NamedTuple):
    """Parameters of both couplings' modes."""

    body: Modes
    head: Modes
    classified_head: Modes
    head_evidence: float
    head_rate_seen: float
    head_common: float


@compiled
def add_seen(
    row: FloatArray,
    modes: Modes,
    weight: float,
    reference: float,
    cos: float,
    sin: float,
    kappa: float,
    uniform: float,
) -> None:
    """Add the log likelihood (ROW,) of an observed angle at each offset from a ``reference`` direction."""
    if not weight * kappa > 0.0:
        return
    # The observation as seen from the reference.
    base_cos, base_sin = math.cos(reference), math.sin(reference)
    along, across = cos * base_cos + sin * base_sin, sin * base_cos - cos * base_sin
    share = 1.0 / (1.0 + uniform)
    for j in range(0, ROW, LANES):
        # `pose.angle_cost`, of several offsets at a time.
        close = load_part(modes.cos, j, ROW) * along + load_part(modes.sin, j, ROW) * across
        says = kappa * (close - 1.0)
        if uniform > 0.0:
            says = log((exp(says) + uniform) * share) - 2.0 * kappa
        store_part(row, j, ROW, load_part(row, j, ROW) + weight * says)


@compiled
def add_seen_classes(
    row: FloatArray,
    modes: Modes,
    weight: float,
    reference: float,
    heights: FloatArray,
    directions: FloatArray,
    kappa: float,
) -> None:
    """The same of class likelihoods; ``heights`` and ``directions`` as in `pose.add_classes`."""
    if not weight * kappa > 0.0:
        return
    n_classes = len(heights) - 1
    cos, sin = math.cos(reference), math.sin(reference)
    for j in range(0, ROW, LANES):
        own_cos, own_sin = load_part(modes.cos, j, ROW), load_part(modes.sin, j, ROW)
        along, across = cos * own_cos - sin * own_sin, sin * own_cos + cos * own_sin
        density = 0.0 * along + heights[n_classes]
        for c in range(n_classes):
            close = along * directions[c, 0] + across * directions[c, 1]
            density += heights[c] * exp(kappa * (close - 1.0))
        store_part(row, j, ROW, load_part(row, j, ROW) + weight * log(density))


@compiled
def drift(probability: FloatArray, variance: float, memory: FloatArray) -> None:
    """Diffuse (BINS, …) around the circle by ``variance`` rad², in place."""
    share = variance / (2.0 * math.pi / BINS) ** 2
    if not share > 0.0:
        return
    # More passes than that leave hardly anything but the uniform density.
    passes = int(min(math.ceil(2.0 * share), MOST_DRIFT))
    side = min(0.5 * share / passes, 1.0 / 3.0)
    for _ in range(passes):
        for j in range(BINS):
            memory[j] = probability[j]
        for j in range(1, BINS - 1):
            probability[j] += side * (memory[j - 1] + memory[j + 1] - 2.0 * memory[j])
        last = BINS - 1
        probability[0] += side * (memory[last] + memory[1] - 2.0 * memory[0])
        probability[last] += side * (memory[last - 1] + memory[0] - 2.0 * memory[last])


@compiled
def switch(now: FloatArray, modes: Modes, dt: float, memory: FloatArray) -> None:
    """Probabilities (ROW,) ``dt`` seconds later, in place: the offset drifts, mode and offset change."""
    drift(now, modes.drift * dt, memory)
    kept = math.exp(-modes.switching * dt)
    found = 0.0 * load_part(now, 0, 0)
    for j in range(0, ROW, LANES):
        found += load_part(now, j, ROW)
    total = sum_of(found)
    # What changes is drawn anew from the long run.
    anew = (1.0 - kept) * total
    for j in range(BINS):
        now[j] = kept * now[j] + anew * (1.0 - modes.aligned) * modes.anywhere[j]
    for j in range(NEAR):
        now[BINS + j] = kept * now[BINS + j] + anew * modes.aligned * modes.share[j]


@compiled
def switch_back(ahead: FloatArray, modes: Modes, dt: float, memory: FloatArray) -> None:
    """The adjoint of `switch`: from what is likely after ``dt`` seconds to what is before, in place."""
    kept = math.exp(-modes.switching * dt)
    near, found = 0.0, 0.0 * load_part(ahead, 0, 0)
    for j in range(0, BINS, LANES):
        found += load_part(ahead, j, BINS) * load_part(modes.anywhere, j, BINS)
    free = sum_of(found)
    for j in range(NEAR):
        near += ahead[BINS + j] * modes.share[j]
    anew = (1.0 - kept) * ((1.0 - modes.aligned) * free + modes.aligned * near)
    for j in range(ROW):
        ahead[j] = kept * ahead[j] + anew
    drift(ahead, modes.drift * dt, memory)


@compiled
def least(one: Any, other: float) -> Any:
    """The lesser of two."""
    return choose(one < other, one, other)


@compiled
def greatest_of(row: FloatArray) -> float:
    """The greatest of a row (ROW,)."""
    greatest = load_part(row, 0, ROW)
    for j in range(1, ROW // LANES):
        other = load_part(row, j * LANES, ROW)
        greatest = choose(other > greatest, other, greatest)
    # The rest with the last whole vector once more.
    other = load_part(row, ROW - LANES, ROW)
    return greatest_lane(choose(other > greatest, other, greatest))


@compiled
def infer_modes(
    dt: FloatArray,
    log_likelihood: FloatArray,
    modes: Modes,
    before: FloatArray,
    filtered: FloatArray,
    smoothed: FloatArray,
) -> None:
    """Probabilities of modes and offsets, given the past (``filtered``) and all frames (``smoothed``).

    Parameters
    ----------
    dt : (n,) seconds since the frame before; 0 at a first frame
    log_likelihood : (n, ROW) of what was seen, at each offset; becomes the likelihood over its greatest
    modes : parameters
    before : (ROW,) filtered probabilities of the frame before the first, used where dt[0] > 0
    filtered, smoothed : (n, ROW) filled in
    """
    n = len(dt)
    likelihood, memory, ahead = log_likelihood, np.empty(BINS), np.ones(ROW)
    now = before.copy()
    if not dt[0] > 0.0:
        for j in range(BINS):
            now[j] = (1.0 - modes.aligned) * modes.anywhere[j]
        for j in range(NEAR):
            now[BINS + j] = modes.aligned * modes.share[j]
    for k in range(n):
        if dt[k] > 0.0:
            switch(now, modes, dt[k], memory)
        row, here = likelihood[k], filtered[k]
        greatest = greatest_of(row)
        total = 0.0 * load_part(row, 0, 0)
        for j in range(0, ROW, LANES):
            # What is beyond the row would be more than 0 here.
            says = exp(least(load_part(row, j, ROW) - greatest, 0.0))
            store_part(row, j, ROW, says)
            says *= load_part(now, j, ROW)
            store_part(now, j, ROW, says)
            total += says
        share = 1.0 / sum_of(total)
        for j in range(0, ROW, LANES):
            says = share * load_part(now, j, ROW)
            store_part(now, j, ROW, says)
            store_part(here, j, ROW, says)
    for k in range(n - 1, -1, -1):
        row, here, found = likelihood[k], filtered[k], smoothed[k]
        total = 0.0 * load_part(row, 0, 0)
        for j in range(0, ROW, LANES):
            says = load_part(here, j, ROW) * load_part(ahead, j, ROW)
            store_part(found, j, ROW, says)
            total += says
        share = 1.0 / sum_of(total)
        for j in range(0, ROW, LANES):
            store_part(found, j, ROW, share * load_part(found, j, ROW))
        if k == 0:
            break
        # ahead: how likely all that follows is, from each mode and offset of the frame before.
        for j in range(0, ROW, LANES):
            store_part(ahead, j, ROW, load_part(ahead, j, ROW) * load_part(row, j, ROW))
        switch_back(ahead, modes, dt[k], memory)
        total = 0.0 * load_part(ahead, 0, 0)
        for j in range(0, ROW, LANES):
            total += load_part(ahead, j, ROW)
        share = 1.0 / sum_of(total)
        for j in range(0, ROW, LANES):
            store_part(ahead, j, ROW, share * load_part(ahead, j, ROW))


@compiled
def expected(
    probability: FloatArray, modes: Modes, strength: float, free_strength: float
) -> tuple[float, float]:
    """Resultant of the couplings of all modes and offsets: cosine and sine times the concentration."""
    cos = sin = near_cos = near_sin = 0.0 * load_part(probability, 0, 0)
    for j in range(0, BINS, LANES):
        weight = load_part(probability, j, BINS)
        own = weight * load_part(modes.own, j, BINS)
        cos += own * load_part(modes.cos, j, BINS)
        sin += own * load_part(modes.sin, j, BINS)
        near_cos += weight - own
    for j in range(BINS, ROW, LANES):
        weight = load_part(probability, j, ROW)
        near_cos += weight * load_part(modes.cos, j, ROW)
        near_sin += weight * load_part(modes.sin, j, ROW)
    return (
        sum_of(free_strength * cos + strength * near_cos),
        sum_of(free_strength * sin + strength * near_sin),
    )


@compiled
def deviation(
    probability: FloatArray, modes: Modes, strength: float, free_strength: float, cos: float, sin: float
) -> float:
    """Standard deviation of the pulls of all modes and offsets on a direction, given by cosine and sine.

    Each pulls with the sine of what it is apart, times the strength of its mode.
    """
    total = near = 0.0 * load_part(probability, 0, 0)
    for j in range(0, BINS, LANES):
        weight = load_part(probability, j, BINS)
        own = weight * load_part(modes.own, j, BINS)
        pull = load_part(modes.sin, j, BINS) * cos - load_part(modes.cos, j, BINS) * sin
        total += own * pull * pull
        near += (weight - own) * (sin * sin)
    for j in range(BINS, ROW, LANES):
        pull = load_part(modes.sin, j, ROW) * cos - load_part(modes.cos, j, ROW) * sin
        near += load_part(probability, j, ROW) * pull * pull
    return math.sqrt(sum_of(free_strength * free_strength * total + strength * strength * near))


@compiled
def aligned(probability: FloatArray) -> float:
    """Probability of the aligned mode."""
    total = 0.0
    for j in range(BINS, ROW):
        total += probability[j]
    return total


@compiled
def mistaken(probability: FloatArray, modes: Modes) -> float:
    """Probability that an offset is the classifier's."""
    total = 0.0
    for j in range(BINS):
        total += probability[j] * (1.0 - modes.own[j])
    return total


def gait_of(parameters: GaitParameters) -> Gait:
    """The parameters as the kernels take them."""
    head = _modes(parameters, "head")
    return Gait(
        _modes(parameters, "body"),
        head,
        _mistaken(head, parameters.head_class_bias, parameters.head_class_bias_kappa),
        parameters.head_evidence,
        parameters.head_rate_seen,
        parameters.head_common,
    )


def _modes(parameters: GaitParameters, side: str) -> Modes:
    names = ("aligned", "switching", "drift", "strength", "free_strength", "lead", "spread", "offset_kappa")
    values = {name: float(getattr(parameters, f"{side}_{name}")) for name in names}
    steps = np.linspace(-2.0, 2.0, NEAR)
    offsets = np.append(2.0 * np.pi * np.arange(BINS) / BINS, steps * values.pop("spread"))
    anywhere = np.exp(values.pop("offset_kappa") * (np.cos(offsets[:BINS]) - 1.0))
    share = np.exp(-0.5 * steps**2)
    return Modes(
        **values,
        cos=np.cos(offsets),
        sin=np.sin(offsets),
        anywhere=anywhere / anywhere.sum(),
        share=share / share.sum(),
        own=np.ones(BINS),
    )


def _mistaken(modes: Modes, bias: float, kappa: float) -> Modes:
    """The modes of an orientation that a classifier may see turned all along, with the probability ``bias``.

    The free mode's offsets are what appears then: the person's, or the classifier's, which is drawn from a
    von Mises density about 0 with the concentration ``kappa``, and says nothing of the person.
    """
    own = (1.0 - bias) * (1.0 - modes.aligned) * modes.anywhere
    turned = np.exp(kappa * (modes.cos[:BINS] - 1.0))
    apparent = own + bias * turned / turned.sum()
    return modes._replace(
        aligned=(1.0 - bias) * modes.aligned,
        anywhere=apparent / apparent.sum(),
        own=np.divide(own, apparent, out=np.ones(BINS), where=apparent > 0.0),
    )
