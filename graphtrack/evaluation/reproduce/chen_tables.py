"""What the experiments on Chen et al.'s class likelihoods share: errors by method and model, as table and
figure."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from graphtrack.evaluation.reproduce.chen_joint import ANGLES, PRESETS, Scores
from graphtrack.evaluation.reproduce.experiment import Cell, Table
from graphtrack.evaluation.resampling import bootstrap
from graphtrack.geometry.angles import class_centres, difference
from graphtrack.tracks import Track

if TYPE_CHECKING:
    from numpy.typing import NDArray

WITH_FULL = (*PRESETS, "full")

_COLOURS = ("#009E73", "#66C7A3", "#D55E00", "#0072B2", "#56B4E9", "#E69F00", "#CC79A7", "#5F6672")


def most_likely_error(track: Track, truth: Track, angle: str) -> float:
    """Mean error (degrees) of the most likely class of each frame; ``truth`` has the same frames."""
    likelihood, true = getattr(track, f"{angle}_likelihood"), getattr(truth, f"true_{angle}")
    centres = class_centres(likelihood.shape[1])
    known = np.isfinite(likelihood).all(axis=1)
    answer = centres[likelihood[known].argmax(axis=1)]
    return float(np.degrees(np.abs(difference(answer, true[known])).mean()))


def detail(found: Iterable[Scores], groups: Mapping[str, str], rng: np.random.Generator) -> Table:
    """The errors of every method with every model, with 95 % intervals over people.

    Parameters
    ----------
    groups : method → "online" or "offline", in the order of the rows
    """
    records: list[dict[str, Cell]] = []
    for one in found:
        for angle in ANGLES:
            for method, group in groups.items():
                for preset in WITH_FULL:
                    errors = one.errors.get((preset, method, angle))
                    if errors is None:
                        continue
                    interval = bootstrap(lambda v: np.mean(v, axis=-1), errors, rng=rng)
                    records.append(
                        {
                            "data": one.data,
                            "people": len(errors),
                            "angle": angle,
                            "group": group,
                            "method": method,
                            "model": preset,
                            "most likely class (°)": float(one.errors["observation", "", angle].mean()),
                            "error (°)": interval.value,
                            "low": interval.low,
                            "high": interval.high,
                        }
                    )
    return Table.of("Body and head from class likelihoods", records)


def draw_errors(
    grid: NDArray[Any], found: Sequence[Scores], groups: Mapping[str, str], rng: np.random.Generator
) -> None:
    """Draw the errors into a grid of axes (2, len(found)), body above head, a column for each source."""
    from graphtrack.report.style import tidy

    for row, angle in enumerate(ANGLES):
        for column, one in enumerate(found):
            axes = grid[row, column]
            for k, (method, group) in enumerate(groups.items()):
                known = [p for p in WITH_FULL if (p, method, angle) in one.errors]
                drawn = [
                    bootstrap(lambda v: np.mean(v, axis=-1), one.errors[p, method, angle], rng=rng)
                    for p in known
                ]
                value = np.array([interval.value for interval in drawn])
                spread = [value - [i.low for i in drawn], [i.high for i in drawn] - value]
                x = np.arange(len(known)) + 0.09 * (k - (len(groups) - 1) / 2.0)
                axes.errorbar(
                    x,
                    value,
                    spread,
                    fmt="o" if group == "online" else "s",
                    color=_COLOURS[k % len(_COLOURS)],
                    markersize=4,
                    label=f"{method} ({group})",
                )
            tidy(axes, grid="y")
            axes.set_xticks(range(len(WITH_FULL)), WITH_FULL)
            if row == 0:
                axes.set_title(f"{one.data} ({one.people} people)", fontsize=10)
        top = max(axes.dataLim.y1 for axes in grid[row])
        grid[row, 0].set_ylim(0.0, 1.05 * top)
        grid[row, 0].set_ylabel(f"{angle}: mean error (°)")
