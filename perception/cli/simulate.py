"""`perception simulate`."""

from __future__ import annotations

import time
from inspect import signature
from typing import Annotated

import typer

from graphtrack.cli import options
from graphtrack.cli.console import emit, progress_bar


def simulate(
    output: options.OutputPath,
    kind: Annotated[str, typer.Argument()] = "street",
    people: Annotated[int | None, typer.Option(min=1)] = None,
    frames: Annotated[int | None, typer.Option(min=2)] = None,
    fps: Annotated[float | None, typer.Option(min=0.5, max=200.0)] = None,
    images: bool = False,
    count: Annotated[int | None, typer.Option(min=1)] = None,
    target: str | None = None,
    seed: options.Seed = 0,
) -> None:
    """Render people whose truth is known: a short clip, or crops to train on.

    Parameters
    ----------
    output : Folder to make, with frames, boxes, camera and truth.
    kind : A clip: street (people who walk), ceiling (somebody in a room, from above), head (one that moves
        and turns); or crops to train on: heads, people.
    people : People in a street, by default 3.
    frames : By default 25 (street), 150 (ceiling) or 75 (head).
    fps : Frames a second, by default 5 (street), 12.5 or 25 (head).
    images : Frames as a folder of images, in place of a video.
    count : Crops of heads or people, by default 400.
    target : Who comes into the room (ceiling): person, the default, or robot.
    """
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
    emit(f"wrote {output}: {total} images in {seconds:.1f} s")
    if boxes:
        box = ",".join(f"{value:.0f}" for value in boxes[0].box)
        emit(f"  first box, in frame {boxes[0].frame}: {box} (left, top, width, height)")
