"""`graphtrack score` of forecasts."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from graphtrack.cli import options
from graphtrack.cli.console import emit, print_table, write_json
from graphtrack.display import counted
from graphtrack.errors import InputError

if TYPE_CHECKING:
    from graphtrack.evaluation.forecasts import ForecastScore


def are_forecasts(inputs: Sequence[Path]) -> bool:
    """Return True if files are tables of forecasts."""
    from graphtrack.behaviour.forecast.table import is_forecast

    files = [path for path in inputs if path.is_file()]
    found = [is_forecast(path) for path in files]
    if any(found) and not (all(found) and len(files) == len(inputs)):
        raise InputError("tables of forecasts beside other inputs", "tables of forecasts alone, or none")
    return bool(found) and all(found)


def score_forecasts(
    inputs: list[Path],
    truth: list[Path],
    reading: options.CameraReading,
    json_path: Path | None,
) -> None:
    """Judge forecasts, say how good they are, and write it."""
    from graphtrack.behaviour.forecast.table import read_forecasts
    from graphtrack.evaluation.forecasts import judge_forecasts
    from graphtrack.io.pairs import paired_files

    options.check_outputs({"--json": json_path}, reading.inputs([*inputs, *truth]))
    found: dict[str, ForecastScore] = {}
    for name, (table, true) in paired_files(inputs, truth).items():
        try:
            found[name] = judge_forecasts(read_forecasts(table), reading.tracks([true]))
        except InputError as error:
            raise InputError(error.found, error.expected, path=error.path or table) from error
    print_table(
        "Forecasts, and how they compare", [row for name, one in found.items() for row in _rows(name, one)]
    )
    if len(found) > 1:
        print_table("Errors over those of constant velocity, mean of the recordings", [_mean_ratio(found)])
    for name, one in found.items():
        print_table(f"{name}: by time ahead", [_shown(row) for row in one.by_ahead])
        curve = [{"should hold": level, "holds": round(share, 3)} for level, share in one.reliability.items()]
        print_table(f"{name}: reliability of circles", curve)
        drawn = "; best of 20 drawn from the table's Gaussian, for it has no samples" if one.drawn else ""
        emit(
            f"{name}: {counted(one.forecasts, 'forecast')} judged, {one.left_out} left out because the truth "
            f"does not reach{drawn}"
        )
    write_json(json_path, _finite({name: one.to_dict() for name, one in found.items()}))


def _rows(name: str, one: ForecastScore) -> list[dict[str, object]]:
    base = one.methods["constant velocity"]
    rows: list[dict[str, object]] = []
    for method, score in one.methods.items():
        values = {
            "ADE m": score.ade,
            "FDE m": score.fde,
            "ADE ratio": score.ade / base.ade if base.ade > 0 else math.nan,
            "FDE ratio": score.fde / base.fde if base.fde > 0 else math.nan,
            "best of 20 ADE": score.best_ade,
            "best of 20 FDE": score.best_fde,
            "log-likelihood": score.log_likelihood,
            "in 50 %": score.inside_50,
            "in 90 %": score.inside_90,
        }
        rows.append({"": name, "method": method, **_shown(values)})
    return rows


def _mean_ratio(found: Mapping[str, ForecastScore]) -> dict[str, object]:
    ratios = {}
    for key in ("ade", "fde"):
        each = [
            getattr(one.methods["forecast"], key) / getattr(one.methods["constant velocity"], key)
            for one in found.values()
        ]
        ratios[key.upper()] = round(sum(each) / len(each), 3)
    return dict(ratios)


def _shown(values: Mapping[str, float]) -> dict[str, object]:
    return {name: round(value, 3) if math.isfinite(value) else None for name, value in values.items()}


def _finite(content: Any) -> Any:
    """Numbers that are not finite as null, and keys as text, as JSON has them."""
    if isinstance(content, Mapping):
        return {str(key): _finite(value) for key, value in content.items()}
    if isinstance(content, list | tuple):
        return [_finite(one) for one in content]
    return None if isinstance(content, float) and not math.isfinite(content) else content
