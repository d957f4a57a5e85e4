"""`perception simulate`."""

from __future__ import annotations

import time
from inspect import signature
from pathlib import Path
from typing import Annotated

import typer

from graphtrack.cli.console import console, progress_bar
from graphtrack.cli.options import Seed


def simulate(
    output: Annotated[
        Path, typer.Option("--output", "-o", help="Folder to make, with frames, boxes, camera and truth.")
    ],
    kind: Annotated[
        str,
        typer.Argument(
            help="A clip: street (people who walk), ceiling (somebody in a room, from above), head (one "
            "that moves and turns); or crops to train on: heads, people."
        ),
    ] = "street",
    people: Annotated[
        int | None, typer.Option("--people", min=1, help="People in a street, by default 3.")
    ] = None,
    frames: Annotated[
        int | None,
        typer.Option("--frames", min=2, help="By default 25 (street), 150 (ceiling) or 75 (head)."),
    ] = None,
    fps: Annotated[
        float | None,
        typer.Option(
            "--fps", min=0.5, max=200.0, help="Frames a second, by default 5 (street), 12.5 or 25 (head)."
        ),
    ] = None,
    images: Annotated[
        bool, typer.Option("--images", help="Frames as a folder of images, in place of a video.")
    ] = False,
    count: Annotated[
        int | None, typer.Option("--count", min=1, help="Crops of heads or people, by default 400.")
    ] = None,
    target: Annotated[
        str | None,
        typer.Option("--target", help="Who comes into the room (ceiling): person, the default, or robot."),
    ] = None,
    seed: Seed = 0,
) -> None:
    """Render people whose truth is known: a short clip, or crops to train on."""
    import numpy as np

    from graphtrack.errors import InputError
    from graphtrack.io.places import check_place
    from perception.synthetic.folders import KINDS

    check_place(output, directory=True)
    if kind not in KINDS:
        raise InputError(f"kind {kind!r}", f"one of {', '.join(KINDS)}")
    known = signature(KINDS[kind]).parameters
    options: dict[str, object] = {
        "people": people,
        "frames": frames,
        "fps": fps,
        "images": images or None,
        "count": count,
    }
    options["target"] = target
    given = {name: value for name, value in options.items() if value is not None}
    for name in given:
        if name not in known:
            raise InputError(f"--{name} with {kind}", "another kind, or no such option")
    length = "count" if "count" in known else "frames"
    total = int(str(given.get(length, known[length].default)))
    rng, begun = np.random.default_rng(seed), time.perf_counter()
    with progress_bar(total, length) as advance:
        boxes = KINDS[kind](output, rng, advance, **given)
    seconds = time.perf_counter() - begun
    console.print(f"wrote {output}: {total} images in {seconds:.1f} s", markup=False)
    if boxes:
        box = ",".join(f"{value:.0f}" for value in boxes[0].box)
        console.print(
            f"  first box, in frame {boxes[0].frame}: {box} (left, top, width, height)", markup=False
        )
