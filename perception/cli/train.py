"""`perception train`, `perception card` and `perception contact-sheet`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from graphtrack.cli.console import console, printable, progress_bar
from graphtrack.cli.options import Seed, check_outputs

Name = Annotated[
    str,
    typer.Argument(
        help="templates, exemplars, deep_belief, body_pose, head_localiser, head_exemplars (of the "
        "mixed-state tracker), or keypoints (body and head by a pose network's points)."
    ),
]


def train(
    name: Name,
    output: Annotated[Path, typer.Option("--output", "-o", help="Model file to write (.npz).")],
    images: Annotated[
        Path | None,
        typer.Option(
            "--images", help="Folder of your images; without it, rendered ones.", exists=True, file_okay=False
        ),
    ] = None,
    labels: Annotated[
        Path | None,
        typer.Option(
            "--labels",
            help="CSV with a column image and pan_deg, tilt_deg (head pose), body_deg (body_pose), "
            "or left, top, width, height (head_localiser).",
            exists=True,
            dir_okay=False,
        ),
    ] = None,
    count: Annotated[
        int | None,
        typer.Option(
            "--count",
            min=100,
            help="Rendered images, or skeletons, to train on, if not as many as the package's model.",
        ),
    ] = None,
    as_published: Annotated[
        bool,
        typer.Option(
            "--as-published",
            help="body_pose, templates or head_localiser as Chen, Heili & Odobez (2011) printed them; "
            "exemplars or head_exemplars as Ba & Odobez (2003) did.",
        ),
    ] = False,
    seed: Seed = 0,
) -> None:
    """Train a model on your labelled images, or on rendered ones."""
    from graphtrack.errors import InputError
    from perception.images.frames import FrameSource
    from perception.training.models import COUNTS, train_on_files, train_on_rendered

    check_outputs(
        {"--output": output},
        {"--labels": labels, "an image of --images": None if images is None else FrameSource.files(images)},
    )
    if (images is None) != (labels is None):
        raise InputError("one of --images and --labels", "both or neither")
    if images is not None and labels is not None:
        model = train_on_files(name, images, labels, seed=seed, as_published=as_published)
    else:
        total = count or COUNTS.get(name, 0)  # another name is refused
        with progress_bar(total, "images to train on") as advance:
            model = train_on_rendered(
                name, images=count, seed=seed, as_published=as_published, advance=advance
            )
    model.save(output)
    console.print(model.card.text(), markup=False)
    console.print(f"wrote {output}", markup=False)


def card(
    model: Annotated[str, typer.Argument(help="Name of a model of the package, or a model file.")],
) -> None:
    """Print a model's card: what it was trained on, how good it is, when it fails."""
    from perception.models import NAMES, model_path
    from perception.storage import load_model

    print(printable(load_model(model_path(model) if model in NAMES else model)[0].text()))


def sheet(
    output: Annotated[Path, typer.Option("--output", "-o", help="Picture to write (.png).")],
    size: Annotated[int, typer.Option("--size", min=8, max=96, help="Height of a head in pixels.")] = 32,
    rows: Annotated[int, typer.Option("--rows", min=1, max=40, help="Heads at each of twelve pans.")] = 6,
    seed: Seed = 0,
) -> None:
    """Draw rendered heads at twelve pans, to look at."""
    import cv2
    import numpy as np

    from graphtrack.io import atomic_path
    from perception.synthetic import HeadVariation, contact_sheet, make_heads

    check_outputs({"--output": output})
    pans = np.arange(-180, 180, 30)
    heads = make_heads(
        12 * rows,
        np.random.default_rng(seed),
        HeadVariation(size=(size, size)),
        pan=np.tile(np.deg2rad(pans), rows),
    )
    picture = contact_sheet(heads.images, 12, titles=[f"{pan}" for pan in pans])
    with atomic_path(output) as temporary:
        temporary.write_bytes(cv2.imencode(".png", picture)[1].tobytes())
    console.print(f"wrote {output}", markup=False)
