"""Command `graphtrack compare`: methods on tracks, and trackers on detections, scored against truth."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from graphtrack.cli import options
from graphtrack.cli.console import (
    emit,
    input_warnings_as_notes,
    option_name,
    print_table,
    progress_bar,
    quiet_input_warnings,
    save_figure,
    write_json,
)
from graphtrack.cli.simulate import NoiseOptions
from graphtrack.errors import InputError
from graphtrack.tracks.display import counted

if TYPE_CHECKING:
    from graphtrack.constants.declared import Trust
    from graphtrack.evaluation.compare import Comparison
    from graphtrack.evaluation.trackers import TrackerComparison
    from graphtrack.model import Model
    from graphtrack.tracks.track import TrackSet


def compare_trackers(
    inputs: Sequence[Path],
    truth: Path,
    reading: options.SceneReading,
    methods: Sequence[str],
    metres: float | None,
    fill: bool,
    model: str | None,
    json_path: Path | None,
) -> None:
    """Read detections and truth, run the trackers on them, and print their figures."""
    from graphtrack.evaluation.trackers import TRACKERS, read_detections
    from graphtrack.evaluation.trackers import compare_trackers as compare

    options.check_outputs({"--json": json_path}, reading.inputs([*inputs, truth], model))
    if len(inputs) > 1:
        raise InputError(f"{len(inputs)} files of detections", "one recording at a time")
    refused = {"--select": reading.select, "--associate never": reading.associate == "never"}
    options.refuse(refused, "with --truth", "all detections, without identities")
    path = inputs[0]
    with quiet_input_warnings():
        detections, summary = read_detections(path, reading.format, reading.options())
    emit(f"{path}: {summary.format}, {len(detections)} detections")
    for note in summary.notes:
        emit(f"  note: {note}")
    true = replace(reading, associate="never", format=None).tracks([truth])
    names = list(methods) or list(TRACKERS)
    with progress_bar(len(names), "methods") as advance:
        found = compare(detections, true, names, metres=metres, fill=fill, model=model, progress=advance)
    print_trackers(found)
    write_json(json_path, found.to_dict())


def compare_groups(
    inputs: Sequence[Path],
    labels: Path,
    reading: options.SceneReading,
    methods: Sequence[str],
    parameters: Path | None,
    json_path: Path | None,
) -> None:
    """Read tracks and labelled groups, find groups with each method, and print their scores."""
    from graphtrack.evaluation.groups import compare_groups as compare
    from graphtrack.evaluation.groups import registry
    from graphtrack.interaction.group_files import read_groups
    from graphtrack.interaction.parameters import GroupParameters

    options.check_outputs(
        {"--json": json_path}, {**reading.inputs(inputs), "--groups": labels, "--parameters": parameters}
    )
    chosen = None if parameters is None else GroupParameters.load(parameters)
    with input_warnings_as_notes():
        tracks = reading.tracks(list(inputs))
        found = compare(
            tracks,
            read_groups(labels, tracks.ids),
            list(methods) or list(registry),
            parameters=chosen,
        )
    frames = next(iter(found.scores.values())).frames
    rows = [
        {"method": name}
        | {
            f"F1, {share} of\nthe members": f1
            for share, f1 in zip(("two thirds", "all"), one.f1, strict=True)
        }
        | {"F1, pairs": one.pair_f1}
        for name, one in found.scores.items()
    ]
    print_table(f"Groups against the truth, {counted(frames, 'frame')}", rows)
    for name, information in found.information.items():
        emit(f"  {name}: {information}")
    write_json(json_path, found.to_dict())


def print_trackers(found: TrackerComparison) -> None:
    """Print the figures as a table, followed by notes on reading them."""
    from graphtrack.evaluation.identities import HEADINGS

    rows = []
    for one in found.results:
        record = one.to_dict()
        figures = {HEADINGS.get(name, name): record[name] for name in record if name != "information"}
        rows.append({"method": one.method, "": one.group} | figures)
    for row in rows:
        row.pop("group")
    print_table(f"Trackers on the same {found.detections} detections, {found.threshold}", rows)
    for one in found.results:
        filled = "; smoothed, gaps filled" if found.filled and one.of.online else ""
        emit(f"  {one.method}: {one.of.information}{filled}")
    for note in found.notes:
        emit(f"  note: {note}")


FIGURES = ("errors.png", "reliability.png")
"""Files of `write_figures`."""


def named(methods: str | None) -> list[str]:
    """Return the methods named by an option; none if it was not given."""
    if methods is None:
        return []
    names = [name.strip() for name in methods.split(",") if name.strip()]
    if not names:
        raise InputError("no methods", "names separated by commas")
    return names


def compare(
    inputs: options.Inputs,
    reading: options.SceneReading,
    noise: NoiseOptions,
    methods: str | None = None,
    model: str | None = None,
    trust: options.TrustNoise = None,
    occlude: float | None = None,
    seed: options.Seed = 0,
    json_path: options.Json = None,
    figures: Path | None = None,
    truth: Path | None = None,
    metres: float | None = None,
    fill: bool = False,
    groups: Path | None = None,
    parameters: Path | None = None,
) -> None:
    """Compare methods on tracks with known truth: errors, NEES and interval coverage.

    With a noise option the file's values are the truth, and noisy observations are drawn from them. With
    --truth, trackers are compared on detections without identities; with --groups, methods that find groups.

    Parameters
    ----------
    methods : Comma-separated: kf, intentional, intentional-printed, intentional-consistent, particle,
        rts, ffbs, smoother, chain, isam2, fixed-lag; by default chain, isam2, kf, intentional,
        intentional-printed, particle, smoother, rts. The others are compared with the first
        online and the first offline method, track by track. With --truth: associate, hungarian, bytetrack,
        ocsort; by default the first two. With --groups: groups, online, average-linkage; by default all.
    model : A preset or a model file (.toml) for all methods; by default the best preset of each: joint for
        the graph with every engine and for particles, and the filters' own.
    occlude : Seconds around the sharpest turn to withhold and score.
    figures : Folder for figures (PNG) of errors and of reliability.

    Trackers, from detections without identities
    --------------------------------------------
    truth : File with the true tracks of the same frames; the input is then detections without identities, and
        trackers are compared.
    metres : Largest distance of a match on the ground; 1 by default.
    fill : Smooth the tracks of online methods too, and fill their gaps; only identities then differ.

    Groups
    ------
    groups : Labelled groups of the same frames: a SALSA or ETH file, or a table of groups.
    parameters : Output of 'graphtrack fit --groups' (.toml), for the methods groups and online.
    """
    of_tracks = {"occlude": occlude, "figures": figures, "trust": trust} | vars(noise)
    refused = {option_name(name): one for name, one in of_tracks.items()}
    if groups is not None:
        refused |= {"--truth": truth, "--metres": metres, "--fill": fill, "--model": model}
        options.refuse(refused, "with --groups", "no such option: methods that find groups have none")
        compare_groups(inputs, groups, reading, named(methods), parameters, json_path)
        return
    options.refuse({"--parameters": parameters}, "without --groups", "it with --groups")
    if truth is not None:
        options.refuse(refused, "with --truth", "no such option: with --truth the input is detections")
        compare_trackers(inputs, truth, reading, named(methods), metres, fill, model, json_path)
        return
    of_trackers = {"--metres": metres, "--fill": fill, "--associate": reading.associate != "auto"}
    options.refuse(of_trackers, "without --truth", "it with --truth, which compares trackers")
    reading = replace(reading, associate="never")
    import numpy as np

    from graphtrack.evaluation.compare import METHODS
    from graphtrack.evaluation.compare import compare as compare_methods
    from graphtrack.model import presets
    from graphtrack.simulation.degrade import add_noise

    options.check_outputs(
        {
            "--json": json_path,
            "--figures": options.files_in(figures, FIGURES),
        },
        reading.inputs(inputs, model),
    )
    if figures is not None:
        options.make_folder(figures)
    tracks = reading.tracks(inputs)
    if not noise.is_none:
        tracks = add_noise(tracks, **noise.given, rng=np.random.default_rng(seed))
    tracks, model_used = _trusted(tracks, model, trust or "check")
    names = named(methods) or METHODS
    with input_warnings_as_notes(), progress_bar(tracks.n_frames) as advance:
        found = compare_methods(tracks, names, model=model_used, occlude_seconds=occlude, progress=advance)
    if not found.rows:
        first = found.failures[0]
        raise InputError(
            f"no method with a result ({first.method} on track {first.track_id}: {first.failure})",
            "a track that at least one method can estimate",
        )
    print_comparison(found)
    if model is not None and model not in presets:
        emit(f"  the model is {model}")
    print_failures(found)
    write_json(json_path, found.to_dict())
    if figures is not None:
        write_figures(found, figures)


def _trusted(tracks: TrackSet, model: str | None, trust: Trust) -> tuple[TrackSet, Model | str | None]:
    """Return the tracks, and the model of all methods with its noise; None: each method uses its own."""
    from graphtrack.constants.declared import trusted
    from graphtrack.model import Model

    given = Model.named(model)
    tracks, learned, verdict = trusted(tracks, given, trust, "default")
    for line in verdict:
        emit(f"  note: {line}")
    if model is None and learned.parameters != given.parameters:
        raise InputError(
            "--trust learn with a separate model for each method",
            "--model, so that all methods share the learned noise",
        )
    return tracks, None if model is None else learned


def print_comparison(comparison: Comparison) -> None:
    """Print the comparison as tables: medians over the tracks, differences, reliability."""
    values = {(row["method"], row["metric"]): row["median"] for row in comparison.rows}
    columns = {row["metric"]: f"{row['metric']}\n({row['unit']})" for row in comparison.rows}
    groups, models = {row["method"]: row["group"] for row in comparison.rows}, comparison.models
    errors = [
        {"method": method, "": group, "model": models[method]}
        | {heading: values.get((method, metric)) for metric, heading in columns.items()}
        for method, group in groups.items()
    ]
    print_table("Medians over the tracks", errors)
    print_differences(comparison)
    print_reliability(comparison)
    emit(comparison.caption)


def print_differences(comparison: Comparison) -> None:
    """Print paired differences from the first method of each group, with their intervals."""
    columns = {row["metric"]: f"{row['metric']}\n({row['unit']})" for row in comparison.differences}
    cells = {(row["method"], row["metric"]): _interval(row) for row in comparison.differences}
    pairs = dict.fromkeys((row["method"], row["reference"]) for row in comparison.differences)
    rows: list[dict[str, Any]] = [
        {"difference": f"{method} − {reference}"}
        | {heading: cells.get((method, metric)) for metric, heading in columns.items()}
        for method, reference in pairs
    ]
    if rows:
        print_table("Paired differences on the same tracks: mean, 95 % interval; negative is better", rows)


def _interval(row: Mapping[str, Any]) -> str:
    value = f"{row['difference']:+.3g}"
    return value if math.isnan(row["low"]) else f"{value} [{row['low']:+.3g}, {row['high']:+.3g}]"


def print_reliability(comparison: Comparison) -> None:
    """Print NEES and interval coverage by method and quantity."""
    rows = [
        {
            "method": row["method"],
            "": row["group"],
            "of": row["quantity"],
            "NEES / dof": row["nees"],
            "± (95 %)": row["nees_error"],
            **{f"{level} % covers\n(%)": f"{100.0 * row[f'coverage_{level}']:.0f}" for level in (50, 90, 95)},
        }
        for row in comparison.calibration
    ]
    print_table("Reliability: NEES / dof should be 1, and coverage should equal the nominal level", rows)


def print_failures(comparison: Comparison) -> None:
    """Print failed methods and omitted tracks, with reasons and counts."""
    reasons: dict[tuple[str, str], list[int]] = {}
    for record in comparison.failures:
        reasons.setdefault((f"{record.method} failed on", record.failure), []).append(record.track_id)
    for track_id, reason in comparison.left_out.items():
        reasons.setdefault(("left out", reason), []).append(track_id)
    for (what, reason), tracks in reasons.items():
        which = f"track {tracks[0]}" if len(tracks) == 1 else counted(len(tracks), "track")
        emit(f"  {what} {which}: {reason}")


def write_figures(comparison: Comparison, folder: Path) -> None:
    """Write figures of errors and reliability as PNG files in a folder."""
    from graphtrack.report.plots import plot_errors, plot_reliability

    options.make_folder(folder)
    made = {FIGURES[0]: plot_errors(comparison.rows)}
    if comparison.calibration:
        made[FIGURES[1]] = plot_reliability(comparison.calibration)
    for name, figure in made.items():
        save_figure(figure, folder / name)
