"""`perception simulate`, `train` and `card`: rendered people, and models trained on them."""

from __future__ import annotations

import time
from inspect import signature
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from graphtrack.cli import options
from graphtrack.cli.console import emit, printable, progress_bar
from graphtrack.errors import InputError

if TYPE_CHECKING:
    from perception.storage import Stored


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
    """Render people with ground truth: a short clip, or crops to train on.

    Parameters
    ----------
    output : Folder to create, with frames, boxes, camera and ground truth.
    kind : A clip: street (people walking), ceiling (a person in a room, from above), head (a head that moves
        and turns); or crops to train on: heads, people.
    people : People in a street, by default 3.
    frames : By default 25 (street), 150 (ceiling) or 75 (head).
    fps : Frames a second, by default 5 (street), 12.5 or 25 (head).
    images : Frames as a folder of images, in place of a video.
    count : Crops of heads or people, by default 400.
    target : The target that enters the room (ceiling): person, the default, or robot.
    """
    import numpy as np

    from graphtrack.io.atomic import check_place
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
        "target": target,
    }
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


Name = Annotated[
    str,
    typer.Argument(
        help="templates, exemplars, deep_belief, body_pose, head_localiser, head_exemplars (of the "
        "mixed-state tracker), keypoints (body and head from a pose network's points), or "
        "follow_confidence (of perception follow)."
    ),
]


def train(
    name: Name,
    output: options.OutputPath,
    images: Annotated[Path | None, typer.Option(exists=True, file_okay=False)] = None,
    labels: options.InputFile | None = None,
    count: Annotated[int | None, typer.Option(min=1)] = None,
    data: Annotated[Path | None, typer.Option(exists=True, file_okay=False)] = None,
    as_published: bool = False,
    seed: options.Seed = 0,
) -> None:
    """Train a model on your labelled images, or on rendered images.

    Parameters
    ----------
    output : Model file to write (.npz).
    images : Folder of your images; without it, images are rendered.
    labels : CSV with a column image and pan_deg, tilt_deg (head pose), body_deg (body_pose), or left, top,
        width, height (head_localiser).
    count : Rendered images (100 or more), skeletons, or sequences of each kind (follow_confidence) to
        train on; by default as for the package's model.
    data : Folder with caviar and towncentre in it, for follow_confidence; without it rendered sequences.
    as_published : body_pose, templates or head_localiser as published by Chen, Heili & Odobez (2011);
        exemplars or head_exemplars as by Ba & Odobez (2003).
    """
    from perception.images.frames import FrameSource
    from perception.training import COUNTS, train_on_files, train_on_rendered

    options.check_outputs(
        {"--output": output},
        {"--labels": labels, "an image of --images": None if images is None else FrameSource.files(images)},
    )
    if name == "follow_confidence":
        given = {"--images": images, "--labels": labels, "--as-published": as_published}
        options.refuse(given, f"with {name}", "--data, or rendered sequences")
        return _written(_confidence(count, data), output)
    options.refuse({"--data": data}, f"with {name}", "it for follow_confidence")
    if count is not None and count < 100:
        raise InputError(f"--count {count}", "at least 100 images")
    if (images is None) != (labels is None):
        raise InputError("one of --images and --labels", "both or neither")
    if images is not None and labels is not None:
        model = train_on_files(name, images, labels, seed=seed, as_published=as_published)
    else:
        total = count or COUNTS.get(name, 0)  # other names are refused
        with progress_bar(total, "images to train on") as advance:
            model = train_on_rendered(
                name, images=count, seed=seed, as_published=as_published, advance=advance
            )
    _written(model, output)


def _confidence(count: int | None, data: Path | None) -> Stored:
    """Fit the confidence of `perception follow`."""
    from perception.experiments.following import SEQUENCES, sources, train_confidence

    size = count or SEQUENCES
    total = sum(len(sources(part, data, size)) for part in (0, 1))
    with progress_bar(total, "sequences") as advance:
        return train_confidence(size, data, advance)


def _written(model: Stored, output: Path) -> None:
    model.save(output)
    emit(model.card.text())
    emit(f"wrote {output}")


def card(
    model: Annotated[str, typer.Argument()],
) -> None:
    """Print a model's card: its training data, accuracy and failure cases.

    Parameters
    ----------
    model : Name of a model of the package, or a model file.
    """
    from perception.models import NAMES, model_path
    from perception.storage import load_model

    print(printable(load_model(model_path(model) if model in NAMES else model)[0].text()))
