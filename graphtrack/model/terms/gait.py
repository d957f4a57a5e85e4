"""Modes of the couplings: where they do not hold, a drifting offset takes their place, or nothing.

A hidden Markov chain over modes and offsets, for each coupling. A frame's mode is *aligned* (the coupling
rests near 0) or *free* (at an offset that drifts around the circle). A row of probabilities has `BINS`
offsets of the free mode on a grid, then `NEAR` small ones of the aligned mode.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, ClassVar, NamedTuple

import numpy as np

from graphtrack.geometry.angles import FloatArray, class_centres, class_kappa
from graphtrack.geometry.camera import GroundCamera
from graphtrack.later import gtsam, special
from graphtrack.model.kernels.bessel import of_alike
from graphtrack.model.kernels.compiled import allocating, compiled
from graphtrack.model.kernels.elementary import exp, log
from graphtrack.model.kernels.layout import Field
from graphtrack.model.observation import States, Step
from graphtrack.model.parameters import GaitParameters
from graphtrack.model.term import Term, Variable
from graphtrack.model.terms.pose import peaked_cost, softened_cost
from graphtrack.tracks import Track

if TYPE_CHECKING:
    from graphtrack.model.kernels.packing import PackedTracks


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
    # Two loops, since one with a condition in it does not become vector instructions.
    if uniform == 0.0:
        for j in range(ROW):
            row[j] -= weight * peaked_cost(modes.cos[j] * along + modes.sin[j] * across, kappa)
    else:
        for j in range(ROW):
            row[j] -= weight * softened_cost(modes.cos[j] * along + modes.sin[j] * across, kappa, uniform)


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
    for j in range(ROW):
        along, across = cos * modes.cos[j] - sin * modes.sin[j], sin * modes.cos[j] + cos * modes.sin[j]
        density = heights[n_classes]
        for c in range(n_classes):
            close = along * directions[c, 0] + across * directions[c, 1]
            density += heights[c] * exp(kappa * (close - 1.0))
        row[j] += weight * log(density)


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
    total = 0.0
    for j in range(ROW):
        total += now[j]
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
    free = near = 0.0
    for j in range(BINS):
        free += ahead[j] * modes.anywhere[j]
    for j in range(NEAR):
        near += ahead[BINS + j] * modes.share[j]
    anew = (1.0 - kept) * ((1.0 - modes.aligned) * free + modes.aligned * near)
    for j in range(ROW):
        ahead[j] = kept * ahead[j] + anew
    drift(ahead, modes.drift * dt, memory)


@allocating
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
        greatest, total = likelihood[k, 0], 0.0
        for j in range(1, ROW):
            greatest = max(greatest, likelihood[k, j])
        for j in range(ROW):
            likelihood[k, j] = exp(likelihood[k, j] - greatest)
            now[j] *= likelihood[k, j]
            total += now[j]
        for j in range(ROW):
            now[j] /= total
            filtered[k, j] = now[j]
    for k in range(n - 1, -1, -1):
        total = 0.0
        for j in range(ROW):
            smoothed[k, j] = filtered[k, j] * ahead[j]
            total += smoothed[k, j]
        for j in range(ROW):
            smoothed[k, j] /= total
        if k == 0:
            break
        # ahead: how likely all that follows is, from each mode and offset of the frame before.
        total = 0.0
        for j in range(ROW):
            ahead[j] *= likelihood[k, j]
        switch_back(ahead, modes, dt[k], memory)
        for j in range(ROW):
            total += ahead[j]
        for j in range(ROW):
            ahead[j] /= total


@compiled
def expected(
    probability: FloatArray, modes: Modes, strength: float, free_strength: float
) -> tuple[float, float]:
    """Resultant of the couplings of all modes and offsets: cosine and sine times the concentration."""
    cos = sin = 0.0
    for j in range(BINS):
        weight = probability[j] * modes.own[j] * free_strength
        cos += weight * modes.cos[j] + probability[j] * (1.0 - modes.own[j]) * strength
        sin += weight * modes.sin[j]
    for j in range(BINS, ROW):
        cos += probability[j] * strength * modes.cos[j]
        sin += probability[j] * strength * modes.sin[j]
    return cos, sin


@compiled
def deviation(
    probability: FloatArray, modes: Modes, strength: float, free_strength: float, cos: float, sin: float
) -> float:
    """Standard deviation of the pulls of all modes and offsets on a direction, given by cosine and sine.

    Each pulls with the sine of what it is apart, times the strength of its mode.
    """
    total = 0.0
    for j in range(BINS):
        pull = free_strength * (modes.sin[j] * cos - modes.cos[j] * sin)
        total += probability[j] * modes.own[j] * pull * pull
        total += probability[j] * (1.0 - modes.own[j]) * (strength * sin) ** 2
    for j in range(BINS, ROW):
        pull = strength * (modes.sin[j] * cos - modes.cos[j] * sin)
        total += probability[j] * pull * pull
    return math.sqrt(total)


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


_GRID = 2.0 * np.pi * np.arange(72) / 72


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


def angle_information(kappa: FloatArray) -> FloatArray:
    """Fisher information κ·I₁(κ)/I₀(κ) of an angle seen with concentration κ."""
    return np.asarray(kappa * special.i1e(kappa) / special.i0e(kappa))


def class_information(heights: FloatArray) -> FloatArray:
    """Fisher information (n,) of class likelihoods (n, classes + 1), the last the outliers'; NaN is 0."""
    n_classes = heights.shape[1] - 1
    kappa, apart = class_kappa(n_classes), _GRID[:, None] - class_centres(n_classes)
    shapes = np.exp(kappa * (np.cos(apart) - 1.0))
    density = np.nan_to_num(heights[:, :-1]) @ shapes.T + np.nan_to_num(heights[:, -1:], nan=1.0)
    slope = np.nan_to_num(heights[:, :-1]) @ (-kappa * np.sin(apart) * shapes).T
    # The mean of (L'/L)² under L itself.
    return np.asarray((slope**2 / density).sum(axis=1) / density.sum(axis=1))


class GaitOffsets(Term):
    """Hidden modes of the two couplings, which stand before it in the list of terms.

    In each frame each coupling is *aligned* (at rest near 0, as Chen et al. (2011) have it) or *free* (at
    rest at an offset that may be anything and drifts slowly); a hidden Markov chain says that this seldom
    changes. The couplings, and the head that steers the motion, count by the probabilities of the modes. The
    engine infers both in turn: given the states the modes, by the forward–backward recursion; given the
    modes the states.
    """

    uses: ClassVar[frozenset[Variable]] = frozenset({"body", "head"})
    repeats = True
    reads = tuple(f"gait.{field.name}" for field in dataclasses.fields(GaitParameters))
    fields = (
        Field("body_aligned_kappa", "κ₁ and κ₂ with the weight, where modes choose how much of them holds"),
        Field("head_aligned_kappa", ""),
        Field("coupling_weight", "that weight"),
        Field("body_information", "Fisher information of what was seen of the body, and of the head"),
        Field("head_information", ""),
    )
    shared = (Field("body_diffusion", "rad²/s"),)
    kernels = ()  # it acts through those of the couplings

    def factors(self, step: Step) -> Sequence[gtsam.NonlinearFactor]:
        """None: the term acts through the couplings."""
        return []

    def cost(self, states: States, track: Track, camera: GroundCamera | None = None) -> float:
        """0: the modes weigh the couplings; they have no cost of their own."""
        return 0.0

    def pack(self, packed: PackedTracks) -> None:
        """The couplings when aligned, their weights, and how much each observation of body and head tells."""
        records, coupling = packed.records, self.parameters.coupling
        packed.shared["body_diffusion"] = self.parameters.orientation.body_diffusion
        records["coupling_weight"] = coupling.weights(packed.dt)
        records["body_aligned_kappa"] = records["motion_body_kappa"]
        records["head_aligned_kappa"] = records["head_body_kappa"]
        for name, heights in (("body", packed.body_heights), ("head", packed.head_heights)):
            records[f"{name}_information"] = of_alike(angle_information, records[f"{name}_kappa"])
            if len(heights):
                records[f"{name}_information"] += class_information(heights)
