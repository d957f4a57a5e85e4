"""CAVIAR's people with labelled heads, seen as often as asked, and filters fitted on some of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from graphtrack.baselines.intentional import OWN_FILTERS, IntentionalParameters, intentional_filter
from graphtrack.baselines.intentional_continuous import intentional_states
from graphtrack.evaluation.reproduce.experiment import ISAM2, LAG, Progress, Settings, quietly
from graphtrack.evaluation.reproduce.fitting import fit, with_coupling, with_density, with_head_rate
from graphtrack.evaluation.reproduce.prediction import from_the_past, one_step_ahead
from graphtrack.evaluation.statistics import head_deviation
from graphtrack.geometry.angles import FloatArray, difference
from graphtrack.inference.engines import OnlineEngine
from graphtrack.model import Model, Parameters
from graphtrack.smoothing import track_online
from graphtrack.tracks import Track

LEAST_LABELS = 50
"""Labelled heads of a person that is judged: 2 s at 25 frames a second."""

RELABELLED = float(np.radians(2.0))
"""Change of a head from frame to frame beyond which it was labelled anew: the same direction in the image
turns by less in the world as somebody walks through the wide-angle view."""

GRAPHS = {"graph joint": "joint", "graph joint-intentional": "joint-intentional"}
"""Method → preset."""


@dataclass(frozen=True)
class Person:
    """A person's stretch of labelled heads; the labelled positions are also the truth."""

    sequence: str
    track: Track

    @property
    def name(self) -> str:
        """Sequence and number."""
        return f"{self.sequence} {self.track.track_id}"


def people(settings: Settings) -> list[Person]:
    """Everybody with enough labelled heads in the CAVIAR sequences that are there."""
    folder = None if settings.data is None else settings.data / "caviar"
    if folder is None or not folder.is_dir():
        return []
    return [
        Person(path.stem, stretch)
        for path in sorted(folder.rglob("*.xml"))
        for track in quietly(path)
        if (stretch := labelled_stretch(track)) is not None
    ]


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
    """The person seen at a share of the frames, the first among them; unseen, there is no head either."""
    seen = rng.random(len(track)) < rate
    seen[0] = True
    position = np.where(seen[:, None], track.position, np.nan)
    head = None if track.head is None else np.where(seen, track.head, np.nan)
    pixel = None if track.pixel is None else np.where(seen[:, None], track.pixel, np.nan)
    return replace(track, position=position, head=head, pixel=pixel)


def relabelled_rate(track: Track) -> float:
    """How often a second the labelled head changes."""
    head = np.asarray(track.head)
    head = head[np.isfinite(head)]
    return float(np.sum(np.abs(difference(head[1:], head[:-1])) > RELABELLED) / (track.t[-1] - track.t[0]))


def deviation(track: Track) -> tuple[float, float]:
    """Circular mean and spread (radians) of the direction of travel minus the head, where people move."""
    found = head_deviation(track)
    found = found[np.isfinite(found)]
    if not len(found):
        return float("nan"), float("nan")
    mean = np.angle(np.mean(np.exp(1j * found)))
    return float(mean), float(np.sqrt(np.mean(difference(found, mean) ** 2)))


@dataclass(frozen=True)
class Fitted:
    """What was fitted on some people, to judge others.

    Attributes
    ----------
    kalman, intentional : parameters of each filter
    rate : λ of the intentional tracker, 1/s
    graphs : method → model
    """

    kalman: Parameters
    intentional: Parameters
    rate: float
    graphs: Mapping[str, Model]


def with_noise(density: float, std: float) -> Parameters:
    """Parameters with q in m²/s³ and 1-σ of the positions in metres."""
    parameters = with_density(Parameters(), density)
    return replace(parameters, likelihood=replace(parameters.likelihood, position_std=std))


def fit_filters(training: Sequence[Track], progress: Progress, *, quick: bool) -> Fitted:
    """The parameters that make the innovations on the training tracks most likely, of each method its own.

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

    def graph(preset: str, *start: float) -> Model:
        def model(q: float, factor: float, *head_rate: float) -> Model:
            parameters = with_coupling(with_noise(q, std), factor)
            return Model(preset, with_head_rate(parameters, *head_rate) if head_rate else parameters)

        def graph_cost(*values: float) -> float:
            candidate, logs = model(*values), []
            for track in training:
                before = np.arange(5, len(track), 10)
                logs.append(one_step_ahead(from_the_past(track, candidate, before), track, candidate)[1])
            return -float(np.nanmean(np.concatenate(logs)))

        found = model(*fit(graph_cost, start, evaluations=(8 + 8 * len(start)) // effort**2))
        progress(1)
        return found

    graphs = {
        "graph joint": graph("joint", density, 3.0),
        "graph joint-intentional": graph("joint-intentional", density, 3.0, float(np.clip(rate, 0.1, 30.0))),
    }
    return Fitted(with_noise(density, std), with_noise(own[0], own[1]), rate, graphs)


FITS = 1 + len(GRAPHS)
"""Units of progress of `fit_filters`."""


def prediction_error(predicted: FloatArray, track: Track) -> float:
    """Sum of squared distances (m²) of one-step predictions (n, 2) from the true positions."""
    return float(np.nansum((predicted - np.asarray(track.true_position)) ** 2))


def own_outcome(track: Track, parameters: IntentionalParameters, *, steered: bool) -> tuple[float, float]:
    """Sum of squared errors and CLL of Baxter et al.'s filter; not steered, of the Kalman filter of its Q
    and R."""
    found = intentional_filter(track.position, track.head if steered else None, parameters)
    return prediction_error(found.predicted_mean[0, :, :2], track), float(np.nansum(found.log_likelihood))


def outcomes(track: Track, fitted: Fitted) -> dict[str, tuple[float, float]]:
    """Method → sum of squared errors (m²) and CLL of its one-step predictions; "kf" is Baxter et al.'s."""
    found = {"kf": own_outcome(track, IntentionalParameters(), steered=False)}
    found |= {name: own_outcome(track, own, steered=True) for name, own in OWN_FILTERS.items()}
    for name, parameters, rate in (
        ("kf fitted", fitted.kalman, 0.0),
        ("intentional", fitted.intentional, fitted.rate),
    ):
        states = intentional_states(track, parameters, rate)
        error = prediction_error(states.predicted_mean[0, :, :2], track)
        found[name] = error, float(np.nansum(states.log_likelihood))
    blind = replace(track, true_position=None, true_head=None)
    engines: dict[str, OnlineEngine] = {"": "chain", ISAM2: "isam2"}
    for (name, model), (suffix, engine) in product(fitted.graphs.items(), engines.items()):
        estimate = track_online(blind, model, engine=engine, lag=LAG)
        predicted, logs = one_step_ahead(estimate, track, model)
        found[name + suffix] = prediction_error(predicted, track), float(np.nansum(logs))
    return found
