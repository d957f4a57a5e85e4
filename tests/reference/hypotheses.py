"""Inferring what `hybrid` states: every course of the modes by itself, or all by GTSAM's hybrid smoother."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import product

import gtsam
import numpy as np
from gtsam.symbol_shorthand import C, O, P
from hybrid import ALIGNED, ANEW, FREE, MODES, Course, HybridTrack, state_hybrid

from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray
from graphtrack.geometry.camera import GroundCamera
from graphtrack.inference.graph.batch import optimize
from graphtrack.inference.prior import variable_keys
from graphtrack.inference.solution import SolverOptions
from graphtrack.model import Model, States
from graphtrack.tracks import Track

GTSAM_FRAMES = 4
"""Longer tracks are not given to GTSAM's hybrid smoother: its time grows by 15 with each frame."""

_LEAST = 1e-9
"""Hypotheses that are less probable are not averaged."""


@dataclass(frozen=True, eq=False)
class HybridSolution:
    """What the hypotheses say of a track of n frames, averaged by their probabilities.

    Attributes
    ----------
    states : position, velocity, body, head; metres, m/s, radians; angles are those of the mean resultants
    aligned_p, head_aligned_p : (n,) probabilities of the aligned modes
    gait_offset, head_offset : (n,) radians from motion to body, and from body to head
    probabilities : (h,) of the hypotheses, the most probable first
    """

    states: States
    aligned_p: FloatArray
    head_aligned_p: FloatArray
    gait_offset: FloatArray
    head_offset: FloatArray
    probabilities: FloatArray


def smooth_by_hypotheses(
    track: Track,
    model: Model,
    camera: GroundCamera | None = None,
    *,
    max_changes: int = 1,
    options: SolverOptions | None = None,
) -> HybridSolution:
    """Enumerate the courses of both couplings' modes, and score each by its Laplace evidence.

    Each is optimised on a graph of its own. Its evidence is minus the cost there plus ½·log det of 2π·H⁻¹,
    with H the curvature of Gauss–Newton.

    Parameters
    ----------
    track : of at most `hybrid.MOST_FRAMES` frames
    model : with modes of its couplings
    max_changes : courses with more changes of one coupling's mode are left out

    Raises
    ------
    InputError
        If the model has no modes, or the track is longer.
    """
    options = SolverOptions() if options is None else options
    stated = state_hybrid(track, model, camera)
    ordering = gtsam.Ordering()
    for step in stated.steps:
        for key in (*variable_keys(step, stated.model), O(step.index), P(step.index)):
            ordering.push_back(key)
    found: list[tuple[gtsam.Values, Course]] = []
    scores = []
    for both in product(courses(len(track), max_changes), repeat=2):
        course = np.array(both)
        graph, cost = stated.graph_of(course)
        values, costs, _ = optimize(graph, stated.values, ordering, options)
        volume = graph.linearize(values).eliminateSequential(ordering).logDeterminant()
        scores.append(-cost - costs[-1] - volume)
        found.append((values, course))
    weights = np.exp(np.array(scores) - max(scores))
    return _average(stated, found, weights / weights.sum())


def courses(n: int, max_changes: int) -> Iterator[tuple[int, ...]]:
    """Courses of one coupling's mode over n frames, with at most so many changes."""

    def longer(course: tuple[int, ...], left: int) -> Iterator[tuple[int, ...]]:
        if len(course) == n:
            yield course
            return
        kept = ALIGNED if course[-1] == ALIGNED else FREE
        yield from longer((*course, kept), left)
        if left > 0:
            for mode in (ALIGNED, ANEW):
                if mode != kept:
                    yield from longer((*course, mode), left - 1)

    for first in (ALIGNED, ANEW):
        yield from longer((first,), max_changes)


def smooth_by_gtsam(
    track: Track, model: Model, camera: GroundCamera | None = None, *, passes: int = 4
) -> HybridSolution:
    """The same by `gtsam.HybridSmoother`, which eliminates all hypotheses at one linearisation point.

    Its hypotheses are not pruned: asked for at most so many, GTSAM 4.3 lets go of the most probable ones when
    variables have more than two modes.

    Parameters
    ----------
    track : of at most `GTSAM_FRAMES` frames
    model, camera : as above
    passes : linearisations, each at the optimum of the hypothesis that was the most probable before

    Raises
    ------
    InputError
        If the model has no modes, or the track is longer.
    """
    n = len(track)
    if n > GTSAM_FRAMES:
        raise InputError(f"{n} frames", f"at most {GTSAM_FRAMES} for GTSAM's hybrid smoother")
    stated = state_hybrid(track, model, camera)
    values = stated.values
    network = _eliminate(stated, values)
    for _ in range(passes - 1):
        values = values.retract(network.optimize().continuous())
        network = _eliminate(stated, values)
    found, weights = [], []
    marginal = network.discreteMarginal()
    for modes in product(range(MODES**2), repeat=n):
        chosen = gtsam.DiscreteValues()
        for k, mode in enumerate(modes):
            chosen[C(k)] = mode
        probability = marginal.evaluate(chosen)
        if probability > _LEAST:
            course = np.array([divmod(mode, MODES) for mode in modes]).T
            found.append((values.retract(network.choose(chosen).optimize()), course))
            weights.append(probability)
    return _average(stated, found, np.array(weights) / sum(weights))


def _eliminate(stated: HybridTrack, values: gtsam.Values) -> gtsam.HybridBayesNet:
    smoother = gtsam.HybridSmoother()
    for k in range(len(stated.steps)):
        smoother.update(stated.hybrid_graph_of(k), stated.values_of(k, values))
    return smoother.hybridBayesNet()


def _average(
    stated: HybridTrack, found: Sequence[tuple[gtsam.Values, Course]], weights: FloatArray
) -> HybridSolution:
    n = len(stated.steps)
    vectors, angles, aligned = np.zeros((2, n, 2)), np.zeros((4, n), complex), np.zeros((2, n))
    for (values, course), weight in zip(found, weights.tolist(), strict=True):
        aligned += weight * (course == ALIGNED)
        for k, step in enumerate(stated.steps):
            vectors[0, k] += weight * values.atPoint2(step.position_key)
            vectors[1, k] += weight * values.atVector(step.velocity_key)
            for i, key in enumerate((step.body_key, step.head_key, O(k), P(k))):
                rotation = values.atRot2(key)
                angles[i, k] += weight * complex(rotation.c(), rotation.s())
    body, head, gait_offset, head_offset = np.angle(angles)
    states = States(vectors[0], vectors[1], body, head)
    return HybridSolution(states, aligned[0], aligned[1], gait_offset, head_offset, np.sort(weights)[::-1])
