"""`perception calibrate` and `perception adapt`: estimate a camera's view, and fit its own models.

`adapt_models` fits the models within other commands, once per recording.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np
import typer

from graphtrack.cli import options
from graphtrack.cli.console import emit, print_table, progress_bar
from graphtrack.errors import InputError
from graphtrack.tracks.display import counted
from perception.cli.options import (
    PRINTED,
    CameraOptions,
    Reports,
    VideoOrFolder,
    check_output_paths,
    read_given_boxes,
    report_skipped,
)
from perception.cli.searching import PeopleSearch, search_journals

if TYPE_CHECKING:
    from graphtrack.geometry.camera import GroundCamera
    from perception.adaptation.models import CameraModels
    from perception.detection.boxes import PersonBox
    from perception.images.frames import Clock, FrameSource
    from perception.storage import ModelCard


PersonHeight = Annotated[
    float,
    typer.Option("--person-height", min=0.5, max=3.0, help="Mean height of people's boxes, metres."),
]


def calibrate(
    source: VideoOrFolder,
    output: options.OutputPath,
    boxes: Annotated[Path | None, typer.Option(exists=True)] = None,
    point_pairs: options.InputFile | None = None,
    frame: Annotated[int | None, typer.Option(min=0)] = None,
    person_height: PersonHeight = 1.7,
    seed: options.Seed = 0,
) -> None:
    """Estimate a camera's view of the ground from people's boxes or from known points.

    With boxes, 95 % intervals are printed, and "scale only" where they are wider than ± 25 %. `--calibration`
    reads the file. Only the size of the frames is used. Without boxes and points, and with an output that
    ends in .html, a page is written on which points are clicked.

    Parameters
    ----------
    boxes : MOT text, COCO JSON, CAVIAR XML, a table with named columns or a folder of YOLO's labels, with
        people's boxes, with or without identities.
    point_pairs : File with rows 'u v X Y': pixels of points on the ground, and X and Y in metres.
    frame : Number of the frame of the page; by default the first.
    output : Calibration to write (.ci), or the page to click points on (.html).
    """
    is_page = output.suffix.lower() == ".html"
    if is_page or boxes is None:
        if is_page == (point_pairs is not None) or boxes is not None:
            given = {"--boxes": boxes, "--point-pairs": point_pairs}
            named = " and ".join(name for name, path in given.items() if path is not None)
            expected = "--boxes or --point-pairs, or an output .html without them: a page to click points"
            raise InputError(f"{named or 'neither'} with -o {output.name}", expected)
        _calibrate_by_points(source, output, point_pairs, frame)
        return
    if point_pairs is not None:
        raise InputError("--boxes and --point-pairs", "one of them")
    from perception.ground.calibration import found_view
    from perception.images.frames import FrameSource

    check_output_paths({"--output": output}, None, source, {"--boxes": boxes})
    frames = FrameSource.open(source)
    refused: dict[str, None] = {}
    people = read_given_boxes(boxes, frames, None, refused.setdefault)
    assert people is not None
    found = found_view(people, frames.size(), np.random.default_rng(seed), person_height)
    found.write(output)
    report_skipped(refused)
    emit(found.described())
    for note in found.notes:
        emit(f"  note: {note}")
    emit(f"wrote {output}")


def _calibrate_by_points(source: Path, output: Path, pairs: Path | None, frame: int | None) -> None:
    """Write the page for clicking points, or the calibration of their file."""
    from perception.ground.point_pairs import view_of_point_pairs, write_page
    from perception.images.frames import FrameSource

    check_output_paths({"--output": output}, None, source, {"--point-pairs": pairs})
    frames = FrameSource.open(source)
    if pairs is None:
        write_page(output, frames, frame)
        emit(f"wrote {output}: open it in a browser, click four points or more, save them as pairs.txt")
        emit(f"then: perception calibrate {source} --point-pairs pairs.txt -o camera.ci")
        return
    if frame is not None:
        raise InputError("--frame with --point-pairs", "a page (.html) as the output")
    found = view_of_point_pairs(pairs, frames.size())
    found.write(output)
    for line in found.described():
        emit(line)
    emit(f"wrote {output}")


def adapt_models(
    path: Path,
    key: str,
    frames: FrameSource,
    people: Sequence[PersonBox],
    camera: GroundCamera,
    clock: Clock,
    refuse: Callable[[str], object],
    *,
    seed: int = 0,
    reports: Reports = PRINTED,
) -> tuple[CameraModels | None, str]:
    """Fit a camera's own models to a recording; return them and a sentence about them.

    None if too few people are walking. The models are written to ``path``, and read from there
    if they were fitted with the same ``key`` before.
    """
    from perception.adaptation.learning import PackageModels, Recording, TooFewWalkers, adapted
    from perception.adaptation.models import CameraModels

    if path.is_file():
        known = CameraModels.load(path)
        if known.card.parameters.get("recording") == key:
            return known, _sentence(known)
    rng = np.random.default_rng(seed)
    try:
        recordings = [Recording(frames, people, clock)]
        models = adapted(recordings, camera, PackageModels.load(), rng, reports.progress, refuse).models
    except TooFewWalkers as error:
        sentence = f"the package's models are used: {error.found}"
        reports.emit(f"  note: {sentence}")
        return None, sentence
    models.card = replace(models.card, parameters={**models.card.parameters, "recording": key})
    models.save(path)
    sentence = _sentence(models)
    reports.emit(sentence)
    return models, sentence


def check_adapt(streamed: bool, camera: Path | None, models: Sequence[object]) -> None:
    """Refuse `--adapt` with a stream, without a camera file, or with other models."""
    if streamed:
        raise InputError("--adapt with -o -", "a file as the output: a camera learns from all frames")
    if camera is None:
        raise InputError("--adapt without a camera", "--calibration or --homography")
    if any(model is not None for model in models):
        raise InputError("--adapt with other models", "one of them")


def _sentence(models: CameraModels) -> str:
    card = models.card
    errors = " and ".join(f"{card.figures[f'{part}_error_deg']:.0f}° ({part})" for part in ("body", "head"))
    return (
        f"models of body and head fitted to {card.parameters['people']} walking people; mean error on "
        f"held-out people against the direction of travel: {errors}; by chance 90°"
    )


def adapt(
    sources: Annotated[list[Path], typer.Argument(metavar="VIDEO|FOLDER...", exists=True)],
    output: options.OutputPath,
    camera: CameraOptions,
    boxes: Annotated[list[Path] | None, typer.Option(exists=True, dir_okay=False)] = None,
    write_model: Path | None = None,
    seed: options.Seed = 0,
) -> None:
    """Fit models of body and head orientation to one camera, from walking people.

    `perception observe --models` reads the file.

    Parameters
    ----------
    sources : Videos or folders of images, all of one camera.
    output : Model file to write (.npz).
    boxes : MOT text, COCO JSON or CAVIAR XML with people's boxes, or of a detector (ids -1), once per
        recording, in their order; without it people are detected.
    write_model : Write the matching model file of the graph (.toml), for `graphtrack smooth --model`.
    """
    from graphtrack.model import Model
    from perception.adaptation.labels import check_camera
    from perception.adaptation.learning import PackageModels, Recording, adapted
    from perception.images.frames import FrameSource

    if output.suffix != ".npz":
        raise InputError(f"--output {output.name}", "a name that ends in .npz")
    given: list[Path | None] = [*boxes] if boxes else [None] * len(sources)
    if len(given) != len(sources):
        raise InputError(
            f"--boxes {len(given)} times for {counted(len(sources), 'recording')}",
            "once per recording, in their order, or not at all",
        )
    # Each recording has its own journals, so that an interrupted search continues.
    output_paths = [output if k == 0 else output.with_name(f"{output.name}.{k}") for k in range(len(sources))]
    journals = [path for place in output_paths for path in search_journals(place)]
    inputs = {"--boxes": boxes, **camera.files}
    outputs = {"--output": output, "--write-model": write_model, "the journals of --output": journals}
    for source in sources:
        check_output_paths(outputs, None, source, inputs)
    on_ground = camera.on_ground(lambda line: emit(f"  note: {line}"))
    if on_ground is None:
        raise InputError(
            "no camera", "--calibration or --homography: directions of travel are measured on the ground"
        )
    opened = [FrameSource.open(source) for source in sources]
    for frames in opened:
        check_camera(on_ground, frames.size())
    refused: dict[str, None] = {}
    refuse = refused.setdefault
    rng = np.random.default_rng(seed)
    recordings = []
    with ExitStack() as searches:
        for frames, place, of_recording in zip(opened, output_paths, given, strict=True):
            clock = camera.clock(frames)
            people = read_given_boxes(of_recording, frames, None, refuse)
            if people is None:
                search = PeopleSearch(frames, on_ground, clock, place)
                people, _ = searches.enter_context(search.people(refuse))
            recordings.append(Recording(frames, people, clock))
        found = adapted(recordings, on_ground, PackageModels.load(), rng, progress_bar, refuse)
        found.models.save(output)
        if write_model is not None:
            found.models.graph(Model.named(None)).save(write_model)
    report_skipped(refused)
    emit(
        f"fitted to {len(found.labels)} boxes of {found.people} walking people "
        f"in {counted(found.labels.tracks, 'track')}"
    )
    print_figures(found.models.card)
    share = found.models.class_outlier_probability
    emit(f"class_outlier_probability of the graph: {share:.2g}")
    emit(f"wrote {output}" + ("" if write_model is None else f" and {write_model}"))


def print_figures(card: ModelCard) -> None:
    """Print the errors on held-out people, step by step."""
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
