"""Baxter et al. 2014, §IV-B, Fig. 5(a): one-step prediction of CAVIAR's people with labelled heads.

Filters are fitted on some of the people; controls change one condition at a time.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from graphtrack.baselines.intentional import (
    OWN_FILTERS,
    IntentionalParameters,
    intentional_filter,
    intentional_states,
)
from graphtrack.experiments.baxter_statistics import travel_velocity
from graphtrack.experiments.harness import (
    GRAPHS,
    Cell,
    Experiment,
    Fitted,
    Panel,
    Parts,
    Progress,
    Row,
    Settings,
    Table,
    fit,
    fitted_graph,
    graph_predictions,
    model_of,
    quietly,
    squared_error,
)
from graphtrack.experiments.harness import PREDICTED as METHODS
from graphtrack.geometry.angles import FloatArray, difference, direction, wrap
from graphtrack.model import Model, Parameters
from graphtrack.tracks.track import Track

LEAST_LABELS = 50
"""Labelled heads of a person that is judged: 2 s at 25 frames a second."""

People = Mapping[str, Track]
"""Sequence and number of a person → stretch of labelled heads; labelled positions are also the truth."""


def people(settings: Settings) -> dict[str, Track]:
    """Everybody with enough labelled heads in the CAVIAR sequences that are there."""
    folder = None if settings.data is None else settings.data / "caviar"
    if folder is None or not folder.is_dir():
        return {}
    return {
        f"{path.stem} {track.track_id}": stretch
        for path in sorted(folder.rglob("*.xml"))
        for track in quietly(path)
        if (stretch := labelled_stretch(track)) is not None
    }


def labelled_stretch(track: Track) -> Track | None:
    """From the first labelled head to the last, without the body; None where there are too few."""
    if track.head is None:
        return None
    labels = np.flatnonzero(np.isfinite(track.head))
    if len(labels) < LEAST_LABELS:
        return None
    part = track[int(labels[0]) : int(labels[-1]) + 1]
    return replace(part, body=None, body_kappa=None, true_position=part.position)


def detected(track: Track, rate: float, rng: np.random.Generator) -> Track:
    """Return a person observed at a share of the frames, including the first, with the head."""
    labelled = rng.random(len(track)) < rate
    labelled[0] = True
    position = np.where(labelled[:, None], track.position, np.nan)
    head = None if track.head is None else np.where(labelled, track.head, np.nan)
    pixel = None if track.pixel is None else np.where(labelled[:, None], track.pixel, np.nan)
    return replace(track, position=position, head=head, pixel=pixel)


def with_noise(density: float, std: float) -> Parameters:
    """Parameters with q in m²/s³ and 1-σ of the positions in metres."""
    values = {"motion.acceleration_density": density, "likelihood.position_std": std}
    return Parameters().with_values(values)


def fit_filters(training: Sequence[Track], progress: Progress, *, quick: bool) -> Fitted:
    """Fit the parameters of each method by the likelihood of the innovations on the training tracks.

    The graphs keep the noise of the positions that the Kalman filter's fit has found.
    """

    def cost(density: float, std: float, rate: float) -> float:
        parameters = with_noise(density, std)
        found = [intentional_states(track, parameters, rate).log_likelihood for track in training]
        return -float(np.nanmean(np.concatenate(found, axis=1)))

    effort = 2 if quick else 1
    density, std = fit(lambda q, s: cost(q, s, 0.0), [1.0, 0.05], evaluations=40 // effort)
    *own, rate = fit(cost, [density, std, 1.0], evaluations=60 // effort)
    progress(1)
    graphs: dict[str, Model] = {}
    for name, more in (("graph joint", ()), ("graph joint-intentional", (float(np.clip(rate, 0.1, 30.0)),))):
        start = (density, 3.0, *more)
        make = model_of(GRAPHS[name], with_noise(density, std))
        graphs[name] = fitted_graph(make, training, start, (8 + 8 * len(start)) // effort**2)
        progress(1)
    return Fitted(with_noise(density, std), with_noise(own[0], own[1]), rate, graphs)


FITS = 1 + len(GRAPHS)
"""Units of progress of `fit_filters`."""


def own_outcome(track: Track, parameters: IntentionalParameters, *, steered: bool) -> tuple[float, float]:
    """Sum of squared errors and CLL of Baxter et al.'s filter; not steered, of the Kalman filter of its Q
    and R."""
    found = intentional_filter(track.position, track.head if steered else None, parameters)
    error = squared_error(found.predicted_mean[0, :, :2], track.true_position)
    return float(error), float(np.nansum(found.log_likelihood))


def outcomes(track: Track, fitted: Fitted) -> dict[str, tuple[float, float]]:
    """Method → sum of squared errors (m²) and CLL of its one-step predictions; "kf" is Baxter et al.'s."""
    found = {"kf": own_outcome(track, IntentionalParameters(), steered=False)}
    found |= {name: own_outcome(track, own, steered=True) for name, own in OWN_FILTERS.items()}
    for name, parameters, rate in (
        ("kf fitted", fitted.kalman, 0.0),
        ("intentional", fitted.intentional, fitted.rate),
    ):
        states = intentional_states(track, parameters, rate)
        error = squared_error(states.predicted_mean[0, :, :2], track.true_position)
        found[name] = float(error), float(np.nansum(states.log_likelihood))
    for name, predicted, logs in graph_predictions(track, fitted.graphs):
        found[name] = float(squared_error(predicted, track.true_position)), float(np.nansum(logs))
    return found


Change = Callable[[Track, np.random.Generator], Track]
Adaptation = Callable[[IntentionalParameters], IntentionalParameters]

LIGHT = 3.5
"""τ of eq. 3 with which a head in the bin of the travel has a weight of 0.005, not 0.905."""

LABEL_STD = 0.07
"""Metres, 1 σ of the labelled positions fitted with the Kalman filter; Baxter et al.'s R is 0.71."""


@dataclass(frozen=True)
class Control:
    """A change to the data or to the parameters.

    Attributes
    ----------
    name : in tables
    change : of a track; by default none
    adapt : Baxter et al.'s parameters to others, for the Kalman filter too
    random : whether the change is drawn, so that it is repeated
    """

    name: str
    change: Change = lambda track, rng: track
    adapt: Adaptation = lambda parameters: parameters
    random: bool = False


def turned_around(track: Track, rng: np.random.Generator) -> Track:
    """Heads that face the other way."""
    return replace(track, head=wrap(np.asarray(track.head) + np.pi))


def at_random(track: Track, rng: np.random.Generator) -> Track:
    """Uninformative heads."""
    drawn = rng.uniform(-np.pi, np.pi, len(track))
    return replace(track, head=np.where(np.isfinite(np.asarray(track.head)), drawn, np.nan))


def as_travelled(track: Track, rng: np.random.Generator) -> Track:
    """Heads without any deviation: the direction of the mean velocity over 24 frames, those ahead too."""
    travel = direction(travel_velocity(track))
    return replace(track, head=np.where(np.isfinite(np.asarray(track.head)), travel, np.nan))


def shuffled(track: Track, rng: np.random.Generator) -> Track:
    """The same deviations from the travel, in another order: noise of each frame, not of a label's length."""
    head, travel = np.asarray(track.head), direction(travel_velocity(track))
    known = np.flatnonzero(np.isfinite(head) & np.isfinite(travel))
    found = head.copy()
    off = difference(head[known], travel[known])
    found[known] = wrap(travel[known] + rng.permutation(off))
    return replace(track, head=found)


def every(count: int) -> Change:
    """A lower frame rate; a step of the filter is that much longer."""
    return lambda track, rng: track[np.arange(0, len(track), count)]


def noisy(std: float) -> Change:
    """Positions with noise (metres), judged against those without."""

    def change(track: Track, rng: np.random.Generator) -> Track:
        return replace(track, position=track.position + std * rng.standard_normal((len(track), 2)))

    return change


def scaled(factor: float) -> Change:
    """Another unit of length, with Baxter et al.'s Q and R as numbers."""

    def change(track: Track, rng: np.random.Generator) -> Track:
        truth = np.asarray(track.true_position)
        return replace(track, position=factor * track.position, true_position=factor * truth)

    return change


CONTROLS = (
    Control("as recorded"),
    Control("head turned around", turned_around),
    Control("head at random", at_random, random=True),
    Control("head along the travel", as_travelled),
    Control("deviations shuffled", shuffled, random=True),
    Control("5 frames a second", every(5)),
    Control("2.5 frames a second", every(10)),
    Control("low base weight (τ = 3.5)", adapt=lambda own: replace(own, weight_offset=LIGHT)),
    Control("R = (0.07 m)²", adapt=lambda own: replace(own, observation_variance=LABEL_STD**2)),
    Control("positions ± 0.1 m", noisy(0.1), random=True),
    Control("positions ± 0.25 m", noisy(0.25), random=True),
    Control("positions ± 0.5 m", noisy(0.5), random=True),
    Control("lengths in centimetres", scaled(100.0)),
)


def control_gains(
    tracks: Sequence[Track],
    repetitions: int,
    rng_of: Callable[[int, int], np.random.Generator],
    controls: Sequence[Control] = CONTROLS,
) -> list[Row]:
    """Controls with both of Baxter et al.'s filters: medians of the people's gains over its Kalman filter.

    Parameters
    ----------
    tracks : with all heads and positions
    repetitions : of the controls that are drawn
    rng_of : from the numbers of a control and a repetition to its source of randomness
    controls : changes of the heads
    """
    rows: list[Row] = []
    for c, control in enumerate(controls):
        row: dict[str, Cell] = {"what is changed": control.name}
        for method, own in OWN_FILTERS.items():
            parameters = control.adapt(own)
            times = range(repetitions if control.random else 1)
            ratios = np.array([_ratios(tracks, control, parameters, rng_of(c, k)) for k in times])
            # A CLL gain is NaN where a CLL is positive.
            error, likelihood = np.median(ratios.mean(axis=0), axis=0).tolist()
            row |= {f"{method}: MSE gain": error, f"{method}: CLL gain": likelihood}
        rows.append(row)
    return rows


def _ratios(
    tracks: Sequence[Track], control: Control, parameters: IntentionalParameters, rng: np.random.Generator
) -> FloatArray:
    ratios = []
    for track in tracks:
        changed = control.change(track, rng)
        plain_error, plain = own_outcome(changed, parameters, steered=False)
        error, likelihood = own_outcome(changed, parameters, steered=True)
        gain = plain / likelihood if max(plain, likelihood) < 0.0 else float("nan")
        ratios.append((plain_error / error, gain))
    return np.array(ratios)


RATES = (1.0, 0.8, 0.6)
PAPER = {100: "above 1", 80: "above 1", 60: "1.122"}
"""Baxter et al. 2014, Fig. 5(a) and §IV-B: the CLL gain on CAVIAR by the detection rate in %; the picture has
no numbers."""

FOLDS = 2
QUICK_PEOPLE, QUICK_FRAMES = 4, 100

Outcomes = Mapping[tuple[float, str], FloatArray]
"""(rate, method) → (seeds, people, 2): sum of squared errors in m², CLL."""


def chosen(settings: Settings) -> dict[str, Track]:
    """The people; few frames of few of them with ``quick``."""
    found = people(settings)
    if not settings.quick:
        return found
    return {name: found[name][:QUICK_FRAMES] for name in list(found)[-QUICK_PEOPLE:]}


def seeds_at(rate: float, settings: Settings) -> int:
    """Number of draws of the detections."""
    return 1 if rate == 1.0 else settings.few(10, 2)


def fit_folds(everyone: People, settings: Settings) -> list[Fitted]:
    """For each person the fit on the other half of the people, at a detection rate of 80 %."""
    folds = []
    for fold in range(FOLDS):
        training = [
            detected(track, 0.8, settings.rng(9, k))
            for k, track in enumerate(everyone.values())
            if k % FOLDS != fold
        ]
        folds.append(fit_filters(training, settings.progress, quick=settings.quick))
    return [folds[k % FOLDS] for k in range(len(everyone))]


def judge(everyone: People, fitted: Sequence[Fitted], settings: Settings) -> Outcomes:
    """Every method on every person, at every rate and seed."""
    found: dict[tuple[float, str], FloatArray] = {}
    for r, rate in enumerate(RATES):
        seeds = seeds_at(rate, settings)
        for seed in range(seeds):
            for k, (track, own) in enumerate(zip(everyone.values(), fitted, strict=True)):
                observed = detected(track, rate, settings.rng(1, r, seed, k))
                for method, outcome in outcomes(observed, own).items():
                    empty = np.full((seeds, len(everyone), 2), np.nan)
                    found.setdefault((rate, method), empty)[seed, k] = outcome
                settings.progress(1)
    return found


def gains(found: Outcomes, rate: float, method: str, *, over: str = "kf") -> tuple[FloatArray, FloatArray]:
    """Ratios (seeds, people) of MSE and CLL; above 1 the method is better.

    A ratio of log-likelihoods is undefined unless both are negative: NaN.
    """
    base, own = found[rate, over], found[rate, method]
    both = (base[..., 1] < 0.0) & (own[..., 1] < 0.0)
    return base[..., 0] / own[..., 0], np.where(both, base[..., 1] / own[..., 1], np.nan)


def spread(ratios: FloatArray) -> tuple[float | None, float | None, float | None]:
    """Median, 1 σ over the people, 1 σ of the seeds' medians; None without data."""
    if not np.isfinite(ratios).all():
        return None, None, None
    seeds = float(np.std(np.median(ratios, axis=1))) if len(ratios) > 1 else None
    return float(np.median(ratios)), float(np.std(ratios.mean(axis=0))), seeds


def _parts(settings: Settings) -> Parts:
    everyone = chosen(settings)
    if len(everyone) < FOLDS:
        where = "no folder is named" if settings.data is None else f"looked for in {settings.data / 'caviar'}"
        yield (
            f"nothing to judge: CAVIAR's recordings are missing ({where}; --data names the folder that has "
            f"caviar in it); found {len(everyone)} people with {LEAST_LABELS} labelled heads or more, "
            "two are needed"
        )
        return
    settings.expect(FOLDS * FITS + len(everyone) * sum(seeds_at(rate, settings) for rate in RATES) + 1)
    fitted = fit_folds(everyone, settings)
    found = judge(everyone, fitted, settings)
    changed = control_gains(
        list(everyone.values()), settings.few(10, 2), lambda c, time: settings.rng(2, c, time)
    )
    settings.progress(1)
    detail = Table.of(
        "Gain over the Kalman filter of Baxter et al. 2014: median of the people's ratios, ± 1 σ",
        _detail(found, everyone),
    )
    yield detail
    yield Table.of("Where the gains come from: one thing changed at a time, all detected", changed)
    yield Table.of(
        "Paper / ours: CAVIAR, labelled heads; Baxter et al. (2014) do not give the MSE on video",
        (
            {
                "detection %": row["detection %"],
                "paper: CLL gain": PAPER[int(row["detection %"] or 0)],
                "ours": row["method"],
                **{name: row[name] for name in ("CLL gain", "MSE gain", "MSE gain over kf fitted")},
            }
            for row in detail.records()
            if row["method"] != "kf"
        ),
    )
    yield from _panels(detail, changed)
    stds = [own.kalman.likelihood.position_std for own in fitted[:FOLDS]]
    rates = [own.rate for own in fitted[:FOLDS]]
    yield (
        "Labelled positions, in metres, are observations and truth; MSE is of one-step predictions. "
        "Without a detection the head is missing too. The body is never observed."
    )
    yield (
        "printed and consistent have Baxter et al.'s parameters (Q = 0.1·I, R = 0.5·I). The others are "
        f"fitted on the other half of the people: 1 σ of the positions {stds[0]:.2g} and {stds[1]:.2g} m, "
        f"where Baxter et al.'s R is 0.71 m; λ of the tracker {rates[0]:.2g} and {rates[1]:.2g} 1/s."
    )
    yield (
        "CLL gains have no meaning for methods whose log-likelihood is positive, as it is once the noise "
        "is fitted: nats a detection are to be compared, between fitted methods."
    )
    yield (
        "What the CLL gain is made of: heads turned around or drawn at random give nearly the same one. "
        "Where innovations are far below what R expects, it is the ratio of the log-determinants of "
        "their covariances, which any prior narrows, and it depends on the unit."
    )
    yield (
        "What the MSE loss is made of: R. With Baxter et al.'s Q and R its filter corrects 36 % of an "
        "innovation, the Kalman filter 65 %, so that what the head gets wrong stays for three frames. With R "
        "that of the labels, or with noise like R's, the loss is gone; with heads along the travel, or with "
        "deviations that are new at every frame, it is not."
    )


def _detail(found: Outcomes, everyone: People) -> Iterator[Row]:
    frames = sum(len(track) - 1 for track in everyone.values())
    for rate, method in product(RATES, ("kf", *METHODS)):
        error, likelihood = (spread(ratios) for ratios in gains(found, rate, method))
        fair, _ = gains(found, rate, method, over="kf fitted")
        sums = found[rate, method].sum(axis=1).mean(axis=0)
        yield {
            "detection %": round(100 * rate),
            "method": method,
            "RMSE (m)": float(np.sqrt(sums[0] / frames)),
            "MSE gain": error[0],
            "± people": error[1],
            "± seeds": error[2],
            "MSE gain over kf fitted": float(np.median(fair)),
            "nats a detection": float(sums[1] / (rate * frames)),
            "CLL gain": likelihood[0],
            "± people ": likelihood[1],
            "± seeds ": likelihood[2],
        }


def _panels(detail: Table, changed: Sequence[Row]) -> Iterator[Panel]:
    rows = [row for row in detail.records() if row["method"] != "kf"]
    own = [row for row in rows if row["method"] in OWN_FILTERS]
    x, by, over = "detection %", "method", "gain over Baxter et al.'s Kalman filter"
    yield Panel(f"MSE {over}", rows, x, "MSE gain", by, spread="± people", level=1.0)
    yield Panel(f"CLL {over}", own, x, "CLL gain", by, spread="± people ", level=1.0)
    for gain in ("MSE gain", "CLL gain"):
        cells: list[Row] = [
            {"control": row["what is changed"], "method": method, gain: row[f"{method}: {gain}"]}
            for row in changed
            for method in OWN_FILTERS
        ]
        yield Panel(f"{gain}, one thing changed", cells, "control", gain, by, level=1.0)


EXPERIMENT = Experiment(
    "baxter-caviar",
    "Baxter et al. 2014, Fig. 5(a): CAVIAR with labelled heads, gain over the Kalman filter by "
    "detection rate",
    f"{QUICK_PEOPLE} people, {QUICK_FRAMES} frames of each",
    _parts,
    columns=2,
)
