"""Constants of each person, learned from the recording: those that predict its observations.

How unsteadily somebody walks and turns differs between people by orders of magnitude, and whether body and
head face where they go depends on what people do. The evidence of a person's motion and turning is the
likelihood of the innovations of filters, over a grid of constants; that of the couplings is how well
smoothed estimates without half of the angles predict that half. The prior is what the people of the
recording have in common: an empirical Bayes estimate with static multiple models. Estimates are averaged over
the couplings.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from graphtrack.constants.filters import Persistent, motion_evidence, turning_evidence
from graphtrack.constants.noise import (
    is_assumed,
    learned_stds,
    offset_of,
    persistent_of,
    undeclared,
    with_learned_noise,
    with_noise,
    with_offset,
)
from graphtrack.constants.population import (
    COUPLINGS,
    DENSITIES,
    DIFFUSIONS,
    CouplingAlternative,
    Population,
    learned,
    posterior,
)
from graphtrack.constants.prediction import HALVES, HeldOut
from graphtrack.errors import InputError
from graphtrack.geometry.angles import UNIFORM_STD, FloatArray, direction, unit, wrap
from graphtrack.inference.chain.covariance import limit_angles
from graphtrack.inference.engines import Failure, PersonalConstants, Solution, with_every_row
from graphtrack.kernels.compilation import processors
from graphtrack.kernels.layout import BODY, HEAD, N
from graphtrack.model import Model
from graphtrack.model.model import BEST_PRESET, default_parameters
from graphtrack.model.same_time import with_merged_rows
from graphtrack.model.terms.couplings import BodyFollowsMotion, HeadFollowsBody
from graphtrack.model.terms.motion import IntentionalMotion
from graphtrack.tracks.track import Track, TrackSet

LEARNED, FEWEST_LEARNED = 50_000, 50
"""Person-frames from which motion and turning are learned, shared by the people, and those of each in any
case: they bound the time."""
JUDGED, FEWEST_JUDGED = 10_000, 12
"""The same of couplings, which need a solution each."""

SHOWN, _THRESHOLD = 0.002, 5.0
"""Share of gross errors among the positions from which their loss is robust, and its threshold in standard
deviations."""

_NEGLIGIBLE = 0.02
"""Probability of a coupling below which it is left out of a person's estimate."""

_UNDETERMINED = 0.9 * UNIFORM_STD**2
"""Variance of an angle, rad², above which an alternative says nothing about it."""


Progress = Callable[[int], None]

Solve = Callable[[TrackSet, Model, Mapping[str, FloatArray], Progress | None], list[Solution | Failure]]
"""Smooth tracks by a model, with parameters of their own by name, as ``group.key``, a value (m,) for each
track; the progress is called with the numbers of person-frames that are done."""


Constants = str | Path | Population
"""Constants: "default", the model's; "learn", each person's, with what the people of the recording
have in common as the prior; or each person's, with a known population: a `Population` or its file."""


Known = Population | Literal["learn", "default"] | None
"""The same, once a file is read; None: by default."""


def known_constants(constants: Constants | None) -> Known:
    """Return constants with the population of a file read; errors as `population_of`."""
    if constants is None:
        return None
    return "default" if constants == "default" else population_of(constants) or "learn"


def population_of(constants: Constants | None) -> Population | None:
    """Return the known population; None if it is to be learned. InputError for other words, or as `load`."""
    if isinstance(constants, Population):
        return constants
    if constants is None or constants == "learn":
        return None
    if not str(constants).endswith(".toml"):
        raise InputError(
            f"constants {str(constants)!r}"[:80], "default, learn, or a file of constants (.toml)"
        )
    return Population.load(constants)


_LEARNED = ("motion", "orientation", "coupling")
"""Groups of parameters, some of which are learned."""


def is_learned(constants: Constants | None, model: Model) -> bool:
    """Return whether constants are learned; by default for `BEST_PRESET`, where they are the preset's.

    Raises
    ------
    InputError
        If they are to be learned for a model where they cannot be.
    """
    if constants == "default":
        return False
    if constants is not None:
        check_learnable(model)
        return True
    own, usual = model.parameters, default_parameters(BEST_PRESET)
    is_usual = all(getattr(own, group) == getattr(usual, group) for group in _LEARNED)
    return model.preset == BEST_PRESET and is_usual and is_learnable(model)


def solve_learned(
    tracks: TrackSet,
    model: Model,
    solve: Solve,
    population: Population | None = None,
    progress: Progress | None = None,
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
    learned_from = _middles(tracks, LEARNED, FEWEST_LEARNED)
    start = with_learned_noise(Population(), learned_from, model) if population is None else population
    given = tracks
    names = undeclared(tracks, model)
    model = model.with_parameters(with_noise(model.parameters, names, start))
    persistent = persistent_of(start, names)
    # Whether the loss will be robust is not known yet: contradictions are kept apart.
    tracks, frames = with_merged_rows(given, with_robust_loss(model).parameters.likelihood)
    learned_from = _middles(tracks, LEARNED, FEWEST_LEARNED)
    motion, shares = _motion(learned_from, model, start, persistent, population is not None)
    offset = offset_of(learned_from, model, persistent)
    noise = learned_stds(learned_from, model, names, offset)
    assumed = tuple(name for name in noise if is_assumed(name, start))
    if shares.gross_errors > SHOWN:
        model = with_robust_loss(model)
    alternatives = alternatives_of(model)
    if len(alternatives) > 1:
        found, weights, shares = _over_couplings(
            tracks, model, solve, motion, shares, population is not None, progress
        )
    else:
        found, weights = solve(tracks, model, motion, progress), np.ones((len(tracks), 1))
    answers: list[Solution | Failure] = []
    learned_by = [
        replace(one, noise=noise, assumed=assumed) for one in _constants(motion, alternatives, weights)
    ]
    for one, constants in zip(found, learned_by, strict=True):
        if isinstance(one, Solution):
            estimates = with_offset(one.track, offset, tracks.camera)
            one = replace(one, track=estimates, constants=constants)
        answers.append(one)
    return with_every_row(answers, given, frames), shares


def _over_couplings(
    tracks: TrackSet,
    model: Model,
    solve: Solve,
    motion: dict[str, FloatArray],
    shares: Population,
    known: bool,
    progress: Progress | None,
) -> tuple[list[Solution | Failure], FloatArray, Population]:
    """Return the averages over the couplings, the couplings' probabilities (m, k), and the population.

    Its shares of couplings are learned unless they are ``known``.
    """
    alternatives = alternatives_of(model)
    couplings = [_strengths(one, model, len(tracks)) for one in alternatives]
    evidence, judged = _coupling_evidence(tracks, model, solve, [motion | one for one in couplings])
    prior = shares.coupling_of(alternatives)
    if not known:
        prior = learned(evidence[judged], tuple(prior.tolist()), shares.people, None)
        shares = shares.with_coupling(alternatives, prior)
    weights = posterior(evidence, prior)
    weights[weights < _NEGLIGIBLE] = 0.0
    weights /= weights.sum(axis=1, keepdims=True)
    lengths = np.array([len(track) for track in tracks])
    shared = _Shared(progress, tracks.n_frames, int((weights > 0.0).sum(axis=1) @ lengths))
    found = [
        _some(tracks, own > 0.0, motion | one, lambda some, own: solve(some, model, own, shared))
        for one, own in zip(couplings, weights.T, strict=True)
    ]
    answers = [_of_one([part[m] for part in found], weights[m]) for m in range(len(tracks))]
    return answers, weights, shares


def _coupling_evidence(
    tracks: TrackSet, model: Model, solve: Solve, alternatives: Sequence[Mapping[str, FloatArray]]
) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Return the log evidence (m, k) of alternatives' parameters, and the tracks (m,) that were solved.

    Without any angle nothing is solved: the alternatives are equally probable.
    """
    evidence, judged = np.zeros((len(tracks), len(alternatives))), np.ones(len(tracks), dtype=bool)
    parts = _middles(tracks, JUDGED, FEWEST_JUDGED)
    held_out = HeldOut(parts.tracks, model.parameters)
    for half in HALVES if held_out.has_angles else ():
        given = parts.with_tracks(held_out.without(half))
        for k, own in enumerate(alternatives):
            found = [
                one.track if isinstance(one, Solution) else None for one in solve(given, model, own, None)
            ]
            judged &= [one is not None for one in found]
            evidence[:, k] += held_out.density(found, half)
    evidence[~judged] = 0.0
    return evidence, judged


def with_robust_loss(model: Model) -> Model:
    """Return the model with a Cauchy loss of positions, unless it has a robust loss."""
    if model.parameters.likelihood.robust != "none":
        return model
    likelihood = replace(model.parameters.likelihood, robust="cauchy", robust_threshold=_THRESHOLD)
    return model.with_parameters(replace(model.parameters, likelihood=likelihood))


def is_learnable(model: Model) -> bool:
    """Return whether constants can be learned: not with intentional motion."""
    return not model.has_term(IntentionalMotion)


def check_learnable(model: Model) -> None:
    """Raise InputError for a model whose constants cannot be learned."""
    if not is_learnable(model):
        raise InputError(
            f"learned constants with the model {model.preset!r}",
            "joint, or another model without intentional motion; or constants default",
        )


def _motion(
    people: TrackSet, model: Model, start: Population, persistent: Persistent, known: bool
) -> tuple[dict[str, FloatArray], Population]:
    """Return the posterior means (m,) of the constants of motion and turning, and the population's shares.

    Parameters
    ----------
    start : the population, or the prior of one that is not ``known``
    """
    tracks, camera, parameters = people.tracks, people.camera, model.parameters
    # Parts of about equal work; each person's evidence does not depend on them.
    parts = [tracks[k :: processors()] for k in range(min(processors(), len(tracks)))]
    evidence = {
        "acceleration_density": lambda some: np.stack(
            motion_evidence(some, parameters, DENSITIES, camera, persistent)
        ),
        "body_diffusion": lambda some: turning_evidence(some, "body", parameters, DIFFUSIONS),
        "head_diffusion": lambda some: turning_evidence(some, "head", parameters, DIFFUSIONS),
    }
    with ThreadPoolExecutor(processors()) as pool:
        jobs = {name: [pool.submit(of, part) for part in parts] for name, of in evidence.items()}
    values: dict[str, FloatArray] = {}
    shares: dict[str, Any] = {}
    # Tracks without a position cannot be smoothed, and say nothing of the others.
    placed = [bool(np.isfinite(track.position).any()) for track in tracks]
    for name, some in jobs.items():
        results = [job.result() for job in some]
        own = np.zeros((*results[0].shape[:-2], len(tracks), len(DENSITIES)))
        for k, result in enumerate(results):
            own[..., k :: len(parts), :] = result
        grid = DIFFUSIONS
        if name == "acceleration_density":
            (own, errors), grid = own, DENSITIES
            if not known:
                positions = sum(int(np.isfinite(track.position[:, 0]).sum()) for track in tracks)
                expected = errors[np.arange(len(own)), own.argmax(axis=1)].sum()
                shares["gross_errors"] = float(expected) / max(positions, 1)
        prior = np.array(getattr(start, name))
        if not known:
            prior = learned(own[placed], getattr(start, name), start.people, grid)
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


def alternatives_of(model: Model) -> tuple[CouplingAlternative, ...]:
    """Return the couplings that differ for a model, the last of those that are alike."""
    return tuple(dict(zip(_effects(model), COUPLINGS, strict=True)).values())


def places_of(model: Model) -> tuple[int, ...]:
    """Return the place of each of `COUPLINGS` among `alternatives_of` the model."""
    effects = _effects(model)
    different = list(dict.fromkeys(effects))
    return tuple(map(different.index, effects))


def _effects(model: Model) -> list[tuple[float, float]]:
    has_path, has_neck = model.has_term(BodyFollowsMotion), model.has_term(HeadFollowsBody)
    return [(one.motion_body * has_path, one.head_body * has_neck) for one in COUPLINGS]


def _middles(tracks: TrackSet, all_frames: int, fewest: int) -> TrackSet:
    """Return the tracks, each cut to its share of all frames in the middle; as they are if all fit."""
    most = max(fewest, all_frames // len(tracks))
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


class _Shared:
    """The progress of several solutions of the same tracks."""

    def __init__(self, progress: Progress | None, frames: int, work: int) -> None:
        self._progress, self._frames, self._work = progress, frames, max(work, 1)
        self._done = 0

    def __call__(self, frames: int) -> None:
        before = self._frames * self._done // self._work
        self._done += frames
        if self._progress is not None:
            self._progress(self._frames * self._done // self._work - before)


def _some(
    tracks: TrackSet,
    chosen: NDArray[np.bool_],
    own: Mapping[str, FloatArray],
    solve: Callable[[TrackSet, Mapping[str, FloatArray]], list[Solution | Failure]],
) -> list[Solution | Failure | None]:
    """Smooth the chosen tracks; None for the others."""
    found: list[Solution | Failure | None] = [None] * len(tracks)
    places = np.flatnonzero(chosen).tolist()
    some = tracks.with_tracks(tracks.tracks[m] for m in places)
    solved = solve(some, {name: values[places] for name, values in own.items()})
    for m, one in zip(places, solved, strict=True):
        found[m] = one
    return found


def _of_one(found: Sequence[Solution | Failure | None], weights: FloatArray) -> Solution | Failure:
    """Return the average of one track's solutions, or the failure of one of them."""
    for one in found:
        if isinstance(one, Failure):
            return one
    used = [
        (one, w) for one, w in zip(found, weights.tolist(), strict=True) if isinstance(one, Solution) and w
    ]
    return averaged([one for one, _ in used], np.array([w for _, w in used]))


def _constants(
    motion: Mapping[str, FloatArray],
    alternatives: Sequence[CouplingAlternative],
    weights: FloatArray,
) -> list[PersonalConstants]:
    """Return the constants of each person, without noise."""
    names = [one.name for one in alternatives]
    values = {name.partition(".")[2]: values for name, values in motion.items()}
    diffusions = (values[f"{name}_diffusion"] for name in ("body", "head"))
    own = zip(values["acceleration_density"], *diffusions, weights.tolist(), strict=True)
    return [
        PersonalConstants(float(q), float(body), float(head), dict(zip(names, shares, strict=True)))
        for q, body, head, shares in own
    ]


def parameters_of(constants: PersonalConstants, model: Model) -> dict[str, float]:
    """Return a person's parameters by name, as ``group.key``, with the most probable coupling."""
    best = max(constants.coupling, key=lambda name: constants.coupling[name], default=COUPLINGS[-1].name)
    (coupling,) = (one for one in COUPLINGS if one.name == best)
    found = {
        "motion.acceleration_density": constants.acceleration_density,
        "orientation.body_diffusion": constants.body_diffusion,
        "orientation.head_diffusion": constants.head_diffusion,
    }
    found |= {name: float(value[0]) for name, value in _strengths(coupling, model, 1).items()}
    for name in ("position_std", "pixel_std"):
        if name in constants.noise:
            # Where that of positions was learned, pixels were judged on the ground.
            found |= {
                f"likelihood.{name}": constants.noise[name],
                "likelihood.image_frame": name == "pixel_std",
            }
    for name in ("body", "head"):
        if f"{name}_std" in constants.noise:
            found[f"likelihood.{name}_kappa"] = constants.noise[f"{name}_std"] ** -2
        if f"{name}_outliers" in constants.noise:
            found[f"likelihood.{name}_outliers"] = constants.noise[f"{name}_outliers"]
    return found


def mixture(states: FloatArray, covariance: FloatArray, weights: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return means (n, 6) and covariances (n, 6, 6) of mixtures of states (k, n, 6).

    The mean of angles is circular, over the alternatives that determine an angle. The variance of one is not
    above that of the uniform density.

    Parameters
    ----------
    states : x, y, vx, vy, body, head; NaN for variables outside the model
    covariance : (k, n, 6, 6)
    weights : (k,) probabilities
    """
    mean = np.tensordot(weights, states, 1)
    votes = weights[:, None, None] * np.maximum(
        1.0 - covariance[:, :, (BODY, HEAD), (BODY, HEAD)] / _UNDETERMINED, 1e-6
    )
    mean[:, BODY:] = direction((votes[..., None] * unit(states[:, :, BODY:])).sum(axis=0))
    away = states - mean
    away[:, :, BODY:] = wrap(away[:, :, BODY:])
    total = np.tensordot(weights, covariance + away[..., :, None] * away[..., None, :], 1)
    limit_angles(total)
    return mean, total


def averaged(solutions: Sequence[Solution], weights: FloatArray) -> Solution:
    """Return the mean of the solutions of one track by their weights, with the covariance of the mixture.

    The mean of angles is circular, over the alternatives that determine an angle.
    """
    best = solutions[int(np.argmax(weights))]
    if len(solutions) == 1:
        return best
    states = np.stack([_states(one.track) for one in solutions])
    covariance = np.stack([one.track.covariance for one in solutions if one.track.covariance is not None])
    mean, total = mixture(states, covariance, weights)
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
