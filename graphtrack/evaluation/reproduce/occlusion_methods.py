"""The methods of baxter-occlusion, each with the parameters that make its own error least."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from graphtrack.baselines.intentional import OWN_FILTERS, IntentionalParameters, intentional_filter
from graphtrack.baselines.intentional_continuous import intentional_tracker
from graphtrack.baselines.kalman import kalman_filter, rauch_tung_striebel
from graphtrack.baselines.particle.filter import ParticleOptions, particle_filter, particle_smoother
from graphtrack.evaluation.reproduce.experiment import ISAM2, LAG, Progress
from graphtrack.evaluation.reproduce.fitting import fit, from_the_past, model_of, with_density
from graphtrack.geometry.angles import BoolArray, FloatArray
from graphtrack.inference.engines import OnlineEngine
from graphtrack.model import Model, Parameters
from graphtrack.smoothing import smooth, track_online
from graphtrack.tracks import Track, TrackSet

STEERED = "joint-intentional"
PRESETS = ("joint", STEERED)
"""Chen et al.'s model, and the same with a head that steers the velocity, as in Baxter et al.'s tracker."""

ONLINE = (
    *("kf", "printed", "consistent", "kf fitted", "intentional"),
    *(f"{method} {preset}" for method in ("particle", "graph") for preset in PRESETS),
    *(f"graph {preset}{ISAM2}" for preset in PRESETS),
)
OFFLINE = ("rts", *(f"{method} {preset}" for method in ("ffbs", "smoother") for preset in PRESETS))
OWN = ("kf", "printed", "consistent")
"""Baxter et al.'s filters with its parameters; they count time in steps."""

PATHS = 20

Predictor = Callable[[Track], FloatArray]
WithheldWindows = Sequence[tuple[Track, BoolArray]]


@dataclass(frozen=True)
class Effort:
    """Effort of fitting and sampling.

    Attributes
    ----------
    evaluations : of the error in the training windows, by the number of parameters, at most
    sparing : the particles are fitted on every so many-th training window
    particles, smoother_particles : of the filter, and of the smoother, which needs more after a gap
    fitting_particles : of both, while they are fitted
    """

    evaluations: Mapping[int, int]
    sparing: int
    particles: int
    smoother_particles: int
    fitting_particles: int


FULL = Effort({1: 16, 2: 20, 3: 30}, 2, 1000, 4000, 1000)
QUICK = Effort({1: 12, 2: 9, 3: 12}, 3, 1000, 1000, 500)

DENSITY, FACTOR, RATE = 0.2, 3.0, 2.0
"""Start of every search: q in m²/s³, the strength of the couplings, λ in 1/s."""


def in_steps(parameters: IntentionalParameters | None) -> Predictor:
    """Baxter et al.'s own filters, which count time in steps; None: its Kalman filter."""

    def estimate(track: Track) -> FloatArray:
        head = None if parameters is None else track.head
        return intentional_filter(track.position, head, parameters).mean[0, :, :2]

    return estimate


def error_of(predictor: Predictor, pairs: WithheldWindows) -> FloatArray:
    """Mean squared error (m²) of each track in its window."""
    found = []
    for track, window in pairs:
        blind = replace(track, true_position=None, true_body=None, true_head=None)
        off = predictor(blind)[window] - np.asarray(track.true_position)[window]
        found.append(np.mean(np.sum(off**2, axis=1)))
    return np.array(found)


def unseen(track: Track) -> NDArray[np.intp]:
    """The frames without a position, after the first one with."""
    seen = np.asarray(np.isfinite(track.position).all(axis=1))
    return np.flatnonzero(~seen & np.logical_or.accumulate(seen))


def kalman(density: float) -> Predictor:
    """The Kalman filter of white-noise acceleration."""
    return lambda track: kalman_filter(track, with_density(Parameters(), density)).position


def backward(density: float) -> Predictor:
    """Its smoother."""
    return lambda track: rauch_tung_striebel(track, with_density(Parameters(), density)).position


def intentional(density: float, rate: float) -> Predictor:
    """Baxter et al.'s tracker in continuous time."""
    return lambda track: intentional_tracker(track, with_density(Parameters(), density), rate).position


def particles(model: Model, count: int) -> Predictor:
    """Chen et al.'s filter."""
    options = ParticleOptions(particles=count)
    return lambda track: particle_filter(track, model, options=options).track.position


def particle_paths(model: Model, count: int) -> Predictor:
    """Its smoother."""
    options = ParticleOptions(particles=count, paths=PATHS)
    return lambda track: particle_smoother(track, model, options=options).track.position


def hidden_only(model: Model) -> Predictor:
    """The online graph at the hidden frames alone, all that is judged; faster than going through all."""
    return lambda track: from_the_past(track, model, unseen(track)).position


def online(model: Model, engine: OnlineEngine = "chain") -> Predictor:
    """The online graph."""
    return lambda track: track_online(track, model, engine=engine, lag=LAG).position


def offline(model: Model) -> Predictor:
    """The offline graph."""
    return lambda track: smooth(TrackSet((track,)), model).tracks[0].position


def fitted(training: WithheldWindows, effort: Effort, progress: Progress) -> dict[str, Predictor]:
    """The methods by name, each with the parameters that make its own error least in the training windows;
    Baxter et al.'s own filters keep theirs.

    Parameters
    ----------
    training : tracks with their windows
    effort : how long the search is
    progress : called after each method
    """

    def best(
        make: Callable[..., Predictor], *start: float, pairs: WithheldWindows = training
    ) -> tuple[float, ...]:
        def error(*values: float) -> float:
            return float(np.mean(error_of(make(*values), pairs)))

        found = fit(error, start, evaluations=effort.evaluations[len(start)])
        progress(1)
        return found

    def best_model(
        preset: str, predictor: Callable[[Model], Predictor], pairs: WithheldWindows = training
    ) -> Model:
        make, rate = model_of(preset), (RATE,) if preset == STEERED else ()
        return make(*best(lambda *v: predictor(make(*v)), DENSITY, FACTOR, *rate, pairs=pairs))

    few, sampled = training[:: effort.sparing], effort.fitting_particles
    found = {"kf": in_steps(None), **{name: in_steps(own) for name, own in OWN_FILTERS.items()}}
    found["kf fitted"] = kalman(*best(kalman, DENSITY))
    found["intentional"] = intentional(*best(intentional, DENSITY, RATE))
    for preset in PRESETS:
        model = best_model(preset, lambda m: particles(m, sampled), few)
        found[f"particle {preset}"] = particles(model, effort.particles)
    for preset in PRESETS:
        model = best_model(preset, hidden_only)
        found[f"graph {preset}"] = online(model)
        found[f"graph {preset}{ISAM2}"] = online(model, "isam2")
    found["rts"] = backward(*best(backward, DENSITY))
    for preset in PRESETS:
        model = best_model(preset, lambda m: particle_paths(m, sampled), few)
        found[f"ffbs {preset}"] = particle_paths(model, effort.smoother_particles)
    for preset in PRESETS:
        found[f"smoother {preset}"] = offline(best_model(preset, offline))
    return found


FITS = len(ONLINE) - len(OWN) - len(PRESETS) + len(OFFLINE)
"""Methods whose parameters are fitted."""
