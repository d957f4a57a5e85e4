"""The modes of the couplings stated with GTSAM's hybrid factors: a reference for short tracks.

`GaitOffsets` is solved by turns. Here the same hidden Markov chains are discrete variables of a factor graph,
the offsets are continuous ones, and all are inferred at once; see `hypotheses`.

Left out are the leads of body and head, `head_evidence`, since the head tells of the body's mode by its own
coupling, the head that steers the motion, and offsets that are likelier than others.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import gtsam
import numpy as np
from gtsam.symbol_shorthand import C, O, P
from hybrid_factors import body_coupling, head_coupling, offset_drawn, offset_kept
from numpy.typing import NDArray
from scipy import special

from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray, difference, direction
from graphtrack.geometry.camera import GroundCamera
from graphtrack.inference.graph.batch import anchors
from graphtrack.inference.offline import smooth_track
from graphtrack.inference.state import insert_step
from graphtrack.model import Model, States, Step
from graphtrack.model.observation import chain
from graphtrack.model.parameters import Parameters
from graphtrack.tracks import Track

ALIGNED, FREE, ANEW = range(3)
"""What a coupling's mode is in a frame: aligned; free, at the offset of the frame before, which drifts; free,
at an offset that is drawn anew."""

MODES = 3

MOST_FRAMES = 12
"""Longer tracks are refused."""

Course = NDArray[np.int64]
"""(2, n) modes of both couplings, body and head, in each frame."""

_STILL = 1e-3
"""Radians by which the offset of an aligned coupling may change from frame to frame: it hardly does."""

_AROUND = math.sqrt(2.0 * math.pi)
"""1-σ of a Gaussian about the initial offset whose height is that of the uniform density on the circle."""

_SIDES = ("body", "head")


@dataclass(frozen=True, eq=False)
class Leaves:
    """The alternatives of one factor, for each mode of one coupling.

    Attributes
    ----------
    side : 0 body, 1 head
    frames : whose modes select: one, or the frame before and this; the last changes fastest
    factors : all on the same variables, with unit noise
    costs : of each by itself: minus the logarithm of its normaliser
    """

    side: int
    frames: tuple[int, ...]
    factors: tuple[gtsam.NoiseModelFactor, ...]
    costs: tuple[float, ...]

    def chosen(self, course: Course) -> int:
        """Place of the alternative that a course of the modes selects."""
        place = 0
        for frame in self.frames:
            place = place * MODES + int(course[self.side, frame])
        return place

    def hybrid(self) -> gtsam.HybridNonlinearFactor:
        """The same as a factor of GTSAM."""
        # One discrete variable a frame for the modes of both couplings: pruning knows chains of one.
        labels = [(C(frame), MODES**2) for frame in self.frames]
        keys = gtsam.DiscreteKeys()
        for label in labels:
            keys.push_back(label)
        pairs = []
        for both in np.ndindex(*(MODES**2 for _ in self.frames)):
            place = 0
            for mode in both:
                place = place * MODES + divmod(mode, MODES)[self.side]
            pairs.append((self.factors[place], self.costs[place]))
        return gtsam.HybridNonlinearFactor(keys, gtsam.HybridNonlinearFactorValuePairs(labels, pairs))


@dataclass(frozen=True, eq=False)
class HybridTrack:
    """A track's graph: what does not depend on the modes, what does, and the chains of the modes.

    Attributes
    ----------
    steps : of the track
    model : "separate" with the same parameters
    plain : for each frame, the factors that are there in every mode
    leaves : for each frame, the alternatives of the others
    first, transitions : (2, 3) probabilities of the first modes, (2, n − 1, 3, 3) of each from the one before
    values : where to start
    """

    steps: list[Step]
    model: Model
    plain: list[list[gtsam.NonlinearFactor]]
    leaves: list[list[Leaves]]
    first: FloatArray
    transitions: FloatArray
    values: gtsam.Values

    def graph_of(self, course: Course) -> tuple[gtsam.NonlinearFactorGraph, float]:
        """The graph under one hypothesis, and what the hypothesis costs beside it."""
        graph, cost = gtsam.NonlinearFactorGraph(), 0.0
        for k, (plain, alternatives) in enumerate(zip(self.plain, self.leaves, strict=True)):
            for factor in plain:
                graph.push_back(factor)
            for leaves in alternatives:
                place = leaves.chosen(course)
                graph.push_back(leaves.factors[place])
                cost += leaves.costs[place]
            for side, modes in enumerate(course):
                row = self.first[side] if k == 0 else self.transitions[side, k - 1, modes[k - 1]]
                cost -= math.log(row[modes[k]])
        return graph, cost

    def values_of(self, k: int, values: gtsam.Values) -> gtsam.Values:
        """Those that the factors of frame k are about: its own and those of the frame before."""
        found = gtsam.Values()
        for step in self.steps[max(0, k - 1) : k + 1]:
            found.insert(step.position_key, values.atPoint2(step.position_key))
            found.insert(step.velocity_key, values.atVector(step.velocity_key))
            for key in (step.body_key, step.head_key, O(step.index), P(step.index)):
                found.insert(key, values.atRot2(key))
        return found

    def hybrid_graph_of(self, k: int) -> gtsam.HybridNonlinearFactorGraph:
        """What arrives with frame k as a hybrid graph; all frames together are the whole model."""
        graph = gtsam.HybridNonlinearFactorGraph()
        for factor in self.plain[k]:
            graph.push_back(factor)
        for leaves in self.leaves[k]:
            graph.push_back(leaves.hybrid())
        keys = gtsam.DiscreteKeys()
        if k == 0:
            table = np.kron(self.first[0], self.first[1])
        else:
            keys.push_back((C(k - 1), MODES**2))
            # GTSAM wants a row for each mode and a column for each mode before.
            table = np.kron(self.transitions[0, k - 1], self.transitions[1, k - 1]).T.ravel()
        graph.push_back(gtsam.DiscreteConditional((C(k), MODES**2), keys, table.tolist()))
        return graph


def state_hybrid(track: Track, model: Model, camera: GroundCamera | None = None) -> HybridTrack:
    """State the model `full` of a track with hybrid factors.

    Raises
    ------
    InputError
        If the model has no modes, or the track is longer than `MOST_FRAMES`.
    SolveError
        If no position was observed.
    """
    if not model.has_modes:
        raise InputError(f"model {model.preset!r}", "a model with modes of its couplings, such as 'full'")
    if len(track) > MOST_FRAMES:
        raise InputError(f"{len(track)} frames", f"at most {MOST_FRAMES} for the hybrid reference")
    separate = Model("separate", model.parameters)
    start = smooth_track(track, separate, camera).track
    assert start.velocity is not None and start.body is not None and start.head is not None
    states = States(start.position, start.velocity, start.body, start.head)
    rows = np.column_stack([states.position, states.velocity, states.body, states.head])
    offsets = difference(states.body, direction(states.velocity)), difference(states.head, states.body)
    steps, values, plain, leaves = chain(track, camera), gtsam.Values(), [], []
    for k, step in enumerate(steps):
        insert_step(values, step, separate, rows[k])
        for key, offset in zip((O(k), P(k)), offsets, strict=True):
            values.insert(key, gtsam.Rot2(float(offset[k])))
        plain.append(separate.factors(step))
        speed, guesses = float(np.linalg.norm(states.velocity[k])), [float(each[k]) for each in offsets]
        leaves.append(list(_leaves(step, model.parameters, speed, guesses)))
    plain[0] += anchors(steps[0], separate, float(states.body[0]), float(states.head[0]))
    first, transitions = _chains(np.diff(track.t), model.parameters)
    return HybridTrack(steps, separate, plain, leaves, first, transitions, values)


def _leaves(step: Step, parameters: Parameters, speed: float, guesses: list[float]) -> Iterator[Leaves]:
    coupling, k = parameters.coupling, step.index
    excess = max(0.0, speed - coupling.speed_threshold)
    kappas = coupling.motion_body_kappa, coupling.head_body_kappa
    for side, (name, letter, scale) in enumerate(zip(_SIDES, (O, P), (excess**2, 1.0), strict=True)):
        gait = {key: getattr(parameters.gait, f"{name}_{key}") for key in _GAIT}
        strengths = [float(coupling.weights(step.dt)) * kappas[side] * gait[key] for key in _GAIT[:2]]
        near, anywhere = (
            body_coupling(step, kappa, coupling.speed_threshold) if side == 0 else head_coupling(step, kappa)
            for kappa in strengths
        )
        # Modes of different strengths are compared as densities of the angle, at the speed of the start.
        costs = [math.log(2.0 * math.pi * float(special.i0e(kappa * scale))) for kappa in strengths]
        yield Leaves(side, (k,), (near, anywhere, anywhere), (costs[0], costs[1], costs[1]))
        keys = [letter(k)] if step.previous is None else [letter(k - 1), letter(k)]
        small = offset_drawn(keys, 0.0, gait["spread"]), _gaussian(gait["spread"])
        about = gait["offset_kappa"]
        mass = math.log(2.0 * math.pi * float(special.i0e(about)))
        any_ = offset_drawn(keys, guesses[side], _AROUND, about), mass
        if step.previous is None or step.dt is None:
            # No free mode goes on here, but GTSAM wants all alternatives.
            table = [small, any_, any_]
        else:
            wander = math.sqrt(gait["drift"] * step.dt + _STILL**2)
            stay = offset_kept(keys, _STILL), _gaussian(_STILL)
            goes_on = offset_kept(keys, wander), _gaussian(wander)
            table = [stay, any_, any_, *[small, goes_on, any_] * 2]
        frames = (k,) if step.previous is None else (k - 1, k)
        yield Leaves(side, frames, tuple(one[0] for one in table), tuple(one[1] for one in table))


_GAIT = ("strength", "free_strength", "spread", "drift", "offset_kappa")


def _gaussian(std: float) -> float:
    """Minus the logarithm of the normaliser of a Gaussian density."""
    return 0.5 * math.log(2.0 * math.pi) + math.log(std)


def _chains(dt: FloatArray, parameters: Parameters) -> tuple[FloatArray, FloatArray]:
    """The Markov chains of `terms.gait.switch`; an aligned offset that is drawn anew is not told apart."""
    first, transitions = np.zeros((2, MODES)), np.zeros((2, len(dt), MODES, MODES))
    for side, name in enumerate(_SIDES):
        aligned = getattr(parameters.gait, f"{name}_aligned")
        first[side, ALIGNED], first[side, ANEW] = aligned, 1.0 - aligned
        kept = np.exp(-getattr(parameters.gait, f"{name}_switching") * dt)
        transitions[side, :, :, ALIGNED] = ((1.0 - kept) * aligned)[:, None]
        transitions[side, :, :, ANEW] = ((1.0 - kept) * (1.0 - aligned))[:, None]
        transitions[side, :, ALIGNED, ALIGNED] += kept
        transitions[side, :, FREE:, FREE] = kept[:, None]
    return first, transitions
