"""Chen et al. 2011, Table 2: body and head from observations alone, filtered separately, and jointly.

The methods share five parameters: q, D_body, D_head, κ₁ and κ₂. They are fitted for each method, preset and
source alike, on people of that source who are not reported.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
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
    at_limit,
    draw_panel,
    evenly,
    fitted_model,
    halves,
    interval_cells,
    page,
    paired,
    thinned,
    unit_of,
)
from graphtrack.geometry.angles import (
    FloatArray,
    class_centres,
    difference,
    von_mises_log_density,
)
from graphtrack.model import Model
from graphtrack.simulation.crowd import standers
from graphtrack.simulation.degrade import add_class_likelihoods, add_noise
from graphtrack.smoothing import smooth
from graphtrack.tracking import track_online
from graphtrack.tracks.track import BODY_CLASSES, HEAD_CLASSES, Track, TrackSet

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


NOT_RUN = np.array([np.nan])
"""Errors of a method that is not run with the default parameters: iSAM2, which takes long by classes."""


@dataclass(frozen=True, eq=False)
class Scores:
    """Mean absolute errors in degrees of the people of a source; ``units``: see `unit_of`."""

    data: str
    people: int
    errors: Errors
    units: Sequence[str] | None = None

    def mean(self, *key: str) -> float:
        """Mean over the people of a (preset, method, angle); NaN if it was not run."""
        return float(self.errors.get(key, NOT_RUN).mean())  # type: ignore[arg-type]


def errors_of(estimate: Track, track: Track) -> list[float]:
    """Mean errors of body and head in degrees."""
    return [angular_error(estimate, track, angle) for angle in ANGLES]


def by_angle(
    key: tuple[str, str], errors: Sequence[Sequence[float]]
) -> dict[tuple[str, str, str], FloatArray]:
    """Errors (people, 2) of body and head, of a preset and method."""
    return {(*key, angle): np.array(errors)[:, i] for i, angle in enumerate(ANGLES)}


def default_models(methods: Collection[str]) -> dict[tuple[str, str], Model]:
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


def mean_interval(
    name: str, errors: FloatArray, rng: np.random.Generator, units: Sequence[str] | None = None
) -> dict[str, Cell]:
    """Cells of the mean over people (n,), with its 95 % bootstrap interval over units."""
    return interval_cells(name, bootstrap(lambda v: np.mean(v, axis=-1), errors, rng=rng, units=units))


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
                **mean_interval("error (°)", errors, rng, one.units),
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


PATHS = ParticleOptions(paths=40)

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


def confusion_of(error: float, n_classes: int) -> FloatArray:
    """Return confusions (n, n) of neighbouring classes whose answers are ``error`` radians off in the mean.

    They fall with the distance of the classes as a von Mises density, and the true angle is anywhere in its
    class.
    """
    width = 2.0 * np.pi / n_classes
    offset = width * np.arange(n_classes)
    within = (np.arange(64) + 0.5) / 64.0 * width - width / 2.0
    off = np.abs(difference(offset[:, None], within)).mean(axis=1)

    def row(kappa: float) -> FloatArray:
        weight = np.exp(kappa * (np.cos(offset) - 1.0))
        return weight / weight.sum()

    kappa = float(optimize.brentq(lambda kappa: float(row(kappa) @ off) - error, 1e-6, 500.0))
    return np.stack([np.roll(row(kappa), k) for k in range(n_classes)])


STANDING = "standing and turning, simulated"
WALKERS, ODD, PARTY = "mocap, walking", "mocap, sideways and back", "SALSA, party"
PERSISTENCE = 1.0
"""Seconds that an error of the simulated classifiers lasts in the mean."""


@dataclass(frozen=True, eq=False)
class Cohort:
    """Noisy people of one source: some to fit every method on, and others to judge."""

    name: str
    training: TrackSet
    judged: TrackSet

    @property
    def parts(self) -> tuple[TrackSet, TrackSet]:
        """Both parts, those to fit on first."""
        return self.training, self.judged

    @property
    def units(self) -> list[str]:
        """Units that each of the judged comes from: people, or styles of motion capture."""
        return [unit_of(track) for track in self.judged]


def cases(settings: Settings) -> list[Cohort]:
    """People by source, observed as badly as Chen et al. observed theirs.

    Those who stand have classes whose errors last for about a second, as a classifier's on a video do; the
    others have angles with independent errors.
    """
    count = settings.few(40, 6)
    sizes = settings.few(8, 2), settings.few(16, 3)
    found = [Cohort(STANDING, *(_classified(settings, people, k) for k, people in enumerate(sizes)))]
    clips = settings.tracks(*MOCAP)
    if clips is not None:
        for name, patterns in ((WALKERS, (WALKING,)), (ODD, ASKANCE)):
            fitted, judged = halves(clips.select(*patterns).map(thinned))
            found.append(Cohort(name, evenly(fitted, settings.few(12, 2), 2.0), evenly(judged, count, 2.0)))
    salsa = settings.tracks(*SALSA)
    if salsa is not None:
        steps = settings.few(250, 30)
        fitted, judged = halves(salsa.map(lambda track: track[:steps]))
        some = fitted.with_tracks(fitted.tracks[:6]).map(lambda track: track[: steps // 3])
        found.append(Cohort(PARTY, some, judged))
    standing, *recorded = found
    return [
        standing,
        *(
            Cohort(one.name, *(_noisy(tracks, settings.rng(2, k, i)) for i, tracks in enumerate(one.parts)))
            for k, one in enumerate(recorded)
        ),
    ]


def _classified(settings: Settings, people: int, part: int) -> TrackSet:
    """Return people who turn on the spot, seen by classifiers whose errors last."""
    standing = standers(settings.rng(5, part), people=people, seconds=settings.few(20, 6))
    body, head = (
        confusion_of(np.radians(error), n)
        for error, n in zip(PAPER["observation"], (BODY_CLASSES, HEAD_CLASSES), strict=True)
    )
    placed = add_noise(standing, position_std=POSITION_STD, rng=settings.rng(6, part))
    return add_class_likelihoods(
        placed, body=body, head=head, persistence=PERSISTENCE, rng=settings.rng(7, part)
    )


def _noisy(tracks: TrackSet, rng: np.random.Generator) -> TrackSet:
    body, head = (concentration_of(np.radians(error)) for error in PAPER["observation"])
    return add_noise(tracks, position_std=POSITION_STD, body_kappa=body, head_kappa=head, rng=rng)


def _observation_errors(track: Track) -> list[float]:
    """Mean errors of body and head as they are observed, in degrees."""
    if track.body_likelihood is None:
        return errors_of(track, track)
    return [most_likely_error(track, track, angle) for angle in ANGLES]


@dataclass(frozen=True, eq=False)
class FittedErrors:
    """The errors of a case's judged people, with default parameters and with those fitted for each method."""

    case: Cohort
    scores: Scores
    models: Models
    fitted: Errors


def _parts(settings: Settings) -> Parts:
    found, evaluations = [], settings.few(60, 7)
    everyone = cases(settings)
    searches = len(FITTED) * sum(not method.endswith(ISAM2) for method in METHODS)
    models = default_models([method for method in METHODS if not method.endswith(ISAM2)])
    settings.expect(
        sum((len(models) + len(FITTED) * len(METHODS)) * len(case.judged) for case in everyone)
        + sum(searches * evaluations * len(case.training) for case in everyone)
    )
    for case in everyone:
        observed = by_angle(("observation", ""), [_observation_errors(track) for track in case.judged])
        estimates = estimated_errors(case.judged, METHODS, models, settings.progress)
        best = fitted_models(case.training, METHODS, evaluations, settings.progress)
        fitted = estimated_errors(case.judged, METHODS, best, settings.progress)
        scores = Scores(case.name, len(case.judged), observed | estimates)
        found.append(FittedErrors(case, scores, best, fitted))
    rng = settings.rng(99)
    yield Table.of(
        "Body and head: observation, nothing coupled, Chen et al.'s separate, Chen et al.'s joint",
        _detail(found, rng),
    )
    yield Table.of("Parameters fitted for each method, on others of the same kind", _parameters(found))
    yield Table.of("Methods compared on the same people, each with its own fit", _pairs(found, rng))
    yield Table.of("Paper / ours: Table 2 of Chen et al. 2011, mean errors in degrees", _published(found))
    yield page(_panels(found, rng), columns=len(found))
    yield (
        "Mean absolute error per person, mean over people. joint − joint-body: paired difference with its "
        "95 % bootstrap interval over people, or over styles of motion capture, whose three actors the "
        "labels do not name; below 0 joint is better."
    )
    yield (
        "What Chen et al. (2011) call separate is joint-body: κ₂ = 0, so that the head does not follow the "
        "body, which does follow the motion. In separate nothing follows anything."
    )
    yield (
        "Observations have the mean error of Chen et al.'s. Those of people who stand and turn are classes "
        f"whose errors last {PERSISTENCE:g} s in the mean; the others are angles with independent errors."
    )
    yield (
        "Fitted: q, D_body, D_head, κ₁ and, in joint, κ₂, for each method, preset and source by its own "
        f"mean error of body and head on other people, or styles, of that source ({evaluations} evaluations "
        "of each). iSAM2 solves the chain's graph, and is run with the parameters fitted to it. No method "
        "learns constants of each person."
    )
    yield (
        "Online estimates use the past alone, offline ones the whole track. Differences between methods are "
        "paired: the same people, the same observations."
    )
    yield (
        "SALSA has a frame every 3 s: in that time 1,000 particles spread so far that few of them are within "
        "the noise of a position, and the particle filter suffers from it."
    )
    if len(found) == 1:
        yield "No recordings were found: only simulated people."


def _detail(found: Sequence[FittedErrors], rng: np.random.Generator) -> Iterator[Row]:
    for one, angle, (method, (group, _)) in product(found, ANGLES, METHODS.items()):
        separate, body, joint = (
            one.scores.errors.get((preset, method, angle), NOT_RUN) for preset in PRESETS
        )
        own_body, own_joint = (one.fitted[preset, method, angle] for preset in FITTED)
        units = one.case.units
        yield {
            "data": one.case.name,
            "people": len(one.case.judged),
            "units": len(set(units)),
            "angle": angle,
            "group": group,
            "method": method,
            "observation (°)": one.scores.mean("observation", "", angle),
            "separate (°)": float(separate.mean()),
            "joint-body (°)": float(body.mean()),
            "joint (°)": float(joint.mean()),
            **paired("joint − joint-body (°)", joint, body, rng, units=units),
            "joint-body, fitted (°)": float(own_body.mean()),
            "joint, fitted (°)": float(own_joint.mean()),
            **paired(
                *("joint − joint-body, fitted (°)", own_joint, own_body, rng, "fitted: low", "fitted: high"),
                units=units,
            ),
        }


def _parameters(found: Sequence[FittedErrors]) -> Iterator[Row]:
    """The parameters fitted for each method, with the package's own first, and those at a search's limit."""

    def row(data: str, preset: str, method: str, model: Model) -> Row:
        start = Model(preset).parameters
        names = FITTED[preset]
        known = {
            label: model.parameters.value(name) if name in names else None for label, name in SHARED.items()
        }
        ended = [
            label
            for label, name in SHARED.items()
            if name in names and at_limit(start.value(name), model.parameters.value(name))
        ]
        return {"data": data, "preset": preset, "method": method, **known, "at the limit": ", ".join(ended)}

    yield row("", "joint", "default", Model("joint"))
    for one in found:
        for (preset, method), model in one.models.items():
            if not method.endswith(ISAM2):
                yield row(one.case.name, preset, method, model)


def _pairs(found: Sequence[FittedErrors], rng: np.random.Generator) -> Iterator[Row]:
    """Paired differences of `PAIRS` with the parameters fitted for each method."""
    for one, preset, angle, (first, second) in product(found, FITTED, ANGLES, PAIRS):
        mine, other = (one.fitted[preset, method, angle] for method in (first, second))
        yield {
            "data": one.case.name,
            "model": preset,
            "angle": angle,
            "difference": f"{first} − {second}",
            **paired("fitted (°)", mine, other, rng, units=one.case.units),
        }


def _published(found: Sequence[FittedErrors]) -> Iterator[Row]:
    """Chen et al.'s Table 2 next to ours with default parameters and with those of each method."""
    for one, (method, (group, _)) in product(found, METHODS.items()):
        row: dict[str, Cell] = {"ours: data": one.case.name, "ours: method": f"{method} ({group})"}
        for i, angle in enumerate(ANGLES):
            row |= {f"{angle}, paper: {name}": values[i] for name, values in PAPER.items()}
            row[f"{angle}, ours: observation"] = one.scores.mean("observation", "", angle)
            for name, preset in (("separate", "joint-body"), ("joint", "joint")):
                row[f"{angle}, ours: {name}, default"] = one.scores.mean(preset, method, angle)
                row[f"{angle}, ours: {name}, fitted"] = float(one.fitted[preset, method, angle].mean())
        yield row


def _panels(found: Sequence[FittedErrors], rng: np.random.Generator) -> list[Panel]:
    panels, order = [], ("observation", *PRESETS)
    for (i, angle), one in product(enumerate(ANGLES), found):
        published = {"method": "Chen et al. 2011", "low": None, "high": None}
        rows: list[Row] = [
            {"model": preset, "error": PAPER[name][i], **published}
            for preset, name in (("joint-body", "separate"), ("joint", "joint"))
        ]
        rows += [
            {
                "model": preset,
                "method": method or "observation",
                **mean_interval("error", errors, rng, one.case.units),
            }
            for (preset, method, of), errors in {**one.scores.errors, **one.fitted}.items()
            if of == angle and preset != "separate"
        ]
        rows.sort(key=lambda row: order.index(str(row["model"])))
        title = f"{one.case.name}: {angle} (°), fitted"
        panels.append(Panel(title, rows, "model", "error", "method", ends=("low", "high")))
    return panels


EXPERIMENT = Experiment(
    "chen-joint",
    "Chen et al. 2011, Table 2: observation, separate and joint filtering",
    "4 to 9 people of each source",
    _parts,
)
