"""`fit`: maximum-likelihood parameters of a model from tracks with their truth, with their uncertainty."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import optimize, stats

from graphtrack.association.associate import tracks_of
from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray, von_mises_log_density
from graphtrack.geometry.camera import GroundCamera
from graphtrack.inference.chain.batch import Options, solve_packed, solve_tracks
from graphtrack.inference.chain.initialisation import empty_result, pack, problem_of
from graphtrack.inference.chain.newton import NOT_FINITE
from graphtrack.inference.engines import make_solver_ready
from graphtrack.inference.offline import engine_of
from graphtrack.kernels.layout import BODY, HEAD
from graphtrack.model import Model
from graphtrack.model.packing import PackedTracks
from graphtrack.model.parameters import range_of, scale_of
from graphtrack.model.same_time import with_merged_rows
from graphtrack.model.terms.classes import HIDDEN
from graphtrack.tracks.given import with_position_noise
from graphtrack.tracks.track import Track
from graphtrack.tracks.validation import check_within

if TYPE_CHECKING:
    from graphtrack.io.read_write import Given

MAX_FRAMES = 20_000
"""Person-frames that are learned from; of more, tracks are chosen at random."""

_DECLARED = {"position_scale": "position_std", "body_scale": "body_kappa", "head_scale": "head_kappa"}
"""Multiples of the noise that tracks declare, and the channel of each."""
_REACH = math.log(100.0)  # largest distance of a parameter from its start, on its scale
_PRIOR_STD = 3.0  # of a parameter about its start, on its scale: a factor of 20 is not held against it
_FLAT = 0.05
"""A parameter that changes the log density by less, a factor of 1.5 either way, is not in the data."""
_ROUGH, _FINE = 0.02, 1e-4  # least gain of an iteration, in the logarithm of the density
_DIFFERENCE = 1e-3
_BLOCKS = 40  # of tracks: enough for the jackknife
_FAILED = -1e9  # stands for the logarithm of a density where a track could not be solved
_SOLVING = Options(max_iterations=100, tolerance=1e-13, search=False)

Blocks = Callable[[FloatArray], FloatArray]
"""x (p,) → a log density for each block of independent data; their sum is climbed."""


@dataclass(frozen=True)
class Learned:
    """One parameter: where it started, its value, and the 95 % interval.

    ``note`` has the reason if it was not learned; the value is then the initial value.
    """

    name: str
    start: float
    value: float
    low: float
    high: float
    note: str = ""


@dataclass(frozen=True, eq=False)
class Fit:
    """Learned parameters and how probable they make the truth.

    Attributes
    ----------
    model, start : with the learned parameters, and with those before
    learned : every parameter of the preset's terms
    covariance : (p, p) of those without a note, on the scale of their logarithms (log odds of probabilities)
    scores : "learned from" and "held out" → log density a frame before and after
    tracks : numbers of tracks learned from and held out
    evaluations : how often the tracks were solved
    """

    model: Model
    start: Model
    learned: tuple[Learned, ...]
    covariance: FloatArray
    scores: dict[str, tuple[float, float]]
    tracks: tuple[int, int]
    evaluations: int

    def to_dict(self) -> dict[str, Any]:
        """Everything in plain types, ready for JSON."""
        return {
            "model": self.model.to_dict(),
            "start": self.start.to_dict(),
            "learned": [asdict(one) for one in self.learned],
            "scores": {name: list(pair) for name, pair in self.scores.items()},
            "tracks": list(self.tracks),
            "evaluations": self.evaluations,
        }


def fit(
    tracks: Given,
    model: Model | str | Path | None = None,
    *,
    hold_out: float = 0.25,
    seed: int = 0,
    max_frames: int = MAX_FRAMES,
    progress: Callable[[int], None] | None = None,
) -> Fit:
    """Fit the parameters of a model to the truth of tracks.

    The likelihood of the true positions and angles under the smoother's covariances is maximised, frame by
    frame. The uncertainty is that of the jackknife over tracks with Student's t, at least that of the
    curvature; with one track it is the curvature's.

    Parameters
    ----------
    tracks : observations with their truth, in any form that `graphtrack.solve` takes; tracks without a truth
        are left out
    model : starting point; parameters that are 0 stay 0. By default "joint"
    hold_out : share of the tracks held out for validation, in [0, 0.9]
    seed : seed of the choice of tracks
    max_frames : person-frames to learn from at most
    progress : called after each evaluation with the number so far

    Raises
    ------
    InputError
        If no track has a truth (`graphtrack.smoothing.learn_constants` learns from observations alone), the
        model has no chain engine, or the tracks determine no parameter.
    """
    model = Model.named(model)
    engine_of(model, "chain")
    check_within(0.0, 0.9, hold_out=hold_out)
    tracks = tracks_of(tracks, scene=model.scene)
    tracks = tracks.map(with_position_noise)
    tracks, _ = with_merged_rows(tracks, model.parameters.likelihood)
    usable = [one for one in tracks if len(one) > 1 and np.isfinite(one.position).any() and one.has_truth]
    if not usable:
        raise InputError(
            "no tracks with a truth to learn from",
            "columns true_x, true_y and tracks of at least two frames; learn_constants (graphtrack fit "
            "--constants) learns from observations alone",
        )
    training, held = _split(usable, hold_out, seed, max_frames)
    every = free_parameters(model, training)
    search = _Search(training, model, tracks.camera, progress)
    shown = search.shown_by_data(every)
    free = [one for one, good in zip(every, shown, strict=True) if good]
    if not free:
        raise InputError("tracks that identify no parameter", "observations of several frames")
    start = np.array([one.start(model) for one in free])
    x, covariance, reach = search.run(free, start, start)
    vague = (np.sqrt(np.diag(covariance)) > 0.5 * _PRIOR_STD) | (np.abs(x - start) > _REACH - 1e-6)
    if vague.any() and not vague.all():
        free = [one for one, bad in zip(free, vague, strict=True) if not bad]
        x, covariance, reach = search.run(free, start[~vague], x[~vague])
    best = with_values(model, free, x)
    spread = reach * np.sqrt(np.diag(covariance))
    learned = [
        Learned(one.name, one.get(model), one.get(best), one.from_scale(a), one.from_scale(b))
        for one, a, b in zip(free, x - spread, x + spread, strict=True)
    ]
    note = "not identified by these tracks: kept"
    absent = (one for one in every if one not in free)
    learned += [Learned(o.name, o.get(model), o.get(model), np.nan, np.nan, note) for o in absent]
    parts = {"learned from": training, "held out": held}
    scores = {name: _score(part, model, best, tracks.camera) for name, part in parts.items() if part}
    counts = (len(training), len(held))
    return Fit(best, model, tuple(learned), covariance, scores, counts, search.count)


def _split(
    tracks: Sequence[Track], hold_out: float, seed: int, max_frames: int
) -> tuple[list[Track], list[Track]]:
    order = np.random.default_rng(seed).permutation(len(tracks)).tolist()
    held = min(round(hold_out * len(tracks)), len(tracks) - 1)
    parts = []
    for chosen in (order[held:], order[:held]):
        sizes = np.cumsum([len(tracks[i]) for i in chosen])
        count = max(1, int(np.searchsorted(sizes, max_frames, side="right"))) if chosen else 0
        parts.append([tracks[i] for i in sorted(chosen[:count])])
    return parts[0], parts[1]


def _score(
    tracks: Sequence[Track], before: Model, after: Model, camera: GroundCamera | None
) -> tuple[float, float]:
    frames = sum(len(track) for track in tracks)
    values = [TruthLikelihood(tracks, one, camera)(one).sum() / frames for one in (before, after)]
    return float(values[0]), float(values[1])


# Parameters on the scales on which they are learned


class Free(NamedTuple):
    """A parameter to be learned, on its scale: its logarithm, or the log odds of a probability.

    Attributes
    ----------
    name : as ``group.key``
    is_probability : True if it is learned by its log odds
    low, high : the least and the greatest value that is tried
    """

    name: str
    is_probability: bool
    low: float
    high: float

    def get(self, model: Model) -> float:
        """Its value in a model."""
        return model.parameters.value(self.name)

    def start(self, model: Model) -> float:
        """Its value in a model, on its scale."""
        value = min(self.get(model), self.high)
        return math.log(value / (1.0 - value)) if self.is_probability else math.log(value)

    def from_scale(self, x: float) -> float:
        """The inverse of `start`, within the limits."""
        value = 1.0 / (1.0 + math.exp(-x)) if self.is_probability else math.exp(x)
        return min(max(value, self.low), self.high)


def free_parameters(model: Model, tracks: Sequence[Track]) -> tuple[Free, ...]:
    """Return the parameters to be learned from such tracks; those that are 0 are switched off, and stay so.

    Raise InputError for a term whose parameters cannot be learned.
    """
    for term in model.terms:
        if not term.states("reads"):
            raise InputError(
                f"the term {term.label}, whose parameters cannot be learned",
                "a preset's terms alone",
            )
    names = dict.fromkeys(name for term in model.terms for name in term.reads or ())
    absent = {
        "likelihood.robust_threshold": model.parameters.likelihood.robust == "none",
        "likelihood.pixel_std": all(track.pixel is None for track in tracks),
        "likelihood.class_outlier_probability": all(
            track.body_likelihood is None and track.head_likelihood is None for track in tracks
        ),
    }
    absent["likelihood.hidden_outliers"] = not any(
        name in track.inputs for track in tracks for name in HIDDEN.values()
    )
    for name, declared in _DECLARED.items():
        absent[f"likelihood.{name}"] = not any(getattr(track, declared) is not None for track in tracks)
    found = []
    for name in names:
        group, key = name.split(".")
        values = getattr(model.parameters, group)
        scale, limits = scale_of(values, key), range_of(values, key)
        if scale is None or limits is None or absent.get(name, False) or getattr(values, key) == 0.0:
            continue
        low, high = limits
        found.append(Free(name, scale == "log odds", low, min(high, 0.999 if high <= 1.0 else 1e3)))
    return tuple(found)


def with_values(model: Model, free: Sequence[Free], x: FloatArray) -> Model:
    """The model with the values at ``x`` (p,), on the parameters' scales."""
    values = {one.name: one.from_scale(value) for one, value in zip(free, x.tolist(), strict=True)}
    return model.with_parameters(model.parameters.with_values(values))


# The likelihood of the truth


class TruthLikelihood:
    """Log density of the truth of each track under the smoother's covariances, as a function of the model.

    Every evaluation starts from the same states, those of ``model`` after a search for the best basin. So
    its value does not depend on what was evaluated before, and is smooth.
    """

    def __init__(self, tracks: Sequence[Track], model: Model, camera: GroundCamera | None) -> None:
        self._tracks, self._camera = tracks, camera
        make_solver_ready(model, "chain", complete=True)
        packed = pack(tracks, model, camera)
        found = solve_packed(packed, model)
        self._origin = np.repeat(packed.origin, np.diff(packed.offsets), axis=0)
        found.states[:, :2] -= self._origin
        self._start = np.nan_to_num(found.states)

    def __call__(self, model: Model) -> FloatArray:
        """(m,) log density of each track, by a model with the same terms."""
        packed = pack(self._tracks, model, self._camera)
        problem, result = problem_of(packed), empty_result(packed)
        result.states[:] = self._start
        solve_tracks(problem, int(np.diff(problem.offsets).max()), _SOLVING, result)
        states = result.states.copy()
        states[:, :2] += self._origin
        frames = _log_density_of_truth(packed, model, states, result.covariance)
        values = np.add.reduceat(frames, packed.offsets[:-1])
        return np.where((result.status != NOT_FINITE) & np.isfinite(values), values, _FAILED)


def _log_density_of_truth(
    packed: PackedTracks, model: Model, states: FloatArray, covariance: FloatArray
) -> FloatArray:
    """Log density (N,) of the true positions and angles, by states (N, 6) and covariances (N, 6, 6)."""
    total, truth = np.zeros(len(states)), packed.channel("true_position")
    assert truth is not None  # of tracks with a truth
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
    return total


class _Search:
    """The search for a maximum, with a count of its evaluations."""

    def __init__(
        self,
        tracks: Sequence[Track],
        model: Model,
        camera: GroundCamera | None,
        progress: Callable[[int], None] | None,
    ) -> None:
        self._tracks, self._model, self._camera, self._progress = tracks, model, camera, progress
        self.count, self._n_blocks = 0, min(_BLOCKS, len(tracks))
        # Tracks are independent of each other, frames are not.
        self._block: NDArray[np.int64] = np.arange(len(tracks)) % self._n_blocks

    def values_about(self, centre: Model, free: Sequence[Free]) -> Blocks:
        """Log densities of the blocks, evaluated from the optimum of ``centre``."""
        likelihood = TruthLikelihood(self._tracks, centre, self._camera)

        def values(x: FloatArray) -> FloatArray:
            self.count += 1
            if self._progress is not None:
                self._progress(self.count)
            found = likelihood(with_values(self._model, free, x))
            return np.asarray(np.bincount(self._block, weights=found), float)

        return values

    def shown_by_data(self, free: Sequence[Free]) -> list[bool]:
        """Return which parameters change the log density at all."""
        values, start = self.values_about(self._model, free), np.array([o.start(self._model) for o in free])
        middle, found = values(start).sum(), []
        for unit in np.log(1.5) * np.eye(len(free)):
            found.append(max(abs(values(start + side * unit).sum() - middle) for side in (-1, 1)) > _FLAT)
        return found

    def run(
        self, free: Sequence[Free], start: FloatArray, near: FloatArray
    ) -> tuple[FloatArray, FloatArray, float]:
        """Return the optimum, its covariance, and the number of 1-σ of a 95 % interval.

        Optimise from ``near``, and again from the optimum.
        """
        x = maximise(self.values_about(self._model, free), near, start)
        values = self.values_about(with_values(self._model, free, x), free)
        x = maximise(values, x, start, definite(curvature(values, x, start).total))
        bent = curvature(values, x, start)
        if self._n_blocks < 2:
            return x, np.asarray(np.linalg.inv(definite(bent.total)), float), 1.96
        return x, uncertainty(bent), float(stats.t.ppf(0.975, self._n_blocks - 1))


# The maximum of a log density, and its curvature


def maximise(
    values: Blocks, start: FloatArray, prior: FloatArray, hessian: FloatArray | None = None
) -> FloatArray:
    """Return the maximum (p,), from ``start``; the prior's mean is ``prior``.

    Without the ``hessian`` (p, p) of the costs near the start it is a rough one: it ends where an iteration
    gains less than `_ROUGH`, and takes one-sided slopes, which move the maximum by half a step. With it the
    climb is in directions in which the costs are about as curved, and ends where it gains less than `_FINE`.
    """
    rough = hessian is None
    axes = np.eye(len(start)) if hessian is None else np.linalg.inv(np.linalg.cholesky(hessian)).T

    def cost(x: FloatArray) -> float:
        # A broad prior keeps what the data do not determine where it starts.
        return 0.5 * float(np.sum((x - prior) ** 2)) / _PRIOR_STD**2 - float(values(x).sum())

    def cost_and_slope(y: FloatArray) -> tuple[float, FloatArray]:
        x, steps = start + axes @ y, _DIFFERENCE * np.eye(len(y))
        x = np.clip(x, prior - _REACH, prior + _REACH)
        here = cost(x)
        if rough:
            slope = np.array([cost(x + d) - here for d in steps]) / _DIFFERENCE
        else:
            slope = np.array([cost(x + d) - cost(x - d) for d in steps]) / (2.0 * _DIFFERENCE)
        return here, axes.T @ slope

    limits = zip(prior - _REACH - start, prior + _REACH - start, strict=True)
    found = optimize.minimize(
        cost_and_slope,
        np.zeros(len(start)),
        jac=True,
        method="L-BFGS-B",
        bounds=list(limits) if rough else None,
        options={"ftol": (_ROUGH if rough else _FINE) / max(1.0, abs(cost(start))), "maxiter": 50},
    )
    return np.clip(start + axes @ found.x, prior - _REACH, prior + _REACH)


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
        diagonal = bends.sum(axis=1) + _PRIOR_STD**-2
        steps = np.clip(0.5 / np.sqrt(np.maximum(diagonal, _PRIOR_STD**-2)), 2e-3, 0.3)
    blocks = np.zeros((len(here), p, p))
    blocks[:, range(p), range(p)] = bends.T
    units = np.diag(used)
    for i in range(p):
        for j in range(i):
            corner = values(x + units[i] + units[j])
            mixed = (ahead[i] + ahead[j] - here - corner) / (used[i] * used[j])
            blocks[:, i, j] = blocks[:, j, i] = mixed
    slopes = ((ahead - behind) / (2.0 * used[:, None])).T
    return Curvature(blocks.sum(axis=0) + _PRIOR_STD**-2 * np.eye(p), slopes, blocks)


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
    return np.asarray((axes * np.maximum(sizes, _PRIOR_STD**-2)) @ axes.T)
