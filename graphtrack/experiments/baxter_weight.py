"""Baxter et al. 2014, eq. 2–3: does a weight that grows with the deviation of the head fit better than a
constant one?"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from graphtrack.baselines.intentional import GrowingRate, intentional_states
from graphtrack.experiments.harness import (
    GAITS,
    LAG,
    MOCAP,
    Cell,
    Experiment,
    Panel,
    Parts,
    Progress,
    Row,
    Settings,
    Table,
    evenly,
    fit,
    from_the_past,
    halves,
    model_of,
    one_step_ahead,
    paired,
    thinned,
    unit_of,
)
from graphtrack.geometry.angles import FloatArray
from graphtrack.model import Parameters
from graphtrack.simulation.corpus import NUMERALS, CorpusParameters, simulate_behaviour
from graphtrack.simulation.degrade import add_noise
from graphtrack.tracking import track_online
from graphtrack.tracks.track import Track

CONSTANT, GROWS, FALLS = "constant", "grows", "falls"
WEIGHTS = {CONSTANT: 0.0, GROWS: 1.0, FALLS: -1.0}
"""Dependence of λ on the deviation → sign of ρ."""

ENDS = {weight: (f"{weight}: low", f"{weight}: high") for weight in (GROWS, FALLS)}
"""Weights that are compared with a constant one → columns of the ends of the interval."""

GRAPH = "graph, joint-intentional"
METHODS = ("intentional", GRAPH)

OBSERVED_EVERY = 5
"""Positions of motion capture are observed twice a second, so that a prediction is one over half a second."""

GROWTH, OFFSET = 1.5, 0.5
"""Start of the searches: |ρ| in 1/rad and τ in radians."""


@dataclass(frozen=True, eq=False)
class WeightData:
    """Tracks to fit on and others to judge on.

    Attributes
    ----------
    name : in tables
    seconds : over which deviations are averaged
    fitted, judged : tracks
    """

    name: str
    seconds: float
    fitted: Sequence[Track]
    judged: Sequence[Track]


@dataclass(frozen=True, eq=False)
class Found:
    """The fit of a source, method and weight, and the likelihood of the judged tracks.

    Attributes
    ----------
    rate : λ as a function of the deviation
    nats : (n,) mean log-likelihood of an observed position, of each judged track
    units : (n,) people, or styles of motion capture
    """

    rate: GrowingRate
    nats: FloatArray
    units: list[str]


def sources(settings: Settings) -> list[WeightData]:
    """The corpus at two detection rates and, where it is there, motion capture."""
    found, count = [], settings.few(6)
    parts: list[list[Track]]
    for share in (1.0, 0.6):
        parts = []
        for stream, tracks in ((1, max(count // 3, 1)), (2, count)):
            corpora = [
                simulate_behaviour(b, CorpusParameters(tracks=tracks), rng=settings.rng(stream, b)).detected(
                    share, settings.rng(stream, b, round(100 * share))
                )
                for b in range(len(NUMERALS))
            ]
            parts.append([track for corpus in corpora for track in corpus.tracks()])
        found.append(WeightData(f"corpus, {share:.0%} detected", 2.5, *parts))
    clips = settings.tracks(*MOCAP)
    if clips is None:
        return found
    for i, (name, patterns) in enumerate(GAITS.items()):
        parts = [
            [
                _thinned(track)
                for track in add_noise(
                    evenly(half, settings.few(40, 3), 2.5),
                    position_std=0.05,
                    head_kappa=4.0,
                    rng=settings.rng(3, i, k),
                )
            ]
            for k, half in enumerate(halves(clips.select(*patterns).map(thinned)))
        ]
        found.append(WeightData(name, 1.0, *parts))
    return found


def _thinned(track: Track) -> Track:
    """The track with a position in every so many-th frame, and the head in all."""
    position = np.where((np.arange(len(track)) % OBSERVED_EVERY == 0)[:, None], track.position, np.nan)
    return replace(track, position=position, body=None, true_body=None)


def _mean(logs: FloatArray) -> float:
    return float(np.nanmean(logs)) if np.isfinite(logs).any() else float("nan")


def tracker_nats(tracks: Sequence[Track], density: float, rate: GrowingRate) -> FloatArray:
    """Of the intentional tracker, (n,) one number a track."""
    values = {"motion.acceleration_density": density, "motion.head_rate": rate.rate}
    parameters = Parameters().with_values(values)
    found = [intentional_states(rate.given_to(track), parameters).log_likelihood for track in tracks]
    return np.array([_mean(logs) for logs in found])


def graph_nats(
    tracks: Sequence[Track], density: float, factor: float, rate: GrowingRate, every: int = 1
) -> FloatArray:
    """Of the online graph, (n,) one number a track.

    Parameters
    ----------
    every : 1: of all frames, by the tracker; else of every so many-th one with a position, which is faster
    """
    model, found = model_of("joint-intentional")(density, factor, rate.rate), []
    for track in tracks:
        given = rate.given_to(track)
        if every == 1:
            estimate = track_online(given, model, engine="chain", lag=LAG, constants="default")
        else:
            has_position = np.flatnonzero(np.isfinite(track.position).all(axis=1))
            estimate = from_the_past(given, model, has_position[2::every] - 1)
        found.append(_mean(one_step_ahead(estimate, given, model)[1]))
    return np.array(found)


def fitted(source: WeightData, method: str, evaluations: int, progress: Progress) -> dict[str, Found]:
    """A constant rate and rates that grow and fall with the deviation, each as likely as it can be on the
    source's tracks to fit on.

    The searches of the rates that change begin at the best constant one of the first round; all have a second
    round, as long as each other's.
    """
    graph = method == GRAPH

    def nats(tracks: Sequence[Track], sign: float, values: Sequence[float], fast: bool) -> FloatArray:
        density, *rest = values
        factor = rest.pop(0) if graph else 1.0
        rate = _rate(source, sign, rest)
        if not graph:
            return tracker_nats(tracks, density, rate)
        return graph_nats(tracks, density, factor, rate, 8 if fast and len(tracks[0]) > 100 else 1 + fast)

    found: dict[str, Found] = {}
    start: tuple[float, ...] = (0.2, 3.0, 0.5) if graph else (0.2, 0.5)
    for weight, sign in WEIGHTS.items():

        def cost(*values: float, sign: float = sign) -> float:
            progress(1)
            return -float(np.nanmean(nats(source.fitted, sign, values, True)))

        begin = start if weight == CONSTANT else (*start, GROWTH, OFFSET)
        best = fit(cost, begin, evaluations=evaluations)
        if weight == CONSTANT:
            start = best
        # Once more from there, so that no weight is ahead for having been searched for longer.
        best = fit(cost, best, evaluations=2 * evaluations)
        rest = best[2:] if graph else best[1:]
        units = [unit_of(track) for track in source.judged]
        found[weight] = Found(_rate(source, sign, rest), nats(source.judged, sign, best, False), units)
    return found


def _rate(source: WeightData, sign: float, values: Sequence[float]) -> GrowingRate:
    rate, *shape = values
    growth, offset = shape or (0.0, 0.0)
    return GrowingRate(rate, sign * growth, offset, source.seconds)


def _parts(settings: Settings) -> Parts:
    evaluations, known = settings.few(35, 6), sources(settings)
    settings.expect(len(known) * len(METHODS) * 9 * evaluations)
    results = {
        (source.name, method): fitted(source, method, evaluations, settings.progress)
        for source in known
        for method in METHODS
    }
    yield Table.of(
        "Weight of the head: what was fitted, and log-likelihood of held-out tracks",
        (
            _detail(data, method, weight, found)
            for (data, method), by_weight in results.items()
            for weight, found in by_weight.items()
        ),
    )
    published = Table.of(
        "Paper / ours: log-likelihood of held-out tracks, paired with a constant weight",
        _published(results, settings.rng(99)),
    )
    yield published
    for weight, ends in ENDS.items():
        name = f"{weight} − constant"
        rows = published.records()
        yield Panel(name, rows, "ours: data", f"{name} (nats)", "ours: method", ends=ends, level=0.0)
    yield (
        "λ_t = 2λ/(1 + exp(−ρ(ŝ_t − τ))), ŝ the mean deviation of the observed head from the direction "
        "of travel before each step: over 2.5 s on the corpus (Baxter et al.: eleven steps), 1 s on "
        "motion capture. Constant: ρ = 0; grows: ρ > 0, as in Baxter et al.; falls: ρ < 0."
    )
    yield (
        "All parameters of each (q, λ, of the graph the strength of the couplings, then ρ and τ) are "
        "those that make the innovations of other tracks most likely."
    )
    yield (
        "Motion capture: positions twice a second with 0.05 m of noise, heads ten times a second with "
        "κ = 4; fitted and judged clips have other styles. Differences in nats for an observed position, "
        "paired by track, with 95 % bootstrap intervals over people, or over styles of motion capture."
    )


def _detail(data: str, method: str, weight: str, found: Found) -> Row:
    at_rest, at_right_angles = found.rate.of(np.array([0.0, np.pi / 2.0]))
    return {
        "data": data,
        "method": method,
        "weight": weight,
        "λ (1/s)": found.rate.rate,
        "ρ (1/rad)": found.rate.growth,
        "τ (°)": float(np.degrees(found.rate.offset)),
        "λ at 0° (1/s)": float(at_rest),
        "λ at 90° (1/s)": float(at_right_angles),
        "tracks": len(found.nats),
        "nats": float(np.nanmean(found.nats)),
    }


def _published(
    results: Mapping[tuple[str, str], Mapping[str, Found]], rng: np.random.Generator
) -> Iterator[Row]:
    for (data, method), by_weight in results.items():
        record: dict[str, Cell] = {
            "paper": "the weight grows with the deviation",
            "ours: data": data,
            "ours: method": method,
            "tracks": len(by_weight[CONSTANT].nats),
        }
        for weight, ends in ENDS.items():
            nats = by_weight[weight].nats, by_weight[CONSTANT].nats
            record |= paired(f"{weight} − constant (nats)", *nats, rng, *ends, units=by_weight[weight].units)
        yield record


EXPERIMENT = Experiment(
    "baxter-weight",
    "Baxter et al. 2014, eq. 2–3: a weight of the head that grows with its deviation, or a constant one",
    "1 track of each behaviour and 3 clips of each kind",
    _parts,
)
