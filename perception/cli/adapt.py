"""`perception adapt`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np
import typer

from graphtrack.cli.console import console, print_table, progress_bar
from graphtrack.cli.options import Seed
from graphtrack.display import counted
from perception.cli.common import (
    Boxes,
    Calibration,
    Fps,
    Homography,
    VideoOrFolder,
    check_places,
    frame_rate,
    print_skipped,
    read_camera,
)
from perception.cli.own_networks import stamp_of
from perception.cli.searching import PeopleSearch, search_journals

if TYPE_CHECKING:
    from perception.storage import ModelCard


def adapt(
    source: VideoOrFolder,
    output: Annotated[Path, typer.Option("--output", "-o", help="Model file to write (.npz).")],
    boxes: Boxes = None,
    homography: Homography = None,
    calibration: Calibration = None,
    fps: Fps = None,
    seed: Seed = 0,
) -> None:
    """Let a camera teach itself how bodies and heads point, from people who surely walk.

    `perception observe --models` uses the file.
    """
    from graphtrack.errors import InputError
    from perception.adaptation.adapting import adapted
    from perception.adaptation.learning import PackageModels
    from perception.adaptation.recording import check_camera
    from perception.detection.boxes import read_boxes
    from perception.images.frames import FrameSource
    from perception.models import HEAD_POSE, load_classifier, load_head_localiser

    if output.suffix != ".npz":
        raise InputError(f"--output {output.name}", "a name that ends in .npz")
    inputs = {"--boxes": boxes, "--homography": homography, "--calibration": calibration}
    journals = search_journals(output)
    check_places({"--output": output, "the journals of --output": journals}, None, source, inputs)
    camera = read_camera(homography, calibration)
    if camera is None:
        raise InputError("no camera", "--calibration or --homography: where people go is seen on the ground")
    frames = FrameSource.open(source)
    check_camera(camera, frames.size())
    rate = frame_rate(frames, fps)
    refused: dict[str, None] = {}
    refuse = refused.setdefault
    asked = stamp_of(homography), stamp_of(calibration)
    search = PeopleSearch(frames, camera, rate, output, asked, one_size=True)
    package = PackageModels(
        load_head_localiser(), load_classifier("body_pose"), load_classifier(HEAD_POSE[0])
    )
    rng = np.random.default_rng(seed)
    with search:
        people = search.people(refuse) if boxes is None else read_boxes(boxes, refuse)
        found = adapted(frames, people, camera, rate, package, rng, progress_bar, refuse)
        found.models.save(output)
    print_skipped(list(refused))
    console.print(
        f"learned from {len(found.labels)} boxes of {found.people} people who "
        f"surely walk, of {counted(found.labels.tracks, 'track')}",
        markup=False,
    )
    print_figures(found.models.card)
    console.print(f"wrote {output}", markup=False)


def print_figures(card: ModelCard) -> None:
    """Errors on people left out, step by step."""
    steps = (
        ("chance", None),
        ("the package's models", "_package"),
        ("learned in the boxes as given", "_boxes_as_given"),
        ("learned in aligned boxes" if card.parameters["aligned"] else "what is written", ""),
    )
    rows = [
        {
            "people left out": name,
            **{
                part: 90.0 if of is None else card.figures.get(f"{part}_error_deg{of}", float("nan"))
                for part in ("body", "head", "both")
            },
        }
        for name, of in steps
    ]
    print_table("mean error against the direction of travel, degrees", rows)
    errors = ", ".join(
        f"{part} {card.figures[f'{part}_expected_calibration_error']:.3f}" for part in ("body", "head")
    )
    console.print(f"expected calibration error: {errors}", markup=False)
    console.print(f"fails with: {card.fails_when}", markup=False)
