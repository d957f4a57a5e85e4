"""Command `graphtrack score`: tracks, tables of forecasts and of groups scored against the truth."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from graphtrack.cli import options
from graphtrack.cli.behaviour import score_tables
from graphtrack.cli.console import emit, print_reading, print_table, write_json
from graphtrack.errors import InputError
from graphtrack.tracks.display import counted

if TYPE_CHECKING:
    from graphtrack.evaluation.forecasts import ForecastScore
    from graphtrack.evaluation.identities import Pair, Threshold, TrackingScore
    from graphtrack.evaluation.state_score import Compared, StateScore
    from graphtrack.tracks.table import Rows
    from graphtrack.tracks.track import TrackSet


def are_forecasts(inputs: Sequence[Path]) -> bool:
    """Return True if files are tables of forecasts."""
    from graphtrack.forecasting.recorded import is_forecast

    files = [path for path in inputs if path.is_file()]
    found = [is_forecast(path) for path in files]
    if any(found) and not (all(found) and len(files) == len(inputs)):
        raise InputError("tables of forecasts among other inputs", "tables of forecasts alone, or none")
    return bool(found) and all(found)


def score_forecasts(
    inputs: list[Path],
    truth: list[Path],
    reading: options.CameraReading,
    json_path: Path | None,
) -> None:
    """Score forecasts, print the scores and write them."""
    from graphtrack.evaluation.forecasts import judge_forecasts
    from graphtrack.forecasting.recorded import read_forecasts
    from graphtrack.io.read_write import paired_files

    options.check_outputs({"--json": json_path}, reading.inputs([*inputs, *truth]))
    found: dict[str, ForecastScore] = {}
    for name, (table, true) in paired_files(inputs, truth).items():
        try:
            found[name] = judge_forecasts(read_forecasts(table), reading.tracks([true]))
        except InputError as error:
            raise error.at(error.path or table) from error
    print_table("Forecasts compared", [row for name, one in found.items() for row in _rows(name, one)])
    if len(found) > 1:
        print_table("Errors over those of constant velocity, mean of the recordings", [_mean_ratio(found)])
    for name, one in found.items():
        print_table(f"{name}: by time ahead", [_shown(row) for row in one.by_ahead])
        curve = [{"should hold": level, "holds": round(share, 3)} for level, share in one.reliability.items()]
        print_table(f"{name}: reliability of circles", curve)
        drawn = "; best of 20 drawn from the table's Gaussian, for it has no samples" if one.drawn else ""
        emit(
            f"{name}: {counted(one.forecasts, 'forecast')} judged, {one.left_out} left out because the truth "
            f"is too short{drawn}"
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
            "minADE-20": score.min_ade,
            "minFDE-20": score.min_fde,
            "missed": score.miss_rate,
            "colliding": score.collision_rate,
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
    """Convert non-finite numbers to null and keys to text, for JSON."""
    if isinstance(content, Mapping):
        return {str(key): _finite(value) for key, value in content.items()}
    if isinstance(content, list | tuple):
        return [_finite(one) for one in content]
    return None if isinstance(content, float) and not math.isfinite(content) else content


def score(
    inputs: Annotated[list[Path], typer.Argument(metavar="ESTIMATES...")],
    reading: options.CameraReading,
    truth: list[Path],
    metres: float | None = None,
    iou: float | None = None,
    frame_offset: Annotated[int, typer.Option(metavar="N")] = 0,
    json_path: options.Json = None,
    report: Path | None = None,
) -> None:
    """Score tracks against the truth: HOTA, IDF1, MOTA, switches, state errors and interval coverage.

    Errors of position, velocity, body and head are for people with the same track_id in both. Tables of
    forecasts and of groups are scored too.

    Sequences are named by their files, without the endings.

    Parameters
    ----------
    inputs : Files with estimated tracks, one a sequence, or a folder of them.
    truth : File with the true tracks, or a folder of files named like the estimates; repeat for more files.
    metres : Largest distance of a match on the ground; 1 by default.
    iou : Match boxes in the image instead, from this intersection over union (such as 0.5).
    frame_offset : Added to the frame numbers of the estimates, such as 1 where they begin at 0 and those of
        the truth at 1; times that count frames move with them.
    report : Write an HTML report too: figures, replay, and a timeline with every switch; of one sequence, on
        the ground.
    """
    from graphtrack.evaluation.identities import judge, threshold_of
    from graphtrack.evaluation.state_score import summary
    from graphtrack.interaction.group_files import is_group_table
    from graphtrack.io.read_write import paired_files

    unused: dict[str, object] = {"--metres": metres, "--iou": iou, "--report": report}
    unused |= {"--frame-offset": frame_offset or None}
    if any(is_group_table(path) for path in inputs):
        options.refuse(unused, "with groups", "a table of groups and the true ones alone")
        score_tables(inputs, truth, json_path)
        return
    if are_forecasts(inputs):
        unused |= {"--select": reading.select}
        options.refuse(unused, "with forecasts", "this option with tracks only")
        score_forecasts(inputs, truth, reading, json_path)
        return
    threshold = threshold_of(metres, iou)
    if report is not None and threshold.measure == "iou":
        raise InputError("--report and --iou", "one of them: the report shows positions on the ground")
    outputs = {"--json": json_path, "--report": report}
    options.check_outputs(outputs, reading.inputs([*inputs, *truth]))
    pairs = paired_files(inputs, truth)
    if report is not None and len(pairs) > 1:
        raise InputError(f"--report of {len(pairs)} sequences", "one sequence: a file and its truth")
    read: list[tuple[TrackSet, TrackSet]] = []
    errors: list[Compared] = []
    found = judge(_read(pairs, reading, threshold, read, errors, frame_offset), threshold)
    print_score(found)
    states = None if threshold.measure == "iou" else summary(errors, threshold)
    if states is not None:
        print_states(states, threshold)
    if report is not None:
        _write_html(report, found, *read[0])
    write_json(json_path, found.to_dict() | ({} if states is None else {"states": states.to_dict()}))


def _read(
    pairs: dict[str, tuple[Path, Path]],
    reading: options.CameraReading,
    threshold: Threshold,
    kept: list[tuple[TrackSet, TrackSet]],
    errors: list[Compared],
    offset: int,
) -> Iterator[Pair]:
    """Read and compare each pair of files, with the errors of matched people.

    The tracks are kept if there is one pair.
    """
    from graphtrack.evaluation.matching import (
        at_shared_times,
        boxes,
        estimated_detections,
        renumbered,
        true_detections,
    )
    from graphtrack.evaluation.state_score import state_errors

    if threshold.measure == "iou" and reading.select:
        raise InputError("--select and --iou", "one of them: boxes are compared as the files have them")
    for name, (estimates, truth) in pairs.items():
        if threshold.measure == "iou":
            yield name, boxes(_boxes(estimates, reading)).renumbered(offset), boxes(_boxes(truth, reading))
        else:
            found = reading.tracks([estimates])
            true = reading.tracks([truth], reference=found)
            found = renumbered(found, true, offset)
            if len(pairs) == 1:
                kept.append((found, true))
            errors.append(state_errors(found, true, threshold))
            found, true, note = at_shared_times(found, true)
            if note:
                emit(f"  note: {note}")
            yield name, estimated_detections(found), true_detections(true)


def _write_html(path: Path, found: TrackingScore, estimates: TrackSet, truth: TrackSet) -> None:
    """Write the figures, and the tracks against the truth."""
    from graphtrack.evaluation.identities import COUNTS, HEADINGS, SHARES
    from graphtrack.evaluation.identity_events import judge_events
    from graphtrack.report.content import Card, DataTable, Section
    from graphtrack.report.html import write_html
    from graphtrack.report.page import tracking_report

    judged = judge_events(estimates, truth, metres=found.threshold.value)
    figures = found.together
    cards = [Card(HEADINGS[name], f"{getattr(figures, name):.3f}") for name in ("hota", "idf1", "mota")]
    cards.append(Card(HEADINGS["switches"].capitalize(), str(figures.switches)))
    tables = tuple(
        DataTable.of(title, [figures.shown(names)])
        for title, names in ((f"Tracks and identities, {found.threshold}", SHARES), ("Counted", COUNTS))
    )
    page = tracking_report(
        judged.tracks,
        title="Tracks against the truth",
        subtitle="Errors are those of rows that match a person of the truth.",
        cards=tuple(cards),
        sections=(Section("Score", tables),),
        events=judged.events,
    )
    write_html(path, page)
    emit(f"report: {path}")


def _boxes(path: Path, reading: options.CameraReading) -> Rows:
    """Read boxes, and print their summary."""
    import numpy as np

    from graphtrack.io.read_write import read_boxes
    from graphtrack.tracks.track import ReadSummary

    rows = read_boxes(path, reading.format, reading.options())
    summary = ReadSummary(rows.format, rows.n_read, dict(rows.refused), rows.notes)
    print_reading(summary, len(np.unique(rows.track_id)), str(path))
    return rows


def print_score(found: TrackingScore) -> None:
    """Print the figures as two tables: shares, and counts."""
    from graphtrack.evaluation.identities import COUNTS, SHARES

    def rows(names: tuple[str, ...]) -> list[dict[str, object]]:
        return [{"": line.name or "–"} | line.shown(names) for line in found.lines()]

    print_table(f"Tracks and identities, {found.threshold}", rows(SHARES))
    print_table("Counted", rows(COUNTS))
    for note in found.notes:
        emit(f"  note: {note}")


def print_states(found: StateScore, threshold: Threshold) -> None:
    """Print errors and interval coverage as a table."""

    def shown(row: dict[str, Any]) -> dict[str, object]:
        numbers = {"RMSE": row["rmse"], "MAE": row["mae"], "median": row["median"]}
        line = {"": row["quantity"], "unit": row["unit"], "tracks": row["tracks"], "frames": row["frames"]}
        line |= {name: f"{value:.3g}" for name, value in numbers.items()}
        if row["coverage_95"] is not None:
            line |= {"95 % covers": f"{100.0 * row['coverage_95']:.0f} %"}
        if row["nees"] is not None:
            band = f"{row['nees_low']:.2f}–{row['nees_high']:.2f}"
            line |= {"NEES / dof": f"{row['nees']:.2f}", "1 if consistent, within": band}
        return line

    if found.rows:
        rows = [shown(row) for row in found.rows]
        headings = dict.fromkeys(name for row in rows for name in row)
        print_table(
            f"Errors of people matched {threshold}",
            [{name: row.get(name, "–") for name in headings} for row in rows],
        )
    for note in found.notes:
        emit(f"  note: {note}")
