"""Chen et al.'s coupling of the head to the body, κ₂, as strong as is best for each method, on other
people."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Literal

import numpy as np

from graphtrack.evaluation.reproduce.experiment import Cell, Progress, Table
from graphtrack.evaluation.reproduce.fitting import fit
from graphtrack.evaluation.reproduce.resampling import bootstrap, mean_difference
from graphtrack.geometry.angles import FloatArray, mean_absolute_error
from graphtrack.model import Model
from graphtrack.tracks import Track, TrackSet

ANGLES: tuple[Literal["body", "head"], ...] = ("body", "head")
PAPER = {"observation": (41.7, 30.3), "separate": (32.9, 25.8), "joint": (21.9, 17.6)}
"""Chen et al. 2011, Table 2: mean errors of body and head in degrees."""

Estimator = Callable[[Track, Model], Track]

Errors = Mapping[tuple[str, str, str], FloatArray]
"""(data, method, angle) → mean errors (n,) in degrees of the people."""


def with_head_coupling(model: Model, kappa: float) -> Model:
    """The model with another κ₂."""
    parameters = model.parameters
    return model.with_parameters(
        replace(parameters, coupling=replace(parameters.coupling, head_body_kappa=kappa))
    )


def fitted_kappas(
    tracks: TrackSet,
    methods: Mapping[str, tuple[str, Estimator]],
    evaluations: int,
    progress: Progress,
) -> dict[str, float]:
    """κ₂ of `joint` with which each method has the smallest mean error of body and head.

    Parameters
    ----------
    tracks : people who are not reported
    methods : group and estimator by name
    evaluations : of each method on all of them, at most
    """
    joint = Model("joint")
    found = {}
    for name, (_, estimator) in methods.items():

        def error(kappa: float, estimator: Estimator = estimator) -> float:
            model = with_head_coupling(joint, kappa)
            errors = [errors_of(estimator(track, model), track) for track in tracks]
            progress(len(tracks))
            return float(np.mean(errors))

        (found[name],) = fit(error, [joint.parameters.coupling.head_body_kappa], evaluations=evaluations)
    return found


def errors_of(estimate: Track, track: Track) -> list[float]:
    """Mean errors of body and head in degrees."""
    return [
        float(np.degrees(mean_absolute_error(getattr(estimate, angle), getattr(track, f"true_{angle}"))))
        for angle in ANGLES
    ]


def fitted_errors(
    people: Mapping[str, TrackSet],
    methods: Mapping[str, tuple[str, Estimator]],
    kappas: Mapping[str, float],
    progress: Progress,
) -> dict[tuple[str, str, str], FloatArray]:
    """The errors of every method, each with its κ₂, by source of the people."""
    found: dict[tuple[str, str, str], FloatArray] = {}
    for data, tracks in people.items():
        for name, (_, estimator) in methods.items():
            model = with_head_coupling(Model("joint"), kappas[name])
            errors = np.array([errors_of(estimator(track, model), track) for track in tracks])
            found |= {(data, name, angle): errors[:, i] for i, angle in enumerate(ANGLES)}
            progress(len(tracks))
    return found


def fitted_table(
    scores: Mapping[str, Errors],
    fitted: Errors,
    methods: Mapping[str, tuple[str, Estimator]],
    kappas: Mapping[str, float],
    rng: np.random.Generator,
) -> Table:
    """What the fitted κ₂ is worth beside the default one, by source, angle and method.

    ``scores`` are those of the default parameters, by source: (preset, method, angle) → errors.
    """
    default = Model("joint").parameters.coupling.head_body_kappa
    records: list[dict[str, Cell]] = []
    for data, errors in scores.items():
        for i, angle in enumerate(ANGLES):
            for method, (group, _) in methods.items():
                own, before = fitted[data, method, angle], errors["joint", method, angle]
                body = errors["joint-body", method, angle]
                against = bootstrap(mean_difference, own, body, rng=rng)
                records.append(
                    {
                        "data": data,
                        "angle": angle,
                        "group": group,
                        "method": method,
                        "κ₂ fitted": kappas[method],
                        "paper: joint (°)": PAPER["joint"][i],
                        f"joint, κ₂ = {default:g} (°)": float(before.mean()),
                        "joint, κ₂ fitted (°)": float(own.mean()),
                        "fitted − default (°)": float((own - before).mean()),
                        "fitted − joint-body (°)": against.value,
                        "low": against.low,
                        "high": against.high,
                    }
                )
    return Table.of("κ₂ fitted for each method, on other people", records)
