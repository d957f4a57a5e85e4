"""Constants of each person, learned from the recording: those that predict its observations.

How unsteadily somebody walks and turns differs between people by orders of magnitude, and whether body and
head face where they go depends on what people do. The evidence of a person's motion and turning is the
likelihood of the innovations of filters, over a grid of constants; that of the couplings is how well the
smoothed estimate from all other observations predicts each single one. The prior is what the people of the
recording have in common: an empirical Bayes estimate with static multiple models. Estimates are averaged over
the couplings.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from graphtrack.errors import InputError
from graphtrack.geometry.angles import UNIFORM_STD, FloatArray, direction, unit, wrap
from graphtrack.inference.engines import Failure, PersonalConstants, Solution
from graphtrack.kernels.compilation import make_ready, processors
from graphtrack.kernels.layout import BODY, HEAD, N
from graphtrack.learning.innovations import REHEARSAL, motion_evidence, turning_evidence
from graphtrack.learning.population import (
    COUPLINGS,
    DENSITIES,
    DIFFUSIONS,
    CouplingAlternative,
    Population,
    learned,
    posterior,
)
from graphtrack.learning.prediction import leave_one_out
from graphtrack.model import Model
from graphtrack.model.terms.couplings import BodyFollowsMotion, HeadFollowsBody
from graphtrack.tracks.track import Track, TrackSet

JUDGED = 20_000
"""Person-frames on which couplings are judged, shared by the people; each has `FEWEST_JUDGED` in any case."""
FEWEST_JUDGED = 25

_NEGLIGIBLE = 0.01
"""Probability of a coupling below which it is left out of a person's estimate."""

_UNDETERMINED = 0.9 * UNIFORM_STD**2
"""Variance of an angle, rad², above which an alternative says nothing about it."""


Solve = Callable[[TrackSet, Mapping[str, FloatArray]], list[Solution | Failure]]
"""Smooth tracks, with parameters of their own by name, as ``group.key``, a value (m,) for each track."""


Constants = str | Path | Population
"""Constants: "default", the model's; "learn", each person's, with what the people of the recording
have in common as the prior; or each person's, with a known population: a `Population` or its file."""


def population_of(constants: Constants) -> Population | None:
    """Return the known population; None if it is to be learned. InputError for other words, or as `load`."""
    if isinstance(constants, Population):
        return constants
    if constants == "learn":
        return None
    if not str(constants).endswith(".toml"):
        raise InputError(
            f"constants {str(constants)!r}"[:80], "default, learn, or a file of constants (.toml)"
        )
    return Population.load(constants)


def solve_learned(
    tracks: TrackSet, model: Model, solve: Solve, population: Population | None = None
) -> tuple[list[Solution | Failure], Population]:
    """Smooth every track with constants of its own, averaged over the couplings by their probabilities.

    Parameters
    ----------
    model : its constants that are learned do not matter, but for the strengths of its couplings
    solve : the smoother
    population : the shares of a known population; None: those of the recording are learned, from the default

    Returns
    -------
    The solutions in the order of the tracks, and the population
    """
    check_learnable(model)
    if not len(tracks):
        return [], Population() if population is None else population
    make_ready("the learned constants", REHEARSAL)
    motion, shares = _motion(tracks.tracks, model, population)
    alternatives = _alternatives(model)
    if len(alternatives) == 1:
        return _with_constants(solve(tracks, motion), motion, alternatives, np.ones((len(tracks), 1))), shares
    judged = _judged(tracks)
    found: list[Sequence[Solution | Failure | None]] = [
        solve(judged, motion | _strengths(one, model, len(tracks))) for one in alternatives
    ]
    failed = np.array([any(isinstance(one[m], Failure) for one in found) for m in range(len(tracks))])
    kept = np.flatnonzero(~failed).tolist()
    prior = np.array(shares.coupling)[[COUPLINGS.index(one) for one in alternatives]]
    prior /= prior.sum()
    evidence = np.zeros((len(tracks), len(alternatives)))
    if kept:
        given = [judged.tracks[m] for m in kept]
        for k, part in enumerate(found):
            evidence[kept, k] = leave_one_out(given, [_track_of(part[m]) for m in kept], model.parameters)
    if population is None:
        prior = learned(evidence[kept], tuple(prior.tolist()), shares.people, None)
        shares = _with_couplings(shares, alternatives, prior)
    weights = posterior(evidence, prior)
    weights[weights < _NEGLIGIBLE] = 0.0
    weights /= weights.sum(axis=1, keepdims=True)
    if judged is not tracks:
        found = [
            _some(tracks, weights[:, k] > 0.0, motion | _strengths(one, model, len(tracks)), solve)
            for k, one in enumerate(alternatives)
        ]
    answers = [_of_one([part[m] for part in found], weights[m]) for m in range(len(tracks))]
    return _with_constants(answers, motion, alternatives, weights), shares


def check_learnable(model: Model) -> None:
    """Raise InputError for a model whose constants cannot be learned: only the plain chain's can."""
    if model.has_modes or model.parameters.likelihood.robust != "none":
        raise InputError(
            f"learned constants with the model {model.preset!r}",
            "joint, or another model without coupling modes and robust loss; or constants default",
        )


def _motion(
    tracks: Sequence[Track], model: Model, population: Population | None
) -> tuple[dict[str, FloatArray], Population]:
    """Return the posterior means (m,) of the constants of motion and turning, and the population's shares."""
    parameters, start = model.parameters, Population() if population is None else population
    with ThreadPoolExecutor(processors()) as pool:
        jobs = {
            "acceleration_density": pool.submit(motion_evidence, tracks, parameters, DENSITIES),
            "body_diffusion": pool.submit(turning_evidence, tracks, "body", parameters, DIFFUSIONS),
            "head_diffusion": pool.submit(turning_evidence, tracks, "head", parameters, DIFFUSIONS),
        }
    values: dict[str, FloatArray] = {}
    shares: dict[str, Any] = {}
    for name, job in jobs.items():
        own, grid = job.result(), DENSITIES if name == "acceleration_density" else DIFFUSIONS
        prior = np.array(getattr(start, name))
        if population is None:
            prior = learned(own, getattr(start, name), start.people, grid)
        group = "motion" if name == "acceleration_density" else "orientation"
        values[f"{group}.{name}"] = posterior(own, prior) @ grid
        shares[name] = tuple(prior.tolist())
    return values, replace(start, **shares)


def _strengths(coupling: CouplingAlternative, model: Model, count: int) -> dict[str, FloatArray]:
    own = model.parameters.coupling
    return {
        "coupling.motion_body_kappa": np.full(count, coupling.motion_body * own.motion_body_kappa),
        "coupling.head_body_kappa": np.full(count, coupling.head_body * own.head_body_kappa),
    }


def _alternatives(model: Model) -> tuple[CouplingAlternative, ...]:
    """Return the couplings that differ for a model, the last of those that are alike."""
    has_path, has_neck = model.has_term(BodyFollowsMotion), model.has_term(HeadFollowsBody)
    kept = {(one.motion_body * has_path, one.head_body * has_neck): one for one in COUPLINGS}
    return tuple(kept.values())


def _with_couplings(
    shares: Population, alternatives: Sequence[CouplingAlternative], learned: FloatArray
) -> Population:
    """Return the population with the learned shares of some couplings; the others keep theirs."""
    found = np.array(shares.coupling)
    places = [COUPLINGS.index(one) for one in alternatives]
    found[places] = learned * found[places].sum()
    return replace(shares, coupling=tuple((found / found.sum()).tolist()))


def _judged(tracks: TrackSet) -> TrackSet:
    """Return the tracks, each cut to its share of `JUDGED` in the middle; as they are if all fit."""
    most = max(FEWEST_JUDGED, JUDGED // len(tracks))
    if all(len(track) <= most for track in tracks):
        return tracks

    def middle(track: Track) -> Track:
        begin = max(0, (len(track) - most) // 2)
        # The part has to have a position.
        placed = np.flatnonzero(np.isfinite(track.position).all(axis=1))
        if len(placed) and not ((placed >= begin) & (placed < begin + most)).any():
            begin = max(0, int(placed[np.argmin(np.abs(placed - begin))]) - most // 2)
        return track[begin : begin + most]

    return tracks.map(middle)


def _some(
    tracks: TrackSet, chosen: NDArray[np.bool_], own: Mapping[str, FloatArray], solve: Solve
) -> list[Solution | Failure | None]:
    """Smooth the chosen tracks; None for the others."""
    found: list[Solution | Failure | None] = [None] * len(tracks)
    places = np.flatnonzero(chosen).tolist()
    some = tracks.with_tracks(tracks.tracks[m] for m in places)
    solved = solve(some, {name: values[places] for name, values in own.items()})
    for m, one in zip(places, solved, strict=True):
        found[m] = one
    return found


def _track_of(found: Solution | Failure | None) -> Track:
    assert isinstance(found, Solution)
    return found.track


def _of_one(found: Sequence[Solution | Failure | None], weights: FloatArray) -> Solution | Failure:
    """Return the average of one track's solutions, or the failure of one of them."""
    for one in found:
        if isinstance(one, Failure):
            return one
    used = [
        (one, w) for one, w in zip(found, weights.tolist(), strict=True) if isinstance(one, Solution) and w
    ]
    return averaged([one for one, _ in used], np.array([w for _, w in used]))


def _with_constants(
    found: Sequence[Solution | Failure],
    motion: Mapping[str, FloatArray],
    alternatives: Sequence[CouplingAlternative],
    weights: FloatArray,
) -> list[Solution | Failure]:
    names = [one.name for one in alternatives]
    answers: list[Solution | Failure] = []
    for m, one in enumerate(found):
        if isinstance(one, Solution):
            values = {name.partition(".")[2]: float(values[m]) for name, values in motion.items()}
            coupling = dict(zip(names, weights[m].tolist(), strict=True))
            one = replace(one, constants=PersonalConstants(**values, coupling=coupling))
        answers.append(one)
    return answers


def averaged(solutions: Sequence[Solution], weights: FloatArray) -> Solution:
    """Return the mean of the solutions of one track by their weights, with the covariance of the mixture.

    The mean of angles is circular, over the alternatives that determine an angle.
    """
    best = solutions[int(np.argmax(weights))]
    if len(solutions) == 1:
        return best
    states = np.stack([_states(one.track) for one in solutions])
    covariance = np.stack([one.track.covariance for one in solutions if one.track.covariance is not None])
    mean = np.einsum("k,kni->ni", weights, states)
    for place in (BODY, HEAD):
        votes = weights[:, None] * np.maximum(1.0 - covariance[:, :, place, place] / _UNDETERMINED, 1e-6)
        mean[:, place] = direction(np.einsum("kn,knj->nj", votes, unit(states[:, :, place])))
    away = states - mean
    away[:, :, BODY:] = wrap(away[:, :, BODY:])
    total = np.einsum("k,knij->nij", weights, covariance) + np.einsum("k,kni,knj->nij", weights, away, away)
    channels = {
        name: mean[:, place]
        for name, place in (("body", BODY), ("head", HEAD))
        if getattr(best.track, name) is not None
    }
    track = best.track.with_estimates(
        position=mean[:, :2], velocity=mean[:, 2:4], covariance=total, **channels
    )
    return replace(best, track=track, converged=all(one.converged for one in solutions))


def _states(track: Track) -> FloatArray:
    """Return the estimates (n, 6), NaN for variables outside the model."""
    found = np.full((len(track), N), np.nan)
    found[:, :2] = track.position
    if track.velocity is not None:
        found[:, 2:4] = track.velocity
    for name, place in (("body", BODY), ("head", HEAD)):
        angle = getattr(track, name)
        if angle is not None:
            found[:, place] = angle
    return found
