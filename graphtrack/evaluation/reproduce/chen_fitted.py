"""Chen et al.'s separate and joint filtering, each method with the parameters that are best for it.

The methods share five parameters: q, D_body, D_head, κ₁ and κ₂. They are fitted for each method and for both
presets alike, on people who are not reported.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from graphtrack.evaluation.reproduce.chen_tables import (
    ANGLES,
    PAPER,
    Errors,
    Estimator,
    Methods,
    errors_of,
)
from graphtrack.evaluation.reproduce.experiment import (
    ISAM2,
    Cell,
    Progress,
    Records,
    Table,
    paired,
    tabulated,
)
from graphtrack.evaluation.reproduce.fitting import fit
from graphtrack.model import Model
from graphtrack.tracks import TrackSet

SHARED: Mapping[str, tuple[str, str]] = {
    "q (m²/s³)": ("motion", "acceleration_density"),
    "D_body (rad²/s)": ("orientation", "body_diffusion"),
    "D_head (rad²/s)": ("orientation", "head_diffusion"),
    "κ₁ ((m/s)⁻²)": ("coupling", "motion_body_kappa"),
    "κ₂": ("coupling", "head_body_kappa"),
}
"""Parameters that all methods have: name in tables → group and key."""

FITTED = {"joint-body": tuple(SHARED)[:-1], "joint": tuple(SHARED)}
"""Preset → the parameters that are fitted: the paper's separate filtering has no κ₂."""

PAIRS = (("graph", "particle"), (f"graph{ISAM2}", "particle"), ("smoother", "ffbs"))
"""Methods that are compared on the same people, the first less the second."""


Models = Mapping[tuple[str, str], Model]
"""(preset, method) → the model with the parameters fitted for that method."""


def shared_values(model: Model) -> dict[str, float]:
    """The values of `SHARED` in a model."""
    parameters = model.parameters
    return {name: float(getattr(getattr(parameters, group), key)) for name, (group, key) in SHARED.items()}


def with_shared(model: Model, values: Mapping[str, float]) -> Model:
    """The model with other values of some of `SHARED`."""
    parameters = model.parameters
    for name, value in values.items():
        group, key = SHARED[name]
        changed = replace(getattr(parameters, group), **{key: value})
        parameters = replace(parameters, **{group: changed})
    return model.with_parameters(parameters)


def fitted_models(
    tracks: TrackSet,
    methods: Methods,
    evaluations: int,
    progress: Progress,
) -> dict[tuple[str, str], Model]:
    """Models of `FITTED`'s presets with which each method has the smallest mean error of body and head.

    iSAM2 solves the graph that the compiled chain solves, and has its parameters.

    Parameters
    ----------
    tracks : people who are not reported
    methods : group and estimator by name
    evaluations : of each method and preset on all of them, at most
    """
    found = {}
    for preset, names in FITTED.items():
        start = Model(preset)
        for method, (_, estimator) in methods.items():
            if method.endswith(ISAM2):
                continue

            def error(
                *values: float,
                estimator: Estimator = estimator,
                start: Model = start,
                names: tuple[str, ...] = names,
            ) -> float:
                model = with_shared(start, dict(zip(names, values, strict=True)))
                errors = [errors_of(estimator(track, model), track) for track in tracks]
                progress(len(tracks))
                return float(np.mean(errors))

            before = shared_values(start)
            best = fit(error, [before[name] for name in names], evaluations=evaluations)
            found[preset, method] = with_shared(start, dict(zip(names, best, strict=True)))
        for method in methods:
            if method.endswith(ISAM2):
                found[preset, method] = found[preset, method.removesuffix(ISAM2)]
    return found


def fits(methods: Mapping[str, object]) -> int:
    """Searches that `fitted_models` makes."""
    return len(FITTED) * sum(not method.endswith(ISAM2) for method in methods)


def parameter_table(models: Models) -> Table:
    """The parameters fitted for each method, with the package's own in the first row."""
    records: list[dict[str, Cell]] = [
        {"preset": "joint", "method": "default", **shared_values(Model("joint"))}
    ]
    for (preset, method), model in models.items():
        own = shared_values(model)
        if not method.endswith(ISAM2):
            given = {name: own[name] if name in FITTED[preset] else None for name in SHARED}
            records.append({"preset": preset, "method": method, **given})
    return Table.of("Parameters fitted for each method, on other people", records)


@tabulated("Errors with the parameters fitted for each method")
def fitted_table(
    scores: Mapping[str, Errors], fitted: Mapping[str, Errors], methods: Methods, rng: np.random.Generator
) -> Records:
    """Errors with the default parameters and with those fitted, by source, angle and method.

    Parameters
    ----------
    scores, fitted : by source
    rng : source of the intervals' resampling
    """
    for data, errors in scores.items():
        for i, angle in enumerate(ANGLES):
            for method, (group, _) in methods.items():
                joint, body = (fitted[data][preset, method, angle] for preset in ("joint", "joint-body"))
                yield {
                    "data": data,
                    "angle": angle,
                    "group": group,
                    "method": method,
                    "paper: joint (°)": PAPER["joint"][i],
                    "joint, default (°)": float(errors["joint", method, angle].mean()),
                    "joint, fitted (°)": float(joint.mean()),
                    "joint-body, fitted (°)": float(body.mean()),
                    **paired("joint − joint-body, fitted (°)", joint, body, rng),
                }


@tabulated("Methods compared on the same people, joint, 95 % intervals")
def pair_table(
    scores: Mapping[str, Errors], fitted: Mapping[str, Errors], rng: np.random.Generator
) -> Records:
    """Paired differences of `PAIRS` with `joint`, with the default parameters and with those fitted."""
    for data, errors in scores.items():
        for angle in ANGLES:
            for first, second in PAIRS:
                record: dict[str, Cell] = {"data": data, "angle": angle, "difference": f"{first} − {second}"}
                for which, of in (("default", errors), ("fitted", fitted[data])):
                    ends = f"{which}: low", f"{which}: high"
                    one, other = (of["joint", method, angle] for method in (first, second))
                    record |= paired(f"{which} (°)", one, other, rng, *ends)
                yield record
