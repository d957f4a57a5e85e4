"""Baxter et al. 2014, §IV-B, Fig. 5(a): one-step prediction of CAVIAR's people with labelled heads."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from graphtrack.evaluation.reproduce.caviar_controls import CONTROLS, ControlGain, control_gains
from graphtrack.evaluation.reproduce.caviar_people import (
    FITS,
    LEAST_LABELS,
    Person,
    detected,
    fit_filters,
    outcomes,
    people,
    relabelled_rate,
)
from graphtrack.evaluation.reproduce.experiment import (
    Cell,
    Experiment,
    Panel,
    Progress,
    Records,
    Reproduction,
    Settings,
    Table,
    page,
    tabulated,
)
from graphtrack.evaluation.reproduce.fitting import PREDICTED as METHODS
from graphtrack.evaluation.reproduce.fitting import Fitted
from graphtrack.evaluation.statistics import deviation, travel_velocity
from graphtrack.geometry.angles import FloatArray

RATES = (1.0, 0.8, 0.6)
OWN = ("printed", "consistent")
"""Baxter et al.'s filters with its parameters."""

PAPER = {1.0: "above 1", 0.8: "above 1", 0.6: "1.122"}
"""Baxter et al. 2014, Fig. 5(a) and §IV-B: the CLL gain on CAVIAR by the detection rate; the picture has no
numbers."""

FOLDS = 2
QUICK_PEOPLE, QUICK_FRAMES = 4, 100

Outcomes = Mapping[tuple[float, str], FloatArray]
"""(rate, method) → (seeds, people, 2): sum of squared errors in m², CLL."""


def chosen(settings: Settings) -> list[Person]:
    """The people; few frames of few of them with ``quick``."""
    found = people(settings)
    if not settings.quick:
        return found
    return [replace(one, track=one.track[:QUICK_FRAMES]) for one in found[-QUICK_PEOPLE:]]


def seeds_at(rate: float, settings: Settings) -> int:
    """Number of draws of the detections."""
    return 1 if rate == 1.0 else 2 if settings.quick else 10


def fit_folds(everyone: Sequence[Person], settings: Settings, progress: Progress) -> list[Fitted]:
    """For each person what was fitted on the others' half, at a detection rate of 80 %."""
    folds = []
    for fold in range(FOLDS):
        training = [
            detected(one.track, 0.8, settings.rng(9, k))
            for k, one in enumerate(everyone)
            if k % FOLDS != fold
        ]
        folds.append(fit_filters(training, progress, quick=settings.quick))
    return [folds[k % FOLDS] for k in range(len(everyone))]


def judge(
    everyone: Sequence[Person], fitted: Sequence[Fitted], settings: Settings, progress: Progress
) -> Outcomes:
    """Every method on every person, at every rate and seed."""
    found: dict[tuple[float, str], FloatArray] = {}
    for r, rate in enumerate(RATES):
        seeds = seeds_at(rate, settings)
        for seed in range(seeds):
            for k, (one, own) in enumerate(zip(everyone, fitted, strict=True)):
                track = detected(one.track, rate, settings.rng(1, r, seed, k))
                for method, outcome in outcomes(track, own).items():
                    empty = np.full((seeds, len(everyone), 2), np.nan)
                    found.setdefault((rate, method), empty)[seed, k] = outcome
                progress(1)
    return found


def gains(found: Outcomes, rate: float, method: str, *, over: str = "kf") -> tuple[FloatArray, FloatArray]:
    """Ratios (seeds, people) of MSE and CLL; above 1 the method is better.

    A ratio of log-likelihoods says nothing where they are not both negative: NaN.
    """
    base, own = found[rate, over], found[rate, method]
    both = (base[..., 1] < 0.0) & (own[..., 1] < 0.0)
    return base[..., 0] / own[..., 0], np.where(both, base[..., 1] / own[..., 1], np.nan)


def spread(ratios: FloatArray) -> tuple[float | None, float | None, float | None]:
    """Median, 1 σ over the people, 1 σ of the seeds' medians; None where there is nothing to tell from."""
    if not np.isfinite(ratios).all():
        return None, None, None
    seeds = float(np.std(np.median(ratios, axis=1))) if len(ratios) > 1 else None
    return float(np.median(ratios)), float(np.std(ratios.mean(axis=0))), seeds


def run(settings: Settings, progress: Progress) -> Reproduction:
    """The experiment; without the recordings a line that says so."""
    everyone = chosen(settings)
    if len(everyone) < FOLDS:
        where = "no folder is named" if settings.data is None else f"looked for in {settings.data / 'caviar'}"
        note = (
            f"nothing to judge: CAVIAR's recordings are missing ({where}; --data names the folder that has "
            f"caviar in it); found {len(everyone)} people with {LEAST_LABELS} labelled heads or more, "
            "two are needed"
        )
        return Reproduction("baxter-caviar", (), None, (note,))
    fitted = fit_folds(everyone, settings, progress)
    found = judge(everyone, fitted, settings, progress)
    controls = control_gains(
        [one.track for one in everyone],
        2 if settings.quick else 10,
        lambda control, time: settings.rng(2, control, time),
    )
    progress(1)
    stds = [own.kalman.likelihood.position_std for own in fitted[:FOLDS]]
    rates = [own.rate for own in fitted[:FOLDS]]
    detail = _detail(found, everyone)
    return Reproduction(
        "baxter-caviar",
        (_people(everyone), detail, _controls(controls), _beside(found)),
        page(_panels(detail, controls), columns=2),
        (
            "Labelled positions, in metres, are observations and truth; MSE is of one-step predictions. "
            "Who is not detected shows no head either. Nobody sees the body.",
            "printed and consistent have Baxter et al.'s parameters (Q = 0.1·I, R = 0.5·I). The "
            "others are fitted on "
            f"the other half of the people: 1 σ of the positions {stds[0]:.2g} and {stds[1]:.2g} m, where "
            f"Baxter et al.'s R says 0.71 m; λ of the tracker {rates[0]:.2g} and {rates[1]:.2g} 1/s.",
            "CLL gains have no meaning for methods whose log-likelihood is positive, as it is once the noise "
            "is fitted: nats a detection are to be compared, between fitted methods.",
            "What the CLL gain is made of: heads turned around or drawn at random give nearly the same one. "
            "Where innovations are far below what R expects, it is the ratio of the log-determinants of "
            "their covariances, which the prior narrows whatever it says, and it depends on the unit.",
            "What the MSE loss is made of: R. With Baxter et al.'s Q and R its filter corrects 36 % "
            "of an innovation, "
            "the Kalman filter 65 %, so that what the head gets wrong stays for three frames. With R that of "
            "the labels, or with noise like R's, the loss is gone; with heads along the travel, or with "
            "deviations that are new at every frame, it is not.",
        ),
    )


@tabulated("People with labelled heads; ε = direction of travel − head, as in baxter-statistics")
def _people(everyone: Sequence[Person]) -> Records:
    for one in everyone:
        track = one.track
        mean, std = deviation(track)
        steps = np.linalg.norm(np.diff(track.position, axis=0), axis=1)
        speed = np.linalg.norm(travel_velocity(track), axis=1)
        yield {
            "person": one.name,
            "frames": len(track),
            "heads": int(np.isfinite(np.asarray(track.head)).sum()),
            "speed (m/s)": float(np.nanmedian(speed)),
            "99 % of steps < (m)": float(np.nanpercentile(steps, 99.0)),
            "relabelled (1/s)": relabelled_rate(track),
            "ε, mean (°)": float(np.degrees(mean)),
            "ε, std (°)": float(np.degrees(std)),
        }


@tabulated("Gain over the Kalman filter of Baxter et al. 2014: median of the people's ratios, ± 1 σ")
def _detail(found: Outcomes, everyone: Sequence[Person]) -> Records:
    frames = sum(len(one.track) - 1 for one in everyone)
    for rate in RATES:
        for method in ("kf", *METHODS):
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


@tabulated("Where the gains come from: one thing changed at a time, all detected")
def _controls(controls: Sequence[ControlGain]) -> Records:
    for control in CONTROLS:
        record: dict[str, Cell] = {"what is changed": control.name}
        for gain in controls:
            if gain.control == control.name:
                record[f"{gain.method}: MSE gain"] = float(np.median(gain.error))
                record[f"{gain.method}: CLL gain"] = float(np.median(gain.likelihood))
        yield record


@tabulated("Paper / ours: CAVIAR, labelled heads; Baxter et al. (2014) do not give the MSE on video")
def _beside(found: Outcomes) -> Records:
    for rate in RATES:
        for method in METHODS:
            error, likelihood = (spread(ratios)[0] for ratios in gains(found, rate, method))
            fair = float(np.median(gains(found, rate, method, over="kf fitted")[0]))
            yield {
                "detection %": round(100 * rate),
                "paper: CLL gain": PAPER[rate],
                "ours": method,
                "CLL gain": likelihood,
                "MSE gain": error,
                "MSE gain over kf fitted": fair,
            }


def _panels(detail: Table, controls: Sequence[ControlGain]) -> list[Panel]:
    rows = [row for row in detail.records() if row["method"] != "kf"]
    own = [row for row in rows if row["method"] in OWN]
    x, by, over = "detection %", "method", "gain over Baxter et al.'s Kalman filter"
    changed: list[dict[str, Cell]] = [
        {
            "control": one.control,
            "method": one.method,
            "MSE gain": float(np.median(one.error)),
            "CLL gain": float(np.median(one.likelihood)),
        }
        for one in controls
    ]
    return [
        Panel(f"MSE {over}", rows, x, "MSE gain", by, spread="± people", level=1.0),
        Panel(f"CLL {over}", own, x, "CLL gain", by, spread="± people ", level=1.0),
        *(
            Panel(f"{name} gain, one thing changed", changed, "control", f"{name} gain", by, level=1.0)
            for name in ("MSE", "CLL")
        ),
    ]


def work(settings: Settings) -> int:
    """Fits, people at each rate and seed, and the controls."""
    count = len(chosen(settings))
    if count < FOLDS:
        return 1
    return FOLDS * FITS + count * sum(seeds_at(rate, settings) for rate in RATES) + 1


EXPERIMENT = Experiment(
    "baxter-caviar",
    "Baxter et al. 2014, Fig. 5(a): CAVIAR with labelled heads, gain over the Kalman filter by "
    "detection rate",
    work,
    run,
    f"{QUICK_PEOPLE} people, {QUICK_FRAMES} frames of each",
)
