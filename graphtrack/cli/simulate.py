"""`graphtrack simulate` and `graphtrack add-noise`."""

from __future__ import annotations

from typing import Annotated

import typer

from graphtrack.cli import options
from graphtrack.cli.console import console
from graphtrack.display import counted
from graphtrack.errors import InputError

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
        typer.Option(
            "--model",
            help="A preset or a model file (.toml). Of full the modes are not simulated: everybody faces "
            "where they go.",
        ),
    ] = "joint",
    tracks: Annotated[int, typer.Option("--tracks", min=1, help="People.")] = 10,
    steps: Annotated[int, typer.Option("--steps", min=1, help="Frames of each.")] = 200,
    fps: Annotated[float, typer.Option("--fps", help="Frames a second.")] = 10.0,
    missing: Annotated[
        float, typer.Option("--missing", min=0.0, max=1.0, help="Share of frames unseen.")
    ] = 0.0,
    scenario: Annotated[
        bool, typer.Option("--scenario", help="The demo's six scripted people instead, who need no model.")
    ] = False,
    seed: options.Seed = 0,
) -> None:
    """Simulate people from the model, with their truth, and write the table."""
    import numpy as np

    from graphtrack.io import write
    from graphtrack.model import Model
    from graphtrack.simulation.sampling import simulate as sample
    from graphtrack.simulation.scenario import scenario as scripted

    options.check_outputs({"--output": output}, {"--model": options.model_file(model)}, table=output)
    rng = np.random.default_rng(seed)
    if scenario:
        what, found = "the demo's people", scripted(rng, fps=fps, seconds=steps / fps)
    else:
        chosen = Model.named(model)
        what = f"model {model}" + (", without its modes" if chosen.has_modes else "")
        found = sample(chosen, n_tracks=tracks, n_steps=steps, fps=fps, missing=missing, rng=rng)
    write(found, output)
    console.print(
        f"wrote {output}: {counted(len(found), 'track')}, {found.n_frames} person-frames; {what}",
        markup=False,
    )


def add_noise(
    inputs: options.Inputs,
    output: options.Output,
    reading: options.Reading,
    position_noise: PositionNoise = None,
    body_kappa: BodyKappa = None,
    head_kappa: HeadKappa = None,
    seed: options.Seed = 0,
) -> None:
    """Take exact tracks as the truth and write noisy observations of them, the truth beside."""
    import numpy as np

    from graphtrack.io import write
    from graphtrack.simulation.degrade import add_noise as noisy

    if position_noise is None and body_kappa is None and head_kappa is None:
        raise InputError("no noise", "at least one of --position-noise, --body-kappa, --head-kappa")
    options.check_outputs({"--output": output}, reading.inputs(inputs), table=output)
    tracks = reading.tracks(inputs)
    found = noisy(
        tracks,
        position_std=position_noise,
        body_kappa=body_kappa,
        head_kappa=head_kappa,
        rng=np.random.default_rng(seed),
    )
    write(found, output)
    console.print(
        f"wrote {output}: {counted(len(found), 'track')}, {found.n_frames} person-frames", markup=False
    )
