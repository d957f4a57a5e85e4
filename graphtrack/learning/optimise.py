"""Objectives of learning (truth, evidence, held-out prediction), their maximum and its curvature.

Couplings are products that are not normalised, so that their evidence is not known; how well they predict
hidden observations is.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy import optimize

from graphtrack.geometry.angles import (
    FloatArray,
    class_centres,
    class_kappa,
    log_blurred,
    von_mises_log_density,
    with_outliers,
)
from graphtrack.geometry.camera import GroundCamera
from graphtrack.inference.chain.batch import Options, solve_packed, solve_terms
from graphtrack.inference.chain.initialisation import empty_result, pack, problem_of
from graphtrack.inference.chain.newton import NOT_FINITE, Result, Workspace, factorise, workspace
from graphtrack.inference.engines import make_solver_ready
from graphtrack.kernels.compilation import allocating
from graphtrack.kernels.layout import BODY, HEAD, Chain, N, Problem
from graphtrack.model import Model
from graphtrack.model.packing import PackedTracks
from graphtrack.packages import special
from graphtrack.simulation.degrade import withhold
from graphtrack.tracks.time import TIME_TOLERANCE
from graphtrack.tracks.track import Track

Blocks = Callable[[FloatArray], FloatArray]
"""x (p,) → a log density for each block of independent data; their sum is climbed."""

REACH = float(np.log(100.0))  # largest distance of a parameter from its start, on its scale
PRIOR_STD = 3.0  # of a parameter about its start, on its scale: a factor of 20 is not held against it
ROUGH, FINE = 0.02, 1e-4  # least gain of an iteration, in the logarithm of the density

_DIFFERENCE = 1e-3


def maximise(
    values: Blocks, start: FloatArray, prior: FloatArray, hessian: FloatArray | None = None
) -> FloatArray:
    """Return the maximum (p,), from ``start``; the prior's mean is ``prior``.

    Without the ``hessian`` (p, p) of the costs near the start it is a rough one: it ends where an iteration
    gains less than `ROUGH`, and takes one-sided slopes, which move the maximum by half a step. With it the
    climb is in directions in which the costs are about as curved, and ends where it gains less than `FINE`.
    """
    rough = hessian is None
    axes = np.eye(len(start)) if hessian is None else np.linalg.inv(np.linalg.cholesky(hessian)).T

    def cost(x: FloatArray) -> float:
        # A broad prior keeps what the data do not determine where it starts.
        return 0.5 * float(np.sum((x - prior) ** 2)) / PRIOR_STD**2 - float(values(x).sum())

    def cost_and_slope(y: FloatArray) -> tuple[float, FloatArray]:
        x, steps = start + axes @ y, _DIFFERENCE * np.eye(len(y))
        x = np.clip(x, prior - REACH, prior + REACH)
        here = cost(x)
        if rough:
            slope = np.array([cost(x + d) - here for d in steps]) / _DIFFERENCE
        else:
            slope = np.array([cost(x + d) - cost(x - d) for d in steps]) / (2.0 * _DIFFERENCE)
        return here, axes.T @ slope

    limits = zip(prior - REACH - start, prior + REACH - start, strict=True)
    found = optimize.minimize(
        cost_and_slope,
        np.zeros(len(start)),
        jac=True,
        method="L-BFGS-B",
        bounds=list(limits) if rough else None,
        options={"ftol": (ROUGH if rough else FINE) / max(1.0, abs(cost(start))), "maxiter": 50},
    )
    return np.clip(start + axes @ found.x, prior - REACH, prior + REACH)


@dataclass(frozen=True, eq=False)
class Curvature:
    """Curvature of a log density, for each block of independent data and with the prior."""

    total: FloatArray  # (p, p) minus the Hessian of the sum with the prior
    slopes: FloatArray  # (blocks, p) of each block
    blocks: FloatArray  # (blocks, p, p) minus the Hessian of each block


def curvature(values: Blocks, x: FloatArray, prior: FloatArray) -> Curvature:
    """The curvature at ``x`` (p,), by differences.

    Steps are about half a standard deviation long: rounding and the higher derivatives both are small there.
    """
    p, here = len(x), values(x)
    steps = np.full(p, 0.02)
    for _ in range(2):
        units = np.diag(steps)
        ahead = np.array([values(x + unit) for unit in units])
        behind = np.array([values(x - unit) for unit in units])
        bends = (2.0 * here - ahead - behind) / steps[:, None] ** 2
        used = steps
        # The prior is a parabola: it bends by that much everywhere.
        diagonal = bends.sum(axis=1) + PRIOR_STD**-2
        steps = np.clip(0.5 / np.sqrt(np.maximum(diagonal, PRIOR_STD**-2)), 2e-3, 0.3)
    blocks = np.zeros((len(here), p, p))
    blocks[:, range(p), range(p)] = bends.T
    units = np.diag(used)
    for i in range(p):
        for j in range(i):
            corner = values(x + units[i] + units[j])
            mixed = (ahead[i] + ahead[j] - here - corner) / (used[i] * used[j])
            blocks[:, i, j] = blocks[:, j, i] = mixed
    slopes = ((ahead - behind) / (2.0 * used[:, None])).T
    return Curvature(blocks.sum(axis=0) + PRIOR_STD**-2 * np.eye(p), slopes, blocks)


def uncertainty(found: Curvature) -> FloatArray:
    """Covariance (p, p) of the maximum: by the jackknife, with no variance below the curvature's.

    The jackknife goes by how far the maximum moves, by one Newton step, without each of the blocks. To first
    order that is the sandwich estimate. Of few blocks it may be small by chance.
    """
    count, centred = len(found.slopes), found.slopes - found.slopes.mean(axis=0)
    pairs = zip(found.blocks, centred, strict=True)
    moves = np.array([np.linalg.solve(definite(found.total - own), slope) for own, slope in pairs])
    moves -= moves.mean(axis=0)
    covariance = moves.T @ moves * (count - 1.0) / count
    least = np.diag(np.linalg.inv(definite(found.total)))
    # Correlations are the jackknife's.
    wider = np.sqrt(np.maximum(1.0, least / np.maximum(np.diag(covariance), 1e-300)))
    return np.asarray(wider[:, None] * covariance * wider)


def definite(hessian: FloatArray) -> FloatArray:
    """The Hessian (p, p) with no less curvature in any direction than the prior alone has.

    At the edge of what is allowed the curvature can be anything; there, the prior is all there is.
    """
    sizes, axes = np.linalg.eigh(hessian)
    return np.asarray((axes * np.maximum(sizes, PRIOR_STD**-2)) @ axes.T)


FOLDS = 3  # each observation is hidden in one of so many smoothings
_STRETCH = 1.0  # seconds hidden at a time: more than neighbours bridge, since there couplings help

_CHANNELS = (("position", "pixel"), ("body", "body_likelihood"), ("head", "head_likelihood"))


def hidden_frames(track: Track, channel: int, fold: int) -> NDArray[np.bool_]:
    """Return frames (n,) in which a fold holds out a channel (0 position, 1 body, 2 head), in intervals."""
    seconds = track.t - track.t[0]
    stretch = min(_STRETCH, 1.001 * float(seconds[-1]) / FOLDS)
    return (np.floor_divide(seconds + TIME_TOLERANCE, stretch).astype(int) + channel) % FOLDS == fold


def withheld(track: Track, fold: int) -> Track:
    """Return the track without the observations that a fold holds out."""
    found = track
    for channel, names in enumerate(_CHANNELS):
        found = withhold(found, hidden_frames(track, channel, fold), names)
    nowhere = not np.isfinite(found.position).all(axis=1).any()
    return replace(found, position=track.position) if nowhere else found


def held_out_log_density(
    packed: PackedTracks, model: Model, states: FloatArray, covariance: FloatArray, fold: int
) -> FloatArray:
    """Return the log density (N,) of the held-out observations in each frame.

    Parameters
    ----------
    packed : the tracks with all that was observed, packed with the model
    states, covariance : (N, 6) in the world and (N, 6, 6), from the observations of the fold
    """
    hidden = [
        np.concatenate([hidden_frames(track, channel, fold) for track in packed.tracks])
        for channel in range(len(_CHANNELS))
    ]
    total = np.zeros(len(states))
    judged = hidden[0] & packed.has_position
    error = states[judged, :2] - packed.position[judged]
    information = packed.records["position_information"][judged]
    spread = covariance[judged][:, :2, :2] + np.eye(2) / information[:, None, None]
    squares = np.einsum("ni,nij,nj->n", error, np.linalg.inv(spread), error)
    total[judged] -= 0.5 * (squares + np.log(np.linalg.det(2.0 * math.pi * spread)))
    for channel, (has, name, place) in enumerate(
        ((model.has_body, "body", BODY), (model.has_head, "head", HEAD)), start=1
    ):
        if has:
            estimate, kappa = states[:, place], 1.0 / covariance[:, place, place]
            total += _held_out_angles(packed, model, name, estimate, kappa, hidden[channel])
    return total


def _held_out_angles(
    packed: PackedTracks,
    model: Model,
    name: str,
    estimate: FloatArray,
    kappa: FloatArray,
    hidden: NDArray[np.bool_],
) -> FloatArray:
    likelihood, total = model.parameters.likelihood, np.zeros(len(estimate))
    angle, classes = packed.channel(name), packed.channel(f"{name}_likelihood")
    if angle is not None:
        # The records have no concentration without observations, and if classes replace the angle.
        noise = packed.records[f"{name}_kappa"]
        judged = hidden & (noise > 0.0)
        density = log_blurred(angle[judged] - estimate[judged], noise[judged], kappa[judged])
        total[judged] = with_outliers(density, likelihood.outlier_probability)
    if classes is not None:
        weight = classes.sum(axis=1)
        judged = hidden & np.isfinite(weight) & (weight > 0.0)
        n, share = classes.shape[1], classes[judged] / weight[judged, None]
        apart = class_centres(n) - estimate[judged, None]
        densities = log_blurred(apart, np.asarray(class_kappa(n)), kappa[judged, None])
        density = special.logsumexp(densities, axis=1, b=share)
        total[judged] = with_outliers(density, likelihood.class_outlier_probability)
    return total


@allocating
def log_determinants(
    problem: Problem, begin: int, end: int, states: FloatArray, workspace: Workspace, found: FloatArray
) -> None:
    """log det of the Hessians of tracks ``begin`` to ``end`` at their states, from the Cholesky factors.

    The Hessian is exact where that is positive definite, else that of Gauss–Newton.
    """
    for track in range(begin, end):
        a, b = problem.offsets[track], problem.offsets[track + 1]
        factorise(Chain(problem, track, b - a, float(b - a)), states[a:b], workspace)
        total = 0.0
        for k in range(b - a):
            for i in range(N):
                total -= 2.0 * math.log(workspace.inverse[k, i, i])
        found[track] = total


MAX_ITERATIONS, TOLERANCE = 100, 1e-13


@dataclass(frozen=True, eq=False)
class Solved:
    """One solution of all tracks; ``result`` counts positions from the tracks' origins."""

    packed: PackedTracks
    problem: Problem
    result: Result
    memory: Workspace

    @property
    def sound(self) -> FloatArray:
        """(m,) whether each track could be solved."""
        return np.asarray(self.result.status != NOT_FINITE)

    @property
    def states(self) -> FloatArray:
        """(N, 6) states in the world."""
        states = self.result.states.copy()
        states[:, :2] += np.repeat(self.packed.origin, np.diff(self.packed.offsets), axis=0)
        return states

    @property
    def covariance(self) -> FloatArray:
        """(N, 6, 6) of the states, those of angles inverse concentrations."""
        return self.result.covariance


class Solver:
    """Solutions that depend on nothing but the model, smoothly: all start from the same states.

    Parameters
    ----------
    model : whose solution, after a search for the best basin, is where all start
    """

    def __init__(self, tracks: Sequence[Track], model: Model, camera: GroundCamera | None) -> None:
        self._tracks, self._camera = tracks, camera
        make_solver_ready(model, "chain", complete=True)
        packed = pack(tracks, model, camera)
        states = solve_packed(packed, model, max_iterations=MAX_ITERATIONS, tolerance=TOLERANCE).states
        states[:, :2] -= np.repeat(packed.origin, np.diff(packed.offsets), axis=0)
        self._start = np.nan_to_num(states)
        self._longest = int(np.diff(packed.offsets).max())

    def __call__(self, model: Model) -> Solved:
        """The solution by a model with the same terms."""
        packed = pack(self._tracks, model, self._camera)
        problem, result = problem_of(packed), empty_result(packed)
        result.states[:] = self._start
        solve_terms(problem, Options(MAX_ITERATIONS, TOLERANCE, search=False), result)
        return Solved(packed, problem, result, workspace(self._longest))


Criterion = Literal["truth", "evidence", "prediction"]

FAILED = -1e9  # stands for the logarithm of a density where a track could not be solved


class Objective:
    """A logarithm of a density for each track, as a function of the model alone.

    Every evaluation starts from the same states, those of ``model`` after a search for the best basin. So
    its value does not depend on what was evaluated before, and is smooth.

    Parameters
    ----------
    criterion : "truth", its likelihood under the smoother's covariances, frame by frame; "evidence", of all
        that was observed; "prediction", the density of observations that were hidden, a part at a time
    """

    def __init__(
        self, tracks: Sequence[Track], model: Model, camera: GroundCamera | None, criterion: Criterion
    ) -> None:
        self.tracks, self.criterion, self._camera = tracks, criterion, camera
        parts = [tracks]
        if criterion == "prediction":
            parts = [[withheld(track, fold) for track in tracks] for fold in range(FOLDS)]
        self._solvers = [Solver(part, model, camera) for part in parts]

    def __call__(self, model: Model) -> FloatArray:
        """(m,) log density of each track."""
        total = np.zeros(len(self.tracks))
        for fold, solver in enumerate(self._solvers):
            solved = solver(model)
            if self.criterion == "truth":
                values = _truth(solved, model)
            elif self.criterion == "evidence":
                values = self._evidence(solved, model)
            else:
                packed = pack(self.tracks, model, self._camera)
                frames = held_out_log_density(packed, model, solved.states, solved.covariance, fold)
                values = np.add.reduceat(frames, packed.offsets[:-1])
            total += np.where(solved.sound & np.isfinite(values), values, FAILED)
        return total

    def _evidence(self, solved: Solved, model: Model) -> FloatArray:
        volumes = np.empty(len(self.tracks))
        log_determinants(solved.problem, 0, len(volumes), solved.result.states, solved.memory, volumes)
        size = np.diff(solved.packed.offsets) * (4 + model.has_body + model.has_head)
        constants = [
            sum(term.log_normaliser(track, self._camera) for term in model.terms) for track in self.tracks
        ]
        return -solved.result.cost - np.array(constants) + 0.5 * (size * np.log(2.0 * np.pi) - volumes)


def _truth(solved: Solved, model: Model) -> FloatArray:
    packed, states, covariance = solved.packed, solved.states, solved.covariance
    total = np.zeros(len(states))
    truth = packed.channel("true_position")
    if truth is not None:
        known = np.isfinite(truth).all(axis=1)
        error, block = states[known, :2] - truth[known], covariance[known][:, :2, :2]
        squares = np.einsum("ni,nij,nj->n", error, np.linalg.inv(block), error)
        total[known] -= 0.5 * (squares + np.log(np.linalg.det(2.0 * np.pi * block)))
    for has, name, place in ((model.has_body, "body", BODY), (model.has_head, "head", HEAD)):
        angle = packed.channel(f"true_{name}")
        if has and angle is not None:
            known = np.isfinite(angle)
            kappa = 1.0 / covariance[known, place, place]
            total[known] += von_mises_log_density(angle[known], states[known, place], kappa)
    return np.add.reduceat(total, packed.offsets[:-1])


def in_blocks(values: FloatArray, blocks: int) -> FloatArray:
    """Sums (≤ blocks,) over every so many tracks: tracks are independent of each other, frames are not."""
    members: NDArray[np.int64] = np.arange(len(values)) % blocks
    return np.asarray(np.bincount(members, weights=values), float)
