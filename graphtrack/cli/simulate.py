"""`graphtrack simulate` and `graphtrack add-noise`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

from graphtrack.cli import options
from graphtrack.cli.console import console
from graphtrack.display import counted
from graphtrack.errors import InputError
from graphtrack.simulation import WALKING_PACE

PositionNoise = Annotated[
    float | None, typer.Option("--position-noise", help="1-σ of the noise on each axis, metres.")
]
BodyKappa = Annotated[
    float | None, typer.Option("--body-kappa", help="von Mises concentration of the body's noise.")
]
HeadKappa = Annotated[
    float | None, typer.Option("--head-kappa", help="von Mises concentration of the head's noise.")
]


def simulate(
    output: options.Output,
    model: Annotated[
        str,
        typer.Option("--model", help="A preset or a model file (.toml)."),
    ] = "joint",
    tracks: Annotated[int, typer.Option("--tracks", min=1, help="People.")] = 10,
    steps: Annotated[int, typer.Option("--steps", min=1, help="Frames of each.")] = 200,
    fps: Annotated[float, typer.Option("--fps", help="Frames a second.")] = 10.0,
    missing: Annotated[
        float, typer.Option("--missing", min=0.0, max=1.0, help="Share of frames unseen.")
    ] = 0.0,
    pace: Annotated[
        float,
        typer.Option(
            "--pace",
            help="How fast people go, m/s, the median; 0: as the model has it, ever faster.",
        ),
    ] = WALKING_PACE,
    glances: Annotated[float, typer.Option("--glances", help="How often a minute people look aside.")] = 0.0,
    scenario: Annotated[
        bool, typer.Option("--scenario", help="The demo's six scripted people instead, who need no model.")
    ] = False,
    scene: Annotated[
        Literal["party"] | None,
        typer.Option(
            "--scene",
            help="A party instead: people in conversations and alone, who look at each other, without noise.",
            show_default=False,
        ),
    ] = None,
    groups: Annotated[
        Path | None,
        typer.Option(
            "--groups", help="Write who is in conversation at the party (.csv).", show_default=False
        ),
    ] = None,
    looks: Annotated[
        Path | None,
        typer.Option(
            "--looks", help="Write who looks at whom at the party (.csv); -1: nobody.", show_default=False
        ),
    ] = None,
    seed: options.Seed = 0,
) -> None:
    """Simulate people from the model, with their truth, and write the table."""
    import numpy as np

    from graphtrack.io import write
    from graphtrack.model import Model
    from graphtrack.simulation.sampling import simulate as sample
    from graphtrack.simulation.scenario import scenario as scripted

    outputs = {"--output": output, "--groups": groups, "--looks": looks}
    options.check_outputs(outputs, {"--model": options.model_file(model)}, table=output)
    if scene is None and (groups is not None or looks is not None):
        raise InputError("--groups or --looks without --scene party", "the scene that has them")
    if scene is not None and scenario:
        raise InputError("--scene and --scenario", "one of them")
    rng = np.random.default_rng(seed)
    if scene is not None:
        from graphtrack.io.groups import write_columns
        from graphtrack.simulation.party import party

        made = party(rng, people=tracks, steps=steps, fps=fps)
        what, found = "a party", made.tracks
        for path, columns in ((groups, made.group_columns()), (looks, made.look_columns())):
            if path is not None:
                write_columns(columns, path)
    elif scenario:
        what, found = "the demo's people", scripted(rng, fps=fps, seconds=steps / fps)
    else:
        chosen = Model.named(model)
        what = f"model {model}"
        found = sample(
            chosen,
            n_tracks=tracks,
            n_steps=steps,
            fps=fps,
            missing=missing,
            rng=rng,
            pace=pace or None,
            glances=glances,
        )
    write(found, output)
    console.print(
        f"wrote {output}: {counted(len(found), 'track')}, {found.n_frames} person-frames; {what}",
        markup=False,
    )


_DETECTOR = "What a detector gets wrong"


def add_noise(
    inputs: options.Inputs,
    output: options.Output,
    reading: options.Reading,
    position_noise: PositionNoise = None,
    body_kappa: BodyKappa = None,
    head_kappa: HeadKappa = None,
    every: Annotated[
        float | None,
        typer.Option(
            "--every",
            help="Seconds between frames: the recording is sampled so, straight on between its rows.",
            show_default=False,
            rich_help_panel=_DETECTOR,
        ),
    ] = None,
    missed: Annotated[
        float,
        typer.Option(
            "--missed", help="Probability that a person is missed in a frame.", rich_help_panel=_DETECTOR
        ),
    ] = 0.0,
    occlude_share: Annotated[
        float,
        typer.Option(
            "--occlude-share",
            help="Share of the people who are hidden once, at a random time.",
            rich_help_panel=_DETECTOR,
        ),
    ] = 0.0,
    occlude_seconds: Annotated[
        float, typer.Option("--occlude-seconds", help="For how long.", rich_help_panel=_DETECTOR)
    ] = 2.0,
    clutter: Annotated[
        float,
        typer.Option(
            "--clutter",
            help="False detections a frame, anywhere in the box around all people.",
            rich_help_panel=_DETECTOR,
        ),
    ] = 0.0,
    clutter_count: Annotated[
        Literal["poisson", "fixed"],
        typer.Option(
            "--clutter-count",
            help="So many on average (poisson), or in each frame (fixed).",
            rich_help_panel=_DETECTOR,
        ),
    ] = "poisson",
    anonymous: Annotated[
        bool,
        typer.Option(
            "--anonymous",
            help="Leave out who is who and what is true, and shuffle each frame; --truth-output keeps the "
            "truth. Written as .csv, .parquet or .ndjson.",
            rich_help_panel=_DETECTOR,
        ),
    ] = False,
    truth_output: Annotated[
        Path | None,
        typer.Option(
            "--truth-output",
            help="Write where everybody is in the same frames here, for 'graphtrack score'.",
            show_default=False,
            rich_help_panel=_DETECTOR,
        ),
    ] = None,
    seed: options.Seed = 0,
) -> None:
    """Take exact tracks as the truth and write noisy observations of them, the truth beside.

    False detections are tracks of their own, of one row each, with the label "false".
    """
    import numpy as np

    from graphtrack.io import write
    from graphtrack.io.reading import check_table_name, write_table
    from graphtrack.simulation.detector import Detector, detect, summary_of

    detector = Detector(missed, occlude_share, occlude_seconds, clutter, clutter_count)
    given = (position_noise, body_kappa, head_kappa, every)
    if detector.is_perfect and not anonymous and all(one is None for one in given):
        raise InputError(
            "no noise",
            "at least one of --position-noise, --body-kappa, --head-kappa, --every, --missed, "
            "--occlude-share, --clutter, --anonymous",
        )
    options.check_outputs(
        {"--output": output, "--truth-output": truth_output}, reading.inputs(inputs), table=output
    )
    if anonymous:
        check_table_name(output)
    if truth_output is not None:
        options.check_outputs({}, table=truth_output)
    tracks = reading.tracks(inputs)
    rng = np.random.default_rng(seed)
    found = detect(
        tracks,
        detector,
        every=every,
        position_std=position_noise,
        body_kappa=body_kappa,
        head_kappa=head_kappa,
        rng=rng,
    )
    if anonymous:
        write_table(found.anonymous(rng), output)
    else:
        write(found.observed, output)
    if every is not None:
        console.print(f"  note: {found.truth.summary.notes[-1]}", markup=False)
    console.print(f"wrote {output}: {summary_of(found)}", markup=False)
    if truth_output is not None:
        write(found.truth, truth_output)
        console.print(f"wrote {truth_output}: the truth", markup=False)
