"""Chen et al. 2011, Table 2: body and head from observations alone, filtered separately, and jointly."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy import integrate, optimize

from graphtrack.baselines.particle.filter import ParticleOptions, particle_filter, particle_smoother
from graphtrack.evaluation.reproduce.chen_fitted import ANGLES as ANGLES
from graphtrack.evaluation.reproduce.chen_fitted import (
    FITTED,
    errors_of,
    fits,
    fitted_errors,
    fitted_models,
    fitted_table,
    pair_table,
    parameter_table,
)
from graphtrack.evaluation.reproduce.chen_fitted import PAPER as PAPER
from graphtrack.evaluation.reproduce.chen_fitted import Estimator as Estimator
from graphtrack.evaluation.reproduce.experiment import (
    ASKANCE,
    ISAM2,
    LAG,
    MOCAP,
    SALSA,
    WALKING,
    Cell,
    Experiment,
    Progress,
    Reproduction,
    Settings,
    Table,
    evenly,
    quietly,
    thinned,
)
from graphtrack.evaluation.resampling import bootstrap, mean_difference
from graphtrack.geometry.angles import FloatArray, von_mises_log_density
from graphtrack.model import Model
from graphtrack.simulation.degrade import add_noise
from graphtrack.simulation.sampling import simulate
from graphtrack.smoothing import smooth, track_online
from graphtrack.tracks import TrackSet

if TYPE_CHECKING:
    from matplotlib.figure import Figure

PRESETS = ("separate", "joint-body", "joint")
"""Nothing coupled; the paper's separate filtering, κ₂ = 0 in eq. 10; the paper's joint filtering."""

PATHS = ParticleOptions(paths=40)

BESIDE = "Paper / ours: mean error in degrees (Chen et al. 2011: on CHIL, with its own particle filter)"

WALKERS = "mocap, walking"

POSITION_STD = 0.1
"""Metres of noise on the positions."""

METHODS: Mapping[str, tuple[str, Estimator]] = {
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


@dataclass(frozen=True, eq=False)
class Scores:
    """Mean absolute errors in degrees, one number a person: (preset, method, angle) → (n,)."""

    data: str
    people: int
    errors: Mapping[tuple[str, str, str], FloatArray]


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
    mocap = settings.recording(*MOCAP)
    if mocap is not None:
        clips = quietly(mocap)
        found[WALKERS] = evenly(clips.select(WALKING).map(thinned), count, 2.0)
        found["mocap, sideways and back"] = evenly(clips.select(*ASKANCE).map(thinned), count, 2.0)
    salsa = settings.recording(*SALSA)
    if salsa is not None:
        steps = 30 if settings.quick else 250
        found["SALSA, party"] = quietly(salsa).map(lambda track: track[:steps])
    drawn = simulate("joint", n_tracks=max(count // 2, 4), n_steps=100, rng=settings.rng(1))
    found["drawn from the joint model"] = drawn
    return {name: _noisy(tracks, settings.rng(2, i)) for i, (name, tracks) in enumerate(found.items())}


def others(settings: Settings, reported: Mapping[str, TrackSet]) -> TrackSet:
    """Noisy people who walk ahead and are not reported, for parameters to be fitted on."""
    count = 3 if settings.quick else 24
    mocap = settings.recording(*MOCAP)
    if mocap is None:
        tracks = simulate("joint", n_tracks=count, n_steps=100, rng=settings.rng(3))
    else:
        known = {track.track_id for track in reported[WALKERS]}
        clips = quietly(mocap).select(WALKING)
        left = clips.with_tracks(track for track in clips if track.track_id not in known)
        tracks = evenly(left.map(thinned), count, 2.0)
    return _noisy(tracks, settings.rng(4))


def _noisy(tracks: TrackSet, rng: np.random.Generator) -> TrackSet:
    body, head = (concentration_of(np.radians(error)) for error in PAPER["observation"])
    return add_noise(tracks, position_std=POSITION_STD, body_kappa=body, head_kappa=head, rng=rng)


def scores(data: str, tracks: TrackSet, progress: Progress) -> Scores:
    """Every method on every person, with the separate and with the joint model."""
    models = {preset: Model(preset) for preset in (*PRESETS, "full")}
    found: dict[tuple[str, str, str], list[float]] = {}
    for track in tracks:
        for angle, error in zip(ANGLES, errors_of(track, track), strict=True):
            found.setdefault(("observation", "", angle), []).append(error)
        for preset, model in models.items():
            for method, (_, estimator) in METHODS.items():
                if preset == "full" and method not in WITH_MODES:
                    continue
                for angle, error in zip(ANGLES, errors_of(estimator(track, model), track), strict=True):
                    found.setdefault((preset, method, angle), []).append(error)
        progress(1)
    return Scores(data, len(tracks), {key: np.array(values) for key, values in found.items()})


def run(settings: Settings, progress: Progress) -> Reproduction:
    """The experiment."""
    everyone = people(settings)
    found = [scores(name, tracks, progress) for name, tracks in everyone.items()]
    models = fitted_models(others(settings, everyone), METHODS, _evaluations(settings), progress)
    fitted = fitted_errors(everyone, METHODS, models, progress)
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
        _figure(found, rng),
        tuple(notes),
    )


def _evaluations(settings: Settings) -> int:
    """Of each method and preset, for its parameters to be fitted."""
    return 7 if settings.quick else 100


def _detail(found: Sequence[Scores], rng: np.random.Generator) -> Table:
    records: list[dict[str, Cell]] = []
    for one in found:
        for angle in ANGLES:
            for method, (group, _) in METHODS.items():
                separate, body, joint = (one.errors[preset, method, angle] for preset in PRESETS)
                interval = bootstrap(mean_difference, joint, body, rng=rng)
                records.append(
                    {
                        "data": one.data,
                        "people": one.people,
                        "angle": angle,
                        "group": group,
                        "method": method,
                        "observation (°)": float(one.errors["observation", "", angle].mean()),
                        "separate (°)": float(separate.mean()),
                        "joint-body (°)": float(body.mean()),
                        "joint (°)": float(joint.mean()),
                        "joint − joint-body (°)": interval.value,
                        "low": interval.low,
                        "high": interval.high,
                    }
                )
    return Table.of(
        "Body and head: observation, nothing coupled, Chen et al.'s separate, Chen et al.'s joint", records
    )


def _modes(found: Sequence[Scores], rng: np.random.Generator) -> Table:
    """What the modes of ``full`` make of it."""
    records: list[dict[str, Cell]] = []
    for one in found:
        for angle in ANGLES:
            for method in WITH_MODES:
                own, separate = (one.errors[preset, method, angle] for preset in ("full", "separate"))
                interval = bootstrap(mean_difference, own, separate, rng=rng)
                records.append(
                    {
                        "data": one.data,
                        "angle": angle,
                        "group": METHODS[method][0],
                        "method": method,
                        "separate (°)": float(separate.mean()),
                        "joint (°)": float(one.errors["joint", method, angle].mean()),
                        "full (°)": float(own.mean()),
                        "full − separate (°)": interval.value,
                        "low": interval.low,
                        "high": interval.high,
                    }
                )
    return Table.of(
        "Beyond Chen et al. 2011: the graph, told whether people face where they go (full)", records
    )


def beside(found: Sequence[Scores], groups: Mapping[str, str], title: str) -> Table:
    """Chen et al.'s Table 2 beside the errors of some methods, of which ``groups`` says whether they are
    online."""
    records: list[dict[str, Cell]] = []
    for i, angle in enumerate(ANGLES):
        for one in found:
            for method, group in groups.items():
                records.append(
                    {
                        "angle": angle,
                        **{f"paper: {name}": PAPER[name][i] for name in PAPER},
                        "ours: data": one.data,
                        "ours: method": f"{method} ({group})",
                        "ours: observation": float(one.errors["observation", "", angle].mean()),
                        "ours: separate": float(one.errors["joint-body", method, angle].mean()),
                        "ours: joint": float(one.errors["joint", method, angle].mean()),
                    }
                )
    return Table.of(title, records)


def _figure(found: Sequence[Scores], rng: np.random.Generator) -> Figure:
    from matplotlib.lines import Line2D

    from graphtrack.evaluation.reproduce.style import colour_of, filling
    from graphtrack.report.style import NEUTRAL_COLOUR, new_figure, tidy

    names = ["Chen et al. 2011", *(one.data for one in found)]
    figure = new_figure(3.0 * len(names), 7.2)
    grid = figure.subplots(2, len(names), sharex=True, sharey="row")
    stages = ("observation", *PRESETS, "full")
    for row, angle in enumerate(ANGLES):
        for column, name in enumerate(names):
            axes = grid[row, column]
            if column == 0:
                values = [PAPER[stage][row] for stage in ("observation", "separate", "joint")]
                axes.plot(
                    (0, 2, 3), values, "o-", color=NEUTRAL_COLOUR, label="Chen et al. 2011, particle filter"
                )
            else:
                one = found[column - 1]
                for k, (method, group) in enumerate(GROUPS.items()):
                    own = stages if method in WITH_MODES else stages[:-1]
                    keys = [(s, "" if s == "observation" else method, angle) for s in own]
                    drawn = [
                        bootstrap(lambda v: np.mean(v, axis=-1), one.errors[key], rng=rng) for key in keys
                    ]
                    x = np.arange(len(own)) + 0.06 * (k - 2.0)
                    value = np.array([interval.value for interval in drawn])
                    spread = [value - [i.low for i in drawn], [i.high for i in drawn] - value]
                    style = "-" if group == "online" else "--"
                    axes.errorbar(
                        x,
                        value,
                        spread,
                        fmt="o" + style,
                        color=colour_of(method),
                        markerfacecolor=filling(method),
                        markersize=4,
                        label=method,
                    )
            tidy(axes, grid="y")
            axes.set_xticks(range(5), ["seen", "separate", "joint-\nbody", "joint", "full"])
            axes.set_xlim(-0.4, 4.4)
            if row == 0:
                axes.set_title(name, fontsize=10)
        # After all are drawn, for they share their axis.
        top = max(axes.dataLim.y1 for axes in grid[row])
        grid[row, 0].set_ylim(0.0, 1.05 * top)
        grid[row, 0].set_ylabel(f"{angle}: mean error (°)")
    grid[0, 0].legend(frameon=False, fontsize=8)
    handles = [
        Line2D(
            [],
            [],
            color=colour_of(method),
            marker="o",
            markerfacecolor=filling(method),
            linestyle="-" if group == "online" else "--",
            label=method,
        )
        for method, group in GROUPS.items()
    ]
    grid[0, 1].legend(handles=handles, frameon=False, fontsize=8)
    return figure


def work(settings: Settings) -> int:
    """People, those that parameters are fitted on at each evaluation, and those reported with them."""
    everyone = people(settings)
    reported = sum(len(tracks) for tracks in everyone.values())
    fitting = _evaluations(settings) * len(others(settings, everyone))
    return reported + fits(METHODS) * fitting + len(FITTED) * len(METHODS) * reported


EXPERIMENT = Experiment(
    "chen-joint",
    "Chen et al. 2011, Table 2: observation, separate and joint filtering",
    work,
    run,
    "4 to 13 people of each source",
)
