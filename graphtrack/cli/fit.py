"""`graphtrack fit`."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from graphtrack.cli import options
from graphtrack.cli.console import console, print_table
from graphtrack.cli.fitted import write_all
from graphtrack.display import counted
from graphtrack.errors import InputError

if TYPE_CHECKING:
    from graphtrack.learning import Fit


def fit(
    inputs: options.Inputs,
    reading: options.SceneReading,
    output: Annotated[Path, typer.Option("--output", "-o", help="Model file to write (.toml).")],
    scene: Annotated[
        bool,
        typer.Option(
            "--scene",
            help="Learn the scene of tracks: how people come, go, are missed and wrongly detected. Of "
            "detections without identities it is what is learned anyway.",
        ),
    ] = False,
    forecast: Annotated[
        bool,
        typer.Option(
            "--forecast",
            help="Learn how people go on, for graphtrack forecast --parameters; each file is a scene.",
        ),
    ] = False,
    groups: Annotated[
        Path | None,
        typer.Option(
            "--groups",
            help="Learn who is in a group with whom, from this file of labelled groups: SALSA's, ETH's or a "
            "table.",
            show_default=False,
        ),
    ] = None,
    attention: Annotated[
        Path | None,
        typer.Option(
            "--attention",
            help="Learn how people look, from this file of labelled looks (.csv): frame, track_id and "
            "target, an id or -1; for graphtrack attention --parameters.",
            show_default=False,
        ),
    ] = None,
    model: Annotated[
        str | None,
        typer.Option(
            "--model",
            help="Where to begin: a preset or a model file (.toml); by default separate, full for a scene.",
            show_default=False,
        ),
    ] = None,
    criterion: Annotated[
        Literal["truth", "evidence", "prediction"] | None,
        typer.Option(
            "--criterion",
            help="By default the truth, where there is one, else the evidence or, with couplings, the "
            "prediction.",
        ),
    ] = None,
    hold_out: Annotated[
        float,
        typer.Option(
            "--hold-out",
            min=0.0,
            max=0.9,
            help="Share of the tracks, or for a scene of the recording's end, that only judges.",
        ),
    ] = 0.25,
    max_frames: Annotated[
        int, typer.Option("--max-frames", min=2, help="Person-frames to learn from at most; not of a scene.")
    ] = 20_000,
    report: Annotated[
        Path | None, typer.Option("--report", help="Write what changed and what it bought as HTML.")
    ] = None,
    json_path: options.Json = None,
    seed: options.Seed = 0,
) -> None:
    """Learn the parameters of a model from tracks, by their truth or without; of a scene from detections.

    If it is interrupted, the same command goes on from the progress file beside the output.
    """
    from graphtrack.learning import fit as learn

    if output.suffix != ".toml":
        raise InputError(f"output {output.name!r}", "a name that ends in .toml", path=output)
    journal = output.with_name(output.name + ".progress")
    options.check_outputs(
        {
            "--output": output,
            "the progress file of --output": journal,
            "--report": report,
            "--json": json_path,
        },
        {**reading.inputs(inputs, model), "--groups": groups, "--attention": attention},
    )
    if sum((forecast, groups is not None, attention is not None)) > 1:
        raise InputError("several of --forecast, --groups and --attention", "one of them")
    if forecast:
        from graphtrack.cli.fit_forecast import learn_forecast

        unused = {"--scene": scene, "--model": model is not None, "--criterion": criterion is not None}
        learn_forecast(inputs, reading, output, report, json_path, unused)
        return
    for truth, what in ((groups, "groups"), (attention, "attention")):
        if truth is None:
            continue
        from graphtrack.cli.attention import learn_attention
        from graphtrack.cli.groups import learn_groups

        unused = {"--scene": scene, "--model": model is not None, "--criterion": criterion is not None}
        for name, given in {**unused, "--report": report is not None}.items():
            if given:
                raise InputError(f"{name} with --{what}", f"tracks and the labels of --{what} alone")
        learn_labelled = learn_groups if what == "groups" else learn_attention
        learn_labelled(reading.tracks(inputs), truth, hold_out, output, json_path)
        return
    rows, are_detections = reading.rows(inputs[0]) if len(inputs) == 1 else (None, False)
    if scene or are_detections:
        from graphtrack.cli.fit_scene import learn_scene

        unused = {"--criterion": criterion is not None, "--select": reading.select is not None}
        learn_scene(rows, reading.associate, model, hold_out, output, report, json_path, unused)
        return
    if reading.associate == "auto":
        reading = replace(reading, associate="never")
    tracks = reading.tracks(inputs, rows)
    if journal.is_file():
        console.print(f"  going on from {journal}, if it is of the same data and options", markup=False)
    with console.status("learning") as status:
        found = learn(
            tracks,
            model or "separate",
            criterion=criterion,
            hold_out=hold_out,
            seed=seed,
            max_frames=max_frames,
            journal=journal,
            progress=lambda count: status.update(f"learning: {count} evaluations"),
        )
    found.model.save(output)
    print_table("Parameters", parameter_rows(found))
    print_table("What it bought: log density a frame", score_rows(found))
    console.print(caption(found), markup=False)
    for line in advice(found):
        console.print(line, markup=False)
    tables = {
        "What changed": parameter_rows(found),
        "What it bought: log density a frame": score_rows(found),
    }
    write_all(output, json_path, report, found.to_dict(), [*advice(found), caption(found)], tables)


def parameter_rows(found: Fit) -> list[dict[str, object]]:
    """What changed, a row for each parameter."""
    return [
        {
            "parameter": one.name,
            "before": one.start,
            "after": one.value,
            "95 % from": one.low,
            "to": one.high,
            "": one.note,
        }
        for one in found.learned
    ]


def score_rows(found: Fit) -> list[dict[str, object]]:
    """What it bought, a row for each part of the tracks."""
    return [
        {"tracks": name, "n": n, "before": before, "after": after, "gain": after - before}
        for (name, (before, after)), n in zip(found.scores.items(), found.tracks, strict=False)
    ]


def caption(found: Fit) -> str:
    """What was made great, in words."""
    what = {
        "truth": "the likelihood of the true positions and angles under the smoother's covariances",
        "evidence": "the Laplace evidence of the observations",
        "prediction": "the density of observations that were hidden from the smoother, a part at a time",
    }[found.criterion]
    return f"Learned by {what}; preset {found.model.preset}, {found.evaluations} evaluations."


def advice(found: Fit) -> list[str]:
    """What to do where learning did not help tracks that it had not seen; nothing where it did."""
    before, after = found.scores.get("held out", (0.0, 0.0))
    if after >= before:
        return []
    learned, held = found.tracks
    return [
        f"Learning made it worse on {counted(held, 'track')} held out, by {before - after:.3g} a frame: "
        f"keep the model that it started from ({found.start.preset}), or learn from more than "
        f"{counted(learned, 'track')}."
    ]
