"""The errors of Chen et al.'s experiments: of body and head by method and model, as tables and pictures."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from graphtrack.evaluation.reproduce.experiment import (
    Cell,
    Panel,
    Progress,
    Records,
    Table,
    draw_panel,
    interval_cells,
    tabulated,
)
from graphtrack.evaluation.resampling import bootstrap
from graphtrack.geometry.angles import FloatArray, class_centres, difference, mean_absolute_error
from graphtrack.model import Model
from graphtrack.tracks import Track

if TYPE_CHECKING:
    from numpy.typing import NDArray

ANGLES: tuple[Literal["body", "head"], ...] = ("body", "head")
PAPER = {"observation": (41.7, 30.3), "separate": (32.9, 25.8), "joint": (21.9, 17.6)}
"""Chen et al. 2011, Table 2: mean errors of body and head in degrees."""

PRESETS = ("separate", "joint-body", "joint")
"""Nothing coupled; the paper's separate filtering, κ₂ = 0 in eq. 10; the paper's joint filtering."""

WITH_FULL = (*PRESETS, "full")

POSITION_STD = 0.1
"""Metres of noise on the positions."""

Estimator = Callable[[Track, Model], Track]

Methods = Mapping[str, tuple[str, Estimator]]
"""Method → group, "online" or "offline", and estimator."""

Errors = Mapping[tuple[str, str, str], FloatArray]
"""(preset, method, angle) → mean errors (n,) in degrees of the people; "observation", "" of what was seen."""


@dataclass(frozen=True, eq=False)
class Scores:
    """Mean absolute errors in degrees of the people of a source."""

    data: str
    people: int
    errors: Errors


def errors_of(estimate: Track, track: Track) -> list[float]:
    """Mean errors of body and head in degrees."""
    return [
        float(np.degrees(mean_absolute_error(getattr(estimate, angle), getattr(track, f"true_{angle}"))))
        for angle in ANGLES
    ]


def by_angle(
    key: tuple[str, str], errors: Sequence[Sequence[float]]
) -> dict[tuple[str, str, str], FloatArray]:
    """Errors (people, 2) of body and head, of a preset and method."""
    return {(*key, angle): np.array(errors)[:, i] for i, angle in enumerate(ANGLES)}


def default_models(methods: Iterable[str], with_full: Iterable[str]) -> dict[tuple[str, str], Model]:
    """(preset, method) → the model with default parameters; ``full`` only for some of the methods."""
    models = {preset: Model(preset) for preset in WITH_FULL}
    return {
        (preset, method): models[preset]
        for preset in WITH_FULL
        for method in methods
        if preset != "full" or method in with_full
    }


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


@tabulated("Body and head from class likelihoods")
def detail(found: Iterable[Scores], groups: Mapping[str, str], rng: np.random.Generator) -> Records:
    """The errors of every method with every model, with 95 % intervals over people.

    Parameters
    ----------
    groups : method → "online" or "offline", in the order of the rows
    """
    for one in found:
        for angle in ANGLES:
            for method, group in groups.items():
                for preset in WITH_FULL:
                    errors = one.errors.get((preset, method, angle))
                    if errors is None:
                        continue
                    interval = bootstrap(lambda v: np.mean(v, axis=-1), errors, rng=rng)
                    yield {
                        "data": one.data,
                        "people": len(errors),
                        "angle": angle,
                        "group": group,
                        "method": method,
                        "model": preset,
                        "most likely class (°)": float(one.errors["observation", "", angle].mean()),
                        **interval_cells("error (°)", interval),
                    }


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


def draw_errors(
    grid: NDArray[Any], found: Sequence[Scores], groups: Mapping[str, str], rng: np.random.Generator
) -> None:
    """Draw the errors into a grid of axes (2, len(found)), body above head, a column for each source."""
    rows = detail(found, groups, rng).records()
    handles: dict[str, Any] = {}
    for row, angle in enumerate(ANGLES):
        for column, one in enumerate(found):
            own = [record for record in rows if (record["data"], record["angle"]) == (one.data, angle)]
            title = f"{one.data} ({one.people} people)" if row == 0 else ""
            panel = Panel(title, own, "model", "error (°)", "method", ends=("low", "high"))
            draw_panel(grid[row, column], panel, handles)
        grid[row, 0].set_ylabel(f"{angle}: mean error (°)")
