"""Chen et al. 2011, Table 2: body and head from observations alone, filtered separately, and jointly."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from scipy import integrate, optimize

from graphtrack.baselines.particle.filter import ParticleOptions, particle_filter, particle_smoother
from graphtrack.evaluation.reproduce.chen_fitted import (
    FITTED,
    fits,
    fitted_models,
    fitted_table,
    pair_table,
    parameter_table,
)
from graphtrack.evaluation.reproduce.chen_tables import (
    ANGLES,
    PAPER,
    POSITION_STD,
    PRESETS,
    WITH_FULL,
    Methods,
    Scores,
    beside,
    by_angle,
    default_models,
    errors_of,
    estimated_errors,
)
from graphtrack.evaluation.reproduce.experiment import (
    ASKANCE,
    ISAM2,
    LAG,
    MOCAP,
    SALSA,
    WALKING,
    Cell,
    Experiment,
    Panel,
    Progress,
    Records,
    Reproduction,
    Settings,
    evenly,
    interval_cells,
    page,
    paired,
    tabulated,
    thinned,
)
from graphtrack.evaluation.resampling import bootstrap
from graphtrack.geometry.angles import von_mises_log_density
from graphtrack.simulation.degrade import add_noise
from graphtrack.simulation.sampling import simulate
from graphtrack.smoothing.recording import smooth, track_online
from graphtrack.tracks import TrackSet

PATHS = ParticleOptions(paths=40)

BESIDE = "Paper / ours: mean error in degrees (Chen et al. 2011: on CHIL, with its own particle filter)"

WALKERS = "mocap, walking"


METHODS: Methods = {
    "particle": ("online", lambda track, model: particle_filter(track, model).track),
    "graph": ("online", lambda track, model: track_online(track, model, engine="chain", lag=LAG)),
    f"graph{ISAM2}": ("online", lambda track, model: track_online(track, model, engine="isam2", lag=LAG)),
    "ffbs": ("offline", lambda track, model: particle_smoother(track, model, options=PATHS).track),
    "smoother": ("offline", lambda track, model: smooth(TrackSet((track,)), model).tracks[0]),
}
"""Method → group and estimator: Chen et al.'s filter and the graph, then their smoothers."""

GROUPS = {method: group for method, (group, _) in METHODS.items()}

WITH_MODES = ("graph", f"graph{ISAM2}", "smoother")
"""Methods that know the preset ``full`` as well, `joint` that is told whether people face where they go."""


def concentration_of(error: float) -> float:
    """The κ of a von Mises whose mean absolute deviation is ``error`` radians."""

    def deviation(kappa: float) -> float:
        def weighted(angle: float) -> float:
            return 2.0 * angle * float(np.exp(von_mises_log_density(angle, 0.0, kappa)))

        return float(integrate.quad(weighted, 0.0, np.pi)[0])

    return float(optimize.brentq(lambda kappa: deviation(kappa) - error, 1e-3, 500.0))


def people(settings: Settings) -> dict[str, TrackSet]:
    """Noisy people by source, as wrong as Chen et al.'s observations are."""
    count = 6 if settings.quick else 40
    found = {}
    clips = settings.tracks(*MOCAP)
    if clips is not None:
        found[WALKERS] = evenly(clips.select(WALKING).map(thinned), count, 2.0)
        found["mocap, sideways and back"] = evenly(clips.select(*ASKANCE).map(thinned), count, 2.0)
    salsa = settings.tracks(*SALSA)
    if salsa is not None:
        steps = 30 if settings.quick else 250
        found["SALSA, party"] = salsa.map(lambda track: track[:steps])
    drawn = simulate("joint", n_tracks=max(count // 2, 4), n_steps=100, rng=settings.rng(1))
    found["drawn from the joint model"] = drawn
    return {name: _noisy(tracks, settings.rng(2, i)) for i, (name, tracks) in enumerate(found.items())}


def others(settings: Settings, reported: Mapping[str, TrackSet]) -> TrackSet:
    """Noisy people who walk ahead and are not reported, for parameters to be fitted on."""
    count = 3 if settings.quick else 24
    clips = settings.tracks(*MOCAP)
    if clips is None:
        tracks = simulate("joint", n_tracks=count, n_steps=100, rng=settings.rng(3))
    else:
        known = {track.track_id for track in reported[WALKERS]}
        clips = clips.select(WALKING)
        left = clips.with_tracks(track for track in clips if track.track_id not in known)
        tracks = evenly(left.map(thinned), count, 2.0)
    return _noisy(tracks, settings.rng(4))


def _noisy(tracks: TrackSet, rng: np.random.Generator) -> TrackSet:
    body, head = (concentration_of(np.radians(error)) for error in PAPER["observation"])
    return add_noise(tracks, position_std=POSITION_STD, body_kappa=body, head_kappa=head, rng=rng)


def run(settings: Settings, progress: Progress) -> Reproduction:
    """The experiment."""
    everyone = people(settings)
    found = []
    for name, tracks in everyone.items():
        seen = by_angle(("observation", ""), [errors_of(track, track) for track in tracks])
        estimates = estimated_errors(tracks, METHODS, default_models(METHODS, WITH_MODES), progress)
        found.append(Scores(name, len(tracks), seen | estimates))
    models = fitted_models(others(settings, everyone), METHODS, _evaluations(settings), progress)
    fitted = {name: estimated_errors(tracks, METHODS, models, progress) for name, tracks in everyone.items()}
    by_default = {one.data: one.errors for one in found}
    rng = settings.rng(99)
    notes = [
        "Mean absolute error per person, mean over people. joint − joint-body: paired difference with its "
        "95 % bootstrap interval over five people or more; below 0 joint is better.",
        "What Chen et al. (2011) call separate is joint-body: κ₂ = 0, so that the head does not "
        "follow the body, which "
        "does follow the motion. In separate nothing follows anything.",
        "Observations have the mean error of Chen et al.'s, but independent noise at every frame "
        "(mocap at 10 frames "
        "a second): filtering removes more of that than of a classifier's errors, which persist.",
        "Every method gets positions, body and head, the same frames and the same default parameters. Online "
        "estimates use the past alone, offline ones the whole track.",
        "Fitted: q, D_body, D_head, κ₁ and, in joint, κ₂, for each method and preset by its own mean error "
        "of body and head, on people who walk ahead and are not reported. iSAM2 solves the chain's graph "
        "and has its parameters.",
        "Differences between methods are paired: the same people, the same observations.",
        "Where people do not face their motion, a coupling that trusts it misleads (mocap, sideways and "
        "back); the preset full finds out who does.",
        "SALSA has a frame every 3 s: in that time 1,000 particles spread so far that few of them are within "
        "the noise of a position, and the particle filter suffers from it.",
    ]
    notes.append(
        "People drawn from the model follow the normalised product of dynamics and coupling, as the particle "
        "filter has it; the graph's is not normalised, and holds the head closer to the body than that."
    )
    if len(found) == 1:
        notes.append("No recordings were found: only people drawn from the model.")
    return Reproduction(
        "chen-joint",
        (
            _detail(found, rng),
            _modes(found, rng),
            parameter_table(models),
            fitted_table(by_default, fitted, METHODS, settings.rng(98)),
            pair_table(by_default, fitted, settings.rng(97)),
            beside(found, GROUPS, BESIDE),
        ),
        page(_panels(found, rng), columns=len(found)),
        tuple(notes),
    )


def _evaluations(settings: Settings) -> int:
    """Of each method and preset, for its parameters to be fitted."""
    return 7 if settings.quick else 100


@tabulated("Body and head: observation, nothing coupled, Chen et al.'s separate, Chen et al.'s joint")
def _detail(found: Sequence[Scores], rng: np.random.Generator) -> Records:
    for one in found:
        for angle in ANGLES:
            for method, (group, _) in METHODS.items():
                separate, body, joint = (one.errors[preset, method, angle] for preset in PRESETS)
                yield {
                    "data": one.data,
                    "people": one.people,
                    "angle": angle,
                    "group": group,
                    "method": method,
                    "observation (°)": float(one.errors["observation", "", angle].mean()),
                    "separate (°)": float(separate.mean()),
                    "joint-body (°)": float(body.mean()),
                    "joint (°)": float(joint.mean()),
                    **paired("joint − joint-body (°)", joint, body, rng),
                }


@tabulated("Beyond Chen et al. 2011: the graph, told whether people face where they go (full)")
def _modes(found: Sequence[Scores], rng: np.random.Generator) -> Records:
    """The errors with ``full``, which has modes of the couplings."""
    for one in found:
        for angle in ANGLES:
            for method in WITH_MODES:
                own, separate = (one.errors[preset, method, angle] for preset in ("full", "separate"))
                yield {
                    "data": one.data,
                    "angle": angle,
                    "group": METHODS[method][0],
                    "method": method,
                    "separate (°)": float(separate.mean()),
                    "joint (°)": float(one.errors["joint", method, angle].mean()),
                    "full (°)": float(own.mean()),
                    **paired("full − separate (°)", own, separate, rng),
                }


NO_ENDS: Mapping[str, Cell] = {"low": None, "high": None}


def _panels(found: Sequence[Scores], rng: np.random.Generator) -> list[Panel]:
    panels = []
    for i, angle in enumerate(ANGLES):
        for one in found:
            rows: list[dict[str, Cell]] = [
                {
                    "model": preset,
                    "error": PAPER[name][i],
                    "method": "Chen et al. 2011",
                    "low": None,
                    "high": None,
                }
                for preset, name in (("joint-body", "separate"), ("joint", "joint"))
            ]
            for (preset, method, of), errors in one.errors.items():
                if of == angle:
                    mean = bootstrap(lambda v: np.mean(v, axis=-1), errors, rng=rng)
                    rows.append(
                        {"model": preset, "method": method or "observation", **interval_cells("error", mean)}
                    )
            order = ("observation", *WITH_FULL)
            rows.sort(key=lambda row: order.index(str(row["model"])))
            title = f"{one.data}: {angle} (°)"
            panels.append(Panel(title, rows, "model", "error", "method", ends=("low", "high")))
    return panels


def work(settings: Settings) -> int:
    """Estimates: with default parameters, at each evaluation of the fits, and with the fitted parameters."""
    everyone = people(settings)
    reported = sum(len(tracks) for tracks in everyone.values())
    fitting = _evaluations(settings) * len(others(settings, everyone))
    known = len(default_models(METHODS, WITH_MODES)) + len(FITTED) * len(METHODS)
    return known * reported + fits(METHODS) * fitting


EXPERIMENT = Experiment(
    "chen-joint",
    "Chen et al. 2011, Table 2: observation, separate and joint filtering",
    work,
    run,
    "4 to 13 people of each source",
)
