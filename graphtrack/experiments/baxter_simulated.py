"""Baxter et al. 2014, §IV-A, Fig. 4: gain over the Kalman filter on the simulated corpus."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from graphtrack.baselines.intentional import OWN_FILTERS, intentional_filter, steer
from graphtrack.baselines.kalman import FilteredStates
from graphtrack.evaluation.metrics import Interval, bootstrap, deviation, mean_difference
from graphtrack.experiments.harness import (
    ENGINES,
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
    interval_cells,
    model_of,
    squared_error,
    with_density,
)
from graphtrack.experiments.harness import PREDICTED as METHODS
from graphtrack.geometry.angles import FloatArray
from graphtrack.model import Parameters
from graphtrack.simulation.corpus import NUMERALS, Corpus, CorpusParameters, simulate_behaviour

RATES = (1.0, 0.8, 0.6)

RIVAL, NO_HEAD = "intentional", "kf fitted"
"""The fitted tracker that the graphs are compared with, track by track, and the fitted Kalman filter, which
has no head: what is gained over it the head adds."""

COMPARED = {
    RIVAL: tuple(m for m in METHODS if m.startswith("graph")),
    NO_HEAD: tuple(m for m in METHODS if m != NO_HEAD),
}
"""Rival → methods that are compared with it."""

ALL_ENGINES = 12
"""Tracks of each behaviour that iSAM2 solves too; the compiled chain solves the same graph on all of them."""

FIT_UNITS = {"graph joint": 20, "graph joint-intentional": 30}
"""Evaluations of the search for the parameters of each graph, two of them and three; half with ``quick``."""


@dataclass(frozen=True, eq=False)
class Gain:
    """Gains over the Kalman filter of Baxter et al. 2014, one number a track.

    Attributes
    ----------
    error, likelihood : ratios of the squared errors and of the cumulative log-likelihoods
    nats : mean log-likelihood of an innovation
    """

    behaviour: int
    rate: float
    method: str
    error: FloatArray
    likelihood: FloatArray
    nats: FloatArray


def steered(corpus: Corpus, parameters: Parameters, rate: float) -> FilteredStates:
    """The intentional tracker in continuous time on all tracks; the Kalman filter with a rate of 0."""
    t = np.arange(corpus.head.shape[1], dtype=np.float64) * corpus.parameters.step_seconds
    variance = np.full(corpus.head.shape, corpus.parameters.observation_std**2)
    return steer(corpus.position, corpus.head, t, variance, parameters, rate)


def fit_methods(settings: Settings) -> Fitted:
    """Each method's parameters, those that make the innovations of training tracks most likely."""
    training = [
        simulate_behaviour(b, CorpusParameters(tracks=10), rng=settings.rng(9, b)).detected(
            0.8, settings.rng(9, b, 1)
        )
        for b in range(len(NUMERALS))
    ]
    position, head = (
        np.concatenate([getattr(one, name) for one in training]) for name in ("position", "head")
    )
    everyone = replace(training[0], position=position, head=head)

    def cost(density: float, rate: float) -> float:
        found = steered(everyone, with_density(Parameters(), density), rate)
        return -float(np.nanmean(found.log_likelihood))

    kalman = with_density(Parameters(), *fit(lambda q: cost(q, 0.0), [0.1], evaluations=25))
    density, rate = fit(cost, [0.1, 1.0], evaluations=40)
    people = [p for corpus in training for p in corpus.tracks(settings.few(4))]
    graphs = {}
    for method, more in (("graph joint", ()), ("graph joint-intentional", (rate,))):
        units = FIT_UNITS[method] // settings.few(1, 2)
        make, start = model_of(GRAPHS[method]), (density, 3.0, *more)
        graphs[method] = fitted_graph(make, people, start, units, settings.progress)
    return Fitted(kalman, with_density(Parameters(), density), rate, graphs)


def gains(corpus: Corpus, rate: float, fitted: Fitted, people: int, progress: Progress) -> list[Gain]:
    """The gains of every method on one behaviour at one detection rate.

    Error is the ratio of the sums of squared distances between one-step predictions and true positions,
    likelihood that of the cumulative log-likelihoods of the innovations; above 1 the method is better.
    """
    reference = intentional_filter(corpus.position, None)
    count = np.isfinite(reference.log_likelihood).sum(axis=1)
    runs = {
        method: intentional_filter(corpus.position, corpus.head, parameters)
        for method, parameters in OWN_FILTERS.items()
    }
    runs["kf fitted"] = steered(corpus, fitted.kalman, 0.0)
    runs["intentional"] = steered(corpus, fitted.intentional, fitted.rate)

    def outcome(run: FilteredStates) -> tuple[FloatArray, FloatArray]:
        """Sums of squared errors and of log-likelihoods, one number a track."""
        error = squared_error(run.predicted_mean[..., :2], corpus.truth)
        return error, np.nansum(run.log_likelihood, axis=1)

    outcomes = {method: outcome(run) for method, run in runs.items()}
    by_graph: dict[str, list[tuple[float, float]]] = {}
    for k, track in enumerate(corpus.tracks(people)):
        engines = ENGINES if k < ALL_ENGINES else {"": ENGINES[""]}
        for method, predicted, logs in graph_predictions(track, fitted.graphs, engines):
            own = float(squared_error(predicted, track.true_position)), float(np.nansum(logs))
            by_graph.setdefault(method, []).append(own)
            progress(1)
    for method, of_tracks in by_graph.items():
        errors, sums = np.array(of_tracks).T
        outcomes[method] = errors, sums
    error, likelihood = outcome(reference)
    return [
        Gain(
            corpus.behaviour,
            rate,
            method,
            error[: len(errors)] / errors,
            likelihood[: len(errors)] / sums,
            sums / count[: len(errors)],
        )
        for method, (errors, sums) in outcomes.items()
    ]


def _parts(settings: Settings) -> Parts:
    people, fits = settings.few(500), sum(FIT_UNITS.values()) // settings.few(1, 2)
    runs = people + min(people, ALL_ENGINES)
    settings.expect(fits + runs * len(GRAPHS) * len(NUMERALS) * len(RATES))
    fitted = fit_methods(settings)
    parameters = CorpusParameters(tracks=settings.few(500, 60))
    found: list[Gain] = []
    names = []
    for behaviour in range(len(NUMERALS)):
        everyone = simulate_behaviour(behaviour, parameters, rng=settings.rng(1, behaviour))
        names.append(everyone.name)
        for k, rate in enumerate(RATES):
            corpus = everyone.detected(rate, settings.rng(2, behaviour, k))
            found += gains(corpus, rate, fitted, people, settings.progress)
    records: list[Row] = [
        {
            "behaviour": names[gain.behaviour],
            "detection %": round(100 * gain.rate),
            "method": gain.method,
            "tracks": len(gain.error),
            "MSE gain, median": float(np.median(gain.error)),
            "MSE gain, std": deviation(gain.error),
            "CLL gain, median": float(np.median(gain.likelihood)),
            "CLL gain, std": deviation(gain.likelihood),
        }
        for gain in found
    ]
    yield Table.of(
        "Gain over the Kalman filter of Baxter et al. 2014 (Q = 0.1·I, R = 0.5·I): ratios, above 1 is better",
        records,
    )
    yield from paired(found, names, settings.rng(98))
    yield Table.of(
        "Paper / ours: medians over the tracks of a behaviour, the least and greatest of them",
        (_published(found, rate, method) for rate in (*RATES, None) for method in METHODS),
    )
    for name, rate in product(("MSE", "CLL"), RATES):
        yield Panel(
            f"{name} gain over the Kalman filter, {rate:.0%} detected",
            [record for record in records if record["detection %"] == round(100 * rate)],
            *("behaviour", f"{name} gain, median", "method"),
            spread=f"{name} gain, std",
            level=1.0,
        )
    joint, steered = (fitted.graphs[method].parameters.motion for method in GRAPHS)
    yield (
        "MSE: one-step predictions against true positions. CLL: cumulative log-likelihood of the innovations."
    )
    yield (
        "printed and consistent have Baxter et al.'s parameters. The others are fitted on other tracks: q of "
        f"the graphs {joint.acceleration_density:.3g} and {steered.acceleration_density:.3g} m²/s³, λ of the "
        f"tracker {fitted.rate:.3g} 1/s and of joint-intentional {steered.head_rate:.3g} 1/s."
    )
    yield (
        "Against the fitted tracker, and against the fitted Kalman filter without a head: on the same "
        f"tracks, {ALL_ENGINES} of each behaviour for iSAM2. Ratio of the squared errors: geometric mean "
        "over the tracks, below 1 the method is better; nats a detection: above 0 it is better. A cell is a "
        "behaviour at a detection rate; clearly: by its 95 % interval over tracks."
    )
    yield (
        "Without a detection the head is missing too. All use positions and head, but the Kalman filters "
        "positions only. In joint-intentional the head steers the velocity as it does in the tracker; in "
        "joint it does not."
    )


def paired(found: Sequence[Gain], names: Sequence[str], rng: np.random.Generator) -> tuple[Table, Table]:
    """Methods against their rivals on the same tracks: each behaviour and rate, and how many of them are won.

    Parameters
    ----------
    names : of the behaviours
    rng : source of the intervals' resampling
    """
    cells: list[dict[str, Cell]] = []
    by_cell = {(one.behaviour, one.rate, one.method): one for one in found}
    pairs = [(own, name) for name, methods in COMPARED.items() for own in found if own.method in methods]
    for own, name in pairs:
        rival = by_cell.get((own.behaviour, own.rate, name))
        if rival is None:
            continue
        tracks = len(own.error)
        log_ratio = bootstrap(mean_difference, np.log(rival.error[:tracks]), np.log(own.error), rng=rng)
        ratio = Interval(*np.exp([log_ratio.value, log_ratio.low, log_ratio.high]).tolist())
        nats = bootstrap(mean_difference, own.nats, rival.nats[:tracks], rng=rng)
        cells.append(
            {
                "behaviour": names[own.behaviour],
                "detection %": round(100 * own.rate),
                "method": own.method,
                "against": name,
                "tracks": tracks,
                **interval_cells("squared error / rival's", ratio, "ratio: low", "ratio: high"),
                **interval_cells("nats a detection − rival's", nats, "nats: low", "nats: high"),
            }
        )
    kinds = dict.fromkeys((cell["method"], cell["against"]) for cell in cells)
    counts = [
        _counted([cell for cell in cells if (cell["method"], cell["against"]) == kind]) for kind in kinds
    ]
    return (
        Table.of("Methods against a rival on the same tracks, 95 % intervals", cells),
        Table.of("Methods against a rival: cells won and lost", counts),
    )


def _counted(cells: Sequence[Row]) -> dict[str, Cell]:
    """Numbers of cells that a method wins and loses against a rival, and of those outside the interval."""

    def column(name: str) -> FloatArray:
        return np.array([cell[name] for cell in cells], dtype=float)

    ratio, nats = column("squared error / rival's"), column("nats a detection − rival's")
    return {
        "method": cells[0]["method"],
        "against": cells[0]["against"],
        "cells": len(cells),
        "tracks": sum(int(cell["tracks"] or 0) for cell in cells),
        "squared error: better": int((ratio < 1.0).sum()),
        "squared error: clearly better": int((column("ratio: high") < 1.0).sum()),
        "squared error: clearly worse": int((column("ratio: low") > 1.0).sum()),
        "ratio, least": float(ratio.min()),
        "ratio, greatest": float(ratio.max()),
        "likelihood: better": int((nats > 0.0).sum()),
        "likelihood: clearly better": int((column("nats: low") > 0.0).sum()),
        "likelihood: clearly worse": int((column("nats: high") < 0.0).sum()),
        "nats, least": float(nats.min()),
        "nats, greatest": float(nats.max()),
    }


PUBLISHED = {
    None: "above 1 throughout",
    1.0: "above 1 on all seven trajectories, both measures",
    0.8: "above 1 (Fig. 5, simulated)",
    0.6: "above 1 (Fig. 5, simulated); video + 12 %",
}


def _published(found: Sequence[Gain], rate: float | None, method: str) -> Row:
    """A statement of Baxter et al. (2014), the least and greatest of our medians over the behaviours.

    ``rate``: share that is detected; None: all of them
    """
    own = [gain for gain in found if gain.method == method and rate in (None, gain.rate)]
    alone = {(gain.behaviour, gain.rate): gain for gain in found if gain.method == NO_HEAD}
    errors = [float(np.median(gain.error)) for gain in own]
    sums = [float(np.median(gain.likelihood)) for gain in own]
    rivals = [alone[gain.behaviour, gain.rate].error[: len(gain.error)] for gain in own]
    heads = [float(np.median(gain.error / rival)) for gain, rival in zip(own, rivals, strict=True)]
    return {
        "detection %": "all" if rate is None else round(100 * rate),
        "paper (intentional tracker)": PUBLISHED[rate],
        "ours": method,
        "tracks": sum(len(gain.error) for gain in own),
        "MSE gain, least": min(errors),
        "MSE gain, greatest": max(errors),
        "MSE gain over a fitted filter, least": min(heads),
        "MSE gain over a fitted filter, greatest": max(heads),
        "CLL gain, least": min(sums),
        "CLL gain, greatest": max(sums),
        "cells": len(own),
        "cells won": sum(e > 1.0 and s > 1.0 for e, s in zip(errors, sums, strict=True)),
    }


EXPERIMENT = Experiment(
    "baxter-simulated",
    "Baxter et al. 2014, Fig. 4 and 5: simulated corpus, gain over the Kalman filter, median ± 1 σ",
    "60 tracks of each behaviour for the filters, 1 for the graphs",
    _parts,
)
