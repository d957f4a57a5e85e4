"""Chen et al. 2011, Table 2: body and head from observations alone, filtered separately, and jointly.

The methods share five parameters: q, D_body, D_head, κ₁ and κ₂. They are fitted for each method and for both
presets alike, on people who are not reported.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from scipy import integrate, optimize

from graphtrack.baselines.particle_filter import ParticleOptions, particle_filter, particle_smoother
from graphtrack.evaluation.metrics import angular_error, bootstrap
from graphtrack.experiments.harness import (
    ASKANCE,
    ISAM2,
    LAG,
    MOCAP,
    SALSA,
    WALKING,
    Cell,
    Experiment,
    Panel,
    Parts,
    Progress,
    Row,
    Settings,
    Table,
    draw_panel,
    evenly,
    fitted_model,
    interval_cells,
    page,
    paired,
    thinned,
)
from graphtrack.geometry.angles import (
    FloatArray,
    class_centres,
    difference,
    von_mises_log_density,
)
from graphtrack.model import Model
from graphtrack.simulation.degrade import add_noise
from graphtrack.simulation.sampling import simulate
from graphtrack.smoothing import smooth
from graphtrack.tracking import track_online
from graphtrack.tracks.track import Track, TrackSet

if TYPE_CHECKING:
    from numpy.typing import NDArray


ANGLES: tuple[Literal["body", "head"], ...] = ("body", "head")
PAPER = {"observation": (41.7, 30.3), "separate": (32.9, 25.8), "joint": (21.9, 17.6)}
"""Chen et al. 2011, Table 2: mean errors of body and head in degrees."""

PRESETS = ("separate", "joint-body", "joint")
"""Nothing coupled; the paper's separate filtering, κ₂ = 0 in eq. 10; the paper's joint filtering."""

POSITION_STD = 0.1
"""Metres of noise on the positions."""

Estimator = Callable[[Track, Model], Track]

Methods = Mapping[str, tuple[str, Estimator]]
"""Method → group, "online" or "offline", and estimator."""

Errors = Mapping[tuple[str, str, str], FloatArray]
"""(preset, method, angle) → mean errors (n,) in degrees; ("observation", "") for the observations."""


@dataclass(frozen=True, eq=False)
class Scores:
    """Mean absolute errors in degrees of the people of a source."""

    data: str
    people: int
    errors: Errors

    def mean(self, *key: str) -> float:
        """Mean over the people of a (preset, method, angle)."""
        return float(self.errors[key].mean())  # type: ignore[index]


def errors_of(estimate: Track, track: Track) -> list[float]:
    """Mean errors of body and head in degrees."""
    return [angular_error(estimate, track, angle) for angle in ANGLES]


def by_angle(
    key: tuple[str, str], errors: Sequence[Sequence[float]]
) -> dict[tuple[str, str, str], FloatArray]:
    """Errors (people, 2) of body and head, of a preset and method."""
    return {(*key, angle): np.array(errors)[:, i] for i, angle in enumerate(ANGLES)}


def default_models(methods: Iterable[str]) -> dict[tuple[str, str], Model]:
    """(preset, method) → the model with default parameters."""
    models = {preset: Model(preset) for preset in PRESETS}
    return {(preset, method): models[preset] for preset in PRESETS for method in methods}


def estimated_errors(
    tracks: Iterable[Track], methods: Methods, models: Mapping[tuple[str, str], Model], progress: Progress
) -> dict[tuple[str, str, str], FloatArray]:
    """The errors of methods with models by (preset, method); one unit of progress an estimate."""
    found: dict[tuple[str, str, str], FloatArray] = {}
    for key, model in models.items():
        errors = []
        for track in tracks:
            errors.append(errors_of(methods[key[1]][1](track, model), track))
            progress(1)
        found |= by_angle(key, errors)
    return found


def most_likely_error(track: Track, truth: Track, angle: str) -> float:
    """Mean error (degrees) of the most likely class of each frame; ``truth`` has the same frames."""
    likelihood, true = getattr(track, f"{angle}_likelihood"), getattr(truth, f"true_{angle}")
    centres = class_centres(likelihood.shape[1])
    known = np.isfinite(likelihood).all(axis=1)
    answer = centres[likelihood[known].argmax(axis=1)]
    return float(np.degrees(np.abs(difference(answer, true[known])).mean()))


def mean_interval(name: str, errors: FloatArray, rng: np.random.Generator) -> dict[str, Cell]:
    """Cells of the mean over people (n,), with its 95 % bootstrap interval."""
    return interval_cells(name, bootstrap(lambda v: np.mean(v, axis=-1), errors, rng=rng))


def detail(title: str, found: Iterable[Scores], groups: Mapping[str, str], rng: np.random.Generator) -> Table:
    """The errors of every method with every model, with 95 % intervals over people.

    Parameters
    ----------
    groups : method → "online" or "offline", in the order of the rows
    """
    return Table.of(
        title,
        (
            {
                "data": one.data,
                "people": len(errors),
                "angle": angle,
                "group": group,
                "method": method,
                "model": preset,
                "most likely class (°)": one.mean("observation", "", angle),
                **mean_interval("error (°)", errors, rng),
            }
            for one in found
            for angle in ANGLES
            for method, group in groups.items()
            for preset in PRESETS
            if (errors := one.errors.get((preset, method, angle))) is not None
        ),
    )


def published_table(found: Sequence[Scores], groups: Mapping[str, str], title: str) -> Table:
    """Chen et al.'s Table 2 next to the errors of some methods, grouped by ``groups`` as online."""
    return Table.of(
        title,
        (
            {
                "angle": angle,
                **{f"paper: {name}": values[i] for name, values in PAPER.items()},
                "ours: data": one.data,
                "ours: method": f"{method} ({group})",
                "ours: observation": one.mean("observation", "", angle),
                "ours: separate": one.mean("joint-body", method, angle),
                "ours: joint": one.mean("joint", method, angle),
            }
            for i, angle in enumerate(ANGLES)
            for one in found
            for method, group in groups.items()
        ),
    )


def draw_errors(
    grid: NDArray[Any], found: Sequence[Scores], groups: Mapping[str, str], rng: np.random.Generator
) -> None:
    """Draw the errors into a grid of axes (2, len(found)), body above head, a column for each source."""
    rows = detail("", found, groups, rng).records()
    handles: dict[str, Any] = {}
    for row, angle in enumerate(ANGLES):
        for column, one in enumerate(found):
            own = [record for record in rows if (record["data"], record["angle"]) == (one.data, angle)]
            title = f"{one.data} ({one.people} people)" if row == 0 else ""
            panel = Panel(title, own, "model", "error (°)", "method", ends=("low", "high"))
            draw_panel(grid[row, column], panel, handles)
        grid[row, 0].set_ylabel(f"{angle}: mean error (°)")


SHARED: Mapping[str, str] = {
    "q (m²/s³)": "motion.acceleration_density",
    "D_body (rad²/s)": "orientation.body_diffusion",
    "D_head (rad²/s)": "orientation.head_diffusion",
    "κ₁ ((m/s)⁻²)": "coupling.motion_body_kappa",
    "κ₂": "coupling.head_body_kappa",
}
"""Parameters that all methods have: name in tables → name."""

FITTED = {"joint-body": tuple(SHARED.values())[:-1], "joint": tuple(SHARED.values())}
"""Preset → the parameters that are fitted: the paper's separate filtering has no κ₂."""

PAIRS = (("graph", "particle"), (f"graph{ISAM2}", "particle"), ("smoother", "ffbs"))
"""Methods that are compared on the same people, the first less the second."""

Models = Mapping[tuple[str, str], Model]
"""(preset, method) → the model with the parameters fitted for that method."""


def fitted_models(tracks: TrackSet, methods: Methods, evaluations: int, progress: Progress) -> Models:
    """Models of `FITTED`'s presets with which each method has the smallest mean error of body and head.

    iSAM2 solves the graph that the compiled chain solves, and has its parameters.

    Parameters
    ----------
    tracks : people who are not reported
    methods : group and estimator by name, a graph before its iSAM2
    evaluations : of each method and preset on all of them, at most
    """

    def fitted(preset: str, estimator: Estimator) -> Model:
        def error(model: Model) -> float:
            errors = [errors_of(estimator(track, model), track) for track in tracks]
            progress(len(tracks))
            return float(np.mean(errors))

        return fitted_model(Model(preset), FITTED[preset], error, evaluations)

    found: dict[tuple[str, str], Model] = {}
    for preset, (method, (_, estimator)) in product(FITTED, methods.items()):
        own = method.removesuffix(ISAM2)
        found[preset, method] = fitted(preset, estimator) if own == method else found[preset, own]
    return found


def parameter_table(models: Models) -> Table:
    """The parameters fitted for each method, with the package's own in the first row."""

    def row(preset: str, method: str, model: Model) -> Row:
        known = {
            label: model.parameters.value(name) if name in FITTED[preset] else None
            for label, name in SHARED.items()
        }
        return {"preset": preset, "method": method, **known}

    rows = [row(*key, model) for key, model in models.items() if not key[1].endswith(ISAM2)]
    title = "Parameters fitted for each method, on other people"
    return Table.of(title, [row("joint", "default", Model("joint")), *rows])


def fitted_rows(
    found: Sequence[Scores], fitted: Mapping[str, Errors], methods: Methods, rng: np.random.Generator
) -> Iterator[Row]:
    """Errors with the default parameters and with those fitted, by source, angle and method."""
    for one, (i, angle) in product(found, enumerate(ANGLES)):
        for method, (group, _) in methods.items():
            joint, body = (fitted[one.data][preset, method, angle] for preset in ("joint", "joint-body"))
            yield {
                "data": one.data,
                "angle": angle,
                "group": group,
                "method": method,
                "paper: joint (°)": PAPER["joint"][i],
                "joint, default (°)": one.mean("joint", method, angle),
                "joint, fitted (°)": float(joint.mean()),
                "joint-body, fitted (°)": float(body.mean()),
                **paired("joint − joint-body, fitted (°)", joint, body, rng),
            }


def pair_rows(
    found: Sequence[Scores], fitted: Mapping[str, Errors], rng: np.random.Generator
) -> Iterator[Row]:
    """Paired differences of `PAIRS` with `joint`, with the default parameters and with those fitted."""
    for one, angle, (first, second) in product(found, ANGLES, PAIRS):
        record: dict[str, Cell] = {"data": one.data, "angle": angle, "difference": f"{first} − {second}"}
        for which, of in (("default", one.errors), ("fitted", fitted[one.data])):
            ends = f"{which}: low", f"{which}: high"
            mine, other = (of["joint", method, angle] for method in (first, second))
            record |= paired(f"{which} (°)", mine, other, rng, *ends)
        yield record


PATHS = ParticleOptions(paths=40)

PUBLISHED_TITLE = (
    "Paper / ours: mean error in degrees (Chen et al. 2011: on CHIL, with its own particle filter)"
)

WALKERS = "mocap, walking"


METHODS: Methods = {
    "particle": ("online", lambda track, model: particle_filter(track, model).track),
    "graph": (
        "online",
        lambda track, model: track_online(track, model, engine="chain", lag=LAG, constants="default"),
    ),
    f"graph{ISAM2}": (
        "online",
        lambda track, model: track_online(track, model, engine="isam2", lag=LAG, constants="default"),
    ),
    "ffbs": ("offline", lambda track, model: particle_smoother(track, model, options=PATHS).track),
    "smoother": (
        "offline",
        lambda track, model: smooth(TrackSet((track,)), model, constants="default").tracks[0],
    ),
}
"""Method → group and estimator: Chen et al.'s filter and the graph, then their smoothers."""

GROUPS = {method: group for method, (group, _) in METHODS.items()}


def concentration_of(error: float) -> float:
    """The κ of a von Mises whose mean absolute deviation is ``error`` radians."""

    def deviation(kappa: float) -> float:
        def weighted(angle: float) -> float:
            return 2.0 * angle * float(np.exp(von_mises_log_density(angle, 0.0, kappa)))

        return float(integrate.quad(weighted, 0.0, np.pi)[0])

    return float(optimize.brentq(lambda kappa: deviation(kappa) - error, 1e-3, 500.0))


def people(settings: Settings) -> dict[str, TrackSet]:
    """Noisy people by source, as wrong as Chen et al.'s observations are."""
    count = settings.few(40, 6)
    found = {}
    clips = settings.tracks(*MOCAP)
    if clips is not None:
        found[WALKERS] = evenly(clips.select(WALKING).map(thinned), count, 2.0)
        found["mocap, sideways and back"] = evenly(clips.select(*ASKANCE).map(thinned), count, 2.0)
    salsa = settings.tracks(*SALSA)
    if salsa is not None:
        steps = settings.few(250, 30)
        found["SALSA, party"] = salsa.map(lambda track: track[:steps])
    drawn = simulate("joint", n_tracks=max(count // 2, 4), n_steps=100, rng=settings.rng(1))
    found["drawn from the joint model"] = drawn
    return {name: _noisy(tracks, settings.rng(2, i)) for i, (name, tracks) in enumerate(found.items())}


def simulated_walkers(settings: Settings, reported: Mapping[str, TrackSet]) -> TrackSet:
    """Noisy people who walk ahead and are not reported, for parameters to be fitted on."""
    count = settings.few(24, 3)
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


def _parts(settings: Settings) -> Parts:
    everyone, evaluations = people(settings), settings.few(100, 7)
    other_people = simulated_walkers(settings, everyone)
    models = default_models(METHODS)
    searches = len(FITTED) * sum(not method.endswith(ISAM2) for method in METHODS)
    reported = sum(len(tracks) for tracks in everyone.values())
    settings.expect(
        (len(models) + len(FITTED) * len(METHODS)) * reported + searches * evaluations * len(other_people)
    )
    found = []
    for name, tracks in everyone.items():
        observed = by_angle(("observation", ""), [errors_of(track, track) for track in tracks])
        estimates = estimated_errors(tracks, METHODS, models, settings.progress)
        found.append(Scores(name, len(tracks), observed | estimates))
    best = fitted_models(other_people, METHODS, evaluations, settings.progress)
    fitted = {
        name: estimated_errors(tracks, METHODS, best, settings.progress) for name, tracks in everyone.items()
    }
    rng = settings.rng(99)
    yield Table.of(
        "Body and head: observation, nothing coupled, Chen et al.'s separate, Chen et al.'s joint",
        _detail(found, rng),
    )
    yield parameter_table(best)
    yield Table.of(
        "Errors with the parameters fitted for each method",
        fitted_rows(found, fitted, METHODS, settings.rng(98)),
    )
    yield Table.of(
        "Methods compared on the same people, joint, 95 % intervals",
        pair_rows(found, fitted, settings.rng(97)),
    )
    yield published_table(found, GROUPS, PUBLISHED_TITLE)
    yield page(_panels(found, rng), columns=len(found))
    yield (
        "Mean absolute error per person, mean over people. joint − joint-body: paired difference with its "
        "95 % bootstrap interval over five people or more; below 0 joint is better."
    )
    yield (
        "What Chen et al. (2011) call separate is joint-body: κ₂ = 0, so that the head does not follow the "
        "body, which does follow the motion. In separate nothing follows anything."
    )
    yield (
        "Observations have the mean error of Chen et al.'s, but independent noise at every frame (mocap at "
        "10 frames a second): filtering removes more of that than of a classifier's errors, which persist."
    )
    yield (
        "Every method gets positions, body and head, the same frames and the same default parameters. Online "
        "estimates use the past alone, offline ones the whole track."
    )
    yield (
        "Fitted: q, D_body, D_head, κ₁ and, in joint, κ₂, for each method and preset by its own mean error "
        "of body and head, on people who walk ahead and are not reported. iSAM2 solves the chain's graph "
        "and has its parameters."
    )
    yield "Differences between methods are paired: the same people, the same observations."
    yield ("Where people do not face their motion, a coupling that trusts it misleads (sideways and back).")
    yield (
        "SALSA has a frame every 3 s: in that time 1,000 particles spread so far that few of them are within "
        "the noise of a position, and the particle filter suffers from it."
    )
    yield (
        "People drawn from the model follow the normalised product of dynamics and coupling, as the particle "
        "filter has it; the graph's is not normalised, and holds the head closer to the body than that."
    )
    if len(found) == 1:
        yield "No recordings were found: only people drawn from the model."


def _detail(found: Sequence[Scores], rng: np.random.Generator) -> Iterator[Row]:
    for one, angle, (method, (group, _)) in product(found, ANGLES, METHODS.items()):
        separate, body, joint = (one.errors[preset, method, angle] for preset in PRESETS)
        yield {
            "data": one.data,
            "people": one.people,
            "angle": angle,
            "group": group,
            "method": method,
            "observation (°)": one.mean("observation", "", angle),
            "separate (°)": float(separate.mean()),
            "joint-body (°)": float(body.mean()),
            "joint (°)": float(joint.mean()),
            **paired("joint − joint-body (°)", joint, body, rng),
        }


def _panels(found: Sequence[Scores], rng: np.random.Generator) -> list[Panel]:
    panels, order = [], ("observation", *PRESETS)
    for (i, angle), one in product(enumerate(ANGLES), found):
        published = {"method": "Chen et al. 2011", "low": None, "high": None}
        rows: list[Row] = [
            {"model": preset, "error": PAPER[name][i], **published}
            for preset, name in (("joint-body", "separate"), ("joint", "joint"))
        ]
        rows += [
            {"model": preset, "method": method or "observation", **mean_interval("error", errors, rng)}
            for (preset, method, of), errors in one.errors.items()
            if of == angle
        ]
        rows.sort(key=lambda row: order.index(str(row["model"])))
        title = f"{one.data}: {angle} (°)"
        panels.append(Panel(title, rows, "model", "error", "method", ends=("low", "high")))
    return panels


EXPERIMENT = Experiment(
    "chen-joint",
    "Chen et al. 2011, Table 2: observation, separate and joint filtering",
    "4 to 13 people of each source",
    _parts,
)
