"""`fit`: maximum-likelihood parameters of a model from tracks, with their uncertainty."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy import stats

from graphtrack.association.associate import tracks_of
from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray
from graphtrack.geometry.camera import GroundCamera
from graphtrack.inference.offline import engine_of
from graphtrack.learning.optimise import (
    PRIOR_STD,
    REACH,
    Criterion,
    Objective,
    curvature,
    definite,
    in_blocks,
    maximise,
    uncertainty,
)
from graphtrack.model import Model, Parameters
from graphtrack.model.parameters import range_of, scale_of
from graphtrack.model.same_time import with_merged_rows
from graphtrack.tracks.given import with_position_noise
from graphtrack.tracks.track import Track
from graphtrack.tracks.validation import check_within

if TYPE_CHECKING:
    from graphtrack.io.read_write import Given


_DECLARED = {"position_scale": "position_std", "body_scale": "body_kappa", "head_scale": "head_kappa"}
"""Multiples of the noise that tracks declare, and the channel of each."""


@dataclass(frozen=True)
class Free:
    """A parameter to be learned: its name, as ``group.key``, and its scale."""

    name: str

    @property
    def is_probability(self) -> bool:
        """Return True if it is learned by its log odds, else by its logarithm."""
        return scale_of(*self._place) == "log odds"

    def get(self, model: Model) -> float:
        """Its value in a model."""
        return model.parameters.value(self.name)

    def to_scale(self, value: float) -> float:
        """Logarithm, or log odds of a probability."""
        value = min(value, self._range[1])
        return math.log(value / (1.0 - value)) if self.is_probability else math.log(value)

    def from_scale(self, x: float) -> float:
        """The inverse of `to_scale`, within what the parameter may be."""
        value = 1.0 / (1.0 + math.exp(-x)) if self.is_probability else math.exp(x)
        low, high = self._range
        return min(max(value, low), high)

    @property
    def _place(self) -> tuple[Any, str]:
        """The group that it is in, and its key there."""
        group, key = self.name.split(".")
        return getattr(Parameters(), group), key

    @property
    def is_learned(self) -> bool:
        """Return True if the parameter may be learned."""
        return scale_of(*self._place) is not None

    @cached_property
    def _range(self) -> tuple[float, float]:
        """The least and the greatest value that is tried."""
        limits = range_of(*self._place)
        assert limits is not None  # only numbers are learned
        low, high = limits
        return low, min(high, 0.999 if high <= 1.0 else 1e3)


def free_parameters(model: Model, tracks: Sequence[Track]) -> tuple[Free, ...]:
    """Return the parameters to be learned from such tracks; those that are 0 are switched off, and stay so.

    Raise InputError for a term whose parameters cannot be learned.
    """
    for term in model.terms:
        if not term.states("reads"):
            raise InputError(
                f"the term {type(term).__name__}, whose parameters cannot be learned",
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
    for name, declared in _DECLARED.items():
        absent[f"likelihood.{name}"] = not any(getattr(track, declared) is not None for track in tracks)
    free = (Free(name) for name in names if not absent.get(name, False))
    return tuple(one for one in free if one.is_learned and one.get(model) > 0.0)


def with_values(model: Model, free: Sequence[Free], x: FloatArray) -> Model:
    """The model with the values at ``x`` (p,), on the parameters' scales."""
    values = {one.name: one.from_scale(value) for one, value in zip(free, x.tolist(), strict=True)}
    return model.with_parameters(model.parameters.with_values(values))


MAX_FRAMES = 20_000  # person-frames that are learned from; of more, tracks are chosen at random
BLOCKS, _FEWEST_BLOCKS = 40, 5
_FLAT = 0.05
"""A parameter that changes the log density by less, a factor of 1.5 either way, is not in the data."""


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
    """Learned parameters and how well they predict.

    Attributes
    ----------
    model, start : with the learned parameters, and with those before
    criterion : "truth", "evidence" or "prediction"
    learned : every parameter of the preset's terms
    covariance : (p, p) of those without a note, on the scale of their logarithms (log odds of probabilities)
    scores : "learned from" and "held out" → log density a frame before and after
    tracks : numbers of tracks learned from and held out
    evaluations : how often the tracks were solved
    """

    model: Model
    start: Model
    criterion: Criterion
    learned: tuple[Learned, ...]
    covariance: FloatArray
    scores: dict[str, tuple[float, float]]
    tracks: tuple[int, int]
    evaluations: int

    def to_dict(self) -> dict[str, Any]:
        """Everything in plain types, ready for JSON."""
        return {
            "criterion": self.criterion,
            "model": self.model.to_dict(),
            "start": self.start.to_dict(),
            "learned": [asdict(one) for one in self.learned],
            "scores": {name: list(pair) for name, pair in self.scores.items()},
            "tracks": list(self.tracks),
            "evaluations": self.evaluations,
        }


def fit(
    tracks: Given,
    model: Model | str | Path = "separate",
    *,
    criterion: Criterion | None = None,
    hold_out: float = 0.25,
    seed: int = 0,
    max_frames: int = MAX_FRAMES,
    progress: Callable[[int], None] | None = None,
) -> Fit:
    """Learn the parameters of a model.

    With the truth, what grows is the likelihood of the true positions and angles under the smoother's
    covariances, frame by frame. Without it, the Laplace evidence: the log density at the optimum, with its
    normaliser, and ½·log of 2π over the determinant of the Hessian. Couplings have no known
    normaliser, so with them and without a truth it is the held-out predictive log-likelihood of observations,
    a part at a time. The uncertainty is that of the jackknife over tracks with Student's t, at least that of
    the curvature; with too few tracks (one, or by the evidence fewer than five) it is the curvature's. Raise
    InputError if the model is no chain, nothing can be learned from the tracks, or the evidence is asked for
    and a term of the model is not normalised.

    Parameters
    ----------
    tracks : observations, in any form that `graphtrack.solve` takes
    model : starting point; parameters that are 0 stay 0
    criterion : None: the truth, if any track has one; else the evidence, if it is known
    hold_out : share of the tracks held out for validation, in [0, 0.9]
    seed : seed of the choice of tracks
    max_frames : person-frames to learn from at most
    progress : called after each evaluation with the number so far
    """
    model = Model.named(model)
    engine_of(model, "chain")
    check_within(0.0, 0.9, hold_out=hold_out)
    tracks = tracks_of(tracks, scene=model.scene)
    tracks = tracks.map(with_position_noise)
    tracks = tracks.with_tracks(with_merged_rows(tracks, model.parameters.likelihood, tracks.camera))
    usable = [track for track in tracks if len(track) > 1 and np.isfinite(track.position).any()]
    if criterion is None:
        normalised = all(term.is_normalised for term in model.terms)
        criterion = "evidence" if normalised else "prediction"
        if any(track.has_truth for track in usable):
            criterion = "truth"
    usable = _require(usable, model, criterion)
    training, held = _split(usable, hold_out, seed, max_frames)
    free = every = free_parameters(model, training)
    search = _Evaluations(training, model, tracks.camera, criterion, progress)
    start = np.array([one.to_scale(one.get(model)) for one in free])
    shown = search.shown_by_data(free, start)
    free = tuple(one for one, good in zip(free, shown, strict=True) if good)
    absent = [one for one in every if one not in free]
    if not free:
        raise InputError("tracks that identify no parameter", "observations of several frames")
    start = np.array([one.to_scale(one.get(model)) for one in free])
    x, covariance, reach = search.run(free, start, start)
    vague = (np.sqrt(np.diag(covariance)) > 0.5 * PRIOR_STD) | (np.abs(x - start) > REACH - 1e-6)
    if vague.any() and not vague.all():
        absent += [one for one, bad in zip(free, vague, strict=True) if bad]
        free = tuple(one for one, bad in zip(free, vague, strict=True) if not bad)
        start = start[~vague]
        x, covariance, reach = search.run(free, start, x[~vague])
    best = with_values(model, free, x)
    spread = reach * np.sqrt(np.diag(covariance))
    learned = [
        Learned(one.name, one.get(model), one.get(best), one.from_scale(a), one.from_scale(b))
        for one, a, b in zip(free, x - spread, x + spread, strict=True)
    ]
    note = "not identified by these tracks: kept"
    learned += [Learned(o.name, o.get(model), o.get(model), np.nan, np.nan, note) for o in absent]
    scores = {"learned from": _score(training, model, best, tracks.camera, criterion)}
    if held:
        scores["held out"] = _score(held, model, best, tracks.camera, criterion)
    counts = (len(training), len(held))
    return Fit(best, model, criterion, tuple(learned), covariance, scores, counts, search.count)


class _Evaluations:
    """The evaluations of one run, counted."""

    def __init__(
        self,
        tracks: Sequence[Track],
        model: Model,
        camera: GroundCamera | None,
        criterion: Criterion,
        progress: Callable[[int], None] | None,
    ) -> None:
        self.tracks, self.model, self.camera, self.count = tracks, model, camera, 0
        self._criterion, self._progress = criterion, progress
        # Blocks of tracks are enough for the sandwich.
        self._blocks = min(BLOCKS, len(tracks))

    def values_about(self, centre: Model, free: Sequence[Free]) -> Callable[[FloatArray], FloatArray]:
        """Log densities of the blocks, evaluated from the optimum of ``centre``."""
        objective = Objective(self.tracks, centre, self.camera, self._criterion)

        def values(x: FloatArray) -> FloatArray:
            self.count += 1
            if self._progress is not None:
                self._progress(self.count)
            return in_blocks(objective(with_values(self.model, free, x)), self._blocks)

        return values

    def shown_by_data(self, free: Sequence[Free], start: FloatArray) -> list[bool]:
        """Return which parameters change the log density at all."""
        values, found = self.values_about(self.model, free), []
        middle = values(start).sum()
        for unit in np.log(1.5) * np.eye(len(free)):
            found.append(max(abs(values(start + side * unit).sum() - middle) for side in (-1, 1)) > _FLAT)
        return found

    def run(
        self, free: Sequence[Free], start: FloatArray, near: FloatArray
    ) -> tuple[FloatArray, FloatArray, float]:
        """Return the optimum, its covariance, and the number of 1-σ of a 95 % interval.

        Optimise from ``near``, and again from the optimum.
        """
        x = maximise(self.values_about(self.model, free), near, start)
        values = self.values_about(with_values(self.model, free, x), free)
        x = maximise(values, x, start, definite(curvature(values, x, start).total))
        bent = curvature(values, x, start)
        enough = _FEWEST_BLOCKS if self._criterion == "evidence" else 2
        if self._blocks < enough:
            return x, np.asarray(np.linalg.inv(definite(bent.total)), float), 1.96
        return x, uncertainty(bent), float(stats.t.ppf(0.975, self._blocks - 1))


def _require(tracks: Sequence[Track], model: Model, criterion: Criterion) -> list[Track]:
    if criterion == "evidence":
        for term in model.terms:
            if not term.is_normalised:
                raise InputError(
                    f"the evidence of the term {type(term).__name__}, which is no normalised density",
                    "the criterion truth or prediction, or the model position, separate or intentional",
                )
    found = [track for track in tracks if criterion != "truth" or track.has_truth]
    if not found:
        raise InputError(
            "no tracks to learn from" + (" (none has true positions)" if criterion == "truth" else ""),
            "tracks of at least two frames with positions",
        )
    return found


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
    tracks: Sequence[Track], before: Model, after: Model, camera: GroundCamera | None, criterion: Criterion
) -> tuple[float, float]:
    frames = sum(len(track) for track in tracks)
    values = [Objective(tracks, model, camera, criterion)(model).sum() / frames for model in (before, after)]
    return float(values[0]), float(values[1])
