"""`perception adapt`."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np
import typer

from graphtrack.cli import options
from graphtrack.cli.console import emit, print_table, progress_bar
from graphtrack.display import counted
from perception.cli.common import CameraOptions, check_places, print_skipped
from perception.cli.searching import PeopleSearch, search_journals
from perception.cli.teaching import package_models

if TYPE_CHECKING:
    from perception.storage import ModelCard


def adapt(
    sources: Annotated[list[Path], typer.Argument(metavar="VIDEO|FOLDER...", exists=True)],
    output: options.OutputPath,
    camera: CameraOptions,
    boxes: Annotated[list[Path] | None, typer.Option(exists=True, dir_okay=False)] = None,
    write_model: Path | None = None,
    seed: options.Seed = 0,
) -> None:
    """Let a camera teach itself how bodies and heads point, from people who surely walk.

    `perception observe --models` uses the file.

    Parameters
    ----------
    sources : Videos or folders of images, all of one camera.
    output : Model file to write (.npz).
    boxes : MOT text or CAVIAR XML with people's boxes, or a detector's, whose ids are -1, once for each
        recording in their order; without it people are detected.
    write_model : Write the graph's model file (.toml) that goes with these models, for `graphtrack smooth
        --model`.
    """
    from graphtrack.errors import InputError
    from graphtrack.model import Model
    from perception.adaptation.adapting import Recording, adapted
    from perception.adaptation.recording import check_camera
    from perception.detection.boxes import read_boxes
    from perception.images.frames import FrameSource

    if output.suffix != ".npz":
        raise InputError(f"--output {output.name}", "a name that ends in .npz")
    given: list[Path | None] = [*boxes] if boxes else [None] * len(sources)
    if len(given) != len(sources):
        raise InputError(
            f"--boxes {len(given)} times for {counted(len(sources), 'recording')}",
            "once for each of them, in their order, or for none",
        )
    # A search that was broken off goes on: each recording has journals of its own.
    places = [output if k == 0 else output.with_name(f"{output.name}.{k}") for k in range(len(sources))]
    journals = [path for place in places for path in search_journals(place)]
    inputs = {"--boxes": boxes, **camera.files}
    outputs = {"--output": output, "--write-model": write_model, "the journals of --output": journals}
    for source in sources:
        check_places(outputs, None, source, inputs)
    on_ground = camera.on_ground()
    if on_ground is None:
        raise InputError("no camera", "--calibration or --homography: where people go is seen on the ground")
    opened = [FrameSource.open(source) for source in sources]
    for frames in opened:
        check_camera(on_ground, frames.size())
    refused: dict[str, None] = {}
    refuse = refused.setdefault
    rng = np.random.default_rng(seed)
    recordings = []
    with ExitStack() as searches:
        for frames, place, of_recording in zip(opened, places, given, strict=True):
            rate = camera.rate(frames)
            if of_recording is None:
                search = PeopleSearch(frames, on_ground, rate, place, camera.stamps, one_size=True)
                people = searches.enter_context(search).people(refuse)
            else:
                people = read_boxes(of_recording, refuse)
            recordings.append(Recording(frames, people, rate))
        found = adapted(recordings, on_ground, package_models(), rng, progress_bar, refuse)
        found.models.save(output)
        if write_model is not None:
            found.models.graph(Model.named(None)).save(write_model)
    print_skipped(list(refused))
    emit(
        f"learned from {len(found.labels)} boxes of {found.people} people who "
        f"surely walk, of {counted(found.labels.tracks, 'track')}"
    )
    print_figures(found.models.card)
    share = found.models.class_outlier_probability
    emit(f"the graph is to take {share:.0%} of the class likelihoods for nothing")
    emit(f"wrote {output}" + ("" if write_model is None else f" and {write_model}"))


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
    emit(f"expected calibration error: {errors}")
    emit(f"fails with: {card.fails_when}")
